"""The random draws of a run: ChaCha with 8 rounds, keyed as in `policy::randomness`."""

import math
import struct

import torch

# Numbers of the purposes.
AGENT_ORDER, REPLAY, UPDATE_ACTION = 5, 13, 31
# Words of a block that each quarter round mixes: columns, then diagonals.
QUARTERS = [(i, 4 + i, 8 + i, 12 + i) for i in range(4)]
QUARTERS += [(i, 4 + (i + 1) % 4, 8 + (i + 2) % 4, 12 + (i + 3) % 4) for i in range(4)]


def block(key, counter):
    """Sixteen words for one value of the counter."""
    start = [*struct.unpack("<4I", b"expand 32-byte k"), *struct.unpack("<8I", key), counter, 0, 0, 0]
    words = list(start)
    for _ in range(4):
        for a, b, c, d in QUARTERS:
            for to, other, mixed, turn in [(a, b, d, 16), (c, d, b, 12), (a, b, d, 8), (c, d, b, 7)]:
                words[to] = (words[to] + words[other]) & 0xFFFFFFFF
                word = words[mixed] ^ words[to]
                words[mixed] = (word << turn | word >> (32 - turn)) & 0xFFFFFFFF
    return [(word + first) & 0xFFFFFFFF for word, first in zip(words, start)]


class Draws:
    """The generator of one draw."""

    def __init__(self, seed, purpose, agent=0, step=0):
        key = struct.pack("<QIIQII", seed, purpose, agent, 0, 0, step)
        self.words = (word for counter in range(2**32) for word in block(key, counter))

    def below(self, bound):
        """A uniform integer below `bound`."""
        low, high = next(self.words), next(self.words)
        return ((high << 32 | low) * bound) >> 64

    def permutation(self, count):
        """A random order of `0..count`."""
        order = list(range(count))
        for last in range(count - 1, 0, -1):
            other = self.below(last + 1)
            order[last], order[other] = order[other], order[last]
        return order

    def normals(self, *shape):
        """Standard normal numbers in single precision."""
        def one():
            u, v = (next(self.words) + 1) / 2**32, next(self.words) / 2**32
            return math.sqrt(-2.0 * math.log(u)) * math.cos(2.0 * math.pi * v)

        numbers = [one() for _ in range(math.prod(shape))]
        return torch.tensor(numbers, dtype=torch.float64).float().double().reshape(shape)
