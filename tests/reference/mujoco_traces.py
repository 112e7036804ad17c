"""Writes sim/tests/data/mujoco-traces.json: what MuJoCo makes of the same robots under the same controls.

    python -m venv venv && venv/bin/pip install mujoco==3.2.7 gymnasium==1.2.3
    venv/bin/python tests/reference/mujoco_traces.py

Gymnasium's own model files are stepped, with their solver settings. `cargo run --release -p sim --example fidelity`
prints how far the simulator is from these traces.
"""

import json
import os
import pathlib
import sys

import gymnasium
import mujoco
import numpy

ASSETS = os.path.join(os.path.dirname(gymnasium.__file__), "envs", "mujoco", "assets")
TIMES_SECS = (0.2, 0.5, 1.0)
HOLD_SECS = 0.05
SEQUENCES = 10
# Name, model file, and joint angles for the flight, from which no limit is near.
ROBOTS = {
    "halfcheetah": ("half_cheetah.xml", [0.2, 0.1, 0.2, -0.2, -0.2, 0.1]),
    "walker2d": ("walker2d.xml", [-0.6, -1.0, 0.1, -1.0, -0.8, -0.1]),
    "ant": ("ant.xml", [0.1, 0.9, -0.1, -0.9, 0.1, -0.9, -0.1, 0.9]),
}


# Starts on the ground. Ant's zero pose has the ankles 30 degrees outside their limits, from where MuJoCo's limits
# fling them to the other end at 10 rad/s; this is the standing pose of its model file.
STANDING = {"ant.xml": [0, 0, 0.55, 1, 0, 0, 0, 0, 1, 0, -1, 0, -1, 0, 1]}


def load(file, parts):
    model = mujoco.MjModel.from_xml_path(os.path.join(ASSETS, file))
    model.opt.timestep /= parts
    return model


def play(model, start, controls, parts):
    """Coordinates at TIMES_SECS; `controls` is [segments, actuators], each row held for HOLD_SECS."""
    data = mujoco.MjData(model)
    data.qpos[:] = start
    steps = round(HOLD_SECS / model.opt.timestep)
    at = {round(time / model.opt.timestep) for time in TIMES_SECS}
    seen, count = [], 0
    for row in controls:
        data.ctrl[:] = row
        for _ in range(steps):
            mujoco.mj_step(model, data)
            count += 1
            if count in at:
                seen.append(data.qpos.tolist())
    return seen


def flight(file, angles):
    """The exact motion high above the floor: contacts off, steps 64 times shorter."""
    model = load(file, 64)
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT
    start = model.qpos0.copy()
    start[-len(angles) :] = angles
    segments = round(TIMES_SECS[-1] / HOLD_SECS)
    controls = [[0.02 * numpy.sin(0.9 * t + k) for k in range(model.nu)] for t in range(segments)]
    return {"start": start.tolist(), "controls": controls, "exact": play(model, start, controls, 64)}


def ground(file, scale):
    """Random torques of this share of full torque from standing, floor and limits and all."""
    model, fine = load(file, 1), load(file, 4)
    segments = round(TIMES_SECS[-1] / HOLD_SECS)
    episodes = []
    for seed in range(SEQUENCES if scale > 0 else 1):
        rng = numpy.random.default_rng(seed)
        controls = scale * rng.uniform(-1, 1, (segments, model.nu))
        controls = numpy.round(controls, 6).tolist()
        start = numpy.array(STANDING.get(file, model.qpos0), dtype=float)
        episodes.append(
            {
                "start": start.tolist(),
                "controls": controls,
                "task_step": play(model, start, controls, 1),
                "quarter_step": play(fine, start, controls, 4),
            }
        )
    return episodes


def rounded(value):
    if isinstance(value, float):
        return float(f"{value:.7g}")
    if isinstance(value, list):
        return [rounded(item) for item in value]
    if isinstance(value, dict):
        return {key: rounded(item) for key, item in value.items()}
    return value


def main():
    robots = {
        name: {
            "flight": flight(file, angles),
            "passive": ground(file, 0.0),
            "tenth": ground(file, 0.1),
            "full": ground(file, 1.0),
        }
        for name, (file, angles) in ROBOTS.items()
    }
    source = f"MuJoCo {mujoco.__version__}, models of Gymnasium {gymnasium.__version__}"
    document = {"source": source, "times_secs": TIMES_SECS, "hold_secs": HOLD_SECS, "robots": robots}
    root = pathlib.Path(__file__).parents[2]
    path = root / "sim" / "tests" / "data" / "mujoco-traces.json"
    path.write_text(json.dumps(rounded(document), separators=(",", ":")) + "\n")
    print(f"{path}: {path.stat().st_size} bytes", file=sys.stderr)


if __name__ == "__main__":
    main()
