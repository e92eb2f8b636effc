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


@pytest.mark.parametrize("number", KEYS, ids=lambda number: SCENARIO.splitlines()[number].strip())
def test_a_key_without_its_colon_is_found_in_its_line_and_corrected(number: int) -> None:
    lines = SCENARIO.splitlines(keepends=True)
    lines[number] = lines[number].replace(":", "", 1)
    text = "".join(lines)
    (finding,) = (each for each in findings_of(text) if each.code in ("DB001", "DB103"))
    assert finding.span.start_position.line == number + 1
    assert "write a colon after the key" in (finding.help or "")
    assert finding.fix is not None
    (edit,) = finding.fix.edits
    assert text[: edit.span.start] + edit.text + text[edit.span.end :] == SCENARIO


@pytest.mark.parametrize(
    ("before", "after"),
    [("{timestep: 32 ms", "{timestep 32 ms"), ("  alive: 1", "  alive:1")],
)
def test_a_colon_is_missing_in_brackets_or_lacks_its_space(before: str, after: str) -> None:
    text = SCENARIO.replace(before, after)
    (finding,) = (each for each in findings_of(text) if each.fix is not None)
    assert finding.fix is not None
    (edit,) = finding.fix.edits
    assert text[: edit.span.start] + edit.text + text[edit.span.end :] == SCENARIO


def test_text_on_several_lines_lacks_no_colon() -> None:
    text = SCENARIO.replace("name: Mine\n", "name: Mine\nsummary: A pole\n  that stands\n")
    assert not [each for each in findings_of(text) if each.severity == "error"]
    text = text.replace("  that stands\n", "  that stands\n  up: 1\n")
    (finding,) = (each for each in findings_of(text) if each.severity == "error")
    assert not re.search(r"`that:", finding.help or "")


TEXT = SCENARIO.replace(
    "  alive: 1\n",
    "  alive: 1\n  lean: -abs(cart.pole_angle) / rad\n  still: 0.1 when abs(cart.pole_angle) < 1 deg\n",
)


def _corrected(text: str) -> str:
    """The text after the fix of its only finding with one."""
    (finding,) = (each for each in findings_of(text) if each.fix is not None)
    assert finding.fix is not None
    for edit in sorted(finding.fix.edits, key=lambda edit: edit.span.start, reverse=True):
        text = text[: edit.span.start] + edit.text + text[edit.span.end :]
    return text


@pytest.mark.parametrize(
    "written",
    [
        "{timestep: 32 ms substeps: 4}",
        "{type: joint_position joint: pole_hinge}",
        "{choices: {forward: 1 backward: -1}}",
    ],
)
def test_a_missing_comma_between_keys_in_braces_is_added(written: str) -> None:
    (right,) = (line for line in TEXT.splitlines() if line.replace(",", "").endswith(written))
    assert _corrected(TEXT.replace(right, right.replace(", ", " "))) == TEXT


def test_a_missing_comma_is_added_behind_braces_and_at_the_end_of_a_line() -> None:
    for right, wrong in (
        ("-1}}\n", "-1} extra: 3}\n"),
        ("ms, substeps", "ms\n  substeps"),
    ):
        text = TEXT.replace(right, wrong)
        (finding,) = findings_of(text)
        assert finding.headline == "a comma is missing before this key"
        assert _corrected(text) == TEXT.replace(
            right, wrong.replace(" extra", ", extra").replace("ms\n", "ms,\n")
        )


def test_a_brace_that_is_not_closed_lacks_no_comma() -> None:
    assert _corrected(TEXT.replace("substeps: 4}", "substeps: 4")) == TEXT


@pytest.mark.parametrize(
    "wrong",
    [
        "name = Mine",
        "  fall_angle=15 deg  # the largest lean",
        "reward=",
        "  alive= 1",
        "  lean = -abs(cart.pole_angle) / rad",
        "  still=0.1 when abs(cart.pole_angle) < 1 deg",
        "    fallen= abs(cart.pole_angle) > fall_angle",
        "world: {timestep= 32 ms, substeps: 4}",
        "world: {timestep: 32 ms, substeps=4}",
    ],
)
def test_an_equals_sign_becomes_the_colon_of_a_key(wrong: str) -> None:
    key, _, rest = wrong.partition("=")
    right = f"{key.rstrip()}: {rest.lstrip()}".rstrip()
    assert f"{right}\n" in TEXT
    assert _corrected(TEXT.replace(f"{right}\n", f"{wrong}\n")) == TEXT


def test_a_comparison_is_not_an_assignment() -> None:
    text = TEXT.replace("> fall_angle", "== fall_angle").replace("< 1 deg", "<= 1 deg")
    assert not [each for each in findings_of(text) if each.severity == "error"]


@pytest.mark.parametrize(
    ("line", "spaces"),
    [
        ("  lean:", 1),
        ("  lean:", 3),
        ("  lean:", 0),
        ("    sensors:", 3),
        ("    sensors:", 5),
        ("    urdf:", 5),
        ("        joints:", 7),
        ("        joints:", 9),
        ("observation:", 1),
        ("  total_timesteps:", 1),
    ],
)
def test_the_line_that_does_not_align_is_moved(line: str, spaces: int) -> None:
    text = TEXT.replace(f"\n{line}", f"\n{' ' * spaces}{line.lstrip()}")
    assert text != TEXT
    assert _corrected(text) == TEXT


def test_a_tab_becomes_spaces() -> None:
    assert _corrected(TEXT.replace("  alive:", "\talive:")) == TEXT


def test_a_value_above_the_block_of_a_section_is_removed() -> None:
    right = "world:\n  timestep: 32 ms    # of a step\n  substeps: 4\n"
    text = TEXT.replace("world: {timestep: 32 ms, substeps: 4}\n", f"\n{right}")
    assert text != TEXT
    wrong = text.replace("\nworld:", "\nworld: +")
    (finding,) = findings_of(wrong)
    assert (finding.headline, _corrected(wrong)) == ("`world` has a value, and a block below it", text)


def test_the_first_key_of_a_section_without_indentation_is_the_one_that_is_moved() -> None:
    right = "world:\n  timestep: 32 ms    # of a step\n  substeps: 4\n"
    text = TEXT.replace("world: {timestep: 32 ms, substeps: 4}\n", right)
    assert text != TEXT
    wrong = text.replace("  timestep:", "timestep:")
    (finding,) = findings_of(wrong)
    assert (finding.headline, _corrected(wrong)) == (
        "`timestep` is not indented below `world`, but the next line is",
        text,
    )


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


def _moved_lines(text: str, spaces: int) -> Iterator[tuple[int, str]]:
    """Yield each line by its number from 1, and the text with the line moved to the right, or to the left."""
    lines = text.splitlines(keepends=True)
    for number, line in enumerate(lines):
        words = line.lstrip(" ")
        depth = len(line) - len(words) + spaces
        if depth >= 0 and words[0] not in "#\n":
            yield number + 1, "".join([*lines[:number], " " * depth + words, *lines[number + 1 :]])


def _errors(text: str) -> list[Finding]:
    path = Path("mine.yaml").absolute()
    findings = analyze(Document(uri_of(path), 1, text, path), {}).findings
    return [finding for finding in findings if finding.severity == "error"]


def _is_improved(text: str) -> bool:
    """Apply the fixes of the errors of a text, the first one of each round, and return whether each leaves no
    more errors, and they end."""
    for _ in range(4):
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
    for spaces in (3, 2, 6, 7, 8):
        wrong = right.replace("    actuators:\n", f"{' ' * spaces}actuators:\n")
        assert wrong != right
        assert _is_improved(wrong), spaces
    assert _corrected(right.replace("    actuators:\n", "  actuators:\n")) == right


@pytest.mark.parametrize("spaces", [spaces for spaces in range(-4, 5) if spaces])
@pytest.mark.parametrize("name", Template)
@pytest.mark.slow
def test_a_fix_of_a_moved_line_leaves_no_more_errors_and_the_fixes_end(name: str, spaces: int) -> None:
    moved = _moved_lines(_template(name), spaces)
    assert [number for number, text in moved if not _is_improved(text)] == []
