"""Multi-agent MuJoCo, whose restored states go on bit for bit, so that a run in it is exact."""

import json
import subprocess

import numpy as np
import pytest
from conftest import SMALL, command
from s2mia_environment.mujoco import multi_agent

ROBOTS = [("HalfCheetah", "6x1"), ("Walker2d", "2x3"), ("Ant", "4x2")]


def bits(environment) -> bytes:
    state, seen = environment.observe()
    return b"".join(row.tobytes() for row in (state, *seen)) + environment.save()


@pytest.mark.parametrize(("scenario", "agent_conf"), ROBOTS)
def test_a_restored_robot_takes_the_same_steps_bit_for_bit(scenario, agent_conf):
    one, other = (multi_agent(scenario=scenario, agent_conf=agent_conf) for _ in range(2))
    sizes = [agent.action.size for agent in one.spec.agents]
    rng = np.random.default_rng(0)
    one.reset(bytes(32))
    other.reset(bytes([7]) * 32)
    outcome = (0.0, False, False)
    for step in range(40):
        if outcome[1]:
            one.reset(bytes([step]) * 32)
        other.restore(one.save())
        assert bits(other) == bits(one), step
        actions = [rng.uniform(-1.5, 1.5, size).astype(np.float32) for size in sizes]
        outcome = one.step(actions)
        assert other.step(actions) == outcome, step
        assert bits(other) == bits(one), step


def test_an_episode_ends_at_its_length_although_it_was_restored_on_the_way():
    robot = multi_agent(scenario="HalfCheetah", agent_conf="2x3", max_episode_steps=4)
    assert robot.spec.episode_steps == 4
    still = [np.zeros(3, np.float32)] * 2
    robot.reset(bytes(32))
    assert [robot.step(still)[2] for _ in range(3)] == [False] * 3
    state = robot.save()
    robot.reset(bytes(32))
    robot.restore(state)
    assert robot.step(still)[2]


def test_a_run_in_mujoco_ends_in_the_same_state_with_one_actor_and_two(offer, tmp_path):
    url = offer("s2mia_environment.mujoco:multi_agent", "scenario=HalfCheetah", "agent_conf=2x3")
    states = []
    for actors in (1, 2):
        folder = tmp_path / str(actors)
        settings = ["environments.count=4", "environments.per_slot=2", "environments.steps=20",
                    "environments.message_steps=20", "run.iterations=3", "evaluation.every_steps=0"]
        arguments = ("train", *SMALL, *settings, f"run.actors={actors}", f"run.dir={folder}", "--environment", url)
        subprocess.run(command(*arguments), capture_output=True, timeout=300, check=True)
        told = subprocess.run(command("inspect", folder, "--json"), capture_output=True, text=True, check=True)
        states.append(json.loads(told.stdout)["state_sha256"])
    assert states[0] == states[1]
