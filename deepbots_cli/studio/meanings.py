"""What a word of a scenario's text means: its description, where it is defined, and what uses it.

The functions are those of the language server.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

from deepbots_cli.compiler import CheckedScenario
from deepbots_cli.compiler.inventory import definition
from deepbots_cli.compiler.namespace import RobotScope
from deepbots_cli.compiler.values import ScopedExpression
from deepbots_cli.diagnostics import Source, Span
from deepbots_cli.document import descend
from deepbots_cli.document.nodes import MappingNode
from deepbots_cli.expressions import parser, syntax
from deepbots_cli.insight.inspection import Row, link_rows
from deepbots_cli.lsp.lookup import (
    definitions,
    document_symbols,
    expression_at,
    hover,
    ignore_finding,
    key_or_value_at,
)
from deepbots_cli.lsp.workspace import CursorView, Document, Locator
from deepbots_cli.robots.model import Joint
from deepbots_cli.scenario.fields import with_article

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
    places = [
        place.range.start.line
        for place in definitions(view, {})
        if place.uri == view.document.uri and place.range.start.line != line_of_word
    ]
    span = _definition_span(view)
    uses = [] if span is None else list(dict.fromkeys(_uses(view, span)))
    return Meaning(
        word,
        text,
        tuple(_link(line) for line in dict.fromkeys(places)),
        tuple(_link(line, text) for line, text in uses[:_MAX_USES] if line != line_of_word),
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


def parts_like(checked: CheckedScenario, phrase: str) -> list[RobotPart]:
    """Return the links and the joints of the robots that a phrase names."""
    words = {word.lower() for word in re.findall(r"\w+", phrase)}
    parts = []
    for robot in (checked.robots or {}).values():
        for row in link_rows(robot.model):
            if str(row["link"]).lower() in words:
                parts.append(_link_part(robot.name, row))
        for joint in robot.model.moving_joints:
            if joint.name.lower() in words:
                parts.append(_joint_part(robot.name, joint))
    return parts[:_MAX_PARTS]


def _link_part(robot: str, row: Row) -> RobotPart:
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
    return RobotPart(text, f"robots.{robot}.links.{row['link']}.scale", "1 1 1.5")


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


def _definition_span(view: CursorView) -> Span | None:
    """Return the place of the definition of the word: of a name in an expression, or of a key that is one."""
    checked = view.checked
    if checked is None or checked.document.root is None:
        return None
    node = expression_at(view)
    if node is not None and node.name is not None:
        entry = definition(checked, node.name, node.robot)
        return entry.span if entry is not None else None
    target = key_or_value_at(view)
    if target is None or not target.is_key:
        return None
    above, _, steps = descend(checked.document.root, target.path[:-1])
    if steps < len(target.path) - 1 or not isinstance(above, MappingNode):
        return None
    entry_of_key = above.entries.get(str(target.path[-1]))
    return entry_of_key.key.span if entry_of_key is not None else None


def _uses(view: CursorView, span: Span) -> Iterator[tuple[int, str]]:
    """Yield the lines (from 0) of the document whose expressions use the name that is defined at a span."""
    assert view.analysis is not None
    locator = Locator(view.analysis, {})
    for reading in view.analysis.readings:
        for name in _names(reading):
            place = reading.text.part(name.start, name.end)
            if place.source is view.source and _is_defined_at(view, reading, name, span):
                line = locator.range(place).start.line
                yield line, _line(place.source, place.start)


def _is_defined_at(view: CursorView, reading: ScopedExpression, name: syntax.Name, span: Span) -> bool:
    assert view.checked is not None
    robot = reading.scope.robot if isinstance(reading.scope, RobotScope) else None
    entry = definition(view.checked, name.dotted, robot)
    return entry is not None and entry.span == span


def _names(reading: ScopedExpression) -> Iterator[syntax.Name]:
    tree = parser.parse(reading.text.text, ignore_finding)
    nodes: list[syntax.Node] = [] if tree is None else [tree]
    while nodes:
        node = nodes.pop()
        if isinstance(node, syntax.Name):
            yield node
        nodes += syntax.children(node)


def _line(source: Source, offset: int) -> str:
    return source.text[source.text.rfind("\n", 0, offset) + 1 :].partition("\n")[0].partition("  #")[0]
