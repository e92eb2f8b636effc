"""Nodes and fields, as a supervisor reads and sets them."""

from __future__ import annotations

import math

import pytest

from deepbots_cli.webots.supervisor import Supervisor, activate, deactivate
from deepbots_cli.webots.tree import Field, Node
from deepbots_cli.webots.unimplemented import NotImplementedCallError
from tests.webots.worlds_of_webots import FLOOR, HEADER, hinge, node, read, run, simulate, solid

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


def test_nodes_are_named_by_def_and_by_paths_of_them():
    it = supervisor()
    assert it.getFromDef("NOWHERE") is None
    assert it.getFromDef("ROBOT.INNER.PART") == it.getFromDef("PART")
    assert it.getFromDef("BALL.PART") is None
    assert it.getSelf() == it.getFromDef("ROBOT")
    part = it.getFromDef("PART")
    assert (part.getDef(), part.getTypeName(), part.getParentNode().getDef()) == ("PART", "Solid", "INNER")
    assert it.getFromId(part.getId()) == part


def test_the_root_has_the_nodes_of_the_world_as_its_children():
    children = supervisor().getRoot().getField("children")
    names = [children.getMFNode(index).getDef() for index in range(children.getCount())]
    assert names == ["", "ROBOT", "BALL", "MARK"]


def test_a_pose_is_that_in_the_world():
    it = supervisor()
    part = it.getFromDef("PART")
    assert part.getPosition() == pytest.approx([1, 3, 4], abs=1e-6)
    assert part.getOrientation() == pytest.approx([0, -1, 0, 1, 0, 0, 0, 0, 1], abs=1e-6)
    assert part.getPose(it.getFromDef("ROBOT")) == pytest.approx(
        [1, 0, 0, 1, 0, 1, 0, 0, 0, 0, 1, 1, 0, 0, 0, 1], abs=1e-6
    )


def test_fields_of_a_pose_are_those_of_now_in_the_node_above():
    it = supervisor()
    assert it.getFromDef("PART").getField("translation").getSFVec3f() == pytest.approx([0, 0, 1])
    ball = it.getFromDef("BALL").getField("translation")
    it.step(80)
    assert ball.getSFVec3f()[2] == pytest.approx(5 - 9.81 * 0.08**2 / 2, abs=0.004)
    assert it.getSelf().getField("rotation").getSFRotation() == pytest.approx(
        [0, 0, 1, math.pi / 2], abs=1e-6
    )


def test_other_fields_are_as_the_world_says():
    it = supervisor()
    physics = it.getFromDef("BALL").getField("physics").getSFNode()
    assert physics.getField("mass").getSFFloat() == 2
    assert it.getFromDef("PART").getField("name").getSFString() == "part"
    assert it.getSelf().getField("supervisor").getSFBool() is True
    assert it.getSelf().getField("nothing") is None


def test_a_proto_has_the_fields_of_its_interface():
    it = supervisor("DEF PIT Pit { pitRadius 2.5 translation 0 0 1 } Robot { supervisor TRUE }")
    pit = it.getFromDef("PIT")
    assert pit.getField("pitRadius").getSFFloat() == 2.5
    assert pit.getField("translation").getSFVec3f() == pytest.approx([0, 0, 1])
    assert pit.isProto() is True
    assert pit.getTypeName() == "Pit"
    assert pit.getBaseTypeName() == "Solid"


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
    assert joint.getField("position").getSFFloat() == 0.4
    assert node(simulation, "PARAMETERS").getField("position").getSFFloat() == 0.4
    node(simulation, "PARAMETERS").getField("position").setSFFloat(0.1)
    x, _, z = node(simulation, "ROD").getOrientation()[0::3]
    assert math.atan2(-z, x) == pytest.approx(0.1)


def test_contacts_have_their_places():
    simulation = simulate(FLOOR + solid("Box { size 0.2 0.2 0.2 }", "translation 0 0 0.1"))
    run(simulation, 0.5)
    points = node(simulation, "BODY").getContactPoints()
    assert (
        sorted(tuple(round(abs(part), 2) for part in point.point) for point in points)
        == [(0.1, 0.1, 0.0)] * 4
    )
    assert node(simulation, "BODY").getNumberOfContactPoints() == 4


def test_a_reset_happens_at_the_end_of_the_step_and_the_clock_begins_anew():
    it = supervisor()
    it.step(80)
    ball = it.getFromDef("BALL")
    it.simulationReset()
    assert ball.getPosition()[2] < 5
    assert it.getTime() == pytest.approx(0.08)
    it.step(8)
    assert (ball.getPosition()[2], it.getTime()) == (5, 0)
    it.step(8)
    assert ball.getPosition()[2] == pytest.approx(5 - 9.81 * 0.008**2)


def test_a_reset_restores_what_a_supervisor_moved():
    it = supervisor(gravity=0)
    it.getFromDef("MARK").getField("translation").setSFVec3f([0, 1, 0])
    it.setCustomData("y")
    it.simulationReset()
    it.step()
    assert it.getFromDef("MARK").getPosition() == pytest.approx([4, 0, 0])
    assert it.getCustomData() == "x"


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


def test_physics_are_stopped():
    it = supervisor()
    it.step(80)
    it.simulationResetPhysics()
    assert it.getFromDef("BALL").getVelocity() == [0.0] * 6


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda it: it.worldReload, "Supervisor.worldReload is not implemented"),
        (lambda it: it.wwiSendText, "Robot.wwiSendText is not implemented"),
        (lambda it: it.getFromDef("BALL").remove, "Node.remove is not implemented"),
        (
            lambda it: it.getSelf().getField("children").importMFNodeFromString,
            "Field.importMFNodeFromString is not implemented",
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
    assert "Warning: \"gsp\" device not found; did you mean 'gps'?" in capsys.readouterr().err
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
    assert sensor.getValue() == 390
    assert sensor.getType() == 2
    assert sensor.getMaxValue() == 400  # both rays are slanted
    assert eye.getField("lookupTable").getMFVec3f(1) == [4, 400, 0]
    assert eye.getField("lookupTable").getCount() == 2
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


def test_types_of_nodes_and_fields_are_numbers():
    it = supervisor()
    ball = it.getFromDef("BALL")
    assert (ball.getType(), it.getSelf().getType()) == (Node.SOLID, Node.ROBOT)
    types = [ball.getField(name).getType() for name in ("translation", "name", "physics", "children")]
    assert types == [Field.SF_VEC3F, Field.SF_STRING, Field.SF_NODE, Field.MF_NODE]
