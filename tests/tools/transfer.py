"""Plays policies that were trained here in MuJoCo, and policies that were trained in MuJoCo here; prints a row per task.

    pip install mujoco==4.0.0 'clients/python[mujoco]'
    for seed in 1 2 3; do s2mia train ant-4x2 run.seed=$seed run.dir=runs/ant-4x2-$seed; done
    python3 tests/tools/transfer.py runs/*

Give runs of HalfCheetah, Walker2d and Ant, also such as `configs/experiments/study-mujoco.toml` trains. A policy gets
no sample of the other simulator. `s2mia eval` plays at home here; all other episodes are played through PettingZoo's
interface, in MuJoCo in the environments of gymnasium-robotics, with its starts, rewards and ends of episodes.

Of Ant's contact forces, which a policy trained here does not observe, the others observe zeros here.
"""

import argparse
import json
import pathlib
import sys

from program import evaluated

# What the tasks pay for each step of a robot that has not fallen.
ALIVE = {"HalfCheetah": 0.0, "Walker2d": 1.0, "Ant": 1.0}
MUJOCO = "mujoco/"
STEPS = 1000


def in_mujoco(robot, partition):
    """The environment of gymnasium-robotics."""
    return mamujoco_v1.parallel_env(robot, partition, agent_factorization=factorization(robot, partition))


def observed(state, size):
    """The part of the global state that a policy observes, followed by zeros where its own simulator has contact forces."""
    return numpy.pad(numpy.asarray(state, numpy.float32), (0, max(0, size - len(state))))[:size]


def played(policies, env, seed):
    """Return and steps of an episode with mean actions. Every agent observes the state and its number."""
    env.reset(seed=seed)
    policies.reset()
    agents = list(env.possible_agents)
    identity = numpy.eye(len(agents), dtype=numpy.float32)
    size = policies.agents[0].observation_size - len(agents)
    total, steps = 0.0, 0
    while env.agents:
        state = observed(env.state(), size)
        actions = policies.act([numpy.concatenate([state, number]) for number in identity])
        # Half a range is 1: the motors of the three robots take controls from -1 to 1.
        _, rewards, *_ = env.step({agent: action.clip(-1, 1) for agent, action in zip(agents, actions, strict=True)})
        total, steps = total + float(rewards[agents[0]]), steps + 1
    return total, steps


def compared(run, episodes):
    """The task by whose name the policies were trained, their robot, and their episodes at home and abroad."""
    task = json.loads((run / "manifest.json").read_text())["environment"]
    # Between them stands `pushed` in tasks whose pushes evaluations leave out.
    robot, *_, partition = task.removeprefix(MUJOCO).split("-")
    robot = {name.lower(): name for name in ROBOTS}.get(robot, robot)
    if robot not in ALIVE:
        sys.exit(f"{run}: {task} is no task of {', '.join(ROBOTS)}")
    policies, seeds = s2mia.load(run), range(episodes)
    mujoco = in_mujoco(robot, partition)
    there = [played(policies, mujoco, seed) for seed in seeds]
    if not task.startswith(MUJOCO):
        return task, robot, evaluated(run, episodes), there
    own = s2mia.parallel_env(f"{robot.lower()}-{partition}")
    return task, robot, there, [played(policies, own, seed) for seed in seeds]


def row(task, robot, runs):
    """A task's row of the table. `runs` has each run's episodes at home and abroad."""
    episodes = numpy.array(runs)
    returns = episodes[..., 0].mean(axis=2)
    # The part of the return that is not paid for each step without a fall.
    moved = (episodes[..., 0] - ALIVE[robot] * episodes[..., 1]).mean(axis=(0, 2))
    full = (episodes[..., 1] == STEPS).sum(axis=(0, 2))
    ratios = returns[:, 1] / returns[:, 0]
    home, abroad = returns.mean(axis=0)
    spread = f"{abroad / home:.2f} ({ratios.min():.2f} to {ratios.max():.2f})"
    count = episodes.shape[0] * episodes.shape[2]
    cells = [task, len(runs), f"{home:,.0f}", f"{abroad:,.0f}", spread, f"{moved[1] / moved[0]:.2f}"]
    cells += [f"{number} of {count}" for number in full]
    return f"| {' | '.join(map(str, cells))} |"


def load_packages():
    """Imports what the help of this program does not need."""
    global ROBOTS, factorization, mamujoco_v1, numpy, s2mia
    import numpy
    import s2mia
    from gymnasium_robotics import mamujoco_v1
    from s2mia_environment.partitions import ROBOTS, factorization


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("runs", nargs="+", type=pathlib.Path)
    parser.add_argument("--episodes", type=int, default=10)
    options = parser.parse_args()
    load_packages()
    tasks = {}
    for run in options.runs:
        task, robot, home, abroad = compared(run, options.episodes)
        tasks.setdefault((task, robot), []).append((home, abroad))
        print(run, f"home {numpy.mean(home, axis=0)}, abroad {numpy.mean(abroad, axis=0)}", file=sys.stderr)
    print("| task | runs | home | abroad | ratio | without `alive` | full at home | full abroad |")
    for (task, robot), runs in tasks.items():
        print(row(task, robot, runs))


if __name__ == "__main__":
    main()
