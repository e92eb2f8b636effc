"""Names of a scenario that mean something in Python, or to the compiler: they stay what the user meant."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from deepbots_cli import api

# Python's words, the words of generated code, and what the compiler would call its own variables.
AWKWARD = [
    *(
        "self",
        "lambda",
        "match",
        "float",
        "abs",
        "print",
        "pi",
        "hypot",
        "copysign",
        "engine",
        "message",
        "stamp",
        "reward",
        "observed",
    ),
    *(
        "cart_joints",
        "cart_cart_pose",
        "cart_place",
        "seen_first",
        "clipped",
        "pack",
        "physics",
        "step_count",
        "robot_cart",
        "drive_pick",
    ),
    *(
        "told_first",
        "term_first",
        "parameter_first",
        "delta_signals_rise_0",
        "ended_by",
        "_private",
        "__dunder__",
        "a1",
        "memory",
    ),
]
SCENARIO = """\
deepbots: 1
name: {name}
summary: {summary}
world: {{timestep: 20 ms, substeps: 2}}
robots:
  cart:
    urdf: cartpole_rail
    base: fixed
    sensors:
      place: {{type: joint_position, joint: slider}}
      cart_joints: {{type: joint_position, joint: hinge}}
    actuators: {{motor: {{type: velocity_motor, joint: slider, max_torque: 10 N}}}}
    receive:
      {awkward}: drive
    emit: [place, cart_joints]
    apply: {{motor: {awkward} * 0.02 m/s + 0 * cart_joints * (m/s) / rad}}
action: {{drive: -1 .. 1}}
augment:
  first: position(cart.cart).x
  {awkward}_: first
signals:
  {awkward}: 2 * first
  rise: delta({awkward})
observation:
  first: -1 .. 1 m
  cart.cart_joints: -4 .. 4 rad
reward:
  {awkward}: {awkward} / m
  first: rise / m
truncation: {{max_steps: 50}}
reset: {{joints: {{cart.hinge: 1 rad}}}}
"""


def scenario(folder: Path, awkward: str = "plain", name: str = "Odd", summary: str = "none") -> Path:
    file = folder / "odd.yaml"
    file.write_text(SCENARIO.format(awkward=awkward, name=name, summary=summary), encoding="utf-8")
    return file


@pytest.mark.parametrize("awkward", AWKWARD)
def test_a_name_is_never_taken_for_something_else(tmp_path: Path, awkward: str) -> None:
    expected, found = [], []
    for name, rows in (("plain", expected), (awkward, found)):
        checked = api.load(scenario(tmp_path, name))
        if checked.findings.errors:
            assert name != "plain", list(checked.findings)
            pytest.skip("the language keeps this name for itself")
        environment = api.make(checked, engine="exact")
        environment.reset(seed=0)
        for _ in range(4):
            observation, reward, _, _, info = environment.step(np.array([0.5]))
            rows.append((observation.tolist(), reward, list(info["reward_terms"].values())))
        environment.close()
    assert found == expected


@pytest.mark.parametrize(
    "name", ["line follower", "3 carts", "Ünïcode", "a'b\"c", "x y-z_w", "...", "class", "None"]
)
def test_any_name_of_a_scenario_gives_a_class(tmp_path: Path, name: str) -> None:
    quoted = '"' + name.replace("\\", "\\\\").replace('"', '\\"') + '"'
    checked = api.load(scenario(tmp_path, name=quoted))
    if checked.findings.errors:
        return
    environment = api.make(checked, engine="exact")
    environment.reset(seed=0)
    environment.close()


@pytest.mark.parametrize(
    "summary",
    [
        '"\\"\\"\\""',
        '"\\\\"',
        '"a\\nb"',
        "'quote \" and '' quote'",
        '"🚗 車 é"',
        '"\\u2028 a \\t b \\x85"',
        "it's",
    ],
)
def test_any_summary_can_be_printed(tmp_path: Path, summary: str) -> None:
    code = api.compile(scenario(tmp_path, summary=summary)).code
    exec(compile(code, "printed", "exec"), {"__name__": "printed"})


def test_the_code_does_not_depend_on_the_process(tmp_path: Path) -> None:
    """Sets are in another order in every process unless hashing is fixed."""
    drawn = Path(__file__).parents[1] / "data" / "scenarios" / "drawn.yaml"
    program = f"from deepbots_cli import api; print(api.compile({str(drawn)!r}).code, end='')"
    answer = subprocess.run(
        [sys.executable, "-c", program],
        capture_output=True,
        text=True,
        check=True,
        env={"PYTHONHASHSEED": "77"},
    )
    assert answer.stdout == api.compile(drawn).code
