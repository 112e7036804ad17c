"""`s2mia.Client` queries, watches and stops a learner, over plain text and TLS."""

import math
import subprocess

import pytest
import s2mia
from conftest import FEW, SMALL, command, s2mia_run
from s2mia.connection import target
from s2mia.learner import _problem

TLS = s2mia.Tls("ca.pem", "operator.pem", "operator.key")


@pytest.mark.parametrize("secs", [0.0, -1.0, 1e300, math.nan, math.inf])
def test_a_duration_that_no_timer_holds_is_refused_by_name(secs):
    run = s2mia.wire.RunDescription(protocol_version=s2mia.learner.PROTOCOL_VERSION, heartbeat_secs=secs)
    run.chunk_steps = run.slot_steps = run.hidden_every = 1
    assert "heartbeat_secs" in _problem(run)


def test_a_learner_is_queried_and_stopped(serve):
    learner = serve("orders", [*SMALL, "environments.per_slot=10"])
    with s2mia.Client(learner.url) as client:
        status = client.status()
        assert (status.run_id, status.iteration, status.slots, status.actors) == ("orders", 0, 2, 0)
        assert (status.leases, status.env_steps_per_sec) == ((), None)
        actor = s2mia.Learner(learner.address)
        lease = actor.lease()
        (held,) = client.status().leases
        assert (held.lease_id, held.actor_id, held.episode) == (lease.lease_id, actor.actor_id, None)
        assert held.slot in (0, 1)
        actor.close()
        client.stop()
    assert "stopped after iteration 0" in learner.finish()


def test_a_learner_that_has_ended_is_told_in_one_line(serve):
    learner = serve("ended", SMALL)
    with s2mia.Client(learner.address) as client:
        client.stop()
        learner.finish()
        with pytest.raises(ConnectionError, match=f"^{learner.address}: UNAVAILABLE: [^\n]*$"):
            client.status()


def test_a_watcher_gets_every_iteration_the_evaluation_and_the_end(serve):
    learner = serve("watching", [*FEW, "evaluation.every_steps=1", "evaluation.episodes=2"])
    with s2mia.Client(learner.address) as client:
        with subprocess.Popen(command("actor", "--learner", learner.url), stderr=subprocess.DEVNULL) as actor:
            seen = list(client.watch())
            assert actor.wait(timeout=60) == 0
    assert [one.iteration for one in seen] == [1, 2, 2]
    assert [one.end for one in seen] == [None, None, "finished"]
    assert seen[-1].evaluation is not None
    assert (seen[-1].run_id, seen[-1].evaluation.iteration, seen[-1].evaluation.episodes) == ("watching", 2, 2)
    learner.finish()


@pytest.fixture
def secured(serve, tmp_path):
    """A learner with TLS, and the certificate of a role."""
    files = tmp_path / "certificates"
    s2mia_run("certs", files)
    server = ["--tls-certificate", files / "server.pem", "--tls-key", files / "server.key"]
    server += ["--tls-client-ca", files / "ca.pem"]
    return serve("secured", [*SMALL, *server]), lambda role, **more: s2mia.Tls(
        files / "ca.pem", files / f"{role}.pem", files / f"{role}.key", **more
    )


def test_certificates_decide_who_may_stop_a_run(secured):
    learner, tls = secured
    assert learner.url.startswith("https://")
    with s2mia.Client(learner.url, tls=tls("actor")) as actor:
        with pytest.raises(ConnectionError, match="^https://.*: PERMISSION_DENIED: [^\n]*operator[^\n]*$"):
            actor.stop()
    s2mia.Learner(learner.url, tls=tls("actor")).close()
    address = learner.url.removeprefix("https://")
    with s2mia.Client(address, tls=tls("operator", server_name="localhost")) as operator:
        assert operator.status().run_id == "secured"
        operator.stop()
    assert "stopped after iteration 0" in learner.finish()


@pytest.mark.parametrize(
    ("address", "tls", "expected"),
    [
        ("127.0.0.1:50051", None, "127.0.0.1:50051"),
        ("http://localhost:50051/", None, "localhost:50051"),
        ("[::1]:50051", None, "[::1]:50051"),
        ("https://learner.example.org:50051", TLS, "learner.example.org:50051"),
        ("10.0.0.5:50051", TLS, "10.0.0.5:50051"),
    ],
)
def test_an_address_may_be_host_and_port_or_a_url(address, tls, expected):
    assert target(address, tls) == expected


@pytest.mark.parametrize(
    ("address", "tls", "message"),
    [
        ("localhost", None, "localhost: expected HOST:PORT, http://HOST:PORT or https://HOST:PORT"),
        ("localhost:x", None, "localhost:x: expected HOST:PORT, http://HOST:PORT or https://HOST:PORT"),
        ("ftp://localhost:1", None, "ftp://localhost:1: expected HOST:PORT, http://HOST:PORT or https://HOST:PORT"),
        ("https://localhost:1", None, "https://localhost:1: https:// needs tls=s2mia.Tls(ca, certificate, key)"),
        ("http://localhost:1", TLS, "http://localhost:1: with tls, the URL begins with https://"),
        ("10.0.0.5:1", None, "10.0.0.5:1: plain text to another machine needs tls or insecure_allow_remote=True"),
    ],
)
def test_an_address_that_cannot_be_used_is_refused_in_one_line(address, tls, message):
    with pytest.raises(ValueError) as raised:
        s2mia.Client(address, tls=tls)
    assert str(raised.value) == message


def test_a_machine_in_a_trusted_network_is_allowed_on_request():
    assert target("10.0.0.5:1", None, insecure_allow_remote=True) == "10.0.0.5:1"
