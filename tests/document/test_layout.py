"""A line whose key lacks its colon has the finding itself, and a fix.

A missing comma, `=` in place of a colon, and a wrong indentation each have a finding with a fix.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

import pytest

from deepbots_cli.cli.starters.draft import Template, from_template
from deepbots_cli.compiler import check
from deepbots_cli.diagnostics import Finding, edited
from deepbots_cli.document import load
from deepbots_cli.lsp.workspace import Document, analyze, uri_of

SCENARIO = """deepbots: 1
name: Mine
parameters:
  fall_angle: 15 deg  # the largest lean
world: {timestep: 32 ms, substeps: 4}
robots:
  cart:
    urdf: cartpole
    sensors:
      pole_angle: {type: joint_position, joint: pole_hinge}
    actuators:
      wheels:
        type: velocity_motor
        joints: [wheel_*]
        max_torque: 10 N*m
    apply: {wheels: drive * 5 rad/s}
action:
  drive: {choices: {forward: 1, backward: -1}}
observation:
  cart.pole_angle: -20 .. 20 deg
reward:
  alive: 1
termination:
  failure:
    fallen: abs(cart.pole_angle) > fall_angle
truncation: {max_steps: 100}
train:
  algorithm: PPO
  total_timesteps: 4096
"""
KEYS = [number for number, line in enumerate(SCENARIO.splitlines()) if number and ":" in line]


def findings_of(text: str) -> tuple[Finding, ...]:
    path = Path("mine.yaml").absolute()
    return tuple(check(load(path, drafts={path: text.encode()})).document.findings)


TEXT = SCENARIO.replace(
    "  alive: 1\n",
    "  alive: 1\n  lean: -abs(cart.pole_angle) / rad\n  still: 0.1 when abs(cart.pole_angle) < 1 deg\n",
)
BLOCK = TEXT.replace(
    "world: {timestep: 32 ms, substeps: 4}\n", "\nworld:\n  timestep: 32 ms    # of a step\n  substeps: 4\n"
)
GROUND = TEXT.replace("world: {", "world: {ground: {color: red}, ")
COMMAS = TEXT.replace("-1}}\n", "-1}, extra: 3}\n").replace("ms, substeps", "ms,\n  substeps")


def _corrected(text: str) -> str:
    """The text after the fix of its only finding with one."""
    (finding,) = (each for each in findings_of(text) if each.fix is not None)
    assert finding.fix is not None
    return edited(finding.fix.edits[0].span.source, finding.fix.edits)


@pytest.mark.parametrize("number", KEYS, ids=lambda number: SCENARIO.splitlines()[number].strip())
def test_a_key_without_its_colon_is_found_in_its_line_and_corrected(number: int) -> None:
    lines = SCENARIO.splitlines(keepends=True)
    lines[number] = lines[number].replace(":", "", 1)
    text = "".join(lines)
    (finding,) = (each for each in findings_of(text) if each.code in ("DB001", "DB103"))
    assert finding.span.start_position.line == number + 1
    assert "write a colon after the key" in (finding.help or "")
    assert _corrected(text) == SCENARIO


@pytest.mark.parametrize(
    "wrong",
    [
        # A comma or a brace is missing.
        "world: {timestep: 32 ms substeps: 4}",
        "world: {timestep: 32 ms, substeps: 4",
        "      pole_angle: {type: joint_position joint: pole_hinge}",
        "  drive: {choices: {forward: 1 backward: -1}}",
        # A comma or a brace too many.
        "world: {timestep: 32 ms, substeps: 4},",
        "world: {timestep: 32 ms, substeps: 4}}",
        # A colon is missing in braces.
        "world: {timestep 32 ms, substeps: 4}",
        # No space behind the colon of the first key of a section.
        "  fall_angle:15 deg  # the largest lean",
        "  alive:1",
        # Non-breaking spaces of a copied text.
        "\u00a0\u00a0alive: 1",
        "world: {timestep:\u00a032 ms, substeps: 4}",
        # `=` in place of a colon.
        "name = Mine",
        "  fall_angle=15 deg  # the largest lean",
        "reward=",
        "  alive= 1",
        "  lean = -abs(cart.pole_angle) / rad",
        "  still=0.1 when abs(cart.pole_angle) < 1 deg",
        "    fallen= abs(cart.pole_angle) > fall_angle",
        "world: {timestep= 32 ms, substeps: 4}",
        "world: {timestep: 32 ms, substeps=4}",
        # A line that does not align.
        "\talive: 1",
        " lean: -abs(cart.pole_angle) / rad",
        "   lean: -abs(cart.pole_angle) / rad",
        "lean: -abs(cart.pole_angle) / rad",
        "   sensors:",
        "     sensors:",
        "     urdf: cartpole",
        "       joints: [wheel_*]",
        "         joints: [wheel_*]",
        " observation:",
        " total_timesteps: 4096",
    ],
)
def test_a_line_with_a_mistake_is_corrected(wrong: str) -> None:
    (right,) = (line for line in TEXT.splitlines() if _letters(line) == _letters(wrong))
    assert _corrected(TEXT.replace(f"\n{right}\n", f"\n{wrong}\n")) == TEXT


def _letters(line: str) -> str:
    return re.sub(r"[\s:=,}]", "", line)


@pytest.mark.parametrize(
    ("text", "right", "wrong", "headline"),
    [
        (COMMAS, "-1}, extra", "-1} extra", "a comma is missing before this key"),
        (COMMAS, "ms,\n", "ms\n", "a comma is missing before this key"),
        (TEXT, "ms, sub", "ms; sub", "a comma is missing before this key"),
        (BLOCK, "\nworld:\n", "\nworld: +\n", "`world` has a value, and a block below it"),
        (
            BLOCK,
            "  timestep: 32",
            "timestep: 32",
            "`timestep` is not indented below `world`, but the next line is",
        ),
        (GROUND, "{color: red}", "color red", "expected a mapping, found the text `color red`"),
        (GROUND, "{color: red}", "color:red", "expected a mapping, found the text `color:red`"),
        (BLOCK, "\n  ", "\n\u00a0 ", "non-breaking spaces in the indentation"),
        (TEXT, "-20 .. 20 deg", "20 .. -20 deg", "a range whose low end is above its high end"),
        (SCENARIO, "alive: 1", "alive:1", "expected a mapping, found the text `alive:1`"),
    ],
)
def test_a_mistake_at_the_border_of_two_values_is_named_and_corrected(
    text: str, right: str, wrong: str, headline: str
) -> None:
    assert right in text
    (finding,) = (each for each in findings_of(text.replace(right, wrong)) if each.severity == "error")
    assert (finding.headline, _corrected(text.replace(right, wrong))) == (headline, text)


def test_a_comparison_and_text_on_several_lines_are_right() -> None:
    text = TEXT.replace("> fall_angle", "== fall_angle").replace("< 1 deg", "<= 1 deg")
    text = text.replace("name: Mine\n", "name: Mine\nsummary: A pole\n  that stands\n")
    assert not [each for each in findings_of(text) if each.severity == "error"]
    text = text.replace("  that stands\n", "  that stands\n  up: 1\n")
    (finding,) = (each for each in findings_of(text) if each.severity == "error")
    assert not re.search(r"`that:", finding.help or "")


@pytest.mark.parametrize(
    ("section", "names"),
    [
        ("reward:\n  alive: 1\n", "`alive` is"),
        (
            "reward:   # terms\n# one\n  alive: 1\n  more:\n    -0.1 * abs(x) / m\n\n  again: 2\n",
            "`alive` and 2 more keys are",
        ),
    ],
)
def test_keys_below_an_empty_section_are_indented(section: str, names: str) -> None:
    right = SCENARIO.replace("reward:\n  alive: 1\n", section)
    wrong = right.replace(section, section.replace("\n  ", "\n"))
    assert f"{names} not indented below `reward`" in [finding.headline for finding in findings_of(wrong)]
    assert _corrected(wrong) == right


def test_a_key_of_the_language_below_an_empty_section_is_not_part_of_it() -> None:
    wrong = SCENARIO.replace("reward:\n  alive: 1\n", "reward:\n")
    assert all(finding.fix is None for finding in findings_of(wrong))


def test_a_misspelled_key_of_a_section_below_names_of_the_user_is_the_mistake() -> None:
    scripts = "scripts:\n  ahead: {drive: 1}\ntrain:\n  algorithm: PPO\n  learning_rat: 1e-3\n"
    (finding,) = findings_of(f"deepbots: 1\nextends: cartpole_continuous\nname: A\n{scripts}")
    assert finding.headline == "unknown key `learning_rat` in `train`"


def _moved_lines(text: str, spaces: int) -> Iterator[tuple[int, str]]:
    """Yield each line by its number from 1, and the text with the line moved to the right, or to the left."""
    lines = text.splitlines(keepends=True)
    for number, line in enumerate(lines):
        words = line.lstrip(" ")
        depth = len(line) - len(words) + spaces
        if depth >= 0 and words[0] not in "#\n":
            yield number + 1, "".join([*lines[:number], " " * depth + words, *lines[number + 1 :]])


def _moved_blocks(text: str) -> Iterator[tuple[str, str]]:
    """Yield each block of lines by its key, and the text with the block moved to the left."""
    for block in re.finditer(r"(?m)^(?=(  +)(\w+):[^\S\n]*(?:#.*)?\n((?:\1 +.*\n|\n)+))", text):
        start, end = block.start(), block.end(3)
        yield block[2], text[:start] + re.sub(r"(?m)^  ", "", text[start:end]) + text[end:]


def _errors(text: str) -> list[Finding]:
    path = Path("mine.yaml").absolute()
    findings = analyze(Document(uri_of(path), 1, text, path), {}).findings
    return [finding for finding in findings if finding.severity == "error"]


def _pressed(text: str) -> str:
    """The text after the first fixes of its errors, one after the other."""
    for _ in range(3):
        fix = next((finding.fix for finding in _errors(text) if finding.fix is not None), None)
        text = edited(fix.edits[0].span.source, fix.edits) if fix is not None else text
    return text


def _is_improved(text: str) -> bool:
    """Apply the fixes of the errors of a text, the first one of each round, and return whether each leaves no
    more errors, and they end."""
    for _ in range(6):
        errors = _errors(text)
        fix = next((finding.fix for finding in errors if finding.fix is not None), None)
        if fix is None:
            return True
        text = edited(fix.edits[0].span.source, fix.edits)
        if len(_errors(text)) > len(errors):
            return False
    return False


def _template(name: str) -> str:
    return next(iter(from_template(name, "mine").values())).decode()


def test_correcting_the_indentation_of_a_section_does_not_lead_to_more_errors_in_a_circle() -> None:
    right = _template("cartpole")
    for spaces in (3, 6, 7, 8):
        wrong = right.replace("    actuators:\n", f"{' ' * spaces}actuators:\n")
        assert wrong != right
        assert _is_improved(wrong), spaces


def test_the_fixes_of_a_line_with_too_little_indentation_lead_back_to_the_text() -> None:
    right = _template("cartpole")
    moved = dict(_moved_lines(right, -2))
    assert len(moved) > 30
    lines = [*moved.items(), *_moved_lines(right, -4)]
    assert [number for number, wrong in lines if _pressed(wrong) != right] == []
    whole = _template("wheeled")
    further = [wrong for _, wrong in _moved_lines(whole, -4)]
    below_a_comment = [wrong for _, wrong in _moved_lines(whole, -2) if "\nangle: b" in wrong]
    assert len(further) > 10
    assert len(below_a_comment) == 1
    assert {_pressed(wrong) for wrong in further + below_a_comment} == {whole}
    apply = next(wrong for wrong in moved.values() if "\n  apply:" in wrong)
    assert [(error.headline, error.span.text, error.help) for error in _errors(apply)] == [
        ("`apply` is not indented below `cart`", "apply", "indent it to 4 spaces: `    apply: ...`")
    ]


@pytest.mark.parametrize("name", ["cartpole", "wheeled", "arm", "pit"])
def test_the_fixes_of_a_block_with_too_little_indentation_lead_back_to_the_text(name: str) -> None:
    right = _template(name)
    assert [key for key, wrong in _moved_blocks(right) if _pressed(wrong) != right] == []


@pytest.mark.parametrize("spaces", [spaces for spaces in range(-4, 5) if spaces])
@pytest.mark.parametrize("name", Template)
@pytest.mark.slow
def test_a_fix_of_a_moved_line_leaves_no_more_errors_and_the_fixes_end(name: str, spaces: int) -> None:
    moved = _moved_lines(_template(name), spaces)
    assert [number for number, text in moved if not _is_improved(text)] == []


def test_a_mistake_in_a_mapping_that_two_names_share_is_one_finding() -> None:
    wrong = """
deepbots: 1
extends: carry
name: Shared
robots:
  left: &rover
    urdf: rover
    actuators: {left_wheel: {type: velocity_moto, joint: left_wheel}}
    apply:
      left_wheel: gas * speed
  right: *rover
"""
    assert [error.span.text for error in _errors(wrong)] == ["velocity_moto"]
