"""One update of HAPPO or MAPPO with the paper's influence term: values, posteriors, actors, critic."""

import copy

import torch

from equations import Optimiser, ValueNormaliser, actor_loss, advantages, next_values, normalised, value_loss
from networks import RecurrentCritic


class Update:
    """All networks, and what one iteration's batch makes of them. Figures and arrays are in `expected`."""

    def __init__(self, case):
        self.settings, self.batch = case["settings"], case["batch"]
        self.actors, self.posteriors, self.critic = map(
            copy.deepcopy, (case["actors"], case["posteriors"], case["critic"])
        )
        beta = self.settings["critic.normalizer_beta"]
        self.normalisers = [ValueNormaliser(state.clone(), beta) for state in case["normalizers"]]
        self.expected = {}
        self.done = self.batch["terminated"] | self.batch["truncated"]
        self.agents = range(len(self.batch["rewards"]))
        self.value()
        self.experience = [self.remember(agent) for agent in self.agents]
        self.conditionals = [self.fit_posterior(agent) for agent in self.agents]

    def actor(self, agent):
        return self.actors[agent if len(self.actors) > 1 else 0]

    def value(self):
        """Advantages and returns under the critic as it is."""
        with torch.no_grad():
            self.old, final = self.critic.before(self.batch, self.done)
        self.advantages, self.returns, shares = [], [], []
        for agent, normaliser in enumerate(self.normalisers):
            now = normaliser.denormalise(self.old[..., agent])
            following = next_values(self.batch, now, normaliser.denormalise(final[..., agent]))
            found = advantages(self.batch, self.batch["rewards"][agent], now, following, self.settings)
            self.advantages.append(normalised(found))
            self.returns.append(found + now)
            shares.append(1 - found.var(correction=0) / self.returns[-1].var(correction=0))
        self.report("losses/explained_variance", torch.stack(shares).mean())

    def features(self, agent):
        observation, hidden = self.batch["observation"][agent], self.batch["hidden"][agent]
        return self.actor(agent).features(observation, hidden, self.done)

    def policy(self, agent):
        return self.actor(agent).head.distribution(self.features(agent))

    def log_prob(self, agent):
        with torch.no_grad():
            return self.policy(agent).log_prob(self.batch["action"][agent])

    def remember(self, agent):
        """What the behaviour weights make of an agent's experience."""
        with torch.no_grad():
            features = self.features(agent)
            policy = self.actor(agent).head.distribution(features)
        others = [action for other, action in enumerate(self.batch["action"]) if other != agent]
        return {
            "features": features,
            "others": torch.cat(others, -1),
            "policy": (policy.mean, policy.stddev),
            "log_prob_old": self.log_prob(agent),
        }

    def fit_posterior(self, agent):
        """Maximum likelihood on all environments but the held-out ones, until those gain nothing; then a constant."""
        known, action, settings = self.experience[agent], self.batch["action"][agent], self.settings
        every = int(settings["influence.holdout_every"])
        held_out = torch.arange(action.shape[1]) % every == every - 1
        posterior = self.posteriors[agent]
        rows = lambda part: (known["features"][:, part], known["others"][:, part], [x[:, part] for x in known["policy"]])
        ask = lambda part: posterior.distribution(*rows(part))
        likelihood_of = lambda part: ask(part).log_prob(action[:, part]).mean()
        floor = 0.5 * settings["policy.sigma_floor"] / known["policy"][1][0, 0]
        optimiser = Optimiser(self.posteriors[agent], settings, "influence", "update.max_gradient_norm")
        likelihood, reached = likelihood_of(~held_out), likelihood_of(held_out)
        for _ in range(int(settings["influence.epochs"])):
            before = copy.deepcopy(posterior.state_dict())
            trained = likelihood_of(~held_out)
            optimiser.step(-trained)
            posterior.sigma_correction.data.clamp_(min=torch.logit(floor.clamp(max=0.5)))
            if likelihood_of(held_out) <= reached:
                posterior.load_state_dict(before)
                break
            likelihood, reached = trained, likelihood_of(held_out)
        self.expected |= optimiser.arrays(f"posterior_{agent}")
        with torch.no_grad():
            gain = ask(held_out).log_prob(action[:, held_out]) - known["log_prob_old"][:, held_out]
            self.report(f"agent{agent}/posterior_log_likelihood", likelihood.detach())
            self.report(f"agent{agent}/mi_estimate", gain.mean())
            return ask(slice(None))

    def loss(self, agent, factor):
        taken = {
            "action": self.batch["action"][agent],
            "log_prob_old": self.experience[agent]["log_prob_old"],
            "advantage": self.advantages[agent],
            "factor": factor,
        }
        return actor_loss(self.policy(agent), self.conditionals[agent], taken, self.settings)

    def climb(self, agents, factor):
        """Epochs of these agents' common steps, on all rows at once."""
        owner = f"agent_{agents[0]}" if len(self.actors) > 1 else "shared"
        optimiser = Optimiser(self.actor(agents[0]), self.settings, "update", "update.max_gradient_norm")
        epochs = int(self.settings["update.epochs"])
        for _ in range(epochs):
            losses, figures = zip(*[self.loss(agent, factor) for agent in agents])
            norm = optimiser.step(torch.stack(losses).mean())
            for agent, own in zip(agents, figures):
                for name, figure in (own | {"gradient_norm": norm}).items():
                    self.report(f"agent{agent}/{name}", figure / epochs)
        self.expected |= optimiser.arrays(owner)

    def fit_critic(self):
        """The normalisers take in the returns, then the critic learns them in their units."""
        for normaliser, returns in zip(self.normalisers, self.returns):
            normaliser.update(returns)
        target = torch.stack([n.normalise(r) for n, r in zip(self.normalisers, self.returns)], -1)
        optimiser = Optimiser(self.critic, self.settings, "critic", "critic.max_gradient_norm")
        epochs = int(self.settings["critic.epochs"])
        for _ in range(epochs):
            loss = value_loss(self.critic(self.batch["state"]), self.old, target, self.settings).mean()
            norm = optimiser.step(loss)
            self.report("losses/value_loss", loss.detach() / epochs)
            self.report("losses/value_gradient_norm", norm / epochs)
        self.expected |= optimiser.arrays("critic")
        for agent, normaliser in enumerate(self.normalisers):
            self.expected[f"normalizer/value_{agent}"] = normaliser.state
        if isinstance(self.critic, RecurrentCritic):
            self.expected["memory/critic.hidden"] = self.critic.carried

    def report(self, name, figure):
        """Adds up: a figure of several steps comes in shares."""
        self.expected[f"report/{name}"] = self.expected.get(f"report/{name}", 0) + figure.reshape(1)


def happo(case):
    """The agents climb one after the other, each weighed with what the ones before it did."""
    update = Update(case)
    factor = torch.ones_like(update.advantages[0])
    for position, agent in enumerate(case["order"].tolist()):
        update.report(f"agent{agent}/sweep_position", torch.tensor(float(position), dtype=torch.float64))
        update.report(f"agent{agent}/factor_mean", factor.mean())
        update.report(f"agent{agent}/factor_largest", factor.max())
        update.climb([agent], factor)
        factor = factor * (update.log_prob(agent) - update.experience[agent]["log_prob_old"]).exp()
    update.fit_critic()
    return update.expected


def mappo(case):
    """The agents share one network, which follows the mean of their gradients."""
    update = Update(case)
    update.climb(list(update.agents), torch.ones_like(update.advantages[0]))
    update.fit_critic()
    return update.expected
