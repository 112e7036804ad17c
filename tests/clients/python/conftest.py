"""Learners for foreign clients: the real binary, the game `cue-2x1`; and programs that offer environments."""

import json
import os
import pathlib
import signal
import subprocess
import sys
import sysconfig

import grpc
import pytest
from google.rpc import error_details_pb2
from grpc_status import rpc_status
from s2mia.connection import CallError

# A shell's background job, as a test run may be, ignores SIGINT, and so would the programs that tests start.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

ROOT = pathlib.Path(__file__).resolve().parents[3]
# Programs that a test starts import its games too.
PLACES = os.pathsep.join(filter(None, [str(pathlib.Path(__file__).parent), os.environ.get("PYTHONPATH")]))

SMALL = ["cue-2x1", "run.seed=3", "evaluation.episodes=2", "checkpoint.every=10"]
FEW = [*SMALL, "run.iterations=2", "evaluation.every_steps=0"]
FEW += ["environments.per_slot=4", "environments.message_steps=10"]
ROBOT = ["halfcheetah-6x1", "run.seed=7", "run.iterations=2", "run.actors=1", "environments.count=4"]
ROBOT += ["environments.steps=20", "environments.per_slot=2", "environments.message_steps=10", "evaluation.episodes=1"]
# The first of two iterations warms up.
HASAC = ["algorithm=hasac", "hasac.warm_up=80", "hasac.updates_per_step=0.1"]
MANY = [*SMALL, "run.env_steps=30000", "evaluation.every_steps=10000"]


def command(*arguments) -> list[str]:
    """The command of the installed package, or the binary that S2MIA names."""
    binary = pathlib.Path(os.environ.get("S2MIA") or pathlib.Path(sysconfig.get_path("scripts")) / "s2mia")
    assert binary.is_file(), f"{binary} is not there; `.ci/run` installs the wheel"
    return [str(binary), *map(str, arguments)]


def s2mia_run(*arguments) -> str:
    """What the binary prints; fails with its last words if it fails."""
    done = subprocess.run(command(*arguments), capture_output=True, text=True, timeout=300, check=False)
    assert done.returncode == 0, f"s2mia {arguments}\n{done.stdout}\n{done.stderr}"
    return done.stdout


def hashes(folder: pathlib.Path) -> dict[str, str]:
    told = subprocess.run(command("inspect", folder, "--json"), check=True, capture_output=True, text=True)
    found = json.loads(told.stdout)
    return {name: found[name] for name in ("weights_sha256", "state_sha256")}


class Served:
    """A learner that waits for actors."""

    def __init__(self, folder: pathlib.Path, settings: list[str]) -> None:
        self.folder = folder
        arguments = ("learner", "--listen", "127.0.0.1:0", *settings, f"run.dir={folder}")
        self.process = subprocess.Popen(
            command(*arguments), stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
        )
        first = self.process.stdout.readline()
        assert "waits for actors" in first, first
        self.url = first.split()[-1]
        self.address = self.url.removeprefix("http://")

    def finish(self) -> str:
        """What it says until its good end."""
        told = self.process.stdout.read()
        assert self.process.wait(timeout=60) == 0, told
        return told

    def metrics(self) -> list[dict]:
        return [json.loads(line) for line in (self.folder / "metrics.jsonl").read_text().splitlines()]


class Serving:
    """The trained policies of a run, served."""

    def __init__(self, folder: pathlib.Path) -> None:
        arguments = command("serve", folder, "--listen", "127.0.0.1:0")
        self.process = subprocess.Popen(arguments, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
        first = self.process.stdout.readline()
        assert "serves its policies" in first, first
        self.address = first.split()[-1].removeprefix("http://")


@pytest.fixture(scope="session")
def trained(tmp_path_factory):
    """Folder of a finished run of the game."""
    folder = tmp_path_factory.mktemp("runs") / "trained"
    train = command("train", *SMALL, "run.iterations=10", "evaluation.every_steps=0", "run.actors=1", f"run.dir={folder}")
    subprocess.run(train, check=True, capture_output=True)
    return folder


@pytest.fixture
def policies(trained):
    """A server of its policies."""
    server = Serving(trained)
    yield server
    server.process.kill()
    server.process.wait()
    server.process.stdout.close()


def refusal(call) -> tuple[str, str]:
    """Reason and field with which a call is refused."""
    with pytest.raises((grpc.RpcError, CallError)) as raised:
        call()
    error = raised.value.status if isinstance(raised.value, CallError) else raised.value
    status = rpc_status.from_call(error)
    assert status is not None, raised.value
    info, request = error_details_pb2.ErrorInfo(), error_details_pb2.BadRequest()
    for detail in status.details:
        detail.Unpack(info)
        detail.Unpack(request)
    assert info.domain == "s2mia"
    (violation,) = request.field_violations
    assert violation.description
    return info.reason, violation.field


@pytest.fixture
def serve(tmp_path):
    """Starts learners by name; none outlives its test."""
    started = []

    def start(name: str, settings: list[str]) -> Served:
        started.append(Served(tmp_path / name, settings))
        return started[-1]

    yield start
    for one in started:
        one.process.kill()
        one.process.wait()
        one.process.stdout.close()


@pytest.fixture
def offer():
    """Starts programs that offer environments, and says where; none outlives its test."""
    started = []

    def start(function: str, *settings: str) -> str:
        arguments = [sys.executable, "-m", "s2mia_environment", "--listen", "127.0.0.1:0", function, *settings]
        process = subprocess.Popen(
            arguments, stdout=subprocess.PIPE, text=True, env={**os.environ, "PYTHONPATH": PLACES}
        )
        started.append(process)
        words = process.stdout.readline().split()
        assert words and words[0] == "offers", words
        return words[-1]

    yield start
    for process in started:
        process.kill()
        process.wait()
        process.stdout.close()
