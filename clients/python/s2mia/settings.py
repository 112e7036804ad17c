"""Settings as keywords: `run__seed=1` is `run.seed=1` of the program's command line."""

import json
import os
from collections.abc import Mapping
from typing import Any

import numpy as np


def by_key(settings: Mapping[str, Any]) -> dict[str, Any]:
    """Settings by keys such as `run.seed`, from keywords such as `run__seed`."""
    return {key.replace("__", "."): value for key, value in settings.items()}


def text_of(what: str, value: Any, meaning: str) -> str:
    """A name or path as a text. Raises `ValueError` for another value; the message calls it `what`, which is `meaning`."""
    try:
        text = os.fspath(value)
    except TypeError:
        text = None
    if not isinstance(text, str):
        raise ValueError(f"{what} is {value!r}; it is {meaning}")
    if "\0" in text:
        raise ValueError(f"{what} has a null character; it is {meaning}")
    return text


def task_text(task: str | os.PathLike[str]) -> str:
    """The task as a text. Raises `ValueError` if it is neither a name nor a path."""
    return text_of("task", task, "a name or the path of a task file")


def absolute(task: str | os.PathLike[str]) -> str:
    """The task, which is a name or a task file, with the file's absolute path."""
    text = task_text(task)
    is_file = text.endswith(".toml") or ".toml:" in text or os.sep in text
    return os.path.abspath(text) if is_file and not text.startswith("~") else text


def arguments(task: str | os.PathLike[str], settings: Mapping[str, Any]) -> list[str]:
    """A task, which is a name or a task file, and its settings as arguments of the program.

    Raises `ValueError` for another task, and for a value that is neither a truth value nor a number nor a text.
    """
    return [f"task={task_text(task)}", *assignments(settings)]


def assignments(settings: Mapping[str, Any]) -> list[str]:
    """Settings as arguments of the program. Raises `ValueError` as `arguments` does."""
    return [f"{key}={_text(key, value)}" for key, value in by_key(settings).items()]


def _text(key: str, value: Any) -> str:
    """The value in TOML, which the program reads. Numbers of NumPy are numbers, and paths are texts."""
    plain = value.item() if isinstance(value, np.generic) else value
    plain = os.fspath(plain) if isinstance(plain, os.PathLike) else plain
    if not isinstance(plain, bool | int | float | str):
        raise ValueError(f"{key} is {value!r}; a setting is True or False, a number or a text")
    return json.dumps(plain, ensure_ascii=False)
