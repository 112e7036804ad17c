"""Multi-agent MuJoCo (MaMuJoCo) of gymnasium-robotics with saved states, so that runs are exactly repeatable.

    python -m s2mia_environment s2mia_environment.mujoco:multi_agent scenario=HalfCheetah agent_conf=2x3
"""

import hashlib
import json
import struct
import sys
from types import SimpleNamespace

import mujoco
import numpy as np
from gymnasium.wrappers import TimeLimit
from gymnasium_robotics import mamujoco_v1

from s2mia_environment.environment import Environment, EnvironmentBatch, InvalidEnvironment
from s2mia_environment.layout import Layout, View
from s2mia_environment.parallel import Parallel
from s2mia_environment.partitions import ROBOTS, factorization
from s2mia_environment.robots import STATE, Robots

STATE_VERSION = 2
# Arrays of MuJoCo's data that rewards and observations of gymnasium and gymnasium-robotics read and that `mj_forward` changes.
LATE = ("xpos", "xipos", "cinert", "cvel", "cfrc_ext", "qfrc_actuator", "ten_length", "ten_velocity", "ten_J")
_STEPS = struct.Struct("<q")

# By default MuJoCo also writes each warning to a file in the working directory.
mujoco.set_mju_user_warning(lambda warning: print(warning, file=sys.stderr))


class MultiAgentMujoco(Parallel):
    """One robot of any kind, whose joints several agents control, in gymnasium's wrappers.

    A state consists of the number of steps, MuJoCo's integration state, and the arrays that rewards and observations
    read one substep late.
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
        late = (array.ravel() for array in self._late_arrays())
        return _STEPS.pack(self.clock._elapsed_steps) + np.concatenate([numbers, *late]).astype("<f8").tobytes()

    def restore(self, state: bytes) -> None:
        if len(state) != self.spec.max_state_bytes:
            raise ValueError(f"a state has {self.spec.max_state_bytes} bytes, this one {len(state)}")
        # A copy, because older versions of MuJoCo take only writable arrays.
        numbers = np.frombuffer(state, "<f8", offset=_STEPS.size).copy()
        mujoco.mj_setState(self.model, self.data, numbers[: self.size], STATE)
        mujoco.mj_forward(self.model, self.data)
        # mj_forward changed the solver's warm start and the late arrays, so set them again.
        mujoco.mj_setState(self.model, self.data, numbers[: self.size], STATE)
        at = self.size
        for array in self._late_arrays():
            array.flat = numbers[at : at + array.size]
            at += array.size
        (self.clock._elapsed_steps,) = _STEPS.unpack_from(state)
        self.steps = self.clock._elapsed_steps
        self.env.unwrapped.agents = self.env.unwrapped.possible_agents
        self._store(self.env.unwrapped._get_obs())

    def _late_arrays(self) -> list[np.ndarray]:
        return [getattr(self.data, name) for name in LATE]


def _time_limit(env) -> TimeLimit:
    """The wrapper that counts an episode's steps."""
    while not isinstance(env, TimeLimit):
        env = env.env
    return env


def multi_agent(
    scenario: str, agent_conf: str | None, observation: str = View.K_NEAREST, **more
) -> EnvironmentBatch | Environment:
    """`gymnasium_robotics.mamujoco_v1.parallel_env` with the same settings and saved states.

    HalfCheetah, Walker2d and Ant have the partitions of the published results (`partitions.py`), and with
    `observation=full_id` also their observations: the global state and the agent's one-hot index.
    """
    views = [view.value for view in View]
    if observation not in views:
        raise InvalidEnvironment(f"observation must be {' or '.join(views)}, is {observation}")
    if more.get("agent_obsk", 1) is None:
        raise InvalidEnvironment("agent_obsk must be a number; observation=full_id shows the whole state to every agent")
    if agent_conf is not None and not isinstance(agent_conf, str):
        raise InvalidEnvironment(f"agent_conf must be a text such as 2x3, or null for one agent, is {agent_conf}")
    if agent_conf is None and scenario in ROBOTS:
        raise InvalidEnvironment(f"agent_conf=null is not for {scenario}; name a partition of it, such as 2x3 of HalfCheetah")
    parts = factorization(scenario, agent_conf)
    try:
        settings = more if more.get("local_categories") else more | _local_categories(scenario, more)
        env = mamujoco_v1.parallel_env(scenario=scenario, agent_conf=agent_conf, agent_factorization=parts, **settings)
    except (AttributeError, LookupError, NotImplementedError) as error:
        given = ", ".join(["scenario", "agent_conf", *more])
        raise InvalidEnvironment(f"{type(error).__name__}: {error}; check {given}") from error
    # Joints of the same name, which Pusher has, are in the order of a set, which differs between processes.
    for near in getattr(env.unwrapped, "k_dicts", ()):
        for joints in near.values():
            joints.sort(key=lambda joint: (joint.label, str(joint.qpos_ids)))
    task = f"mujoco/{scenario}-{agent_conf}"
    if scenario in ROBOTS:
        steps = _time_limit(env.single_agent_env)._max_episode_steps
        return _with_kind_of(more, Robots(env, task, Layout(env, View(observation)), steps))
    if observation != View.K_NEAREST:
        raise InvalidEnvironment(f"observation={observation} is only for {', '.join(ROBOTS)}, not for {scenario}")
    return _with_kind_of(more, MultiAgentMujoco(env, task))


def _local_categories(scenario: str, more: dict) -> dict:
    """The default `local_categories` without those that `include_CATEGORY_in_observation=false` leaves out, if any."""
    if all(more.get(key, True) for key in more if key.startswith("include_")):
        return {}
    near = SimpleNamespace(agent_obsk=more.get("agent_obsk", 1))
    categories = mamujoco_v1.parallel_env._generate_local_categories(near, scenario)
    shown = [[name for name in depth if more.get(f"include_{name}_in_observation", True)] for depth in categories]
    return {"local_categories": shown}


def _with_kind_of(more: dict, made):
    """The same environment, whose states have a kind of their own: with other settings, they may lead elsewhere."""
    if more:
        text = json.dumps(more, sort_keys=True, default=str)
        made.spec.state_kind += f"/{hashlib.sha256(text.encode()).hexdigest()[:16]}"
    return made
