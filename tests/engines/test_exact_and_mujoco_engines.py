"""What the exact engine and MuJoCo do, or cannot do.

* The exact engine against closed forms, conserved figures, and PyBullet.
* What MuJoCo does otherwise by itself, or cannot do.
"""

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace
from hashlib import sha256
from math import cos, pi, sin, sqrt
from pathlib import Path

import numpy as np
import pytest
from exact_engine.lump import joined
from exact_engine.motion import CartPole, RigidBody

from deepbots_cli import frames
from deepbots_cli.engines import create, create_batch
from deepbots_cli.errors import EngineError
from deepbots_cli.frames import quaternion
from deepbots_cli.port import Engine, View
from deepbots_cli.program.world import Formula, Ground, ObjectBody, RobotBody, Terrain, WorldModel
from deepbots_cli.robots.model import (
    Box,
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
    Sphere,
)
from tests.engines.conftest import Worlds
from tests.files import written
from tests.named import constant
from tests.robots.meshes import ball, block

DOWN = (0.0, 0.0, -9.81)


def cart_pole(world: WorldModel) -> CartPole:
    (robot,) = world.robots
    model = robot.model
    parts = (joined(model, name) for name in ("rail", "cart", "pole"))
    return CartPole(*parts, model.joint("slide"), model.joint("hinge"), world.gravity)


@pytest.mark.parametrize("angle", [0.05, 1.5, 3.1])
def test_a_cart_pole_keeps_its_energy_for_ten_seconds(angle, worlds):
    motion = cart_pole(worlds.rail())
    motion.set_joint(1, angle, 0.3)
    before = motion.energy
    for _ in range(100):
        motion.advance(0.1)
        assert motion.energy == pytest.approx(before, rel=1e-9)
    assert motion.state[1] != angle


def test_a_tumbling_body_keeps_its_energy_for_ten_seconds():
    stone = Link(
        "stone",
        Inertial(0.7, Pose((0.1, -0.2, 0.05), (0.3, 0.2, -0.4)), 0.01, 0.002, 0.001, 0.02, -0.001, 0.025),
    )
    body = RigidBody(joined(RobotModel("stone", (stone,), (), root="stone"), "stone"), DOWN, flies=True)
    body.spin((1.0, 3.0, -2.0))
    before = body.energy
    for _ in range(100):
        body.advance(0.1)
    assert body.energy == pytest.approx(before, rel=1e-9)


def test_a_symmetric_top_precesses_about_its_momentum_at_the_rate_of_the_closed_form():
    top = Link("top", Inertial(1.0, ixx=0.02, iyy=0.02, izz=0.05))
    body = RigidBody(joined(RobotModel("top", (top,), (), root="top"), "top"), (0, 0, 0), flies=True)
    body.place(((0, 0, 0), quaternion(0.4, 0, 0)))
    body.spin(frames.rotate(body.turned, (0.0, 0.6, 4.0)))
    momentum = body.momentum
    rate = sqrt(frames.dot(momentum, momentum)) / 0.02
    axis = frames.rotate(body.turned, (0, 0, 1))
    body.advance(1.3)
    about = frames.scaled(momentum, 1 / sqrt(frames.dot(momentum, momentum)))
    assert frames.rotate(body.turned, (0, 0, 1)) == pytest.approx(
        frames.rotate(frames.from_axis_angle(about, rate * 1.3), axis), abs=1e-8
    )


def test_free_fall_is_exact_to_the_last_digits(worlds, build):
    engine = build("exact", worlds.ball(height=3.0))
    for _ in range(50):
        engine.step(4)
    assert engine.pose("ball")()[0][2] == pytest.approx(3.0 - 9.81 / 2, abs=1e-12)


def test_a_cart_pole_follows_the_textbook_equations(worlds):
    motion = cart_pole(worlds.rail())
    motion.set_joint(1, 0.7, 1.1)
    motion.drives[0].torque = 3.0
    motion.advance(1e-5)
    total, m, half, angle, rate = 1.1, 0.1, 0.5, 0.7, 1.1
    temp = (3.0 + m * half * rate**2 * sin(angle)) / total
    turning = (9.81 * sin(angle) - cos(angle) * temp) / (half * (4 / 3 - m * cos(angle) ** 2 / total))
    sliding = temp - m * half * turning * cos(angle) / total
    assert (motion.state[2] / 1e-5, (motion.state[3] - rate) / 1e-5) == pytest.approx(
        (sliding, turning), rel=1e-3
    )


def test_what_the_equations_do_not_cover_is_refused_by_name(worlds, build):
    rail = worlds.rail()
    (robot,) = rail.robots
    ball = worlds.ball()
    pair = RobotModel(
        "pair",
        (Link("a", Inertial(1.0, ixx=1, iyy=1, izz=1)), Link("b", Inertial(1.0))),
        (Joint("j", "continuous", "a", "b"),),
        root="a",
    )
    cases = (
        (worlds.arena(), "no equations for robot 'robot'"),
        (replace(rail, robots=(replace(robot, fixed_base=False),)), "no equations"),
        (
            WorldModel(0.02, 1, ground=None, robots=(RobotBody("pair", pair, fixed_base=True),)),
            "no equations for robot 'pair'",
        ),
        (replace(ball, ground=worlds.arena().ground), "no contacts: 'ball'"),
        (worlds.rail(friction=1.0), "friction in joints"),
        (
            WorldModel(
                0.02,
                1,
                ground=None,
                robots=(RobotBody("dot", RobotModel("dot", (Link("dot"),), (), root="dot")),),
            ),
            "'dot' moves without",
        ),
    )
    for world, reason in cases:
        with pytest.raises(EngineError, match=reason):
            build("exact", world)


def test_it_draws_nothing(worlds, build):
    engine = build("exact", worlds.rail())
    assert "rendering" not in engine.capabilities
    with pytest.raises(EngineError, match="rendering"):
        engine.render(View((1, 1, 1), (0, 0, 0)))


def test_the_end_of_a_range_is_an_error_since_there_are_no_stops(worlds, build):
    engine = build("exact", worlds.rail(limit=Limit(-0.1, 0.1)))
    engine.velocity_motor("robot", ["slide"], [100.0])([1.0])
    with pytest.raises(EngineError, match="'slide' passed the end of its range"):
        engine.step(100)


def test_fixed_and_unsolid_objects_stay(build):
    objects = (
        ObjectBody("block", Box((1, 1, 1)), Pose((1, 2, 3)), 5.0, fixed=True),
        ObjectBody("mark", Sphere(0.1), Pose((0, 0, 1)), solid=False),
    )
    engine = build("exact", WorldModel(0.02, 1, objects=objects))
    engine.step(5)
    assert [engine.pose(thing.name)()[0] for thing in objects] == [(1, 2, 3), (0, 0, 1)]


def test_links_that_are_fixed_to_each_other_are_one_body(worlds):
    """Two half rods in a row weigh and turn like one whole."""

    def half(name):
        return Link(
            name, Inertial(0.5, Pose((0, 0, 0.25)), ixx=0.5 * 0.25 / 12, iyy=0.5 * 0.25 / 12, izz=0.0)
        )

    hold = Joint("hold", "fixed", "low", "high", Pose((0, 0, 0.5), (0.0, 0.0, 1.2)))
    lump = joined(RobotModel("rod", (half("low"), half("high")), (hold,), root="low"), "low")
    assert (lump.mass, lump.center) == (1.0, pytest.approx((0, 0, 0.5)))
    assert lump.inertia[0][0] == pytest.approx(1 / 12)
    assert lump.inertia_about((0, 1, 0)) == pytest.approx(1 / 3)


HILLS = Terrain(Formula(constant(0.0).scalar, (4.0, 4.0)))


def test_a_mesh_is_not_ground_and_the_message_says_what_to_do():
    with pytest.raises(EngineError, match=r"convex hull.*terrain of heights.*`pybullet`"):
        create("mujoco", WorldModel(0.02, 1, terrain=Terrain(Mesh("ground.stl", "00"))))


def post(inertial: Inertial, *shapes: Mesh, turned: Pose = Pose()) -> WorldModel:  # noqa: B008
    pieces = tuple(Geometry(shape, turned) for shape in shapes)
    model = RobotModel(
        "post",
        (Link("foot"), Link("pole", inertial, pieces, pieces)),
        (Joint("hinge", "continuous", "foot", "pole"),),
        root="foot",
    )
    return WorldModel(0.02, 1, robots=(RobotBody("robot", model, fixed_base=True),))


def test_an_impossible_inertia_names_robot_and_link_and_says_what_to_do():
    message = (
        r"^link 'pole' of 'robot' has an inertia that no rigid body can have, which MuJoCo refuses;"
        r" .*the engine `pybullet`$"
    )
    for moments in ({"ixx": 1.0, "iyy": 1.0, "izz": 3.0}, {"ixx": 1.0, "iyy": 1.0, "izz": 1.0, "ixy": 2.0}):
        with pytest.raises(EngineError, match=message):
            create("mujoco", post(Inertial(1.0, **moments)))


def test_the_rounded_inertia_of_a_thin_disc_is_possible(build):
    build(
        "mujoco", post(Inertial(0.2, Pose(rpy=(0.4, 0.3, 0.2)), ixx=0.0017, iyy=0.0017, izz=0.003401))
    ).step(1)


def test_a_turned_mesh_of_a_link_without_inertia_has_that_of_its_box_in_turned_axes(build, tmp_path):
    """About x, the axis of the hinge: I_x cos^2 + I_y sin^2 of a box that is turned about z."""
    path = written(tmp_path / "box.obj", block("box.obj", (0.6, 0.2, 0.1)))
    shape = Mesh(str(path), sha256(path.read_bytes()).hexdigest())
    for angle in (0.0, 0.5, pi / 2):
        world = replace(post(Inertial(2.0), shape, turned=Pose(rpy=(0.0, 0.0, angle))), ground=None)
        engine = build("mujoco", world)
        engine.torque_motor("robot", ["hinge"], [10.0])([0.1])
        engine.step(1)
        inertia = 2 / 12 * ((0.2**2 + 0.1**2) * cos(angle) ** 2 + (0.6**2 + 0.1**2) * sin(angle) ** 2)
        speed = engine.joint_states("robot", ["hinge"])()[0][1]
        assert speed == pytest.approx(0.1 * 0.02 / inertia, rel=1e-6)


def test_what_the_compiler_refuses_is_an_error_that_names_robot_and_link(tmp_path):
    flat = square(tmp_path)
    with pytest.raises(
        EngineError,
        match=r"^MuJoCo cannot build link 'pole' of 'robot': mesh has coplanar vertices, [a-z ]*; correct"
        r" its ",
    ):
        create("mujoco", post(Inertial(1.0, ixx=1.0, iyy=1.0, izz=1.0), flat))


def test_a_flat_mesh_that_touches_nothing_is_drawn(build, tmp_path):
    sign = RobotModel("sign", (Link("sign", None, (Geometry(square(tmp_path)),)),), (), root="sign")
    engine = build("mujoco", WorldModel(0.02, 1, ground=None, robots=(RobotBody("sign", sign, True),)))
    image = engine.render(View((0.5, 0.4, 2.0), (0.5, 0.5, 0.0), 40, 40))
    assert len({tuple(color) for color in image.reshape(-1, 3).tolist()}) > 1


@pytest.mark.slow
def test_a_ball_of_more_vertices_than_a_hull_may_have_rests_as_a_ball(build, tmp_path):
    path = written(tmp_path / "ball.obj", ball(0.2, 80))
    shape = Mesh(str(path), sha256(path.read_bytes()).hexdigest())
    thing = ObjectBody("ball", shape, Pose((0, 0, 0.21)), 1.0)
    engine = build("mujoco", WorldModel(0.01, 10, ground=Ground(1.0), objects=(thing,)))
    engine.step(100)
    assert engine.pose("ball")()[0][2] == pytest.approx(0.2, abs=2e-4)


def square(folder: Path) -> Mesh:
    path = written(folder / "flat.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 1 1 0\nf 1 2 3\nf 2 4 3\n")
    return Mesh(str(path), sha256(path.read_bytes()).hexdigest())


def test_distances_to_terrain_are_refused(build):
    engine = build(
        "mujoco",
        WorldModel(0.02, 1, terrain=HILLS, objects=(ObjectBody("ball", Sphere(0.1), Pose((0, 0, 1)), 1.0),)),
    )
    with pytest.raises(EngineError, match="distances to terrain; measure them with a ray sensor"):
        engine.clearance(("ball", None), ("ground", None))


@pytest.mark.parametrize("right_angle", [1.57, 1.571, 1.5708, pi / 2])
def test_a_wheel_whose_file_rounds_a_right_angle_rolls_on_its_tire(right_angle, build):
    """A tire touches the ground in one point, a cylinder in two."""
    tire = (Geometry(Cylinder(0.03, 0.02), Pose(rpy=(right_angle, 0, 0))),)
    wheel = Link("wheel", Inertial(0.08, ixx=2e-5, iyy=3.6e-5, izz=2e-5), tire, tire)
    axle = Joint("axle", "continuous", "stand", "wheel", Pose((0, 0, 0.0299)), (0, 1, 0))
    stand = Link("stand", Inertial(5.0, ixx=0.1, iyy=0.1, izz=0.1))
    model = RobotModel("unicycle", (stand, wheel), (axle,), root="stand")
    world = WorldModel(0.01, 1, ground=Ground(1.0), robots=(RobotBody("robot", model, fixed_base=True),))
    engine = build("mujoco", world)
    engine.step(1)
    assert engine._world.data.ncon == 1


def test_a_wheel_is_a_cylinder_to_everything_but_flat_ground(build):
    """8 cm from its axle the face of a wheel is flat: a tire would be 12 mm further away there."""
    tire = (Geometry(Cylinder(0.1, 0.06), Pose(rpy=(pi / 2, 0, 0))),)
    wheel = Link("wheel", Inertial(1.0, ixx=0.003, iyy=0.005, izz=0.003), tire, tire, Friction(1.0))
    axle = Joint("axle", "continuous", "stand", "wheel", Pose((0, 0, 0.099)), (0, 1, 0))
    stand = RobotModel(
        "spinner", (Link("stand", Inertial(5.0, ixx=0.1, iyy=0.1, izz=0.1)), wheel), (axle,), root="stand"
    )
    eye = RobotModel("eye", (Link("eye", Inertial(1.0, ixx=0.1, iyy=0.1, izz=0.1)),), (), root="eye")
    ball = ObjectBody("ball", Sphere(0.05), Pose((0.08, 0.1, 0.099)), fixed=True)
    robots = (
        RobotBody("robot", stand, fixed_base=True),
        RobotBody("eye", eye, fixed_base=True, pose=Pose((-0.08, 0.5, 0.099))),
    )
    engine = build("mujoco", WorldModel(0.01, 1, ground=Ground(1.0), objects=(ball,), robots=robots))
    touches = engine.contact(("robot", "wheel"), [("ground", None)])
    force = engine.contact_force(("robot", "wheel"))
    see = engine.rays(("eye", None), [((0.0, 0.0, 0.0), quaternion(0.0, 0.0, -pi / 2))], 2.0)
    drive = engine.velocity_motor("robot", ["axle"], [0.01])
    speed = engine.joint_states("robot", ["axle"])
    for _ in range(10):
        drive([50.0])
        engine.step(1)
    assert touches()
    assert force() > 0.0
    assert speed()[0][1] < 0.1  # it grips
    assert engine.clearance(("robot", "wheel"), ("ball", None))() == pytest.approx(0.02, abs=1e-6)
    assert see() == pytest.approx([0.47], abs=1e-6)


def test_a_state_that_is_not_finite_writes_no_file(tmp_path, monkeypatch, worlds, build):
    monkeypatch.chdir(tmp_path)
    engine = build("mujoco", worlds.rail())
    engine.set_joint("robot", "hinge", float("nan"), 0.0)
    engine.step(4)
    with pytest.raises(EngineError, match="'robot' became infinite or NaN"):
        engine.require_finite()
    assert list(tmp_path.iterdir()) == []
    engine.reset()
    engine.step(4)
    engine.require_finite()


_WITHOUT_LIBRARIES = """
import ctypes
from_system = ctypes.CDLL
def library(name, *arguments, **options):
    if name and ("EGL" in str(name) or "OSMesa" in str(name)):
        raise OSError(name)
    return from_system(name, *arguments, **options)
ctypes.CDLL = library
"""


@pytest.mark.parametrize(
    ("before", "variables"),
    [("", {"MUJOCO_GL": "disable"}), (_WITHOUT_LIBRARIES, {})],
    ids=["switched off", "no library installed"],
)
def test_without_opengl_everything_but_pictures_works(before, variables):
    script = """
from deepbots_cli.engines import create
from deepbots_cli.errors import EngineError
from deepbots_cli.port import Engine, View
from deepbots_cli.program.world import WorldModel
engine = create("mujoco", WorldModel(0.02, 1))
engine.step(1)
try:
    engine.render(View((1, 1, 1), (0, 0, 0)))
except EngineError as error:
    print(sorted(engine.capabilities), error)
"""
    done = subprocess.run(
        [sys.executable, "-c", before + script],
        capture_output=True,
        text=True,
        env={"PATH": "", **variables, "PYTHONPATH": ":".join(sys.path)},
    )
    assert (
        "'mimic', 'self_collision', 'snapshot', 'torque_curve'] MuJoCo cannot render on this machine"
        in done.stdout
    ), done.stderr


def test_a_library_of_opengl_that_is_missing_is_named_with_what_to_do():
    done = subprocess.run(
        [sys.executable, "-c", f"{_WITHOUT_LIBRARIES}import deepbots_cli.engines.mujoco"],
        capture_output=True,
        text=True,
        env={"PATH": "", "MUJOCO_GL": "osmesa", "PYTHONPATH": ":".join(sys.path)},
    )
    assert "MUJOCO_GL=osmesa, which is not a library of OpenGL on this machine; unset" in done.stderr


def color_shares(image) -> list[float]:
    """The shares of pixels that are mostly red, green and blue."""
    strongest = image.astype(int).argmax(axis=-1)[np.ptp(image.astype(int), axis=-1) > 60]
    return [float((strongest == color).sum()) / image[..., 0].size for color in range(3)]


@pytest.mark.parametrize("distance", [1.0, 20.0])
def test_a_table_that_is_level_with_the_floor_does_not_flicker(build, distance):
    """As in PandaPush: the floor was seen through half of it."""
    table = ObjectBody(
        "table", Box((4.0, 4.0, 0.02)), Pose((0, 0, -0.01)), color=(1.0, 0.0, 0.0, 1.0), fixed=True
    )
    engine = build("mujoco", WorldModel(0.02, 1, ground=Ground(color=(0.0, 1.0, 0.0, 1.0)), objects=(table,)))
    for turn in (0.0, 0.4, 1.1):
        eye = (0.6 * distance * cos(turn), 0.6 * distance * sin(turn), 0.8 * distance)
        assert color_shares(engine.render(View(eye, (0, 0, 0), 80, 60, 0.7 / distance, samples=1))) == [
            1.0,
            0.0,
            0.0,
        ]


def test_of_faces_in_one_plane_the_later_one_is_seen(build):
    def piece(color: int, x: float, size: float) -> ObjectBody:
        shade = tuple(float(place == color) for place in range(3))
        return ObjectBody(
            f"piece{color}", Box((size, size, 0.1)), Pose((x, 0, 0.05)), color=(*shade, 1.0), fixed=True
        )

    base = piece(0, 0.0, 4.0)
    above = View((0.3, 0.2, 1.0), (0.0, 0.0, 0.1), 80, 60, 0.5, samples=1)
    for others in ((piece(1, 0.0, 3.0),), (piece(1, 0.0, 3.0), piece(2, 0.0, 2.0))):
        shares = color_shares(
            build("mujoco", WorldModel(0.02, 1, ground=None, objects=(base, *others))).render(above)
        )
        assert shares[len(others)] == 1.0
    label = (
        Geometry(Box((4.0, 4.0, 0.1)), color=(1.0, 0, 0, 1)),
        Geometry(Cylinder(2.0, 0.1), color=(0, 0, 1.0, 1)),
    )
    sign = RobotModel(
        "sign", (Link("sign", Inertial(1.0, ixx=1.0, iyy=1.0, izz=1.0), label),), (), root="sign"
    )
    engine = build(
        "mujoco",
        WorldModel(0.02, 1, ground=None, robots=(RobotBody("sign", sign, False, Pose((0, 0, 0.05))),)),
    )
    assert color_shares(engine.render(above)) == [0.0, 0.0, 1.0]


# The engine of many worlds in MuJoCo: what its members read is what engines of one world read
def marbles(count: int) -> WorldModel:
    """A tray on the ground with marbles on it."""
    tray = ObjectBody("tray", Box((1.0, 1.0, 0.1)), Pose((0, 0, 0.05)), 3.0)
    spots = [(0.12 * (k % 7) - 0.36, 0.12 * (k // 7) - 0.36) for k in range(count)]
    objects = [
        ObjectBody(f"marble{k}", Sphere(0.05), Pose((x, y, 0.15)), 0.1) for k, (x, y) in enumerate(spots)
    ]
    return WorldModel(0.02, 4, ground=Ground(), objects=(tray, *objects))


def dumbbell(mass: float = 2.0) -> WorldModel:
    """A hull with a weight that a hinge along its x axis holds, beside it."""
    hull = Link("hull", Inertial(3.0, ixx=0.1, iyy=0.2, izz=0.3))
    moment = 0.02 * mass
    weight = Link("weight", Inertial(mass, Pose((0, 0.5, 0)), ixx=moment, iyy=moment, izz=moment))
    hinge = Joint("hinge", "continuous", "hull", "weight", axis=(1, 0, 0))
    return WorldModel(
        0.02, 4, robots=(RobotBody("robot", RobotModel("dumbbell", (hull, weight), (hinge,), root="hull")),)
    )


def bend(engine: Engine) -> None:
    engine.velocity_motor("robot", ["knee"], [100.0])([0.4])


def tumble(engine: Engine) -> None:
    engine.set_parameter("mass", ("robot", "weight"), 3.0)
    engine.place("robot", (0, 0, 1), (0, 0, 0, 1), (0, 1, 0), (0.3, 0.2, 0.5))
    engine.torque_motor("robot", ["hinge"], [1.0])([0.4])


@pytest.mark.parametrize(
    ("world", "what", "places", "begin", "watched"),
    [
        (
            replace(marbles(5), gravity=(3.0, 1.0, -9.0)),
            "contact_force_vector",
            [("tray", None), ("marble2", None), ("ground", None)],
            lambda engine: None,
            (),
        ),
        (Worlds.stand(0.1), "joint_wrench", [("robot", "leg")], bend, ()),
        (Worlds.stand(0.1), "joint_wrench", [("robot", "leg")], bend, [("robot", "leg")]),
        (dumbbell(), "angular_momentum", ["robot"], tumble, ()),
    ],
    ids=["forces", "wrenches", "wrenches beside contacts", "momenta"],
)
def test_what_a_batch_reads_is_what_single_worlds_read(world, what, places, begin, watched):
    batch, single = create_batch("mujoco", world, 3), create("mujoco", world)
    of_batch, of_single, of_member = (
        [getattr(engine, what)(place) for place in places] for engine in (batch, single, batch.members[2])
    )
    for part in watched:
        batch.contact(part, [("ground", None)])
    for engine in (single, *batch.members):
        engine.reset()
        begin(engine)
    batch.begin_episodes()
    for _ in range(30):
        batch.step(4)
        single.step(4)
        for together, alone, member in zip(of_batch, of_single, of_member, strict=True):
            all_worlds = np.array(together())
            np.testing.assert_allclose(all_worlds[..., 1], alone(), rtol=1e-9, atol=1e-9)
            np.testing.assert_array_equal(member(), all_worlds[..., 2])
    assert all(np.abs(read()).max() > 0.1 for read in of_single)


def test_a_waiting_world_keeps_its_wrench_when_another_sensor_is_added():
    batch = create_batch("mujoco", Worlds.stand(0.1), 2)
    read = batch.joint_wrench(("robot", "leg"))
    for engine in batch.members:
        engine.reset()
        bend(engine)
    batch.begin_episodes()
    assert not np.any(read())
    for _ in range(5):
        batch.step(4)
    before = np.array(read())[..., 1].copy()
    batch.contact(("robot", "leg"), [("ground", None)])
    batch.step(1, np.array([True, False]))
    assert np.any(before)
    np.testing.assert_array_equal(np.array(read())[..., 1], before)


def test_limits_of_driven_joints_are_as_soft_with_a_drawn_mass_as_with_the_same_written_one():
    written, drawn = create("mujoco", dumbbell(3.0)), create("mujoco", dumbbell())
    batch = create_batch("mujoco", dumbbell(), 2)
    for engine in (drawn, *batch.members):
        engine.reset()
        engine.set_parameter("mass", ("robot", "weight"), 3.0)
    batch.begin_episodes()
    for kind in ("velocity_motor", "torque_motor"):
        for engine in (written, drawn, batch):
            getattr(engine, kind)("robot", ["hinge"], [1.0])([0.4])
            engine.step(1)
        for name in ("dof_invweight0", "body_invweight0"):
            expected = getattr(written._world.model, name)
            assert getattr(drawn._world.model, name) == pytest.approx(expected, rel=1e-9)
            assert batch.rows[name][1] == pytest.approx(expected, rel=1e-9)


def test_a_reading_of_a_batch_of_one_stays_as_it_was():
    batch = create_batch("mujoco", Worlds.stand(0.1), 1)
    read = batch.joint_states("robot", ["knee"])
    (member,) = batch.members
    member.reset()
    bend(member)
    batch.begin_episodes()
    batch.step(4)
    positions = read()
    first = np.array(positions)
    batch.step(4)
    np.testing.assert_array_equal(positions, first)
    assert np.any(np.array(read()) != first)


def test_more_contacts_than_a_batch_adds_up_are_an_error():
    batch = create_batch("mujoco", marbles(40), 2)
    read = batch.contact_force(("tray", None))
    for member in batch.members:
        member.reset()
    batch.begin_episodes()
    batch.step(4)
    with pytest.raises(
        EngineError, match=r"^world 0: a link of 'tray' has 44 contacts, but a batch supports at most 32"
    ):
        read()


def test_members_change_and_read_their_own_worlds():
    batch = create_batch("mujoco", marbles(1), 3)
    poses = [member.pose("marble0") for member in batch.members]
    for member in batch.members:
        member.reset()
    batch.members[1].place("marble0", (0.1, 0.2, 0.9), (0, 0, 0, 1))
    assert [read()[0] for read in poses] == [(-0.36, -0.36, 0.15), (0.1, 0.2, 0.9), (-0.36, -0.36, 0.15)]
    batch.begin_episodes()
    batch.step(4, np.array([False, True, False]))
    assert [read()[0][2] < start for read, start in zip(poses, (0.15, 0.9, 0.15), strict=True)] == [
        False,
        True,
        False,
    ]
