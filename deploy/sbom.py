"""Prints a software bill of materials of the program `s2mia` and its Python module, as CycloneDX 1.6 JSON: `python3 deploy/sbom.py > s2mia.cdx.json`.

It lists every crate that is compiled into them or runs during its build, with licence and SHA-256, and what needs what. Tests are
left out. It is made from Cargo.lock and `cargo metadata`, without a network if the crates are there, and has no time or random number in
it: one commit has one bill.
"""

import json
import pathlib
import subprocess
import tomllib

ROOT = pathlib.Path(__file__).resolve().parents[1]
# The crates of the image; other systems need few others.
PLATFORM = "x86_64-unknown-linux-gnu"
NOT_IN_THE_PROGRAM = {"dev"}


def metadata() -> dict:
    command = ["cargo", "metadata", "--format-version=1", "--locked", f"--filter-platform={PLATFORM}"]
    return json.loads(subprocess.run(command, cwd=ROOT, check=True, capture_output=True).stdout)


def needed(nodes: dict[str, dict], roots: list[str]) -> dict[str, list[str]]:
    """What each crate of the roots needs, by its id."""
    found: dict[str, list[str]] = {}
    waiting = list(roots)
    while waiting:
        crate = waiting.pop()
        if crate in found:
            continue
        kinds = {dep["pkg"]: {kind["kind"] or "normal" for kind in dep["dep_kinds"]} for dep in nodes[crate]["deps"]}
        found[crate] = sorted(dep for dep, of in kinds.items() if of - NOT_IN_THE_PROGRAM)
        waiting += found[crate]
    return found


def purl(package: dict) -> str:
    return f"pkg:cargo/{package['name']}@{package['version']}"


def component(package: dict, checksums: dict) -> dict:
    found = {"type": "library", "bom-ref": purl(package), "name": package["name"], "version": package["version"]}
    if licence := package["license"]:
        found["licenses"] = [{"expression": licence.replace("/", " OR ")}]
    if checksum := checksums.get((package["name"], package["version"])):
        found["hashes"] = [{"alg": "SHA-256", "content": checksum}]
    return found | {"purl": purl(package)}


def bill() -> dict:
    found = metadata()
    packages = {package["id"]: package for package in found["packages"]}
    own = {packages[crate]["name"]: crate for crate in found["workspace_members"]}
    program = own["s2mia"]
    needs = needed({node["id"]: node for node in found["resolve"]["nodes"]}, [program, own["python"]])
    lock = tomllib.loads((ROOT / "Cargo.lock").read_text())["package"]
    checksums = {(crate["name"], crate["version"]): crate.get("checksum") for crate in lock}
    crates = sorted((packages[crate] for crate in needs if crate != program), key=purl)
    return {
        "bomFormat": "CycloneDX",
        "specVersion": "1.6",
        "version": 1,
        "metadata": {"component": component(packages[program], checksums) | {"type": "application"}},
        "components": [component(crate, checksums) for crate in crates],
        "dependencies": [
            {"ref": purl(packages[crate]), "dependsOn": [purl(packages[other]) for other in of]}
            for crate, of in sorted(needs.items(), key=lambda one: purl(packages[one[0]]))
        ],
    }


if __name__ == "__main__":
    print(json.dumps(bill(), indent=2))
