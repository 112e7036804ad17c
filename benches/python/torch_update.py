"""The learner's update in plain PyTorch compared with ours, in one run: the same shapes, passes, terms and threads.

HASAC's update is that of `tests/reference/hasac.py` in single precision.

    pip install torch==2.8.0
    python benches/python/torch_update.py [--rounds 3] [--cases halfcheetah-6x1 ...]

Needs Rust, too: it has `cargo bench -p s2mia -- SECTION --json` measure our side between its own rounds. Per round
and case both sides run once; medians are compared. Processor seconds are those of one thread and hold beside other
work; with two threads only wall time is valid, on a machine that does nothing else.
"""

import argparse
import json
import statistics
import subprocess
import sys
import time
from pathlib import Path
from types import SimpleNamespace

import torch
from torch import nn
from torch.nn.functional import huber_loss
from torch.nn.utils import clip_grad_norm_

sys.path.append(str(Path(__file__).parents[2] / "tests" / "reference"))
from hasac import Learner, NormalisedNetwork

STEPS, ENVIRONMENTS, HOLDOUT = 200, 20, 5
GAMMA, TRACE, CLIP, KAPPA, LAMBDA = 0.99, 0.95, 0.1, 1.0, 0.01


def layers(inputs, width, count):
    """LayerNorm, then `count` times Linear, ReLU, LayerNorm."""
    widths = [inputs] + [width] * count
    parts = [nn.LayerNorm(inputs)]
    for pair in zip(widths, widths[1:]):
        parts += [nn.Linear(*pair), nn.ReLU(), nn.LayerNorm(pair[1])]
    return nn.Sequential(*parts)


class Head(nn.Linear):
    """A Gaussian's mean and its own deviation."""

    def __init__(self, inputs, actions):
        super().__init__(inputs, actions)
        self.log_std = nn.Parameter(torch.zeros(actions))

    def forward(self, features):
        return super().forward(features), torch.sigmoid(self.log_std) * 0.5


class MlpActor(nn.Module):
    def __init__(self, shape):
        super().__init__()
        self.trunk = layers(shape["observation"], shape["width"], shape["layers"])
        self.head = Head(shape["width"], shape["action"])

    def features(self, observation, _hidden):
        return self.trunk(observation)


class GruActor(nn.Module):
    """Chunks are columns: `nn.GRU` runs all of them through time at once. None of them holds an episode's end."""

    def __init__(self, shape):
        super().__init__()
        encoder, hidden = shape["encoder"], shape["hidden"]
        self.encoder = nn.Sequential(
            nn.LayerNorm(shape["observation"]), nn.Linear(shape["observation"], encoder), nn.Tanh()
        )
        self.gru, self.norm = nn.GRU(encoder, hidden), nn.LayerNorm(hidden)
        self.head = Head(hidden, shape["action"])

    def features(self, observation, hidden):
        return self.norm(self.gru(self.encoder(observation), hidden)[0])


class Posterior(nn.Module):
    """`q(a^i | a^-i, features)`."""

    def __init__(self, shape, features):
        super().__init__()
        self.encoder = nn.Linear((shape["agents"] - 1) * shape["action"], 64)
        self.joined, self.head = nn.Linear(features + 64, 64), Head(64, shape["action"])

    def forward(self, features, others):
        joined = torch.cat([features, torch.tanh(self.encoder(others))], -1)
        return self.head(torch.tanh(self.joined(joined)))


def log_prob(mean, sigma, action):
    return (-0.5 * ((action - mean) / sigma).square() - sigma.log() - 0.9189385).sum(-1)


def divergence(q, p):
    """`KL[q || p]` over action dimensions."""
    (q_mean, q_sigma), (mean, sigma) = q, p
    gap = (q_sigma.square() + (q_mean - mean).square()) / (2 * sigma.square())
    return ((sigma / q_sigma).log() + gap - 0.5).sum(-1)


class Update:
    """Every network of a case and one iteration's made-up experience."""

    SECTION = "update"

    def __init__(self, shape):
        self.shape, recurrent = shape, shape["hidden"] > 0
        self.actors = [(GruActor if recurrent else MlpActor)(shape) for _ in range(shape["agents"])]
        width = shape["hidden"] if recurrent else shape["width"]
        self.posteriors = [Posterior(shape, width) for _ in self.actors]
        self.critic = nn.Sequential(layers(shape["state"], 128, 3), nn.Linear(128, shape["agents"]))
        networks = self.actors + self.posteriors + [self.critic]
        self.adam = {n: torch.optim.Adam(n.parameters(), lr=5e-4, eps=1e-5) for n in networks}
        # Chunks as columns, as the recurrent networks want them; for the others any order will do.
        length, columns = shape["chunk"], STEPS // shape["chunk"] * ENVIRONMENTS
        self.observation = [torch.randn(length, columns, shape["observation"]) for _ in self.actors]
        self.action = [0.3 * torch.randn(length, columns, shape["action"]) for _ in self.actors]
        self.hidden = [torch.randn(1, columns, shape["hidden"]) if recurrent else None for _ in self.actors]
        self.state = torch.randn(STEPS, ENVIRONMENTS, shape["state"])
        self.last_state = torch.randn(ENVIRONMENTS, shape["state"])
        self.reward = torch.randn(STEPS, ENVIRONMENTS)

    def step(self, network, loss):
        self.adam[network].zero_grad(set_to_none=True)
        loss.backward()
        clip_grad_norm_(network.parameters(), 10.0)
        self.adam[network].step()

    def run(self):
        rewards = [self.reward + 0.01 * self.surprise(agent) for agent in range(self.shape["agents"])]
        values, advantages, returns = self.advantages(rewards)
        features = [self.behaviour(agent) for agent in range(self.shape["agents"])]
        posteriors = [self.fit_posterior(agent, features[agent]) for agent in range(self.shape["agents"])]
        factor = torch.ones(self.action[0].shape[:2])
        for agent in torch.randperm(self.shape["agents"]).tolist():
            factor = self.climb(agent, self.chunked(advantages[..., agent]), factor, posteriors[agent])
        self.fit_critic(values, returns)

    def chunked(self, rows):
        """`[T, B]` as `[chunk, columns]`."""
        length = self.shape["chunk"]
        return rows.view(STEPS // length, length, ENVIRONMENTS).transpose(0, 1).reshape(length, -1)

    def surprise(self, agent):
        """Eq. (4) under a Gaussian fitted to the same rows."""
        seen = self.observation[agent].view(STEPS, ENVIRONMENTS, -1)
        mean, sigma = seen.mean((0, 1)), seen.std((0, 1)).clamp(min=0.01)
        return (-0.5 * ((seen - mean) / sigma).square() - sigma.log()).sum(-1)

    @torch.no_grad()
    def advantages(self, rewards):
        """Generalised advantages, normalised per agent, and returns, `[T, B, N]`."""
        values, last = self.critic(self.state), self.critic(self.last_state)
        following = torch.cat([values[1:], last.unsqueeze(0)])
        errors = torch.stack(rewards, -1) + GAMMA * following - values
        found, later = torch.empty_like(errors), torch.zeros_like(errors[0])
        for step in range(STEPS - 1, -1, -1):
            later = errors[step] + GAMMA * TRACE * later
            found[step] = later
        normalised = (found - found.mean((0, 1))) / (found.std((0, 1)) + 1e-5)
        return values, normalised, found + values

    def policy(self, agent, part=slice(None)):
        hidden = self.hidden[agent]
        hidden = None if hidden is None else hidden[:, part]
        return self.actors[agent].features(self.observation[agent][:, part], hidden)

    @torch.no_grad()
    def behaviour(self, agent):
        features = self.policy(agent)
        p = self.actors[agent].head(features)
        return features, log_prob(*p, self.action[agent])

    def fit_posterior(self, agent, known):
        """Maximum likelihood on four environments of five; then a constant."""
        features, posterior = known[0], self.posteriors[agent]
        others = torch.cat([a for other, a in enumerate(self.action) if other != agent], -1)
        columns = torch.arange(features.shape[1])
        trained = columns[columns % HOLDOUT != HOLDOUT - 1]
        seen, acts, own = features[:, trained], others[:, trained], self.action[agent][:, trained]
        for _ in range(self.shape["posterior epochs"]):
            self.step(posterior, -log_prob(*posterior(seen, acts), own).mean())
        with torch.no_grad():
            return known[1], posterior(features, others)

    def climb(self, agent, advantage, factor, known):
        """Epochs of Eq. (10); returns the factor M for the next agent."""
        old, (q_mean, q_sigma) = known
        cap, actor = KAPPA * self.shape["action"], self.actors[agent]
        columns, parts = advantage.shape[1], self.shape["minibatches"]
        for _ in range(self.shape["epochs"]):
            dealt = [slice(None)] if parts == 1 else torch.randperm(columns).split(columns // parts)
            for part in dealt:
                p = actor.head(self.policy(agent, part))
                ratio = (log_prob(*p, self.action[agent][:, part]) - old[:, part]).exp()
                better = advantage[:, part]
                kept = torch.minimum(ratio * better, ratio.clamp(1 - CLIP, 1 + CLIP) * better)
                influence = divergence((q_mean[:, part], q_sigma), p).clamp(max=cap).mean()
                self.step(actor, -(factor[:, part] * kept).mean() - LAMBDA * influence)
        with torch.no_grad():
            new = log_prob(*actor.head(self.policy(agent)), self.action[agent])
            return factor * (new - old).exp()

    def fit_critic(self, old, returns):
        target = (returns - returns.mean((0, 1))) / returns.std((0, 1))
        rows = lambda numbers: numbers.flatten(0, 1)
        state, old, target = rows(self.state), rows(old), rows(target)
        parts = self.shape["critic minibatches"]
        for _ in range(self.shape["critic epochs"]):
            whole = [slice(None)]
            for part in whole if parts == 1 else torch.randperm(len(state)).split(len(state) // parts):
                value, before, aim = self.critic(state[part]), old[part], target[part]
                held = before + (value - before).clamp(-CLIP, CLIP)
                free = huber_loss(value, aim, reduction="none", delta=10.0)
                clipped = huber_loss(held, aim, reduction="none", delta=10.0)
                self.step(self.critic, torch.maximum(free, clipped).mean())


class HasacUpdate:
    """As many optimiser steps as an iteration has, each with other rows of a replay."""

    SECTION = "off-policy"
    ROWS = 10_000
    SETTINGS = {
        "hasac.initial_temperature": 1.0,
        "hasac.first_moment": 0.5,
        "policy.sigma_floor": 1e-6,
        "update.adam_epsilon": 1e-8,
    } | {
        f"{section}.{name}": value
        for section in ("update", "critic")
        for name, value in [("learning_rate", 1e-3), ("max_gradient_norm", 1e9)]
    }
    POLICY_EVERY, NORM_MOMENTUM = 3, 0.01

    def __init__(self, shape):
        self.shape, agents = shape, range(shape["agents"])
        network = lambda inputs, outputs: NormalisedNetwork(inputs, outputs, shape, self.NORM_MOMENTUM)
        joint = shape["state"] + shape["agents"] * shape["action"]
        self.learner = Learner(
            {
                "settings": self.SETTINGS,
                "range": (-1.0, 1.0),
                "actors": [network(shape["observation"], 2 * shape["action"]) for _ in agents],
                "critics": [network(joint, 1) for _ in range(2)],
            }
        )
        for temperature in self.learner.temperatures:
            temperature.float()
        rows = lambda *size: torch.randn(self.ROWS, *size)
        self.replay = {name: rows(shape["state"]) for name in ("state", "next state")}
        self.replay |= {(name, agent): rows(shape["observation"]) for name in ("seen", "next seen") for agent in agents}
        self.replay |= {("action", agent): rows(shape["action"]).clamp(-1, 1) for agent in agents}
        self.replay["reward"] = rows()

    def sample(self):
        at = torch.randint(self.ROWS, (self.shape["replay batch"],))
        pick = {name: stored[at] for name, stored in self.replay.items()}
        every = lambda name: [pick[name, agent] for agent in range(self.shape["agents"])]
        ahead = SimpleNamespace(
            state=pick["next state"], observation=every("next seen"), reward=pick["reward"], discount=GAMMA
        )
        return {"state": pick["state"], "observation": every("seen"), "action": every("action"), "ahead": ahead}

    def run(self):
        draws = [SimpleNamespace(normals=torch.randn)] * self.shape["agents"]
        for step in range(self.shape["optimiser steps"]):
            sample = self.sample()
            self.learner.fit_critics(sample, draws)
            if step % self.POLICY_EVERY == 0:
                self.learner.improve_policies(sample, torch.randperm(self.shape["agents"]).tolist(), draws)


def measured(update, threads):
    """Wall and processor seconds of one update."""
    torch.set_num_threads(threads)
    wall, processor = time.perf_counter(), time.process_time()
    update.run()
    return time.perf_counter() - wall, time.process_time() - processor


def ours(sections):
    command = ["cargo", "bench", "--quiet", "-p", "s2mia", "--", *sections, "--json", "--quick"]
    return json.loads(subprocess.run(command, check=True, capture_output=True, text=True).stdout)


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--cases", nargs="*", default=[], help="beginnings of the cases' names")
    arguments = parser.parse_args()
    torch.manual_seed(0)
    shapes = ours(["shapes"])["shapes"]
    shapes = {case: {k: int(v) for k, v in shape.items()} for case, shape in shapes.items()}
    wanted = lambda case: not arguments.cases or case.startswith(tuple(arguments.cases))
    made = lambda shape: HasacUpdate(shape) if shape["replay batch"] else Update(shape)
    updates = {case: made(shape) for case, shape in shapes.items() if wanted(case) and not case.endswith("maddpg")}
    times = {case: {key: [] for key in ("ours 1", "torch 1", "ours 2", "torch 2")} for case in updates}
    for update in updates.values():
        update.run()
    for _ in range(arguments.rounds):
        figures = {}
        for section in sorted({update.SECTION for update in updates.values()}):
            figures |= ours([section])[section]
        for case, update in updates.items():
            times[case]["ours 1"].append(figures[case]["1 thread, processor s"])
            times[case]["ours 2"].append(figures[case]["2 threads, s"])
            times[case]["torch 1"].append(measured(update, 1)[1])
            times[case]["torch 2"].append(measured(update, 2)[0])
    print(f"PyTorch {torch.__version__}, medians of {arguments.rounds} rounds\n")
    heads = ["case", "ours, 1 thread, processor s", "PyTorch", "ratio", "ours, 2 threads, s", "PyTorch", "ratio"]
    print(f"| {' | '.join(heads)} |\n|{' --- |' * len(heads)}")
    for case, found in times.items():
        one, torch_one, two, torch_two = (
            statistics.median(found[key]) for key in ("ours 1", "torch 1", "ours 2", "torch 2")
        )
        cells = [f"{x:.3f}" for x in (one, torch_one, one / torch_one, two, torch_two, two / torch_two)]
        print(f"| {case} | {' | '.join(cells)} |")


if __name__ == "__main__":
    main()
