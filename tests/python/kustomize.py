"""What `kubectl kustomize` makes of a folder: its resources under its JSON 6902 patches. Names of images and settings stay as they are."""

from pathlib import Path

import jsonpatch
import yaml

# What is applied here, and what changes no form of a manifest.
APPLIED = {"resources", "patches"}
LEFT_ALONE = {"apiVersion", "kind", "namespace", "images", "configMapGenerator"}


def rendered(folder: Path) -> list[dict]:
    """All documents of a kustomization; a patch that meets nothing is an error."""
    kustomization = yaml.safe_load((folder / "kustomization.yaml").read_text())
    assert kustomization.keys() <= APPLIED | LEFT_ALONE, folder
    found = [document for resource in kustomization["resources"] for document in documents(folder / resource)]
    for patch in kustomization.get("patches", []):
        found = patched(found, patch["target"], yaml.safe_load(patch["patch"]))
    return found


def documents(path: Path) -> list[dict]:
    """Those of a file, or of the kustomization in a folder."""
    return rendered(path) if path.is_dir() else list(yaml.safe_load_all(path.read_text()))


def patched(found: list[dict], target: dict, operations: list[dict]) -> list[dict]:
    """All documents, the one of this kind and name changed; raises `JsonPatchConflict` where it has not what is to change."""
    meant = [one for one in found if (one["kind"], one["metadata"]["name"]) == (target["kind"], target["name"])]
    assert len(meant) == 1, target
    return [jsonpatch.apply_patch(one, operations) if one is meant[0] else one for one in found]
