"""Worlds whose axes are NUE, and nodes of releases before R2022a: closed forms, within 1 % at steps of 8 ms."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable

import pytest

from deepbots_webots.imports.draft import read_project
from deepbots_webots.project import equivalents
from deepbots_webots.scene import build_scene
from deepbots_webots.shapes import visible_shape
from deepbots_webots.simulation import Simulation
from deepbots_webots.syntax import WorldError
from tests.webots.exported_projects import device, node, read, run, solid, turning

OLD, NEW = "R2021b", "R2023b"
FLOOR = "Solid { boundingObject Plane { } }"


def simulate(text: str, release: str = OLD, info: str = "") -> Simulation:
    system = "" if release == NEW or "coordinateSystem" in info else 'coordinateSystem "NUE"'
    world = read(f"#VRML_SIM {release} utf8\nWorldInfo {{ basicTimeStep 8 {info} {system} }} {text}")
    scene = build_scene(world)
    world.findings.require_none()
    return Simulation(scene, world.span)


def place(simulation: Simulation) -> list[float]:
    return node(simulation, "BODY").getPosition()


@pytest.mark.parametrize(
    ("release", "info", "text", "rests"),
    [
        pytest.param(
            NEW,
            'coordinateSystem "NUE"',
            f"Pose {{ rotation 1 0 0 -1.5707963 children [ {FLOOR} ] }}"
            + solid("Sphere { radius 0.1 }", "translation 0 1 0"),
            [0, 0.1, 0],
            id="NUE of today",
        ),
        pytest.param(
            NEW,
            'coordinateSystem "ENU"',
            FLOOR + solid("Box { size 2 2 2 }", "translation 0 0 2"),
            [0, 0, 1],
            id="ENU",
        ),
        pytest.param(
            OLD,
            "",
            FLOOR + solid("Cylinder { radius 0.5 height 0.2 }", "translation 0 1 0"),
            [0, 0.1, 0],
            id="an old cylinder stands along y",
        ),
        pytest.param(
            OLD,
            "",
            FLOOR + solid("Capsule { radius 0.1 height 0.4 }", "rotation 1 0 0 1.5707963 translation 0 1 0"),
            [0, 0.1, 0],
            id="an old capsule lies",
        ),
        pytest.param(
            OLD,
            'coordinateSystem "ENU"',
            "Pose { rotation 1 0 0 1.5707963 children [ "
            + FLOOR
            + " ] }"
            + solid("Cylinder { radius 0.5 height 0.2 }", "rotation 1 0 0 1.5707963 translation 0 0 1"),
            [0, 0, 0.1],
            id="old nodes in an old world with z upward",
        ),
        pytest.param(
            OLD,
            "",
            "Solid { boundingObject ElevationGrid { xDimension 2 zDimension 3 zSpacing 2 height"
            " [ 0 0, 0 0, 1 1 ] } }" + solid("Sphere { radius 0.1 }", "translation 0.5 1 1"),
            [0.5, 0.1, 1],
            id="an old grid has its rows along z",
        ),
        pytest.param(
            OLD,
            "",
            "RectangleArena { floorSize 4 2 wallHeight 0.5 wallThickness 0.2 } "
            + solid("Sphere { radius 0.1 }", "translation 2.1 1 0"),
            [2.1, 0.6, 0],
            id="an old arena is as long as wide along x",
        ),
        pytest.param(
            OLD,
            "",
            "WoodenBox { translation 0 1 0 size 1 2 3 } "
            + solid("Sphere { radius 0.1 }", "translation 0 2.5 0"),
            [0, 2.1, 0],
            id="the size of an old box has its height second",
        ),
    ],
)
def test_a_body_rests_on_the_ground_of_its_world(release: str, info: str, text: str, rests: list[float]):
    bouncy = "contactProperties [ ContactProperties { bounce 0 } ]"
    simulation = simulate(text, release, f"{info} {bouncy}")
    run(simulation, 2)
    assert place(simulation) == pytest.approx(rests, abs=2e-3)


WALL = "Solid { translation 0 0 -2 boundingObject Box { size 4 4 2 } }"
TURNED = "rotation 0 1 0 0.3"


@pytest.mark.parametrize(
    ("robot", "sensor", "surroundings", "measure", "expected"),
    [
        ("", "Accelerometer { }", "", lambda sensor: sensor.getValues(), [0, 9.81, 0]),
        ("", "Compass { }", "", lambda sensor: sensor.getValues(), [1, 0, 0]),
        ("translation 1 2 3", "GPS { }", "", lambda sensor: sensor.getValues(), [1, 2, 3]),
        ("rotation 1 0 0 0.3", "InertialUnit { }", "", lambda unit: unit.getRollPitchYaw(), [0.3, 0, 0]),
        ("rotation 0 1 0 0.3", "InertialUnit { }", "", lambda unit: unit.getRollPitchYaw(), [0, 0, 0.3]),
        ("rotation 0 0 1 0.3", "InertialUnit { }", "", lambda unit: unit.getRollPitchYaw(), [0, 0.3, 0]),
        (
            TURNED,
            "InertialUnit { noise 1e-9 }",
            "",
            lambda unit: unit.getQuaternion(),
            [0, math.sin(0.15), 0, math.cos(0.15)],
        ),
        (
            "",
            "Lidar { horizontalResolution 3 fieldOfView 1 numberOfLayers 1 maxRange 9 near 0.01 }",
            WALL,
            lambda lidar: lidar.getRangeImage()[1],
            1.0,
        ),
        (
            "rotation 0 1 0 1.5707963",
            "DistanceSensor { lookupTable [ 0 0 0, 9 9 0 ] }",
            WALL,
            lambda sensor: sensor.getValue(),
            1.0,
        ),
    ],
)
def test_an_old_device_measures_along_its_old_axes(
    robot: str, sensor: str, surroundings: str, measure: Callable[..., object], expected: object
):
    named = sensor if 'name "s"' in sensor else sensor.replace("{", '{ name "s"', 1)
    simulation = simulate(f"Robot {{ {robot} children [ {named} ] }} {surroundings}")
    sensed = device(simulation, "s")
    sensed.enable(8)
    run(simulation, 0.016)
    assert measure(sensed) == pytest.approx(expected, abs=1e-6, rel=0.01)


@pytest.mark.parametrize(("release", "ahead"), [(OLD, [0, 0, -1]), (NEW, [1, 0, 0])])
def test_an_e_puck_drives_ahead_in_the_axes_of_its_world(release: str, ahead: list[float]):
    simulation = simulate("DEF BODY E-puck { } " + FLOOR, release)
    for side in ("left", "right"):
        turning(simulation, 5.0, f"{side} wheel motor")
    run(simulation, 2)
    driven = 5.0 * 0.02 * 2
    assert place(simulation) == pytest.approx([driven * axis for axis in ahead], rel=0.02, abs=3e-3)
    assert node(simulation, "BODY").getOrientation() == pytest.approx([1, 0, 0, 0, 1, 0, 0, 0, 1], abs=0.02)


def test_a_node_in_a_slot_of_a_proto_keeps_the_axes_of_its_file():
    simulation = simulate(
        'E-puck { turretSlot [ DEF BODY Solid { translation 0 0.1 -0.2 children [ Receiver { name "r" } ] } ] }'
    )
    assert place(simulation) == pytest.approx([0, 0.1 + 0.0486, 0.0095 - 0.2], abs=1e-6)


ROBOTS = {
    "E-puck": (0.02, "left wheel motor", "right wheel motor"),
    "TurtleBot3Burger": (0.033, "left wheel motor", "right wheel motor"),
    "Pioneer3dx": (0.0975, "left wheel", "right wheel"),
    "Pioneer3at": (0.11, "front left wheel", "back left wheel", "front right wheel", "back right wheel"),
    "Khepera4": (0.021, "left wheel motor", "right wheel motor"),
    "Thymio2": (0.021, "motor.left", "motor.right"),
}
"""The radius of the wheels (m) and the motors of each robot of the library."""


@pytest.mark.parametrize("robot", ROBOTS)
def test_a_robot_of_the_library_drives_ahead_and_stays_upright(robot: str):
    radius, *motors = ROBOTS[robot]
    simulation = simulate(f"DEF BODY {robot} {{ }} {FLOOR}", NEW)
    before = place(simulation)
    for motor in motors:
        turning(simulation, 5.0, motor)
    run(simulation, 2)
    # Two seconds at 5 rad/s; casters slip.
    assert place(simulation)[0] == pytest.approx(before[0] + radius * 10, rel=0.15)
    assert place(simulation)[1:] == pytest.approx(before[1:], abs=2e-3)
    assert node(simulation, "BODY").getOrientation()[8] == pytest.approx(1, abs=1e-3)


def test_a_scenario_needs_z_upward(tmp_path):
    path = tmp_path / "w.wbt"
    path.write_text('#VRML_SIM R2021b utf8\nWorldInfo { coordinateSystem "NUE" } E-puck { }')
    with pytest.raises(WorldError, match="the axes of the world are not ENU"):
        read_project(path)


@pytest.mark.parametrize("release", [OLD, NEW])
def test_all_protos_of_the_library_move_finitely_in_the_axes_of_their_file(release: str):
    places = (f"{60 * at} 1 0" if release == OLD else f"{60 * at} 0 1" for at in itertools.count())
    protos = [f"{name} {{ translation {next(places)} }}" for name in sorted(equivalents())]
    simulation = simulate("\n".join([FLOOR, *protos]), release)
    run(simulation, 0.8)  # 100 steps, each of which checks that all velocities are finite
    robots = [body for body in simulation.scene.bodies if body.robot is not None and body.parent is None]
    heights = [simulation.physics.position(body)[1 if release == OLD else 2] for body in robots]
    assert len(robots) == 25
    assert min(heights) > -0.01


@pytest.mark.parametrize(
    ("header", "info", "falls"),
    [
        ("V8.6", "", [0, -1, 0]),
        ("R2020a", "gravity 0 -9.81 0", [0, -1, 0]),
        ("R2020a", "gravity 0 0 -9.81", [0, 0, -1]),
        ("R2020b", "", [0, 0, -1]),
        ("R2021b", 'coordinateSystem "NUE"', [0, -1, 0]),
    ],
)
def test_gravity_has_the_direction_of_the_release(header: str, info: str, falls: list[float]):
    scene = build_scene(read(f"#VRML_SIM {header} utf8\nWorldInfo {{ {info} }}"))
    assert scene.gravity == pytest.approx([9.81 * axis for axis in falls])


def test_a_template_of_the_project_gives_way_to_an_equivalent(tmp_path):
    (tmp_path / "protos" / "arenas").mkdir(parents=True)
    template = "#VRML_SIM R2023b utf8\nPROTO Floor [ ] { Solid { name %<= 1 >% } }"
    (tmp_path / "protos" / "arenas" / "Floor.proto").write_text(template)
    (warning,) = read("Floor { }", tmp_path).findings
    assert (warning.severity, warning.help) == ("warning", "its equivalent takes its place")


def test_a_car_of_an_older_file_looks_along_z_with_its_sensors():
    """Before R2022a, cars drive along z, and their slots turn a camera, which looks along -z, away from the car."""
    slots = (f'sensorsSlot{end} [ GPS {{ name "{end}" translation 0 0 -1 }} ]' for end in ("Front", "Rear"))
    simulation = simulate(f"BmwX5 {{ translation 0 0.4 0 {' '.join(slots)} }}")
    front, rear = device(simulation, "Front"), device(simulation, "Rear")
    front.enable(8)
    rear.enable(8)
    simulation.run_step()
    assert front.getValues() == pytest.approx([0, 0.85, 4.85], abs=0.01)
    assert rear.getValues() == pytest.approx([0, 0.7, -2], abs=0.01)


def test_a_create_turns_in_place_feels_a_wall_with_both_bumpers_and_sees_the_floor():
    text = f"{FLOOR} DEF ROBOT Create {{ }} Solid {{ translation 0.4 0 0 boundingObject Box {{ size 0.1 2 2 }} }}"
    simulation = simulate(text, NEW)
    sensors = [
        device(simulation, f"{kind}_{side}") for kind in ("bumper", "cliff") for side in ("left", "right")
    ]
    for sensor in sensors:
        sensor.enable(8)
    turning(simulation, -4, "left wheel motor")
    turning(simulation, 4, "right wheel motor")
    run(simulation, 1)
    turned = node(simulation, "ROBOT").getField("rotation").getSFRotation()[3]
    assert turned == pytest.approx(2 * 4 * 0.031 / 0.271756, rel=0.05)
    assert [sensor.getValue() for sensor in sensors[:2]] == [0, 0]
    assert all(700 < sensor.getValue() < 900 for sensor in sensors[2:])
    turning(simulation, 4, "left wheel motor")
    turning(simulation, -4, "right wheel motor")
    run(simulation, 1)
    for side in ("left", "right"):
        turning(simulation, 8, f"{side} wheel motor")
    touched = [False, False]
    for _ in range(250):
        simulation.run_step()
        touched = [was or bool(sensor.getValue()) for was, sensor in zip(touched, sensors, strict=False)]
    assert touched == [True, True]


def test_plain_equivalents_are_boxes():
    world = read(
        """ConveyorBelt { size 1 0.4 0.6 borderThickness 0.1 } E-puck { turretSlot [ Pi-puck { } ] }
        Solid { children [ Shape { geometry Rectangle { size 1 0.1 } } ] } Background { cubemap Cubemap { textureBaseName "x" } }"""
    )
    scene = build_scene(world)
    assert not [*world.findings]
    assert scene.bodies[0].geometries[0].shape.size == pytest.approx((1.2, 0.6, 0.6))
    assert visible_shape(scene.visuals[-1], world.files).size == (1, 0.1, 0.001)


def test_worlds_of_cities_load_with_plain_signs_and_buildings():
    names = sorted(equivalents() & {"StopSign", "GenericTrafficLight", "Hotel", "Oak", "PedestrianCrossing"})
    assert len(names) == 5
    world = read("\n".join(f"{name} {{ size 2 7 }}" for name in names))
    build_scene(world)
    assert {finding.severity for finding in world.findings} == {"warning"}
