"""Laws of writing: a scenario that is written in another way is the same scenario.

The scenarios are those that chance draws, and the shipped ones, which have cases, stages, tests, trainings and
several agents. Where a law says so, one place of the scenario is spoiled first: the findings of a mistake must
not depend on the way of writing either.
"""

from __future__ import annotations

import copy
import json
import re
from collections import Counter
from collections.abc import Iterator, Sequence
from functools import cache
from typing import Any, NamedTuple

import yaml
from hypothesis import reject
from hypothesis import strategies as st

from deepbots_cli import Scenario, api
from deepbots_cli.diagnostics import Findings, Source
from deepbots_cli.document import load, shipped, to_data
from deepbots_cli.document.layout import canonical_text
from deepbots_cli.document.layout import to_yaml as tree_to_yaml
from deepbots_cli.document.parse import parse
from deepbots_cli.lint import all_findings
from deepbots_cli.program import Program, identity
from deepbots_cli.scenario.base import MappingOf, Section
from deepbots_cli.scenario.walk import shape_at
from tests.laws.expressions import Draw, chance, pick
from tests.laws.law import Case, as_text, law

Data = dict[str, Any]
Path = tuple[str | int, ...]


class Shown(str):
    """A text that Hypothesis prints as it is."""

    def _repr_pretty_(self, printer: Any, _cycle: bool) -> None:
        printer.text(f"\n{self}")


# What a text means


class Meaning(NamedTuple):
    """What a scenario means: its findings, as codes and headlines, and its program; None with errors."""

    findings: Counter[tuple[str, str]]
    program: Program | None

    @classmethod
    def of(cls, source: Any, overrides: Sequence[str] = ()) -> Meaning:
        checked = api.load(source, overrides=overrides, tests=True)
        findings = Counter((finding.code, finding.headline) for finding in all_findings(checked))
        checked.release_names()
        assert not any(code == "DB903" for code, _ in findings), findings
        return cls(findings, checked.program)

    def require(self, expected: Meaning) -> None:
        """Require the same findings and the same digest."""
        assert self.findings == expected.findings, (
            f"more: {self.findings - expected.findings}, fewer: {expected.findings - self.findings}"
        )
        assert (self.program is None) == (expected.program is None)
        if self.program is not None and expected.program is not None:
            require_equal(canonical(self.program), canonical(expected.program))


def canonical(program: Program) -> Any:
    return json.loads(identity.to_json(program))


def require_equal(actual: Any, expected: Any, place: str = "program") -> None:
    """Require two values of JSON to be equal; the message names the first place where they differ."""
    if isinstance(actual, dict) and isinstance(expected, dict):
        assert actual.keys() == expected.keys(), place
        for key, value in actual.items():
            require_equal(value, expected[key], f"{place}.{key}")
    elif isinstance(actual, list) and isinstance(expected, list):
        assert len(actual) == len(expected), place
        for number, (one, other) in enumerate(zip(actual, expected, strict=True)):
            require_equal(one, other, f"{place}[{number}]")
    else:
        assert actual == expected, place


# What is written


@cache
def _shipped_data(name: str) -> str:
    path = shipped.scenario_path(name)
    assert path is not None
    root = load(path).root
    assert root is not None
    data: Any = to_data(root)
    for robot in data["robots"].values():
        robot["urdf"] = robot["urdf"].rpartition("/")[2].removesuffix(".urdf")
    return json.dumps(data)


def data_of(case: Case) -> Data:
    """Return a copy of the scenario that was drawn, or now and then of a shipped one."""
    if chance(case.draw, 20):
        data: Data = json.loads(_shipped_data(pick(case.draw, shipped.scenario_names())))
        return data
    return copy.deepcopy(case.drawn.data)


def walk(data: Any, path: Path = ()) -> Iterator[tuple[Path, Any]]:
    """Yield all values below `data` with their paths."""
    items = data.items() if isinstance(data, dict) else enumerate(data) if isinstance(data, list) else ()
    for step, value in items:
        yield (*path, step), value
        yield from walk(value, (*path, step))


def holder_of(data: Any, path: Path) -> Any:
    for step in path[:-1]:
        data = data[step]
    return data


def spoiled(case: Case, data: Data) -> Data:
    """Spoil one place now and then: a value, a key, or what is missing."""
    if not chance(case.draw, 40):
        return data
    path = pick(case.draw, [path for path, _ in walk(data)])
    holder, last = holder_of(data, path), path[-1]
    way = pick(case.draw, ("absent", "word", "unit", "number", "list", "mapping", "key"))
    old = holder[last]
    match way:
        case "absent":
            del holder[last]
        case "key" if isinstance(holder, dict):
            entries = [(f"{key}s" if key == last else key, value) for key, value in holder.items()]
            holder.clear()
            holder.update(entries)
        case "unit":
            holder[last] = f"{old} kg" if isinstance(old, str | int | float) else "1 kg"
        case _:
            holder[last] = {"word": "nonsense", "number": -7, "list": [old], "mapping": {"no": 1}}.get(way, 7)
    return data


# Layout

_WORD = re.compile(r"[A-Za-z0-9_.+-][A-Za-z0-9_.+*/^()%<>=| -]*(?<! )")
_RESOLVED = re.compile(
    r"null|Null|NULL|~|true|True|TRUE|false|False|FALSE|[-+]?(\.inf|\.Inf|\.INF)|\.nan|\.NaN|\.NAN"
    r"|[-+]?[0-9]+|0o[0-7]+|0x[0-9a-fA-F]+|[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?"
)
"""Plain texts that YAML 1.2 takes for other values than texts."""


class Hand:
    """Writes data as YAML in one of the ways in which people do."""

    def __init__(self, draw: Draw) -> None:
        self.draw = draw
        self.step = pick(draw, (2, 3, 4))
        self.flush = chance(draw, 30)
        self.free = chance(draw, 50)

    def text(self, data: Data) -> str:
        text = "\n".join(self.block(data, 0)) + pick(self.draw, ("\n", "", "\n\n\n", "\n# the end\n"))
        return text.replace("\n", "\r\n") if chance(self.draw, 10) else text

    def block(self, node: Any, pad: int) -> Iterator[str]:
        """Yield the lines of a mapping or a list, or of a single value."""
        blanks = " " * pad
        if isinstance(node, dict):
            for key, value in node.items():
                yield from self.between(pad)
                yield from self.entry(f"{blanks}{self.word(key)}:", value, pad)
        else:
            for item in node:
                yield from self.between(pad)
                if isinstance(item, dict) and item and not chance(self.draw, 40):
                    first, *rest = self.block(item, pad + self.step)
                    while not first.strip() or first.lstrip().startswith("#"):
                        yield first
                        first, *rest = rest
                    yield f"{blanks}-{' ' * (self.step - 1)}{first.lstrip()}"
                    yield from rest
                else:
                    yield from self.entry(f"{blanks}-", item, pad)

    def entry(self, head: str, value: Any, pad: int) -> Iterator[str]:
        blanks = pick(self.draw, (" ", " ", " ", "  ", "      "))
        if isinstance(value, dict | list) and value and not chance(self.draw, 25):
            flush = isinstance(value, list) and self.flush and not head.endswith("-")
            yield f"{head}{self.comment()}"
            yield from self.block(value, pad if flush else pad + self.step)
        elif isinstance(value, str) and len(value.split()) > 3 and _is_plain(value) and chance(self.draw, 30):
            words = value.split(" ")
            middle = self.draw(st.integers(1, len(words) - 1))
            first, second = " ".join(words[:middle]), " ".join(words[middle:])
            folded = pick(self.draw, (" >-", ""))
            if folded or not _is_plain(first) or second.startswith(("#", "- ")):
                yield f"{head} >-"
                yield f"{' ' * (pad + 2)}{first}"
            else:
                yield f"{head}{blanks}{first}"
            yield f"{' ' * (pad + 2)}{second}"
        else:
            yield f"{head}{blanks}{self.flow(value, top=True)}{self.comment()}"

    def between(self, pad: int) -> Iterator[str]:
        if self.free and chance(self.draw, 10):
            yield pick(self.draw, ("", f"{' ' * pad}# about the next line", "   ", "# at the left: {not: yaml}"))

    def comment(self) -> str:
        return pick(self.draw, ("  # why: it's", " # ", "   ")) if self.free and chance(self.draw, 10) else ""

    def flow(self, value: Any, *, top: bool = False) -> str:
        """Return a value on one line."""
        blank = " " if chance(self.draw, 20) else ""
        if isinstance(value, dict):
            inner = ", ".join(f"{self.word(key)}: {self.flow(item)}" for key, item in value.items())
            return f"{{{blank}{inner}{blank}}}"
        if isinstance(value, list):
            return f"[{blank}{', '.join(self.flow(item) for item in value)}{blank}]"
        return self.word(value, top=top)

    def word(self, value: Any, *, top: bool = False) -> str:
        if isinstance(value, bool):
            return "true" if value else "false"
        if isinstance(value, int | float):
            return repr(value)
        if "\n" in value:
            return json.dumps(value)
        plain = _is_plain(value) or (top and value and re.fullmatch(r"\w[\w ()+*,.-]*\w", value, re.ASCII))
        if plain and not _RESOLVED.fullmatch(value) and not chance(self.draw, 15):
            return str(value)
        doubled = value.replace("'", "''")
        return f"'{doubled}'" if chance(self.draw, 50) else json.dumps(value)


def _is_plain(text: str) -> bool:
    return bool(_WORD.fullmatch(text)) and not text.startswith(("- ", "-\t")) and text != "-"


@st.composite
def layouts(draw: Draw, data: Data) -> Shown:
    """Draw a text of the data."""
    return Shown(Hand(draw).text(data))


def _texts(data: Any) -> Any:
    """Return data with all values as texts, and all numbers written in the same way."""
    if isinstance(data, dict):
        return {key: _texts(value) for key, value in data.items()}
    if isinstance(data, list):
        return [_texts(item) for item in data]
    text = str(data).lower() if isinstance(data, bool) else str(data)
    return repr(float(text)) if _RESOLVED.fullmatch(text) and text[-1].isdigit() else text


@law(cost=90)
def another_layout_is_the_same_scenario(case: Case) -> None:
    """YAML has many ways to write the same data: blocks and braces, quotes, line breaks, comments."""
    data = spoiled(case, data_of(case))
    expected = Meaning.of(case.write(data))
    text = case.draw(layouts(data))
    assert _texts(yaml.load(text, yaml.BaseLoader)) == _texts(data), "a fault of the law"
    Meaning.of(case.write(text)).require(expected)


@law(cost=90)
def fmt_changes_white_space_only(case: Case) -> None:
    """`deepbots fmt` is for readers: a second time it finds nothing to do, and it keeps values and comments."""
    data = spoiled(case, data_of(case))
    text = case.draw(layouts(data))
    expected = Meaning.of(case.write(text))
    tidy = canonical_text(text)
    assert tidy is not None, text
    assert canonical_text(tidy) == tidy
    assert re.sub(r"\s+", "", tidy) == re.sub(r"\s+", "", text)
    Meaning.of(case.write(tidy)).require(expected)
