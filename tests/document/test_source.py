"""Text to nodes: values, places, and findings about text whose meaning differs from its look.

Whole documents: reading files, `extends`, `include`, `remove`, `--set`, and which files may be read.

Edits that keep the other text of a file: moved and set entries, their comments and line ends.

Any text at all: no exception, no hang, every place inside the text, and the values that YAML gives.

The canonical layout changes white space only and keeps comments and columns. Shipped files have it.
"""

from __future__ import annotations

import json
import os
import tracemalloc
from itertools import pairwise
from pathlib import Path, PureWindowsPath
from typing import Any, cast

import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from deepbots_cli.diagnostics import Finding, Findings, Source, Span, edited
from deepbots_cli.diagnostics.render import render
from deepbots_cli.document import (
    Document,
    MappingNode,
    Node,
    Permissions,
    ScalarNode,
    SequenceNode,
    descend,
    load,
    loads,
    shipped,
    to_data,
    walk,
)
from deepbots_cli.document.files import UnusableFile, project_root, resolve_reference
from deepbots_cli.document.layout import (
    assigned_text,
    canonical_text,
    move_to_augment_fix,
    removal_fix,
    to_yaml,
)
from deepbots_cli.document.load import shipped_summaries
from deepbots_cli.document.nodes import NodePath, node_at
from deepbots_cli.document.parse import parse
from deepbots_cli.errors import UsageError
from deepbots_cli.files import read_at_most
from tests.files import written
from tests.golden.cases import documents, mistakes


def read(text: str) -> tuple[Node | None, list[Finding]]:
    findings = Findings()
    return parse(Source("test.yaml", text), findings), list(findings)


def value(text: str) -> object:
    node, _ = read(f"key: {text}\n")
    assert isinstance(node, MappingNode)
    return to_data(node).get("key")  # type: ignore[attr-defined]


def data_at(root: Node | None, *path: str | int) -> object:
    node = node_at(root, *path)
    return None if node is None else to_data(node)


def only_finding(text: str) -> Finding:
    _, findings = read(text)
    assert len(findings) == 1, [f.headline for f in findings]
    return findings[0]


def scalar(text: str, *path: str | int) -> ScalarNode:
    node, _ = read(text)
    assert node is not None
    node, _, _ = descend(node, path)
    assert isinstance(node, ScalarNode)
    return node


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("3e-4", 3e-4),
        ("1.", 1.0),
        (".5", 0.5),
        ("-1e3", -1000.0),
        ("12", 12),
        ("+12", 12),
        ("100_000", 100_000),
        ("-1_000_000", -1_000_000),
        ("true", True),
        ("False", False),
        ("on", "on"),
        (".inf", ".inf"),
        (".nan", ".nan"),
        ("'12'", "12"),
        ('""', ""),
        ("-0.4 .. 0.4 m", "-0.4 .. 0.4 m"),
        ("10 N*m", "10 N*m"),
        ("[wheel_*]", ["wheel_*"]),
        ("{}", {}),
    ],
)
def test_scalars_follow_yaml_1_2_with_decimal_numbers(text: str, expected: object) -> None:
    scalar_value = value(text)
    assert scalar_value == expected
    assert type(scalar_value) is type(expected)


def test_keys_and_values_know_where_they_begin_and_end() -> None:
    text = "größe: 1\nlist: [a, {b: 'c d'}]\nend:\n  deep: x  # why\n"
    node, findings = read(text)
    assert not findings
    assert isinstance(node, MappingNode)
    assert (node.entries["größe"].key.span.text, node.entries["list"].value.span.text) == (
        "größe",
        "[a, {b: 'c d'}]",
    )
    assert (node.entries["end"].value.span.text, scalar(text, "list", 1, "b").span.text) == (
        "deep: x",
        "'c d'",
    )
    assert scalar(text, "end", "deep").span.start_position == (4, 9)
    assert node.span.text == text[: text.index("  #")]


def test_the_span_of_a_value_leaves_out_its_anchor() -> None:
    text = "a: &one\n  b: &two 1\nc: &three [x]\nd: *one\n"
    node, findings = read(text)
    assert not findings
    assert isinstance(node, MappingNode)
    assert (node.entries["a"].value.span.text, scalar(text, "a", "b").span.text) == ("b: &two 1", "1")
    assert (node.entries["c"].value.span.text, to_data(node.entries["d"].value)) == ("[x]", {"b": 1})


@pytest.mark.parametrize(
    ("text", "word"),
    [
        ("a: plain words here", "words"),
        ("a: plain\n  goes on\n  here", "here"),
        ('a: "quoted \\u00e9\\t words"', "words"),
        ('a: "joined \\\n   words"', "words"),
        ("a: 'it''s words'", "words"),
        ("a: |\n  first line\n  words", "words"),
        ("a: |+\n\n    more\n      words\n\n", "words"),
        ("a: >-\n  folded\n  lines\n\n  words", "words"),
        ("a: äöü 日本 words", "words"),
        ('a: "äöü\n   日本 words"', "words"),
    ],
)
@pytest.mark.parametrize("line_end", ["\n", "\r\n"])
def test_a_piece_of_a_text_has_an_exact_place(text: str, word: str, line_end: str) -> None:
    text = text.replace("\n", line_end)
    node = scalar(text, "a")
    start = node.text.index(word)
    assert node.part(start, start + len(word)).text == word
    assert node.part(start, start + len(word)).start == text.index(word)


def test_a_block_of_text_begins_below_its_sign_and_ends_before_the_blank_lines_behind_it() -> None:
    assert scalar("a: |\n  one\n  two\n\n\nb: 1", "a").span.text == "one\n  two"


@pytest.mark.parametrize(
    ("text", "code", "marked", "hint"),
    [
        *mistakes("document"),
        pytest.param("a: " + "9" * 5000, "DB105", "9" * 5000, "smaller", id="5000 digits"),
    ],
)
def test_a_trap_gets_one_finding_at_its_place_that_says_what_to_write(
    text: str, code: str, marked: str, hint: str
) -> None:
    finding = only_finding(text)
    assert (finding.code, finding.span.text) == (code, marked)
    assert hint in (finding.help or "")
    assert finding.headline[0] != finding.headline[0].upper() or not finding.headline[0].isalpha()
    assert not finding.headline.endswith(".")


@pytest.mark.parametrize(
    "text",
    ["a: y", "a: n", "a: 'on'", 'a: "0777"', "a: 1.5", "a: -0", "on: 1", "a: 10:b", "a: 0 5 10", "a: 1e3"],
)
def test_values_that_mean_what_they_seem_to_are_not_reported(text: str) -> None:
    assert read(text)[1] == []


def test_a_key_that_had_to_be_left_out_marks_its_mapping_as_partial() -> None:
    node, _ = read("a: {b: , c: 1}\nd: 1\n")
    assert isinstance(node, MappingNode)
    inner = node.get("a")
    assert isinstance(inner, MappingNode)
    assert inner.partial
    assert not node.partial


ALIASES = "".join(
    f"{name}: &{name} [{','.join([f'*{inner}'] * 9)}]\n" for inner, name in pairwise("abcdefghi")
)


@pytest.mark.parametrize(
    "text",
    [
        *(unit * 100_000 for unit in ("[", "{", "- ", "? ", "[a: ", "{a: ", "{? ", "[\n", "- - ", "? - ")),
        *(unit * 100_000 for unit in ("a: ", "&a ", "!a ", "}")),
        "\n".join(" " * i + "a:" for i in range(1400)),
        "[" * 65 + "]" * 65,
        "[" + "1," * 8_001 + "]",
        # Aliases are counted before they are expanded, and do not build deeper trees.
        "a: &a [x,x,x,x,x,x,x,x,x]\n" + ALIASES,
        "[&b0 []," + ",".join(f"&b{i + 1} [*b{i}]" for i in range(100)) + "]",
        "a: &a [*a]",
    ],
)
def test_any_depth_and_any_amount_of_repetition_end_in_one_finding(text: str) -> None:
    assert only_finding(text).code in ("DB001", "DB005")


def test_64_levels_and_thousands_of_values_are_allowed() -> None:
    assert read("[" * 64 + "]" * 64)[1] == read("[" + "1," * 7_900 + "]")[1] == []


@pytest.mark.parametrize(
    "text",
    [
        "a: {b: [1, 'x y'], c: \"d\\u00e9\"}\nlong:\n  - one\n  - two words\n  # note\n  - |\n    block\n   "
        " text\n",
        "anchors: &x {y: 1}\nagain: *x\nfolded: >\n  a\n  b\n\nlast: 1 # c\n",
    ],
)
def test_the_parser_in_python_gives_the_same_nodes_as_the_one_in_c(
    monkeypatch: pytest.MonkeyPatch, text: str
) -> None:
    trees = []
    for loader in (yaml.CBaseLoader, yaml.BaseLoader):
        monkeypatch.setattr("deepbots_cli.document.syntax_hints.LOADER", loader)
        node, _ = read(text)
        assert node is not None
        trees.append(contents(node))
    assert trees[0] == trees[1]


def contents(node: Node) -> object:
    """The contents of a tree, with the place of every character."""
    place = node.span.start, node.span.end
    match node:
        case ScalarNode(_, text, value, style, offsets):
            return place, text, value, style, None if offsets is None else [*offsets]
        case SequenceNode(_, items):
            return place, [contents(item) for item in items]
        case MappingNode(_, entries):
            return place, [(contents(key), contents(value)) for key, value in entries.values()]


@pytest.mark.parametrize(
    ("text", "code", "marked", "help", "data"),
    [
        (
            "{max_steps: 2,000}",
            "DB001",
            "2,000",
            "write a decimal point, `2.000`, or group the digits, `2_000`",
            {},
        ),
        ("{3: a}", "DB103", "3", 'put it in quotes: "3"', {}),
        ("{x: 5 cm, y: -1,5 cm}", "DB001", "-1,5 cm", "write a decimal point: `-1.5 cm`", {"x": "5 cm"}),
        (
            "{x: 5 cm, y: -0,5 .. 0,5 m}",
            "DB001",
            "-0,5 .. 0,5 m",
            "write a decimal point: `-0.5 .. 0.5 m`",
            {"x": "5 cm"},
        ),
        ("{x: 5 cm, y: 0,99}", "DB001", "0,99", "write a decimal point: `0.99`", {"x": "5 cm"}),
        ("{x: 5 cm, y: a1,5 cm}", "DB107", "5 cm", None, {"x": "5 cm", "y": "a1"}),
        (
            "{y: uniform(1, # the lowest\n 3)}",
            "DB001",
            "uniform(1, # the lowest\n 3)",
            "write the draw without a comma: `uniform(1 .. 3)`",
            {},
        ),
    ],
)
def test_a_number_with_a_comma_in_braces_is_not_reported_as_a_key(
    text: str, code: str, marked: str, help: str | None, data: dict[str, str]
) -> None:
    node, (finding,) = read(text)
    assert (finding.code, finding.span.text, to_data(node)) == (code, marked, data)
    assert help in (None, finding.help)
    assert finding.fix is None or not {"2,000", "#"} & {*text.replace("}", " ").split()}


def write(folder: Path, **files: str) -> Path:
    """Files named by their stem; the first one is returned."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, text in files.items():
        (folder / f"{name}.yaml").write_text(text, encoding="utf-8")
    return folder / f"{next(iter(files))}.yaml"


def data(document: Document) -> object:
    assert document.root is not None, [f.headline for f in document.findings]
    assert not list(document.findings), [f.headline for f in document.findings]
    return to_data(document.root)


def codes(document: Document) -> list[str]:
    return [finding.code for finding in document.findings]


@pytest.mark.parametrize("case", documents().values(), ids=documents())
def test_files_are_read_as_one_document(tmp_path: Path, case: dict[str, Any]) -> None:
    for name, text in case["files"].items():
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text(text, encoding="utf-8")
    document = load(tmp_path / next(iter(case["files"])), case.get("set", ()))
    expected = case.get("findings", [])
    assert len(document.findings) == len(expected), [finding.headline for finding in document.findings]
    for finding, (code, *rest) in zip(document.findings, expected, strict=True):
        marked, help, notes, headline = [*rest, *("", "", [], "")[len(rest) :]]
        assert (finding.code, finding.span.text) == (code, marked or finding.span.text)
        assert help in (finding.help or "")
        assert notes in ([], [*finding.notes])
        assert headline in finding.headline
    data = to_data(document.root) if document.root else {}
    if "data" in case:
        assert json.dumps(data) == json.dumps(case["data"])
    assert {key: data.get(key) for key in case.get("part", {})} == case.get("part", {})
    sources = [Path(source.name).name for source in document.sources]
    assert case.get("sources", sources) == sources


# Reading


def test_a_missing_file_a_folder_and_a_pipe_are_wrong_usage(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    for path in (tmp_path / "none.yaml", tmp_path, tmp_path / "pipe", tmp_path / ("x" * 300), Path("a\0b")):
        with pytest.raises(UsageError) as raised:
            load(path)
        assert "\n" not in str(raised.value)


@pytest.mark.parametrize(
    ("content", "code", "where"),
    [
        (b"", "DB107", (1, 1)),
        (b"a: \x00\x01", "DB001", (1, 4)),
        (b"\x7fELF\x02\x01\x00\x00", "DB001", (1, 1)),
        ("a: é".encode("latin-1"), "DB001", (1, 4)),
        ("ä: é\nb: ".encode() + b"\xff", "DB001", (2, 4)),
        ("a: 1".encode("utf-16"), "DB001", (1, 1)),
        (b"a: 1\rb: 2", "DB001", (1, 5)),
        ("a: 1\u2028b: 2".encode(), "DB001", (1, 5)),
        (b"a: 1\n" * 300_000, "DB005", (1, 1)),
        (b"just text", "DB103", (1, 1)),
        (b"- a\n- b", "DB103", (1, 1)),
    ],
)
def test_a_file_that_is_not_a_scenario_gets_one_finding_at_the_place(
    tmp_path: Path, content: bytes, code: str, where: tuple[int, int]
) -> None:
    document = load(written(tmp_path / "a.yaml", content), display="a.yaml")
    assert document.root is None
    assert [(f.code, f.span.start_position, f.span.source.name) for f in document.findings] == [
        (code, where, "a.yaml")
    ]


def test_a_byte_order_mark_and_windows_line_ends_are_read(tmp_path: Path) -> None:
    document = load(written(tmp_path / "a.yaml", "\ufeffa: 1\r\nb:\r\n  c: 2\r\n".encode()))
    assert data(document) == {"a": 1, "b": {"c": 2}}
    assert document.root is not None
    assert document.root.entries["b"].value.span.start_position == (3, 3)


# extends, include, remove


def test_paths_are_relative_to_the_file_that_wrote_them(tmp_path: Path) -> None:
    (tmp_path / "robots").mkdir()
    (tmp_path / "robots" / "epuck.yaml").write_text("urdf: epuck.urdf\n")
    document = load(write(tmp_path, main="r: {include: robots/epuck.yaml}\n"), ["r.extra=mine.urdf"])
    robot = document.root.get("r") if document.root else None
    assert isinstance(robot, MappingNode)
    assert document.directory_of(robot.entries["urdf"].value.span) == tmp_path / "robots"
    assert document.directory_of(robot.span) == tmp_path
    assert document.directory_of(robot.entries["extra"].value.span) == Path.cwd()


def test_a_finding_in_an_included_file_has_the_chain_of_inclusions(tmp_path: Path) -> None:
    (finding,) = load(write(tmp_path, main="r:\n  include: part.yaml\n", part="a: 1\na: 2\n")).findings
    included_from = finding.span.source.included_from
    assert finding.span.source.name.endswith("part.yaml")
    assert included_from is not None
    assert included_from.start_position == (2, 12)


@pytest.mark.parametrize(
    "reference",
    ["/etc/passwd", "../../secret.yaml", "link.yaml", "~/x.yaml", '"a\\0b"', "x" * 5000, ".", "loop"],
)
def test_no_reference_leads_out_of_the_project(tmp_path: Path, reference: str) -> None:
    project = tmp_path / "far" / "project"
    (tmp_path / "secret.yaml").write_text("password: 1\n")
    path = write(project, main=f"extends: {reference}\n")
    (project / "link.yaml").symlink_to(tmp_path / "secret.yaml")
    (project / "loop").symlink_to(project / "loop")
    document = load(path)
    assert codes(document) == ["DB204"]
    assert document.root is None
    assert len(document.sources) == 1


def test_a_symbolic_link_that_leads_outside_is_called_one(tmp_path: Path) -> None:
    (tmp_path / "secret.yaml").write_text("password: 1\n")
    path = write(tmp_path / "project", main="extends: link.yaml\n")
    (tmp_path / "project" / "link.yaml").symlink_to(tmp_path / "secret.yaml")
    (finding,) = load(path).findings
    assert finding.headline == "`link.yaml` leads outside the project through a symbolic link"
    path.write_text("extends: ../secret.yaml\n")
    (finding,) = load(path).findings
    assert finding.headline == "`../secret.yaml` lies outside the project"


def test_allowed_paths_may_be_read(tmp_path: Path) -> None:
    path = write(tmp_path / "project", main="extends: ../shared/base.yaml\n")
    shared = write(tmp_path / "shared", base="a: 1\n").parent
    assert codes(load(path)) == ["DB204"]
    for allowed in ([shared], [str(shared)], str(shared), shared):
        assert data(load(str(path), permissions=Permissions(allowed))) == {"a": 1}


def test_the_project_is_the_nearest_folder_with_a_marker(tmp_path: Path) -> None:
    (tmp_path / "deepbots.toml").touch()
    path = write(tmp_path / "deep" / "down", main="extends: ../../base.yaml\n")
    write(tmp_path, base="a: 1\n")
    assert (project_root(path.parent), data(load(path))) == (tmp_path, {"a": 1})


def test_shipped_files_may_be_read_from_anywhere(tmp_path: Path) -> None:
    for root in shipped.data_roots():
        for path in root.rglob("*.*"):
            assert resolve_reference(str(path), tmp_path, shipped.data_roots()) == path
    assert isinstance(
        resolve_reference(str(shipped.data_dir() / "pyproject.toml"), tmp_path, shipped.data_roots()),
        UnusableFile,
    )


def test_a_file_on_another_drive_of_windows_is_outside() -> None:
    project, other = cast(list[Path], [PureWindowsPath("C:/project"), PureWindowsPath("D:/arm.urdf")])
    assert "or copy the file into C:" in UnusableFile("outside", "D:/arm.urdf", other, (project,)).help


@pytest.mark.parametrize("name", ["../x", "", "a/b", "x" * 10_000, "a\0", "nothing-like-it"])
def test_an_unknown_name_is_not_a_shipped_file(name: str) -> None:
    assert shipped.scenario_path(name) is None
    assert shipped.robot_path(name) is None


def test_many_files_cannot_expand_beyond_the_limit(tmp_path: Path) -> None:
    files = {f"f{i}": "\n".join(f"k{j}: {{include: f{i + 1}.yaml}}" for j in range(10)) for i in range(10)}
    assert "DB005" in codes(load(write(tmp_path, **files, f10="a: 1\n")))


def test_a_long_chain_of_files_is_refused(tmp_path: Path) -> None:
    path = write(tmp_path, **{f"f{i}": f"extends: f{i + 1}.yaml\n" for i in range(100)}, f100="a: 1\n")
    assert codes(load(path)) == ["DB204"]


# --set

BASE = (
    "parameters: {pole: 1, track: 2 m}\nworld: {timestep: 32 ms, arena: {size: 1 m}}\nobservation:"
    " {cart.pole: 1, x: 2}\nlist: [a, b]\n"
)


def test_an_assigned_value_has_its_place_in_the_assignment() -> None:
    document = loads(BASE, overrides=["world.timestep=8 ms"])
    world = document.root.get("world") if document.root else None
    assert isinstance(world, MappingNode)
    span = world.entries["timestep"].value.span
    assert (span.text, span.location) == ("8 ms", "--set world.timestep:1:16")


@pytest.mark.parametrize(
    ("assignment", "code", "marked", "hint"),
    [
        ("poel=3", "DB201", "poel", "did you mean `pole`?"),
        ("wrld.timestep=3", "DB201", "wrld", "did you mean `world`?"),
        ("world.arena.size.x=3", "DB201", "x", "whole value"),
        ("world.area.size=3", "DB201", "area", "did you mean `arena`?"),
        ("world..x=3", "DB201", ".", "there are"),
        ("world.arena.door.width=3", "DB201", "door", "set it whole: `world.arena.door={width: ...}`"),
        ("pole", "DB107", "pole", "path=value"),
        ("pole=", "DB107", "pole=", "path=value"),
        ("pole=null", "DB107", "pole", "no null"),
        ("pole= #fff", "DB107", "pole= #fff", "quotes"),
        ("=3", "DB102", "=3", "path=value"),
        ("pole=a: b: c", "DB001", ":", "quotes"),
        ("pole=[[", "DB001", "[", "closing"),
        ("pole=*x", "DB001", "*x", "quotes"),
        ("pole=\x1b", "DB001", "\x1b", "escape"),
        ("pole=\udc80", "DB001", "\udc80", "remove it"),
    ],
)
def test_an_assignment_that_cannot_be_made_is_reported_in_its_own_text(
    assignment: str, code: str, marked: str, hint: str
) -> None:
    document = loads(BASE, overrides=[assignment])
    (finding,) = document.findings
    assert (finding.code, finding.span.text) == (code, marked)
    assert finding.span.source.name == f"--set {assignment.partition('=')[0] or assignment}"
    assert hint in (finding.help or "")
    assert document.root is not None
    assert to_data(document.root) == to_data(loads(BASE).root)  # type: ignore[arg-type]


def test_extends_takes_the_name_of_a_shipped_scenario_and_a_file_of_that_name_comes_first(
    tmp_path: Path,
) -> None:
    path = write(tmp_path, main="deepbots: 1\nextends: cartpole\nname: Mine\n")
    shipped_root = data(load(Path(shipped.scenario_path("cartpole") or "")))
    document = load(path)
    assert data(document) == {key: value for key, value in shipped_root.items() if key != "tests"} | {
        "name": "Mine"
    }
    assert [source.name.split("/")[-1] for source in document.sources] == ["main.yaml", "cartpole.yaml"]
    (tmp_path / "cartpole").write_text("a: 1\n")
    assert data(load(path)) == {"deepbots": 1, "name": "Mine", "a": 1}


def test_a_folder_to_be_allowed_that_is_not_there_is_wrong_usage(tmp_path: Path) -> None:
    file = write(tmp_path, a="deepbots: 1\n")
    with pytest.raises(UsageError, match="is not a folder"):
        load(file, permissions=Permissions([tmp_path / "nowhere"]))


# Files are read up to a limit, and memory is asked for by what they hold


@pytest.mark.parametrize(
    ("size", "most"), [(0, 5), (4, 5), (5, 5), (6, 5), (70_000, 5), (70_000, 70_001), (70_000, 1 << 25)]
)
def test_a_file_is_read_to_its_end_or_to_the_limit(tmp_path, size, most):
    data = bytes(number % 251 for number in range(size))
    (tmp_path / "file").write_bytes(data)
    assert read_at_most(tmp_path / "file", most) == data[:most]


@pytest.mark.skipif(not Path("/proc/version").exists(), reason="no file here says less than it holds")
def test_a_file_that_says_that_it_is_empty_is_read_all_the_same():
    whole = Path("/proc/version").read_bytes()
    assert Path("/proc/version").stat().st_size == 0 < len(whole)
    assert (read_at_most(Path("/proc/version"), 1000), read_at_most(Path("/proc/version"), 3)) == (
        whole,
        whole[:3],
    )


def test_a_small_file_takes_no_memory_for_the_largest_that_might_be(tmp_path):
    (tmp_path / "file").write_text("deepbots: 1\n")
    tracemalloc.start()
    try:
        read_at_most(tmp_path / "file", 1 << 25)
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert peak < 1 << 20


def root_of(text: str) -> MappingNode:
    root = loads(text, "file.yaml").root
    assert root is not None
    return root


def moved(text: str, name: str = "a") -> str:
    fix = move_to_augment_fix(root_of(text), name)
    assert fix is not None
    return edited(Source("file.yaml", text), fix.edits)


@pytest.mark.parametrize(
    ("before", "after"),
    [
        ("signals:\n  a: x  # note\naugment:\n  b: y\n", "augment:\n  b: y\n  a: x  # note\n"),
        (
            "augment:\n  b: y\nsignals:\n  c: z\n  a: x  # note",
            "augment:\n  b: y\n  a: x  # note\nsignals:\n  c: z\n",
        ),
        (
            "augment:\n  b: y\nsignals:\n  a: x  # note\nname: n\n",
            "augment:\n  b: y\n  a: x  # note\nname: n\n",
        ),
        (
            "signals:\n  # of b\n\n  # of a,\n  # again\n  a: x\n  # of c\n  c: z\n",
            "augment:\n  # of a,\n  # again\n  a: x\nsignals:\n  # of b\n\n  # of c\n  c: z\n",
        ),
        ("augment: {b: y}\nsignals: {a: x, c: z}\n", "augment: {b: y, a: x}\nsignals: {c: z}\n"),
        (
            "signals:\r\n  a: x\r\n  c: z\r\nname: n\r\n",
            "augment:\r\n  a: x\r\nsignals:\r\n  c: z\r\nname: n\r\n",
        ),
        ("augment: [b]\nsignals:\n  a: x\n", "augment: [b, a]\nsignals:\n  a: x\n"),
    ],
)
def test_a_signal_moves_to_augment_with_its_comments(before: str, after: str) -> None:
    assert moved(before) == after


@pytest.mark.parametrize(
    ("before", "value", "after"),
    [
        ("name: n  # why\n", "'p # set q'", "name: 'p # set q'  # why  # set by x\n"),
        ("name: n  # set by y\n", "p", "name: p  # set by x\n"),
        ("name: n\r\nother: 1\r\n", "p", "name: p  # set by x\r\nother: 1\r\n"),
        ("name: |\n  n\n", "p", None),
    ],
)
def test_a_value_is_set_with_a_comment_behind_it(before: str, value: str, after: str | None) -> None:
    root = root_of(before)
    assert assigned_text(root, root.span.source, ("name",), value, "set by x") == after


def test_a_value_that_an_alias_repeats_is_set_without_a_change_of_its_anchor() -> None:
    before = "limits: &l {low: 1, high: 2}\nparameters: {fall: &x 12 deg, other: *x, all: *l}\n"
    root = root_of(before)
    text = assigned_text(root, root.span.source, ("parameters", "other"), "5 deg", "")
    assert text == before.replace("*x", "5 deg")
    text = assigned_text(root, root.span.source, ("parameters", "all", "low"), "3", "")
    assert text == before.replace("low: 1", "low: 3")


def test_an_entry_with_an_anchor_that_is_used_stays() -> None:
    root = root_of("parameters:\n  used: &x 12 deg\n  unused: &y 12 deg\n  fall: *x\n")
    fixes = [removal_fix(root, ("parameters", name)) for name in ("used", "unused")]
    assert [fix is None for fix in fixes] == [True, False]


def test_a_new_section_has_the_line_ends_of_the_file() -> None:
    root = root_of("name: n\r\n")
    assert assigned_text(root, root.span.source, ("train", "gamma"), "0.9", "") == (
        "name: n\r\ntrain:\r\n  gamma: 0.9\r\n"
    )


@given(
    st.sampled_from(
        [
            "a:\nb: 1\n",
            "a:\n  c:\nb: 1\n",
            "a: {b: &x 1, c: *x}\n",
            "{a: 1, b: 2}\n",
            "b:\n- 1\na: 2\n",
            "? a\n: 1\n",
            "a: {b: 1, # one, two\n  c: 2}\n",
            "a: {}\nb: [1, 2]\n",
            "a: |\n  b\nc: 'd'\n",
        ]
    ),
    st.lists(st.sampled_from("abc"), min_size=1, max_size=3).map(tuple),
    st.sampled_from(["5 deg", "'on'", "{d: 1}", "[1, 2]"]),
)
def test_an_edit_changes_an_entry_and_nothing_else(text: str, path: NodePath, new: str) -> None:
    root = root_of(text)
    edited = assigned_text(root, root.span.source, path, new, "")
    if edited is not None:
        edited_root, findings = read(edited)
        assert data_at(edited_root, *path) == value(new)
        assert len(findings) <= len(read(text)[1])
        for name in root.entries:
            assert name == path[0] or data_at(edited_root, name) == data_at(root, name)
    fix = removal_fix(root, path)
    if fix is not None:
        (edit,) = fix.edits
        left, findings = read(text[: edit.span.start] + text[edit.span.end :])
        assert node_at(left, *path) is None
        assert len(findings) <= len(read(text)[1])


TEXT = st.text(st.characters(max_codepoint=0xFFFF, exclude_categories=["Cs"]), max_size=12)


@given(st.dictionaries(st.sampled_from(["a", "on", "b c"]), TEXT))
def test_a_tree_that_is_written_is_read_as_the_same_data(data: dict[str, str]) -> None:
    assert to_data(root_of(to_yaml(root_of(json.dumps(data))))) == data


# Pieces that YAML gives a meaning, and words; strings of them reach far into the parser.
SIGNS = list("ab1:\n\t[]{},'\"\\|>#*%@`~()é日😀\u2028\ufeff\x00\x85")
LAYOUT = [
    ": ",
    "\n  ",
    "\n    ",
    "- ",
    "? ",
    ", ",
    "|\n  ",
    ">-\n  ",
    " #",
    "&a ",
    "*a",
    "!t ",
    "---",
    "...",
    "\r\n",
    "''",
]
WORDS_OF_OURS = [
    "key",
    "\\x41",
    "0x1",
    "1_000",
    "<<",
    "extends: ",
    "include: ",
    "remove: ",
    "uniform(0, 1)",
    "true",
    "on",
    "1,5",
    "null",
]
PIECES = st.sampled_from(SIGNS + LAYOUT + WORDS_OF_OURS)
TEXTS = st.lists(PIECES, max_size=40).map("".join)
WORDS = st.text(
    st.characters(codec="utf-8", exclude_categories=["C", "Z"], exclude_characters="\x7f") | st.just(" "),
    min_size=1,
    max_size=20,
)
DATA = st.recursive(
    WORDS | st.integers(-(2**62), 2**62) | st.floats(allow_nan=False, allow_infinity=False) | st.booleans(),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(WORDS, inner, max_size=4),
    max_leaves=20,
)


def spans_of(document: Document) -> list[Span]:
    spans = [
        span
        for finding in document.findings
        for span in (finding.span, *(label.span for label in finding.labels))
    ]
    for _, node in walk(document.root) if document.root else ():
        spans.append(node.span)
        if isinstance(node, MappingNode):
            spans.extend(entry.key.span for entry in node.entries.values())
        if isinstance(node, ScalarNode):
            spans.extend(node.part(i, i + 1) for i in range(len(node.text)))
    return spans


def texts(node: Node) -> object:
    """The tree as PyYAML's base loader gives it: every scalar as text."""
    match node:
        case ScalarNode():
            return node.text
        case SequenceNode():
            return [texts(item) for item in node.items]
        case MappingNode():
            return {key: texts(entry.value) for key, entry in node.entries.items()}


def check(document: Document) -> None:
    for span in spans_of(document):
        assert 0 <= span.start <= span.end <= len(span.source.text)
    for format in ("full", "concise", "json"):
        assert render(document.findings, format) or not len(document.findings)


@given(TEXTS | st.text(max_size=60))
def test_any_text_gives_nodes_or_findings_with_places_inside_it(text: str) -> None:
    document = loads(text)
    check(document)
    assert document.root is not None or document.findings.errors


@given(content=st.binary(max_size=60) | TEXTS.map(str.encode))
def test_any_bytes_give_nodes_or_findings(tmp_path_factory, content: bytes) -> None:  # type: ignore[no-untyped-def]
    path: Path = tmp_path_factory.getbasetemp() / "fuzz.yaml"
    path.write_bytes(content)
    check(load(path))


@given(TEXTS)
def test_any_assignment_gives_a_document(text: str) -> None:
    check(loads("parameters: {a: 1}\nb: {key: [1, 2]}\n", overrides=[text, f"a={text}", f"b.key={text}"]))


@given(TEXTS.map("a: ".__add__))
def test_text_without_findings_has_the_data_that_pyyaml_reads(text: str) -> None:
    document = loads(text)
    if document.root is not None and not len(document.findings):
        assert texts(document.root) == yaml.load(text, yaml.CBaseLoader)


@given(st.dictionaries(WORDS, DATA, max_size=5), st.sampled_from([None, 2]))
def test_json_is_read_as_the_data_that_it_holds(data: dict[str, object], indent: int | None) -> None:
    reserved = {"extends", "include", "remove"}
    text = json.dumps(data, ensure_ascii=False, indent=indent)
    if not reserved.intersection(text.split('"')):
        document = loads(text)
        assert document.root is not None, list(document.findings)
        assert to_data(document.root) == data


@given(st.dictionaries(WORDS, DATA, max_size=5))
def test_the_span_of_a_scalar_reads_as_that_scalar(data: dict[str, object]) -> None:
    document = loads(json.dumps(data, ensure_ascii=False))
    for _, node in walk(document.root) if document.root else ():
        if isinstance(node, ScalarNode):
            again = loads(f"a: {node.span.text}").root
            assert again is not None
            assert to_data(again) == {"a": node.value}
            visible = [i for i, c in enumerate(node.text) if not c.isspace() and c not in '"\\']
            assert all(node.part(i, i + 1).text == node.text[i] for i in visible)


@pytest.mark.parametrize("summary", ["Mine.", "'Mine.'", "Mine.  # short", ">\n  Mine."])
def test_a_scenario_whose_first_line_extends_another_is_a_variant_with_its_summary(
    tmp_path, monkeypatch, summary
):
    (tmp_path / "mine.yaml").write_text(f"extends: cartpole\nsummary: {summary}\n")
    monkeypatch.setattr(shipped, "scenario_names", lambda: ["mine"])
    monkeypatch.setattr(shipped, "scenario_path", lambda name: tmp_path / f"{name}.yaml")
    assert shipped_summaries.__wrapped__(variants=True) == {"mine": "Mine."}


UNTIDY = """

deepbots:   1
name:  CartPole
# about
world:
    timestep:    32 ms     # tick
    # inner
    arena:   {  size: 1 1 m ,wall_height: 0.1 m,
              friction: 1.0  }
    list:
    -   a: 1
        b:   2
    # between
    -   c:  "x  y
          z"
    - - 1
      -   2
      # of the list
    # of the world



    text: |
        first
          second

        third
signals:
   x:      1
   longer: 2
"""
TIDY = """deepbots: 1
name: CartPole
# about
world:
  timestep: 32 ms        # tick
  # inner
  arena: {size: 1 1 m, wall_height: 0.1 m,
            friction: 1.0}
  list:
    - a: 1
      b: 2
    # between
    - c: "x  y
          z"
    - - 1
      - 2
      # of the list
  # of the world

  text: |
      first
        second

      third
signals:
  x:      1
  longer: 2
"""


@pytest.mark.parametrize(
    ("text", "tidy"),
    [
        (UNTIDY, TIDY),
        (TIDY, TIDY),
        (UNTIDY.replace("\n", "\r\n"), TIDY.replace("\n", "\r\n")),
        ("name: CartPole # short", "name: CartPole # short\n"),
        (KEPT := "summary: |\n  one \n  two \nname: n\n", KEPT),
        ("a:   1\t# x\ty\n", "a: 1   # x\ty\n"),
        # Whatever is quadratic in the lines takes minutes here.
        (COMMENTS := "a: 1\n" + "# a word\n" * 40_000, COMMENTS),
        (BRACKETS := "a: [\n" + "  x,\n" * 7_000 + "]\n", BRACKETS),
    ],
    ids=["untidy", "tidy", "line ends", "no line end", "blanks of a text", "tabs", "comments", "brackets"],
)
def test_blanks_blank_lines_and_indentation_are_put_in_order(text: str, tidy: str) -> None:
    assert canonical_text(text) == tidy


@pytest.mark.parametrize("name", shipped.scenario_names())
def test_a_shipped_scenario_is_in_the_canonical_layout(name):
    text = shipped.scenario_path(name).read_text(encoding="utf-8")
    assert canonical_text(text) == text
