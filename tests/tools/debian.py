"""Programs from Debian's packages, unpacked beside the build and never installed."""

import pathlib
import shutil
import subprocess
import sys

ROOT = pathlib.Path(__file__).resolve().parents[2]
TOOLS = ROOT / "target" / "ci-tools"


# How a test ends on a machine that has no such packages.
UNREACHABLE = 3


def program(package: str, path: str) -> pathlib.Path:
    """The program at `path` of a package, fetched once; where no package can be had, one line says so and all ends with 3."""
    found = TOOLS / package / path
    if not found.exists():
        archives = TOOLS / "archives" / package
        archives.mkdir(parents=True, exist_ok=True)
        if not fetched(package, archives):
            print(f"{pathlib.Path(sys.argv[0]).name} not run: no package {package} from apt-get and dpkg here")
            raise SystemExit(UNREACHABLE)
        newest = max(archives.glob("*.deb"), key=lambda file: file.stat().st_mtime)
        subprocess.run(["dpkg", "-x", newest, TOOLS / package], check=True)
    return found


def fetched(package: str, folder: pathlib.Path) -> bool:
    if shutil.which("apt-get") is None or shutil.which("dpkg") is None:
        return False
    works = lambda *command: subprocess.run(command, cwd=folder, capture_output=True).returncode == 0
    download = ("apt-get", "download", package)
    # The lists may be missing or old.
    return works(*download) or (works("apt-get", "update", "-qq") and works(*download))
