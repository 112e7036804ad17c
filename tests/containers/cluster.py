"""Runs deploy/compose.yaml for real and disturbs it: the weights must be those of an undisturbed local run.

`--mtls` adds deploy/compose.mtls.yaml. `--short` does with fewer iterations, actors and faults, and takes the binary that `cargo test` has built.
`--swarm` plays the short form on deploy/stack.yaml, in a swarm of this one node that ends with the test.

Needs a container engine, started here if this user may, and but for a swarm compose (v2, or docker-compose 1.29).
Where no registry answers, debootstrap makes the base image. Ends with 0 if every check held, 1 if one
did not, and 3 with one line `container test not run: REASON` where containers cannot run at all.
"""

import argparse
import contextlib
import dataclasses
import json
import os
import pathlib
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable

ROOT = pathlib.Path(__file__).resolve().parents[2]
PROJECT = "s2mia-cluster-test"
BASE_IMAGE = "debian:bookworm-slim"
RELEASE = "bookworm"
STEPS_PER_ITERATION = 8 * 100
IMAGE = "s2mia:cluster-test"
SEED, RUN = "11", "cluster"
NOT_RUN = 3
DEADLINE_SECS = 600


class NotRun(Exception):
    """Containers cannot run on this machine."""


@dataclasses.dataclass(frozen=True)
class Form:
    """How long the run is, and which binary runs it."""

    # Enough for the slowest engine to play all faults before the run's end.
    iterations: int
    binary: str
    disturb: Callable[["Cluster"], None]
    cluster: type["Cluster"]
    files: tuple[str, ...] = ("deploy/compose.yaml", "tests/containers/short.yaml")

    def settings(self) -> dict[str, str]:
        """For the compose file, or the stack."""
        return {"ENV_STEPS": self.env_steps(), "S2MIA_IMAGE": IMAGE, "SEED": SEED, "RUN": RUN, "PAGE_PORT": ""}

    def local(self) -> list[str]:
        """The same run without containers."""
        own = [f"run.seed={SEED}", f"run.env_steps={self.env_steps()}"]
        return ["environments.count=8", "environments.steps=100", "evaluation.every_steps=0", *own]

    def env_steps(self) -> str:
        return str(self.iterations * STEPS_PER_ITERATION)


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
        if not succeeds("debootstrap", "--variant=minbase", RELEASE, folder):
            raise NotRun(f"{BASE_IMAGE} cannot be pulled, and debootstrap cannot make it")
        archive = subprocess.Popen(["tar", "-C", folder, "-c", "."], stdout=subprocess.PIPE)
        output("docker", "import", "-", BASE_IMAGE, stdin=archive.stdout)


class Cluster:
    """The services of deploy/compose.yaml under a project name of their own."""

    def __init__(self, form: Form) -> None:
        files = [word for file in form.files for word in ("-f", file)]
        self.command = [*compose_command(), "-p", PROJECT, *files]
        self.environment = {**os.environ, **form.settings()}

    def compose(self, *arguments: str) -> str:
        return output(*self.command, *arguments, env=self.environment)

    def up(self) -> None:
        """With one actor."""
        self.scale(1)

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
            lines = self.in_volume("cat", f"/runs/{RUN}/metrics.jsonl").splitlines()
            return json.loads(lines[-1])["iteration"]
        return 0

    def in_volume(self, *command: str) -> str:
        mount = ["--rm", "-v", f"{PROJECT}_runs:/runs"]
        entry = ["--entrypoint", command[0], IMAGE, *command[1:]]
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

    def start_again(self, killed: str) -> None:
        output("docker", "start", killed)

    def evaluated(self) -> str:
        return self.compose("run", "--rm", "-T", "evaluator")

    def logs(self) -> str:
        return self.compose("logs", "--tail", "30")

    def down(self) -> None:
        self.compose("down", "-v", "--timeout", "5")


class Swarm(Cluster):
    """The services of deploy/stack.yaml, on a swarm of this one node."""

    def __init__(self, form: Form) -> None:
        if swarm_state() != "inactive":
            raise NotRun("this engine is in a swarm already")
        self.environment = {**os.environ, **form.settings()}

    def up(self) -> None:
        output("docker", "swarm", "init", "--advertise-addr", "127.0.0.1", "--listen-addr", "127.0.0.1:2377")
        output("docker", "node", "update", "--label-add", "s2mia.runs=here", output("docker", "node", "ls", "-q"))
        # Compose wants no version where its own file has none, and a stack wants the same in each.
        short = 'version: "3.8"\n' + (ROOT / "tests/containers/short.yaml").read_text()
        files = ("-c", "deploy/stack.yaml", "-c", "tests/containers/swarm.yaml", "-c", "-")
        deploy = ("docker", "stack", "deploy", "--resolve-image", "never", *files, PROJECT)
        output(*deploy, env=self.environment, input=short)

    def containers(self, service: str) -> list[str]:
        """Those that run; the swarm puts others in the place of what has ended."""
        return output("docker", "ps", "-q", "--filter", f"label=com.docker.swarm.service.name={PROJECT}_{service}").split()

    def scale(self, actors: int) -> None:
        output("docker", "service", "scale", "--detach", f"{PROJECT}_actor={actors}")
        say(f"{actors} actors asked for, iteration {self.iteration()}")

    def start_again(self, killed: str) -> None:
        """The swarm's own work."""
        self.wait_for("a learner in its place", self.healthy)
        say(f"the swarm has put another in its place, iteration {self.iteration()}")

    def evaluated(self) -> str:
        return self.in_volume("s2mia", "eval", f"/runs/{RUN}")

    def logs(self) -> str:
        services = [f"{PROJECT}_{service}" for service in ("learner", "actor")]
        told = [output("docker", "service", "logs", "--tail", "30", service) for service in services]
        return "\n".join([output("docker", "service", "ps", "--no-trunc", *services), *told])

    def down(self) -> None:
        if swarm_state() == "active":
            output("docker", "stack", "rm", PROJECT)
            output("docker", "swarm", "leave", "--force")
        self.wait_for("the run's volume to be free", lambda: succeeds("docker", "volume", "rm", "-f", f"{PROJECT}_runs"))


def swarm_state() -> str:
    return output("docker", "info", "--format", "{{.Swarm.LocalNodeState}}")


def say(what: str) -> None:
    print(f"  {what}", flush=True)


def hashes(inspected: str) -> dict[str, str]:
    found = json.loads(inspected)
    return {name: found[name] for name in ("weights_sha256", "state_sha256")}


def undisturbed(form: Form, folder: str) -> dict[str, str]:
    """Hashes of the same run on this machine, without containers and without faults."""
    program = str(ROOT / form.binary)
    output(program, "train", *form.local(), f"run.dir={folder}/run")
    return hashes(output(program, "inspect", f"{folder}/run", "--json"))


def kill_an_actor(cluster: Cluster) -> None:
    output("docker", "kill", cluster.running("actor")[0])
    say(f"an actor's container killed, iteration {cluster.iteration()}")


def kill_the_learner(cluster: Cluster) -> None:
    (learner,) = cluster.running("learner")
    output("docker", "kill", learner)
    say(f"the learner's container killed, iteration {cluster.iteration()}")
    cluster.start_again(learner)


def disturb_shortly(cluster: Cluster) -> None:
    """One more actor, one death of either role."""
    cluster.wait_for("a healthy learner", cluster.healthy)
    cluster.pass_iteration(3)
    cluster.scale(2)
    cluster.pass_iteration(8)
    kill_an_actor(cluster)
    cluster.pass_iteration(14)
    kill_the_learner(cluster)
    cluster.scale(2)


def disturb(cluster: Cluster) -> None:
    """Scales, kills and cuts off while the run continues."""
    cluster.wait_for("a healthy learner", cluster.healthy)
    cluster.pass_iteration(5)
    cluster.scale(4)
    cluster.pass_iteration(20)
    kill_an_actor(cluster)
    cluster.pass_iteration(35)
    kill_the_learner(cluster)
    cluster.pass_iteration(50)
    cut_off = cluster.running("actor")[-1]
    network = f"{PROJECT}_cluster"
    output("docker", "network", "disconnect", network, cut_off)
    say(f"an actor cut off, iteration {cluster.iteration()}")
    cluster.pass_iteration(65)
    output("docker", "network", "connect", network, cut_off)
    say("and connected again")
    cluster.scale(2)


SHORT = Form(iterations=150, binary="target/debug/s2mia", disturb=disturb_shortly, cluster=Cluster)
SWARM = dataclasses.replace(SHORT, cluster=Swarm)
WHOLE = Form(iterations=150, binary="target/release/s2mia", disturb=disturb, cluster=Cluster)


def cluster_hashes(cluster: Cluster, form: Form) -> dict[str, str]:
    """Hashes of the disturbed run."""
    cluster.down()
    try:
        cluster.up()
        form.disturb(cluster)
        cluster.wait_for("the end of the run", lambda: not cluster.running("learner"))
        cluster.wait_for("the actors' end", lambda: not cluster.running("actor"))
        say(f"the evaluator: {cluster.evaluated().splitlines()[-1]}")
        return hashes(cluster.in_volume("s2mia", "inspect", f"/runs/{RUN}", "--json"))
    except BaseException:
        print(cluster.logs(), file=sys.stderr)
        raise
    finally:
        cluster.down()


def build_image(form: Form) -> None:
    """The image around a binary of this checkout."""
    if form.binary == WHOLE.binary:
        output("cargo", "build", "--release")
    arguments = ["BINARY=prebuilt", f"PREBUILT={form.binary}"]
    build = [word for argument in arguments for word in ("--build-arg", argument)]
    environment = {**os.environ, "DOCKER_BUILDKIT": "1"}
    try:
        output("docker", "build", "-q", "-f", "deploy/Dockerfile", *build, "-t", IMAGE, ".", env=environment)
    except RuntimeError as error:
        if "buildx component is missing" in str(error):
            raise NotRun("this docker has no BuildKit") from error
        raise


def main() -> int:
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    forms = options.add_mutually_exclusive_group()
    forms.add_argument("--short", action="store_const", const=SHORT, default=WHOLE, dest="form")
    forms.add_argument("--swarm", action="store_const", const=SWARM, dest="form")
    options.add_argument("--mtls", action="store_true")
    asked = options.parse_args()
    form = asked.form
    if asked.mtls and form is SWARM:
        options.error("deploy/stack.yaml has no form with certificates")
    if asked.mtls:
        form = dataclasses.replace(form, files=(*form.files, "deploy/compose.mtls.yaml"))
    try:
        engine = start_engine()
    except NotRun as reason:
        print(f"container test not run: {reason}")
        return NOT_RUN
    try:
        cluster = form.cluster(form)
        provide_base_image()
        build_image(form)
        with tempfile.TemporaryDirectory() as folder:
            expected = undisturbed(form, folder)
        found = cluster_hashes(cluster, form)
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
