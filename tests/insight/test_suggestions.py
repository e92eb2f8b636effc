"""The changes of a scenario that a phrase asks for."""

from __future__ import annotations

import pytest

from deepbots_cli import api
from deepbots_cli.insight.suggestions import Suggestion, suggestions

_SCALE = "robots.cart.links.pole.scale"
_MASS = "robots.cart.links.pole.mass"


def _suggestions(phrase: str, *overrides: str) -> list[Suggestion]:
    return suggestions(api.load("cartpole", overrides=overrides), phrase)


def _override(path: str, value: str) -> str:
    section, _, key = path.partition(".links.pole.")
    return f"{section}.links={{pole: {{{key}: {value}}}}}" if key else f"{path}={value}"


@pytest.mark.parametrize(
    ("phrase", "path", "value"),
    [
        ("make the pole longer", _SCALE, "1 1 1.5"),
        ("make the pole 2 times as long", _SCALE, "1 1 2"),
        ("pole 0.75x", _SCALE, "1 1 0.75"),
        ("half the pole", _SCALE, "1 1 0.5"),
        ("a pole that is half as heavy", _MASS, "urdf * 0.5"),
        ("make the pole 2 times lighter", _MASS, "urdf * 0.5"),
        ("a pole 4x shorter", _SCALE, "1 1 0.25"),
        ("a smaller and shorter pole", _SCALE, "1 1 0.666667"),
        ("make the pole heavier", _MASS, "urdf * 1.5"),
        ("make the cart faster", "parameters.wheel_speed", "7.5 rad/s"),
        ("go twice as fast", "parameters.wheel_speed", "10 rad/s"),
        ("a larger fall angle", "parameters.fall_angle", "22.5 deg"),
        ("make the pole 2 m long", _SCALE, "1 1 2"),
        ("pole length 150 cm", _SCALE, "1 1 1.5"),
        ("a pole of 0.5 kg", _MASS, "0.5 kg"),
        ("how do I make the training longer", "train.total_timesteps", "150_000"),
        ("make the training half as long, shorter", "train.total_timesteps", "50_000"),
    ],
)
def test_a_phrase_names_a_part_or_a_parameter_and_how_much_it_changes(phrase, path, value):
    (suggestion,) = _suggestions(phrase)
    assert (suggestion.path, suggestion.value) == (path, value)
    assert not api.load("cartpole", overrides=[_override(path, value)]).findings.errors


def test_the_same_phrase_once_more_changes_what_is_written():
    (suggestion,) = _suggestions("make the pole longer", _override(_SCALE, "1 1 1.5"))
    assert suggestion.value == "1 1 2.25"
    assert "The file has `scale: 1 1 1.5`." in suggestion.text
    (suggestion,) = _suggestions("make the pole 2 m long", _override(_SCALE, "1 1 1.5"))
    assert suggestion.value == "1 1 2"
    (suggestion,) = _suggestions("make the pole shorter", _override(_SCALE, "1 1 1.5"))
    assert suggestion.value == "1 1 1"


@pytest.mark.parametrize("phrase", ["why does the pole fall", "reset the pole", "pole"])
def test_a_phrase_without_a_clear_change_has_what_it_is_about(phrase):
    (suggestion,) = _suggestions(phrase)
    assert suggestion.text.startswith("`pole` is a link")
    assert suggestion.value == ""


@pytest.mark.parametrize("phrase", ["fall_angle", "what is a policy", "how does it learn faster", ""])
def test_a_phrase_that_asks_for_no_change_of_the_world_has_no_suggestion(phrase):
    assert _suggestions(phrase) == []


def test_a_link_says_what_it_is():
    (suggestion,) = _suggestions("pole")
    assert suggestion.text.startswith("`pole` is a link of the robot `cart`: box 0.02 0.02 1 m, 0.2 kg")


@pytest.mark.parametrize(
    ("written", "value"),
    [
        ("-1e-3 m", "-0.0015 m"),
        ("2 m/s^2", "3 m/s^2"),
        ("50 %", "75 %"),
    ],
)
def test_a_value_of_one_number_keeps_its_sign_and_unit(written, value):
    (suggestion,) = _suggestions("a larger extra", f"parameters={{extra: {written}}}")
    assert suggestion.value == value


@pytest.mark.parametrize("written", ["1 1 stretch", "1 1 uniform(1 .. 2)"])
def test_a_size_that_is_drawn_or_a_formula_stays(written):
    (suggestion,) = _suggestions("make the pole longer", _override(_SCALE, written))
    assert suggestion.value == written


def test_a_drawn_parameter_is_left_alone():
    assert _suggestions("a larger track", "parameters.track=uniform(0.3 .. 0.4 m)") == []
