"""Serves environments made by FUNCTION to s2mia: PettingZoo `ParallelEnv`s, or environments of this package.

    python -m s2mia_environment [--listen HOST:PORT] [--streams N] [--workers N] PACKAGE.module:FUNCTION [NAME=VALUE]...

Each NAME=VALUE is an argument of FUNCTION. A VALUE that is not JSON is a string.
"""

import argparse
import functools
import json
import multiprocessing
import os
import signal
import sys
import threading

from s2mia.arguments import Parser

from s2mia_environment.making import batch_of
from s2mia_environment.server import STREAMS, place_of, serve
from s2mia_environment.streams import EnvironmentFailed
from s2mia_environment.workers import WorkerLost

# How long calls may take to end when the server stops.
STOP_SECS = 5.0
# How often the main thread looks for a signal that did not end its wait.
POLL_SECS = 0.2


def value(text: str):
    """Parses JSON; other text is a string."""
    try:
        return json.loads(text)
    except json.JSONDecodeError:
        return text


def cores() -> int:
    """Cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _arguments() -> argparse.Namespace:
    parser = Parser(prog="s2mia_environment", description=__doc__.splitlines()[0])
    parser.add_argument("--listen", default="127.0.0.1:50061", metavar="HOST:PORT")
    parser.add_argument("--streams", type=int, default=STREAMS, metavar="N", help="stream limit; an actor has two")
    parser.add_argument("--workers", type=int, default=cores(), metavar="N", help="processes; default: one per core")
    parser.add_argument("function", metavar="PACKAGE.module:FUNCTION")
    parser.add_argument("settings", nargs="*", metavar="NAME=VALUE")
    arguments = parser.parse_intermixed_args()
    pairs = [setting.partition("=") for setting in arguments.settings]
    if not arguments.function.partition(":")[2] or not all(key and equals for key, equals, _ in pairs):
        parser.error("expected PACKAGE.module:FUNCTION NAME=VALUE ...")
    arguments.settings = {key: value(text) for key, _, text in pairs}
    if len(arguments.settings) < len(pairs):
        parser.error("a NAME=VALUE is given twice")
    for option in ("streams", "workers"):
        if getattr(arguments, option) < 1:
            parser.error(f"--{option} must be at least 1, is {getattr(arguments, option)}")
    try:
        place_of(arguments.listen)
    except ValueError as error:
        parser.error(f"--listen {error}")
    return arguments


def _fail(line: str) -> int:
    print(f"s2mia_environment: {line}", file=sys.stderr)
    return 1


def main() -> int:
    """The program. Returns its exit status, 0 also if Ctrl-C or SIGTERM stopped it."""
    arguments = _arguments()
    make = functools.partial(batch_of, arguments.function, arguments.settings)
    try:
        server, port = serve(make, arguments.listen, arguments.streams, arguments.workers)
    except (EnvironmentFailed, WorkerLost) as error:
        return _fail(f"cannot make {arguments.function}: {error}")
    except OSError as error:
        return _fail(str(error))
    except KeyboardInterrupt:
        return 128 + signal.SIGINT
    stopped = threading.Event()

    def stop(number: int, _frame) -> None:
        # The second signal ends the process at once.
        signal.signal(number, signal.SIG_DFL)
        stopped.set()

    signal.signal(signal.SIGINT, stop)
    signal.signal(signal.SIGTERM, stop)
    host = arguments.listen.rpartition(":")[0]
    print(f"offers {arguments.function} at http://{host}:{port}", flush=True)
    # Only the main thread handles a signal, whose wait it does not end if another thread received it or the wait had
    # not begun.
    while not stopped.wait(POLL_SECS):
        pass
    # An environment may never return from a step, for which the end of the server and of this process waits.
    deadline = threading.Timer(STOP_SECS, _end_at_once)
    deadline.daemon = True
    deadline.start()
    server.stop(None).wait()
    return 0


def _end_at_once() -> None:
    for worker in multiprocessing.active_children():
        worker.kill()
    os._exit(1)


if __name__ == "__main__":
    sys.exit(main())
