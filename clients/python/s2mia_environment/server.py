"""The service `EnvironmentService`, with separate environments per stream, which worker processes step."""

import atexit
import re
import socket
from collections.abc import Callable, Iterator
from concurrent import futures

import grpc

from s2mia_environment.environment import EnvironmentBatch
from s2mia_environment.streams import EnvironmentFailed, Streams
from s2mia_environment.workers import WorkerLost, WorkerStreams

MAX_MESSAGE_BYTES = 4 * 1024 * 1024
# Each actor has two streams: one for its slot, one for evaluations.
STREAMS = 64
NAME = "s2mia.v1.EnvironmentService"


class Service:
    """The service's calls. Messages stay encoded here: only the process that steps the environments decodes them."""

    def __init__(self, streams: Streams | WorkerStreams) -> None:
        self.streams = streams

    def describe(self, request: bytes, context: grpc.ServicerContext) -> bytes:
        """Returns the description of the environment."""
        return self.streams.description

    def play(self, requests: Iterator[bytes], context: grpc.ServicerContext) -> Iterator[bytes]:
        """Steps the environments of one stream."""
        stream = None
        try:
            stream = self.streams.open()
            for request in requests:
                yield self.streams.answer(stream, request)
        except EnvironmentFailed as error:
            # The environment would fail again, so the client must not retry.
            context.abort(grpc.StatusCode.INVALID_ARGUMENT, str(error))
        except WorkerLost as error:
            context.abort(grpc.StatusCode.UNAVAILABLE, str(error))
        finally:
            if stream is not None:
                self.streams.close(stream)

    def handlers(self) -> grpc.GenericRpcHandler:
        """The calls by their names."""
        calls = {
            "DescribeEnvironment": grpc.unary_unary_rpc_method_handler(self.describe),
            "Play": grpc.stream_stream_rpc_method_handler(self.play),
        }
        return grpc.method_handlers_generic_handler(NAME, calls)


def serve(
    make: Callable[[], EnvironmentBatch], listen: str, streams: int = STREAMS, workers: int = 1
) -> tuple[grpc.Server, int]:
    """Starts the service. Returns the server and its port. Streams beyond `streams` are rejected.

    With several workers, `make` is sent to processes: it must be a function of a module. Raises `ValueError` if
    `listen` is not `HOST:PORT`, `OSError` if it cannot be used, and `EnvironmentFailed` if `make` fails.
    """
    demand_free(listen)
    service = Service(Streams(make) if workers == 1 else WorkerStreams(make, workers))
    options = [("grpc.max_receive_message_length", MAX_MESSAGE_BYTES), ("grpc.so_reuseport", 0)]
    server = grpc.server(futures.ThreadPoolExecutor(streams), options=options, maximum_concurrent_rpcs=streams)
    # After the program's own end of the server, and before the workers are terminated.
    atexit.register(service.streams.close_all)
    server.add_generic_rpc_handlers((service.handlers(),))
    try:
        port = server.add_insecure_port(listen)
    except RuntimeError as error:
        raise OSError(f"cannot listen on {listen}: {error}") from None
    server.start()
    return server, port


def place_of(listen: str) -> tuple[str, int]:
    """Host and port of `HOST:PORT`. gRPC would take another port for a number above 65535, and 443 for none."""
    found = re.fullmatch(r"(?:\[([0-9A-Fa-f:.]+)\]|([^\s:/\[\]]+)):(\d+)", listen, re.ASCII)
    if found is None:
        raise ValueError(f"{listen} is not of the form HOST:PORT, such as 127.0.0.1:50061")
    if int(found[3]) > 65535:
        raise ValueError(f"{listen}: the port {found[3]} is not a number from 0 to 65535")
    return found[1] or found[2], int(found[3])


def demand_free(listen: str) -> None:
    """Raises `OSError` if `listen` cannot be used, before environments are made; gRPC would not name the reason."""
    host, port = place_of(listen)
    try:
        kind, _, _, _, place = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE)[0]
        with socket.socket(kind, socket.SOCK_STREAM) as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            probe.bind(place)
    except OSError as error:
        advice = "choose another HOST:PORT"
        raise OSError(f"cannot listen on {listen}: {error.strerror or error}; {advice}") from None
