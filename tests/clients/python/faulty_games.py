"""Environments with one fault each, as their authors might write them."""

import os
import pathlib
import sys
import time

import numpy as np
from gymnasium import spaces
from pettingzoo import AECEnv, ParallelEnv


def _double(name):
    return lambda seen, *others: seen.update({name: seen["b"]})


def _without(index):
    return lambda *dictionaries: dictionaries[index].pop("b")


def _with(index, agent, value):
    return lambda *dictionaries: dictionaries[index].update({agent: value})


def _raise(*_):
    raise KeyError("an error of the author")


# What each fault does to observations, rewards, terminations and truncations in the third step.
FAULTS = {
    "none": lambda *_: None,
    "no number": _with(0, "b", np.array([0, np.nan, 0])),
    "overflow": _with(0, "b", np.array([0, 0, 1e300])),
    "another shape": _with(0, "b", np.zeros(4)),
    "words": _with(0, "b", np.array(["x", "y", "z"])),
    "outside": _with(0, "b", np.array([0, 5, 0])),
    "no observation": _without(0),
    "one too many": _double("c"),
    "no reward": _without(1),
    "a huge reward": _with(1, "b", 4e10),
    "a reward that is none": _with(1, "a", None),
    "an endless reward": _with(1, "a", np.inf),
    "no termination": _without(2),
    "no truncation": _without(3),
    "__all__": _with(2, "__all__", False),
    "a word": _with(2, "a", "False"),
    "both ends": lambda seen, rewards, terminations, truncations: (
        terminations.update(a=True),
        truncations.update(a=True),
    ),
    "an error": _raise,
    "an exit": lambda *_: sys.exit("an exit of the author"),
}


class Game(ParallelEnv):
    """A game for two with a fault in its third step."""

    metadata = {"name": "game"}
    possible_agents = ["a", "b"]
    max_cycles = 5

    def __init__(self, fault: str = "none") -> None:
        self.fault, self.moves = FAULTS[fault], 0

    def observation_space(self, agent):
        return spaces.Box(-1, 1, (3,), np.float32)

    def action_space(self, agent):
        return spaces.Discrete(2)

    def reset(self, seed=None, options=None):
        self.moves = 0
        return self.of_all(np.zeros(3)), {}

    def step(self, actions):
        self.moves += 1
        answer = self.of_all(np.zeros(3)), self.of_all(1.0), self.of_all(False), self.of_all(False)
        if self.moves == 3:
            self.fault(*answer)
        return *answer, {}

    def of_all(self, value) -> dict:
        return dict.fromkeys(self.possible_agents, value)


class Misspelt(Game):
    def state(self):
        return self.postions


class Unfinished(Game):
    def state(self):
        return self.features()

    def features(self):
        raise NotImplementedError


class Described(Game):
    def state(self):
        return np.arange(7)


class Attribute(Game):
    state = np.zeros(3)


class Late(Game):
    def reset(self, seed=None, options=None):
        return {"a": np.zeros(3)}, {}


class Old(Game):
    def reset(self, seed=None, options=None):
        return super().reset()[0]


class Unseeded(Game):
    def reset(self, options=None):
        return super().reset()


class Restless(Game):
    """Ignores its seed."""

    max_cycles = None

    def reset(self, seed=None, options=None):
        return self.of_all(np.random.default_rng().random(3)), {}


class Endless(Game):
    def step(self, actions):
        time.sleep(1000)


class Turns(AECEnv):
    possible_agents = ["a", "b"]


def nothing():
    return None


def broken():
    raise ValueError("an error of the author\nin two lines")


class Held(Game):
    """Holds a file outside the process until it is closed."""

    def __init__(self, folder):
        super().__init__()
        self.file = pathlib.Path(folder) / f"{os.getpid()}-{id(self)}"
        self.file.write_text("held")

    def close(self):
        self.file.unlink()
