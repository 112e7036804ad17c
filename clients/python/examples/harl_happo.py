"""Trains a robot of s2mia with HAPPO of HARL (github.com/PKU-MARL/HARL), which knows nothing of this project.

    pip install 'S2MIA.whl[environment]' torch==2.8.0 tensorboardX setproctitle pyyaml absl-py
    python harl_happo.py CHECKOUT_OF_HARL halfcheetah-2x3 --steps 300000 --seed 1 --out results

The settings are those that HARL's authors tuned for the robot of MuJoCo. Progress is in `progress.txt` in a folder of `--out`.
"""

import argparse
import json
import pathlib
import sys
from typing import Any

import s2mia

# HARL's tuned settings of the same robot.
TUNED = {"halfcheetah": "HalfCheetah-v2-2x3", "walker2d": "Walker2d-v2-2x3", "ant": "Ant-v2-4x2"}


class Robot:
    """A robot with the interface of HARL's environments, over PettingZoo's."""

    def __init__(self, task: str, seed: int) -> None:
        self.env = s2mia.parallel_env(task, seed=seed)
        self.agents = list(self.env.possible_agents)
        self.n_agents = len(self.agents)
        self.observation_space = [self.env.observation_space(agent) for agent in self.agents]
        self.action_space = [self.env.action_space(agent) for agent in self.agents]
        self.share_observation_space = [self.env.state_space] * self.n_agents

    def reset(self) -> tuple[list[Any], list[Any], None]:
        """Observations and states of all agents. Without masks of choices, because actions are continuous."""
        observations, _ = self.env.reset()
        return [observations[agent] for agent in self.agents], self._states(), None

    def step(self, actions: Any) -> tuple[list[Any], list[Any], list[list[float]], list[bool], list[dict[str, bool]], None]:
        """The actions of all agents."""
        joint = dict(zip(self.agents, actions, strict=True))
        observations, rewards, terminated, truncated, _ = self.env.step(joint)
        seen = [observations[agent] for agent in self.agents]
        done = [terminated[agent] or truncated[agent] for agent in self.agents]
        # HARL takes the value of the last state of an episode that only its length ended.
        infos = [{"bad_transition": truncated[agent]} for agent in self.agents]
        return seen, self._states(), [[rewards[agent]] for agent in self.agents], done, infos, None

    def close(self) -> None:
        """HARL calls it at the end."""
        self.env.close()

    def _states(self) -> list[Any]:
        return [self.env.state()] * self.n_agents


def settings(checkout: pathlib.Path, task: str, options: argparse.Namespace) -> tuple[dict[str, Any], dict[str, Any]]:
    """HARL's tuned settings with our number of steps, and what names the folder of results."""
    robot, _, partition = task.partition("-")
    tuned = checkout / "tuned_configs" / "mamujoco" / TUNED[robot] / "happo" / "config.json"
    algorithm = json.loads(tuned.read_text())["algo_args"]
    algorithm["device"].update(cuda=False, torch_threads=1)
    algorithm["seed"]["seed"] = options.seed
    algorithm["logger"]["log_dir"] = str(options.out)
    algorithm["train"].update(num_env_steps=options.steps)
    algorithm["eval"].update(use_eval=True, n_eval_rollout_threads=10, eval_episodes=10)
    return algorithm, {"scenario": robot, "agent_conf": partition}


def main() -> None:
    """Trains."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("harl", type=pathlib.Path)
    parser.add_argument("task", nargs="?", default="halfcheetah-2x3")
    parser.add_argument("--steps", type=int, default=300_000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--out", type=pathlib.Path, default=pathlib.Path("results"))
    options = parser.parse_args()
    sys.path.insert(0, str(options.harl))
    # absl, which HARL imports, reads the arguments that are left.
    sys.argv = sys.argv[:1]
    from harl.envs.env_wrappers import ShareDummyVecEnv
    from harl.runners import RUNNER_REGISTRY, on_policy_base_runner

    def robots(first: int) -> Any:
        def made(_: str, seed: int, count: int, __: dict[str, Any]) -> Any:
            # Numbers apart, so that no two environments of a run start alike.
            numbers = range(first + 1000 * seed, first + 1000 * seed + count)
            return ShareDummyVecEnv([lambda own=own: Robot(options.task, own) for own in numbers])

        return made

    on_policy_base_runner.make_train_env = robots(0)
    on_policy_base_runner.make_eval_env = robots(500)
    names = {"algo": "happo", "env": "mamujoco", "exp_name": "s2mia"}
    runner = RUNNER_REGISTRY["happo"](names, *settings(options.harl, options.task, options))
    runner.run()
    runner.close()


if __name__ == "__main__":
    main()
