"""A line whose key lacks its colon has the finding itself, and a fix."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from deepbots_cli.compiler import check
from deepbots_cli.diagnostics import Finding
from deepbots_cli.document import load

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
