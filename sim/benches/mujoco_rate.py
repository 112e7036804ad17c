"""Prints MuJoCo's environment steps per second for one model: mujoco_rate.py MODEL STEPS.

The whole environment step is one call into C (`mj_step` with `nstep`), with random controls and resets as in
`steps.rs`.
"""

import os
import sys
import time

import gymnasium
import mujoco
import numpy

FRAME_SKIP = {"half_cheetah": 5, "walker2d": 4, "ant": 5}


def main():
    name, steps = sys.argv[1], int(sys.argv[2])
    assets = os.path.join(os.path.dirname(gymnasium.__file__), "envs", "mujoco", "assets")
    model = mujoco.MjModel.from_xml_path(os.path.join(assets, f"{name}.xml"))
    data = mujoco.MjData(model)
    rng = numpy.random.default_rng(7)
    controls = rng.uniform(-1, 1, (steps, model.nu))
    start = time.perf_counter()
    for step in range(steps):
        data.ctrl[:] = controls[step]
        mujoco.mj_step(model, data, nstep=FRAME_SKIP[name])
        if step % 1000 == 999:
            mujoco.mj_resetData(model, data)
    print(steps / (time.perf_counter() - start))


if __name__ == "__main__":
    main()
