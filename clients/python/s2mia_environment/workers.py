"""Worker processes, each of which steps the environments of some streams."""

import contextlib
import enum
import itertools
import json
import multiprocessing
import pickle
import signal
import struct
import threading
from collections.abc import Callable, Iterator

from s2mia_environment.environment import EnvironmentBatch
from s2mia_environment.notes import Notes, show
from s2mia_environment.streams import EnvironmentFailed, Streams

# Kind of a message to a worker and the number of its stream. A request follows.
_HEADER = struct.Struct("<BQ")
# First byte of a worker's message. An answer, the text of an error, or a note follows. Notes precede the answer.
_ANSWER, _ERROR, _NOTE = b"\0", b"\1", b"\2"

# Seconds for which the failure of one worker waits for the first message of another.
_START_SECS = 10.0
# Seconds for which the end of the program waits until a worker has closed its environments.
_CLOSE_SECS = 3.0


class _Kind(enum.IntEnum):
    BEGIN = 0
    REQUEST = 1
    CLOSE = 2


class WorkerLost(Exception):
    """A worker process ended, and its environments with it."""


class Worker:
    """A worker process. It handles one message at a time."""

    def __init__(self, make: Callable[[], EnvironmentBatch]) -> None:
        # A forked process would inherit the locks, but not the threads, of gRPC and of the environments' libraries.
        context = multiprocessing.get_context("spawn")
        self.pipe, theirs = context.Pipe()
        self.process = context.Process(target=_work, args=(make, theirs), name="environments", daemon=True)
        try:
            with _without_interrupts():
                self.process.start()
        except (AttributeError, TypeError, pickle.PicklingError) as error:
            raise ValueError(f"with several workers, make must be a function of a module: {error}") from None
        theirs.close()
        self.lock = threading.Lock()
        self.streams = 0
        self.failure: EnvironmentFailed | None = None

    def receive(self) -> bytes:
        """Waits for the worker's next message, and shows the notes before it."""
        while True:
            try:
                message = self.pipe.recv_bytes()
            except (EOFError, OSError):
                raise self._lost() from None
            if message[:1] == _NOTE:
                show(*json.loads(message[1:]))
                continue
            if message[:1] == _ERROR:
                raise EnvironmentFailed(message[1:].decode())
            return message[1:]

    def ask(self, kind: _Kind, stream: int, request: bytes = b"") -> bytes:
        """The answer to one message."""
        if self.failure is not None:
            raise EnvironmentFailed(str(self.failure))
        with self.lock:
            try:
                self.pipe.send_bytes(_HEADER.pack(kind, stream) + request)
            except OSError:
                raise self._lost() from None
            return self.receive()

    def _lost(self) -> WorkerLost:
        self.process.join(timeout=1)
        return WorkerLost(f"a worker process ended with exit code {self.process.exitcode}; its environments are lost")


class WorkerStreams:
    """Streams whose environments step in `count` worker processes: each stream in the one with the fewest streams."""

    def __init__(self, make: Callable[[], EnvironmentBatch], count: int) -> None:
        self.make, self.lock, self.numbers = make, threading.Lock(), itertools.count()
        self.workers = [Worker(make) for _ in range(count)]
        try:
            # A worker sends the description when it is ready.
            self.description = [worker.receive() for worker in self.workers][0]
        except (EnvironmentFailed, WorkerLost):
            # Other workers fail, too, and print their tracebacks: the line of the failure follows them.
            for worker in self.workers:
                worker.pipe.poll(_START_SECS)
            raise
        self.of_stream: dict[int, Worker] = {}

    def open(self) -> int:
        """Starts a stream. Returns its number."""
        with self.lock:
            worker, number = min(self.workers, key=lambda worker: worker.streams), next(self.numbers)
            worker.streams += 1
            self.of_stream[number] = worker
        try:
            self._ask(_Kind.BEGIN, number)
        except Exception:
            self._forget(number)
            raise
        return number

    def answer(self, number: int, request: bytes) -> bytes:
        """Answers one request of the stream."""
        return self._ask(_Kind.REQUEST, number, request)

    def close(self, number: int) -> None:
        """Ends the stream and its environments."""
        try:
            with contextlib.suppress(WorkerLost):
                self._ask(_Kind.CLOSE, number)
        finally:
            self._forget(number)

    def close_all(self) -> None:
        """Ends all workers, which close their environments."""
        for worker in self.workers:
            worker.pipe.close()
        for worker in self.workers:
            worker.process.join(timeout=_CLOSE_SECS)

    def _forget(self, number: int) -> None:
        with self.lock:
            self.of_stream.pop(number).streams -= 1

    def _ask(self, kind: _Kind, number: int, request: bytes = b"") -> bytes:
        worker = self.of_stream[number]
        try:
            return worker.ask(kind, number, request)
        except WorkerLost:
            self._replace(worker)
            raise

    def _replace(self, lost: Worker) -> None:
        """Starts another process for one that ended, once for all its streams."""
        with self.lock:
            if lost in self.workers:
                other = Worker(self.make)
                self.workers[self.workers.index(lost)] = other
                try:
                    other.receive()
                except EnvironmentFailed as error:
                    # The streams that it gets say so.
                    other.failure = error
                except WorkerLost:
                    # The next request to it replaces it.
                    pass


@contextlib.contextmanager
def _without_interrupts() -> Iterator[None]:
    """Blocks Ctrl-C, also in a process that is started meanwhile."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _work(make: Callable[[], EnvironmentBatch], pipe) -> None:
    """Handles messages until the server closes the pipe."""
    # Ctrl-C reaches the whole process group. The workers end with the server.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    Notes.receive = lambda *note: pipe.send_bytes(_NOTE + json.dumps(note).encode())
    try:
        try:
            streams = Streams(make)
        except EnvironmentFailed as error:
            pipe.send_bytes(_encoded(error))
            return
        try:
            pipe.send_bytes(_ANSWER + streams.description)
            while True:
                pipe.send_bytes(_handled(streams, pipe.recv_bytes()))
        finally:
            streams.close_all()
    except (EOFError, OSError):
        return


def _encoded(error: EnvironmentFailed) -> bytes:
    return _ERROR + str(error).encode(errors="replace")


def _handled(streams: Streams, message: bytes) -> bytes:
    kind, number = _HEADER.unpack_from(message)
    try:
        match _Kind(kind):
            case _Kind.BEGIN:
                streams.begin(number)
            case _Kind.REQUEST:
                return _ANSWER + streams.answer(number, message[_HEADER.size :])
            case _Kind.CLOSE:
                streams.close(number)
    except EnvironmentFailed as error:
        return _encoded(error)
    return _ANSWER
