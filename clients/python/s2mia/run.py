"""Runs: trains one with the program `s2mia`, and reads what it has written."""

import dataclasses
import json
import os
import pathlib
import shutil
import subprocess
import sysconfig
import tempfile
from typing import IO, TYPE_CHECKING, Any

from s2mia.error import RunError
from s2mia.name import printable
from s2mia.settings import arguments, assignments, text_of
from s2mia.values import Seed

if TYPE_CHECKING:
    from s2mia.policies import Policies


# Files that every run has.
_CONFIG, _MANIFEST = "config.toml", "manifest.json"
# The file of policies in a checkpoint, which has these two files, too.
_POLICY = "policy.safetensors"


@dataclasses.dataclass(frozen=True, init=False)
class Run:
    """A run folder, also given by one of its checkpoints. The run may have ended, been stopped, or still be training.

    Raises `RunError` for a folder of no run.
    """

    folder: pathlib.Path
    """Its absolute path."""

    def __init__(self, folder: str | os.PathLike[str]) -> None:
        given = folder_of(folder)
        found = run_of(given)
        if not is_run(found):
            missing = next((name for name in (_CONFIG, _MANIFEST) if not (found / name).is_file()), None)
            what = f"it has no {missing}" if missing else "it is a checkpoint without its run"
            raise RunError(f"{printable(str(given))} is no run: {what}")
        object.__setattr__(self, "folder", found.absolute())

    @property
    def metrics(self) -> list[dict[str, Any]]:
        """The figures of each iteration, for example `env_steps` and `episode_return`."""
        return [line for line in lines(self.folder) if line["kind"] == "iteration"]

    @property
    def evaluations(self) -> list[dict[str, Any]]:
        """The figures of each evaluation, for example `env_steps` and `mean`, the mean return."""
        return [line for line in lines(self.folder) if line["kind"] == "evaluation"]

    def load(
        self, seed: Seed | None = None, *, checkpoint: str | int | os.PathLike[str] | None = None
    ) -> "Policies":
        """The newest policies, or those of a checkpoint, as `s2mia.load` returns them."""
        # Only this needs the native module.
        from s2mia.policies import load

        return load(self.folder, seed, checkpoint=checkpoint)

    def resume(self, *, progress: bool = False, **settings: Any) -> "Run":
        """Trains from the newest checkpoint to the end of the run, as `train` does, and returns the run.

        `settings` are those that may change, such as `run__env_steps`.
        """
        return _trained(["--resume", str(self.folder), *assignments(settings)], progress)


def train(task: str | os.PathLike[str], *, progress: bool = False, **settings: Any) -> Run:
    """Trains with the program to the end of the run and returns it.

    `task` is a name or a task file, `settings` are those of `s2mia config`: `run__seed=1` is `run.seed`. With
    `progress`, the program's lines are printed. Ctrl-C ends the run after a checkpoint, and then raises
    `KeyboardInterrupt`. Raises `ValueError` for a value that no setting has, and `RunError` with the program's line if
    it refuses a setting or fails.
    """
    return _trained(arguments(task, settings), progress)


def _trained(words: list[str], progress: bool) -> Run:
    """The run that `s2mia train` with these arguments has trained."""
    with tempfile.TemporaryFile("w+", errors="replace") as errors:
        opening, status = _finished([_program(), "train", "--stop-with-stdin", *words], errors, progress)
        if status or ": task " not in opening:
            raise RunError(_failure(errors, status))
    return Run(pathlib.Path(opening.rpartition(": task ")[0]).absolute())


def _finished(words: list[str], errors: IO[str], progress: bool) -> tuple[str, int]:
    """The first line of the program, and its status. Ctrl-C reaches it only by the end of its standard input."""
    opening = ""
    pipe = subprocess.PIPE
    try:
        process = subprocess.Popen(
            words, stdin=pipe, stdout=pipe, stderr=errors, text=True, errors="replace", start_new_session=True
        )
    except OSError as error:
        raise RunError(f"{words[0]} cannot be started: {error.strerror}") from None
    with process:
        assert process.stdin and process.stdout, "both are pipes"
        try:
            for line in process.stdout:
                opening = opening or line
                if progress:
                    print(line, end="", flush=True)
        finally:
            process.stdin.close()
            process.wait()
    return opening, process.returncode


def _failure(errors: IO[str], status: int) -> str:
    """The program's line about its error; if it wrote none, its status and last line."""
    errors.seek(0)
    said = [line.strip() for line in errors if line.strip()]
    if reported := [line for line in said if line.startswith("error: ")]:
        return reported[-1].removeprefix("error: ")
    return ": ".join([f"s2mia ended with status {status}", *said[-1:]])


def _program() -> str:
    """The program: the file that S2MIA names, or that of this package, or the first on PATH."""
    user = sysconfig.get_path("scripts", sysconfig.get_preferred_scheme("user"))
    # The last one is that of `pip install --target`.
    own = [sysconfig.get_path("scripts"), user, str(pathlib.Path(__file__).parents[1] / "bin")]
    places = os.pathsep.join([*own, os.environ.get("PATH", os.defpath)])
    found = os.environ.get("S2MIA") or shutil.which("s2mia", path=places)
    if found is None:
        raise RunError("the program s2mia is neither in the package nor on PATH; S2MIA can name its file")
    return found


def is_run(path: pathlib.Path) -> bool:
    """Whether a folder is a run's. A checkpoint has the same files and its policies."""
    return all((path / name).is_file() for name in (_CONFIG, _MANIFEST)) and not (path / _POLICY).exists()


def folder_of(given: str | os.PathLike[str]) -> pathlib.Path:
    """The path of a folder with runs, where `~` is the home. Raises `ValueError` if it is no path."""
    return pathlib.Path(os.path.expanduser(text_of("the run", given, "the path of a run or folder")))


def run_of(path: pathlib.Path) -> pathlib.Path:
    """The run of a checkpoint in its place, otherwise the path."""
    if (path / _POLICY).is_file() and is_run(above := path.resolve().parent.parent):
        return above
    return path


def read(path: pathlib.Path) -> bytes:
    """The bytes of a file of a run. Raises `RunError` if it cannot be read."""
    try:
        return path.read_bytes()
    except OSError as error:
        raise RunError(f"{path} cannot be read: {error.strerror}") from None


def parsed(text: bytes, place: str | pathlib.Path) -> dict[str, Any]:
    """The JSON object in `text`. Raises `RunError` if it is none."""
    try:
        found = json.loads(text)
    except ValueError as error:
        raise RunError(f"{place} is damaged: {error}") from None
    if not isinstance(found, dict):
        raise RunError(f"{place} is damaged: it is no JSON object")
    return found


def lines(run: pathlib.Path) -> list[dict[str, Any]]:
    """The lines of `metrics.jsonl`, none before it exists.

    A run that is writing may have an unfinished last line, which is omitted. Raises `RunError` if the run is gone.
    """
    path = run / "metrics.jsonl"
    data = read(path) if path.exists() or not is_run(run) else b""
    found = [parsed(line, f"{path}:{number}") for number, line in enumerate(data.split(b"\n")[:-1], 1)]
    for number, line in enumerate(found, 1):
        if not isinstance(line.get("kind"), str):
            raise RunError(f"{path}:{number} is damaged: it has no kind")
    return found
