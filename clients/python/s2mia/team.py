"""Client of the policies that `s2mia serve` serves: sends observations, receives actions."""

import queue
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from s2mia import wire
from s2mia.connection import Connection, Tls
from s2mia.policy import Floats


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

        `address` is `HOST:PORT`, `http://HOST:PORT`, or with `tls` `https://HOST:PORT`. Raises `ValueError` for an
        invalid address or certificate. Raises `ConnectionError`, as every call, if the server does not answer or
        refuses the call.
        """
        self._connection = Connection(
            address, wire.PolicyServiceStub, tls, insecure_allow_remote=insecure_allow_remote
        )
        self.channel, self.service = self._connection.channel, self._connection.service
        try:
            self.description = self._connection.first_call("DescribePolicy", wire.DescribePolicyRequest())
        except ConnectionError:
            self._connection.close()
            raise
        mean = wire.ActStart(mean=wire.MeanAction())
        start = mean if seed is None else wire.ActStart(sampled=wire.SampledAction(seed=seed))
        self.weights = self.description.weights
        self._requests: queue.SimpleQueue[Any] = queue.SimpleQueue()
        self._requests.put(wire.ActRequest(start=start))
        with self._connection.errors():
            self._answers = self.service.Act(iter(self._requests.get, None))

    def act(self, observations: Mapping[int, ArrayLike], reset: bool = False) -> dict[int, Floats]:
        """Returns an action `[act]` for each observation `[obs]`, by agent index. `reset` starts an episode.

        Continuous actions are in units of half a range (-1 and 1 are the limits) and not clamped.
        """
        rows = [
            wire.AgentObservation(agent=agent, observation=wire.tensor(np.asarray(row)))
            for agent, row in observations.items()
        ]
        with self._connection.errors():
            self._requests.put(wire.ActRequest(step=wire.ActStep(reset=reset, observations=rows)))
            answer = next(self._answers, None)
        if answer is None:
            raise ConnectionError(f"{self._connection.address}: the server ended the stream")
        self.weights = answer.weights
        return {row.agent: wire.array(row.action) for row in answer.actions}

    def close(self) -> None:
        """Ends the stream."""
        self._requests.put(None)
        self._connection.close()
