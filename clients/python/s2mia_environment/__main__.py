"""Serves environments made by FUNCTION to s2mia: PettingZoo `ParallelEnv`s, or `Environment`s of this package.

    python -m s2mia_environment [--listen HOST:PORT] [--streams N] PACKAGE.module:FUNCTION [NAME=VALUE ...]

Each NAME=VALUE is an argument of FUNCTION. A VALUE that is not JSON is a string.
"""

import argparse
import functools
import importlib
import json

from s2mia_environment.parallel import Parallel
from s2mia_environment.server import STREAMS, Environment, serve


def value(text: str):
    """Parses JSON; other text is a string."""
    try:
        return json.loads(text)
    except json.JSONDecodeError:
        return text


def make(function, settings: dict) -> Environment:
    """Makes one environment."""
    made = function(**settings)
    return made if isinstance(made, Environment) else Parallel(made)


def main() -> None:
    parser = argparse.ArgumentParser(prog="s2mia_environment", description=__doc__.splitlines()[0])
    parser.add_argument("--listen", default="127.0.0.1:50061", metavar="HOST:PORT")
    parser.add_argument("--streams", type=int, default=STREAMS, metavar="N", help="stream limit; an actor has two")
    parser.add_argument("function", metavar="PACKAGE.module:FUNCTION")
    parser.add_argument("settings", nargs="*", metavar="NAME=VALUE")
    arguments = parser.parse_args()
    module, _, name = arguments.function.partition(":")
    if not name or not all("=" in setting for setting in arguments.settings):
        parser.error("expected PACKAGE.module:FUNCTION NAME=VALUE ...")
    if arguments.streams < 1:
        parser.error(f"--streams must be at least 1, is {arguments.streams}")
    settings = {key: value(text) for key, _, text in (setting.partition("=") for setting in arguments.settings)}
    function = getattr(importlib.import_module(module), name)
    server, port = serve(functools.partial(make, function, settings), arguments.listen, arguments.streams)
    host = arguments.listen.rpartition(":")[0]
    print(f"offers {arguments.function} at http://{host}:{port}", flush=True)
    server.wait_for_termination()


if __name__ == "__main__":
    main()
