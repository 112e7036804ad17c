"""Notes about an environment, which the server prints once."""

import sys
from collections.abc import Callable

_printed: set[str] = set()


def show(topic: str, text: str) -> None:
    """Prints a note in one line, unless one with the same topic was printed before."""
    if topic not in _printed:
        _printed.add(topic)
        print(f"s2mia_environment: note: {' '.join(text.split())}", file=sys.stderr, flush=True)


class Notes:
    """Where the notes of this process go: to standard error, or from a worker to its server."""

    receive: Callable[[str, str], None] = staticmethod(show)


def note(topic: str, text: str) -> None:
    """Notes something that the environment's author should know and that is no error."""
    Notes.receive(topic, text)
