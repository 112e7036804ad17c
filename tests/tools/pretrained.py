"""Makes the trained teams that come with the program, `pretrained/TASK.safetensors`, and their records, `pretrained/teams.toml`.

    python3 tests/tools/pretrained.py PROGRAM [TASK ...] [--runs FOLDER]

For each TASK, or for all that have a team, PROGRAM trains with the algorithm of `ALGORITHMS`, its default settings and seed 1 into FOLDER/TASK (`runs/pretrained`), which takes
two to eight minutes each on two idle cores, and evaluates the run. A finished run in FOLDER/TASK is used as it is. Afterwards build
the program again; `cargo test pretrained` compares the teams with their records. A new task also needs a line in `src/run/pretrained.rs`.
"""

import argparse
import hashlib
import json
import pathlib
import shutil
import subprocess
import tomllib

ROOT = pathlib.Path(__file__).resolve().parents[2]
TEAMS = ROOT / "pretrained"
RECORDS = TEAMS / "teams.toml"
HEAD = "# The trained teams that come with the program: src/run/pretrained.rs explains the fields.\n"
SEED = 1

# The default algorithm does not learn to push the load (docs/STUDY.md).
ALGORITHMS = {"carry-light-2x2": "happo", "carry-heavy-2x2": "happo"}


def output(*command: object) -> str:
    """Standard output of a command that must succeed."""
    return subprocess.run([str(word) for word in command], check=True, stdout=subprocess.PIPE, text=True).stdout


def trained(program: str, task: str, run: pathlib.Path) -> dict[str, object]:
    """Trains the task unless `run` is a finished run, copies its policies and returns the team's record."""
    algorithm = ALGORITHMS.get(task, "happo-s2mia")
    if not (run / "checkpoints/LATEST").is_file():
        output(program, "train", task, f"algorithm={algorithm}", f"run.seed={SEED}", f"run.dir={run}")
    manifest = json.loads((run / "manifest.json").read_text())
    settings = output(program, "config", task, f"algorithm={algorithm}", f"run.seed={manifest['seed']}").splitlines()
    expected = settings[-1].removeprefix("# config_sha256 = ")
    if (manifest["task"], manifest["config_sha256"]) != (task, expected):
        raise SystemExit(f"{run} is no run of {task} with the default settings of {algorithm}")
    steps = next(int(line.split()[2]) for line in settings if line.startswith("env_steps = "))
    checkpoint = run / "checkpoints" / (run / "checkpoints/LATEST").read_text().strip()
    content = json.loads((checkpoint / "manifest.json").read_text())
    if content["env_steps"] < steps:
        raise SystemExit(f"{run} has {content['env_steps']} of {steps} environment steps")
    measured = json.loads(output(program, "eval", run, "--json"))
    policy = checkpoint / "policy.safetensors"
    shutil.copy(policy, TEAMS / f"{task}.safetensors")
    return {
        "algorithm": algorithm,
        "seed": manifest["seed"],
        "iteration": content["iteration"],
        "env_steps": content["env_steps"],
        "return_mean": measured["return_mean"],
        "return_standard_deviation": measured["return_standard_deviation"],
        "first_return": measured["episodes"][0]["return"],
        "settings_sha256": manifest["config_sha256"],
        "weights_sha256": content["weights_sha256"],
        "policy_sha256": hashlib.sha256(policy.read_bytes()).hexdigest(),
        "commit": manifest["git_commit"],
    }


def main() -> None:
    """Renews the teams that the command line names."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("program")
    parser.add_argument("tasks", nargs="*", metavar="TASK")
    parser.add_argument("--runs", type=pathlib.Path, default=ROOT / "runs/pretrained", metavar="FOLDER")
    arguments = parser.parse_args()
    records = tomllib.loads(RECORDS.read_text()) if RECORDS.exists() else {}
    for task in arguments.tasks or list(records):
        records[task] = trained(arguments.program, task, arguments.runs / task)
        tables = (
            f"\n[{name}]\n" + "".join(f"{key} = {json.dumps(value)}\n" for key, value in record.items())
            for name, record in sorted(records.items())
        )
        RECORDS.write_text(HEAD + "".join(tables))
        print(f"{task}: return {records[task]['return_mean']:.1f}")


if __name__ == "__main__":
    main()
