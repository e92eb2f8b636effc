"""Actions of choices and ranges, and the masks of options that are forbidden."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from deepbots_cli.errors import EvaluationError, UsageError
from deepbots_cli.rollout.drivers import repeated_actions, zero_action
from tests.worlds import Make

MIXED = "action={drive: -1 .. 1, gear: {choices: {low: 1, high: 3}, forbid: {high: step < 1}}, tilt: 0 .. 4}"
REWARD = "reward: {drive: drive, gear: 10 * gear, tilt: 100 * tilt}\n"


def act(gear: Any, *ranges: float) -> dict[str, Any]:
    return {"choices": gear, "ranges": np.array(ranges, np.float32)}


def test_choices_and_ranges_together_are_a_dict(small: Make) -> None:
    environment = small(REWARD, MIXED)
    environment.reset(seed=0)
    assert environment.step(act(1, 0.5, 0))[1] == 0.5 + 30 + 200
    assert environment.step(act(np.int64(0), -1, 1))[1] == -1 + 10 + 400
    for _ in range(20):
        environment.step(environment.action_space.sample())


def test_the_previous_action_lists_both_as_numbers_in_file_order(small: Make) -> None:
    environment = small(REWARD, MIXED, "observation={previous_action: auto}")
    names = [entry.component for entry in environment.scenario.agent.numbers]
    assert names == ["drive", "gear_low", "gear_high", "tilt"]
    assert environment.reset(seed=0)[0].tolist() == [0, 0, 0, 0]
    assert environment.step(act(1, 0.5, -0.25))[0].tolist() == [0.5, 0, 1, -0.25]


def test_masks_of_the_choices_go_with_samples_of_the_dict(small: Make) -> None:
    environment = small(REWARD, MIXED)
    _, info = environment.reset(seed=0)
    assert environment.action_masks().tolist() == [True, False]
    assert all(environment.action_space.sample(info["action_mask"])["choices"] == 0 for _ in range(20))


@pytest.mark.parametrize("form", [list, tuple, lambda array: array.astype(float)])
def test_both_parts_may_come_in_usual_forms(small: Make, form: Callable[[Any], Any]) -> None:
    environment = small(REWARD, MIXED)
    environment.reset(seed=0)
    action = {"choices": np.array(1), "ranges": form(np.array([0.5, 0.0], np.float32))}
    assert environment.step(action)[1] == 230.5


BAD = [
    None,
    0,
    "low",
    {},
    [],
    np.zeros(3),
    {"choices": 0},
    {"ranges": np.zeros(2)},
    act(2, 0, 0),
    act(0, 0),
    act(0, np.nan, 0),
    act("low", 0, 0),
]


@pytest.mark.parametrize("action", BAD, ids=str)
def test_what_does_not_fit_is_refused_and_changes_nothing(small: Make, action: Any) -> None:
    environment = small(REWARD, MIXED)
    environment.reset(seed=0)
    with pytest.raises(UsageError, match="does not fit"):
        environment.step(action)
    assert environment.step_count == 0


def test_an_action_of_both_can_be_scripted_and_left_alone(small: Make) -> None:
    environment = small(REWARD, MIXED)
    environment.reset(seed=0)
    assert environment.step(repeated_actions(environment, "0.5:high:-1").act(None))[1] == 0.5 + 30 + 0
    assert environment.step(zero_action(environment.action_space))[1] == 0 + 10 + 200


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("2:low:0", r"-1 is -1, 1 is 1\)"),
        ("0:low:0:0", "has 4 parts, but this scenario needs 3$"),
        ("0", "has 1 part, but this scenario needs 3; separate the parts by colons"),
        ("0:low:0 *x", r"such as 0:low:0\*8"),
    ],
)
def test_an_action_that_cannot_be_read_is_explained(small: Make, text: str, message: str) -> None:
    with pytest.raises(UsageError, match=message):
        repeated_actions(small(REWARD, MIXED), text)


# Options that are forbidden: the masks, where conditions come from, and a state without a way out


PAY = "reward: {pay: drive}\n"
THREE = (
    "action.drive={choices: {ahead: 1, back: -1, stay: 0}, forbid: {ahead: step >= 2, stay:"
    " previous_action.stay}}"
)


def test_masks_follow_what_was_known_after_the_last_step(small: Make) -> None:
    environment = small(PAY, THREE)
    _, info = environment.reset(seed=0)
    masks = [environment.action_masks().tolist()]
    for action in (2, 0, 1):
        info = environment.step(action)[4]
        masks.append(environment.action_masks().tolist())
        np.testing.assert_array_equal(info["action_mask"], masks[-1])
    assert masks == [[True, True, True], [True, True, False], [False, True, True], [False, True, True]]


def test_samples_with_the_mask_of_the_info_are_allowed(small: Make) -> None:
    environment = small(PAY, THREE)
    _, info = environment.reset(seed=0)
    for _ in range(50):
        action = environment.action_space.sample(info["action_mask"])
        assert environment.action_masks()[action]
        info = environment.step(action)[4]


def test_several_choices_have_their_masks_in_a_row(small: Make) -> None:
    pair = (
        "action={drive: {choices: {ahead: 1, back: -1}, forbid: {back: lamp_off}}, lamp: {choices: {on:"
        " 1, off: 0}}}"
    )
    environment = small("augment: {lamp_off: previous_action.lamp_off}\nreward: {pay: drive + lamp}\n", pair)
    _, info = environment.reset(seed=0)
    assert environment.action_masks().tolist() == [True, True, True, True]
    info = environment.step(np.array([0, 1]))[4]
    assert environment.action_masks().tolist() == [True, False, True, True]
    assert environment.action_space.sample(info["action_mask"])[0] == 0


def test_without_conditions_every_option_is_allowed_and_the_info_says_nothing(small: Make) -> None:
    environment = small(PAY, "action.drive={choices: {ahead: 1, back: -1}}")
    _, info = environment.reset(seed=0)
    assert environment.action_masks().tolist() == [True, True]
    assert "action_mask" not in info


def test_ranges_have_no_masks(small: Make) -> None:
    environment = small(PAY)
    environment.reset(seed=0)
    with pytest.raises(UsageError, match="no"):
        environment.action_masks()


def test_a_state_in_which_nothing_is_allowed_is_an_error_that_names_the_options(small: Make) -> None:
    environment = small(
        PAY, "action.drive={choices: {ahead: 1, back: -1}, forbid: {ahead: step > 1, back: step > 1}}"
    )
    environment.reset(seed=0)
    environment.step(0)
    with pytest.raises(EvaluationError, match="every option of 'drive' is forbidden: ahead, back"):
        environment.step(0)


def test_nothing_needs_to_be_allowed_once_an_episode_has_ended(small: Make) -> None:
    forbid = "action.drive={choices: {ahead: 1, back: -1}, forbid: {ahead: step > 1, back: step > 1}}"
    environment = small(PAY, forbid, "truncation.max_steps=2")
    environment.reset(seed=0)
    environment.step(0)
    assert environment.step(0)[3]
