"""Trajectories of the bodies that move in an episode and matter to its task."""

from __future__ import annotations

from contextlib import closing
from dataclasses import replace
from itertools import product

import numpy as np
import pytest

from deepbots_cli import api
from deepbots_cli.robots.kinematics import robot_bounds
from deepbots_cli.runtime.overview import overview
from deepbots_cli.view import trajectories
from deepbots_cli.view.episodes import Player, Showing
from deepbots_cli.view.pictures import projection


@pytest.fixture(scope="module")
def push():
    """The arm that pushes a block, and its world."""
    program = api.compile(api.load("panda_push")).program
    return program, program.world


def _positions(world, **ways):
    """Positions of all bodies in four steps, of which those in `ways` go so far (m) along x."""
    names = [(robot.name, link.name) for robot in world.robots for link in robot.model.links] + [
        (o.name, o.name) for o in world.objects
    ]
    steps = np.arange(4.0)[:, None] / 3 * np.array([[1.0, 0.0, 0.0]])
    return {part: ways.get(part[1], 0.0) * steps for part in names}


def test_the_path_of_an_arm_is_not_a_dot_at_its_base(push):
    program, world = push
    moving = trajectories.find_moving(
        program, world, [_positions(world, block=0.1, panda_grasptarget=0.3, panda_link7=0.4)]
    )
    assert moving.parts == (("block", "block"), ("panda", "panda_grasptarget"))
    assert [trajectories.describe(world, part) for part in moving.parts] == [
        "block",
        "panda.panda_grasptarget",
    ]


def test_a_block_that_no_episode_moves_has_no_path(push):
    program, world = push
    moving = trajectories.find_moving(program, world, [_positions(world, panda_grasptarget=0.3)] * 2)
    assert moving.parts == (("panda", "panda_grasptarget"),)


def test_an_arm_whose_links_the_task_does_not_read_moves_as_the_link_that_goes_farthest(push):
    program, world = push
    silent = program.with_agent(goal=None, observation=(), reward=())
    moving = trajectories.find_moving(
        replace(silent, endings=()), world, [_positions(world, panda_link5=0.2, panda_hand=0.3)]
    )
    assert moving.parts == (("panda", "panda_hand"),)


def test_a_target_that_moves_is_followed():
    overrides = ("goal.desired=vector(0.5 m, 0.2 m * sin(90 deg/s * time), 0.5 m)",)
    with closing(Player(Showing("panda_reach", overrides=overrides).open(), "zero")) as player:
        positions = trajectories.read_positions(player.reader.layout, player.episode(0, 0, 5))
        assert trajectories.find_moving(player.program, player.env.world, [positions]).targets == (
            ("", "agent"),
        )
    assert positions["", "agent"][:, 1] == pytest.approx(
        0.2 * np.sin(np.pi / 2 * 0.04 * np.arange(6)), abs=1e-6
    )
    assert trajectories.has_moved(positions["", "agent"])


def test_a_wall_that_a_failure_reads_is_not_a_target():
    overrides = ["objects.post={shape: box, size: 5 5 5 cm, fixed: true}", "reset.place.post={x: 0.3 m, y:"
                                                                           " 0.3 m}",
                 "termination.failure.hit=contact(cart, post)", "reward.hit=-5 when hit"]  # fmt: skip
    program = api.compile(api.load("cartpole", overrides=overrides)).program
    moving = trajectories.find_moving(program, program.world, [_positions(program.world, base_link=0.2)])
    assert moving.targets == ()


def test_the_page_draws_the_path_of_an_arm_by_its_end_link():
    pytest.importorskip("viser")
    from deepbots_cli.view.page import Page

    with closing(Page(Showing("panda_reach"), port=0, driver="random")) as page:
        for _ in range(3):
            page.step_once()
        trail = np.array(page.world._trail)
    assert np.linalg.norm(trail[-1] - trail[0]) > 0.005
    assert trail[0][2] > 0.4  # and not where the base stands


def test_the_view_does_not_cut_off_an_arm_that_reaches_out(push):
    model = push[1].robots[0].model
    view = overview(api.compile(api.load("panda_reach")).program, 300, 200)
    low, high = robot_bounds(model, {"panda_joint2": 0.4, "panda_joint4": -1.2, "panda_joint6": 1.6})
    for corner in product(*zip(low, high, strict=True)):
        x, y = projection(view)(corner)
        assert 0 < x < 300
        assert 0 < y < 200
