"""The stack for a swarm beside the compose file that it follows; no engine is needed."""

from pathlib import Path

import yaml

DEPLOY = Path(__file__).resolve().parents[2] / "deploy"
STACK, COMPOSE = (yaml.safe_load((DEPLOY / name).read_text()) for name in ("stack.yaml", "compose.yaml"))


def test_a_learner_takes_the_same_variables_as_under_compose():
    stack, compose = (file["services"]["learner"] for file in (STACK, COMPOSE))
    for key in ("image", "environment", "volumes"):
        assert stack[key] == compose[key], key


def test_an_actor_is_started_by_the_same_command_as_under_compose():
    assert STACK["services"]["actor"]["command"] == COMPOSE["services"]["actor"]["command"]


def test_plain_text_stays_on_an_encrypted_network_of_the_stack_alone():
    network = STACK["networks"]["cluster"]
    assert network["internal"] and "encrypted" in network["driver_opts"] and "attachable" not in network
    for service in STACK["services"].values():
        assert service["networks"] == ["cluster"] and "ports" not in service


def test_every_service_runs_without_privileges_on_a_read_only_root():
    for service in STACK["services"].values():
        assert service["read_only"] and service["cap_drop"] == ["ALL"]
