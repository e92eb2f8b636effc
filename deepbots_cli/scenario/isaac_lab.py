"""The terms of Isaac Lab with their lines in a scenario, by sections of docs/isaac-lab.md: the table
`isaac_lab.json`. And the advice for sections that are written as there."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

from deepbots_cli.document.nodes import NodePath

TERMS_FILE = Path(__file__).with_name("isaac_lab.json")
PAGE = "docs/isaac-lab.md"
_GROUPS = frozenset({"policy", "actor", "critic"})
_KEYS_OF_OBSERVATIONS = frozenset({"range", "history", "noise", "clip"})


class Line(NamedTuple):
    """A line of a scenario, and the section in which it is; empty for the top level."""

    section: str
    text: str


class Term(NamedTuple):
    """The lines of a term, or the reason why it has none."""

    lines: tuple[Line, ...]
    reason: str

    @property
    def reward(self) -> str:
        """The line of its reward; empty without one."""
        return next((line.text for line in self.lines if line.section == "reward"), "")


@cache
def terms() -> Mapping[str, Term]:
    """Return the terms by name."""
    table = json.loads(TERMS_FILE.read_text(encoding="utf-8"))
    return {
        name: Term(tuple(Line(*line) for line in row["lines"]), row["reason"])
        for rows in table.values()
        for row in rows
        for name in row["names"]
    }


def term_help(name: str) -> str | None:
    """Return the help for a name that is a term of Isaac Lab; None for other names."""
    return f"a term of Isaac Lab: `deepbots explain {name}` shows its line" if name in terms() else None


class Advice(NamedTuple):
    """What to write for the entries at `paths`, which are written as in Isaac Lab; `path` is the place of the
    finding."""

    path: NodePath
    paths: tuple[NodePath, ...]
    headline: str
    help: str


def advice(data: Any) -> Iterator[Advice]:
    """Yield the advice for the sections of a scenario."""
    for name, entry in _entries(data, "reward"):
        if "func" in entry:
            yield _for_reward(name, entry)
    groups = [
        name
        for name, entry in _entries(data, "observation")
        if name in _GROUPS and not _KEYS_OF_OBSERVATIONS & entry.keys()
    ]
    if groups:
        yield Advice(
            ("observation", groups[0]),
            tuple(("observation", name) for name in groups),
            f"`{groups[0]}` is a group of observations",
            "list the entries of the policy directly under `observation`, as in `observation:"
            " {v: -2 .. 2 m/s}`, and those of the group `critic` under `critic`, at the top level",
        )
    for name, entry in _entries(data, "disturbances"):
        if "velocity" in entry and not {"force", "torque"} & entry.keys():
            yield Advice(
                ("disturbances", name, "velocity"),
                (("disturbances", name),),
                "a push with a velocity",
                "a push is a force, mass * change of velocity / duration: 12 kg get 0.5 m/s by"
                " `force: uniform(-60 -60 0 .. 60 60 0 N), duration: 100 ms`",
            )


def _entries(data: Any, section: str) -> Iterator[tuple[str, Mapping[str, Any]]]:
    entries = data.get(section) if isinstance(data, Mapping) else None
    if isinstance(entries, Mapping):
        for name, entry in entries.items():
            if isinstance(entry, Mapping):
                yield name, entry


def _for_reward(name: str, entry: Mapping[str, Any]) -> Advice:
    function = str(entry["func"]).rpartition(".")[-1]
    term = terms().get(function)
    line = term.reward if term is not None else ""
    example = f"that of `{function}` is `{line}`; see {PAGE}" if line else f"as in {PAGE}"
    return Advice(
        ("reward", name, "func"),
        (("reward", name),),
        f"`{name}` is a term with `func`",
        f"a term is a line with its weight: {example}",
    )
