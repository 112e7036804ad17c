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
    data = np.ascontiguousarray(array, dtype=layout).tobytes()
    return this.Tensor(data_type=kind, shape=array.shape, data=data)


def array(tensor: Any) -> NDArray[np.float32]:
    """Decodes a tensor of floats."""
    return np.frombuffer(tensor.data, "<f4").reshape(tensor.shape)
