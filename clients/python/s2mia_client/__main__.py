"""`python -m s2mia_client HOST:PORT` is an actor for runs of `cue-2x1`."""

import sys

import numpy as np

from s2mia_client import Learner, act_for
from s2mia_client.cue import KIND, Cue


def main() -> int:
    if len(sys.argv) != 2:
        print(__doc__, file=sys.stderr)
        return 2
    learner = Learner(sys.argv[1])
    offered = learner.run.environment
    if offered.state_kind != KIND:
        print(f"{offered.task} is not supported; this actor supports only cue-2x1", file=sys.stderr)
        return 2
    print(f"run {learner.run.run_id}, actor {learner.actor_id}")
    done = act_for(learner, Cue, np.random.default_rng())
    print(f"the run is over; {done} leases completed")
    return 0


if __name__ == "__main__":
    sys.exit(main())
