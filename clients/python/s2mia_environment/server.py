"""The service `EnvironmentService`: one thread and environments of its own for each stream of a player."""

import abc
import traceback
from collections.abc import Callable, Iterable, Iterator
from concurrent import futures

import grpc
import numpy as np
from s2mia_client import wire

MAX_MESSAGE_BYTES = 4 * 1024 * 1024
# Each actor keeps two streams open: one for its slot, one for evaluations.
STREAMS = 64


class Environment(abc.ABC):
    """One environment. What it does must be a function of the seed, or of the restored state, and of the actions."""

    spec: "wire.EnvironmentSpec"
    """What it is. With `max_state_bytes = 0` it is never asked to save."""

    @abc.abstractmethod
    def reset(self, seed: bytes) -> None:
        """Begins an episode. All its chance comes from the 32 bytes of `seed`."""

    @abc.abstractmethod
    def step(self, actions: list[np.ndarray]) -> tuple[float, bool, bool]:
        """One action `[act]` for each agent, not yet clamped: the team's reward, terminated, truncated."""

    @abc.abstractmethod
    def observe(self) -> tuple[np.ndarray, list[np.ndarray]]:
        """Global state `[S]`, and one observation `[obs]` for each agent."""

    def save(self) -> bytes:
        """From which `restore` goes on, here or in another environment of this kind."""
        raise NotImplementedError

    def restore(self, state: bytes) -> None:
        """Goes on from a saved state."""
        raise NotImplementedError


class Stage:
    """The environments of one stream."""

    def __init__(self, make: Callable[[], Environment]) -> None:
        self.make = make
        self.environments: dict[int, Environment] = {}

    def answer(self, request) -> "wire.PlayResponse":
        """What one request comes to."""
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
    """Offers what `make` makes."""

    def __init__(self, make: Callable[[], Environment]) -> None:
        self.make, self.spec = make, make().spec

    def DescribeEnvironment(self, request, context):  # noqa: N802
        """What it is."""
        return wire.DescribeEnvironmentResponse(environment=self.spec)

    def Play(self, request_iterator, context) -> Iterator["wire.PlayResponse"]:  # noqa: N802
        """Steps environments of this stream's own."""
        stage = Stage(self.make)
        for request in request_iterator:
            try:
                answer = stage.answer(request)
            except Exception as error:
                # Whatever an environment gets wrong, it would again: its player ends instead of asking for ever.
                traceback.print_exc()
                context.abort(grpc.StatusCode.INVALID_ARGUMENT, f"{type(error).__name__}: {error}")
            yield answer


def serve(make: Callable[[], Environment], listen: str, streams: int = STREAMS) -> tuple[grpc.Server, int]:
    """Starts the service; gives the server and its port back. Whoever opens a stream above `streams` is refused."""
    options = [("grpc.max_receive_message_length", MAX_MESSAGE_BYTES), ("grpc.so_reuseport", 0)]
    server = grpc.server(futures.ThreadPoolExecutor(streams), options=options, maximum_concurrent_rpcs=streams)
    wire.add_EnvironmentServiceServicer_to_server(Service(make), server)
    port = server.add_insecure_port(listen)
    server.start()
    return server, port
