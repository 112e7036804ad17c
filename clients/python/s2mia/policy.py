"""The agents' policies: a snapshot is a safetensors file with the policies' specs in its metadata.

Shapes: `R` rows, `obs`, `act` and `H` as in trajectory.proto; `out` outputs: means or logits. Arrays have PyTorch's
names and layout.
"""

import json
import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from s2mia.error import RunError

Floats = NDArray[np.float32]

SPEC_KEY = "s2mia.policy"
EPSILON = 1e-5
# Standardised features are clamped to this many standard deviations.
LIMIT = 10.0
# Distribution of specs without a head.
GAUSSIAN = "gaussian"
DISTRIBUTIONS = (GAUSSIAN, "categorical", "deterministic", "uniform")
CORES = ("gru", "mlp")
INPUT_NORMS = ("layer_norm", "none")
# Largest size of a layer, as in policy/src/acting.rs.
MAX_SIZE = 1 << 20
_SIZES = ("observation", "action")
_SIZES_OF_CORE = {"gru": ("encoder", "hidden"), "mlp": ("width", "layers")}
_KNOWN = {*_SIZES, *_SIZES_OF_CORE["gru"], *_SIZES_OF_CORE["mlp"]}
_KNOWN |= {"core", "input_norm", "chunk_steps", "sigma_scale", "head"}


def read_safetensors(data: bytes, source: str = "snapshot") -> tuple[dict[str, Floats], dict[str, str]]:
    """Arrays by name, and the file's metadata. `source` is the name of the file in errors."""
    length = int.from_bytes(data[:8], "little")
    body = data[8 + length :]
    arrays = {}
    name = "header"
    try:
        header = json.loads(data[8 : 8 + length])
        metadata = dict(header.pop("__metadata__", {}))
        for name, entry in header.items():
            begin, end = entry["data_offsets"]
            if entry["dtype"] != "F32" or not 0 <= begin <= end <= len(body):
                raise ValueError(f"type {entry['dtype']}, bytes {begin} to {end} of {len(body)}")
            arrays[name] = np.frombuffer(body[begin:end], "<f4").reshape(entry["shape"])
    except (ValueError, TypeError, KeyError, AttributeError) as error:
        raise RunError(f"{source} is no safetensors file of a policy: {name}: {error}") from None
    return arrays, metadata


def _sigmoid(x: Floats) -> Floats:
    # The branches avoid an overflow of exp.
    small = np.exp(-np.abs(x))
    return np.asarray(np.where(x >= 0, 1.0, small) / (1.0 + small), np.float32)


class Agent:
    """One agent's policy."""

    def __init__(self, spec: dict[str, Any], arrays: dict[str, Floats]) -> None:
        """Raises `KeyError` for an entry that `spec` lacks, and `ValueError` for a missing array or a wrong shape."""
        self.spec, self.arrays = spec, arrays
        head = spec.get("head", GAUSSIAN)
        kind, parameters = (head, {}) if isinstance(head, str) else next(iter(head.items()))
        self.distribution: str = kind
        """`gaussian`, `categorical`, `deterministic` or `uniform`."""
        self.choices: int = parameters.get("choices", 0)
        """Number of choices; 0 if actions are continuous."""
        self._noise_sigma: float = parameters.get("noise_sigma", 0.0)
        self._range: tuple[float, float] | None = None
        if "low" in parameters:
            self._range = parameters["low"], parameters["high"]
        self.observation_size: int = spec["observation"]
        self.action_size: int = spec["action"]
        self.hidden_size: int = spec["hidden"] if spec["core"] == "gru" else 0
        if self.distribution not in DISTRIBUTIONS or spec["core"] not in CORES:
            raise ValueError(f"core {spec['core']} with distribution {kind} is unknown to this package")
        self._demand_valid(parameters)
        shapes = self._shapes()
        if unused := sorted(arrays.keys() - shapes.keys()):
            raise ValueError(f"{unused[0]} is no array of the network")
        for name, shape in shapes.items():
            if name not in arrays:
                raise ValueError(f"{name} is missing")
            if arrays[name].shape != shape:
                raise ValueError(f"{name} has shape {arrays[name].shape}, expected {shape}")
            if not np.isfinite(arrays[name]).all():
                raise ValueError(f"{name} contains a number that is not finite")

    def _demand_valid(self, parameters: dict[str, Any]) -> None:
        """Refuses what the program refuses (policy/src/acting.rs, policy/src/head.rs)."""
        spec = self.spec
        if unknown := sorted(spec.keys() - _KNOWN):
            raise ValueError(f"the entry {unknown[0]} is unknown to this package")
        if spec.get("input_norm", "layer_norm") not in INPUT_NORMS:
            raise ValueError(f"input_norm {spec['input_norm']} is unknown to this package")
        for name in (*_SIZES, *_SIZES_OF_CORE[spec["core"]]):
            if type(spec[name]) is not int or not 1 <= spec[name] <= MAX_SIZE:
                raise ValueError(f"{name} is {spec[name]}, expected 1 to {MAX_SIZE}")
        scale = spec["sigma_scale"]
        valid = 0 < scale < math.inf
        if self.distribution == "categorical":
            valid &= self.action_size == 1 and type(self.choices) is int and self.choices > 0
        elif self.distribution != GAUSSIAN:
            valid &= self._range is not None and -math.inf < self._range[0] < self._range[1] < math.inf
            valid &= self.distribution == "uniform" or 0 < self._noise_sigma < math.inf
        if not valid:
            head = f"{self.distribution} {parameters} with sigma_scale {scale}"
            raise ValueError(f"the distribution {head} is invalid for {self.action_size} action values")

    def _shapes(self) -> dict[str, tuple[int, ...]]:
        """Shape of every array that the network needs."""
        spec, shapes = self.spec, {}
        observation, hidden = self.observation_size, self.hidden_size

        def linear(name: str, inputs: int, outputs: int) -> None:
            shapes.update({f"{name}.weight": (outputs, inputs), f"{name}.bias": (outputs,)})

        def norm(name: str, width: int) -> None:
            shapes.update({f"{name}.weight": (width,), f"{name}.bias": (width,)})

        if "input.mean" in self.arrays:
            shapes.update({"input.mean": (observation,), "input.inverse_deviation": (observation,)})
        if spec.get("input_norm", "layer_norm") == "layer_norm":
            norm("encoder.norm", observation)
        if spec["core"] == "gru":
            linear("encoder.linear", observation, spec["encoder"])
            for name, inputs in (("ih", spec["encoder"]), ("hh", hidden)):
                shapes.update({f"gru.weight_{name}": (3 * hidden, inputs), f"gru.bias_{name}": (3 * hidden,)})
            norm("output.norm", hidden)
        else:
            for layer in range(spec["layers"]):
                linear(f"layers.{layer}.linear", spec["width"] if layer else observation, spec["width"])
                norm(f"layers.{layer}.norm", spec["width"])
        linear("head", hidden or spec["width"], self.choices or self.action_size)
        if self.distribution == GAUSSIAN:
            shapes["head.log_std"] = (self.action_size,)
        return shapes

    def _linear(self, name: str, x: Floats) -> Floats:
        product: Floats = x @ self.arrays[f"{name}.weight"].T
        return product + self.arrays[f"{name}.bias"]

    def _norm(self, name: str, x: Floats) -> Floats:
        centred: Floats = x - x.mean(-1, keepdims=True)
        scale: Floats = np.sqrt((centred**2).mean(-1, keepdims=True) + np.float32(EPSILON))
        normal: Floats = centred / scale
        return normal * self.arrays[f"{name}.weight"] + self.arrays[f"{name}.bias"]

    def _gru(self, x: Floats, hidden: Floats) -> Floats:
        x = np.tanh(self._linear("encoder.linear", x))
        inputs = np.split(x @ self.arrays["gru.weight_ih"].T + self.arrays["gru.bias_ih"], 3, axis=-1)
        states = np.split(hidden @ self.arrays["gru.weight_hh"].T + self.arrays["gru.bias_hh"], 3, axis=-1)
        reset, update = (_sigmoid(inputs[gate] + states[gate]) for gate in (0, 1))
        new: Floats = np.tanh(inputs[2] + reset * states[2])
        return (1 - update) * new + update * hidden

    def forward(self, observation: Floats, hidden: Floats) -> tuple[Floats, Floats]:
        """Returns means or logits `[R, out]` and the next recurrent state `[R, H]` for observations `[R, obs]`."""
        x = observation.astype(np.float32)
        if "input.mean" in self.arrays:
            x = np.clip((x - self.arrays["input.mean"]) * self.arrays["input.inverse_deviation"], -LIMIT, LIMIT)
        if "encoder.norm.weight" in self.arrays:
            x = self._norm("encoder.norm", x)
        if self.spec["core"] == "gru":
            hidden = self._gru(x, hidden)
            x = self._norm("output.norm", hidden)
        else:
            for layer in range(self.spec["layers"]):
                x = self._norm(f"layers.{layer}.norm", np.maximum(self._linear(f"layers.{layer}.linear", x), 0))
        output = self._linear("head", x)
        if self._range:
            low, high = self._range
            output = np.tanh(output) * np.float32((high - low) / 2) + np.float32((high + low) / 2)
        return output.astype(np.float32), hidden.astype(np.float32)

    def sigma(self) -> Floats:
        """Standard deviations `[act]` of the noise of continuous actions."""
        if self.distribution == GAUSSIAN:
            return _sigmoid(self.arrays["head.log_std"]) * np.float32(self.spec["sigma_scale"])
        return np.full(self.action_size, self._noise_sigma, np.float32)

    def draw(self, output: Floats, rng: np.random.Generator) -> Floats:
        """Draws actions `[R, act]` from outputs `[R, out]`."""
        if self.choices:
            return self.mode(output + rng.gumbel(size=output.shape).astype(np.float32))
        if self._range and self.distribution == "uniform":
            return rng.uniform(*self._range, output.shape).astype(np.float32)
        action = output + self.sigma() * rng.standard_normal(output.shape)
        if self._range:
            action = np.clip(action, *self._range)
        return action.astype(np.float32)

    def mode(self, output: Floats) -> Floats:
        """The mean action, or the likeliest choice, `[R, act]`. Evaluation uses it."""
        if self.choices:
            return np.asarray(np.argmax(output, -1)[:, None], np.float32)
        return output

    def log_prob(self, output: Floats, action: Floats) -> Floats:
        """Log-densities or log-probabilities `[R]` of actions `[R, act]`, nats."""
        if self.choices:
            shifted = output - output.max(-1, keepdims=True)
            log_probs = shifted - np.log(np.exp(shifted).sum(-1, keepdims=True))
            return np.asarray(np.take_along_axis(log_probs, action.astype(int), -1)[:, 0], np.float32)
        if self._range and self.distribution == "uniform":
            low, high = self._range
            return np.full(len(action), -action.shape[1] * math.log(high - low), np.float32)
        sigma = self.sigma()
        deviation = (action - output) / sigma
        terms = -0.5 * deviation**2 - np.log(sigma) - 0.5 * math.log(2 * math.pi)
        return np.asarray(terms.sum(-1), np.float32)


class Policy:
    """All agents' policies of one version."""

    def __init__(self, snapshot: bytes, source: str = "snapshot") -> None:
        """Decodes a snapshot. Raises `RunError`, which names `source` and the array, if it is invalid."""
        arrays, metadata = read_safetensors(snapshot, source)
        self.agents: list[Agent] = []
        try:
            specs = json.loads(metadata[SPEC_KEY])
        except (KeyError, ValueError):
            specs = None
        if not isinstance(specs, list) or not specs:
            raise RunError(f"{source} is no policy: it has no valid metadata {SPEC_KEY}")
        prefixes = tuple(f"agent_{index}." for index in range(len(specs)))
        if others := [name for name in arrays if not name.startswith(prefixes)]:
            raise RunError(f"{source}: {others[0]} belongs to no agent")
        for index, (spec, prefix) in enumerate(zip(specs, prefixes, strict=True)):
            own = {name.removeprefix(prefix): array for name, array in arrays.items() if name.startswith(prefix)}
            try:
                self.agents.append(Agent(spec, own))
            except KeyError as error:
                raise RunError(f"{source}: {SPEC_KEY}: agent {index} has no {error}") from None
            except (AttributeError, TypeError, ValueError) as error:
                raise RunError(f"{source}: agent_{index}: {error}") from None
