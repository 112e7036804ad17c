"""Queries and controls a running learner: `ControlService` of control.proto, without a registration."""

import dataclasses
import math
import numbers
from collections.abc import Iterator
from typing import Any

from s2mia import wire
from s2mia.closing import Closing
from s2mia.connection import Connection, Tls
from s2mia.name import printable
from s2mia.values import whole


@dataclasses.dataclass(frozen=True)
class Lease:
    """An open lease, of a slot or of an episode of an evaluation."""

    lease_id: int
    actor_id: int
    slot: int | None
    episode: int | None
    chunks: int
    """Chunks received for it."""
    still_secs: float
    """Seconds since its last progress."""


@dataclasses.dataclass(frozen=True)
class Status:
    """Status of a run. `GetStatusResponse` in control.proto describes each number."""

    run_id: str
    incarnation: int
    iteration: int
    env_steps: int
    slots: int
    complete_slots: int
    actors: int
    env_steps_per_sec: float | None
    messages_refused: int
    leases_reissued: int
    slots_backed_up: int
    audits_agreed: int
    storage_degraded: bool
    leases: tuple[Lease, ...]
    """Open leases, the oldest first."""


@dataclasses.dataclass(frozen=True)
class Evaluation:
    """Results of evaluation episodes."""

    iteration: int
    """Number of iterations that trained the policies."""
    mean: float
    """Mean extrinsic return."""
    standard_deviation: float
    episodes: int


@dataclasses.dataclass(frozen=True)
class Progress:
    """Progress at the end of an iteration, or of the learner."""

    run_id: str
    iteration: int
    env_steps: int
    env_steps_per_sec: float
    episode_return: float | None
    """Mean extrinsic return of the last finished episodes, at most 20."""
    evaluation: Evaluation | None
    """The newest complete evaluation since the learner started."""
    end: str | None
    """`finished` or `stopped` in the last message of a learner."""


def _field(message: Any, name: str) -> Any:
    """The value of a field, a text as it can be printed; `None` if it is absent."""
    if message.DESCRIPTOR.fields_by_name[name].has_presence and not message.HasField(name):
        return None
    value = getattr(message, name)
    return printable(value) if isinstance(value, str) else value


def _fields(kind: type[Any], message: Any) -> dict[str, Any]:
    return {field.name: _field(message, field.name) for field in dataclasses.fields(kind)}


class Client(Closing):
    """A connection to a learner. No call changes the results of training."""

    def __init__(
        self,
        url: str,
        *,
        tls: Tls | None = None,
        insecure_allow_remote: bool = False,
        timeout_secs: float = 60.0,
        token: str | None = None,
    ) -> None:
        """Prepares a connection to `url`: `HOST:PORT`, `http://HOST:PORT`, or with `tls` `https://HOST:PORT`.

        Raises `ValueError` for an invalid address, certificate, token or time. Every call raises `ConnectionError` if the
        learner does not answer within `timeout_secs`, or refuses the call. To stop `s2mia train`, it needs the `token`
        of its run folder; by default, that of S2MIA_TOKEN is sent.
        """
        is_number = isinstance(timeout_secs, numbers.Real) and not isinstance(timeout_secs, bool)
        if not (is_number and 0.0 < timeout_secs < math.inf):
            raise ValueError(f"timeout_secs is {timeout_secs!r}; it is a positive number")
        self.url, self.timeout_secs = url, timeout_secs
        self._connection = Connection(
            url, wire.ControlServiceStub, tls, insecure_allow_remote=insecure_allow_remote, token=token
        )

    def _call(self, name: str, request: Any) -> Any:
        return self._connection.call(name, request, self.timeout_secs)

    def status(self) -> Status:
        """Returns the status of the run."""
        message = self._call("GetStatus", wire.GetStatusRequest())
        leases = tuple(Lease(**_fields(Lease, lease)) for lease in message.leases)
        return Status(**{**_fields(Status, message), "leases": leases})

    def watch(self, after_iteration: int = 0) -> Iterator[Progress]:
        """Yields one item for each finished iteration after `after_iteration`, and a last one with `end`.

        The learner has the last 256 iterations since its start. Raises `ConnectionError` if the stream breaks; to
        continue, call again with the last iteration that was received.
        """
        after = whole("after_iteration", after_iteration, 0, 2**64 - 1)
        request = wire.WatchRunRequest(after_iteration=after)
        with self._connection.errors():
            stream = self._connection.service.WatchRun(request)
        try:
            with self._connection.errors():
                for message in stream:
                    yield self._progress(message)
        finally:
            stream.cancel()

    def _progress(self, message: Any) -> Progress:
        fields = _fields(Progress, message)
        ends = {wire.RUN_END_FINISHED: "finished", wire.RUN_END_STOPPED: "stopped"}
        fields["end"] = ends.get(message.end)
        if fields["evaluation"] is not None:
            fields["evaluation"] = Evaluation(**_fields(Evaluation, message.evaluation))
        return Progress(**fields)

    def stop(self) -> None:
        """Ends the learner with a checkpoint."""
        self._call("Stop", wire.StopRequest())

    def close(self) -> None:
        """Closes the connection."""
        self._connection.close()
