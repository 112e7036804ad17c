"""Vectors of environments: equal for any number of threads, reset as Gymnasium defines it, and padded for unequal agents."""

import os
import subprocess
import sys
import threading
import time

import numpy as np
import pytest
import s2mia
from gymnasium.vector import AutoresetMode, VectorEnv


def rollout(envs, steps: int) -> list[bytes]:
    """All that steps with random actions return."""
    envs.action_space.seed(0)
    seen, _ = envs.reset()
    told = [seen.tobytes()]
    for _ in range(steps):
        *arrays, _ = envs.step(envs.action_space.sample())
        told += [array.tobytes() for array in arrays]
    return [*told, envs.state().tobytes()]


@pytest.mark.parametrize("task", ["walker2d-2x3", "cue-2x1"])
def test_no_number_depends_on_the_number_of_threads(task):
    alone = rollout(s2mia.vector_env(task, 7, seed=3), 80)
    for threads in (2, 3, 100):
        assert rollout(s2mia.vector_env(task, 7, threads=threads, seed=3), 80) == alone
    assert rollout(s2mia.vector_env(task, 7, seed=4), 80) != alone


def test_spaces_have_an_axis_for_environments_and_one_for_agents():
    envs = s2mia.vector_env("ant-4x2", num_envs=3, threads=2)
    assert isinstance(envs, VectorEnv)
    assert envs.metadata["autoreset_mode"] == envs.autoreset_mode == AutoresetMode.NEXT_STEP
    features = len(envs.task.agents[0].features)
    assert envs.observation_space.shape == (3, 4, features) and envs.action_space.shape == (3, 4, 2)
    assert envs.single_observation_space.shape == (4, features) and envs.single_action_space.shape == (4, 2)
    seen, _ = envs.reset()
    assert seen in envs.observation_space and envs.state().shape == (3, len(envs.task.state))
    seen, rewards, terminated, truncated, infos = envs.step(envs.action_space.sample())
    assert seen.shape == (3, 4, features) and rewards.shape == terminated.shape == truncated.shape == (3,)
    assert (rewards.dtype, terminated.dtype, truncated.dtype) == (np.float32, bool, bool)
    assert list(infos) == ["reward_terms", "_reward_terms", "efforts", "_efforts"]


def test_infos_have_each_environments_reward_terms_and_efforts():
    envs = s2mia.vector_env("halfcheetah-2x3", 2, seed=1, environments__steps=10)
    team = s2mia.parallel_env("halfcheetah-2x3", seed=1, environments__steps=10)
    envs.reset(options={"limit": [1000, 4]})
    team.reset()
    actions = np.stack([np.full((2, 3), 0.5), np.full((2, 3), -2)])
    # The gears of the model in N m; controls beyond the range are clamped. The rebuild after ten steps discards no effort.
    gears = dict(zip(envs.task.joints, [120, 90, 60, 120, 60, 30], strict=True))
    for step in range(1, 11):
        _, rewards, *_, infos = envs.step(actions)
        *_, alone = team.step({"agent_0": actions[0, 0], "agent_1": actions[0, 1]})
        for part, values in alone["agent_0"].items():
            assert {name: row[0] for name, row in infos[part].items()} == values, (step, part)
        assert infos["_reward_terms"].tolist() == infos["_efforts"].tolist() == [True, step != 5]
        torque = 0 if step == 5 else -1
        assert {name: row.tolist() for name, row in infos["efforts"].items()} == {
            name: [0.5 * gear, torque * gear] for name, gear in gears.items()
        }
        assert np.allclose(np.sum(list(infos["reward_terms"].values()), 0), rewards, atol=1e-5)
    game = s2mia.vector_env("cue-2x1")
    game.reset()
    assert game.step([[0, 0]])[-1] == {}


def test_an_ended_episode_is_followed_by_a_step_that_starts_the_next():
    envs = s2mia.vector_env("signal-2x1", 2, seed=1)
    actions = np.ones(envs.action_space.shape, np.float32)
    first, _ = envs.reset(options={"limit": [3, 5]})
    ends = []
    for _ in range(5):
        seen, rewards, terminated, truncated, _ = envs.step(actions)
        ends.append((rewards.tolist()[0] == 0, truncated.tolist(), terminated.any()))
        if len(ends) == 4:
            second = seen[0].copy()
    assert [truncated for _, truncated, _ in ends] == [[False] * 2, [False] * 2, [True, False], [False] * 2, [False, True]]
    assert ends[3][0] and not any(terminated for *_, terminated in ends)
    again = s2mia.parallel_env("signal-2x1", seed=1)
    assert list(again.reset()[0].values())[0].tobytes() == first[0][0].tobytes()
    assert list(again.reset()[0].values())[0].tobytes() == second[0].tobytes()


def test_rows_of_unequal_agents_are_padded():
    envs, team = s2mia.vector_env("humanoid-9x8", 2, seed=2), s2mia.parallel_env("humanoid-9x8", seed=2)
    assert envs.single_action_space.shape == (2, 9)
    seen, _ = envs.reset()
    observations, _ = team.reset()
    actions = np.random.default_rng(0).uniform(-1, 1, (2, 2, 9)).astype(np.float32)
    for _ in range(3):
        for row, (name, own) in zip(seen[0], observations.items(), strict=True):
            assert row[: len(own)].tobytes() == own.tobytes() and not row[len(own) :].any(), name
        seen, rewards, *_ = envs.step(actions)
        observations, paid, *_ = team.step({"agent_0": actions[0, 0], "agent_1": actions[0, 1, :8]})
        assert rewards[0] == np.float32(paid["agent_0"])
        # The number that no actuator has changes nothing.
        actions[0, 1, 8] += 1


def test_invalid_actions_name_the_environment_and_step_none():
    envs = s2mia.vector_env("halfcheetah-2x3", 4, threads=4)
    actions = np.zeros(envs.action_space.shape, np.float32)
    with pytest.raises(ValueError, match=r"^no episode has begun; call reset\(\)$"):
        envs.step(actions)
    envs.reset()
    before = envs.state().tobytes()
    for shape in [(4, 6), (3, 2, 3)]:
        with pytest.raises(ValueError, match="the actions have the shape"):
            envs.step(np.zeros(shape))
    actions[3, 1, 2] = np.inf
    with pytest.raises(ValueError, match=r"^the action of agent 1 in environment 3 is inf at index 2; it must be "):
        envs.step(actions)
    with pytest.raises(ValueError, match=r"^seed is \[1, 2, 3, 4\]; it must be a whole number"):
        envs.reset(seed=[1, 2, 3, 4])
    with pytest.raises(ValueError, match="^the joint action is no array of numbers: it has the type bool$"):
        envs.step(actions > 0)
    for limit in ([9, 9], [[9, 9, 9, 9]]):
        with pytest.raises(ValueError, match="^limit has the shape .*; it is a number or has the shape "):
            envs.reset(options={"limit": limit})
    with pytest.raises(ValueError, match="^options has 'reset_mask'; the option is 'limit'$"):
        envs.reset(options={"reset_mask": np.ones(4, bool)})
    assert envs.state().tobytes() == before


ROLLOUT = """
import hashlib, numpy, s2mia
envs = s2mia.vector_env("walker2d-2x3", 6, threads=3, seed=1)
told = hashlib.sha256(envs.reset()[0].tobytes())
for _ in range(5):
    told.update(envs.step(numpy.full(envs.action_space.shape, 0.5))[0].tobytes())
print(told.hexdigest())
"""


def test_environments_whose_threads_cannot_start_are_stepped_in_that_of_python():
    def told(**variables: str) -> str:
        environment = {**os.environ, **variables}
        return subprocess.check_output([sys.executable, "-c", ROLLOUT], env=environment)

    # No address space has room for such a stack, so no thread starts.
    assert told(RUST_MIN_STACK=str(2**60)) == told()


def test_other_threads_of_python_run_while_environments_step():
    envs = s2mia.vector_env("humanoid-17x1", 256)
    envs.reset()
    ticks, over = [], threading.Event()

    def tick():
        while not over.is_set():
            ticks.append(time.perf_counter())
            time.sleep(0.0005)

    thread = threading.Thread(target=tick)
    thread.start()
    try:
        begin = time.perf_counter()
        envs.step(np.zeros(envs.action_space.shape, np.float32))
        end = time.perf_counter()
    finally:
        over.set()
        thread.join()
    assert sum(begin < tick < end for tick in ticks) > 2
