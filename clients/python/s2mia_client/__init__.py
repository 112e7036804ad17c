"""An actor for a learner of s2mia in plain Python: gRPC and NumPy, made from the .proto files alone.

    learner.py  the connection: what the run is about, leases, weights, results
    policy.py   the agents' policies as a snapshot carries them
    actor.py    rolls out what is leased, in any environment with four methods
    cue.py      such an environment: the game `cue-2x1`
    wire.py     the messages
"""

from s2mia_client.actor import act_for
from s2mia_client.learner import Learner
from s2mia_client.policy import Policy

__all__ = ["Learner", "Policy", "act_for"]
