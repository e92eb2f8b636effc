"""Mesh files are found, checked and hashed before an engine sees them.

Closed forms, and overrides against them.

Masses of links from their density: closed forms at once, meshes when they are simulated.

glTF files as meshes: their triangles against those of trimesh, and files that would hurt.
"""

from __future__ import annotations

import base64
import hashlib
import json
import math
import os
import re
import struct
from contextlib import closing
from dataclasses import replace
from itertools import chain
from pathlib import Path
from random import Random
from typing import Any

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from deepbots_cli import api, geometry
from deepbots_cli.diagnostics import Findings
from deepbots_cli.errors import EngineError
from deepbots_cli.geometry import mesh_triangles
from deepbots_cli.robots import meshes, packages
from deepbots_cli.robots.mesh_formats import FaultyMeshError, gltf_triangles, read_gltf
from deepbots_cli.robots.meshes import MAX_BYTES, mesh_bounds, mesh_reach, mesh_vertices
from deepbots_cli.robots.model import (
    Box,
    Capsule,
    Cylinder,
    Friction,
    Geometry,
    Inertial,
    Joint,
    Limit,
    Link,
    Mesh,
    Pose,
    RobotModel,
    Shape,
    Sphere,
    homogeneous_inertial,
    to_urdf,
    volume,
    with_density,
    with_friction,
    with_joint,
    with_mass,
    with_scale,
)
from deepbots_cli.robots.reader import RobotFile, read
from tests.robots.meshes import ball, block

COLLADA = "http://www.collada.org/2005/11/COLLADASchema"
TETRAHEDRON = b"v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 2 3\nf 1/1 2/2 4/3\nf -1 -2 -3\n"


def stl(claimed: int, held: int) -> bytes:
    return b"\0" * 80 + struct.pack("<I", claimed) + b"\0" * 50 * held


def robot_with(folder: Path, filename: str, scale: str = "1 2 3") -> tuple[RobotFile | None, list[str]]:
    text = f"""<robot name="r"><link name="a">
<inertial><mass value="1"/><inertia ixx="0.01" iyy="0.01" izz="0.01"/></inertial>
<visual><geometry><mesh filename="{filename}" scale="{scale}"/></geometry></visual></link></robot>"""
    (folder / "robot.urdf").write_text(text)
    findings = Findings()
    robot = read(folder / "robot.urdf", "robot.urdf", findings)
    for finding in findings:
        assert (finding.code, finding.span.text) == ("DB301", filename)
    return robot, [finding.headline for finding in findings]


def test_a_mesh_is_kept_by_its_real_path_and_digest(tmp_path: Path):
    (tmp_path / "m.obj").write_bytes(TETRAHEDRON)
    robot, headlines = robot_with(tmp_path, "m.obj")
    assert headlines == []
    path = os.path.realpath(tmp_path / "m.obj")
    digest = hashlib.sha256(TETRAHEDRON).hexdigest()
    assert robot.model.links[0].visuals[0].shape == Mesh(path, digest, (1.0, 2.0, 3.0))
    assert robot.meshes == {path: digest}


def test_a_mesh_is_checked_once_until_its_content_changes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    checked = []
    check = meshes.mesh_problem
    monkeypatch.setattr(
        meshes, "mesh_problem", lambda suffix, data: checked.append(data) or check(suffix, data)
    )
    sound = TETRAHEDRON + b"# read twice\n"
    broken = b"v 0 0 0\nv 1 0 0\nf 1 2 3\n"
    problems = []
    for content in (sound, sound, broken, broken):
        (tmp_path / "m.obj").write_bytes(content)
        problems.append(robot_with(tmp_path, "m.obj")[1])
    assert (checked, problems[:2]) == ([sound, broken], [[], []])
    assert problems[2] == problems[3] != []


def test_the_normalized_robot_finds_its_meshes_from_anywhere(tmp_path: Path):
    (tmp_path / "m.obj").write_bytes(TETRAHEDRON)
    robot, _ = robot_with(tmp_path, "m.obj")
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "elsewhere/n.urdf").write_text(to_urdf(robot.model))
    again = read(tmp_path / "elsewhere/n.urdf", "n.urdf", Findings(), resolve_mesh=Path)
    assert again.model == robot.model


def sheets(name: str, count: int, *, scale: float = 1.0) -> bytes:
    """A file of so many triangles over each other, in one plane or, with a scale other than 1, in planes one
    below the other."""
    corners = [
        [(0.0, 0.0, z), (0.2, 0.0, z), (0.0, 0.2, z)]
        for z in (number * (scale - 1.0) for number in range(count))
    ]
    points = [point for triangle in corners for point in triangle]
    if name.endswith(".stl"):
        body = b"".join(
            struct.pack("<12fH", 0, 0, 0, *chain.from_iterable(triangle), 0) for triangle in corners
        )
        return bytes(80) + struct.pack("<I", count) + body
    if name.endswith(".obj"):
        vertices = "".join(f"v {x:.9g} {y:.9g} {z:.9g}\n" for x, y, z in points)
        return (
            vertices
            + "".join(f"f {3 * n + 1} {3 * n + 2}/1/1 {3 * n - len(points) + 2}\n" for n in range(count))
        ).encode()
    numbers = " ".join(f"{each:.9g}" for point in points for each in point)
    indices = " ".join(f"0 {n}" for n in range(len(points)))
    return f"""<COLLADA xmlns="{COLLADA}" version="1.4.1"><asset/><library_geometries><geometry id="g"><mesh>
<source id="s"><float_array id="f" count="{3 * len(points)}">{numbers}</float_array>
<technique_common><accessor/></technique_common></source>
<vertices id="v"><input semantic="POSITION" source="#s"/></vertices>
<triangles count="{count}"><input semantic="NORMAL" source="#s" offset="0"/><input semantic="VERTEX" source="#v" offset="1"/>
<p>{indices}</p></triangles></mesh></geometry></library_geometries>
<library_visual_scenes><visual_scene id="w"><node id="n"><instance_geometry url="#g"/></node></visual_scene>
</library_visual_scenes><scene><instance_visual_scene url="#w"/></scene></COLLADA>""".encode()


CONTENTS = {
    "a.obj": (b"# nothing\n", "the OBJ file contains no vertex"),
    "b.obj": (
        b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 99999999\n",
        "a face of the OBJ file has vertex 99999999, but the file has only 3 vertices",
    ),
    "c.obj": (b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 " + b"9" * 9999 + b"\n", "but the file has only 3 vertices"),
    "d.obj": (b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf -1 -2 -9\n", "but the file has only 3 vertices"),
    "e.obj": (b"v nan 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", "a vertex that is not finite"),
    "f.obj": (b"v 0 0 0\n", "the OBJ file contains no face"),
    "h.obj": (
        b"v 0 e90 0\nv 1 0 0\nv 0 1 9999999\nf 1 2 3\n",
        "a vertex of the OBJ file is not three numbers",
    ),
    "i.obj": (b"v 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", "a vertex of the OBJ file is not three numbers"),
    "g.stl": (
        b"solid x\nfacet normal 0 0 1\nvertex 0 1.2.3 0\n",
        "a vertex of the STL file is not three numbers",
    ),
    "g.obj": (b"\0\1\2", "the OBJ file is not text"),
    "a.stl": (
        stl(100_000_000, 1),
        "the STL file declares 100,000,000 triangles, but it is as long as a file of 1 triangles",
    ),
    "b.stl": (b"short", "the STL file is shorter than its header"),
    "c.stl": (stl(0, 0), "the STL file contains no triangle"),
    "d.stl": (stl(1, 1) + b"\n", "declares 1 triangles, but it is as long as a file of 1.02"),
    "e.stl": (stl(1, 0) + struct.pack("<12f", *[math.nan] * 12) + b"\0\0", "a vertex that is not finite"),
    "f.stl": (b"solid x\nfacet normal 0 0 1\nvertex 0 nan 0\n", "a vertex that is not finite"),
    "h.stl": (b"solid x\nfacet normal 0 0 1\nendfacet\n", "the STL file contains no triangle"),
    "i.stl": (
        b"solid x\nfacet normal 0 0 1\nvertex 0 0 0\nvertex 1 0 0\nendfacet\n",
        "a triangle of the STL file does not have three vertices",
    ),
    "n.dae": (
        sheets("n.dae", 1).replace(b'<scene><instance_visual_scene url="#w"/></scene>', b""),
        "the COLLADA file has no <scene>",
    ),
    "o.dae": (
        re.sub(b"<triangles.*</triangles>", b"", sheets("o.dae", 1), flags=re.DOTALL),
        "the scene of the COLLADA file has no triangle or polygon",
    ),
    "p.dae": (
        sheets("p.dae", 1).replace(b"<instance_geometry", b"<instance_controller"),
        "the scene of the COLLADA file has no triangle or polygon",
    ),
    "q.dae": (
        sheets("q.dae", 1).replace(b"triangles", b"tristrips"),
        "the scene of the COLLADA file has no triangle or polygon",
    ),
    "a.dae": (b"<COLLADA/>", "the COLLADA file has no <asset>"),
    "b.dae": (b"hello", "the mesh is not a COLLADA file"),
    "c.dae": (b"<!DOCTYPE x [<!ENTITY a 'b'>]><COLLADA>&a;</COLLADA>", "the mesh is not a COLLADA file"),
    "d.dae": (
        sheets("d.dae", 1).replace(b"0 2</p>", b"0 99999999</p>"),
        "has vertex 99999999, but there are only 3 vertices",
    ),
    "e.dae": (
        sheets("e.dae", 1).replace(b"0 2</p>", b"0 -9</p>"),
        "has vertex -9, but there are only 3 vertices",
    ),
    "f.dae": (sheets("f.dae", 1).replace(b"<p>", b"<p>0 x "), "an index of the COLLADA file is not a number"),
    "g.dae": (
        sheets("g.dae", 1).replace(b'<triangles count="1"', b'<triangles count="99999999"'),
        "has fewer triangles than its count",
    ),
    "h.dae": (sheets("h.dae", 1).replace(b'source="#v"', b'source="#w"'), "refers to no positions"),
    "i.dae": (
        sheets("i.dae", 1).replace(b'<source id="s"', b"<source"),
        "a <source> of the COLLADA file has no id",
    ),
    "j.dae": (
        sheets("j.dae", 1).replace(b"<geometry id=", b"<geometry name="),
        "a <geometry> of the COLLADA file has no id",
    ),
    "k.dae": (sheets("k.dae", 1).replace(b'semantic="VERTEX"', b""), "has no <input> with semantic VERTEX"),
    "l.dae": (
        sheets("l.dae", 1).replace(b'offset="0"', b""),
        "an <input> of the COLLADA file lacks its semantic, source or offset",
    ),
    "m.dae": (sheets("m.dae", 1).replace(b"<accessor/>", b""), "refers to no positions"),
    "fan.obj": (b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf" + b" 1 2 3" * 1_000 + b"\n", "cover each other about"),
    "zip.obj": (b"PK\x03\x04" + bytes(100), "the mesh is an archive"),
    "large.stl": (bytes(MAX_BYTES + 1), "the mesh is larger than 32 MiB"),
    "a.ply": (b"ply", "the mesh format '.ply' is not supported"),
    "noext": (b"", "the mesh format '' is not supported"),
}


@pytest.mark.parametrize("name", CONTENTS)
def test_a_mesh_that_would_hurt_an_engine_is_refused(tmp_path: Path, name):
    data, expected = CONTENTS[name]
    (tmp_path / name).write_bytes(data)
    robot, headlines = robot_with(tmp_path, name)
    assert robot is None
    assert len(headlines) == 1
    assert expected in headlines[0]


def test_sound_files_of_each_format_pass_and_have_triangles(tmp_path: Path):
    contents = {
        "a.OBJ": TETRAHEDRON,
        "b.stl": stl(2, 2),
        "c.STL": b"solid x\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 1 0\n"
        b"endloop\nendfacet\nendsolid x\n",
        "capitals.stl": b"SOLID X\nFACET NORMAL 0 0 1\nOUTER LOOP\nVERTEX 0 0 0\nVERTEX 1 0 0\nVERTEX 0 1 0\n"
        b"ENDLOOP\nENDFACET\nENDSOLID X\n",
        "d.dae": sheets("d.dae", 1),
        # PyBullet leaves polygons out, and MuJoCo has them.
        "p.dae": sheets("p.dae", 1)
        .replace(b"triangles", b"polylist")
        .replace(b"<p>", b"<vcount>3</vcount><p>"),
    }
    for name, data in contents.items():
        (tmp_path / name).write_bytes(data)
        robot, headlines = robot_with(tmp_path, name)
        assert (headlines, mesh_triangles(robot.model.links[0].visuals[0].shape).shape[1:]) == ([], (3, 3))


@pytest.mark.parametrize("name", ["flat.stl", "flat.obj", "flat.dae"])
def test_flat_triangles_over_each_other_that_no_renderer_finishes_are_refused(tmp_path: Path, name):
    """PyBullet took 440 s for a picture of 640,000 triangles at random in one plane."""
    (tmp_path / name).write_bytes(sheets(name, 199))
    assert robot_with(tmp_path, name)[1] == []
    (tmp_path / name).write_bytes(sheets(name, 2_000))
    (headline,) = robot_with(tmp_path, name)[1]
    assert headline == "the triangles of the mesh cover each other about 1,000 times, and the limit is 100"


def test_sheets_below_one_another_are_refused_where_the_scale_puts_them_into_one_plane(tmp_path: Path):
    (tmp_path / "m.obj").write_bytes(sheets("m.obj", 2_000, scale=2.0))
    for factor, refused in ((1.0, False), (1e-6, True)):
        loaded = meshes.MeshReader(packages.mesh_resolver(tmp_path)).load("m.obj", (1.0, 1.0, factor))
        assert isinstance(loaded, packages.UnusableMesh) == refused


@pytest.mark.parametrize(("count", "apart", "refused"), [(100, 0.0, True), (150, 0.2, False)])
def test_parts_of_a_mesh_cover_each_other_where_their_nodes_place_them(
    tmp_path: Path, count: int, apart: float, refused: bool
) -> None:
    whole = sheets("m.dae", count).decode()
    (node,) = re.findall("<node.*</node>", whole)
    places = [node.replace("<inst", f"<translate>{apart * n} 0 0</translate><inst") for n in range(40)]
    (tmp_path / "m.dae").write_text(whole.replace(node, "".join(places)))
    assert bool(robot_with(tmp_path, "m.dae")[1]) == refused


def test_many_triangles_that_do_not_cover_each_other_are_not_a_fault(tmp_path: Path):
    (tmp_path / "ball.obj").write_bytes(ball(0.2, 60))
    assert robot_with(tmp_path, "ball.obj")[1] == []
    n = 120
    points = "".join(f"v {x} {y} 0\n" for y in range(n + 1) for x in range(n + 1))
    squares = (y * (n + 1) + x + 1 for y in range(n) for x in range(n))
    (tmp_path / "floor.obj").write_text(
        points + "".join(f"f {k} {k + 1} {k + n + 2} {k + n + 1}\n" for k in squares)
    )
    assert robot_with(tmp_path, "floor.obj")[1] == []


def test_meshes_stay_inside_the_folder_of_the_robot(tmp_path: Path):
    inner = tmp_path / "robot"
    inner.mkdir()
    (tmp_path / "secret.obj").write_bytes(TETRAHEDRON)
    (inner / "link.obj").symlink_to(tmp_path / "secret.obj")
    for filename in (
        "../secret.obj",
        "link.obj",
        str(tmp_path / "secret.obj"),
        f"file://{tmp_path}/secret.obj",
        "package://../secret.obj",
    ):
        assert robot_with(inner, filename)[1] == ["the mesh lies outside the folder of the robot"], filename


def test_a_mesh_in_a_folder_above_is_read_with_a_warning_where_that_folder_is_allowed(tmp_path: Path):
    inner = tmp_path / "robots" / "car"
    inner.mkdir(parents=True)
    (tmp_path / "shapes").mkdir()
    (tmp_path / "shapes/m.obj").write_bytes(TETRAHEDRON)
    assert robot_with(inner, "shapes/m.obj")[1] == ["the mesh does not exist"]
    findings = Findings()
    robot = read(
        inner / "robot.urdf", "robot.urdf", findings, resolve_mesh=packages.mesh_resolver(inner, [tmp_path])
    )
    assert [(finding.code, finding.help) for finding in findings] == [
        ("DB311", 'write filename="../../shapes/m.obj"')
    ]
    assert list(robot.meshes) == [os.path.realpath(tmp_path / "shapes/m.obj")]


@pytest.mark.parametrize(
    ("filename", "expected"),
    [
        ("gone.obj", "the mesh does not exist"),
        ("http://x.org/m.obj", "deepbots cannot download a mesh from 'http'"),
        ("x" * 5000 + ".obj", "cannot be read"),
        ("folder.obj", "the mesh is not a regular file"),
        ("pipe.obj", "the mesh is not a regular file"),
    ],
)
def test_a_mesh_that_is_not_there_is_an_error_at_its_name(tmp_path: Path, filename, expected):
    (tmp_path / "folder.obj").mkdir()
    os.mkfifo(tmp_path / "pipe.obj")
    assert expected in robot_with(tmp_path, filename)[1][0]


def test_a_resolver_limits_which_files_are_read(tmp_path: Path):
    (tmp_path / "m.obj").write_bytes(TETRAHEDRON)
    robot_with(tmp_path, "m.obj")
    findings = Findings()
    assert (
        read(
            tmp_path / "robot.urdf",
            "r",
            findings,
            resolve_mesh=lambda _: packages.UnusableMesh("not today", "come back"),
        )
        is None
    )
    assert (findings.errors[0].headline, findings.errors[0].help) == ("not today", "come back")


@pytest.mark.parametrize("name", ["m.stl", "m.obj", "m.dae"])
def test_a_damaged_mesh_of_many_triangles_gives_findings_and_no_error_of_python(tmp_path: Path, name):
    random = Random(0)
    whole = sheets(name, 150)
    for _ in range(150):
        data = bytearray(whole)
        for _ in range(random.randint(1, 20)):
            at = random.randrange(len(data))
            data[at : at + random.randint(0, 3)] = random.choice(
                (b"", b"-", b"9" * 30, b"<", b'"', b"e9", b"\n", bytes([random.randrange(256)]))
            )
        (tmp_path / name).write_bytes(data)
        robot_with(tmp_path, name)


sizes = st.floats(0.1, 10)
DENSITY = 3.0


def robot(
    shape: Shape,
    origin: Pose = Pose(),  # noqa: B008
    rpy: tuple[float, float, float] = (0.0, 0.0, 0.0),
) -> RobotModel:
    """One link of homogeneous material, with a child at (0.1, 0.2, 0.3)."""
    body = homogeneous_inertial(shape, DENSITY * (volume(shape) or 1), origin)
    geometry = Geometry(shape, origin)
    links = (Link("a", body, (geometry,), (geometry,)), Link("b", Inertial(1.0, ixx=1.0, iyy=1.0, izz=1.0)))
    return RobotModel("r", links, (Joint("j", "continuous", "a", "b", Pose((0.1, 0.2, 0.3), rpy)),), "a")


def moments(body: Inertial | None) -> tuple[float, ...]:
    assert body is not None
    return (body.mass, *body.origin.xyz, body.ixx, body.ixy, body.ixz, body.iyy, body.iyz, body.izz)


def model_of(result: RobotModel | str) -> RobotModel:
    assert isinstance(result, RobotModel), result
    return result


@settings(max_examples=50)
@given(st.tuples(sizes, sizes, sizes), st.tuples(sizes, sizes, sizes), st.tuples(sizes, sizes, sizes))
def test_a_stretched_box_is_the_box_of_the_new_size(size, scale, at):
    stretched = model_of(with_scale(robot(Box(size), Pose(at)), "a", scale))
    new = tuple(s * f for s, f in zip(size, scale, strict=True))
    link = stretched.link("a")
    assert link.visuals[0].shape == Box(new)
    assert moments(link.inertial) == pytest.approx(
        moments(
            homogeneous_inertial(
                Box(new), DENSITY * math.prod(new), Pose(tuple(a * f for a, f in zip(at, scale, strict=True)))
            )
        )
    )


@settings(max_examples=50)
@given(sizes, sizes, sizes, sizes)
def test_a_cylinder_may_grow_in_length_and_in_radius(radius, length, across, along):
    stretched = model_of(
        with_scale(robot(Cylinder(radius, length), rpy=(0.1, 0.2, 0.3)), "a", (across, across, along))
    )
    assert stretched.joint("j").origin == Pose((0.1 * across, 0.2 * across, 0.3 * along), (0.1, 0.2, 0.3))
    new = Cylinder(radius * across, length * along)
    assert stretched.link("a").collisions[0].shape == new
    assert moments(stretched.link("a").inertial) == pytest.approx(
        moments(homogeneous_inertial(new, DENSITY * math.pi * new.radius**2 * new.length))
    )


@pytest.mark.parametrize("shape", [Sphere(0.3), Capsule(0.2, 0.7), Cylinder(0.3, 0.1), Box((1.0, 2.0, 3.0))])
def test_every_shape_grows_evenly(shape):
    stretched = model_of(
        with_scale(robot(shape, Pose((1.0, 2.0, 3.0), (0.3, -0.2, 1.0))), "a", (2.0, 2.0, 2.0))
    ).link("a")
    assert stretched.inertial.mass == pytest.approx(8 * robot(shape).link("a").inertial.mass)
    assert moments(stretched.inertial)[4:] == pytest.approx(
        [32 * value for value in moments(robot(shape).link("a").inertial)[4:]]
    )
    assert stretched.inertial.origin.xyz == (2.0, 4.0, 6.0)


def test_a_shape_turned_by_a_right_angle_is_scaled_along_its_own_axes():
    lying = Pose((0.0, 0.0, 0.0), (math.pi / 2, 0.0, 0.0))  # its z along -y of the link
    shape = (
        model_of(with_scale(robot(Cylinder(0.1, 1.0), lying), "a", (2.0, 3.0, 2.0)))
        .link("a")
        .visuals[0]
        .shape
    )
    assert (shape.radius, shape.length) == (pytest.approx(0.2), pytest.approx(3.0))


def test_the_inertia_of_a_turned_frame_is_stretched_in_the_axes_of_the_link():
    model = robot(Box((1.0, 2.0, 3.0)), Pose((0.0, 0.0, 0.0), (0.0, 0.0, math.pi / 2)))
    stretched = model_of(with_scale(model, "a", (5.0, 1.0, 1.0))).link("a").inertial
    assert moments(stretched)[4:] == pytest.approx(
        moments(homogeneous_inertial(Box((1.0, 10.0, 3.0)), 6 * 5 * DENSITY))[4:]
    )


def test_a_mesh_is_stretched_by_its_scale():
    mesh = Mesh("/m.stl", "0", (1.0, 1.0, 2.0))
    model = RobotModel("r", (Link("a", None, (Geometry(mesh),)),), (), "a")
    assert model_of(with_scale(model, "a", (1.0, 2.0, 3.0))).link("a").visuals[0].shape == replace(
        mesh, scale=(1.0, 2.0, 6.0)
    )


@pytest.mark.parametrize(
    ("shape", "origin", "scale", "why"),
    [
        (Sphere(1.0), Pose(), (1.0, 1.0, 2.0), "a sphere would not stay round"),
        (Cylinder(1.0, 1.0), Pose(), (1.0, 2.0, 2.0), "a cylinder would not stay round"),
        (Capsule(1.0, 1.0), Pose(), (1.0, 1.0, 2.0), "the ends of a capsule would not stay round"),
        (Box((1.0, 1.0, 1.0)), Pose(rpy=(0.0, 0.0, 0.5)), (1.0, 2.0, 1.0), "skew"),
        (Box((1.0, 1.0, 1.0)), Pose(), (1.0, 0.0, 1.0), "above 0"),
        (Box((1.0, 1.0, 1.0)), Pose(), (1.0, math.nan, 1.0), "above 0"),
    ],
)
def test_a_shape_that_cannot_follow_says_why(shape, origin, scale, why):
    answer = with_scale(robot(shape, origin), "a", scale)
    assert isinstance(answer, str)
    assert why in answer


def test_a_new_mass_scales_the_inertia():
    model = model_of(with_mass(robot(Box((1.0, 2.0, 3.0))), "a", 5.0))
    assert moments(model.link("a").inertial) == pytest.approx(
        moments(homogeneous_inertial(Box((1.0, 2.0, 3.0)), 5.0))
    )


def test_a_mass_that_cannot_be_changed_says_why():
    assert isinstance(with_mass(RobotModel("r", (Link("a"),), (), "a"), "a", 1.0), str)
    assert isinstance(with_mass(robot(Sphere(1.0)), "a", 0.0), str)


def test_joint_and_friction_overrides_change_only_what_is_named():
    model = with_joint(
        with_joint(robot(Sphere(1.0)), "j", damping=0.5), "j", friction=0.1, limit=Limit(effort=2.0)
    )
    assert (model.joint("j").damping, model.joint("j").friction, model.joint("j").limit.effort) == (
        0.5,
        0.1,
        2.0,
    )
    model = with_friction(with_friction(model, "a", lateral=0.3), "a", rolling=0.0)
    assert model.link("a").friction == Friction(lateral=0.3, rolling=0.0)
    assert model.link("b") == robot(Sphere(1.0)).link("b")


@pytest.mark.parametrize(
    "shape", [Box((0.36, 0.6, 0.96)), Sphere(0.5), Cylinder(0.4, 1.0), Capsule(0.3, 0.6)]
)
def test_the_closed_forms_agree_with_a_sum_over_small_cubes(shape):
    """A grid of 40 cubes along the longest side; the surface cubes make an error of some per cent."""
    step = 1.2 / 40
    ticks = [-0.6 + step * (i + 0.5) for i in range(40)]
    inside = [(x, y, z) for x in ticks for y in ticks for z in ticks if _holds(shape, x, y, z)]
    body = homogeneous_inertial(shape, 2.0)
    share = 2.0 / len(inside)
    assert volume(shape) == pytest.approx(len(inside) * step**3, rel=0.05)
    assert body.ixx == pytest.approx(share * sum(y * y + z * z for _, y, z in inside), rel=0.03)
    assert body.izz == pytest.approx(share * sum(x * x + y * y for x, y, _ in inside), rel=0.03)


def _holds(shape: Shape, x: float, y: float, z: float) -> bool:
    match shape:
        case Box(size):
            return abs(x) < size[0] / 2 and abs(y) < size[1] / 2 and abs(z) < size[2] / 2
        case Sphere(r):
            return math.hypot(x, y, z) < r
        case Cylinder(r, length):
            return math.hypot(x, y) < r and abs(z) < length / 2
        case Capsule(r, length):
            return math.hypot(x, y, max(abs(z) - length / 2, 0)) < r
        case _:
            return False


@settings(max_examples=50)
@given(st.tuples(sizes, sizes, sizes), st.tuples(sizes, sizes, sizes))
def test_every_real_body_is_plausible_also_when_stretched(size, scale):
    model = robot(Box(size))
    assert model.link("a").inertial.is_plausible
    assert model_of(with_scale(model, "a", scale)).link("a").inertial.is_plausible


WOOD_DENSITY = 700.0  # kg/m^3


def one_shape(shape: Shape, origin: Pose = Pose()) -> RobotModel:  # noqa: B008  # frozen
    return RobotModel("r", (Link("a", collisions=(Geometry(shape, origin),)),), (), "a")


def mesh(folder: Path, name: str, data: bytes, scale: tuple[float, float, float] = (1.0, 1.0, 1.0)) -> Mesh:
    (folder / name).write_bytes(data)
    return Mesh(str(folder / name), hashlib.sha256(data).hexdigest(), scale)


def weighed(model: RobotModel) -> Inertial:
    dense = with_density(model, "a", WOOD_DENSITY)
    assert isinstance(dense, RobotModel)
    inertial = geometry.with_masses(dense).link("a").inertial
    assert inertial is not None
    return inertial


def mass_and_matrix(inertial: Inertial) -> list[float]:
    return [inertial.mass, *(entry for row in inertial.matrix for entry in row)]


@pytest.mark.parametrize("name", ["block.stl", "block.obj"])
@pytest.mark.parametrize("scale", [(1.0, 1.0, 1.0), (0.5, 2.0, -1.0)])
def test_a_block_of_triangles_weighs_what_a_box_does(
    tmp_path: Path, name: str, scale: tuple[float, float, float]
) -> None:
    inertial = weighed(
        one_shape(mesh(tmp_path, name, block(name, (0.1, 0.2, 0.3)), scale), Pose((1.0, 2.0, 3.0)))
    )
    size = (0.1 * scale[0], 0.2 * scale[1], 0.3 * abs(scale[2]))
    expected = homogeneous_inertial(Box(size), WOOD_DENSITY * math.prod(size))
    assert mass_and_matrix(inertial) == pytest.approx(
        mass_and_matrix(expected), rel=1e-6, abs=1e-9
    )  # an STL file has 32-bit floats
    assert inertial.origin.xyz == pytest.approx((1.0, 2.0, 3.0))


def test_a_ball_of_triangles_weighs_nearly_what_a_sphere_does(tmp_path: Path) -> None:
    inertial = weighed(one_shape(mesh(tmp_path, "ball.obj", ball(0.5, 120))))
    expected = homogeneous_inertial(Sphere(0.5), WOOD_DENSITY * 4 / 3 * math.pi * 0.5**3)
    assert mass_and_matrix(inertial) == pytest.approx(mass_and_matrix(expected), rel=2e-3, abs=1e-9)
    assert inertial.origin.xyz == pytest.approx((0.0, 0.0, 0.0), abs=1e-12)


BLOCK = block("block.obj", (0.1, 0.2, 0.3))
TURNED = Pose((0.0, 0.0, 0.0), (0.0, 0.0, math.pi / 2))


@pytest.mark.parametrize(
    ("data", "origin", "scale", "size"),
    [
        (BLOCK, TURNED, (1.0, 1.0, 1.0), (0.2, 0.1, 0.3)),
        (BLOCK, Pose(), (1.0, 1.0, 2.0), (0.1, 0.2, 0.6)),
        (block("block.obj", (0.1, 0.2, 0.3), outward=False), Pose(), (1.0, 1.0, 1.0), (0.1, 0.2, 0.3)),
        # Its convex hull counts.
        (b"\n".join(BLOCK.splitlines()[:-1]), Pose(), (1.0, 1.0, 1.0), (0.1, 0.2, 0.3)),
    ],
    ids=["turned", "stretched", "inside out", "open"],
)
def test_a_block_has_the_mass_and_the_inertia_of_its_box(
    tmp_path: Path,
    data: bytes,
    origin: Pose,
    scale: tuple[float, float, float],
    size: tuple[float, float, float],
) -> None:
    model = with_scale(one_shape(mesh(tmp_path, "block.obj", data), origin), "a", scale)
    expected = homogeneous_inertial(Box(size), WOOD_DENSITY * math.prod(size))
    assert mass_and_matrix(weighed(model_of(model))) == pytest.approx(mass_and_matrix(expected), abs=1e-12)


def test_a_flat_mesh_has_no_mass(tmp_path: Path) -> None:
    flat = b"v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nf 1 2 3\nf 1 3 4\n"
    with pytest.raises(EngineError, match="the mesh of link 'a' encloses no volume"):
        weighed(one_shape(mesh(tmp_path, "flat.obj", flat)))


def test_shapes_in_closed_form_are_weighed_at_once() -> None:
    dense = with_density(one_shape(Cylinder(0.1, 0.5), Pose((0.0, 0.0, 0.2))), "a", WOOD_DENSITY)
    assert isinstance(dense, RobotModel)
    volume = math.pi * 0.1**2 * 0.5
    assert dense.link("a").inertial == homogeneous_inertial(
        Cylinder(0.1, 0.5), WOOD_DENSITY * volume, Pose((0.0, 0.0, 0.2))
    )
    assert dense.link("a").density is None


def test_a_link_without_a_volume_is_an_error_that_says_why(tmp_path: Path) -> None:
    assert "has no shape" in str(with_density(RobotModel("r", (Link("a"),), (), "a"), "a", WOOD_DENSITY))


ROOT = Path(__file__).parents[2]
CARTPOLE = ROOT / "robots/urdf/cartpole.urdf"
SCENARIO = (ROOT / "scenarios/cartpole.yaml").read_text(encoding="utf-8")


def cartpole(folder: Path, pole: str) -> str:
    """A CartPole whose pole is a mesh with an inertial or without, and what the scenario says of it; the
    codes of the findings."""
    (folder / "pole.obj").write_bytes(block("pole.obj", (0.02, 0.02, 1.0)))
    box = homogeneous_inertial(Box((0.02, 0.02, 1.0)), WOOD_DENSITY * 0.0004, Pose((0.0, 0.0, 0.5)))
    assert box is not None
    moments = f'<inertia ixx="{box.ixx!r}" iyy="{box.iyy!r}" izz="{box.izz!r}"/>'
    written = f'<inertial><origin xyz="0 0 0.5"/><mass value="{box.mass!r}"/>{moments}</inertial>'
    shape = '<collision><origin xyz="0 0 0.5"/><geometry><mesh filename="pole.obj"/></geometry></collision>'
    text = re.sub(
        r'<link name="pole">.*?</link>',
        f'<link name="pole">{written if pole == "written" else ""}{shape}</link>',
        CARTPOLE.read_text(encoding="utf-8"),
        flags=re.DOTALL,
    )
    (folder / f"{pole}.urdf").write_text(text, encoding="utf-8")
    links = "\n    links: {pole: {density: 700 kg/m^3}}" if pole == "dense" else ""
    return SCENARIO.replace("urdf: ../robots/urdf/cartpole.urdf", f"urdf: {pole}.urdf{links}")


def test_a_link_of_a_scenario_takes_its_mass_from_its_density(tmp_path: Path) -> None:
    rolls, codes = {}, {}
    for pole in ("written", "dense", "bare"):
        file = tmp_path / f"{pole}.yaml"
        file.write_text(cartpole(tmp_path, pole), encoding="utf-8")
        codes[pole] = {finding.code for finding in api.lint(file)} & {"DB305", "DB301", "DB105"}
        if pole != "bare":
            with closing(api.make(file)) as environment:
                environment.reset(seed=0)
                rolls[pole] = [environment.step(step % 2)[0].tolist() for step in range(40)]
    assert codes == {"written": set(), "dense": set(), "bare": {"DB305"}}
    assert rolls["dense"] == [pytest.approx(row, abs=1e-3) for row in rolls["written"]]


def test_a_density_replaces_a_random_mass_of_an_earlier_pattern(tmp_path: Path) -> None:
    links = '{"*": {mass: urdf * uniform(0.9 .. 1.1)}, pole: {density: 700 kg/m^3}}'
    text = SCENARIO.replace("urdf: ../robots/urdf/cartpole.urdf", f"urdf: cartpole\n    links: {links}")
    (tmp_path / "a.yaml").write_text(text, encoding="utf-8")
    drawn = {varied.of[-1] for varied in api.compile(tmp_path / "a.yaml").program.reset.variations}
    assert ("body" in drawn, "pole" in drawn) == (True, False)


def test_a_mass_replaces_the_density_of_an_earlier_pattern(tmp_path: Path) -> None:
    links = '{"*": {density: 700 kg/m^3}, pole: {mass: 2 kg}}'
    text = cartpole(tmp_path, "dense").replace("{pole: {density: 700 kg/m^3}}", links)
    (tmp_path / "a.yaml").write_text(text, encoding="utf-8")
    (simulated,) = api.compile(tmp_path / "a.yaml").program.world.robots
    assert geometry.with_masses(simulated.model).link("pole").mass == pytest.approx(2.0)


@pytest.mark.parametrize(
    ("says", "code", "words"),
    [
        ("density: 700 kg/m^3, mass: 1 kg", "DB202", "cannot be combined"),
        ("density: 7 kg", "DB503", "density"),
        ("density: 0 kg/m^3", "DB105", "0"),
    ],
)
def test_a_density_that_cannot_be_meant_is_a_finding(
    tmp_path: Path, says: str, code: str, words: str
) -> None:
    text = SCENARIO.replace(
        "urdf: ../robots/urdf/cartpole.urdf", f"urdf: cartpole\n    links: {{pole: {{{says}}}}}"
    )
    (tmp_path / "a.yaml").write_text(text, encoding="utf-8")
    assert [finding.code for finding in api.lint(tmp_path / "a.yaml") if words in finding.headline] == [code]


# glTF files as meshes: their triangles against those of trimesh, and files that would hurt


POINTS = struct.pack("<9f", 0, 0, 0, 1, 0, 0, 0, 2, 0)
DOCUMENT: dict[str, Any] = {
    "asset": {"version": "2.0"},
    "scenes": [{"nodes": [0]}],
    "nodes": [{"mesh": 0, "translation": [0, 0, 3]}],
    "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}],
    "accessors": [{"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3"}],
    "bufferViews": [{"buffer": 0, "byteLength": 36}],
    "buffers": [{"byteLength": 36}],
}


def glb(document: dict[str, Any] = DOCUMENT, buffer: bytes = POINTS) -> bytes:
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    body = (
        struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(buffer), b"BIN\0") + buffer
    )
    return struct.pack("<4sII", b"glTF", 2, 12 + len(body)) + body


@pytest.mark.parametrize("suffix", ["glb", "gltf"])
def test_a_file_of_trimesh_gives_its_triangles(tmp_path: Path, suffix: str):
    scene = trimesh.Scene()
    turned = trimesh.transformations.rotation_matrix(0.5, [1, 2, 3], [0.1, 0.2, 0.3])
    scene.add_geometry(trimesh.creation.box((1, 2, 3)), transform=turned)
    scene.add_geometry(trimesh.creation.icosphere(2), transform=trimesh.transformations.scale_matrix(0.2))
    if suffix == "glb":
        (tmp_path / "m.glb").write_bytes(scene.export(file_type="glb"))
    else:
        for name, content in scene.export(file_type="gltf").items():
            (tmp_path / name.replace("model.gltf", "m.gltf")).write_bytes(content)
    robot, headlines = robot_with(tmp_path, f"m.{suffix}", "1 1 1")
    assert headlines == []
    mesh = robot.model.links[0].visuals[0].shape
    expected = scene.to_mesh()
    corners = mesh_triangles(mesh)
    assert corners.shape == expected.triangles.shape
    assert np.sort(corners.sum((1, 2))) == pytest.approx(np.sort(expected.triangles.sum((1, 2))), abs=1e-5)
    assert np.ravel(mesh_bounds(mesh)) == pytest.approx(expected.bounds.ravel(), abs=1e-6)


def test_a_mesh_that_is_missing_for_a_while_is_read_once_it_is_there(tmp_path: Path):
    trimesh.creation.box((1, 2, 3)).export(tmp_path / "m.stl")
    robot, _ = robot_with(tmp_path, "m.stl", "1 1 1")
    mesh = robot.model.links[0].visuals[0].shape
    moved = (tmp_path / "m.stl").rename(tmp_path / "moved.stl")
    assert (mesh_bounds(mesh), mesh_vertices(mesh), mesh_reach(mesh, (1, 0, 0))) == (None, (), 0)
    moved.rename(tmp_path / "m.stl")
    assert mesh_bounds(mesh) == ((-0.5, -1, -1.5), (0.5, 1, 1.5))
    assert (len(mesh_vertices(mesh)), mesh_reach(mesh, (1, 0, 0))) == (8, 0.5)


def test_buffers_in_the_text_and_beside_the_file_give_the_same(tmp_path: Path):
    uri = "data:application/octet-stream;base64," + base64.b64encode(POINTS).decode()
    for name, address in (("a.gltf", uri), ("b.gltf", "bras%20n%C2%B01%20%C3%A9.bin")):
        document = {**DOCUMENT, "buffers": [{"byteLength": 36, "uri": address}]}
        (tmp_path / name).write_text(json.dumps(document))
    (tmp_path / "bras n\u00b01 \u00e9.bin").write_bytes(POINTS)
    first, second = (read_gltf(tmp_path / name, MAX_BYTES) for name in ("a.gltf", "b.gltf"))
    assert first == second
    ((part, rows),) = gltf_triangles(first)
    assert list(part.moved(rows)) == [0, 0, 3, 1, 0, 3, 0, 2, 3]


def test_strips_and_fans_are_triangles():
    for mode, corners in ((5, [0, 1, 2, 2, 1, 3]), (6, [0, 1, 2, 0, 2, 3])):
        document = json.loads(json.dumps(DOCUMENT))
        document["meshes"][0]["primitives"][0]["mode"] = mode
        document["accessors"][0]["count"] = 4
        ((part, _),) = gltf_triangles(glb(document, POINTS + struct.pack("<3f", 1, 1, 1)))
        assert list(part.corners) == corners


def changed(*path: str | int, to: Any) -> dict[str, Any]:
    document = json.loads(json.dumps(DOCUMENT))
    node = document
    for step in path[:-1]:
        node = node[step]
    node[path[-1]] = to
    return document


LOOP = {"nodes": [{"children": [0], "mesh": 0}]}
FAULTS = {
    "no JSON": b"glTF" + struct.pack("<II", 2, 20) + struct.pack("<I4s", 0, b"JSON"),
    "a huge declared length": glb()[:8] + struct.pack("<I", 0xFFFFFFFF) + glb()[12:],
    "a part longer than the file": glb()[:12] + struct.pack("<I", 0x7FFFFFFF) + glb()[16:],
    "a count of billions": glb(changed("accessors", 0, "count", to=4_000_000_000)),
    "a negative place": glb(changed("bufferViews", 0, "byteOffset", to=-36)),
    "an index beyond": glb(changed("meshes", 0, "primitives", 0, "attributes", "POSITION", to=7)),
    "a node that holds itself": glb({**DOCUMENT, **LOOP}),
    "a buffer outside": glb(changed("bufferViews", 0, "buffer", to=1)),
    "a compressed mesh": glb({**DOCUMENT, "extensionsRequired": ["KHR_draco_mesh_compression"]}),
    "a position that is text": glb(changed("nodes", 0, "translation", to=["x", 0, 0])),
    "deep JSON": struct.pack("<4sII", b"glTF", 2, 20 + 100_000)
    + struct.pack("<I4s", 100_000, b"JSON")
    + b"[" * 100_000,
    "a vertex that is not finite": glb(buffer=struct.pack("<9f", *[float("nan")] * 9)),
    "nothing drawn": glb(changed("meshes", 0, "primitives", 0, "mode", to=1)),
}


@pytest.mark.parametrize("case", FAULTS)
def test_a_glb_file_that_would_hurt_is_one_finding(tmp_path: Path, case: str):
    (tmp_path / "m.glb").write_bytes(FAULTS[case])
    robot, headlines = robot_with(tmp_path, "m.glb")
    assert (robot, len(headlines)) == (None, 1)


@pytest.mark.parametrize(
    "uri", ["../secret.bin", "/etc/passwd", "http://x.org/b.bin", "link.bin", "gone.bin"]
)
def test_no_buffer_outside_the_folder_of_a_gltf_file_is_opened(tmp_path: Path, uri: str):
    (tmp_path / "secret.bin").write_bytes(POINTS)
    folder = tmp_path / "robot"
    folder.mkdir()
    (folder / "link.bin").symlink_to(tmp_path / "secret.bin")
    (folder / "m.gltf").write_text(json.dumps({**DOCUMENT, "buffers": [{"byteLength": 36, "uri": uri}]}))
    with pytest.raises(FaultyMeshError, match=r"outside its folder|does not exist beside it"):
        read_gltf(folder / "m.gltf", MAX_BYTES)
