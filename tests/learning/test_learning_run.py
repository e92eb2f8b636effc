"""The run directory: made once, complete, and read with suspicion."""

from __future__ import annotations

import json
import os
import shutil
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import pytest
import stand_in
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from deepbots_cli import api, canonical, interface
from deepbots_cli.document import shipped
from deepbots_cli.errors import RunError, UsageError
from deepbots_cli.learning import TrainingResult, evaluate, resume, train
from deepbots_cli.learning.run import Run, inside, new_directory
from deepbots_cli.program import Program
from deepbots_cli.program.training import Evaluation, Solved
from deepbots_cli.program.world import ObjectBody, RobotBody, Variant, WorldModel
from deepbots_cli.robots.model import Geometry, Inertial, Joint, Link, RobotModel, Sphere


def test_a_run_keeps_everything_that_it_was_made_from(trained: TrainingResult) -> None:
    files = {str(path.relative_to(trained.run)) for path in trained.run.rglob("*") if path.is_file()}
    assert {
        "run.json",
        "resolved.yaml",
        "scenario.ir.json",
        "environment.py",
        "monitor.csv",
        "checkpoint.npz",
        "models/best.npz",
        "models/last.npz",
        "inputs/stand_in.yaml",
        "inputs/_/robots/cart.urdf",
    } <= files
    assert any(name.startswith("tensorboard/events") for name in files)
    record = json.loads((trained.run / "run.json").read_text())
    assert record["status"] == "finished"
    assert record["command"] == ["deepbots", "train", "stand_in"]
    assert record["seed"] == 3
    assert {"python", "torch", "stable-baselines3", "numpy", "gymnasium", "pybullet"} <= set(record["versions"])
    assert record["result"]["steps"] == trained.steps


def test_a_run_is_never_overwritten(trained: TrainingResult) -> None:
    before = stand_in.tree_digest(trained.run)
    with pytest.raises(UsageError, match="never overwritten"):
        train(stand_in.compiled(), run=trained.run, build=stand_in.build)
    assert stand_in.tree_digest(trained.run) == before


def test_new_runs_are_numbered_past_all_that_exist(tmp_path: Path) -> None:
    (tmp_path / "cart_pole-0-7").mkdir()
    (tmp_path / "cart_pole-0-x").mkdir()
    assert [new_directory(None, tmp_path, "Cart Pole", 0).name for _ in range(2)] == ["cart_pole-0-8", "cart_pole-0-9"]
    assert new_directory(None, tmp_path, "../..", 0).parent == tmp_path


@given(st.text(alphabet="./\\:a\0~", max_size=12))
def test_copies_of_inputs_never_leave_the_run(name: str) -> None:
    path = inside(name)
    assert not path.is_absolute()
    assert path.parts
    assert ".." not in path.parts


def test_what_is_no_run_is_named_in_one_sentence(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    (tmp_path / "empty").mkdir()
    for name, reason in (("nothing", "no such directory"), ("file", "it is a file"), ("empty", "no run.json")):
        with pytest.raises(RunError, match=reason) as caught:
            Run.open(tmp_path / name)
        assert "\n" not in str(caught.value)


@pytest.mark.parametrize("version", [0, 2, 99])
def test_a_run_of_another_format_is_refused(run_copy: Path, version: int) -> None:
    edit(run_copy, format=version)
    with pytest.raises(RunError, match=f"format {version}"):
        evaluate(run_copy, build=stand_in.build)


def test_a_run_of_another_deepbots_warns(run_copy: Path) -> None:
    edit(run_copy, deepbots="9.9")
    assert "9.9" in evaluate(run_copy, episodes=1, build=stand_in.build).notes[0]


def test_a_scenario_that_was_changed_after_the_training_is_refused(run_copy: Path) -> None:
    path = run_copy / "scenario.ir.json"
    path.write_text(path.read_text().replace('"timestep":0.032', '"timestep":0.064'))
    with pytest.raises(RunError, match="not what was trained"):
        evaluate(run_copy, build=stand_in.build)


@pytest.mark.parametrize(
    "changes", [{"solved": Solved(-1, 1.0)}, {"solved": Solved(2**70, 1.0)}, {"world": WorldModel(0.0, 1)}, {"evaluation": Evaluation(0)}]
)
def test_a_forged_scenario_with_senseless_figures_is_refused(run_copy: Path, changes: dict[str, object]) -> None:
    forged = replace(stand_in.scenario(), **changes)  # type: ignore[arg-type]
    forge(run_copy, forged)
    with pytest.raises(RunError, match="figures"):
        Run.open(run_copy)


def test_a_symbolic_link_in_a_run_is_not_followed(run_copy: Path, tmp_path: Path) -> None:
    victim = tmp_path / "victim"
    victim.write_text("precious")
    (run_copy / "monitor.csv").unlink()
    os.symlink(victim, run_copy / "monitor.csv")
    with pytest.raises(RunError, match="symbolic link"):
        resume(run_copy, total_timesteps=100_000, build=stand_in.build)
    assert victim.read_text() == "precious"


def test_a_run_whose_project_is_gone_finds_its_meshes_in_its_own_copies(tmp_path: Path) -> None:
    project = tmp_path / "project"
    project.mkdir()
    (project / "part.obj").write_bytes(b"v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n")
    robot = shipped.robot_path("cartpole").read_text().replace('<box size="0.20 0.05 0.08"/>', '<mesh filename="part.obj"/>', 1)
    (project / "mine.urdf").write_text(robot)
    scenario = shipped.scenario_path("cartpole").read_text().replace("../robots/urdf/cartpole.urdf", "mine.urdf")
    (project / "mine.yaml").write_text(scenario)
    compiled = api.compile(project / "mine.yaml")
    result = train(compiled, run=tmp_path / "run", total_timesteps=512, build=stand_in.build)
    shutil.rmtree(project)
    shutil.move(result.run, tmp_path / "moved")
    run = Run.open(tmp_path / "moved")
    meshes: list[str] = []
    canonical.with_files(run.ir, lambda mesh: meshes.append(mesh.path) or mesh)
    assert meshes == [str(tmp_path / "moved" / "inputs" / "part.obj")]
    with closing(api.build(run.ir)) as environment:
        environment.reset(seed=0)
    assert api.compile(tmp_path / "moved" / "resolved.yaml").digest == run.record.digest


@pytest.mark.parametrize("name", ["monitor.csv", "models/last.npz"])
def test_a_pipe_in_a_run_is_not_waited_for(run_copy: Path, name: str) -> None:
    (run_copy / name).unlink()
    os.mkfifo(run_copy / name)
    with pytest.raises(RunError, match="neither a file nor a directory"):
        Run.open(run_copy)


LINK = Link("base", Inertial(1.0))
HINGE = Joint("hinge", "continuous", "base", "arm")


@pytest.mark.parametrize(
    ("links", "joints", "root"),
    [
        ((LINK, Link("arm", Inertial(1.0))), (replace(HINGE, name="x" * 100_000),), "base"),
        ((LINK, Link("arm\ud800", Inertial(1.0))), (replace(HINGE, child="arm\ud800"),), "base"),
        ((LINK,), (HINGE,), "base"),
        ((LINK, LINK), (), "base"),
        ((LINK,), (), "arm"),
        ((LINK,), (replace(HINGE, child="base"),), "base"),
        ((Link("base", Inertial(-1.0)),), (), "base"),
        ((Link("base", Inertial(1e308)),), (), "base"),
        ((Link("base", Inertial(1.0), collisions=(Geometry(Sphere(-1.0)),)),), (), "base"),
    ],
    ids=["long name", "no text", "no child", "link twice", "no root", "circle", "negative mass", "huge mass", "negative size"],
)
def test_a_forged_robot_that_would_end_the_process_is_refused(
    run_copy: Path, links: tuple[Link, ...], joints: tuple[Joint, ...], root: str
) -> None:
    world = WorldModel(0.02, 1, robots=(RobotBody("robot", RobotModel("robot", links, joints, root)),))
    forge(run_copy, replace(stand_in.scenario(), world=world))
    with pytest.raises(RunError, match="figures or bodies"):
        Run.open(run_copy)


@pytest.mark.parametrize(
    "form",
    [Variant("odd", Sphere(-1.0)), Variant("odd", Sphere(1.0), -1.0), Variant("odd", Sphere(1e300))],
    ids=["negative size", "negative mass", "huge"],
)
def test_a_forged_form_of_an_object_that_would_end_the_process_is_refused(run_copy: Path, form: Variant) -> None:
    thing = ObjectBody("thing", Sphere(0.1), mass=1.0, variants=(Variant("usual", Sphere(0.1), 1.0), form))
    forge(run_copy, replace(stand_in.scenario(), world=WorldModel(0.02, 1, objects=(thing,))))
    with pytest.raises(RunError, match="figures or bodies"):
        Run.open(run_copy)


VALUES = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=8),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=8), inner, max_size=3),
    max_leaves=6,
)


@settings(max_examples=80, suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None)
@given(data=st.data())
def test_whatever_run_json_holds_it_opens_or_is_refused_in_a_sentence(run_copy: Path, trained: TrainingResult, data: st.DataObject) -> None:
    record = json.loads((trained.run / "run.json").read_text())
    key = data.draw(st.sampled_from(sorted(record)))
    if data.draw(st.booleans()):
        record[key] = data.draw(VALUES)
    else:
        del record[key]
    (run_copy / "run.json").write_text(json.dumps(record))
    assert "\n" not in refusal(run_copy)


@pytest.mark.parametrize(
    "content",
    [
        b"",
        b"{",
        b"[" * 100_000,
        b"\xff\xfe\x00",
        b"NaN",
        b'{"format": 1e400}',
        b'{"format": ' + b"9" * 10_000 + b"}",
        b"[]",
        b" " * 5_000_000,
    ],
)
def test_broken_json_is_refused(run_copy: Path, content: bytes) -> None:
    for name in ("run.json", "scenario.ir.json"):
        shutil.copy(run_copy / name, run_copy / "kept")
        (run_copy / name).write_bytes(content)
        with pytest.raises(RunError):
            Run.open(run_copy)
        shutil.move(run_copy / "kept", run_copy / name)


def refusal(path: Path) -> str:
    """Why a run is refused; nothing if it opens."""
    try:
        Run.open(path)
    except RunError as error:
        return str(error)
    return ""


def forge(path: Path, scenario: Program) -> None:
    """Another scenario in the run, with digests that fit."""
    (path / "scenario.ir.json").write_text(canonical.to_json(scenario))
    edit(path, digest=canonical.digest(scenario), interface=interface.digest(scenario))


def edit(path: Path, **changes: object) -> None:
    record = json.loads((path / "run.json").read_text())
    (path / "run.json").write_text(json.dumps(record | changes))
