"""The supervisor between engine and robots: timing, endings, failures, and the code that one sees."""

from __future__ import annotations

import ast
import inspect
import linecache
import math
import traceback
from typing import Any

import numpy as np
import pytest

from deepbots_cli import api
from deepbots_cli.errors import DeepbotsError, EngineError, EvaluationError, MessageError, UsageError
from deepbots_cli.runtime import Supervisor
from tests.worlds import RAIL, Make

NEARLY = 1e-6  # a motor of limited force leaves the speed so near to its target
DRIVES = (1.0, -1.0, -1.0, 0.5, 1.0)


def rates(environment: Supervisor) -> tuple[list[float], list[float]]:
    """Speeds of the cart after each step in units of the command: as the robot sent it, and the truth."""
    environment.reset(seed=0)
    infos = [environment.step(np.array([drive]))[4]["reward_terms"] for drive in DRIVES]
    return [info["sent"] / 0.02 for info in infos], [info["truth"] / 0.02 for info in infos]


TIMED = "reward: {sent: cart.rate * s / m, truth: velocity(cart.cart).x * s / m}"


# Timing


def test_immediate_timing_acts_at_once_and_sends_what_is_so_afterwards(small: Make) -> None:
    sent, truth = rates(small(TIMED))
    assert truth == pytest.approx(DRIVES, abs=NEARLY)
    assert sent == pytest.approx(DRIVES, abs=NEARLY)


def test_paper_timing_acts_one_step_late_and_what_the_robot_sends_is_one_step_old(small: Make) -> None:
    sent, truth = rates(small(TIMED, "messages.timing=delayed"))
    assert truth == pytest.approx([0.0, *DRIVES[:4]], abs=NEARLY)
    assert sent == pytest.approx([0.0, 0.0, *DRIVES[:3]], abs=NEARLY)


def test_paper_timing_does_not_grow_later_with_each_episode(small: Make) -> None:
    environment = small(TIMED, "messages.timing=delayed")
    assert [rates(environment) for _ in range(3)] == [rates(environment)] * 3


# Endings and limits


def test_time_limits_count_whole_steps(small: Make) -> None:
    environment = small("reward: {a: 1}", "truncation={max_time: 0.3 s}")
    environment.reset(seed=0)
    steps = 1
    while not environment.step(np.zeros(1))[3]:
        steps += 1
    assert steps == 15


def test_failure_beats_success_and_all_endings_are_listed(small: Make) -> None:
    environment = small(
        "reward: {a: 1}\ntermination: {success: {far: drive > 0.5}, failure: {fast: drive > 0.4, slow: drive"
        " < 0}}"
    )
    environment.reset(seed=0)
    _, _, terminated, truncated, info = environment.step(np.array([0.75]))
    assert terminated is True
    assert truncated is False
    assert info["is_success"] is False
    assert info["ended_by"] == "fast"
    assert info["endings"] == ("fast", "far")


def test_termination_beats_a_limit_in_the_same_step(small: Make) -> None:
    environment = small(
        "reward: {a: 1}\ntermination: {success: {far: drive > 0.5}}", "truncation.max_steps=1"
    )
    environment.reset(seed=0)
    assert environment.step(np.array([1.0]))[2:4] == (True, False)
    environment.reset(seed=0)
    assert environment.step(np.array([0.0]))[2:4] == (False, True)


def test_an_ending_that_is_true_at_the_start_is_an_error_and_leaves_nothing_to_step(small: Make) -> None:
    environment = small("reward: {a: 1}\ntermination: {failure: {still: abs(position(cart.pole).x) < 1 mm}}")
    with pytest.raises(EvaluationError, match="'still' is already true at reset"):
        environment.reset(seed=0)
    with pytest.raises(UsageError, match="reset"):
        environment.step(np.zeros(1))


# What has no value


@pytest.mark.parametrize(
    ("term", "line"),
    [
        ("1 / (step - 3)", "1.0 / (step_count - 3.0)"),
        ("sqrt(2.5 - step)", "sqrt(2.5 - step_count)"),
        ("exp(1000 * step) if step == 3 else 0", "exp(1000.0 * step_count)"),
        ("log(3 - step)", "log(3.0 - step_count)"),
    ],
)
def test_an_expression_without_a_value_names_its_line_and_the_step(small: Make, term: str, line: str) -> None:
    environment = small(f'reward: {{bad: "{term}"}}')
    environment.reset(seed=0)
    for _ in range(2):
        environment.step(np.zeros(1))
    with pytest.raises(EvaluationError) as caught:
        environment.step(np.zeros(1))
    assert "step 3" in str(caught.value)
    assert line in str(caught.value)
    assert "`bad = " in str(caught.value)
    environment.reset(seed=0)
    environment.step(np.zeros(1))


def test_a_reward_that_overflows_names_its_term(small: Make) -> None:
    environment = small('reward: {fine: 1, large: "1e200 * (step * 1e150)"}')
    environment.reset(seed=0)
    with pytest.raises(EvaluationError, match="'large' is not finite"):
        environment.step(np.zeros(1))


def test_the_traceback_of_such_an_error_shows_generated_lines(small: Make) -> None:
    environment = small('reward: {bad: "1 / (step - 1)"}')
    environment.reset(seed=0)
    with pytest.raises(EvaluationError) as caught:
        environment.step(np.zeros(1))
    text = "".join(traceback.format_exception(caught.value))
    assert "self.term_bad = 1.0 / (self.step_count - 1.0)" in text
    assert "<deepbots Small " in text


@pytest.mark.parametrize("format", ["struct", "json", "csv", "msgpack", "none"])
@pytest.mark.parametrize("engine", ["exact", "pybullet"])
def test_a_world_that_blew_up_is_the_engines_failure(make: Make, format: str, engine: str) -> None:
    environment = make(RAIL, f"messages.format={format}", engine=engine)
    environment.reset(seed=0)
    environment.step(0)
    environment.engine.set_joint("cart", "hinge", math.nan, 0.0)
    with pytest.raises(EngineError, match="cart"):
        environment.step(0)


# Messages that do not fit


@pytest.mark.parametrize("message", [b"", b"garbage", "text", None, b"\0" * 12, b"\0" * 500])
def test_a_foreign_message_on_the_way_is_refused_by_the_robot(make: Make, message: Any) -> None:
    environment = make(RAIL, engine="exact")
    environment.reset(seed=0)
    environment.step(0)
    environment.to_cart.transmit(message)
    with pytest.raises(MessageError, match=r"robot 'cart', to the robot, step 2"):
        environment.step(0)


def test_a_foreign_message_from_a_robot_is_refused_by_the_supervisor(make: Make) -> None:
    environment = make(RAIL, engine="exact")
    environment.reset(seed=0)
    environment.from_cart.transmit(environment.to_cart.wire.encode((1.0,)))
    with pytest.raises(
        MessageError, match=r"robot 'cart', from the robot, step 1: the message has another layout"
    ):
        environment.step(0)


def test_every_failure_of_a_step_is_one_line_and_within_our_tree(make: Make) -> None:
    environment = make(RAIL, engine="exact")
    for use in (
        lambda: environment.step(0),
        lambda: environment.step("x"),
        lambda: environment.step(np.zeros((40, 40))),
    ):
        with pytest.raises(DeepbotsError) as caught:
            use()
        assert "\n" not in str(caught.value)
        environment.reset(seed=0)


# The code


def test_the_code_that_the_compiler_prints_is_the_code_that_runs(make: Make) -> None:
    environment = make(RAIL, engine="exact")
    code = api.compile(RAIL).code
    filename = inspect.getfile(type(environment)._advance)
    assert "".join(linecache.getlines(filename)) == code
    assert inspect.getsource(type(environment)._advance) in code
    assert inspect.getsource(type(environment.robot_cart).create_message) in code


def test_the_printed_module_has_the_papers_classes_and_imports_nothing_odd() -> None:
    tree = ast.parse(api.compile("cartpole").code)
    classes = {
        node.name: {item.name for item in node.body if isinstance(item, ast.FunctionDef)}
        for node in tree.body
        if isinstance(node, ast.ClassDef)
    }
    assert {"create_message", "use_message_data"} <= classes["CartController"]
    assert {"get_observations", "get_reward", "is_done", "get_info", "reset"} <= set(dir(Supervisor))
    assert "CartPoleSupervisor" in classes
    modules = {node.module for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)}
    assert modules <= {"__future__", "math", "struct", "typing", "deepbots_cli.runtime"}
    assert not [node for node in ast.walk(tree) if isinstance(node, ast.Import)]


# Physics, end to end


def test_two_engines_agree_on_the_rail(make: Make) -> None:
    """0.8 s of a falling pole on a cart that is pushed back and forth: PyBullet at 1.25 ms steps is within
    3e-3 of the exact motion.

    Figures are parts of the observation's ranges; the error is of first order in the step.
    """
    worst = {}
    for substeps in (4, 16):
        exact, pybullet = (
            make(RAIL, f"world.substeps={substeps}", engine=engine) for engine in ("exact", "pybullet")
        )
        exact.reset(seed=2)
        pybullet.reset(seed=2)
        difference = 0.0
        for tick in range(40):
            action = tick // 3 % 2
            ours, theirs = exact.step(action)[0], pybullet.step(action)[0]
            difference = max(difference, float(np.abs(ours - theirs).max()))
        worst[substeps] = difference
    assert worst[16] < 3e-3
    assert worst[4] == pytest.approx(4 * worst[16], rel=0.1)


@pytest.mark.parametrize("action", [["0.5"], [True], [b"0.5"]])
def test_an_action_of_text_or_truth_values_fits_no_interval(small: Make, action: list[object]) -> None:
    environment = small(TIMED)
    environment.reset(seed=0)
    with pytest.raises(UsageError, match="does not fit"):
        environment.step(action)
