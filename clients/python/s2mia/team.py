"""Client of the policies that `s2mia serve` serves: sends observations, receives actions."""

import queue
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from s2mia import wire
from s2mia.connection import Tls, open_channel
from s2mia.policy import Floats

CALL_SECS = 10.0


class Team:
    """One stream: one team in one world. The server keeps the agents' recurrent states."""

    def __init__(
        self,
        address: str,
        seed: int | None = None,
        *,
        tls: Tls | None = None,
        insecure_allow_remote: bool = False,
    ) -> None:
        """Actions are means or likeliest choices; with a `seed`, they are sampled.

        `address` is `HOST:PORT`, `http://HOST:PORT`, or with `tls` `https://HOST:PORT`.
        """
        self.channel = open_channel(address, tls, insecure_allow_remote=insecure_allow_remote)
        self.service = wire.PolicyServiceStub(self.channel)
        request = wire.DescribePolicyRequest()
        self.description = self.service.DescribePolicy(request, timeout=CALL_SECS, wait_for_ready=True)
        mean = wire.ActStart(mean=wire.MeanAction())
        start = mean if seed is None else wire.ActStart(sampled=wire.SampledAction(seed=seed))
        self.weights = self.description.weights
        self._requests: queue.SimpleQueue[Any] = queue.SimpleQueue()
        self._requests.put(wire.ActRequest(start=start))
        self._answers = self.service.Act(iter(self._requests.get, None))

    def act(self, observations: Mapping[int, ArrayLike], reset: bool = False) -> dict[int, Floats]:
        """Returns an action `[act]` for each observation `[obs]`, by agent index. `reset` starts an episode.

        Continuous actions are in units of half a range (-1 and 1 are the limits) and not clamped.
        """
        rows = [
            wire.AgentObservation(agent=agent, observation=wire.tensor(np.asarray(row, np.float32)))
            for agent, row in observations.items()
        ]
        self._requests.put(wire.ActRequest(step=wire.ActStep(reset=reset, observations=rows)))
        answer = next(self._answers)
        self.weights = answer.weights
        return {row.agent: wire.array(row.action) for row in answer.actions}

    def close(self) -> None:
        """Ends the stream."""
        self._requests.put(None)
        self.channel.close()
