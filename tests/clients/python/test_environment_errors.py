"""Environments with faults: one line says what is wrong, and the author's own errors keep their traceback."""

import ctypes
import os
import signal
import socket
import subprocess
import sys
import time

import grpc
import numpy as np
import pytest
from conftest import PLACES
from faulty_games import Attribute, Described, Game, Late, Misspelt, Old, Turns, Unfinished
from gymnasium import spaces
from pettingzoo.utils.wrappers import BaseParallelWrapper
from s2mia import wire
from s2mia_environment import InvalidEnvironment, Parallel
from s2mia_environment.parallel import Box

ALL = "; all agents of possible_agents, and no others, take part from the first step to the last"
STAY = [np.zeros(1, np.float32)] * 2


def start(*arguments: str, listen: str = "127.0.0.1:0") -> subprocess.Popen:
    words = [sys.executable, "-m", "s2mia_environment", "--listen", listen, *arguments]
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    return subprocess.Popen(words, text=True, env={**os.environ, "PYTHONPATH": PLACES}, **pipes)


def refusal(*arguments: str, **more) -> tuple[int, list[str]]:
    """Status and last words of a server that cannot start."""
    process = start(*arguments, **more)
    told, line = process.communicate(timeout=60)
    assert told == ""
    return process.returncode, line.splitlines()


@pytest.mark.parametrize("kind", [np.int8, np.int32, np.int64, np.uint8, np.uint64])
def test_every_integer_of_a_box_has_a_share_of_the_actions(kind):
    low = 0 if np.issubdtype(kind, np.unsignedinteger) else -1
    box = Box(spaces.Box(low, 3, (2,), kind))
    bounds = (box.spec.low, box.spec.high)
    taken = [box.action(np.full(2, number, np.float32)) for number in np.linspace(*bounds, 1001)[1:-1]]
    counts = [sum(action[0] == value for action in taken) for value in range(low, 4)]
    assert min(counts) > 0.4 * max(counts) and sum(counts) == len(taken), counts
    assert all(box.space.contains(action) for action in taken)


@pytest.mark.parametrize("kind", [np.int64, np.uint64])
def test_the_limits_of_64_bits_are_not_exceeded(kind):
    limits = np.iinfo(kind)
    box = Box(spaces.Box(limits.min, limits.max, (1,), kind))
    for number in (box.spec.low, box.spec.high, 0.0):
        assert box.space.contains(box.action(np.array([number], np.float32)))


def test_an_error_inside_state_is_raised_and_a_missing_state_is_all_observations():
    assert len(Parallel(Described()).spec.state) == 7
    assert len(Parallel(BaseParallelWrapper(Described())).spec.state) == 7
    for env in (Game(), BaseParallelWrapper(Game()), Attribute(), BaseParallelWrapper(Attribute())):
        assert len(Parallel(env).spec.state) == 6
    for kind, error in ((Misspelt, AttributeError), (Unfinished, NotImplementedError)):
        with pytest.raises(error):
            Parallel(kind())
        with pytest.raises(error):
            Parallel(BaseParallelWrapper(kind()))


@pytest.mark.parametrize(
    ("fault", "message"),
    [
        ("no number", "the observation of agent b: number 1 is nan"),
        ("overflow", "the observation of agent b: number 2 is 1e+300; its magnitude must be at most 1e+09"),
        ("another shape", "the observation of agent b has shape (4,), its space has (3,)"),
        ("words", "the observation of agent b is no array of numbers, but array(['x', 'y', 'z'], dtype='<U1')"),
        ("no observation", f"observations has no agent b{ALL}"),
        ("one too many", f"observations has the unknown agent c{ALL}"),
        ("no reward", f"rewards has no agent b{ALL}"),
        ("a huge reward", "the reward of agent b is 4e+10; its magnitude must be at most 1e+09"),
        ("a reward that is none", "the reward of agent a is None, expected a number"),
        ("an endless reward", "the reward of agent a is inf"),
        ("no termination", f"terminations has no agent b{ALL}"),
        ("no truncation", f"truncations has no agent b{ALL}"),
        ("__all__", f"terminations has the unknown agent __all__{ALL}"),
        ("a word", "terminations of agent a is 'False', expected True or False"),
    ],
)
def test_a_faulty_step_is_refused_with_agent_and_step(fault, message):
    game = Parallel(Game(fault))
    for _ in range(2):
        game.step(STAY)
    with pytest.raises(InvalidEnvironment) as raised:
        game.step(STAY)
    separator = " " if " has " in message and message.startswith("the observation") else ": "
    assert str(raised.value).replace(" of an episode", "") in (f"step 3: {message}", f"step 3{separator}{message}")


def test_an_agent_that_ends_in_both_ways_is_terminated():
    game = Parallel(Game("both ends"))
    assert [game.step(STAY)[1:] for _ in range(3)] == [(False, False), (False, False), (True, False)]


@pytest.mark.parametrize(
    ("env", "message"),
    [
        (Late(), "reset(): observations has no agent b"),
        (Old(), "reset() must return two dictionaries"),
        (Turns(), "Turns is an AEC environment"),
        (None, "NoneType is no PettingZoo ParallelEnv: it has no possible_agents"),
    ],
)
def test_what_is_no_parallel_environment_is_refused(env, message):
    with pytest.raises(InvalidEnvironment, match=f"^{message.replace('(', '[(]').replace(')', '[)]')}"):
        Parallel(env)


@pytest.mark.parametrize(
    ("arguments", "status", "message"),
    [
        (["faulty_games"], 2, "expected PACKAGE.module:FUNCTION"),
        (["faulty_games:Game", "fault"], 2, "expected PACKAGE.module:FUNCTION NAME=VALUE"),
        (["faulty_games:nobody"], 1, "the module faulty_games has no nobody"),
        (["faulty_games.py:Game"], 1, "there is no module faulty_games.py"),
        (["no_games:Game"], 1, "there is no module no_games; start the program in its folder"),
        (["faulty_games:FAULTS"], 1, "faulty_games:FAULTS is no function, but dict"),
        (["faulty_games:Game", "faults=none"], 1, "got an unexpected keyword argument 'faults'; the arguments of"),
        (["faulty_games:Turns"], 1, "whose agents act in turns"),
        (["faulty_games:Unseeded"], 1, "reset() of Unseeded must take the argument seed"),
        (["faulty_games:nothing", "--workers", "2"], 1, "NoneType is no PettingZoo ParallelEnv"),
    ],
)
def test_a_mistake_in_the_arguments_is_one_line(arguments, status, message):
    found, lines = refusal(*arguments)
    assert (found, len(lines)) == (status, 1), lines
    assert message in lines[0]


@pytest.mark.parametrize("workers", ["1", "2"])
def test_an_error_of_the_author_keeps_its_traceback_before_one_line(workers):
    status, lines = refusal("faulty_games:broken", "--workers", workers)
    assert status == 1
    assert any(line.startswith("Traceback") for line in lines)
    why = "ValueError: an error of the author in two lines"
    assert lines[-1] == f"s2mia_environment: cannot make faulty_games:broken: {why}"


def test_an_address_that_cannot_be_used_is_one_line():
    with socket.create_server(("127.0.0.1", 0)) as taken:
        place = "127.0.0.1:%d" % taken.getsockname()[1]
        for listen, status, message in [
            (place, 1, f"cannot listen on {place}: Address already in use; choose another HOST:PORT"),
            ("127.0.0.1:65536", 2, "the port 65536 is not a number from 0 to 65535"),
            ("127.0.0.1", 2, "127.0.0.1 is not of the form HOST:PORT"),
        ]:
            found, lines = refusal("faulty_games:Game", listen=listen)
            assert (found, len(lines)) == (status, 1), lines
            assert message in lines[0]


def played(process: subprocess.Popen, streams: int = 1, secs: float | None = None) -> list[str]:
    """How streams end that step the offered game five times, and are cut off after a time."""
    address = process.stdout.readline().split()[-1].removeprefix("http://")
    rows = wire.tensor(np.zeros((1, 1), np.float32))
    reset = wire.PlayRequest(reset=wire.ResetEnvironment(environment=0, seed=bytes(32)))
    step = wire.PlayRequest(step=wire.StepEnvironments(environments=[0], actions=[rows, rows]))
    ends = []
    with grpc.insecure_channel(address, options=[("grpc.enable_http_proxy", 0)]) as channel:
        service = wire.EnvironmentServiceStub(channel)
        calls = [service.Play(iter([reset, *[step] * 5]), timeout=secs) for _ in range(streams)]
        for call in calls:
            try:
                ends.append(f"{len(list(call))} answers")
            except grpc.RpcError as error:
                ends.append(f"{error.code().name}: {error.details()}")
    return ends


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_the_server_with_status_0_and_without_a_word(number):
    process = start("faulty_games:Game", "--workers", "2")
    assert played(process) == ["6 answers"]
    process.send_signal(number)
    assert process.communicate(timeout=60)[1] == ""
    assert process.returncode == 0


@pytest.mark.parametrize("workers", ["1", "2"])
def test_environments_are_closed_at_the_end_of_their_stream_and_of_the_server(workers, tmp_path):
    process = start("faulty_games:Held", f"folder={tmp_path}", "--workers", workers)
    assert played(process, streams=4) == ["6 answers"] * 4
    deadline = time.monotonic() + 30
    # A worker keeps the environment of its description until its first stream.
    while (held := len(list(tmp_path.iterdir()))) and time.monotonic() < deadline:
        time.sleep(0.05)
    assert held == 0
    replayed = start("faulty_games:Held", f"folder={tmp_path}", "--workers", workers)
    replayed.stdout.readline()
    assert list(tmp_path.iterdir())
    for server in (process, replayed):
        server.terminate()
        assert server.communicate(timeout=60)[1] == ""
        assert server.returncode == 0
    assert not list(tmp_path.iterdir())


def test_a_signal_that_another_thread_received_ends_the_server():
    process = start("faulty_games:Game", "--workers", "1")
    assert played(process) == ["6 answers"]
    other = max(map(int, os.listdir(f"/proc/{process.pid}/task")))
    assert other != process.pid
    assert ctypes.CDLL(None).tgkill(process.pid, other, signal.SIGTERM) == 0
    process.communicate(timeout=60)
    assert process.returncode == 0


@pytest.mark.parametrize("workers", ["1", "2"])
def test_a_signal_ends_the_server_also_while_an_environment_hangs(workers):
    process = start("faulty_games:Endless", "--workers", workers)
    assert played(process, secs=1.0)[0].startswith("DEADLINE_EXCEEDED")
    process.terminate()
    process.communicate(timeout=60)
    assert process.returncode == 1


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("max_cycles", -5, "max_cycles is -5; it must be a whole number from 1 to 4,294,967,295"),
        ("max_cycles", "many", "max_cycles is 'many'; it must be a whole number"),
        ("metadata", {"render_fps": "a"}, "metadata['render_fps'] is 'a'; it must be a number above 0"),
    ],
)
def test_a_length_or_a_rate_that_is_none_is_named(name, value, message):
    env = Game()
    setattr(env, name, value)
    with pytest.raises(InvalidEnvironment) as refused:
        Parallel(env)
    assert str(refused.value).startswith(message)


def test_an_environment_without_an_end_is_truncated():
    env = Game()
    env.max_cycles = float("inf")
    assert Parallel(env).spec.episode_steps == 1000


@pytest.mark.parametrize("workers", ["1", "2"])
@pytest.mark.parametrize(
    ("fault", "why", "traceback"),
    [
        ("no number", "step 3 of an episode: the observation of agent b: number 1 is nan", False),
        ("an error", "KeyError: 'an error of the author'", True),
        ("an exit", "SystemExit: an exit of the author", True),
    ],
)
def test_a_failed_environment_is_told_to_the_client_and_in_the_servers_last_line(workers, fault, why, traceback):
    process = start("faulty_games:Game", f"fault={fault}", "--workers", workers)
    assert played(process) == [f"INVALID_ARGUMENT: {why}"]
    process.terminate()
    lines = process.communicate(timeout=60)[1].splitlines()
    assert lines[-1] == f"s2mia_environment: the environment failed: {why}"
    assert any(line.startswith("Traceback") for line in lines) is traceback
    assert traceback or len(lines) == 1


def test_what_the_author_should_know_is_noted_once():
    process = start("faulty_games:Restless", "fault=outside", "--workers", "2")
    assert played(process, streams=4) == ["6 answers"] * 4
    process.terminate()
    lines = sorted(process.communicate(timeout=60)[1].splitlines())
    assert len(lines) == 3, lines
    assert "an episode is truncated after 1000 steps" in lines[0]
    assert "reset() ignores its seed" in lines[1]
    assert "the observation of agent b: number 1 is 5, outside its space (-1 to 1)" in lines[2]


def test_a_request_that_makes_no_sense_is_refused_in_one_line():
    process = start("faulty_games:Game", "--workers", "1")
    address = process.stdout.readline().split()[-1].removeprefix("http://")
    rows = wire.tensor(np.zeros((1, 2), np.float32))
    reset = wire.PlayRequest(reset=wire.ResetEnvironment(environment=0, seed=bytes(32)))
    with grpc.insecure_channel(address, options=[("grpc.enable_http_proxy", 0)]) as channel:
        play = wire.EnvironmentServiceStub(channel).Play
        for requests, why in [
            (
                [wire.PlayRequest(save=wire.SaveEnvironment(environment=3))],
                "environment 3 was neither reset nor restored",
            ),
            ([wire.PlayRequest(reset=wire.ResetEnvironment(seed=b"x"))], "reset.seed has 1 bytes, a seed has 32"),
            ([reset, wire.PlayRequest(step=wire.StepEnvironments(environments=[0], actions=[rows, rows]))],
             "step.actions have the shapes [(1, 2), (1, 2)], expected [(1, 1), (1, 1)]"),
        ]:
            with pytest.raises(grpc.RpcError) as refused:
                list(play(iter(requests)))
            assert refused.value.details() == why
    process.kill()
    process.communicate()
