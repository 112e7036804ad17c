"""Trains a whole robot with PPO of Stable-Baselines3, as one agent.

    pip install S2MIA.whl stable-baselines3==2.9.2
    python stable_baselines.py halfcheetah --steps 300000 --seed 1

Prints the returns of ten episodes with mean actions.
"""

import argparse
from typing import Any

import s2mia
from stable_baselines3 import PPO
from stable_baselines3.common.env_util import make_vec_env
from stable_baselines3.common.evaluation import evaluate_policy
from stable_baselines3.common.vec_env import VecNormalize


def main() -> None:
    """Trains and evaluates."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("robot", nargs="?", default="halfcheetah")
    parser.add_argument("--steps", type=int, default=300_000)
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()

    def robot() -> Any:
        return s2mia.gym_env(options.robot)

    robots = VecNormalize(make_vec_env(robot, n_envs=8, seed=options.seed))
    # The batch of an update is 4,000 steps, as in this project's comparison with HARL; all else is the library's default.
    learner = PPO("MlpPolicy", robots, n_steps=500, batch_size=500, seed=options.seed, device="cpu", verbose=1)
    learner.learn(options.steps)
    robots.training, robots.norm_reward = False, False
    returns, _ = evaluate_policy(learner, robots, n_eval_episodes=10, return_episode_rewards=True)
    print("returns:", *(f"{own:.0f}" for own in returns))


if __name__ == "__main__":
    main()
