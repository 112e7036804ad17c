"""What loaded and served teams share: their description, the forms of observations and actions, and resets.

Shapes: `N` agents, `E` environments, `obs` and `act` of each agent.
"""

import abc
import dataclasses
import difflib
from collections.abc import Mapping
from typing import Any, overload

import numpy as np
from numpy.typing import ArrayLike, NDArray

from s2mia.closing import Closing
from s2mia.values import AgentSpec, Numbers, numbers


@dataclasses.dataclass(frozen=True)
class Agent(AgentSpec):
    """One agent of a team. A loaded team of a run in another program's environment has no names of features and joints."""

    observation_size: int
    """`obs`"""
    distribution: str
    """`gaussian`, `categorical`, `clamped_gaussian`, `uniform` or `tanh_gaussian`."""
    hidden_size: int
    """Width of its recurrent state; 0 without one."""


@dataclasses.dataclass(frozen=True)
class Description:
    """A team and its origin."""

    run: str
    task: str
    algorithm: str
    seed: int
    iteration: int
    """Iterations that trained the weights that act."""
    policy_sha256: str
    dt_secs: float | None
    """Seconds between observations; `None` if only the program of the environment knows it."""
    agents: list[Agent]
    record: dict[str, Any] | None = None
    """Of a team that comes with the package: return, seed, commit and hashes of its run."""


class Acting(Closing):
    """A trained team in `E` environments, with the agents' recurrent states. A context manager."""

    description: Description
    """The team; its weights are those of the last actions."""

    def __init__(self, description: Description) -> None:
        self.description = description
        self._indices = {agent.name: index for index, agent in enumerate(description.agents)}
        # Environments of the current episodes; None before the first step.
        self._environments: int | None = None

    @property
    def agents(self) -> list[Agent]:
        """The agents, in the order of the first axis of observations."""
        return self.description.agents

    @overload
    def act(self, observations: Mapping[str, ArrayLike]) -> dict[str, NDArray[Any]]: ...

    @overload
    def act(self, observations: ArrayLike) -> NDArray[Any]: ...

    def act(self, observations: Mapping[str, ArrayLike] | ArrayLike) -> dict[str, NDArray[Any]] | NDArray[Any]:
        """Returns the actions for observations as the environment returns them.

        `observations` is a dictionary by the agents' names, `[obs]` or `[E, obs]` each, as PettingZoo has it, or an
        array `[N, obs]` or `[E, N, obs]` of all agents, as `s2mia.vector_env` has it: of agents with different sizes, `obs`
        is the largest. The result has the same form, with `act` in place of `obs`.
        The recurrent states of agents that a dictionary lacks do not change. Continuous actions are in units of half a
        range (-1 and 1 are the limits) and not clamped. A choice is its index, without the axis `act`.
        Raises `ValueError` for an unknown agent, a wrong shape, a number that is not finite, or an array for a team of which
        only some agents have choices.
        """
        if isinstance(observations, Mapping):
            rows = {self._index(name): own for name, own in observations.items()}
            batch, single = self._batch(rows)
            actions = self._actions(batch, single)
            return {self.agents[index].name: own for index, own in actions.items()}
        if len({agent.choices is None for agent in self.agents}) > 1:
            kinds = "some agents have continuous actions, others a choice"
            raise ValueError(f"{kinds}, which no array holds; give a dictionary of observations by the agents' names")
        batch, single = self._batch(self._split(observations))
        acted = list(self._actions(batch, single).values())
        widest = max(agent.action_size for agent in self.agents)
        if any(agent.action_size < widest for agent in self.agents):
            acted = [np.pad(own, [(0, 0)] * (own.ndim - 1) + [(0, widest - own.shape[-1])]) for own in acted]
        return np.stack(acted, 0 if single else 1)

    def reset(self, environments: ArrayLike | None = None) -> None:
        """Starts episodes, with recurrent states of zero.

        `environments` is a mask `[E]` of bool or the indices, each once, of the environments whose episodes start. Without
        it, all episodes start, and the number of environments may change. Raises `ValueError` for other environments.
        """
        if environments is None:
            self._environments = None
            return
        try:
            which = np.asarray(environments)
        except ValueError as error:
            raise ValueError(f"reset needs a mask of environments or their indices: {error}") from None
        if not which.size:
            return
        # Before the first step, the number of environments is not known.
        count = self._environments
        mask = which.dtype == bool and which.ndim == 1 and count in (None, which.size)
        indices = which.dtype.kind in "iu" and which.ndim <= 1 and which.min() >= 0
        if indices:
            indices = (count is None or which.max() < count) and np.unique(which).size == which.size
        if not mask and not indices:
            size, limit = ("the", "") if count is None else (count, f" below {count}")
            given = " ".join(np.array2string(which, threshold=8).split())
            raise ValueError(
                f"reset needs a mask of {size} environments or indices{limit}, not {given}; "
                "a mask has the type bool, and no index is given twice"
            )
        if count is not None:
            for environment in np.flatnonzero(which) if mask else which.reshape(-1):
                self._restart(int(environment))

    @abc.abstractmethod
    def close(self) -> None:
        """Closes the connection of a served team, which then acts no more. A loaded team has none, and still acts."""

    @abc.abstractmethod
    def _begin(self, environments: int) -> None:
        """Starts episodes in this many environments, before the first step."""

    @abc.abstractmethod
    def _restart(self, environment: int) -> None:
        """Starts an episode in one environment."""

    @abc.abstractmethod
    def _step(self, rows: dict[int, Numbers]) -> dict[int, Numbers]:
        """Actions `[E, act]` for observations `[E, obs]`, by the index of the agent."""

    def _actions(self, rows: dict[int, Numbers], single: bool) -> dict[int, NDArray[Any]]:
        """Actions `[act]` or `[E, act]`, of which choices are whole numbers without the axis `act`."""
        environments = len(next(iter(rows.values())))
        if self._environments is None:
            self._begin(environments)
            self._environments = environments
        if self._environments != environments:
            before = self._environments
            raise ValueError(f"observations of {environments} environments after {before}; call reset() in between")

        def shaped(index: int, actions: Numbers) -> NDArray[Any]:
            own = actions[:, 0].astype(np.int64) if self.agents[index].choices is not None else actions
            return own[0] if single else own

        return {index: shaped(index, actions) for index, actions in self._step(rows).items()}

    def _index(self, name: str) -> int:
        """The index of the agent with this name."""
        if name in self._indices:
            return self._indices[name]
        near = difflib.get_close_matches(str(name), self._indices, 1)
        known = f"did you mean {near[0]!r}?" if near else f"the agents are {', '.join(self._indices)}"
        raise ValueError(f"{name!r} is no agent of the team; {known}")

    def _split(self, observations: ArrayLike) -> dict[int, ArrayLike]:
        """The observations of each agent in an array of all agents."""
        try:
            array = np.asarray(observations)
        except ValueError:
            raise ValueError("the observations have different sizes; give a dictionary by the agents' names") from None
        count, widest = len(self.agents), max(agent.observation_size for agent in self.agents)
        if array.ndim not in (2, 3) or array.shape[-2:] != (count, widest):
            expected = f"({count}, {widest}) or (E, {count}, {widest})"
            raise ValueError(f"observations have shape {array.shape}, expected {expected}")
        return {index: array[..., index, : agent.observation_size] for index, agent in enumerate(self.agents)}

    def _batch(self, observations: Mapping[int, ArrayLike]) -> tuple[dict[int, Numbers], bool]:
        """Arrays `[E, obs]`, and whether they had no axis `E`."""
        if not observations:
            raise ValueError("there is no observation")
        batch: dict[int, Numbers] = {}
        leading: tuple[int, ...] | None = None
        for index, observation in observations.items():
            agent = self.agents[index]
            own, size = numbers(f"{agent.name}: the observation", observation), agent.observation_size
            if own.ndim not in (1, 2) or own.shape[-1] != size or not own.size:
                raise ValueError(f"{agent.name}: observation has shape {own.shape}, expected ({size},) or (E, {size})")
            leading = own.shape[:-1] if leading is None else leading
            if own.shape[:-1] != leading:
                expected = (*leading, size)
                raise ValueError(f"{agent.name}: observation has shape {own.shape}, expected {expected} as for the first")
            if not np.isfinite(own).all():
                raise ValueError(f"{agent.name}: the observation contains a number that is not finite")
            batch[index] = np.ascontiguousarray(np.atleast_2d(own))
        return batch, leading == ()
