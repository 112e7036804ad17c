"""What the simulator and teams have in common: agents, and the checks of seeds and arrays that users give."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

Numbers = NDArray[np.float32]


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


def whole(name: str, value: Any, least: int, most: int) -> int:
    """The value. Raises `ValueError` if it is no whole number from `least` to `most`."""
    is_whole = isinstance(value, int | np.integer) and not isinstance(value, bool)
    if not (is_whole and least <= value <= most):
        raise ValueError(f"{name} is {value!r}; it must be a whole number from {least} to {most}")
    return int(value)


def checked_seed(seed: int | None, most: int = 2**64 - 1) -> int | None:
    """The seed. Raises `ValueError` if it is no whole number from 0 to `most`."""
    return None if seed is None else whole("seed", seed, 0, most)


def numbers(name: str, values: ArrayLike) -> Numbers:
    """The array in 32 bits, where too large numbers are infinite.

    Raises `ValueError` for texts, truth values and complex numbers.
    """
    try:
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
