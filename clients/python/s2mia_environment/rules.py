"""Rewards and ends of HalfCheetah, Walker2d and Ant, for several robots at once, with gymnasium's settings.

The order of operations is also gymnasium's, because another order rounds differently.
"""

import abc
import dataclasses

import mujoco
import numpy as np
from gymnasium.envs.mujoco.ant_v5 import AntEnv
from gymnasium.envs.mujoco.half_cheetah_v5 import HalfCheetahEnv
from gymnasium.envs.mujoco.walker2d_v5 import Walker2dEnv


class Robot:
    """One robot. Its arrays are views of MuJoCo's data."""

    def __init__(self, model: mujoco.MjModel) -> None:
        self.data, self.steps = mujoco.MjData(model), 0
        self.control, self.position, self.velocity = self.data.ctrl, self.data.qpos, self.data.qvel
        self.body_position, self.contact_force = self.data.xpos, self.data.cfrc_ext.reshape(-1)


@dataclasses.dataclass
class Rows:
    """What rewards and observations read of `n` robots, one row each."""

    position: np.ndarray
    """`[n, nq]`."""
    velocity: np.ndarray
    """`[n, nv]`."""
    contact_force: np.ndarray
    """`[n, 6 * bodies]`; without columns if the robot's rules do not use contact forces."""

    @classmethod
    def of(cls, robots: list[Robot], rules: "Rules") -> "Rows":
        """Copies the arrays of these robots."""
        positions, velocities = [robot.position for robot in robots], [robot.velocity for robot in robots]
        forces = [robot.contact_force for robot in robots] if rules.contact_forces else np.empty((len(robots), 0))
        return cls(np.array(positions), np.array(velocities), np.array(forces))


class Rules(abc.ABC):
    """Rewards and ends of a robot. `env` is gymnasium's environment."""

    contact_forces = False
    """Whether observations and rewards depend on contact forces."""

    def __init__(self, env) -> None:
        self.env, self.dt = env, env.dt

    def place(self, robots: list[Robot]) -> np.ndarray:
        """Position along x whose change is rewarded, m, `[n]`."""
        return np.array([robot.position[0] for robot in robots])

    @abc.abstractmethod
    def reward(self, distance: np.ndarray, controls: np.ndarray, rows: Rows) -> np.ndarray:
        """Rewards `[n]` of a step over `distance`, m, `[n]`."""

    @abc.abstractmethod
    def terminated(self, rows: Rows) -> np.ndarray:
        """Whether the robots are in a terminal state, `[n]`."""

    def _forward(self, distance: np.ndarray) -> np.ndarray:
        return self.env._forward_reward_weight * (distance / self.dt)

    def _control_cost(self, controls: np.ndarray) -> np.ndarray:
        return self.env._ctrl_cost_weight * np.sum(np.square(controls), axis=1)


class HalfCheetah(Rules):
    """Never ends."""

    def reward(self, distance: np.ndarray, controls: np.ndarray, rows: Rows) -> np.ndarray:
        return self._forward(distance) - self._control_cost(controls)

    def terminated(self, rows: Rows) -> np.ndarray:
        return np.zeros(len(rows.position), bool)


class Walker2d(Rules):
    """Ends when the torso is too low, too high or too inclined."""

    def reward(self, distance: np.ndarray, controls: np.ndarray, rows: Rows) -> np.ndarray:
        rewards = self._forward(distance) + self._healthy(rows) * self.env._healthy_reward
        return rewards - self._control_cost(controls)

    def terminated(self, rows: Rows) -> np.ndarray:
        return ~self._healthy(rows) & bool(self.env._terminate_when_unhealthy)

    def _healthy(self, rows: Rows) -> np.ndarray:
        z, angle = rows.position[:, 1], rows.position[:, 2]
        (low, high), (least, most) = self.env._healthy_z_range, self.env._healthy_angle_range
        return (low < z) & (z < high) & (least < angle) & (angle < most)


class Ant(Rules):
    """Ends when the torso is too low or too high. Pays for contact forces."""

    contact_forces = True

    def __init__(self, env) -> None:
        super().__init__(env)
        self.torso = env.data.body(env._main_body).id

    def place(self, robots: list[Robot]) -> np.ndarray:
        return np.array([robot.body_position[self.torso, 0] for robot in robots])

    def reward(self, distance: np.ndarray, controls: np.ndarray, rows: Rows) -> np.ndarray:
        rewards = self._forward(distance) + self._healthy(rows) * self.env._healthy_reward
        force = np.clip(rows.contact_force, *self.env._contact_force_range)
        contact_cost = self.env._contact_cost_weight * np.sum(np.square(force), axis=1)
        return rewards - (self._control_cost(controls) + contact_cost)

    def terminated(self, rows: Rows) -> np.ndarray:
        return ~self._healthy(rows) & bool(self.env._terminate_when_unhealthy)

    def _healthy(self, rows: Rows) -> np.ndarray:
        low, high = self.env._healthy_z_range
        z = rows.position[:, 2]
        finite = np.isfinite(rows.position).all(axis=1) & np.isfinite(rows.velocity).all(axis=1)
        return finite & (low <= z) & (z <= high)


_RULES = {HalfCheetahEnv: HalfCheetah, Walker2dEnv: Walker2d, AntEnv: Ant}


def rules_of(env) -> Rules:
    """The rules of gymnasium's environment."""
    return _RULES[type(env)](env)
