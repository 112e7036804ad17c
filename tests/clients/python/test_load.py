"""Policies of a run folder act as the program acts, bit for bit, and what cannot be loaded is refused in one line."""

import copy
import hashlib
import pickle
import re
import shutil

import mujoco
import numpy as np
import pytest
import s2mia
from conftest import HASAC, ROBOT, ROOT, SMALL, s2mia_run
from s2mia.cue import Cue
from safetensors.numpy import load_file

POLICIES = {
    "recurrent with running statistics": ROBOT,
    "without memory": [*ROBOT, "policy.core=mlp"],
    "with a layer norm": [*ROBOT, "policy.input_norm=layer_norm", "observation.norm=none"],
    "squashed": [*ROBOT, "algorithm=maddpg"],
    "squashed with own deviations": [*ROBOT, *HASAC],
    "of choices": ["cue-2x1", "run.seed=3", "run.iterations=10", "run.actors=1"],
}


@pytest.fixture(scope="module", params=POLICIES)
def played(request, tmp_path_factory):
    """A run folder, and the observations and actions, by agent, of an episode that the program played."""
    folder = tmp_path_factory.mktemp("played")
    s2mia_run("train", *POLICIES[request.param], f"run.dir={folder / 'run'}")
    s2mia_run("export", folder / "run", "--onnx", folder / "onnx")
    episode = load_file(folder / "onnx" / "episode.safetensors")
    agents = sorted({name.split(".")[0] for name in episode})
    return folder / "run", *({agent: episode[f"{agent}.{part}"] for agent in agents} for part in ("observation", "action"))


def test_an_episode_is_acted_with_the_bits_of_the_program(played):
    run, observations, actions = played
    with s2mia.load(run) as team:
        assert [agent.name for agent in team.agents] == list(actions)
        for step in range(len(actions["agent_0"])):
            acted = team.act({agent: rows[step] for agent, rows in observations.items()})
            for agent, own in acted.items():
                assert own.tobytes() == actions[agent][step].astype(own.dtype).tobytes(), (agent, step)


def test_a_copy_of_policies_begins_as_they_did(played):
    run, observations, actions = played
    team = s2mia.load(run)
    first = {agent: rows[0] for agent, rows in observations.items()}
    team.act(first)
    for again in (copy.deepcopy(team), pickle.loads(pickle.dumps(team))):
        for agent, own in again.act(first).items():
            assert own.tobytes() == actions[agent][0].astype(own.dtype).tobytes(), agent


def test_an_array_of_all_agents_has_the_actions_of_the_dictionary(played):
    run, observations, _ = played
    by_name, by_array = s2mia.load(run), s2mia.load(run)
    for step in range(3):
        rows = {agent: own[step] for agent, own in observations.items()}
        named = by_name.act(rows)
        assert (by_array.act(np.stack(list(rows.values()))) == np.stack(list(named.values()))).all()


def test_environments_in_one_batch_act_as_each_alone(played):
    run, observations, _ = played
    starts = [0, 7, 20]
    together, alone = s2mia.load(run), [s2mia.load(run) for _ in starts]
    for step in range(10):
        if step == 5:
            together.reset([False, True, False])
            together.reset([])
            alone[1].reset()
        batch = np.stack([[rows[start + step] for rows in observations.values()] for start in starts])
        acted = together.act(batch)
        assert (acted == np.stack([team.act(rows) for team, rows in zip(alone, batch, strict=True)])).all()


def test_a_seed_samples_the_same_actions_again_and_others_in_the_next_episode(played):
    run, observations, _ = played
    rows = {agent: np.repeat(own[:1], 50, 0) for agent, own in observations.items()}
    team, again, other = (s2mia.load(run, seed) for seed in (1, 1, 2))

    def joint(team) -> bytes:
        return b"".join(own.tobytes() for own in team.act(rows).values())

    first = joint(team)
    assert first == joint(again) != joint(other)
    team.reset()
    assert joint(team) != first


def test_an_agent_that_is_left_out_keeps_its_recurrent_state(played):
    run, observations, _ = played
    whole, part = s2mia.load(run), s2mia.load(run)
    rows = [{agent: own[step] for agent, own in observations.items()} for step in range(2)]
    whole.act(rows[0])
    part.act(rows[0])
    assert list(part.act({"agent_0": rows[1]["agent_0"]})) == ["agent_0"]
    others = part.act({agent: own for agent, own in rows[1].items() if agent != "agent_0"})
    acted = whole.act(rows[1])
    assert all((own == acted[agent]).all() for agent, own in others.items())


def test_a_team_says_what_it_is(played):
    run, observations, _ = played
    team = s2mia.load(run)
    newest = max((run / "checkpoints").glob("iter_*"))
    assert newest.name == f"iter_{team.description.iteration:08}" and team.description.run == "run"
    assert team.description.policy_sha256 == hashlib.sha256((newest / "policy.safetensors").read_bytes()).hexdigest()
    robot = team.description.task == "halfcheetah-6x1"
    assert team.description.seed == (7 if robot else 3)
    for agent in team.agents:
        assert agent.observation_size == len(agent.features) == observations[agent.name].shape[1]
        assert len(agent.joints) == len(agent.control_ranges) == len(agent.actuators) == (1 if robot else 0)
        assert agent.choices == (None if robot else 3)
    if robot:
        assert team.agents[0].joints == ["bthigh"] and team.agents[0].control_ranges == [[-1, 1]]
        assert "bthigh.velocity" in team.agents[0].features and team.description.dt_secs == 0.05


def test_actuators_have_the_numbers_and_the_law_of_the_model_in_mujoco():
    model = mujoco.MjModel.from_xml_path(str(ROOT / "sim" / "assets" / "quadruped.xml"))
    data, rng = mujoco.MjData(model), np.random.default_rng(0)
    data.qpos[7:], data.qvel[6:], data.ctrl[:] = rng.uniform(-1, 1, 12), rng.uniform(-9, 9, 12), rng.uniform(-2, 2, 12)
    mujoco.mj_forward(model, data)
    agents = s2mia.pretrained("quadruped-4x3").agents
    assert agents[0].actuators == s2mia.parallel_env("quadruped-4x3").task.agents[0].actuators
    actuators = [own for agent in agents for own in agent.actuators]
    assert len(actuators) == model.nu == 12
    for own in actuators:
        row, joint = model.actuator(own.name), data.joint(own.joint)
        assert (own.kind, own.gear, own.torque_range, own.activation) == ("position", row.gear[0], None, None)
        assert [own.gain, own.constant, -own.kp, -own.kd] == [row.gainprm[0], *row.biasprm[:3]]
        assert own.force_range == row.forcerange.tolist() and own.control_limits == pytest.approx(row.ctrlrange)
        control = np.clip(data.actuator(own.name).ctrl[0], *own.control_limits)
        position, speed = own.gear * joint.qpos[0], own.gear * joint.qvel[0]
        force = np.clip(own.gain * control + own.constant - own.kp * position - own.kd * speed, *own.force_range)
        assert own.gear * force == pytest.approx(joint.qfrc_actuator[0], abs=1e-4)


def test_actions_of_different_sizes_are_padded_in_arrays_as_in_the_simulator(tmp_path):
    s2mia_run("train", "humanoid-9x8", *ROBOT[1:], f"run.dir={tmp_path / 'run'}")
    envs = s2mia.vector_env("humanoid-9x8", num_envs=2)
    observations, _ = envs.reset()
    acted, team = s2mia.load(tmp_path / "run").act(observations), s2mia.load(tmp_path / "run")
    named = team.act({agent.name: observations[:, index] for index, agent in enumerate(team.agents)})
    assert acted.shape == envs.action_space.shape == (2, 2, 9)
    assert [own.shape for own in named.values()] == [(2, 9), (2, 8)]
    assert (acted[:, 0] == named["agent_0"]).all() and (acted[:, 1, :8] == named["agent_1"]).all()
    assert not acted[:, 1, 8].any()


def test_a_team_that_comes_with_the_package_acts_with_the_bits_of_the_program(tmp_path, monkeypatch):
    task = "quadruped-4x3"
    s2mia_run("export", task, "--onnx", tmp_path / "onnx")
    monkeypatch.chdir(tmp_path)
    (tmp_path / task).mkdir()
    episode, team = load_file(tmp_path / "onnx" / "episode.safetensors"), s2mia.pretrained(task)
    assert (team.description.run, team.description.task, team.description.seed) == (task, task, 1)
    for step in range(50):
        acted = team.act({agent.name: episode[f"{agent.name}.observation"][step] for agent in team.agents})
        assert all((own == episode[f"{agent}.action"][step]).all() for agent, own in acted.items())


@pytest.mark.parametrize(
    ("task", "message"),
    [
        ("quadrupet-4x3", r"did you mean `quadruped-4x3`\?$"),
        ("cue-2x1", "^the program has no trained team for `cue-2x1`; train one with "),
        ("zebra", "^the program has no trained team for `zebra`; it has teams for .*quadruped-4x3"),
        ("", "^the program has no trained team for ``; it has teams for "),
    ],
)
def test_a_task_without_a_team_is_refused(task, message):
    with pytest.raises(s2mia.RunError, match=message):
        s2mia.pretrained(task)


def test_the_checkpoints_of_another_run_are_refused(trained, tmp_path):
    other = tmp_path / "other"
    s2mia_run("train", *ROBOT, f"run.dir={other}")
    shutil.rmtree(other / "checkpoints")
    shutil.copytree(trained / "checkpoints", other / "checkpoints")
    with pytest.raises(s2mia.RunError, match="it belongs to another run"):
        s2mia.load(other)


def test_a_trained_team_is_paid_for_its_choices(trained):
    team, game = s2mia.load(trained), Cue()
    game.reset(0, 50, np.random.default_rng(1))
    paid = sum(game.step(team.act(np.stack(game.observe()[1]))[:, None])[0] for _ in range(50))
    assert paid > 40, "of 50"


OTHER = "agent_1: observation has shape (2, 9), expected (3, 9) as for the first"


@pytest.mark.parametrize(
    ("observations", "message"),
    [
        (np.zeros((1, 9)), "observations have shape (1, 9), expected (2, 9) or (E, 2, 9)"),
        (np.zeros((4, 2, 7)), "observations have shape (4, 2, 7), expected (2, 9) or (E, 2, 9)"),
        (np.zeros(9), "observations have shape (9,), expected (2, 9) or (E, 2, 9)"),
        (np.zeros((0, 2, 9)), "agent_0: observation has shape (0, 9), expected (9,) or (E, 9)"),
        ({"agent_0": np.zeros(7)}, "agent_0: observation has shape (7,), expected (9,) or (E, 9)"),
        ([np.zeros(9), np.zeros(8)], "the observations have different sizes; give a dictionary by the agents' names"),
        ({"agent_0": np.zeros((3, 9)), "agent_1": np.zeros((2, 9))}, OTHER),
        ({}, "there is no observation"),
        ({"agent0": np.zeros(9)}, "'agent0' is no agent of the team; did you mean 'agent_0'?"),
        ({0: np.zeros(9)}, "0 is no agent of the team; the agents are agent_0, agent_1"),
        (
            {"agent_1": "one"},
            "agent_1: the observation is no array of numbers: could not convert string to float: 'one'",
        ),
        ({"agent_1": np.full(9, np.nan)}, "agent_1: the observation contains a number that is not finite"),
        ({"agent_1": np.full(9, 1e300)}, "agent_1: the observation contains a number that is not finite"),
        ({"agent_1": np.zeros(9, bool)}, "agent_1: the observation is no array of numbers: it has the type bool"),
        ({"agent_1": np.zeros(9, complex)}, "agent_1: the observation is no array of numbers: it has the type complex128"),
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
    assert team.act(np.zeros((2, 2, 9))).shape == (2, 2)


@pytest.mark.parametrize("environments", [[True], [0, 3], [-1], [0.5], "first", [1, 0, 1], np.uint8([0, 0, 1])])
def test_environments_that_do_not_exist_or_are_named_twice_are_not_reset(trained, environments):
    team = s2mia.load(trained)
    team.act(np.zeros((3, 2, 9)))
    with pytest.raises(ValueError, match="^reset needs a mask of 3 environments or indices below 3, not "):
        team.reset(environments)


@pytest.mark.parametrize("environments", [[-1], [0.5], "first", [1, 0, 1], [[True]], [[0]]])
def test_before_the_first_step_wrong_environments_are_refused_as_well(trained, environments):
    team = s2mia.load(trained)
    with pytest.raises(ValueError, match="^reset needs a mask of the environments or indices, not "):
        team.reset(environments)
    with pytest.raises(ValueError, match=r"not \[0 0 0 \.\.\. 0 0 0\]; a mask has the type bool, and no index is given twice$"):
        team.reset(np.zeros(64, np.uint8))
    team.reset([True, False])
    team.reset([3, 1])
    assert team.act(np.zeros((2, 2, 9))).shape == (2, 2)


def test_a_loaded_team_has_no_connection_and_acts_after_it_is_closed(trained):
    with s2mia.load(trained) as team:
        acted = team.act(np.zeros((2, 9)))
    team.reset()
    assert (team.act(np.zeros((2, 9))) == acted).all()


def test_a_copy_of_a_trained_team_or_of_a_checkpoint_can_be_made_in_another_folder(trained, tmp_path, monkeypatch):
    monkeypatch.chdir(trained.parent)
    newest = sorted((trained / "checkpoints").glob("iter_*"))[-1].relative_to(trained.parent)
    kept = [pickle.dumps(s2mia.load("ant-4x2")), pickle.dumps(s2mia.load(trained.name, checkpoint=newest))]
    monkeypatch.chdir(tmp_path)
    for team in map(pickle.loads, kept):
        assert team.agents


def test_a_copy_has_the_checkpoint_of_its_policies_after_the_run_has_grown(tmp_path):
    run = tmp_path / "run"
    few = ["run.iterations=1", "checkpoint.every=1", "evaluation.every_steps=1", "run.actors=1"]
    s2mia_run("train", *SMALL, *few, f"run.dir={run}")
    teams = [s2mia.load(run), s2mia.load(run, checkpoint="best")]
    kept = pickle.dumps(teams)
    s2mia_run("train", "--resume", run, "run.iterations=2")
    assert s2mia.load(run).description.iteration == 2
    for again in [*copy.deepcopy(teams), *pickle.loads(kept)]:
        assert again.description == teams[0].description
        assert copy.copy(again).description.iteration == 1


def test_a_copy_is_refused_if_its_checkpoint_is_gone_or_has_other_policies(trained, tmp_path):
    run = tmp_path / "run"
    shutil.copytree(trained, run)
    kept = pickle.dumps(s2mia.load(run))
    shutil.rmtree(run)
    few = ["run.iterations=10", "checkpoint.every=5", "evaluation.every_steps=0", "run.actors=1"]
    s2mia_run("train", *SMALL, *few, "run.seed=4", f"run.dir={run}")
    sha256 = r"[0-9a-f]{64}"
    with pytest.raises(s2mia.RunError, match=rf"^the policies of iteration 10 in \S+ have SHA-256 {sha256}, the copied ones {sha256}; "):
        pickle.loads(kept)
    shutil.rmtree(run / "checkpoints" / "iter_00000010")
    with pytest.raises(s2mia.RunError, match="has no checkpoint of iteration 10, only of 5$"):
        pickle.loads(kept)


@pytest.mark.parametrize("seed", [-1, 2**64, 1.5, True, "1"])
def test_a_seed_is_a_whole_number(trained, seed):
    with pytest.raises(ValueError, match="^seed is .*; it must be a whole number from 0 to 18446744073709551615$"):
        s2mia.load(trained, seed)


def refused(path) -> str:
    """The message with which a path is refused, without that path."""
    with pytest.raises(s2mia.RunError) as raised:
        s2mia.load(path)
    assert "\n" not in str(raised.value)
    return str(raised.value).replace(f"{path}", "PATH")


def test_a_folder_without_policies_is_refused(trained, tmp_path):
    assert refused(tmp_path) == "`PATH` is no run folder: it has no config.toml"
    assert refused(tmp_path / "x") == "there is no run folder `PATH`"
    with pytest.raises(s2mia.RunError, match="^`` is neither a folder nor a task with a trained team; "):
        s2mia.load("")
    shutil.copy(trained / "config.toml", tmp_path)
    assert refused(tmp_path) == "`PATH` is no run folder: it has no manifest.json"
    shutil.copy(trained / "starts.jsonl", tmp_path)
    assert refused(tmp_path).startswith("PATH has no checkpoint yet; ")


def test_a_damaged_checkpoint_is_refused_and_of_a_run_the_one_before_it_is_taken_with_a_warning(tmp_path, capfd):
    run = tmp_path / "run"
    few = ["run.iterations=2", "checkpoint.every=1", "evaluation.every_steps=0", "run.actors=1"]
    s2mia_run("train", *SMALL, *few, f"run.dir={run}")
    policy = run / "checkpoints" / "iter_00000002" / "policy.safetensors"
    whole = policy.read_bytes()
    policy.write_bytes(whole[:-1] + bytes([whole[-1] ^ 1]))
    assert s2mia.load(run).description.iteration == 1
    assert s2mia.load(run, checkpoint=1).description.iteration == 1
    with pytest.raises(s2mia.RunError, match="has no checkpoint of iteration 3, only of 1, 2$"):
        s2mia.load(run, checkpoint=3)
    with pytest.raises(s2mia.RunError, match="^`newest` is no checkpoint; name last, best, an iteration or the folder of a checkpoint$"):
        s2mia.load(run, checkpoint="newest")
    assert re.search(r"WARN \S+/iter_00000002 is damaged and skipped: ", capfd.readouterr().err)
    assert "policy.safetensors" in refused(policy.parent)
    shutil.rmtree(run / "checkpoints" / "iter_00000001")
    assert refused(run).startswith("PATH has no valid checkpoint: ")
