"""What a word of a scenario's text means: its description, where it is defined, and what uses it.

The functions are those of the language server.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass

from lsprotocol import types

from deepbots_cli.compiler import CheckedScenario
from deepbots_cli.insight.inspection import Row, link_rows
from deepbots_cli.lsp.hover import hover
from deepbots_cli.lsp.lookup import definitions, document_symbols
from deepbots_cli.lsp.uses import references
from deepbots_cli.lsp.workspace import CursorView, Document
from deepbots_cli.robots.model import Joint
from deepbots_cli.scenario.fields.base import with_article

_WORD = re.compile(r"[A-Za-z_]\w*")
_MAX_USES = 12
_MAX_PARTS = 4


@dataclass(frozen=True)
class Meaning:
    """What the word at a place means.

    Attributes:
        word: The word.
        text: The hover text (Markdown); empty without one.
        definitions, uses: Places as Markdown, with links to the lines of the same file; without the place of
            the word itself.
    """

    word: str
    text: str = ""
    definitions: tuple[str, ...] = ()
    uses: tuple[str, ...] = ()

    def markdown(self) -> str:
        """Return the meaning as Markdown; empty if nothing is known about the word."""
        parts = [self.text] if self.text else []
        if self.definitions:
            parts.append(f"Defined in {', '.join(self.definitions)}.")
        if self.uses:
            parts.append("Used in:")
            parts.append("\n".join(f"- {use}" for use in self.uses))
        return "\n\n".join(parts)


@dataclass(frozen=True)
class RobotPart:
    """A link or joint of a robot.

    Attributes:
        text: What it is, and how the scenario changes it, as Markdown.
        path, value: An example of such a change: the keys to a value, and the value.
    """

    text: str
    path: str
    value: str


def meaning(view: CursorView, word: str) -> Meaning:
    """Return what the word at a place means."""
    shown = hover(view)
    text = shown.contents.value if shown is not None and hasattr(shown.contents, "value") else ""
    if view.analysis is None:
        return Meaning(word, text)
    line_of_word = view.document.lines.range(view.offset, view.offset).start.line

    def lines_of(places: list[types.Location]) -> list[int]:
        lines = {place.range.start.line: None for place in places if place.uri == view.document.uri}
        return [line for line in lines if line != line_of_word]

    texts = view.document.plain.split("\n")
    uses = [(line, texts[line].partition("  #")[0]) for line in lines_of(references(view, {}))]
    return Meaning(
        word,
        text,
        tuple(map(_link, lines_of(definitions(view, {})))),
        tuple(_link(line, text) for line, text in uses[:_MAX_USES]),
    )


def names_like(document: Document, phrase: str) -> list[tuple[str, int]]:
    """Return the names of a text that have a word of a phrase, with the line of each, from 0."""
    words = {word.lower() for word in _WORD.findall(phrase) if len(word) > 2}
    names: dict[str, int] = {}

    def read(symbols: Iterable[object]) -> None:
        for symbol in symbols:
            name = str(getattr(symbol, "name", ""))
            if words & set(re.split(r"[._\W]+", name.lower())):
                names.setdefault(name, symbol.selection_range.start.line)  # type: ignore[attr-defined]
            read(getattr(symbol, "children", None) or ())

    read(document_symbols(document))
    return list(names.items())


_FACTOR = re.compile(r"(?<![\w.])\d{1,3}(?:\.\d{1,3})?(?= times\b|x\b)")
_FACTORS = {"half": "0.5", "shorter": "0.5", "smaller": "0.5", "lighter": "0.5", "twice": "2", "double": "2"}
_OF_MASS = {"heavier", "lighter", "heavy", "light", "mass", "weight"}
"""Words of a phrase: what multiplies a length or a mass, as `2 times` does, and that it is the mass."""


def parts_like(checked: CheckedScenario, phrase: str) -> list[RobotPart]:
    """Return the links and the joints of the robots that a phrase names."""
    words = {word.lower() for word in re.findall(r"\w+", phrase)}
    number = _FACTOR.search(phrase)
    factor = number[0] if number else _FACTORS.get(" ".join(words & _FACTORS.keys()), "1.5")
    parts = []
    for robot in (checked.robots or {}).values():
        for row in link_rows(robot.model):
            if str(row["link"]).lower() in words:
                parts.append(_link_part(robot.name, row, factor, of_mass=bool(words & _OF_MASS)))
        for joint in robot.model.moving_joints:
            if joint.name.lower() in words:
                parts.append(_joint_part(robot.name, joint))
    return parts[:_MAX_PARTS]


def _link_part(robot: str, row: Row, factor: str, *, of_mass: bool) -> RobotPart:
    shapes = row["seen_as"] or row["collides_as"]
    assert isinstance(shapes, list)
    sizes = f": {', '.join(shapes)} m" if shapes else ""
    mass = f", {row['mass_kg']:.4g} kg" if row["mass_kg"] else ""
    joint = f", on the joint `{row['joint']}`" if row["joint"] else ""
    text = (
        f"`{row['link']}` is a link of the robot `{robot}`{sizes}{mass}{joint}. The section `links` of the"
        " robot changes it: `scale` multiplies its size along x, y and z, and its mass follows the volume;"
        " `mass`, `friction` and `color` replace those of the robot file."
    )
    key, value = ("mass", f"urdf * {factor}") if of_mass else ("scale", f"1 1 {factor}")
    return RobotPart(text, f"robots.{robot}.links.{row['link']}.{key}", value)


def _joint_part(robot: str, joint: Joint) -> RobotPart:
    unit = "N*s/m" if joint.type == "prismatic" else "N*m*s/rad"
    text = (
        f"`{joint.name}` is {with_article(joint.type)} joint of the robot `{robot}`: it joins `{joint.child}`"
        f" to `{joint.parent}`. The section `joints` of the robot changes it: `damping`, `friction`, `range`,"
        " `armature`."
    )
    return RobotPart(text, f"robots.{robot}.joints.{joint.name}.damping", f"0.01 {unit}")


def line_link(line: int) -> str:
    """Return a link to a line (from 0) of the shown file."""
    return f"[line {line + 1}](#line:{line + 1})"


def _link(line: int, text: str = "") -> str:
    quoted = text.strip().replace("`", "'")
    return f"{line_link(line)}: `{quoted}`" if quoted else line_link(line)
