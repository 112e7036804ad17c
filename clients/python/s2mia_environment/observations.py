"""Observations and states as checked rows of 32-bit floats."""

from collections.abc import Mapping, Sequence

import numpy as np
from gymnasium import spaces

from s2mia_environment.environment import InvalidEnvironment
from s2mia_environment.notes import note

# Actors accept no number of a larger magnitude (proto/src/tensor.rs).
LIMIT = 1e9


def numbers(what: str, value) -> np.ndarray:
    """The numbers of an array as one row. `what` names the array in errors."""
    if np.ma.is_masked(value):
        raise InvalidEnvironment(f"{what} has masked elements; give numbers in their place")
    array = np.asarray(value)
    if array.dtype.kind not in "biuf":
        raise InvalidEnvironment(f"{what} is no array of numbers, but {_short(value)}")
    flat = array.ravel()
    with np.errstate(over="ignore"):
        row = flat.astype(np.float32)
    # NaN is not within the limit either.
    if not (np.abs(row) <= LIMIT).all():
        index = int(np.argmin(np.abs(row) <= LIMIT))
        raise InvalidEnvironment(f"{what}: number {index} is {wrong(flat[index])}")
    return row


def wrong(number: float) -> str:
    """A number that actors refuse, and why."""
    return f"{number:g}; its magnitude must be at most {LIMIT:g}" if np.isfinite(number) else f"{number}"


def flat(what: str, space: spaces.Space, value) -> np.ndarray:
    """An observation of `space` as one row, in the order of `gymnasium.spaces.flatten`."""
    match space:
        case spaces.Box():
            return _box(what, space, value)
        case spaces.Discrete():
            return _one_hot(what, space, value)
        case spaces.Dict():
            if not isinstance(value, Mapping):
                raise InvalidEnvironment(f"{what} is {_short(value)}, its space has the entries {list(space)}")
            missing, more = set(space) - set(value), set(value) - set(space)
            if missing or more:
                raise InvalidEnvironment(f"{what} has the entries {list(value)}, its space has {list(space)}")
            return np.concatenate([flat(f"{what}[{key!r}]", part, value[key]) for key, part in space.items()])
        case spaces.Tuple():
            if not isinstance(value, Sequence | np.ndarray):
                raise InvalidEnvironment(f"{what} is {_short(value)}, its space has {len(space)} entries")
            if len(value) != len(space):
                raise InvalidEnvironment(f"{what} has {len(value)} entries, its space has {len(space)}")
            parts = enumerate(zip(space, value, strict=True))
            return np.concatenate([flat(f"{what}[{index}]", part, one) for index, (part, one) in parts])
    if not space.is_np_flattenable:
        raise InvalidEnvironment(f"{what} has the space {space}, which cannot be flattened to a fixed number of floats")
    if not space.contains(value):
        raise InvalidEnvironment(f"{what} is {_short(value)}, which is not in its space {space}")
    return numbers(what, spaces.flatten(space, value))


def _box(what: str, space: spaces.Box, value) -> np.ndarray:
    try:
        shape = np.shape(value)
    except ValueError:
        raise InvalidEnvironment(f"{what} is no array, but {_short(value)}") from None
    if shape != space.shape:
        raise InvalidEnvironment(f"{what} has shape {shape}, its space has {space.shape}")
    # Without a conversion to the space's type, which could truncate or overflow.
    row = numbers(what, value)
    low, high = space.low.ravel().astype(np.float32), space.high.ravel().astype(np.float32)
    outside = (row < low) | (row > high)
    if outside.any():
        at = int(np.argmax(outside))
        limits = f"{row[at]:g}, outside its space ({low[at]:g} to {high[at]:g})"
        note("outside", f"{what}: number {at} is {limits}; such observations are used as they are")
    return row


def _one_hot(what: str, space: spaces.Discrete, value) -> np.ndarray:
    index = np.asarray(value)
    first, last = int(space.start), int(space.start + space.n - 1)
    if index.dtype.kind not in "biu" or index.size != 1 or not first <= int(index.item()) <= last:
        raise InvalidEnvironment(f"{what} is {_short(value)}, its space has the integers {first} to {last}")
    row = np.zeros(int(space.n), np.float32)
    row[int(index.item()) - first] = 1.0
    return row


def _short(value) -> str:
    text = " ".join(repr(value).split())
    return text if len(text) <= 80 else f"{text[:80]}..."
