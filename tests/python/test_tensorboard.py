"""The TensorBoard events tell what metrics.jsonl tells, each iteration once."""

import json

import pytest
from conftest import ITERATIONS, STEPS_PER_ITERATION, TINY, s2mia
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator


@pytest.fixture(scope="module", params=["whole", "resumed"])
def written(request, run, tmp_path_factory):
    """Folder of a run that went through, and of one that was resumed from a checkpoint before its last lines."""
    if request.param == "whole":
        return run
    folder = tmp_path_factory.mktemp("runs") / "resumed"
    s2mia("train", *TINY, f"run.dir={folder}")
    newest = folder / "checkpoints" / f"iter_{ITERATIONS:08}"
    (newest / "manifest.json").unlink()
    s2mia("train", "--resume", folder)
    return folder


def figures(folder, kind):
    """The lines of one kind in metrics.jsonl."""
    lines = [json.loads(line) for line in (folder / "metrics.jsonl").read_text().splitlines()]
    return [line for line in lines if line["kind"] == kind]


@pytest.fixture(scope="module")
def events(written):
    """What TensorBoard's own reader makes of the run."""
    accumulator = EventAccumulator(str(written / "tensorboard"))
    accumulator.Reload()
    return accumulator


def test_tensorboard_reads_each_iteration_once_over_environment_steps(events):
    losses = events.Scalars("losses/value_loss")
    assert [event.step for event in losses] == [STEPS_PER_ITERATION * k for k in range(1, ITERATIONS + 1)]
    times = [event.wall_time for event in losses]
    assert times == sorted(times)


def test_a_tensorboard_that_is_open_shows_what_comes_after_a_resume_and_each_step_once(tmp_path):
    folder = tmp_path / "open"
    s2mia("train", *TINY, f"run.dir={folder}")
    before = set((folder / "tensorboard").iterdir())
    accumulator = EventAccumulator(str(folder / "tensorboard"))
    accumulator.Reload()
    newest = sorted((folder / "checkpoints").glob("iter_*"))[-1]
    (newest / "manifest.json").unlink()
    s2mia("train", "--resume", folder, "run.iterations=6")
    accumulator.Reload()
    assert before < set((folder / "tensorboard").iterdir())
    for tag in ("losses/value_loss", "charts/evaluation_return"):
        steps = [event.step for event in accumulator.Scalars(tag)]
        assert steps == sorted(set(steps))
        assert steps[-1] == 6 * STEPS_PER_ITERATION


@pytest.mark.parametrize(
    ("tag", "kind", "figure"),
    [
        ("losses/value_loss", "iteration", "losses/value_loss"),
        ("s2mia/surprise_entropy_bound/agent5", "iteration", "agent5/surprise_entropy_bound"),
        ("agent0/entropy", "iteration", "agent0/entropy"),
        ("stats/update_time", "iteration", "update_secs"),
        ("charts/evaluation_return", "evaluation", "mean"),
    ],
)
def test_a_tag_shows_the_figure_of_the_metrics(events, written, tag, kind, figure):
    shown = [(event.step, event.value) for event in events.Scalars(tag)]
    expected = [(line["env_steps"], line[figure]) for line in figures(written, kind)]
    assert [step for step, _ in shown] == [step for step, _ in expected]
    assert [value for _, value in shown] == pytest.approx([value for _, value in expected], rel=1e-6)
