"""Server of Python environments for s2mia: any PettingZoo `ParallelEnv`, or a class with five methods.

    server.py    the service, for any `Environment`
    parallel.py  a PettingZoo `ParallelEnv` as an `Environment`
    mujoco.py    multi-agent MuJoCo of gymnasium-robotics, whose states can be saved
"""

from s2mia_environment.parallel import Parallel
from s2mia_environment.server import Environment, serve

__all__ = ["Environment", "Parallel", "serve"]
