"""Client of the policies that `s2mia serve` serves: sends observations, receives actions."""

import queue

import grpc
import numpy as np

from s2mia_client import wire

CALL_SECS = 10.0


class Team:
    """One stream: one team in one world. The server keeps the agents' recurrent states."""

    def __init__(self, address: str, seed: int | None = None) -> None:
        """Actions are means or likeliest choices; with a `seed`, they are sampled."""
        self.channel = grpc.insecure_channel(address)
        self.service = wire.PolicyServiceStub(self.channel)
        request = wire.DescribePolicyRequest()
        self.description = self.service.DescribePolicy(request, timeout=CALL_SECS, wait_for_ready=True)
        mean = wire.ActStart(mean=wire.MeanAction())
        start = mean if seed is None else wire.ActStart(sampled=wire.SampledAction(seed=seed))
        self.weights = self.description.weights
        self._requests = queue.SimpleQueue()
        self._requests.put(wire.ActRequest(start=start))
        self._answers = self.service.Act(iter(self._requests.get, None))

    def act(self, observations: dict[int, np.ndarray], reset: bool = False) -> dict[int, np.ndarray]:
        """Returns an action `[act]` for each observation `[obs]`, by agent index. `reset` starts an episode."""
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
