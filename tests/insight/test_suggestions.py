"""The changes of a scenario that a phrase asks for."""

from __future__ import annotations

from dataclasses import astuple

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from deepbots_cli import api
from deepbots_cli.insight.suggestions import Suggestion, _link_text, suggestions

_SCALE = "robots.cart.links.pole.scale"
_MASS = "robots.cart.links.pole.mass"


def _suggestions(phrase: str, *overrides: str) -> list[Suggestion]:
    return suggestions(api.load("cartpole", overrides=overrides), phrase)


def _override(path: str, value: str) -> str:
    section, _, place = path.partition(".links.")
    link, _, key = place.partition(".")
    return f"{section}.links={{{link}: {{{key}: {value}}}}}" if key else f"{path}={value}"


PARTS = {
    "make the pole longer": (_SCALE, "1 1 1.5"),
    "make the pole 2 times as long": (_SCALE, "1 1 2"),
    "pole 0.75x": (_SCALE, "1 1 0.75"),
    "half the pole": (_SCALE, "1 1 0.5"),
    "a pole that is half as heavy": (_MASS, "urdf * 0.5"),
    "make the pole 2 times lighter": (_MASS, "urdf * 0.5"),
    "a pole 4x shorter": (_SCALE, "1 1 0.25"),
    "a smaller and shorter pole": (_SCALE, "1 1 0.666667"),
    "make the pole heavier": (_MASS, "urdf * 1.5"),
    "make the cart faster": ("parameters.wheel_speed", "7.5 rad/s"),
    "go twice as fast": ("parameters.wheel_speed", "10 rad/s"),
    "a larger fall angle": ("parameters.fall_angle", "22.5 deg"),
    "make the pole 2 m long": (_SCALE, "1 1 2"),
    "pole length 150 cm": (_SCALE, "1 1 1.5"),
    "a pole of 0.5 kg": (_MASS, "0.5 kg"),
    "how do I make the training longer": ("train.total_timesteps", "150_000"),
    "make the training half as long, shorter": ("train.total_timesteps", "50_000"),
    "make the training 3 times shorter": ("train.total_timesteps", "33_333"),
    "train for half as long": ("train.total_timesteps", "50_000"),
    "make the episodes longer": ("truncation.max_steps", "300"),
    "give it twice as much time": ("truncation.max_steps", "400"),
    "make the pole 1,000 g": (_MASS, "1 kg"),
    "make the wheels twice as slow": ("parameters.wheel_speed", "2.5 rad/s"),
    "make the wheels half as slow": ("parameters.wheel_speed", "10 rad/s"),
    "slow the wheels down by half": ("parameters.wheel_speed", "2.5 rad/s"),
    "slow down the wheels to half the speed": ("parameters.wheel_speed", "2.5 rad/s"),
    "reduce the mass of the pole to only 30 %": (_MASS, "urdf * 0.3"),
    "reduce the mass of the pole to  about 30%": (_MASS, "urdf * 0.3"),
}
WRITTEN = [
    ("make the pole longer", _SCALE, "1 1 1.5", "1 1 2.25"),
    ("make the pole 2 m long", _SCALE, "1 1 1.5", "1 1 2"),
    ("make the pole shorter", _SCALE, "1 1 1.5", "1 1 1"),
    ("make the pole longer", _SCALE, "1 1 stretch", "1 1 stretch"),
    ("make the pole longer", _SCALE, "1 1 uniform(1 .. 2)", "1 1 uniform(1 .. 2)"),
    ("a larger extra", "parameters.extra", "-1e-3 m", "-0.0015 m"),
    ("a larger extra", "parameters.extra", "2 m/s^2", "3 m/s^2"),
    ("a larger extra", "parameters.extra", "50 %", "75 %"),
    ("reduce extra to 80 %", "parameters.extra", "10 m", "8 m"),
    ("reduce extra by 80 %", "parameters.extra", "10 m", "2 m"),
    ("a larger extra", "parameters.extra", "1_000 ms", "1_500 ms"),
    ("a larger extra", "parameters.extra", "0.000_5 m", "0.00075 m"),
]
"""Phrases about a written value: a drawn one and a formula stay."""
UNCLEAR = """
why does the pole fall
reset the pole
pole
make the pole 20 cm longer
make the pole 100 g heavier
make the pole 0,5 kg
add 500 g to the pole
remove 100 g from the pole
add 20 cm to the length of the pole
reduce the length of the pole to 120 %
increase the mass of the pole to 50 %
make the pole 0.5 longer
make the pole a third longer
make the pole 2 and a half times longer
make the pole twenty percent longer
a pole eleven times heavier
make the pole 2 m wide
make the pole longer and heavier
make the pole lighter and the cart faster
more friction of the pole
make the pole hinge 2 times stiffer
the pole no longer falls
"""
NO_CHANGE = (
    "fall_angle",
    "what is a policy",
    "how does it learn faster",
    "",
    "a larger drawn",
    "a higher learning rate",
)


@pytest.mark.parametrize("phrase", PARTS)
def test_a_phrase_names_a_part_or_a_parameter_and_how_much_it_changes(phrase: str) -> None:
    (suggestion,) = _suggestions(phrase)
    assert (suggestion.path, suggestion.value) == PARTS[phrase]
    assert not api.load("cartpole", overrides=[_override(*PARTS[phrase])]).findings.errors


@pytest.mark.parametrize(("phrase", "path", "written", "value"), WRITTEN)
def test_a_phrase_changes_the_written_value(phrase: str, path: str, written: str, value: str) -> None:
    override = _override(path, written) if path == _SCALE else f"parameters={{extra: {written}}}"
    (suggestion,) = _suggestions(phrase, override)
    assert suggestion.value == value
    assert path != _SCALE or f"The file has `scale: {written}`." in suggestion.text


@pytest.mark.parametrize("phrase", [*UNCLEAR.strip().splitlines(), *NO_CHANGE])
def test_a_phrase_without_a_clear_change_has_what_it_is_about(phrase: str) -> None:
    named = _suggestions(phrase, "parameters.drawn=uniform(0.3 .. 0.4 m)")
    assert {suggestion.value for suggestion in named} == (set() if phrase in NO_CHANGE else {""})
    about = "`pole` is a link of the robot `cart`: box 0.02 0.02 1 m, 0.2 kg"
    assert all(suggestion.text.startswith(about) for suggestion in named[:1])


def _mass_and_sizes(checked, name):
    link = next(iter(checked.robots.values())).model.link(name)
    return np.hstack([link.inertial.mass, *astuple(link.visuals[0].shape)])


@settings(max_examples=40)
@given(
    st.sampled_from([("cartpole", "body"), ("quadruped", "FR_toe"), ("balancer", "left_wheel")]),
    st.sampled_from(
        [
            ("longer", "long", "shorter", "short", (1, 1)),
            ("heavier", "heavy", "lighter", "light", (1, 0)),
            ("bigger", "big", "smaller", "small", (3, 1)),
        ]
    ),
    st.sampled_from([("", 1.5), ("2 times ", 2), ("three times ", 3), ("twice as ", 2), ("half as ", 0.5)]),
    st.booleans(),
)
def test_a_value_that_is_offered_compiles_with_the_direction_and_amount_of_the_phrase(
    part, words, amount, grows
):
    word = words[2 * (not grows) + amount[0].endswith("as ")]
    before = api.load(part[0])
    for suggestion in suggestions(before, f"make the {part[1]} {amount[0]}{word}"):
        if suggestion.value:
            after = api.load(part[0], overrides=[_override(suggestion.path, suggestion.value)])
            old, new = (_mass_and_sizes(checked, part[1]) for checked in (before, after))
            ratios = (new / old)[[0, 1 + np.argmax(old[1:])]]  # of the mass, and of the longest side
            expected = (amount[1] if grows else 1 / amount[1]) ** np.array(words[4], float)
            assert not after.findings.errors
            assert ratios == pytest.approx(expected, rel=1e-4)


@pytest.mark.parametrize(
    ("phrase", "override", "paths"),
    [
        ("make a pole longer", "parameters={a: 2 m, _: 1 m}", [_SCALE]),  # an article is no name
        ("a bigger goal", "termination.success={up: lean < fall_angle}", ["parameters.fall_angle"]),
        ("go faster", "parameters.wheel_speed=1 rad/s if 1 > 2 else 2 rad/s", []),
    ],
)
def test_articles_are_no_names_and_formulas_are_not_multiplied(
    phrase: str, override: str, paths: list[str]
) -> None:
    assert [suggestion.path for suggestion in _suggestions(phrase, override)] == paths


def test_the_file_of_a_mesh_has_no_unit() -> None:
    assert "`arm`: mesh hand.stl, 2 kg." in _link_text(
        "arm",
        {"link": "hand", "joint": "", "mass_kg": 2.0, "seen_as": ["mesh hand.stl"], "collides_as": []},
        "",
    )
