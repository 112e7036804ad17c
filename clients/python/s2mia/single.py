"""The simulator under Gymnasium's interface, with one agent that drives the whole robot: `gym_env`."""

import difflib
import os
from typing import Any

import numpy as np

from s2mia import _native
from s2mia.settings import by_key, task_text
from s2mia.simulator import OneEnvironment, Simulator, demand_settings
from s2mia.values import Numbers, Seed, numbers

try:
    from gymnasium import Env
    from gymnasium.spaces import Box, MultiDiscrete, Space
except ModuleNotFoundError as missing:
    raise ModuleNotFoundError("s2mia.gym_env needs gymnasium: pip install 's2mia[environment]'") from missing


# Settings of what an agent observes, which here is the global state.
_WITHOUT_EFFECT = ("observation.mode", "observation.nearest", "observation.globals")


def gym_env(
    task: str | os.PathLike[str],
    *,
    seed: Seed | None = None,
    render_mode: str | None = None,
    disturbances: str = "training",
    **settings: Any,
) -> "SingleSimulator":
    """A task of the program as a Gymnasium `Env`, whose one agent drives the whole robot.

    Its observation is the global state, and its action that of all agents, in their order. `task` may also be the name of a
    robot, such as `"ant"`, whose partition does not matter here. The other arguments are those of `s2mia.parallel_env`.
    """
    demand_settings(gym_env, settings)
    for key in by_key(settings):
        if key in _WITHOUT_EFFECT:
            raise ValueError(f"{key} has no effect: the agent of gym_env observes the global state")
    name, names = task_text(task), _native.task_names()
    # Of each robot its first task.
    robots = {own.rpartition("-")[0]: own for own in reversed(names)}
    near = difflib.get_close_matches(name, [*names, *robots], 1, 0.8)
    if near and near[0] in robots.keys() - {name}:
        raise ValueError(f"unknown robot {name!r}; did you mean {near[0]!r}?")
    whole = name if name in names else robots.get(name, name)
    return SingleSimulator(Simulator(whole, settings, seed, disturbances), render_mode)


class SingleSimulator(OneEnvironment, Env[Numbers, Any]):
    """A Gymnasium environment. Units are those of `s2mia.parallel_env`."""

    def __init__(self, simulator: Simulator, render_mode: str | None) -> None:
        OneEnvironment.__init__(self, simulator, render_mode)
        agents = self.task.agents
        size = sum(agent.action_size for agent in agents)
        choices = [agent.choices for agent in agents if agent.choices is not None]
        self.observation_space: Space[Numbers] = Box(-np.inf, np.inf, (len(self.task.state),), np.float32)
        self.action_space: Space[Any] = MultiDiscrete(choices) if choices else Box(-1.0, 1.0, (size,), np.float32)

    def reset(
        self, *, seed: Seed | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Numbers, dict[str, Any]]:
        """Starts the next episode or, with a seed, episode 0. `options["limit"]` is the number of steps until truncation."""
        self.begin(seed, options)
        Env.reset(self, seed=None if seed is None else int(seed))
        return self.state(), {}

    def step(self, action: Any) -> tuple[Numbers, float, bool, bool, dict[str, Any]]:
        """Steps with the action `[A]`. `info` is that of an agent of `s2mia.parallel_env`."""
        joint = numbers("the action", action)
        if joint.shape != self.action_space.shape:
            raise ValueError(f"the action has the shape {joint.shape}, not {self.action_space.shape}")
        _, reward, terminated, truncated, info = self.advance(joint)
        return self.state(), reward, terminated, truncated, info
