"""Explanations of an episode against the values that it recorded."""

from __future__ import annotations

import operator
import re
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, assume, example, given, settings
from hypothesis import strategies as st

from deepbots_cli import api
from deepbots_cli.insight.episode import explain, explanation_json
from deepbots_cli.insight.trace import Trace, TraceRecorder, instrument_program
from deepbots_cli.rollout import play
from deepbots_cli.rollout.drivers import constant_driver
from tests.worlds import CART

SIGNS = {"<": operator.lt, "<=": operator.le, ">": operator.gt, ">=": operator.ge}
STEPS = 24


def played(folder: Path, sections: str) -> Trace:
    """Play the cart on a rail: 12 steps forward, then backward, 2 cm each."""
    text = CART.replace("drive * 0.02 m/s", "drive * 1 m/s")
    (folder / "cart.yaml").write_text(f"{text}reward: {{alive: 1}}\n{sections}", encoding="utf-8")
    watch = instrument_program(api.compile(folder / "cart.yaml").program, include_observation=True)
    with closing(TraceRecorder(api.build(watch.program, engine="exact"), watch)) as world:
        world.reset(seed=0)
        for step in range(STEPS):
            action = np.array([1.0 if step < STEPS / 2 else -1.0], np.float32)
            if any(world.step(action)[2:4]):
                break
        return world.trace("the episode")


def texts(trace: Trace) -> dict[str, str]:
    return {statement.cause: statement.text for statement in explain(trace)}


@st.composite
def written_comparisons(draw: st.DrawFn) -> tuple[str, str, float]:
    """Draw the text of a comparison of the place with a number, and what it means: a sign and a bound in m."""
    sign = draw(st.sampled_from(sorted(SIGNS)))
    # Odd millimeters, between the places of the cart.
    bound = draw(st.integers(-20, 140).map(lambda number: (2 * number + 1) / 1000))
    mirrored = sign.translate(str.maketrans("<>", "><"))
    text = f"cart.place {sign} {bound} m"
    if draw(st.booleans()):
        text = f"{bound} m {mirrored} cart.place"
    if draw(st.booleans()):
        text, sign = f"not {text}", {"<": ">=", "<=": ">", ">": "<=", ">=": "<"}[sign]
    return text, sign, bound


def meaning(text: str) -> tuple[str, float]:
    """Return the sign and the bound (m) of a printed comparison of the place."""
    if written := re.fullmatch(r"cart\.place (\S+) (\S+) m", text):
        return written[1], float(written[2])
    written = re.fullmatch(r"(\S+) m (\S+) cart\.place", text)
    assert written is not None, text
    return written[2].translate(str.maketrans("<>", "><")), float(written[1])


@given(written_comparisons(), written_comparisons())
@example(("0.101 m < cart.place", ">", 0.101), ("not cart.place > 0.101 m", "<=", 0.101))
@settings(
    max_examples=40,
    deadline=None,
    derandomize=True,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)
def test_an_explanation_agrees_with_the_recorded_places_however_a_comparison_is_written(
    tmp_path: Path, failure: tuple[str, str, float], missed: tuple[str, str, float]
) -> None:
    assume(not SIGNS[failure[1]](0.0, failure[2]))  # at the reset
    trace = played(
        tmp_path,
        f"termination:\n  failure: {{over: {failure[0]}}}\n"
        f"  success: {{done: '{missed[0]} and cart.place > 9 m'}}\n",
    )
    places = trace.observations[:, 0] * 2.4

    def is_true(comparison: tuple[str, float], place: float) -> bool:
        sign, bound = comparison
        return SIGNS[sign](place, bound)

    data = explanation_json(trace, explain(trace))
    if trace.ended_by == "over":
        end = data["end"]
        assert is_true(failure[1:], places[-1])
        assert (end["operator"], end["bound"], end["value"]) == (
            failure[1],
            pytest.approx(failure[2]),
            pytest.approx(places[-1], abs=1e-6),
        )
        assert end["margin"] == pytest.approx(abs(places[-1] - failure[2]), abs=1e-6)
        assert meaning(end["condition"]) == failure[1:]
    else:
        assert not any(is_true(failure[1:], place) for place in places[1:])
    sentence = texts(trace)["conditions"]
    printed = re.search(r"'done', `(.+?)` was true in (\d+) of (\d+) moments", sentence)
    assert printed is not None
    assert meaning(printed[1]) == missed[1:]
    count = sum(is_true(missed[1:], place) for place in places)
    assert (int(printed[2]), int(printed[3])) == (count, len(places))


def test_a_negated_condition_without_a_number_is_printed_with_its_not(tmp_path: Path) -> None:
    trace = played(
        tmp_path,
        "signals:\n  far: cart.place < 5 cm\ntermination:\n  failure:\n    stuck: not (far != (cart.place > 1 m))\n",
    )
    assert trace.end is not None
    assert trace.end.condition.text == "not (far != (cart.place > 1 m))"
    assert texts(trace)["truth_ending"].startswith("`not (far != (cart.place > 1 m))` became true in step 6.")


@pytest.mark.parametrize(
    ("comparison", "shown"),
    [
        ("cart.place - 0.6 m > -0.5 m", "the threshold of -0.5 m."),
        ("cart.place > .05 m", "the threshold of 0.05 m."),
        ("cart.place > edge", "the threshold of 0.05 m (edge)."),
        ("cart.place - 11 cm > -edge", "the threshold of -5 cm (-edge)."),
        ("cart.place > 1 cm + edge", "the threshold of 6 cm (1 cm + edge)."),
    ],
)
def test_a_threshold_that_is_a_number_is_printed_once(tmp_path: Path, comparison: str, shown: str) -> None:
    sections = f"parameters: {{edge: 0.05 m}}\ntermination: {{failure: {{over: {comparison}}}}}\n"
    assert texts(played(tmp_path, sections))["margin"].endswith(shown)


def test_an_explanation_of_one_step_begins_its_sentences_with_capitals(tmp_path: Path) -> None:
    sentences = texts(played(tmp_path, "termination: {failure: {over: cart.place > 1 mm}}\n"))
    assert "ended it after 1 step, at 0.02 s" in sentences["ending"]
    assert sentences["margin"].startswith("At the end, cart.place was ")


def test_an_explanation_of_agents_that_compete_names_the_one_that_won() -> None:
    watch = instrument_program(
        api.compile(api.load("tag", overrides=["endings.escaped.when=time >= 0.3 s"])).program
    )
    with closing(TraceRecorder(api.build(watch.program), watch)) as world:
        play(world, constant_driver(np.zeros(world.action_space.shape, np.float32)))
        trace = world.trace("the episode")
    assert texts(trace)["ending"] == (
        "The episode was a success of prey: 'escaped' ended it after 3 steps, at 0.38 s."
    )
    assert explanation_json(trace, explain(trace))["succeeded"] == ["prey"]
