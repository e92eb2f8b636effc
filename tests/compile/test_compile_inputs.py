"""The files that a scenario was made from, and the scenario made again from their copies."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from deepbots_cli import api
from deepbots_cli.compiler.inputs import copy_names
from deepbots_cli.document import shipped
from deepbots_cli.program import identity
from tests.few import LIGHT, few

MESH = b"v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"


def unpack(compiled: api.Compiled, folder: Path) -> Path:
    """The scenario and its inputs as a run keeps them."""
    for name, content in compiled.inputs.items():
        copy = folder / "inputs" / name
        copy.parent.mkdir(parents=True, exist_ok=True)
        copy.write_bytes(content)
    (folder / "resolved.yaml").write_text(compiled.resolved, encoding="utf-8")
    return folder / "resolved.yaml"


@pytest.fixture
def meshed(workshop, cartpole):
    """A project whose robot is drawn with a mesh that lies in a folder beside that of the robot."""
    folder = workshop.file.parent
    robot = shipped.robot_path("cartpole").read_text(encoding="utf-8")
    for name in ("robots", "meshes"):
        (folder / name).mkdir()
    (folder / "meshes" / "part.obj").write_bytes(MESH)
    (folder / "robots" / "mine.urdf").write_text(
        robot.replace('<box size="0.20 0.05 0.08"/>', '<mesh filename="../meshes/part.obj"/>', 1),
        encoding="utf-8",
    )
    (folder / "scenarios").mkdir()
    workshop.file = folder / "scenarios" / "scenario.yaml"
    return workshop.write(cartpole(("urdf: cartpole", "urdf: ../robots/mine.urdf")))


def test_inputs_are_all_files_and_stand_to_each_other_as_they_did(meshed):
    inputs = api.compile(meshed).inputs
    assert list(inputs) == ["scenarios/scenario.yaml", "robots/mine.urdf", "meshes/part.obj"]
    assert inputs["meshes/part.obj"] == MESH


@pytest.mark.parametrize("overrides", [(), ("world.gravity=0 0 -9.8 m/s^2", "world.substeps=5")])
@pytest.mark.parametrize("name", few(shipped.scenario_names(), LIGHT))
def test_a_resolved_scenario_compiles_to_the_same_from_its_copies(tmp_path, name, overrides):
    compiled = api.compile(name, overrides=overrides)
    assert api.compile(unpack(compiled, tmp_path)).digest == compiled.digest


def test_so_does_one_whose_project_is_gone(meshed, tmp_path_factory):
    compiled = api.compile(meshed)
    resolved = unpack(compiled, tmp_path_factory.mktemp("elsewhere"))
    shutil.rmtree(meshed.parents[1])
    again = api.compile(resolved)
    assert again.digest == compiled.digest
    assert identity.to_json(again.program) == identity.to_json(
        compiled.program
    )  # where the mesh lies does not count


def test_so_does_one_with_a_file_that_only_an_evaluation_case_names(meshed, tmp_path_factory):
    folder = meshed.parents[1]
    shutil.copy(folder / "robots" / "mine.urdf", folder / "robots" / "other.urdf")
    case = "evaluation:\n  cases:\n    other: {set: {robots.cart.urdf: ../robots/other.urdf}}\n"
    meshed.write_text(meshed.read_text(encoding="utf-8") + case, encoding="utf-8")
    compiled = api.compile(meshed)
    assert "robots/other.urdf" in compiled.inputs
    resolved = unpack(compiled, tmp_path_factory.mktemp("elsewhere"))
    shutil.rmtree(folder)
    assert api.compile(resolved).digest == compiled.digest


def test_another_mesh_is_another_scenario(meshed):
    before = api.compile(meshed).digest
    (meshed.parents[1] / "meshes" / "part.obj").write_bytes(MESH + b"v 2 2 2\n")
    assert api.compile(meshed).digest != before


def test_files_of_other_homes_get_folders_of_their_own():
    files = [
        Path(name)
        for name in (
            "/mine/a/x.yaml",
            "/ours/r/x.urdf",
            "/ours/m/x.stl",
            "/mine/b/y.yaml",
            "/far/z.urdf",
            "/mine/a/x.yaml",
        )
    ]
    named = copy_names(files, (Path("/mine"), Path("/ours")))
    assert list(named.values()) == [
        "a/x.yaml",
        "b/y.yaml",
        "elsewhere_1/r/x.urdf",
        "elsewhere_1/m/x.stl",
        "elsewhere_2/z.urdf",
    ]
