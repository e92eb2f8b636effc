"""Pictures of a camera as part of the observation."""

from __future__ import annotations

from contextlib import closing
from pathlib import Path

import numpy as np
import pytest

from deepbots_cli import api
from deepbots_cli.errors import ScenarioError
from deepbots_cli.learning import learner
from deepbots_cli.learning.learner import Setup
from deepbots_cli.learning.policy import Policy
from deepbots_cli.runtime import Supervisor
from tests.worlds import Make

SECTIONS = """\
reward: {pay: drive}
objects: {ball: {shape: sphere, radius: 10 cm, color: red, fixed: true, pose: {x: 1 m, z: 0.6 m}}}
"""
EYE = (
    "robots.cart.sensors.eye={type: camera, link: cart, pose: {x: 0.3 m, z: 0.2 m}, resolution: 24 16,"
    " fov: 60 deg}"
)
SEND = "robots.cart.emit=[place, eye]"
PUSH = "robots.cart.apply={motor: drive * 2 m/s}"


def look(small: Make, observation: str, *overrides: str) -> Supervisor:
    return small(SECTIONS, EYE, SEND, PUSH, f"observation={observation}", *overrides, engine="pybullet")


def test_a_picture_stands_under_its_name_beside_the_numbers(small: Make) -> None:
    environment = look(small, "{cart.place: -2 .. 2 m, cart.eye: auto}")
    observation, _ = environment.reset(seed=0)
    assert environment.observation_space.contains(observation)
    assert observation["cart_eye"].shape == (16, 24, 3)
    assert observation["cart_eye"].dtype == np.uint8
    assert observation["cart_eye"].std() > 1
    assert observation["observation"].shape == (1,)


def test_a_policy_may_see_pictures_alone(small: Make) -> None:
    assert set(look(small, "{cart.eye: auto}").observation_space) == {"cart_eye"}


def test_a_history_of_pictures_stands_side_by_side_the_newest_last(small: Make) -> None:
    single = look(small, "{cart.eye: auto}")
    pictures = [single.reset(seed=0)[0]["cart_eye"]]
    pictures += [single.step(np.ones(1, np.float32))[0]["cart_eye"] for _ in range(5)]
    assert len({picture.tobytes() for picture in pictures}) > 2
    several = look(small, "{cart.eye: {range: auto, history: 3}, cart.place: -2 .. 2 m}")
    for _ in range(2):
        histories = [several.reset(seed=0)[0]["cart_eye"]]
        histories += [several.step(np.ones(1, np.float32))[0]["cart_eye"] for _ in range(5)]
        for index, picture in enumerate(histories):
            expected = [pictures[max(0, index - ago)] for ago in (2, 1, 0)]
            np.testing.assert_array_equal(picture, np.concatenate(expected, axis=2))


def test_a_stack_applies_to_pictures_too(small: Make) -> None:
    environment = look(
        small, "{cart.eye: auto, cart.place: -2 .. 2 m}", "agent={frame_stack: 2, action_repeat: 2}"
    )
    assert environment.observation_space["cart_eye"].shape == (16, 24, 6)
    environment.reset(seed=0)
    first = environment.step(np.ones(1, np.float32))[0]["cart_eye"]
    second = environment.step(np.ones(1, np.float32))[0]["cart_eye"]
    np.testing.assert_array_equal(first[..., 3:], second[..., :3])


def test_pictures_that_were_given_out_do_not_change(small: Make) -> None:
    environment = look(small, "{cart.eye: {range: auto, history: 2}}")
    kept = environment.reset(seed=0)[0]["cart_eye"]
    copy = kept.copy()
    environment.step(np.ones(1, np.float32))
    np.testing.assert_array_equal(kept, copy)


@pytest.mark.parametrize("entry", ["0 .. 255", "{range: auto, noise: 0.1}", "{range: auto, history: 1000}"])
def test_an_entry_that_is_useless_for_a_picture_is_a_finding(small: Make, entry: str) -> None:
    with pytest.raises(ScenarioError):
        look(small, f"{{cart.place: -2 .. 2 m, cart.eye: {entry}}}", "agent={frame_stack: 20}")


@pytest.mark.parametrize(
    ("depth_range", "shade"),
    [("0.5 m .. 2.5 m", 64), ("0 m .. 4 m", 64), ("1.2 m .. 2 m", 0), ("0.1 m .. 0.8 m", 255)],
)
def test_a_picture_of_depth_grows_evenly_from_the_near_end_of_its_range_to_the_far_end(
    small: Make, depth_range: str, shade: int
) -> None:
    box = "objects.box={shape: box, size: 20 40 400 cm, fixed: true, pose: {x: 1.4 m, z: 2 m}}"
    overrides = (
        box,
        "robots.cart.sensors.eye.channels=depth",
        f"robots.cart.sensors.eye.range={depth_range}",
    )
    environment = look(small, "{cart.eye: auto}", *overrides)
    picture = environment.reset(seed=0)[0]["cart_eye"]
    assert picture.shape == (16, 24, 1)
    assert abs(int(picture[8, 12, 0]) - shade) <= 1  # the face of the box is 1 m ahead
    assert picture[0, 0, 0] == 255  # the sky


# A camera that nothing but the goal looks through


TURNING = Path(__file__).parent / "turning.yaml"


def test_a_goal_sees_the_ball_until_the_robot_has_turned_away() -> None:
    with closing(api.make(TURNING)) as environment:
        environment.reset(seed=0)
        rewards = [environment.step(np.ones(1, np.float32))[1] for _ in range(10)]
    assert rewards[0] == 1.0
    assert rewards[-1] == 0.0
    assert rewards == sorted(rewards, reverse=True)


def test_a_recurrent_policy_takes_rows_of_pictures(small: Make) -> None:
    train = "train={algorithm: RecurrentPPO, lstm: 8, total_timesteps: 100}"
    larger = "robots.cart.sensors.eye.resolution=36 36"
    environment = look(small, "{cart.place: -2 .. 2 m, cart.eye: auto}", larger, train)
    program = environment.scenario
    spaces = environment.observation_space, environment.action_space
    policy = Policy(program, learner.create(Setup(program.agent.training, *spaces, program=program)))
    environment.reset(seed=0)
    observations = [environment.step(np.full(1, drive, np.float32))[0] for drive in (-1, 1, 1)]
    expected = []
    for observation in observations:
        policy.reset()
        expected.append([policy.predict(observation) for _ in range(2)])
    policy.reset()
    rows = {name: np.stack([each[name] for each in observations]) for name in observations[0]}
    predicted = [policy.predict(rows) for _ in range(2)]
    np.testing.assert_allclose(np.stack(predicted, axis=1), expected, atol=1e-5)
