"""Any text at all: no exception, no hang, every place inside the text, and the values that YAML gives."""

from __future__ import annotations

import json
from pathlib import Path

import yaml
from hypothesis import given
from hypothesis import strategies as st

from deepbots_cli.diagnostics import Span
from deepbots_cli.diagnostics.render import render
from deepbots_cli.document import (
    Document,
    MappingNode,
    Node,
    ScalarNode,
    SequenceNode,
    load,
    loads,
    to_data,
    walk,
)

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
