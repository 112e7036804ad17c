"""Trains a whole robot with CMA-ES of PyPI's package `cma`: one agent, a linear policy, no gradients.

    pip install 'S2MIA.whl[environment]' cma
    python cma_es.py halfcheetah --generations 100 --steps 500

Prints the best return of each generation, and at the end that of the best policy.
"""

import argparse
from typing import Any

import cma
import gymnasium
import numpy as np
import s2mia


def played(env: gymnasium.Env[Any, Any], weights: Any, steps: int) -> float:
    """Return of the first steps of the episode of seed 0. The policy is linear in the observation and a constant."""
    observation, _ = env.reset(seed=0)
    policy = np.reshape(weights, (-1, len(observation) + 1))
    total = 0.0
    for _ in range(steps):
        action = np.clip(policy @ [*observation, 1.0], -1, 1).astype(np.float32)
        observation, reward, terminated, truncated, _ = env.step(action)
        total += float(reward)
        if terminated or truncated:
            break
    return total


def main() -> None:
    """Trains."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("robot", nargs="?", default="halfcheetah")
    parser.add_argument("--generations", type=int, default=100)
    parser.add_argument("--steps", type=int, default=500)
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    env = s2mia.gym_env(options.robot)
    start = np.zeros((len(env.observation_space.sample()) + 1) * len(env.action_space.sample()))
    search = cma.CMAEvolutionStrategy(start, 0.1, {"seed": options.seed, "verbose": -9})
    print(f"start: {played(env, start, options.steps):.1f}")
    for generation in range(1, options.generations + 1):
        candidates = search.ask()
        returns = [played(env, candidate, options.steps) for candidate in candidates]
        search.tell(candidates, [-own for own in returns])
        print(f"generation {generation}: {max(returns):.1f}", flush=True)
    print(f"end: {played(env, search.result.xbest, options.steps):.1f}")


if __name__ == "__main__":
    main()
