"""s2mia in Python: the simulator, training, trained policies, tables of runs, and clients of the gRPC services.

    parallel.py     the simulator as a PettingZoo `ParallelEnv`: `parallel_env`
    vector.py       as a Gymnasium `VectorEnv` of teams: `vector_env`
    single.py       as a Gymnasium `Env` with one agent: `gym_env`
    simulator.py    what these have in common
    run.py          trains with the program, and reads a run: `train`, `Run`
    settings.py     settings as keywords
    values.py       agents, and checks of seeds and arrays
    policies.py     trained policies in this process: `load`, `pretrained`
    team.py         trained policies that a server computes: `Team`
    acting.py       what both have in common
    tables.py       settings and metrics of runs as data frames: `runs`
    control.py      queries and controls a learner: `Client`
    connection.py   addresses and certificates: `Tls`
    learner.py      connection of an actor to a learner: `Learner`
    actor.py        computes leased work in any environment: `act_for`, and `python -m s2mia.actor`
    policy.py       the networks and distributions with which it acts
    cue.py          an environment: the game `cue-2x1`
    arguments.py    arguments of programs
    environment.py  server of environments: the package `s2mia_environment`
    wire.py         the messages

A module is imported when a name from it is first used: gRPC, pandas, PettingZoo, Gymnasium and the native module `_native`, of
the simulator and `policies.py`, are needed only then.
"""

import importlib
import importlib.util
import sys
from typing import TYPE_CHECKING, Any

from s2mia.error import RunError

if TYPE_CHECKING:
    from s2mia._native import VERSION
    from s2mia.actor import act_for
    from s2mia.connection import Tls
    from s2mia.control import Client, Progress, Status
    from s2mia.learner import Learner
    from s2mia.parallel import parallel_env
    from s2mia.policies import Policies, load, pretrained
    from s2mia.run import Run, train
    from s2mia.single import gym_env
    from s2mia.tables import Runs, runs
    from s2mia.team import Team
    from s2mia.vector import vector_env

    __version__ = VERSION

__all__ = [
    "Client",
    "Learner",
    "Policies",
    "Progress",
    "Run",
    "RunError",
    "Runs",
    "Status",
    "Team",
    "Tls",
    "act_for",
    "gym_env",
    "load",
    "parallel_env",
    "pretrained",
    "runs",
    "train",
    "vector_env",
]

_MODULES = {
    "Client": "control",
    "Learner": "learner",
    "Policies": "policies",
    "Progress": "control",
    "Run": "run",
    "Runs": "tables",
    "Status": "control",
    "Team": "team",
    "Tls": "connection",
    "act_for": "actor",
    "gym_env": "single",
    "load": "policies",
    "parallel_env": "parallel",
    "pretrained": "policies",
    "runs": "tables",
    "train": "run",
    "vector_env": "vector",
}


# Optional packages, by the names that need them. Without the package, `help(s2mia)` omits the name.
_EXTRAS = {"Runs": "pandas", "runs": "pandas", "gym_env": "gymnasium", "parallel_env": "pettingzoo", "vector_env": "gymnasium"}
for _name, _extra in _EXTRAS.items():
    if sys.modules.get(_extra) is None and (_extra in sys.modules or importlib.util.find_spec(_extra) is None):
        __all__.remove(_name)


def __getattr__(name: str) -> Any:
    if name == "environment":
        return importlib.import_module("s2mia.environment")
    if name == "__version__":
        return importlib.import_module("s2mia._native").VERSION
    if name in _MODULES:
        return getattr(importlib.import_module(f"s2mia.{_MODULES[name]}"), name)
    raise AttributeError(f"module 's2mia' has no attribute {name!r}")


def __dir__() -> list[str]:
    return [*__all__, "__version__"]
