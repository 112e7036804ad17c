"""A run that lasts as long as it is looked at."""

import contextlib
import pathlib
import socket
import subprocess
import time
from collections.abc import Callable, Iterator

from debian import ROOT

PROGRAM = ROOT / "target" / "debug" / "s2mia"
TIMEOUT_SECS = 60
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


def eventually(holds: Callable[[], bool], missing: str) -> None:
    """Asks again and again; a server that does not answer yet holds nothing."""
    deadline = time.monotonic() + TIMEOUT_SECS
    while time.monotonic() < deadline:
        with contextlib.suppress(OSError):
            if holds():
                return
        time.sleep(0.2)
    raise SystemExit(f"{missing} after {TIMEOUT_SECS} s")


def answers(address: str) -> bool:
    host, port = address.split(":")
    with socket.create_connection((host, int(port)), timeout=5):
        return True


@contextlib.contextmanager
def training(folder: pathlib.Path, page: str) -> Iterator[subprocess.Popen]:
    """`s2mia train` with its page at `page`, resumed if `folder` holds a run, once it answers; killed at the end."""
    begun = (folder / "config.toml").exists()
    where = ["--resume", folder] if begun else ["halfcheetah-2x3", f"run.dir={folder}", *SETTINGS]
    with subprocess.Popen([PROGRAM, "train", "--page", page, *where], stdout=subprocess.DEVNULL) as process:
        try:
            eventually(lambda: answers(page), "no page")
            yield process
        finally:
            process.kill()
