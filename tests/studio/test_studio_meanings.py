"""What the studio says about the word at the cursor."""

from __future__ import annotations

import asyncio
from pathlib import Path

import pytest

pytest.importorskip("nicegui")
from deepbots_cli.studio.explain import explanation
from deepbots_cli.studio.meanings import Meaning, RobotPart
from tests.studio.test_studio_page import SCENARIO
from tests.studio.test_studio_session import Running

LINES = SCENARIO.split("\n")


def _meaning(folder: Path, line_begins: str, word: str) -> Meaning:
    """Return the meaning of a word in the first line that begins so."""
    line = next(number for number, text in enumerate(LINES) if text.startswith(line_begins))
    (folder / "mine.yaml").write_text(SCENARIO, encoding="utf-8")

    async def run() -> Meaning:
        async with Running(folder) as running:
            file = running.session.open(Path("mine.yaml"))
            await running.checked(file.path)
            column = LINES[line].index(word) + 1
            return running.session.language.meaning(file.path, file.text, line, column, word)

    return asyncio.run(run())


def test_a_parameter_says_where_it_is_used_and_a_use_where_it_is_defined(tmp_path):
    at_its_definition = _meaning(tmp_path, "  fall_angle:", "fall_angle")
    assert "a parameter, an angle" in at_its_definition.text
    assert at_its_definition.definitions == ()
    assert at_its_definition.uses == ("[line 22](#line:22): `fallen: abs(cart.pole_angle) > fall_angle`",)
    at_its_use = _meaning(tmp_path, "    fallen:", "fall_angle")
    assert at_its_use.definitions == ("[line 4](#line:4)",)
    assert at_its_use.uses == ()


def test_a_sensor_and_a_key_of_the_language(tmp_path):
    sensor = _meaning(tmp_path, "    fallen:", "pole_angle")
    assert "an angle" in sensor.text
    assert sensor.definitions == ("[line 10](#line:10)",)
    key = _meaning(tmp_path, "truncation:", "max_steps")
    assert key.text
    assert not key.uses


def test_a_phrase_finds_names_of_the_text(tmp_path):
    (tmp_path / "mine.yaml").write_text(SCENARIO, encoding="utf-8")

    async def run() -> list[tuple[str, int]]:
        async with Running(tmp_path) as running:
            file = running.session.open(Path("mine.yaml"))
            return running.session.language.names_like(file, "pole length")

    assert ("pole_angle", 9) in asyncio.run(run())


@pytest.mark.parametrize(
    ("phrase", "change"),
    [
        ("make the pole longer", "scale: 1 1 1.5"),
        ("make the pole 2 times as long", "scale: 1 1 2"),
        ("pole 0.75x", "scale: 1 1 0.75"),
        ("half the pole", "scale: 1 1 0.5"),
        ("make the pole heavier", "mass: urdf * 1.5"),
    ],
)
def test_a_phrase_names_parts_of_the_robot_and_how_they_are_changed(tmp_path, phrase, change):
    (tmp_path / "mine.yaml").write_text(SCENARIO, encoding="utf-8")

    async def run() -> tuple[list[RobotPart], str]:
        async with Running(tmp_path) as running:
            file = running.session.open(Path("mine.yaml"))
            await running.checked(file.path)
            parts = running.session.language.parts_like(file.path, phrase)
            running.session.show(file.path)
            running.session.write_values({part.path: part.value for part in parts})
            return parts, file.text

    (part,), text = asyncio.run(run())
    assert part.text.startswith("`pole` is a link of the robot `cart`: box 0.02 0.02 1 m, 0.2 kg")
    assert f"links: {{pole: {{{change}}}}}" in text


def test_a_phrase_without_an_entry_gets_the_nearest_one():
    assert "**size and mass of a robot**" in explanation("make the pole longer")


@pytest.mark.parametrize(
    ("phrase", "entry"), [("what is a policy", "policy"), ("my learning rate is too high", "learning rate")]
)
def test_the_nearest_entry_has_the_words_of_the_phrase_as_its_name(phrase, entry):
    assert f"**{entry}**" in explanation(phrase)
