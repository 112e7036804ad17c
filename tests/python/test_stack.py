"""The compose file, and the stack for a swarm that follows it; no engine is needed."""

import re

from pathlib import Path

import yaml

DEPLOY = Path(__file__).resolve().parents[2] / "deploy"
FILES = ("stack.yaml", "stack.observability.yaml", "compose.yaml", "compose.mtls.yaml")
STACK, STACK_PROMETHEUS, COMPOSE, MTLS = (yaml.safe_load((DEPLOY / name).read_text()) for name in FILES)
PUBLISHED = {"learner": "PAGE_PORT", "prometheus": "PROMETHEUS_PORT"}


def test_a_learner_takes_the_same_variables_as_under_compose():
    stack, compose = (file["services"]["learner"] for file in (STACK, COMPOSE))
    for key in ("image", "environment", "volumes"):
        assert stack[key] == compose[key], key


def test_an_actor_is_started_by_the_same_command_as_under_compose():
    assert STACK["services"]["actor"]["command"] == COMPOSE["services"]["actor"]["command"]


def test_plain_text_stays_on_an_encrypted_network_of_the_stack_alone():
    network = STACK["networks"]["cluster"]
    assert network["internal"] and "encrypted" in network["driver_opts"] and "attachable" not in network
    for service in swarm_services():
        assert service["networks"] == ["cluster"] and "ports" not in service


def test_every_service_runs_without_privileges_on_a_read_only_root():
    for service in swarm_services():
        assert service["read_only"] and service["cap_drop"] == ["ALL"]


def swarm_services():
    return [*STACK["services"].values(), *STACK_PROMETHEUS["services"].values()]


def test_learner_and_actors_of_a_finished_or_stopped_run_end():
    for role in ("learner", "actor"):
        assert re.fullmatch(r"on-failure:\d+", COMPOSE["services"][role]["restart"])
        swarm = STACK["services"][role]["deploy"]["restart_policy"]
        assert swarm["condition"] == "on-failure" and swarm["max_attempts"]


def test_only_documented_ports_are_published_and_only_on_loopback():
    services = COMPOSE["services"].items()
    ports = {name: service["ports"] for name, service in services if "ports" in service}
    assert ports.keys() == PUBLISHED.keys()
    for name, (port,) in ports.items():
        assert re.fullmatch(rf"127\.0\.0\.1:\$\{{{PUBLISHED[name]}-(\d+)\}}:\1", port), port
        assert PUBLISHED[name] in (DEPLOY.parent / "docs" / "DEPLOY.md").read_text()


def test_nothing_leaves_the_networks_of_compose():
    networks = COMPOSE["networks"]
    assert networks["cluster"] == {"internal": True}
    assert networks["monitoring"] == {"driver_opts": {"com.docker.network.bridge.enable_ip_masquerade": "false"}}
    members = {name: service["networks"] for name, service in COMPOSE["services"].items() if "networks" in service}
    assert {name for name, networks in members.items() if "cluster" in networks} == {"learner", "actor"}
    assert {name for name, networks in members.items() if "monitoring" in networks} == PUBLISHED.keys()
    assert {service["network_mode"] for name, service in COMPOSE["services"].items() if name not in members} == {"none"}


def test_prometheus_reads_the_learner_under_compose_with_and_without_certificates_and_in_a_swarm():
    (job,) = yaml.safe_load((DEPLOY / "prometheus" / "prometheus.yml").read_text())["scrape_configs"]
    (host, port) = job["static_configs"][0]["targets"][0].split(":")
    configs = STACK_PROMETHEUS["configs"]
    assert all((DEPLOY / config["file"]).is_file() for config in configs.values())
    for file in (STACK, COMPOSE):
        words = file["services"][host]["command"]
        assert {f"--page=0.0.0.0:{port}", f"--page-host={host}", "--insecure-allow-remote-page"} <= set(words)
    learner = MTLS["services"][host]
    (script,) = learner["command"]
    (alias,) = learner["networks"]["monitoring"]["aliases"]
    assert f"getent hosts {alias}" in script and f'%% *}}:{port}"' in script and f"--page-host={host}" in script
