"""Disturbs one run for an hour by a seeded schedule of faults, then checks that nothing of it can be seen.

    cargo build --release --features fail_points && python3 tests/soak/soak.py --minutes 60

Needs Linux and Python 3.11. Actors come, leave, die, freeze and are cut off; the learner is killed, killed at named
points, stopped, suspended, and given full disks and rubbish. Where network namespaces can be made (link.py), some
actors are on another host, whose network delays, loses and reorders packets and fails in one direction. Each
schedule is new; its seed is printed, and `--seed` repeats it. Checks at the end: final hashes equal those of an
undisturbed run, every slot of every iteration was consumed exactly once, the learner's memory and open files are
flat, and it logged no error that no fault explains. Ends with 0 if all hold.
"""

import argparse
import contextlib
import json
import pathlib
import random
import secrets
import signal
import socket
import subprocess
import sys
import tempfile
import time

from link import ADDRESSES, Link, NoNamespaces
from machine import Learner, Proxy, file_count, free_port, resident_kib, slope_per_minute

ROOT = pathlib.Path(__file__).resolve().parents[2]
PROGRAM = str(ROOT / "target/release/s2mia")
ITERATIONS_PER_MINUTE = 60
LEASE_SECS = 2.0
SETTINGS = [
    "halfcheetah-2x3",
    "run.seed=5",
    "environments.count=8",
    "environments.steps=50",
    "environments.per_slot=2",
    "environments.message_steps=10",
    "evaluation.every_steps=40000",
    "evaluation.episodes=1",
    "checkpoint.every=5",
    f"lease.ttl_secs={LEASE_SECS}",
]
DEATHS = ["after-collect", "mid-update", "after-publish", "mid-checkpoint"]
FULL_DISKS = ["MakeFolder", "WriteFile", "FlushFiles", "Rename", "RemoveOld"]
FULL = "no storage space"
MOST_ACTORS = 4
# A process that is younger than this may not handle signals yet.
STARTED_SECS = 1.0
# The learner dies only before this share of the time, so that its memory can be watched over the rest.
DEATHS_END = 0.4
# The other host's network fails only before this share, so that its actors hear of the end.
LINK_FAULTS_END = 0.9
# Longer than the keepalives of both sides, which end after 30 and 40 s.
LONGEST_LINK_FAULT_SECS = 60.0
WARM_UP_SECS = 60
MAX_KIB_PER_MINUTE = 1024
MAX_MORE_FILES = 24


def say(what: str) -> None:
    print(f"{time.strftime('%H:%M:%S')} {what}", flush=True)


class Actors:
    """Actor processes in turn on this host, behind a proxy that can be cut and stalled, and on the other host."""

    def __init__(self, port: int, folder: pathlib.Path, link: Link | None) -> None:
        self.port, self.folder, self.link = port, folder, link
        self.proxy = Proxy(port)
        self.running: list[subprocess.Popen] = []
        self.frozen: list[tuple[float, subprocess.Popen]] = []
        self.started = 0

    def join(self) -> None:
        here = [PROGRAM, "actor", "--name", f"actor-{self.started}", "--learner"]
        ways = [[*here, f"http://127.0.0.1:{port}"] for port in (self.port, self.proxy.port)]
        if self.link:
            url = f"http://{ADDRESSES['near']}:{self.port}"
            ways.append([*self.link.on("far"), *here, url, "--insecure-allow-remote"])
        command = ways[self.started % len(ways)]
        log = open(self.folder / "actors.log", "a")
        self.running.append(subprocess.Popen(command, stdout=log, stderr=log))
        self.started += 1

    def signal(self, which: subprocess.Popen, number: signal.Signals) -> None:
        which.send_signal(number)
        if number in (signal.SIGKILL, signal.SIGTERM):
            self.running.remove(which)
            which.wait(timeout=30)

    def freeze(self, which: subprocess.Popen) -> None:
        which.send_signal(signal.SIGSTOP)
        self.running.remove(which)
        self.frozen.append((time.monotonic() + 2.5 * LEASE_SECS, which))

    def thaw(self) -> None:
        """Resumes the actors that have been frozen past their leases."""
        due = [one for one in self.frozen if one[0] <= time.monotonic()]
        for one in due:
            one[1].send_signal(signal.SIGCONT)
            self.frozen.remove(one)
            self.running.append(one[1])

    def kill(self) -> None:
        for one in [*self.running, *(frozen for _, frozen in self.frozen)]:
            one.kill()

    def end(self) -> None:
        """Every actor receives that the run is over, and exits with status 0."""
        for _, frozen in self.frozen:
            frozen.send_signal(signal.SIGCONT)
            self.running.append(frozen)
        for one in self.running:
            assert one.wait(timeout=60) == 0, f"an actor ended with status {one.returncode}"
        self.proxy.close()


class Soak:
    """The disturbed run."""

    def __init__(self, minutes: float, seed: int, folder: pathlib.Path, link: Link | None) -> None:
        self.random = random.Random(seed)
        self.secs = 60 * minutes
        self.iterations = int(minutes * ITERATIONS_PER_MINUTE)
        self.folder = folder
        self.link, self.heals = link, 0.0
        settings = [*SETTINGS, f"run.iterations={self.iterations}"]
        self.learner = Learner(PROGRAM, settings, folder, free_port(), "0.0.0.0" if link else "127.0.0.1")
        self.actors = Actors(self.learner.port, folder, link)
        self.counts: dict[str, int] = {}
        self.samples: list[tuple[float, int, int]] = []
        self.good_ends: set[int] = set()
        self.begun = time.monotonic()

    def share(self) -> float:
        """Of the planned time that has passed."""
        return (time.monotonic() - self.begun) / self.secs

    def run(self) -> None:
        next_fault = next_sample = 0.0
        while not self.learner.finished():
            now = time.monotonic()
            if self.learner.process.poll() is not None:
                self.restart()
            self.actors.thaw()
            if self.link and (now >= self.heals or self.share() >= LINK_FAULTS_END):
                self.link.heal()
            self.keep_pace()
            if now >= next_sample:
                self.sample(now)
                next_sample = now + 5.0
            if now >= next_fault and self.share() < 0.97:
                self.disturb()
                next_fault = now + self.random.uniform(1.0, 8.0)
            time.sleep(0.1)
        self.actors.end()

    def keep_pace(self) -> None:
        """Actors join a run that is behind its plan and leave one that is ahead, down to none."""
        ahead = self.learner.iteration() - self.share() * self.iterations
        here = self.actors.running
        if ahead < 0 and len(here) < MOST_ACTORS and self.random.random() < 0.2:
            self.count("an actor joins", self.actors.join)
        elif ahead > 10 and here and self.random.random() < 0.2:
            victim = self.random.choice(here)
            self.count("an actor is asked to leave", lambda: self.actors.signal(victim, signal.SIGTERM))

    def restart(self) -> None:
        """The learner resumes with its folder, perhaps to die again or to find its disk full."""
        ended, words = self.learner.process.returncode, self.learner.last_words()
        # One that is asked to stop and cannot write its last checkpoint ends with 1.
        explained = ended in self.good_ends or (ended == 1 and 0 in self.good_ends and FULL in words)
        assert explained, f"the learner ended with {ended}: {words}"
        self.good_ends = set()
        points = [*FULL_DISKS, *(DEATHS if self.share() < DEATHS_END else [])]
        point = self.random.choice(points)
        # Checkpoints are made at multiples of five.
        iteration = (self.learner.iteration() + self.random.randint(10, 40)) // 5 * 5
        if point in DEATHS:
            self.good_ends.add(-signal.SIGABRT)
        self.count(f"fault laid, {point}", lambda: None)
        self.learner.start(f"{point}@{iteration}")

    def sample(self, now: float) -> None:
        """Memory and open files of the learner's newest life, once it is warm."""
        if self.learner.up_secs() < 5.0:
            self.samples.clear()
        elif self.learner.up_secs() > WARM_UP_SECS:
            pid = self.learner.process.pid
            self.samples.append((now, resident_kib(pid), file_count(pid)))

    def disturb(self) -> None:
        faults = [self.kill_actor, self.freeze_actor, self.cut, self.stall, self.rubbish, self.half_open]
        if self.share() < DEATHS_END:
            faults += [self.kill_learner, self.stop_learner, self.suspend_learner]
        if self.link and self.share() < LINK_FAULTS_END:
            faults += [self.bad_link, self.one_way]
        fault = self.random.choice(faults)
        self.count((fault.__doc__ or "").strip("."), fault)

    def count(self, name: str, fault) -> None:
        self.counts[name] = self.counts.get(name, 0) + 1
        fault()

    def some_actor(self) -> subprocess.Popen:
        if not self.actors.running:
            self.actors.join()
        return self.random.choice(self.actors.running)

    def kill_actor(self) -> None:
        """actor killed."""
        self.actors.signal(self.some_actor(), signal.SIGKILL)

    def freeze_actor(self) -> None:
        """actor frozen past its lease."""
        self.actors.freeze(self.some_actor())

    def cut(self) -> None:
        """connections cut."""
        self.actors.proxy.cut()

    def stall(self) -> None:
        """connections stalled."""
        self.actors.proxy.stall(self.random.uniform(0.5, 2 * LEASE_SECS))

    def rubbish(self) -> None:
        """rubbish sent to the learner."""
        for _ in range(10):
            # A learner that has died, or that has hung up already, hears no more of it.
            with contextlib.suppress(OSError), socket.create_connection(("127.0.0.1", self.learner.port)) as peer:
                peer.sendall(self.random.randbytes(self.random.randint(1, 4096)))

    def half_open(self) -> None:
        """half a greeting, then silence."""
        self.learner.hold_open(b"PRI * HTTP/2.0\r\n")

    def kill_learner(self) -> None:
        """learner killed."""
        self.learner.process.kill()
        self.good_ends.add(-signal.SIGKILL)
        self.learner.process.wait()

    def suspend_learner(self) -> None:
        """learner suspended."""
        self.learner.process.send_signal(signal.SIGSTOP)
        time.sleep(self.random.uniform(0.5, 15.0))
        self.learner.process.send_signal(signal.SIGCONT)

    def bad_link(self) -> None:
        """network with delays, losses and another order."""
        delay, jitter, loss = self.random.uniform(0, 0.1), self.random.uniform(0, 0.1), self.random.uniform(0, 0.1)
        self.link.disturb(delay=delay, jitter=jitter, loss=loss)
        self.heals = time.monotonic() + self.random.uniform(1.0, LONGEST_LINK_FAULT_SECS)

    def one_way(self) -> None:
        """network without packets of one direction."""
        self.link.disturb(cut=(self.random.choice(["near", "far"]),))
        self.heals = time.monotonic() + self.random.uniform(1.0, LONGEST_LINK_FAULT_SECS)

    def stop_learner(self) -> None:
        """learner asked to stop."""
        if self.learner.up_secs() < STARTED_SECS:
            self.good_ends.add(-signal.SIGTERM)
        self.learner.process.terminate()
        self.good_ends.add(0)
        self.learner.process.wait(timeout=30)


def hashes(folder: pathlib.Path) -> dict[str, str]:
    told = subprocess.run([PROGRAM, "inspect", str(folder), "--json"], check=True, capture_output=True, text=True)
    found = json.loads(told.stdout)
    return {name: found[name] for name in ("iteration", "weights_sha256", "state_sha256")}


def undisturbed(iterations: int, folder: pathlib.Path) -> dict[str, str]:
    settings = [*SETTINGS, f"run.iterations={iterations}", f"run.dir={folder}"]
    subprocess.run([PROGRAM, "train", *settings], check=True, capture_output=True)
    return hashes(folder)


def consumed_exactly_once(folder: pathlib.Path, iterations: int) -> bool:
    """Each iteration has one line of provenance, with each of its slots once."""
    lines = [json.loads(line) for line in (folder / "provenance.jsonl").read_text().splitlines()]
    slots = [[slot["slot"] for slot in line["slots"]] for line in lines]
    return [line["iteration"] for line in lines] == list(range(1, iterations + 1)) and all(
        one == [0, 1, 2, 3] for one in slots
    )


def flat(later: list[tuple[float, int, int]]) -> bool:
    """Memory and open files of the learner's last life, after its warming up."""
    memory = slope_per_minute([(when, kib) for when, kib, _ in later])
    files = [count for _, _, count in later]
    say(f"resident memory {later[0][1]} -> {later[-1][1]} KiB, {memory:+.0f} KiB a minute")
    say(f"open files {min(files)} to {max(files)}")
    return memory < MAX_KIB_PER_MINUTE and max(files) - min(files) <= MAX_MORE_FILES


def unexplained_errors(log: pathlib.Path) -> list[str]:
    """Errors of the learner, but for those of a disk that was made to be full."""
    lines = log.read_text(errors="replace").splitlines()
    return [line for line in lines if "ERROR" in line and FULL not in line]


def other_host(seed: int) -> Link | None:
    """Another host, and this process on a host of its own beside it; none where that cannot be had."""
    try:
        link = Link(seed)
    except NoNamespaces as error:
        say(f"all actors are on this host, no network namespace can be made: {error}")
        return None
    link.enter("near")
    return link


def disturbed(options: argparse.Namespace, folder: pathlib.Path, link: Link | None) -> Soak:
    folder.mkdir()
    soak = Soak(options.minutes, options.seed, folder, link)
    try:
        soak.run()
    finally:
        soak.learner.process.kill()
        soak.actors.kill()
    say(f"the disturbed run has ended after {time.monotonic() - soak.begun:.0f} s")
    for name, count in sorted(soak.counts.items()):
        say(f"{count:6} x {name}")
    return soak


def main() -> int:
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("--minutes", type=float, default=60.0)
    options.add_argument("--seed", type=int, default=secrets.randbelow(1_000_000), help="of an earlier schedule")
    options = options.parse_args()
    say(f"the schedule has the seed {options.seed}")
    with tempfile.TemporaryDirectory() as name, contextlib.ExitStack() as stack:
        folder = pathlib.Path(name)
        if link := other_host(options.seed):
            stack.callback(link.close)
        soak = disturbed(options, folder / "disturbed", link)
        found = hashes(soak.learner.run)
        expected = undisturbed(soak.iterations, folder / "undisturbed")
        errors = unexplained_errors(folder / "disturbed" / "learner.log")
        checks = {
            f"hashes equal: {found} and {expected}": found == expected,
            "every slot consumed exactly once": consumed_exactly_once(soak.learner.run, soak.iterations),
            "memory and open files flat": flat(soak.samples),
            f"errors without a fault: {errors[:3]}": not errors,
        }
    for check, held in checks.items():
        say(f"{'held' if held else 'BROKEN'}: {check}")
    return 0 if all(checks.values()) else 1


if __name__ == "__main__":
    sys.exit(main())
