"""What the container image is built from."""

import tomllib
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]


def test_the_image_gets_every_crate_of_the_workspace():
    manifest = tomllib.loads((ROOT / "Cargo.toml").read_text())
    taken = {line[1:] for line in (ROOT / ".dockerignore").read_text().splitlines() if line.startswith("!")}
    targets = [one["path"].split("/")[0] for kind in ("bench", "example") for one in manifest.get(kind, [])]
    # The workspace needs the crate of the Python package, the image nothing else of it.
    crates = {member for member in manifest["workspace"]["members"] if not {f"{member}/Cargo.toml", f"{member}/src"} <= taken}
    assert {*crates, *targets, "src", "configs"} - taken == set()
