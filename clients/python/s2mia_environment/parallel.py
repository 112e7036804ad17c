"""A PettingZoo `ParallelEnv` as an environment for s2mia."""

import functools
import hashlib
import importlib

import numpy as np
from gymnasium import spaces
from s2mia import wire

from s2mia_environment.environment import Environment, EnvironmentBatch, OneByOne

# Defaults for environments that do not define their episode length or step time.
EPISODE_STEPS = 1000
STEP_SECS = 0.05


def number_of(seed: bytes) -> int:
    """The seed of an episode as a number below 2^32."""
    return int.from_bytes(hashlib.sha256(seed).digest()[:4], "little")


class Box:
    """A continuous action. Policies act in -1 to 1: the limits of each dimension's own range."""

    def __init__(self, space: spaces.Box) -> None:
        low, high = space.low.astype(np.float64).ravel(), space.high.astype(np.float64).ravel()
        # The largest number of a type is a way to write that there is no bound.
        if not np.all(np.abs([low, high]) < np.finfo(np.float32).max):
            raise ValueError(f"actions must have finite bounds, not {space}; state the range that has an effect")
        self.space, self.low, self.high = space, low, high
        self.middle, self.half = low / 2 + high / 2, high / 2 - low / 2
        self.spec = wire.ActionSpec(size=low.size, low=-1.0, high=1.0)

    def action(self, numbers: np.ndarray) -> np.ndarray:
        """The action of the environment: scaled to the range of each dimension and clamped."""
        scaled = np.clip(self.middle + self.half * numbers.astype(np.float64), self.low, self.high)
        return scaled.reshape(self.space.shape).astype(self.space.dtype)


class Choice:
    """A discrete action."""

    def __init__(self, space: spaces.Discrete) -> None:
        self.start = int(space.start)
        self.spec = wire.ActionSpec(size=1, low=0.0, high=float(space.n - 1), choices=int(space.n))

    def action(self, numbers: np.ndarray) -> int:
        """The choice in the environment's numbering."""
        return self.start + int(numbers[0])


ACTIONS = {spaces.Box: Box, spaces.Discrete: Choice}


def action_of(space: spaces.Space):
    """The action type of a space."""
    if type(space) not in ACTIONS:
        raise ValueError(f"actions must be one Box or one Discrete per agent, not {space}")
    return ACTIONS[type(space)](space)


def features(name: str, count: int) -> list:
    """Features named by their index."""
    signal = wire.FEATURE_ROLE_SIGNAL
    return [wire.FeatureSpec(name=f"{name}.{index}", role=signal) for index in range(count)]


class Parallel(Environment):
    """All agents step at once and share one reward, the mean of theirs; the first agent's end ends the episode.

    The global state is the environment's `state()`, or the concatenated observations if it has none. States are
    not saved: an episode is restored by replaying it.
    """

    def __init__(self, env) -> None:
        self.env = env
        self.agents = list(env.possible_agents)
        self.spaces = [env.observation_space(agent) for agent in self.agents]
        self.actions = [action_of(env.action_space(agent)) for agent in self.agents]
        self.seen: list[np.ndarray] = []
        self.reset(bytes(32))
        state, observations = self.observe()
        self.spec = wire.EnvironmentSpec(
            task=str(env.metadata.get("name", type(env.unwrapped).__name__)),
            agents=[
                wire.AgentSpec(name=str(agent), observation=features(str(agent), row.size), action=action.spec)
                for agent, row, action in zip(self.agents, observations, self.actions, strict=True)
            ],
            state=features("state", state.size),
            dt_secs=self.step_secs(),
            episode_steps=self.episode_steps(),
        )

    def step_secs(self) -> float:
        """Seconds per step, for display."""
        return 1.0 / self.env.metadata["render_fps"] if "render_fps" in self.env.metadata else STEP_SECS

    def episode_steps(self) -> int:
        """Steps after which the client truncates an episode."""
        known = (getattr(self.env.unwrapped, name, None) for name in ("max_cycles", "max_steps", "max_episode_steps"))
        return next((int(steps) for steps in known if steps), EPISODE_STEPS)

    def reset(self, seed: bytes) -> None:
        observations, _ = self.env.reset(seed=number_of(seed))
        self._store(observations)

    def step(self, actions: list[np.ndarray]) -> tuple[float, bool, bool]:
        taken = {
            agent: kind.action(numbers) for agent, kind, numbers in zip(self.agents, self.actions, actions, strict=True)
        }
        observations, rewards, terminations, truncations, _ = self.env.step(taken)
        self._store(observations)
        terminated = any(terminations.values())
        reward = float(np.mean([rewards[agent] for agent in self.agents]))
        return reward, terminated, not terminated and any(truncations.values())

    def observe(self) -> tuple[np.ndarray, list[np.ndarray]]:
        return self.state(), self.seen

    def state(self) -> np.ndarray:
        """The global state."""
        try:
            return np.asarray(self.env.state(), np.float32).ravel()
        except (AttributeError, NotImplementedError):
            return np.concatenate(self.seen)

    def _store(self, observations: dict) -> None:
        self.seen = [
            np.asarray(spaces.flatten(space, observations[agent]), np.float32)
            for agent, space in zip(self.agents, self.spaces, strict=True)
        ]


def batch_of(function: str, settings: dict) -> EnvironmentBatch:
    """The environments of one stream, made by `PACKAGE.module:FUNCTION` with these arguments."""
    module, _, name = function.partition(":")
    make = functools.partial(getattr(importlib.import_module(module), name), **settings)
    made = make()
    if isinstance(made, EnvironmentBatch):
        return made
    if isinstance(made, Environment):
        return OneByOne(made, make)
    return OneByOne(Parallel(made), lambda: Parallel(make()))
