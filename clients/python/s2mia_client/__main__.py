"""`python -m s2mia_client HOST:PORT` plays `cue-2x1` for a learner until its run is done."""

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
        print(f"{offered.task} is another environment than cue-2x1, which is all that this one plays", file=sys.stderr)
        return 2
    print(f"run {learner.run.run_id}, actor {learner.actor_id}")
    done = act_for(learner, Cue, np.random.default_rng())
    print(f"the run is over; {done} leases done")
    return 0


if __name__ == "__main__":
    sys.exit(main())
