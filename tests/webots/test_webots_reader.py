"""Worlds as text: nodes, and findings about damaged worlds."""

from __future__ import annotations

import os
import time
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from deepbots_cli.diagnostics import Source
from deepbots_cli.errors import DeepbotsError
from deepbots_cli.webots.findings import WorldError
from deepbots_cli.webots.nodes import child, number, numbers, text, vector, walk
from deepbots_cli.webots.project import Files, read_world, world_of_source
from deepbots_cli.webots.scene_builder import build_scene
from deepbots_cli.webots.simulation import Simulation
from deepbots_cli.webots.syntax import MAX_DEPTH, parse
from tests.webots.worlds_of_webots import HEADER, node, read, simulate

EXAMPLE = """#VRML_SIM R2023b utf8
EXTERNPROTO "https://raw.githubusercontent.com/cyberbotics/webots/R2023b/projects/objects/floors/protos/RectangleArena.proto"
PROTO Wheel [ field SFFloat radius 0.04 field SFString name "wheel" field MFNode extra [ ] ]
{ Solid { name IS name children IS extra boundingObject Cylinder { radius IS radius height 0.02 } physics Physics { } } }
WorldInfo { basicTimeStep 16 info [ "a", "b" ] contactProperties [ ContactProperties { coulombFriction 0.5 } ] }
Viewpoint { orientation 0 0 1 0.5 position -1 0 1 }
RectangleArena { floorSize 2 2 } # a comment
DEF ROBOT Robot { translation 0 0 .1 children [ DEF SHAPE Shape { geometry Box { size 0.2 0.1 0.1 } }
  HingeJoint { jointParameters HingeJointParameters { axis 0 1 0 anchor 0 0.1 0 }
    device [ RotationalMotor { name "motor" }, PositionSensor { } ] endPoint Wheel { radius 0.05 } } ]
  boundingObject USE SHAPE physics Physics { density -1 mass 1 } controller "c" supervisor TRUE }
"""


def errors(text: str) -> list[str]:
    """Return the headlines of a world that cannot run."""
    try:
        world = read(text)
        build_scene(world)
    except WorldError as error:
        return [finding.headline for finding in error.findings]
    return [finding.headline for finding in world.findings.errors]


def warnings(text: str) -> list[str]:
    world = read(text)
    build_scene(world)
    return [finding.headline for finding in world.findings.warnings]


# What is read


def test_a_world_is_a_tree_of_nodes_with_places():
    document = parse(Source("w.wbt", EXAMPLE))
    assert document.release == "R2023b"
    assert [entry.type for entry in document.nodes] == ["WorldInfo", "Viewpoint", "RectangleArena", "Robot"]
    assert [entry.name for entry in document.externs] == ["RectangleArena"]
    robot = document.nodes[-1]
    assert robot.name == "ROBOT"
    assert robot.span.start_position == (8, 11)
    assert vector(robot, "translation") == (0, 0, 0.1)
    shape = child(robot, "boundingObject")
    assert shape is not None
    assert shape.name == "SHAPE"


def test_a_definition_is_used_by_reference_and_defaults_are_those_of_webots():
    world = read(EXAMPLE)
    info, _, _, robot = world.nodes
    assert number(info, "basicTimeStep") == 16
    assert number(info, "ERP") == 0.2
    assert text(robot, "window") == "<generic>"
    motor = next(motor_node for motor_node in walk(world.nodes) if motor_node.type == "RotationalMotor")
    assert number(motor, "maxVelocity") == 10
    assert number(motor, "maxTorque") == 10
    assert numbers(motor, "controlPID") == [10, 0, 0]


def test_a_proto_keeps_its_fields_and_becomes_its_body():
    wheel = next(entry for entry in walk(read(EXAMPLE).nodes) if entry.type == "Wheel")
    assert number(wheel, "radius") == 0.05
    assert wheel.body is not None
    cylinder = child(wheel.body, "boundingObject")
    assert cylinder is not None
    assert number(cylinder, "radius") == 0.05
    assert text(wheel.body, "name") == "wheel"


def test_nodes_in_a_field_of_a_proto_take_their_place_in_its_body():
    world = read(
        HEADER
        + "PROTO A [ field MFNode slot [ ] ] { Solid { translation 1 0 0 children [ Group { children IS slot } ] } }"
        + " A { slot [ DEF INNER Solid { translation 0 2 0 } ] }"
    )
    simulation = Simulation(build_scene(world), world.span)
    assert node(simulation, "INNER").getPosition() == pytest.approx([1, 2, 0])


def test_a_proto_of_the_project_is_read_from_its_file(tmp_path: Path):
    (tmp_path / "worlds").mkdir()
    (tmp_path / "protos").mkdir()
    (tmp_path / "protos" / "Ball.proto").write_text(
        HEADER
        + "PROTO Ball [ field SFFloat radius 1 ] { Solid { boundingObject Sphere { radius IS radius } } }"
    )
    path = tmp_path / "worlds" / "w.wbt"
    path.write_text(HEADER + 'EXTERNPROTO "../protos/Ball.proto"\nBall { radius 0.5 }')
    scene = build_scene(read_world(path))
    assert scene.bodies[0].geometries[0].shape.size == (0.5,)


def test_a_copy_of_webots_has_further_protos(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    folder = tmp_path / "webots" / "projects" / "objects" / "toys"
    folder.mkdir(parents=True)
    (folder / "Duck.proto").write_text(
        HEADER + "PROTO Duck [ ] { Solid { boundingObject Sphere { radius 0.1 } } }"
    )
    (tmp_path / "project" / "worlds").mkdir(parents=True)
    path = tmp_path / "project" / "worlds" / "w.wbt"
    path.write_text(HEADER + 'EXTERNPROTO "webots://projects/objects/toys/Duck.proto"\nDuck { }')
    missing = read_world(path).findings.errors
    assert [finding.headline for finding in missing] == ["PROTO Duck is not available"]
    assert not read_world(path, [tmp_path / "webots"]).findings.errors
    monkeypatch.setenv("WEBOTS_HOME", str(tmp_path / "webots"))
    assert not read_world(path).findings.errors


# Findings


@pytest.mark.parametrize(
    ("text", "headline"),
    [
        ("", "the first line is not a header of Webots"),
        ("\x00\x01\x02", "the file is binary"),
        (
            "#VRML_SIM R2021b utf8\nWorldInfo { }",
            "a world of R2021b; before R2022a other axes point up and along cylinders",
        ),
        (
            "#VRML_SIM V8.5 utf8\nWorldInfo { }",
            "a world of V8.5; before R2022a other axes point up and along cylinders",
        ),
        (HEADER + "WorldInfo {", "the end of the file in the place of the name of a field or '}'"),
        (HEADER + "WorldInfo { title }", "'}' in the place of a value"),
        (HEADER + 'WorldInfo { title "a }', "a string without its end"),
        (HEADER + "Robot { children [ Solid { ] }", "']' in the place of the name of a field or '}'"),
        (HEADER + "Robot { boundingObject USE BOX }", "USE of 'BOX', which no DEF names before"),
        (HEADER + "Solid { name 1 name 2 }", "the field name is written twice"),
        (HEADER + "1 2 3", "'1' in the place of a node"),
        (HEADER + "PROTO A [ field SFOdd x 1 ] { Solid { } }", "there is no type SFOdd"),
        (HEADER + "PROTO A [ ] { }", "PROTO A has no node"),
        (HEADER + "Solid { children [ " * (MAX_DEPTH + 1), f"nodes are more than {MAX_DEPTH} levels deep"),
    ],
)
def test_a_text_that_is_not_a_world_is_one_finding(text: str, headline: str):
    with pytest.raises(WorldError) as caught:
        world_of_source(Source("w.wbt", text), Path("/n/worlds/w.wbt"), Files(Path("/n")))
    (finding,) = caught.value.findings
    assert finding.headline == headline
    assert str(finding).startswith("w.wbt:")


@pytest.mark.parametrize(
    ("text", "headline"),
    [
        ("Robt { }", "there is no node Robt"),
        ("Solid { translation 1 2 }", "Solid.translation is 2 numbers, and not three numbers"),
        ("Solid { translation [ 1 2 3 ] }", "Solid.translation is a list, and not three numbers"),
        ("Solid { name 3 }", "Solid.name is not a text in quotes"),
        ("Robot { supervisor 1 }", "Robot.supervisor is not TRUE or FALSE"),
        ("Solid { translation 1e999 0 0 }", "Solid.translation is too large a number"),
        ("Solid { translation IS place }", "Solid.translation is IS place, outside of a PROTO"),
        (
            "Solid { boundingObject Sphere { radius -1 } }",
            "a Sphere whose size is not positive, or is above 1000 km",
        ),
        ("Solid { physics Physics { density -1 } }", "Physics with neither a density nor a mass"),
        ("WorldInfo { basicTimeStep 0 }", "basicTimeStep is 0 ms; it is between 1 and 10,000"),
        ('WorldInfo { coordinateSystem "NUE" }', "the axes of the world are NUE; deepbots has z upward"),
        ("Track { }", "the node Track is not implemented"),
        ("PROTO A [ ] { A { } } A { }", "PROTO A contains itself"),
        ("PROTO A [ ] { Solid { name IS x } } A { }", "the PROTO has no field 'x'"),
        ('EXTERNPROTO "webots://projects/a/B.proto" B { }', "PROTO B is not available"),
        (
            "PROTO A [ ] { Solid { translation %<= 1 >% 0 0 } } A { }",
            "PROTO A is a template, which only a file of its own may be",
        ),
        (
            'Solid { boundingObject Mesh { url "../../etc/passwd" } }',
            "the mesh '../../etc/passwd' is not a file of the project",
        ),
        (
            f'Solid {{ boundingObject Mesh {{ url "{"x" * 300}.stl" }} }}',
            f"the mesh '{'x' * 80}' is not a file of the project",
        ),
        (f'EXTERNPROTO "{"x" * 300}.proto" {"x" * 300} {{ }}', f"PROTO {'x' * 300} is not available"),
        (
            "Solid { boundingObject ElevationGrid { } }",
            "an ElevationGrid with less than two rows or columns, or without spacing",
        ),
        (
            "Solid { boundingObject IndexedFaceSet { coord Coordinate { point [ 0 0 0 ] } coordIndex [ 0 1 2 ] } }",
            "an IndexedFaceSet whose coordIndex names a point that does not exist",
        ),
        (
            "Solid { physics Physics { density -1 mass 1 inertiaMatrix [ 1 1 9, 0 0 0 ] } }",
            "inertiaMatrix is none of a rigid body",
        ),
        (
            "Robot { children [ HingeJoint { jointParameters HingeJointParameters { axis 0 0 0 } endPoint Solid { } } ] }",
            "the axis of a HingeJoint is zero",
        ),
    ],
)
def test_a_world_that_cannot_run_says_why(text: str, headline: str):
    assert errors(HEADER + text) == [headline]


@pytest.mark.parametrize(
    ("name", "data", "reason"),
    [
        ("a.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\n" + b"f 1 2 3\n" * 3_800_000, "more than 400,000"),
        ("a.stl", b"x" * 80 + (500_000).to_bytes(4, "little") + bytes(50 * 500_000), "it has 500,000 faces"),
        (
            "a.ply",
            b"ply\nformat ascii 1.0\nelement vertex 3\nelement face 3800000\n",
            "it has 3,800,000 faces",
        ),
    ],
)
def test_a_mesh_of_millions_of_faces_is_refused_before_it_is_loaded(
    tmp_path: Path, name: str, data: bytes, reason: str
):
    (tmp_path / "worlds").mkdir()
    (tmp_path / "worlds" / name).write_bytes(data)
    world = tmp_path / "worlds" / "w.wbt"
    text = f'{HEADER}Solid {{ boundingObject Mesh {{ url "{name}" }} }}'
    start = time.process_time()
    read_text = world_of_source(Source("w.wbt", text), world, Files(tmp_path))
    build_scene(read_text)
    (finding,) = read_text.findings.errors
    assert reason in finding.headline
    assert time.process_time() - start < 5


@pytest.mark.parametrize(
    ("text", "headline"),
    [
        ("Solid { colour 1 }", "Solid has no field 'colour'"),
        ("RectangleArena { floorSise 1 1 }", "RectangleArena has no field 'floorSise'"),
        (
            'EXTERNPROTO "https://x/Rust.proto" Solid { children [ Shape { appearance Rust { } } ] }',
            "the appearance Rust is not available",
        ),
        ("Solid { boundingObject Cone { } }", "Cone cannot collide"),
        (
            "Robot { children [ GPS { } GPS { } ] }",
            "the robot 'robot' has two devices 'gps'; the first one is used",
        ),
    ],
)
def test_a_world_runs_without_what_it_warns_of(text: str, headline: str):
    assert warnings(HEADER + text) == [headline]


def test_findings_have_their_place_and_a_suggestion():
    world = read(HEADER + 'WorldInfo { }\nSolid {\n  naem "a"\n}')
    (finding,) = world.findings.warnings
    assert str(finding) == "world.wbt:4:8: warning: Solid has no field 'naem'\n  help: did you mean 'name'?"


@pytest.mark.skipif(os.name == "nt", reason="links need rights there")
def test_nothing_is_read_outside_of_the_project(tmp_path: Path):
    secret = tmp_path / "Secret.proto"
    secret.write_text(HEADER + "PROTO Secret [ ] { Solid { } }")
    (tmp_path / "project" / "worlds").mkdir(parents=True)
    (tmp_path / "project" / "protos").mkdir()
    (tmp_path / "project" / "protos" / "Secret.proto").symlink_to(secret)
    path = tmp_path / "project" / "worlds" / "w.wbt"
    for address in ("../protos/Secret.proto", "../../Secret.proto"):
        path.write_text(HEADER + f'EXTERNPROTO "{address}"\nSecret {{ }}')
        assert [finding.headline for finding in read_world(path).findings.errors] == [
            "PROTO Secret is not available"
        ]


# Damage


def survives(text: str) -> None:
    """Build and run a world, which may end in findings and in nothing else."""
    try:
        world = world_of_source(Source("w.wbt", text), Path("/n/worlds/w.wbt"), Files(Path("/n")))
        scene = build_scene(world)
        world.findings.require_none()
        simulation = Simulation(scene, world.span)
        for _ in range(2):
            simulation.run_step()
    except (DeepbotsError, FloatingPointError):
        pass


@given(st.data())
def test_a_damaged_world_ends_in_findings(data: st.DataObject):
    start = data.draw(st.integers(0, len(EXAMPLE)))
    length = data.draw(st.integers(0, 40))
    piece = data.draw(
        st.one_of(
            st.text(max_size=12),
            st.sampled_from(
                [
                    "{",
                    "}",
                    "[",
                    "]",
                    '"',
                    "IS x",
                    "USE ROBOT",
                    "DEF A",
                    "NULL",
                    "TRUE",
                    "-1",
                    "1e308",
                    "0",
                    "nan",
                    "#",
                    "PROTO B [",
                    "%<",
                ]
            ),
        )
    )
    survives(EXAMPLE[:start] + piece + EXAMPLE[start + length :])


@given(st.data())
def test_a_world_with_two_parts_exchanged_ends_in_findings(data: st.DataObject):
    words = EXAMPLE.split(" ")
    first, second = (data.draw(st.integers(5, len(words) - 1)) for _ in range(2))
    words[first], words[second] = words[second], words[first]
    survives(" ".join(words))


@given(st.text(max_size=200))
def test_any_text_ends_in_findings(text: str):
    survives(HEADER + text)


def test_the_example_runs():
    simulation = simulate(FLOOR_LESS)
    assert [robot.name for robot in simulation.scene.robots] == ["robot"]


FLOOR_LESS = 'Robot { children [ GPS { } ] controller "<none>" }'
