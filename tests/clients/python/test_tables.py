"""The runs of a folder as data frames."""

import json
import shutil

import pytest
import s2mia
from conftest import s2mia_run

TINY = ["cue-2x1", "run.iterations=3", "evaluation.every_steps=1000", "evaluation.episodes=2", "run.actors=1"]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A folder with two runs, one of them deeper."""
    root = tmp_path_factory.mktemp("tables")
    s2mia_run("train", *TINY, "run.seed=1", f"run.dir={root / 'one'}")
    s2mia_run("train", *TINY, "run.seed=2", "algorithm=happo", f"run.dir={root / 'group' / 'two'}")
    return root


def lines(run, kind):
    every = (json.loads(line) for line in (run / "metrics.jsonl").read_text().splitlines())
    return [line for line in every if line["kind"] == kind]


def test_a_run_is_a_row_with_the_settings_that_differ_and_its_newest_results(folder):
    table = s2mia.runs(folder).table
    assert list(table.index) == ["group/two", "one"]
    assert list(table["algorithm"]) == ["happo", "happo-s2mia"]
    assert list(table["run.seed"]) == [2, 1]
    assert "surprise.alpha" in table, "it differs"
    assert "run.iterations" not in table and "run.dir" not in table
    assert list(table["iteration"]) == [3, 3]
    one = lines(folder / "one", "iteration")[-1]
    assert table.loc["one", "env_steps"] == one["env_steps"]
    assert table.loc["one", "evaluation"] == lines(folder / "one", "evaluation")[-1]["mean"]
    assert table.loc["one", "git_commit"] == json.loads((folder / "one" / "manifest.json").read_text())["git_commit"]
    assert s2mia.load(table.loc["one", "folder"]).agents


def test_metrics_and_evaluations_are_those_of_the_files(folder):
    found = s2mia.runs(folder)
    for frame, kind in ((found.metrics, "iteration"), (found.evaluations, "evaluation")):
        for name, run in (("one", folder / "one"), ("group/two", folder / "group" / "two")):
            own = frame[frame["run"] == name]
            expected = lines(run, kind)
            assert len(own) == len(expected) > 1
            for key, value in expected[-1].items():
                assert key == "kind" or value is None or own[key].iloc[-1] == value, key


def test_a_run_folder_is_a_table_of_one_row(folder):
    found = s2mia.runs(folder / "one")
    assert list(found.table.index) == ["one"]
    assert list(found.table["task"]) == ["cue-2x1"]


def test_a_checkpoint_is_its_run_and_no_run_of_its_own(folder):
    checkpoints = folder / "one" / "checkpoints"
    [newest, *_] = sorted(checkpoints.glob("iter_*"), reverse=True)
    assert list(s2mia.runs(newest).table.index) == ["one"]
    with pytest.raises(s2mia.RunError, match="checkpoints holds no run: "):
        s2mia.runs(checkpoints)


def test_a_line_that_is_still_being_written_is_left_out(folder, tmp_path):
    run = tmp_path / "run"
    shutil.copytree(folder / "one", run)
    with (run / "metrics.jsonl").open("a") as file:
        file.write('{"kind": "iteration", "itera')
    assert len(s2mia.runs(run).metrics) == 3


def test_a_path_may_begin_with_the_home(folder, monkeypatch):
    monkeypatch.setenv("HOME", str(folder))
    assert s2mia.Run("~/one").folder == folder / "one"
    assert len(s2mia.runs("~/one").table) == 1
    with pytest.raises(ValueError, match="^the run is 3; it is the path of a run or folder$"):
        s2mia.runs(3)


def test_what_is_no_run_or_damaged_is_refused_with_the_file(folder, tmp_path):
    with pytest.raises(s2mia.RunError, match=f"^{tmp_path}/x is no folder$"):
        s2mia.runs(tmp_path / "x")
    with pytest.raises(s2mia.RunError, match=f"^{tmp_path} holds no run: "):
        s2mia.runs(tmp_path)
    for file, text, message in [
        ("metrics.jsonl", "{}\n[1\n", "metrics.jsonl:2 is damaged: "),
        ("metrics.jsonl", "7\n", "metrics.jsonl:1 is damaged: "),
        ("metrics.jsonl", "[]\n", "metrics.jsonl:1 is damaged: it is no JSON object"),
        ("metrics.jsonl", "{}\n", "metrics.jsonl:1 is damaged: it has no kind"),
        ("config.toml", "task = ", "config.toml is damaged: "),
        ("manifest.json", "", "manifest.json is damaged: "),
    ]:
        shutil.rmtree(tmp_path / "run", ignore_errors=True)
        shutil.copytree(folder / "one", tmp_path / "run")
        (tmp_path / "run" / file).write_text(text)
        with pytest.raises(s2mia.RunError, match=f"^{tmp_path}/run/{message}"):
            s2mia.runs(tmp_path)
