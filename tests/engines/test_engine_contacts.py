"""What touches what, how hard, and how far apart surfaces are, against closed forms."""

from __future__ import annotations

from dataclasses import replace
from math import cos, inf, pi, sqrt, tan

import pytest

from deepbots_cli.program.world import ObjectBody, WorldModel
from deepbots_cli.robots.model import Box, Capsule, Cylinder, Pose, Sphere
from tests.few import few

STAYS = {"fixed": True}


def things(
    *objects: ObjectBody, gravity: tuple[float, float, float] = (0, 0, -9.81), substeps: int = 4
) -> WorldModel:
    return WorldModel(0.02, substeps, gravity, objects=objects)


def ball(name: str, at: tuple[float, float, float], mass: float = 0.2, radius: float = 0.05) -> ObjectBody:
    return ObjectBody(name, Sphere(radius), Pose(at), mass)


def test_a_ball_touches_the_ground_from_its_landing_on(engine_name, build):
    engine = build(engine_name, things(ball("ball", (0, 0, 0.2))))
    on_ground = engine.contact(("ball", None), [("ground", None)])
    anything = engine.contact(("ball", None))
    but_ground = engine.contact(("ball", None), ground=False)
    landed = 0
    for tick in range(40):
        engine.step(4)
        if tick * 0.02 < sqrt(2 * 0.15 / 9.81) - 0.04:
            assert not on_ground()
        landed += on_ground()
        assert on_ground() is anything()
        assert not but_ground()
    assert landed >= 30
    engine.reset()
    assert not on_ground()


def test_a_contact_in_a_single_engine_step_counts_for_the_whole_tick(engine_name, build):
    """A ball that bounces off a wall within a tick touches nothing when the tick ends."""
    wall = ObjectBody("wall", Box((0.1, 1, 1)), Pose((0.35, 0, 0.5)), **STAYS)
    world = replace(things(ball("ball", (0, 0, 0.5)), wall, gravity=(0, 0, 0)), timestep=0.1, substeps=50)
    engine = build(engine_name, world)
    engine.set_parameter("restitution", ("wall", ""), 1.0)
    engine.set_parameter("restitution", ("ball", ""), 1.0)
    touched = engine.contact(("wall", None), [("ball", None)])
    force = engine.contact_force(("wall", None))
    engine.place("ball", (0, 0, 0.5), (0, 0, 0, 1), (5.0, 0, 0))
    engine.step(50)
    assert touched()
    assert force() == 0.0
    assert engine.pose("ball")()[0][0] < 0.2
    engine.step(50)
    assert not touched()


def test_what_is_touched_late_in_a_tick_counts_beside_what_was_touched_all_along(engine_name, build):
    """Once the crate is known to stand on the ground, the ball that falls on it is still looked for."""
    crate = ObjectBody("crate", Box((0.2, 0.2, 0.1)), Pose((0, 0, 0.05)), 3.0)
    world = replace(things(crate, ball("ball", (0, 0, 0.4))), timestep=0.05, substeps=50)
    engine = build(engine_name, world)
    on_ground = engine.contact(("crate", None), [("ground", None)])
    hit = engine.contact(("crate", None), ground=False)
    readings = []
    for _ in range(6):
        engine.step(50)
        readings.append((on_ground(), hit()))
    falls = sqrt(2 * 0.25 / 9.81)  # s
    assert [hits for _, hits in readings].index(True) == int(falls / 0.05)
    assert all(stands for stands, _ in readings[1:])


def test_links_of_a_robot_have_contacts_of_their_own(engine_name, worlds, build):
    engine = build(engine_name, worlds.arena())
    wheels = [engine.contact(("robot", f"wheel_{i}"), [("ground", None)]) for i in range(4)]
    body, pole = engine.contact(("robot", "body")), engine.contact(("robot", "pole"))
    crate = engine.contact(("robot", None), [("crate", None), ("drum", None)])
    all_but_ground = engine.contact(("robot", None), ground=False)
    for _ in range(10):
        engine.step(4)
    assert [wheel() for wheel in wheels] == [True] * 4
    assert not any(read() for read in (body, pole, crate, all_but_ground))
    engine.place("crate", (-0.14, 0, 0.05), (0, 0, 0, 1))
    engine.step(4)
    assert crate()
    assert all_but_ground()
    assert body()


def test_the_force_on_the_ground_is_the_weight_of_what_stands_on_it(engine_name, build):
    heavy = ObjectBody("crate", Box((0.2, 0.2, 0.1)), Pose((0, 0, 0.05)), 3.0)
    engine = build(engine_name, things(heavy, ball("ball", (0, 0, 0.15), 0.5)))
    forces = {name: engine.contact_force((name, None)) for name in ("ground", "crate", "ball")}
    assert {name: read() for name, read in forces.items()} == dict.fromkeys(forces, 0.0)
    for _ in range(100):
        engine.step(4)
    expected = {"ground": 3.5 * 9.81, "crate": 4.0 * 9.81, "ball": 0.5 * 9.81}
    assert {name: read() for name, read in forces.items()} == pytest.approx(expected, rel=0.01)


def test_the_force_on_a_body_is_the_sum_of_those_from_above_and_below(engine_name, build):
    heavy, light = (
        ObjectBody(name, Box((0.2, 0.2, 0.1)), Pose((0, 0, height)), mass)
        for name, height, mass in (("heavy", 0.05, 3.0), ("light", 0.15, 0.5))
    )
    engine = build(engine_name, things(heavy, light))
    forces = {name: engine.contact_force_vector((name, None)) for name in ("ground", "heavy", "light")}
    assert {name: read() for name, read in forces.items()} == dict.fromkeys(forces, (0.0, 0.0, 0.0))
    for _ in range(100):
        engine.step(4)
    expected = {"ground": -3.5 * 9.81, "heavy": 3.0 * 9.81, "light": 0.5 * 9.81}
    for name, read in forces.items():
        assert read() == pytest.approx((0.0, 0.0, expected[name]), rel=0.01, abs=0.02)


@pytest.mark.parametrize(("angle", "friction"), [(0.3, 0.6), (0.5, 0.2)])
def test_friction_is_part_of_the_force_on_a_crate_on_a_slope(engine_name, worlds, angle, friction, build):
    """It holds the crate at rest, or else is the normal force times its coefficient."""
    engine = build(engine_name, worlds.slope(angle, friction))
    read = engine.contact_force_vector(("crate", None))
    normal = engine.contact_force(("crate", None))
    forces = []
    for _ in range(30):
        engine.step(4)
        forces.append(read())
        assert forces[-1][2] == pytest.approx(normal(), rel=1e-6)
    for x, y, z in forces[10:]:
        assert x == pytest.approx(-min(tan(angle), friction) * z, rel=0.02, abs=0.05)
        assert y == pytest.approx(0.0, abs=0.3)
    assert max(z for *_, z in forces) > 9.81 * cos(angle) - 0.1


def test_watching_contacts_changes_nothing(engine_name, worlds, build):
    watched, unwatched = build(engine_name, worlds.arena()), build(engine_name, worlds.arena())
    for name in ("robot", "ball"):
        watched.contact((name, None))
        watched.clearance((name, None), ("crate", None))
    for engine in (watched, unwatched):
        engine.velocity_motor("robot", [f"wheel_{i}" for i in range(4)], [10.0] * 4)([20.0] * 4)
        for _ in range(60):
            engine.step(4)
    assert watched.pose("robot")() == unwatched.pose("robot")()
    assert watched.pose("ball")() == unwatched.pose("ball")()


SOLIDS = {
    "sphere": (Sphere(0.1), 0.1),
    "box": (Box((0.2, 0.3, 0.4)), 0.1),
    "cylinder": (Cylinder(0.1, 0.3), 0.1),
    "capsule": (Capsule(0.1, 0.3), 0.1),
}


@pytest.mark.parametrize("one", SOLIDS)
@pytest.mark.parametrize("other", SOLIDS)
@pytest.mark.parametrize("apart", few([0.003, 0.5, 30.0], ["0.003"]))
def test_the_gap_between_two_solids_along_x_is_what_is_left_between_them(
    engine_name, one, other, apart, build
):
    (shape, half), (other_shape, other_half) = SOLIDS[one], SOLIDS[other]
    place = Pose((half + other_half + apart, 0, 1))
    world = things(
        ObjectBody("one", shape, Pose((0, 0, 1)), **STAYS), ObjectBody("other", other_shape, place, **STAYS)
    )
    engine = build(engine_name, world)
    assert engine.clearance(("one", None), ("other", None))() == pytest.approx(apart, abs=1e-6)


def test_gaps_to_the_ground_to_corners_and_to_what_overlaps(engine_name, build):
    turned = ObjectBody("turned", Box((0.2, 0.2, 0.2)), Pose((1, 0, 1), (0, 0, pi / 4)), **STAYS)
    engine = build(engine_name, things(ball("ball", (0, 0, 1)), turned, ball("inside", (0.05, 0, 1))))
    assert engine.clearance(("ball", None), ("ground", None))() == pytest.approx(0.95, abs=1e-6)
    # a corner is rounded by the library's margin of 1 mm: 0.4 mm too far
    assert engine.clearance(("ball", None), ("turned", None))() == pytest.approx(
        1 - 0.05 - 0.1 * sqrt(2), abs=5e-4
    )
    assert engine.clearance(("ball", None), ("inside", None))() == 0.0


def test_the_gap_of_a_moving_link_follows_it(engine_name, worlds, build):
    world = worlds.arena()
    engine = build(engine_name, world)
    gap = engine.clearance(("robot", "wheel_0"), ("front wall", None))
    pose = engine.pose("robot", "wheel_0")
    engine.velocity_motor("robot", [f"wheel_{i}" for i in range(4)], [10.0] * 4)([5.0] * 4)
    engine.place("ball", (0, 0.4, 0.05), (0, 0, 0, 1))
    for _ in range(30):
        engine.step(4)
        assert gap() == pytest.approx(0.5 - 0.04 - pose()[0][0], abs=1e-4)
    assert pose()[0][0] > 0.1


def test_a_gap_to_nothing_is_infinite(engine_name, build):
    ghost = ObjectBody("ghost", Sphere(0.1), Pose((1, 0, 1)), solid=False)
    engine = build(engine_name, things(ball("ball", (0, 0, 1)), ghost))
    assert engine.clearance(("ball", None), ("ghost", None))() == inf


# What lies within something else


def test_bodies_within_each_other_are_listed_with_their_depth_deepest_first(engine_name, build):
    post = ObjectBody("post", Sphere(0.05), Pose((0, 0, 0.05)), **STAYS)
    engine = build(
        engine_name,
        things(ball("near", (0.08, 0, 0.055)), ball("sunk", (1, 0, 0.03)), ball("clear", (2, 0, 0.06)), post),
    )
    first, second = engine.overlaps()
    depths = {frozenset((overlap.one[0], overlap.other[0])): overlap.depth for overlap in (first, second)}
    assert depths[frozenset(("near", "post"))] == pytest.approx(0.1 - sqrt(0.08**2 + 0.005**2), abs=1e-3)
    assert depths[frozenset(("sunk", "ground"))] == pytest.approx(0.02, abs=1e-3)
    assert first.depth >= second.depth


def test_two_bodies_that_never_move_do_not_overlap(engine_name, build):
    first, second = (ObjectBody(name, Sphere(0.05), Pose((0, 0, 0.02)), **STAYS) for name in ("one", "other"))
    assert list(build(engine_name, things(first, second)).overlaps()) == []


def test_links_of_a_robot_that_overlap_are_named(engine_name, build, worlds):
    engine = build(engine_name, worlds.arena())
    engine.place("robot", (0, 0, 0.02), (0, 0, 0, 1))
    (overlap,) = engine.overlaps()
    assert overlap.depth == pytest.approx(0.02, abs=1.5e-3)
    assert {part[0] for part in (overlap.one, overlap.other)} == {"robot", "ground"}
    assert any((part[1] or "").startswith("wheel_") for part in (overlap.one, overlap.other))


def test_looking_for_overlaps_leaves_no_trace_beyond_a_reset(engine_name, build):
    world = things(ball("ball", (0, 0, 0.2)))

    def fall(engine) -> list[object]:
        engine.reset()
        engine.step(40)
        return [engine.pose("ball")(), engine.velocity("ball")()]

    fresh, looked_at = build(engine_name, world), build(engine_name, world)
    looked_at.overlaps()
    assert fall(looked_at) == fall(fresh)
