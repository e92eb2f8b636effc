"""Pictures show what matters: all of it is in the frame, and the frame is filled."""

import math
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest

from deepbots_cli import api
from deepbots_cli.document import shipped
from deepbots_cli.frames import add, cross, dot, scaled, subtract
from deepbots_cli.port import View
from deepbots_cli.runtime import Supervisor
from deepbots_cli.runtime.overview import overview, shift_beside, view_around
from tests.few import few


def place_in_picture(view: View, point: tuple[float, float, float]) -> tuple[float, float]:
    """Where a point is in the picture: -1 to 1 from left to right and from bottom to top."""
    ahead = subtract(view.target, view.eye)
    ahead = scaled(ahead, 1 / math.sqrt(dot(ahead, ahead)))
    right = cross(ahead, (0.0, 0.0, 1.0))
    right = scaled(right, 1 / math.sqrt(dot(right, right)))
    offset = subtract(point, view.eye)
    depth = dot(offset, ahead)
    tall = math.tan(view.fov / 2)
    assert depth > 0
    return dot(offset, right) / depth / tall * view.height / view.width, dot(
        offset, cross(right, ahead)
    ) / depth / tall


TEAM = Path(__file__).parents[1] / "channel" / "team.yaml"
BOXES = [
    ((-0.04, -0.04, 0.0), (0.04, 0.04, 0.05)),
    ((-5.0, -5.0, 0.0), (5.0, 5.0, 0.1)),
    ((0.0, 0.0, 0.0), (0.1, 0.1, 3.0)),
    ((9.0, -3.0, 1.0), (11.0, -2.0, 2.0)),
]


@pytest.mark.parametrize("box", BOXES)
def test_a_view_contains_a_box_and_hardly_more(box) -> None:
    view = view_around([box])
    corners = [
        place_in_picture(view, (x, y, z))
        for x in (box[0][0], box[1][0])
        for y in (box[0][1], box[1][1])
        for z in (box[0][2], box[1][2])
    ]
    greatest = max(abs(part) for corner in corners for part in corner)
    assert greatest == pytest.approx(1 / 1.08) or (
        max(box[1][2] - box[0][2], box[1][0] - box[0][0]) < 0.1 and greatest < 1.0
    )


def test_scenes_stand_side_by_side_and_long_ones_lie_across() -> None:
    boxes = [((-5.0, -5.0, 0.0), (5.0, 5.0, 0.1))]
    view = view_around(boxes)
    shift = shift_beside(boxes, boxes)
    assert place_in_picture(view, add(view.target, shift))[0] > 1.0
    row = view_around([((-0.5, -4.0, 0.0), (0.5, 4.0, 0.2))])
    ends = [place_in_picture(row, (0.0, y, 0.0)) for y in (-4.0, 4.0)]
    assert abs(ends[1][0] - ends[0][0]) > 1.5


@pytest.mark.parametrize("name", few(shipped.scenario_names()))
def test_every_robot_of_a_shipped_scenario_begins_in_the_picture(name: str) -> None:
    with closing(api.make(name)) as environment:
        view = overview(environment.scenario)
        for seed in range(5):
            environment.reset(seed=seed)
            for name in robot_bodies(environment):
                x, y = place_in_picture(view, environment.engine.pose(name)()[0])
                assert abs(x) < 1.0
                assert abs(y) < 1.0


def robot_bodies(environment: Supervisor) -> list[str]:
    """The bodies of the robots in the engine; with copies of a robot, those of every copy."""
    return [robot.name for robot in environment.world.robots]


def test_every_copy_of_a_row_begins_in_the_picture() -> None:
    with closing(
        api.make(TEAM, overrides=["robots.cart.count=9", "robots.cart.spacing=0 4 0 m"])
    ) as environment:
        view = overview(environment.scenario)
        environment.reset(seed=0)
        for number in range(1, 10):
            place = environment.engine.pose(f"cart#{number}")()[0]
            assert max(map(abs, place_in_picture(view, place))) < 1.0


def test_the_view_follows_a_robot_that_leaves_and_stays_where_there_is_an_arena() -> None:
    with closing(api.make("quadruped", engine="pybullet", render_mode="rgb_array")) as environment:
        environment.reset(seed=0)
        first = environment.render()
        (x, y, z), turn = environment.engine.pose("dog")()
        environment.engine.place("dog", (x + 8.0, y, z), turn)
        body = np.abs(environment.render().astype(int) - first.astype(int)).sum(axis=2) > 60
        assert body.mean() < 0.05  # the floor under it has the same tiles, and the robot is where it was
