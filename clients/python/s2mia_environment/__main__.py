"""Serves environments made by FUNCTION to s2mia: PettingZoo `ParallelEnv`s, or environments of this package.

    python -m s2mia_environment [--listen HOST:PORT] [--streams N] [--workers N] PACKAGE.module:FUNCTION [NAME=VALUE]...

Each NAME=VALUE is an argument of FUNCTION. A VALUE that is not JSON is a string.
"""

import argparse
import functools
import json
import os

from s2mia_environment.parallel import batch_of
from s2mia_environment.server import STREAMS, serve
from s2mia_environment.streams import EnvironmentFailed
from s2mia_environment.workers import WorkerLost


def value(text: str):
    """Parses JSON; other text is a string."""
    try:
        return json.loads(text)
    except json.JSONDecodeError:
        return text


def cores() -> int:
    """Cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def main() -> None:
    parser = argparse.ArgumentParser(prog="s2mia_environment", description=__doc__.splitlines()[0])
    parser.add_argument("--listen", default="127.0.0.1:50061", metavar="HOST:PORT")
    parser.add_argument("--streams", type=int, default=STREAMS, metavar="N", help="stream limit; an actor has two")
    parser.add_argument("--workers", type=int, default=cores(), metavar="N", help="processes; default: one per core")
    parser.add_argument("function", metavar="PACKAGE.module:FUNCTION")
    parser.add_argument("settings", nargs="*", metavar="NAME=VALUE")
    arguments = parser.parse_args()
    if not arguments.function.partition(":")[2] or not all("=" in setting for setting in arguments.settings):
        parser.error("expected PACKAGE.module:FUNCTION NAME=VALUE ...")
    for option in ("streams", "workers"):
        if getattr(arguments, option) < 1:
            parser.error(f"--{option} must be at least 1, is {getattr(arguments, option)}")
    settings = {key: value(text) for key, _, text in (setting.partition("=") for setting in arguments.settings)}
    make = functools.partial(batch_of, arguments.function, settings)
    try:
        server, port = serve(make, arguments.listen, arguments.streams, arguments.workers)
    except (ImportError, AttributeError, TypeError, ValueError, EnvironmentFailed, WorkerLost) as error:
        parser.exit(1, f"s2mia_environment: cannot make {arguments.function}: {error}\n")
    host = arguments.listen.rpartition(":")[0]
    print(f"offers {arguments.function} at http://{host}:{port}", flush=True)
    server.wait_for_termination()


if __name__ == "__main__":
    main()
