"""The actor in Python computes what the program computes, with NumPy alone."""

import numpy as np
import pytest
import s2mia
from conftest import HASAC, ROBOT, SMALL, s2mia_run
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory
from s2mia import wire
from s2mia.policy import Policy
from s2mia.shared_noise import TRAINING

POLICIES = {
    "recurrent": ROBOT,
    "without memory": [*ROBOT, "policy.core=mlp"],
    "with a layer norm": [*ROBOT, "policy.input_norm=layer_norm", "observation.norm=none"],
    "squashed": [*ROBOT, "algorithm=maddpg"],
    "squashed with own deviations": [*ROBOT, *HASAC],
    "with shared noise": [*ROBOT, "algorithm=happo-shared"],
    "of choices": [*SMALL, "run.iterations=3", "run.actors=1"],
}


def newest(run) -> Policy:
    return Policy(max((run / "checkpoints").glob("iter_*/policy.safetensors")).read_bytes())


@pytest.fixture(scope="module", params=POLICIES)
def run(request, tmp_path_factory):
    folder = tmp_path_factory.mktemp("networks") / "run"
    s2mia_run("train", *POLICIES[request.param], f"run.dir={folder}")
    return folder


def test_the_likeliest_actions_are_those_of_the_program(run):
    team, policy, rng = s2mia.load(run), newest(run), np.random.default_rng(1)
    hidden = [np.zeros((20, agent.hidden_size), np.float32) for agent in policy.agents]
    for _ in range(10):
        rows = {agent.name: rng.normal(size=(20, agent.observation_size)) for agent in team.agents}
        for index, (own, acted) in enumerate(zip(rows.values(), team.act(rows).values(), strict=True)):
            network = policy.agents[index]
            output, hidden[index] = network.forward(own, hidden[index])
            mode = network.mode(output)
            assert np.abs(mode - acted.reshape(mode.shape)).max() < 1e-5


def test_drawn_actions_have_the_density_that_the_policy_states(run):
    rows, rng = 4000, np.random.default_rng(1)
    for agent in newest(run).agents:
        observations = np.repeat(rng.normal(size=(1, agent.spec["observation"])), rows, 0)
        output, _ = agent.forward(observations, np.zeros((rows, agent.hidden_size), np.float32))
        action = agent.draw(output, rng)
        if agent.choices:
            shares = np.bincount(action[:, 0].astype(int), minlength=agent.choices) / rows
            stated = [np.exp(agent.log_prob(output[:1], np.array([[choice]])))[0] for choice in range(agent.choices)]
            assert np.allclose(shares, stated, atol=0.05)
        elif agent.distribution in ("gaussian", "shared_gaussian"):
            assert np.allclose(action.mean(0), output[0], atol=6 * agent.sigma() / rows**0.5)
            assert np.allclose(action.std(0), agent.sigma(), rtol=0.1)
            entropy = 0.5 + 0.5 * np.log(2 * np.pi) + np.log(agent.sigma()).sum()
            assert abs(agent.log_prob(output, action).mean() + entropy) < 0.1
        else:
            assert np.ptp(action) > 0 and np.abs(action).max() <= 1
        if agent.distribution == "tanh_gaussian":
            grid = np.linspace(-1, 1, 20_001, dtype=np.float32)[1:-1]
            for joint in range(action.shape[1]):
                alone = output[:1, [joint, action.shape[1] + joint]]
                density = np.exp(agent.log_prob(np.repeat(alone, len(grid), 0), grid[:, None]))
                assert abs(density.mean() * 2 - 1) < 1e-3
                assert abs((density * grid).mean() * 2 - action[:, joint].mean()) < 6 * action[:, joint].std() / rows**0.5


SHARED = ["policy.noise=shared", "policy.noise_hold=3"]
LOGGED = {
    "gaussian": ["policy.core=mlp"],
    "tanh_gaussian": HASAC,
    "constant loadings": ["policy.core=mlp", *SHARED, "policy.noise_loading=0.7", "policy.noise_decay_steps=1000"],
    "learnt loadings": ["policy.core=mlp", *SHARED, "policy.noise_size=2"],
    "learnt loadings before tanh": [*HASAC, *SHARED, "policy.noise_size=2"],
}


@pytest.mark.parametrize("settings", LOGGED.values(), ids=LOGGED)
def test_logged_training_steps_have_the_log_probabilities_that_numpy_computes(settings, tmp_path):
    logging = [*settings, "log.episodes=all", "checkpoint.every=1"]
    s2mia_run("train", *ROBOT, *logging, f"run.dir={tmp_path / 'run'}")
    team = Policy((tmp_path / "run" / "checkpoints" / "iter_00000001" / "policy.safetensors").read_bytes())
    share, rows, compared = None, [], 0
    [log] = sorted((tmp_path / "run" / "logs").glob("trajectories-*.mcap"))
    with log.open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        for _, channel, _, message in reader.iter_decoded_messages(log_time_order=False):
            if channel.topic == "/share":
                share = message if message.kind == 1 and message.weights_version == 1 else None
            elif channel.topic.startswith("/agents/") and share:
                rows.append((team.agents[int(channel.topic.removeprefix("/agents/"))], message))
            elif channel.topic == "/step" and share:
                key = share.iteration, [share.environment], message.step - share.first_step
                signal = team.signal(share.seed, TRAINING, *key)
                assert np.abs(signal[0] - np.array(message.signal)).max(initial=0) < 1e-5
                for agent, row in rows:
                    observation, action = (np.array([x], np.float32) for x in (row.observation, row.action))
                    output, _ = agent.forward(observation, np.zeros((1, 0), np.float32))
                    stated = agent.log_prob(agent.shifted(output, signal), action)
                    assert abs(stated[0] - row.log_prob) < 5e-5
                    compared += 1
                rows.clear()
    assert compared == 4 * 20 * len(team.agents)


def test_a_distribution_that_is_unknown_is_refused(run):
    snapshot = max((run / "checkpoints").glob("iter_*/policy.safetensors")).read_bytes()
    other = snapshot.replace(b'\\"core\\":\\"gru\\"', b'\\"core\\":\\"lru\\"').replace(
        b'\\"core\\":\\"mlp\\"', b'\\"core\\":\\"lru\\"'
    )
    with pytest.raises(ValueError, match="^core lru with distribution "):
        Policy(other)


def test_bytes_that_are_no_policies_are_refused_in_one_line(run):
    snapshot = max((run / "checkpoints").glob("iter_*/policy.safetensors"))
    weights = (snapshot.parent / "weights.safetensors").read_bytes()
    for other in (b"", b"garbage", weights, snapshot.read_bytes()[:-40]):
        with pytest.raises(ValueError, match="^no policies, or damaged ones; policy.safetensors of a checkpoint has them") as refused:
            Policy(other)
        assert len(str(refused.value).splitlines()) == 1


def test_the_numbers_of_a_message_can_be_written_to():
    numbers = wire.array(wire.tensor(np.zeros(3, np.float32)))
    numbers += 1
    assert numbers.tolist() == [1, 1, 1]
