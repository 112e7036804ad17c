"""Writes sim/tests/data/mujoco-contacts.json: how small models with contacts, limits and dry friction move in MuJoCo.

    python -m venv venv && venv/bin/pip install mujoco==4.0.0
    venv/bin/python tests/reference/mujoco_contacts.py
"""

import json
import pathlib

import mujoco

STEPS = [50, 150, 300, 500]
FLOOR = '<geom name="floor" type="plane" size="1 1 1" {floor}/>'


def document(bodies, option="", floor="", sections=""):
    return (
        f'<mujoco><compiler angle="radian"/><option timestep="0.002" {option}/>{sections}\n'
        f"<worldbody>{FLOOR.format(floor=floor)}\n{bodies}</worldbody></mujoco>"
    )


def ball(geom, option="", height=0.1):
    body = (
        f'<body pos="0 0 {height}"><freejoint name="root"/><geom size="0.1" mass="10" {geom}/></body>'
    )
    return document(body, option, geom)


def block(option, feet="", angle=0.35, speed=""):
    """A block on four spherical feet on a slope."""
    places = [(x, y) for x in (-0.1, 0.1) for y in (-0.1, 0.1)]
    spheres = "".join(f'<geom size="0.02" pos="{x} {y} -0.03" mass="0" {feet}/>' for x, y in places)
    body = (
        '<body pos="0.0171 0 0.047" euler="0 0.35 0"><freejoint name="root"/>'
        '<geom type="box" size="0.1 0.1 0.03" mass="10" contype="0" conaffinity="0"/>'
        f"{spheres}</body>"
    )
    return document(body, option, f'euler="0 {angle} 0"')


def arm(joint, option=""):
    """An arm that falls from level."""
    body = (
        f'<body pos="0 0 2"><joint axis="0 1 0" {joint}/>'
        '<geom type="capsule" size="0.03" fromto="0 0 0 0.5 0 0" mass="1"/>'
        f'<body pos="0.5 0 0"><joint axis="0 1 0" {joint}/>'
        '<geom type="capsule" size="0.02" fromto="0 0 0 0.3 0 0" mass="0.4"/></body></body>'
    )
    return document(body, option)


CAPSULE = (
    '<body pos="0 0 0.3" euler="0.3 0.4 0.5"><freejoint name="root"/>'
    '<geom type="capsule" size="0.05 0.2" density="500"/>'
    '<body pos="0 0 0.2"><joint axis="1 0 0" damping="0.05" range="-1 1"/>'
    '<geom type="capsule" size="0.03" fromto="0 0 0 0 0.3 0" density="500"/>'
    '<body pos="0 0.3 0"><geom size="0.04" density="300"/></body></body></body>'
)
SOFT = "0.015 1 0.031"


def wheel(height, joint=""):
    """A ball on a hinge through its centre, of which contacts feel no inverse mass in the rest pose."""
    return f'<body pos="0 0 {height}"><joint axis="0 1 0" {joint}/><geom size="0.1"/></body>'


SPRUNG = 'stiffness="0.5" springref="1"'
CUBE = " ".join(f"{x} {y} {z}" for x in (-0.2, 0.2) for y in (-0.2, 0.2) for z in (-0.1, 0.1))
FIELD = (
    '<asset><hfield name="field" nrow="5" ncol="4" size="0.6 0.5 0.1 0.1"'
    ' elevation="0 0 2 4 0 0 1 3 0 0 0 2 1 0 0 1 2 1 0 0"/></asset>'
)
DEEP = 'solref="0.1 1"'
MESH = f'<asset><mesh name="cube" vertex="{CUBE}"/></asset>'


def on(ground, body, option="", sections=""):
    """A free body on a shape that is fixed to the world."""
    return document(f'{ground}<body pos="0 0 0.35"><freejoint name="root"/>{body}</body>', option, "", sections)


def in_air(place, shape, option=""):
    """A free body at a height field that is high above the floor."""
    return above('<geom type="hfield" hfield="field" pos="0 0 1"/>', place, shape, option, FIELD)


def above(ground, place, shape, option="", sections=""):
    """A free body at a place."""
    return document(f"{ground}<body {place}><freejoint/>{shape}</body>", option, "", sections)


EGG = '<geom type="ellipsoid" size="0.15 0.1 0.05" pos="0 0 1"/>'
DRUM = '<geom type="cylinder" size="0.1 0.1" pos="0 0 1" euler="0.8 0.2 0"/>'
ROD = '<geom type="capsule" size="0.04 0.1" mass="1"/>'

FINGER = (
    '<body name="palm" pos="0 0 1"><joint name="a" axis="0 1 0" damping="0.1"/>'
    '<geom name="palm" type="capsule" size="0.03" fromto="0 0 0 0.3 0 0" mass="1"/>'
    '<body name="middle" pos="0.3 0 0"><joint name="b" axis="0 1 0" damping="0.05"/>'
    '<geom name="middle" type="capsule" size="0.02" fromto="0 0 0 0.1 0 0.1" mass="0.1"/>'
    '<body name="tip" pos="0.1 0 0.1"><joint name="c" axis="0 1 0" damping="0.02" stiffness="2" springref="-3"/>'
    '<geom name="tip" size="0.03" pos="-0.1 0 0.05" mass="0.2" {tip}/></body></body></body>'
)

# Name: the document, and velocities at the start.
MODELS = {
    "soft ball": (ball(f'condim="1" solimp="{SOFT}"'), None),
    "softer ball": (ball('condim="1" solimp="0.2 0.2 0.001"'), None),
    "ball on a curve of power 3": (ball('condim="1" solimp="0.1 0.99 0.02 0.3 3"'), None),
    "ball on a linear curve": (ball('condim="1" solimp="0.1 0.99 0.02 0.5 1"'), None),
    "ball without a width": (ball('condim="1" solimp="0.2 0.8 0"'), None),
    "sprung wheel in the floor": (document(wheel(0.05, SPRUNG)), None),
    "wheel that turns in the floor": (document(wheel(0.05), 'cone="elliptic"'), [2]),
    "wheels that touch": (document(wheel(1, SPRUNG) + wheel(1.15)), None),
    "underdamped ball": (ball('condim="1" solref="0.04 0.3"'), None),
    "ball with a stated stiffness": (ball('condim="1" solref="-3000 -20"'), None),
    "ball with a margin": (ball('condim="1" margin="0.005"', height=0.12), None),
    "dropped ball": (ball('condim="1"', height=0.25), None),
    "ball that spins and rolls": (
        ball('condim="6" friction="0.6 0.05 0.02"', height=0.0999),
        [0.5, 0.2, 0, 1, 2, 5],
    ),
    "ball that spins in an elliptic cone": (
        ball('condim="4" friction="0.6 0.05 0.02"', 'cone="elliptic"', height=0.0999),
        [0.5, 0.2, 0, 1, 2, 5],
    ),
    "block on a slope": (block(""), None),
    "block with impratio": (block('impratio="100"'), None),
    "block in an elliptic cone": (block('cone="elliptic" impratio="10"'), None),
    "block that slides": (block("", 'friction="0.2"').replace("<geom name", '<geom friction="0.2" name'), None),
    "block that slides in an elliptic cone": (
        block('cone="elliptic"', 'friction="0.2"').replace("<geom name", '<geom friction="0.2" name'),
        [0, 0.5, 0, 0, 0, 0],
    ),
    "capsules": (document(CAPSULE), None),
    "capsules with the Runge-Kutta integrator": (document(CAPSULE, 'integrator="RK4"'), None),
    "ball on a box": (on('<geom type="box" size="0.2 0.2 0.1" pos="0 0 0.1"/>', '<geom size="0.1" mass="2"/>'), [0.3]),
    "ball on a cylinder": (
        on('<geom type="cylinder" size="0.2 0.1" pos="0 0 0.1"/>', '<geom size="0.1" mass="2"/>'),
        [0.3],
    ),
    "ball on a mesh": (on('<geom type="mesh" mesh="cube" pos="0 0 0.1"/>', '<geom size="0.1" mass="2"/>', "", MESH), [0.3]),
    "ball on a capsule": (
        on('<geom type="capsule" size="0.2" fromto="-1 0 0 1 0 0"/>', '<geom size="0.1" pos="0 0.01 0" mass="2"/>'),
        None,
    ),
    "box on a box": (
        on('<geom type="box" size="0.2 0.2 0.1" pos="0 0 0.1"/>', '<geom type="box" size="0.1 0.05 0.1" mass="2"/>'),
        [0.3],
    ),
    "box with a margin on a box far away": (
        above(
            '<geom type="box" size="0.2 0.2 0.1" pos="3 4 0.1" margin="0.004"/>',
            'pos="3 4.02 0.305"',
            '<geom type="box" size="0.1 0.05 0.1" mass="2" margin="0.004"/>',
        ),
        [0.3],
    ),
    "capsule on a box": (
        on(
            '<geom type="box" size="0.4 0.4 0.1" pos="0 0 0.1"/>',
            '<geom type="capsule" size="0.1" fromto="-0.1 0 0 0.1 0 0" mass="2"/>',
        ),
        [0, 0.3],
    ),
    "ball on a height field": (
        on('<geom type="hfield" hfield="field" pos="0 0 0.2"/>', '<geom size="0.1" pos="0.05 0.02 0" mass="2"/>', "", FIELD),
        None,
    ),
    "box on a height field": (
        on(
            '<geom type="hfield" hfield="field" pos="0 0 0.2"/>',
            '<geom type="box" size="0.1 0.05 0.05" pos="0.1 0 0.1" mass="2"/>',
            "",
            FIELD,
        ),
        None,
    ),
    "ball that sinks deep into a height field": (
        in_air('pos="0.1 0.06 1.25"', f'<geom size="0.02" density="5000" {DEEP}/>'),
        [0, 0, -1],
    ),
    "ball at the side of a height field": (
        in_air('pos="0.71 0 0.95"', '<geom size="0.1" mass="1"/>', 'gravity="-3 0 0"'),
        None,
    ),
    "ball on an ellipsoid": (
        above(
            '<geom type="ellipsoid" size="0.15 0.1 0.05" pos="0 0 1"/>',
            'pos="0.05 0.02 1.12"',
            '<geom size="0.06" mass="1"/>',
        ),
        None,
    ),
    "ball on a tilted cylinder": (
        above(
            '<geom type="cylinder" size="0.1 0.1" pos="0 0 1" euler="0.8 0.2 0"/>',
            'pos="0.02 0.01 1.22"',
            '<geom size="0.06" mass="1"/>',
        ),
        None,
    ),
    "capsule on an ellipsoid": (above(EGG, 'pos="0.05 0.02 1.12" euler="0 1.4 0.3"', ROD), None),
    "capsule on a tilted cylinder": (above(DRUM, 'pos="0.02 0.01 1.22" euler="0 1.4 0.3"', ROD), None),
    "cylinder on an ellipsoid": (above(EGG, 'pos="0.03 0.02 1.16" euler="0.8 0.4 0.3"', ROD.replace("capsule", "cylinder")), None),
    "capsule on a height field": (in_air('pos="0.12 0.06 1.2" euler="0.5 1.2 0.3"', ROD), None),
    "bar of a mesh on the floor": (
        above(
            "",
            'pos="0 0 0.3" euler="0 0.14 0"',
            '<geom type="mesh" mesh="cube" solref="0.06 1"/>',
            "",
            MESH,
        ),
        None,
    ),
    "pendulum on a box": (
        document(
            '<geom type="box" size="0.2 0.2 0.1" pos="0 0 0.1"/><body pos="-0.15 0 0.4"><joint axis="0 1 0"/>'
            '<geom type="capsule" size="0.03" fromto="0 0 0 0.2 0 0" mass="1"/></body>'
        ),
        None,
    ),
    "box with ends in a turned frame": (
        document(
            '<body pos="0 0 0.3"><freejoint name="root"/><frame euler="0.5 0.3 0.9" pos="0 0 0.1">'
            '<geom type="box" size="0.05" fromto="0 0 0 0.2 0.1 0.05"/></frame></body>'
        ),
        None,
    ),
    "weight on a slide": (
        document(
            '<body pos="0 0 0.12"><joint type="slide" axis="0 0 1"/><geom size="0.1" mass="3" solref="0.1 1"/></body>'
            '<body pos="1 0 0.12"><joint type="slide" axis="0 0 1"/><geom size="0.1" mass="3" solref="0.1 1"/>'
            '<geom size="0.05" mass="1" pos="0.1 0 0"/></body>'
        ),
        None,
    ),
    "ball between two planes": (
        on('<geom type="plane" size="1 1 1" pos="-0.05 0 0.1" euler="0 1 0"/>', '<geom size="0.1" mass="2"/>'),
        None,
    ),
    "block with a pair": (
        block("", 'name="f"')
        .replace('name="f"', 'name="f1"', 1)
        .replace('name="f"', 'name="f2"', 1)
        .replace('name="f"', 'name="f3"', 1)
        .replace('name="f"', 'name="f4"', 1)
        .replace(
            "</mujoco>",
            '<contact><pair geom1="f1" geom2="floor" friction="0.1 0.1"/>'
            '<pair geom1="floor" geom2="f3" condim="1" solref="0.05 1" margin="0.001"/></contact></mujoco>',
        ),
        None,
    ),
    **{
        f"box with a pair of {stated or 'defaults'}": (
            document(
                '<body pos="0 0 .1"><freejoint name="f"/><geom name="g" type="box" size=".1 .1 .1" contype="0" conaffinity="0"'
                ' friction="0.4 0.1 0.01" solref="0.05 2" solimp="0.5 0.6 0.01" condim="1" priority="1"/></body>',
                'gravity="3 5 -9"',
                'friction="0.4 0.1 0.01"',
                f'<contact><pair geom1="g" geom2="floor" {stated}/></contact>',
            ),
            None,
        )
        for stated in ("", 'friction="0.3"', 'solref="0.05"', 'solimp="0.6 0.7"')
    },
    "ball with a margin and a pair without one": (
        document(
            '<body pos="0 0 0.12"><freejoint/><geom name="b" size="0.1" mass="10" margin="0.02"/></body>',
            "",
            "",
            '<contact><pair geom1="b" geom2="floor"/></contact>',
        ),
        None,
    ),
    "finger on its palm": (document(FINGER.format(tip="")), None),
    "finger through its palm": (
        document(FINGER.format(tip=""), "", "", '<contact><exclude body1="tip" body2="palm"/></contact>'),
        None,
    ),
    "finger with a pair": (
        document(
            FINGER.format(tip='contype="0" conaffinity="0"'),
            "",
            "",
            '<contact><pair geom1="tip" geom2="palm" friction="0.2 0.2"/></contact>',
        ),
        None,
    ),
    "limits": (arm('range="-0.4 0.5" damping="0.2"'), None),
    "soft limits": (arm('range="-0.4 0.5" solimplimit="0.1 0.9 0.2" solreflimit="0.05 0.7"'), None),
    "dry friction": (arm('frictionloss="1.5"'), None),
    "soft dry friction": (arm('frictionloss="6" solimpfriction="0.3 0.3 1" damping="0.1"'), None),
}


def coordinates(mjcf, speeds):
    model = mujoco.MjModel.from_xml_string(mjcf)
    data = mujoco.MjData(model)
    if speeds:
        data.qvel[: len(speeds)] = speeds
    found = []
    for step in range(1, STEPS[-1] + 1):
        mujoco.mj_step(model, data)
        if step in STEPS:
            found.append(data.qpos.tolist())
    return found


def main():
    out = pathlib.Path(__file__).resolve().parents[2] / "sim" / "tests" / "data" / "mujoco-contacts.json"
    models = {
        name: {"mjcf": mjcf, "speeds": speeds or [], "coordinates": coordinates(mjcf, speeds)}
        for name, (mjcf, speeds) in MODELS.items()
    }
    document = {"mujoco": mujoco.__version__, "steps": STEPS, "models": models}
    out.write_text(json.dumps(document, indent=1) + "\n")


if __name__ == "__main__":
    main()
