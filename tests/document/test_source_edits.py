"""Edits that keep the other text of a file: moved and set entries, their comments and line ends."""

from __future__ import annotations

import json

import pytest
from hypothesis import given
from hypothesis import strategies as st

from deepbots_cli.diagnostics import Source, edited
from deepbots_cli.document import MappingNode, loads
from deepbots_cli.document.edits import assigned_text, move_to_augment_fix
from deepbots_cli.document.layout import to_yaml
from deepbots_cli.document.nodes import to_data


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
        ("augment: {b: y}\nsignals: {a: x, c: z}\n", "augment: {b: y, a: x}\nsignals: {c: z}\n"),
        (
            "signals:\r\n  a: x\r\n  c: z\r\nname: n\r\n",
            "augment:\r\n  a: x\r\nsignals:\r\n  c: z\r\nname: n\r\n",
        ),
        ("augment: [b]\nsignals:\n  a: x\n", "augment: [b, a]\nsignals:\n  a: x\n"),
    ],
)
def test_a_signal_moves_to_augment_with_its_comment(before: str, after: str) -> None:
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


def test_a_new_section_has_the_line_ends_of_the_file() -> None:
    root = root_of("name: n\r\n")
    text = assigned_text(root, root.span.source, ("train", "gamma"), "0.9", "")
    assert text == "name: n\r\ntrain:\r\n  gamma: 0.9\r\n"


TEXT = st.text(st.characters(max_codepoint=0xFFFF, exclude_categories=["Cs"]), max_size=12)


@given(st.dictionaries(st.sampled_from(["a", "on", "b c"]), TEXT))
def test_a_tree_that_is_written_is_read_as_the_same_data(data: dict[str, str]) -> None:
    written = to_yaml(root_of(json.dumps(data)))
    assert to_data(root_of(written)) == data
