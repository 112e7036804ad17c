"""Programs from Debian's packages, unpacked beside the build and never installed."""

import pathlib
import subprocess

ROOT = pathlib.Path(__file__).resolve().parents[2]
TOOLS = ROOT / "target" / "ci-tools"


def program(package: str, path: str) -> pathlib.Path:
    """The program at `path` of a package, fetched once."""
    found = TOOLS / package / path
    if not found.exists():
        archives = TOOLS / "archives" / package
        archives.mkdir(parents=True, exist_ok=True)
        fetch = ["apt-get", "download", package]
        if subprocess.run(fetch, cwd=archives, capture_output=True).returncode != 0:
            # The lists may be missing or old.
            subprocess.run(["apt-get", "update", "-qq"], check=True)
            subprocess.run(fetch, cwd=archives, check=True)
        newest = max(archives.glob("*.deb"), key=lambda file: file.stat().st_mtime)
        subprocess.run(["dpkg", "-x", newest, TOOLS / package], check=True)
    return found
