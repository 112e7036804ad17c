"""The program's simulator: what the environments of PettingZoo and Gymnasium have in common."""

import copy
import difflib
import inspect
import json
import os
import struct
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from s2mia._native import Environments
from s2mia.settings import absolute, arguments, by_key
from s2mia.values import AgentSpec, Numbers, Seed, agent_fields, checked_seed, whole

RENDER_MODE = "rgb_array"
_REWARD = struct.Struct("<f")
# A setting has 63 bits.
_LARGEST_SEED = 2**63 - 1
MOST_ENVIRONMENTS, MOST_THREADS = 65_536, 1024
# Arguments that some kinds of environments have.
_ARGUMENTS = ("disturbances", "num_envs", "render_mode", "seed", "threads")


@dataclass(frozen=True)
class TaskSpec:
    """A task."""

    name: str
    dt_secs: float
    """Simulated seconds of a step."""
    episode_steps: int
    """Steps after which an episode is truncated."""
    state: list[str]
    """Names of the global state's features, m, rad, m/s and rad/s."""
    reward_terms: list[str]
    """Names of the terms whose sum is the reward; empty for games."""
    joints: list[str]
    """Joints with efforts: hinges and slides, then the three axes of each ball joint; empty for games."""
    agents: list[AgentSpec]


class Simulator:
    """Environments of one task. `native` steps them, with arrays as bytes. A copy, or what is unpickled, has had no episode."""

    def __init__(
        self,
        task: str | os.PathLike[str],
        settings: Mapping[str, Any],
        seed: Seed | None,
        disturbances: str,
        num_envs: int = 1,
        threads: int = 1,
    ) -> None:
        own = checked_seed(seed, _LARGEST_SEED)
        settings = by_key(settings)
        if not isinstance(disturbances, str):
            raise ValueError(f"disturbances is {disturbances!r}; it is 'training', 'evaluation' or 'off'")
        if own is not None and settings.get("run.seed", own) != own:
            raise ValueError(f"seed is {own} and run.seed is {settings['run.seed']}; give one of them")
        seeded = {} if own is None else {"run.seed": own}
        self.num_envs = whole("num_envs", num_envs, 1, MOST_ENVIRONMENTS)
        threads = whole("threads", threads, 1, MOST_THREADS)
        # A copy may be made in another folder.
        self._arguments = (absolute(task), settings, seed, disturbances, self.num_envs, threads)
        self.native = Environments(arguments(task, {**settings, **seeded}), self.num_envs, threads, disturbances)
        about: dict[str, Any] = json.loads(self.native.task())
        agents = [AgentSpec(**agent_fields(own)) for own in about.pop("agents")]
        self.task = TaskSpec(agents=agents, **about)

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), self._arguments

    def reset(self, seed: Seed | None, options: Mapping[str, Any] | None) -> None:
        """Starts the next episodes or, with a seed, episode 0 of another seed. `options["limit"]` shortens them."""
        given = {} if options is None else options
        if not isinstance(given, Mapping):
            raise ValueError(f"options is a {type(given).__name__}; it is a mapping such as {{'limit': 200}}")
        # PettingZoo's test resets with the option `options`.
        if unknown := given.keys() - {"limit", "options"}:
            raise ValueError(f"options has {', '.join(sorted(map(repr, unknown)))}; the option is 'limit'")
        limits = self._limits(given["limit"]) if "limit" in given else []
        self.native.reset(checked_seed(seed, _LARGEST_SEED), limits)

    def _limits(self, limit: Any) -> list[int]:
        """The limits of all environments, `[E]`, from one number or as many as there are environments."""
        limits = np.asarray(limit, object)
        if limits.shape not in ((), (self.num_envs,)):
            raise ValueError(f"limit has the shape {limits.shape}; it is a number or has the shape ({self.num_envs},)")
        return [whole("limit", one, 1, self.task.episode_steps) for one in np.broadcast_to(limits, self.num_envs)]


def demand_settings(function: Callable[..., Any], settings: Mapping[str, Any]) -> None:
    """Raises `ValueError` for an argument of another kind of environment, and for nearly one of `function`."""
    own = [name for name in inspect.signature(function).parameters if name in _ARGUMENTS]
    for key in settings:
        if key in _ARGUMENTS:
            raise ValueError(f"{function.__name__} has no argument {key!r}; it has {', '.join(map(repr, own))}")
        if near := difflib.get_close_matches(key, own, 1, 0.8):
            raise ValueError(f"unknown argument {key!r}; did you mean {near[0]!r}?")


class OneEnvironment:
    """One environment of the simulator. A copy of it, or what is unpickled, has had no episode."""

    metadata: dict[str, Any]

    def __init__(self, simulator: Simulator, render_mode: str | None) -> None:
        if render_mode not in (None, RENDER_MODE):
            raise ValueError(f"render_mode is {render_mode!r}; it is {RENDER_MODE!r} or None")
        self.simulator, self.task, self.render_mode = simulator, simulator.task, render_mode
        self.metadata = {
            "name": self.task.name,
            "render_modes": [RENDER_MODE] if self.task.joints else [],
            "render_fps": round(1 / self.task.dt_secs),
            "is_parallelizable": True,
        }
        self.is_running = False
        if render_mode is not None:
            self.render()

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), (self.simulator, self.render_mode)

    def __copy__(self) -> Any:
        return copy.deepcopy(self)

    def state(self) -> Numbers:
        """The global state `[S]`, whose features `task.state` names."""
        return np.frombuffer(self.simulator.native.states(), np.float32)

    def save(self) -> bytes:
        """The state, as logs and checkpoints of runs have it. What follows in the episode equals what follows `restore`.

        This holds bit for bit in any environment of the task with the same settings, `disturbances` and
        `environments__steps`; the next episodes are those of the environment's own seed.
        It differs from what follows without `save`, in the last bits: an environment that saves does not repeat a run.
        Raises `ValueError` before the first episode, or if the episode is over.
        """
        return self.simulator.native.save(0)

    def restore(self, state: bytes | bytearray | memoryview) -> None:
        """Continues from an exact state, of this task. Raises `ValueError` for anything else, and changes nothing."""
        try:
            exact = bytes(memoryview(state))
        except TypeError:
            raise ValueError(f"the state is a {type(state).__name__}; it is the bytes that save() returns") from None
        self.simulator.native.restore(0, exact)
        self.is_running = True

    def render(self) -> NDArray[np.uint8]:
        """A picture of the robot from the side, `[height, width, 3]`."""
        if self.render_mode is None:
            raise ValueError(f"nothing is drawn: make the environment with render_mode={RENDER_MODE!r}")
        height, width, pixels = self.simulator.native.picture(0)
        return np.frombuffer(pixels, np.uint8).reshape(height, width, 3)

    def close(self) -> None:
        """Does nothing."""

    def begin(self, seed: Seed | None, options: Mapping[str, Any] | None) -> None:
        """Starts an episode."""
        self.simulator.reset(seed, options)
        self.is_running = True

    def observe(self) -> Numbers:
        """Observations of all agents in their order, `[O]`."""
        return np.frombuffer(self.simulator.native.observations(), np.float32)

    def demand_running(self) -> None:
        """Raises `ValueError` if no episode is running."""
        if not self.is_running:
            raise ValueError("no episode is running; call reset()")

    def advance(self, joint: Numbers) -> tuple[Numbers, float, bool, bool, dict[str, Any]]:
        """Steps with the joint action `[A]`: observations `[O]`, reward, terminated, truncated and info."""
        self.demand_running()
        seen, reward, terms, efforts, terminated, truncated, fault = self.simulator.native.step(joint.tobytes())
        self.is_running = not (terminated[0] or truncated[0])
        observations = np.frombuffer(seen, np.float32)
        info: dict[str, Any] = {"fault": True} if fault[0] else {}
        if self.task.reward_terms or self.task.joints:
            info["reward_terms"] = dict(zip(self.task.reward_terms, np.frombuffer(terms, np.float32).tolist(), strict=True))
            info["efforts"] = dict(zip(self.task.joints, np.frombuffer(efforts, np.float32).tolist(), strict=True))
        return observations, _REWARD.unpack(reward)[0], bool(terminated[0]), bool(truncated[0]), info
