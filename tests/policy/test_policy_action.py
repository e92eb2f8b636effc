"""What a policy does: actions, masks, and policies that are written by hand.

* Actions of choices and ranges, and the masks of options that are forbidden.
* Policies that are written by hand: their inputs, their actions, and that evaluating them changes nothing.
"""

from __future__ import annotations

import difflib
from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from deepbots_cli import api
from deepbots_cli.errors import EvaluationError, UsageError
from deepbots_cli.rollout.drivers import repeated_actions, zero_action
from deepbots_cli.runtime import Supervisor
from tests.worlds import SCENARIOS, Make, begun

MIXED = "action={drive: -1 .. 1, gear: {choices: {low: 1, high: 3}, forbid: {high: step < 1}}, tilt: 0 .. 4}"
REWARD = "reward: {drive: drive, gear: 10 * gear, tilt: 100 * tilt}\n"


def act(gear: Any, *ranges: float) -> dict[str, Any]:
    return {"choices": gear, "ranges": np.array(ranges, np.float32)}


def test_choices_and_ranges_together_are_a_dict(small: Make) -> None:
    environment = begun(small(REWARD, MIXED))
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
    environment = begun(small(REWARD, MIXED))
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
    environment = begun(small(REWARD, MIXED))
    with pytest.raises(UsageError, match="does not fit"):
        environment.step(action)
    assert environment.step_count == 0


def test_an_action_of_both_can_be_scripted_and_left_alone(small: Make) -> None:
    environment = begun(small(REWARD, MIXED))
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
    environment = begun(small(PAY))
    with pytest.raises(UsageError, match="no"):
        environment.action_masks()


def test_a_state_in_which_nothing_is_allowed_is_an_error_that_names_the_options(small: Make) -> None:
    environment = begun(
        small(PAY, "action.drive={choices: {ahead: 1, back: -1}, forbid: {ahead: step > 1, back: step > 1}}")
    )
    environment.step(0)
    with pytest.raises(EvaluationError, match="every option of 'drive' is forbidden: ahead, back"):
        environment.step(0)


def test_nothing_needs_to_be_allowed_once_an_episode_has_ended(small: Make) -> None:
    forbid = "action.drive={choices: {ahead: 1, back: -1}, forbid: {ahead: step > 1, back: step > 1}}"
    environment = begun(small(PAY, forbid, "truncation.max_steps=2"))
    environment.step(0)
    assert environment.step(0)[3]


COPIES = Path(__file__).parents[1] / "channel" / "copies.yaml"
PAY = "reward: {pay: drive}\n"
CHOICE = "action.drive={choices: {ahead: 1, back: -1, stay: 0}}"


def actions_of_script(environment: Supervisor, name: str, steps: int) -> list[Any]:
    """The actions of a script over some steps."""
    actions = []
    for _ in range(steps):
        actions.append(environment.script(name))
        environment.step(actions[-1])
    return actions


# What a script gives
def test_an_option_that_is_named_is_taken_always(small: Make) -> None:
    environment = begun(small(PAY + "scripts: {rest: {drive: stay}}\n", CHOICE))
    assert actions_of_script(environment, "rest", 3) == [2, 2, 2]


def test_the_first_option_whose_condition_holds_is_taken(small: Make) -> None:
    rules = "scripts: {turns: {drive: {back: step >= 2 and step < 4, ahead: step >= 3, stay: true}}}\n"
    environment = begun(small(PAY + rules, CHOICE))
    assert actions_of_script(environment, "turns", 6) == [2, 2, 1, 1, 0, 0]


def test_a_value_is_in_the_unit_of_the_range_and_clamped_to_it(small: Make) -> None:
    script = "scripts: {late: {drive: 10 mm + step * 20 mm}}\n"
    overrides = ("action.drive=20 .. 60 mm", "robots.cart.apply.motor=drive / s")
    environment = begun(small("reward: {pay: drive / mm}\n" + script, *overrides))
    pays = [environment.step(environment.script("late"))[1] for _ in range(5)]
    assert pays == pytest.approx([20, 30, 50, 60, 60], abs=1e-5)
    assert environment.script("late").dtype == np.float32
    assert environment.action_space.contains(environment.script("late"))


def test_a_constant_beyond_the_range_is_clamped_too(small: Make) -> None:
    environment = begun(
        small(PAY + "scripts: {much: {drive: 7}, little: {drive: -7}}\n", "action.drive=-2 .. 6")
    )
    assert (environment.script("much").tolist(), environment.script("little").tolist()) == ([1.0], [-1.0])


def test_components_of_a_vector_have_one_value_or_one_each() -> None:
    each = "{prop_fl: -30 mN, prop_fr: 15 mN, prop_rl: 0 N, prop_rr: 60 mN}"
    overrides = [f"scripts={{same: {{push: 15 mN}}, each: {{push: {each}}}, before: {{push: push + 3 mN}}}}"]
    with closing(api.make(SCENARIOS / "drone.yaml", overrides=overrides)) as environment:
        environment.reset(seed=0)
        assert environment.script("same").tolist() == pytest.approx([0.5] * 4)
        assert environment.script("each").tolist() == pytest.approx([-1, 0.5, 0, 1])
        assert environment.script("before").tolist() == pytest.approx([0.1] * 4)
        environment.step(environment.script("each"))
        assert environment.script("before").tolist() == pytest.approx([-0.9, 0.6, 0.1, 1])


def test_several_choices_are_an_array_and_stand_in_the_order_of_the_action() -> None:
    overrides = ["scripts={go: {hurry: {fast: time > 20 ms, slow: true}, both: apart}}"]
    with closing(api.make(SCENARIOS / "pair.yaml", overrides=overrides, engine="exact")) as environment:
        environment.reset(seed=0)
        assert [action.tolist() for action in actions_of_script(environment, "go", 2)] == [[1, 0], [1, 1]]
        assert environment.action_space.contains(environment.script("go"))


def test_choices_beside_ranges_are_a_dictionary(small: Make) -> None:
    action = "action={drive: -1 .. 1, gear: {choices: {low: 1, high: 3}}}"
    environment = begun(
        small("reward: {pay: drive * gear}\nscripts: {go: {gear: high, drive: 0.5}}\n", action)
    )
    assert environment.action_space.contains(environment.script("go"))
    assert environment.step(environment.script("go"))[1] == 1.5


def test_every_copy_of_a_robot_follows_the_script_by_what_it_sees_itself() -> None:
    overrides = ["scripts={catch: {drive: {forward: cart.lean > 0 rad, backward: true}}}"]
    with closing(api.make(COPIES, overrides=overrides, engine="exact")) as environment:
        leans = environment.reset(seed=4)[0][:, 2]
        actions = environment.script("catch")
        assert environment.action_space.contains(actions)
        assert actions.tolist() == [0 if lean > 0 else 1 for lean in leans]
        assert len(set(actions.tolist())) == 2  # or the seed shows nothing


# What a script sees
def test_a_script_sees_what_arrived_and_what_is_true(small: Make) -> None:
    sections = (
        PAY + "scripts: {told: {drive: cart.place / m}, truth: {drive: joint_position(cart.slider) / m}}\n"
    )
    environment = begun(small(sections, "messages.timing=delayed"))
    for _ in range(3):
        environment.step(np.array([1.0], np.float32))
    received, truth = environment.script("told").item(), environment.script("truth").item()
    assert received == pytest.approx(2.4 * environment.get_observations()[0], abs=1e-7)
    assert truth > received + 1e-5  # what the robot sends is one tick old


def test_a_script_sees_signals_with_a_memory_and_its_own_last_action(small: Make) -> None:
    sections = 'signals: {trail: "accumulate(0.1, 0 .. 1, 0)"}\n' + PAY
    sections += "scripts: {by_signal: {drive: trail}, by_action: {drive: previous_action.drive + 0.25}, "
    sections += "by_variable: {drive: drive + 0.25}}\n"
    environment = begun(small(sections))
    assert np.concatenate(actions_of_script(environment, "by_signal", 4)).tolist() == pytest.approx(
        [0, 0.1, 0.2, 0.3]
    )
    for name in ("by_action", "by_variable"):
        environment.reset(seed=0)
        assert np.concatenate(actions_of_script(environment, name, 4)).tolist() == pytest.approx(
            [0.25, 0.5, 0.75, 1.0]
        )


@pytest.mark.parametrize("repeat", [1, 3])
def test_a_script_reads_the_reward_of_the_last_step(small: Make, repeat: int) -> None:
    sections = (
        "reward: {pay: 0.01 * (step + 1)}\nscripts: {last: {drive: previous_reward}, sum: {drive:"
        " episode_return}}\n"
    )
    environment = begun(small(sections, f"agent.action_repeat={repeat}"))
    rewards = [0.0]
    for _ in range(4):
        assert environment.script("last").item() == pytest.approx(rewards[-1], abs=1e-7)
        assert environment.script("sum").item() == pytest.approx(sum(rewards), abs=1e-7)
        rewards.append(environment.step(np.zeros(1, np.float32))[1])


def test_a_script_that_asks_what_nothing_else_asks_gets_true_answers() -> None:
    """Contacts of the whole tick, and the way along a line."""
    world = "world.lines={stripe: {points: [-1 0 m, 1 0 m], width: 20 mm}}"
    ball = "objects={ball: {shape: sphere, radius: 5 cm, pose: {x: 0.4 m}}}"
    way = "way: {drive: {forward: 'arc_length(cart, stripe) > 0.05 m', backward: true}}"
    overrides = [
        world,
        ball,
        "termination={}",
        f"scripts={{{way}, touch: {{drive: {{backward: collided(cart), forward: true}}}}}}",
    ]
    with closing(api.make("cartpole", overrides=overrides)) as environment:
        environment.reset(seed=0)
        assert environment.script("way") == 1
        touched = []
        for _ in range(40):
            touched.append(environment.script("touch"))
            environment.step(0)
        assert (environment.script("way"), touched[0]) == (0, 0)
        assert 1 in touched  # the ball


def test_the_age_of_a_reading_is_known_to_a_script(small: Make) -> None:
    sensor = "robots.cart.sensors.rate={type: joint_velocity, joint: slider, latency: 60 ms}"
    environment = begun(small(PAY + "scripts: {old: {drive: age(cart.rate) / s}}\n", sensor))
    assert np.concatenate(actions_of_script(environment, "old", 6)).tolist()[-1] == pytest.approx(0.06)


def test_a_case_may_have_a_script_of_its_own(small: Make) -> None:
    sections = PAY + "scripts: {go: {drive: 1}}\nevaluation: {cases: {back: {set: {scripts.go.drive: -1}}}}\n"
    environment = small(sections)
    with closing(api.build(environment.scenario.case("back").program, engine="exact")) as case:
        for world, expected in ((environment, [1.0]), (case, [-1.0])):
            world.reset(seed=0)
            assert world.script("go").tolist() == expected


# Asking
def test_asking_changes_nothing() -> None:
    overrides = [
        "scripts={go: {both: {apart: 'clearance(left.cart, right.cart) > 1 m', still: true}, hurry: {fast:"
        " ahead > 0 m, slow: true}}}",
        "termination={}",
    ]

    def episode(*, asking: bool) -> list[Any]:
        with closing(api.make(SCENARIOS / "pair.yaml", overrides=overrides)) as environment:
            environment.reset(seed=3)
            steps = []
            for _ in range(30):
                if asking:
                    assert environment.script("go").tolist() == environment.script("go").tolist()
                observation, *rest = environment.step(np.array([1, 1]))
                steps.append((observation.tobytes(), *rest))
            return steps

    assert episode(asking=True) == episode(asking=False)


def test_a_scenario_with_a_script_does_in_a_step_what_it_does_without_but_for_what_it_keeps() -> None:
    script = "scripts={catch: {drive: {forward: cart.pole_angle > 0 rad, backward: true}}}"
    plain, scripted = (
        api.compile("cartpole", overrides=overrides).code.splitlines()[1:] for overrides in ([], [script])
    )
    changed = [line for line in difflib.ndiff(plain, scripted) if line[0] in "+-" and line[2:].strip()]
    in_step, _, _ = "\n".join(changed).partition("\n+     def script_")
    assert in_step == "+         self.last_cart_pole_angle = cart_pole_angle"
    assert not any(line.startswith("-") for line in changed)


def test_a_script_is_asked_while_an_episode_runs(small: Make) -> None:
    environment = small(PAY + "scripts: {go: {drive: 1}}\n")
    with pytest.raises(UsageError, match=r"reset\(\)"):
        environment.script("go")
    environment.reset(seed=0)
    with pytest.raises(UsageError, match=r"did you mean go\?.*there are: go"):
        environment.script("goo")
    environment.close()
    with pytest.raises(UsageError, match="closed"):
        environment.script("go")


def test_a_scenario_without_scripts_says_so(small: Make) -> None:
    environment = begun(small(PAY))
    with pytest.raises(UsageError, match="has no scripts"):
        environment.script("__init__")


def test_a_script_without_a_value_is_an_error_that_shows_where(small: Make) -> None:
    environment = begun(small(PAY + "scripts: {go: {drive: 1 / (step - 1)}}\n"))
    environment.step(environment.script("go"))
    with pytest.raises(EvaluationError, match=r"no value for `return make_action\(.*division"):
        environment.script("go")
