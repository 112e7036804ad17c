"""The service `EnvironmentService`, with separate environments per stream, which worker processes step."""

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

    With several workers, `make` is sent to processes: it must be a function of a module.
    """
    service = Service(Streams(make) if workers == 1 else WorkerStreams(make, workers))
    options = [("grpc.max_receive_message_length", MAX_MESSAGE_BYTES), ("grpc.so_reuseport", 0)]
    server = grpc.server(futures.ThreadPoolExecutor(streams), options=options, maximum_concurrent_rpcs=streams)
    server.add_generic_rpc_handlers((service.handlers(),))
    port = server.add_insecure_port(listen)
    server.start()
    return server, port
