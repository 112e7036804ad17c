"""Power loss at every moment of a run: `cargo build --features fail_points && python3 tests/tools/power_loss.py [--whole]`.

strace records a run that is killed once and resumed. After each of its writes, a power loss may leave any part of what was not flushed.
The folders that it can leave are made, and the run in each is resumed. It must end with the hashes of an undisturbed run, with every
iteration once in metrics and provenance, and no checkpoint that was complete may be lost. Without `--whole` a sample is tried. Ends with
0 if all of it holds, and with 3 where strace cannot be had or may not trace.
"""

import argparse
import dataclasses
import json
import pathlib
import random
import re
import subprocess
import sys
import tempfile

from debian import ROOT, UNREACHABLE
from disk_record import KINDS, Disk, build, digest, record

PROGRAM = str(ROOT / "target" / "debug" / "s2mia")
ITERATIONS = 4
SETTINGS = [
    "halfcheetah-2x3",
    "run.seed=7",
    f"run.iterations={ITERATIONS}",
    "run.actors=2",
    "environments.count=4",
    "environments.steps=20",
    "environments.per_slot=2",
    "environments.message_steps=10",
    "policy.encoder=8",
    "policy.hidden=8",
    "critic.width=16",
    "influence.encoder=8",
    "influence.hidden=8",
    "evaluation.every_steps=160",
    "evaluation.episodes=1",
    "checkpoint.every=1",
    "checkpoint.keep_last=2",
]
# Where the run is, below the folder that exists before it: the names of both must last, too.
RUN = "runs/run"
SAMPLE = 15


@dataclasses.dataclass
class State:
    """A folder that a power loss may leave."""

    after: str
    kind: str
    left: dict
    # Iteration of the newest checkpoint that was complete before the power loss.
    promised: int


def states(root: pathlib.Path, folder: pathlib.Path) -> list[State]:
    """All different folders that a power loss during a run, which dies once and is resumed, may leave of `root`."""
    root.mkdir()
    run = f"run.dir={root / RUN}"
    dies = ["env", "S2MIA_FAIL_AT=mid-checkpoint@2", PROGRAM]
    status, first = record([*dies, "train", *SETTINGS, run], folder / "first")
    if not first:
        print("power_loss.py not run: strace may not trace here")
        raise SystemExit(UNREACHABLE)
    assert status != 0, "the first run did not die: cargo build --features fail_points"
    status, second = record([PROGRAM, "train", "--resume", str(root / RUN)], folder / "second")
    assert status == 0, f"the recorded resume ended with {status}"
    disk, found, promised = Disk(root), {}, 0
    for number, call in enumerate(first + second):
        if not disk.apply(call):
            continue
        for kind in KINDS:
            left = disk.left(kind)
            found.setdefault(digest(left), State(f"call {number}, {call.name}", kind, left, promised))
        # A checkpoint is complete when its name, which `LATEST` repeats, has been flushed.
        certain = disk.left("nothing that was not flushed").get(f"{RUN}/checkpoints/LATEST", b"")
        promised = max(promised, *map(int, re.findall(rb"iter_(\d+)", certain)), 0)
    assert disk.agrees(), "the record does not explain the folder: a call was missed"
    assert promised == ITERATIONS, f"checkpoint {promised} is the newest whose path was flushed, from {root} on"
    return list(found.values())


def s2mia(*arguments: str) -> str:
    ended = subprocess.run([PROGRAM, *arguments], capture_output=True, text=True)
    assert ended.returncode == 0, f"{arguments[0]} ended with {ended.returncode}: {ended.stderr[-2000:]}"
    return ended.stdout


def hashes(run: pathlib.Path) -> dict:
    return json.loads(s2mia("inspect", str(run), "--json"))


def lines(file: pathlib.Path) -> list[dict]:
    return [json.loads(line) for line in file.read_text().splitlines()]


def evaluations(run: pathlib.Path) -> list[tuple]:
    found = [line for line in lines(run / "metrics.jsonl") if line["kind"] == "evaluation"]
    return [(line["iteration"], line["mean"]) for line in found]


def check(state: State, root: pathlib.Path, expected: tuple) -> None:
    """Resumes from the files that are left as a user would, and compares the end."""
    build(state.left, root)
    run = root / RUN
    there = (run / "manifest.json").is_file() or (run / "checkpoints").is_dir()
    assert there or not state.promised, "the run is gone"
    if state.promised:
        assert (found := hashes(run)["iteration"]) >= state.promised, f"checkpoint {state.promised} is lost, {found} is left"
    s2mia("train", *(["--resume", str(run)] if there else [*SETTINGS, f"run.dir={run}"]))
    assert (hashes(run), evaluations(run)) == expected, "the run ends differently"
    iterations = [line["iteration"] for line in lines(run / "provenance.jsonl")]
    assert iterations == list(range(1, ITERATIONS + 1)), f"provenance has the iterations {iterations}"
    iterations = [line["iteration"] for line in lines(run / "metrics.jsonl") if line["kind"] == "iteration"]
    assert iterations == list(range(1, ITERATIONS + 1)), f"metrics have the iterations {iterations}"
    manifest = json.loads((run / "manifest.json").read_text())
    assert manifest["foreign_actors"] is False, "the manifest was lost"


def main() -> int:
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("--whole", action="store_true", help="try all folders")
    options.add_argument("--seed", type=int, default=1, help="of the sample")
    options = options.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = pathlib.Path(name).resolve()
        quiet = folder / "quiet"
        s2mia("train", *SETTINGS, f"run.dir={quiet}")
        expected = hashes(quiet), evaluations(quiet)
        found = states(folder / "recorded", folder)
        chosen = found if options.whole else random.Random(options.seed).sample(found, SAMPLE)
        failures = 0
        for number, state in enumerate(chosen):
            try:
                check(state, folder / f"left-{number}", expected)
            except AssertionError as error:
                failures += 1
                print(f"power loss after {state.after}, which left {state.kind}: {error}", flush=True)
    print(f"{len(chosen) - failures} of {len(chosen)} folders that a power loss can leave were resumed exactly ({len(found)} are known)")
    return 1 if failures else 0


if __name__ == "__main__":
    sys.exit(main())
