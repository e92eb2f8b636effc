"""Loading a bundle: one that is damaged, changed or put together from two exports is refused in a sentence,
or acts the same."""

from __future__ import annotations

import io
import json
import random
import subprocess
import sys
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import onnx
import pytest
from hypothesis import given
from hypothesis import strategies as st
from onnx import numpy_helper

import deepbots_robot
from deepbots_robot import BundleError, InputError, bundle, model, onnx_file, schema
from tests.bundle.untrained import write
from tests.few import every

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


# Mutations


Mutation = Callable[
    [random.Random, model.BundleInfo, bytes, bytes], tuple[model.BundleInfo | bytes, bytes, bytes]
]


def _json(
    rng: random.Random, info: model.BundleInfo, graph: bytes, parity: bytes
) -> tuple[bytes, bytes, bytes]:
    """One value of bundle.json changed, removed, repeated or exchanged with its neighbor."""
    tree = json.loads(model.encode(info))
    places: list[tuple[Any, Any]] = []

    def collect(node: Any) -> None:
        for key in node if isinstance(node, dict) else range(len(node)):
            places.append((node, key))
            if isinstance(node[key], dict | list):
                collect(node[key])

    collect({key: value for key, value in tree.items() if key != "files"})
    collect(tree)
    node, key = rng.choice(
        [place for place in places if place[0] is not tree["files"] and place[1] != "files"]
    )
    value = node[key]
    options: list[Any] = [None, True, -1, 1e6, "other", [], {}, [value], value]
    if isinstance(value, int | float) and not isinstance(value, bool):
        options += [-value, value * 2, value + 1, value * 180 / 3.14159, value * 1.01]
    if isinstance(value, str):
        options += [
            value.upper(),
            value[:-1],
            value + "x",
            {"rad": "deg", "m": "cm", "sensor": "goal"}.get(value, "rad/s"),
        ]
    if isinstance(value, list):
        options += [value[::-1], value[:-1], value * 2]
    chosen = rng.choice([each for each in options if each != value or type(each) is not type(value)])
    node[key] = chosen
    if rng.random() < 0.1 and isinstance(node, dict):
        del node[key]
    return json.dumps(tree).encode(), graph, parity


def _bytes_of(content: bytes, rng: random.Random) -> bytes:
    changed = bytearray(content)
    match rng.randrange(4):
        case 0:
            changed[rng.randrange(len(changed))] ^= 1 << rng.randrange(8)
        case 1:
            del changed[rng.randrange(len(changed)) :]
        case 2:
            at = rng.randrange(len(changed))
            changed[at : at + rng.randrange(1, 40)] = rng.randbytes(rng.randrange(0, 40))
        case _:
            changed += rng.randbytes(8)
    return bytes(changed)


def _graph_bytes(
    rng: random.Random, info: model.BundleInfo, graph: bytes, parity: bytes
) -> tuple[model.BundleInfo, bytes, bytes]:
    return info, _bytes_of(graph, rng), parity


def _graph_parts(
    rng: random.Random, info: model.BundleInfo, graph: bytes, parity: bytes
) -> tuple[model.BundleInfo, bytes, bytes]:
    """A weight, an operator, or the order of arguments, inputs or outputs."""
    changed = onnx.load_from_string(graph)
    node = rng.choice(changed.graph.node)
    match rng.randrange(5):
        case 0 | 1:
            weight = rng.choice(changed.graph.initializer)
            array = numpy_helper.to_array(weight).copy()
            if array.size and array.dtype.kind == "f":
                array.flat[rng.randrange(array.size)] *= rng.choice(
                    [-1.0, 0.0, 1.5, 1.001, 1e3, float("nan")]
                )
            weight.CopyFrom(numpy_helper.from_array(array, weight.name))
        case 2:
            node.op_type = rng.choice(["Add", "Sub", "Mul", "Tanh", "Relu", "Max", "Min", "Loop", "Identity"])
        case 3:
            node.input[:] = list(node.input)[::-1]
        case _:
            entries = rng.choice([changed.graph.input, changed.graph.output])
            swapped = list(entries)
            rng.shuffle(swapped)
            del entries[:]
            entries.extend(swapped)
    return info, changed.SerializeToString(), parity


def _parity_arrays(
    rng: random.Random, info: model.BundleInfo, graph: bytes, parity: bytes
) -> tuple[model.BundleInfo, bytes, bytes]:
    with np.load(io.BytesIO(parity)) as archive:
        arrays = {name: archive[name].copy() for name in archive.files}
    name = rng.choice(sorted(arrays))
    array = arrays[name]
    match rng.randrange(5):
        case 0:
            array.flat[rng.randrange(array.size)] += rng.choice([1, 7])
        case 1:
            arrays[name] = array[:-1]
        case 2:
            arrays[name] = array.astype(rng.choice([np.float16, np.int8, object]))
        case 3:
            del arrays[name]
        case _:
            arrays[name] = array[::-1].copy()
    stream = io.BytesIO()
    np.savez(stream, **arrays)
    return info, graph, stream.getvalue()


def _parity_bytes(
    rng: random.Random, info: model.BundleInfo, graph: bytes, parity: bytes
) -> tuple[model.BundleInfo, bytes, bytes]:
    return info, graph, _bytes_of(parity, rng)


MUTATIONS: dict[str, Mutation] = {
    "json": _json,
    "graph_bytes": _graph_bytes,
    "graph_parts": _graph_parts,
    "parity_arrays": _parity_arrays,
    "parity_bytes": _parity_bytes,
}


@pytest.mark.parametrize("kind", every(3, MUTATIONS))
def test_each_of_many_mutations_with_new_digests_is_refused_or_acts_the_same(
    folder: Path, tmp_path: Path, kind: str
) -> None:
    """200 mutations in all. A bundle that loads acts as the original does, on inputs that were not
    recorded."""
    original = deepbots_robot.load(folder)
    graph, parity = (folder / bundle.GRAPH_NAME).read_bytes(), (folder / bundle.PARITY_NAME).read_bytes()
    refused = 0
    for number in range(40):
        rng = random.Random(f"{kind} {number}")
        info, *contents = MUTATIONS[kind](rng, original.info, graph, parity)
        place = tmp_path / str(number)
        place.mkdir()
        write(place, original.info, *contents)
        if isinstance(info, bytes):
            tree = json.loads(info)
            if isinstance(tree, dict):
                tree["files"] = json.loads((place / bundle.BUNDLE_NAME).read_bytes())["files"]
            (place / bundle.BUNDLE_NAME).write_bytes(json.dumps(tree).encode())
        try:
            mutated = deepbots_robot.load(place)
        except BundleError:
            refused += 1
            continue
        assert mutated.info.inputs == original.info.inputs
        assert mutated.info.outputs == original.info.outputs
        acting = mutated.start()
        expected = original.start()
        rows = np.random.default_rng(number)
        for _ in range(200):
            values = values_of(original, rows)
            assert acting.step(values)["bot.wheels"] == pytest.approx(
                expected.step(values)["bot.wheels"], abs=1e-5 * 0.2
            )
    assert refused >= 25


def test_a_graph_of_another_export_is_refused(folder: Path, choosing: Path, tmp_path: Path) -> None:
    loaded = deepbots_robot.load(folder)
    other_info = msgspec.structs.replace(
        loaded.info, scenario=msgspec.structs.replace(loaded.info.scenario, summary="other")
    )
    place = tmp_path / "mixed"
    place.mkdir()
    write(
        place,
        other_info,
        (folder / bundle.GRAPH_NAME).read_bytes(),
        (folder / bundle.PARITY_NAME).read_bytes(),
    )
    with pytest.raises(BundleError, match=r"policy.onnx and bundle.json are not of the same export"):
        deepbots_robot.load(place)


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


def test_an_archive_that_unpacks_to_too_much_is_refused(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    loaded = deepbots_robot.load(folder)
    unpacked = sum(entry.file_size for entry in zipfile.ZipFile(folder / bundle.PARITY_NAME).infolist())
    monkeypatch.setattr(bundle, "_MAX_PARITY_BYTES", unpacked - 1)
    with pytest.raises(BundleError, match=f"holds more than {unpacked - 1} bytes"):
        bundle.read_parity((folder / bundle.PARITY_NAME).read_bytes(), loaded.info)


# What is published


def test_the_schema_is_that_of_the_records() -> None:
    """`python -m deepbots_robot.schema` writes it."""
    assert (ROOT / schema.PATH).read_text(encoding="utf-8") == schema.json_schema()


def test_a_bundle_fits_the_published_schema(folder: Path) -> None:
    jsonschema = pytest.importorskip("jsonschema")
    published = json.loads((ROOT / schema.PATH).read_text())
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
