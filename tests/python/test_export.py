"""Exported policies act elsewhere as they act here, and the examples in docs/USING.md do what they say."""

import json

import numpy
import onnxruntime
import pytest
from conftest import TINY, examples, s2mia
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory
from safetensors import safe_open
from safetensors.numpy import load_file

POLICIES = {
    "recurrent": [],
    "without memory": ["policy.core=mlp"],
    "of choices": ["task=cue-2x1"],
    "squashed": ["algorithm=maddpg"],
    "squashed with own deviations": ["algorithm=hasac", "hasac.warm_up=100", "hasac.updates_per_step=0.1"],
    "standardising": ["observation.norm=running"],
}


@pytest.fixture(scope="module")
def exported(run, tmp_path_factory):
    """The folder of one run's exported policies."""
    folder = tmp_path_factory.mktemp("export") / "exported"
    s2mia("export", run, "--onnx", folder)
    return folder


def agents(folder):
    """For each agent its session and its part of the recorded episode."""
    episode = load_file(folder / "episode.safetensors")
    for index, path in enumerate(sorted(folder.glob("agent_*.onnx"))):
        names = {part: f"agent_{index}.{part}" for part in ("observation", "hidden", "action")}
        own = {part: episode[name] for part, name in names.items() if name in episode}
        yield onnxruntime.InferenceSession(path), own


def fed(session, rows):
    """Those of `rows` that the model takes."""
    return {value.name: rows[value.name] for value in session.get_inputs()}


@pytest.mark.parametrize("kind", POLICIES)
def test_every_step_of_an_episode_comes_out_as_it_was_played(kind, tmp_path):
    run, folder = tmp_path / "run", tmp_path / "exported"
    s2mia("train", f"task={TINY[0]}", *TINY[1:], *POLICIES[kind], f"run.dir={run}", "run.iterations=2")
    s2mia("export", run, "--onnx", folder)
    count = 0
    for session, episode in agents(folder):
        action = session.run(["action"], fed(session, episode))[0]
        assert numpy.abs(action - episode["action"]).max() < 1e-5
        assert numpy.abs(episode["observation"]).max() > 0 and len(episode["action"]) > 1
        count += 1
    assert count > 1


def test_what_an_agent_remembers_is_the_next_step_s_hidden_state(exported):
    for session, episode in agents(exported):
        remembered = session.run(["next_hidden"], fed(session, episode))[0]
        assert numpy.abs(remembered[:-1] - episode["hidden"][1:]).max() < 1e-5
        assert not episode["hidden"][0].any() and episode["hidden"][1].any()


def test_the_model_says_where_it_comes_from(exported, inspected):
    session = onnxruntime.InferenceSession(exported / "agent_0.onnx")
    told = session.get_modelmeta().custom_metadata_map
    assert told["task"] == "halfcheetah-6x1" and told["iteration"] == str(inspected["iteration"])
    with safe_open(exported / "policy.safetensors", "numpy") as weights:
        deviation = 0.5 / (1 + numpy.exp(-weights.get_tensor("agent_0.head.log_std")))
    assert numpy.allclose([float(sigma) for sigma in told["sigma"].split()], deviation, atol=1e-6)


def recorded(path):
    """For each agent its steps of a recorded episode, as (raw observation, action), and the global states."""
    agents, states = {}, []
    with path.open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        for _, channel, _, message in reader.iter_decoded_messages():
            if channel.topic.startswith("/agents/"):
                agents.setdefault(int(channel.topic[8:]), []).append((message.observation, message.action))
            elif channel.topic == "/step":
                states.append(list(message.state))
    return agents, states


@pytest.mark.parametrize("norm", ["running", "none"])
def test_raw_observations_give_the_actions_of_the_program(norm, tmp_path):
    run, folder = tmp_path / "run", tmp_path / "exported"
    s2mia("train", *TINY, f"run.dir={run}", "run.iterations=2", f"observation.norm={norm}")
    s2mia("export", run, "--onnx", folder)
    s2mia("record", run, "--out", tmp_path / "episode.mcap")
    agents, states = recorded(tmp_path / "episode.mcap")
    assert len(agents) == 6
    for index, steps in agents.items():
        session = onnxruntime.InferenceSession(folder / f"agent_{index}.onnx")
        about = session.get_modelmeta().custom_metadata_map
        assert about["observation_scaling"] == norm
        hidden = numpy.zeros((1, session.get_inputs()[1].shape[1]), numpy.float32)
        for state, (observation, expected) in zip(states, steps):
            # Raw: the features of the global state as they are, then the agent's index.
            assert list(observation[: len(state)]) == state
            rows = {"observation": numpy.array([observation], numpy.float32), "hidden": hidden}
            action, hidden = session.run(["action", "next_hidden"], rows)
            assert numpy.abs(action[0] - expected).max() < 1e-4


def test_the_model_names_its_inputs_and_outputs(exported, tasks):
    task = tasks["halfcheetah-6x1"]
    for index, agent in enumerate(task["agents"]):
        session = onnxruntime.InferenceSession(exported / f"agent_{index}.onnx")
        about = session.get_modelmeta().custom_metadata_map
        assert about["agent"] == f"agent_{index}"
        assert json.loads(about["action_joints"]) == agent["joints"]
        features = json.loads(about["observation_features"])
        assert features == agent["observation"] and len(features) == session.get_inputs()[0].shape[1]
        assert float(about["dt_secs"]) == task["dt_secs"]
        limits = [float(about[name]) for name in ("action_low", "action_high")]
        assert limits == [agent["action"]["low"], agent["action"]["high"]]
        assert about["action_unit"] == "half_range"
        assert json.loads(about["control_ranges"]) == [[-1, 1]] * len(agent["joints"])
        (actuator,) = json.loads(about["actuators"])
        gears = {"bthigh": 120, "bshin": 90, "bfoot": 60, "fthigh": 120, "fshin": 60, "ffoot": 30}
        assert [actuator[name] for name in ("kind", "gear", "kp")] == ["motor", gears[agent["joints"][0]], 0]


def test_the_documented_examples_run(exported, monkeypatch, capsys):
    monkeypatch.chdir(exported.parent)
    with_onnx, with_numpy = examples("ONNX export")
    exec(with_onnx, {})
    assert float(capsys.readouterr().out.split(":")[1]) < 1e-5
    scope = {}
    exec(with_numpy, scope)
    episode = load_file("exported/episode.safetensors")
    hidden = episode["agent_0.hidden"][0]
    for observation, expected in zip(episode["agent_0.observation"][:100], episode["agent_0.action"]):
        action, hidden = scope["act"](observation, hidden)
        assert numpy.abs(action - expected).max() < 1e-4


def test_a_folder_without_a_run_is_refused_in_one_line(tmp_path):
    (tmp_path / "empty").mkdir()
    with pytest.raises(AssertionError, match="is no run folder: it has no config.toml"):
        s2mia("export", tmp_path / "empty", "--onnx", tmp_path / "out")
