"""Clients of s2mia in Python with gRPC and NumPy, based only on the .proto files: an actor and a policy client.

    learner.py  connection to a learner: run description, leases, weights, results
    policy.py   the agents' policies in a snapshot
    actor.py    computes leased work in any `Environment`
    cue.py      an environment: the game `cue-2x1`
    team.py     client of served policies
    wire.py     the messages
"""

from s2mia_client.actor import act_for
from s2mia_client.learner import Learner
from s2mia_client.policy import Policy
from s2mia_client.team import Team

__all__ = ["Learner", "Policy", "Team", "act_for"]
