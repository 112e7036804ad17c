"""Robots of Gymnasium's packages load, weigh what MuJoCo computes, and stay finite under random controls."""

import pathlib
import re
import shutil
import sys

import gymnasium
import gymnasium_robotics
import mujoco
import pytest

from conftest import ROOT, s2mia

sys.path.append(str(ROOT / "tests" / "reference"))
from mujoco_models import links

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
TASK = """robot = "robot"
model = "{model}"
frame_skip = 5
episode_steps = 200
agents.all = [{joints}]
[[reward]]
term = "alive"
weight = 1.0
"""
# A line of the check: a link's name, mass and principal moments.
LINK = r"^link +(\S+) +(\S+) kg, inertia (\S+) (\S+) (\S+) kg m\^2$"


@pytest.fixture(params=["hopper", "humanoid", "arm"])
def model(request, tmp_path):
    """A model in a folder of its own."""
    path = tmp_path / f"{request.param}.xml"
    if request.param == "arm":
        shutil.copytree(KITCHEN / "franka_assets", tmp_path / "franka_assets")
        path.write_text(ARM)
    else:
        shutil.copy(GYMNASIUM / path.name, path)
    return path


def test_a_robot_nobody_here_wrote_loads_and_stays_finite(model):
    reference = mujoco.MjModel.from_xml_path(str(model))
    joints = [reference.joint(joint).name for joint in reference.actuator_trnid[:, 0]]
    task = model.with_suffix(".toml")
    task.write_text(TASK.format(model=model.name, joints=joints))
    check = s2mia("task", "check", task)
    assert "mean length 200.0 steps" in check and "0 by a physics fault" in check
    assert all(re.search(f"^joint {joint} ", check, re.MULTILINE) for joint in joints), check
    data = mujoco.MjData(reference)
    mujoco.mj_forward(reference, data)
    found = {name: list(map(float, numbers)) for name, *numbers in re.findall(LINK, check, re.MULTILINE)}
    for link in links(reference, data, with_base=True):
        mass, *moments = found[link["name"]]
        # The check prints four decimals of a mass and four digits of a moment.
        assert mass == pytest.approx(link["mass"], rel=1e-4, abs=6e-5), link
        assert moments == pytest.approx(link["moments"], rel=1e-3, abs=1e-4 * link["moments"][-1]), link
