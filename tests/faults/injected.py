"""Scenarios with one known mistake each: what `lint` has to say of them is known beforehand, to the
character.

Every mistake of `places` in every way of writing of `styles`, and moreover in files laid out on a single line
behind text of other scripts, in files that others extend, and in parts that others include. Cases are drawn
evenly, and always the same.
"""

from __future__ import annotations

import json
import random
import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TypeVar

import yaml

from tests.faults.places import Fault, Slip, faults, slips
from tests.faults.styles import ANYWHERE, IN_BLOCKS, OF_KEYS, Wish

ROOT = Path(__file__).parents[2]
CRAFTED = Path(__file__).parent / "crafted"
PART = "faulty_part.yaml"
OTHER_SCRIPTS = "naïve Größe 日本語 😀 е́"
PER_GROUP = 2
"""Cases of each kind and each way of writing in a file."""


@dataclass(frozen=True)
class Injected:
    """Texts by their names, the first of which is linted, and the only finding at error level that there
    shall be.

    It begins at character `at` of the file `culprit` and ends at `until`. Of a whole value in quotes the
    quotes may be named or not, which `slack` allows. `chain` holds the places, as file, line and column, of
    what brought the culprit in.
    """

    source: str
    kind: str
    style: str
    codes: tuple[str, ...]
    files: dict[str, str]
    culprit: str
    at: int
    until: int
    slack: int = 0
    chain: tuple[tuple[str, int, int], ...] = ()

    @property
    def text(self) -> str:
        return self.files[self.culprit]


def sources() -> list[Path]:
    """The shipped scenarios, and some crafted ones."""
    return [*sorted((ROOT / "scenarios").glob("*.yaml")), *sorted(CRAFTED.glob("*.yaml"))]


def everything() -> list[Injected]:
    return [case for path in sources() for case in of_file(path)]


def of_file(path: Path) -> Iterator[Injected]:
    text = path.read_text(encoding="utf-8")
    chance = random.Random(path.name)
    name = path.name
    for group in _grouped(faults(text)):
        for style in (*ANYWHERE, *IN_BLOCKS, "one line"):
            fit = [fault for fault in group if _fits(fault, style)]
            for fault in chance.sample(fit, min(PER_GROUP, len(fit))):
                yield (
                    _on_one_line(name, text, fault)
                    if style == "one line"
                    else _in_style(name, text, fault, style)
                )
        inherited = [fault for fault in group if fault.section != "tests"]
        for fault in chance.sample(inherited, min(PER_GROUP, len(inherited))):
            style = chance.choice([style for style in (*ANYWHERE, *IN_BLOCKS) if _fits(fault, style)])
            yield _extended(_in_style(name, text, fault, style))
        for fault in chance.sample(group, min(PER_GROUP, len(group))):
            yield from _included(name, text, fault)
    for group in _grouped(list(slips(text))):
        for slip in chance.sample(group, min(2 * PER_GROUP, len(group))):
            broken = text[: slip.low] + slip.instead + text[slip.high :]
            case = Injected(name, slip.kind, "plain", slip.codes, {name: broken}, name, slip.at, slip.until)
            yield case
            yield _extended(case)


Kind = TypeVar("Kind", Fault, Slip)


def _grouped(kinds: Sequence[Kind]) -> Iterable[list[Kind]]:
    groups: dict[str, list[Kind]] = {}
    for kind in kinds:
        groups.setdefault(kind.kind, []).append(kind)
    return groups.values()


def _fits(fault: Fault, style: str) -> bool:
    if (
        style == "one line" and fault.is_shared
    ):  # such a line has no aliases, so it would have the fault twice
        return False
    if fault.is_key:
        return style in (*OF_KEYS, "one line")
    return style not in IN_BLOCKS or not fault.in_flow


def _in_style(name: str, text: str, fault: Fault, style: str) -> Injected:
    value = text[fault.start : fault.end]
    wrong = value[: fault.low] + fault.instead + value[fault.high :]
    line = text[text.rfind("\n", 0, fault.start) + 1 :]
    indent = " " * (len(line) - len(line.lstrip(" -")) + 6)
    written = {**ANYWHERE, **IN_BLOCKS}[style](Wish(wrong, fault.at, indent))
    if written.head:
        end_of_line = text.find("\n", fault.end)
        before = text[: fault.start] + written.head + text[fault.end : end_of_line] + "\n"
        after = text[end_of_line:]
    else:
        before, after = text[: fault.start], text[fault.end :]
    at, until = (len(before) + written.places[place] for place in (fault.at, fault.until))
    slack = int(fault.is_whole and written.text[:1] in ("'", '"'))
    return Injected(
        name, fault.kind, style, fault.codes, {name: before + written.text + after}, name, at, until, slack
    )


def _extended(case: Injected) -> Injected:
    """The same, in a file that one extends which another one extends."""
    name = case.source
    files = {
        name: "deepbots: 1\nname: Above\nextends: middle.yaml\n",
        "middle.yaml": f"deepbots: 1\nextends:   '{PART}'\nname: Middle\n",
        PART: case.text,
    }
    chain = (("middle.yaml", 2, 12), (name, 3, 10))
    return replace(case, style=f"{case.style}, extended", files=files, culprit=PART, chain=chain)


_SECTION = re.compile(r"^(\w+):[ ]*(?:#[^\n]*)?\n((?:[ ]+[^\n]*\n|\n)+)", re.MULTILINE)


def _included(name: str, text: str, fault: Fault) -> Iterator[Injected]:
    """The section that holds the fault, moved to the left in a file of its own."""
    section = next(
        (match for match in _SECTION.finditer(text) if match.start(2) <= fault.start < match.end(2)), None
    )
    if section is None:
        return
    lines = section[2].splitlines(keepends=True)
    indent = len(lines[0]) - len(lines[0].lstrip())
    if any(line[:indent].strip() or not line.strip() for line in lines) or lines[0].lstrip().startswith("-"):
        return
    part = "".join(line[indent:] for line in lines)
    moved = section.start(2) + indent * (text.count("\n", section.start(2), fault.start) + 1)
    case = _in_style(PART, part, replace(fault, start=fault.start - moved, end=fault.end - moved), "plain")
    head = f"{section[1]}: {{include: "
    above = f"{text[: section.start()]}{head}{PART}}}\n{text[section.end() :]}"
    chain = ((name, text.count("\n", 0, section.start()) + 1, len(head) + 1),)
    yield replace(case, source=name, style="included", files={name: above, PART: case.text}, chain=chain)


_PLAIN = re.compile(r"[-+.\w]+")


def _on_one_line(name: str, text: str, fault: Fault) -> Injected:
    """The whole scenario between brackets on a single line, behind text of other scripts."""
    line = _Line(fault)
    line.put("{summary: " + _quoted(OTHER_SCRIPTS))
    root = yaml.compose(text, yaml.CSafeLoader)
    for key, value in root.value:
        if key.value != "summary":
            line.put(", ")
            line.entry(key, value)
    line.put("}\n")
    return Injected(
        name,
        fault.kind,
        "one line",
        fault.codes,
        {name: line.text},
        name,
        *line.place,
        slack=int(fault.is_whole),
    )


class _Line:
    """Grows to the right; `place` is where the fault came to stand."""

    def __init__(self, fault: Fault) -> None:
        self._fault = fault
        self.text = ""
        self.place = (0, 0)

    def put(self, text: str) -> None:
        self.text += text

    def entry(self, key: yaml.ScalarNode, value: yaml.Node) -> None:
        self._scalar(key, is_key=True)
        self.put(": ")
        self._node(value)

    def _node(self, node: yaml.Node) -> None:
        match node:
            case yaml.ScalarNode():
                self._scalar(node, is_key=False)
            case yaml.SequenceNode():
                for index, item in enumerate(node.value):
                    self.put(", " if index else "[")
                    self._node(item)
                self.put("]" if node.value else "[]")
            case yaml.MappingNode():
                for index, (key, value) in enumerate(node.value):
                    self.put(", " if index else "{")
                    self.entry(key, value)
                self.put("}" if node.value else "{}")

    def _scalar(self, node: yaml.ScalarNode, *, is_key: bool) -> None:
        fault, value = self._fault, node.value
        if (node.start_mark.index, is_key) == (fault.start, fault.is_key):
            value = value[: fault.low] + fault.instead + value[fault.high :]
            start = len(self.text) - 1  # without the closing quote of what is measured
            self.place = (start + len(_quoted(value[: fault.at])), start + len(_quoted(value[: fault.until])))
            self.put(_quoted(value))
        else:
            self.put(value if not node.style and _PLAIN.fullmatch(value) else _quoted(value))


def _quoted(text: str) -> str:
    return json.dumps(text, ensure_ascii=False)
