"""Streams of requests, each with its own environments, in this process. Requests and answers are encoded messages."""

import itertools
import sys
import traceback
from collections.abc import Callable, Sequence

import numpy as np
from s2mia import wire
from s2mia.name import check

from s2mia_environment.environment import EnvironmentBatch, InvalidEnvironment

# The text of a status is sent in a header, which has limited size.
MAX_TEXT = 400
SEED_BYTES = 32


class EnvironmentFailed(Exception):
    """An environment raised an error, which it would raise again. The message is one line that names its type."""


def failed(error: BaseException) -> EnvironmentFailed:
    """The failure of an environment that raised `error`, whose traceback is printed if it is the environment's own."""
    own = not isinstance(error, InvalidEnvironment)
    if own:
        traceback.print_exception(error)
    line = " ".join(f"{type(error).__name__}: {error}".split() if own else str(error).split())
    return EnvironmentFailed(line if len(line) <= MAX_TEXT else f"{line[:MAX_TEXT]}...")


# `SystemExit` in a thread of the server would leave its call without an answer.
_ERRORS = (Exception, SystemExit)


class Stream:
    """The environments of one stream."""

    def __init__(self, batch: EnvironmentBatch) -> None:
        self.batch = batch
        self.begun: set[int] = set()

    def answer(self, request) -> "wire.PlayResponse":
        """Answers one request."""
        match request.WhichOneof("request"):
            case "step":
                return wire.PlayResponse(steps=self._step(request.step))
            case "save":
                self._demand_begun([request.save.environment])
                return wire.PlayResponse(saved=wire.EnvironmentState(state=self.batch.save(request.save.environment)))
            case "restore":
                number = request.restore.environment
                self.batch.restore(number, request.restore.state)
                self.begun.add(number)
                return wire.PlayResponse(view=self._view([number]))
            case "reset":
                number, seed = request.reset.environment, request.reset.seed
                if len(seed) != SEED_BYTES:
                    raise InvalidEnvironment(f"reset.seed has {len(seed)} bytes, a seed has {SEED_BYTES}")
                self.batch.reset(number, seed)
                self.begun.add(number)
                return wire.PlayResponse(view=self._view([number]))
        raise InvalidEnvironment("a request without content")

    def _demand_begun(self, numbers: Sequence[int]) -> None:
        for number in numbers:
            if number not in self.begun:
                raise InvalidEnvironment(f"environment {number} was neither reset nor restored")
        if len(set(numbers)) < len(numbers):
            raise InvalidEnvironment(f"step.environments has duplicates: {list(numbers)}")

    def _step(self, request) -> "wire.EnvironmentsSteps":
        self._demand_begun(request.environments)
        rewards, terminated, truncated = self.batch.step(request.environments, self._actions(request))
        return wire.EnvironmentsSteps(
            view=self._view(request.environments),
            reward=_tensor("the rewards", rewards),
            terminated=_tensor("terminated", terminated),
            truncated=_tensor("truncated", truncated),
        )

    def _actions(self, request) -> list[np.ndarray]:
        """The checked actions `[n, act]` of all agents."""
        try:
            actions = [wire.array(rows) for rows in request.actions]
        except ValueError as error:
            raise InvalidEnvironment(f"step.actions: {error}") from None
        expected = [(len(request.environments), agent.action.size) for agent in self.batch.spec.agents]
        found = [rows.shape for rows in actions]
        if found != expected:
            raise InvalidEnvironment(f"step.actions have the shapes {found}, expected {expected}")
        if not all(np.isfinite(rows).all() for rows in actions):
            raise InvalidEnvironment("step.actions contain a number that is not finite")
        return actions

    def _view(self, numbers: Sequence[int]) -> "wire.EnvironmentsView":
        state, observations = self.batch.observe(numbers)
        agents = (agent.name for agent in self.batch.spec.agents)
        # The client compares the number of observations with the number of agents.
        named = zip(agents, observations, strict=False)
        rows = [_tensor(f"the observation of agent {agent}", own) for agent, own in named]
        rows += [_tensor("an observation", own) for own in observations[len(rows) :]]
        return wire.EnvironmentsView(observations=rows, state=_tensor("the global state", state))


def _tensor(what: str, array) -> "wire.Tensor":
    try:
        return wire.tensor(np.asarray(array))
    except ValueError as error:
        raise InvalidEnvironment(f"{what}: {error}") from None


class Streams:
    """Answers the requests of streams whose environments `make` makes."""

    def __init__(self, make: Callable[[], EnvironmentBatch]) -> None:
        """Makes one environment for the description. Raises `EnvironmentFailed` if that fails."""
        self.make = make
        self.spare: list[EnvironmentBatch] = []
        self.spare.append(self._made())
        try:
            _check_names(self.spare[0].spec)
        except ValueError as error:
            raise failed(InvalidEnvironment(str(error))) from None
        self.description = wire.DescribeEnvironmentResponse(environment=self.spare[0].spec).SerializeToString()
        self.streams: dict[int, Stream] = {}
        self.numbers = itertools.count()

    def open(self) -> int:
        """Starts a stream. Returns its number."""
        number = next(self.numbers)
        self.begin(number)
        return number

    def begin(self, number: int) -> None:
        """Starts the stream with that number."""
        # Several threads may begin streams at a time.
        try:
            batch = self.spare.pop()
        except IndexError:
            batch = None
        self.streams[number] = Stream(self._made() if batch is None else batch)

    def answer(self, number: int, request: bytes) -> bytes:
        """Answers one request of the stream."""
        try:
            return self.streams[number].answer(wire.PlayRequest.FromString(request)).SerializeToString()
        except _ERRORS as error:
            failure = failed(error)
            print(f"s2mia_environment: the environment failed: {failure}", file=sys.stderr, flush=True)
            raise failure from error

    def close(self, number: int) -> None:
        """Ends the stream and its environments."""
        _close(self.streams.pop(number).batch)

    def close_all(self) -> None:
        """Ends all streams and environments."""
        while self.streams:
            _close(self.streams.popitem()[1].batch)
        while self.spare:
            _close(self.spare.pop())

    def _made(self) -> EnvironmentBatch:
        try:
            return self.make()
        except _ERRORS as error:
            raise failed(error) from error


def _close(batch: EnvironmentBatch) -> None:
    """Closes environments, which nobody needs any more. Their error is printed."""
    try:
        batch.close()
    except _ERRORS as error:
        traceback.print_exception(error)


def _check_names(spec: "wire.EnvironmentSpec") -> None:
    """Raises `ValueError` for a name that learner and actors would refuse."""
    check(spec.task, "the environment's name")
    for index, agent in enumerate(spec.agents):
        check(agent.name, f"the name of agent {index}")
        for joint in agent.joints:
            check(joint, f"the name of a joint of agent {index}")
    for feature in itertools.chain(spec.state, *(agent.observation for agent in spec.agents)):
        check(feature.name, "the name of a feature")
