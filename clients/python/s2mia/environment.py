"""The server of Python environments: all names of the package `s2mia_environment`, whose program is
`python -m s2mia_environment`."""

from s2mia_environment import *  # noqa: F403
from s2mia_environment import __all__ as __all__
