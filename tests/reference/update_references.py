"""Writes marl/tests/references/*.safetensors: what PyTorch makes of the same losses and the same whole updates.

    python -m venv venv && venv/bin/pip install torch==2.8.0 safetensors numpy
    venv/bin/python tests/reference/update_references.py

Everything is computed in double precision. Inputs and first weights are numbers that single precision can hold, so
that both precisions can start from them. Names: `settings/`, `batch/`, `start/` (arrays of a run before), `expected/`
(arrays of a run after, and figures that it reports).
"""

import pathlib

import torch
from safetensors.torch import save_file
from torch.distributions import Categorical

from equations import ValueNormaliser, actor_loss, advantages, next_values, normalised, value_loss
from hasac import NormalisedNetwork, hasac
from networks import ActionValue, Critic, FeedForwardActor, Posterior, RecurrentActor, RecurrentCritic, gaussian, start
from off_policy import maddpg
from on_policy import happo, mappo

FOLDER = pathlib.Path(__file__).parents[2] / "marl" / "tests" / "references"
STEPS, ENVIRONMENTS, CHUNK, STATES = 10, 5, 5, 6
# Ends of episodes, (step, environment): inside chunks, at a chunk's end and at the very end.
TERMINATED, TRUNCATED = [(2, 0), (6, 3), (9, 1), (1, 4)], [(4, 1), (7, 2), (2, 3)]
SIZES = {"encoder": 5, "hidden": 6, "width": 7, "layers": 2}
SETTINGS = {
    "policy.sigma_floor": 0.0625,
    "update.gamma": 0.9,
    "update.gae_lambda": 0.8,
    "update.learning_rate": 5e-3,
    "update.adam_epsilon": 1e-5,
    "update.clip": 0.1,
    "update.epochs": 2,
    "update.entropy": 0.02,
    "update.max_gradient_norm": 0.3,
    "critic.learning_rate": 1e-2,
    "critic.epochs": 2,
    "critic.clip": 0.02,
    "critic.huber_delta": 0.8,
    "critic.normalizer_beta": 0.9,
    "critic.max_gradient_norm": 0.5,
    "influence.lambda": 0.3,
    "influence.kappa": 1.0,
    "influence.epochs": 2,
    "influence.learning_rate": 1e-2,
    "influence.holdout_every": 5,
    "maddpg.n_step": 3,
    "maddpg.polyak": 0.05,
    "hasac.batch": 16,
    "hasac.norm_momentum": 0.1,
    "hasac.initial_temperature": 0.5,
    "hasac.first_moment": 0.5,
}
# The rows that the replay draws, and the order that the sweep draws, with the seeds that the tests name.
SAMPLED = [46, 4, 6, 27, 3, 13, 16, 34, 14, 27, 42, 15, 31, 16, 19, 3]
ORDER = [1, 0]


class Drawing:
    """Numbers that single precision can hold, from one seed."""

    def __init__(self, seed):
        self.generator = torch.Generator().manual_seed(seed)

    def normal(self, *shape, scale=1.0):
        draw = torch.randn(shape, generator=self.generator, dtype=torch.float64)
        return (scale * draw).float().double()

    def network(self, network):
        return start(network, self.generator)


def batch_of(draw, observations, actions, hidden):
    """An iteration's experience. Final states stand at all rows and are true at the ends of episodes."""
    rows, chunks = (STEPS, ENVIRONMENTS), (STEPS // CHUNK, ENVIRONMENTS)
    ends = {"terminated": torch.zeros(rows, dtype=torch.bool), "truncated": torch.zeros(rows, dtype=torch.bool)}
    for name, places in [("terminated", TERMINATED), ("truncated", TRUNCATED)]:
        for place in places:
            ends[name][place] = True
    return ends | {
        "state": draw.normal(*rows, STATES),
        "final_state": draw.normal(*rows, STATES),
        "rewards": [draw.normal(*rows) for _ in actions],
        "observation": [draw.normal(*rows, size) for size in observations],
        "final_observation": [draw.normal(*rows, size) for size in observations],
        "action": [draw.normal(*rows, size, scale=0.4) for size in actions],
        "hidden": [draw.normal(*chunks, hidden, scale=0.5) for _ in actions],
    }


def on_policy_case(seed, core, observations, actions, owners):
    """Networks and a batch for agents of these sizes; `owners` of them have a network of their own."""
    draw, recurrent = Drawing(seed), core is RecurrentActor
    features = SIZES["hidden"] if recurrent else SIZES["width"]
    actors = [draw.network(core(*pair, SIZES)) for pair in list(zip(observations, actions))[:owners]]
    batch = batch_of(draw, observations, actions, SIZES["hidden"] if recurrent else 0)
    batch["action"] = [act(draw, batch, actors[agent % owners], agent) for agent in range(2)]
    return {
        "settings": SETTINGS,
        "order": torch.tensor(ORDER),
        "batch": batch,
        "actors": actors,
        "posteriors": [draw.network(Posterior(sum(actions) - own, features, own, SIZES)) for own in actions],
        "critic": draw.network(Critic(STATES, len(actions), SIZES)),
        "normalizers": [torch.tensor([0.1 + agent, 0.9 + 3 * agent, 0.7], dtype=torch.float64) for agent in range(2)],
    }


def act(draw, batch, actor, agent):
    """Actions of an agent that acts with `actor`, as if its recurrent states were its own."""
    with torch.no_grad():
        done = batch["terminated"] | batch["truncated"]
        p = actor.head.distribution(actor.features(batch["observation"][agent], batch["hidden"][agent], done))
        return (p.mean + p.stddev * draw.normal(*p.mean.shape)).float().double()


def with_memory(case, seed):
    """The case with a recurrent critic in the middle of all episodes."""
    draw = Drawing(seed)
    critic = draw.network(RecurrentCritic(STATES, len(case["normalizers"]), SIZES, CHUNK))
    critic.carried = draw.normal(ENVIRONMENTS, SIZES["width"], scale=0.5)
    return case | {"critic": critic}


def on_policy_start(case):
    owners = [f"agent_{i}" for i in range(2)] if len(case["actors"]) > 1 else ["shared"]
    named = list(zip(owners, case["actors"])) + [("critic", case["critic"])]
    named += [(f"posterior_{agent}", network) for agent, network in enumerate(case["posteriors"])]
    arrays = weights(named)
    if isinstance(case["critic"], RecurrentCritic):
        arrays["memory/critic.hidden"] = case["critic"].carried
    return arrays | {f"normalizer/value_{agent}": state for agent, state in enumerate(case["normalizers"])}


def maddpg_case(seed):
    draw, observations, actions = Drawing(seed), [4, 3], [2, 1]
    actor = lambda pair: draw.network(FeedForwardActor(*pair, SIZES, torch.nn.Linear))
    value = lambda _: draw.network(ActionValue(STATES + sum(actions), SIZES))
    pairs = list(zip(observations, actions))
    return {
        "settings": SETTINGS,
        "sampled": torch.tensor(SAMPLED),
        "range": torch.tensor([-1.0, 2.0], dtype=torch.float64),
        "batch": batch_of(draw, observations, actions, 0),
        "actors": list(map(actor, pairs)),
        "values": list(map(value, pairs)),
        "target_actors": list(map(actor, pairs)),
        "target_values": list(map(value, pairs)),
    }


def maddpg_start(case):
    kinds = [("agent", "actors"), ("q", "values"), ("target_agent", "target_actors"), ("target_q", "target_values")]
    return weights([(f"{name}_{i}", own) for name, kind in kinds for i, own in enumerate(case[kind])])


def hasac_case(seed):
    draw, observations, actions = Drawing(seed), [4, 3], [2, 1]
    momentum = SETTINGS["hasac.norm_momentum"]
    network = lambda inputs, outputs: draw.network(NormalisedNetwork(inputs, outputs, SIZES, momentum))
    return {
        "settings": SETTINGS,
        "seed": 1,
        "range": torch.tensor([-1.0, 2.0], dtype=torch.float64),
        "batch": batch_of(draw, observations, actions, 0),
        "actors": [network(seen, 2 * own) for seen, own in zip(observations, actions)],
        "critics": [network(STATES + sum(actions), 1) for _ in range(2)],
    }


def hasac_start(case):
    kinds = [("agent", "actors"), ("q", "critics")]
    return weights([(f"{name}_{i}", own) for name, kind in kinds for i, own in enumerate(case[kind])])


def weights(named):
    parameters = [(owner, network.named_parameters()) for owner, network in named]
    return {f"weights/{owner}.{name}": value.detach() for owner, own in parameters for name, value in own}


def gradients(loss, **inputs):
    found = torch.autograd.grad(loss, list(inputs.values()))
    return {f"expected/d_{name}": gradient for name, gradient in zip(inputs, found)}


def gaussian_loss_case():
    """The actor's loss of a Gaussian: ratios inside and outside the trust region, divergences below and above the
    cap. With it the posterior's negative mean log-likelihood of the same actions."""
    draw, rows = Drawing(11), 12
    mean, sigma = draw.normal(rows, 2, scale=0.3).requires_grad_(), torch.tensor([0.3, 0.45], dtype=torch.float64)
    q_mean, q_sigma = draw.normal(rows, 2, scale=0.3), torch.tensor([0.25, 0.4], dtype=torch.float64)
    taken = {"action": draw.normal(rows, 2, scale=0.4), "advantage": draw.normal(rows)}
    taken["factor"] = draw.normal(rows, scale=0.3).exp()
    sigma.requires_grad_()
    p = gaussian(mean, sigma)
    taken["log_prob_old"] = (p.log_prob(taken["action"]) + draw.normal(rows, scale=0.2)).detach()
    loss, figures = actor_loss(p, gaussian(q_mean, q_sigma), taken, SETTINGS)
    q_inputs = {"q_mean": q_mean.clone().requires_grad_(), "q_sigma": q_sigma.clone().requires_grad_()}
    likelihood = gaussian(*q_inputs.values()).log_prob(taken["action"]).mean()
    inputs = taken | {"mean": mean, "sigma": sigma, "q_mean": q_mean, "q_sigma": q_sigma}
    expected = figures | {"loss": loss, "posterior_loss": -likelihood}
    slopes = gradients(loss, mean=mean, sigma=sigma) | gradients(-likelihood, **q_inputs)
    return named("input", inputs) | named("expected", expected) | slopes


def categorical_loss_case():
    """The actor's loss of choices."""
    draw, rows, choices = Drawing(12), 12, 4
    logits, q_logits = draw.normal(rows, choices).requires_grad_(), draw.normal(rows, choices)
    taken = {"action": torch.arange(rows).double() % choices, "advantage": draw.normal(rows)}
    taken["factor"] = draw.normal(rows, scale=0.3).exp()
    p = Categorical(logits=logits)
    taken["log_prob_old"] = (p.log_prob(taken["action"]) + draw.normal(rows, scale=0.2)).detach()
    loss, figures = actor_loss(p, Categorical(logits=q_logits), taken, SETTINGS)
    inputs = taken | {"logits": logits, "q_logits": q_logits}
    return named("input", inputs) | named("expected", figures | {"loss": loss}) | gradients(loss, logits=logits)


def value_case():
    """The critic's loss element by element; advantages, returns and the normaliser around it."""
    draw = Drawing(13)
    rows = (STEPS, ENVIRONMENTS)
    value, old, target = draw.normal(*rows).requires_grad_(), draw.normal(*rows), draw.normal(*rows)
    with torch.no_grad():
        value.copy_(old + 0.03 * draw.normal(*rows))
    loss = value_loss(value, old, target, SETTINGS)
    batch = batch_of(draw, [1], [1], 0)
    values, final = draw.normal(*rows), draw.normal(*rows)
    following = next_values(batch, values, final)
    advantage = advantages(batch, batch["rewards"][0], values, following, SETTINGS)
    normaliser = ValueNormaliser(torch.tensor([0.3, 1.7, 0.8], dtype=torch.float64), 0.9)
    normaliser.update(advantage + values)
    ends = {name: batch[name] for name in ("terminated", "truncated")}
    inputs = {"value": value, "old": old, "target": target, "reward": batch["rewards"][0]}
    inputs |= {"values": values, "final_values": final} | ends
    expected = {"value_loss": loss, "next": following, "advantage": advantage, "normalised": normalised(advantage)}
    expected |= {"normaliser": normaliser.state, "target": normaliser.normalise(advantage + values)}
    return named("input", inputs) | named("expected", expected) | gradients(loss.sum(), value=value)


def named(prefix, arrays):
    return {f"{prefix}/{name}": array for name, array in arrays.items()}


def update_arrays(case, first, expected):
    """A whole update's file."""
    arrays = {f"start/{name}": value for name, value in first.items()}
    for name, value in case["batch"].items():
        each = enumerate(value) if isinstance(value, list) else [(None, value)]
        arrays |= {f"batch/{name}" + ("" if i is None else f"_{i}"): own for i, own in each}
    return arrays | named("expected", expected)


def write(name, arrays):
    scalars = {f"settings/{key}": torch.tensor([float(value)]) for key, value in SETTINGS.items()}
    number = lambda array: array.to(torch.uint8) if array.dtype == torch.bool else array
    arrays = {key: number(array.detach()).clone().contiguous() for key, array in (arrays | scalars).items()}
    # One entry: several would be in another order each time.
    save_file(arrays, FOLDER / f"{name}.safetensors", metadata={"torch": torch.__version__.split("+")[0]})


def main():
    torch.set_default_dtype(torch.float64)
    torch.set_num_threads(1)
    FOLDER.mkdir(exist_ok=True)
    write("gaussian_loss", gaussian_loss_case())
    write("categorical_loss", categorical_loss_case())
    write("values", value_case())
    for name, rule, arguments in [
        ("happo_gru", happo, (1, RecurrentActor, [4, 3], [2, 1], 2)),
        ("happo_mlp", happo, (2, FeedForwardActor, [4, 3], [2, 1], 2)),
        ("mappo_shared", mappo, (3, RecurrentActor, [4, 4], [2, 2], 1)),
    ]:
        case = on_policy_case(*arguments)
        write(name, update_arrays(case, on_policy_start(case), rule(case)))
    case = with_memory(on_policy_case(5, RecurrentActor, [4, 3], [2, 1], 2), 6)
    write("happo_gru_critic", update_arrays(case, on_policy_start(case), happo(case)))
    case = maddpg_case(4)
    write("maddpg", update_arrays(case, maddpg_start(case), maddpg(case)))
    case = hasac_case(7)
    write("hasac", update_arrays(case, hasac_start(case), hasac(case)))


main()
