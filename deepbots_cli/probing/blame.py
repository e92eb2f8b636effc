"""Which part of a scenario it was that had no value when an episode broke off."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Literal

from deepbots_cli.diagnostics import Span
from deepbots_cli.expressions.scalar import Name, walk
from deepbots_cli.probing.probed import Probed
from deepbots_cli.program import Program
from deepbots_cli.program.values import Expression

Section = Literal["observation", "reward", "other"]


@dataclass(frozen=True)
class Blamed:
    """The definition at fault, and for what it is needed."""

    name: str
    span: Span
    section: Section
    notes: tuple[str, ...]


def blamed(probed: Probed) -> Blamed | None:
    """None where nothing broke off, or where no expression was at fault."""
    stop = probed.report.stop or {}
    if stop.get("kind") != "value":
        return None
    text = str(stop.get("text", ""))
    notes = (probed.when(), text) if text else (probed.when(),)
    terms = {term.name: term for term in probed.program.reward}
    for name in map(str, stop.get("terms", ())):
        if name in terms:
            return Blamed(name, terms[name].span, "reward", notes)
    known = dict(_identifiers(probed))
    for line in map(str, stop.get("lines", ())):
        for word in _words(line):
            if word in known:
                name, span, section = known[word]
                return Blamed(name, span, section, notes)
    return None


def _words(line: str) -> list[str]:
    """The identifiers of a generated line: what it assigns first, then what it looks at."""
    return [word.removeprefix("self.") for word in re.findall(r"(?:self\.)?[A-Za-z_]\w*", line)]


def _identifiers(probed: Probed) -> Iterator[tuple[str, tuple[str, Span, Section]]]:
    """What generated code calls values, in the order of `codegen.names`; a name that was taken has a number behind it there."""
    program = probed.program
    for entry in program.observation:
        for name in (_identifier("seen", entry.value.name), _identifier(entry.value.name)):
            yield name, (entry.value.name, entry.value.span, "observation")
    for term in program.reward:
        yield _identifier("term", term.name), (term.name, term.span, "reward")
        yield _identifier(term.name, "term"), (term.name, term.span, "reward")
    seen, paid = _needed(program, (entry.value for entry in program.observation)), _needed(program, program.reward)
    for value in program.signals:
        section: Section = "observation" if value.name in seen else "reward" if value.name in paid else "other"
        yield _identifier(value.name), (value.name, value.span, section)
    for ending in program.endings:
        yield _identifier(ending.value.name), (ending.value.name, ending.value.span, "other")


def _identifier(*parts: str) -> str:
    return re.sub(r"\W", "_", "_".join(part for part in parts if part))


def _needed(program: Program, values: Iterable[Expression]) -> set[str]:
    """The signals that values are made of."""
    made_of = {signal.name: signal.scalars for signal in program.signals}
    found: set[str] = set()
    waiting = [scalar for value in values for scalar in value.scalars]
    while waiting:
        for node in walk(waiting.pop()):
            if isinstance(node, Name) and node.name in made_of and node.name not in found:
                found.add(node.name)
                waiting += made_of[node.name]
    return found
