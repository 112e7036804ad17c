"""Trained policies of all agents, with NumPy alone."""

import os
import pathlib
from collections.abc import Sequence
from typing import Any, overload

import numpy as np
from numpy.typing import ArrayLike, NDArray

from s2mia.checkpoint import policy_file, read_policy
from s2mia.policy import Agent, Floats, Policy


class Policies:
    """The policies of a run in `E` environments, with the agents' recurrent states.

    Shapes: `N` agents, `obs` and `act` of each agent.
    """

    def __init__(self, policy: Policy, path: pathlib.Path) -> None:
        self.agents: list[Agent] = policy.agents
        self.path = path
        """The file from which they were loaded."""
        self._hidden: list[Floats] | None = None

    def reset(self, environments: ArrayLike | None = None) -> None:
        """Starts episodes: sets recurrent states to zero.

        `environments` is a mask `[E]` or the indices of the environments whose episodes start. Without it, all
        episodes start, and the number of environments may change. Raises `ValueError` for other environments.
        """
        if environments is None:
            self._hidden = None
            return
        which = np.asarray(environments)
        if not which.size or self._hidden is None:
            return
        count = len(self._hidden[0])
        mask = which.dtype == bool and which.shape == (count,)
        indices = which.dtype.kind in "iu" and which.ndim <= 1 and which.min() >= 0 and which.max() < count
        if not mask and not indices:
            raise ValueError(f"reset needs a mask of {count} environments or indices below {count}, not {environments}")
        for hidden in self._hidden:
            hidden[which] = 0

    @overload
    def act(self, observations: NDArray[Any], rng: np.random.Generator | None = None) -> NDArray[Any]: ...

    @overload
    def act(self, observations: Sequence[ArrayLike], rng: np.random.Generator | None = None) -> list[NDArray[Any]]: ...

    def act(
        self, observations: NDArray[Any] | Sequence[ArrayLike], rng: np.random.Generator | None = None
    ) -> NDArray[Any] | list[NDArray[Any]]:
        """Returns the actions for observations as the environment returns them.

        `observations` is an array `[N, obs]` or `[E, N, obs]`, or a list with an array `[obs]` or `[E, obs]` for
        each agent. The result has the same form, with `act` in place of `obs`. Actions are means, or the most
        likely choices; with `rng`, they are sampled. They are in units of half a range (-1 and 1 are the limits) and
        not clamped. A choice is an index.
        Raises `ValueError` if a shape is wrong or a number is not finite.
        """
        stacked = isinstance(observations, np.ndarray)
        batch = self._batch(observations)
        single = batch[0].ndim == 1
        rows = [np.atleast_2d(own) for own in batch]
        hidden = self._states(len(rows[0]))
        if stacked and len({agent.action_size for agent in self.agents}) > 1:
            raise ValueError("the agents' actions have different sizes; give the observations as a list")
        actions = []
        for index, (agent, own) in enumerate(zip(self.agents, rows, strict=True)):
            output, hidden[index] = agent.forward(own, hidden[index])
            action = agent.mode(output) if rng is None else agent.draw(output, rng)
            kind = np.int64 if agent.choices else np.float32
            actions.append((action[0] if single else action).astype(kind))
        self._hidden = hidden
        return np.stack(actions, -2) if stacked else actions

    def _batch(self, observations: NDArray[Any] | Sequence[ArrayLike]) -> list[Floats]:
        """One array `[obs]` or `[E, obs]` per agent."""
        if isinstance(observations, np.ndarray):
            if observations.ndim not in (2, 3):
                raise ValueError(f"observations have shape {observations.shape}, expected (N, obs) or (E, N, obs)")
            observations = list(np.moveaxis(observations, -2, 0))
        if len(observations) != len(self.agents):
            raise ValueError(f"observations of {len(observations)} agents, expected {len(self.agents)}")
        batch = [_numbers(index, own) for index, own in enumerate(observations)]
        first = batch[0].shape[:-1]
        for index, (agent, own) in enumerate(zip(self.agents, batch, strict=True)):
            size = agent.observation_size
            if own.ndim not in (1, 2) or own.shape[-1] != size:
                raise ValueError(f"agent_{index}: observation has shape {own.shape}, expected ({size},) or (E, {size})")
            if own.shape[:-1] != first:
                raise ValueError(
                    f"agent_{index}: observation has shape {own.shape}, expected {(*first, size)} as for agent_0"
                )
            if not np.isfinite(own).all():
                raise ValueError(f"agent_{index}: the observation contains a number that is not finite")
        return batch

    def _states(self, environments: int) -> list[Floats]:
        """One recurrent state `[E, H]` per agent."""
        if self._hidden is None:
            return [np.zeros((environments, agent.hidden_size), np.float32) for agent in self.agents]
        if len(self._hidden[0]) != environments:
            before = len(self._hidden[0])
            raise ValueError(f"observations of {environments} environments after {before}; call reset() in between")
        return list(self._hidden)


def _numbers(agent: int, observation: ArrayLike) -> Floats:
    try:
        numbers = np.asarray(observation)
        if numbers.dtype.kind not in "biuf":
            if numbers.dtype.kind != "c":
                # Raises for texts that are no numbers, and says which.
                np.asarray(observation, np.float32)
            raise TypeError(f"it has the type {numbers.dtype}")
        with np.errstate(over="ignore"):
            return numbers.astype(np.float32)
    except (TypeError, ValueError) as error:
        raise ValueError(f"agent_{agent}: the observation is no array of numbers: {error}") from None


def load(run: str | os.PathLike[str]) -> Policies:
    """Loads the policies of a run folder's newest checkpoint, of a checkpoint, or of a `policy.safetensors`.

    Raises `RunError` if there is none or its hash is wrong.
    """
    path = policy_file(pathlib.Path(run))
    return Policies(Policy(read_policy(path), str(path)), path)
