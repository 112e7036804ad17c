"""Writes sim/tests/data/mujoco-models.json: masses, joints and actuators that MuJoCo compiles from models of many kinds, and
motions of some.

    python -m venv venv && venv/bin/pip install mujoco==4.0.0
    venv/bin/python tests/reference/mujoco_models.py
"""

import json
import pathlib

import mujoco
import numpy
from mujoco_motions import MOTIONS

# A trough with an open top: neither convex nor star-shaped.
OUTLINE = [(0, 0), (3, 0), (3, 2), (2, 2), (2, 1), (1, 1), (1, 2), (0, 2)]
QUADS = [(0, 1, 4, 5), (1, 2, 3, 4), (0, 5, 6, 7)]


def trough():
    """The trough as an OBJ file, one metre thick."""
    count = len(OUTLINE)
    lines = [f"v {x} {y} {z}" for z in (0, 1) for x, y in OUTLINE]
    for quad in QUADS:
        lines.append("f " + " ".join(str(corner + 1) for corner in reversed(quad)))
        lines.append("f " + " ".join(str(corner + count + 1) for corner in quad))
    for a in range(count):
        b = (a + 1) % count
        lines.append(f"f {a + 1} {b + 1} {b + count + 1} {a + count + 1}")
    return "\n".join(lines) + "\n"


PRIMITIVES = """<mujoco>
  <compiler angle="degree"/>
  <worldbody>
    <geom type="plane" size="1 1 1"/>
    <body name="trunk" pos="0 0 1" euler="10 20 30">
      <freejoint name="root"/>
      <geom type="box" size="0.1 0.2 0.3" pos="0.1 0 0.05" euler="20 0 50"/>
      <geom type="ellipsoid" size="0.1 0.2 0.15" pos="-0.2 0.1 0" density="700"/>
      <body name="wheel" pos="0.4 0 0" axisangle="1 1 0 40">
        <joint name="axle" axis="1 2 3" pos="0.01 0.02 0.03"/>
        <geom type="cylinder" size="0.1 0.02" mass="0.7"/>
        <geom type="cylinder" size="0.02" fromto="0 0 -0.1 0.05 0.1 0.1"/>
      </body>
      <body name="bar" pos="0 -0.4 0" xyaxes="0 1 0.2 -1 0.3 0">
        <joint name="shift" type="slide" axis="0 1 1"/>
        <geom type="box" size="0.03" fromto="0 0 0 0.1 0.2 0.3"/>
        <geom type="capsule" size="0.03" fromto="0 0 0 -0.1 0.2 0.3" mass="0.4"/>
        <body name="tip" pos="0 0 0.1" zaxis="1 2 3">
          <geom type="sphere" size="0.05" mass="0.1"/>
          <frame pos="0.1 0 0" euler="0 90 0">
            <geom type="ellipsoid" size="0.02" fromto="0 0 0 0.1 0 0.1"/>
          </frame>
        </body>
      </body>
      <body name="stated" pos="0 0.5 0">
        <joint name="twist" axis="0 0 1"/>
        <joint name="bend" axis="1 0 0" pos="0 0 0.1"/>
        <inertial pos="0.1 0.2 0.3" quat="1 0.5 0 0.2" mass="2" diaginertia="0.02 0.03 0.04"/>
        <geom type="sphere" size="0.1"/>
        <body name="full" pos="0 0 0.2">
          <inertial pos="0 0 0" mass="1" fullinertia="0.02 0.03 0.04 0.001 -0.002 0.003"/>
        </body>
      </body>
    </body>
  </worldbody>
</mujoco>
"""

CLASSES = """<mujoco>
  <compiler angle="radian" eulerseq="zYx" settotalmass="5"/>
  <default>
    <geom density="500" size="0.1"/>
    <default class="leg">
      <geom type="capsule" size="0.05 0.2"/>
      <joint axis="0 1 0"/>
      <default class="foot"><geom type="box" size="0.1 0.05 0.02" quat="1 0 0 1"/></default>
    </default>
  </default>
  <worldbody>
    <body name="base"><geom type="box" size="0.1 0.1 0.1"/>
      <body name="upper" childclass="leg" pos="0 0 1" euler="0.3 0.2 0.1">
        <joint name="hip"/>
        <geom/>
        <geom class="main" pos="0 0 0.3"/>
        <body name="lower" pos="0 0 0.5">
          <joint name="knee" class="main" axis="1 0 0"/>
          <geom class="foot"/>
          <geom class="foot" euler="0.1 0.2 0.3"/>
        </body>
      </body>
    </body>
  </worldbody>
</mujoco>
"""

MESHES = """<mujoco>
  <compiler meshdir="parts"/>
  <asset>
    <mesh file="trough.obj" scale="0.1 0.1 0.1"/>
    <mesh name="exact" file="trough.obj" scale="0.1 0.1 0.1" inertia="exact"/>
    <mesh name="convex" file="trough.obj" scale="0.1 -0.1 0.2" inertia="convex"/>
    <mesh name="points" vertex="0 0 0 0.1 0 0 0 0.2 0 0 0 0.3 0.02 0.02 0.02"/>
  </asset>
  <worldbody>
    <body name="a"><joint name="ja"/><geom type="mesh" mesh="trough" pos="0 0 0.1" quat="1 1 0 0"/></body>
    <body name="b"><joint name="jb"/><geom type="mesh" mesh="exact" density="300"/></body>
    <body name="c"><joint name="jc"/><geom type="mesh" mesh="convex" mass="2"/></body>
    <body name="d"><joint name="jd"/><geom type="mesh" mesh="points"/></body>
  </worldbody>
</mujoco>
"""

# Primitive shapes with the inertia box of a mesh.
FITTED = """<mujoco>
  <compiler meshdir="parts"/>
  <asset><mesh name="m" file="trough.obj" scale="0.1 0.1 0.1"/></asset>
  <default><geom mesh="m" pos="0 0 0.1" quat="1 1 0 0"/></default>
  <worldbody>
    <body name="a"><joint name="ja"/><geom type="box"/></body>
    <body name="b"><joint name="jb"/><geom type="capsule" density="300" fitscale="0.7"/></body>
    <body name="c"><joint name="jc"/><geom type="cylinder" mass="2"/></body>
    <body name="d"><joint name="jd"/><geom type="sphere"/></body>
    <body name="e"><joint name="je"/><geom type="ellipsoid" fitscale="2"/></body>
  </worldbody>
</mujoco>
"""

# An L, whose surface's centroid is outside its kernel, so that MuJoCo's "legacy" mass is not its volume.
BENT = """<mujoco>
  <asset>
    <mesh name="bent" vertex="0 0 0  .3 0 0  .3 .1 0  .1 .1 0  .1 .2 0  0 .2 0
      0 0 .1  .3 0 .1  .3 .1 .1  .1 .1 .1  .1 .2 .1  0 .2 .1"
      face="0 2 1 0 3 2 0 4 3 0 5 4 6 7 8 6 8 9 6 9 10 6 10 11 0 1 7 0 7 6 1 2 8 1 8 7 2 3 9 2 9 8
      3 4 10 3 10 9 4 5 11 4 11 10 5 0 6 5 6 11"/>
  </asset>
  <worldbody><body name="a"><joint name="j"/><geom type="mesh" mesh="bent"/></body></worldbody>
</mujoco>
"""

BOUNDS = """<mujoco>
  <compiler boundmass="0.5" boundinertia="0.002" inertiagrouprange="1 2"/>
  <worldbody>
    <body name="light"><joint name="a"/>
      <geom type="box" size="0.1 0.02 0.01" pos="0.1 0.2 0" euler="10 20 30" group="1"/>
      <geom size="0.1" group="3"/>
      <body name="empty" pos="0 0 0.3"><joint name="b"/></body>
      <body name="heavy" pos="0 0.3 0"><joint name="c"/><geom size="0.1" group="2"/></body>
    </body>
  </worldbody>
</mujoco>
"""

# Servos whose damping is stated by a damping ratio, on a chain with an armature and a slide.
SERVOS = """<mujoco>
  <compiler angle="radian"/>
  <worldbody>
    <body name="a"><joint name="turn" axis="0 1 1" armature="0.02" range="-1 2"/>
      <geom type="capsule" size="0.03" fromto="0 0 0 0.3 0 0.1"/>
      <body name="b" pos="0.3 0 0.1"><joint name="shift" type="slide" axis="1 0 0" range="-0.1 0.3"/>
        <geom type="box" size="0.05 0.03 0.02" pos="0.05 0 0"/>
        <body name="c" pos="0.1 0 0"><joint name="bend" axis="1 0 0" pos="0 0 0.1" range="-0.5 0.5"/>
          <geom size="0.04"/></body></body></body>
  </worldbody>
  <actuator>
    <position name="turn" joint="turn" kp="40" dampratio="0.7" inheritrange="0.9"/>
    <position name="shift" joint="shift" kp="500" dampratio="1" gear="2" ctrlrange="0 0.1"/>
    <general name="bend" joint="bend" gainprm="9" biastype="affine" biasprm="0.5 -9 0.6" ctrlrange="-1 1"/>
    <general name="bent" joint="bend" gainprm="3" biastype="affine" biasprm="0 0 -0.2" ctrlrange="-1 1"/>
  </actuator>
</mujoco>
"""

FILES = {"parts/trough.obj": trough()}
MODELS = {
    "primitives": PRIMITIVES,
    "classes": CLASSES,
    "meshes": MESHES,
    "fitted": FITTED,
    "bent": BENT,
    "bounds": BOUNDS,
    "servos": SERVOS,
}


def links(model, data, with_base=False):
    """Mass, world mass centre and principal moments of each moving body with the jointless bodies on it.

    With the base, the bodies that are fixed to the world are a link, too, with the name of the first one.
    """
    found = {}
    for body in range(1, model.nbody):
        home = body
        while home and model.body_jntnum[home] == 0:
            home = model.body_parentid[home]
        if home or with_base:
            found.setdefault(home, []).append(body)
    for home, bodies in found.items():
        mass = sum(model.body_mass[body] for body in bodies)
        centre = sum(model.body_mass[body] * data.xipos[body] for body in bodies) / mass
        inertia = numpy.zeros((3, 3))
        for body in bodies:
            turn, away = data.ximat[body].reshape(3, 3), data.xipos[body] - centre
            inertia += turn @ numpy.diag(model.body_inertia[body]) @ turn.T
            inertia += model.body_mass[body] * (away @ away * numpy.eye(3) - numpy.outer(away, away))
        yield {
            "name": model.body(home or bodies[0]).name,
            "mass": mass,
            "centre": centre.tolist(),
            "moments": sorted(numpy.linalg.eigvalsh(inertia).tolist()),
        }


def joints(model, data):
    for index in range(model.njnt):
        if mujoco.mjtJoint(model.jnt_type[index]) in (mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE):
            yield {
                "name": model.joint(index).name,
                "anchor": data.xanchor[index].tolist(),
                "axis": data.xaxis[index].tolist(),
            }


def motors(model):
    for index in range(model.nu):
        yield {
            "name": model.actuator(index).name,
            "joint": model.joint(model.actuator_trnid[index][0]).name,
            "gear": model.actuator_gear[index][0],
            "gain": model.actuator_gainprm[index][0],
            "bias": model.actuator_biasprm[index][:3].tolist(),
            "range": model.actuator_ctrlrange[index].tolist(),
        }


def moved(mjcf, velocities, controls, steps):
    """A motion from the rest pose: coordinates and velocities after the steps."""
    model = mujoco.MjModel.from_xml_string(mjcf)
    data = mujoco.MjData(model)
    data.qvel[: len(velocities)] = velocities
    data.ctrl[:] = controls
    mujoco.mj_step(model, data, steps)
    end = {"qpos": data.qpos.tolist(), "qvel": data.qvel.tolist()}
    return {"mjcf": mjcf, "velocities": velocities, "controls": controls, "steps": steps, **end}


def compiled(mjcf, files):
    assets = {pathlib.PurePath(name).name: text.encode() for name, text in files.items()}
    model = mujoco.MjModel.from_xml_string(mjcf, assets)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    parts = {"links": links(model, data), "joints": joints(model, data), "motors": motors(model)}
    return {name: list(part) for name, part in parts.items()}


def main():
    out = pathlib.Path(__file__).resolve().parents[2] / "sim" / "tests" / "data" / "mujoco-models.json"
    models = {name: {"mjcf": mjcf, **compiled(mjcf, FILES)} for name, mjcf in MODELS.items()}
    motions = {name: moved(*motion) for name, motion in MOTIONS.items()}
    document = {"mujoco": mujoco.__version__, "files": FILES, "models": models, "motions": motions}
    out.write_text(json.dumps(document, indent=1) + "\n")


if __name__ == "__main__":
    main()
