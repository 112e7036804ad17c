"""Client of the policies that `s2mia serve` serves: sends observations, receives actions."""

import dataclasses
import queue
import threading
import weakref
from typing import Any

import numpy as np

from s2mia import wire
from s2mia.acting import Acting, Agent, Description
from s2mia.connection import Connection, Tls
from s2mia.values import Actuator, Numbers, Seed, checked_seed


# The server refuses larger observations, and ends the stream.
_LARGEST = 1e9


class Team(Acting):
    """One stream: one team in one environment. The server keeps the agents' recurrent states. Threads take turns."""

    def __init__(
        self,
        address: str,
        seed: Seed | None = None,
        *,
        tls: Tls | None = None,
        insecure_allow_remote: bool = False,
    ) -> None:
        """Actions are means or likeliest choices; with a `seed`, they are sampled.

        `address` is `HOST:PORT`, `http://HOST:PORT`, or with `tls` `https://HOST:PORT`. Raises `ValueError` for an
        invalid address or certificate. Raises `ConnectionError`, as every call, if the server does not answer or
        refuses the call.
        """
        own = checked_seed(seed)
        self._connection = Connection(
            address, wire.PolicyServiceStub, tls, insecure_allow_remote=insecure_allow_remote
        )
        try:
            answer = self._connection.first_call("DescribePolicy", wire.DescribePolicyRequest())
        except ConnectionError:
            self._connection.close()
            raise
        super().__init__(_description(answer))
        mean = wire.ActStart(mean=wire.MeanAction())
        start = mean if own is None else wire.ActStart(sampled=wire.SampledAction(seed=own))
        self._starts = True
        # Held from a request to its answer.
        self._turn = threading.Lock()
        self._requests: queue.SimpleQueue[Any] = queue.SimpleQueue()
        self._requests.put(wire.ActRequest(start=start))
        # gRPC's thread waits for requests until there is `None`.
        weakref.finalize(self, self._requests.put, None)
        with self._connection.errors():
            self._answers = self._connection.service.Act(iter(self._requests.get, None))

    def close(self) -> None:
        """Ends the stream."""
        self._requests.put(None)
        self._connection.close()

    def _begin(self, environments: int) -> None:
        if environments != 1:
            raise ValueError(f"observations of {environments} environments; a served team acts in one")
        self._starts = True

    def _restart(self, environment: int) -> None:
        self._starts = True

    def _step(self, rows: dict[int, Numbers]) -> dict[int, Numbers]:
        for agent, row in rows.items():
            if (largest := np.abs(row).max()) > _LARGEST:
                name = self.agents[agent].name
                raise ValueError(f"{name}: the observation contains {largest:g}; a served team takes up to {_LARGEST:g}")
        observations = [
            wire.AgentObservation(agent=agent, observation=wire.tensor(row[0])) for agent, row in rows.items()
        ]
        with self._turn:
            starts, self._starts = self._starts, False
            answer = self._answer(wire.ActStep(reset=starts, observations=observations))
            self.description = dataclasses.replace(self.description, **_weights(answer.weights))
        return {row.agent: wire.array(row.action)[None] for row in answer.actions}

    def _answer(self, step: Any) -> Any:
        """The answer to a step."""
        with self._connection.errors():
            try:
                self._requests.put(wire.ActRequest(step=step))
                answer = next(self._answers, None)
            except Exception:
                raise
            except BaseException:
                # An interrupted call: a later step would get the answer to this one.
                self.close()
                raise
        if answer is None:
            raise ConnectionError(f"{self._connection.address}: the server ended the stream")
        return answer


def _weights(name: Any) -> dict[str, Any]:
    """The fields of a description that change with the weights."""
    return {"iteration": name.version, "policy_sha256": name.digest.hex()}


def _description(answer: Any) -> Description:
    return Description(
        run=answer.run_id,
        task=answer.task,
        algorithm=answer.algorithm,
        seed=answer.seed,
        dt_secs=answer.dt_secs,
        agents=[_agent(own) for own in answer.agents],
        **_weights(answer.weights),
    )


def _agent(own: Any) -> Agent:
    return Agent(
        name=own.agent.name,
        observation_size=len(own.agent.observation),
        features=[feature.name for feature in own.agent.observation],
        joints=list(own.agent.joints),
        action_size=own.agent.action.size,
        choices=own.agent.action.choices or None,
        control_ranges=[[range.low, range.high] for range in own.control_ranges],
        actuators=[_actuator(actuator) for actuator in own.actuators],
        distribution=wire.ActionDistribution.Name(own.distribution).removeprefix("ACTION_DISTRIBUTION_").lower(),
        hidden_size=own.hidden_size,
    )


def _actuator(own: Any) -> Actuator:
    def ends(name: str) -> list[float] | None:
        limits = getattr(own, name)
        return [limits.low, limits.high] if own.HasField(name) else None

    activation = wire.ActivationKind.Name(own.activation).removeprefix("ACTIVATION_KIND_").lower()
    return Actuator(
        name=own.name,
        joint=own.joint,
        kind=wire.ActuatorKind.Name(own.kind).removeprefix("ACTUATOR_KIND_").lower(),
        control_limits=[own.control_limits.low, own.control_limits.high],
        gear=own.gear,
        gain=own.gain,
        constant=own.constant,
        kp=own.kp,
        kd=own.kd,
        force_range=ends("force_range"),
        torque_range=ends("torque_range"),
        activation=activation if own.activation else None,
        time_constant_secs=own.time_constant_secs if own.HasField("time_constant_secs") else None,
        activation_range=ends("activation_range"),
        ball_axis=list(own.ball_axis) or None,
        link=own.link or None,
        link_point=list(own.link_point) or None,
        link_force=list(own.link_force) or None,
        link_torque=list(own.link_torque) or None,
    )
