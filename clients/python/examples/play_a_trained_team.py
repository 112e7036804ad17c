"""Compares the runs of a folder, then plays one of its trained teams in the game `cue-2x1`, with NumPy and pandas.

    s2mia train cue-2x1 run.dir=runs/cue
    python play_a_trained_team.py runs/cue

The marks `# %%` divide it into cells for editors that run cells.
"""

# %%
import sys

import numpy as np
import s2mia
from s2mia.cue import STEPS, Cue

folder = sys.argv[1]

# %% One row per run: the settings that differ, and the results.
table, metrics, evaluations = s2mia.runs(folder)
print(table.T.to_string())

# %% Learning curves: the mean return of training episodes, averaged over ten iterations.
returns = metrics.pivot(index="iteration", columns="run", values="episode_return")
print(returns.rolling(10, min_periods=1).mean().iloc[:: max(1, len(returns) // 5)].to_string())

# %% The newest policies of a run whose task is the game.
games = table[table["task"] == "cue-2x1"]
team = s2mia.load(games["folder"].iloc[0])
for index, agent in enumerate(team.agents):
    print(f"agent {index}: {agent.observation_size} numbers observed, one of {agent.choices} choices made")


# %% Many games at once. The leading axis of observations [E, N, obs] and actions [E, N, act] is the environment.
def play(environments: int, rng: np.random.Generator, *, sampled: bool) -> float:
    """Mean return of one game in each environment, with the most likely or with sampled choices."""
    games = [Cue() for _ in range(environments)]
    for episode, game in enumerate(games):
        game.reset(episode, STEPS, rng)
    team.reset()
    total = 0.0
    for _ in range(STEPS):
        observations = np.stack([game.observe()[1] for game in games])
        actions = team.act(observations, rng if sampled else None)
        total += sum(game.step(list(own))[0] for game, own in zip(games, actions, strict=True))
    return total / environments


rng = np.random.default_rng(1)
print(f"most likely choices: {play(20, rng, sampled=False):.1f} of {STEPS}")
print(f"sampled choices: {play(20, rng, sampled=True):.1f} of {STEPS}")
