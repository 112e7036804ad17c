"""How a pod ends: deploy/job.sh with a program in the place of s2mia, and the commands of deploy/k8s/seeds.yaml with s2mia itself."""

import os
import signal
import subprocess
from pathlib import Path

import pytest
from conftest import TINY, program
from kustomize import documents

DEPLOY = Path(__file__).resolve().parents[2] / "deploy"
JOB = DEPLOY / "job.sh"
KILLED_AT = "after-collect@1"


def path_with(folder, name, text):
    """A search path on which `name` is a shell script."""
    script = folder / name
    script.write_text(f"#!/bin/sh\n{text}\n")
    script.chmod(0o755)
    return {**os.environ, "PATH": f"{folder}:{os.environ['PATH']}"}


@pytest.mark.parametrize("status", [0, 1, 2])
def test_a_pod_ends_with_the_status_of_its_program(tmp_path, status):
    environment = path_with(tmp_path, "s2mia", f'test "$*" = "train a=b" && exit {status}; exit 9')
    assert subprocess.run([JOB, "train", "a=b"], env=environment).returncode == status


def test_a_moved_pod_waits_for_the_checkpoint_and_does_not_count_as_finished(tmp_path):
    waits = f'trap "sleep 0.2; touch {tmp_path}/checkpoint; exit 0" TERM; echo ready; while :; do sleep 0.05; done'
    environment = path_with(tmp_path, "s2mia", waits)
    with subprocess.Popen([JOB], env=environment, stdout=subprocess.PIPE) as pod:
        assert pod.stdout.readline() == b"ready\n"
        pod.send_signal(signal.SIGTERM)
        assert pod.wait(60) == 128 + signal.SIGTERM
    assert (tmp_path / "checkpoint").exists()


def test_the_image_contains_the_script_that_every_job_starts():
    assert os.access(JOB, os.X_OK)
    assert "COPY deploy/job.sh /usr/local/bin/s2mia-job" in (DEPLOY / "Dockerfile").read_text()
    assert "!deploy/job.sh" in (DEPLOY.parent / ".dockerignore").read_text().splitlines()


@pytest.fixture
def seed(tmp_path):
    """The command of the fourth seed with small settings, its environment variables and its run folder."""
    job = next(one for one in documents(DEPLOY / "k8s" / "seeds.yaml") if one["kind"] == "Job")
    (script,) = job["spec"]["template"]["spec"]["containers"][0]["args"]
    (tmp_path / "s2mia-job").symlink_to(JOB)
    small = [setting for setting in TINY if "=" in setting and not setting.startswith("run.seed")]
    settings = "\n".join(f'export S2MIA__{key.upper().replace(".", "__")}="{value}"' for key, value in (one.split("=") for one in small))
    environment = path_with(tmp_path, "s2mia", f'{settings}\nexec {program()} "$@"')
    environment["JOB_COMPLETION_INDEX"] = "3"
    start = ["/bin/sh", "-c", script.replace("/runs/", f"{tmp_path}/").replace(" run.env_steps=10000000", "")]
    return start, environment, tmp_path / "seed-3"


def test_a_seed_that_is_killed_before_its_first_checkpoint_finishes_when_its_pod_is_replaced(seed):
    start, environment, run = seed
    assert subprocess.run(start, env={**environment, "S2MIA_FAIL_AT": KILLED_AT}).returncode not in (0, 2)
    assert (run / "manifest.json").exists() and not list(run.glob("checkpoints/*"))
    for _ in range(2):
        assert subprocess.run(start, env=environment).returncode == 0
    assert list(run.glob("checkpoints/*"))


def test_a_seed_whose_manifest_is_lost_is_resumed(seed):
    start, environment, run = seed
    for _ in range(2):
        assert subprocess.run(start, env=environment).returncode == 0
        (run / "manifest.json").unlink()
