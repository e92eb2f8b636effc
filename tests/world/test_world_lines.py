"""Painted lines: places beside and along them, their reflected light, and their use in a scenario."""

import math
from contextlib import closing

import pytest

from deepbots_cli import api
from deepbots_cli.program.world import Line
from deepbots_cli.runtime.paths import Follower, PaintedGround
from tests.worlds import Maker

SQUARE = Line(
    "square", ((0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)), closed=True, width=0.02, reflectance=0.1
)
ROAD = Line("road", ((0.0, 0.0), (1.0, 0.0)), closed=False, width=0.02)


def circle(corners: int, radius: float = 1.0) -> Line:
    angles = [2 * math.pi * n / corners for n in range(corners)]
    return Line(
        "circle", tuple((radius * math.cos(a), radius * math.sin(a)) for a in angles), closed=True, width=0.02
    )


def test_left_of_a_line_is_positive() -> None:
    follow = Follower(ROAD)
    assert follow((0.5, 0.1, 0.0)) == pytest.approx((0.1, 0.0))
    assert follow((0.5, -0.2, 0.0)) == pytest.approx((-0.2, 0.0))


def test_inside_a_loop_that_turns_left_is_left_of_it_and_outside_right() -> None:
    assert Follower(SQUARE)((0.5, 0.2))[0] == pytest.approx(0.2)
    assert Follower(SQUARE)((-0.3, -0.4))[0] == pytest.approx(-0.5)


def test_the_way_along_a_line_counts_from_where_the_episode_begins() -> None:
    follow = Follower(ROAD)
    follow((0.3, 0.0))
    assert follow((0.8, 0.0))[1] == pytest.approx(0.5)
    assert follow((0.2, 0.0))[1] == pytest.approx(-0.1)
    follow.reset()
    assert follow((0.9, 0.0))[1] == 0.0


def test_laps_of_a_closed_line_add_up_and_driving_back_takes_them_away() -> None:
    line = circle(90)
    follow = Follower(line)
    for degree in range(3 * 360 + 1):
        _, driven = follow((math.cos(math.radians(degree)), math.sin(math.radians(degree))))
    assert driven == pytest.approx(3 * line.length, rel=1e-6)
    for degree in range(3 * 360, -361, -1):
        _, driven = follow((math.cos(math.radians(degree)), math.sin(math.radians(degree))))
    assert driven == pytest.approx(-line.length, rel=1e-6)


def test_asking_twice_at_one_place_changes_nothing() -> None:
    follow = Follower(SQUARE)
    follow((0.9, 0.0))
    assert follow((1.0, 0.1)) == follow((1.0, 0.1))


def test_a_line_that_crosses_itself_is_followed_straight_on() -> None:
    eight = Line("eight", ((-1.0, -1.0), (1.0, 1.0), (1.0, -1.0), (-1.0, 1.0)), closed=True, width=0.02)
    follow = Follower(eight)
    for step in range(-80, 81):
        beside, driven = follow((step / 100, step / 100 + 0.001))
    assert driven == pytest.approx(1.6 * math.sqrt(2))
    assert beside == pytest.approx(0.001 / math.sqrt(2))


def test_lanes_beside_each_other_are_distinguished() -> None:
    hairpin = Line("hairpin", ((0.0, 0.0), (2.0, 0.0), (2.0, 0.05), (0.0, 0.05)), closed=False, width=0.01)
    follow = Follower(hairpin)
    for step in range(101):
        beside, _ = follow((step / 100, 0.02))
    assert beside == pytest.approx(0.02)
    beside, _ = follow((1.01, 0.03))  # nearer to the way back, which is two meters on
    assert beside == pytest.approx(0.03)


def test_bare_ground_is_white_and_paint_throws_back_what_it_says() -> None:
    light = PaintedGround([SQUARE], spot=0.002)
    assert light(0.5, 0.5) == 1.0
    assert light(40.0, 40.0) == 1.0
    assert light(0.5, 0.0) == pytest.approx(0.1)


@pytest.mark.parametrize(
    ("y", "share"), [(0.01, 0.5), (0.011, 0.25), (0.009, 0.75), (0.012, 0.0), (0.008, 1.0)]
)
def test_at_the_edge_of_the_paint_the_light_is_a_mean_over_the_spot(y: float, share: float) -> None:
    assert PaintedGround([SQUARE], spot=0.002)(0.5, -y) == pytest.approx(1.0 - 0.9 * share)


def test_a_spot_wider_than_the_line_never_sees_it_alone() -> None:
    assert PaintedGround([SQUARE], spot=0.02)(0.5, 0.0) == pytest.approx(1.0 - 0.9 * 0.5)


def test_a_later_line_lies_over_an_earlier_one() -> None:
    over = Line("over", ((0.5, -1.0), (0.5, 1.0)), closed=False, width=0.02, reflectance=0.7)
    assert PaintedGround([SQUARE, over], spot=0.001)(0.5, 0.0) == pytest.approx(0.7)
    assert PaintedGround([over, SQUARE], spot=0.001)(0.5, 0.0) == pytest.approx(0.1)


SCENARIO = """
deepbots: 1
name: Lines
parameters: {width: 20 mm}
world:
  timestep: 32 ms
  lines:
    track: {points: [0 0 m, 1 0 m, 1 1 m, 0 1 m], closed: true, width: width}
robots:
  rover:
    urdf: epuck
    sensors: {spin: {type: joint_velocity, joint: left_wheel}}
    actuators: {wheels: {type: velocity_motor, joints: ["*_wheel"], max_torque: 0.05 N*m}}
    apply: {wheels: gas * 5 rad/s}
action: {gas: 0 .. 1}
augment:
  offset: cross_track_error(rover, track)
  driven: arc_length(rover, track)
observation:
  offset: -1 .. 1 m
  driven: 0 m .. length(track)
reward: {r: 100 * delta(driven) / m}
truncation: {max_steps: 50}
reset: {place: {rover: {x: 0.1 m, y: -0.05 m, z: 0 m}}}
"""


def test_a_scenario_tells_the_place_beside_and_along_a_line_from_the_true_pose(make: Maker) -> None:
    compiled = api.compile(make.written(SCENARIO))
    assert [(entry.name, entry.low, entry.high) for entry in compiled.program.agent.numbers] == [
        ("offset", -1.0, 1.0),
        ("driven", 0.0, 4.0),
    ]
    with closing(api.make(compiled)) as environment:
        for _ in range(2):
            observation, _ = environment.reset(seed=1)
            assert observation == pytest.approx([-0.05, -1.0])
            x = environment.engine.pose("rover")()[0][0]
            total = sum(environment.step([1.0])[1] for _ in range(40))
            moved = environment.engine.pose("rover")()[0][0] - x
            assert total == pytest.approx(100 * moved)
            assert moved > 0.1
