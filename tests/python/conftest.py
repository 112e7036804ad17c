"""One small run and one recording of it, made by the real binary and shared by all tests here."""

import json
import os
import re
import subprocess
import sysconfig
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]

ITERATIONS = 4
STEPS_PER_ITERATION = 4 * 20
TINY = [
    "halfcheetah-6x1",
    "algorithm=happo-s2mia",
    "run.seed=7",
    f"run.iterations={ITERATIONS}",
    "run.actors=2",
    "environments.count=4",
    "environments.steps=20",
    "environments.per_slot=2",
    "environments.message_steps=10",
    f"evaluation.every_steps={2 * STEPS_PER_ITERATION}",
    "evaluation.episodes=1",
    "checkpoint.every=2",
    # An audit would log its slot again, as a second attempt.
    "audit.share=0",
]


def program():
    """The binary under test: the command of the installed package, or what S2MIA names."""
    binary = Path(os.environ.get("S2MIA") or Path(sysconfig.get_path("scripts")) / "s2mia")
    assert binary.is_file(), f"{binary} is not there; `.ci/run` installs the wheel"
    return binary


def s2mia(*arguments):
    """What the binary prints; fails with its last words if it fails."""
    done = subprocess.run([program(), *map(str, arguments)], capture_output=True, text=True, timeout=600)
    assert done.returncode == 0, f"s2mia {arguments}\n{done.stdout}\n{done.stderr}"
    return done.stdout


def examples(heading):
    """The Python examples under the heading `## HEADING` of docs/USING.md."""
    document = (ROOT / "docs" / "USING.md").read_text()
    section = document.split(f"\n## {heading}\n")[1].split("\n## ")[0]
    return re.findall(r"```python\n(.*?)```", section, re.DOTALL)


@pytest.fixture(scope="session")
def run(tmp_path_factory):
    """Folder of a finished run."""
    folder = tmp_path_factory.mktemp("runs") / "tiny"
    s2mia("train", *TINY, f"run.dir={folder}")
    return folder


@pytest.fixture(scope="session")
def inspected(run):
    """What `s2mia inspect --json` says about the run."""
    return json.loads(s2mia("inspect", run, "--json"))


@pytest.fixture(scope="session")
def tasks():
    """What `s2mia tasks --json` says, by name."""
    return {task["task"]: task for task in json.loads(s2mia("tasks", "--json"))}


@pytest.fixture(scope="session")
def recording(run):
    """An MCAP file with one episode."""
    path = run / "logs" / "episode.mcap"
    s2mia("record", run, "--out", path)
    return path
