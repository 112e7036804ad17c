"""A learner and actors on two hosts with a bad network: `cargo build && python3 tests/soak/two_hosts.py`.

The hosts are network namespaces (link.py). The link delays, reorders and loses packets, then loses those of one direction only, then
those of the other, each until the learner has noticed. The run must end with the hashes of an undisturbed one. Ends with 0 if it
does, and with 3 where no network namespace can be made.
"""

import contextlib
import json
import pathlib
import subprocess
import sys
import tempfile
import time

from link import ADDRESSES, Link, NoNamespaces

ROOT = pathlib.Path(__file__).resolve().parents[2]
PROGRAM = str(ROOT / "target" / "debug" / "s2mia")
UNREACHABLE = 3
TIMEOUT_SECS = 300
PORT = 50051
URL = f"http://{ADDRESSES['near']}:{PORT}"
SETTINGS = [
    "halfcheetah-2x3",
    "run.seed=7",
    "environments.count=4",
    "environments.steps=20",
    "environments.per_slot=2",
    "environments.message_steps=10",
    "policy.encoder=8",
    "policy.hidden=8",
    "critic.width=16",
    "influence.encoder=8",
    "influence.hidden=8",
    "evaluation.every_steps=1600",
    "evaluation.episodes=1",
    "lease.ttl_secs=1",
]


class Run:
    """A learner on the near host, and two actors on the far one, through all disturbances."""

    def __init__(self, link: Link, folder: pathlib.Path) -> None:
        self.link, self.folder = link, folder
        self.logs = [open(folder / f"{name}.log", "w") for name in ("learner", "actor-0", "actor-1")]
        settings = [*SETTINGS, "run.iterations=100000", f"run.dir={folder / 'run'}"]
        remote = "--insecure-allow-remote"
        learner = self.started("near", 0, "learner", f"--listen={ADDRESSES['near']}:{PORT}", remote, *settings)
        actors = [self.started("far", index, "actor", remote, "--learner", URL) for index in (1, 2)]
        self.processes = [learner, *actors]

    def started(self, host: str, log: int, *arguments: str) -> subprocess.Popen:
        words = [*self.link.on(host), PROGRAM, *arguments]
        return subprocess.Popen(words, stdout=self.logs[log], stderr=self.logs[log])

    def status(self) -> dict:
        """Asked on the learner's own host, which no disturbance reaches; empty while it does not answer."""
        told = subprocess.run([*self.link.on("near"), PROGRAM, "status", URL, "--json"], capture_output=True, text=True)
        return json.loads(told.stdout) if told.returncode == 0 else {}

    def wait(self, what: str, holds) -> dict:
        deadline = time.monotonic() + TIMEOUT_SECS
        while not holds(status := self.status()):
            ended = [process.args[5] for process in self.processes if process.poll() is not None]
            if ended or time.monotonic() > deadline:
                logs = "".join((self.folder / name).read_text()[-2000:] for name in ("learner.log", "actor-0.log", "actor-1.log"))
                raise SystemExit(f"{what}: not after {TIMEOUT_SECS} s, or ended: {ended}; {status}\n{logs}")
            time.sleep(0.2)
        return status

    def goes_on(self, iterations: int) -> None:
        begin = self.wait("the learner answers", bool)["iteration"]
        self.wait("iterations finish", lambda status: status and status["iteration"] >= begin + iterations)

    def loses_actors(self) -> None:
        """Until the learner has taken work back from an actor, or has no actor any more if none held work."""
        before = self.wait("the learner answers", bool)["leases_reissued"]
        lost = lambda status: status and (status["leases_reissued"] > before or not status["actors"])
        self.wait("the learner notices", lost)

    def end(self) -> int:
        """Stops the run; returns the iterations that are finished then."""
        subprocess.run([*self.link.on("near"), PROGRAM, "stop", URL], check=True, capture_output=True)
        learner, *actors = self.processes
        learner.wait(timeout=TIMEOUT_SECS)
        for process in [learner, *actors]:
            # An actor that is reconnecting does not hear of the end; it leaves with 0 when it is asked to.
            process.terminate()
            if status := process.wait(timeout=TIMEOUT_SECS):
                raise SystemExit(f"a process ended with status {status}: {process.args}")
        return hashes(self.folder / "run")["iteration"]

    def kill(self) -> None:
        for process in self.processes:
            process.kill()
            process.wait()


def hashes(run: pathlib.Path) -> dict:
    told = subprocess.run([PROGRAM, "inspect", str(run), "--json"], check=True, capture_output=True, text=True)
    return {name: json.loads(told.stdout)[name] for name in ("iteration", "weights_sha256", "state_sha256")}


def disturbed(link: Link, folder: pathlib.Path) -> int:
    run = Run(link, folder)
    with contextlib.ExitStack() as stack:
        stack.callback(run.kill)
        run.goes_on(2)
        link.disturb(delay=0.01, jitter=0.02, loss=0.02)
        run.goes_on(3)
        for host in ("far", "near"):
            link.disturb(cut=(host,))
            run.loses_actors()
            link.heal()
            run.goes_on(2)
        return run.end()


def main() -> int:
    with tempfile.TemporaryDirectory() as name, contextlib.ExitStack() as stack:
        folder = pathlib.Path(name)
        try:
            link = Link(seed=7)
        except NoNamespaces as error:
            print(f"two_hosts.py not run: no network namespace can be made here: {error}")
            return UNREACHABLE
        stack.callback(link.close)
        iterations = disturbed(link, folder)
        quiet = [*SETTINGS, f"run.iterations={iterations}", f"run.dir={folder / 'quiet'}"]
        subprocess.run([PROGRAM, "train", *quiet], check=True, capture_output=True)
        found, expected = hashes(folder / "run"), hashes(folder / "quiet")
        lost = link.lost
    print(f"after {iterations} iterations and {lost} lost packets: {found}; undisturbed: {expected}")
    return 0 if found == expected else 1


if __name__ == "__main__":
    sys.exit(main())
