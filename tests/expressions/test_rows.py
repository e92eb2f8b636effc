"""A vector for each link of a group: positions of feet, their components, reductions and combinations."""

from __future__ import annotations

from contextlib import closing
from pathlib import Path

import numpy as np
import pytest

from deepbots_cli import api
from deepbots_cli.expressions.types import RowComponents

DATA = Path(__file__).parents[1] / "data"


def test_a_group_of_links_has_a_vector_for_each(bench):
    value = bench.clean("position(cart.feet)")
    assert value.type.components == RowComponents(("left_toe", "right_toe"), ("x", "y", "z"))
    assert value.type.components[:4] == ("left_toe.x", "left_toe.y", "left_toe.z", "right_toe.x")


@pytest.mark.parametrize(
    ("text", "components"),
    [
        ("position(cart.feet).z", ("left_toe", "right_toe")),
        ("position(cart.feet).left_toe", ("x", "y", "z")),
        ("position(cart.feet).left_toe.z", None),
        ("position(cart.feet).z.left_toe", None),
        ("position(cart.feet).yx", RowComponents(("left_toe", "right_toe"), ("y", "x"))),
        ("norm(velocity(cart.feet))", ("left_toe", "right_toe")),
        ("mean(position(cart.feet))", ("x", "y", "z")),
        ("max(position(cart.feet))", ("x", "y", "z")),
        ("sum(norm(velocity(cart.feet).xy))", None),
        ("position(cart.feet) - position(cart)", RowComponents(("left_toe", "right_toe"), ("x", "y", "z"))),
        (
            "position(cart.feet) * norm(velocity(cart.feet))",
            RowComponents(("left_toe", "right_toe"), ("x", "y", "z")),
        ),
        ("tilt(cart.feet)", ("left_toe", "right_toe")),
        ("distance(cart.feet, ball)", ("left_toe", "right_toe")),
        ("contact(cart.feet, ground)", ("left_toe", "right_toe")),
        ("duration(not contact(cart.feet, ground))", ("left_toe", "right_toe")),
        ("rising_edge(position(cart.feet).z < 1 cm)", ("left_toe", "right_toe")),
        ("count(contact(cart.feet, ground))", None),
        ("any(position(cart.feet).z > 1 m)", None),
        (
            "to_body_frame(cart, position(cart.feet))",
            RowComponents(("left_toe", "right_toe"), ("x", "y", "z")),
        ),
        ("vector(1, 2, 3, 4)", ("1", "2", "3", "4")),
        ("vector(vector(1 m, 2 m), vector(3 m, 4 m))", RowComponents(("1", "2"), ("x", "y"))),
    ],
)
def test_what_a_value_of_a_group_has(bench, text, components):
    assert bench.clean(text).type.components == components


@pytest.mark.parametrize(
    ("text", "code", "piece"),
    [
        ("position(cart.feet) + joint_position(cart.legs)", "DB404", None),
        ("position(cart.feet).z * joint_position(cart.legs)", "DB404", None),
        ("position(cart.feet).knee", "DB402", "position(cart.feet).knee"),
        ("distance(cart.feet, cart.feet)", "DB404", None),
        ("to_body_frame(cart.feet, velocity(cart))", "DB203", "cart.feet"),
        ("to_body_frame(cart, position(cart.feet).xy)", "DB404", "position(cart.feet).xy"),
        ("count(position(cart.feet).z)", "DB403", "position(cart.feet).z"),
        ("vector(home, home.xy)", "DB404", "home.xy"),
        ("vector(position(cart.feet), position(cart.feet))", "DB404", "position(cart.feet)"),
    ],
)
def test_what_does_not_fit_is_one_finding(bench, text, code, piece):
    finding = bench.only(text)
    assert finding.code == code
    assert piece is None or finding.piece == piece


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("mean(vector(vector(1, 2), vector(3, 6)))", [2.0, 4.0]),
        ("max(vector(vector(3, 4), vector(6, 2)))", [6.0, 4.0]),
        ("norm(vector(vector(3, 4), vector(6, 8)))", [5.0, 10.0]),
        ("vector(vector(3, 4), vector(6, 8)) - vector(1, 2)", [2.0, 2.0, 5.0, 6.0]),
        (
            "vector(vector(3, 4), vector(6, 8)) * norm(vector(vector(0, 1), vector(0, 2)))",
            [3.0, 4.0, 12.0, 16.0],
        ),
        ("vector(vector(3, 4), vector(6, 8)).yx", [4.0, 3.0, 8.0, 6.0]),
        ("count(vector(1, 2, 3, 4) > 2)", [2.0]),
        ("count(vector(vector(1, 2), vector(3, 4)) > 1.5)", [1.0, 2.0]),
    ],
)
def test_rows_are_combined_as_by_hand(bench, text, value):
    assert bench.values(text) == value


def test_work_and_power_are_not_measured_in_radians(bench):
    """A torque times an angular velocity over a watt was "an angle (rad)"."""
    power = "sum(abs(joint_torque(cart.legs) * joint_velocity(cart.legs)))"
    assert str(bench.clean(power).type.dimension) == "W"
    assert str(bench.clean(f"{power} / (N*m*rad/s)").type.dimension) == "1"
    assert str(bench.clean("joint_torque(cart.legs) * joint_position(cart.legs)").type.dimension) == "N*m"
    assert str(bench.clean("2 kg*m^2 * 3 rad/s^2").type.dimension) == "N*m"
    assert str(bench.clean("4 N*m/rad * angle").type.dimension) == "N*m"


def test_a_group_of_feet_is_the_same_as_foot_by_foot():
    """To the bit, while the feet land and rise."""
    group, by_link = (api.make(str(DATA / name)) for name in ("scenarios/feet.yaml", "feet_by_link.yaml"))
    with closing(group), closing(by_link):
        np.testing.assert_array_equal(group.reset(seed=4)[0], by_link.reset(seed=4)[0])
        group.action_space.seed(1)
        terms = set()
        for _ in range(60):
            action = group.action_space.sample()
            observation, reward, terminated, _, info = group.step(action)
            foot_by_foot, other_reward, _, _, other_info = by_link.step(action)
            np.testing.assert_array_equal(observation, foot_by_foot)
            assert reward == other_reward
            assert info["reward_terms"] == other_info["reward_terms"]
            terms |= {name for name, value in info["reward_terms"].items() if value != 0.0}
            if terminated:
                break
    assert {"slip", "stride", "stands", "power", "high"} <= terms
