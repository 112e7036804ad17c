"""Every failed call is a `ConnectionError` of one line that says what to change, and no call uses a proxy."""

import gc
import re
import signal
import socket
import subprocess
import sys
import threading
import time

import grpc
import numpy as np
import pytest
import s2mia
from conftest import ROOT, SMALL, Serving, s2mia_run
from s2mia import learner as learner_module
from s2mia.connection import CallError, authorization

SEEN = dict.fromkeys(["agent_0", "agent_1"], np.zeros(9))


def failure(call) -> str:
    """The line with which a call fails."""
    with pytest.raises(ConnectionError) as raised:
        call()
    assert len(str(raised.value).splitlines()) == 1
    return str(raised.value)


@pytest.fixture
def proxy(monkeypatch):
    """A listener to which every variable for proxies points; nobody connects to it."""
    with socket.create_server(("127.0.0.1", 0)) as listener:
        url = "http://127.0.0.1:%d" % listener.getsockname()[1]
        for name in ("http_proxy", "https_proxy", "grpc_proxy", "all_proxy"):
            monkeypatch.setenv(name, url)
        for name in ("no_proxy", "no_grpc_proxy", "NO_PROXY"):
            monkeypatch.delenv(name, raising=False)
        yield
        listener.setblocking(False)
        with pytest.raises(BlockingIOError):
            listener.accept()


def test_no_client_uses_a_proxy(proxy, serve, policies):
    learner = serve("direct", SMALL)
    port = learner.address.split(":")[1]
    for host in ("127.0.0.1", "localhost"):
        with s2mia.Client(f"http://{host}:{port}") as client:
            assert client.status().run_id == "direct"
    with s2mia.Client(f"[::1]:{port}") as client:
        assert "UNAVAILABLE" in failure(client.status), "the learner does not listen there"
    s2mia.Learner(learner.address).close()
    team = s2mia.Team(policies.address)
    assert set(team.act(SEEN)) == set(SEEN)
    team.close()


def test_teams_that_are_dropped_leave_no_threads(policies):
    def acted() -> dict:
        return s2mia.Team(policies.address).act(SEEN)

    acted()
    gc.collect()
    before = threading.active_count()
    for _ in range(10):
        acted()
    gc.collect()
    deadline = time.monotonic() + 20
    while threading.active_count() > before + 3 and time.monotonic() < deadline:
        time.sleep(0.05)
    assert threading.active_count() <= before + 3


def test_every_call_to_a_learner_that_is_gone_fails_in_one_line(serve):
    served = serve("gone", SMALL)
    actor, client = s2mia.Learner(served.address), s2mia.Client(served.address)
    lease, watched = actor.lease(), client.watch()
    assert client.status().iteration == 0
    served.process.kill()
    served.process.wait()
    calls = [client.status, client.stop, lambda: next(watched)]
    calls += [actor.lease, lambda: actor.heartbeat(lease, 0), lambda: actor.weights(lease.weights)]
    for call in [*calls, lambda: actor.push(lease, [])]:
        assert failure(call).startswith(f"{served.address}: UNAVAILABLE: ")
    client.close()
    actor.close()
    for call in (client.status, lambda: next(client.watch()), actor.lease, lambda: actor.push(lease, [])):
        assert failure(call) == f"{served.address}: the connection is closed"


def test_a_server_that_never_answers_is_a_deadline(monkeypatch):
    monkeypatch.setattr("s2mia.connection.CALL_SECS", 0.5)
    with socket.create_server(("127.0.0.1", 0)) as silent:
        place = "127.0.0.1:%d" % silent.getsockname()[1]
        for call in (s2mia.Client(place, timeout_secs=0.5).status, lambda: s2mia.Team(place)):
            assert failure(call).startswith(f"{place}: DEADLINE_EXCEEDED: ")
    assert failure(lambda: s2mia.Learner(place)).endswith("Connection refused")


def test_a_team_whose_server_ends_fails_in_one_line(trained):
    server = Serving(trained)
    team = s2mia.Team(server.address)
    assert set(team.act(SEEN)) == set(SEEN)
    server.process.terminate()
    server.process.communicate()
    for _ in range(2):
        assert failure(lambda: team.act(SEEN)).startswith(f"{server.address}: UNAVAILABLE: ")
    team.close()
    assert failure(lambda: team.act(SEEN)) == f"{server.address}: the connection is closed"


def test_another_program_at_the_address_is_named_as_the_cause(serve):
    learner = serve("other", SMALL)
    line = failure(lambda: s2mia.Team(learner.address))
    assert line.endswith("does not provide this service; it may be another program")


def test_an_error_while_results_are_computed_is_raised_as_it_is(serve):
    actor = s2mia.Learner(serve("results", SMALL).address)

    def results():
        yield from ()
        raise KeyError("an error of the environment")

    with pytest.raises(KeyError, match="an error of the environment"):
        actor.push(actor.lease(), results())
    actor.close()


def test_certificates_that_do_not_match_are_named(serve, tmp_path):
    for name in ("own", "other"):
        s2mia_run("certs", tmp_path / name)
    own, other = tmp_path / "own", tmp_path / "other"
    server = ["--tls-certificate", own / "server.pem", "--tls-key", own / "server.key"]
    server += ["--tls-client-ca", own / "ca.pem"]
    secured, plain = serve("secured", [*SMALL, *server]), serve("plain", SMALL)
    tls = s2mia.Tls(own / "ca.pem", own / "operator.pem", own / "operator.key")
    url = f"https://{plain.address}"
    for call in (s2mia.Client(url, tls=tls).status, lambda: s2mia.Learner(url, tls=tls)):
        assert failure(call).endswith("; the server has no TLS: use http://")
    address = secured.url.removeprefix("https://")
    for call in (s2mia.Client(address).status, lambda: s2mia.Learner(address)):
        assert "; if the server requires TLS, use https://" in failure(call)
    strange = s2mia.Tls(other / "ca.pem", other / "operator.pem", other / "operator.key")
    assert "handshake failed" in failure(s2mia.Client(secured.url, tls=strange).status)
    for files, message in [
        ((own / "ca.pem", own / "operator.pem", other / "operator.key"), "are no certificate and its key"),
        ((own / "operator.key", own / "operator.pem", own / "operator.key"), "is no valid certificate authority"),
    ]:
        with pytest.raises(ValueError, match=message):
            s2mia.Client(secured.url, tls=s2mia.Tls(*files))


def test_the_package_has_the_protocol_version_of_the_program_and_refuses_another(serve, monkeypatch):
    source = (ROOT / "proto" / "src" / "lib.rs").read_text()
    (version,) = re.findall(r"PROTOCOL_VERSION: u32 = (\d+);", source)
    assert learner_module.PROTOCOL_VERSION == int(version)
    monkeypatch.setattr(learner_module, "PROTOCOL_VERSION", 99)
    address = serve("version", SMALL).address
    assert "protocol version" in failure(lambda: s2mia.Learner(address))


def test_a_token_is_not_sent_in_plain_text_to_another_machine(monkeypatch):
    monkeypatch.setenv("S2MIA_TOKEN", "secret")
    assert authorization("[::1]:1", None, None) == [("authorization", "Bearer secret")]
    assert authorization("10.0.0.1:1", None, None) is None
    with pytest.raises(ValueError, match="readable in the network"):
        authorization("10.0.0.1:1", None, "secret")
    with pytest.raises(ValueError, match="character"):
        authorization("127.0.0.1:1", None, "two\nlines")


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_stops_an_actor_without_a_traceback(serve, number):
    learner = serve("stopped", [*SMALL, "run.iterations=100000"])
    words = [sys.executable, "-m", "s2mia.actor", learner.url]
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    process = subprocess.Popen(words, text=True, **pipes)
    assert process.stdout.readline().startswith("run stopped, actor ")
    process.send_signal(number)
    assert process.communicate(timeout=60)[1] == "stopped\n"
    assert process.returncode == 0


def test_a_status_without_a_code_is_one_line_too():
    assert str(CallError("a:1", grpc.RpcError("two\nlines\x1b"))) == "a:1: UNKNOWN: two lines<U+001B>"


@pytest.mark.parametrize(
    ("arguments", "why"),
    [
        ({"timeout_secs": -1}, "timeout_secs is -1; it is a positive number"),
        ({"timeout_secs": "a"}, "timeout_secs is 'a'; it is a positive number"),
        ({"timeout_secs": float("nan")}, "timeout_secs is nan"),
        ({"token": 5}, "token has the type int; it is a text"),
        ({"tls": True}, re.escape("tls is True; it is s2mia.Tls(ca, certificate, key)")),
    ],
)
def test_an_argument_of_the_wrong_kind_is_refused_by_name(arguments, why):
    with pytest.raises(ValueError, match=why):
        s2mia.Client("127.0.0.1:1", **arguments)


def test_a_negative_iteration_is_refused_by_name():
    with pytest.raises(ValueError, match="after_iteration is -1; it must be a whole number"):
        next(s2mia.Client("127.0.0.1:1").watch(-1))
