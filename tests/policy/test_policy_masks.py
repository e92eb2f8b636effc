"""Options that are forbidden: the masks, where conditions come from, and a state without a way out."""

from __future__ import annotations

import numpy as np
import pytest

from deepbots_cli.errors import EvaluationError, UsageError
from tests.worlds import Make

REWARD = "reward: {pay: drive}\n"
THREE = (
    "action.drive={choices: {ahead: 1, back: -1, stay: 0}, forbid: {ahead: step >= 2, stay:"
    " previous_action.stay}}"
)


def test_masks_follow_what_was_known_after_the_last_step(small: Make) -> None:
    environment = small(REWARD, THREE)
    _, info = environment.reset(seed=0)
    masks = [environment.action_masks().tolist()]
    for action in (2, 0, 1):
        info = environment.step(action)[4]
        masks.append(environment.action_masks().tolist())
        np.testing.assert_array_equal(info["action_mask"], masks[-1])
    assert masks == [[True, True, True], [True, True, False], [False, True, True], [False, True, True]]


def test_samples_with_the_mask_of_the_info_are_allowed(small: Make) -> None:
    environment = small(REWARD, THREE)
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
    environment = small(REWARD, "action.drive={choices: {ahead: 1, back: -1}}")
    _, info = environment.reset(seed=0)
    assert environment.action_masks().tolist() == [True, True]
    assert "action_mask" not in info


def test_ranges_have_no_masks(small: Make) -> None:
    environment = small(REWARD)
    environment.reset(seed=0)
    with pytest.raises(UsageError, match="no"):
        environment.action_masks()


def test_a_state_in_which_nothing_is_allowed_is_an_error_that_names_the_options(small: Make) -> None:
    environment = small(
        REWARD, "action.drive={choices: {ahead: 1, back: -1}, forbid: {ahead: step > 1, back: step > 1}}"
    )
    environment.reset(seed=0)
    environment.step(0)
    with pytest.raises(EvaluationError, match="every option of 'drive' is forbidden: ahead, back"):
        environment.step(0)


def test_nothing_needs_to_be_allowed_once_an_episode_has_ended(small: Make) -> None:
    forbid = "action.drive={choices: {ahead: 1, back: -1}, forbid: {ahead: step > 1, back: step > 1}}"
    environment = small(REWARD, forbid, "truncation.max_steps=2")
    environment.reset(seed=0)
    environment.step(0)
    assert environment.step(0)[3]
