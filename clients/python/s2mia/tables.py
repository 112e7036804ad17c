"""Settings and metrics of runs as pandas data frames."""

import os
import pathlib
import sys
from collections.abc import Iterator
from typing import Any, NamedTuple

from s2mia.error import RunError
from s2mia.run import folder_of, is_run, lines, parsed, read, run_of

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

try:
    import pandas as pd
except ModuleNotFoundError as missing:
    raise ModuleNotFoundError("s2mia.runs needs pandas: pip install 's2mia[pandas]'") from missing

# Settings that every table shows.
_ALWAYS = ["task", "algorithm", "run.seed"]
# Settings that differ between runs without a meaning for the result.
_NEVER = ["run.dir"]
# Fields of a run's manifest that the table shows.
_MANIFEST = ["version", "git_commit", "foreign_actors"]


class Runs(NamedTuple):
    """Tables of the runs in a folder."""

    table: pd.DataFrame
    """One row per run, by its path in the folder: the settings that differ, its folder and its newest results."""
    metrics: pd.DataFrame
    """One row per run and iteration: `run` and the figures of its line in `metrics.jsonl`."""
    evaluations: pd.DataFrame
    """One row per run and evaluation: `run` and the figures of its line in `metrics.jsonl`."""


def runs(folder: str | os.PathLike[str]) -> Runs:
    """Reads all runs in a folder and its sub-folders, or the one run of a run folder or of one of its checkpoints.

    Running and stopped runs are included. Raises `RunError` if there is no run or a file is damaged.
    """
    root = folder_of(folder)
    if not root.is_dir():
        raise RunError(f"{root} is no folder")
    root = run_of(root)
    found = list(_run_folders(root))
    if not found:
        raise RunError(f"{root} holds no run: no folder in it has a config.toml and a manifest.json")
    names = [str(path.relative_to(root)) if path != root else path.resolve().name for path in found]
    settings = pd.DataFrame([_settings(path / "config.toml") for path in found], index=pd.Index(names, name="run"))
    figures = [{"run": name, **line} for name, path in zip(names, found, strict=True) for line in lines(path)]
    metrics, evaluations = _of_kind(figures, "iteration"), _of_kind(figures, "evaluation")
    others = [name for name in settings if name not in (*_ALWAYS, *_NEVER)]
    shown = [*_ALWAYS, *(name for name in others if settings[name].astype(str).nunique(dropna=False) > 1)]
    table = settings.reindex(columns=shown)
    table["folder"] = [str(path) for path in found]
    for source, column, name in [
        (metrics, "iteration", "iteration"),
        (metrics, "env_steps", "env_steps"),
        (metrics, "episode_return", "episode_return"),
        (evaluations, "mean", "evaluation"),
    ]:
        table[name] = source.groupby("run")[column].last() if column in source else None
    manifests = [parsed(read(file), file) for file in (path / "manifest.json" for path in found)]
    for name in _MANIFEST:
        table[name] = [manifest.get(name) for manifest in manifests]
    # The setting names a task also if its settings alone are used, in another program's environment.
    table["task"] = [manifest.get("task", setting) for manifest, setting in zip(manifests, table["task"], strict=True)]
    return Runs(table, metrics, evaluations)


def _run_folders(root: pathlib.Path) -> Iterator[pathlib.Path]:
    """Run folders in the order of their paths. Nothing in a run folder is another run."""
    for place, folders, _ in os.walk(root, onerror=_refuse):
        if is_run(path := pathlib.Path(place)):
            folders.clear()
            yield path
        folders.sort()


def _refuse(error: OSError) -> None:
    """Runs in a folder that cannot be read would be missing without a word."""
    raise RunError(f"{error.filename} cannot be read: {error.strerror}") from None


def _settings(path: pathlib.Path) -> dict[str, Any]:
    """All settings of a run, by their full keys."""

    def flat(prefix: str, value: Any) -> Iterator[tuple[str, Any]]:
        if isinstance(value, dict):
            for key, inner in value.items():
                yield from flat(f"{prefix}.{key}" if prefix else key, inner)
        else:
            yield prefix, value

    try:
        return dict(flat("", tomllib.loads(read(path).decode("utf-8"))))
    except RunError:
        raise
    except ValueError as error:
        raise RunError(f"{path} is damaged: {error}") from None


def _of_kind(lines: list[dict[str, Any]], kind: str) -> pd.DataFrame:
    """The lines of one kind, without the column that names the kind."""
    frame = pd.DataFrame([line for line in lines if line["kind"] == kind])
    return frame.drop(columns="kind", errors="ignore")
