"""Writes sim/tests/data/mujoco-humanoid.json: masses, and motions in flight and on the ground, of Gymnasium's Humanoid.

    python -m venv venv && venv/bin/pip install mujoco==4.0.0 gymnasium==1.4.0
    venv/bin/python tests/reference/mujoco_humanoid.py
"""

import json
import pathlib

import gymnasium
import mujoco
import numpy
from mujoco_models import links

MODEL = pathlib.Path(gymnasium.__file__).parent / "envs/mujoco/assets/humanoid.xml"
STEPS = [10, 20, 40]  # environment steps of five physics steps


def motion(model, height, controls):
    """Coordinates after STEPS, from the rest pose at a height (m)."""
    data = mujoco.MjData(model)
    data.qpos[2], data.ctrl[:] = height, controls
    reached = []
    for step in range(1, STEPS[-1] + 1):
        mujoco.mj_step(model, data, 5)
        if step in STEPS:
            reached.append(list(data.qpos))
    return {"height": height, "controls": list(controls), "qpos": reached}


model = mujoco.MjModel.from_xml_path(str(MODEL))
data = mujoco.MjData(model)
mujoco.mj_forward(model, data)
rng = numpy.random.default_rng(0)
scales = {"flight": (8.0, 0.1), "passive": (1.4, 0.0), "driven": (1.4, 0.1)}
record = {
    "source": f"MuJoCo {mujoco.__version__}, Gymnasium {gymnasium.__version__}, humanoid.xml",
    "steps": STEPS,
    "links": [{key: link[key] for key in ("name", "mass", "moments")} for link in links(model, data)],
    "motions": {name: motion(model, at, rng.uniform(-by, by, model.nu)) for name, (at, by) in scales.items()},
}
path = pathlib.Path(__file__).parents[2] / "sim/tests/data/mujoco-humanoid.json"
text = json.dumps(json.loads(json.dumps(record), parse_float=lambda number: round(float(number), 8)), indent=1)
path.write_text(text + "\n")
