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
    """The policies of a run. `load` and `pretrained` return them.

    A copy, or what is unpickled, loads the same checkpoint and begins anew. It raises `RunError` if the checkpoint is gone
    or has other policies.
    """

    def __init__(self, native: Native, made: "Callable[[Description], Callable[[], Policies]]") -> None:
        about: dict[str, Any] = json.loads(native.description)
        agents = [Agent(**agent_fields(own)) for own in about.pop("agents")]
        super().__init__(Description(agents=agents, **about))
        self._native = native
        self._made = made(self.description)

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
    means or likeliest choices; with a `seed`, they are sampled, and equal those of a served team with that seed. A copy
    has the policies of the same checkpoint, also after the run has grown. Raises `RunError` if there is no valid checkpoint.
    """
    # A copy may be made in another folder.
    place, which = _absolute(run), None if checkpoint is None else str(checkpoint)
    if which not in (None, "last", "best") and not which.isdigit():
        which = _absolute(which)

    def again(about: Description) -> Callable[[], Policies]:
        # The newest and the best checkpoint change while a run trains. A team of the package and a checkpoint have none.
        changes = which in (None, "last", "best") and os.path.isdir(os.path.join(place, "checkpoints"))
        return functools.partial(_again, place, seed, str(about.iteration) if changes else which, about.policy_sha256)

    return _made(lambda own: Native(place, own, which), seed, again)


def pretrained(task: str | os.PathLike[str], seed: Seed | None = None) -> Policies:
    """The trained team that comes with the package for a task, as `load` returns one.

    Raises `RunError` if there is none; its line names the nearest task or how to train one.
    """
    name = task_text(task)
    return _made(lambda own: Native.pretrained(name, own), seed, lambda _: functools.partial(pretrained, name, seed))


def _again(place: str, seed: Seed | None, checkpoint: str | None, policy_sha256: str) -> Policies:
    """The policies of a checkpoint once more. Raises `RunError` if it has other ones than those with this SHA-256."""
    team = load(place, seed, checkpoint=checkpoint)
    if (found := team.description.policy_sha256) != policy_sha256:
        what = f"the policies of iteration {team.description.iteration} in {place} have SHA-256 {found}"
        raise RunError(f"{what}, the copied ones {policy_sha256}; load the run instead of a copy")
    return team


def _absolute(path: str | os.PathLike[str]) -> str:
    """The absolute path of a file or folder; any other text as it is, such as the name of a task or an iteration."""
    text = text_of("run", path, "the path of a run or checkpoint")
    place = os.path.expanduser(text)
    return os.path.abspath(place) if os.path.exists(place) else text


def _made(
    native: Callable[[int | None], Native], seed: Seed | None, made: Callable[[Description], Callable[[], Policies]]
) -> Policies:
    """Policies of `native` for a checked seed; `made` returns what makes them once more, by their description."""
    own = checked_seed(seed)
    try:
        return Policies(native(own), made)
    except ValueError as error:
        raise RunError(str(error)) from None
