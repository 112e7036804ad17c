"""An actor in Python: computes leases, each one slot or one evaluation episode.

    python -m s2mia.actor HOST:PORT [--tls-ca FILE --tls-certificate FILE --tls-key FILE] [--tls-server-name NAME]

is an actor for runs of `cue-2x1`.
"""

import argparse
import signal
import sys
from collections.abc import Callable, Iterable, Iterator
from typing import Any, Protocol

import grpc
import numpy as np

from s2mia import shared_noise, wire
from s2mia.arguments import Parser
from s2mia.connection import CallError, Tls
from s2mia.cue import KIND, Cue
from s2mia.learner import Learner
from s2mia.name import printable
from s2mia.policy import Policy
from s2mia.shared_noise import Floats


class Environment(Protocol):
    """One environment of the run's task."""

    def reset(self, episode: int, limit: int, rng: np.random.Generator) -> None:
        """Starts an episode that is truncated after `limit` steps."""

    def step(self, actions: list[Floats]) -> tuple[float, bool, bool]:
        """Takes one action `[act]` per agent. Returns reward, terminated, truncated."""

    def observe(self) -> tuple[Floats, list[Floats]]:
        """Returns the global state `[S]` and one observation `[obs]` per agent."""

    def save(self) -> bytes:
        """Encodes the state for `restore`, in the encoding `state_kind` of the run."""

    def restore(self, state: bytes) -> int:
        """Continues from a saved state. Returns the index of its episode."""


class StartStateError(ValueError):
    """A start state of a lease cannot be restored."""


class Slot:
    """`E` environments of one lease, and their agents' recurrent states."""

    def __init__(
        self, run: Any, work: Any, policy: Policy, make: Callable[[], Environment], rng: np.random.Generator
    ) -> None:
        self.run, self.work, self.policy, self.rng = run, work, policy, rng
        self.indices = [start.environment for start in work.environments]
        self.environments = [make() for _ in work.environments]
        self.episodes = [0] * len(self.environments)
        count = len(self.environments)
        self.hidden = [np.zeros((count, agent.hidden_size), np.float32) for agent in policy.agents]
        for row, start in enumerate(work.environments):
            if start.WhichOneof("start") == "fresh":
                self._reset(row, start.fresh.episode, start.fresh.limit)
            else:
                self._restore(row, start)
                for hidden, kept in zip(self.hidden, start.continued.recurrent, strict=True):
                    hidden[row] = wire.array(kept)

    def _restore(self, row: int, start: Any) -> None:
        try:
            self.episodes[row] = self.environments[row].restore(start.continued.state)
        except Exception as error:
            raise StartStateError(f"environment {start.environment}: {type(error).__name__}: {error}") from error

    def _reset(self, row: int, episode: int, limit: int) -> None:
        self.episodes[row] = episode
        self.environments[row].reset(episode, limit, self.rng)
        for hidden in self.hidden:
            hidden[row] = 0

    def chunks(self) -> Iterator[Any]:
        """Yields the slot's chunks as they are completed."""
        for sequence in range(self.run.slot_steps // self.run.chunk_steps):
            yield self._chunk(sequence)

    def _chunk(self, sequence: int) -> Any:
        length = self.run.chunk_steps
        rows: dict[str, list[Any]] = {name: [] for name in ("state", "reward", "terminated", "truncated")}
        names = ("observation", "action", "log_prob", "hidden")
        agents: list[dict[str, list[Any]]] = [{name: [] for name in names} for _ in self.hidden]
        finals: list[Any] = []
        for step in range(sequence * length, (sequence + 1) * length):
            self._step(step, rows, agents, finals)
        last = (sequence + 1) * length == self.run.slot_steps
        return wire.TrajectoryChunk(
            sequence=sequence,
            first_step=sequence * length,
            steps=length,
            agents=[self._agent(collected) for collected in agents],
            state=wire.tensor(np.stack(rows["state"])),
            reward=wire.tensor(np.array(rows["reward"], np.float32)),
            terminated=wire.tensor(np.array(rows["terminated"], bool)),
            truncated=wire.tensor(np.array(rows["truncated"], bool)),
            finals=self._finals(finals),
            end=self._end() if last else None,
        )

    def _step(self, step: int, rows: dict[str, Any], agents: list[dict[str, Any]], finals: list[Any]) -> None:
        """Observes, acts, steps, and resets ended episodes."""
        seen = [environment.observe() for environment in self.environments]
        rows["state"].append(np.stack([state for state, _ in seen]))
        signal = self.policy.signal(self.run.seed, shared_noise.TRAINING, self.work.iteration, self.indices, step)
        drawn = []
        for index, (agent, collected) in enumerate(zip(self.policy.agents, agents, strict=True)):
            if step % self.run.hidden_every == 0:
                collected["hidden"].append(self.hidden[index].copy())
            observation = np.stack([observations[index] for _, observations in seen]).astype(np.float32)
            output, self.hidden[index] = agent.forward(observation, self.hidden[index])
            output = agent.shifted(output, signal)
            action = agent.draw(output, self.rng)
            collected["observation"].append(observation)
            collected["action"].append(action)
            collected["log_prob"].append(agent.log_prob(output, action))
            drawn.append(action)
        outcomes = [
            environment.step([action[row] for action in drawn]) for row, environment in enumerate(self.environments)
        ]
        for name, values in zip(("reward", "terminated", "truncated"), zip(*outcomes, strict=True), strict=True):
            rows[name].append(values)
        for row, (_, terminated, truncated) in enumerate(outcomes):
            ended = terminated or truncated
            if ended or step + 1 == self.run.slot_steps:
                finals.append((step, row, *self.environments[row].observe()))
            if ended:
                self._reset(row, self.episodes[row] + 1, self.run.environment.episode_steps)

    def _agent(self, collected: dict[str, Any]) -> Any:
        return wire.AgentChunk(**{name: wire.tensor(np.stack(rows)) for name, rows in collected.items()})

    def _finals(self, finals: list[Any]) -> Any:
        """The true next states and observations that are not in the following row."""
        spec = self.run.environment
        states = [state for _, _, state, _ in finals]
        observations = [
            np.array([final[3][index] for final in finals], np.float32).reshape(len(finals), len(agent.observation))
            for index, agent in enumerate(spec.agents)
        ]
        return wire.FinalSteps(
            steps=[final[0] for final in finals],
            environments=[final[1] for final in finals],
            state=wire.tensor(np.array(states, np.float32).reshape(len(finals), len(spec.state))),
            observations=[wire.tensor(rows) for rows in observations],
        )

    def _end(self) -> Any:
        return wire.SlotEnd(
            environments=[environment.save() for environment in self.environments],
            recurrent=[wire.tensor(hidden) for hidden in self.hidden],
        )


def evaluate(run: Any, work: Any, policy: Policy, environment: Environment, rng: np.random.Generator) -> Any:
    """Computes one whole episode with mean actions or the likeliest choices, or with sampled ones if the run has these."""
    environment.reset(work.episode, run.environment.episode_steps, rng)
    hidden = [np.zeros((1, agent.hidden_size), np.float32) for agent in policy.agents]
    total, steps, ended = 0.0, 0, False
    while not ended:
        _, observations = environment.observe()
        actions = []
        for index, agent in enumerate(policy.agents):
            output, hidden[index] = agent.forward(observations[index][None], hidden[index])
            if run.sampled_evaluations:
                signal = policy.signal((run.seed + work.episode) % 2**64, shared_noise.SAMPLED, 0, [0], steps)
                actions.append(agent.draw(agent.shifted(output, signal), rng)[0])
            else:
                actions.append(agent.mode(output)[0])
        reward, terminated, truncated = environment.step(actions)
        total, steps, ended = total + float(reward), steps + 1, terminated or truncated
    return wire.EvaluationResult(episode=work.episode, extrinsic_return=total, steps=steps)


def act_for(learner: Learner, make: Callable[[], Environment], rng: np.random.Generator) -> int:
    """Works for a learner until its run is over, in environments from `make()`. Returns the number of leases."""
    held, done = None, 0
    while (lease := learner.lease()) is not None:
        results: Iterable[Any]
        try:
            if lease.weights.digest != held:
                held, policy = lease.weights.digest, Policy(learner.weights(lease.weights))
            try:
                if lease.WhichOneof("work") == "rollout":
                    results = Slot(learner.run, lease.rollout, policy, make, rng).chunks()
                else:
                    results = [evaluate(learner.run, lease.evaluation, policy, make(), rng)]
                done += learner.push(lease, results)
            except StartStateError as error:
                # The state is from another actor; another lease may have other states.
                learner.return_lease(lease, wire.LEASE_FAILURE_START_STATE, str(error))
        except CallError as error:
            # The lease ended, for example because it was reissued; continue with another.
            if error.code() != grpc.StatusCode.ABORTED:
                raise
    return done


def _arguments() -> argparse.Namespace:
    parser = Parser(prog="python -m s2mia.actor", description="An actor for runs of cue-2x1.")
    parser.add_argument("learner", metavar="HOST:PORT", help="or a URL")
    for name in ("ca", "certificate", "key"):
        parser.add_argument(f"--tls-{name}", metavar="FILE")
    parser.add_argument("--tls-server-name", metavar="NAME")
    arguments = parser.parse_args()
    files = (arguments.tls_ca, arguments.tls_certificate, arguments.tls_key)
    if any(files) and not all(files):
        parser.error("--tls-ca, --tls-certificate and --tls-key belong together")
    arguments.tls = Tls(*files, arguments.tls_server_name) if all(files) else None
    return arguments


def _work(arguments: argparse.Namespace) -> int:
    learner = Learner(arguments.learner, tls=arguments.tls)
    offered = learner.run.environment
    if offered.state_kind != KIND:
        raise ValueError(f"{printable(offered.task)} is not supported; this actor supports only cue-2x1")
    print(f"run {printable(learner.run.run_id)}, actor {learner.actor_id}", flush=True)
    return act_for(learner, Cue, np.random.default_rng())


def main() -> int:
    """The program `python -m s2mia.actor`. Returns its exit status, 0 also if Ctrl-C or SIGTERM stopped it."""
    arguments = _arguments()
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        done = _work(arguments)
    except KeyboardInterrupt:
        print("stopped", file=sys.stderr)
        return 0
    except (OSError, ValueError) as error:
        print(error, file=sys.stderr)
        return 1 if isinstance(error, ConnectionError) else 2
    print(f"the run is over; {done} leases completed")
    return 0


if __name__ == "__main__":
    sys.exit(main())
