"""Environment steps per second with random actions, in Python: s2mia, gymnasium-robotics and EnvPool, alternately.

    pip install S2MIA.whl envpool==1.2.5 gymnasium-robotics==1.4.2 mujoco==4.0.0
    python benches/python/simulators.py [--rounds 5] [--secs 2] [--environments 64] [--threads 2]

Prints for each robot the medians of the rounds: environment steps per second, and microseconds of processor time of a step,
which other programs on the machine hardly change. `parallel_env` of s2mia and of gymnasium-robotics is one environment in one
thread. The last table is the processor time that a call of s2mia spends in Python: that of calls whose native answer is recorded.
"""

import argparse
import statistics
import time
from collections.abc import Callable

import envpool
import numpy as np
import s2mia
from gymnasium_robotics import mamujoco_v1

# Task, robot and partition of gymnasium-robotics, name in EnvPool.
ROBOTS = [
    ("halfcheetah-2x3", ("HalfCheetah", "2x3"), "HalfCheetah-v5"),
    ("walker2d-2x3", ("Walker2d", "2x3"), "Walker2d-v5"),
    ("ant-4x2", ("Ant", "4x2"), "Ant-v5"),
]
# Different actions that are sent in turn.
ACTIONS = 64
WARM_SECS = 0.3

Step = Callable[[int], object]


def parallel(env) -> Step:
    """Steps one PettingZoo environment."""
    rng = np.random.default_rng(0)
    sizes = {agent: env.action_space(agent).shape for agent in env.possible_agents}
    actions = [{agent: rng.uniform(-1, 1, size).astype(np.float32) for agent, size in sizes.items()} for _ in range(ACTIONS)]
    env.reset(seed=0)

    def step(call: int) -> None:
        if not env.agents:
            env.reset()
        env.step(actions[call % ACTIONS])

    return step


def vector(env) -> Step:
    """Steps environments that begin their next episode themselves."""
    rng = np.random.default_rng(0)
    actions = [rng.uniform(-1, 1, env.action_space.shape).astype(np.float32) for _ in range(ACTIONS)]
    env.reset()
    return lambda call: env.step(actions[call % ACTIONS])


class Pool:
    """EnvPool's environments, whose space of actions is that of one."""

    def __init__(self, name: str, environments: int, threads: int) -> None:
        self.env = envpool.make(name, env_type="gymnasium", num_envs=environments, num_threads=threads)
        self.action_space = np.empty((environments, *self.env.action_space.shape))
        self.reset, self.step = self.env.reset, self.env.step


def measured(step: Step, secs: float) -> tuple[float, float]:
    """Calls per second, and processor seconds per call."""
    begin, cpu, calls = time.perf_counter(), time.process_time(), 0
    while time.perf_counter() < begin + secs:
        step(calls)
        calls += 1
    return calls / (time.perf_counter() - begin), (time.process_time() - cpu) / calls


def contestants(robot, options) -> dict[str, tuple[Step, int]]:
    """What is measured for a robot, and how many environments each steps."""
    task, (scenario, partition), pool = robot
    count, threads = options.environments, options.threads
    many = s2mia.vector_env(task, num_envs=count, threads=threads)
    return {
        "s2mia.parallel_env": (parallel(s2mia.parallel_env(task)), 1),
        f"s2mia.vector_env, {count} x {threads} threads": (vector(many), count),
        "gymnasium-robotics parallel_env": (parallel(mamujoco_v1.parallel_env(scenario, partition)), 1),
        f"EnvPool, {count} x {threads} threads": (vector(Pool(pool, count, threads)), count),
    }


def race(steps: dict[str, tuple[Step, int]], options) -> dict[str, tuple[float, float]]:
    """Medians over the rounds of environment steps per second and processor seconds per step."""
    rates = {name: [] for name in steps}
    for step, _ in steps.values():
        measured(step, WARM_SECS)
    for _ in range(options.rounds):
        for name, (step, count) in steps.items():
            calls, cpu = measured(step, options.secs)
            rates[name].append((calls * count, cpu / count))
    return {name: tuple(map(statistics.median, zip(*rows, strict=True))) for name, rows in rates.items()}


class Recorded:
    """Answers as the native module, without a step of the simulator."""

    def __init__(self, simulator) -> None:
        numbers = simulator.num_envs * sum(agent.action_size for agent in simulator.task.agents)
        answer = simulator.native.step(np.zeros(numbers, np.float32).tobytes())
        self.step = lambda joint: answer


def call_cost(env, step: Step, options) -> float:
    """Processor seconds that a call spends in Python: the median over the rounds."""
    env.simulator.native = Recorded(env.simulator)
    measured(step, WARM_SECS)
    return statistics.median(measured(step, options.secs)[1] for _ in range(options.rounds))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--secs", type=float, default=2.0)
    parser.add_argument("--environments", type=int, default=64)
    parser.add_argument("--threads", type=int, default=2)
    options = parser.parse_args()
    print("| robot | simulator | environment steps/s | processor time of a step, µs |\n| --- | --- | --- | --- |")
    for robot in ROBOTS:
        for name, (rate, cpu) in race(contestants(robot, options), options).items():
            print(f"| {robot[0]} | {name} | {rate:,.0f} | {cpu * 1e6:.1f} |", flush=True)
    print(f"\n| robot | `parallel_env`, µs | `vector_env`, {options.environments}, µs |\n| --- | --- | --- |")
    for task, *_ in ROBOTS:
        one, many = s2mia.parallel_env(task), s2mia.vector_env(task, num_envs=options.environments)
        costs = [call_cost(one, parallel(one), options), call_cost(many, vector(many), options)]
        print(f"| {task} | {' | '.join(f'{secs * 1e6:.1f}' for secs in costs)} |", flush=True)


if __name__ == "__main__":
    main()
