"""A Python program acts by policies that the binary serves, in an environment of its own."""

import copy
import pickle
from concurrent import futures

import grpc
import numpy as np
import pytest
import s2mia
from conftest import Serving, refusal
from s2mia import Team, wire
from s2mia.cue import Cue

# Both agents guess: one step of nine is paid, of fifty.
GUESSING = 50 / 9


@pytest.fixture
def team(policies):
    """Opens teams that are closed again."""
    opened = []

    def act(seed: int | None = None) -> Team:
        opened.append(Team(policies.address, seed))
        return opened[-1]

    yield act
    for one in opened:
        one.close()


def test_one_process_may_open_more_teams_than_a_connection_has_streams(team):
    game = Cue()
    game.reset(0, 50, np.random.default_rng(1))
    seen = {f"agent_{agent}": row for agent, row in enumerate(game.observe()[1])}
    choices = [tuple(int(choice) for choice in team().act(seen).values()) for _ in range(20)]
    assert choices == 20 * choices[:1]


def test_a_served_team_has_the_agents_of_the_loaded_one():
    server = Serving("quadruped-4x3")
    try:
        with Team(server.address) as team:
            assert team.agents == s2mia.pretrained("quadruped-4x3").agents
    finally:
        server.process.kill()
        server.process.wait()
        server.process.stdout.close()


def play(team, seed: int) -> tuple[list[list[int]], float]:
    """All joint actions of a game, and what it paid."""
    game, joint, total, ended = Cue(), [], 0.0, False
    game.reset(0, 50, np.random.default_rng(seed))
    team.reset()
    while not ended:
        choices = team.act({f"agent_{agent}": row for agent, row in enumerate(game.observe()[1])})
        joint.append([int(choice) for choice in choices.values()])
        reward, terminated, truncated = game.step([np.array([choice]) for choice in joint[-1]])
        total, ended = total + reward, terminated or truncated
    return joint, total


@pytest.mark.parametrize("seed", [None, 5])
def test_a_served_team_acts_as_a_loaded_one_episode_after_episode(team, trained, seed):
    served, loaded = team(seed), s2mia.load(trained, seed)
    for game in range(3):
        assert play(served, game) == play(loaded, game)


def test_a_served_team_describes_itself_as_a_loaded_one(team, trained):
    assert team().description == s2mia.load(trained).description


def test_served_choices_are_paid(team):
    assert play(team(), 1)[1] > 2 * GUESSING


def test_drawn_choices_follow_from_the_seed(team):
    first, again, other = (play(team(seed), 2)[0] for seed in (5, 5, 6))
    assert first == again != other


def test_a_served_team_acts_in_one_environment(team):
    with pytest.raises(ValueError, match="^observations of 3 environments; a served team acts in one$"):
        team().act(np.zeros((3, 2, 9)))
    assert team().act(np.zeros((1, 2, 9))).shape == (1, 2)


def test_threads_that_share_a_served_team_get_their_own_answers(team):
    shared = team()

    def call(agent: str) -> set[str]:
        acted: set[str] = set()
        for _ in range(200):
            shared.reset()
            acted |= shared.act({agent: np.zeros(9)}).keys()
        return acted

    with futures.ThreadPoolExecutor(2) as pool:
        assert list(pool.map(call, ["agent_0", "agent_1"])) == [{"agent_0"}, {"agent_1"}]


def test_a_served_team_still_acts_after_an_observation_that_is_too_large(team):
    acting = team()
    with pytest.raises(ValueError, match=r"^agent_1: the observation contains 2e\+09; a served team takes up to 1e\+09$"):
        acting.act({"agent_0": np.zeros(9), "agent_1": np.full(9, -2e9)})
    assert acting.act(np.zeros((2, 9))).shape == (2,)


def test_an_interrupted_call_closes_a_served_team(team, monkeypatch):
    def interrupted(*_):
        raise KeyboardInterrupt

    acting = team()
    monkeypatch.setattr(acting, "_answers", map(interrupted, [0]))
    with pytest.raises(KeyboardInterrupt):
        acting.act(np.zeros((2, 9)))
    with pytest.raises(ConnectionError, match=r": the connection is closed$"):
        acting.act(np.zeros((2, 9)))


@pytest.mark.parametrize("copied", [copy.copy, copy.deepcopy, pickle.dumps])
def test_a_connection_cannot_be_copied(team, copied):
    with pytest.raises(TypeError, match=r"^a Team has a connection, which cannot be copied or pickled; connect once more$"):
        copied(team())


@pytest.fixture
def stub(policies):
    with grpc.insecure_channel(policies.address) as channel:
        yield wire.PolicyServiceStub(channel)


def test_refusals_name_reason_and_field_from_outside(stub):
    start = wire.ActRequest(start=wire.ActStart(mean=wire.MeanAction()))
    good = np.zeros(9, np.float32)
    for observations, expected in [
        ({}, ("MISSING_FIELD", "step.observations")),
        ({2: good}, ("BAD_VALUE", "step.observations[0].agent")),
        ({0: good, 1: good[:8]}, ("BAD_SHAPE", "step.observations[1].observation")),
        ({1: np.full(9, np.nan, np.float32)}, ("NOT_FINITE", "step.observations[0].observation")),
    ]:
        rows = [wire.AgentObservation(agent=agent, observation=wire.tensor(row)) for agent, row in observations.items()]
        step = wire.ActRequest(step=wire.ActStep(observations=rows))
        assert refusal(lambda: next(stub.Act(iter([start, step])))) == expected
    assert refusal(lambda: next(stub.Act(iter([step])))) == ("MISSING_FIELD", "start")
