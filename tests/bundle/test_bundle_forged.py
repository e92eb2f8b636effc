"""Forged bundles: who writes new digests cannot make a bundle run code, read files, hang, or command beyond
its ranges."""

from __future__ import annotations

import io
import json
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import onnx
import pytest
from onnx import TensorProto, helper, numpy_helper

import deepbots_robot
from deepbots_cli.insight.templates import plain_markdown
from deepbots_robot import BundleError, bundle, model, onnx_file, signature
from tests.bundle.forged_graphs import varint
from tests.bundle.untrained import write

FLOAT = TensorProto.FLOAT


@pytest.fixture
def forged(folder: Path, tmp_path: Path) -> Path:
    """A copy to change."""
    return Path(shutil.copytree(folder, tmp_path / "forged"))


# Graphs


def _part(key: bytes, content: bytes) -> bytes:
    return key + varint(len(content)) + content


def _graph(
    *nodes: onnx.NodeProto, size: int = 4, shapes: dict[str, list[int]] | None = None, **parts: Any
) -> bytes:
    """A graph from `x` (float32 [size]) to `y`, with nodes between."""
    ends = [helper.make_tensor_value_info(name, FLOAT, [size]) for name in "xy"]
    between = [helper.make_tensor_value_info(name, FLOAT, shape) for name, shape in (shapes or {}).items()]
    graph = helper.make_graph(
        list(nodes), "g", ends[:1], ends[1:], parts.pop("weights", []), value_info=between
    )
    return helper.make_model(
        graph, opset_imports=parts.pop("opsets", [helper.make_opsetid("", 17)]), **parts
    ).SerializeToString()


def _node(operator: str = "Relu", inputs: str = "x", outputs: str = "y", **attributes: Any) -> onnx.NodeProto:
    return helper.make_node(operator, list(inputs), list(outputs), **attributes)


def _with_bytes_in_node(extra: bytes) -> bytes:
    """A graph whose only node has further bytes."""
    node = _part(b"\x0a", _node().SerializeToString() + extra)
    rest = onnx.load_from_string(_graph()).graph.SerializeToString()
    model = onnx.load_from_string(_graph())
    model.ClearField("graph")
    return model.SerializeToString() + _part(b"\x3a", node + rest)


def _outside() -> onnx.TensorProto:
    weight = numpy_helper.from_array(np.zeros(4, np.float32), "w")
    weight.data_location = TensorProto.EXTERNAL
    weight.external_data.add(key="location", value="/etc/passwd")
    return weight


def _short() -> onnx.TensorProto:
    weight = numpy_helper.from_array(np.zeros(4, np.float32), "w")
    weight.dims[0] = 1 << 30
    return weight


_INNER = helper.make_graph([], "inner", [], [])
GRAPHS: dict[str, tuple[bytes, str]] = {
    "a plain one": (_graph(_node()), ""),
    "another operator behind a field number of 33 bits": (
        _with_bytes_in_node(_part(varint((1 << 32) + (4 << 3 | 2)), b"RandomNormal")),
        "is damaged",
    ),
    "a field number that is longer than it needs to be": (
        _with_bytes_in_node(_part(varint(4 << 3 | 2, 3), b"Loop")),
        "is damaged",
    ),
    "a second operator in a node": (
        _with_bytes_in_node(_part(b"\x22", b"Relu")),
        "field 4 of a node occurs twice",
    ),
    "a field of a node that is not known": (_with_bytes_in_node(_part(b"\x42", b"x")), "field 8 of a node"),
    "a weight in another file": (
        _graph(_node(), weights=[_outside()]),
        "a weight (its numbers may be in another file)",
    ),
    "a weight with too few bytes": (
        _graph(_node(), weights=[_short()]),
        "another number of bytes than its shape",
    ),
    "a loop": (_graph(_node("Loop", body=_INNER)), "'Loop' is not one"),
    "a constant with a tensor": (_graph(_node("Constant", "", value=_outside())), "'Constant' is not one"),
    "an inner graph": (_graph(_node("Relu", body=_INNER)), "of an attribute"),
    "an operator of another domain": (_graph(_node("Relu", domain="com.evil")), "of the domain 'com.evil'"),
    "operators of another domain": (
        _graph(_node(), opsets=[helper.make_opsetid("com.evil", 1)]),
        "operators of 'com.evil'",
    ),
    "functions": (
        _graph(
            _node(), functions=[helper.make_function("d", "f", [], [], [], [helper.make_opsetid("", 17)])]
        ),
        "field 25 of the model",
    ),
    "a tensor without a shape": (
        _graph(_node("Relu", "x", "a"), _node("Relu", "a", "y")),
        "'a' has no shape",
    ),
    "a tensor that is read before it is made": (
        _graph(_node("Relu", "a", "y"), shapes={"a": [4]}),
        "that is not made before it",
    ),
    "a shape from an input": (_graph(_node("Reshape", "xx", "y")), "depends on an input"),
    "a square of 30,000": (
        _graph(
            _node("Add", "xc", "a"),
            weights=[numpy_helper.from_array(np.zeros((30_000, 1), np.float32), "c")],
            size=30_000,
            shapes={"a": [30_000, 30_000]},
        ),
        "has more than",
    ),
    "a chain of 6,000 nodes": (_graph(*[_node("Relu", "x", "y")] * 6_000), "more than 5000 nodes"),
    "work without an end": (
        _graph(
            _node("MatMul", "xw", "a"),
            _node("MatMul", "aw", "y"),
            size=1100,
            shapes={"a": [1100, 1100]},
            weights=[numpy_helper.from_array(np.zeros((1100, 1100), np.float32), "w")],
        ),
        "operations",
    ),
}


@pytest.mark.parametrize("name", GRAPHS)
def test_a_graph_is_read_strictly(name: str) -> None:
    graph, message = GRAPHS[name]
    if not message:
        assert onnx_file.require_plain(graph) > 0
        return
    with pytest.raises(BundleError) as caught:
        onnx_file.require_plain(graph)
    assert message in str(caught.value)


def test_a_shape_that_is_not_that_of_the_operator_is_refused_by_onnxruntime(
    folder: Path, forged: Path
) -> None:
    loaded = deepbots_robot.load(folder)
    graph = onnx.load_from_string((folder / bundle.GRAPH_NAME).read_bytes())
    value = next(each for each in graph.graph.value_info if len(each.type.tensor_type.shape.dim) == 1)
    value.type.tensor_type.shape.dim[0].dim_value += 1
    write(forged, loaded.info, graph.SerializeToString(), (folder / bundle.PARITY_NAME).read_bytes())
    with pytest.raises(BundleError, match=r"cannot be run by onnxruntime"):
        deepbots_robot.load(forged)


# bundle.json


def _output(**changes: Any) -> Callable[[dict[str, Any]], None]:
    return lambda tree: tree["outputs"][0].update(changes)


def _top(**changes: Any) -> Callable[[dict[str, Any]], None]:
    return lambda tree: tree.update(changes)


def _topic(**changes: Any) -> Callable[[dict[str, Any]], None]:
    topic = {"topic": "/a", "type": "std_msgs/Float64", "part": None} | changes
    return lambda tree: tree.update(ros={topic.pop("name", tree["outputs"][0]["name"]): topic})


def _memories(tree: dict[str, Any]) -> None:
    memory = {"shape": [4096, 4096], "dtype": "float64", "initial": [0]}
    tree["memory"] += [{"name": f"m{number}", **memory} for number in range(400)]


DESCRIPTIONS: dict[str, tuple[Callable[[dict[str, Any]], None], str]] = {
    "a negative rate": (_output(max_rate=[-5, -5]), "Expected `float` >= 0"),
    "a negative effort": (_output(max_effort=[-1, -1]), "Expected `float` >= 0"),
    "too few rates": (_output(max_rate=[]), "has 0 max_rate and the shape [2]"),
    "a joint twice": (_output(joints=["left_wheel", "left_wheel"]), "has a joint twice"),
    "too many joints": (_output(joints=["a", "b", "c"]), "has 3 joints and the shape [2]"),
    "too many efforts": (_output(max_effort=[1, 1, 1]), "has 3 max_effort"),
    "a rate of 1e12": (_top(rate_hz=1e12, timestep_s=1e-12), "<= 10000"),
    "a rate of 1e-12": (_top(rate_hz=1e-12, timestep_s=1e12), ">= 0.01"),
    "a topic of nothing": (_topic(name="nothing"), "'nothing' has a topic"),
    "a topic of an unknown type": (_topic(type="std_msgs/Evil"), "the unknown type 'std_msgs/Evil'"),
    "51 GB of memories": (_memories, "more than 4000000 numbers together"),
    "a file outside of the bundle": (
        lambda tree: tree["files"].update({"../x": "0" * 64}),
        "'../x' is not a path in a bundle",
    ),
    "a file at a fixed place": (
        lambda tree: tree["files"].update({"/etc/passwd": "0" * 64}),
        "is not a path in a bundle",
    ),
    "no digest of the scenario": (
        lambda tree: tree["files"].pop("scenario.yaml"),
        "no digest of scenario.yaml",
    ),
}


@pytest.mark.parametrize("name", DESCRIPTIONS)
def test_a_description_that_no_export_writes_is_refused(forged: Path, name: str) -> None:
    change, message = DESCRIPTIONS[name]
    file = forged / bundle.BUNDLE_NAME
    tree = json.loads(file.read_bytes())
    change(tree)
    file.write_text(json.dumps(tree))
    with pytest.raises(BundleError) as caught:
        deepbots_robot.load(forged)
    assert message in str(caught.value)


# parity.npz


def _parity_with(name: str, array: Any) -> Callable[[dict[str, Any]], None]:
    return lambda arrays: arrays.update({name: array(arrays[name])})


PARITIES: dict[str, tuple[Callable[[dict[str, Any]], None], str]] = {
    "strings": (_parity_with("output/action", lambda rows: np.full(len(rows), "a")), "another shape or type"),
    "records": (
        _parity_with("output/scores", lambda rows: np.zeros(rows.shape, [("a", "f4")])),
        "another shape or type",
    ),
    "no numbers": (_parity_with("output/scores", lambda rows: rows[:, :0]), "another shape or type"),
    "scores that are not numbers": (
        _parity_with("output/scores", lambda rows: rows * np.nan),
        "is not finite",
    ),
    "infinite scores": (
        _parity_with("output/scores", lambda rows: rows + np.float32("inf")),
        "is not finite",
    ),
    "starts out of order": (_parity_with("starts", lambda rows: np.array([0, 5, 5])), "not in order"),
}


@pytest.mark.parametrize("name", PARITIES)
def test_recorded_steps_that_prove_nothing_are_refused(choosing: Path, tmp_path: Path, name: str) -> None:
    """NaN scores made every step a tie, and other types ended in a traceback."""
    change, message = PARITIES[name]
    loaded = deepbots_robot.load(choosing)
    with np.load(choosing / bundle.PARITY_NAME) as archive:
        arrays = dict(archive)
    change(arrays)
    stream = io.BytesIO()
    np.savez(stream, **arrays)
    write(tmp_path, loaded.info, (choosing / bundle.GRAPH_NAME).read_bytes(), stream.getvalue())
    with pytest.raises(BundleError) as caught:
        deepbots_robot.load(tmp_path)
    assert message in str(caught.value)


# Files beside the graph


@pytest.mark.parametrize("name", [bundle.README_NAME, bundle.SCENARIO_NAME])
def test_a_file_that_a_person_works_by_is_the_one_that_was_exported(forged: Path, name: str) -> None:
    (forged / name).write_text("limits: none\n")
    with pytest.raises(BundleError, match=f"{name} is not the file that was exported"):
        deepbots_robot.load(forged)


@pytest.mark.parametrize("name", [bundle.GRAPH_NAME, bundle.README_NAME, "inputs"])
def test_links_are_refused(forged: Path, tmp_path: Path, name: str) -> None:
    """`serve --log` copied the files behind a linked folder `inputs` into the log."""
    elsewhere = tmp_path / "elsewhere"
    if name == "inputs":
        elsewhere.mkdir()
        (elsewhere / "secret").write_text("secret")
        file = forged / bundle.BUNDLE_NAME
        tree = json.loads(file.read_bytes())
        tree["files"]["inputs/secret"] = "2bb80d537b1da3e38bd30361aa855686bde0eacd7162fef6a25fe97bf527a25b"
        file.write_text(json.dumps(tree))
    else:
        shutil.move(forged / name, elsewhere)
    (forged / name).symlink_to(elsewhere)
    with pytest.raises(BundleError, match=r"is reached through a symbolic link"):
        deepbots_robot.load(forged)


# Signatures


@pytest.fixture(scope="module")
def key(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("keys") / "key"
    signature.write_key(path)
    return path


@pytest.fixture
def signed(forged: Path, key: Path) -> Path:
    content = (forged / bundle.BUNDLE_NAME).read_bytes()
    (forged / bundle.SIGNATURE_NAME).write_bytes(signature.sign(content, key))
    return forged


def _public(key: Path) -> Path:
    return key.with_name(f"{key.name}.pub")


def test_a_signed_bundle_loads_with_its_key_and_a_key_is_private_and_never_overwritten(
    signed: Path, key: Path, tmp_path: Path
) -> None:
    assert deepbots_robot.load(signed, trusted=_public(key)).operations > 0
    other_key = signature.write_key(tmp_path / "other").read_text()
    assert (
        deepbots_robot.load(
            signed, trusted=["# keys of the lab", other_key, f"{_public(key).read_text().strip()} bench"]
        ).folder
        == signed
    )
    assert key.stat().st_mode & 0o077 == 0
    with pytest.raises(signature.KeyFileError, match="a key is never overwritten"):
        signature.write_key(key)


def _changed_description(folder: Path) -> None:
    loaded = deepbots_robot.load(folder)
    changed = msgspec.structs.replace(
        loaded.info, training=msgspec.structs.replace(loaded.info.training, seed=7)
    )
    graph = onnx.load_from_string((folder / bundle.GRAPH_NAME).read_bytes())
    helper.set_model_props(graph, {bundle.METADATA_KEY: bundle.description_digest(changed)})
    write(folder, changed, graph.SerializeToString(), (folder / bundle.PARITY_NAME).read_bytes())


def _other_key(folder: Path) -> None:
    signature.write_key(folder / "mine")
    (folder / bundle.SIGNATURE_NAME).write_bytes(
        signature.sign((folder / bundle.BUNDLE_NAME).read_bytes(), folder / "mine")
    )


def _borrowed_key(folder: Path) -> None:
    """The name of the trusted key, and the signature of another one."""
    trusted = msgspec.json.decode((folder / bundle.SIGNATURE_NAME).read_bytes())["key"]
    _other_key(folder)
    own = msgspec.json.decode((folder / bundle.SIGNATURE_NAME).read_bytes())
    (folder / bundle.SIGNATURE_NAME).write_bytes(msgspec.json.encode(own | {"key": trusted}))


FORGERIES: dict[str, tuple[Callable[[Path], object], str]] = {
    "new digests": (_changed_description, "is not the file that was signed"),
    "another key": (_other_key, "a key that is not trusted"),
    "the name of the key": (_borrowed_key, "is not the file that was signed"),
    "no signature": (lambda folder: (folder / bundle.SIGNATURE_NAME).unlink(), "bundle.sig is missing"),
    "another format": (
        lambda folder: (folder / bundle.SIGNATURE_NAME).write_text("{}"),
        "bundle.sig is damaged",
    ),
    "other weights": (
        lambda folder: (folder / bundle.GRAPH_NAME).write_bytes(b"\x00"),
        "is not the file that was exported",
    ),
}


@pytest.mark.parametrize("name", FORGERIES)
def test_without_the_key_nothing_can_be_changed(signed: Path, key: Path, name: str) -> None:
    forge, message = FORGERIES[name]
    forge(signed)
    if name in ("new digests", "another key"):  # digests alone stop accidents, not forgers
        assert deepbots_robot.load(signed).folder == signed
    with pytest.raises(BundleError) as caught:
        deepbots_robot.load(signed, trusted=_public(key))
    assert message in str(caught.value)


@pytest.mark.parametrize("trusted", [[], ["ssh-rsa AAAA"], ["nonsense"], "missing.pub"])
def test_keys_that_are_none_are_refused(signed: Path, trusted: Any) -> None:
    with pytest.raises(BundleError, match="trusted key"):
        deepbots_robot.load(signed, trusted=trusted)


def _files(folder: Path) -> Iterator[Path]:
    return (path for path in sorted(folder.rglob("*")) if path.is_file())


def test_a_bundle_has_no_file_without_a_digest(folder: Path) -> None:
    info = model.decode((folder / bundle.BUNDLE_NAME).read_bytes())
    names = {path.relative_to(folder).as_posix() for path in _files(folder)}
    assert names == {bundle.BUNDLE_NAME, *info.files}


def test_a_name_from_a_scenario_is_not_markup_in_the_readme() -> None:
    """`<script>` passed into README.md, by whose limits a person works."""
    text = plain_markdown("a <script>x</script> [link](javascript:x) `code`\n# Limits: none")
    assert not set("<>[]`#\n") & set(text.replace("&#", "&"))
    assert text.startswith("a &#60;script&#62;x")
