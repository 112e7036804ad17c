"""tests/tools/rehash_records.py computes the hashes that records and trained teams have."""

import csv
import importlib.util
import shutil
import tomllib

import pytest
from conftest import ROOT, program

SCRIPT = ROOT / "tests/tools/rehash_records.py"


@pytest.fixture(scope="module")
def rehash():
    """The script as a module."""
    spec = importlib.util.spec_from_file_location("rehash_records", SCRIPT)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.parametrize("name", ["study-hasac.toml", "study-preset-paper.toml"])
def test_the_hash_of_every_recorded_run_is_computed_with_and_without_an_external_environment(rehash, name):
    experiment = ROOT / "configs/experiments" / name
    computed = rehash.planned(experiment, str(program()))
    with (ROOT / tomllib.loads(experiment.read_text())["record"]).open() as record:
        rows = [row for row in csv.DictReader(record) if row["settings_sha256"]]
    recorded = {(row["task"], row["variant"], int(row["seed"])): row["settings_sha256"] for row in rows}
    assert recorded and recorded == {run: computed[run] for run in recorded}


def test_the_hash_of_every_trained_team_is_computed(rehash, tmp_path, monkeypatch, capsys):
    (tmp_path / "pretrained").mkdir()
    shutil.copy(ROOT / "pretrained/teams.toml", tmp_path / "pretrained")
    monkeypatch.setattr(rehash, "ROOT", tmp_path)
    rehash.rewrite_teams(str(program()), str(program()))
    assert capsys.readouterr().out == ""
