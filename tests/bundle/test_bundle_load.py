"""Loading a bundle: one that is damaged, changed or put together from two exports is refused in a sentence,
or acts the same."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import pytest
from hypothesis import given
from hypothesis import strategies as st

import deepbots_robot
from deepbots_robot import BundleError, InputError, bundle, model, onnx_file

ROOT = Path(__file__).parents[2]


def values_of(loaded: deepbots_robot.Bundle, rng: np.random.Generator) -> dict[str, Any]:
    return {entry.name: rng.normal(0.0, 3.0, entry.shape) for entry in loaded.info.inputs}


def test_a_policy_remembers_until_it_is_reset(folder: Path) -> None:
    loaded = deepbots_robot.load(folder)
    policy, independent = loaded.start(), loaded.start()
    rng = np.random.default_rng(0)
    rows = [values_of(loaded, rng) for _ in range(5)]
    first = [policy.step(row)["bot.wheels"].tolist() for row in rows]
    again = [policy.step(row)["bot.wheels"].tolist() for row in rows]
    assert first != again
    policy.reset()
    assert [policy.step(row)["bot.wheels"].tolist() for row in rows] == first
    assert [
        independent.step(row)["bot.wheels"].tolist() for row in rows
    ] == first  # each policy has a memory of its own


def test_in_a_loop_that_is_a_multiple_faster_the_policy_acts_on_every_nth_call(folder: Path) -> None:
    loaded = deepbots_robot.load(folder)
    policy, fast = loaded.start(), loaded.start(3 * loaded.info.rate_hz)
    rng = np.random.default_rng(0)
    rows = [values_of(loaded, rng) for _ in range(12)]
    wanted = [policy.step(row)["bot.wheels"].tolist() for row in rows[::3]]
    assert [fast.step(row)["bot.wheels"].tolist() for row in rows] == [
        command for command in wanted for _ in range(3)
    ]
    fast.reset()
    assert fast.step(rows[0])["bot.wheels"].tolist() == wanted[0]


@pytest.mark.parametrize("ratio", [0.5, 1.5, 0.0, -1.0, float("nan"), float("inf")])
def test_another_rate_is_refused(folder: Path, ratio: float) -> None:
    loaded = deepbots_robot.load(folder)
    with pytest.raises(BundleError, match="not a whole multiple"):
        loaded.start(ratio * loaded.info.rate_hz)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"bot.gyro": [0.0, 0.0]}, "'bot.gyro' has the shape [2]; it must have [3]"),
        ({"bot.gyro": [0.0, np.nan, 0.0]}, "'bot.gyro' is not finite"),
        ({"bot.gyro": ["a", "b", "c"]}, "'bot.gyro' is of the type"),
        ({"bot.gyro": [True, False, True]}, "'bot.gyro' is of the type bool; it must be float64"),
        ({"bot.compass": 0.0}, "1 unknown (bot.compass)"),
    ],
)
def test_values_that_do_not_fit_change_nothing(folder: Path, change: dict[str, Any], message: str) -> None:
    loaded = deepbots_robot.load(folder)
    policy, unharmed = loaded.start(), loaded.start()
    values = values_of(loaded, np.random.default_rng(0))
    for each in (policy, unharmed):
        each.step(values)
    with pytest.raises(InputError) as caught:
        policy.step(values | change)
    assert message in str(caught.value)
    assert policy.step(values)["bot.wheels"].tolist() == unharmed.step(values)["bot.wheels"].tolist()


def test_a_missing_value_is_named(folder: Path) -> None:
    with pytest.raises(InputError, match=r"1 missing \(bot.gyro\)"):
        deepbots_robot.load(folder).start().step({"bot.accel": [0.0, 0.0, 9.81]})


# Recorded steps


def test_an_option_that_is_not_the_best_is_refused_unless_two_are_equally_good(
    choosing: Path, tmp_path: Path
) -> None:
    loaded = deepbots_robot.load(choosing)
    parity = bundle.read_parity((choosing / bundle.PARITY_NAME).read_bytes(), loaded.info)
    bundle.replay(loaded, parity)
    outputs = {name: rows.copy() for name, rows in parity.outputs.items()}
    outputs["action"][7] = 1 - outputs["action"][7]
    outputs["cart.wheels"][7] *= -1
    with pytest.raises(BundleError, match=r"step 7: 'cart\.wheels'"):
        bundle.replay(loaded, bundle.Parity(parity.inputs, outputs, parity.starts))
    outputs["scores"][7] = 0.5
    bundle.replay(loaded, bundle.Parity(parity.inputs, outputs, parity.starts))


# Hostile files


@given(st.binary(max_size=200))
def test_bytes_that_are_not_a_model_are_refused_or_have_no_nodes(content: bytes) -> None:
    try:
        onnx_file.require_plain(content)
    except BundleError:
        return
    assert not onnx.load_from_string(content).graph.node


@given(st.binary(max_size=300) | st.text(max_size=200).map(str.encode))
def test_bytes_that_are_not_a_description_are_refused(content: bytes) -> None:
    with pytest.raises(BundleError, match=r"bundle.json"):
        model.decode(content)


# What is published


def test_the_schema_is_that_of_the_records() -> None:
    """`python -m deepbots_robot.model` writes it."""
    assert (ROOT / model.PATH).read_text(encoding="utf-8") == model.json_schema()


def test_a_bundle_fits_the_published_schema(folder: Path) -> None:
    jsonschema = pytest.importorskip("jsonschema")
    published = json.loads((ROOT / model.PATH).read_text())
    jsonschema.Draft202012Validator.check_schema(published)
    jsonschema.validate(json.loads((folder / bundle.BUNDLE_NAME).read_text()), published)


def test_a_robot_imports_no_simulator_and_no_learner(folder: Path) -> None:
    code = f"""
import sys, deepbots_robot
deepbots_robot.load({str(folder)!r}).start()
for name in ("deepbots_cli", "torch", "pybullet", "mujoco", "pydantic", "gymnasium", "onnx", "scipy"):
    assert name not in sys.modules, name
"""
    subprocess.run([sys.executable, "-c", code], check=True, cwd=ROOT)
