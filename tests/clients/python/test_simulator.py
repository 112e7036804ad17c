"""The simulator under PettingZoo's and Gymnasium's interfaces: it passes their tests, and bad input is refused in one line."""

import copy
import pathlib
import pickle
import re
import struct
import warnings

import numpy as np
import pytest
import s2mia
from conftest import ROOT
from gymnasium.utils.env_checker import check_env
from pettingzoo.test import parallel_api_test, parallel_seed_test
from test_package import examples


def rest(env):
    """Actions of 0."""
    return {name: np.zeros(env.action_space(name).shape, np.float32) for name in env.possible_agents}


@pytest.mark.parametrize("task", ["ant-4x2", "humanoid-9x8", "cue-2x1", "signal-2x1"])
def test_a_team_passes_the_tests_of_pettingzoo(task):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        parallel_api_test(s2mia.parallel_env(task), num_cycles=120)
    parallel_seed_test(lambda: s2mia.parallel_env(task), num_cycles=60)


@pytest.mark.parametrize("task", ["ant", "humanoid-9x8", "cue-2x1", "signal-2x1"])
def test_one_agent_passes_the_checker_of_gymnasium(task):
    check_env(s2mia.gym_env(task))


def test_one_agent_drives_the_whole_robot_and_observes_the_global_state():
    whole, team = s2mia.gym_env(pathlib.Path("ant"), render_mode="rgb_array"), s2mia.parallel_env("ant-2x4")
    assert whole.task == team.task and whole.action_space.shape == (8,)
    check_env(whole)
    state, _ = whole.reset(seed=3)
    team.reset(seed=3)
    assert np.array_equal(state, team.state()) and state.shape == (len(whole.task.state),)
    action = np.linspace(-1, 1, 8, dtype=np.float32)
    state, reward, *_ = whole.step(action)
    _, rewards, *_ = team.step({"agent_0": action[:4], "agent_1": action[4:]})
    assert np.array_equal(state, team.state()) and set(rewards.values()) == {reward}


def test_agents_observe_the_features_that_the_task_names():
    env = s2mia.parallel_env("walker2d-2x3", observation__mode="k_nearest", observation__nearest=0)
    observations, _ = env.reset()
    sizes = [len(agent.features) for agent in env.task.agents]
    assert [row.shape for row in observations.values()] == [(size,) for size in sizes]
    assert sizes[0] < len(s2mia.parallel_env("walker2d-2x3").task.agents[0].features)
    named = dict(zip(env.task.state, env.state(), strict=True))
    seen = dict(zip(env.task.agents[1].features, observations["agent_1"], strict=True))
    shared = named.keys() & seen.keys()
    assert len(shared) > 3 and all(named[name] == seen[name] for name in shared)
    assert env.task.agents[0].joints == ["thigh", "leg", "foot"]
    assert (env.task.dt_secs, env.task.episode_steps) == (0.008, 1000)


def test_an_algorithm_whose_runs_standardise_observations_standardises_those_of_robots_and_not_of_games():
    def first(task, algorithm):
        return s2mia.parallel_env(task, algorithm=algorithm).reset(seed=1)[0]["agent_0"]

    assert first("ant-4x2", "maddpg").std() == pytest.approx(1, abs=0.01)
    assert first("ant-4x2", "happo").std() < 0.9
    assert np.array_equal(first("jump-4x1", "maddpg"), first("jump-4x1", "happo"))


def test_a_fall_terminates_and_the_limit_truncates():
    ends = {}
    for limit in (5, 1000):
        env = s2mia.parallel_env("walker2d-2x3", seed=2)
        env.reset(options={"limit": limit})
        steps, terminated, truncated = 0, {"agent_0": False}, {"agent_0": False}
        while env.agents:
            _, rewards, terminated, truncated, infos = env.step(dict.fromkeys(env.agents, np.full(3, 0.7)))
            steps += 1
        ends[limit] = terminated, truncated
        assert infos["agent_0"] == infos["agent_1"] and rewards["agent_0"] == rewards["agent_1"]
        assert sum(infos["agent_0"]["reward_terms"].values()) == pytest.approx(rewards["agent_0"], abs=1e-5)
        assert list(infos["agent_0"]["reward_terms"]) == env.task.reward_terms == ["forward_speed", "alive", "control"]
        assert (steps == 5) == (limit == 5)
        with pytest.raises(ValueError, match=r"^no episode is running; call reset\(\)$"):
            env.step(rest(env))
    no, yes = dict.fromkeys(["agent_0", "agent_1"], False), dict.fromkeys(["agent_0", "agent_1"], True)
    assert ends == {5: (no, yes), 1000: (yes, no)}


def test_a_restored_state_continues_with_the_same_bits():
    first, other = s2mia.parallel_env("ant-4x2", seed=5), s2mia.parallel_env("ant-4x2")
    first.reset()
    rng = np.random.default_rng(0)
    actions = [{name: rng.uniform(-1, 1, 2).astype(np.float32) for name in first.agents} for _ in range(20)]
    for action in actions[:10]:
        first.step(action)
    saved = first.save()
    other.restore(bytearray(saved))
    assert other.save() == saved
    for name, row in first.observations().items():
        assert row.tobytes() == other.observations()[name].tobytes()
    for action in actions[10:]:
        seen, rewards, *_ = first.step(action)
        again, paid, *_ = other.step(action)
        assert rewards == paid and all(seen[name].tobytes() == again[name].tobytes() for name in seen)
    assert first.save() == other.save()


@pytest.mark.parametrize("copied", [copy.copy, copy.deepcopy, lambda env: pickle.loads(pickle.dumps(env))])
@pytest.mark.parametrize("made", [s2mia.parallel_env, s2mia.vector_env, s2mia.gym_env])
def test_a_copy_is_an_environment_of_the_same_arguments_before_its_first_episode(made, copied):
    env = made("walker2d-2x3", seed=5, reward__control=0.5)
    env.reset()
    first = env.state()
    env.reset()
    second = env.state()
    other = copied(env)
    assert type(other) is type(env)
    other.reset()
    assert np.array_equal(other.state(), first)
    assert np.array_equal(env.state(), second)


def test_a_copy_of_an_environment_of_a_task_file_can_be_made_in_another_folder(monkeypatch):
    monkeypatch.chdir(ROOT / "sim")
    env = s2mia.parallel_env("assets/hopper.toml", seed=1)
    kept = pickle.dumps(env)
    monkeypatch.chdir("/")
    assert pickle.loads(kept).task == env.task == copy.copy(env).task


@pytest.mark.parametrize(
    ("made", "given", "line"),
    [
        (s2mia.vector_env, {"thread": 2}, "unknown argument 'thread'; did you mean 'threads'?"),
        (s2mia.parallel_env, {"disturbance": "off"}, "unknown argument 'disturbance'; did you mean 'disturbances'?"),
        (s2mia.parallel_env, {"num_envs": 3}, "parallel_env has no argument 'num_envs'; it has 'seed', 'render_mode', 'disturbances'"),
        (s2mia.gym_env, {"disturbances": None}, "disturbances is None; it is 'training', 'evaluation' or 'off'"),
        (s2mia.gym_env, {"task": 3}, "task is 3; it is a name or the path of a task file"),
        (s2mia.parallel_env, {"task": b"cue-2x1"}, "task is b'cue-2x1'; it is a name or the path of a task file"),
    ],
)
def test_wrong_arguments_are_refused_in_one_line(made, given, line):
    with pytest.raises(ValueError, match=f"^{re.escape(line)}$"):
        made(**{"task": "ant-4x2", **given})


def test_a_setting_that_changes_no_environment_is_refused_as_such():
    with pytest.raises(ValueError, match=r"^settings: `policy.width` has no effect on an environment; "):
        s2mia.parallel_env("ant-4x2", policy__width=3)


def test_the_infos_of_agents_are_their_own():
    env = s2mia.parallel_env("ant-4x2")
    env.reset()
    infos = env.step(rest(env))[-1]
    infos["agent_0"]["reward_terms"].clear()
    assert infos["agent_1"]["reward_terms"].keys() == set(env.task.reward_terms)


@pytest.mark.parametrize("separator", [".", "__"])
@pytest.mark.parametrize("key", ["mode", "nearest", "globals"])
def test_the_single_agent_refuses_settings_of_what_agents_observe(key, separator):
    with pytest.raises(ValueError, match=f"^observation.{key} has no effect: the agent of gym_env observes the global state$"):
        s2mia.gym_env("ant", **{f"observation{separator}{key}": 1})


@pytest.mark.parametrize("key", ["run__seed", "run.seed"])
def test_two_different_seeds_are_refused(key):
    with pytest.raises(ValueError, match=r"^seed is 3 and run.seed is 4; give one of them$"):
        s2mia.parallel_env("ant-4x2", seed=3, **{key: 4})


def test_only_an_episode_that_has_begun_is_saved():
    env, other = s2mia.parallel_env("ant-4x2", seed=5), s2mia.parallel_env("ant-4x2", seed=5)
    with pytest.raises(ValueError, match=r"^no episode has begun; call reset\(\)$"):
        env.save()
    env.reset()
    other.reset()
    assert np.array_equal(env.state(), other.state())


def test_actions_beyond_the_limits_move_as_clamped_ones_and_cost_as_they_are():
    def stepped(size):
        env = s2mia.parallel_env("ant-4x2", seed=1)
        env.reset()
        observations, rewards, *_ = env.step(dict.fromkeys(env.agents, np.full(2, size)))
        return [row.tobytes() for row in observations.values()], rewards["agent_0"]

    (seen, paid), (same, less), (_, least) = stepped(1), stepped(2), stepped(1e6)
    # Eight squares of 2 instead of 1, with a weight of 0.5.
    assert seen == same and paid - less == pytest.approx(0.5 * 8 * 3, abs=1e-4) and np.isfinite(least)
    with pytest.raises(ValueError, match="is 1e38 at index 0; it must be a number from -1e6 to 1e6$"):
        stepped(1e38)


def test_seeds_may_be_numbers_of_numpy():
    for env in (s2mia.gym_env("ant"), s2mia.vector_env("ant-4x2"), s2mia.parallel_env("ant-4x2")):
        env.reset(seed=3)
        state = env.state()
        env.reset(seed=np.int64(3))
        assert np.array_equal(env.state(), state)


def test_a_run_with_other_steps_of_backpropagation_can_be_repeated():
    s2mia.parallel_env("ant-4x2", policy__backpropagation_steps=5, environments__steps=25).reset()


def test_a_fault_ends_the_episode_with_a_word_in_the_infos():
    team, one, envs = s2mia.parallel_env("ant-4x2"), s2mia.gym_env("ant"), s2mia.vector_env("ant-4x2", 2)
    team.reset()
    one.reset()
    envs.reset()
    whole = team.save()
    # One of the velocities, so fast that the next step leaves the bounds.
    spoilt = whole[:108] + struct.pack("<f", 999) + whole[112:]
    team.restore(spoilt)
    one.restore(spoilt)
    envs.simulator.native.restore(1, spoilt)
    _, rewards, terminated, truncated, infos = team.step(rest(team))
    names = team.possible_agents
    terms, efforts = (dict.fromkeys(names, 0.0) for names in (team.task.reward_terms, team.task.joints))
    info = {"fault": True, "reward_terms": terms, "efforts": efforts}
    assert infos == dict.fromkeys(names, info) and team.agents == []
    assert (rewards, terminated, truncated) == tuple(dict.fromkeys(names, value) for value in (0, False, True))
    assert one.step(np.zeros(8))[1:] == (0, False, True, info)
    _, rewards, terminated, truncated, infos = envs.step(np.zeros((2, 4, 2)))
    assert truncated.tolist() == infos["fault"].tolist() == infos["_fault"].tolist() == [False, True]
    assert rewards[1] == 0 != rewards[0] and not terminated.any()


def test_what_a_step_returned_does_not_change_with_the_next():
    env = s2mia.parallel_env("ant-4x2")
    env.reset()
    kept, *_ = env.step(rest(env))
    copies = {name: row.copy() for name, row in kept.items()}
    kept["agent_1"][0] = 7
    env.step(rest(env))
    for name, row in kept.items():
        assert np.array_equal(row[1:], copies[name][1:]) and (row[0] == copies[name][0]) == (name != "agent_1")


def test_pictures_show_how_the_robot_moves():
    env = s2mia.parallel_env("halfcheetah-2x3", render_mode="rgb_array")
    env.reset()
    before = env.render()
    assert before.dtype == np.uint8 and before.shape == (270, 480, 3)
    assert len(np.unique(before.reshape(-1, 3), axis=0)) > 5
    for _ in range(5):
        env.step(dict.fromkeys(env.agents, np.ones(3, np.float32)))
    assert np.count_nonzero(before != env.render()) > 1000


def test_disturbances_act_as_in_training_unless_others_are_chosen():
    def starts(**chosen):
        env = s2mia.parallel_env("halfcheetah-pushed-2x3", seed=1, **chosen)
        seen = []
        env.reset()
        for _ in range(60):
            seen.append(env.step(rest(env))[0]["agent_0"].tobytes())
        return seen

    assert starts() == starts(disturbances="training")
    assert starts() != starts(disturbances="off") == starts(disturbances="evaluation")


def test_a_weight_of_the_reward_is_a_setting():
    rewards = {}
    for weight in (0.1, 0.3):
        env = s2mia.parallel_env("halfcheetah-2x3", seed=1, reward__control=weight)
        env.reset()
        rewards[weight] = env.step(dict.fromkeys(env.agents, np.full(3, 0.5, np.float32)))[1]["agent_0"]
    # Six actions of 0.5 have squares of 1.5 in sum.
    assert rewards[0.1] - rewards[0.3] == pytest.approx(0.2 * 1.5, abs=1e-6)


def test_a_task_file_is_an_environment():
    file = ROOT / "sim" / "assets" / "hopper.toml"
    env = s2mia.parallel_env(file, seed=1)
    env.reset()
    env.step(rest(env))
    assert env.task.name.startswith("hopper-")


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: s2mia.parallel_env("ant-4x3"), "settings: unknown task `ant-4x3`; did you mean `ant-4x2`?"),
        (lambda: s2mia.gym_env("ants"), "unknown robot 'ants'; did you mean 'ant'?"),
        (lambda: s2mia.gym_env("halfcheetah-2x2"), "did you mean `halfcheetah-2x3`?"),
        (lambda: s2mia.gym_env("zebra"), "settings: unknown task `zebra`"),
        (lambda: s2mia.parallel_env("no.toml"), "no.toml: there is no such task file"),
        (lambda: s2mia.parallel_env("ant-4x2", observation__mod="full_id"), "did you mean `observation.mode`?"),
        (lambda: s2mia.parallel_env("ant-4x2", observation__mode="eyes"), "observation.mode"),
        (lambda: s2mia.parallel_env("ant-4x2", update__gamma=0.9), "`update.gamma` has no effect on an environment"),
        (lambda: s2mia.parallel_env("ant-4x2", seed=-1), "seed is -1; it must be a whole number from 0 to"),
        (lambda: s2mia.parallel_env("ant-4x2", seed=2**63), "a whole number from 0 to 9223372036854775807"),
        (lambda: s2mia.parallel_env("ant-4x2").reset(seed=2**63), "a whole number from 0 to 9223372036854775807"),
        (lambda: s2mia.parallel_env("ant-4x2", observation__norm="none"), "`observation.norm` has no effect on an environment"),
        (lambda: s2mia.parallel_env("ant-4x2", disturbances="on"), "disturbances is \"on\"; it is training, evaluation or off"),
        (lambda: s2mia.parallel_env("ant-4x2", render_mode="human"), "render_mode is 'human'"),
        (lambda: s2mia.parallel_env("cue-2x1", render_mode="rgb_array"), "cue-2x1 is a game: there is nothing to draw"),
        (lambda: s2mia.vector_env("ant-4x2", 0), "num_envs is 0; it must be a whole number from 1 to 65536"),
        (lambda: s2mia.vector_env("ant-4x2", 1.5), "num_envs is 1.5; it must"),
        (lambda: s2mia.vector_env("ant-4x2", True), "num_envs is True; it must"),
        (lambda: s2mia.vector_env("ant-4x2", 2**70), "num_envs is 1180591620717411303424; it must"),
        (lambda: s2mia.vector_env("ant-4x2", 4, threads=0), "threads is 0; it must be a whole number from 1 to 1024"),
        (lambda: s2mia.vector_env("ant-4x2", 4, threads="2"), "threads is '2'; it must"),
        (lambda: s2mia.parallel_env(None), "task is None; it is a name or the path of a task file"),
    ],
)
def test_environments_that_cannot_be_made_are_refused_in_one_line(make, message):
    with pytest.raises(ValueError) as raised:
        make()
    assert message in str(raised.value) and "\n" not in str(raised.value)


@pytest.mark.parametrize(
    ("use", "message"),
    [
        (lambda env: env.step(rest(env) | {"agent_2": np.zeros(3)}), "the action of agent_2 has the shape (3,), not (2,)"),
        (lambda env: env.step(rest(env) | {"agent_2": [0, np.nan]}), "the action of agent 2 in environment 0 is NaN at index 1; it must"),
        (lambda env: env.step(rest(env) | {"agent_2": [0, 1e300]}), "agent 2 in environment 0 is inf at index 1; it must"),
        (lambda env: env.step(rest(env) | {"agent_2": [True, True]}), "agent_2 is no array of numbers: it has the type bool"),
        (lambda env: env.step(rest(env) | {"agent_2": ["1", "0"]}), "agent_2 is no array of numbers: it has the type <U1"),
        (lambda env: env.step(rest(env) | {"agent_2": [1j, 0]}), "agent_2 is no array of numbers: it has the type complex128"),
        (lambda env: env.step(rest(env) | {"agent_4": np.zeros(2)}), "needed are those of agent_0, agent_1, agent_2, agent_3"),
        (lambda env: env.step({}), "the dictionary of actions is empty; it needs an action for each of agent_0"),
        (lambda env: env.step([0.0]), "actions is a list; it maps the name of each agent to its action"),
        (lambda env: env.reset(options=[9]), "options is a list; it is a mapping such as {'limit': 200}"),
        (lambda env: env.restore(b"s2st"), "invalid environment state: it has 4 bytes; a state of rapier/ant has "),
        (lambda env: env.restore("x"), "the state is a str; it is the bytes that save() returns"),
        (lambda env: env.reset(seed=-1), "seed is -1; it must be a whole number from 0 to"),
        (lambda env: env.reset(options={"limit": 0}), "limit is 0; it must be a whole number from 1 to 1000"),
        (lambda env: env.reset(options={"limit": 1.5}), "limit is 1.5; it must"),
        (lambda env: env.reset(options={"limit": True}), "limit is True; it must"),
        (lambda env: env.reset(options={"limit": None}), "limit is None; it must"),
        (lambda env: env.reset(options={"limit": 'a'}), "limit is 'a'; it must"),
        (lambda env: env.reset(options={"limit": 2**80}), "limit is 1208925819614629174706176; it must"),
        (lambda env: env.reset(options={"limit": np.nan}), "limit is nan; it must"),
        (lambda env: env.reset(options={"limit": [9, 9]}), "the shape (2,); it is a number or has the shape (1,)"),
        (lambda env: env.reset(options={"limt": 3}), "options has 'limt'; the option is 'limit'"),
        (lambda env: env.render(), "render_mode='rgb_array'"),
    ],
)
def test_what_an_environment_refuses_changes_nothing(use, message):
    env = s2mia.parallel_env("ant-4x2")
    env.reset(seed=4)
    before = env.save()
    with pytest.raises(ValueError) as raised:
        use(env)
    assert message in str(raised.value) and "\n" not in str(raised.value)
    assert env.save() == before and env.agents == env.possible_agents


def test_a_state_of_another_task_and_a_choice_that_does_not_exist_are_refused():
    walker, cheetah, cue = (s2mia.parallel_env(task) for task in ("walker2d-2x3", "halfcheetah-2x3", "cue-2x1"))
    for env in (walker, cheetah, cue):
        env.reset()
    with pytest.raises(ValueError, match=r"^invalid environment state: it is not a state of rapier/halfcheetah$"):
        cheetah.restore(walker.save())
    with pytest.raises(ValueError, match=r"^the action of agent 1 in environment 0 is 3, not one of 3 choices$"):
        cue.step({"agent_0": 0, "agent_1": np.array([3])})


def test_the_documented_examples_run(capsys):
    team, vector, one = examples("Simulator in Python")
    exec(team, {})
    assert "features of agent_0: ['" in capsys.readouterr().out
    exec(vector, {})
    assert "observations: (64, 2, 19) states: (64, 17) rewards: (64,)" in capsys.readouterr().out
    exec(one, {})
    assert capsys.readouterr().out == "the same bits: True picture: (270, 480, 3)\n"
