"""Environments of other authors, offered over gRPC by `s2mia_environment`, and policies that learn in them."""

import json
import os
import queue
import subprocess
import sys
import threading
import time

import grpc
import numpy as np
import pytest
import s2mia
from conftest import PLACES, SMALL, command
from games import STEPS, Follow, Push
from gymnasium import spaces
from s2mia import wire
from s2mia_environment import Parallel

# Both agents guess: one step of nine is paid.
GUESSING = STEPS / 9
CUE = ["run.env_steps=30000", "evaluation.every_steps=10000"]


def train(folder, url: str, *settings: str) -> subprocess.CompletedProcess:
    arguments = ("train", *SMALL, f"run.dir={folder}", "--environment", url, *settings)
    return subprocess.run(command(*arguments), capture_output=True, text=True, timeout=300, check=False)


def told(folder) -> tuple[str, list[float]]:
    """Hash of the final weights, and the mean returns of evaluations."""
    done = subprocess.run(command("inspect", folder, "--json"), capture_output=True, text=True, check=True)
    lines = [json.loads(line) for line in (folder / "metrics.jsonl").read_text().splitlines()]
    return json.loads(done.stdout)["weights_sha256"], [line["mean"] for line in lines if line["kind"] == "evaluation"]


def test_agents_learn_in_a_pettingzoo_environment(offer, tmp_path):
    done = train(tmp_path / "run", offer("games:Follow"), "run.actors=2", *CUE)
    assert done.returncode == 0, done.stderr
    assert "task follow" in done.stdout
    _, returns = told(tmp_path / "run")
    assert returns[0] < 3 * GUESSING
    assert returns[-1] > 0.9 * STEPS
    manifest = json.loads((tmp_path / "run" / "manifest.json").read_text())
    assert manifest["environment_states"] == "replayed"
    # The names are those of the game, which need not run.
    with s2mia.load(tmp_path / "run") as team:
        assert [agent.name for agent in team.agents] == ["left", "right"]


def test_a_team_with_choices_and_continuous_actions_acts_by_name_and_no_array_holds_its_actions(offer, tmp_path):
    settings = ("algorithm=happo", "policy.input_norm=none", "run.iterations=1", "run.actors=1")
    done = train(tmp_path / "run", offer("games:Mixed"), *settings)
    assert done.returncode == 0, done.stderr
    seen = dict.fromkeys(["chooser", *(f"knob_{index}" for index in range(8))], np.ones(1, np.float32))
    with s2mia.load(tmp_path / "run") as team, s2mia.load(tmp_path / "run") as other:
        first = other.act(seen)
        assert first["chooser"].shape == () and first["knob_7"].shape == (1,)
        with pytest.raises(ValueError, match="give a dictionary of observations by the agents' names"):
            team.act(np.ones((9, 1), np.float32))
        # The refused call was no step.
        assert all((own == first[name]).all() for name, own in team.act(seen).items())


def test_an_environment_without_states_gives_one_actor_and_two_the_same_weights(offer, tmp_path):
    url = offer("games:Follow")
    short = ("run.iterations=3", "environments.steps=20", "environments.message_steps=20")
    hashes = []
    for actors in (1, 2):
        folder = tmp_path / str(actors)
        done = train(folder, url, *short, f"run.actors={actors}")
        assert done.returncode == 0, done.stderr
        hashes.append(told(folder)[0])
    assert hashes[0] == hashes[1]


@pytest.mark.parametrize(
    ("lie", "field"),
    [
        ("shown=NaN", "NOT_FINITE: view.observations[0]: element 0 is NaN, agent a (after a reset)"),
        ("count=2", "BAD_SHAPE: view.observations[0]: [1, 2], expected [1, 1], agent a (after a reset)"),
        ("state=3", "BAD_SHAPE: view.state: [1, 3], expected [1, 1]"),
    ],
)
def test_a_program_that_shows_something_else_than_it_says_ends_the_run_by_field(offer, tmp_path, lie, field):
    norms = ("policy.input_norm=none", "critic.input_norm=none")
    done = train(tmp_path / "run", offer("games:Liar", lie), *norms, "run.actors=1")
    assert done.returncode == 1
    (line,) = done.stderr.splitlines()[-1:]
    assert f"sent an invalid answer: {field}" in line


def eventually(call):
    """What it gives as soon as a stream is free: the server learns of an end a moment after the client."""
    deadline = time.monotonic() + 30
    while True:
        try:
            return call()
        except grpc.RpcError as refused:
            full = refused.code() == grpc.StatusCode.RESOURCE_EXHAUSTED
            if not full or time.monotonic() > deadline:
                raise
            time.sleep(0.05)


def test_a_stream_too_many_is_refused_until_another_ends(offer):
    url = offer("games:Follow", "--streams", "1")
    with grpc.insecure_channel(url.removeprefix("http://")) as channel:
        service = wire.EnvironmentServiceStub(channel)
        start = wire.PlayRequest(reset=wire.ResetEnvironment(environment=0, seed=bytes(32)))
        over = threading.Event()

        def first():
            yield start
            over.wait()

        answers = service.Play(first())
        assert next(answers).WhichOneof("answer") == "view"
        with pytest.raises(grpc.RpcError) as refused:
            next(service.Play(iter([start])))
        assert refused.value.code() == grpc.StatusCode.RESOURCE_EXHAUSTED
        over.set()
        assert list(answers) == []
        assert eventually(lambda: next(service.Play(iter([start])))).WhichOneof("answer") == "view"


class Stream:
    """A stream of requests to environment 0."""

    def __init__(self, service) -> None:
        self.requests = queue.SimpleQueue()
        self.answers = service.Play(iter(self.requests.get, None))

    def ask(self, request):
        self.requests.put(request)
        return next(self.answers)

    def process(self) -> int:
        """Process of a `Fragile` environment."""
        start = wire.ResetEnvironment(environment=0, seed=bytes(32))
        return int(wire.array(self.ask(wire.PlayRequest(reset=start)).view.state)[0, 0])

    def act(self, action: float):
        rows = wire.tensor(np.full((1, 1), action, np.float32))
        return self.ask(wire.PlayRequest(step=wire.StepEnvironments(environments=[0], actions=[rows, rows])))

    def refusal(self, action: float) -> tuple[grpc.StatusCode, str]:
        with pytest.raises(grpc.RpcError) as refused:
            self.act(action)
        return refused.value.code(), refused.value.details()


def test_streams_are_spread_over_workers_and_a_worker_that_ends_is_replaced(offer):
    url = offer("games:Fragile", "--workers", "2")
    with grpc.insecure_channel(url.removeprefix("http://")) as channel:
        service = wire.EnvironmentServiceStub(channel)
        streams = [Stream(service) for _ in range(3)]
        processes = [stream.process() for stream in streams]
        assert len(set(processes)) == 2
        (alone,) = (stream for stream, process in zip(streams, processes) if processes.count(process) == 1)
        lost, kept = (stream for stream in streams if stream is not alone)
        assert lost.refusal(1.0) == (grpc.StatusCode.INVALID_ARGUMENT, "ValueError: broken by its action")
        code, why = alone.refusal(2.0)
        assert (code, why) == (
            grpc.StatusCode.UNAVAILABLE,
            "a worker process ended with exit code 3; its environments are lost",
        )
        assert kept.act(0.0).steps.view.state.data
        again = [Stream(service).process() for _ in range(2)]
        assert len({*again} - {*processes}) == 1


def test_environments_that_cannot_be_made_end_the_server_with_one_line():
    places = {**os.environ, "PYTHONPATH": PLACES}
    for workers in ("1", "2"):
        arguments = [sys.executable, "-m", "s2mia_environment", "--listen", "127.0.0.1:0", "--workers", workers]
        arguments += ["games:Push", "low=1"]
        done = subprocess.run(arguments, capture_output=True, text=True, env=places, check=False)
        assert (done.returncode, done.stdout) == (1, "")
        (line,) = done.stderr.splitlines()
        assert line.startswith("s2mia_environment: cannot make games:Push: "), line


def test_choices_are_numbered_as_the_environment_does_and_observations_lie_flat():
    game = Parallel(Follow())
    game.reset(bytes(32))
    state, seen = game.observe()
    assert [row.tolist() for row in seen] == [np.eye(3)[game.env.sign].tolist()] * 2
    assert state.tolist() == [*seen[0], *seen[1]], "without a state of its own, all observations"
    right = [np.array([game.env.sign], np.float32)] * 2
    assert game.step(right) == (1.0, False, False)
    action = game.spec.agents[0].action
    assert (action.size, action.choices, game.spec.episode_steps, game.spec.dt_secs) == (1, 3, STEPS, 0.1)


def test_the_same_seed_gives_the_same_episode_and_another_seed_another():
    def signs(seed: bytes) -> list[int]:
        game = Parallel(Follow())
        game.reset(seed)
        return [game.step([np.zeros(1)] * 2) and game.env.sign for _ in range(20)]

    assert signs(bytes(32)) == signs(bytes(32)) != signs(bytes(31) + b"\x01")


def test_pushes_are_clamped_and_brought_into_ranges_that_differ():
    for low, high, own, push, expected in (
        ((-2.0, -2.0), (2.0, 2.0), (-2.0, 2.0), (0.5, 9.0), [0.5, 2.0]),
        ((0.0, 0.0), (4.0, 4.0), (0.0, 4.0), (1.0, -1.0), [1.0, 0.0]),
        ((0.0, -1.0), (4.0, 1.0), (-1.0, 1.0), (0.0, 9.0), [2.0, 1.0]),
        ((-100.0, 0.1), (100.0, 0.7), (-1.0, 1.0), (0.25, 1.0), [25.0, float(np.float32(0.7))]),
    ):
        game = Parallel(Push(low=low, high=high))
        action = game.spec.agents[0].action
        assert (action.size, action.low, action.high) == (2, *own)
        game.step([np.array(push, np.float32)] * 2)
        assert game.observe()[1][0].tolist() == expected


def test_the_unit_of_an_action_does_not_affect_the_weights(offer, tmp_path):
    """The reward of all is the same function of the place of an action in its range."""
    norm = "policy.input_norm=none"
    short = (norm, "algorithm=happo", "run.iterations=3", "environments.steps=20", "environments.message_steps=20", "run.actors=1")
    hashes = []
    for first, second in ((1, 1), (128, 128), (1, 128)):
        folder = tmp_path / f"{first}-{second}"
        done = train(folder, offer("games:Aim", f"first={first}", f"second={second}"), *short)
        assert done.returncode == 0, done.stderr
        hashes.append(told(folder)[0])
    assert hashes[1:] == hashes[:1] * 2


def test_the_team_is_paid_the_mean_and_ends_with_its_first_agent():
    game = Parallel(Push())
    assert game.step([np.zeros(2)] * 2) == (2.0, False, True)
    assert game.step([np.full(2, 2.0)] * 2) == (2.0, True, False)


def test_a_reward_in_single_precision_that_all_share_is_the_teams_to_the_last_bit():
    class Shared(Push):
        # The mean of seven in single precision would be another number.
        possible_agents = [f"agent_{index}" for index in range(7)]
        paid = np.float32(0.1)

        def step(self, actions):
            ends = dict.fromkeys(actions, False)
            return actions, dict.fromkeys(actions, self.paid), ends, ends, {}

    assert Parallel(Shared()).step([np.zeros(2)] * 7)[0] == float(Shared.paid)


def test_a_kind_of_box_is_a_box():
    class Own(spaces.Box):
        pass

    class Unit(Push):
        def action_space(self, agent):
            return Own(-1.0, 1.0, (1,), np.float32)

    assert [agent.action.size for agent in Parallel(Unit()).spec.agents] == [1, 1]


def test_an_array_is_an_observation_of_a_tuple_of_spaces():
    class Pair(Follow):
        def observation_space(self, agent):
            return spaces.Tuple([spaces.Discrete(3), spaces.Discrete(3)])

        def _look(self):
            return {agent: np.array([sign, 1]) for agent, sign in super()._look().items()}

    game = Parallel(Pair())
    game.reset(bytes(32))
    assert [row.tolist()[3:] for row in game.observe()[1]] == [[0, 1, 0]] * 2


@pytest.mark.parametrize("seen", [np.ma.masked_array([1.0, 2.0], [True, False]), None, [[1.0], 2.0]])
def test_an_observation_that_is_no_array_of_numbers_is_refused_with_its_agent(seen):
    class Odd(Push):
        def step(self, actions):
            return super().step(actions)[0] | {"two": seen}, *super().step(actions)[1:]

    with pytest.raises(ValueError, match="two"):
        Parallel(Odd()).step([np.zeros(2)] * 2)


def test_actions_that_no_policy_can_be_taught_are_refused_when_the_program_starts():
    class Endless(Push):
        def action_space(self, agent):
            return spaces.Box(-np.inf, np.inf, (1,))

    class Disguised(Push):
        def action_space(self, agent):
            return spaces.Box(np.finfo(np.float32).min, np.finfo(np.float32).max, (1,), np.float32)

    class Many(Push):
        def action_space(self, agent):
            return spaces.MultiDiscrete([2, 2])

    for kind, why in ((Endless, "finite bounds"), (Disguised, "finite bounds"), (Many, "one Box or one Discrete")):
        with pytest.raises(ValueError, match=why):
            Parallel(kind())
