"""What a forger can still make of a bundle: a share of `python -m tests.bundle.forgeries`, and ways that were
written by hand."""

from __future__ import annotations

import io
import json
import os
import struct
import subprocess
import sys
import zipfile
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import onnxruntime
import pytest
from onnx import TensorProto, helper, numpy_helper

import deepbots_robot
from deepbots_robot import BundleError, bundle, model, onnx_file, signature
from deepbots_robot.__main__ import main
from deepbots_robot.server import Commands
from deepbots_robot.serving import ServeError, inputs_of, mapped, outputs_of
from tests.bundle.forged import Forged
from tests.bundle.forged_graphs import encoded, fields, varint
from tests.bundle.forgeries import QUICK, prepare
from tests.few import every

ROOT = Path(__file__).parents[2]
pytestmark = pytest.mark.skipif(
    sys.platform != "linux", reason="the limits of processes and their memory are those of Linux"
)


@pytest.fixture(scope="module")
def bases(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return prepare(tmp_path_factory.mktemp("forgeries") / "bases", QUICK)


def _run(bases: Path, *words: object) -> list[dict[str, Any]]:
    command = [
        sys.executable,
        "-m",
        "tests.bundle.forgeries",
        "--bases",
        str(bases),
        "--json",
        *map(str, words),
    ]
    ran = subprocess.run(command, cwd=ROOT, text=True, capture_output=True, check=False)
    return [json.loads(line) for line in ran.stdout.splitlines()]


@pytest.mark.parametrize(
    ("count", "seed"),
    [pytest.param(40, 1, id="some"), pytest.param(500, 2, id="many", marks=pytest.mark.slow)],
)
def test_a_forged_bundle_is_refused_in_a_sentence_or_acts_within_its_limits(
    bases: Path, tmp_path: Path, count: int, seed: int
) -> None:
    outcomes = _run(bases, "--count", count, "--seed", seed, "--keep", tmp_path)
    assert len(outcomes) == count
    assert [each for each in outcomes if each["end"] == "failed"] == []
    assert sum(each["end"] == "refused" for each in outcomes) > count / 2
    assert any(each["end"] == "loaded" for each in outcomes)


@pytest.mark.slow
def test_a_number_is_always_the_same_forgery(bases: Path, tmp_path: Path) -> None:
    outcomes = [_run(bases, "--only", 37, "--keep", tmp_path)[0] for _ in range(2)]
    assert [{**outcome, "seconds": 0, "megabytes": 0} for outcome in outcomes] == [
        {**outcomes[0], "seconds": 0, "megabytes": 0}
    ] * 2


# By hand. Each way changes a copy of a bundle; its digests are those of the forger.


def _forged(bases: Path, name: str = "balancer") -> Forged:
    forged = Forged.of(bases / name)
    del forged.files[bundle.SIGNATURE_NAME]
    return forged


def _loaded(forged: Forged, place: Path) -> deepbots_robot.Bundle:
    forged.write(place / "forged", digests=True)
    return deepbots_robot.load(place / "forged")


def _command(
    forged: Forged,
    *nodes: onnx.NodeProto,
    weights: dict[str, Any] | None = None,
    shapes: dict[str, list[int]] | None = None,
) -> None:
    """The command of the balancer is made by these nodes, of which the last one makes `forged`; the recorded
    steps are made to fit."""
    graph = forged.graph
    end = next(node for node in graph.graph.node if node.output[0] == "bot.wheels")
    own = end.input[0]
    new_nodes = [
        helper.make_node(node.op_type, [own if name == "own" else name for name in node.input], node.output)
        for node in nodes
    ]
    for new_node, node in zip(new_nodes, nodes, strict=True):
        new_node.attribute.extend(node.attribute)
    at = list(graph.graph.node).index(end)
    end.input[0] = "forged"
    rest = list(graph.graph.node)
    del graph.graph.node[:]
    graph.graph.node.extend([*rest[:at], *new_nodes, *rest[at:]])
    graph.graph.initializer.extend(
        [numpy_helper.from_array(np.asarray(value), name) for name, value in (weights or {}).items()]
    )
    for name, shape in {**(shapes or {}), "forged": [2]}.items():
        graph.graph.value_info.append(helper.make_tensor_value_info(name, TensorProto.DOUBLE, shape))
    forged.set_graph(graph)


def _values(loaded: deepbots_robot.Bundle, **changes: Any) -> dict[str, Any]:
    return {entry.name: np.zeros(entry.shape) for entry in loaded.info.inputs} | {
        name.replace("_", "."): value for name, value in changes.items()
    }


def test_a_model_in_the_format_of_onnxruntime_is_none(bases: Path, tmp_path: Path) -> None:
    """A model that was ONNX for our reader and RandomNormalLike for onnxruntime, whose own format begins with
    "ORTM" at byte 4, was run."""
    ends = [helper.make_tensor_value_info(name, TensorProto.FLOAT, [4]) for name in "xy"]
    opset = helper.make_opsetid("", 17)
    evil = helper.make_graph([helper.make_node("RandomNormalLike", ["x"], ["y"])], "g", ends[:1], ends[1:])
    options = onnxruntime.SessionOptions()
    options.log_severity_level = 4
    options.optimized_model_filepath = str(tmp_path / "evil.ort")
    options.add_session_config_entry("session.save_model_format", "ORT")
    evil_model = helper.make_model(evil, opset_imports=[opset], ir_version=8).SerializeToString()
    onnxruntime.InferenceSession(evil_model, options, providers=["CPUExecutionProvider"])
    inner = (tmp_path / "evil.ort").read_bytes()
    assert inner[4:8] == b"ORTM"
    head = b"\x08\x08\x22\x04ORTM"  # `ir_version` 8 and the domain "ORTM"; as an offset, 69 MB from here
    root, table = struct.unpack("<I", head[:4])[0], struct.unpack("<I", inner[:4])[0]
    index = table - struct.unpack("<i", inner[table : table + 4])[0]
    index_size, table_size = struct.unpack("<HH", inner[index : index + 4])
    moved = bytearray((root + 79) // 16 * 16)
    start = len(moved)
    moved += inner
    moved[root - 32 : root - 32 + index_size] = inner[index : index + index_size]
    moved[root : root + table_size] = inner[table : table + table_size]
    moved[root : root + 4] = struct.pack("<i", 32)
    for slot in filter(
        None, struct.unpack(f"<{index_size // 2 - 2}H", inner[index + 4 : index + index_size])
    ):
        target = table + slot + struct.unpack("<I", inner[table + slot : table + slot + 4])[0]
        moved[root + slot : root + slot + 4] = struct.pack("<I", start + target - root - slot)
    text = b"\x32" + varint(len(moved) - len(head) - 5)  # all of it is the documentation of the model
    moved[: len(head) + 5] = head + text
    plain = helper.make_graph([helper.make_node("Relu", ["x"], ["y"])], "g", ends[:1], ends[1:])
    both = bytes(moved) + helper.make_model(plain, opset_imports=[opset]).SerializeToString()[2:]
    session = onnxruntime.InferenceSession(both, providers=["CPUExecutionProvider"])
    assert session.run(None, {"x": np.zeros(4, np.float32)})[
        0
    ].any()  # onnxruntime alone runs the other model
    with pytest.raises(BundleError, match="more than 1,000,000 bytes without the numbers"):
        onnx_file.require_plain(both)
    forged = _forged(bases)
    parts = [part for part in fields(forged.files[bundle.GRAPH_NAME]) if part[0] not in (1, 4)]
    forged.set_graph(head + encoded(parts))  # short enough for our reader
    assert _loaded(forged, tmp_path).start().step(_values(deepbots_robot.load(bases / "balancer")))


def test_a_command_is_clipped_where_the_graph_does_not(bases: Path, tmp_path: Path) -> None:
    """A graph without its last limits, with recorded steps within them, commanded 1e6."""
    forged = _forged(bases)
    _command(
        forged,
        helper.make_node("Sub", ["bot.gyro", "far"], ["beyond"]),
        helper.make_node("Max", ["beyond", "nothing"], ["more"]),
        helper.make_node("ReduceSum", ["more", "axes"], ["sum"], keepdims=1),
        helper.make_node("Add", ["own", "sum"], ["forged"]),
        weights={"far": [1e9], "nothing": [0.0], "axes": [0]},
        shapes={"beyond": [3], "more": [3], "sum": [1]},
    )
    loaded = _loaded(forged, tmp_path)
    assert loaded.start().step(_values(loaded, bot_gyro=np.full(3, 1e12)))["bot.wheels"].tolist() == [
        0.1,
        0.1,
    ]


def test_a_command_that_is_not_a_number_is_an_error_and_changes_nothing(bases: Path, tmp_path: Path) -> None:
    forged = _forged(bases)
    _command(
        forged,
        helper.make_node("Sub", ["far", "bot.gyro"], ["left"]),
        helper.make_node("Sqrt", ["left"], ["root"]),
        helper.make_node("Mul", ["root", "zero"], ["none"]),
        helper.make_node("ReduceSum", ["none", "axes"], ["sum"], keepdims=1),
        helper.make_node("Add", ["own", "sum"], ["forged"]),
        weights={"far": [1e9], "zero": [0.0], "axes": [0]},
        shapes={"left": [3], "root": [3], "none": [3], "sum": [1]},
    )
    loaded = _loaded(forged, tmp_path)
    policy, unharmed = loaded.start(), loaded.start()
    with pytest.raises(BundleError, match=r"computes 'bot.wheels' as nan, nan"):
        policy.step(_values(loaded, bot_gyro=np.full(3, 1e12)))
    assert (
        policy.step(_values(loaded))["bot.wheels"].tolist()
        == unharmed.step(_values(loaded))["bot.wheels"].tolist()
    )


def test_a_place_beyond_a_table_is_an_error_of_the_bundle(bases: Path, tmp_path: Path) -> None:
    """Onnxruntime's own exception passed through `step`."""
    forged = _forged(bases)
    _command(
        forged,
        helper.make_node("Gather", ["bot.gyro", "first"], ["one"], axis=0),
        helper.make_node("Mul", ["one", "small"], ["place"]),
        helper.make_node("Cast", ["place"], ["at"], to=7),
        helper.make_node("Gather", ["table", "at"], ["taken"], axis=0),
        helper.make_node("Add", ["own", "taken"], ["forged"]),
        weights={"first": [0], "small": [1e-9], "table": [0.0, 0.0]},
        shapes={"one": [1], "place": [1], "taken": [1]},
    )
    graph = forged.graph
    graph.graph.value_info.append(helper.make_tensor_value_info("at", TensorProto.INT64, [1]))
    forged.set_graph(graph)
    loaded = _loaded(forged, tmp_path)
    with pytest.raises(BundleError, match=r"policy.onnx cannot compute with these values"):
        loaded.start().step(_values(loaded, bot_gyro=np.full(3, 1e12)))


def test_a_policy_that_counts_its_steps_stays_within_its_range_and_rate(bases: Path, tmp_path: Path) -> None:
    """Within the recorded steps it is the one that was exported; later it commands more, from one end to the
    other."""
    forged = _forged(bases)
    graph = forged.graph
    forged.tree["memory"].append({"name": "count", "shape": [1], "dtype": "float64", "initial": [1.0]})
    forged.tree["outputs"][0]["max_rate"] = [0.5, 0.5]
    graph.graph.input.append(helper.make_tensor_value_info("count", TensorProto.DOUBLE, [1]))
    output = helper.make_tensor_value_info("count_next", TensorProto.DOUBLE, [1])
    before = list(graph.graph.output)
    place = [entry.name for entry in before].index("action")
    del graph.graph.output[:]
    graph.graph.output.extend([*before[:place], output, *before[place:]])
    graph.graph.node.append(helper.make_node("Mul", ["count", "growth"], ["count_next"]))
    graph.graph.initializer.append(numpy_helper.from_array(np.array([-1.06]), "growth"))
    forged.set_graph(graph)
    _command(
        forged,
        helper.make_node("Mul", ["count", "small"], ["more"]),
        helper.make_node("Add", ["own", "more"], ["forged"]),
        weights={"small": [1e-17]},
        shapes={"more": [1]},
    )
    arrays = forged.arrays
    starts = arrays.pop("starts")
    forged.set_arrays({name: rows[:200] for name, rows in arrays.items()} | {"starts": starts[starts < 200]})
    forged.fit_graph()
    loaded = _loaded(forged, tmp_path)
    policy = loaded.start()
    limits = Commands(outputs_of(loaded.info))
    last = None
    raw = []
    for _ in range(2_000):
        commands = policy.step(_values(loaded))
        raw.append(float(commands["bot.wheels"][0]))
        limited = limits.limit(commands, loaded.info.timestep_s)
        assert limited is not None
        assert np.abs(limited["bot.wheels"]).max() <= 0.1
        assert (
            last is None or np.abs(limited["bot.wheels"] - last).max() <= 0.5 * loaded.info.timestep_s + 1e-12
        )
        last = limited["bot.wheels"]
    assert {raw[-1], raw[-2]} == {0.1, -0.1}


def test_a_choice_that_is_none_of_the_options_is_an_error(bases: Path, tmp_path: Path) -> None:
    forged = _forged(bases, "cartpole")
    graph = forged.graph
    end = next(node for node in graph.graph.node if node.output[0] == "action")
    graph.graph.initializer.append(numpy_helper.from_array(np.array(99, np.int64), "more"))
    end.CopyFrom(helper.make_node("Add", [end.input[0], "more"], ["action"]))
    forged.set_graph(graph)
    arrays = forged.arrays
    forged.set_arrays(arrays | {"output/action": arrays["output/action"] + 99})
    with pytest.raises(BundleError, match=r"computes 'action' as (99|100)"):
        _loaded(forged, tmp_path)


# Texts


@pytest.mark.parametrize(
    ("key", "text"),
    [("text", "solved\n  signed with a trusted key: yes"), ("text", "\x1b]0;x\x07"), ("text", "a\u202eb")],
)
def test_a_text_cannot_write_further_lines_of_check(bases: Path, tmp_path: Path, key: str, text: str) -> None:
    forged = _forged(bases)
    numbers = {
        "episodes": 1,
        "seed": 0,
        "mean_return": 0,
        "return_interval": None,
        "success_rate": None,
        "success_interval": None,
        "solved": True,
    }
    forged.tree["evaluation"] = {**numbers, key: text}
    forged.fit_graph()
    with pytest.raises(BundleError, match=r"bundle\.json is damaged"):
        _loaded(forged, tmp_path)


@pytest.mark.parametrize("name", ["bot.gyro\n", "bot\x9b2J", "a\u2028b"])
def test_a_name_has_no_hidden_characters(bases: Path, tmp_path: Path, name: str) -> None:
    """A pattern that ends with `$` also takes a line end."""
    forged = _forged(bases)
    forged.tree["inputs"][0]["name"] = name
    with pytest.raises(BundleError, match=r"bundle\.json is damaged"):
        _loaded(forged, tmp_path)


def test_a_name_in_a_graph_is_shown_without_control_characters(
    bases: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    forged = _forged(bases)
    graph = forged.graph
    graph.graph.node[0].output[0] = "\x1b[2J\nerror: none"
    forged.set_graph(graph)
    forged.write(tmp_path / "forged", digests=True)
    assert main(["check", str(tmp_path / "forged")]) == 1
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert error[:-1].isprintable()


def test_fields_for_which_no_topic_is_left_are_named(bases: Path) -> None:
    """Two names that are the same as topics ended `serve` in a KeyError."""
    forged = _forged(bases)
    entry = {**forged.tree["inputs"][0], "robot": None, "source": "supervisor", "sensor": "x", "joints": []}
    forged.tree["inputs"] += [{**entry, "name": "position(a b)"}, {**entry, "name": "position(a-b)"}]
    info = model.decode(json.dumps(forged.tree).encode())
    with pytest.raises(ServeError, match=r"no topic fits position\(a-b\)"):
        mapped([each.field for each in inputs_of(info)], {})


# bundle.json and the files


def _twice(forged: Forged) -> None:
    text = model.encode(model.decode(json.dumps(forged.tree).encode()))
    forged.description = text.replace(b'"rate_hz"', b'"rate_hz": 1.0,\n  "rate_hz"', 1)


def _initial(forged: Forged) -> None:
    forged.tree["memory"][0]["initial"] = [0.0]
    next(entry for entry in forged.tree["memory"] if entry["dtype"] == "bool")["initial"] = [0.5]


def _picture_with_a_range(forged: Forged) -> None:
    forged.tree["inputs"][0].update(shape=[3, 1, 1], dtype="uint8", components=[])


def _long_part(forged: Forged) -> None:
    forged.tree["files"]["a" * 256] = "0" * 64


def _deep(forged: Forged) -> None:
    forged.tree["files"]["a/" * 200 + "a"] = "0" * 64


def _many_fields(forged: Forged) -> None:
    entry = {**forged.tree["inputs"][0], "components": [], "joints": [], "range": None, "shape": [1]}
    forged.tree["inputs"] += [{**entry, "name": f"{number:04}" + "x" * 150} for number in range(4_000)]
    graph = forged.graph
    more = [
        helper.make_tensor_value_info(each["name"], TensorProto.DOUBLE, [1])
        for each in forged.tree["inputs"][-4_000:]
    ]
    before = list(graph.graph.input)
    memories = len(forged.tree["memory"])
    del graph.graph.input[:]
    graph.graph.input.extend([*before[:-memories], *more, *before[-memories:]])
    forged.set_graph(graph)
    arrays = {name: rows[:2] for name, rows in forged.arrays.items()} | {"starts": np.array([0])}
    forged.set_arrays(
        arrays | {f"input/{each['name']}": np.zeros((2, 1)) for each in forged.tree["inputs"][-4_000:]}
    )
    forged.fit_graph()


def _no_room(forged: Forged) -> None:
    forged.files[bundle.GRAPH_NAME] = forged.files[bundle.GRAPH_NAME] + b"\x42\x00" * 2_000_000


def _whole_numbers_divided(forged: Forged) -> None:
    graph = forged.graph
    graph.graph.initializer.extend(
        [numpy_helper.from_array(np.array([number], np.int64), f"i{number}") for number in (0, 1)]
    )
    graph.graph.node.append(helper.make_node("Div", ["i1", "i0"], ["crash"]))
    graph.graph.value_info.append(helper.make_tensor_value_info("crash", TensorProto.INT64, [1]))
    forged.set_graph(graph)


def _wide_convolution(forged: Forged) -> None:
    graph = forged.graph
    for name, shape in {"picture": (1, 1, 500, 500), "kernel": (1, 1, 250, 250)}.items():
        graph.graph.initializer.append(numpy_helper.from_array(np.zeros(shape, np.float32), name))
    graph.graph.node.append(helper.make_node("Conv", ["picture", "kernel"], ["wide"]))
    graph.graph.value_info.append(helper.make_tensor_value_info("wide", TensorProto.FLOAT, [1, 1, 251, 251]))
    forged.set_graph(graph)


def _sequence_lengths(forged: Forged) -> None:
    graph = forged.graph
    node = next(node for node in graph.graph.node if node.op_type == "Concat")
    node.op_type = "LSTM"
    forged.set_graph(graph)


def _many_worlds(forged: Forged) -> None:
    graph = forged.graph
    for name, shape in {
        "steps": (60, 4_000, 1),
        "weights": (1, 1_600, 1),
        "recurrent": (1, 1_600, 400),
    }.items():
        graph.graph.initializer.append(numpy_helper.from_array(np.zeros(shape, np.float32), name))
    graph.graph.node.append(
        helper.make_node("LSTM", ["steps", "weights", "recurrent"], ["", "hidden_after"], hidden_size=400)
    )
    graph.graph.value_info.append(
        helper.make_tensor_value_info("hidden_after", TensorProto.FLOAT, [1, 4_000, 400])
    )
    forged.set_graph(graph)


def _no_inputs(forged: Forged) -> None:
    graph = forged.graph
    graph.graph.node.append(helper.make_node("Conv", ["bot.gyro"], ["wide"]))
    graph.graph.value_info.append(helper.make_tensor_value_info("wide", TensorProto.DOUBLE, [1]))
    forged.set_graph(graph)


def _long_shape(forged: Forged) -> None:
    graph = forged.graph
    graph.graph.value_info.append(
        helper.make_tensor_value_info("long", TensorProto.DOUBLE, [(1 << 30) + 1] * 50_000)
    )
    forged.set_graph(graph)


def _truth_that_is_two(forged: Forged) -> None:
    graph = forged.graph
    graph.graph.initializer.append(helper.make_tensor("two", TensorProto.BOOL, [1], b"\x02", raw=True))
    forged.set_graph(graph)


def _archive(forged: Forged, entries: dict[str, bytes], **settings: Any) -> None:
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", **settings) as archive:
        for name, content in entries.items():
            archive.writestr(name, content)
    forged.files[bundle.PARITY_NAME] = stream.getvalue()


def _plain_entries(forged: Forged) -> dict[str, bytes]:
    with zipfile.ZipFile(io.BytesIO(forged.files[bundle.PARITY_NAME])) as archive:
        return {name: archive.read(name) for name in archive.namelist()}


def _lzma(forged: Forged) -> None:
    _archive(forged, _plain_entries(forged), compression=zipfile.ZIP_LZMA)


def _key_twice_in_a_header(forged: Forged) -> None:
    entries = _plain_entries(forged)
    header = b"{'descr': '<f8', 'fortran_order': False, 'shape': (1,), 'descr': '|O', }\n"
    entries["starts.npy"] = b"\x93NUMPY\x01\x00" + struct.pack("<H", len(header)) + header + b"\x80\x04."
    _archive(forged, entries)


def _same_bytes(forged: Forged) -> None:
    """Each entry has the bytes of the one after it in itself, so that all unpack the longest one."""
    entries = _plain_entries(forged)
    content = b""
    directory = b""
    packer = zlib.compressobj(wbits=-15)
    tail = packer.compress(bytes(1_000_000)) + packer.flush()
    body = tail
    for name, plain in reversed(list(entries.items())):
        encoded_name = name.encode()
        head = (
            struct.pack("<IHHHIIIHH", 0x04034B50, 20, 0, 8, 0, zlib.crc32(plain), 0, 0, len(encoded_name))[
                :26
            ]
            + struct.pack("<HH", len(encoded_name), 0)
            + encoded_name
        )
        body = head + body
        quoted = len(body)
        directory += (
            struct.pack(
                "<IHHHHIIIIHHHHHII",
                0x02014B50,
                20,
                20,
                0,
                8,
                0,
                zlib.crc32(plain),
                quoted,
                len(plain),
                len(encoded_name),
                0,
                0,
                0,
                0,
                0,
                0,
            )
            + encoded_name
        )
    content = body
    end = struct.pack(
        "<IHHHHIIH", 0x06054B50, 0, 0, len(entries), len(entries), len(directory), len(content), 0
    )
    forged.files[bundle.PARITY_NAME] = content + directory + end


def _hundred_thousand_steps(forged: Forged) -> None:
    arrays = {name: np.repeat(rows[:1], 100_000, axis=0) for name, rows in forged.arrays.items()}
    forged.set_arrays(arrays | {"starts": np.arange(100_000)})


WAYS: dict[str, tuple[Callable[[Forged], None], str]] = {
    "a key of bundle.json twice": (_twice, "not written as an export writes it"),
    "a truth value of one half at the start": (_initial, "an initial number that is not of type bool"),
    "a picture with a range": (_picture_with_a_range, "neither a row of numbers nor a picture"),
    "a name that no file system takes": (_long_part, "is not a path in a bundle"),
    "a path of 200 folders": (_deep, "is not a path in a bundle"),
    "4,000 inputs that nothing reads": (_many_fields, ""),
    "two million empty operator sets": (_no_room, "more than 1,000,000 bytes without"),
    "whole numbers divided by zero": (_whole_numbers_divided, "'Div' divides whole numbers"),
    "a kernel as large as the picture": (_wide_convolution, "a step has more than"),
    "an LSTM without weights": (_sequence_lengths, "is not one that an export writes"),
    "an LSTM of 4,000 worlds": (_many_worlds, "computes more than one step of one world"),
    "a convolution without a kernel": (_no_inputs, "policy.onnx is damaged"),
    "a shape with 50,000 sides": (_long_shape, "more than 8 sides"),
    "a truth value of two": (_truth_that_is_two, "is neither 0 nor 1"),
    "an archive packed by LZMA": (_lzma, "is not compressed as an export compresses it"),
    "a key twice in the header of an array": (_key_twice_in_a_header, "parity.npz is damaged"),
    "entries that share their bytes": (_same_bytes, "has arrays in the same bytes"),
    "100,000 recorded steps": (_hundred_thousand_steps, "recorded steps take more than"),
}


@pytest.mark.parametrize("name", every(3, WAYS))
def test_a_way_by_hand_is_refused_or_loads_within_the_limits(bases: Path, tmp_path: Path, name: str) -> None:
    """Each ended in a traceback, took seconds or hundreds of megabytes, or passed; see its message."""
    change, message = WAYS[name]
    forged = _forged(bases)
    change(forged)
    if not message:
        loaded = _loaded(forged, tmp_path)
        assert loaded.start().step({entry.name: np.zeros(entry.shape) for entry in loaded.info.inputs})
        return
    with pytest.raises(BundleError) as caught:
        _loaded(forged, tmp_path)
    assert message in str(caught.value)


# Signatures


def test_a_signature_of_an_older_export_is_none_of_this_one(bases: Path, tmp_path: Path) -> None:
    forged = Forged.of(bases / "balancer")
    forged.files[bundle.SIGNATURE_NAME] = (bases / "cartpole" / bundle.SIGNATURE_NAME).read_bytes()
    forged.write(tmp_path / "forged", digests=True)
    with pytest.raises(BundleError, match="is not the file that was signed"):
        deepbots_robot.load(tmp_path / "forged", trusted=bases / "key.pub")


def test_another_signature_for_the_same_bytes_is_refused(bases: Path, tmp_path: Path) -> None:
    """The scalar of an Ed25519 signature plus the order of the group would be a second valid signature."""
    import base64

    forged = Forged.of(bases / "balancer")
    tree = json.loads(forged.files[bundle.SIGNATURE_NAME])
    content = base64.b64decode(tree["signature"])
    order = (1 << 252) + 27742317777372353535851937790883648493
    malleated = content[:32] + (int.from_bytes(content[32:], "little") + order).to_bytes(32, "little")
    forged.files[bundle.SIGNATURE_NAME] = json.dumps(
        {**tree, "signature": base64.b64encode(malleated).decode()}
    ).encode()
    forged.write(tmp_path / "forged", digests=True)
    with pytest.raises(BundleError, match="is not the file that was signed"):
        deepbots_robot.load(tmp_path / "forged", trusted=bases / "key.pub")


@pytest.mark.parametrize(
    "content", [b"[" * 9_000, b'{"format":1,"key":' + b"[" * 9_000, b'{"format":1e400}', b"\xff"]
)
def test_a_damaged_signature_is_a_sentence(bases: Path, tmp_path: Path, content: bytes) -> None:
    forged = Forged.of(bases / "balancer")
    forged.files[bundle.SIGNATURE_NAME] = content
    forged.write(tmp_path / "forged", digests=True)
    with pytest.raises(BundleError, match=r"bundle\.sig is damaged"):
        deepbots_robot.load(tmp_path / "forged", trusted=bases / "key.pub")


def test_a_pipe_instead_of_a_signature_does_not_wait(bases: Path, tmp_path: Path) -> None:
    forged = Forged.of(bases / "balancer")
    forged.last.append(
        lambda folder: ((folder / bundle.SIGNATURE_NAME).unlink(), os.mkfifo(folder / bundle.SIGNATURE_NAME))
    )
    forged.write(tmp_path / "forged", digests=True)
    with pytest.raises(BundleError, match="is not a regular file"):
        deepbots_robot.load(tmp_path / "forged", trusted=bases / "key.pub")


def test_signing_covers_all(bases: Path) -> None:
    assert deepbots_robot.load(bases / "balancer", trusted=bases / "key.pub").info.inputs
    assert signature.keys_of(bases / "key.pub")
