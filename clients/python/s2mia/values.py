"""What the simulator and teams have in common: agents, their actuators, and the checks of seeds and arrays that users give."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

Numbers = NDArray[np.float32]


@dataclass(frozen=True)
class Actuator:
    """An actuator, which one number of an action controls.

    With the control `c`, and `q` and `v` for `gear` times the position and speed of the joint, as agents observe them, the force
    is `gain * c + constant - kp * q - kd * v`, within `force_range`. The torque is `gear` times the force, N m; on a slide or
    tendon a force, N. About a ball joint's axis, `q` and `v` are sums along `ball_axis`. An actuator on a site has neither `q` nor
    `v`. `None` is no limit.
    """

    name: str
    """That of its joint, unless the model states one or the joint has several."""
    joint: str
    """Joint, tendon or site that it acts on."""
    kind: str
    """`motor`: the force depends on the control only; `position`: `kp * (c - q) - kd * v`; `velocity`: `kd * (c - v)`; `general`."""
    control_limits: list[float]
    """Range to which the control is clamped."""
    gear: float
    """N m per unit of force."""
    gain: float
    """Force per unit of the control."""
    constant: float
    """Force without a control, position and speed."""
    kp: float
    """Force per unit of `q`, such as N m/rad."""
    kd: float
    """Force per unit of `v`, such as N m s/rad."""
    force_range: list[float] | None
    """Range to which the force is clamped."""
    torque_range: list[float] | None
    """Range to which the joint clamps the sum of its actuators' torques, N m or N."""
    activation: str | None
    """MuJoCo's `dyntype`, `integrator`, `filter` or `filterexact`, of an activation that takes the place of `c`."""
    time_constant_secs: float | None
    """Of a filter."""
    activation_range: list[float] | None
    """Range to which the activation is clamped."""
    ball_axis: list[float] | None
    """On a ball joint, the axis by which `gear` is multiplied, in axes of the child."""
    link: str | None
    """On a site, the link on which it acts."""
    link_point: list[float] | None
    """The point at which it acts, in the link's frame, m."""
    link_force: list[float] | None
    """The force there per unit of `gear` times the force, in axes of the link, N."""
    link_torque: list[float] | None
    """The torque, likewise, N m."""


@dataclass(frozen=True)
class AgentSpec:
    """One agent of a task."""

    name: str
    joints: list[str]
    """Joints that it drives, in the order of its action; none in a game."""
    features: list[str]
    """Names of its observation, m, rad, m/s and rad/s."""
    action_size: int
    """Numbers in its action."""
    choices: int | None
    """Choices of a discrete action, which is one number."""
    control_ranges: list[list[float]]
    """Controls for the actions -1 and 1, a pair for each number; none in a game."""
    actuators: list[Actuator]
    """Those that these numbers control."""


def agent_fields(about: dict[str, Any]) -> dict[str, Any]:
    """The fields of an agent that the native module describes."""
    return {**about, "actuators": [Actuator(**own) for own in about["actuators"]]}


# A seed, also one of NumPy's integers.
Seed = int | np.integer[Any]


def whole(name: str, value: Any, least: int, most: int) -> int:
    """The value. Raises `ValueError` if it is no whole number from `least` to `most`."""
    is_whole = isinstance(value, int | np.integer) and not isinstance(value, bool)
    if not (is_whole and least <= value <= most):
        raise ValueError(f"{name} is {value!r}; it must be a whole number from {least} to {most}")
    return int(value)


def checked_seed(seed: Seed | None, most: int = 2**64 - 1) -> int | None:
    """The seed. Raises `ValueError` if it is no whole number from 0 to `most`."""
    return None if seed is None else whole("seed", seed, 0, most)


def numbers(name: str, values: ArrayLike) -> Numbers:
    """The array in 32 bits, where too large numbers are infinite.

    Raises `ValueError` for texts, truth values and complex numbers.
    """
    try:
        if np.ma.is_masked(values):
            raise ValueError("it has masked elements")
        array = np.asarray(values)
        if array.dtype.kind not in "iuf":
            if array.dtype.kind != "c":
                # Raises for texts that are no numbers, and says which.
                np.asarray(values, np.float32)
            raise TypeError(f"it has the type {array.dtype}")
        with np.errstate(over="ignore"):
            return array.astype("<f4")
    except (TypeError, ValueError) as error:
        raise ValueError(f"{name} is no array of numbers: {error}") from None
