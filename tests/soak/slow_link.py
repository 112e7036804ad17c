"""Environment steps per second over a slow link: `cargo build --release && python3 tests/soak/slow_link.py [SETTING...]`.

A learner and two actors are on two hosts (network namespaces, link.py). The same run is computed over an undisturbed link and over one with
a round trip of 20 ms that loses 1 % of the packets. Prints both rates and their ratio; ends with 1 if the hashes differ, and with 3
where no network namespace can be made.
"""

import contextlib
import json
import pathlib
import statistics
import subprocess
import sys
import tempfile
import time

from link import ADDRESSES, Link, NoNamespaces

ROOT = pathlib.Path(__file__).resolve().parents[2]
PROGRAM = str(ROOT / "target" / "release" / "s2mia")
UNREACHABLE = 3
ACTORS = 2
URL = f"http://{ADDRESSES['near']}:50051"
REMOTE = "--insecure-allow-remote"
SETTINGS = ["run.seed=7", "run.iterations=40", "evaluation.every_steps=0"]


def train(link: Link, folder: pathlib.Path, settings: list[str]) -> tuple[float, dict]:
    """Median rate of the iterations after the first five, and the hashes of the run."""
    run = folder / "run"
    near = [*link.on("near"), PROGRAM, "learner", f"--listen={ADDRESSES['near']}:50051", REMOTE, f"run.dir={run}", *settings]
    far = [*link.on("far"), PROGRAM, "actor", REMOTE, "--learner", URL]
    with contextlib.ExitStack() as stack:
        log = stack.enter_context(open(folder / "log", "w"))
        learner = subprocess.Popen(near, stdout=log, stderr=log)
        stack.callback(learner.kill)
        time.sleep(1)
        actors = [subprocess.Popen(far, stdout=log, stderr=log) for _ in range(ACTORS)]
        stack.callback(lambda: [actor.kill() for actor in actors])
        if learner.wait(timeout=600):
            raise SystemExit((folder / "log").read_text()[-2000:])
    lines = [json.loads(line) for line in (run / "metrics.jsonl").read_text().splitlines()]
    rates = [line["env_steps_per_sec"] for line in lines if line["kind"] == "iteration"]
    told = subprocess.run([PROGRAM, "inspect", str(run), "--json"], check=True, capture_output=True, text=True)
    hashes = {name: json.loads(told.stdout)[name] for name in ("weights_sha256", "state_sha256")}
    return statistics.median(rates[5:]), hashes


def main() -> int:
    settings = [*SETTINGS, *sys.argv[1:]]
    try:
        link = Link(seed=1)
    except NoNamespaces as error:
        print(f"slow link: {error}")
        return UNREACHABLE
    with contextlib.closing(link), tempfile.TemporaryDirectory() as folder:
        results = []
        for name, disturbance in (("undisturbed", {}), ("slow", {"delay": 0.01, "loss": 0.01})):
            link.disturb(**disturbance)
            (pathlib.Path(folder) / name).mkdir()
            results.append(train(link, pathlib.Path(folder) / name, settings))
            print(f"{name}: {results[-1][0]:.0f} env steps/s", flush=True)
        (whole, hashes), (slow, others) = results
        print(f"ratio {slow / whole:.2f}, hashes {'equal' if hashes == others else 'differ'}")
        return int(hashes != others)


if __name__ == "__main__":
    sys.exit(main())
