"""The equations of the reference updates: losses, advantages, normalisers, one optimiser step."""

import torch
from torch.distributions import Categorical, kl_divergence
from torch.nn.functional import huber_loss
from torch.nn.utils import clip_grad_norm_

from networks import SIGMA_SCALE


def actor_loss(p, q, taken, settings):
    """What an agent descends: minus the weighted clipped surrogate, the capped influence and the entropy."""
    log_ratio = p.log_prob(taken["action"]) - taken["log_prob_old"]
    ratio, clip = log_ratio.exp(), settings["update.clip"]
    clipped = ratio.clamp(1 - clip, 1 + clip) * taken["advantage"]
    surrogate = (taken["factor"] * torch.minimum(ratio * taken["advantage"], clipped)).mean()
    divergence, cap = kl_divergence(q, p), settings["influence.kappa"] * cap_dimensions(p)
    influence = divergence.clamp(max=cap).mean()
    bonus = settings["influence.lambda"] * influence + settings["update.entropy"] * p.entropy().mean()
    figures = {
        "policy_loss": -surrogate,
        "approx_kl": (ratio - 1 - log_ratio).mean(),
        "clip_fraction": ((ratio - 1).abs() > clip).double().mean(),
        "influence_kl": influence,
        "influence_capped": (divergence >= cap).double().mean(),
    }
    return -surrogate - bonus, {name: figure.detach() for name, figure in figures.items()}


def cap_dimensions(p):
    return 1 if isinstance(p, Categorical) else p.event_shape[0]


def value_loss(value, old, target, settings):
    """The larger of the free and the clipped Huber loss, element by element."""
    delta, clip = settings["critic.huber_delta"], settings["critic.clip"]
    huber = lambda found: huber_loss(found, target, reduction="none", delta=delta)
    return torch.maximum(huber(value), huber(old + (value - old).clamp(-clip, clip)))


def next_values(batch, values, final_values):
    """Value of every row's true next state, `[T, B]`: nothing after a termination, the final state's after a
    truncation and at the end."""
    shifted = torch.cat([values[1:], torch.zeros_like(values[:1])])
    stops = batch["truncated"].clone()
    stops[-1] = True
    return torch.where(stops, final_values, shifted).masked_fill(batch["terminated"], 0.0)


def advantages(batch, reward, values, following, settings):
    """Generalised advantage estimation, `[T, B]`."""
    gamma, trace = settings["update.gamma"], settings["update.gae_lambda"]
    done = batch["terminated"] | batch["truncated"]
    found, later = torch.zeros_like(reward), torch.zeros_like(reward[0])
    for step in reversed(range(len(reward))):
        error = reward[step] + gamma * following[step] - values[step]
        later = error + gamma * trace * torch.where(done[step], torch.zeros_like(later), later)
        found[step] = later
    return found


def normalised(advantage):
    return (advantage - advantage.mean()) / (advantage.std(correction=0) + 1e-5)


class ValueNormaliser:
    """Exponential averages of returns and their squares, `state = [mean, square, weight]`."""

    def __init__(self, state, beta):
        self.state, self.beta = state, beta

    def update(self, returns):
        new = torch.stack([returns.mean(), (returns**2).mean(), torch.ones((), dtype=torch.float64)])
        self.state = self.beta * self.state + (1 - self.beta) * new

    def moments(self):
        mean, square, weight = self.state
        mean, square = mean / weight.clamp(min=1e-5), square / weight.clamp(min=1e-5)
        return mean, (square - mean**2).clamp(min=1e-2).sqrt()

    def normalise(self, values):
        mean, deviation = self.moments()
        return (values - mean) / deviation

    def denormalise(self, values):
        mean, deviation = self.moments()
        return values * deviation + mean


class Optimiser:
    """Adam after clipping by global norm; then deviations are held at their floor."""

    def __init__(self, network, settings, section, most, betas=(0.9, 0.999)):
        self.network, self.most = network, settings[most]
        self.least_share = settings["policy.sigma_floor"] / SIGMA_SCALE
        rate = settings[f"{section}.learning_rate"]
        epsilon = settings["update.adam_epsilon"]
        self.adam = torch.optim.Adam(network.parameters(), lr=rate, eps=epsilon, betas=betas)

    def step(self, loss):
        """Gives the gradient's norm before clipping."""
        self.adam.zero_grad()
        loss.backward(inputs=list(self.network.parameters()))
        norm = clip_grad_norm_(self.network.parameters(), self.most)
        self.adam.step()
        self.hold_deviations()
        return norm.detach()

    def hold_deviations(self):
        lowest = torch.logit(torch.tensor(self.least_share, dtype=torch.float64)).item()
        for name, parameter in self.network.named_parameters():
            if name.endswith("log_std"):
                parameter.data.clamp_(min=lowest)

    def arrays(self, owner):
        """Weights and moments by the names under which a run keeps them."""
        arrays = {}
        for name, parameter in self.network.named_parameters():
            state = self.adam.state[parameter]
            arrays[f"weights/{owner}.{name}"] = parameter.detach()
            arrays[f"optimizer/{owner}.m.{name}"] = state["exp_avg"]
            arrays[f"optimizer/{owner}.v.{name}"] = state["exp_avg_sq"]
            arrays[f"optimizer/{owner}.steps"] = torch.tensor([int(state["step"])])
        return arrays
