"""Multi-agent MuJoCo (MaMuJoCo) of gymnasium-robotics, whose states can be saved: a run in it is exact.

    python -m s2mia_environment s2mia_environment.mujoco:multi_agent scenario=HalfCheetah agent_conf=2x3
"""

import struct
import sys

import mujoco
import numpy as np
from gymnasium.wrappers import TimeLimit
from gymnasium_robotics import mamujoco_v1

from s2mia_environment.parallel import Parallel

# Everything from which the next step follows: time, positions, velocities, what the solver starts from.
STATE = mujoco.mjtState.mjSTATE_INTEGRATION
STATE_VERSION = 1
_STEPS = struct.Struct("<q")

# MuJoCo would also write each warning into a file where the program stands.
mujoco.set_mju_user_warning(lambda warning: print(warning, file=sys.stderr))


class MultiAgentMujoco(Parallel):
    """One robot whose joints several agents drive.

    A state is the steps done, MuJoCo's own integration state, and what rewards and observations read that is a
    substep behind it: body positions and contact forces.
    """

    def __init__(self, env, task: str) -> None:
        single = env.unwrapped.single_agent_env
        self.model, self.data = single.unwrapped.model, single.unwrapped.data
        self.clock = _time_limit(single)
        self.size = mujoco.mj_stateSize(self.model, STATE)
        super().__init__(env)
        for agent, joints in zip(self.spec.agents, env.unwrapped.agent_action_partitions, strict=True):
            agent.joints.extend(joint.label for joint in joints)
        self.spec.task = task
        self.spec.state_kind = f"mujoco/{mujoco.__version__}/{type(single.unwrapped).__name__}"
        self.spec.state_version = STATE_VERSION
        self.spec.max_state_bytes = len(self.save())

    def step_secs(self) -> float:
        return float(self.env.unwrapped.single_agent_env.unwrapped.dt)

    def episode_steps(self) -> int:
        return int(self.clock._max_episode_steps)

    def save(self) -> bytes:
        numbers = np.empty(self.size)
        mujoco.mj_getState(self.model, self.data, numbers, STATE)
        behind = (array.ravel() for array in self._behind())
        return _STEPS.pack(self.clock._elapsed_steps) + np.concatenate([numbers, *behind]).astype("<f8").tobytes()

    def restore(self, state: bytes) -> None:
        if len(state) != self.spec.max_state_bytes:
            raise ValueError(f"a state has {self.spec.max_state_bytes} bytes, this one {len(state)}")
        numbers = np.frombuffer(state[_STEPS.size :], "<f8")
        mujoco.mj_setState(self.model, self.data, numbers[: self.size], STATE)
        mujoco.mj_forward(self.model, self.data)
        # The line before has gone on with what the solver starts from, and brought up what was behind.
        mujoco.mj_setState(self.model, self.data, numbers[: self.size], STATE)
        at = self.size
        for array in self._behind():
            array.flat = numbers[at : at + array.size]
            at += array.size
        (self.clock._elapsed_steps,) = _STEPS.unpack_from(state)
        self.env.unwrapped.agents = self.env.unwrapped.possible_agents
        self._look(self.env.unwrapped._get_obs())

    def _behind(self) -> list[np.ndarray]:
        return [self.data.xpos, self.data.cfrc_ext]


def _time_limit(env) -> TimeLimit:
    """The wrapper that counts an episode's steps."""
    while not isinstance(env, TimeLimit):
        env = env.env
    return env


def multi_agent(scenario: str, agent_conf: str, **more) -> MultiAgentMujoco:
    """What `gymnasium_robotics.mamujoco_v1.parallel_env` makes of the same settings, with states."""
    env = mamujoco_v1.parallel_env(scenario=scenario, agent_conf=agent_conf, **more)
    return MultiAgentMujoco(env, f"mamujoco/{scenario}-{agent_conf}")
