"""Prints MuJoCo's environment steps per second: mujoco_rate.py MODEL FRAME_SKIP STEPS random|still.

MODEL is a file, or the name of one of Gymnasium's. The whole environment step is one call into C (`mj_step` with `nstep`),
with the controls and resets of `steps.rs`, from the first keyframe if there is one.
"""

import os
import sys
import time

import mujoco
import numpy


def find(name):
    if os.path.exists(name):
        return name
    import gymnasium

    folder = os.path.dirname(gymnasium.__file__)
    return os.path.join(folder, "envs", "mujoco", "assets", f"{name}.xml")


def main():
    name, frame_skip, steps, controls = sys.argv[1:]
    frame_skip, steps = int(frame_skip), int(steps)
    model = mujoco.MjModel.from_xml_path(find(name))
    data = mujoco.MjData(model)
    rng = numpy.random.default_rng(7)
    low, high = model.actuator_ctrlrange.T
    width = 1.0 if controls == "random" else 0.0
    numbers = (high + low) / 2 + width * rng.uniform(-1, 1, (steps, model.nu)) * (high - low) / 2
    start = time.perf_counter()
    for step in range(steps):
        if step % 1000 == 0 and model.nkey:
            mujoco.mj_resetDataKeyframe(model, data, 0)
        elif step % 1000 == 0:
            mujoco.mj_resetData(model, data)
        data.ctrl[:] = numbers[step]
        mujoco.mj_step(model, data, nstep=frame_skip)
    print(steps / (time.perf_counter() - start))


if __name__ == "__main__":
    main()
