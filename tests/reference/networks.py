"""The networks of the reference updates, out of PyTorch's modules, their parameters named as in the arrays of a run."""

import torch
from torch import nn
from torch.distributions import Independent, Normal

SIGMA_SCALE = 0.5


class GaussianHead(nn.Linear):
    """A linear mean and one deviation for each action, `sigmoid(log_std) * SIGMA_SCALE`."""

    def __init__(self, inputs, actions):
        super().__init__(inputs, actions)
        self.log_std = nn.Parameter(torch.zeros(actions))

    def distribution(self, features):
        return gaussian(self(features), torch.sigmoid(self.log_std) * SIGMA_SCALE)


def gaussian(mean, sigma):
    """A Gaussian over whole actions with independent dimensions."""
    return Independent(Normal(mean, sigma.expand_as(mean)), 1)


class RecurrentActor(nn.Module):
    """LayerNorm, Linear, tanh, GRU, LayerNorm, head."""

    def __init__(self, observations, actions, sizes):
        super().__init__()
        encoder = {"norm": nn.LayerNorm(observations), "linear": nn.Linear(observations, sizes["encoder"])}
        self.encoder = nn.ModuleDict(encoder)
        self.gru = nn.GRUCell(sizes["encoder"], sizes["hidden"])
        self.output = nn.ModuleDict({"norm": nn.LayerNorm(sizes["hidden"])})
        self.head = GaussianHead(sizes["hidden"], actions)

    def features(self, observation, hidden, done):
        """`[T, B, F]`: each chunk goes through time from its stored state, forgetting at episodes' ends inside it."""
        chunk = observation.shape[0] // hidden.shape[0]
        features = []
        for step, seen in enumerate(torch.tanh(self.encoder["linear"](self.encoder["norm"](observation)))):
            if step % chunk == 0:
                state = hidden[step // chunk]
            else:
                state = torch.where(done[step - 1].unsqueeze(1), torch.zeros_like(state), state)
            state = self.gru(seen, state)
            features.append(self.output["norm"](state))
        return torch.stack(features)


class FeedForwardActor(nn.Module):
    """LayerNorm, then layers of Linear, ReLU, LayerNorm, then the head; a plain linear one where it is squashed."""

    def __init__(self, observations, actions, sizes, head=GaussianHead):
        super().__init__()
        self.encoder = nn.ModuleDict({"norm": nn.LayerNorm(observations)})
        self.layers = normalised_layers(observations, sizes)
        self.head = head(sizes["width"], actions)

    def features(self, observation, _hidden=None, _done=None):
        return through(self.layers, self.encoder["norm"](observation))


class Critic(nn.Module):
    """One normalised value for each agent from the global state."""

    def __init__(self, states, agents, sizes):
        super().__init__()
        self.norm = nn.LayerNorm(states)
        self.layers = normalised_layers(states, sizes)
        self.value = nn.Linear(sizes["width"], agents)

    def forward(self, state):
        return self.value(through(self.layers, self.norm(state)))

    def before(self, batch, _done):
        """Values of all states and of all final states."""
        return self(batch["state"]), self(batch["final_state"])


class RecurrentCritic(Critic):
    """The same with a GRU and a LayerNorm before the values. States that start a sequence are in single precision."""

    def __init__(self, states, agents, sizes, chunk):
        super().__init__(states, agents, sizes)
        self.gru = nn.GRUCell(sizes["width"], sizes["width"])
        self.gru_norm = nn.LayerNorm(sizes["width"])
        self.chunk = chunk

    def step(self, seen, state):
        """The next state and its values."""
        state = self.gru(through(self.layers, self.norm(seen)), state)
        return state, self.value(self.gru_norm(state))

    def before(self, batch, done):
        """One pass over all steps from `carried`, which is then what the next pass starts from."""
        self.done, self.starts, state, values, finals = done, [], self.carried, [], []
        for step, seen in enumerate(batch["state"]):
            if step % self.chunk == 0:
                self.starts.append(single(state))
            state, value = self.step(seen, state)
            values.append(value)
            finals.append(self.step(batch["final_state"][step], single(state))[1])
            state = self.forget(state, step)
        self.carried = single(state)
        return torch.stack(values), torch.stack(finals)

    def forward(self, state):
        """Chunk by chunk from the states that the weights before the update reached."""
        values = []
        for step, seen in enumerate(state):
            if step % self.chunk == 0:
                hidden = self.starts[step // self.chunk]
            hidden, value = self.step(seen, hidden)
            values.append(value)
            hidden = self.forget(hidden, step)
        return torch.stack(values)

    def forget(self, state, step):
        return torch.where(self.done[step].unsqueeze(1), torch.zeros_like(state), state)


def single(state):
    return state.float().double()


class Posterior(nn.Module):
    """`q(a^i | a^-i, features)`: the policy, its mean shifted and its deviation times `2 sigmoid(sigma_correction)`."""

    def __init__(self, others, features, actions, sizes):
        super().__init__()
        self.encoder = nn.Linear(others, sizes["encoder"])
        self.joined = nn.Linear(features + sizes["encoder"], sizes["hidden"])
        self.head = nn.Linear(sizes["hidden"], actions)
        self.sigma_correction = nn.Parameter(torch.zeros(actions))

    def distribution(self, features, others, policy):
        joined = torch.cat([features, torch.tanh(self.encoder(others))], -1)
        shift = self.head(torch.tanh(self.joined(joined)))
        return gaussian(policy[0] + shift, policy[1] * 2 * torch.sigmoid(self.sigma_correction))


class ActionValue(nn.Module):
    """What a joint action is worth in a global state."""

    def __init__(self, inputs, sizes):
        super().__init__()
        widths = [inputs] + [sizes["width"]] * sizes["layers"]
        layers = [nn.ModuleDict({"linear": nn.Linear(*pair)}) for pair in zip(widths, widths[1:])]
        self.layers = nn.ModuleList(layers)
        self.value = nn.Linear(sizes["width"], 1)

    def forward(self, state, actions):
        x = torch.cat([state, *actions], -1)
        for layer in self.layers:
            x = torch.relu(layer["linear"](x))
        return self.value(x).squeeze(-1)


def normalised_layers(inputs, sizes):
    widths = [inputs] + [sizes["width"]] * sizes["layers"]
    layer = lambda pair: nn.ModuleDict({"linear": nn.Linear(*pair), "norm": nn.LayerNorm(pair[1])})
    return nn.ModuleList([layer(pair) for pair in zip(widths, widths[1:])])


def through(layers, x):
    for layer in layers:
        x = layer["norm"](torch.relu(layer["linear"](x)))
    return x


def start(network, generator):
    """Draws every parameter afresh: none at zero, all of them numbers that single precision can hold."""
    for name, parameter in network.named_parameters():
        draw = torch.randn(parameter.shape, generator=generator, dtype=torch.float64)
        if name.endswith("log_std"):
            # The second deviation starts a hair above its floor, an eighth of the scale.
            value = torch.tensor([0.3, -1.9458, 0.1], dtype=torch.float64)[: len(parameter)]
        elif "norm" in name and name.endswith("weight"):
            value = 1.0 + 0.1 * draw
        elif name.endswith("weight") or "weight_" in name:
            value = (0.3 if name.startswith("head") else 1.0) * draw / parameter.shape[-1] ** 0.5
        else:
            value = 0.1 * draw
        parameter.data.copy_(value.float().double())
    return network
