"""A run that lasts as long as it is looked at."""

import contextlib
import pathlib
import socket
import subprocess
from collections.abc import Iterator

from debian import ROOT

PROGRAM = ROOT / "target" / "debug" / "s2mia"
SETTINGS = [
    "run.iterations=100000",
    "run.actors=1",
    "environments.count=4",
    "environments.steps=50",
    "evaluation.every_steps=1000",
    "evaluation.episodes=1",
    "checkpoint.every=2",
]


def free_port() -> int:
    with socket.socket() as listener:
        listener.bind(("127.0.0.1", 0))
        return listener.getsockname()[1]


@contextlib.contextmanager
def training(folder: pathlib.Path, page: str) -> Iterator[subprocess.Popen]:
    """`s2mia train` with its page at `page`, gone on with if `folder` holds a run; killed at the end."""
    begun = (folder / "config.toml").exists()
    where = ["--resume", folder] if begun else ["halfcheetah-2x3", f"run.dir={folder}", *SETTINGS]
    with subprocess.Popen([PROGRAM, "train", "--page", page, *where], stdout=subprocess.DEVNULL) as process:
        try:
            yield process
        finally:
            process.kill()
