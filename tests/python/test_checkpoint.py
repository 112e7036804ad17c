"""A checkpoint opens without s2mia: safetensors, a manifest, and hashes from Python's own library."""

import hashlib
import json
import struct

import numpy as np
import pytest
from safetensors.numpy import load_file

from conftest import ITERATIONS


@pytest.fixture(scope="module")
def checkpoint(run):
    """Folder of the newest checkpoint."""
    return run / "checkpoints" / (run / "checkpoints" / "LATEST").read_text().strip()


@pytest.fixture(scope="module")
def manifest(checkpoint):
    """Its manifest."""
    return json.loads((checkpoint / "manifest.json").read_text())


def test_the_newest_checkpoint_is_that_of_the_last_iteration(checkpoint, inspected):
    assert checkpoint.name == f"iter_{ITERATIONS:08}"
    assert inspected["iteration"] == ITERATIONS


def test_the_manifest_s_hashes_are_those_of_the_files(checkpoint, manifest):
    listed = manifest["files"]
    assert set(listed) == {path.name for path in checkpoint.iterdir()} - {"manifest.json"}
    for name, entry in listed.items():
        data = (checkpoint / name).read_bytes()
        assert len(data) == entry["size"]
        assert hashlib.sha256(data).hexdigest() == entry["sha256"]


def test_manifest_and_inspect_tell_the_same(manifest, inspected):
    for key in ("iteration", "env_steps", "weights_sha256", "state_sha256"):
        assert manifest[key] == inspected[key]


def sha256_of_arrays(arrays):
    """The hash that `policy/src/arrays.rs` describes, written from its description alone."""
    tags = {"float32": 1, "float64": 2, "int64": 3, "uint8": 4}
    digest = hashlib.sha256()
    for name in sorted(arrays, key=str.encode):
        array = arrays[name]
        digest.update(struct.pack("<Q", len(name.encode())) + name.encode())
        digest.update(struct.pack("<BQ", tags[array.dtype.name], array.ndim))
        digest.update(struct.pack(f"<{array.ndim}Q", *array.shape))
        digest.update(array.tobytes())
    return digest.hexdigest()


def test_python_finds_the_same_hashes_of_weights_and_state(checkpoint, inspected):
    files = [path for path in checkpoint.glob("*.safetensors") if path.name != "policy.safetensors"]
    arrays = {name: array for path in files for name, array in load_file(path).items()}
    weights = {name: array for name, array in arrays.items() if name.startswith("weights/")}
    assert weights
    assert sha256_of_arrays(weights) == inspected["weights_sha256"]
    state = {name: array for name, array in arrays.items() if not name.startswith("evaluation/")}
    assert sha256_of_arrays(state) == inspected["state_sha256"]


def test_the_policy_holds_every_agent_under_pytorch_s_names(checkpoint):
    policy = load_file(checkpoint / "policy.safetensors")
    for agent in range(6):
        assert policy[f"agent_{agent}.gru.weight_ih"].shape[0] % 3 == 0
        assert policy[f"agent_{agent}.head.weight"].shape[0] == 1


def test_all_arrays_are_finite_numbers(checkpoint):
    files = sorted(checkpoint.glob("*.safetensors"))
    assert files
    arrays = [array for file in files for array in load_file(file).values()]
    assert arrays
    assert all(np.isfinite(array).all() for array in arrays if array.dtype.kind == "f")
