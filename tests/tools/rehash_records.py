"""Rewrites the hashes of settings in `docs/*.csv` and `pretrained/teams.toml` after a change of the settings' keys or defaults.

    python3 tests/tools/rehash_records.py BEFORE AFTER

BEFORE and AFTER are the program built before and after the change. Each run of each file in `configs/experiments` is resolved by both with
`s2mia config`. A recorded run with the hash that BEFORE gives gets the one of AFTER. A run that has the latter already is left, so the
command may be repeated; any other is named and left. Only apply it if the change leaves the weights of the recorded runs equal.
"""

import hashlib
import os
import pathlib
import subprocess
import sys
import tomllib

ROOT = pathlib.Path(__file__).resolve().parents[2]


def flat(table: dict, prefix: str = "") -> list[str]:
    """Settings of a TOML table as arguments."""
    found = []
    for key, value in table.items():
        if isinstance(value, dict):
            found += flat(value, f"{prefix}{key}.")
        else:
            found.append(f"{prefix}{key}={str(value).lower() if isinstance(value, bool) else value}")
    return found


def resolved(program: str, arguments: list[str]) -> dict[str, str] | None:
    """What `s2mia config` prints: the settings and `config_sha256`; None if it refuses one."""
    environment = {key: value for key, value in os.environ.items() if not key.startswith("S2MIA__")}
    result = subprocess.run([program, "config", *arguments], capture_output=True, text=True, env=environment, check=False)
    if result.returncode:
        return None
    found, section = {}, ""
    for line in result.stdout.splitlines():
        if line.startswith("["):
            section = line.strip()[1:-1] + "."
        elif line.startswith("# config_sha256 = "):
            found["config_sha256"] = line.split(" = ")[1]
        elif " = " in line:
            key, value = line.split(" = ", 1)
            found[section + key] = value.split("  # ")[0].rstrip()
    return found


def recorded_sha256(found: dict[str, str], every_steps: str) -> str:
    """The hash that `s2mia experiment` records for a run: src/experiment/record.rs."""
    hasher = hashlib.sha256(bytes.fromhex(found["config_sha256"]))
    if found["environment_service.url"] != '""':
        hasher.update(b"external environment\n")
    hasher.update(f"evaluation.every_steps = {every_steps}\n".encode())
    hasher.update(f"evaluation.episodes = {found['evaluation.episodes']}\n".encode())
    if found["evaluation.sampled"] == "true":
        hasher.update(b"evaluation.sampled = true\n")
    return hasher.hexdigest()


def planned(path: pathlib.Path, program: str) -> dict[tuple, str]:
    """Hash of each run of an experiment file by task, variant and seed."""
    file = tomllib.loads(path.read_text())
    hashes = {}
    for variant in file["variants"]:
        steps = variant.get("env_steps", file["env_steps"])
        settings = flat(file.get("settings", {})) + flat(variant.get("settings", {}))
        for task in variant.get("tasks", file["tasks"]):
            url = file.get("environments", {}).get(task)
            service = [f"environment_service.url={url}"] if url else []
            names = [f"task={task}", f"algorithm={variant['algorithm']}"]
            chosen = any(setting.startswith("evaluation.every_steps=") for setting in settings)
            for seed in variant.get("seeds", file["seeds"]):
                found = resolved(program, [*names, *service, *settings, f"run.env_steps={steps}", f"run.seed={seed}"])
                if found is None:
                    continue
                every_steps = found["evaluation.every_steps"]
                if int(every_steps) > steps // 10 and not chosen:
                    every_steps = str(max(steps // 10, 1))
                name = variant.get("name", variant["algorithm"])
                hashes[task, name, seed] = recorded_sha256(found, every_steps)
    return hashes


def rewrite(path: pathlib.Path, renewed: dict[tuple, str]) -> None:
    """Rewrites the column `settings_sha256` of a record."""
    lines = path.read_text().split("\n")
    column = lines[0].split(",").index("settings_sha256")
    counts = {"rewritten": 0, "left": 0}
    for at, line in enumerate(lines[1:], 1):
        fields = line.split(",")
        if len(fields) <= column or not fields[column]:
            continue
        run = (fields[0], fields[1], int(fields[2]))
        if (*run, fields[column]) in renewed:
            fields[column] = renewed[*run, fields[column]]
            lines[at] = ",".join(fields)
            counts["rewritten"] += 1
        elif fields[column] in renewed.values():
            counts["left"] += 1
        else:
            print(f"{path.name}: {run} has a hash of neither program")
    path.write_text("\n".join(lines))
    print(f"{path.name}: {counts}")


def rewrite_teams(before: str, after: str) -> None:
    """Rewrites the hashes of the trained teams' settings."""
    path = ROOT / "pretrained/teams.toml"
    text = path.read_text()
    for task, team in tomllib.loads(text).items():
        settings = [task, f"algorithm={team['algorithm']}", f"run.seed={team['seed']}"]
        old, new = resolved(before, settings), resolved(after, settings)
        if not old or not new:
            print(f"{path.name}: {task} is refused by one of the programs")
        elif team["settings_sha256"] in (old["config_sha256"], new["config_sha256"]):
            text = text.replace(old["config_sha256"], new["config_sha256"])
        else:
            print(f"{path.name}: {task} has a hash of neither program")
    path.write_text(text)


def main() -> None:
    before, after = sys.argv[1:]
    records: dict[pathlib.Path, dict[tuple, str]] = {}
    for path in sorted((ROOT / "configs/experiments").glob("*.toml")):
        record = tomllib.loads(path.read_text()).get("record")
        if record:
            old, new = planned(path, before), planned(path, after)
            pairs = {(*run, old[run]): new[run] for run in old if run in new}
            records.setdefault(ROOT / record, {}).update(pairs)
    for path, renewed in sorted(records.items()):
        rewrite(path, renewed)
    rewrite_teams(before, after)


if __name__ == "__main__":
    main()
