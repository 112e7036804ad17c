"""Server of Python environments for s2mia: any PettingZoo `ParallelEnv`, or a class of the user's own.

    environment.py    the interfaces: `Environment` steps alone, `EnvironmentBatch` has several that step together
    server.py         the service
    streams.py        answers requests in this process
    workers.py        answers requests in worker processes
    making.py         environments of PACKAGE.module:FUNCTION
    notes.py          what the server says once about an environment
    observations.py   observations as checked rows of numbers
    parallel.py       a PettingZoo `ParallelEnv` as an `Environment`
    mujoco.py         multi-agent MuJoCo of gymnasium-robotics, whose states can be saved
    partitions.py     which agent controls which joints
    robots.py         HalfCheetah, Walker2d and Ant as an `EnvironmentBatch`, without gymnasium's wrappers
"""

from s2mia_environment.environment import Environment, EnvironmentBatch, InvalidEnvironment
from s2mia_environment.parallel import Parallel
from s2mia_environment.server import serve

__all__ = ["Environment", "EnvironmentBatch", "InvalidEnvironment", "Parallel", "serve"]
