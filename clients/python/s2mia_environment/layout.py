"""What the agents of HalfCheetah, Walker2d and Ant observe, and the global state, as columns of the robots' arrays."""

import enum
import types

import mujoco
import numpy as np
from gymnasium.envs.mujoco.walker2d_v5 import Walker2dEnv
from s2mia import wire

from s2mia_environment.rules import Rows

# gymnasium limits velocities in Walker2d's state, m/s and rad/s; agents of gymnasium-robotics observe them unlimited.
WALKER_SPEED = 10.0
# gymnasium-robotics' limit of the contact forces that agents observe.
AGENT_FORCE = 1.0


class View(str, enum.Enum):
    """What an agent observes; the names are those of `observation.mode`."""

    FULL_ID = "full_id"
    """The global state and the agent's one-hot index, as in the published results."""
    K_NEAREST = "k_nearest"
    """Its joints and those near them, as in gymnasium-robotics."""


class Layout:
    """Columns of observations and states. `env` is the `MultiAgentMujocoEnv` whose settings they have."""

    def __init__(self, env, view: View) -> None:
        single = env.single_agent_env.unwrapped
        model, parts = single.model, single.observation_structure
        self.agents, self.view = len(env.possible_agents), view
        self.skipped, self.forces = parts["skipped_qpos"], parts.get("cfrc_ext", 0)
        self.speed = WALKER_SPEED if isinstance(single, Walker2dEnv) else np.inf
        self.force_range = getattr(single, "_contact_force_range", None)
        moves, bodies = model.nq + model.nv, model.nbody
        places = types.SimpleNamespace(
            qpos=np.arange(model.nq),
            qvel=model.nq + np.arange(model.nv),
            cfrc_ext=moves + np.arange(6 * bodies).reshape(bodies, 6),
        )
        self.near = [env._get_obs_agent(agent, places) for agent in range(self.agents)]
        # Columns of the state among positions, velocities and forces; those of the world, body 0, are left out.
        self.state = np.r_[self.skipped : moves, moves + 6 : moves + 6 + self.forces]
        self.names = _names(model)

    def observe(self, rows: Rows) -> tuple[np.ndarray, list[np.ndarray]]:
        """The global states `[n, S]` and the observations `[n, obs]` per agent."""
        state = [rows.position[:, self.skipped :], rows.velocity.clip(-self.speed, self.speed)]
        if self.forces:
            state.append(rows.contact_force[:, 6:].clip(*self.force_range))
        state = np.concatenate(state, axis=1, dtype=np.float32)
        if self.view is View.FULL_ID:
            index = (self._index(agent, len(state)) for agent in range(self.agents))
            return state, [np.concatenate([state, one_hot], axis=1) for one_hot in index]
        force = rows.contact_force.clip(-AGENT_FORCE, AGENT_FORCE)
        every = np.concatenate([rows.position, rows.velocity, force], axis=1, dtype=np.float32)
        return state, [every.take(columns, axis=1) for columns in self.near]

    def state_features(self) -> list:
        """Features of the global state."""
        return [_signal(self.names[column]) for column in self.state]

    def agent(self, agent: int) -> dict:
        """Features of an agent's observation, and their columns in the global state if it has all of them."""
        near = self._in_state(self.near[agent])
        if self.view is View.K_NEAREST:
            observation = [_signal(self.names[column]) for column in self.near[agent]]
            return {"observation": observation, "seen": near, "near": near}
        identity = [
            wire.FeatureSpec(name=f"id.{other}", role=wire.FEATURE_ROLE_IDENTITY) for other in range(self.agents)
        ]
        return {"observation": self.state_features() + identity, "seen": range(len(self.state)), "near": near}

    def _index(self, agent: int, rows: int) -> np.ndarray:
        return np.eye(self.agents, dtype=np.float32)[[agent] * rows]

    def _in_state(self, columns: np.ndarray) -> list[int]:
        place = {int(column): index for index, column in enumerate(self.state)}
        return [place[int(column)] for column in columns] if place.keys() >= set(columns.tolist()) else []


def _signal(name: str):
    return wire.FeatureSpec(name=name, role=wire.FEATURE_ROLE_SIGNAL)


def _names(model: mujoco.MjModel) -> list[str]:
    """Names of all positions, velocities and contact forces."""
    joints = [(model.joint(index).name, model.jnt_type[index]) for index in range(model.njnt)]
    free = mujoco.mjtJoint.mjJNT_FREE
    positions = [name for joint, kind in joints for name in _numbered(f"{joint}.position", 7 if kind == free else 1)]
    velocities = [name for joint, kind in joints for name in _numbered(f"{joint}.velocity", 6 if kind == free else 1)]
    bodies = [model.body(index).name or str(index) for index in range(model.nbody)]
    return positions + velocities + [name for body in bodies for name in _numbered(f"contact.{body}", 6)]


def _numbered(name: str, count: int) -> list[str]:
    return [name] if count == 1 else [f"{name}.{index}" for index in range(count)]
