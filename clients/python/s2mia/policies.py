"""Trained policies that act in this process, with the program's own code: the same bits as `s2mia eval`."""

import functools
import json
import os
from collections.abc import Callable
from typing import Any

import numpy as np

from s2mia._native import Team as Native
from s2mia.acting import Acting, Agent, Description
from s2mia.error import RunError
from s2mia.settings import task_text, text_of
from s2mia.values import Numbers, Seed, agent_fields, checked_seed


class Policies(Acting):
    """The policies of a run. `load` and `pretrained` return them. A copy, or what is unpickled, is loaded and begins anew."""

    def __init__(self, native: Native, made: Callable[[], "Policies"]) -> None:
        about: dict[str, Any] = json.loads(native.description)
        agents = [Agent(**agent_fields(own)) for own in about.pop("agents")]
        super().__init__(Description(agents=agents, **about))
        self._native = native
        self._made = made

    def __reduce__(self) -> tuple[Any, ...]:
        return self._made, ()

    def close(self) -> None:
        """Does nothing: there is no connection, and the team still acts."""

    def _begin(self, environments: int) -> None:
        self._native.begin(environments)

    def _restart(self, environment: int) -> None:
        self._native.reset(environment)

    def _step(self, rows: dict[int, Numbers]) -> dict[int, Numbers]:
        return {
            index: np.frombuffer(self._native.act(index, own.tobytes()), "<f4").reshape(len(own), -1)
            for index, own in rows.items()
        }


def load(
    run: str | os.PathLike[str], seed: Seed | None = None, *, checkpoint: str | int | os.PathLike[str] | None = None
) -> Policies:
    """Loads the policies of a run's newest checkpoint, or of a checkpoint's folder.

    `checkpoint` is that of an iteration, one by its folder, or `"best"`, the one with the best evaluation. Actions are
    means or likeliest choices; with a `seed`, they are sampled, and equal those of a served team with that seed. Raises
    `RunError` if there is no valid checkpoint.
    """
    # A copy may be made in another folder.
    place, which = _absolute(run), None if checkpoint is None else str(checkpoint)
    if which not in (None, "last", "best") and not which.isdigit():
        which = _absolute(which)
    again = functools.partial(load, place, seed, checkpoint=which)
    return _made(lambda own: Native(place, own, which), seed, again)


def pretrained(task: str | os.PathLike[str], seed: Seed | None = None) -> Policies:
    """The trained team that comes with the package for a task, as `load` returns one.

    Raises `RunError` if there is none; its line names the nearest task or how to train one.
    """
    name = task_text(task)
    return _made(lambda own: Native.pretrained(name, own), seed, functools.partial(pretrained, name, seed))


def _absolute(path: str | os.PathLike[str]) -> str:
    """The absolute path of a file or folder; any other text as it is, such as the name of a task or an iteration."""
    text = text_of("run", path, "the path of a run or checkpoint")
    place = os.path.expanduser(text)
    return os.path.abspath(place) if os.path.exists(place) else text


def _made(native: Callable[[int | None], Native], seed: Seed | None, made: Callable[[], Policies]) -> Policies:
    """Policies of `native` for a checked seed; `made` makes them once more."""
    own = checked_seed(seed)
    try:
        return Policies(native(own), made)
    except ValueError as error:
        raise RunError(str(error)) from None
