"""Findings that follow from the interval of a value, where an earlier step or a lost message matters."""

from __future__ import annotations

from pathlib import Path

import pytest

from deepbots_cli import api

SCENARIO = """\
deepbots: 1
name: Small
world: {{timestep: 20 ms}}
robots:
  cart:
    urdf: cartpole_rail
    base: fixed
    actuators: {{move: {{type: velocity_motor, joint: slider, max_torque: 5 N}}}}
    emit: {{gain: 2}}
    apply: {{move: push * 1 m/s}}
messages: {{from_robot: {{loss: 20 %, on_loss: {on_loss}}}}}
action: {{push: -1 .. 1}}
signals: {{value: '{value}'}}
observation: {{previous_action: auto}}
reward: {{alive: 1}}
termination: {{failure: {{there: value > 0.4}}}}
truncation: {{max_steps: 50}}
"""


@pytest.mark.parametrize(
    ("value", "on_loss", "code"),
    [
        ("1 / cart.gain", "zero", "DB405"),
        ("1 / cart.gain", "hold", "DB802"),
        ("low_pass(step, -1 s)", "hold", "DB406"),
        ("delta(sqrt(step), step)", "hold", ""),
    ],
)
def test_a_value_is_judged_with_what_memories_and_messages_keep(
    tmp_path: Path, value: str, on_loss: str, code: str
) -> None:
    path = tmp_path / "small.yaml"
    path.write_text(SCENARIO.format(value=value, on_loss=on_loss), encoding="utf-8")
    codes = {finding.code for finding in api.lint(path)} - {"DB205", "DB805"}
    assert codes == ({code} if code else set())
