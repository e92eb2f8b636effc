"""Closed forms, and overrides against them."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

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
    volume,
    with_friction,
    with_joint,
    with_mass,
    with_scale,
)

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
    stretched = model_of(with_scale(robot(Cylinder(radius, length)), "a", (across, across, along)))
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


def test_child_joints_move_with_the_stretch_and_keep_their_direction():
    joint = model_of(
        with_scale(robot(Box((1.0, 1.0, 1.0)), rpy=(0.1, 0.2, 0.3)), "a", (1.0, 2.0, 10.0))
    ).joint("j")
    assert joint.origin == Pose((0.1, 0.4, 3.0), (0.1, 0.2, 0.3))


def test_a_shape_turned_by_a_right_angle_is_scaled_along_its_own_axes():
    lying = Pose((0.0, 0.0, 0.0), (math.pi / 2, 0.0, 0.0))  # its z along -y of the link
    shape = (
        model_of(with_scale(robot(Cylinder(0.1, 1.0), lying), "a", (2.0, 3.0, 2.0)))
        .link("a")
        .visuals[0]
        .shape
    )
    assert shape.radius == pytest.approx(0.2)
    assert shape.length == pytest.approx(3.0)


def test_the_inertia_of_a_turned_frame_is_stretched_in_the_axes_of_the_link():
    turned = Pose((0.0, 0.0, 0.0), (0.0, 0.0, math.pi / 2))
    model = robot(Box((1.0, 2.0, 3.0)), turned)
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
    assert model.joint("j").damping == 0.5
    assert model.joint("j").friction == 0.1
    assert model.joint("j").limit.effort == 2.0
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
