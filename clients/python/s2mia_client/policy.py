"""The agents' policies: a snapshot is a safetensors file with the policies' specs in its metadata.

Shapes: `R` rows, `obs`, `act` and `H` as in trajectory.proto. Arrays have PyTorch's names and layout.
"""

import json
import math

import numpy as np

SPEC_KEY = "s2mia.policy"
EPSILON = 1e-5
# Standardised features are clamped to this many standard deviations.
LIMIT = 10.0
# Distribution of specs without a head.
GAUSSIAN = "gaussian"


def read_safetensors(data: bytes) -> tuple[dict[str, np.ndarray], dict[str, str]]:
    """Arrays by name, and the file's metadata."""
    length = int.from_bytes(data[:8], "little")
    header = json.loads(data[8 : 8 + length])
    metadata = header.pop("__metadata__", {})
    body = data[8 + length :]
    arrays = {}
    for name, entry in header.items():
        begin, end = entry["data_offsets"]
        arrays[name] = np.frombuffer(body[begin:end], "<f4").reshape(entry["shape"])
    return arrays, metadata


def _sigmoid(x: np.ndarray) -> np.ndarray:
    return 1.0 / (1.0 + np.exp(-x))


class Agent:
    """One agent's policy."""

    def __init__(self, spec: dict, arrays: dict[str, np.ndarray]) -> None:
        self.spec, self.arrays = spec, arrays
        self.head = spec.get("head", GAUSSIAN)
        self.hidden_size = spec["hidden"] if spec["core"] == "gru" else 0

    def _linear(self, name: str, x: np.ndarray) -> np.ndarray:
        return x @ self.arrays[f"{name}.weight"].T + self.arrays[f"{name}.bias"]

    def _norm(self, name: str, x: np.ndarray) -> np.ndarray:
        centred = x - x.mean(-1, keepdims=True)
        scale = np.sqrt((centred**2).mean(-1, keepdims=True) + np.float32(EPSILON))
        return centred / scale * self.arrays[f"{name}.weight"] + self.arrays[f"{name}.bias"]

    def _gru(self, x: np.ndarray, hidden: np.ndarray) -> np.ndarray:
        x = np.tanh(self._linear("encoder.linear", x))
        inputs = np.split(x @ self.arrays["gru.weight_ih"].T + self.arrays["gru.bias_ih"], 3, axis=-1)
        states = np.split(hidden @ self.arrays["gru.weight_hh"].T + self.arrays["gru.bias_hh"], 3, axis=-1)
        reset, update = (_sigmoid(inputs[gate] + states[gate]) for gate in (0, 1))
        new = np.tanh(inputs[2] + reset * states[2])
        return (1 - update) * new + update * hidden

    def forward(self, observation: np.ndarray, hidden: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
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
        if low_high := self._range():
            low, high = low_high
            output = np.tanh(output) * (high - low) / 2 + (high + low) / 2
        return output.astype(np.float32), hidden.astype(np.float32)

    def _range(self) -> tuple[float, float] | None:
        """The range to which the network's output is scaled, if any."""
        if isinstance(self.head, dict):
            (kind,) = self.head.values()
            if "low" in kind:
                return kind["low"], kind["high"]
        return None

    def _sigma(self) -> np.ndarray:
        """Standard deviations of the action noise `[act]`."""
        if self.head == GAUSSIAN:
            return _sigmoid(self.arrays["head.log_std"]) * np.float32(self.spec["sigma_scale"])
        return np.full(self.spec["action"], self.head["deterministic"]["noise_sigma"], np.float32)

    def draw(self, output: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        """Draws actions `[R, act]` from outputs `[R, out]`."""
        if "categorical" in self.head:
            gumbel = -np.log(-np.log(rng.random(output.shape)))
            return np.argmax(output + gumbel, -1)[:, None].astype(np.float32)
        if "uniform" in self.head:
            return rng.uniform(*self._range(), output.shape).astype(np.float32)
        action = output + self._sigma() * rng.standard_normal(output.shape)
        if low_high := self._range():
            action = np.clip(action, *low_high)
        return action.astype(np.float32)

    def mode(self, output: np.ndarray) -> np.ndarray:
        """The mean action, or the likeliest choice, `[R, act]`. Evaluation uses it."""
        if "categorical" in self.head:
            return np.argmax(output, -1)[:, None].astype(np.float32)
        return output

    def log_prob(self, output: np.ndarray, action: np.ndarray) -> np.ndarray:
        """Log-densities or log-probabilities `[R]` of actions `[R, act]`, nats."""
        if "categorical" in self.head:
            shifted = output - output.max(-1, keepdims=True)
            log_probs = shifted - np.log(np.exp(shifted).sum(-1, keepdims=True))
            return np.take_along_axis(log_probs, action.astype(int), -1)[:, 0]
        if "uniform" in self.head:
            low, high = self._range()
            return np.full(len(action), -action.shape[1] * math.log(high - low), np.float32)
        sigma = self._sigma()
        deviation = (action - output) / sigma
        return (-0.5 * deviation**2 - np.log(sigma) - 0.5 * math.log(2 * math.pi)).sum(-1)


class Policy:
    """All agents' policies of one version."""

    def __init__(self, snapshot: bytes) -> None:
        arrays, metadata = read_safetensors(snapshot)
        self.agents = []
        for index, spec in enumerate(json.loads(metadata[SPEC_KEY])):
            prefix = f"agent_{index}."
            own = {name.removeprefix(prefix): array for name, array in arrays.items() if name.startswith(prefix)}
            self.agents.append(Agent(spec, own))
