"""Two optimiser steps of HASAC's critics, the first with one of every policy and temperature."""

import copy
import math

import torch
import torch.nn.functional as F
from torch import nn

from equations import Optimiser
from off_policy import Outlook
from random_draws import AGENT_ORDER, REPLAY, UPDATE_ACTION, Draws


class NormalisedNetwork(nn.Module):
    """Batch norm, Linear, ReLU for each layer, then a batch norm and a Linear."""

    def __init__(self, inputs, outputs, sizes, momentum):
        super().__init__()
        widths = [inputs] + [sizes["width"]] * sizes["layers"]
        layer = lambda pair: nn.ModuleDict({"norm": nn.BatchNorm1d(pair[0], momentum=momentum), "linear": nn.Linear(*pair)})
        self.layers = nn.ModuleList([layer(pair) for pair in zip(widths, widths[1:] + [outputs])])

    def forward(self, x):
        for layer in self.layers[:-1]:
            x = torch.relu(layer["linear"](layer["norm"](x)))
        return self.layers[-1]["linear"](self.layers[-1]["norm"](x))

    def statistics(self, owner):
        """Running statistics by the names under which a run keeps them."""
        arrays = {}
        for index, layer in enumerate(self.layers):
            arrays[f"normalizer/{owner}.layers.{index}.mean"] = layer["norm"].running_mean
            arrays[f"normalizer/{owner}.layers.{index}.variance"] = layer["norm"].running_var
        return arrays


class Temperature(nn.Module):
    """The weight of a policy's entropy, by its logarithm."""

    def __init__(self, settings):
        super().__init__()
        start = torch.tensor([math.log(settings["hasac.initial_temperature"])], dtype=torch.float64)
        self.log = nn.Parameter(start.float().double())


class Learner:
    """Networks and their optimisers."""

    def __init__(self, case):
        self.case, self.settings = case, case["settings"]
        self.actors, self.critics = map(copy.deepcopy, (case["actors"], case["critics"]))
        self.temperatures = [Temperature(self.settings) for _ in self.actors]
        first = {"betas": (self.settings["hasac.first_moment"], 0.999)}
        optimiser = lambda network, section: Optimiser(
            network, self.settings, section, f"{section}.max_gradient_norm", **first
        )
        self.critic_optimisers = [optimiser(critic, "critic") for critic in self.critics]
        self.optimisers = [optimiser(actor, "update") for actor in self.actors]
        plain = lambda own: Optimiser(own, self.settings, "update", "update.max_gradient_norm")
        self.temperature_optimisers = [plain(own) for own in self.temperatures]
        for network in self.actors + self.critics:
            network.eval()

    def act(self, agent, seen, draws):
        """Actions in the environment's units, and log-probabilities of what tanh gives."""
        mean, l = self.actors[agent](seen).chunk(2, -1)
        log_sigma = -5 + 3.5 * (torch.tanh(l) + 1)
        noise = draws.normals(*mean.shape)
        u = mean + log_sigma.exp() * noise
        slope = 2 * (math.log(2) - u - F.softplus(-2 * u))
        log_prob = (-0.5 * noise**2 - log_sigma - 0.5 * math.log(2 * math.pi) - slope).sum(-1)
        low, high = self.case["range"]
        return (high + low) / 2 + (high - low) / 2 * torch.tanh(u), log_prob

    def fit_critics(self, sample, draws):
        """One pass over both halves of the batch."""
        with torch.no_grad():
            drawn = [self.act(agent, seen, draws[agent]) for agent, seen in enumerate(sample["ahead"].observation)]
            bonus = sum(own.log.exp() * log_prob for own, (_, log_prob) in zip(self.temperatures, drawn))
        now = torch.cat([sample["state"], *sample["action"]], -1)
        following = torch.cat([sample["ahead"].state] + [action for action, _ in drawn], -1)
        both, count = torch.cat([now, following]), len(now)
        for critic in self.critics:
            critic.train()
        values = [critic(both).squeeze(-1) for critic in self.critics]
        least = torch.minimum(*values).detach()[count:]
        target = sample["ahead"].reward + sample["ahead"].discount * (least - bonus)
        losses = [((value[:count] - target) ** 2).mean() for value in values]
        norms = [own.step(loss) for own, loss in zip(self.critic_optimisers, losses)]
        for critic in self.critics:
            critic.eval()
        return torch.stack(losses).mean().detach(), torch.stack(norms).mean()

    def improve_policies(self, sample, order, draws):
        """Every agent in turn; gives its figures."""
        with torch.no_grad():
            current = [self.act(agent, seen, draws[agent])[0] for agent, seen in enumerate(sample["observation"])]
        figures = {}
        for agent in order:
            seen, temperature = sample["observation"][agent], self.temperatures[agent].log.exp().detach()
            self.actors[agent].train()
            current[agent], log_prob = self.act(agent, seen, draws[agent])
            self.actors[agent].eval()
            joint = torch.cat([sample["state"], *current], -1)
            value = torch.cat([critic(joint) for critic in self.critics], -1).min(-1)[0].mean()
            loss = temperature * log_prob.mean() - value
            norm = self.optimisers[agent].step(loss)
            entropy = -log_prob.detach().mean()
            own = self.temperatures[agent]
            self.temperature_optimisers[agent].step((own.log.exp() * (entropy + current[agent].shape[-1])).sum())
            with torch.no_grad():
                current[agent] = self.act(agent, seen, draws[agent])[0]
            named = {"policy_loss": loss, "action_value": value, "entropy": entropy, "gradient_norm": norm}
            named["temperature"] = own.log.exp()
            figures |= {f"report/agent{agent}/{name}": number.detach().reshape(1) for name, number in named.items()}
        return figures

    def arrays(self):
        """Weights, statistics and moments."""
        arrays = {"optimizer/steps": torch.tensor([2])}
        for kind, networks, optimisers in [
            ("q", self.critics, self.critic_optimisers),
            ("agent", self.actors, self.optimisers),
            ("temperature", self.temperatures, self.temperature_optimisers),
        ]:
            for index, (network, optimiser) in enumerate(zip(networks, optimisers)):
                arrays |= optimiser.arrays(f"{kind}_{index}")
                if kind != "temperature":
                    arrays |= network.statistics(f"{kind}_{index}")
        return arrays


def sampled(case, step):
    """The transitions of one optimiser step."""
    batch, draws = case["batch"], Draws(case["seed"], REPLAY, step=step)
    count = batch["terminated"].numel()
    rows = torch.tensor([draws.below(count) for _ in range(int(case["settings"]["hasac.batch"]))])
    pick = lambda data: data.flatten(0, 1)[rows]
    named = {name: [pick(own) for own in batch[name]] for name in ("observation", "action")}
    return named | {"state": pick(batch["state"]), "ahead": Outlook(batch, rows, case["settings"])}


def hasac(case):
    """Gives all weights, statistics, moments and figures after both steps."""
    learner, losses, norms, agents = Learner(case), [], [], range(len(case["actors"]))
    for step in range(2):
        sample = sampled(case, step)
        draws = [Draws(case["seed"], UPDATE_ACTION, agent=agent, step=step) for agent in agents]
        loss, norm = learner.fit_critics(sample, draws)
        losses.append(loss)
        norms.append(norm)
        if step == 0:
            order = Draws(case["seed"], AGENT_ORDER, step=step).permutation(len(agents))
            figures = learner.improve_policies(sample, order, draws)
    figures["report/losses/value_loss"] = torch.stack(losses).mean().reshape(1)
    figures["report/losses/value_gradient_norm"] = torch.stack(norms).mean().reshape(1)
    return learner.arrays() | figures
