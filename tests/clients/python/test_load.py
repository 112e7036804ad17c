"""Policies of a run folder act in NumPy as the program acts, and what cannot be loaded is refused in one line."""

import json
import re
import shutil

import numpy as np
import pytest
import s2mia
from conftest import s2mia_run
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory
from s2mia.cue import Cue
from safetensors.numpy import load_file

ROBOT = ["halfcheetah-6x1", "run.seed=7", "run.iterations=2", "run.actors=1", "environments.count=4",
         "environments.steps=20", "environments.per_slot=2", "environments.message_steps=10", "evaluation.episodes=1"]
POLICIES = {
    "recurrent with running statistics": ROBOT,
    "without memory": [*ROBOT, "policy.core=mlp"],
    "with a layer norm": [*ROBOT, "policy.input_norm=layer_norm", "observation.norm=none"],
    "squashed": [*ROBOT, "algorithm=maddpg"],
    "of choices": ["cue-2x1", "run.seed=3", "run.iterations=10", "run.actors=1"],
}


@pytest.fixture(scope="module", params=POLICIES)
def exported(request, tmp_path_factory):
    """A run folder, and each agent's observations and actions of an episode that the program played."""
    folder = tmp_path_factory.mktemp("exported")
    s2mia_run("train", *POLICIES[request.param], f"run.dir={folder / 'run'}")
    s2mia_run("export", folder / "run", "--onnx", folder / "onnx")
    episode = load_file(folder / "onnx" / "episode.safetensors")
    agents = range(len(episode) // len({name.split(".")[1] for name in episode}))
    return folder, *([episode[f"agent_{agent}.{part}"] for agent in agents] for part in ("observation", "action"))


def test_an_episode_is_acted_as_the_program_played_it(exported):
    folder, observations, actions = exported
    for path in (folder / "run", folder / "onnx" / "policy.safetensors"):
        team = s2mia.load(path)
        for step in range(len(actions[0])):
            acted = team.act([rows[step] for rows in observations])
            for own, played in zip(acted, actions, strict=True):
                assert own.shape == played[step].shape
                assert np.abs(own - played[step]).max() < 1e-5, step


def test_environments_in_one_batch_act_as_each_alone(exported):
    folder, observations, _ = exported
    starts = [0, 7, 20]
    together, alone = s2mia.load(folder / "run"), [s2mia.load(folder / "run") for _ in starts]
    for step in range(10):
        if step == 5:
            together.reset([False, True, False])
            together.reset([])
            alone[1].reset()
        batch = np.stack([[rows[start + step] for rows in observations] for start in starts])
        acted = together.act(batch)
        listed = [team.act(list(rows)) for team, rows in zip(alone, batch, strict=True)]
        assert acted.shape == (3, len(observations), 1)
        assert np.abs(acted - np.array(listed)).max() < 1e-6


def test_sampled_actions_have_the_density_that_the_policy_states(exported):
    folder, observations, _ = exported
    team, rows = s2mia.load(folder / "run"), 4000
    batch = [np.repeat(own[:1], rows, 0) for own in observations]
    drawn = team.act(batch, np.random.default_rng(1))
    assert all((one == other).all() for one, other in zip(drawn, _again(folder, batch), strict=True))
    for agent, own, action in zip(team.agents, batch, drawn, strict=True):
        output, _ = agent.forward(own, np.zeros((rows, agent.hidden_size), np.float32))
        if agent.choices:
            shares = np.bincount(action[:, 0], minlength=agent.choices) / rows
            stated = [np.exp(agent.log_prob(output[:1], np.array([[choice]])))[0] for choice in range(agent.choices)]
            assert np.allclose(shares, stated, atol=0.05)
        elif agent.distribution == "gaussian":
            assert np.allclose(action.mean(0), output[0], atol=6 * agent.sigma() / rows**0.5)
            assert np.allclose(action.std(0), agent.sigma(), rtol=0.1)
            entropy = 0.5 + 0.5 * np.log(2 * np.pi) + np.log(agent.sigma()).sum()
            assert abs(agent.log_prob(output, action).mean() + entropy) < 0.1
        else:
            assert np.ptp(action) > 0 and np.abs(action).max() <= 1


def _again(folder, batch):
    return s2mia.load(folder / "run").act(batch, np.random.default_rng(1))


def test_logged_training_steps_have_the_log_probabilities_that_numpy_computes(tmp_path):
    logging = ["policy.core=mlp", "log.episodes=all", "checkpoint.every=1"]
    s2mia_run("train", *ROBOT, *logging, f"run.dir={tmp_path / 'run'}")
    team = s2mia.load(tmp_path / "run" / "checkpoints" / "iter_00000001")
    version, compared = None, 0
    [log] = sorted((tmp_path / "run" / "logs").glob("trajectories-*.mcap"))
    with log.open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        for _, channel, _, message in reader.iter_decoded_messages(log_time_order=False):
            if channel.topic == "/share":
                version = message.weights_version if message.kind == 1 else None
            elif channel.topic.startswith("/agents/") and version == 1:
                agent = team.agents[int(channel.topic.removeprefix("/agents/"))]
                output, _ = agent.forward(np.array([message.observation], np.float32), np.zeros((1, 0), np.float32))
                stated = agent.log_prob(output, np.array([message.action], np.float32))
                assert abs(stated[0] - message.log_prob) < 1e-5
                compared += 1
    assert compared == 4 * 20 * len(team.agents)


def test_a_trained_team_is_paid_for_its_choices(trained):
    team, game = s2mia.load(trained), Cue()
    game.reset(0, 50, np.random.default_rng(1))
    paid = sum(game.step(team.act(game.observe()[1]))[0] for _ in range(50))
    assert paid > 40, "of 50"


@pytest.mark.parametrize(
    ("observations", "message"),
    [
        ([np.zeros(9)], "observations of 1 agents, expected 2"),
        ([np.zeros(9), np.zeros(8)], "agent_1: observation has shape (8,), expected (9,) or (E, 9)"),
        (np.zeros((4, 2, 7)), "agent_0: observation has shape (4, 7), expected (9,) or (E, 9)"),
        (np.zeros(9), "observations have shape (9,), expected (N, obs) or (E, N, obs)"),
        ([np.zeros((3, 9)), np.zeros((2, 9))], "agent_1: observation has shape (2, 9), expected (3, 9) as for agent_0"),
        (
            {"one": np.zeros(9), "two": np.zeros(9)},
            "agent_0: the observation is no array of numbers: could not convert string to float: 'one'",
        ),
        ([np.zeros(9), np.full(9, np.nan)], "agent_1: the observation contains a number that is not finite"),
        ([np.zeros(9), np.full(9, 1e300)], "agent_1: the observation contains a number that is not finite"),
        ([np.zeros(9), np.zeros(9, complex)], "agent_1: the observation is no array of numbers: it has the type complex128"),
    ],
)
def test_a_wrong_observation_is_refused_with_agent_and_shape(trained, observations, message):
    with pytest.raises(ValueError, match=f"^{re.escape(message)}$"):
        s2mia.load(trained).act(observations)


def test_another_number_of_environments_needs_a_reset(trained):
    team = s2mia.load(trained)
    team.act(np.zeros((3, 2, 9)))
    with pytest.raises(ValueError, match=r"^observations of 2 environments after 3; call reset\(\) in between$"):
        team.act(np.zeros((2, 2, 9)))
    team.reset()
    assert team.act(np.zeros((2, 2, 9))).shape == (2, 2, 1)


@pytest.mark.parametrize("environments", [[True], [0, 3], [-1], [0.5], "first"])
def test_environments_that_do_not_exist_are_not_reset(trained, environments):
    team = s2mia.load(trained)
    team.act(np.zeros((3, 2, 9)))
    with pytest.raises(ValueError, match="^reset needs a mask of 3 environments or indices below 3, not "):
        team.reset(environments)


def refused(path) -> str:
    """The message with which a path is refused, without that path."""
    with pytest.raises(s2mia.RunError) as raised:
        s2mia.load(path)
    assert "\n" not in str(raised.value)
    return str(raised.value).replace(f"{path}", "PATH")


def test_a_folder_without_policies_is_refused(trained, tmp_path):
    assert refused(tmp_path) == "PATH is no run folder with policies: it has no config.toml and no checkpoints"
    assert refused(tmp_path / "x") == "PATH does not exist; expected a run folder, a checkpoint or a policy.safetensors"
    shutil.copy(trained / "config.toml", tmp_path)
    assert refused(tmp_path) == "PATH is no run folder with policies: it has no checkpoint yet"
    (tmp_path / "checkpoints").mkdir()
    assert refused(tmp_path) == "PATH/checkpoints holds no checkpoint yet"


def test_a_damaged_checkpoint_is_refused_with_the_file(trained, tmp_path):
    run = tmp_path / "run"
    shutil.copytree(trained, run)
    checkpoint = max((run / "checkpoints").glob("iter_*"))
    name = f"PATH/checkpoints/{checkpoint.name}"
    policy, manifest = checkpoint / "policy.safetensors", checkpoint / "manifest.json"
    whole = policy.read_bytes()
    policy.write_bytes(whole[:-1] + bytes([whole[-1] ^ 1]))
    assert refused(run).startswith(f"{name}/policy.safetensors is damaged: it has SHA-256 ")
    policy.write_bytes(whole)
    text = manifest.read_text()
    manifest.write_text(text.replace('"iteration": 10', '"iteration": 11'))
    assert refused(run) == f"{name}/manifest.json is damaged: it does not have its own hash"
    manifest.write_text(text.replace('"schema": 2', '"schema": 3'))
    assert refused(run) == f"{name}/manifest.json has schema 3, this package reads 2"
    manifest.write_text("[]")
    assert refused(run).startswith(f"{name}/manifest.json is damaged: ")
    manifest.unlink()
    assert refused(run) == f"{name} is damaged: it has no manifest.json"
    manifest.write_text(text)
    policy.unlink()
    assert refused(run) == f"{name}/policy.safetensors cannot be read: No such file or directory"


def changed(header, change):
    specs = json.loads(header["__metadata__"]["s2mia.policy"])
    change(header, specs[1])
    header["__metadata__"]["s2mia.policy"] = json.dumps(specs)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda header, spec: header.pop("agent_1.head.bias"), "PATH: agent_1: head.bias is missing"),
        (
            lambda header, spec: header["agent_1.head.bias"].update(shape=[1, 3]),
            "PATH: agent_1: head.bias has shape (1, 3), expected (3,)",
        ),
        (lambda header, spec: spec.pop("hidden"), "PATH: s2mia.policy: agent 1 has no 'hidden'"),
        (
            lambda header, spec: spec.update(head="beta"),
            "PATH: agent_1: core gru with distribution beta is unknown to this package",
        ),
        (lambda header, spec: spec.update(dropout=0.1), "PATH: agent_1: the entry dropout is unknown to this package"),
        (lambda header, spec: spec.update(encoder=0), "PATH: agent_1: encoder is 0, expected 1 to 1048576"),
        (lambda header, spec: spec.update(sigma_scale=-1.0), "PATH: agent_1: the distribution categorical "),
        (lambda header, spec: spec.update(input_norm="batch"), "PATH: agent_1: input_norm batch is unknown"),
        (
            lambda header, spec: header.update({"agent_1.extra": header["agent_1.head.bias"]}),
            "PATH: agent_1: extra is no array of the network",
        ),
        (
            lambda header, spec: header.update({"agent_2.head.bias": header["agent_1.head.bias"]}),
            "PATH: agent_2.head.bias belongs to no agent",
        ),
        (
            lambda header, spec: header["agent_1.head.bias"].update(dtype="F64"),
            "PATH is no safetensors file of a policy: agent_1.head.bias: type F64",
        ),
    ],
)
def test_a_policy_of_another_form_is_refused_with_the_array(trained, tmp_path, change, message):
    data = max((trained / "checkpoints").glob("iter_*/policy.safetensors")).read_bytes()
    length = int.from_bytes(data[:8], "little")
    header = json.loads(data[8 : 8 + length])
    changed(header, change)
    text = json.dumps(header).encode()
    path = tmp_path / "policy.safetensors"
    path.write_bytes(len(text).to_bytes(8, "little") + text + data[8 + length :])
    assert refused(path).startswith(message)
    path.write_bytes(data[:100])
    assert refused(path).startswith("PATH is no safetensors file of a policy: header: ")
