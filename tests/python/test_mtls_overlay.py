"""The overlay with certificates, its commands run as they stand: certificates from Secrets, a learner, its probe, an actor."""

import re
import shutil
import socket
import ssl
import subprocess
import time
import urllib.error
import urllib.request
from pathlib import Path

import pytest
from conftest import TINY, program, s2mia
from kustomize import rendered

OVERLAY = Path(__file__).resolve().parents[2] / "deploy" / "k8s" / "overlays" / "mtls"
TIMEOUT_SECS = 600


def pod(role):
    jobs = [one for one in rendered(OVERLAY) if one["kind"] == "Job"]
    (found,) = [job["spec"]["template"]["spec"] for job in jobs if job["metadata"]["name"] == role]
    return found


def secrets():
    """Names of files, by the Secret that the overlay's own commands put them in."""
    text = (OVERLAY / "kustomization.yaml").read_text()
    commands = re.findall(r"create secret generic (\S+)((?:[\s#\\]+--from-file=\S+)+)", text)
    return {secret: re.findall(r"--from-file=(\S+)", files) for secret, files in commands}


@pytest.fixture(scope="module")
def mounted(tmp_path_factory):
    """A folder for each Secret, as a pod that mounts it sees it."""
    folder = tmp_path_factory.mktemp("secrets")
    s2mia("certs", folder / "made", "--names", "learner,localhost")
    for secret, files in secrets().items():
        (folder / secret).mkdir()
        for file in files:
            shutil.copy(folder / "made" / file, folder / secret)
    return folder


@pytest.fixture(scope="module")
def ports():
    """Free ports for the learner and its page."""
    with socket.socket() as first, socket.socket() as second:
        for listener in (first, second):
            listener.bind(("127.0.0.1", 0))
        return first.getsockname()[1], second.getsockname()[1]


def command(words, of, mounted, ports):
    """A pod's command on this machine: its Secret lies elsewhere, and its learner listens on loopback."""
    (secret,) = [volume["secret"]["secretName"] for volume in of["volumes"] if volume["name"] == "certificates"]
    port, page = ports
    here = {
        "/certificates": str(mounted / secret),
        "0.0.0.0:50051": f"127.0.0.1:{port}",
        "://learner:50051": f"://localhost:{port}",
        "://localhost:50051": f"://localhost:{port}",
        "0.0.0.0:50080": f"127.0.0.1:{page}",
    }
    for there, where in here.items():
        words = [word.replace(there, where) for word in words]
    return [program(), *words]


def succeeds(words):
    return subprocess.run(words, capture_output=True).returncode == 0


def metrics(port, secret, role):
    """What a Prometheus with the certificate of this role reads."""
    tls = ssl.create_default_context(cafile=secret / "ca.pem")
    tls.load_cert_chain(secret / f"{role}.pem", secret / f"{role}.key")
    with urllib.request.urlopen(f"https://localhost:{port}/metrics", context=tls, timeout=60) as answer:
        return answer.read().decode()


def wait_for(learner, holds):
    deadline = time.monotonic() + TIMEOUT_SECS
    while not holds():
        assert learner.poll() is None, "the learner has ended"
        assert time.monotonic() < deadline, "the learner does not become healthy"
        time.sleep(0.1)


def test_the_secrets_hold_a_key_for_each_side_and_no_other():
    keys = {secret: {file for file in files if file.endswith(".key")} for secret, files in secrets().items()}
    assert keys == {"learner-certificates": {"server.key", "operator.key"}, "actor-certificates": {"actor.key"}}


def test_no_plain_text_is_allowed():
    for role in ("learner", "actor"):
        (container,) = pod(role)["containers"]
        assert not [word for word in container["args"] if word.startswith("--insecure") or "http://" in word]


def test_a_run_is_finished_with_the_certificates_of_the_secrets(mounted, ports, tmp_path):
    of = pod("learner")
    (container,) = of["containers"]
    probes = [container[name]["exec"]["command"] for name in ("startupProbe", "readinessProbe", "livenessProbe")]
    arguments = command(container["args"], of, mounted, ports)
    with subprocess.Popen([*arguments, *TINY, f"run.dir={tmp_path}/run"], stdout=subprocess.DEVNULL) as learner:
        try:
            for probe in probes:
                wait_for(learner, lambda: succeeds(command(probe[1:], of, mounted, ports)))
            assert not succeeds([program(), "health", f"--learner=http://127.0.0.1:{ports[0]}"])
            scraped = metrics(ports[1], mounted / "learner-certificates", "operator")
            assert "s2mia_iteration" in scraped
            with pytest.raises(urllib.error.HTTPError, match="403"):
                metrics(ports[1], mounted / "actor-certificates", "actor")
            actor = pod("actor")
            subprocess.run(command(actor["containers"][0]["args"], actor, mounted, ports), check=True, timeout=TIMEOUT_SECS)
            assert learner.wait(TIMEOUT_SECS) == 0
        finally:
            learner.kill()
