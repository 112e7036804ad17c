"""Environment steps per second of the environment server, with multi-agent MuJoCo and without a learner.

    pip install 'clients/python[mujoco]'
    python benches/python/environment_load.py [--scenario HalfCheetah] [--agent-conf 2x3] [--workers 2] [--streams 2]
        [--environments 10] [--secs 10] [--repetitions 5]

Starts the server on this machine. Each stream has a client process, which steps its environments together with
uniformly random actions and resets those whose episode ended, as an actor does. Prints the rate of each repetition and
the median.
"""

import argparse
import multiprocessing
import queue
import statistics
import subprocess
import sys
import time

import numpy as np

# Different actions that a client sends in turn.
ACTIONS = 64


def start(arguments) -> tuple[subprocess.Popen, str]:
    """Starts the server. Returns its process and its address."""
    settings = [f"scenario={arguments.scenario}", f"agent_conf={arguments.agent_conf}", "observation=full_id"]
    module = ["-m", "s2mia_environment", "--listen", "127.0.0.1:0", "--workers", str(arguments.workers)]
    command = [sys.executable, *module, "s2mia_environment.mujoco:multi_agent", *settings]
    server = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
    words = server.stdout.readline().split()
    if not words:
        raise SystemExit("the server did not start; run it alone to see why: python " + " ".join(command[1:]))
    return server, words[-1].removeprefix("http://")


def load(address: str, stream: int, count: int, ready, until, steps) -> None:
    """Steps the environments of one stream from the barrier `ready` to the time `until`. Adds them to `steps`."""
    import grpc
    from s2mia import wire

    channel = grpc.insecure_channel(address)
    service = wire.EnvironmentServiceStub(channel)
    spec = service.DescribeEnvironment(wire.DescribeEnvironmentRequest()).environment
    requests = queue.SimpleQueue()
    answers = service.Play(iter(requests.get, None))

    def ask(request):
        requests.put(request)
        return next(answers)

    def reset(environment: int, episode: int) -> None:
        seed = np.array([stream, environment, episode, 0], "<u8").tobytes()
        ask(wire.PlayRequest(reset=wire.ResetEnvironment(environment=environment, seed=seed)))

    rng = np.random.default_rng(stream)
    uniform = [
        [rng.uniform(-1, 1, (count, agent.action.size)).astype(np.float32) for agent in spec.agents]
        for _ in range(ACTIONS)
    ]
    moves = [
        wire.PlayRequest(
            step=wire.StepEnvironments(environments=range(count), actions=[wire.tensor(rows) for rows in actions])
        )
        for actions in uniform
    ]
    for environment in range(count):
        reset(environment, 0)
    ready.wait()
    done = 0
    while time.monotonic() < until.value:
        taken = ask(moves[done % ACTIONS]).steps
        done += 1
        for row, (terminated, truncated) in enumerate(zip(taken.terminated.data, taken.truncated.data, strict=True)):
            if terminated or truncated:
                reset(row, done)
    with steps.get_lock():
        steps.value += done * count
    requests.put(None)
    channel.close()


def measure(arguments, address: str) -> float:
    """Environment steps per second of all streams together."""
    context = multiprocessing.get_context("spawn")
    ready, until, steps = context.Barrier(arguments.streams + 1), context.Value("d"), context.Value("q")
    clients = [
        context.Process(target=load, args=(address, stream, arguments.environments, ready, until, steps))
        for stream in range(arguments.streams)
    ]
    until.value = float("inf")
    for client in clients:
        client.start()
    ready.wait()
    begin = time.monotonic()
    until.value = begin + arguments.secs
    for client in clients:
        client.join()
    return steps.value / (time.monotonic() - begin)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--scenario", default="HalfCheetah")
    parser.add_argument("--agent-conf", default="2x3")
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--streams", type=int, default=2, help="one for each actor")
    parser.add_argument("--environments", type=int, default=10, help="environments per message")
    parser.add_argument("--secs", type=float, default=10.0)
    parser.add_argument("--repetitions", type=int, default=5)
    arguments = parser.parse_args()
    server, address = start(arguments)
    try:
        rates = []
        for _ in range(arguments.repetitions):
            rates.append(measure(arguments, address))
            print(f"{rates[-1]:,.0f} environment steps/s", flush=True)
    finally:
        server.kill()
        server.wait()
    print(f"median {statistics.median(rates):,.0f} environment steps/s")


if __name__ == "__main__":
    main()
