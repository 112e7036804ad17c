"""metrics.jsonl and provenance.jsonl are plain JSON lines that agree with the checkpoint."""

import json
import math

import pytest
from conftest import ITERATIONS, STEPS_PER_ITERATION, TINY, s2mia


def lines(path):
    """Each line of a file as an object."""
    return [json.loads(line) for line in path.read_text().splitlines()]


def of_kind(run, kind):
    """The metrics of iterations, or of evaluations."""
    return [line for line in lines(run / "metrics.jsonl") if line["kind"] == kind]


def test_every_iteration_stands_in_the_metrics_once(run):
    iterations = of_kind(run, "iteration")
    assert [line["iteration"] for line in iterations] == list(range(1, ITERATIONS + 1))
    steps = [line["env_steps"] for line in iterations]
    assert steps == [STEPS_PER_ITERATION * k for k in range(1, ITERATIONS + 1)]


def test_figures_are_finite_numbers_under_known_names(run):
    expected = {"agent0/policy_loss", "agent5/policy_loss", "agent0/entropy", "losses/value_loss"}
    for line in of_kind(run, "iteration"):
        # No episode ends in so short a run, so there is no return yet.
        figures = {name: value for name, value in line.items() if name not in ("kind", "episode_return")}
        wrong = {name for name, value in figures.items() if value is None or not math.isfinite(value)}
        assert not wrong
        assert expected <= set(figures), sorted(figures)


def test_evaluations_stand_at_the_steps_they_were_asked_for(run):
    evaluations = of_kind(run, "evaluation")
    steps = sorted(line["env_steps"] for line in evaluations)
    assert steps == [0, 2 * STEPS_PER_ITERATION, 4 * STEPS_PER_ITERATION]
    assert all(math.isfinite(line["mean"]) for line in evaluations)


def terms(run):
    """Figures of the terms of the reward, by kind of line and iteration."""
    of_terms = ("reward/", "return/")
    return {
        (line["kind"], line["iteration"]): {name: value for name, value in line.items() if name.startswith(of_terms)}
        for line in lines(run / "metrics.jsonl")
    }


def test_terms_of_the_reward_are_equal_with_any_number_of_actors(run, tmp_path):
    found = terms(run)
    assert set(found["iteration", ITERATIONS]) == {"reward/forward_speed", "reward/control"}
    assert all(of_line["reward/control"] < 0 for (kind, _), of_line in found.items() if kind == "iteration")
    for actors in (1, 3):
        folder = tmp_path / f"actors-{actors}"
        s2mia("train", *TINY, f"run.dir={folder}", f"run.actors={actors}")
        assert terms(folder) == found


def test_terms_of_an_evaluation_sum_to_its_mean_return(run):
    found = terms(run)
    for line in of_kind(run, "evaluation"):
        own = found["evaluation", line["iteration"]]
        assert set(own) == {"return/forward_speed", "return/control"}
        assert sum(own.values()) == pytest.approx(line["mean"], abs=1e-3)


def test_provenance_ends_with_the_weights_of_the_checkpoint(run, inspected):
    provenance = lines(run / "provenance.jsonl")
    assert len(provenance) == ITERATIONS
    assert provenance[-1]["weights_sha256"] == inspected["weights_sha256"]


def test_the_run_keeps_its_settings_and_its_manifest(run):
    assert 'task = "halfcheetah-6x1"' in (run / "config.toml").read_text()
    manifest = json.loads((run / "manifest.json").read_text())
    for key in ("seed", "config_sha256", "rollout_fingerprint"):
        assert key in manifest
