"""The simulator under Gymnasium's interface of vectorised environments: `vector_env`."""

import copy
import os
from typing import Any

import numpy as np
from numpy.typing import NDArray

from s2mia.simulator import Simulator, demand_settings
from s2mia.values import Numbers, Seed, numbers

try:
    from gymnasium.spaces import Box, MultiDiscrete, Space
    from gymnasium.vector import AutoresetMode, VectorEnv
    from gymnasium.vector.utils import batch_space
except ModuleNotFoundError as missing:
    raise ModuleNotFoundError("s2mia.vector_env needs gymnasium: pip install 's2mia[environment]'") from missing

Flags = NDArray[np.bool_]


def vector_env(
    task: str | os.PathLike[str],
    num_envs: int = 1,
    *,
    threads: int = 1,
    seed: Seed | None = None,
    disturbances: str = "training",
    **settings: Any,
) -> "VectorSimulator":
    """`num_envs` environments of a task as a Gymnasium `VectorEnv` of a team: arrays of all agents in and out.

    `threads` threads step them; no result depends on their number. Environment `i` starts episode `e` as environment `i` of
    a run with the same seed does, whose first episodes may be shorter (`environments.phase`). The other arguments are those of
    `s2mia.parallel_env`.
    """
    demand_settings(vector_env, settings)
    return VectorSimulator(Simulator(task, settings, seed, disturbances, num_envs, threads))


class VectorSimulator(VectorEnv[Numbers, Any, NDArray[Any]]):
    """Environments with `N` agents each.

    Observations are `[E, N, obs]`; actions are `[E, N, act]` from -1 to 1, or `[E, N]` indices of choices. If agents have
    different sizes, `obs` and `act` are the largest: further numbers of an observation are 0, those of an action are ignored.
    Rewards are those of the teams, `[E]`. An environment whose episode has ended starts the next one in the next step, with the
    reward 0 (`AutoresetMode.NEXT_STEP`). `infos` of a robot's steps have `reward_terms` and `efforts` by name, `[E]` each, with
    masks `_reward_terms` and `_efforts` of the environments that did not start an episode, and `fault` `[E]` after a step that left
    the bounds of the simulation. A copy, or what is unpickled, has had no episode.
    """

    def __init__(self, simulator: Simulator) -> None:
        self.simulator, self.task, self.num_envs = simulator, simulator.task, simulator.num_envs
        # Gymnasium's own environments have it in both places.
        self.autoreset_mode = AutoresetMode.NEXT_STEP
        self.metadata = {"name": self.task.name, "autoreset_mode": self.autoreset_mode}
        agents = self.task.agents
        self._features = _Columns([len(agent.features) for agent in agents])
        self._numbers = _Columns([agent.action_size for agent in agents])
        shape = (len(agents), self._features.largest)
        self.single_observation_space = Box(-np.inf, np.inf, shape, np.float32)
        choices = [agent.choices for agent in agents if agent.choices is not None]
        single: Space[Any] = Box(-1.0, 1.0, (len(agents), self._numbers.largest), np.float32)
        self.single_action_space = MultiDiscrete(choices) if choices else single
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)
        self.action_space = batch_space(self.single_action_space, self.num_envs)
        # Environments that the next step steps; the others start an episode.
        self._running = np.ones(self.num_envs, np.bool_)

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), (self.simulator,)

    def __copy__(self) -> "VectorSimulator":
        return copy.deepcopy(self)

    def reset(self, *, seed: Seed | None = None, options: dict[str, Any] | None = None) -> tuple[Numbers, dict[str, Any]]:
        """Starts the next episodes or, with a seed, episode 0. `options["limit"]` is the number of steps until truncation, of
        all environments or of each, `[E]`."""
        self.simulator.reset(seed, options)
        super().reset(seed=None if seed is None else int(seed))
        self._running = np.ones(self.num_envs, np.bool_)
        return self._observed(self.simulator.native.observations()), {}

    def step(self, actions: Any) -> tuple[Numbers, Numbers, Flags, Flags, dict[str, Any]]:
        """Steps all environments: observations, rewards, terminations, truncations and infos."""
        joint = numbers("the joint action", actions)
        if joint.shape != self.action_space.shape:
            raise ValueError(f"the actions have the shape {joint.shape}, not {self.action_space.shape}")
        joint = self._numbers.joined(joint.reshape(self.num_envs, -1))
        seen, rewards, terms, efforts, *flags = self.simulator.native.step(joint.tobytes())
        terminated, truncated, fault = (np.frombuffer(flag, np.bool_) for flag in flags)
        infos = self._infos(terms, efforts)
        if fault.any():
            infos |= {"fault": fault, "_fault": fault}
        self._running = ~(terminated | truncated)
        return self._observed(seen), np.frombuffer(rewards, np.float32), terminated, truncated, infos

    def state(self) -> Numbers:
        """The global states, `[E, S]`."""
        return np.frombuffer(self.simulator.native.states(), np.float32).reshape(self.num_envs, -1)

    def _infos(self, terms: bytearray, efforts: bytearray) -> dict[str, Any]:
        """Terms of the rewards and efforts, in which a game has none."""
        if not (self.task.reward_terms or self.task.joints):
            return {}

        def by_name(names: list[str], rows: bytearray) -> dict[str, Numbers]:
            return dict(zip(names, np.frombuffer(rows, np.float32).reshape(self.num_envs, -1).T, strict=True))

        return {
            "reward_terms": by_name(self.task.reward_terms, terms),
            "_reward_terms": self._running,
            "efforts": by_name(self.task.joints, efforts),
            "_efforts": self._running,
        }

    def _observed(self, seen: bytearray) -> Numbers:
        rows = np.frombuffer(seen, np.float32).reshape(self.num_envs, -1)
        return self._features.padded(rows).reshape(self.observation_space.shape or ())


class _Columns:
    """Numbers of all agents in one row, which belong to the first columns of equally long rows of each agent."""

    def __init__(self, sizes: list[int]) -> None:
        self.largest = max(sizes)
        self.width = len(sizes) * self.largest
        columns = [agent * self.largest + column for agent, size in enumerate(sizes) for column in range(size)]
        self.places = np.array(columns) if len(columns) < self.width else None

    def padded(self, rows: Numbers) -> Numbers:
        """`[E, N * largest]` of `[E, sum of sizes]`."""
        if self.places is None:
            return rows
        padded = np.zeros((len(rows), self.width), np.float32)
        padded[:, self.places] = rows
        return padded

    def joined(self, rows: Numbers) -> Numbers:
        """`[E, sum of sizes]` of `[E, N * largest]`."""
        return rows if self.places is None else rows[:, self.places]
