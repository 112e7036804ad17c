"""The models, starts and controls of the motions that mujoco_models.py records."""

ARM = """<mujoco>
  <compiler angle="radian"/>
  <option timestep="0.001"/>
  <worldbody>
    <body pos="0 0 1"{body}><joint name="j1" axis="0 1 0" damping="0.2"{joint}/>
      <geom type="capsule" fromto="0 0 0 0.3 0 0" size="0.02" mass="1" contype="0" conaffinity="0"/>
      <body pos="0.3 0 0"{body}><joint name="j2" axis="0 1 0" damping="0.1"/>
        <geom type="capsule" fromto="0 0 0 0.3 0 0" size="0.02" mass="0.5" contype="0" conaffinity="0"/>
      </body>
    </body>
  </worldbody>
  {sections}
</mujoco>
"""

FLIGHT = """<mujoco>
  <option timestep="0.001"/>
  <worldbody>
    <body pos="0 0 9"><joint name="root" type="free" damping="0.8" armature="0.3"{friction}/>
      <geom type="box" size="0.1 0.2 0.3" mass="2" pos="{place}"/></body>
  </worldbody>
</mujoco>
"""
# Two fingers on slides and a knuckle that they bend, without weight.
FINGERS = """<mujoco>
  <compiler angle="radian"/>
  <option timestep="0.001" gravity="0 0 0"/>
  <default><geom contype="0" conaffinity="0"/></default>
  <worldbody>
    <body pos="0 0.05 0"><joint name="l" type="slide" axis="0 1 0" damping="2"/><geom size=".02" mass=".1"/></body>
    <body pos="0 -0.05 0"><joint name="r" type="slide" axis="0 -1 0" ref="0.3" damping="1"/>
      <geom size=".02" mass=".2"/>
      <body><joint name="bend" axis="1 0 0" damping="0.01"/><geom size=".02" pos="0 0 .1" mass=".05"/></body></body>
  </worldbody>
  <tendon><fixed name="split"{tendon}><joint joint="l" coef="0.5"/><joint joint="r" coef="-1.5"/></fixed>
    <fixed name="other"><joint joint="bend" coef="0.2"/></fixed></tendon>
  {sections}
</mujoco>
"""
PULL = '<actuator><general tendon="split" gear="2" ctrlrange="-9 9"/></actuator>'
HOLD = """<actuator><position tendon="split" kp="30" dampratio="0.8" gear="3" ctrlrange="-1 1"/></actuator>"""

# A crank that moves a rocker by a coupler, whose end hangs on the rocker by one point; and a bob on the world.
FOUR_BARS = """<mujoco>
  <compiler angle="radian"/>
  <option timestep="0.001"/>
  <default><geom contype="0" conaffinity="0" type="capsule" size="0.02"/><joint axis="0 1 0" damping="0.1"/></default>
  <worldbody>
    <body name="crank" pos="0 0 1"><joint name="crank"/><geom fromto="0 0 0 0 0 .2" mass=".3"/>
      <body name="coupler" pos="0 0 .2"><joint name="coupler"/><geom fromto="0 0 0 .5 0 .1" mass=".2"/>
        <body name="tip" pos=".5 0 .1"><geom size=".03" fromto="0 0 0 .1 0 0" mass=".1"/></body></body></body>
    <body name="rocker" pos=".5 0 1"><joint name="rocker"/><geom fromto="0 0 0 0 0 .3" mass=".4"/></body>
    <body name="bob" pos="0 1 1"><joint name="bob"/><geom fromto="0 0 0 .3 0 0" mass=".4"/></body>
  </worldbody>
  <equality><connect body1="tip" body2="rocker" anchor="0 0 0"/>
    <connect body1="bob" anchor=".3 0 0" solref="0.1 0.7" solimp="0.5 0.9 0.02"/></equality>
  <actuator><motor joint="crank" ctrlrange="-9 9"/></actuator>
</mujoco>
"""

# A chain of two ball joints off the axes of their bodies: with a spring, dry friction and motors, and with a limit.
BALLS = """<mujoco>
  <compiler angle="radian"/>
  <option timestep="0.001" integrator="implicitfast"/>
  <default><geom contype="0" conaffinity="0" type="capsule" size="0.02"/></default>
  <worldbody>
    <body pos="0 0 1" euler="0.3 -0.5 0.2"><joint name="neck" type="ball" pos="0.02 0 0.1" damping="0.05" armature="0.01"
        stiffness="2" frictionloss="0.04"/><geom fromto="0 0 0 0.3 0.1 0" mass="0.5"/>
      <body pos="0.3 0.1 0" quat="1 0.5 -0.2 0.7"><joint name="tail" type="ball" damping="0.01"{limit}/>
        <geom fromto="0 0 0 0 0.2 0.1" mass="0.2"/>
        <body pos="0 0.2 0.1"><joint name="tip" axis="0 1 1" damping="0.01"/><geom fromto="0 0 0 0.1 0 0" mass="0.1"/>
        </body></body></body>
  </worldbody>
  <actuator><motor name="turn" joint="neck" gear="0.4 -0.2 0.3" ctrlrange="-9 9"/>
    <position name="hold" joint="tail" kp="0.4" kv="0.02" gear="0 2 0" ctrlrange="-1 1"/>
    <position name="lean" joint="tail" kp="0.2" gear="1 0 -1" ctrlrange="-1 1"/></actuator>
</mujoco>
"""

# Two bodies that a weld holds together and one that another holds to the world, all hit by the speeds at the start.
WELDS = """<mujoco>
  <compiler angle="radian"/>
  <option timestep="0.001"/>
  <default><geom contype="0" conaffinity="0" type="box" size="0.1 0.05 0.03"/></default>
  <worldbody>
    <body name="a" pos="0 0 1"><freejoint/><geom mass="1" pos="0.1 0 0"/>
      <body name="b" pos="0.2 0 0" euler="0 0.5 0"><joint name="j" axis="0 1 0" damping="0.1"/><geom mass="0.3"/>
        <body name="c" pos="0.1 0 0" euler="0.4 0 0"><geom mass="0.2"/></body></body></body>
    <body name="d" pos="0.5 0 1" quat="1 0.2 -0.4 0.3"><joint name="k" type="ball"/><geom mass="0.5" pos="0 0.1 0"/></body>
  </worldbody>
  <equality><weld body1="c" body2="d" anchor="-0.1 0 0.05" torquescale="0.2" {relpose}/>
    <weld body1="a" solref="0.05 0.8" solimp="0.5 0.9 0.02"/></equality>
  <actuator><motor joint="j" ctrlrange="-9 9"/></actuator>
</mujoco>
"""

# A tumbling body of several shapes with a fin, in a fluid that flows.
FLUID = """<mujoco>
  <compiler angle="radian"/>
  <option timestep="0.002" gravity="0 0 -1" {option}/>
  <worldbody>
    <body name="hull" pos="0 0 1"><freejoint name="root"/>
      <geom type="capsule" fromto="0 0 0 .3 .2 .1" size=".04"/>
      <body pos=".1 0 0"><geom type="box" size=".1 .02 .05" euler="0.4 0.2 0"/><geom size=".03" pos=".1 .1 0"/></body>
      <body name="fin" pos="-.1 0 0"><joint name="fin" axis="0 1 1" damping="0.01"/>
        <geom type="ellipsoid" pos="-.1 0 0" size=".1 .04 .01"/></body></body>
  </worldbody>
  <actuator><motor joint="fin" ctrlrange="-1 1"/></actuator>
</mujoco>
"""

# A body with a stated inertia, or of two shapes, whose moments are equal or not, in a fluid that flows.
DRONE = """<mujoco>
  <option timestep="0.002" density="{density}" viscosity="0.00002" wind="10 0 3"/>
  <worldbody>
    <body pos="0 0 1"><freejoint name="root"/>
      {parts}
      <body pos=".3 0 0"><joint name="j" axis="0 0 1"/>
        <geom type="capsule" fromto="0 0 0 .2 0 0" size=".02"/></body></body>
  </worldbody>
  <actuator><motor joint="j" ctrlrange="-1 1"/></actuator>
</mujoco>
"""
STATED = '<inertial pos="0 0 0" mass="2" diaginertia="{}" euler="30 40 50"/><geom size=".1" contype="0" conaffinity="0"/>'
FULL = '<frame euler="30 40 50"><inertial pos="0 0 0" mass="2" fullinertia="0.05 0.055 0.055 0 0 0.005"/></frame><geom size=".1"/>'
BALLS_APART = '<geom size=".06" pos=".1 .07 .04"/><geom size=".06" pos="-.1 -.07 -.04"/>'
TWO = '<geom type="cylinder" size=".05 .2" euler="30 40 50"/><geom size=".08" pos="0.05 0 0.02"/>'

# An arm, or a free robot, beside what is fixed to the world and counts for `settotalmass`.
TOTAL = """<mujoco>
  <compiler settotalmass="30"/>
  <worldbody>
    {fixed}
    {start}<geom type="box" size=".1 .2 .05"/>
      <body pos=".1 0 0"><joint name="j1" axis="0 1 0" damping=".3"/>
        <geom type="capsule" fromto="0 0 0 .3 0 0" size=".03"/></body></body>{end}
  </worldbody>
  <actuator><motor joint="j1" ctrlrange="-5 5"/></actuator>
</mujoco>
"""

# A chain that tumbles, swings into its limits and falls on the floor, with large steps.
TUMBLE = """<mujoco>
  <compiler angle="radian"/>
  <option timestep="0.01" integrator="RK4"/>
  <default><geom type="capsule" size=".04"/></default>
  <worldbody>
    <geom type="plane" size="9 9 1"/>
    <body name="trunk" pos="0 0 .4"><freejoint name="root"/><geom fromto="-.2 0 0 .2 0 0"/>
      <body name="leg" pos=".2 0 0"><joint name="hip" axis="0 1 1" range="-.4 .4" damping=".2" stiffness="3"/>
        <geom fromto="0 0 0 .1 0 -.3"/></body></body>
  </worldbody>
  <actuator><position joint="hip" kp="20" kv="0.5" ctrlrange="-1 1"/></actuator>
</mujoco>
"""

# A body on slides and a hinge in a plane, on all of which forces act.
PLANAR = """<mujoco>
  <compiler angle="radian"/>
  <option timestep="0.001"/>
  <default><geom contype="0" conaffinity="0" type="capsule" size="0.03"/></default>
  <worldbody>
    <body pos="0 0 1"><joint name="x" type="slide" axis="1 0 0"/><joint name="z" type="slide" axis="0 0 1"/>
      <joint name="turn" axis="0 1 0"/><geom fromto="-.1 0 0 .3 0 0" mass="1"/>
      <body pos=".3 0 0"><joint name="hip" axis="0 1 0" damping="0.02"/><geom fromto="0 0 0 .1 0 -.3" mass="0.4"/></body>
    </body>
  </worldbody>
  <tendon><fixed stiffness="20"><joint joint="x" coef="1"/><joint joint="hip" coef="0.1"/></fixed></tendon>
  <actuator><motor joint="z" gear="20" ctrlrange="-1 1"/><motor joint="turn" ctrlrange="-1 1"/></actuator>
</mujoco>
"""

SPIN = [1, 0, 0.5, 0.4, -0.3, 0.2]

# Motions: a model, its velocities at the start, constant controls, and physics steps.
MOTIONS = {
    "damped flight": (FLIGHT.format(friction="", place="0 0 0"), SPIN, [], 500),
    "damped flight off centre": (FLIGHT.format(friction="", place="0.1 0 0.05"), SPIN, [], 500),
    "flight with dry friction": (
        FLIGHT.format(friction=' frictionloss="0.3"', place="0 0 0"), [1, 0, 0.5, 0, 0, 0], [], 500),
    "half the weight": (
        ARM.format(body=' gravcomp="0.5"', joint="", sections=""), [], [], 300),
    "limit with a margin": (
        ARM.format(body="", joint=' range="-1 0.2" margin="0.15"', sections=""), [], [], 2000),
    "equal joints": (
        FINGERS.format(tendon="", sections=PULL + '<equality><joint joint1="l" joint2="r"/></equality>'),
        [], [0.6], 500),
    "a polynomial of a joint": (
        FINGERS.format(tendon="", sections=PULL + """<equality><joint joint1="bend" joint2="l"
          polycoef="0.1 2 -3 4 5" solref="0.05 0.8" solimp="0.5 0.9 0.02 0.4 3"/></equality>"""),
        [], [0.6], 500),
    "a held joint": (
        FINGERS.format(tendon="", sections=PULL + '<equality><joint joint1="r" polycoef="0.05"/></equality>'),
        [], [0.6], 500),
    "equal tendons": (
        FINGERS.format(tendon="", sections=PULL + """<equality>
          <tendon tendon1="split" tendon2="other" polycoef="0.01 0.5 0 0 0"/></equality>"""), [], [0.1], 500),
    "a tendon with a spring and a limit": (
        FINGERS.format(tendon=' stiffness="4" damping="0.5" springlength="-0.3" range="-0.6 -0.40" margin="0.01"',
                       sections=PULL), [], [0.7], 500),
    "a tendon on a joint whose motors have a limit": (
        FINGERS.format(tendon=' stiffness="4" springlength="-0.9"', sections=PULL).replace(
            "<joint ", '<joint actuatorfrcrange="-0.2 0.2" ', 1), [], [0.7], 500),
    "a tendon with dry friction": (
        FINGERS.format(tendon=' frictionloss="0.4"', sections=PULL), [], [0.6], 500),
    "a servo of a tendon": (FINGERS.format(tendon="", sections=HOLD), [], [-0.9], 500),
    "a body in a fluid": (FLUID.format(option='density="900" viscosity="0.3" wind="1 -2 0.5"'),
                          [0.5, 0, 1, 2, -3, 4, 5], [0.05], 300),
    "a body in honey": (FLUID.format(option='viscosity="8"'), [0.5, 0, 1, 2, -3, 4, 5], [0.05], 300),
    **{f"an inertia of {moments} in air": (
        DRONE.format(density="1.2", parts=STATED.format(moments)), [0.5, 0, 1, 2, -3, 4, 5], [0.3], 250)
       for moments in ("0.06 0.05 0.05", "0.05 0.05 0.05", "0.05 0.05 0.06", "0.04 0.05 0.06")},
    "a stated inertia in water": (
        DRONE.format(density="1000", parts=STATED.format("0.06 0.05 0.05")), [0.5, 0, 1, 2, -3, 4, 5], [0.3], 100),
    **{f"{name} in water": (DRONE.format(density="1000", parts=parts), [0.5, 0, 1, 2, -3, 4, 5], [0.3], 100)
       for name, parts in (("a full inertia", FULL), ("two balls", BALLS_APART))},
    "two shapes in water": (DRONE.format(density="1000", parts=TWO), [0.5, 0, 1, 2, -3, 4, 5], [0.3], 100),
    "a total mass with a table": (
        TOTAL.format(fixed='<body pos="3 0 .5"><geom type="box" size=".3 .3 .5" mass="20"/></body>',
                     start='<body pos="0 0 1"><freejoint name="root"/>', end=""), [], [5], 150),
    "a total mass with a base that has no shape": (
        TOTAL.format(fixed="", start='<body><inertial pos="0 0 0" mass="20" diaginertia="1 1 1"/>'
                     '<body pos="0 0 1"><joint name="j0" axis="0 0 1"/>', end="</body>"), [], [5], 150),
    "a step of Runge and Kutta": (TUMBLE, [0.3, 0.2, 0, 4, -3, 5, 2], [0.9], 40),
    "four bars": (FOUR_BARS, [], [0.3], 350),
    "ball joints": (BALLS.format(limit=""), [1, -2, 3, 2, 0.5, -1, 1], [0.5, 0.3, -0.4], 400),
    "a limit of a ball joint": (
        BALLS.format(limit=' range="0 0.4" margin="0.05" solreflimit="0.05 0.9"'),
        [1, -2, 3, 2, 0.5, -1, 1], [0.5, 0.3, -0.4], 400),
    "a servo of a ball joint that turns the shorter way": (
        BALLS.format(limit="").replace('gear="0 2 0"', 'gear="0 0.2 0.1"'), [1, -2, 3, 2, 0.5, -1, 1], [0.5, 0.9, -0.4], 300),
    "implicit speed terms of a ball joint": (
        BALLS.format(limit="").replace('kp="0.2" gear', 'kp="0.2" kv="0.3" gear').replace('"0.001"', '"0.004"'),
        [1, -2, 3, 2, 0.5, -1, 1], [0.5, 0.3, -0.4], 75),
    "implicit damping of tendons": (
        FINGERS.format(tendon=' damping="20" stiffness="30"', sections=HOLD.replace("30", "60").replace("0.8", "2")).replace(
            'timestep="0.001"', 'timestep="0.004" integrator="implicitfast"'), [], [0.8], 75),
    "welds": (WELDS.format(relpose=""), [*SPIN, 2, 3, -2, 1], [0.5], 300),
    "a weld in another pose": (
        WELDS.format(relpose='relpose="0.3 0.02 0.1 1 0.1 -0.3 0.2" solref="0.1 1"'), [*SPIN, 2, 3, -2, 1], [0.5], 300),
    "a connection and a weld of sites": (
        WELDS.replace('mass="0.2"/>', 'mass="0.2"/><site name="p" pos="0.1 0.02 0" euler="0.2 0 0.1"/>')
        .replace('pos="0 0.1 0"/>', 'pos="0 0.1 0"/><site name="q" pos="-0.1 0 0.05"/>')
        .replace('<weld body1="c" body2="d" anchor="-0.1 0 0.05" torquescale="0.2" {relpose}/>', '<weld site1="p" site2="q" torquescale="0.2" solref="0.1 1"/>')
        .replace('<weld body1="a" solref="0.05 0.8" solimp="0.5 0.9 0.02"/>', '<connect site1="o" site2="s"/>')
        .replace('<body name="a"', '<site name="s" pos="0.02 0 1.1"/><body name="a"')
        .replace('<freejoint/>', '<freejoint/><site name="o" pos="0 0 0.1"/>'), [*SPIN, 2, 3, -2, 1], [0.5], 300),
    "a weld to a mocap body": (
        WELDS.format(relpose="").replace('<weld body1="a"', '<weld body1="m" body2="a"')
        .replace('<body name="a"', '<body name="m" mocap="true" pos="0.1 0 1.2"/><body name="a"'), [*SPIN, 2, 3, -2, 1], [0.5], 300),
    "activations": (
        ARM.format(body="", joint="", sections="""<actuator>
          <position joint="j1" kp="20" timeconst="0.1" ctrlrange="-1 1"/>
          <general joint="j1" dyntype="filter" dynprm="0.05" gainprm="3" ctrlrange="-1 1"/>
          <general joint="j2" dyntype="integrator" actrange="-0.2 0.1" actearly="true" gainprm="10" biastype="affine"
            biasprm="0 -10 -0.5" ctrlrange="-1 1"/></actuator>"""), [], [0.5, -0.3, 0.8], 300),
    "activations in a step of Runge and Kutta": (
        ARM.format(body="", joint="", sections="""<actuator>
          <position joint="j1" kp="20" timeconst="0.05" ctrlrange="-1 1"/>
          <general joint="j1" dyntype="filter" dynprm="0.02" gainprm="3" actearly="true" ctrlrange="-1 1"/>
          <general joint="j2" dyntype="integrator" actrange="-0.2 0.1" gainprm="10" biastype="affine" biasprm="0 -10 0"
            ctrlrange="-1 1"/></actuator>""").replace('"0.001"', '"0.005" integrator="RK4"'), [], [0.5, -0.3, 0.8], 60),
    "joints with a spring and damper": (
        BALLS.format(limit=' springdamper="0.2 0.3"').replace('axis="0 1 1"', 'axis="0 1 1" springdamper="0.5 0.7"'),
        [1, -2, 3, 2, 0.5, -1, 1], [0.5, 0.3, -0.4], 400),
    "forces on a planar root": (PLANAR, [0.3, 0, 1, -2], [0.8, 0.3], 400),
    "two actuators": (
        ARM.format(body="", joint="", sections="""<actuator>
          <position joint="j1" kp="20" ctrlrange="-1 1"/><velocity joint="j1" kv="1" ctrlrange="-1 1"/>
          <motor joint="j2" ctrlrange="-1 1"/></actuator>"""), [], [0.5, -0.3, 0.4], 300),
}
