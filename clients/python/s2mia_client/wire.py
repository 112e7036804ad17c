"""The messages and services of the .proto files, compiled when this module is imported.

Generated code is not stored; the files in `proto/` are the only definition of the protocol.
"""

import importlib
import os
import pathlib
import sys
import tempfile

import grpc_tools
import numpy as np
from grpc_tools import protoc

_HERE = pathlib.Path(__file__).resolve()
PROTO = pathlib.Path(os.environ.get("S2MIA_PROTO", _HERE.parents[3] / "proto" / "proto"))
_FILES = ["tensor", "environment", "trajectory", "learner", "control", "policy", "environment_service"]
_SERVICES = ["learner", "control", "policy", "environment_service"]


def _compile() -> None:
    names = [f"s2mia/v1/{name}.proto" for name in _FILES]
    missing = [name for name in names if not (PROTO / name).is_file()]
    if missing:
        raise FileNotFoundError(f"{PROTO} does not contain {missing[0]}; set S2MIA_PROTO to the folder that does")
    generated = tempfile.TemporaryDirectory(prefix="s2mia-wire-")
    with generated as folder:
        own = str(pathlib.Path(grpc_tools.__file__).parent / "_proto")
        outputs = [f"--python_out={folder}", f"--grpc_python_out={folder}"]
        if protoc.main(["protoc", f"-I{PROTO}", f"-I{own}", *outputs, *names]) != 0:
            raise RuntimeError(f"the .proto files in {PROTO} cannot be compiled")
        sys.path.insert(0, folder)
        try:
            for name in _FILES:
                module = importlib.import_module(f"s2mia.v1.{name}_pb2")
                globals().update({key: value for key, value in vars(module).items() if key[0].isupper()})
            for name in _SERVICES:
                module = importlib.import_module(f"s2mia.v1.{name}_pb2_grpc")
                ours = ("Stub", "Servicer", "_to_server")
                globals().update({key: value for key, value in vars(module).items() if key.endswith(ours)})
        finally:
            sys.path.remove(folder)


_compile()


def tensor(array: np.ndarray):
    """Encodes an array as a tensor of 32-bit floats or booleans."""
    kind, layout = (DATA_TYPE_BOOL, "u1") if array.dtype == bool else (DATA_TYPE_F32, "<f4")  # noqa: F821
    data = np.ascontiguousarray(array, dtype=layout).tobytes()
    return Tensor(data_type=kind, shape=array.shape, data=data)  # noqa: F821


def array(tensor) -> np.ndarray:
    """Decodes a tensor of floats."""
    return np.frombuffer(tensor.data, "<f4").reshape(tensor.shape)
