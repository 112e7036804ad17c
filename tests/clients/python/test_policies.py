"""A Python program acts by policies that the binary serves, in an environment of its own."""

import numpy as np
import pytest
from conftest import refusal
from s2mia import Policy, Team, wire
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


def play(team: Team, game: Cue) -> tuple[list[tuple[float, ...]], float]:
    """All joint actions of a game, and what it paid."""
    joint, total, ended = [], 0.0, False
    while not ended:
        _, observations = game.observe()
        actions = team.act(dict(enumerate(observations)), reset=not joint)
        joint.append(tuple(float(actions[agent][0]) for agent in range(2)))
        reward, terminated, truncated = game.step([actions[0], actions[1]])
        total, ended = total + reward, terminated or truncated
    return joint, total


def game(seed: int) -> Cue:
    one = Cue()
    one.reset(0, 50, np.random.default_rng(seed))
    return one


def test_the_service_names_the_team_and_its_distributions(team):
    described = team().description
    assert (described.run_id, described.weights.version) == ("trained", 10)
    assert [row.agent.name for row in described.agents] == ["agent_0", "agent_1"]
    assert {row.distribution for row in described.agents} == {wire.ACTION_DISTRIBUTION_CATEGORICAL}
    assert {row.agent.action.choices for row in described.agents} == {3}


def test_served_choices_are_those_that_the_snapshot_gives_and_are_paid(team, trained):
    snapshot = Policy((trained / "checkpoints" / "iter_00000010" / "policy.safetensors").read_bytes())
    joint, total = play(team(), game(1))
    assert total > 2 * GUESSING
    here, hidden = game(1), [np.zeros((1, agent.hidden_size), np.float32) for agent in snapshot.agents]
    for served in joint:
        _, observations = here.observe()
        own = []
        for index, agent in enumerate(snapshot.agents):
            output, hidden[index] = agent.forward(observations[index][None], hidden[index])
            own.append(agent.mode(output)[0])
        assert served == tuple(float(action[0]) for action in own)
        here.step(own)


def test_drawn_choices_follow_from_the_seed(team):
    first, again, other = (play(team(seed), game(2))[0] for seed in (5, 5, 6))
    assert first == again
    assert first != other


def test_refusals_name_reason_and_field_from_outside(team):
    agents = {agent: np.zeros(9, np.float32) for agent in range(2)}
    assert set(team().act(agents)) == {0, 1}
    for observations, expected in [
        ({}, ("MISSING_FIELD", "step.observations")),
        ({2: agents[0]}, ("BAD_VALUE", "step.observations[0].agent")),
        ({0: agents[0], 1: np.zeros(8)}, ("BAD_SHAPE", "step.observations[1].observation")),
        ({1: np.full(9, np.nan)}, ("NOT_FINITE", "step.observations[0].observation")),
    ]:
        assert refusal(lambda: team().act(observations)) == expected


def test_a_stream_begins_with_its_beginning(team):
    step = wire.ActRequest(step=wire.ActStep())
    assert refusal(lambda: next(team().service.Act(iter([step])))) == ("MISSING_FIELD", "start")
