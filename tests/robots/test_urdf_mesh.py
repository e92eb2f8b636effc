"""Mesh files are found, checked and hashed before an engine sees them."""

from __future__ import annotations

import hashlib
import math
import os
import re
import struct
import zipfile
from itertools import chain
from pathlib import Path
from random import Random

import pytest

from deepbots_cli.diagnostics import Findings
from deepbots_cli.geometry import mesh_triangles
from deepbots_cli.robots import meshes
from deepbots_cli.robots.coverage import mesh_coverage
from deepbots_cli.robots.model import Mesh, to_urdf
from deepbots_cli.robots.reader import RobotFile, read
from tests.robots.meshes import ball

COLLADA = "http://www.collada.org/2005/11/COLLADASchema"
TETRAHEDRON = b"v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 2 3\nf 1/1 2/2 4/3\nf -1 -2 -3\n"


def stl(claimed: int, held: int) -> bytes:
    return b"\0" * 80 + struct.pack("<I", claimed) + b"\0" * 50 * held


def robot_with(folder: Path, filename: str) -> tuple[RobotFile | None, list[str]]:
    text = f"""<robot name="r"><link name="a">
<inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1"/></inertial>
<visual><geometry><mesh filename="{filename}" scale="1 2 3"/></geometry></visual></link></robot>"""
    (folder / "robot.urdf").write_text(text)
    findings = Findings()
    robot = read(folder / "robot.urdf", "robot.urdf", findings)
    for finding in findings:
        assert finding.code == "DB301"
        assert finding.span.text == filename
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
    assert checked == [sound, broken]
    assert problems[:2] == [[], []]
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
        "the COLLADA file contains no triangle or polygon",
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
        "d.dae": sheets("d.dae", 1),
    }
    for name, data in contents.items():
        (tmp_path / name).write_bytes(data)
        robot, headlines = robot_with(tmp_path, name)
        assert headlines == []
        assert mesh_triangles(robot.model.links[0].visuals[0].shape).shape[1:] == (3, 3)


def test_a_collada_file_of_polygons_is_sound(tmp_path: Path):
    """PyBullet leaves them out, and MuJoCo has them."""
    polygons = sheets("p.dae", 1).replace(b"triangles", b"polylist").replace(b"<p>", b"<vcount>3</vcount><p>")
    (tmp_path / "p.dae").write_bytes(polygons)
    assert robot_with(tmp_path, "p.dae")[1] == []


@pytest.mark.parametrize("name", ["flat.stl", "flat.obj", "flat.dae"])
def test_flat_triangles_over_each_other_that_no_renderer_finishes_are_refused(tmp_path: Path, name):
    """PyBullet took 440 s for a picture of 640,000 triangles at random in one plane."""
    (tmp_path / name).write_bytes(sheets(name, 199))
    assert robot_with(tmp_path, name)[1] == []
    (tmp_path / name).write_bytes(sheets(name, 2_000))
    (headline,) = robot_with(tmp_path, name)[1]
    assert headline == "the triangles of the mesh cover each other about 1,000 times, and the limit is 100"


def test_the_corners_of_one_face_that_repeat_are_refused(tmp_path: Path):
    (tmp_path / "fan.obj").write_bytes(b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf" + b" 1 2 3" * 1_000 + b"\n")
    assert "cover each other about" in robot_with(tmp_path, "fan.obj")[1][0]


def test_sheets_below_one_another_are_refused_where_the_scale_puts_them_into_one_plane(tmp_path: Path):
    (tmp_path / "m.obj").write_bytes(sheets("m.obj", 2_000, scale=2.0))
    for factor, refused in ((1.0, False), (1e-6, True)):
        loaded = meshes.MeshReader(meshes.mesh_resolver(tmp_path)).load("m.obj", (1.0, 1.0, factor))
        assert isinstance(loaded, meshes.UnusableMesh) == refused


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


def test_an_archive_is_refused_whatever_it_is_called(tmp_path: Path):
    with zipfile.ZipFile(tmp_path / "m.obj", "w") as archive:
        archive.writestr("m.obj", TETRAHEDRON)
    assert robot_with(tmp_path, "m.obj")[1] == ["the mesh is an archive"]


def test_a_large_mesh_is_refused(tmp_path: Path):
    with (tmp_path / "m.stl").open("wb") as file:
        file.truncate(meshes.MAX_BYTES + 1)
    assert robot_with(tmp_path, "m.stl")[1] == ["the mesh is larger than 32 MiB"]


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
        inner / "robot.urdf", "robot.urdf", findings, resolve_mesh=meshes.mesh_resolver(inner, [tmp_path])
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
    ],
)
def test_a_mesh_that_is_not_there_is_an_error_at_its_name(tmp_path: Path, filename, expected):
    assert expected in robot_with(tmp_path, filename)[1][0]


def test_a_folder_or_a_pipe_is_not_a_mesh(tmp_path: Path):
    (tmp_path / "d.obj").mkdir()
    os.mkfifo(tmp_path / "p.obj")
    for name in ("d.obj", "p.obj"):
        assert robot_with(tmp_path, name)[1] == ["the mesh is not a regular file"]


def test_a_package_is_an_installed_one_else_a_folder_above_else_beside_the_robot(tmp_path: Path):
    home = Path(os.path.realpath(Path(pytest.__file__).parent))
    assert meshes.locate_mesh("package://pytest/m.obj", tmp_path) == home / "m.obj"
    folder = tmp_path / "my_robot_description" / "urdf"
    folder.mkdir(parents=True)
    assert meshes.locate_mesh("package://my_robot_description/m.obj", folder) == Path(
        os.path.realpath(folder.parent / "m.obj")
    )
    assert meshes.locate_mesh("package://meshes/visual/m.obj", folder) == Path(
        os.path.realpath(folder / "meshes/visual/m.obj")
    )


def test_a_resolver_limits_which_files_are_read(tmp_path: Path):
    (tmp_path / "m.obj").write_bytes(TETRAHEDRON)
    robot_with(tmp_path, "m.obj")
    findings = Findings()
    assert (
        read(
            tmp_path / "robot.urdf",
            "r",
            findings,
            resolve_mesh=lambda _: meshes.UnusableMesh("not today", "come back"),
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
        mesh_coverage(Path(name).suffix, bytes(data), "seed")
