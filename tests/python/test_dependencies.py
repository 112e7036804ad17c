"""What is built, tested and deployed comes from known places: hashes, commits, sources and licences. Reads files only."""

import json
import os
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
DENY = tomllib.loads((ROOT / "deny.toml").read_text())
CRATES = [crate for crate in tomllib.loads((ROOT / "Cargo.lock").read_text())["package"] if "source" in crate]
DOWNLOADED = Path(os.environ.get("CARGO_HOME", Path.home() / ".cargo")) / "registry" / "src"


def allowed(licence):
    """Whether an SPDX expression permits a licence of deny.toml; the old form `A/B` means `A OR B`."""
    words = re.findall(r"[()]|[\w.+-]+(?: WITH [\w.+-]+)?", licence.replace("/", " OR "))
    known = {"(": "(", ")": ")", "OR": "or", "AND": "and"}
    return eval(" ".join(known.get(word, str(word in DENY["licenses"]["allow"])) for word in words))


@pytest.mark.parametrize(
    ("licence", "expected"),
    [("MIT/Apache-2.0", True), ("(GPL-3.0 OR MIT) AND ISC", True), ("MIT AND GPL-3.0", False), ("MIT WITH Bison", False)],
)
def test_an_expression_of_licences_is_read(licence, expected):
    assert allowed(licence) is expected


def test_every_crate_has_a_licence_that_is_allowed():
    wrong = {}
    for crate in CRATES:
        # A crate that no build on this machine needs is not here.
        for manifest in DOWNLOADED.glob(f"*/{crate['name']}-{crate['version']}/Cargo.toml"):
            licence = tomllib.loads(manifest.read_text())["package"].get("license", "none")
            if not allowed(licence):
                wrong[crate["name"]] = licence
    assert wrong == {}


def test_every_crate_comes_from_the_registry_with_its_hash_and_none_is_banned():
    (registry,) = DENY["sources"]["allow-registry"]
    assert {crate["source"] for crate in CRATES} == {f"registry+{registry}"}
    assert all(crate["checksum"] for crate in CRATES)
    assert {crate["name"] for crate in CRATES} & {ban["crate"] for ban in DENY["bans"]["deny"]} == set()


@pytest.mark.parametrize("folder", ["deploy", "tests/python"])
def test_every_python_package_has_hashes(folder):
    wanted, locked = ((ROOT / folder / f"requirements.{end}").read_text() for end in ("in", "txt"))
    packages = dict(re.findall(r"^(\S+==\S+)((?: \\\n    --hash=sha256:[0-9a-f]{64})*)$", locked, re.MULTILINE))
    assert set(packages) == set(re.findall(r"^\S+==\S+$", wanted, re.MULTILINE))
    assert all(packages.values())
    for script in (".ci/run", ".github/workflows/release.yml"):
        assert "--require-hashes" in (ROOT / script).read_text()


def test_every_action_is_pinned_to_a_commit():
    for workflow in (ROOT / ".github" / "workflows").iterdir():
        for action in re.findall(r"uses: *(.+)", workflow.read_text()):
            assert re.fullmatch(r"[\w/-]+@[0-9a-f]{40} # v[\d.]+", action), action


def test_the_bill_of_materials_has_every_crate_of_the_program_with_its_hash_and_licence():
    made = [subprocess.run([sys.executable, ROOT / "deploy" / "sbom.py"], check=True, capture_output=True).stdout for _ in range(2)]
    assert made[0] == made[1]
    bill = json.loads(made[0])
    components = {component["name"]: component for component in bill["components"]}
    own = {"actor", "kernels", "learner", "marl", "policy", "proto", "python", "recording", "rollout", "security", "sim"}
    assert own | {"tonic", "rustls", "candle-core", "rapier3d", "pyo3"} <= set(components)
    assert "proptest" not in components, "crates of tests are not in the program"
    checksums = {(crate["name"], crate["version"]): crate["checksum"] for crate in CRATES}
    for name in set(components) - own:
        (hashed,) = components[name]["hashes"]
        assert hashed == {"alg": "SHA-256", "content": checksums[name, components[name]["version"]]}
        assert allowed(components[name]["licenses"][0]["expression"])
    known = {component["bom-ref"] for component in bill["components"]} | {bill["metadata"]["component"]["bom-ref"]}
    assert {needed for one in bill["dependencies"] for needed in [one["ref"], *one["dependsOn"]]} == known
