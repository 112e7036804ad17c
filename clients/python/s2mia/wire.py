"""The messages and services of the .proto files, compiled when this module is imported.

Generated code is not stored; the .proto files are the only definition of the protocol. `proto` is a link to them in
the repository, and a folder with them in an installed package.
"""

import importlib
import pathlib
import sys
import tempfile
from typing import Any

import grpc_tools
import numpy as np
import s2mia
from grpc_tools import protoc
from numpy.typing import NDArray

PROTO = pathlib.Path(__file__).parent / "proto"
_FILES = ["tensor", "environment", "trajectory", "learner", "control", "policy", "environment_service"]
_SERVICES = ["learner", "control", "policy", "environment_service"]


def __getattr__(name: str) -> Any:
    # For type checkers, which do not know the generated names.
    raise AttributeError(f"the .proto files define no {name}")


def _compile() -> None:
    names = [f"s2mia/v1/{name}.proto" for name in _FILES]
    with tempfile.TemporaryDirectory(prefix="s2mia-wire-") as folder:
        own = str(pathlib.Path(grpc_tools.__file__).parent / "_proto")
        outputs = [f"--python_out={folder}", f"--grpc_python_out={folder}"]
        if protoc.main(["protoc", f"-I{PROTO}", f"-I{own}", *outputs, *names]) != 0:
            raise RuntimeError(f"the .proto files in {PROTO} cannot be compiled")
        # The generated modules have the package of the .proto files, s2mia.v1.
        place = str(pathlib.Path(folder, "s2mia"))
        s2mia.__path__.append(place)
        try:
            for name in _FILES:
                module = importlib.import_module(f"s2mia.v1.{name}_pb2")
                globals().update({key: value for key, value in vars(module).items() if key[0].isupper()})
            for name in _SERVICES:
                module = importlib.import_module(f"s2mia.v1.{name}_pb2_grpc")
                ours = ("Stub", "Servicer", "_to_server")
                globals().update({key: value for key, value in vars(module).items() if key.endswith(ours)})
        finally:
            s2mia.__path__.remove(place)


_compile()


def tensor(array: NDArray[Any]) -> Any:
    """Encodes an array as a tensor of 32-bit floats or booleans."""
    this = sys.modules[__name__]
    kind, layout = (this.DATA_TYPE_BOOL, "u1") if array.dtype == bool else (this.DATA_TYPE_F32, "<f4")
    own = array if array.dtype == np.float32 or array.dtype == bool else floats(array)
    data = np.ascontiguousarray(own, dtype=layout).tobytes()
    return this.Tensor(data_type=kind, shape=array.shape, data=data)


def floats(array: NDArray[Any]) -> NDArray[np.float32]:
    """The numbers as 32-bit floats. Raises `ValueError` if one is too large, or if they are no real numbers."""
    if array.dtype.kind not in "biuf":
        raise ValueError(f"{array.dtype} is no type of real numbers")
    with np.errstate(over="ignore"):
        own = array.astype(np.float32)
    lost = np.isfinite(array) & ~np.isfinite(own)
    if lost.any():
        raise ValueError(f"{array[lost].flat[0]} is too large for a 32-bit float")
    return own


def array(tensor: Any) -> NDArray[np.float32]:
    """Decodes a tensor of floats. Raises `ValueError` if its type or its size is another."""
    if tensor.data_type != sys.modules[__name__].DATA_TYPE_F32:
        raise ValueError(f"a tensor has the data type {tensor.data_type}, expected 32-bit floats")
    return np.frombuffer(tensor.data, "<f4").reshape(tensor.shape).copy()
