"""Text to nodes: values, places, and findings about text whose meaning differs from its look."""

from __future__ import annotations

import pytest
import yaml

from deepbots_cli.diagnostics import Finding, Findings, Source
from deepbots_cli.document import MappingNode, Node, ScalarNode, SequenceNode, descend, to_data
from deepbots_cli.document.parse import parse
from tests.golden.cases import mistakes


def read(text: str) -> tuple[Node | None, list[Finding]]:
    findings = Findings()
    node = parse(Source("test.yaml", text), findings)
    return node, list(findings)


def value(text: str) -> object:
    node, _ = read(f"key: {text}\n")
    assert isinstance(node, MappingNode)
    return to_data(node).get("key")  # type: ignore[attr-defined]


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
    assert node.entries["größe"].key.span.text == "größe"
    assert node.entries["list"].value.span.text == "[a, {b: 'c d'}]"
    assert node.entries["end"].value.span.text == "deep: x"
    assert scalar(text, "list", 1, "b").span.text == "'c d'"
    assert scalar(text, "end", "deep").span.start_position == (4, 9)
    assert node.span.text == text[: text.index("  #")]


def test_the_span_of_a_value_leaves_out_its_anchor() -> None:
    text = "a: &one\n  b: &two 1\nc: &three [x]\nd: *one\n"
    node, findings = read(text)
    assert not findings
    assert isinstance(node, MappingNode)
    assert node.entries["a"].value.span.text == "b: &two 1"
    assert scalar(text, "a", "b").span.text == "1"
    assert node.entries["c"].value.span.text == "[x]"
    assert to_data(node.entries["d"].value) == {"b": 1}


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


def test_a_duplicate_key_is_reported_with_the_first_one_which_is_kept() -> None:
    finding = only_finding("a: 1\nb: 2\na: 3\n")
    assert finding.code == "DB002"
    assert finding.span.start_position == (3, 1)
    assert finding.labels[0].span.start_position == (1, 1)
    node, _ = read("a: 1\na: 3\n")
    assert node is not None
    assert to_data(node) == {"a": 1}


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
    assert finding.code == code
    assert finding.span.text == marked
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


def test_a_list_with_an_item_that_cannot_be_read_is_left_out_as_a_whole() -> None:
    node, findings = read("a: [b, *c]\nd: 1\n")
    assert node is not None
    assert to_data(node) == {"d": 1}
    assert len(findings) == 1


@pytest.mark.parametrize("unit", ["[", "{", "- ", "? ", "[a: ", "{a: ", "{? ", "[\n", "- - ", "? - "])
def test_any_depth_of_nesting_ends_in_one_finding(unit: str) -> None:
    assert only_finding(unit * 100_000).code == "DB005"


@pytest.mark.parametrize(
    "text",
    [
        "a: " * 100_000,
        "\n".join(" " * i + "a:" for i in range(1400)),
        "&a " * 100_000,
        "!a " * 100_000,
        "}" * 100_000,
    ],
)
def test_any_amount_of_repetition_ends_in_one_finding(text: str) -> None:
    assert only_finding(text).code in ("DB001", "DB005")


def test_a_number_with_a_comma_in_braces_is_not_a_key_to_be_quoted() -> None:
    (finding,) = read("{max_steps: 2,000}")[1]
    assert (finding.code, finding.span.text) == ("DB001", "2,000")
    assert finding.help == "write a decimal point, `2.000`, or group the digits, `2_000`"
    assert finding.fix is None
    (finding,) = read("{3: a}")[1]
    assert finding.help == 'put it in quotes: "3"'


def test_64_levels_are_allowed_and_65_are_not() -> None:
    assert read("[" * 64 + "]" * 64)[1] == []
    assert only_finding("[" * 65 + "]" * 65).code == "DB005"


def test_more_than_8_000_values_are_refused() -> None:
    assert isinstance(read("[" + "1," * 7_900 + "]")[0], SequenceNode)
    assert only_finding("[" + "1," * 8_001 + "]").code == "DB005"


def test_aliases_are_counted_before_they_are_expanded() -> None:
    bomb = "a: &a [x,x,x,x,x,x,x,x,x]\n"
    for name, next_name in zip("abcdefgh", "bcdefghi", strict=True):
        bomb += f"{next_name}: &{next_name} [{','.join([f'*{name}'] * 9)}]\n"
    finding = only_finding(bomb)
    assert finding.code == "DB005"
    assert "8,000" in finding.headline


def test_aliases_cannot_build_a_tree_deeper_than_the_limit() -> None:
    steps = ",".join(f"&b{i + 1} [*b{i}]" for i in range(100))
    assert only_finding(f"[&b0 [],{steps}]").code == "DB005"


def test_an_alias_inside_its_own_anchor_is_reported() -> None:
    assert only_finding("a: &a [*a]").code == "DB001"


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


def test_a_decimal_comma_in_braces_is_not_reported_as_a_key() -> None:
    for text, value in [("-1,5 cm", "-1.5 cm"), ("-0,5 .. 0,5 m", "-0.5 .. 0.5 m"), ("0,99", "0.99")]:
        node, (finding,) = read(f"{{x: 5 cm, y: {text}}}")
        assert finding.code == "DB001"
        assert finding.span.text == text
        assert to_data(node) == {"x": "5 cm"}
        assert finding.help == f"write a decimal point: `{value}`"
    (finding,) = read("{x: 5 cm, y: a1,5 cm}")[1]
    assert (finding.code, finding.span.text) == ("DB107", "5 cm")
