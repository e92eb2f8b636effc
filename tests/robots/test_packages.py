"""The places where a mesh is looked for, and that nothing outside the allowed folders is opened."""

from __future__ import annotations

import os
import tempfile
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from deepbots_cli.diagnostics import Findings
from deepbots_cli.robots import packages
from deepbots_cli.robots.packages import MeshElsewhere, Places, UnusableMesh, mesh_resolver
from deepbots_cli.robots.reader import read

MESH = b"v 0 0 0\nv .1 0 0\nv 0 .1 0\nv 0 0 .1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"
MANIFEST = "<?xml version='1.0'?><package><!-- <name>other</name> --><name> {} </name></package>"


def write(folder: Path, **files: str | bytes) -> None:
    for name, content in files.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content.encode() if isinstance(content, str) else content)


def located(robot: Path, reference: str, *allowed: Path) -> Path | None:
    """The file that a robot file names; None for a refusal."""
    place = mesh_resolver(robot, allowed)(reference)
    if isinstance(place, MeshElsewhere):
        return place.path
    return None if isinstance(place, UnusableMesh) else place


# The robot file is `ws/arm/urdf/arm.urdf`, and `ws` is allowed.
PLACES = {
    "the folder of the package": ("package://arm/meshes/m.obj", "arm/meshes/m.obj", {}),
    "a checkout of another name": ("package://robot/m.obj", "arm/m.obj", {"arm/package.xml": "robot"}),
    "a sibling": ("package://hand/m.obj", "hand/m.obj", {}),
    "a sibling by its package.xml": ("package://hand/m.obj", "x/m.obj", {"x/package.xml": "hand"}),
    "a deeper package": ("package://hand/m.obj", "a/b/x/m.obj", {"a/b/x/package.xml": "hand"}),
    "three slashes": ("package:///meshes/m.obj", "arm/meshes/m.obj", {}),
    "no name": ("package://meshes/m.obj", "arm/meshes/m.obj", {}),
    "a file alone": ("package://m.obj", "arm/m.obj", {}),
    "a name of Gazebo": ("model://arm/m.obj", "arm/m.obj", {}),
    "a name with blanks": ("package://my arm/a mesh.obj", "my arm/a mesh.obj", {}),
    "another package name": ("package://gone/meshes/m.obj", "arm/meshes/m.obj", {}),
    "a folder of the author": ("/home/x/ws/src/arm/meshes/m.obj", "arm/meshes/m.obj", {}),
    "a folder of an author with Windows": (r"C:\ws\arm\meshes\m.obj", "arm/meshes/m.obj", {}),
}


@pytest.mark.parametrize("case", PLACES)
def test_a_mesh_is_found_in(tmp_path: Path, case: str):
    reference, mesh, manifests = PLACES[case]
    write(tmp_path, **{"arm/urdf/arm.urdf": "", mesh: MESH})
    write(tmp_path, **{path: MANIFEST.format(name) for path, name in manifests.items()})
    assert located(tmp_path / "arm/urdf", reference, tmp_path) == Path(os.path.realpath(tmp_path / mesh))


def test_the_nearest_place_with_the_file_counts_and_not_a_namesake_without_it(tmp_path: Path):
    write(tmp_path, **{"robot/lab/arm/urdf/robot/a.txt": "", "robot/lab/arm/meshes/m.obj": MESH})
    write(tmp_path, **{"robot/lab/arm/package.xml": MANIFEST.format("robot")})
    place = located(tmp_path / "robot/lab/arm/urdf", "package://robot/meshes/m.obj", tmp_path)
    assert place == Path(os.path.realpath(tmp_path / "robot/lab/arm/meshes/m.obj"))


def test_of_two_packages_of_one_name_the_nearest_counts(tmp_path: Path):
    write(tmp_path, **{"arm/urdf/a.urdf": "", "hand/m.obj": MESH, "arm/hand/m.obj": MESH})
    place = located(tmp_path / "arm/urdf", "package://hand/m.obj", tmp_path)
    assert place == Path(os.path.realpath(tmp_path / "arm/hand/m.obj"))


@pytest.mark.parametrize(("variable", "folder"), [("ROS_PACKAGE_PATH", ""), ("AMENT_PREFIX_PATH", "share")])
def test_the_folders_of_ros_count_where_they_are_allowed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, variable: str, folder: str
):
    write(tmp_path / "ros" / folder, **{"hand/m.obj": MESH})
    write(tmp_path / "arm", **{"a.urdf": ""})
    monkeypatch.setenv(variable, f"/nowhere{os.pathsep}{tmp_path / 'ros'}")
    assert located(tmp_path / "arm", "package://hand/m.obj", tmp_path / "ros") is not None
    assert located(tmp_path / "arm", "package://hand/m.obj") is None


def test_the_name_in_a_package_xml_of_100_mb_is_read_from_its_beginning(tmp_path: Path):
    write(tmp_path, **{"arm/urdf/a.urdf": "", "x/m.obj": MESH, "x/package.xml": "<package>"})
    with (tmp_path / "x/package.xml").open("r+b") as file:
        file.truncate(100 << 20)
        file.seek(99 << 20)
        file.write(b"<name>hand</name>")
    assert located(tmp_path / "arm/urdf", "package://hand/m.obj", tmp_path) is None


def test_a_link_out_of_the_allowed_folders_is_not_followed(tmp_path: Path):
    write(tmp_path, **{"secret/m.obj": MESH, "home/arm/a.urdf": ""})
    (tmp_path / "home/hand").symlink_to(tmp_path / "secret")
    (tmp_path / "home/arm/m.obj").symlink_to(tmp_path / "secret/m.obj")
    for reference in ("package://hand/m.obj", "m.obj", "package://arm/m.obj", "/x/y/hand/m.obj"):
        assert located(tmp_path / "home/arm", reference, tmp_path / "home") is None, reference


def test_one_message_says_how_many_meshes_are_missing_where_they_were_looked_for_and_what_to_allow(
    tmp_path: Path,
):
    names = [f"m{number}.obj" for number in range(30)]
    write(tmp_path, **{f"arm/meshes/{name}": MESH for name in names})
    shapes = "".join(
        f'<visual><geometry><mesh filename="package://arm/meshes/{name}"/></geometry></visual>'
        for name in names
    )
    write(tmp_path, **{"arm/urdf/arm.urdf": f'<robot name="r"><link name="a">{shapes}</link></robot>'})
    robot, findings = tmp_path / "arm/urdf/arm.urdf", Findings()
    places = Places(robot.parent, suggests=True)
    assert read(robot, "arm.urdf", findings, resolve_mesh=places.resolve) is None
    (finding,) = findings
    assert finding.headline == "the mesh lies outside the folder of the robot"
    assert "and 24 more" in " ".join(finding.notes)
    (folder,) = places.suggested
    assert f"`--allow-path {folder}`" in str(finding.help)
    assert read(robot, "arm.urdf", Findings(), resolve_mesh=mesh_resolver(robot.parent, [folder])) is not None


def test_the_whole_clone_is_to_be_allowed_since_its_other_packages_are_there(tmp_path: Path, monkeypatch):
    write(tmp_path, **{"clone/arm/meshes/m.obj": MESH, "clone/arm/urdf/arm.urdf": "", "clone/.git/HEAD": ""})
    folder = tmp_path / "clone/arm/urdf"
    place = Places(folder, suggests=True).resolve("package://arm/meshes/m.obj")
    assert isinstance(place, UnusableMesh)
    assert place.allow == tmp_path / "clone"
    monkeypatch.chdir(tmp_path / "clone")
    place = Places(folder, suggests=True).resolve("package://arm/meshes/m.obj")
    assert isinstance(place, UnusableMesh)
    assert place.allow == tmp_path / "clone/arm"


def test_a_file_of_the_same_name_nearby_is_offered_and_not_taken(tmp_path: Path):
    write(tmp_path, **{"robot.urdf": "", "assets/body.stl": MESH})
    place = mesh_resolver(tmp_path)("package://body.stl")
    assert isinstance(place, UnusableMesh)
    assert 'write filename="assets/body.stl"' in str(place.help)


parts = st.sampled_from(["..", ".", "arm", "hand", "secret", "m.obj", "meshes", "", "package.xml", "a b"])
references = st.tuples(
    st.sampled_from(["package://", "model://", "file://", "", "/", "package:///", "C:\\"]),
    st.lists(parts, max_size=6).map("/".join),
).map("".join)


@given(references)
def test_nothing_outside_the_allowed_folders_is_opened_or_listed(reference: str):
    with tempfile.TemporaryDirectory() as name, pytest.MonkeyPatch.context() as patch:
        top = Path(os.path.realpath(name))
        write(top, **{"package.xml": MANIFEST.format("arm"), "secret/m.obj": MESH, "secret/package.xml": ""})
        write(top, **{"home/arm/m.obj": MESH, "home/arm/package.xml": MANIFEST.format("arm")})
        (top / "home/hand").symlink_to(top / "secret")
        touched: list[Path] = []

        def read_at_most(path: Path, limit: int) -> bytes:
            touched.append(path)
            return path.read_bytes()[:limit]

        def scandir(path: Path) -> object:
            touched.append(path)
            return scan(path)

        scan = os.scandir
        patch.setattr(packages, "read_at_most", read_at_most)
        patch.setattr(os, "scandir", scandir)
        place = located(top / "home/arm", reference, top / "home")
        patch.undo()
        for path in [*touched, *([place] if place is not None else [])]:
            assert Path(os.path.realpath(path)).is_relative_to(top / "home"), path
