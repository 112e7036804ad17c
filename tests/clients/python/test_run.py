"""Python trains with the program, and reads what a run has written."""

import importlib.util
import json
import os
import pathlib
import signal
import subprocess
import sys
import threading
import types

import pytest
import s2mia
from conftest import PLACES, ROOT

SHORT = {"run__actors": 1, "run__iterations": 3, "evaluation__every_steps": 1000, "evaluation__episodes": 2}


def test_a_training_returns_its_folder_metrics_evaluations_and_policies(tmp_path, capfd):
    run = s2mia.train("cue-2x1", run__seed=5, run__dir=tmp_path / "run", **SHORT)
    assert run.folder == tmp_path / "run"
    assert capfd.readouterr() == ("", ""), "it is quiet"
    lines = [json.loads(line) for line in (tmp_path / "run" / "metrics.jsonl").read_text().splitlines()]
    assert run.metrics == [line for line in lines if line["kind"] == "iteration"]
    assert [line["iteration"] for line in run.metrics] == [1, 2, 3]
    assert run.evaluations == [line for line in lines if line["kind"] == "evaluation"]
    team = run.load()
    assert (team.description.seed, team.description.iteration) == (5, 3)


@pytest.mark.parametrize("kind", [str, pathlib.Path])
def test_a_folder_without_a_run_is_refused(tmp_path, kind):
    with pytest.raises(s2mia.RunError, match="nowhere is no run: it has no config.toml$"):
        s2mia.Run(kind(tmp_path / "nowhere"))


def test_a_folder_with_any_config_or_a_checkpoint_alone_is_no_run(tmp_path):
    (tmp_path / "config.toml").write_text("x = 1\n")
    with pytest.raises(s2mia.RunError, match="is no run: it has no manifest.json$"):
        s2mia.Run(tmp_path)
    for name in ("manifest.json", "policy.safetensors"):
        (tmp_path / name).write_text("{}")
    with pytest.raises(s2mia.RunError, match="is no run: it is a checkpoint without its run$"):
        s2mia.Run(tmp_path)


def test_a_run_is_found_by_its_checkpoint_and_from_any_folder_and_missed_when_it_is_gone(tmp_path, monkeypatch):
    made = s2mia.train("cue-2x1", run__dir=tmp_path / "run", **SHORT)
    monkeypatch.chdir(tmp_path)
    run = s2mia.Run("run")
    monkeypatch.chdir("/")
    assert run == made and run.metrics
    assert s2mia.Run(run.folder / "checkpoints" / "iter_00000003") == run
    assert run.load(checkpoint=3).description.iteration == 3
    run.folder.rename(tmp_path / "elsewhere")
    with pytest.raises(s2mia.RunError, match="metrics.jsonl cannot be read: No such file or directory$"):
        run.metrics  # noqa: B018


def test_a_run_is_resumed_with_settings_that_may_change(tmp_path):
    run = s2mia.train("cue-2x1", run__dir=tmp_path / "run", **SHORT)
    assert run.resume(run__iterations=4) == run
    assert [line["iteration"] for line in run.metrics] == [1, 2, 3, 4]
    with pytest.raises(s2mia.RunError, match="run.seed"):
        run.resume(run__seed=9)


def test_without_a_folder_the_run_gets_one_of_its_own(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    run = s2mia.train("cue-2x1", progress=True, **SHORT)
    assert run.folder.parent == tmp_path / "runs" and run.metrics
    assert "task cue-2x1" in capsys.readouterr().out


def test_a_training_starts_from_the_policies_of_another_run(tmp_path):
    first = s2mia.train("cue-2x1", run__dir=tmp_path / "first", **SHORT)
    second = s2mia.train("cue-2x1", run__dir=tmp_path / "second", **SHORT, **{"policy.start": first.folder})
    kept = (second.folder / "start_policies.safetensors").read_bytes()
    assert kept == (first.folder / "checkpoints" / "iter_00000003" / "policy.safetensors").read_bytes()


@pytest.mark.parametrize(
    ("task", "settings", "message"),
    [
        ("cue-2x2", {}, "unknown task `cue-2x2`; did you mean `cue-2x1`?"),
        ("cue-2x1", {"run__sed": 1}, "unknown key `run.sed`; did you mean `run.seed`?"),
        ("cue-2x1", {"run__seed": "one"}, "`run.seed` must be a whole number"),
        ("cue-2x1", {"update__clip": float("nan")}, "`update.clip` must be a finite number"),
    ],
)
def test_what_the_program_refuses_is_an_error_with_its_line(tmp_path, monkeypatch, task, settings, message):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(s2mia.RunError) as raised:
        s2mia.train(task, **settings)
    assert message in str(raised.value) and "\n" not in str(raised.value)
    assert list(tmp_path.iterdir()) == []


def test_a_program_that_is_not_there_is_an_error(tmp_path, monkeypatch):
    monkeypatch.setenv("S2MIA", str(tmp_path / "no"))
    with pytest.raises(s2mia.RunError, match="/no cannot be started: No such file or directory$"):
        s2mia.train("cue-2x1")


def test_a_program_that_is_killed_is_an_error(tmp_path, monkeypatch):
    program = tmp_path / "s2mia"
    program.write_text("#!/bin/sh\necho 'runs/a: task cue-2x1'\necho 'a warning' >&2\nkill -9 $$\n")
    program.chmod(0o755)
    monkeypatch.setenv("S2MIA", str(program))
    with pytest.raises(s2mia.RunError, match="^s2mia ended with status -9: a warning$"):
        s2mia.train("cue-2x1")


def test_another_program_that_ends_well_is_no_run(monkeypatch):
    monkeypatch.setenv("S2MIA", "/bin/true")
    with pytest.raises(s2mia.RunError, match="^s2mia ended with status 0$"):
        s2mia.train("cue-2x1")


def test_an_interrupt_ends_the_run_after_a_checkpoint(tmp_path):
    """In a process of its own, which gets the signal as soon as the run has a first line of metrics."""
    run = tmp_path / "run"
    script = (
        "import s2mia\ntry:\n"
        f"    s2mia.train('cue-2x1', run__dir={str(run)!r}, run__iterations=100_000, progress=True)\n"
        "except KeyboardInterrupt: print('interrupted', flush=True)"
    )
    environment = {**os.environ, "PYTHONPATH": PLACES}
    with subprocess.Popen([sys.executable, "-c", script], stdout=subprocess.PIPE, text=True, env=environment) as process:
        guard = threading.Timer(120, process.kill)
        guard.start()
        metrics = run / "metrics.jsonl"
        while process.poll() is None and not (metrics.is_file() and metrics.stat().st_size):
            pass
        process.send_signal(signal.SIGINT)
        said = process.stdout.read()
        guard.cancel()
    assert said.endswith("interrupted\n"), said
    reached = s2mia.Run(run).metrics[-1]["iteration"]
    assert s2mia.load(run).description.iteration == reached


def example(name: str) -> types.ModuleType:
    spec = importlib.util.spec_from_file_location(name, ROOT / "clients" / "python" / "examples" / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_the_example_trains_with_the_weights_that_a_trial_suggests(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    asked = {}

    def suggest_float(name: str, low: float, high: float, *, log: bool) -> float:
        asked[name] = low if log else high
        return asked[name]

    trial = types.SimpleNamespace(number=4, suggest_float=suggest_float)
    value = example("sweep_a_setting").objective(trial)
    assert list(asked) == ["alpha", "lambda"]
    [folder] = pathlib.Path("runs").iterdir()
    assert value == s2mia.Run(folder).evaluations[-1]["mean"] > 0
    settings = (folder / "config.toml").read_text()
    assert f"alpha = {asked['alpha']}" in settings and f"lambda = {asked['lambda']}" in settings
    assert s2mia.load(folder).description.seed == 4
