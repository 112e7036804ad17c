"""The client of a learner, for actors."""

import contextlib
import hashlib
import os
import struct
import threading
from collections.abc import Callable, Iterable, Iterator
from typing import Any

from s2mia import wire
from s2mia.connection import CALL_SECS, Connection, Tls
from s2mia.name import check

# Limit of every message, in both directions.
# The description of a run is the largest message; the learner sends no other one of more than 4 MiB.
MAX_DESCRIPTION_BYTES = 16 * 1024 * 1024
# Limit of a snapshot.
MAX_WEIGHTS_BYTES = 1 << 30
# Version of the protocol that this package has, as in proto/src/lib.rs.
PROTOCOL_VERSION = 5
LEASE_WAIT_MILLIS = 5_000
# Maximum number of unacknowledged results.
MAX_UNACKNOWLEDGED = 4
# Id by which the learner recognises the connections of one process, which gets no backup leases of its own slow slots.
PROCESS = os.urandom(16)


def chunk_digest(chunk: Any, rollout: Any) -> bytes:
    """SHA-256 of a chunk of the slot `rollout`, as trajectory.proto describes it."""
    sha = hashlib.sha256(b"s2mia.v1.TrajectoryChunk")

    def blob(data: bytes) -> None:
        sha.update(struct.pack("<Q", len(data)) + data)

    environments = [start.environment for start in rollout.environments]
    sha.update(struct.pack("<QIQ", rollout.iteration, rollout.slot, len(environments)))
    sha.update(struct.pack(f"<{len(environments)}I", *environments))
    sha.update(struct.pack("<3I", chunk.sequence, chunk.first_step, chunk.steps))
    for agent in chunk.agents:
        for tensor in (agent.observation, agent.action, agent.log_prob, agent.hidden):
            blob(tensor.data)
    for tensor in (chunk.state, chunk.reward, chunk.terminated, chunk.truncated):
        blob(tensor.data)
    finals = chunk.finals
    sha.update(struct.pack("<Q", len(finals.steps)))
    for step, environment in zip(finals.steps, finals.environments, strict=True):
        sha.update(struct.pack("<2I", step, environment))
    blob(finals.state.data)
    for tensor in finals.observations:
        blob(tensor.data)
    sha.update(b"\x01" if chunk.HasField("end") else b"\x00")
    if chunk.HasField("end"):
        for state in chunk.end.environments:
            blob(state)
        for tensor in chunk.end.recurrent:
            blob(tensor.data)
    if chunk.reward_terms:
        blob(struct.pack(f"<{len(chunk.reward_terms)}d", *chunk.reward_terms))
    return sha.digest()


def evaluation_digest(result: Any, iteration: int) -> bytes:
    """SHA-256 of the result of an episode with the policies after `iteration`."""
    figures = struct.pack("<QIdI", iteration, result.episode, result.extrinsic_return, result.steps)
    if terms := result.reward_terms:
        figures += struct.pack(f"<Q{len(terms)}d", 8 * len(terms), *terms)
    return hashlib.sha256(b"s2mia.v1.EvaluationResult" + figures).digest()


def _problem(run: Any) -> str | None:
    """Why no actor can work for this run; `None` if one can."""
    if run.protocol_version != PROTOCOL_VERSION:
        versions = f"the learner has protocol version {run.protocol_version}, this package has {PROTOCOL_VERSION}"
        return f"{versions}; use the package of the learner's version"
    if not (run.chunk_steps and run.slot_steps and run.hidden_every) or run.slot_steps % run.chunk_steps:
        steps = f"slot_steps {run.slot_steps}, chunk_steps {run.chunk_steps}, hidden_every {run.hidden_every}"
        return f"the description of the run is invalid: {steps}"
    # What timers can hold.
    if not 1e-9 <= run.heartbeat_secs <= 1e9:
        return f"the description of the run is invalid: heartbeat_secs {run.heartbeat_secs}"
    return None


class Learner:
    """One connection and one registration. `token` is the run's token; by default, that of S2MIA_TOKEN, if it is set."""

    def __init__(
        self,
        address: str,
        client: str = "s2mia-python",
        *,
        tls: Tls | None = None,
        insecure_allow_remote: bool = False,
        token: str | None = None,
    ) -> None:
        """Registers as an actor. `address` is `HOST:PORT`, `http://HOST:PORT`, or with `tls` `https://HOST:PORT`.

        Raises `ValueError` for an invalid address, name `client`, certificate or token. Raises `ConnectionError`, as every
        call, if the learner does not answer or refuses the call.
        """
        check(client, "the name of the client")
        options = [("grpc.max_receive_message_length", MAX_DESCRIPTION_BYTES)]
        self._connection = Connection(
            address,
            wire.LearnerServiceStub,
            tls,
            insecure_allow_remote=insecure_allow_remote,
            token=token,
            options=options,
        )
        self.channel, self.service = self._connection.channel, self._connection.service
        self.metadata = self._connection.metadata
        try:
            self._register(client)
        except ConnectionError:
            self._connection.close()
            raise

    def _register(self, client: str) -> None:
        self.run = self._connection.first_call("DescribeRun", wire.DescribeRunRequest()).run
        if problem := _problem(self.run):
            raise ConnectionError(f"{self._connection.address}: {problem}")
        registration = wire.RegisterRequest(
            client=client,
            protocol_version=PROTOCOL_VERSION,
            environment=self.run.environment,
            process=PROCESS,
        )
        own = self._connection.call("Register", registration)
        self.actor_id, self.incarnation = own.actor_id, own.incarnation

    def close(self) -> None:
        """Ends the registration and its leases."""
        self.channel.close()

    def lease(self) -> Any:
        """Returns the next lease, or None if the run is over."""
        request = wire.LeaseSlotsRequest(
            actor_id=self.actor_id, incarnation=self.incarnation, wait_millis=LEASE_WAIT_MILLIS
        )
        while True:
            response = self._connection.call("LeaseSlots", request, CALL_SECS + LEASE_WAIT_MILLIS / 1000)
            match response.WhichOneof("answer"):
                case "lease":
                    return response.lease
                case "done":
                    return None
                case None:
                    raise ConnectionError(f"{self._connection.address}: the learner's answer to LeaseSlots is unknown")

    def weights(self, name: Any) -> bytes:
        """Returns the snapshot `name`."""
        snapshot = bytearray()
        request = wire.GetWeightsRequest(weights=name, repeats=True)
        with self._connection.errors():
            for part in self._connection.call("GetWeights", request, 60.0):
                earlier = part.repeat
                snapshot += part.data + snapshot[earlier.offset : earlier.offset + earlier.length]
                if len(snapshot) > MAX_WEIGHTS_BYTES:
                    raise ValueError(f"weights {name.version} have more than {MAX_WEIGHTS_BYTES} bytes")
        if hashlib.sha256(snapshot).digest() != name.digest:
            raise ValueError(f"weights {name.version} do not match their digest")
        return bytes(snapshot)

    def heartbeat(self, lease: Any, step: int) -> bool:
        """Keeps a lease alive. Returns False if the lease ended."""
        request = wire.HeartbeatRequest(
            actor_id=self.actor_id, incarnation=self.incarnation, lease_id=lease.lease_id, slot_step=step
        )
        return bool(self._connection.call("Heartbeat", request).lease_valid)

    def return_lease(self, lease: Any, failure: int, detail: str) -> None:
        """Returns a lease that cannot be processed; `failure` is a `LeaseFailure`."""
        request = wire.ReturnLeaseRequest(
            actor_id=self.actor_id,
            incarnation=self.incarnation,
            lease_id=lease.lease_id,
            failure=failure,
            detail=detail,
        )
        self._connection.call("ReturnLease", request)

    def message(self, lease: Any, content: Any) -> Any:
        """The message with a chunk or evaluation result of a lease."""
        message = wire.PushTrajectoryRequest(
            lease_id=lease.lease_id, incarnation=lease.incarnation, weights=lease.weights
        )
        if isinstance(content, wire.TrajectoryChunk):
            message.chunk.CopyFrom(content)
            message.digest = chunk_digest(content, lease.rollout)
        else:
            message.evaluation.CopyFrom(content)
            message.digest = evaluation_digest(content, lease.evaluation.iteration)
        return message

    def push(self, lease: Any, contents: Iterable[Any]) -> bool:
        """Sends a lease's results as they are computed. Returns True if the learner has the complete result.

        An error of `contents` is raised as it is, after the call was cancelled.
        """
        free = threading.Semaphore(MAX_UNACKNOWLEDGED)
        begun = threading.Event()
        pushed = [0]
        failed: list[Exception] = []

        def messages() -> Iterator[Any]:
            try:
                for content in contents:
                    while not free.acquire(timeout=0.5):
                        if begun.is_set() and not call.is_active():
                            return
                    pushed[0] += 1
                    yield self.message(lease, content)
            except Exception as error:
                # gRPC would replace it by the status UNKNOWN.
                failed.append(error)
                begun.wait()
                call.cancel()

        with self._connection.errors():
            call = self.service.PushTrajectory(messages(), metadata=self.metadata)
        begun.set()
        with self._heartbeats(lease, lambda: pushed[0] * self.run.chunk_steps):
            finished = False
            try:
                with self._connection.errors():
                    for acknowledgement in call:
                        free.release()
                        finished |= acknowledgement.lease_finished
            except ConnectionError:
                if not failed:
                    raise
            if failed:
                raise failed[0]
            return finished

    @contextlib.contextmanager
    def _heartbeats(self, lease: Any, step: Callable[[], int]) -> Iterator[None]:
        """Sends heartbeats within the context, because environments may be slow."""
        over = threading.Event()

        def beat() -> None:
            while not over.wait(self.run.heartbeat_secs):
                # The stream of results has the reason.
                with contextlib.suppress(ConnectionError):
                    self.heartbeat(lease, min(step(), self.run.slot_steps))

        thread = threading.Thread(target=beat, daemon=True)
        thread.start()
        try:
            yield
        finally:
            over.set()
            thread.join()
