"""Finds the policies of a run and verifies their hashes."""

import hashlib
import json
import pathlib
import re
from typing import Any

from s2mia.error import RunError

SCHEMA = 2
POLICY = "policy.safetensors"
MANIFEST = "manifest.json"
_ITERATION = re.compile(r"iter_(\d{8,})")


def policy_file(path: pathlib.Path) -> pathlib.Path:
    """The policy file that `path` means: itself, that of a checkpoint, or that of a run's newest checkpoint."""
    if path.is_file():
        return path
    if not path.is_dir():
        raise RunError(f"{path} does not exist; expected a run folder, a checkpoint or a {POLICY}")
    if (path / POLICY).is_file() or _ITERATION.fullmatch(path.name):
        return path / POLICY
    checkpoints = path / "checkpoints"
    if not checkpoints.is_dir():
        missing = "no checkpoint yet" if (path / "config.toml").is_file() else "no config.toml and no checkpoints"
        raise RunError(f"{path} is no run folder with policies: it has {missing}")
    numbers = {int(found[1]): entry for entry in checkpoints.iterdir() if (found := _ITERATION.fullmatch(entry.name))}
    if not numbers:
        raise RunError(f"{checkpoints} holds no checkpoint yet")
    return numbers[max(numbers)] / POLICY


def read_policy(path: pathlib.Path) -> bytes:
    """The bytes of a policy file, compared with the manifest beside it. An exported file has none."""
    data = read(path)
    if not (path.parent / MANIFEST).is_file():
        if _ITERATION.fullmatch(path.parent.name):
            raise RunError(f"{path.parent} is damaged: it has no {MANIFEST}")
        return data
    entry = _manifest(path.parent / MANIFEST)["files"].get(path.name)
    if entry is None:
        raise RunError(f"{path.parent / MANIFEST} does not list {path.name}")
    found = hashlib.sha256(data).hexdigest()
    if found != entry["sha256"]:
        raise RunError(f"{path} is damaged: it has SHA-256 {found}, {MANIFEST} has {entry['sha256']}")
    return data


def _manifest(path: pathlib.Path) -> dict[str, Any]:
    """A checkpoint's manifest, which contains its own hash."""
    text = read(path)
    try:
        manifest: dict[str, Any] = json.loads(text)
        schema, own, _ = manifest["schema"], manifest["manifest_sha256"], manifest["files"].items()
    except (AttributeError, ValueError, TypeError, KeyError) as error:
        raise RunError(f"{path} is damaged: {error!r}") from None
    if schema != SCHEMA:
        raise RunError(f"{path} has schema {schema}, this package reads {SCHEMA}")
    bare = text.replace(f'"manifest_sha256": "{own}"'.encode(), b'"manifest_sha256": ""')
    if hashlib.sha256(bare).hexdigest() != own:
        raise RunError(f"{path} is damaged: it does not have its own hash")
    return manifest


def read(path: pathlib.Path) -> bytes:
    """The bytes of a file of a run. Raises `RunError` if it cannot be read."""
    try:
        return path.read_bytes()
    except OSError as error:
        raise RunError(f"{path} cannot be read: {error.strerror}") from None
