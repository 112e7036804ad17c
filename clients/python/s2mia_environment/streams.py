"""Streams of requests, each with its own environments, in this process. Requests and answers are encoded messages."""

import itertools
import traceback
from collections.abc import Callable, Sequence

import numpy as np
from s2mia import wire
from s2mia.name import check

from s2mia_environment.environment import EnvironmentBatch


class EnvironmentFailed(Exception):
    """An environment raised an error, which it would raise again. The message names its type."""


class Streams:
    """Answers the requests of streams whose environments `make` makes."""

    def __init__(self, make: Callable[[], EnvironmentBatch]) -> None:
        self.make = make
        self.spare = [make()]
        _check_names(self.spare[0].spec)
        self.description = wire.DescribeEnvironmentResponse(environment=self.spare[0].spec).SerializeToString()
        self.batches: dict[int, EnvironmentBatch] = {}
        self.numbers = itertools.count()

    def open(self) -> int:
        """Starts a stream. Returns its number."""
        number = next(self.numbers)
        self.begin(number)
        return number

    def begin(self, number: int) -> None:
        """Starts the stream with that number."""
        try:
            self.batches[number] = self.spare.pop() if self.spare else self.make()
        except Exception as error:
            raise _failed(error) from error

    def answer(self, number: int, request: bytes) -> bytes:
        """Answers one request of the stream."""
        try:
            return _answer(self.batches[number], wire.PlayRequest.FromString(request)).SerializeToString()
        except Exception as error:
            raise _failed(error) from error

    def close(self, number: int) -> None:
        """Ends the stream and its environments."""
        del self.batches[number]


def _check_names(spec: "wire.EnvironmentSpec") -> None:
    """Raises `ValueError` for a name that learner and actors would refuse."""
    check(spec.task, "the environment's name")
    for index, agent in enumerate(spec.agents):
        check(agent.name, f"the name of agent {index}")
        for joint in agent.joints:
            check(joint, f"the name of a joint of agent {index}")
    for feature in itertools.chain(spec.state, *(agent.observation for agent in spec.agents)):
        check(feature.name, "the name of a feature")


def _failed(error: Exception) -> EnvironmentFailed:
    traceback.print_exception(error)
    return EnvironmentFailed(f"{type(error).__name__}: {error}")


def _answer(batch: EnvironmentBatch, request) -> "wire.PlayResponse":
    match request.WhichOneof("request"):
        case "step":
            return wire.PlayResponse(steps=_step(batch, request.step))
        case "save":
            return wire.PlayResponse(saved=wire.EnvironmentState(state=batch.save(request.save.environment)))
        case "restore":
            batch.restore(request.restore.environment, request.restore.state)
            return wire.PlayResponse(view=_view(batch, [request.restore.environment]))
        case "reset":
            batch.reset(request.reset.environment, request.reset.seed)
            return wire.PlayResponse(view=_view(batch, [request.reset.environment]))
    raise ValueError("a request without content")


def _step(batch: EnvironmentBatch, request) -> "wire.EnvironmentsSteps":
    rewards, terminated, truncated = batch.step(request.environments, [wire.array(rows) for rows in request.actions])
    return wire.EnvironmentsSteps(
        view=_view(batch, request.environments),
        reward=wire.tensor(rewards),
        terminated=wire.tensor(terminated),
        truncated=wire.tensor(truncated),
    )


def _view(batch: EnvironmentBatch, numbers: Sequence[int]) -> "wire.EnvironmentsView":
    state, observations = batch.observe(numbers)
    return wire.EnvironmentsView(observations=[wire.tensor(rows) for rows in observations], state=wire.tensor(state))
