"""Noise of which all agents share a part, in NumPy, as `policy/src/shared_noise.rs`.

The signal `z` of a step has a key that names no agent, so every process computes the same one: the first numbers of the ChaCha
generator with 8 rounds whose key has the run's seed, a purpose, the iteration, the environment and the step.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float32]

# Purposes of the signals of training actions and of sampled evaluations, as in `policy/src/randomness.rs`.
TRAINING, SAMPLED = 40, 41
# Largest norm of a row of loadings.
LARGEST = np.float32(0.95)
_QUARTERS = ((0, 4, 8, 12), (1, 5, 9, 13), (2, 6, 10, 14), (3, 7, 11, 15))
_DIAGONALS = ((0, 5, 10, 15), (1, 6, 11, 12), (2, 7, 8, 13), (3, 4, 9, 14))


def _first_words(keys: NDArray[np.uint32]) -> NDArray[np.uint32]:
    """The first 16 words `[E, 16]` of the generators with keys `[E, 8]`."""
    start = np.zeros((16, len(keys)), np.uint32)
    start[:4] = np.frombuffer(b"expand 32-byte k", "<u4")[:, None]
    start[4:12] = keys.T
    words = start.copy()
    for places in 4 * (_QUARTERS + _DIAGONALS):
        a, b, c, d = places
        for to, by, turned, bits in ((a, b, d, 16), (c, d, b, 12), (a, b, d, 8), (c, d, b, 7)):
            words[to] += words[by]
            mixed = words[turned] ^ words[to]
            words[turned] = (mixed << np.uint32(bits)) | (mixed >> np.uint32(32 - bits))
    return (words + start).T


class SharedNoise:
    """One agent's part of the noise that all agents share: loadings `r` `[act, K]` of a signal `z` `[K]`."""

    def __init__(self, settings: dict[str, Any], actions: int, u: Floats | None) -> None:
        """`u` has the parameters `[act, K]` of learnt loadings. Raises `ValueError` if it is missing."""
        self.size, self._hold = settings["size"], settings["hold"]
        share = np.float32(settings.get("share", 1.0))
        self.loadings: Floats = np.zeros((actions, self.size), np.float32)
        if u is None and "loading" not in settings:
            raise ValueError("shared noise with learnt loadings has no array head.loading")
        if u is None:
            rows = np.arange(actions)
            self.loadings[rows, rows % self.size] = share * np.float32(settings["loading"])
        else:
            self.loadings = share * LARGEST / np.sqrt(np.float32(self.size)) * np.tanh(u)
        squares: Floats = (self.loadings**2).sum(-1)
        self.own_part: Floats = np.sqrt(1 - squares)
        """Part of each standard deviation that is the agent's own given the signal, `[act]`."""

    def signal(self, seed: int, purpose: int, iteration: int, environments: Sequence[int], step: int) -> Floats:
        """The signals `[E, K]` of a step in some environments."""
        held = step - step % self._hold
        heads = seed.to_bytes(8, "little") + purpose.to_bytes(4, "little") + bytes(4) + iteration.to_bytes(8, "little")
        tails = [environment.to_bytes(4, "little") + held.to_bytes(4, "little") for environment in environments]
        keys = np.frombuffer(b"".join(heads + tail for tail in tails), "<u4").reshape(-1, 8)
        pairs = _first_words(keys)[:, : 2 * self.size].astype(np.float64) / 2.0**32
        radius = np.sqrt(-2 * np.log(pairs[:, ::2] + 2.0**-32))
        return np.asarray(radius * np.cos(2 * np.pi * pairs[:, 1::2]), np.float32)
