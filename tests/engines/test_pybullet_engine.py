"""PyBullet as an engine: contacts, resets, pictures, and its traps."""

from __future__ import annotations

import os
import pickle
import subprocess
import sys
from dataclasses import replace
from hashlib import sha256

import numpy as np
import pytest

pytest.importorskip("pybullet")

from deepbots_cli.engines import create
from deepbots_cli.engines.pybullet.surfaces import PaintMap
from deepbots_cli.errors import EngineError
from deepbots_cli.geometry import mesh_triangles
from deepbots_cli.port import View
from deepbots_cli.program.world import Ground, Line, ObjectBody, RobotBody, WorldModel
from deepbots_cli.robots.model import (
    Inertial,
    Joint,
    Link,
    Mesh,
    Pose,
    RobotModel,
)
from deepbots_cli.view.scene import triangles as seen_triangles


def test_a_library_prints_nothing_and_leaves_stdout_to_the_program(worlds):
    script = (
        "import pickle, sys; from deepbots_cli.engines import create; create('pybullet',"
        " pickle.load(sys.stdin.buffer)); print('done')"
    )
    done = subprocess.run(
        [sys.executable, "-c", script], input=pickle.dumps(worlds.arena()), capture_output=True, check=True
    )
    assert (done.stdout, done.stderr) == (b"done\n", b"")


def test_a_closed_world_is_not_stepped_when_another_takes_its_place(worlds, build):
    first = build("pybullet", worlds.ball())
    step = first.step
    first.close()
    second = build("pybullet", worlds.ball())
    with pytest.raises(EngineError):
        step(1)
    assert second.pose("ball")()[0] == (0, 0, 5.0)


def test_an_engine_that_is_dropped_gives_its_world_back(worlds):
    step = create("pybullet", worlds.ball()).step
    with pytest.raises(EngineError, match="closed"):
        step(1)


def test_what_moves_without_mass_is_refused_by_name(worlds, build):
    wheel = RobotModel(
        "r",
        (Link("base", Inertial(1.0)), Link("wheel")),
        (Joint("axle", "continuous", "base", "wheel"),),
        root="base",
    )
    for model, fixed, name in (
        (wheel, True, "axle"),
        (RobotModel("r", (Link("base"),), (), root="base"), False, "base"),
    ):
        with pytest.raises(EngineError, match=f"'{name}'"):
            build("pybullet", WorldModel(0.02, 1, robots=(RobotBody("robot", model, fixed_base=fixed),)))


def robot_of(joints: int, kind: str) -> RobotModel:
    """A chain of links, the last of which turns."""
    links = tuple(
        Link(f"link{index}", Inertial(1.0, ixx=0.1, iyy=0.1, izz=0.1)) for index in range(joints + 1)
    )
    chain = (Joint(f"joint{index}", kind, f"link{index - 1}", f"link{index}") for index in range(1, joints))
    last = Joint("last", "continuous", f"link{joints - 1}", f"link{joints}")
    return RobotModel("r", links, (*chain, last), root="link0")


@pytest.mark.parametrize(("joints", "kind"), [(128, "fixed"), (128, "continuous"), (998, "continuous")])
def test_a_robot_of_more_joints_than_pybullet_can_read_is_refused_by_name(build, joints, kind):
    with pytest.raises(EngineError, match=f"'robot' has {joints} joints"):
        build("pybullet", WorldModel(0.02, 1, robots=(RobotBody("robot", robot_of(joints, kind)),)))


def test_a_robot_of_as_many_joints_as_pybullet_can_read_is_built(build):
    engine = build("pybullet", WorldModel(0.02, 1, robots=(RobotBody("robot", robot_of(127, "fixed")),)))
    assert engine.joint_states("robot", ["last"])()[0][:2] == (0.0, 0.0)


def test_a_pipe_in_place_of_a_mesh_is_not_waited_for(tmp_path, build):
    os.mkfifo(tmp_path / "stone.obj")
    for path in (str(tmp_path / "stone.obj"), "/dev/zero", "a\0b"):
        with pytest.raises(EngineError, match="cannot be read"):
            build(
                "pybullet",
                WorldModel(0.02, 4, objects=(ObjectBody("stone", Mesh(path, "0" * 64), mass=1.0),)),
            )


def test_a_mesh_is_loaded_only_while_it_is_the_one_that_was_checked(tmp_path, build):
    file = tmp_path / "tetra.obj"
    file.write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n")
    mesh = Mesh(str(file), sha256(file.read_bytes()).hexdigest(), (0.1, 0.1, 0.1))
    world = WorldModel(0.02, 4, objects=(ObjectBody("stone", mesh, Pose((0, 0, 0.2)), 1.0),))
    engine = build("pybullet", world)
    for _ in range(50):
        engine.step(4)
    engine.require_finite()
    assert abs(engine.pose("stone")()[0][2]) < 0.1
    file.write_text(file.read_text() + "# changed\n")
    with pytest.raises(EngineError, match="has changed"):
        build("pybullet", world)
    file.unlink()
    with pytest.raises(EngineError, match="cannot be read"):
        build("pybullet", world)


@pytest.mark.parametrize("face", ["f 1 3 2 # face 12", "f 1 3 \\\n2 # the \\", "f \\\r\n1 3 2"])
def test_an_obj_file_with_a_comment_behind_numbers_or_a_continued_line_is_read(tmp_path, build, face):
    (file := tmp_path / "m.obj").write_text(
        f"v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1 # tip\n{face}\nf 1 2 4\nf 2 3 4"
    )
    mesh = Mesh(str(file), sha256(file.read_bytes()).hexdigest())
    build("pybullet", WorldModel(0.02, 4, objects=(ObjectBody("stone", mesh, Pose((0, 0, 2)), 1.0),)))
    assert len(mesh_triangles(mesh)) == len(seen_triangles(mesh).faces) == 3


def test_a_world_that_blew_up_says_so_and_is_not_reset(worlds, build):
    engine = build("pybullet", worlds.arena())
    engine.set_joint("robot", "wheel_1", float("nan"), float("nan"))
    engine.step(1)
    for use in (engine.require_finite, engine.reset):
        with pytest.raises(EngineError, match="'robot' became infinite or NaN"):
            use()


def test_a_picture_shows_bodies_before_floor_and_sky(worlds, build):
    engine = build("pybullet", worlds.arena())
    view = View((1.0, -1.3, 0.9), (0.0, 0.0, 0.2), width=120, height=80)
    picture = engine.render(view)
    assert (picture.shape, picture.dtype) == ((80, 120, 3), np.uint8)
    assert len(np.unique(picture.reshape(-1, 3), axis=0)) > 200
    engine.place("robot", (0.2, 0.2, 0.04), (0, 0, 0, 1))
    moved = engine.render(view)
    assert (moved != picture).any()
    assert (moved[:10, :10] == picture[:10, :10]).all()
    assert engine.render(replace(view, samples=1)).shape == (80, 120, 3)


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize(
    ("eye", "target"),
    [
        ((0.0, 0.0, 2.0), (0.0, 0.0, 0.0)),  # straight down
        ((0.3, 0.2, -1.0), (0.0, 0.0, 0.0)),  # from below
        ((0.0, 0.0, 1e9), (1.0, 0.0, 1e9)),  # far above the floor
    ],
)
def test_unusual_views_give_pictures_without_a_warning(worlds, build, eye, target):
    engine = build("pybullet", replace(worlds.arena(), ground=Ground()))
    assert engine.render(View(eye, target, 40, 40)).shape == (40, 40, 3)


def test_each_of_many_painted_lines_is_in_a_picture():
    lines = [Line(str(n), ((n / 50, 0), (n / 50, 1)), False, 0.01, color=(1, 0, 0, 1)) for n in range(300)]
    assert [
        *PaintMap(lines).paint(np.zeros((3, 3), np.float32), *np.float32([[0, 5.98, 0.01], [0.5] * 3]))[:, 0]
    ] == [255, 255, 0]
