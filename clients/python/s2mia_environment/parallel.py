"""A PettingZoo `ParallelEnv` as an environment for s2mia."""

import hashlib
import inspect
import math
import numbers as kinds
import traceback
from collections.abc import Mapping

import numpy as np
from s2mia import wire

from s2mia_environment.environment import Environment, InvalidEnvironment
from s2mia_environment.notes import note
from s2mia_environment.observations import LIMIT, flat, numbers, wrong

try:
    from gymnasium import spaces
except ModuleNotFoundError as missing:
    raise ModuleNotFoundError("s2mia_environment needs gymnasium: pip install 's2mia[environment]'") from missing

# Defaults for environments that do not define their episode length or step time.
EPISODE_STEPS = 1000
STEP_SECS = 0.05
LONGEST_EPISODE = 2**32 - 1
# Attributes that define the episode length; the first that an environment has counts.
_LENGTHS = ("max_cycles", "max_steps", "max_episode_steps")


def number_of(seed: bytes) -> int:
    """The seed of an episode as a number below 2^32."""
    return int.from_bytes(hashlib.sha256(seed).digest()[:4], "little")


class Box:
    """A continuous action. Actors map -1 and 1 to the range in `spec`: that of all dimensions, or -1 to 1 if they differ."""

    def __init__(self, space: spaces.Box) -> None:
        low, high = space.low.astype(np.float64).ravel(), space.high.astype(np.float64).ravel()
        # The largest number of a type is a way to write that there is no bound.
        if not np.all(np.abs([low, high]) < np.finfo(np.float32).max):
            raise InvalidEnvironment(f"actions must have finite bounds, not {space}; state the range that has an effect")
        self.space, self.low, self.high = space, low, high
        one_range = np.unique(low).size == np.unique(high).size == 1
        own = (low[0], high[0]) if one_range else (-1.0, 1.0)
        self.middle, self.half = (0.0, 1.0) if one_range else (low / 2 + high / 2, high / 2 - low / 2)
        self.spec = wire.ActionSpec(size=low.size, low=own[0], high=own[1])

    def action(self, numbers: np.ndarray) -> np.ndarray:
        """The action of the environment, for numbers in the range of `spec`: clamped to the range of each dimension."""
        return self._of_type(np.clip(self.middle + self.half * numbers.astype(np.float64), self.low, self.high))

    def _of_type(self, scaled: np.ndarray) -> np.ndarray:
        """The nearest action that the space contains."""
        shape, kind, low, high = self.space.shape, self.space.dtype, self.space.low, self.space.high
        if np.issubdtype(kind, np.floating):
            return np.clip(scaled.reshape(shape).astype(kind), low, high)
        # Python's integers, because floats do not have all limits of 64-bit types.
        limits = zip(np.rint(scaled).tolist(), low.ravel().tolist(), high.ravel().tolist(), strict=True)
        return np.array([min(max(int(x), least), most) for x, least, most in limits], kind).reshape(shape)


class Choice:
    """A discrete action."""

    def __init__(self, space: spaces.Discrete) -> None:
        self.start, self.count = int(space.start), int(space.n)
        self.spec = wire.ActionSpec(size=1, low=0.0, high=float(space.n - 1), choices=self.count)

    def action(self, numbers: np.ndarray) -> int:
        """The choice in the environment's numbering."""
        index = float(numbers[0])
        if not (index.is_integer() and 0 <= index < self.count):
            raise InvalidEnvironment(f"an action is {index}, expected a choice from 0 to {self.count - 1}")
        return self.start + int(index)


ACTIONS = {spaces.Box: Box, spaces.Discrete: Choice}


def action_of(space: spaces.Space):
    """The action type of a space."""
    for kind, action in ACTIONS.items():
        if isinstance(space, kind):
            return action(space)
    raise InvalidEnvironment(f"actions must be one Box or one Discrete per agent, not {space}")


def features(name: str, count: int) -> list:
    """Features named by their index."""
    signal = wire.FEATURE_ROLE_SIGNAL
    return [wire.FeatureSpec(name=f"{name}.{index}", role=signal) for index in range(count)]


class Parallel(Environment):
    """All agents step at once and share one reward, the mean of theirs; the first agent's end ends the episode.

    An agent that is terminated and truncated is terminated. The global state is the environment's `state()`, or the
    concatenated observations if it has none. States are not saved: an episode is restored by replaying it.
    """

    def __init__(self, env) -> None:
        self.env = env
        self.agents = _agents(env)
        self.spaces = [env.observation_space(agent) for agent in self.agents]
        self.actions = [action_of(env.action_space(agent)) for agent in self.agents]
        self.seen: list[np.ndarray] = []
        self.steps = 0
        self.reset(bytes(32))
        first = self.seen
        self.reset(bytes(32))
        if not all(np.array_equal(*pair) for pair in zip(first, self.seen, strict=True)):
            text = "reset() ignores its seed: two episodes with one seed begin with different observations"
            note("seed", f"{text}. A run can be trained, but neither repeated nor resumed exactly")
        self.has_state = _has_state(env)
        state, observations = self.observe()
        self.spec = wire.EnvironmentSpec(
            task=str(env.metadata.get("name", type(env.unwrapped).__name__)),
            agents=[
                wire.AgentSpec(name=str(agent), observation=features(str(agent), row.size), action=action.spec)
                for agent, row, action in zip(self.agents, observations, self.actions, strict=True)
            ],
            state=features("state", state.size),
            dt_secs=self.step_secs(),
            episode_steps=self.episode_steps(),
        )

    def close(self) -> None:
        self.env.close()

    def step_secs(self) -> float:
        """Seconds per step, for display."""
        rate = self.env.metadata.get("render_fps") or 1.0 / STEP_SECS
        if not isinstance(rate, kinds.Real) or not 0.0 < rate < math.inf:
            raise InvalidEnvironment(f"metadata['render_fps'] is {rate!r}; it must be a number above 0")
        return 1.0 / float(rate)

    def episode_steps(self) -> int:
        """Steps after which the client truncates an episode."""
        base = self.env.unwrapped
        for name in _LENGTHS:
            if declares(base, name) and (steps := getattr(base, name)):
                if steps == math.inf:
                    break
                is_whole = isinstance(steps, kinds.Real) and float(steps).is_integer()
                if not (is_whole and 0 < steps <= LONGEST_EPISODE):
                    raise InvalidEnvironment(f"{name} is {steps!r}; it must be a whole number from 1 to {LONGEST_EPISODE:,}")
                return int(steps)
        names = " or ".join(_LENGTHS)
        note("length", f"an episode is truncated after {EPISODE_STEPS} steps; the environment has no {names}")
        return EPISODE_STEPS

    def reset(self, seed: bytes) -> None:
        self.steps = 0
        answer = self.env.reset(seed=number_of(seed))
        if not isinstance(answer, tuple) or len(answer) != 2:
            raise InvalidEnvironment("reset() must return two dictionaries: observations and infos")
        self._store(answer[0])

    def step(self, actions: list[np.ndarray]) -> tuple[float, bool, bool]:
        taken = {
            agent: kind.action(numbers) for agent, kind, numbers in zip(self.agents, self.actions, actions, strict=True)
        }
        answer = self.env.step(taken)
        self.steps += 1
        if not isinstance(answer, tuple) or len(answer) != 5:
            names = "observations, rewards, terminations, truncations and infos"
            raise InvalidEnvironment(f"step() must return five dictionaries: {names}")
        observations, rewards, terminations, truncations, _ = answer
        self._store(observations)
        rewards = self._of_agents("rewards", rewards)
        for agent, reward in zip(self.agents, rewards, strict=True):
            self._demand_reward(agent, reward)
        terminated = self._any("terminations", terminations)
        truncated = self._any("truncations", truncations)
        return float(np.mean(rewards, dtype=np.float64)), terminated, truncated and not terminated

    def observe(self) -> tuple[np.ndarray, list[np.ndarray]]:
        return self.state(), self.seen

    def state(self) -> np.ndarray:
        """The global state."""
        return numbers(f"{self._place()}: state()", self.env.state()) if self.has_state else np.concatenate(self.seen)

    def _store(self, observations: Mapping) -> None:
        rows = zip(self.agents, self.spaces, self._of_agents("observations", observations), strict=True)
        place = self._place()
        self.seen = [flat(f"{place}: the observation of agent {agent}", space, row) for agent, space, row in rows]

    def _place(self) -> str:
        return f"step {self.steps} of an episode" if self.steps else "reset()"

    def _of_agents(self, what: str, found: Mapping) -> list:
        """The entries of all agents in a dictionary that the environment returned."""
        if not isinstance(found, Mapping):
            kind = type(found).__name__
            raise InvalidEnvironment(f"{self._place()}: {what} must be a dictionary of all agents, not {kind}")
        missing = [agent for agent in self.agents if agent not in found]
        if missing or len(found) > len(self.agents):
            more = [agent for agent in found if agent not in self.agents]
            problem = f"has no agent {_names(missing)}" if missing else f"has the unknown agent {_names(more)}"
            rule = "all agents of possible_agents, and no others, take part from the first step to the last"
            raise InvalidEnvironment(f"{self._place()}: {what} {problem}; {rule}")
        return [found[agent] for agent in self.agents]

    def _demand_reward(self, agent, reward) -> None:
        value = np.asarray(reward)
        what = f"{self._place()}: the reward of agent {agent} is"
        if value.dtype.kind not in "biuf" or value.shape != ():
            raise InvalidEnvironment(f"{what} {reward!r}, expected a number")
        if not abs(float(value)) <= LIMIT:
            raise InvalidEnvironment(f"{what} {wrong(float(value))}")

    def _any(self, what: str, found: Mapping) -> bool:
        flags = self._of_agents(what, found)
        for agent, flag in zip(self.agents, flags, strict=True):
            # A text or an array would count as true.
            if np.shape(flag) != () or flag not in (0, 1):
                place = self._place()
                raise InvalidEnvironment(f"{place}: {what} of agent {agent} is {flag!r}, expected True or False")
        return any(flags)


def _names(agents: list) -> str:
    return ", ".join(map(str, agents))


def declares(env, name: str) -> bool:
    """Whether `env` has this attribute. An error inside a property is not taken for its absence, as by `hasattr`."""
    return inspect.getattr_static(env, name, None) is not None or hasattr(env, name)


def _agents(env) -> list:
    """The agents of a `ParallelEnv`."""
    kind = type(env).__name__
    if declares(type(env), "agent_iter"):
        advice = "give a function that returns its parallel_env, or pettingzoo.utils.aec_to_parallel(env)"
        raise InvalidEnvironment(f"{kind} is an AEC environment, whose agents act in turns; {advice}")
    wanted = ("possible_agents", "observation_space", "action_space", "reset", "step", "metadata", "unwrapped")
    if missing := [name for name in wanted if isinstance(env, type) or not declares(env, name)]:
        raise InvalidEnvironment(f"{kind} is no PettingZoo ParallelEnv: it has no {', '.join(missing)}")
    try:
        inspect.signature(env.reset).bind(seed=0)
    except TypeError:
        raise InvalidEnvironment(f"reset() of {kind} must take the argument seed, as PettingZoo's does") from None
    agents = list(env.possible_agents)
    if not agents or len({str(agent) for agent in agents}) < len(agents):
        raise InvalidEnvironment(f"possible_agents of {kind} must be one or more different names, is {agents}")
    return agents


def _has_state(env) -> bool:
    """Whether the environment has a `state()` of its own. Errors inside it are raised."""
    having = [one for one in (env.unwrapped, env) if declares(one, "state")]
    if not having:
        return False
    if not all(callable(one.state) for one in having):
        note("state", "the attribute state is not PettingZoo's method state(); all observations are the global state")
        return False
    try:
        env.state()
    except NotImplementedError as error:
        # `state` raises it directly where it has no implementation, as PettingZoo's does.
        if _raised_in(error) != "state":
            raise
        return False
    except AttributeError:
        # Wrappers have a `state` that calls the one of an environment without any.
        if declares(env.unwrapped, "state"):
            raise
        return False
    return True


def _raised_in(error: Exception) -> str:
    """Name of the function that raised `error`."""
    return traceback.extract_tb(error.__traceback__)[-1].name
