"""The simulator under PettingZoo's interface: `parallel_env`."""

import os
from collections.abc import Mapping
from typing import Any

import numpy as np

from s2mia.simulator import OneEnvironment, Simulator, demand_settings
from s2mia.values import AgentSpec, Numbers, Seed, numbers

try:
    from gymnasium.spaces import Box, Discrete, Space
    from pettingzoo import ParallelEnv
except ModuleNotFoundError as missing:
    raise ModuleNotFoundError("s2mia.parallel_env needs pettingzoo: pip install 's2mia[environment]'") from missing


def parallel_env(
    task: str | os.PathLike[str],
    *,
    seed: Seed | None = None,
    render_mode: str | None = None,
    disturbances: str = "training",
    **settings: Any,
) -> "ParallelSimulator":
    """A task of the program as a PettingZoo `ParallelEnv`, with the same bits as `s2mia train`.

    `task` is a name of `s2mia tasks` or the path of a task file. `settings` are those of the program that change an
    environment, such as `observation__mode="k_nearest"`. Episode `e` starts as episode `e` of environment 0 of a run with the
    same seed, which is `run.seed` unless it is given. Of the disturbances of a task, those of `"training"` act, those of
    `"evaluation"`, or none with `"off"`. Raises `ValueError` in one line if an argument is invalid.
    """
    demand_settings(parallel_env, settings)
    return ParallelSimulator(Simulator(task, settings, seed, disturbances), render_mode)


def _spaces(agent: AgentSpec) -> tuple[Space[Any], Space[Any]]:
    """The spaces of an agent's observations and actions."""
    action: Space[Any] = Box(-1.0, 1.0, (agent.action_size,), np.float32)
    if agent.choices is not None:
        action = Discrete(agent.choices)
    return Box(-np.inf, np.inf, (len(agent.features),), np.float32), action


def _own(info: dict[str, Any]) -> dict[str, Any]:
    """A copy, whose dictionaries are copies."""
    return {key: dict(value) if isinstance(value, dict) else value for key, value in info.items()}


class ParallelSimulator(OneEnvironment, ParallelEnv[str, Numbers, Any]):  # type: ignore[misc]
    """A PettingZoo environment.

    Observations are not scaled; `task` names their features. Continuous actions are in units of half a range: -1 and 1 are the
    limits of an actuator. Every agent gets the reward of the team. `infos` have `reward_terms`, the terms that sum to the
    reward, `efforts`, the mean torques of the actuators during the step by the names in `task.joints` (N m, or N on a slide), and
    `fault` after a step that left the bounds of the simulation, which truncates the episode.
    """

    def __init__(self, simulator: Simulator, render_mode: str | None) -> None:
        OneEnvironment.__init__(self, simulator, render_mode)
        agents = self.task.agents
        self.possible_agents = [agent.name for agent in agents]
        self.agents: list[str] = []
        spaces = {agent.name: _spaces(agent) for agent in agents}
        self.observation_spaces = {name: observation for name, (observation, _) in spaces.items()}
        self.action_spaces = {name: action for name, (_, action) in spaces.items()}
        self.state_space = Box(-np.inf, np.inf, (len(self.task.state),), np.float32)
        ends = np.cumsum([0, *(len(agent.features) for agent in agents)]).tolist()
        self._rows = [
            (name, slice(*ends[index : index + 2])) for index, name in enumerate(self.possible_agents)
        ]
        self._names = set(self.possible_agents)
        # A choice may be a number or an array of one.
        shapes = [((agent.action_size,), (agent.action_size,) if agent.choices is None else ()) for agent in agents]
        self._shapes = list(zip(self.possible_agents, shapes, strict=True))

    def observation_space(self, agent: str) -> Space[Any]:
        """The space of the agent's observation, `[obs]`."""
        return self.observation_spaces[agent]

    def action_space(self, agent: str) -> Space[Any]:
        """The space of the agent's action: `[act]`, or the index of a choice."""
        return self.action_spaces[agent]

    def reset(
        self, seed: Seed | None = None, options: Mapping[str, Any] | None = None
    ) -> tuple[dict[str, Numbers], dict[str, dict[str, Any]]]:
        """Starts the next episode or, with a seed, episode 0. `options["limit"]` is the number of steps until truncation."""
        self.begin(seed, options)
        self.agents = list(self.possible_agents)
        return self._split(self.observe()), {name: {} for name in self.agents}

    def step(
        self, actions: Mapping[str, Any]
    ) -> tuple[
        dict[str, Numbers], dict[str, float], dict[str, bool], dict[str, bool], dict[str, dict[str, Any]]
    ]:
        """Steps with an action of each agent. At the end of an episode, `agents` becomes empty."""
        self.demand_running()
        seen, reward, terminated, truncated, info = self.advance(self._joint(actions))
        names = self.agents
        if terminated or truncated:
            self.agents = []
        return (
            self._split(seen),
            dict.fromkeys(names, reward),
            dict.fromkeys(names, terminated),
            dict.fromkeys(names, truncated),
            {name: _own(info) for name in names},
        )

    def restore(self, state: bytes | bytearray | memoryview) -> None:
        """Continues from an exact state of this task. Raises `ValueError` for other bytes, and changes nothing."""
        super().restore(state)
        self.agents = list(self.possible_agents)

    def observations(self) -> dict[str, Numbers]:
        """What the agents observe now, as the last reset or step returned it, or as a restored state is observed."""
        return self._split(self.observe())

    def _split(self, seen: Numbers) -> dict[str, Numbers]:
        return {name: seen[row] for name, row in self._rows}

    def _joint(self, actions: Mapping[str, Any]) -> Numbers:
        """The joint action `[A]`."""
        if not isinstance(actions, Mapping):
            raise ValueError(f"actions is a {type(actions).__name__}; it maps the name of each agent to its action")
        if actions.keys() != self._names:
            named, agents = ", ".join(map(str, actions)), ", ".join(self.possible_agents)
            if not named:
                raise ValueError(f"the dictionary of actions is empty; it needs an action for each of {agents}")
            raise ValueError(f"the actions are of the agents {named}; needed are those of {agents}")
        rows = []
        for name, shapes in self._shapes:
            rows.append(numbers(f"the action of {name}", actions[name]))
            if rows[-1].shape not in shapes:
                raise ValueError(f"the action of {name} has the shape {rows[-1].shape}, not {shapes[0]}")
        return np.concatenate(rows, axis=None)
