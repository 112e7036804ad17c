"""The Python package: its wheel works in a new environment and an empty folder, its examples run, and its types are complete."""

import ast
import filecmp
import json
import os
import pathlib
import re
import subprocess
import sys
from importlib import metadata

import pytest
from conftest import FEW, ROBOT, ROOT, SMALL, command, s2mia_run
from hatchling.builders.wheel import WheelBuilder

CLIENTS = ROOT / "clients" / "python"
# All that the wheel needs with its extra `environment`.
NEEDED = "cloudpickle|farama-notifications|grpcio|grpcio-tools|gymnasium|numpy|pettingzoo|protobuf|setuptools|typing-extensions"


def succeed(words, cwd) -> str:
    """What a program prints; fails with its last words if it fails."""
    done = subprocess.run([*map(str, words)], cwd=cwd, capture_output=True, text=True, timeout=300, check=False)
    assert done.returncode == 0, f"{words}\n{done.stdout}\n{done.stderr}"
    return done.stdout


def python(*arguments, cwd) -> str:
    """What Python prints."""
    return succeed([sys.executable, *arguments], cwd)


def examples(heading: str) -> list[str]:
    """The Python examples under the heading `## HEADING` of docs/USING.md."""
    document = (ROOT / "docs" / "USING.md").read_text()
    section = document.split(f"\n## {heading}\n")[1].split("\n## ")[0]
    return re.findall(r"```python\n(.*?)```", section, re.DOTALL)


@pytest.fixture(scope="module")
def fresh(tmp_path_factory):
    """A new environment with the wheel from which this one has the package, and with what the wheel says that it needs."""
    folder = tmp_path_factory.mktemp("fresh")
    wheel = json.loads(metadata.distribution("s2mia").read_text("direct_url.json"))["url"]
    locked = (ROOT / "tests" / "python" / "requirements.txt").read_text()
    needed = re.finditer(rf"^(?:{NEEDED})==.*(?:\n    --hash=.*)*\n", locked, re.MULTILINE)
    (folder / "needed.txt").write_text("".join(found[0] for found in needed))
    python("-m", "venv", folder / "venv", cwd=folder)
    pip = [folder / "venv" / "bin" / "pip", "--quiet", "--disable-pip-version-check", "install"]
    succeed([*pip, "--require-hashes", "--only-binary", ":all:", "--requirement", "needed.txt"], folder)
    succeed([*pip, "--no-index", f"s2mia[environment] @ {wheel}"], folder)
    return folder / "venv"


@pytest.fixture
def empty(tmp_path):
    """An empty folder."""
    folder = tmp_path / "empty"
    folder.mkdir()
    return folder


def test_the_wheel_holds_the_proto_files_and_every_module(fresh):
    (site,) = (fresh / "lib").glob("python*/site-packages")
    files = [path.relative_to(ROOT / "proto" / "proto") for path in (ROOT / "proto" / "proto").rglob("*.proto")]
    assert len(files) > 5
    assert filecmp.cmpfiles(ROOT / "proto" / "proto", site / "s2mia" / "proto", files, shallow=False)[0] == files
    for package in ("s2mia", "s2mia_environment"):
        modules = [path.name for path in (CLIENTS / package).glob("*.py*")]
        assert filecmp.cmpfiles(CLIENTS / package, site / package, modules, shallow=False)[0] == modules
    assert (site / "s2mia" / "py.typed").is_file()


def test_the_installed_program_trains_in_an_empty_folder_and_the_package_loads_the_run(fresh, empty):
    assert "iteration" in succeed([fresh / "bin" / "s2mia", "train", "cue-2x1", "run.iterations=2"], empty)
    (run,) = (empty / "runs").iterdir()
    load = f"import s2mia; print(s2mia.__file__, s2mia.__version__, len(s2mia.load({str(run)!r}).act([[0] * 9] * 2)))"
    place, version, count = succeed([fresh / "bin" / "python", "-I", "-c", load], empty).split()
    assert fresh in pathlib.Path(place).parents
    assert succeed([fresh / "bin" / "s2mia", "--version"], empty).split()[1].split("+")[0] == version
    assert count == "2"


def test_the_installed_package_steps_an_environment_in_an_empty_folder(fresh, empty):
    lines = [
        "import s2mia",
        "env = s2mia.parallel_env('cue-2x1', seed=1)",
        "env.reset()",
        "_, rewards, *_ = env.step(dict.fromkeys(env.agents, 0))",
        "print(sorted(rewards))",
    ]
    assert succeed([fresh / "bin" / "python", "-I", "-c", "\n".join(lines)], empty) == "['agent_0', 'agent_1']\n"
    assert list(empty.iterdir()) == []


def test_the_installed_package_is_an_actor_in_an_empty_folder(fresh, serve, empty):
    learner = serve("wheel", FEW)
    told = succeed([fresh / "bin" / "python", "-I", "-m", "s2mia.actor", learner.url], empty)
    assert re.search(r"the run is over; [1-9]\d* leases completed", told)
    assert "finished after iteration 2" in learner.finish()
    served = "from s2mia import environment; print(environment.serve.__module__)"
    assert succeed([fresh / "bin" / "python", "-I", "-c", served], empty) == "s2mia_environment.server\n"
    assert list(empty.iterdir()) == []


def test_loading_policies_needs_neither_grpc_nor_pandas(trained, tmp_path):
    blocked = "import sys; sys.modules.update(dict.fromkeys(['grpc', 'pandas'])); import s2mia; "
    python("-c", f"{blocked}s2mia.load({str(trained)!r}).act([[0] * 9] * 2)", cwd=tmp_path)
    failing = f"{blocked}\ntry: s2mia.runs('.')\nexcept ModuleNotFoundError as error: print(error)"
    assert python("-c", failing, cwd=tmp_path) == "s2mia.runs needs pandas: pip install 's2mia[pandas]'\n"


def test_clients_of_services_and_tables_of_runs_need_no_native_module(tmp_path):
    blocked = "import sys; sys.modules['s2mia._native'] = None; import s2mia, s2mia.actor, s2mia_environment; "
    named = "s2mia.Client, s2mia.Learner, s2mia.Team, s2mia.runs, s2mia.train, s2mia.Run, s2mia.act_for"
    python("-c", f"{blocked}{named}", cwd=tmp_path)
    python("-c", "import s2mia; assert s2mia.__version__[0].isdigit() and '__version__' in dir(s2mia)", cwd=tmp_path)


def test_an_editable_installation_is_refused_in_one_line(tmp_path):
    wheels = WheelBuilder(str(CLIENTS)).build(directory=str(tmp_path), versions=["editable"])
    with pytest.raises(RuntimeError, match="^an editable installation would lack the native module; CONTRIBUTING.md says "):
        next(wheels)


def test_an_actor_without_a_learner_ends_with_one_line(tmp_path):
    words = [sys.executable, "-m", "s2mia.actor", "10.0.0.5:50051"]
    done = subprocess.run(words, capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 2
    assert done.stderr == "10.0.0.5:50051: plain text to another machine needs tls or insecure_allow_remote=True\n"


def test_the_example_plays_a_trained_team(trained, tmp_path):
    told = python(CLIENTS / "examples" / "play_a_trained_team.py", trained.parent, cwd=tmp_path)
    likely, sampled = (float(paid) for paid in re.findall(r"choices: ([\d.]+) of 50", told))
    assert likely > 40 and likely > sampled > 50 / 9
    assert re.search(r"algorithm +happo-s2mia", told)


def test_the_example_ends_with_one_line_without_a_run_of_the_game(tmp_path):
    s2mia_run("train", *ROBOT, f"run.dir={tmp_path / 'robot'}")
    (tmp_path / "empty").mkdir()
    for arguments, message in [
        ([], "usage: python play_a_trained_team.py FOLDER, with a run of cue-2x1 in it"),
        (["empty"], "empty holds no run: no folder in it has a config.toml and a manifest.json"),
        (["robot"], "robot has no run of cue-2x1; train one with `s2mia train cue-2x1 run.dir=runs/cue`"),
    ]:
        words = [sys.executable, CLIENTS / "examples" / "play_a_trained_team.py", *arguments]
        done = subprocess.run(words, cwd=tmp_path, capture_output=True, text=True, timeout=60, check=False)
        assert (done.returncode, done.stderr) == (1, f"{message}\n")


def test_the_documented_examples_run(serve, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    training, policies, servos, tables, learner = examples("Python package")
    exec(training, {})
    assert re.search(r"runs/cue [\d.]+\nevaluations: \[[\d.]+", capsys.readouterr().out)
    exec(policies, {})
    assert re.search(r"most likely choices: \{'agent_0': np.int64\(\d\), 'agent_1': ", capsys.readouterr().out)
    exec(servos, {})
    assert re.match(r"front_left_hip position 40.0 1.0 targets \(-?[\d.]+, [\d.]+\) N m \[-33.0, 33.0\]", capsys.readouterr().out)
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


def test_the_syntax_is_that_of_the_oldest_supported_python():
    for path in sorted(CLIENTS.rglob("*.py")):
        ast.parse(path.read_text(), str(path), feature_version=(3, 10))
