"""Robots of Gymnasium's packages load, weigh what MuJoCo computes, and stay finite under random controls."""

import json
import os
import pathlib
import subprocess
import sys

import gymnasium
import gymnasium_robotics
import mujoco
import pytest

from conftest import ROOT

sys.path.append(str(ROOT / "tests" / "reference"))
from mujoco_models import links

EPISODES, STEPS = 3, 200
GYMNASIUM = pathlib.Path(gymnasium.__file__).parent / "envs" / "mujoco" / "assets"
KITCHEN = pathlib.Path(gymnasium_robotics.__file__).parent / "envs" / "assets" / "kitchen_franka"
# The arm is a part of a kitchen; alone on a floor it needs a document of its own.
ARM = """<mujoco>
  <include file="franka_assets/assets.xml"/>
  <include file="franka_assets/basic_scene.xml"/>
  <worldbody><include file="franka_assets/chain.xml"/></worldbody>
  <include file="franka_assets/actuator.xml"/>
</mujoco>
"""


def example():
    program = pathlib.Path(os.environ.get("S2MIA", ROOT / "target" / "debug" / "s2mia"))
    return program.parent / "examples" / "model"


@pytest.fixture(params=["hopper", "humanoid", "arm"])
def model(request, tmp_path):
    """Folder of a model, and its document in it."""
    if request.param != "arm":
        return GYMNASIUM, f"{request.param}.xml"
    (tmp_path / "franka_assets").symlink_to(KITCHEN / "franka_assets")
    (tmp_path / "arm.xml").write_text(ARM)
    return tmp_path, "arm.xml"


def test_a_robot_nobody_here_wrote_loads_and_stays_finite(model):
    folder, document = model
    done = subprocess.run(
        [example(), folder, document, str(EPISODES), str(STEPS)], capture_output=True, text=True, timeout=600
    )
    assert done.returncode == 0, done.stderr
    robot, motion = map(json.loads, done.stdout.splitlines())
    assert motion["steps"] == EPISODES * STEPS
    assert robot["actuators"] and document in robot["files"]
    reference = mujoco.MjModel.from_xml_path(str(folder / document))
    data = mujoco.MjData(reference)
    mujoco.mj_forward(reference, data)
    found = {link["name"]: link for link in robot["links"]}
    for link in links(reference, data, with_base=True):
        name, moments = link["name"], link["moments"]
        assert found[name]["mass"] == pytest.approx(link["mass"], rel=1e-4), name
        assert found[name]["moments"] == pytest.approx(moments, rel=1e-3, abs=1e-4 * moments[-1]), name
    moving = reference.body_mass[1:]
    centre = moving @ data.xipos[1:] / moving.sum()
    assert robot["centre"] == pytest.approx(centre, abs=1e-4)
