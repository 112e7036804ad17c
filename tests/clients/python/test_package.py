"""The Python package: its wheel works in an empty folder, its examples run, and its types are complete."""

import filecmp
import os
import pathlib
import re
import subprocess
import sys

import pytest
from conftest import CLIENTS, FEW, ROOT, SMALL, command, s2mia_run


def python(*arguments, cwd, path=CLIENTS) -> str:
    """What Python prints with the packages in `path`; fails with its last words if it fails."""
    environment = {**os.environ, "PYTHONPATH": str(path), "PYTHONDONTWRITEBYTECODE": "1"}
    words = [sys.executable, *map(str, arguments)]
    done = subprocess.run(words, cwd=cwd, env=environment, capture_output=True, text=True, timeout=300, check=False)
    assert done.returncode == 0, f"{words}\n{done.stdout}\n{done.stderr}"
    return done.stdout


def examples(heading: str) -> list[str]:
    """The Python examples under the heading `## HEADING` of docs/USING.md."""
    document = (ROOT / "docs" / "USING.md").read_text()
    section = document.split(f"\n## {heading}\n")[1].split("\n## ")[0]
    return re.findall(r"```python\n(.*?)```", section, re.DOTALL)


def listing() -> set[pathlib.Path]:
    """All files of the package's folder, except compiled ones."""
    return {path for path in CLIENTS.rglob("*") if "__pycache__" not in path.parts}


@pytest.fixture(scope="module")
def installed(tmp_path_factory):
    """A folder with the installed wheel. The build leaves nothing in the repository."""
    folder, before = tmp_path_factory.mktemp("wheel"), listing()
    pip = ["-m", "pip", "--disable-pip-version-check"]
    offline = ["--quiet", "--no-index", "--no-deps"]
    python(*pip, "wheel", *offline, "--no-build-isolation", "--wheel-dir", folder, CLIENTS, cwd=folder)
    (wheel,) = folder.glob("s2mia-*.whl")
    python(*pip, "install", *offline, "--target", folder / "site", wheel, cwd=folder)
    assert listing() == before
    return folder / "site"


def test_the_wheel_holds_the_proto_files_and_every_module(installed):
    files = [path.relative_to(ROOT / "proto" / "proto") for path in (ROOT / "proto" / "proto").rglob("*.proto")]
    assert len(files) > 5
    assert filecmp.cmpfiles(ROOT / "proto" / "proto", installed / "s2mia" / "proto", files, shallow=False)[0] == files
    for package in ("s2mia", "s2mia_environment"):
        assert {path.name for path in (CLIENTS / package).glob("*.py*")} == {
            path.name for path in (installed / package).glob("*.py*")
        }
    assert (installed / "s2mia" / "py.typed").is_file()


def test_the_installed_package_acts_and_is_an_actor_in_an_empty_folder(installed, trained, serve, tmp_path):
    empty = tmp_path / "empty"
    empty.mkdir()
    load = f"import s2mia; print(s2mia.__file__, len(s2mia.load({str(trained)!r}).act([[0] * 9] * 2)))"
    place, count = python("-c", load, cwd=empty, path=installed).split()
    assert (pathlib.Path(place).parent, count) == (installed / "s2mia", "2")
    learner = serve("wheel", FEW)
    told = python("-m", "s2mia.actor", learner.url, cwd=empty, path=installed)
    assert re.search(r"the run is over; [1-9]\d* leases completed", told)
    assert "finished after iteration 2" in learner.finish()
    served = "from s2mia import environment; print(environment.serve.__module__)"
    assert python("-c", served, cwd=empty, path=installed) == "s2mia_environment.server\n"
    assert list(empty.iterdir()) == []


def test_loading_policies_needs_neither_grpc_nor_pandas(trained, tmp_path):
    blocked = "import sys; sys.modules.update(dict.fromkeys(['grpc', 'pandas'])); import s2mia; "
    python("-c", f"{blocked}s2mia.load({str(trained)!r}).act([[0] * 9] * 2)", cwd=tmp_path)
    failing = f"{blocked}\ntry: s2mia.runs('.')\nexcept ModuleNotFoundError as error: print(error)"
    assert python("-c", failing, cwd=tmp_path) == "s2mia.runs needs pandas: pip install 's2mia[pandas]'\n"


def test_an_actor_without_a_learner_ends_with_one_line(tmp_path):
    words = [sys.executable, "-m", "s2mia.actor", "10.0.0.5:50051"]
    done = subprocess.run(words, cwd=CLIENTS, capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 2
    assert done.stderr == "10.0.0.5:50051: plain text to another machine needs tls or insecure_allow_remote=True\n"


def test_the_example_plays_a_trained_team(trained, tmp_path):
    told = python(CLIENTS / "examples" / "play_a_trained_team.py", trained.parent, cwd=tmp_path)
    likely, sampled = (float(paid) for paid in re.findall(r"choices: ([\d.]+) of 50", told))
    assert likely > 40 and likely > sampled > 50 / 9
    assert re.search(r"algorithm +happo-s2mia", told)


def test_the_documented_examples_run(serve, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    train = (*SMALL, "run.iterations=20", "run.actors=1", "evaluation.every_steps=10000", "run.dir=runs/cue")
    s2mia_run("train", *train)
    policies, tables, learner = examples("Python package")
    exec(policies, {})
    assert re.search(r"most likely choices: \[\d, \d\]\nsampled choices: \[\d, \d\]", capsys.readouterr().out)
    exec(tables, {})
    assert re.search(r"algorithm +happo-s2mia", capsys.readouterr().out)
    started = serve("live", [*SMALL, "run.iterations=1000", "evaluation.every_steps=0"])
    with subprocess.Popen(command("actor", "--learner", started.url), stderr=subprocess.DEVNULL) as actor:
        assert "127.0.0.1:50051" in learner
        exec(learner.replace("127.0.0.1:50051", started.address), {})
        actor.wait(timeout=60)
    assert re.match(r"iteration \d+, \d+ steps, [01] actors\n1 ", capsys.readouterr().out)
    assert "stopped after iteration" in started.finish()


def test_the_types_are_complete(tmp_path):
    assert "Success" in python("-m", "mypy", "--cache-dir", tmp_path, cwd=CLIENTS)
