"""The networks and distributions of a snapshot in NumPy, for an actor that shares no code with the program.

A snapshot is a safetensors file with the policies' specs in its metadata; arrays have PyTorch's names and layout.
Shapes: `R` rows, `obs`, `act` and `H` as in trajectory.proto; `out` outputs: means, means
and then `l` with log sigma = -5 + 3.5 (tanh(l) + 1), or logits.
"""

import json
import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from s2mia.shared_noise import Floats, SharedNoise

EPSILON = 1e-5
# Standardised features are clamped to this many standard deviations.
LIMIT = 10.0
# As `policy/src/tanh_gaussian.rs`: from this tanh(u) on, an action is at the edge of its range.
EDGE = 1 - 2.0**-20
_DISTRIBUTIONS = ("gaussian", "shared_gaussian", "categorical", "deterministic", "uniform", "tanh_gaussian")


def _sigmoid(x: Floats) -> Floats:
    # The branches avoid an overflow of exp.
    small = np.exp(-np.abs(x))
    return np.asarray(np.where(x >= 0, 1.0, small) / (1.0 + small), np.float32)


class Network:
    """One agent's policy."""

    def __init__(self, spec: dict[str, Any], arrays: dict[str, Floats]) -> None:
        """Raises `ValueError` for a network or a distribution that this module does not have."""
        self.spec, self.arrays = spec, arrays
        head = spec.get("head", "gaussian")
        self.distribution, parameters = (head, {}) if isinstance(head, str) else next(iter(head.items()))
        if spec["core"] not in ("gru", "mlp") or self.distribution not in _DISTRIBUTIONS:
            raise ValueError(f"core {spec['core']} with distribution {head} is unknown to this package")
        self.choices: int = parameters.get("choices", 0)
        """Number of choices; 0 if actions are continuous."""
        self._noise_sigma: float = parameters.get("noise_sigma", 0.0)
        self._range = (parameters["low"], parameters["high"]) if "low" in parameters else None
        self.hidden_size: int = spec["hidden"] if spec["core"] == "gru" else 0
        shared = parameters if self.distribution == "shared_gaussian" else parameters.get("noise")
        self.noise = shared and SharedNoise(shared, spec["action"], arrays.get("head.loading"))
        """Noise that all agents share; `None` if each has its own."""

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
                x = np.maximum(self._linear(f"layers.{layer}.linear", x), 0)
                if f"layers.{layer}.norm.weight" in self.arrays:
                    x = self._norm(f"layers.{layer}.norm", x)
        output = self._linear("head", x)
        if self._range and self.distribution != "tanh_gaussian":
            output = self._scaled(np.tanh(output))
        return output.astype(np.float32), hidden.astype(np.float32)

    def _half_and_middle(self) -> tuple[float, float]:
        """Half the width of the action range, and its middle."""
        assert self._range
        low, high = self._range
        return (high - low) / 2, (high + low) / 2

    def _scaled(self, squashed: NDArray[Any]) -> Floats:
        """Actions for numbers between -1 and 1."""
        half, middle = self._half_and_middle()
        return np.asarray(squashed * np.asarray(half, squashed.dtype) + np.asarray(middle, squashed.dtype), np.float32)

    def _squashed_gaussian(self, output: Floats) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Means and logarithms of standard deviations `[R, act]` before tanh, without a shared signal."""
        mean, deviation = np.split(output.astype(np.float64), 2, axis=-1)
        return mean, -5 + 3.5 * (np.tanh(deviation) + 1)

    def _own_squashed_gaussian(self, output: Floats) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """As `_squashed_gaussian`, given the shared signal."""
        mean, log_sigma = self._squashed_gaussian(output)
        return mean, log_sigma + (np.log(self.noise.own_part.astype(np.float64)) if self.noise else 0.0)

    def shifted(self, output: Floats, signal: Floats) -> Floats:
        """Outputs `[R, out]` given the signals `[R, K]` that all agents share, for `draw` and `log_prob`."""
        if not self.noise:
            return output
        if self.distribution == "tanh_gaussian":
            sigma = np.exp(self._squashed_gaussian(output)[1]).astype(np.float32)
        else:
            sigma = self._marginal_sigma()
        moved = output.copy()
        moved[:, : self.spec["action"]] += sigma * (signal @ self.noise.loadings.T)
        return moved

    def _marginal_sigma(self) -> Floats:
        return _sigmoid(self.arrays["head.log_std"]) * np.float32(self.spec["sigma_scale"])

    def sigma(self) -> Floats:
        """Standard deviations `[act]` of the noise of continuous actions that are not squashed, given the shared signal."""
        if self.distribution in ("gaussian", "shared_gaussian"):
            return self._marginal_sigma() * (self.noise.own_part if self.noise else np.float32(1))
        return np.full(self.spec["action"], self._noise_sigma, np.float32)

    def draw(self, output: Floats, rng: np.random.Generator) -> Floats:
        """Draws actions `[R, act]` from outputs `[R, out]`, those of `shifted` if agents share noise."""
        if self.choices:
            return self.mode(output + rng.gumbel(size=output.shape).astype(np.float32))
        if self._range and self.distribution == "uniform":
            return rng.uniform(*self._range, output.shape).astype(np.float32)
        if self.distribution == "tanh_gaussian":
            mean, log_sigma = self._own_squashed_gaussian(output)
            return self._scaled(np.tanh(mean + np.exp(log_sigma) * rng.standard_normal(mean.shape)))
        action = output + self.sigma() * rng.standard_normal(output.shape)
        if self._range:
            action = np.clip(action, *self._range)
        return action.astype(np.float32)

    def mode(self, output: Floats) -> Floats:
        """The mean action, or the likeliest choice, `[R, act]`. Evaluation uses it."""
        if self.choices:
            return np.asarray(np.argmax(output, -1)[:, None], np.float32)
        if self.distribution == "tanh_gaussian":
            return self._scaled(np.tanh(self._squashed_gaussian(output)[0]))
        return output

    def _squashed_log_prob(self, output: Floats, action: Floats) -> Floats:
        """An action at the edge of the range has the density of the `u` closest to the mean."""
        (mean, log_sigma), (half, middle) = self._own_squashed_gaussian(output), self._half_and_middle()
        value = (action.astype(np.float64) - middle) / half
        u = np.arctanh(np.clip(value, -EDGE, EDGE))
        u = np.where(value >= EDGE, np.maximum(u, mean), np.where(value <= -EDGE, np.minimum(u, mean), u))
        gaussian = -0.5 * ((u - mean) / np.exp(log_sigma)) ** 2 - log_sigma - 0.5 * math.log(2 * math.pi)
        slope = 2 * (math.log(2) - np.abs(u) - np.log1p(np.exp(-2 * np.abs(u))))
        return np.asarray((gaussian - math.log(half) - slope).sum(-1), np.float32)

    def log_prob(self, output: Floats, action: Floats) -> Floats:
        """Log-densities or log-probabilities `[R]` of actions `[R, act]`, nats."""
        if self.choices:
            shifted = output - output.max(-1, keepdims=True)
            log_probs = shifted - np.log(np.exp(shifted).sum(-1, keepdims=True))
            return np.asarray(np.take_along_axis(log_probs, action.astype(int), -1)[:, 0], np.float32)
        if self._range and self.distribution == "uniform":
            low, high = self._range
            return np.full(len(action), -action.shape[1] * math.log(high - low), np.float32)
        if self.distribution == "tanh_gaussian":
            return self._squashed_log_prob(output, action)
        sigma = self.sigma()
        deviation = (action - output) / sigma
        terms = -0.5 * deviation**2 - np.log(sigma) - 0.5 * math.log(2 * math.pi)
        return np.asarray(terms.sum(-1), np.float32)


def _decoded(snapshot: bytes) -> tuple[list[dict[str, Any]], list[dict[str, Floats]]]:
    """The agents' descriptions and arrays."""
    length = int.from_bytes(snapshot[:8], "little")
    header, body = json.loads(snapshot[8 : 8 + length]), snapshot[8 + length :]
    specs = json.loads(header.pop("__metadata__")["s2mia.policy"])
    own: list[dict[str, Floats]] = [{} for _ in specs]
    for name, entry in header.items():
        agent, array = name.removeprefix("agent_").split(".", 1)
        begin, end = entry["data_offsets"]
        own[int(agent)][array] = np.frombuffer(body[begin:end], "<f4").reshape(entry["shape"])
    return specs, own


class Policy:
    """All agents' policies of one version."""

    def __init__(self, snapshot: bytes) -> None:
        """Decodes a snapshot, such as `policy.safetensors` of a checkpoint. Raises `ValueError` as `Network`, and for other bytes."""
        try:
            specs, own = _decoded(snapshot)
        except (ValueError, KeyError, TypeError, IndexError, AttributeError) as error:
            text = "no policies, or damaged ones; policy.safetensors of a checkpoint has them"
            raise ValueError(f"{text} ({type(error).__name__}: {error})") from None
        self.agents = [Network(spec, arrays) for spec, arrays in zip(specs, own, strict=True)]

    def signal(self, seed: int, purpose: int, iteration: int, environments: Sequence[int], step: int) -> Floats:
        """The signals `[E, K]` that all agents share in a step, as `SharedNoise.signal`; `[E, 0]` if they share none."""
        noise = self.agents[0].noise if self.agents else None
        if not noise:
            return np.zeros((len(environments), 0), np.float32)
        return noise.signal(seed, purpose, iteration, environments, step)
