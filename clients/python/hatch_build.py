"""Puts the program and the native module into the wheel.

Both are built from the workspace around this folder, by `cargo build --release`. Two variables take another build:

    S2MIA_BUILT      a folder of the workspace with both, such as target/debug; nothing is built
    S2MIA_PLATFORM   the platform in the wheel's name, such as manylinux_2_28_x86_64; by default this machine's
"""

import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface
from packaging import tags

# The oldest Python of the stable ABI that `pyo3` in the workspace's Cargo.toml names.
PYTHON = "cp310-abi3"


class Native(BuildHookInterface):
    """The part of a wheel that is not Python."""

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Adds the program as a script and the module as a file of the package."""
        if version == "editable":
            raise RuntimeError("an editable installation would lack the native module; CONTRIBUTING.md says what to do instead")
        if self.target_name != "wheel":
            raise RuntimeError("only a wheel can be built: a source archive would lack the Rust sources")
        built = self.built()
        library = "lib_native.dylib" if sys.platform == "darwin" else "lib_native.so"
        platform = os.environ.get("S2MIA_PLATFORM") or next(tags.platform_tags())
        build_data["pure_python"] = False
        build_data["tag"] = f"{PYTHON}-{platform}"
        build_data["shared_scripts"][str(built / "s2mia")] = "s2mia"
        build_data["force_include"][str(built / library)] = "s2mia/_native.abi3.so"

    def built(self) -> Path:
        """The folder with the program and the module."""
        workspace = Path(self.root).parents[1]
        if given := os.environ.get("S2MIA_BUILT"):
            return workspace / given
        if not shutil.which("cargo"):
            raise RuntimeError("building s2mia needs Rust and a C compiler: https://rustup.rs")
        target = workspace / "target"
        command = ["cargo", "build", "--release", "--locked", "--package=s2mia", "--package=python", f"--target-dir={target}"]
        subprocess.run(command, cwd=workspace, check=True)
        return target / "release"
