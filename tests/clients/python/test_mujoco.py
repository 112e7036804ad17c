"""Multi-agent MuJoCo: equal to gymnasium-robotics, exactly restored, and the same run with any number of processes."""

import json
import subprocess

import numpy as np
import pytest
import s2mia
from conftest import SMALL, command
from gymnasium_robotics import mamujoco_v1
from s2mia import wire
from s2mia_environment.mujoco import multi_agent
from s2mia_environment.parallel import number_of
from s2mia_environment.partitions import factorization

# The joints of each agent in the nine tasks of the published results, in the order of the action.
CHEETAH = "bthigh bshin bfoot fthigh fshin ffoot".split()
WALKER = "thigh_joint leg_joint foot_joint thigh_left_joint leg_left_joint foot_left_joint".split()
ANT = "hip4 ankle4 hip1 ankle1 hip2 ankle2 hip3 ankle3".split()
TASKS = [
    *(("HalfCheetah", partition, CHEETAH) for partition in ("2x3", "3x2", "6x1")),
    *(("Walker2d", partition, WALKER) for partition in ("2x3", "3x2", "6x1")),
    *(("Ant", partition, ANT) for partition in ("2x4", "4x2", "8x1")),
]
ROBOTS = [("HalfCheetah", "6x1"), ("Walker2d", "2x3"), ("Ant", "4x2")]
EACH_TASK = pytest.mark.parametrize(("scenario", "agent_conf", "joints"), TASKS)


def seed(number: int) -> bytes:
    return number.to_bytes(32, "little")


def sizes(batch) -> list[int]:
    return [agent.action.size for agent in batch.spec.agents]


def bits(batch, number: int) -> bytes:
    state, seen = batch.observe([number])
    return b"".join(row.tobytes() for row in (state, *seen)) + batch.save(number)


class Reference:
    """The environment of gymnasium-robotics with the same partition."""

    def __init__(self, scenario: str, agent_conf: str, **more) -> None:
        parts = factorization(scenario, agent_conf)
        self.env = mamujoco_v1.parallel_env(scenario, agent_conf, agent_factorization=parts, **more)
        self.episode = 0

    def reset(self, robot: int) -> bytes:
        """Starts the next episode. Returns its seed for the batch."""
        self.episode += 1
        begin = seed(100 * robot + self.episode)
        self.seen, _ = self.env.reset(seed=number_of(begin))
        return begin

    def step(self, actions: list[np.ndarray]) -> tuple[float, bool, bool]:
        taken = dict(zip(self.env.possible_agents, (np.clip(rows, -1, 1) for rows in actions), strict=True))
        self.seen, rewards, terminated, truncated, _ = self.env.step(taken)
        first = self.env.possible_agents[0]
        ended = bool(terminated[first])
        return float(rewards[first]), ended, bool(truncated[first]) and not ended


def assert_same_view(batch, robots: list[Reference]) -> None:
    state, seen = batch.observe(range(len(robots)))
    assert np.array_equal(state, np.array([robot.env.state() for robot in robots], np.float32))
    for agent, rows in zip(robots[0].env.possible_agents, seen, strict=True):
        assert np.array_equal(rows, np.array([robot.seen[agent] for robot in robots], np.float32))


@EACH_TASK
def test_every_task_equals_gymnasium_robotics_bit_for_bit(scenario, agent_conf, joints):
    # Short episodes, so that some end by their length and others by a fall.
    batch = multi_agent(scenario, agent_conf, max_episode_steps=25)
    robots = [Reference(scenario, agent_conf, max_episode_steps=25) for _ in range(3)]
    rng = np.random.default_rng(len(joints) + len(agent_conf))
    for number, robot in enumerate(robots):
        batch.reset(number, robot.reset(number))
    ends = set()
    for _ in range(200):
        assert_same_view(batch, robots)
        actions = [rng.uniform(-1.5, 1.5, (len(robots), size)).astype(np.float32) for size in sizes(batch)]
        reward, terminated, truncated = batch.step(range(len(robots)), actions)
        for number, robot in enumerate(robots):
            outcome = (float(reward[number]), bool(terminated[number]), bool(truncated[number]))
            assert outcome == robot.step([rows[number] for rows in actions])
            ends.add(outcome[1:])
        assert_same_view(batch, robots)
        for number in np.flatnonzero(terminated | truncated).tolist():
            batch.reset(number, robots[number].reset(number))
    assert (False, True) in ends
    assert ((True, False) in ends) == (scenario != "HalfCheetah")


@EACH_TASK
def test_the_agents_of_published_tasks_control_consecutive_joints_from_the_thigh_to_the_foot(
    scenario, agent_conf, joints
):
    agents, each = map(int, agent_conf.split("x"))
    batch = multi_agent(scenario, agent_conf)
    assert [list(agent.joints) for agent in batch.spec.agents] == [
        joints[agent * each : (agent + 1) * each] for agent in range(agents)
    ]


# What MuJoCo numbers in the coordinates of Ant's free joint.
ROOT = {
    "position": ["x", "y", "z", "qw", "qx", "qy", "qz"],
    "velocity": ["x", "y", "z", "wx", "wy", "wz"],
}


def own_name(feature: str) -> str:
    """The name that the simulator's own task has for a feature of MuJoCo's state."""
    joint, kind, *number = feature.replace("_joint", "").split(".")
    return f"{joint}.{ROOT[kind][int(number[0])]}.{kind}" if number else f"{joint}.{kind}"


@EACH_TASK
def test_policies_find_the_same_features_and_joints_in_the_same_order_here_and_in_mujoco(scenario, agent_conf, joints):
    own = s2mia.parallel_env(f"{scenario.lower()}-{agent_conf}").task
    there = multi_agent(scenario, agent_conf, observation="full_id").spec
    assert [own_name(feature.name) for feature in there.state[: len(own.state)]] == own.state
    assert {feature.name.split(".")[0] for feature in there.state[len(own.state) :]} <= {"contact"}
    for agent, mine in zip(there.agents, own.agents, strict=True):
        assert [joint.replace("_joint", "") for joint in agent.joints] == [
            joint.replace("hip_", "hip").replace("ankle_", "ankle") for joint in mine.joints
        ]
        assert {(agent.action.low, agent.action.high)} == {tuple(limits) for limits in mine.control_ranges}


def test_an_agent_of_ant_2x4d_has_opposite_legs():
    diagonal = multi_agent("Ant", "2x4d")
    assert [list(agent.joints) for agent in diagonal.spec.agents] == [
        ["hip1", "ankle1", "hip3", "ankle3"],
        ["hip2", "ankle2", "hip4", "ankle4"],
    ]
    data = diagonal.robots[0].data
    hips = {leg: (data.joint(f"hip_{leg}").xanchor - data.body("torso").xpos)[:2] for leg in (1, 2, 3, 4)}
    for one, other in ((1, 3), (2, 4)):
        assert np.allclose(hips[one], -hips[other], atol=0.1), "on opposite sides of the torso"


@pytest.mark.parametrize("observation", ["full_id", "k_nearest"])
def test_contact_forces_that_are_left_out_of_observations_are_left_out_of_every_agents(observation):
    shown, hidden = (
        multi_agent("Ant", "4x2", observation=observation, **settings).spec.agents[0].observation
        for settings in ({}, {"include_cfrc_ext_in_observation": False})
    )
    contacts = [feature.name for feature in shown if feature.name.startswith("contact.")]
    assert contacts and [feature for feature in shown if feature.name not in contacts] == list(hidden)


def test_other_partitions_are_those_of_gymnasium_robotics_and_wrong_ones_are_refused():
    hopper = multi_agent("Hopper", "3x1").spec
    assert [list(agent.joints) for agent in hopper.agents] == [["thigh_joint"], ["leg_joint"], ["foot_joint"]]
    with pytest.raises(ValueError, match="HalfCheetah has 6 joints; agent_conf=3x3 has 3 x 3"):
        multi_agent("HalfCheetah", "3x3")
    with pytest.raises(ValueError, match="observation must be full_id or k_nearest, is all"):
        multi_agent("HalfCheetah", "2x3", observation="all")
    with pytest.raises(ValueError, match="only for HalfCheetah, Walker2d, Ant, not for Hopper"):
        multi_agent("Hopper", "3x1", observation="full_id")


def test_the_order_of_a_partition_decides_which_joint_an_action_moves():
    rng = np.random.default_rng(7)
    actions = [rng.uniform(-1, 1, (1, 4)).astype(np.float32) for _ in range(2)]
    slices, diagonal = multi_agent("Ant", "2x4"), multi_agent("Ant", "2x4d")
    labels = [label for agent in diagonal.spec.agents for label in agent.joints]
    order = [labels.index(joint) for joint in ANT]
    moved = np.concatenate(actions, axis=1)[:, order]
    for batch in (slices, diagonal):
        batch.reset(0, seed(1))
    slices.step([0], [moved[:, :4], moved[:, 4:]])
    diagonal.step([0], actions)
    assert slices.save(0) == diagonal.save(0)


@pytest.mark.parametrize(("scenario", "agent_conf"), ROBOTS)
def test_with_full_id_every_agent_observes_the_state_and_its_number(scenario, agent_conf):
    batch = multi_agent(scenario, agent_conf, observation="full_id")
    near = multi_agent(scenario, agent_conf)
    for one in (batch, near):
        one.reset(0, seed(3))
        one.step([0], [np.full((1, size), 0.3, np.float32) for size in sizes(one)])
    state, seen = batch.observe([0])
    agents = len(batch.spec.agents)
    for agent, rows in enumerate(seen):
        assert np.array_equal(rows, np.concatenate([state, np.eye(agents, dtype=np.float32)[[agent]]], axis=1))
    assert [feature.role for feature in batch.spec.agents[0].observation[-agents:]] == (
        [wire.FEATURE_ROLE_IDENTITY] * agents
    )
    # The same features are near an agent, whatever it observes.
    _, local = near.observe([0])
    for rows, one, other in zip(local, batch.spec.agents, near.spec.agents, strict=True):
        assert list(one.near) == list(other.near) == list(other.seen)
        assert np.array_equal(state[:, list(one.near)], rows)
        assert [batch.spec.state[place].name for place in one.near] == [feature.name for feature in other.observation]


@pytest.mark.parametrize(("scenario", "agent_conf"), ROBOTS)
def test_a_restored_robot_takes_the_same_steps_bit_for_bit(scenario, agent_conf):
    one, other = (multi_agent(scenario=scenario, agent_conf=agent_conf) for _ in range(2))
    rng = np.random.default_rng(0)
    one.reset(0, bytes(32))
    outcome = (0.0, False, False)
    for step in range(40):
        if outcome[1]:
            one.reset(0, seed(step))
        # Into a new robot, and into one that has moved.
        for number in (step, 1000):
            other.restore(number, one.save(0))
            assert bits(other, number) == bits(one, 0), step
        actions = [rng.uniform(-1.5, 1.5, (1, size)).astype(np.float32) for size in sizes(one)]
        outcome = tuple(part[0] for part in one.step([0], actions))
        for number in (step, 1000):
            assert tuple(part[0] for part in other.step([number], actions)) == outcome, step
            assert bits(other, number) == bits(one, 0), step


# CoupledHalfCheetah of gymnasium-robotics 1.4.2 needs an older MuJoCo than 4.
@pytest.mark.parametrize(
    ("scenario", "agent_conf"),
    [("Hopper", "3x1"), ("Humanoid", "9|8"), ("HumanoidStandup", "9|8"), ("InvertedDoublePendulum", None), ("Pusher", "3p")],
)
def test_robots_without_a_batch_are_restored_bit_for_bit_too(scenario, agent_conf):
    one, other = (multi_agent(scenario, agent_conf) for _ in range(2))
    one.reset(bytes(32))
    push = [np.full(agent.action.size, 0.3, np.float32) for agent in one.spec.agents]
    seen = lambda robot: b"".join(row.tobytes() for row in (robot.observe()[0], *robot.observe()[1]))
    for _ in range(5):
        other.restore(one.save())
        assert seen(one) == seen(other)
        assert one.step(push) == other.step(push)
        assert one.save() == other.save()


def test_states_of_other_settings_have_another_kind():
    kinds = {multi_agent("HalfCheetah", "2x3", **more).spec.state_kind for more in ({}, {"ctrl_cost_weight": 50})}
    assert len(kinds) == 2
    with pytest.raises(ValueError, match="agent_conf must be a text such as 2x3, or null for one agent, is 2"):
        multi_agent("Hopper", 2)
    with pytest.raises(ValueError, match="agent_conf=null is not for Ant"):
        multi_agent("Ant", None)
    with pytest.raises(ValueError, match="NotImplementedError: .*; check scenario, agent_conf"):
        multi_agent("Walker", "2x3")


def test_an_episode_ends_at_its_length_although_it_was_restored_on_the_way():
    robot = multi_agent(scenario="HalfCheetah", agent_conf="2x3", max_episode_steps=4)
    assert robot.spec.episode_steps == 4
    still = [np.zeros((1, 3), np.float32)] * 2
    robot.reset(0, bytes(32))
    assert [bool(robot.step([0], still)[2][0]) for _ in range(3)] == [False] * 3
    state = robot.save(0)
    robot.reset(0, bytes(32))
    robot.restore(0, state)
    assert robot.step([0], still)[2][0]


def test_the_number_of_actors_and_of_workers_does_not_change_a_run(offer, tmp_path):
    task = ("s2mia_environment.mujoco:multi_agent", "scenario=HalfCheetah", "agent_conf=3x2")
    states = set()
    for workers, actors in ((1, 1), (2, 2), (1, 2)):
        folder = tmp_path / f"{workers}-{actors}"
        url = offer("--workers", str(workers), *task)
        settings = ["environments.count=4", "environments.per_slot=2", "environments.steps=20",
                    "environments.message_steps=20", "run.iterations=3", "evaluation.every_steps=0"]
        arguments = ("train", *SMALL, *settings, f"run.actors={actors}", f"run.dir={folder}", "--environment", url)
        subprocess.run(command(*arguments), capture_output=True, timeout=300, check=True)
        told = subprocess.run(command("inspect", folder, "--json"), capture_output=True, text=True, check=True)
        states.add(json.loads(told.stdout)["state_sha256"])
    assert len(states) == 1
