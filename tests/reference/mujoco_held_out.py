"""Writes sim/tests/data/mujoco-held-out.json: MuJoCo's motion under a second set of controls and starts.

    python -m venv venv && venv/bin/pip install mujoco==4.0.0 gymnasium==1.4.0
    venv/bin/python tests/reference/mujoco_held_out.py

`traces` are recorded as in mujoco_traces.py: coordinates at the task's step and at a quarter of it. `random` holds
statistics of episodes under uniform random actions. Their starts and actions come from `draw`, which the `fidelity`
example repeats, so they are not stored. Joints start outside no limit in `traces`; in `random` every episode starts
as in the task.
"""

import json
import pathlib
import sys

import gymnasium
import mujoco
import mujoco_traces
import numpy
from mujoco_traces import HOLD_SECS, ROBOTS, STANDING, TIMES_SECS

STARTS = 5
# Amplitude of the square waves and of the torque in one leg, share of full torque.
AMPLITUDE = {"halfcheetah": 0.3, "walker2d": 0.2, "ant": 0.2}
# Half-width of the noise on each joint of a start, rad.
JOINT_NOISE = 0.05
# Motors of one leg in the order of the actuators.
ONE_LEG = {"halfcheetah": (0, 1, 2), "walker2d": (0, 1, 2), "ant": (2, 3)}
# Episodes, longest episode in steps, physics steps in a step, half-width of the start noise.
RANDOM = {
    "halfcheetah": (20, 500, 5, 0.1),
    "walker2d": (200, 500, 4, 0.005),
    "ant": (200, 500, 5, 0.1),
}


def load(file, parts):
    """MuJoCo 4 adds the margins of both geoms; Ant's file was written for their maximum."""
    model = mujoco_traces.load(file, parts)
    model.geom_margin[model.geom_bodyid == 0] = 0.0
    return model


def mixed(word):
    """The finaliser of splitmix64."""
    word = (word + 0x9E3779B97F4A7C15) % 2**64
    word = (word ^ (word >> 30)) * 0xBF58476D1CE4E5B9 % 2**64
    word = (word ^ (word >> 27)) * 0x94D049BB133111EB % 2**64
    return word ^ (word >> 31)


def draw(episode, step, index):
    """Uniform in [-1, 1) with 24 bits: the same number wherever it is asked for."""
    return (mixed(episode * 2**32 + step * 2**8 + index) >> 40) / 2**23 - 1


def controls(name, drive, seed, actuators):
    segments = round(TIMES_SECS[-1] / HOLD_SECS)
    signs = numpy.random.default_rng(1000 + seed).choice([-1.0, 1.0], actuators)
    rows = numpy.zeros((segments, actuators))
    for segment in range(segments):
        middle_secs = (segment + 0.5) * HOLD_SECS
        if drive in ("square_slow", "square_fast"):
            hertz = 0.5 if drive == "square_slow" else 2.0
            rows[segment] = AMPLITUDE[name] * signs * (1 if (2 * hertz * middle_secs) % 2 < 1 else -1)
        elif drive == "one_leg":
            leg = list(ONE_LEG[name])
            wave = 1 if (2 * middle_secs) % 2 < 1 else -1
            rows[segment, leg] = AMPLITUDE[name] * signs[leg] * wave
    return rows.tolist()


def start(name, file, model, drive, seed):
    """A standing robot, 2 cm high, with noise on its joints; 0.5 m high for a drop."""
    rng = numpy.random.default_rng(2000 + seed)
    at = numpy.array(STANDING.get(file, model.qpos0), dtype=float)
    hinges = len(ROBOTS[name][1])
    at[-hinges:] += rng.uniform(-JOINT_NOISE, JOINT_NOISE, hinges)
    limits = model.jnt_range[-hinges:]
    at[-hinges:] = numpy.clip(at[-hinges:], limits[:, 0], limits[:, 1])
    motion = numpy.zeros(model.nv)
    height = 2 if name == "ant" else 1
    at[height] += 0.5 if drive == "drop" else 0.02
    if drive == "forward":
        motion[0] = 3.0
    if drive == "spin":
        motion[5 if name == "ant" else 2] = 3.0
    return numpy.round(at, 6), motion


def play(model, at, motion, rows, parts):
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:] = at, motion
    steps = round(HOLD_SECS / model.opt.timestep)
    seen = []
    for segment, row in enumerate(rows):
        data.ctrl[:] = row
        mujoco.mj_step(model, data, nstep=steps)
        now = (segment + 1) * HOLD_SECS
        if any(abs(now - time) < 1e-9 for time in TIMES_SECS):
            seen.append(data.qpos.tolist())
    return seen


def traces(name, file):
    model, fine = load(file, 1), load(file, 4)
    drives = {}
    for drive in ("square_slow", "square_fast", "one_leg", "drop", "forward", "spin"):
        drives[drive] = []
        for seed in range(STARTS):
            at, motion = start(name, file, model, drive, seed)
            rows = controls(name, drive, seed, model.nu)
            drives[drive].append(
                {
                    "start": at.tolist(),
                    "motion": motion.tolist(),
                    "controls": rows,
                    "task_step": play(model, at, motion, rows, 1),
                    "quarter_step": play(fine, at, motion, rows, 4),
                }
            )
    return drives


def touching(model, data):
    force = numpy.zeros(6)
    for index in range(data.ncon):
        mujoco.mj_contactForce(model, data, index, force)
        if force[0] > 0:
            return True
    return False


def fallen(name, data):
    if name == "walker2d":
        return not (0.8 < data.qpos[1] < 2.0 and abs(data.qpos[2]) < 1.0)
    return name == "ant" and not 0.2 <= data.qpos[2] <= 1.0


def random(name, file):
    """Means over all steps of all episodes but the episode lengths, the overshoot's quantile apart."""
    episodes, longest, skip, noise = RANDOM[name]
    model = load(file, 1)
    data = mujoco.MjData(model)
    hinges = len(ROBOTS[name][1])
    limits = model.jnt_range[-hinges:]
    heights, contacts, overshoots, speeds, lengths, low = [], [], [], [], [], 0
    for episode in range(episodes):
        mujoco.mj_resetData(model, data)
        data.qpos[:] += [noise * draw(episode, 0, k) for k in range(model.nq)]
        data.qvel[:] = [noise * draw(episode, 0, 64 + k) for k in range(model.nv)]
        if name == "ant":
            data.qpos[3:7] /= numpy.linalg.norm(data.qpos[3:7])
        for step in range(1, longest + 1):
            data.ctrl[:] = [draw(episode, step, k) for k in range(model.nu)]
            mujoco.mj_step(model, data, nstep=skip)
            angles = data.qpos[-hinges:]
            heights.append(data.qpos[2 if name == "ant" else 1])
            contacts.append(touching(model, data))
            # The published start of Ant has its ankles outside their limits.
            if step > 20 or name != "ant":
                overshoots.extend(numpy.maximum(limits[:, 0] - angles, angles - limits[:, 1]).clip(0))
            speeds.append(numpy.abs(data.qvel[-hinges:]).mean())
            if fallen(name, data):
                low += data.qpos[2] < 0.5
                break
        lengths.append(step)
    return {
        "episodes": episodes,
        "longest": longest,
        "noise": noise,
        "height": float(numpy.mean(heights)),
        "contact": float(numpy.mean(contacts)),
        "overshoot": float(numpy.quantile(overshoots, 0.999, method="lower")),
        "joint_speed": float(numpy.mean(speeds)),
        "length": float(numpy.mean(lengths)),
        "ended_low": float(low) / episodes,
    }


def main():
    robots = {
        name: {"traces": traces(name, file), "random": random(name, file)}
        for name, (file, _) in ROBOTS.items()
    }
    source = f"MuJoCo {mujoco.__version__}, models of Gymnasium {gymnasium.__version__}"
    document = {"source": source, "times_secs": TIMES_SECS, "hold_secs": HOLD_SECS, "robots": robots}
    root = pathlib.Path(__file__).parents[2]
    path = root / "sim" / "tests" / "data" / "mujoco-held-out.json"
    path.write_text(json.dumps(mujoco_traces.rounded(document), separators=(",", ":")) + "\n")
    for name, robot in robots.items():
        print(name, robot["random"], file=sys.stderr)
    print(f"{path}: {path.stat().st_size} bytes", file=sys.stderr)


if __name__ == "__main__":
    main()
