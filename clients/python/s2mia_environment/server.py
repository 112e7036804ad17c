"""The service `EnvironmentService`, with one thread and separate environments per stream."""

import abc
import traceback
from collections.abc import Callable, Iterable, Iterator
from concurrent import futures

import grpc
import numpy as np
from s2mia_client import wire

MAX_MESSAGE_BYTES = 4 * 1024 * 1024
# Each actor has two streams: one for its slot, one for evaluations.
STREAMS = 64


class Environment(abc.ABC):
    """One environment. It must be a deterministic function of the seed, or the restored state, and the actions."""

    spec: "wire.EnvironmentSpec"
    """Its description. With `max_state_bytes = 0`, `save` is never called."""

    @abc.abstractmethod
    def reset(self, seed: bytes) -> None:
        """Starts an episode. The 32 bytes of `seed` are its only source of randomness."""

    @abc.abstractmethod
    def step(self, actions: list[np.ndarray]) -> tuple[float, bool, bool]:
        """Takes one unclamped action `[act]` per agent. Returns the team's reward, terminated, truncated."""

    @abc.abstractmethod
    def observe(self) -> tuple[np.ndarray, list[np.ndarray]]:
        """Returns the global state `[S]` and one observation `[obs]` per agent."""

    def save(self) -> bytes:
        """Encodes the state for `restore`, in this or another environment of the same kind."""
        raise NotImplementedError

    def restore(self, state: bytes) -> None:
        """Continues from a saved state."""
        raise NotImplementedError


class StreamEnvironments:
    """The environments of one stream."""

    def __init__(self, make: Callable[[], Environment]) -> None:
        self.make = make
        self.environments: dict[int, Environment] = {}

    def answer(self, request) -> "wire.PlayResponse":
        """Answers one request."""
        match request.WhichOneof("request"):
            case "reset":
                self._begin(request.reset.environment).reset(request.reset.seed)
                return wire.PlayResponse(view=self._view([request.reset.environment]))
            case "restore":
                self._begin(request.restore.environment).restore(request.restore.state)
                return wire.PlayResponse(view=self._view([request.restore.environment]))
            case "save":
                state = self.environments[request.save.environment].save()
                return wire.PlayResponse(saved=wire.EnvironmentState(state=state))
            case "step":
                return wire.PlayResponse(steps=self._step(request.step))
        raise ValueError("a request without content")

    def _begin(self, number: int) -> Environment:
        if number not in self.environments:
            self.environments[number] = self.make()
        return self.environments[number]

    def _step(self, request) -> "wire.EnvironmentsSteps":
        actions = [wire.array(tensor) for tensor in request.actions]
        outcomes = [
            self.environments[number].step([rows[row] for rows in actions])
            for row, number in enumerate(request.environments)
        ]
        rewards, terminated, truncated = zip(*outcomes, strict=True)
        return wire.EnvironmentsSteps(
            view=self._view(request.environments),
            reward=wire.tensor(np.array(rewards, np.float32)),
            terminated=wire.tensor(np.array(terminated, bool)),
            truncated=wire.tensor(np.array(truncated, bool)),
        )

    def _view(self, numbers: Iterable[int]) -> "wire.EnvironmentsView":
        seen = [self.environments[number].observe() for number in numbers]
        agents = zip(*(observations for _, observations in seen), strict=True)
        return wire.EnvironmentsView(
            observations=[wire.tensor(np.stack(rows)) for rows in agents],
            state=wire.tensor(np.stack([state for state, _ in seen])),
        )


class Service(wire.EnvironmentServiceServicer):
    """Serves environments made by `make`."""

    def __init__(self, make: Callable[[], Environment]) -> None:
        self.make, self.spec = make, make().spec

    def DescribeEnvironment(self, request, context):  # noqa: N802
        """Returns the description of the environment."""
        return wire.DescribeEnvironmentResponse(environment=self.spec)

    def Play(self, request_iterator, context) -> Iterator["wire.PlayResponse"]:  # noqa: N802
        """Steps the environments of one stream."""
        environments = StreamEnvironments(self.make)
        for request in request_iterator:
            try:
                answer = environments.answer(request)
            except Exception as error:
                # The environment would fail again, so the client must not retry.
                traceback.print_exc()
                context.abort(grpc.StatusCode.INVALID_ARGUMENT, f"{type(error).__name__}: {error}")
            yield answer


def serve(make: Callable[[], Environment], listen: str, streams: int = STREAMS) -> tuple[grpc.Server, int]:
    """Starts the service. Returns the server and its port. Streams beyond `streams` are rejected."""
    options = [("grpc.max_receive_message_length", MAX_MESSAGE_BYTES), ("grpc.so_reuseport", 0)]
    server = grpc.server(futures.ThreadPoolExecutor(streams), options=options, maximum_concurrent_rpcs=streams)
    wire.add_EnvironmentServiceServicer_to_server(Service(make), server)
    port = server.add_insecure_port(listen)
    server.start()
    return server, port
