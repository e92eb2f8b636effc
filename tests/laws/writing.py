"""Laws of writing: a scenario that is written in another way is the same scenario.

The scenarios are those that chance draws, and the shipped ones, which have cases, stages, tests, trainings
and several agents. Where a law says so, one place of the scenario is spoiled first: the findings of a mistake
must not depend on the way of writing either.
"""

from __future__ import annotations

import copy
import json
import keyword
import os
import re
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import chdir
from dataclasses import replace
from fractions import Fraction
from functools import cache
from typing import Any, NamedTuple

import pytest
import yaml
from hypothesis import assume, reject
from hypothesis import strategies as st
from pydantic import ValidationError
from pydantic_core import PydanticCustomError

from deepbots_cli import Scenario, api
from deepbots_cli.diagnostics import RULES, edited
from deepbots_cli.document import load, shipped, to_data
from deepbots_cli.document.layout import canonical_text
from deepbots_cli.errors import ScenarioError
from deepbots_cli.expressions.dimensions import UNITS, Unit
from deepbots_cli.expressions.syntax import NUMBER, Number
from deepbots_cli.lint import all_findings
from deepbots_cli.program import Program, identity
from deepbots_cli.scenario.base import MappingOf, Section, shape_at
from deepbots_cli.scenario.fields import BUILT_IN_NAMES, RESERVED, Name
from deepbots_cli.scenario.quantities import Parsed
from tests.laws.expressions import Draw, chance, pick, units_of
from tests.laws.law import Case, law, reference
from tests.laws.scenarios import LEFT_OUT, as_text

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

    @property
    def has_errors(self) -> bool:
        return any(RULES[code].severity == "error" for code, _ in self.findings)

    @classmethod
    def of(cls, source: Any, overrides: Sequence[str] = ()) -> Meaning:
        checked = api.load(source, overrides=overrides, tests=True)
        findings = Counter((finding.code, finding.headline) for finding in all_findings(checked))
        checked.release_names()
        assert not any(code == "DB903" for code, _ in findings), findings
        return cls(findings, checked.program)

    def require(self, expected: Meaning, *, may_lack: Sequence[str] = ()) -> None:
        """Require the same findings, but those of codes that `may_lack` lists, and the same digest."""
        more, fewer = self.findings - expected.findings, expected.findings - self.findings
        fewer = {entry: count for entry, count in fewer.items() if entry[0] not in may_lack}
        assert not more, f"findings more: {more}, fewer: {fewer}"
        assert not fewer, f"findings fewer: {fewer}"
        assert (self.program is None) == (expected.program is None)
        if self.program is not None and expected.program is not None:
            require_equal(canonical(self.program), canonical(expected.program))


def canonical(program: Program) -> Any:
    # The names of agents are sorted in the JSON, and so in another order after a renaming.
    return json.loads(
        identity.to_json(program),
        object_hook=lambda part: part | {key: dict(part[key]) for key in {"drivers"} & part.keys()},
    )


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
        assert actual == expected, f"{place}: {str(actual)[:80]} and {str(expected)[:80]}"


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
    items: Any = data.items() if isinstance(data, dict) else ()
    if isinstance(data, list):
        items = enumerate(data)
    for step, value in items:
        yield (*path, step), value
        yield from walk(value, (*path, step))


def data_at(data: Any, path: Path) -> Any:
    for step in path:
        data = data[step]
    return data


def holder_of(data: Any, path: Path) -> Any:
    return data_at(data, path[:-1])


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
            yield pick(
                self.draw, ("", f"{' ' * pad}# about the next line", "   ", "# at the left: {not: yaml}")
            )

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
    # That finding is about the layout.
    assume(not any("not indented below" in headline for _, headline in expected.findings))
    text = case.draw(layouts(data))
    assert _texts(yaml.load(text, yaml.BaseLoader)) == _texts(data), "a fault of the law"
    Meaning.of(case.write(text)).require(expected)


@law(cost=100)
def fmt_changes_white_space_only(case: Case) -> None:
    """`deepbots fmt` is for readers: a second time it finds nothing to do, and it keeps values and
    comments."""
    text = case.draw(layouts(spoiled(case, data_of(case))))
    expected = Meaning.of(case.write(text))
    tidy = canonical_text(text)
    assert tidy is not None, text
    assert canonical_text(tidy) == tidy
    assert re.sub(r"\s+", "", tidy) == re.sub(r"\s+", "", text)
    Meaning.of(case.write(tidy)).require(expected)


# Files


def is_section(data: Data, path: Path) -> bool:
    """Return whether the mapping at a path has the keys of a section, whose order has no meaning."""
    return isinstance(shape_at(Scenario, data, path), type)


@st.composite
def orders(draw: Draw, data: Data) -> Shown:
    """Draw a text in which the keys of sections have another order."""

    def ordered(node: Any, path: Path) -> Any:
        if isinstance(node, list):
            return [ordered(item, (*path, number)) for number, item in enumerate(node)]
        if not isinstance(node, dict):
            return node
        keys = draw(st.permutations(list(node))) if is_section(data, path) and chance(draw, 50) else node
        return {key: ordered(node[key], (*path, key)) for key in keys}

    return Shown(as_text(ordered(data, ())))


@law(cost=75)
def keys_may_stand_in_any_order(case: Case) -> None:
    """The keys of a section are a set, as in Python's keyword arguments; names of the author have an order,
    since the observation has one."""
    data = spoiled(case, data_of(case))
    expected = Meaning.of(case.write(data))
    require_in_order(Meaning.of(case.write(case.draw(orders(data)))), expected)


def require_in_order(actual: Meaning, expected: Meaning, may_lack: Sequence[str] = ()) -> None:
    """Require the same, unless a finding is about what is on the line above, in another order or file."""
    if any("not indented below" in headline for _, headline in (*expected.findings, *actual.findings)):
        reject()
    actual.require(expected, may_lack=may_lack)


_OF_BASES = ("DB205",)
"""Findings of what the scenario's own file defines: what it does not use of a base or of an option, another
scenario may use."""
_KINDS = ("type", "shape", "algorithm")


class Cutter:
    """Cuts the data of a scenario into files that are merged again."""

    def __init__(self, draw: Draw, data: Data) -> None:
        self.draw = draw
        self.data = data

    def cut(self, node: Data, path: Path = ()) -> tuple[Data, Data]:
        """Return the entries of a mapping in two parts: the base, and what is laid upon it.

        Where names have an order, those of the base come first.
        """
        base: Data = {}
        own: Data = {}
        free = is_section(self.data, path)
        last = self.draw(st.integers(0, len(node))) if chance(self.draw, 40) else len(node)
        for number, (key, value) in enumerate(node.items()):
            if key == "include":
                base[key] = value
            elif (path, key) == ((), "tests") or (not chance(self.draw, 70) if free else number >= last):
                own[key] = value
            elif isinstance(value, dict) and value and chance(self.draw, 60):
                base[key], own[key] = self.cut(value, (*path, key))
            elif chance(self.draw, 60) or isinstance(value, dict):  # a mapping would be merged
                base[key] = value
            else:
                others = (0, "nonsense", [1], {"bad": "sense"})
                base[key] = value if key in _KINDS else pick(self.draw, others)
                own[key] = value
        return base, own

    def remove(self, name: str, base: Data, own: Data) -> None:
        """Add an entry that should not be there to the base, and remove it in the scenario."""
        mappings = {path for path, value in walk(self.data) if isinstance(value, dict)}
        path = pick(self.draw, [(), *(path for path, _ in walk(base) if path in mappings)])
        holder = data_at(base, path)
        if chance(self.draw, 30) and isinstance(holder, dict):
            holder[name] = pick(self.draw, (0, {"bad": "sense"}))
            own["remove"] = [".".join(map(str, (*path, name)))]


@st.composite
def bases(draw: Draw, data: Data) -> Files:
    """Draw a scenario that extends others."""
    files = Files()
    names = ["scenario.yaml", "base.yaml", "parts/base.yaml", "parts/first.yaml"]
    own = data
    for number in range(draw(st.integers(1, 3))):
        cutter = Cutter(draw, data)
        base, own = cutter.cut(own)
        cutter.remove(f"wrong{number}", base, own)
        folder = os.path.dirname(names[number]) or "."
        files[names[number]] = {"extends": os.path.relpath(names[number + 1], folder), **own}
        files[names[number + 1]] = own = base
    return files


class Files(dict[str, Data]):
    """The data of several files by name."""

    def write(self, case: Case) -> None:
        for name, data in self.items():
            case.write(data, name)

    def _repr_pretty_(self, printer: Any, _cycle: bool) -> None:
        for name, data in self.items():
            printer.text(f"\n--- {name}\n{as_text(data)}")


@law(cost=80)
def a_scenario_cut_by_extends_is_the_whole(case: Case) -> None:
    """A scenario that extends another is laid upon it, key by key; what it replaces or removes is gone."""
    data = spoiled(case, data_of(case))
    expected = Meaning.of(case.write(data))
    case.draw(bases(data)).write(case)
    require_in_order(Meaning.of(case.path), expected, _OF_BASES)


@st.composite
def parts(draw: Draw, data: Data) -> Files:
    """Draw a scenario of which some mappings begin in files of their own."""
    files = Files({"scenario.yaml": copy.deepcopy(data)})
    paths = [(), *(path for path, value in walk(data) if isinstance(value, dict) and value)]
    chosen = draw(st.lists(st.sampled_from(paths), max_size=3, unique=True))
    # The innermost first: the file of an outer mapping includes that of an inner one.
    for number, path in enumerate(sorted(chosen, key=len, reverse=True)):
        holder: Any = holder_of(files["scenario.yaml"], path) if path else files
        step = path[-1] if path else "scenario.yaml"
        # Files of one name in several folders are several files.
        is_inside = chance(draw, 50)
        name = f"folder{number}/part.yaml" if is_inside else f"part{number}.yaml"
        files[name], own = Cutter(draw, data).cut(holder[step], path)
        for inner, value in [*walk(files[name])] if is_inside else ():
            if inner[-1] == "include":
                holder_of(files[name], inner)["include"] = f"../{value}"
        holder[step] = {"include": name, **own} if chance(draw, 50) else {**own, "include": name}
    return files


@law(cost=75)
def a_scenario_of_included_parts_is_the_whole(case: Case) -> None:
    """A mapping may begin in a file; what stands beside `include` is laid upon it, key by key."""
    data = spoiled(case, data_of(case))
    expected = Meaning.of(case.write(data))
    case.draw(parts(data)).write(case)
    require_in_order(Meaning.of(case.path), expected, _OF_BASES)


# Assignments


@st.composite
def assignments(draw: Draw, data: Data) -> tuple[Shown, list[str]]:
    """Draw a text in which some values are wrong or absent, and the assignments of the right ones."""
    changed = copy.deepcopy(data)
    paths = [path for path, value in walk(data) if not isinstance(value, dict | list) or value]
    chosen: list[Path] = []
    for path in draw(st.lists(st.sampled_from(paths), min_size=1, max_size=4, unique=True)):
        if not any(path[: len(other)] == other or other[: len(path)] == path for other in chosen):
            chosen.append(path)
    texts = []
    for path in chosen:
        holder, step = holder_of(changed, path), path[-1]
        value = holder[step]
        if is_section(data, path[:-1]) and chance(draw, 40):
            del holder[step]
        else:
            holder[step] = pick(draw, (0, "nonsense", {"bad": "sense"}, ["non", "sense"]))
        is_parameter = path[:1] == ("parameters",) and len(path) == 2 and chance(draw, 50)
        name = str(step) if is_parameter else ".".join(map(str, path))
        blank = pick(draw, ("", "", " "))
        texts.append(f"{name}{blank}={blank}{Hand(draw).flow(value, top=True)}")
    return Shown(as_text(changed)), texts


@law(cost=80)
def a_value_set_by_an_option_is_that_of_the_file(case: Case) -> None:
    """`--set path=value` replaces a value, or adds a key, as if the file had it."""
    data = spoiled(case, data_of(case))
    expected = Meaning.of(case.write(data))
    text, overrides = case.draw(assignments(data))
    Meaning.of(case.write(text), overrides).require(expected, may_lack=_OF_BASES)


# Python


@law(cost=120)
def a_scenario_built_in_python_is_that_of_the_file(case: Case) -> None:
    """The models are the language, so keyword arguments, sections as models, JSON and YAML written from them
    are ways to write a scenario. What they refuse is an error in the file, too."""
    data = spoiled(case, data_of(case))
    path = case.write(data)
    expected = Meaning.of(path)
    try:
        scenario = Scenario(**data)
    except ValidationError as error:
        messages = {message["msg"] for message in error.errors()}
        assert expected.has_errors, messages
        with pytest.raises(ScenarioError):
            Scenario.from_yaml(path)
        return
    if any(code in _OF_FILES for code, _ in expected.findings):
        reject()
    Meaning.of(scenario).require(expected)
    assert Scenario(**{key: getattr(scenario, key) for key in scenario.model_fields_set}) == scenario
    assert Scenario.model_validate_json(scenario.model_dump_json(exclude_unset=True)) == scenario
    read = Scenario.from_yaml(path)
    if not (scenario.agents and scenario.train):  # a file gives the keys of a common `train` to each agent
        assert read == scenario
    Meaning.of(case.write(read.to_yaml())).require(expected)


_OF_FILES = ("DB003", "DB004")
"""Findings about how a text is spelled, which a value in Python is not."""


# Copies


@law(cost=250)
def a_copy_of_its_files_is_the_same_scenario(case: Case) -> None:
    """A run keeps the merged scenario and all its files, and compiles them: wherever the folder is, and
    whatever the working folder is."""
    data = data_of(case)
    data.pop("tune", None)  # a run has none
    checked = api.load(case.write(data))
    expected = distinct(Meaning.of(case.path))
    if checked.program is None:
        reject()
    copy_folder = case.folder / "a folder" / "copy"
    checked.inputs.write(copy_folder)
    distinct(Meaning.of(copy_folder / "resolved.yaml")).require(expected)
    moved = case.folder / "moved"
    copy_folder.rename(moved)
    with chdir(moved / "inputs"):
        distinct(Meaning.of("../resolved.yaml")).require(expected)
        again = api.load("../resolved.yaml").inputs
    again.write(moved / "again")
    distinct(Meaning.of(moved / "again" / "resolved.yaml")).require(expected)


def distinct(meaning: Meaning) -> Meaning:
    """Return a meaning with each finding once: a copy has the chosen learner in each of its agents."""
    return meaning._replace(findings=Counter({*meaning.findings}))


# Units

_UNIT = r"[A-Za-z]+(?:\^-?\d)?(?:[*/][A-Za-z]+(?:\^-?\d)?)*"
_SIGNED = rf"[-+]?{NUMBER}"
_MEASURED = re.compile(
    rf"(?<![\w.)^])({_SIGNED}(?:(?:\s*(?:\.\.|\+-|\|)\s*|\s+){_SIGNED})*)\s+({_UNIT})(?![\w.(*/^])"
)
"""Numbers with one unit behind them: `1 m`, `0 0 1 m`, `0 .. 1 m`, `0 +- 1 m`."""


@cache
def _unit(text: str) -> Unit | None:
    try:
        tree = Parsed.tree(f"1 {text}")
    except PydanticCustomError:
        return None
    return tree.unit if isinstance(tree, Number) else None


_DECIMAL = {"m": 0, "cm": -2, "mm": -3, "km": 3, "s": 0, "ms": -3, "us": -6, "kg": 0, "g": -3, "rad": 0}
_DECIMAL |= {"N": 0, "mN": -3, "kN": 3}
"""Units by the power of ten of their values in SI: the law has its own table, as a second implementation."""


def scale_of(unit: str) -> tuple[int, int] | None:
    """Return numerator and denominator of the scale of a unit; None if it is no decimal one."""
    numerator = denominator = 1
    for sign, name, exponent in re.findall(r"([*/]?)([A-Za-z]+)(?:\^(-?\d))?", unit):
        if name not in _DECIMAL:
            return None
        power = _DECIMAL[name] * int(exponent or 1) * (-1 if sign == "/" else 1)
        numerator, denominator = numerator * 10 ** max(power, 0), denominator * 10 ** max(-power, 0)
    return numerator, denominator


def in_unit(numbers: str, old: str, new: str) -> str | None:
    """Return numbers in another unit; None if they are not exactly the same there."""
    before, after = scale_of(old), scale_of(new)
    if before is None or after is None:
        return None
    exact = True

    def converted(match: re.Match[str]) -> str:
        nonlocal exact
        value = Fraction(match[0].replace("_", "")) * Fraction(*before) / Fraction(*after)
        text = repr(float(value))
        old_value, new_value = float(match[0]) * before[0] / before[1], float(text) * after[0] / after[1]
        exact = exact and Fraction(text) == value and old_value == new_value
        return text

    text = re.sub(_SIGNED, converted, numbers)
    return text if exact else None


@st.composite
def units(draw: Draw, data: Data) -> Shown:
    """Draw a text in which some quantities have other units."""

    def replaced(match: re.Match[str]) -> str:
        old = _unit(match[2])
        if old is None or not chance(draw, 60):
            return match[0]
        same = [unit for unit in UNITS.values() if unit.dimension == old.dimension]
        new = pick(draw, [*units_of(old.dimension), *same])
        numbers = in_unit(match[1], match[2], new.text) if new.text else None
        text = (
            re.sub(r"(?<=[a-z])/([A-Za-z]+)(?![\^\w])", r"*\1^-1", new.text) if chance(draw, 30) else new.text
        )
        return match[0] if numbers is None else f"{numbers} {text}"

    def changed(node: Any) -> Any:
        if isinstance(node, dict):
            return {key: changed(value) for key, value in node.items()}
        if isinstance(node, list):
            return [changed(item) for item in node]
        return _MEASURED.sub(replaced, node) if isinstance(node, str) else node

    return Shown(as_text(changed(data)))


def without_units(data: Any) -> Any:
    """Return a canonical program without the units in which its values are shown."""
    if isinstance(data, dict):
        return {key: without_units(value) for key, value in data.items() if key not in ("unit", "units")}
    return [without_units(item) for item in data] if isinstance(data, list) else data


_OF_UNITS = {
    "DB504": "it suspects a number of degrees with the unit rad",
}
"""Findings about the unit that is written, and why."""


@law(cost=85)
def a_quantity_has_any_of_its_units(case: Case) -> None:
    """A quantity is a number of SI units; only the texts that show it again have the unit of the author.

    The headlines of findings show quantities, so only their codes are compared.
    """
    data = data_of(case)
    expected = Meaning.of(case.write(data))
    actual = Meaning.of(case.write(case.draw(units(data))))
    codes = [
        Counter(code for code, _ in meaning.findings.elements() if code not in _OF_UNITS)
        for meaning in (actual, expected)
    ]
    assert codes[0] == codes[1], (
        f"{actual.findings - expected.findings} {expected.findings - actual.findings}"
    )
    assert (actual.program is None) == (expected.program is None)
    if actual.program is not None and expected.program is not None:
        require_equal(without_units(canonical(actual.program)), without_units(canonical(expected.program)))


# Names

_WORDS = (
    *(word for word in keyword.kwlist if word.islower()),
    *("self", "np", "math", "world", "engine", "int", "float", "range", "abs", "position", "norm", "any_"),
    *("x", "y", "z", "w", "name", "type", "shape", "none", "null", "yes", "no", "on", "off", "e1", "inf"),
    *("nan", "_", "__", "__class__", "one_", "r0", "robot", "reward", "action", "step_", "zero", "random"),
    *("a" * 40, "success", "failure", "max_steps", "supervisor", "message", "reset", "timing", "l", "o"),
)
"""Names that mean something in Python, in YAML or elsewhere in the language."""


def with_plain_names(data: Data) -> Data:
    """Return a scenario in which no name is an English word, which a headline may have."""
    return Renaming({name: f"v{number}" for number, name in enumerate(defined_names(data))}).applied(data)


def defined_names(data: Data) -> list[str]:
    """Return all names that the author of a scenario chose."""
    names: dict[str, None] = {}
    for path, value in walk(data):
        shape = shape_at(Scenario, data, path)
        if isinstance(shape, MappingOf) and isinstance(shape.key, Name):
            names |= dict.fromkeys(value)
    return list(names)


class Renaming(dict[str, str]):
    """New names by old ones; `names` are all names."""

    names: Sequence[str] = ()

    def word(self, word: str) -> str:
        """Return a name, or two joined by deepbots (`drive_left`, `gyro_age`, `red__previous_action`), with
        their new names."""
        for match in re.finditer("_+", word):
            first, second = word[: match.start()], word[match.end() :]
            if word not in self and first in self.names and second in (*self.names, "age", *BUILT_IN_NAMES):
                return f"{self.get(first, first)}{match[0]}{self.get(second, second)}"
        return self.get(word, word)

    def applied(self, node: Any) -> Any:
        """Return data in which all names in keys and texts are replaced."""
        if isinstance(node, dict):
            return {self.applied(key): self.applied(value) for key, value in node.items()}
        if isinstance(node, list):
            return [self.applied(item) for item in node]
        if not isinstance(node, str):
            return node
        return re.sub(r"(?<![A-Za-z0-9_])[a-z_]\w*", lambda match: self.word(match[0]), node)


@st.composite
def renamings(draw: Draw, names: Sequence[str], words: Sequence[str]) -> Renaming:
    """Draw new names for one to three names."""
    old = draw(st.lists(st.sampled_from(names), min_size=1, max_size=3, unique=True))
    new = draw(st.lists(st.sampled_from(words), min_size=len(old), max_size=len(old), unique=True))
    renaming = Renaming(zip(old, new, strict=True))
    renaming.names = names
    return renaming


@law(cost=125)
def a_name_is_any_name(case: Case) -> None:
    """A name has no meaning beside what it names, whatever it means in Python or elsewhere in the
    language."""
    data = with_plain_names(case.drawn.data)
    expected = Meaning.of(case.write(data))
    words = [word for word in _WORDS if word not in RESERVED]
    if "agents" in data:  # whose names and those of their parts are joined by `__`
        words = [word for word in words if "__" not in f"{word}_"]
    renaming = case.draw(renamings(defined_names(data), words))
    path = case.write(renaming.applied(data))
    actual = Meaning.of(path)
    findings = Counter((code, renaming.applied(headline)) for code, headline in expected.findings.elements())
    Meaning(actual.findings, None).require(Meaning(findings, None))
    assert (actual.program is None) == (expected.program is None)
    if actual.program is None or expected.program is None or expected.has_errors:
        return
    require_equal(canonical(actual.program), renaming.applied(canonical(expected.program)))
    if "agents" in data:
        return  # an environment needs the role of an agent, by its name
    with case.environment(case.compile(path)) as environment, reference():
        environment.reset(seed=0)
        environment.action_space.seed(0)
        environment.step(environment.action_space.sample())


@law(cost=60)
def a_reserved_name_is_one_mistake(case: Case) -> None:
    """A name that is refused is refused where it is defined; what uses it has no finding of its own."""
    data = case.drawn.data
    names = [*data["robots"], *data.get("action", {})]
    for section in ("parameters", "objects", "signals", "augment"):
        names += data.get(section, {})
    words = [*("g", "m", "min", "h", "rad", "if", "is", "any", "auto", "urdf", "lambda")]
    if chance(case.draw, 50):
        words += ["time", "step", "ground", "arena", "previous_action"]
    else:  # what is on board of a robot
        names += [name for robot in data["robots"].values() for name in robot["sensors"]]
    renaming = case.draw(renamings(names, words))
    own = Meaning.of(case.write(data)).findings
    findings = Meaning.of(case.write(renaming.applied(data))).findings - own
    errors = Counter({entry: n for entry, n in findings.items() if RULES[entry[0]].severity == "error"})
    assert {code for code, _ in errors} == {"DB202"}, errors
    assert len(errors) == len(renaming), errors


# Defaults


@st.composite
def with_defaults(draw: Draw, data: Data) -> Shown:
    """Draw a text in which some keys that are absent have their default."""
    whole = copy.deepcopy(data)
    for path, value in [((), data), *walk(data)]:
        model = shape_at(Scenario, data, path)
        if not isinstance(value, dict) or not isinstance(model, type) or _is_inherited(data, path):
            continue
        for key, info in model.model_fields.items():
            default = info.default if isinstance(info.default, bool | int | float | str) else ""
            if key not in value and default != "" and chance(draw, 40) and _may_be_added(model, value, key):
                data_at(whole, path)[key] = default
    return Shown(as_text(whole))


_NO_DEFAULT = {"Observed": ("noise",), "Measured": ("noise",)}
"""Keys that are refused in some places, though they have a default: a truth value and a picture have no
noise."""


def _is_inherited(data: Data, path: Path) -> bool:
    """Return whether an absent key has the value of another section: of the agent that this one is like, or of
    the common training."""
    if path[:1] != ("agents",) or len(path) < 2:
        return False
    return "like" in data["agents"][path[1]] or ("train" in data and path[2:3] == ("train",))


def _may_be_added(model: type[Section], data: Data, key: str) -> bool:
    refused = (*LEFT_OUT.get(model.__name__, ()), *_NO_DEFAULT.get(model.__name__, ()))
    full = any(
        key in rule.names and len(data.keys() & set(rule.names)) >= rule.max for rule in model.key_rules
    )
    return key not in refused and not full


@law(cost=70)
def a_default_may_be_written(case: Case) -> None:
    """The default of a key is what its absence means, so writing it changes nothing."""
    data = data_of(case)
    expected = Meaning.of(case.write(data))
    Meaning.of(case.write(case.draw(with_defaults(data)))).require(expected)


# Cases

_SET = ("parameters", "world", "objects", "robots", "messages", "signals", "augment", "reward", "termination")
"""Sections that a case may change."""


@st.composite
def settings(draw: Draw, data: Data) -> Data:
    """Draw some values of the scenario, as the settings of a case that changes nothing."""
    values = {
        ".".join(map(str, path)): value
        for path, value in walk(data)
        if path[0] in _SET and len(path) > 1 and not isinstance(value, dict | list)
    }
    return {
        path: values[path] for path in draw(st.lists(st.sampled_from(list(values)), max_size=3, unique=True))
    }


@law(cost=95)
def a_case_that_sets_what_is_set_is_the_scenario(case: Case) -> None:
    """A case or a stage is the scenario with its settings: if these are those of the scenario, so is the
    task, and no rule has more to say."""
    data = data_of(case)
    if "agents" in data:
        reject()
    for section in ("evaluation", "curriculum", "tests", "tune"):
        data.pop(section, None)
    expected = Meaning.of(case.write(data))
    data["evaluation"] = {"cases": {"same": {"set": case.draw(settings(data))}}}
    actual = Meaning.of(case.write(data))
    # A text that a rule judges by itself is judged once more where the case repeats it.
    judged = {(code, headline.removeprefix("in case `same`, ")) for code, headline in actual.findings}
    assert judged == set(expected.findings)
    if actual.program is not None and expected.program is not None:
        (variant,) = actual.program.cases
        require_equal(canonical(replace(variant.program, cases=())), canonical(expected.program))


# Fixes

_DAMAGES = {
    "unit": (r"(?<![\w.])(\d[\d_.]*) [a-z]\w*(?![\w/*^])", (r"\1", r"\1 kg", r"\1 degrees")),
    "second": (r"(?<=\d )s\b(?![\w/*^])", ("sec", "seconds")),  # of `20 ms`, `20 sec` would be another time
    "meter": (r"(?<=\d )m\b(?![\w/*^])", ("meter",)),
    "name": (
        r"(?<!\d )(?<!\w)([a-z_])([a-z_0-9])([a-z_0-9]{2,})",
        (r"\1\3", r"\1\2\2\3", r"\2\1\3", r"\1_\2\3"),
    ),
    "range": (r"(-?[\d.]+) \.\. (-?[\d.]+)", (r"\2 .. \1",)),
    "indentation": (r"(?m)^  (?=\w)", ("", " ", "    ")),
    "kind": (r"(?m)(?<=: )(\w[^\n#]*)$", (r"[\1]", r"{value: \1}", r"\1,5", "yes", r"\1%", "1_0")),
}
"""Slips by their kind: the form of the text, and what is written instead."""


def damaged(draw: Draw, text: str) -> tuple[str, str, str]:
    """Damage one place as a person does; returns the kind of the slip, what was there, and the text."""
    places = {kind: [*re.finditer(form, text)] for kind, (form, _) in _DAMAGES.items()}
    kind = pick(draw, [kind for kind, matches in places.items() if matches])
    match = pick(draw, places[kind])
    slip = match.expand(pick(draw, _DAMAGES[kind][1]))
    return kind, match.group(), text[: match.start()] + slip + text[match.end() :]


@law(cost=100)
def a_fix_removes_its_finding(case: Case) -> None:
    """A fix that lint offers is what to write instead: it leaves one finding of this kind less, and no more
    errors than before, but for other uses of a name whose definition is misspelled."""
    kind, word, text = damaged(case.draw, case.drawn.text)
    findings = all_findings(api.load(case.write(text), tests=True))
    before = Counter((finding.code, finding.headline) for finding in findings)
    for finding, fix in ((finding, finding.fix) for finding in findings if finding.fix):
        after = Meaning.of(case.write(edited(finding.span.source, fix.edits), "fixed.yaml")).findings
        about = f"{kind}: {finding.code} {finding.headline}, fixed by {[edit.text for edit in fix.edits]}"
        entry = (finding.code, finding.headline)
        assert after[entry] < before[entry], about
        if kind == "name":
            after = Counter({entry: count for entry, count in after.items() if word not in entry[1]})
        # A text that can be read, and a quantity whose unit exists, have a meaning, which may not fit.
        is_read = finding.code in ("DB401", "DB501")
        assert is_read or errors_in(after) <= errors_in(before), f"{about}: {after - before}"


def errors_in(findings: Counter[tuple[str, str]]) -> int:
    return sum(count for (code, _), count in findings.items() if RULES[code].severity == "error")
