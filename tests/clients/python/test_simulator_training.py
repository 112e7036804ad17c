"""Environments in Python are those of training, bit for bit: a logged run is played again with its actions."""

import numpy as np
import pytest
import s2mia
from conftest import s2mia_run
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

ENVIRONMENTS, STEPS, SEED = 4, 300, 7
RUN = [f"run.seed={SEED}", "run.iterations=3", "run.actors=1", f"environments.count={ENVIRONMENTS}", "log.episodes=all",
       "environments.steps=100", "environments.per_slot=2", "environments.message_steps=50", "evaluation.every_steps=0"]
# A run rebuilds its worlds after as many steps.
SETTINGS = {"environments__steps": 100}


class Logged:
    """A step of an environment."""

    def __init__(self, agents, step) -> None:
        self.observations, self.actions = (
            [np.array(getattr(agent, part), np.float32) for agent in agents] for part in ("observation", "action")
        )
        self.state = np.array(step.state, np.float32)
        self.paid = np.float32(step.reward), step.terminated, step.truncated


@pytest.fixture(scope="module", params=["halfcheetah-2x3", "walker2d-2x3", "cue-2x1"])
def run(request, tmp_path_factory):
    """A task, the steps of each environment in training, and the state at the start of each share."""
    folder = tmp_path_factory.mktemp("runs") / "logged"
    s2mia_run("train", request.param, *RUN, f"run.dir={folder}")
    steps, starts = {environment: {} for environment in range(ENVIRONMENTS)}, []
    for log in sorted((folder / "logs").glob("*.mcap")):
        with log.open("rb") as file:
            agents, share = [], None
            reader = make_reader(file, decoder_factories=[DecoderFactory()])
            for _, channel, _, message in reader.iter_decoded_messages(log_time_order=False):
                if channel.topic == "/share":
                    share = message
                    starts.append(share)
                elif channel.topic.startswith("/agents/"):
                    agents.append(message)
                elif channel.topic == "/step":
                    steps[share.environment][share.episode, message.step] = Logged(agents, message)
                    agents = []
    return request.param, [[own[key] for key in sorted(own)] for own in steps.values()], starts


def staggered(task) -> list[int]:
    """Steps of the first episodes, with `environments.phase=staggered`."""
    whole = s2mia.parallel_env(task).task.episode_steps
    return [max(1, whole * (environment + 1) // ENVIRONMENTS) for environment in range(ENVIRONMENTS)]


@pytest.mark.parametrize("threads", [1, 3])
def test_a_vector_of_environments_repeats_a_run_bit_for_bit(run, threads):
    task, steps, _ = run
    assert [len(own) for own in steps] == [STEPS] * ENVIRONMENTS
    envs = s2mia.vector_env(task, ENVIRONMENTS, threads=threads, seed=SEED, **SETTINGS)
    seen, _ = envs.reset(options={"limit": staggered(task)})
    done, starts = [0] * ENVIRONMENTS, np.zeros(ENVIRONMENTS, bool)
    actions = np.zeros(envs.action_space.shape, np.float32)
    while min(done) < STEPS:
        states = envs.state()
        now = [None if starts[e] or done[e] == STEPS else steps[e][done[e]] for e in range(ENVIRONMENTS)]
        for e, logged in enumerate(now):
            if logged is not None:
                assert seen[e].tobytes() == np.concatenate(logged.observations).tobytes(), (e, done[e])
                assert states[e].tobytes() == logged.state.tobytes()
                actions[e] = np.reshape(logged.actions, actions[e].shape)
        seen, rewards, terminated, truncated, _ = envs.step(actions)
        for e, logged in enumerate(now):
            done[e] += logged is not None
            expected = (np.float32(0), False, False) if starts[e] else logged and logged.paid
            assert expected is None or (rewards[e], terminated[e], truncated[e]) == expected, (e, done[e])
        starts = terminated | truncated
    assert any(logged.paid[1] or logged.paid[2] for own in steps for logged in own)


def test_one_environment_repeats_environment_0_for_a_team_and_for_one_agent(run):
    task, steps, _ = run
    team, one = s2mia.parallel_env(task, seed=SEED, **SETTINGS), s2mia.gym_env(task, seed=1, **SETTINGS)
    limit = {"limit": staggered(task)[0]}
    observations, _ = team.reset(options=limit)
    state, _ = one.reset(seed=SEED, options=limit)
    for logged in steps[0]:
        if not team.agents:
            (observations, _), (state, _) = team.reset(), one.reset()
        assert np.concatenate(list(observations.values())).tobytes() == np.concatenate(logged.observations).tobytes()
        assert state.tobytes() == logged.state.tobytes()
        observations, rewards, *ends, _ = team.step(dict(zip(team.agents, logged.actions, strict=True)))
        state, *paid, _ = one.step(np.concatenate(logged.actions))
        assert (np.float32(rewards["agent_0"]), *(end["agent_0"] for end in ends)) == logged.paid == tuple(paid)


def test_a_logged_state_is_restored(run):
    task, steps, shares = run
    env, restored = s2mia.parallel_env(task), 0
    for share in shares:
        env.restore(share.environment_state)
        assert env.save() == share.environment_state
        if share.environment == 0:
            observed = np.concatenate(list(env.observations().values())).tobytes()
            restored += observed in {np.concatenate(logged.observations).tobytes() for logged in steps[0]}
    assert restored == sum(share.environment == 0 for share in shares) > 1
