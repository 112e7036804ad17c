"""HalfCheetah, Walker2d and Ant of multi-agent MuJoCo, stepped together and without gymnasium's wrappers.

Observations, rewards and ends are those of gymnasium and gymnasium-robotics, bit for bit; a test compares them.
"""

import struct
from collections.abc import Sequence

import mujoco
import numpy as np
from s2mia import wire

from s2mia_environment.environment import EnvironmentBatch
from s2mia_environment.layout import Layout
from s2mia_environment.parallel import number_of
from s2mia_environment.rules import Robot, Rows, rules_of

# The complete integration state: time, positions, velocities, controls, warm start of the solver.
STATE = mujoco.mjtState.mjSTATE_INTEGRATION
STATE_VERSION = 2
_STEPS = struct.Struct("<q")


class Robots(EnvironmentBatch):
    """The robots of one stream. `env` is the `MultiAgentMujocoEnv` whose settings and joints they have.

    A state consists of the number of steps, MuJoCo's integration state and, for Ant, the positions and contact forces
    of the bodies, which rewards and observations read one substep late.
    """

    def __init__(self, env, task: str, layout: Layout, episode_steps: int) -> None:
        self.single, self.layout, self.limit = env.single_agent_env.unwrapped, layout, episode_steps
        self.model, self.rules = self.single.model, rules_of(self.single)
        self.size = mujoco.mj_stateSize(self.model, STATE)
        order = [joint.act_ids for joints in env.agent_action_partitions for joint in joints]
        self.column = np.argsort(order)
        self.low, self.high = self.single.action_space.low, self.single.action_space.high
        if len({*zip(self.low, self.high, strict=True)}) > 1:
            raise ValueError("the motors of a robot must have one control range; give the others theirs by their gear")
        self.robots: dict[int, Robot] = {}
        self.reset(0, bytes(32))
        box = {"low": self.low[0], "high": self.high[0]}
        self.spec = wire.EnvironmentSpec(
            task=task,
            agents=[
                wire.AgentSpec(
                    name=name,
                    joints=[joint.label for joint in joints],
                    action=wire.ActionSpec(size=len(joints), **box),
                    **layout.agent(agent),
                )
                for agent, (name, joints) in enumerate(
                    zip(env.possible_agents, env.agent_action_partitions, strict=True)
                )
            ],
            state=layout.state_features(),
            dt_secs=self.single.dt,
            episode_steps=episode_steps,
            state_kind=f"mujoco/{mujoco.__version__}/{type(self.single).__name__}",
            state_version=STATE_VERSION,
            max_state_bytes=len(self.save(0)),
        )

    def reset(self, number: int, seed: bytes) -> None:
        robot = self._begin(number)
        # gymnasium's own start, in this robot's data.
        self.single.data = robot.data
        self.single.reset(seed=number_of(seed))
        robot.steps = 0

    def step(self, numbers: Sequence[int], actions: list[np.ndarray]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        robots = [self.robots[number] for number in numbers]
        # `take` keeps the rows contiguous; sums over columns of another layout round differently.
        controls = np.concatenate(actions, axis=1).take(self.column, axis=1)
        controls = controls.clip(self.low, self.high).astype(np.float64)
        before = self.rules.place(robots)
        for robot, control in zip(robots, controls, strict=True):
            robot.control[:] = control
            mujoco.mj_step(self.model, robot.data, self.single.frame_skip)
            if self.rules.contact_forces:
                mujoco.mj_rnePostConstraint(self.model, robot.data)
            robot.steps += 1
        rows, distance = Rows.of(robots, self.rules), self.rules.place(robots) - before
        terminated = self.rules.terminated(rows)
        late = np.array([robot.steps >= self.limit for robot in robots])
        return self.rules.reward(distance, controls, rows), terminated, late & ~terminated

    def observe(self, numbers: Sequence[int]) -> tuple[np.ndarray, list[np.ndarray]]:
        return self.layout.observe(Rows.of([self.robots[number] for number in numbers], self.rules))

    def save(self, number: int) -> bytes:
        robot = self.robots[number]
        numbers = np.empty(self.size)
        mujoco.mj_getState(self.model, robot.data, numbers, STATE)
        return b"".join([_STEPS.pack(robot.steps), numbers.tobytes(), *(late.tobytes() for late in self._late(robot))])

    def restore(self, number: int, state: bytes) -> None:
        if len(state) != self.spec.max_state_bytes:
            raise ValueError(f"a state has {self.spec.max_state_bytes} bytes, this one {len(state)}")
        # A copy, because older versions of MuJoCo take only writable arrays.
        robot, numbers = self._begin(number), np.frombuffer(state, "<f8", offset=_STEPS.size).copy()
        (robot.steps,) = _STEPS.unpack_from(state)
        mujoco.mj_setState(self.model, robot.data, numbers[: self.size], STATE)
        at = self.size
        for late in self._late(robot):
            late.flat = numbers[at : at + late.size]
            at += late.size

    def _begin(self, number: int) -> Robot:
        if number not in self.robots:
            self.robots[number] = Robot(self.model)
        return self.robots[number]

    def _late(self, robot: Robot) -> list[np.ndarray]:
        return [robot.body_position, robot.contact_force] if self.rules.contact_forces else []
