"""The built program, as other programs of this folder use it."""

import json
import os
import subprocess
import sys

from debian import ROOT


def s2mia(*arguments):
    """What the program prints. `S2MIA` names another one than the release build."""
    binary = os.environ.get("S2MIA", ROOT / "target" / "release" / "s2mia")
    done = subprocess.run([binary, *map(str, arguments)], stdout=subprocess.PIPE, text=True)
    if done.returncode:
        sys.exit(f"s2mia {' '.join(map(str, arguments))} failed")
    return done.stdout


def evaluated(run, episodes=10):
    """Return and steps of each evaluation episode of a run's newest policies."""
    told = json.loads(s2mia("eval", run, "--episodes", episodes, "--json"))
    return [(episode["return"], episode["steps"]) for episode in told["episodes"]]
