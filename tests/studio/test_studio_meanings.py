"""What the studio says about the word at the cursor."""

from __future__ import annotations

import asyncio
from pathlib import Path

import pytest

pytest.importorskip("nicegui")
from deepbots_cli.studio.explain import explanation
from deepbots_cli.studio.meanings import Meaning
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


@pytest.mark.parametrize("phrase", ["pole length", "pole_angle"])
def test_a_phrase_finds_names_of_the_text(tmp_path, phrase):
    (tmp_path / "mine.yaml").write_text(SCENARIO, encoding="utf-8")

    async def run() -> list[tuple[str, int]]:
        async with Running(tmp_path) as running:
            file = running.session.open(Path("mine.yaml"))
            return running.session.language.names_like(file, phrase)

    assert asyncio.run(run())[0] == ("pole_angle", 9)


def test_a_phrase_without_an_entry_gets_the_nearest_one():
    assert "**size and mass of a robot**" in explanation("make the pole longer")


@pytest.mark.parametrize(
    ("phrase", "entry"), [("what is a policy", "policy"), ("my learning rate is too high", "learning rate")]
)
def test_the_nearest_entry_has_the_words_of_the_phrase_as_its_name(phrase, entry):
    assert f"**{entry}**" in explanation(phrase)
