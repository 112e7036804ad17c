"""The game `cue-2x1` in Python, with the same states as the built-in game.

Two agents observe one of three cues and one of four places. If both choose the cue, the reward is 1 and the place
advances by one.
"""

import struct
from typing import Any

import numpy as np
from numpy.typing import NDArray

PLACES, CUES, AGENTS, STEPS = 4, 3, 2, 50
KIND = "discrete/cue"
STATE_VERSION = 1
_HEADER = struct.Struct("<4sIIQII")


def _fnv1a(text: str) -> int:
    value = 0x811C9DC5
    for byte in text.encode():
        value = (value ^ byte) * 0x01000193 % 2**32
    return value


def _one_hot(index: int, size: int) -> NDArray[np.float32]:
    return np.asarray(np.eye(size, dtype=np.float32)[index])


class Cue:
    """One game."""

    def __init__(self) -> None:
        self.episode = self.moves = self.place = 0
        self.limit, self.cues = STEPS, [0] * (STEPS + 1)

    def reset(self, episode: int, limit: int, rng: np.random.Generator) -> None:
        self.episode, self.moves, self.limit = episode, 0, limit
        self.place = int(rng.integers(PLACES))
        self.cues = [int(cue) for cue in rng.integers(CUES, size=STEPS + 1)]

    def step(self, actions: list[NDArray[Any]]) -> tuple[float, bool, bool]:
        matched = all(action[0] == self.cues[self.moves] for action in actions)
        self.moves += 1
        self.place = (self.place + matched) % PLACES
        return float(matched), False, self.moves >= self.limit

    def observe(self) -> tuple[NDArray[Any], list[NDArray[Any]]]:
        place, cue = _one_hot(self.place, PLACES), _one_hot(self.cues[self.moves], CUES)
        return place, [np.concatenate([place, cue, _one_hot(agent, AGENTS)]) for agent in range(AGENTS)]

    def save(self) -> bytes:
        header = _HEADER.pack(b"s2st", STATE_VERSION, _fnv1a(KIND), self.episode, self.moves, self.limit)
        return header + np.array([self.place, *self.cues], "<f4").tobytes()

    def restore(self, state: bytes) -> int:
        mark, version, kind, self.episode, self.moves, self.limit = _HEADER.unpack_from(state)
        if (mark, version, kind) != (b"s2st", STATE_VERSION, _fnv1a(KIND)):
            raise ValueError("the bytes are not a state of cue-2x1")
        self.place, *self.cues = (int(number) for number in np.frombuffer(state[_HEADER.size :], "<f4"))
        return self.episode
