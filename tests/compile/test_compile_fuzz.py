"""Whatever becomes of a scenario's text: findings with places, or a scenario that compiles to Python."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from deepbots_cli import api
from deepbots_cli.diagnostics.render import render

from .conftest import Workshop, shipped_text

FOLDER = Path(__file__).parents[1] / "data" / "scenarios"
TEXTS = [
    shipped_text("cartpole"),
    (FOLDER / "drawn.yaml").read_text(encoding="utf-8"),
    (FOLDER / "pair.yaml").read_text(encoding="utf-8"),
]
LINES = sorted({line for text in TEXTS for line in text.splitlines() if line.strip()})
WORDS = sorted({word for text in TEXTS for word in re.findall(r"[\w.]+", text)})
SIGNS = [
    "..",
    "+",
    "*",
    "/",
    "(",
    ")",
    "^",
    "-",
    " m",
    " rad",
    " deg",
    " s",
    ",",
    ":",
    "{",
    "}",
    "[",
    "]",
    "|",
    ">",
    "=",
    "#",
    "'",
    '"',
    "&a",
    "*a",
]
ODD = [
    "0",
    "-1",
    "1e308",
    "1e-320",
    "nan",
    ".inf",
    "true",
    "null",
    "x",
    "cart",
    "auto",
    "any",
    "urdf",
    "1 2 3 m",
    "0 .. 0",
    "{}",
    "[]",
    "\u00e4",
    "\t",
]
PIECES = st.sampled_from(WORDS + SIGNS + ODD)


@pytest.fixture(scope="session")
def bench(tmp_path_factory: pytest.TempPathFactory) -> Workshop:
    return Workshop(tmp_path_factory.mktemp("fuzz"))


def examine(bench: Workshop, text: str) -> None:
    findings = bench.lint(text)
    assert [finding.headline for finding in findings if finding.is_internal_error] == []
    for finding in findings:
        assert 0 <= finding.span.start <= finding.span.end <= len(finding.span.source.text)
    assert render(findings, "full") or not findings
    if not any(finding.severity == "error" for finding in findings):
        compile(api.compile(bench.file).code, "generated", "exec")


@given(data=st.data())
def test_lines_taken_out_put_in_or_exchanged(bench: Workshop, data: st.DataObject) -> None:
    lines = data.draw(st.sampled_from(TEXTS)).splitlines()
    for _ in range(data.draw(st.integers(1, 3))):
        at, other = data.draw(st.integers(0, len(lines) - 1)), data.draw(st.integers(0, len(lines) - 1))
        match data.draw(st.sampled_from(["delete", "insert", "swap", "indent"])):
            case "delete" if len(lines) > 1:
                del lines[at]
            case "insert":
                lines.insert(at, data.draw(st.sampled_from(LINES)))
            case "swap":
                lines[at % len(lines)], lines[other % len(lines)] = (
                    lines[other % len(lines)],
                    lines[at % len(lines)],
                )
            case _:
                lines[at % len(lines)] = "  " + lines[at % len(lines)]
    examine(bench, "\n".join(lines) + "\n")


@given(data=st.data())
def test_words_exchanged(bench: Workshop, data: st.DataObject) -> None:
    text = data.draw(st.sampled_from(TEXTS))
    for _ in range(data.draw(st.integers(1, 3))):
        word = data.draw(st.sampled_from(list(re.finditer(r"[\w.]+", text))))
        text = text[: word.start()] + data.draw(PIECES) + text[word.end() :]
    examine(bench, text)


@given(data=st.data())
def test_values_exchanged(bench: Workshop, data: st.DataObject) -> None:
    text = data.draw(st.sampled_from(TEXTS))
    for _ in range(data.draw(st.integers(1, 2))):
        value = data.draw(st.sampled_from(list(re.finditer(r"(?<=: )[^\n{]+?(?=[,}\n])", text))))
        text = text[: value.start()] + " ".join(data.draw(st.lists(PIECES, max_size=5))) + text[value.end() :]
    examine(bench, text)
