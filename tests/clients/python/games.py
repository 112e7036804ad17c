"""Small environments as their authors would write them, for programs that offer them."""

import os

import numpy as np
from gymnasium import spaces
from pettingzoo import ParallelEnv
from s2mia_environment import Environment
from s2mia_environment.parallel import features
from s2mia import wire

STEPS = 50


class Follow(ParallelEnv):
    """Both agents see one of three signs and are paid when both choose it. A choice is numbered from 1."""

    metadata = {"name": "follow", "render_fps": 10}
    max_cycles = STEPS

    def __init__(self) -> None:
        self.possible_agents = ["left", "right"]

    def observation_space(self, agent):
        return spaces.Discrete(3)

    def action_space(self, agent):
        return spaces.Discrete(3, start=1)

    def reset(self, seed=None, options=None):
        self.rng, self.moves = np.random.default_rng(seed), 0
        self.agents = list(self.possible_agents)
        return self._look(), {}

    def step(self, actions):
        paid = float(all(action == self.sign + 1 for action in actions.values()))
        self.moves += 1
        over = self.moves == STEPS
        seen = self._look()
        every = {agent: over for agent in self.agents}
        return seen, dict.fromkeys(self.agents, paid), dict.fromkeys(self.agents, False), every, {}

    def _look(self) -> dict:
        self.sign = int(self.rng.integers(3))
        return dict.fromkeys(self.possible_agents, self.sign)


class Push(ParallelEnv):
    """Shows the actions: each agent sees its last push."""

    metadata = {"name": "push"}
    possible_agents = ["one", "two"]

    def __init__(self, low=(-2.0, -2.0), high=(2.0, 2.0)) -> None:
        self.box = spaces.Box(np.array(low, np.float32), np.array(high, np.float32))

    def observation_space(self, agent):
        return spaces.Box(-np.inf, np.inf, (2,), np.float32)

    def action_space(self, agent):
        return self.box

    def reset(self, seed=None, options=None):
        return {agent: np.zeros(2, np.float32) for agent in self.possible_agents}, {}

    def step(self, actions):
        ended = {"one": False, "two": bool(actions["two"][0] > 1.0)}
        return actions, {"one": 1.0, "two": 3.0}, ended, {"one": True, "two": False}, {}


class Aim(ParallelEnv):
    """Pays for actions near the middle of the upper half of their range."""

    metadata = {"name": "aim"}
    possible_agents = ["one", "two"]
    max_cycles = 20

    def __init__(self, first: float, second: float) -> None:
        self.high = np.array([first, second], np.float32)

    def observation_space(self, agent):
        return spaces.Box(-1, 1, (1,), np.float32)

    def action_space(self, agent):
        return spaces.Box(-self.high, self.high, dtype=np.float32)

    def reset(self, seed=None, options=None):
        self.agents, self.moves = list(self.possible_agents), 0
        return dict.fromkeys(self.agents, np.ones(1, np.float32)), {}

    def step(self, actions):
        self.moves += 1
        paid = -float(np.mean([(taken / self.high - 0.5) ** 2 for taken in actions.values()]))
        seen = dict.fromkeys(self.agents, np.ones(1, np.float32))
        never, late = dict.fromkeys(self.agents, False), dict.fromkeys(self.agents, self.moves == self.max_cycles)
        return seen, dict.fromkeys(self.agents, paid), never, late, {}


class Mixed(Aim):
    """One agent chooses, eight turn a knob by up to half a turn."""

    metadata = {"name": "mixed"}
    possible_agents = ["chooser", *(f"knob_{index}" for index in range(8))]

    def __init__(self) -> None:
        self.high = np.array([np.pi], np.float32)

    def action_space(self, agent):
        return spaces.Discrete(3) if agent == "chooser" else super().action_space(agent)


class Liar(Environment):
    """Says that it has one agent with one number, then shows what its arguments say."""

    def __init__(self, shown: float = 0.0, count: int = 1, state: int = 1) -> None:
        agent = wire.AgentSpec(
            name="a", observation=features("a", 1), action=wire.ActionSpec(size=1, low=-1.0, high=1.0)
        )
        self.spec = wire.EnvironmentSpec(
            task="liar", agents=[agent, agent], state=features("state", 1), dt_secs=0.1, episode_steps=10
        )
        self.shown = np.full(count, shown, np.float32), np.zeros(state, np.float32)

    def reset(self, seed: bytes) -> None:
        pass

    def step(self, actions):
        return 0.0, False, False

    def observe(self):
        observation, state = self.shown
        return state, [observation, observation]


class Fragile(Environment):
    """Shows the number of its process. An action of 1 raises an error, and an action of 2 ends the process."""

    def __init__(self) -> None:
        agent = wire.AgentSpec(
            name="a", observation=features("a", 1), action=wire.ActionSpec(size=1, low=0.0, high=2.0)
        )
        self.spec = wire.EnvironmentSpec(
            task="fragile", agents=[agent, agent], state=features("state", 1), dt_secs=0.1, episode_steps=10
        )

    def reset(self, seed: bytes) -> None:
        pass

    def step(self, actions):
        if actions[0][0] == 1.0:
            raise ValueError("broken by its action")
        if actions[0][0] == 2.0:
            os._exit(3)
        return 0.0, False, False

    def observe(self):
        shown = np.array([os.getpid()], np.float32)
        return shown, [shown, shown]
