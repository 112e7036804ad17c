"""Searches the weights of the two terms of HAPPO-S2MIA in the game `cue-2x1` with Optuna: `pip install optuna`.

    python sweep_a_setting.py 20

Each trial is a whole training; `objective` takes any object with `suggest_float`.
"""

# %%
import sys
from typing import Any

import s2mia


# %% The last evaluation's mean return.
def objective(trial: Any) -> float:
    run = s2mia.train(
        "cue-2x1",
        run__iterations=4,
        run__seed=trial.number,
        surprise__alpha=trial.suggest_float("alpha", 1e-4, 1e-1, log=True),
        influence__lambda=trial.suggest_float("lambda", 1e-4, 1e-1, log=True),
    )
    return float(run.evaluations[-1]["mean"])


# %%
if __name__ == "__main__":
    import optuna

    study = optuna.create_study(direction="maximize", sampler=optuna.samplers.TPESampler(seed=1))
    study.optimize(objective, n_trials=int(sys.argv[1]))
    print(f"{study.best_value:.1f} with {study.best_params}")
