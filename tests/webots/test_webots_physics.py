"""Physics of worlds against closed forms, within 1 % at steps of 8 ms.

Nodes and fields, as a supervisor reads and sets them.
"""

from __future__ import annotations

import math

import pytest

from deepbots_webots.scene import build_scene
from deepbots_webots.sensors import NotImplementedCallError
from deepbots_webots.simulation import Simulation
from deepbots_webots.supervisor import Supervisor, activate, deactivate
from deepbots_webots.tree import Field, Node
from tests.webots.exported_projects import (
    FLOOR,
    HEADER,
    ROD_INERTIA,
    device,
    enu,
    hinge,
    node,
    read,
    run,
    simulate,
    solid,
    turning,
)


@pytest.fixture(params=["ENU", "NUE"])
def axes(request: pytest.FixtureRequest) -> str:
    return request.param


def test_a_supervisor_sets_gravity(axes: str):
    simulation = simulate(solid("Box { }"), axes=axes, gravity=0)
    info = Node(simulation, next(entry for entry in simulation.scene.nodes if entry.type == "WorldInfo"))
    info.getField("gravity").setSFFloat(2)
    run(simulation, 1)
    assert enu(node(simulation, "BODY").getVelocity(), axes)[2] == pytest.approx(-2, rel=0.01)
    assert info.getField("gravity").getSFFloat() == 2


def test_a_pendulum_swings_with_its_period(axes: str):
    text = hinge(
        end="rotation 0 1 0 1.4708 boundingObject Pose { translation 0.5 0 0 children [ Box { size 1 0.02 0.02 } ] }"
    )
    simulation = simulate(text, axes=axes)
    times = []
    before = None
    for step in range(1000):
        simulation.run_step()
        now = enu(node(simulation, "ROD").getVelocity(), axes)[4]
        if before is not None and before < 0 <= now:
            times.append(step * 0.008 + 0.008 * before / (before - now))
        before = now
    period = (times[-1] - times[0]) / (len(times) - 1)
    small = 2 * math.pi * math.sqrt(ROD_INERTIA / (2 * 9.81 * 0.5))
    assert period == pytest.approx(small * (1 + 0.1**2 / 16), rel=0.01)


def test_two_materials_have_the_friction_of_their_pair():
    text = (
        'Solid { contactMaterial "ice" boundingObject Plane { } }'
        + solid(
            "Box { size 0.2 0.2 0.1 }", 'contactMaterial "wood" translation 0 0 0.05 linearVelocity 1 0 0'
        )
        + solid("Box { size 0.2 0.2 0.1 }", "translation 0 1 0.05 linearVelocity 1 0 0", name="OTHER")
    )
    pair = '[ ContactProperties { material1 "wood" material2 "ice" coulombFriction 0.1 bounce 0 } ]'
    simulation = simulate(text, contactProperties=pair)
    run(simulation, 1.5)
    # Steps of 8 ms whose velocity changes before the position: v^2 / (2 mu g) - v h / 2.
    for name, friction in (("BODY", 0.1), ("OTHER", 1.0)):
        distance = 1 / (2 * friction * 9.81) - 0.008 / 2
        assert node(simulation, name).getPosition()[0] == pytest.approx(distance, rel=0.03)


@pytest.mark.parametrize(
    ("motor", "step", "command", "seconds", "velocity"),
    [
        pytest.param("RotationalMotor { maxTorque 1000 }", 8, 3, 0.008, 3, id="in one step"),
        pytest.param("RotationalMotor { maxTorque 1000 }", 32, 3, 0.032, 3, id="in one step of 32 ms"),
        pytest.param(
            "RotationalMotor { maxTorque 1e6 acceleration 4 }", 8, 8, 1, 4, id="by its acceleration"
        ),
        pytest.param(
            "LinearMotor { maxForce 3 maxVelocity 1000 }", 8, 1000, 0.8, 3 / 2 * 0.8, id="along its axis"
        ),
    ],
)
def test_a_motor_reaches_its_velocity(
    axes: str, motor: str, step: int, command: float, seconds: float, velocity: float
):
    is_linear = motor.startswith("Linear")
    text = hinge(devices=motor, kind="SliderJoint" if is_linear else "HingeJoint")
    simulation = simulate(text, step, axes, gravity=0)
    turning(simulation, command, "linear motor" if is_linear else "rotational motor")
    run(simulation, seconds)
    reached = enu(node(simulation, "ROD").getVelocity(), axes)[0 if is_linear else 4]
    assert reached == pytest.approx(velocity, rel=0.01)


def position(simulation: Simulation) -> float:
    return node(simulation, "JOINT").getField("position").getSFFloat()


def angle(simulation: Simulation) -> float:
    """The angle of the rod, rad."""
    return turn(simulation, "ROD")[0]


def turn(simulation: Simulation, name: str) -> tuple[float, float]:
    """The angles of a solid about y and z in its robot, rad."""
    x, y, z = node(simulation, name).getPose(node(simulation, "ROBOT"))[0:12:4]
    return math.atan2(-z, math.hypot(x, y)), math.atan2(y, x)


@pytest.mark.parametrize(
    ("text", "info", "seconds", "read", "expected"),
    [
        pytest.param(
            hinge("position 0.3", "RotationalMotor { maxTorque 100 }"),
            {},
            1,
            position,
            pytest.approx(0.3, abs=1e-3),
            id="a motor without commands keeps it",
        ),
        pytest.param(
            hinge(devices="RotationalMotor { maxTorque 5 }"),
            {},
            0.24,
            position,
            # Near the horizontal.
            pytest.approx((2 * 9.81 * 0.5 - 5) / ROD_INERTIA * 0.24**2 / 2, rel=0.04),
            id="a motor too weak for its load gives way",
        ),
        pytest.param(
            hinge("position 0.2 springConstant 32", kind="SliderJoint"),
            {},
            2 * math.pi * math.sqrt(2 / 32) / 2,
            position,
            pytest.approx(-0.2, rel=0.01),
            id="a spring swings with its period",
        ),
        pytest.param(
            hinge("minStop -0.4 maxStop 0.4"), {}, 3, position, pytest.approx(0.4, abs=0.01), id="stops"
        ),
        pytest.param(
            hinge("position 0.5 springConstant 1000 dampingConstant 50"),
            {"gravity": 0},
            3,
            angle,
            pytest.approx(-0.5, abs=1e-3),
            id="the position in a file is that of the pose in it",
        ),
    ],
)
def test_a_joint_is_where_mechanics_has_it(
    axes: str, text: str, info: dict, seconds: float, read, expected: object
):
    simulation = simulate(text, axes=axes, **info)
    run(simulation, seconds)
    assert read(simulation) == expected


def test_a_position_is_approached_by_the_gain_and_within_the_velocity():
    text = hinge(devices="RotationalMotor { maxTorque 1e6 maxVelocity 2 controlPID 5 0 0 }")
    simulation = simulate(text, gravity=0)
    device(simulation, "rotational motor").setPosition(1.0)
    run(simulation, 0.2)
    position = node(simulation, "JOINT").getField("position")
    assert position.getSFFloat() == pytest.approx(0.4, rel=0.01)  # at 2 rad/s
    run(simulation, 0.1)  # to 0.6, from where on the gain asks for less
    assert position.getSFFloat() == pytest.approx(0.6, rel=0.02)
    run(simulation, 0.4)
    assert 1 - position.getSFFloat() == pytest.approx(0.4 * math.exp(-5 * 0.4), rel=0.1)


def test_damping_slows_exponentially(axes: str):
    text = hinge("dampingConstant 4", "RotationalMotor { maxTorque 1e6 }")
    simulation = simulate(text, axes=axes, gravity=0)
    motor = turning(simulation, 3)
    simulation.run_step()
    motor.setTorque(0)
    run(simulation, 0.2)
    left = 3 * math.exp(-4 / ROD_INERTIA * 0.2)
    assert enu(node(simulation, "ROD").getVelocity(), axes)[4] == pytest.approx(left, rel=0.03)


@pytest.mark.parametrize(("own", "default", "left"), [("linear 0.5", "", 0.5), ("", "linear 0.4", 0.6)])
def test_a_body_loses_its_share_of_velocity_per_second(own: str, default: str, left: float):
    damping = f"damping Damping {{ {own} }}" if own else ""
    body = f"DEF BODY Solid {{ linearVelocity 2 0 0 physics Physics {{ density -1 mass 1 {damping} }} }}"
    simulation = simulate(body, gravity=0, defaultDamping=f"Damping {{ {default} }}" if default else "NULL")
    run(simulation, 1)
    assert node(simulation, "BODY").getVelocity()[0] == pytest.approx(2 * left, rel=0.01)


def test_a_ball_joint_turns_about_all_axes(axes: str):
    text = """DEF ROBOT Robot { children [ BallJoint { jointParameters BallJointParameters { anchor 0 0 0 }
      endPoint DEF ROD Solid { boundingObject Pose { translation 0.5 0 0 children [ Box { size 1 0.02 0.02 } ] }
      physics Physics { density -1 mass 2 } } } ] }"""
    simulation = simulate(text, axes=axes)
    run(simulation, 0.2)
    angle = 2 * 9.81 * 0.5 / ROD_INERTIA * 0.2**2 / 2
    assert node(simulation, "ROD").getPosition() == pytest.approx([0, 0, 0], abs=1e-3)
    assert turn(simulation, "ROD")[0] == pytest.approx(angle, rel=0.06)


def test_a_hinge2_joint_has_two_axes(axes: str):
    text = """DEF ROBOT Robot { children [ DEF JOINT Hinge2Joint {
      jointParameters HingeJointParameters { axis 0 0 1 } jointParameters2 JointParameters { axis 0 1 0 }
      device [ RotationalMotor { name "first" maxTorque 1e6 } ] device2 [ RotationalMotor { name "second" maxTorque 1e6 } ]
      endPoint DEF ROD Solid { boundingObject Box { size 1 0.2 0.1 } physics Physics { density -1 mass 2 } } } ] }"""
    simulation = simulate(text, axes=axes, gravity=0)
    for name, angle in (("first", 0.6), ("second", 0.3)):
        device(simulation, name).setPosition(angle)
    run(simulation, 3)
    assert turn(simulation, "ROD") == pytest.approx((0.3, 0.6), abs=1e-3)


TETRAHEDRON = (
    "IndexedFaceSet { coord Coordinate { point [ 0 0 0, 0.3 0 0, 0 0.3 0, 0 0 0.3 ] }"
    " coordIndex [ 0 2 1 -1 0 1 3 -1 0 3 2 -1 1 2 3 -1 ] }"
)


@pytest.mark.parametrize(
    ("shape", "volume"),
    [
        ("Box { size 0.1 0.2 0.3 }", 0.006),
        ("Sphere { radius 0.1 }", 4 / 3 * math.pi * 1e-3),
        ("Cylinder { radius 0.1 height 0.3 }", math.pi * 0.003),
        ("Capsule { radius 0.1 height 0.3 }", math.pi * 0.003 + 4 / 3 * math.pi * 1e-3),
        (TETRAHEDRON, 0.3**3 / 6),
    ],
)
def test_a_density_gives_the_mass_of_a_shape(axes: str, shape: str, volume: float):
    text = f"DEF BODY Solid {{ boundingObject {shape} physics Physics {{ }} }}"
    simulation = simulate(text, axes=axes, gravity=0)
    node(simulation, "BODY").addForce([0.0, 0.0, 1.0], True)
    simulation.run_step()
    velocity = enu(node(simulation, "BODY").getVelocity(), axes)
    assert velocity[2] == pytest.approx(0.008 / (1000 * volume), rel=0.01)


@pytest.mark.parametrize(
    ("shape", "stated", "moment"),
    [
        ("Box { }", "inertiaMatrix [ 0.02 0.03 0.04, 0 0 0 ]", 0.04),
        ("Box { size 0.2 0.4 0.6 }", "", 2 / 12 * (0.2**2 + 0.4**2)),
        (
            "Pose { rotation 1 0 0 1.5707963 children [ Box { size 0.2 0.6 0.4 } ] }",
            "",
            2 / 12 * (0.2**2 + 0.4**2),
        ),
        (TETRAHEDRON, "", 2 * 0.3**2 / 14),  # about its center 3/40, with products of 1/80
    ],
)
def test_a_stated_center_of_mass_keeps_the_inertia_of_the_outline(
    axes: str, shape: str, stated: str, moment: float
):
    text = f"""DEF BODY Solid {{ boundingObject {shape} physics Physics {{ density -1 mass 2
      centerOfMass [ 0.1 0 0 ] {stated} }} }}"""
    simulation = simulate(text, axes=axes, gravity=0)
    body = node(simulation, "BODY")
    assert enu(body.getCenterOfMass(), axes) == pytest.approx([0.1, 0, 0], abs=1e-6)
    body.addTorque([0.0, 0.0, 1e-3], True)
    simulation.run_step()
    assert enu(body.getVelocity(), axes)[5] == pytest.approx(0.008e-3 / moment, rel=0.01)


def test_propellers_lift_their_robot_by_the_square_of_their_speed(axes: str):
    propeller = """Propeller {{ shaftAxis 0 0 2 centerOfThrust {} 0 0 thrustConstants {} 1e-4
      torqueConstants 1e-6 0 device RotationalMotor {{ name "{}" maxVelocity 600 }} slowHelix Solid {{ }} }}"""
    pair = propeller.format(0.1, 1e-4, "a") + propeller.format(-0.1, -1e-4, "b")
    robot = f"""DEF BODY Robot {{ boundingObject Box {{ size 0.2 0.2 0.1 }}
      physics Physics {{ density -1 mass 0.5 }} children [ {pair} ] }}"""
    simulation = simulate(robot, axes=axes)
    for name, speed in (("a", 200), ("b", -200)):
        turning(simulation, speed, name)
    run(simulation, 1)
    # m dv/dt = 2 a w^2 - m g - 2 b w v
    lift, drag = 2 * 1e-4 * 200**2 / 0.5 - 9.81, 2 * 1e-4 * 200 / 0.5
    velocity = lift / drag * (1 - math.exp(-drag))
    assert enu(node(simulation, "BODY").getVelocity(), axes) == pytest.approx(
        [0, 0, velocity, 0, 0, 0], rel=0.01, abs=1e-6
    )
    device(simulation, "b").setVelocity(0)
    spin = enu(node(simulation, "BODY").getVelocity(), axes)[5]
    simulation.run_step()
    inertia = 0.5 / 12 * (0.2**2 + 0.2**2)
    assert enu(node(simulation, "BODY").getVelocity(), axes)[5] - spin == pytest.approx(
        -1e-6 * 200**2 / inertia * 0.008, rel=0.01
    )


def test_a_solid_reference_closes_a_loop(axes: str):
    """A coupler between two equal rods stays level while they swing."""
    ends = """DEF COUPLER Solid { translation 1 0 0 boundingObject Pose { translation 0.3 0 0
      children [ Box { size 0.6 0.02 0.02 } ] } physics Physics { density -1 mass 1 } children [ HingeJoint {
      jointParameters HingeJointParameters { axis 0 1 0 anchor 0.6 0 0 } endPoint SolidReference { solidName "far" } } ] }"""
    rod = """HingeJoint {{ jointParameters HingeJointParameters {{ axis 0 1 0 anchor {0} 0 0 }} endPoint DEF {1} Solid {{
      translation {0} 0 0 name "{1}" boundingObject Pose {{ translation 0.5 0 0 children [ Box {{ size 1 0.02 0.02 }} ] }}
      physics Physics {{ density -1 mass 1 }} children [ {2} ] }} }}"""
    near = rod.format(
        0,
        "near",
        "HingeJoint { jointParameters HingeJointParameters { axis 0 1 0 anchor 1 0 0 }"
        f" endPoint {ends} }}",
    )
    robot = f"DEF ROBOT Robot {{ children [ {near} {rod.format(0.6, 'far', '')} ] }}"
    simulation = simulate(robot, axes=axes)
    run(simulation, 0.3)
    turned = [turn(simulation, name)[0] for name in ("near", "far", "COUPLER")]
    inertia = 2 / 3 + 1
    assert turned == pytest.approx([2 * 9.81 / inertia * 0.3**2 / 2] * 2 + [0], rel=0.1, abs=2e-3)


@pytest.mark.parametrize(
    ("joint", "message"),
    [
        ('HingeJoint { endPoint SolidReference { solidName "x" } }', "there is no solid 'x'"),
        *(
            (
                f"BallJoint {{ {fields} endPoint Solid {{ }} }}",
                "a BallJoint with devices, stops or single axes is not implemented",
            )
            for fields in (
                "device2 [ RotationalMotor { } ]",
                "jointParameters BallJointParameters { minStop -1 maxStop 1 }",
                "jointParameters3 JointParameters { }",
            )
        ),
    ],
)
def test_a_joint_that_is_missing_is_named(joint: str, message: str):
    world = read(f"Robot {{ children [ {joint} ] }}")
    build_scene(world)
    assert [finding.headline for finding in world.findings] == [message]


def test_solids_without_a_joint_are_one_body():
    text = """DEF BODY Solid { boundingObject Box { } physics Physics { density -1 mass 1 } children [
      DEF PART Solid { translation 1 0 0 boundingObject Box { } physics Physics { density -1 mass 3 } } ] }"""
    simulation = simulate(text, gravity=0)
    assert node(simulation, "BODY").getCenterOfMass() == pytest.approx([0.75, 0, 0])
    node(simulation, "BODY").setVelocity([0, 0, 0, 0, 0, 1])
    assert node(simulation, "PART").getVelocity() == pytest.approx([0, 1, 0, 0, 0, 1], abs=1e-9)


def test_a_scale_shrinks_shapes_and_places():
    text = """Solid { translation 0 0 2 scale 0.1 0.1 0.1 children [
      DEF PART Solid { translation 1 0 0 boundingObject Sphere { radius 1 } } ] }"""
    simulation = simulate(text)
    assert node(simulation, "PART").getPosition() == pytest.approx([0.1, 0, 2])
    assert simulation.physics.geoms[0][1].shape.radius == pytest.approx(0.1)


def test_an_elevation_grid_begins_at_its_origin():
    grid = "ElevationGrid { xDimension 3 yDimension 2 xSpacing 1 ySpacing 2 height [ 0 0.5 1, 0 0.5 1 ] }"
    simulation = simulate(f"Solid {{ translation 1 0 0 boundingObject {grid} }}")
    for x, height in ((1.5, 0.25), (2.0, 0.5), (2.8, 0.9)):
        distance = simulation.physics.cast((x, 1.0, 5.0), [(0.0, 0.0, -1.0)], 10, None)[0][0]
        assert 5 - distance == pytest.approx(height, abs=1e-3)


def test_the_parts_of_a_robot_pass_through_each_other_unless_it_says_so():
    text = """DEF ROBOT Robot {{ {} children [ HingeJoint {{ jointParameters HingeJointParameters {{ axis 0 1 0 }}
      endPoint DEF ROD Solid {{ boundingObject Pose {{ translation 0.5 0 0 children [ Box {{ size 1 0.1 0.1 }} ] }}
      physics Physics {{ }} }} }} Solid {{ translation 0.8 0 -0.3 boundingObject Box {{ size 0.2 0.2 0.2 }} }} ] }}"""
    angles = []
    for fields in ("", "selfCollision TRUE"):
        simulation = simulate(text.format(fields))
        run(simulation, 0.6)
        angles.append(math.asin(-node(simulation, "ROD").getOrientation()[6]))
    assert angles[0] > 0.8
    assert angles[1] < 0.3


def test_a_run_is_repeatable():
    text = FLOOR + solid("Box { size 0.2 0.2 0.2 }", "translation 0 0 1 angularVelocity 1 2 3")
    ends = []
    for _ in range(2):
        simulation = simulate(text, 32)
        run(simulation, 3)
        ends.append(node(simulation, "BODY").getPosition())
    assert ends[0] == ends[1]
    simulation.physics.reset()
    run(simulation, 3)
    assert node(simulation, "BODY").getPosition() == ends[0]


def test_a_robot_that_pushes_a_wall_does_not_sink_into_it():
    """The motors of an e-puck may exert 10 N m, and press it against the wall with more than its weight."""
    wall = "Solid { translation 0 0.16 0.07 boundingObject Box { size 0.5 0.06 0.15 } }"
    robot = "DEF ROBOT E-puck { translation 0 0.27 0 rotation 0 0 1 -1.5708 }"
    simulation = simulate(f"{FLOOR} {wall} {robot}", 32)
    for side in ("left", "right"):
        turning(simulation, 1, f"{side} wheel motor")
    nearest = math.inf
    for _ in range(200):
        simulation.run_step()
        nearest = min(nearest, node(simulation, "ROBOT").getPosition()[1])
    assert nearest == pytest.approx(0.19 + 0.037, abs=0.005)


def test_a_stick_that_spins_fast_stays_finite():
    stick = solid("Cylinder { radius 0.0075 height 0.06 }", "angularVelocity 60 290 50", mass=0.008)
    simulation = simulate(stick, step=10, gravity=0)
    run(simulation, 10)
    # At most 1 rad in a substep of 5 ms.
    assert math.hypot(*node(simulation, "BODY").getVelocity()[3:]) < 200.1


def test_too_many_contacts_end_a_run_with_a_sentence():
    simulation = simulate("E-puck { }" * 40)
    with pytest.raises(FloatingPointError, match="more contacts than MuJoCo has room for"):
        simulation.run_step()


def test_bb8_rocks_in_the_pit():
    """The strategy of robotbenchmark's example: the motor turns with the ball. It climbs, and stays within."""
    pit = """Pit { size 20 20 4 pitRadius 2.7 }
      DEF ROBOT BB-8 { } Solid { name "ground" translation 0 0 -9 boundingObject Plane { } }"""
    simulation = simulate(pit, step=32)
    motor, gyro = turning(simulation, 8.72, "body pitch motor"), device(simulation, "body gyro")
    gyro.enable(32)
    reached = 0.0
    for _ in range(450):
        simulation.run_step()
        motor.setVelocity(-8.72 if gyro.getValues()[1] < 0 else 8.72)
        x, y, _ = node(simulation, "ROBOT").getPosition()
        reached = max(reached, math.hypot(x, y))
    assert 2.7 > reached > 1.3


WORLD = """DEF ROBOT Robot { translation 1 2 3 rotation 0 0 1 1.5707963 supervisor TRUE name "one" customData "x"
  children [ DEF INNER Pose { translation 1 0 0 children [ DEF PART Solid { translation 0 0 1 name "part" } ] } ] }
DEF BALL Solid { translation 0 0 5 boundingObject Sphere { radius 0.5 } physics Physics { density -1 mass 2 } }
DEF MARK Solid { translation 4 0 0 }"""


def supervisor(text: str = WORLD, **info: object) -> Supervisor:
    """Return the supervisor of a world; its steps advance the world."""
    simulation = simulate(text, **info)
    activate(simulation)
    simulation.current = simulation.scene.robots[0]
    try:
        return Supervisor()
    finally:
        deactivate()


def close(*numbers: float):
    return pytest.approx(numbers, abs=1e-6)


@pytest.mark.parametrize(
    ("read", "value"),
    [
        (lambda it: it.getFromDef("NOWHERE"), None),
        (lambda it: it.getFromDef("ROBOT.INNER.PART") == it.getFromDef("PART"), True),
        (lambda it: it.getFromDef("BALL.PART"), None),
        (lambda it: it.getSelf() == it.getFromDef("ROBOT"), True),
        (lambda it: it.getFromId(it.getFromDef("PART").getId()).getDef(), "PART"),
        (lambda it: it.getFromDef("PART").getTypeName(), "Solid"),
        (lambda it: it.getFromDef("PART").getParentNode().getDef(), "INNER"),
        (lambda it: it.getRoot().getField("children").getCount(), 4),
        (lambda it: it.getRoot().getField("children").getMFNode(2).getDef(), "BALL"),
        (lambda it: it.getFromDef("BALL").getField("physics").getSFNode().getField("mass").getSFFloat(), 2),
        (lambda it: it.getFromDef("PART").getField("name").getSFString(), "part"),
        (lambda it: it.getSelf().getField("supervisor").getSFBool(), True),
        (lambda it: it.getSelf().getField("nothing"), None),
        (lambda it: it.getFromDef("BALL").getType(), Node.SOLID),
        (lambda it: it.getSelf().getType(), Node.ROBOT),
        (lambda it: it.getFromDef("BALL").getField("translation").getType(), Field.SF_VEC3F),
        (lambda it: it.getFromDef("BALL").getField("name").getType(), Field.SF_STRING),
        (lambda it: it.getFromDef("BALL").getField("physics").getType(), Field.SF_NODE),
        (lambda it: it.getFromDef("BALL").getField("children").getType(), Field.MF_NODE),
        (lambda it: it.getFromDef("PART").getPosition(), close(1, 3, 4)),
        (lambda it: it.getFromDef("PART").getOrientation(), close(0, -1, 0, 1, 0, 0, 0, 0, 1)),
        (
            lambda it: it.getFromDef("PART").getPose(it.getFromDef("ROBOT")),
            close(1, 0, 0, 1, 0, 1, 0, 0, 0, 0, 1, 1, 0, 0, 0, 1),
        ),
        (lambda it: it.getFromDef("PART").getField("translation").getSFVec3f(), close(0, 0, 1)),
        (lambda it: it.getSelf().getField("rotation").getSFRotation(), close(0, 0, 1, math.pi / 2)),
    ],
)
def test_a_supervisor_reads_nodes_and_fields(read, value):
    assert read(supervisor()) == value


def test_fields_of_a_pose_are_those_of_now_in_the_node_above():
    it = supervisor()
    ball = it.getFromDef("BALL").getField("translation")
    it.step(80)
    assert ball.getSFVec3f()[2] == pytest.approx(5 - 9.81 * 0.08**2 / 2, abs=0.004)


def test_a_proto_has_the_fields_of_its_interface():
    it = supervisor("DEF PIT Pit { pitRadius 2.5 translation 0 0 1 } Robot { supervisor TRUE }")
    pit = it.getFromDef("PIT")
    assert (pit.getField("pitRadius").getSFFloat(), pit.getField("translation").getSFVec3f()) == (
        2.5,
        pytest.approx([0, 0, 1]),
    )
    assert pit.isProto() is True
    assert (pit.getTypeName(), pit.getBaseTypeName()) == ("Pit", "Solid")


def test_bodies_are_moved_and_keep_their_velocity():
    it = supervisor(gravity=0)
    ball, mark = it.getFromDef("BALL"), it.getFromDef("MARK")
    ball.setVelocity([1, 0, 0, 0, 0, 2])
    ball.getField("translation").setSFVec3f([7, 0, 0])
    ball.getField("rotation").setSFRotation([0, 0, 2, 0.5])
    mark.getField("translation").setSFVec3f([0, 1, 0])
    assert (ball.getPosition(), mark.getPosition()) == ([7, 0, 0], [0, 1, 0])
    it.step(8)
    assert ball.getPosition() == pytest.approx([7.008, 0, 0])
    assert ball.getField("rotation").getSFRotation()[3] == pytest.approx(0.5 + 0.016)
    assert ball.getVelocity() == pytest.approx([1, 0, 0, 0, 0, 2])
    ball.resetPhysics()
    assert ball.getVelocity() == [0.0] * 6


def test_numbers_that_are_missing_are_zeros_and_an_axis_of_zero_has_no_effect(capsys):
    it = supervisor("DEF VIEW Viewpoint { } DEF MARK Solid { } Robot { supervisor TRUE }")
    mark, view = it.getFromDef("MARK"), it.getFromDef("VIEW").getField("orientation")
    mark.getField("translation").setSFVec3f([1, 2])
    mark.getField("rotation").setSFRotation([0, 0, 2, 0.5])
    mark.getField("rotation").setSFRotation([0, 0, 0, 1])
    assert mark.getField("rotation").getSFRotation() == close(0, 0, 1, 0.5)
    mark.getField("rotation").setSFRotation([0, 1, 0])
    view.setSFRotation([0, 1, 0])
    assert (mark.getPosition(), mark.getField("rotation").getSFRotation()[3]) == ([1, 2, 0], 0)
    assert view.getSFRotation() == [0, 1, 0, 0]
    assert capsys.readouterr().err.count("setSFRotation: the axis is zero, so the call is ignored") == 1


def test_forces_on_a_node_without_a_body_warn_once_and_have_no_effect(capsys):
    it = supervisor("DEF LIGHT SpotLight { } Robot { supervisor TRUE }")
    light = it.getFromDef("LIGHT")
    for _ in range(2):
        light.resetPhysics()
        light.addForceWithOffset([1, 0, 0], [0, 0, 1], True)
        light.restartController()
    assert capsys.readouterr().err.splitlines() == [
        f"Warning: Node.{function} of a SpotLight, which is no {kind}, has no effect"
        for function, kind in (
            ("resetPhysics", "Solid"),
            ("addForceWithOffset", "Solid"),
            ("restartController", "Robot"),
        )
    ]


def test_a_moved_obstacle_stops_rays_where_it_is():
    it = supervisor(
        "DEF WALL Solid { translation 9 0 0 boundingObject Box { } } Robot { supervisor TRUE children"
        " [ DistanceSensor { lookupTable [ 0 0 0, 5 5 0 ] } ] }"
    )
    sensor = it.getDevice("distance sensor")
    sensor.enable(8)
    it.getFromDef("WALL").getField("translation").setSFVec3f([2, 0, 0])
    it.step()
    assert sensor.getValue() == pytest.approx(1.95, rel=1e-3)


def test_forces_and_torques_push_for_one_step():
    it = supervisor(gravity=0)
    ball = it.getFromDef("BALL")
    ball.addForce([2.0, 0, 0], False)
    it.step(8)
    it.step(8)
    assert ball.getVelocity()[0] == pytest.approx(0.008, rel=1e-3)
    ball.addForceWithOffset([0, 2.0, 0], [0.5, 0, 0], True)
    it.step(8)
    inertia = 0.4 * 2 * 0.5**2
    assert ball.getVelocity()[5] == pytest.approx(0.5 * 2 * 0.008 / inertia, rel=1e-3)


def test_the_position_of_a_joint_is_read_and_set():
    simulation = simulate(hinge(), gravity=0)
    joint = node(simulation, "JOINT")
    joint.setJointPosition(0.4)
    assert (
        joint.getField("position").getSFFloat(),
        node(simulation, "PARAMETERS").getField("position").getSFFloat(),
    ) == (0.4, 0.4)
    node(simulation, "PARAMETERS").getField("position").setSFFloat(0.1)
    assert angle(simulation) == pytest.approx(0.1)


def test_contacts_have_their_places():
    simulation = simulate(FLOOR + solid("Box { size 0.2 0.2 0.2 }", "translation 0 0 0.1"))
    run(simulation, 0.5)
    points = node(simulation, "BODY").getContactPoints()
    assert (
        sorted(tuple(round(abs(part), 2) for part in point.point) for point in points)
        == [(0.1, 0.1, 0.0)] * 4
    )
    assert node(simulation, "BODY").getNumberOfContactPoints() == 4


def test_a_reset_happens_at_the_end_of_the_step_and_restores_clock_and_world():
    it = supervisor()
    it.step(80)
    ball, mark = it.getFromDef("BALL"), it.getFromDef("MARK")
    mark.getField("translation").setSFVec3f([0, 1, 0])
    it.setCustomData("y")
    it.simulationReset()
    assert ball.getPosition()[2] < 5
    assert it.getTime() == pytest.approx(0.08)
    it.step(8)
    assert (ball.getPosition()[2], it.getTime()) == (5, 0)
    assert (mark.getPosition(), it.getCustomData()) == (pytest.approx([4, 0, 0]), "x")
    it.step(8)
    assert ball.getPosition()[2] == pytest.approx(5 - 9.81 * 0.008**2)


def test_a_saved_state_is_loaded_again():
    it = supervisor()
    ball = it.getFromDef("BALL")
    it.step(80)
    ball.saveState("there")
    kept = ball.getPosition() + ball.getVelocity()
    it.step(80)
    ball.loadState("there")
    assert ball.getPosition() + ball.getVelocity() == kept
    ball.loadState("__init__")
    assert ball.getPosition() == [0, 0, 5]


def test_a_saved_state_has_moved_statics_and_the_commands_of_motors():
    it = supervisor(f"{hinge('', 'RotationalMotor { maxTorque 50 }')} {STILL}", gravity=0)
    motor, still = it.getDevice("rotational motor"), it.getFromDef("STILL")
    motor.setPosition(1)
    motor.setVelocity(0.5)
    still.getField("translation").setSFVec3f([1, 2, 3])
    still.saveState("there")
    still.getField("translation").setSFVec3f([4, 5, 6])
    motor.setTorque(0)
    still.loadState("there")
    it.step(4000)
    angle = it.getFromDef("JOINT").getField("position").getSFFloat()
    assert (still.getPosition(), angle, motor.getVelocity()) == ([1, 2, 3], pytest.approx(1, abs=1e-3), 0.5)


@pytest.mark.parametrize(
    ("field", "value", "angle"),
    [
        pytest.param("maxVelocity", 0.5, 0.4, id="velocity"),
        pytest.param("maxTorque", 0.0, 0.0, id="torque"),
        # Half the acceleration times the square of 0.8 s.
        pytest.param("acceleration", 1.0, 0.32, id="acceleration"),
        pytest.param("maxPosition", 0.3, 0.3, id="position"),
    ],
)
def test_a_supervisor_sets_the_limits_of_a_motor(field: str, value: float, angle: float):
    it = supervisor(
        hinge("", "DEF MOTOR RotationalMotor { minPosition -1 maxPosition 9 maxTorque 500 }"), gravity=0
    )
    it.getFromDef("MOTOR").getField(field).setSFFloat(value)
    it.getDevice("rotational motor").setPosition(2)
    it.step(800)
    assert it.getFromDef("JOINT").getField("position").getSFFloat() == pytest.approx(angle, abs=0.01)
    assert it.getFromDef("MOTOR").getField(field).getSFFloat() == value


# Nodes that come and go

STILL = 'DEF STILL Solid { name "still" boundingObject Box { } }'
FALLING = """DEF NEW Solid { translation 0 3 5 name "new" boundingObject Sphere { radius 0.1 }
  physics Physics { density -1 mass 1 } }"""


def children_of_the_world(it: Supervisor):
    return it.getRoot().getField("children")


def test_a_node_comes_into_a_world_that_goes_on():
    it = supervisor()
    it.step(80)
    ball, field = it.getFromDef("BALL"), children_of_the_world(it)
    before, count = ball.getPosition() + ball.getVelocity(), field.getCount()
    field.importMFNodeFromString(-1, FALLING)
    assert (field.getCount(), it.getFromDef("NEW").getPosition()) == (count + 1, [0, 3, 5])
    assert ball.getPosition() + ball.getVelocity() == pytest.approx(before)
    it.step(80)
    assert it.getFromDef("NEW").getVelocity()[2] == pytest.approx(-9.81 * 0.08, rel=1e-3)
    field.importMFNodeFromString(0, STILL)
    assert field.getMFNode(0).getDef() == "STILL"


def test_a_node_that_comes_into_a_body_moves_with_it():
    it = supervisor(
        "Robot { supervisor TRUE } " + solid("Box { }", "translation 0 0 5 linearVelocity 1 0 0"), gravity=0
    )
    it.getFromDef("BODY").getField("children").importMFNodeFromString(
        -1, STILL.replace("{ name", "{ translation 0 1 0 name")
    )
    it.step(1000)
    assert it.getFromDef("STILL").getPosition() == pytest.approx([1, 1, 5])
    assert it.getFromDef("STILL").getParentNode() == it.getFromDef("BODY")


@pytest.mark.parametrize("way", ["remove", "removeMF"])
def test_a_node_that_goes_leaves_the_world(way: str):
    """What stood on it falls, and what comes after it in the file keeps its place and speed."""
    world = "Robot { supervisor TRUE } DEF TABLE Solid { boundingObject Box { size 1 1 1 } } "
    it = supervisor(world + solid("Box { size 0.2 0.2 0.2 }", "translation 0 0 0.6"))
    it.step(400)
    field, body = children_of_the_world(it), it.getFromDef("BODY")
    assert body.getPosition()[2] == pytest.approx(0.6, abs=1e-3)
    if way == "remove":
        it.getFromDef("TABLE").remove()
    else:
        field.removeMF(field.getCount() - 2)
    it.step(400)
    assert it.getFromDef("TABLE") is None
    assert body.getPosition()[2] == pytest.approx(0.6 - 9.81 * 0.4**2 / 2, abs=0.02)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("Solid { ", "the end of the file in the place of"),
        ("Sold { }", "PROTO Sold is not available"),
        ("DEF NEW Solid { boundingObject Box { size 0 0 0 } }", "a Box whose size is not positive"),
    ],
)
def test_a_node_with_an_error_does_not_come_in(capsys, text: str, message: str):
    it = supervisor()
    field = children_of_the_world(it)
    count = field.getCount()
    field.importMFNodeFromString(-1, text)
    error = capsys.readouterr().err
    assert error.startswith("Error: Field.importMFNodeFromString: ")
    assert (message in error, field.getCount(), it.getFromDef("NEW")) == (True, count, None), error
    it.step(80)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda it: it.worldReload, "Supervisor.worldReload is not implemented"),
        (lambda it: it.wwiSendText, "Robot.wwiSendText is not implemented"),
        (
            lambda it: it.getSelf().getField("children").importSFNodeFromString,
            "Field.importSFNodeFromString is not implemented",
        ),
        (
            lambda it: it.getFromDef("BALL").getField("physics").getSFNode().remove(),
            "Node.remove of a node outside of 'children' is not implemented",
        ),
        (
            lambda it: it.getFromDef("BALL").getField("contactMaterial").setSFString("x"),
            "Field.setSFString of Solid.contactMaterial is not implemented",
        ),
        (
            lambda it: it.getFromDef("PART").getField("translation").setSFVec3f([0, 0, 0]),
            "Field.setSFVec3f of Solid.translation is not implemented",
        ),
        (
            lambda it: it.getFromDef("BALL").getField("physics").getSFNode().getPosition(),
            "Node.getPosition of a Physics is not implemented",
        ),
    ],
)
def test_the_error_of_a_missing_function_names_it(call, message: str):
    with pytest.raises(NotImplementedCallError) as caught:
        call(supervisor())
    assert str(caught.value) == message


def test_a_missing_device_is_none_with_a_warning(capsys):
    it = supervisor("Robot { supervisor TRUE children [ GPS { } ] }")
    assert it.getDevice("gsp") is None
    assert 'Warning: "gsp" device not found (did you mean gps?)' in capsys.readouterr().err
    assert it.getGPS("gps") is it.getDevice("gps")


def test_a_robot_needs_a_simulation():
    with pytest.raises(RuntimeError, match="deepbots webots"):
        Supervisor()


def test_a_proto_hides_its_own_definitions():
    world = read(
        HEADER + "PROTO A [ ] { DEF OUTER Solid { children [ DEF HIDDEN Solid { } ] } } DEF SEEN A { }"
    )
    assert [entry.name for entry in world.nodes] == ["SEEN"]
    it = supervisor("Robot { supervisor TRUE } DEF PIT Pit { }")
    assert it.getFromDef("GRID") is None
    assert it.getFromDef("PIT") is not None


# Fields that are set

SENSOR = """DEF WALL Solid { translation 1.05 0 0 boundingObject Box { size 0.1 2 2 } }
Robot { supervisor TRUE children [ DEF EYE DistanceSensor { lookupTable [ 0 0 0, 2 2000 0 ] } ] }"""


def test_a_sensor_answers_by_the_fields_that_a_supervisor_sets():
    it = supervisor(SENSOR)
    sensor = it.getDevice("distance sensor")
    eye = it.getFromDef("EYE")
    sensor.enable(8)
    it.step()
    assert sensor.getValue() == pytest.approx(1000, rel=1e-3)
    eye.getField("lookupTable").setMFVec3f(1, [4, 400])  # the noise that is missing is 0
    it.step()
    assert sensor.getValue() == pytest.approx(100, rel=1e-3)
    eye.getField("resolution").setSFFloat(30)
    eye.getField("type").setSFString("sonar")
    eye.getField("numberOfRays").setSFInt32(2)
    it.step()
    assert (sensor.getValue(), sensor.getType()) == (390, 2)
    assert sensor.getMaxValue() == 400  # both rays are slanted
    assert (eye.getField("lookupTable").getMFVec3f(1), eye.getField("lookupTable").getCount()) == (
        [4, 400, 0],
        2,
    )
    with pytest.raises(IndexError, match="lookupTable has 2 items, and no item 2"):
        eye.getField("lookupTable").setMFVec3f(2, [1, 1, 1])


def test_looks_are_kept_and_change_nothing():
    it = supervisor("DEF VIEW Viewpoint { } Robot { supervisor TRUE }")
    position = it.getFromDef("VIEW").getField("position")
    position.setSFVec3f([1, 2, 3])
    assert position.getSFVec3f() == [1, 2, 3]


def test_solids_in_groups_and_poses_at_the_top_are_moved_in_their_frame():
    it = supervisor(
        "Group { children [ DEF ONE Solid { translation 1 0 0 } Pose { translation 0 0 5 rotation 0 0 1 1.5707963"
        " children [ DEF TWO Solid { translation 1 0 0 } ] } ] } Robot { supervisor TRUE }"
    )
    first, second = it.getFromDef("ONE"), it.getFromDef("TWO")
    assert second.getPosition() == pytest.approx([0, 1, 5], abs=1e-6)
    assert second.getField("translation").getSFVec3f() == pytest.approx([1, 0, 0], abs=1e-6)
    first.getField("translation").setSFVec3f([2, 0, 0])
    second.getField("translation").setSFVec3f([2, 0, 0])
    assert (first.getPosition(), second.getPosition()) == ([2, 0, 0], pytest.approx([0, 2, 5], abs=1e-6))
