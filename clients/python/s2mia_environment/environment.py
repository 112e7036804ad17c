"""The interfaces of environments: one that steps alone, or several that step together."""

import abc
from collections.abc import Callable, Sequence

import numpy as np
from s2mia import wire


class InvalidEnvironment(ValueError):
    """An environment that cannot be served, or the wrong arguments for one; one line that says what to do."""


class Environment(abc.ABC):
    """One environment. It must be a deterministic function of the seed, or the restored state, and the actions."""

    spec: "wire.EnvironmentSpec"
    """Its description. With `max_state_bytes = 0`, `save` is never called."""

    @abc.abstractmethod
    def reset(self, seed: bytes) -> None:
        """Starts an episode. The 32 bytes of `seed` are its only source of randomness."""

    @abc.abstractmethod
    def step(self, actions: list[np.ndarray]) -> tuple[float, bool, bool]:
        """Takes one unclamped action `[act]` per agent, in the unit of `low` and `high` in `spec`, to which -1 and 1 of the
        policy are mapped. Returns the team's reward, terminated, truncated."""

    @abc.abstractmethod
    def observe(self) -> tuple[np.ndarray, list[np.ndarray]]:
        """Returns the global state `[S]` and one observation `[obs]` per agent."""

    def save(self) -> bytes:
        """Encodes the state for `restore`, in this or another environment of the same kind."""
        raise NotImplementedError

    def restore(self, state: bytes) -> None:
        """Continues from a saved state."""
        raise NotImplementedError

    def close(self) -> None:  # noqa: B027
        """Frees what it holds outside this process. Called once, at the end of its stream or of the program."""


class EnvironmentBatch(abc.ABC):
    """The environments of one stream, `n` of which step together. Each is as deterministic as an `Environment`.

    The client chooses their numbers. An environment begins with its first reset or restore.
    """

    spec: "wire.EnvironmentSpec"
    """Description of each environment. With `max_state_bytes = 0`, `save` is never called."""

    @abc.abstractmethod
    def reset(self, number: int, seed: bytes) -> None:
        """Starts an episode. The 32 bytes of `seed` are its only source of randomness."""

    @abc.abstractmethod
    def step(self, numbers: Sequence[int], actions: list[np.ndarray]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Takes unclamped actions `[n, act]` per agent, as `Environment.step`. Returns rewards, terminated and truncated, each `[n]`."""

    @abc.abstractmethod
    def observe(self, numbers: Sequence[int]) -> tuple[np.ndarray, list[np.ndarray]]:
        """Returns the global states `[n, S]` and the observations `[n, obs]` per agent."""

    def save(self, number: int) -> bytes:
        """Encodes the state for `restore`, in this or another batch of the same kind."""
        raise NotImplementedError

    def restore(self, number: int, state: bytes) -> None:
        """Continues from a saved state."""
        raise NotImplementedError

    def close(self) -> None:  # noqa: B027
        """Frees what the environments hold outside this process. Called once, at the end of their stream or of the program."""


class OneByOne(EnvironmentBatch):
    """Environments that step one after the other. `first` is one of them, `make` makes the others."""

    def __init__(self, first: Environment, make: Callable[[], Environment]) -> None:
        self.spec, self.make = first.spec, make
        self.spare = [first]
        self.environments: dict[int, Environment] = {}

    def reset(self, number: int, seed: bytes) -> None:
        self._begin(number).reset(seed)

    def step(self, numbers: Sequence[int], actions: list[np.ndarray]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        outcomes = [
            self.environments[number].step([rows[row] for rows in actions]) for row, number in enumerate(numbers)
        ]
        rewards, terminated, truncated = zip(*outcomes, strict=True)
        for flag in (*terminated, *truncated):
            # A text or an array would count as true.
            if np.shape(flag) != () or flag not in (0, 1):
                raise InvalidEnvironment(f"step() returned {flag!r} for terminated or truncated, expected True or False")
        return np.array(rewards), np.array(terminated, bool), np.array(truncated, bool)

    def observe(self, numbers: Sequence[int]) -> tuple[np.ndarray, list[np.ndarray]]:
        seen = [self.environments[number].observe() for number in numbers]
        agents = zip(*(observations for _, observations in seen), strict=True)
        return np.stack([state for state, _ in seen]), [np.stack(rows) for rows in agents]

    def save(self, number: int) -> bytes:
        return self.environments[number].save()

    def restore(self, number: int, state: bytes) -> None:
        self._begin(number).restore(state)

    def close(self) -> None:
        for environment in (*self.spare, *self.environments.values()):
            environment.close()

    def _begin(self, number: int) -> Environment:
        if number not in self.environments:
            self.environments[number] = self.spare.pop() if self.spare else self.make()
        return self.environments[number]
