"""A robot without `z` begins where both engines let it rest, whatever its collision shapes are.

The truth is what the engines settle to. Half of the robots collide as meshes: STL, OBJ and COLLADA files,
scaled, mirrored, turned, placed by nodes, in inches.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from random import Random

import pytest

from deepbots_cli import api, engines
from deepbots_cli.diagnostics import Findings
from deepbots_cli.geometry import mesh_triangles
from deepbots_cli.program.world import Ground, RobotBody, WorldModel
from deepbots_cli.robots import meshes
from deepbots_cli.robots.kinematics import resting_height, robot_bounds
from deepbots_cli.robots.model import Mesh, Pose, RobotModel
from deepbots_cli.robots.reader import read
from tests.files import written
from tests.robots.meshes import Point, Triangle, as_obj, as_stl, ball, block

TOLERANCE_M = 5e-4
MAX_UPWARD_SPEED = 0.01
TIMESTEP = 0.004

# Meshes

CUBE = (0.04, 0.06, 0.05)
WEDGE: tuple[list[Point], list[Triangle]] = (
    [(-0.1, -0.1, -0.03), (0.1, -0.1, -0.03), (0.1, 0.1, -0.03), (-0.1, 0.1, -0.03), (0.0, 0.0, 0.05)],
    [(0, 2, 1), (0, 3, 2), (0, 1, 4), (1, 2, 4), (2, 3, 4), (3, 0, 4)],
)
"""A pyramid, 3 cm from its origin to its base."""


def prism(radius: float, length: float, sides: int = 128) -> bytes:
    """A wheel along z as an STL file."""
    around = [2 * math.pi * side / sides for side in range(sides)]
    points: list[Point] = [
        (radius * math.cos(a), radius * math.sin(a), z) for z in (-length / 2, length / 2) for a in around
    ]
    faces: list[Triangle] = []
    for side in range(sides):
        after = (side + 1) % sides
        faces += [(side, after, sides + after), (side, sides + after, sides + side)]
        faces += [(0, after, side), (sides, sides + side, sides + after)]
    return as_stl(points, faces)


def text_stl() -> bytes:
    points, faces = WEDGE
    corners = ["".join("vertex {} {} {}\n".format(*points[corner]) for corner in face) for face in faces]
    facets = (f"facet normal 0 0 1\nouter loop\n{three}endloop\nendfacet\n" for three in corners)
    return f"solid wedge\n{''.join(facets)}endsolid wedge\n".encode()


def collada(nodes: str = "", *, meter: float = 1.0, polygons: bool = False) -> bytes:
    """The pyramid as a COLLADA file; `nodes` are the elements that move it."""
    points, faces = WEDGE
    numbers = " ".join(str(number) for point in points for number in point)
    indices = " ".join(str(corner) for face in faces for corner in face)
    kind = "polylist" if polygons else "triangles"
    counts = f"<vcount>{'3 ' * len(faces)}</vcount>" if polygons else ""
    return f"""<?xml version="1.0"?>
<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1">
<asset><unit meter="{meter}"/><up_axis>Z_UP</up_axis></asset>
<library_geometries><geometry id="g"><mesh>
<source id="s"><float_array id="a" count="{3 * len(points)}">{numbers}</float_array>
<technique_common><accessor source="#a" count="{len(points)}" stride="3"/></technique_common></source>
<vertices id="v"><input semantic="POSITION" source="#s"/></vertices>
<{kind} count="{len(faces)}"><input semantic="VERTEX" source="#v" offset="0"/>
{counts}<p>{indices}</p></{kind}>
</mesh></geometry></library_geometries>
<library_visual_scenes><visual_scene id="w"><node id="n">{nodes}
<instance_geometry url="#g"/></node></visual_scene>
</library_visual_scenes><scene><instance_visual_scene url="#w"/></scene></COLLADA>""".encode()


FILES: dict[str, Callable[[], bytes]] = {
    "cube.stl": lambda: block("cube.stl", CUBE),
    "cube.obj": lambda: block("cube.obj", CUBE),
    "loose.obj": lambda: block("loose.obj", CUBE) + b"\nv 0 0 -9\n",
    "ball.obj": lambda: ball(0.02, 24),
    "wheel.stl": lambda: prism(0.06, 0.03),
    "wedge.stl": text_stl,
    "far.obj": lambda: as_obj([(x, y, z + 0.2) for x, y, z in WEDGE[0]], WEDGE[1]),
    "plain.dae": collada,
    "polygons.dae": lambda: collada(polygons=True),
    "placed.dae": lambda: collada(
        "<translate>0 0 2</translate><rotate>0 0 1 30</rotate><rotate>1 0 0 180</rotate><scale>3 3 2</scale>",
        meter=0.0254,
    ),
}


# Robots


def inertial(mass: float, center: str) -> str:
    moment = 4e-3 * mass
    return (
        f'<inertial><origin xyz="{center}"/><mass value="{mass}"/>'
        f'<inertia ixx="{moment}" iyy="{moment}" izz="{moment}" ixy="0" ixz="0" iyz="0"/></inertial>'
    )


def link(*shapes: str, name: str = "body", mass: float = 1.0, center: str = "0 0 0") -> str:
    pieces = "".join(
        f"<collision>{origin}<geometry>{shape}</geometry></collision>"
        for origin, _, shape in (text.rpartition("|") for text in shapes)
    )
    return f'<link name="{name}">{inertial(mass, center)}{pieces}</link>'


def mesh(name: str, scale: str = "1 1 1") -> str:
    return f'<mesh filename="{name}" scale="{scale}"/>'


def origin(xyz: str, rpy: str = "0 0 0") -> str:
    return f'<origin xyz="{xyz}" rpy="{rpy}"/>|'


def buggy(wheel: str, caster: str) -> str:
    turned = origin("0 0 0", "1.5707963 0 0")
    wheels = "".join(
        link(turned + wheel, name=name, mass=0.2)
        + f'<joint name="{name}_axle" type="continuous"><parent link="body"/><child link="{name}"/>'
        f'<origin xyz="-0.05 {side} 0.01"/><axis xyz="0 1 0"/></joint>'
        for name, side in (("left", 0.1), ("right", -0.1))
    )
    box = '<box size="0.2 0.14 0.04"/>'
    return link(origin("0 0 0.03") + box, origin("0.1 0 -0.03") + caster) + wheels


BOX, SPHERE = '<box size="0.1 0.2 0.06"/>', '<sphere radius="0.02"/>'
CYLINDER = '<cylinder radius="0.06" length="0.03"/>'
ROBOTS = {
    "a box": link(BOX),
    "a box away from its origin": link(origin("0.1 0 0.2") + BOX, center="0.1 0 0.2"),
    "a box on its side": link(origin("0 0 0", "1.5707963 0 0") + BOX),
    "a sphere": link(SPHERE),
    "a cylinder on its base": link(CYLINDER),
    "a cylinder on its side": link(origin("0 0 0", "1.5707963 0 0") + CYLINDER),
    "a capsule on its side": link(origin("0 0 0", "0 1.5707963 0") + '<capsule radius="0.03" length="0.1"/>'),
    "two boxes": link(BOX, origin("0 0 -0.05") + '<box size="0.3 0.3 0.02"/>'),
    "wheels and a caster": buggy(CYLINDER, SPHERE),
    "a sphere beside a box": link(
        origin("0 0 0.02") + BOX, origin("0 0 -0.02") + '<box size="0.2 0.2 0.01"/>'
    ),
    "a cube, STL": link(mesh("cube.stl")),
    "a cube, OBJ, with a loose vertex": link(mesh("loose.obj")),
    "a pyramid as text": link(mesh("wedge.stl")),
    "a pyramid in millimeters": link(mesh("cube.obj", "0.5 0.5 2")),
    "a mirrored pyramid that lies on its base": link(
        origin("0 0 0.1", "3.14159265 0 0") + mesh("wedge.stl", "1 1 -1"), center="0 0 0.1"
    ),
    "a turned pyramid far from its origin": link(
        origin("0.3 0 0", "0 0 0.7") + mesh("far.obj"), center="0.3 0 0.2"
    ),
    "COLLADA": link(mesh("plain.dae")),
    "COLLADA of polygons": link(mesh("polygons.dae")),
    "COLLADA in inches, placed by a node": link(origin("0 0 0", "3.14159265 0 0") + mesh("placed.dae")),
    "wheels and a caster of triangles": buggy(mesh("wheel.stl"), mesh("ball.obj")),
}


def robot(folder: Path, name: str, inside: str) -> RobotModel:
    for file, content in FILES.items():
        (folder / file).write_bytes(content())
    path = written(folder / "robot.urdf", f'<robot name="robot">{inside}</robot>')
    findings = Findings()
    file = read(path, name, findings)
    assert file is not None, list(findings)
    return file.model


def test_half_of_twenty_robots_collide_as_meshes() -> None:
    assert (len(ROBOTS), sum("<mesh" in text for text in ROBOTS.values())) == (20, 10)


@pytest.mark.parametrize("engine", ["pybullet", "mujoco"])
@pytest.mark.parametrize("name", ROBOTS)
def test_a_robot_starts_at_the_height_at_which_the_engine_lets_it_rest(
    tmp_path: Path, name: str, engine: str
) -> None:
    model = robot(tmp_path, name, ROBOTS[name])
    height = resting_height(model)
    body = RobotBody("robot", model, fixed_base=False, pose=Pose((0.0, 0.0, height)))
    world = WorldModel(TIMESTEP, 1, robots=(body,), ground=Ground())
    with closing(engines.create(engine, world)) as opened:
        opened.reset()
        opened.place("robot", (0.0, 0.0, height), (0.0, 0.0, 0.0, 1.0))
        pose, velocity = opened.pose("robot"), opened.velocity("robot")
        speeds = []
        for _ in range(100):
            opened.step(1)
            speeds.append(velocity()[0][2])
        assert pose()[0][2] == pytest.approx(height, abs=TOLERANCE_M)
        assert max(speeds) < MAX_UPWARD_SPEED


# Scenarios

SCENARIO = """deepbots: 1
name: Rest
world: {timestep: 20 ms, substeps: 5}
robots:
  robot:
    urdf: robot.urdf
    sensors: {q: {type: joint_position, joint: slide_0}}
    actuators: {hold: {type: position_motor, joints: [slide_0, slide_1, slide_2]}}
    apply: {hold: u * 0 m + 0.05 m}
action: {u: -1 .. 1}
observation: {robot.q: auto}
reward: {height: position(robot).z / m}
reset:
  place: {robot: {x: 0 m}}
  joints: {robot.slide_0: 0.05 m, robot.slide_1: 0.05 m, robot.slide_2: 0.05 m}
truncation: {max_steps: 50}
train: {algorithm: PPO, total_timesteps: 10_000}
"""


def lifted(foot: str) -> str:
    """A plate on three feet; each slides downward."""
    feet = "".join(
        link(foot, name=f"foot_{number}", mass=0.1)
        + f'<joint name="slide_{number}" type="prismatic"><parent link="body"/><child link="foot_{number}"/>'
        f'<origin xyz="{x} {y} 0"/><axis xyz="0 0 -1"/>'
        '<limit lower="0" upper="0.2" effort="500" velocity="1"/></joint>'
        for number, (x, y) in enumerate(((0.2, 0.0), (-0.1, 0.15), (-0.1, -0.15)))
    )
    return link('<box size="0.1 0.1 0.02"/>') + feet


@pytest.mark.parametrize("engine", ["pybullet", "mujoco"])
@pytest.mark.parametrize("foot", ["ball.obj", "cube.stl"])
def test_a_robot_starts_on_its_feet_where_the_reset_sets_its_joints(
    tmp_path: Path, engine: str, foot: str
) -> None:
    robot(tmp_path, "robot", lifted(mesh(foot)))
    file = written(tmp_path / "rest.yaml", SCENARIO.replace("substeps: 5", f"substeps: 5, engine: {engine}"))
    expected = 0.05 + (0.02 if foot == "ball.obj" else 0.025)
    with closing(api.make(file)) as environment:
        environment.reset(seed=0)
        heights = [environment.step([0.0])[1] for _ in range(20)]
    assert heights == pytest.approx([expected] * 20, abs=TOLERANCE_M)


# The lowest point


@pytest.mark.parametrize("file", FILES)
def test_the_lowest_vertex_is_that_of_all_corners_in_any_attitude(tmp_path: Path, file: str) -> None:
    model = robot(tmp_path, "robot", link(mesh(file, "1 -2 0.5")))
    corners = mesh_triangles(model.links[0].collisions[0].shape).reshape(-1, 3)
    random = Random(0)
    for _ in range(5):
        roll, pitch = random.uniform(-3.0, 3.0), random.uniform(-1.5, 1.5)
        down = (math.sin(pitch), -math.cos(pitch) * math.sin(roll), -math.cos(pitch) * math.cos(roll))
        assert resting_height(model, roll, pitch) == pytest.approx(float((corners @ down).max()), abs=1e-9)


@pytest.mark.parametrize(
    ("moved", "size"),
    [
        ("<scale>2 3 4</scale>", (0.4, 0.6, 0.32)),
        ("<matrix>0 0 1 5 0 2 0 6 3 0 0 7 0 0 0 1</matrix>", (0.08, 0.4, 0.6)),
        ("<rotate>0 0 1 90</rotate><scale>2 1 1</scale>", (0.2, 0.4, 0.08)),
    ],
)
@pytest.mark.parametrize("meter", [1.0, 0.01])
def test_a_collada_mesh_has_the_size_of_its_nodes_and_of_its_unit(
    tmp_path: Path, moved: str, size: tuple[float, float, float], meter: float
) -> None:
    (tmp_path / "moved.dae").write_bytes(collada(moved, meter=meter))
    shape = robot(tmp_path, "robot", link(mesh("moved.dae"))).links[0].collisions[0].shape
    assert isinstance(shape, Mesh)
    low, high = meshes.mesh_bounds(shape) or ((), ())
    assert [b - a for a, b in zip(low, high, strict=True)] == pytest.approx([meter * side for side in size])


def test_a_robot_of_collada_files_is_as_large_as_its_meshes(tmp_path: Path) -> None:
    low, high = robot_bounds(robot(tmp_path, "robot", link(mesh("plain.dae"))))
    assert [b - a for a, b in zip(low, high, strict=True)] == pytest.approx([0.2, 0.2, 0.08])


def test_a_node_that_places_itself_is_a_finding(tmp_path: Path) -> None:
    (tmp_path / "loop.dae").write_bytes(collada('<instance_node url="#n"/>'))
    (tmp_path / "robot.urdf").write_text(f'<robot name="r">{link(mesh("loop.dae"))}</robot>')
    findings = Findings()
    assert read(tmp_path / "robot.urdf", "robot.urdf", findings) is None
    assert [finding.headline for finding in findings] == ["the COLLADA file places more than 10,000 nodes"]


def test_a_mesh_of_very_many_vertices_has_the_height_of_its_box(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(meshes, "MAX_EXACT_VERTICES", 100)
    assert resting_height(robot(tmp_path, "robot", link(mesh("ball.obj", "3 3 3")))) == pytest.approx(0.06)


def test_a_mesh_that_has_gone_rests_at_its_origin(tmp_path: Path) -> None:
    model = robot(tmp_path, "robot", link(mesh("cube.stl", "7 7 7")))
    (tmp_path / "cube.stl").unlink()
    assert resting_height(model) == 0.0


def test_a_camera_sees_a_collada_mesh_where_it_is_touched(tmp_path: Path) -> None:
    pytest.importorskip("pybullet")
    moved = "<translate>0 0.1 0</translate><rotate>0 0 1 90</rotate><rotate>0 1 0 -90</rotate>"
    (tmp_path / "moved.dae").write_bytes(collada(moved))
    shape = robot(tmp_path, "robot", link(mesh("moved.dae"))).links[0].collisions[0].shape
    points = mesh_triangles(shape).reshape(-1, 3).tolist()
    faces = [(at, at + 1, at + 2) for at in range(0, len(points), 3)]
    (tmp_path / "same.obj").write_bytes(as_obj(points, faces))
    seen = []
    for file in ("moved.dae", "same.obj"):
        body = RobotBody("robot", robot(tmp_path, "robot", link(mesh(file))), fixed_base=True)
        world = WorldModel(TIMESTEP, 1, ground=None, robots=(body,))
        with closing(engines.create("pybullet", world)) as engine:
            look = engine.camera(("robot", None), ((-0.6, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0)), 32, 32, 0.9)
            seen.append(look().bodies >= 0)
    assert seen[1].any()
    assert (seen[0] == seen[1]).all()
