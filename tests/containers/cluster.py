"""Runs deploy/compose.yaml for real and disturbs it: the weights must be those of an undisturbed local run.

Needs a container engine with compose (v2, or docker-compose 1.29), started here if this user may.
Where no registry answers, debootstrap makes the base image. Ends with 0 if every check held, 1 if one
did not, and 3 with one line `container test not run: REASON` where containers cannot run at all.
"""

import contextlib
import json
import os
import pathlib
import shutil
import subprocess
import sys
import tempfile
import time

ROOT = pathlib.Path(__file__).resolve().parents[2]
PROJECT = "s2mia-cluster-test"
BASE_IMAGE = "debian:bookworm-slim"
RELEASE = "bookworm"
ITERATIONS = 120
STEPS_PER_ITERATION = 8 * 100
SETTINGS = {
    "ENV_STEPS": str(ITERATIONS * STEPS_PER_ITERATION),
    "S2MIA_IMAGE": "s2mia:cluster-test",
    "SEED": "11",
    "RUN": "cluster",
}
LOCAL = [
    "environments.count=8",
    "environments.steps=100",
    "evaluation.every_steps=0",
    "run.seed=11",
    f"run.env_steps={SETTINGS['ENV_STEPS']}",
]
NOT_RUN = 3
DEADLINE_SECS = 600


class NotRun(Exception):
    """Containers cannot run on this machine."""


def output(*command: str, **options) -> str:
    """What a command prints; its own words if it fails."""
    done = subprocess.run(command, cwd=ROOT, text=True, capture_output=True, **options)
    if done.returncode != 0:
        raise RuntimeError(f"{' '.join(command)}: {done.stderr.strip() or done.stdout.strip()}")
    return done.stdout.strip()


def succeeds(*command: str) -> bool:
    return subprocess.run(command, cwd=ROOT, capture_output=True).returncode == 0


def start_engine() -> subprocess.Popen | None:
    """The engine that was started for this test, if none ran."""
    if shutil.which("docker") is None:
        raise NotRun("there is no docker command")
    if succeeds("docker", "info"):
        return None
    if shutil.which("dockerd") is None or os.geteuid() != 0:
        raise NotRun("no container engine answers, and this user cannot start one")
    log = open(pathlib.Path(tempfile.gettempdir()) / "s2mia-dockerd.log", "w")
    engine = subprocess.Popen(["dockerd"], stdout=log, stderr=log)
    for _ in range(60):
        if succeeds("docker", "info"):
            return engine
        if engine.poll() is not None:
            break
        time.sleep(0.5)
    engine.terminate()
    raise NotRun(f"dockerd does not come up, see {log.name}")


def compose_command() -> list[str]:
    for command in (["docker", "compose"], ["docker-compose"]):
        if shutil.which(command[0]) and succeeds(*command, "version"):
            return command
    raise NotRun("there is neither `docker compose` nor docker-compose")


def provide_base_image() -> None:
    """The runtime's base image: here already, from a registry, or made with debootstrap."""
    if succeeds("docker", "image", "inspect", BASE_IMAGE) or succeeds("docker", "pull", "-q", BASE_IMAGE):
        return
    if shutil.which("debootstrap") is None:
        raise NotRun(f"{BASE_IMAGE} cannot be pulled, and debootstrap is not installed")
    with tempfile.TemporaryDirectory() as folder:
        output("debootstrap", "--variant=minbase", RELEASE, folder)
        archive = subprocess.Popen(["tar", "-C", folder, "-c", "."], stdout=subprocess.PIPE)
        output("docker", "import", "-", BASE_IMAGE, stdin=archive.stdout)


class Cluster:
    """The services of deploy/compose.yaml under a project name of their own."""

    def __init__(self) -> None:
        files = ["-f", "deploy/compose.yaml", "-f", "tests/containers/short.yaml"]
        self.command = [*compose_command(), "-p", PROJECT, *files]
        self.environment = {**os.environ, **SETTINGS}

    def compose(self, *arguments: str) -> str:
        return output(*self.command, *arguments, env=self.environment)

    def containers(self, service: str) -> list[str]:
        return self.compose("ps", "-q", service).split()

    def running(self, service: str) -> list[str]:
        state = ("docker", "inspect", "-f", "{{.State.Running}}")
        return [one for one in self.containers(service) if output(*state, one) == "true"]

    def scale(self, actors: int) -> None:
        self.compose("up", "-d", "--no-build", "--no-recreate", "--scale", f"actor={actors}")
        say(f"{actors} actors asked for, iteration {self.iteration()}")

    def iteration(self) -> int:
        """Finished iterations, as the metrics in the volume say."""
        with contextlib.suppress(RuntimeError, IndexError):
            lines = self.in_volume("cat", f"/runs/{SETTINGS['RUN']}/metrics.jsonl").splitlines()
            return json.loads(lines[-1])["iteration"]
        return 0

    def in_volume(self, *command: str) -> str:
        mount = ["--rm", "-v", f"{PROJECT}_runs:/runs"]
        entry = ["--entrypoint", command[0], SETTINGS["S2MIA_IMAGE"], *command[1:]]
        return output("docker", "run", *mount, *entry)

    def wait_for(self, what: str, holds) -> None:
        end = time.monotonic() + DEADLINE_SECS
        while not holds():
            if time.monotonic() > end:
                raise RuntimeError(f"waited {DEADLINE_SECS} s for: {what}")
            time.sleep(0.2)

    def pass_iteration(self, iteration: int) -> None:
        self.wait_for(f"iteration {iteration}", lambda: self.iteration() >= iteration)

    def healthy(self) -> bool:
        status = ("docker", "inspect", "-f", "{{.State.Health.Status}}")
        return [output(*status, one) for one in self.containers("learner")] == ["healthy"]

    def down(self) -> None:
        self.compose("down", "-v", "--timeout", "5")


def say(what: str) -> None:
    print(f"  {what}", flush=True)


def hashes(inspected: str) -> dict[str, str]:
    found = json.loads(inspected)
    return {name: found[name] for name in ("weights_sha256", "state_sha256")}


def undisturbed(folder: str) -> dict[str, str]:
    """Hashes of the same run on this machine, without containers and without faults."""
    program = str(ROOT / "target/release/s2mia")
    output(program, "train", *LOCAL, f"run.dir={folder}/run")
    return hashes(output(program, "inspect", f"{folder}/run", "--json"))


def disturb(cluster: Cluster) -> None:
    """Scales, kills and cuts off while the run goes on."""
    cluster.wait_for("a healthy learner", cluster.healthy)
    cluster.pass_iteration(5)
    cluster.scale(4)
    cluster.pass_iteration(20)
    victim = cluster.running("actor")[0]
    output("docker", "kill", victim)
    say("an actor's container killed")
    cluster.pass_iteration(35)
    learner = cluster.running("learner")[0]
    output("docker", "kill", learner)
    say(f"the learner's container killed, iteration {cluster.iteration()}")
    output("docker", "start", learner)
    cluster.pass_iteration(50)
    cut_off = cluster.running("actor")[-1]
    network = f"{PROJECT}_cluster"
    output("docker", "network", "disconnect", network, cut_off)
    say(f"an actor cut off, iteration {cluster.iteration()}")
    cluster.pass_iteration(65)
    output("docker", "network", "connect", network, cut_off)
    say("and connected again")
    cluster.scale(2)


def cluster_hashes() -> dict[str, str]:
    """Hashes of the disturbed run."""
    cluster = Cluster()
    cluster.down()
    try:
        cluster.scale(1)
        disturb(cluster)
        cluster.wait_for("the end of the run", lambda: not cluster.running("learner"))
        cluster.wait_for("the actors' end", lambda: not cluster.running("actor"))
        return hashes(cluster.in_volume("s2mia", "inspect", f"/runs/{SETTINGS['RUN']}", "--json"))
    except BaseException:
        print(cluster.compose("logs", "--tail", "30"), file=sys.stderr)
        raise
    finally:
        cluster.down()


def main() -> int:
    try:
        engine = start_engine()
    except NotRun as reason:
        print(f"container test not run: {reason}")
        return NOT_RUN
    try:
        compose_command()
        provide_base_image()
        output("cargo", "build", "--release")
        build = ["--build-arg", "BINARY=prebuilt", "-t", SETTINGS["S2MIA_IMAGE"], "."]
        output("docker", "build", "-q", "-f", "deploy/Dockerfile", *build,
               env={**os.environ, "DOCKER_BUILDKIT": "1"})
        with tempfile.TemporaryDirectory() as folder:
            expected = undisturbed(folder)
        found = cluster_hashes()
    except NotRun as reason:
        print(f"container test not run: {reason}")
        return NOT_RUN
    finally:
        if engine is not None:
            engine.terminate()
            engine.wait()
    print(f"undisturbed, local: {expected}\ndisturbed, cluster: {found}")
    return 0 if found == expected else 1


if __name__ == "__main__":
    sys.exit(main())
