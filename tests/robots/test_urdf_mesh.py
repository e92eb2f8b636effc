"""Mesh files are found, checked and hashed before an engine sees them."""

from __future__ import annotations

import hashlib
import math
import os
import struct
import zipfile
from pathlib import Path

import pytest

from deepbots_cli.diagnostics import Findings
from deepbots_cli.robots import meshes
from deepbots_cli.robots.model import Mesh, to_urdf
from deepbots_cli.robots.reader import RobotFile, read

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
    path, digest = os.path.realpath(tmp_path / "m.obj"), hashlib.sha256(TETRAHEDRON).hexdigest()
    assert robot.model.links[0].visuals[0].shape == Mesh(path, digest, (1.0, 2.0, 3.0))
    assert robot.meshes == {path: digest}


def test_a_mesh_is_checked_once_until_its_content_changes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    checked, check = [], meshes.mesh_problem
    monkeypatch.setattr(
        meshes, "mesh_problem", lambda suffix, data: checked.append(data) or check(suffix, data)
    )
    sound, broken = TETRAHEDRON + b"# read twice\n", b"v 0 0 0\nv 1 0 0\nf 1 2 3\n"
    said = []
    for content in (sound, sound, broken, broken):
        (tmp_path / "m.obj").write_bytes(content)
        said.append(robot_with(tmp_path, "m.obj")[1])
    assert checked == [sound, broken]
    assert said[:2] == [[], []]
    assert said[2] == said[3] != []


def test_the_normalized_robot_finds_its_meshes_from_anywhere(tmp_path: Path):
    (tmp_path / "m.obj").write_bytes(TETRAHEDRON)
    robot, _ = robot_with(tmp_path, "m.obj")
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "elsewhere/n.urdf").write_text(to_urdf(robot.model))
    again = read(tmp_path / "elsewhere/n.urdf", "n.urdf", Findings(), resolve_mesh=Path)
    assert again.model == robot.model


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
    "a.dae": (b"<COLLADA/>", "the COLLADA file has no <asset>"),
    "b.dae": (b"hello", "the mesh is not a COLLADA file"),
    "c.dae": (b"<!DOCTYPE x [<!ENTITY a 'b'>]><COLLADA>&a;</COLLADA>", "the mesh is not a COLLADA file"),
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


def test_sound_files_of_each_format_pass(tmp_path: Path):
    contents = {
        "a.OBJ": TETRAHEDRON,
        "b.stl": stl(2, 2),
        "c.STL": b"solid x\nfacet normal 0 0 1\nendfacet\nendsolid x\n",
        "d.dae": b"<?xml version='1.0'?><COLLADA><asset/><library_geometries/><library_visual_scenes/></COLLADA>",
    }
    for name, data in contents.items():
        (tmp_path / name).write_bytes(data)
        assert robot_with(tmp_path, name)[1] == []


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


def test_a_folder_or_a_pipe_is_no_mesh(tmp_path: Path):
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


def test_a_resolver_decides_what_may_be_read(tmp_path: Path):
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
