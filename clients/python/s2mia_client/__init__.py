"""Clients of s2mia in plain Python: gRPC and NumPy, made from the .proto files alone. First of all an actor.

    learner.py  the connection: what the run is about, leases, weights, results
    policy.py   the agents' policies as a snapshot carries them
    actor.py    rolls out what is leased, in any environment with four methods
    cue.py      such an environment: the game `cue-2x1`
    team.py     acts by policies that are served, without computing them
    wire.py     the messages
"""

from s2mia_client.actor import act_for
from s2mia_client.learner import Learner
from s2mia_client.policy import Policy
from s2mia_client.team import Team

__all__ = ["Learner", "Policy", "Team", "act_for"]
