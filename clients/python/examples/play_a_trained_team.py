"""Compares the runs of a folder, then plays one of its trained teams in the game `cue-2x1`.

    pip install 'S2MIA.whl[environment,pandas]'
    s2mia train cue-2x1 run.dir=runs/cue
    python play_a_trained_team.py runs/cue

The marks `# %%` divide it into cells for editors that run cells.
"""

# %%
import sys

import s2mia

if len(sys.argv) != 2:
    sys.exit("usage: python play_a_trained_team.py FOLDER, with a run of cue-2x1 in it")
folder = sys.argv[1]

# %% One row per run: the settings that differ, and the results.
try:
    table, metrics, evaluations = s2mia.runs(folder)
except s2mia.RunError as error:
    sys.exit(str(error))
print(table.T.to_string())

# %% Learning curves: the mean return of training episodes, averaged over ten iterations.
returns = metrics.pivot(index="iteration", columns="run", values="episode_return")
print(returns.rolling(10, min_periods=1).mean().iloc[:: max(1, len(returns) // 5)].to_string())

# %% The newest policies of a run whose task is the game.
games = table[table["task"] == "cue-2x1"]
if games.empty:
    sys.exit(f"{folder} has no run of cue-2x1; train one with `s2mia train cue-2x1 run.dir=runs/cue`")
newest = games["folder"].iloc[0]
for agent in s2mia.load(newest).agents:
    print(f"{agent.name}: {agent.observation_size} numbers observed, one of {agent.choices} choices made")


# %% Many games at once: observations [E, N, obs] and choices [E, N] of E environments.
def play(team: s2mia.Policies, environments: int) -> float:
    """Mean return of one game in each environment."""
    envs = s2mia.vector_env("cue-2x1", num_envs=environments, seed=1)
    observations, _ = envs.reset()
    total = 0.0
    for _ in range(envs.task.episode_steps):
        observations, rewards, *_ = envs.step(team.act(observations))
        total += float(rewards.sum())
    return total / environments


print(f"most likely choices: {play(s2mia.load(newest), 20):.1f} of 50")
print(f"sampled choices: {play(s2mia.load(newest, seed=1), 20):.1f} of 50")
