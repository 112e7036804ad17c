"""A client that misbehaves: every refusal as it looks from outside, and a run that is none the worse for it."""

import hashlib
import re
import socket
import subprocess

import numpy as np
from conftest import FEW, ROOT, command, hashes, refusal
from s2mia import Learner, wire
from s2mia.actor import Slot
from s2mia.cue import Cue
from s2mia.policy import Policy

NAN = np.float32("nan")


class Attacker:
    """One connection with one lease, and the first chunk that an honest actor would send."""

    def __init__(self, address: str) -> None:
        self.learner = Learner(address, client="attacker")
        self.lease = self.learner.lease()
        policy = Policy(self.learner.weights(self.lease.weights))
        rng = np.random.default_rng(0)
        self.chunks = Slot(self.learner.run, self.lease.rollout, policy, Cue, rng).chunks()
        self.chunk = next(self.chunks)

    def push(self, *messages) -> None:
        for _ in self.learner.service.PushTrajectory(iter(messages), timeout=30):
            pass

    def send(self, spoil_chunk=None, spoil_message=None) -> None:
        if spoil_chunk:
            spoil_chunk(self.chunk)
        message = self.learner.message(self.lease, self.chunk)
        if spoil_message:
            spoil_message(message)
        self.push(message)


def spoil(tensor, index: int, value: float) -> None:
    array = wire.array(tensor).copy()
    array.flat[index] = value
    tensor.data = array.tobytes()


def shape(tensor, *sizes: int) -> None:
    tensor.shape[:] = sizes


def lie(tensor) -> None:
    tensor.data = b"\x01" + tensor.data[1:]


def set_field(name: str, value):
    return lambda message: setattr(message, name, value)


def other_version(message) -> None:
    message.weights.version += 7


CHUNKS = {
    "a chunk without its rewards": ("MISSING_FIELD", "chunk.reward", lambda c: c.ClearField("reward")),
    "one agent too few": ("BAD_SHAPE", "chunk.agents", lambda c: c.agents.pop()),
    "an element type that nobody knows": ("BAD_TYPE", "chunk.state", lambda c: set_field("data_type", 9)(c.state)),
    "a shape that is not the run's": ("BAD_SHAPE", "chunk.reward", lambda c: shape(c.reward, 9, 2)),
    "a shape whose product overflows": ("BAD_SHAPE", "chunk.reward", lambda c: shape(c.reward, 2**32 - 1, 2**32 - 1)),
    "bytes that are too few": ("BAD_SHAPE", "chunk.state", lambda c: set_field("data", c.state.data[:-4])(c.state)),
    "a flag that is no flag": ("BAD_VALUE", "chunk.terminated",
                               lambda c: set_field("data", b"\x07" + c.terminated.data[1:])(c.terminated)),
    "NaN in an observation": ("NOT_FINITE", "chunk.agents[1].observation", lambda c: spoil(c.agents[1].observation, 3, NAN)),
    "an infinite reward": ("NOT_FINITE", "chunk.reward", lambda c: spoil(c.reward, 0, np.inf)),
    "a choice that is none": ("BAD_VALUE", "chunk.agents[0].action", lambda c: spoil(c.agents[0].action, 0, 3.0)),
    "an episode's end without its final step": ("INCONSISTENT", "chunk.finals", lambda c: lie(c.truncated)),
    "a chunk out of order": ("OUT_OF_ORDER", "chunk.sequence", set_field("sequence", 1)),
    "log-probabilities that the weights do not give": ("CANARY_MISMATCH", "chunk.agents[0].log_prob",
                                                        lambda c: spoil(c.agents[0].log_prob, 0, -0.01)),
}
MESSAGES = {
    "another digest": ("DIGEST_MISMATCH", "digest", set_field("digest", bytes(32))),
    "a digest that is none": ("BAD_VALUE", "digest", set_field("digest", b"short")),
    "a lease that never was": ("UNKNOWN_LEASE", "lease_id", set_field("lease_id", 999_999)),
    "another start of the learner": ("OTHER_INCARNATION", "incarnation", set_field("incarnation", 99)),
    "other weights": ("STALE_WEIGHTS", "weights.version", other_version),
    "nothing": ("MISSING_FIELD", "content", lambda m: m.ClearField("content")),
}


def register(attacker: Attacker, **changes) -> None:
    run = attacker.learner.run
    registration = wire.RegisterRequest(
        client="attacker", protocol_version=run.protocol_version, environment=run.environment
    )
    for name, value in changes.items():
        setattr(registration, name, value)
    attacker.learner.service.Register(registration, timeout=10)


def other_robot(attacker: Attacker) -> None:
    attacker.learner.run.environment.state.pop()
    register(attacker)


def ghostly_weights(attacker: Attacker) -> None:
    ghost = wire.WeightsName(version=99, digest=hashlib.sha256(b"ghost").digest())
    list(attacker.learner.service.GetWeights(wire.GetWeightsRequest(weights=ghost), timeout=10))


def a_stranger(attacker: Attacker) -> None:
    attacker.learner.actor_id = 77_777
    attacker.learner.lease()


def greed(attacker: Attacker) -> None:
    for _ in range(64):
        attacker.learner.lease()


def two_truths(attacker: Attacker) -> None:
    first = attacker.learner.message(attacker.lease, attacker.chunk)
    spoil(attacker.chunk.reward, 0, 0.5)
    attacker.push(first, attacker.learner.message(attacker.lease, attacker.chunk))


def five_megabytes(attacker: Attacker) -> None:
    attacker.chunk.state.data = bytes(5 * 1024 * 1024)
    attacker.send()


def no_message(attacker: Attacker) -> None:
    call = attacker.learner.channel.stream_stream("/s2mia.v1.LearnerService/PushTrajectory")
    list(call(iter([b"\xff\xff\xff\xff"]), timeout=10))


CALLS = {
    "another protocol": ("OTHER_PROTOCOL", lambda a: register(a, protocol_version=99)),
    "an id of a process that is none": ("BAD_VALUE", lambda a: register(a, process=b"short")),
    "another build": (
        "OTHER_BUILD",
        lambda a: register(a, rollout_fingerprint=a.learner.run.rollout_fingerprint, build="0.0.1"),
    ),
    "another program": (
        "OTHER_FINGERPRINT",
        lambda a: register(a, rollout_fingerprint=bytes(32), build=a.learner.run.build),
    ),
    "another robot": ("OTHER_ENVIRONMENT", other_robot),
    "weights that nobody has": ("UNKNOWN_WEIGHTS", ghostly_weights),
    "an actor that nobody knows": ("UNKNOWN_ACTOR", a_stranger),
    "more leases than anyone may hold": ("TOO_MANY_LEASES", greed),
    "one chunk in two versions": ("DIGEST_CONFLICT", two_truths),
    "a message of five megabytes": ("TOO_LARGE", five_megabytes),
    "no message of ours": ("UNDECODABLE", no_message),
}
# Takes five minutes of silence, or several connections (tests/system/hostile_peers/resource_limits.rs).
UNTRIED = {"TOO_SLOW", "BUSY", "OTHER_CONNECTION"}


def attack(address: str, act) -> tuple[str, str]:
    attacker = Attacker(address)
    try:
        return refusal(lambda: act(attacker))
    finally:
        attacker.learner.close()


def test_every_refusal_names_its_reason_and_field_and_the_run_ends_as_if_nothing_had_been(serve):
    learner = serve("attacked", FEW)
    host, port = learner.address.split(":")
    with socket.create_connection((host, int(port))) as peer:
        peer.sendall(b"\x5a" * 4096)
    for what, (reason, field, change) in CHUNKS.items():
        assert attack(learner.address, lambda a: a.send(spoil_chunk=change)) == (reason, field), what
    for what, (reason, field, change) in MESSAGES.items():
        assert attack(learner.address, lambda a: a.send(spoil_message=change)) == (reason, field), what
    for what, (reason, act) in CALLS.items():
        assert attack(learner.address, act)[0] == reason, what
    finish(learner)
    assert learner.metrics()[-1]["messages_refused"] >= len(CHUNKS) + len(MESSAGES) + len(CALLS)
    quiet = serve("quiet", FEW)
    finish(quiet)
    assert hashes(learner.folder) == hashes(quiet.folder)


def finish(learner) -> None:
    """An honest actor does the work."""
    subprocess.run(command("actor", "--learner", learner.url), check=True, capture_output=True)
    assert "finished after iteration 2" in learner.finish()


def test_no_reason_is_left_untried():
    source = (ROOT / "proto" / "src" / "refusal.rs").read_text()
    reasons = set(re.findall(r'\(Reason::\w+, "([A-Z_]+)"', source))
    tried = {entry[0] for attacks in (CHUNKS, MESSAGES, CALLS) for entry in attacks.values()}
    assert reasons - tried == UNTRIED
