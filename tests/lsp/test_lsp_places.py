"""Where a place is: positions of the protocol, and the path of a place in a text that may be broken."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from lsprotocol.types import Position
from pygls.workspace import PositionCodec

from deepbots_cli.diagnostics import Findings, Source
from deepbots_cli.document import MappingNode, ScalarNode, walk
from deepbots_cli.document.parse import parse
from deepbots_cli.lsp.cursor import cursor_at
from deepbots_cli.lsp.workspace import Lines
from tests.few import every

ROOT = Path(__file__).parents[2]
FILES = [
    *sorted((ROOT / "scenarios").glob("*.yaml")),
    *sorted((ROOT / "robots").glob("*.yaml")),
    *sorted((ROOT / "tests" / "golden" / "lint" / "ok").glob("*.yaml")),
]
TEXTS = st.text(st.sampled_from("ab\n\r😀𝄞ü \t")) | st.text()
ENCODINGS = {"utf-8": 1, "utf-16": 2, "utf-32": 4}


@given(
    TEXTS.filter(lambda text: not any("\ud800" <= letter <= "\udfff" for letter in text)),
    st.sampled_from(sorted(ENCODINGS)),
)
def test_each_offset_has_a_position_that_leads_back_to_it(text, encoding):
    lines = Lines(text, PositionCodec(encoding))
    mark = text.startswith("\ufeff")
    for index in range(mark, len(text) + 1):
        if text[index - 1 : index + 1] == "\r\n":
            continue  # between the two there is no place
        position = lines.position(index - mark)
        before = text[:index]
        start = max(before.rfind("\n"), before.rfind("\r")) + 1
        assert position.line == len(before.replace("\r\n", "\n").replace("\r", "\n").split("\n")) - 1
        name = "utf-8" if encoding == "utf-8" else f"{encoding}-le"
        assert position.character == len(text[start:index].encode(name)) // ENCODINGS[encoding]
        assert lines.offset(position) == index - mark


@pytest.mark.parametrize(
    ("position", "offset"),
    [
        (Position(0, 2), 1),
        (Position(0, 3), 2),
        (Position(0, 99), 3),
        (Position(1, 99), 5),
        (Position(99, 0), 5),
        (Position(1, 0), 4),
    ],
)
def test_what_lies_inside_of_a_character_or_beyond_a_line_is_taken_to_the_nearest_place(position, offset):
    assert Lines("a😀b\nc").offset(position) == offset


@pytest.mark.parametrize("file", every(12, FILES, lambda file: file.name))
def test_the_reader_of_broken_text_finds_the_paths_that_the_parser_finds(file):
    text = file.read_text(encoding="utf-8")
    root = parse(Source(file.name, text), Findings())
    visited = set()
    for path, node in walk(root):
        if (
            isinstance(node, ScalarNode) and node.span not in visited
        ):  # what an alias repeats stands in one place
            visited.add(node.span)
            cursor = cursor_at(text, node.span.end)
            assert cursor.path == path
            assert cursor.role == "value" or isinstance(path[-1], int)
        for entry in node.entries.values() if isinstance(node, MappingNode) else ():
            if entry.key.span not in visited:
                visited.add(entry.key.span)
                cursor = cursor_at(text, entry.key.span.end)
                assert (cursor.path, cursor.role) == (path, "key")


@pytest.mark.parametrize(
    ("text", "path", "role"),
    [
        ("world: {", ("world",), "key"),
        ("world: {timestep: 32 ms, ", ("world",), "key"),
        ("world: {timestep: ", ("world", "timestep"), "value"),
        ("world:\n  timestep: 32 ms\n  ", ("world",), "key"),
        ("world:\n  timestep: 32 ms\n", (), "key"),
        ("robots:\n  cart:\n    sensors: {a: {type: gyro, l", ("robots", "cart", "sensors", "a"), "key"),
        ("curriculum:\n- name: a\n  se", ("curriculum", 0), "key"),
        ("emit: [a, ", ("emit", 1), "value"),
        ("signals:\n  x: |\n    foo(ba", ("signals", "x"), "value"),
        ("summary: 'it''s ", ("summary",), "value"),
        ("summary: a  # on", ("summary",), "aside"),
        ("world: {{\nreward:\n  x: ", ("reward", "x"), "value"),
        ('summary: "open\nreward:\n  x: ', ("reward", "x"), "value"),
        ("a: ]\nreward: {x: ", ("reward", "x"), "value"),
        ("", (), "key"),
    ],
)
def test_a_text_that_is_being_written_has_a_path_all_the_same(text, path, role):
    cursor = cursor_at(text, len(text))
    assert (cursor.path, cursor.role) == (path, role)


@given(st.text(st.sampled_from("ab:-[]{},\"'#|>&*!% \n\t😀")), st.integers(0, 200))
def test_any_text_whatever_has_a_path(text, offset):
    cursor = cursor_at(text, min(offset, len(text)))
    assert cursor.start <= max(len(text), 0)


@pytest.mark.parametrize(
    "piece", ["[", "{a: ", "- ", "a:\n", "\n", '"', " ", ":", "# ", "[x ", "'", "a: |\n"]
)
def test_a_hostile_text_is_read_to_its_end(piece):
    text = piece * 50_000
    assert len(cursor_at(text, len(text)).path) <= 100
