"""A robot whose meshes are named in each way that robot files know, from `train` to `resume`."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from deepbots_cli import api
from deepbots_cli.document import Permissions, shipped
from deepbots_cli.errors import RunError
from deepbots_cli.learning import train
from deepbots_cli.learning.runs.run import Run
from tests.commands import Deepbots

MESH = "v 0 0 0\nv .1 0 0\nv 0 .1 0\nv 0 0 .1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"
SCENARIO = """\
deepbots: 1
extends: cartpole
name: Meshed
remove: [solved]
evaluation: {{episodes: 2}}
robots: {{cart: {{urdf: {robot}}}}}
train: {{algorithm: PPO, total_timesteps: 64, environments: 1, n_steps: 32, batch_size: 32, n_epochs: 1}}
"""
# The robot file and the mesh, from the folder of the project, and how the robot file names the mesh.
WAYS = {
    "the folder of the project": ("urdf/r.urdf", "meshes/m.obj", "package://arms/meshes/m.obj"),
    "a folder above the project": ("urdf/r.urdf", "meshes/m.obj", "package://home/arms/meshes/m.obj"),
    "a folder of --allow-path": ("../other/urdf/r.urdf", "../other/m.obj", "package://other/m.obj"),
    "a folder in that of --allow-path": ("../other/a/b/r.urdf", "../other/a/m.obj", "package://a/m.obj"),
    "below the robot file": ("urdf/r.urdf", "urdf/x/meshes/m.obj", "package://x/meshes/m.obj"),
    "two folders of --allow-path": ("../other/r.urdf", "../far/m.obj", "../far/m.obj"),
    "a sibling of the folder of the robot file": ("urdf/r.urdf", "meshes/m.obj", "../meshes/m.obj"),
    "another way round": ("urdf/r.urdf", "urdf/m.obj", "../urdf/./m.obj"),
    "where PyBullet looks above": ("a/urdf/r.urdf", "meshes/m.obj", "meshes/m.obj"),
    "three slashes": ("urdf/r.urdf", "meshes/m.obj", "file://{home}/meshes/m.obj"),
    "an absolute path": ("urdf/r.urdf", "../other/m.obj", "{home}/../other/m.obj"),
    "characters of XML": ("urdf/r.urdf", "meshes/a&b's.obj", "package://arms/meshes/a&amp;b&apos;s.obj"),
}


@pytest.fixture
def project(
    request: pytest.FixtureRequest, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, deepbots: Deepbots
) -> list[str]:
    """A project whose robot names its mesh in the way of the parameter; the options that allow it."""
    home = tmp_path / "home" / "arms"
    robot, mesh, reference = request.param
    text = shipped.robot_path("cartpole").read_text(encoding="utf-8")
    drawn = f"<mesh filename='{reference.format(home=home)}'/>"
    files = {robot: text.replace('<box size="0.20 0.05 0.08"/>', drawn, 1), mesh: MESH, "deepbots.toml": ""}
    for name, content in {**files, "t.yaml": SCENARIO.format(robot=robot)}.items():
        (home / name).parent.mkdir(parents=True, exist_ok=True)
        (home / name).write_text(content, encoding="utf-8")
    monkeypatch.chdir(home)
    return [f"--allow-path=../{name}" for name in ("other", "far") if (home / ".." / name).is_dir()]


@pytest.mark.parametrize(
    "project",
    [
        pytest.param(
            way,
            id=name,
            marks=() if name == "two folders of --allow-path" else pytest.mark.slow,
        )
        for name, way in WAYS.items()
    ],
    indirect=True,
)
def test_a_training_with_meshes_of_other_folders_is_not_lost_at_its_end(
    project: list[str], deepbots: Deepbots, tmp_path: Path
):
    folders = tuple(option.partition("=")[2] for option in project)
    digest = api.compile("t.yaml", permissions=Permissions(folders)).digest
    assert "DB903" not in deepbots("lint", "t.yaml", "--deep", *project, code=None).out
    deepbots("train", "t.yaml", *project, "--run", "r")
    home = Path.cwd().rename(tmp_path / "moved")  # nothing but the run is left in its place
    run = Run.open(home / "r")
    assert run.digest == run.record.digest == digest
    deepbots("eval", home / "r", "--episodes", 1)
    deepbots("render", home / "r", "-o", home / "r.png", "--steps", 2)
    deepbots("resume", home / "r", "--timesteps", 128)


@pytest.mark.parametrize("project", [WAYS["the folder of the project"]], indirect=True)
def test_a_project_of_compile_has_meshes_of_other_folders(project: list[str], deepbots: Deepbots):
    deepbots("compile", "t.yaml", "--project", "out")
    Path("meshes/m.obj").unlink()
    assert api.compile("out/resolved.yaml").program is not None


@pytest.mark.parametrize(
    ("mesh", "reason"),
    [(b"", "does not compile: "), (MESH.replace(".1", ".2").encode(), "has changed since it was compiled")],
)
@pytest.mark.parametrize("project", [WAYS["the folder of the project"]], indirect=True)
def test_a_training_whose_copy_is_another_scenario_stops_before_its_first_step(
    project: list[str], mesh: bytes, reason: str
):
    compiled = api.compile("t.yaml")
    copies = {name: mesh if name.endswith(".obj") else each for name, each in compiled.inputs.items()}
    with pytest.raises(RunError, match=reason):
        train(replace(compiled, inputs=copies), run="r", on_start=lambda path: pytest.fail("has begun"))
    assert not Path("r").exists()
