"""One optimiser step of MADDPG: n-step targets, central action values, actors, slow copies."""

import copy

import torch

from equations import Optimiser


class Outlook:
    """What lies ahead of the sampled rows: rewards, the discount of what follows, and where that is."""

    def __init__(self, batch, rows, settings):
        ahead = [self.look(batch, row, settings) for row in rows.tolist()]
        reward, discount, seen = zip(*ahead)
        self.reward, self.discount = (torch.tensor(x, dtype=torch.float64) for x in (reward, discount))
        self.state = torch.stack([state for state, _ in seen])
        self.observation = [torch.stack(own) for own in zip(*[observation for _, observation in seen])]

    @staticmethod
    def look(batch, row, settings):
        steps, environments = batch["terminated"].shape
        step, environment = divmod(row, environments)
        reward, discount = 0.0, 1.0
        for _ in range(int(settings["maddpg.n_step"])):
            reward += discount * batch["rewards"][0][step, environment].item()
            discount *= settings["update.gamma"]
            at, after = (step, environment), [own[step, environment] for own in batch["final_observation"]]
            if batch["terminated"][at]:
                discount = 0.0
            if batch["terminated"][at] or batch["truncated"][at] or step + 1 == steps:
                return reward, discount, (batch["final_state"][at], after)
            step += 1
        at = (step, environment)
        return reward, discount, (batch["state"][at], [own[at] for own in batch["observation"]])


def maddpg(case):
    """Gives all weights, moments and figures after the step."""
    settings, batch = case["settings"], case["batch"]
    actors, values, slow_actors, slow_values = map(
        copy.deepcopy, (case["actors"], case["values"], case["target_actors"], case["target_values"])
    )
    pick = lambda data: data.flatten(0, 1)[case["sampled"]]
    state, seen, taken = pick(batch["state"]), map(pick, batch["observation"]), list(map(pick, batch["action"]))
    ahead = Outlook(batch, case["sampled"], settings)
    low, high = case["range"]
    act = lambda actor, seen: (high - low) / 2 * torch.tanh(actor.head(actor.features(seen))) + (high + low) / 2
    with torch.no_grad():
        following = [act(actor, seen) for actor, seen in zip(slow_actors, ahead.observation)]
    expected, losses = {}, []
    for agent, own in enumerate(seen):
        with torch.no_grad():
            target = ahead.reward + ahead.discount * slow_values[agent](ahead.state, following)
        loss = ((values[agent](state, taken) - target) ** 2).mean()
        value_optimiser = Optimiser(values[agent], settings, "critic", "critic.max_gradient_norm")
        value_optimiser.step(loss)
        losses.append(loss.detach())
        joint = taken[:agent] + [act(actors[agent], own)] + taken[agent + 1 :]
        climbed = -values[agent](state, joint).mean()
        actor_optimiser = Optimiser(actors[agent], settings, "update", "update.max_gradient_norm")
        norm = actor_optimiser.step(climbed)
        expected |= value_optimiser.arrays(f"q_{agent}") | actor_optimiser.arrays(f"agent_{agent}")
        expected[f"report/agent{agent}/policy_loss"] = climbed.detach().reshape(1)
        expected[f"report/agent{agent}/gradient_norm"] = norm.reshape(1)
        for name, slow, fast in [("agent", slow_actors, actors), ("q", slow_values, values)]:
            expected |= follow(f"weights/target_{name}_{agent}.", slow[agent], fast[agent], settings)
    expected["report/losses/value_loss"] = torch.stack(losses).mean().reshape(1)
    return expected


def follow(prefix, slow, fast, settings):
    """The slow copy goes a share of the way."""
    pairs = zip(slow.named_parameters(), fast.parameters())
    return {prefix + name: torch.lerp(own, new, settings["maddpg.polyak"]).detach() for (name, own), new in pairs}
