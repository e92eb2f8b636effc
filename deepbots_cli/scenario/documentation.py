"""What is written about the language beside its models: the documentation of sections and of their keys, the
words that people write instead of a word of the language (`synonyms.yaml`), and the terms of Isaac Lab with
their lines in a scenario, by sections of docs/isaac-lab.md (`isaac_lab.json`).

Documentation needs the pydantic model of a section, and not the shapes of its keys. The sentence of a key is
the docstring below its field, and `examples.yaml` contains the examples, by model. Sentences are read from
the source on demand: `use_attribute_docstrings` of pydantic reads all sources on import, which takes 0.1 s.
"""

from __future__ import annotations

import ast
import inspect
import json
import re
import sys
from collections.abc import Iterable, Iterator, Mapping
from functools import cache
from itertools import pairwise, takewhile
from pathlib import Path
from typing import Any, NamedTuple

from pydantic import BaseModel

from deepbots_cli.diagnostics import Findings, Source
from deepbots_cli.document import nodes
from deepbots_cli.document.nodes import NodePath, to_data
from deepbots_cli.document.parse import parse

EXAMPLES_FILE = Path(__file__).with_name("examples.yaml")


def key_description(section: type[BaseModel], key: str) -> str:
    """Return the sentence about a key of a section."""
    docstrings = (
        _docstrings(model.__module__).get((model.__name__, key))
        for model in takewhile(lambda model: model is not BaseModel, section.__mro__)
    )
    return next(filter(None, docstrings), "")


@cache
def _docstrings(module: str) -> Mapping[tuple[str, str], str]:
    """Return the docstrings below the fields of a module, by class and field, and of its classes, with an
    empty field.

    They are read from the source, which also has them under `python -OO`.
    """
    docstrings = {}
    try:
        tree = ast.parse(inspect.getsource(sys.modules[module]))
    except OSError:  # a plug-in without source
        return {}
    for section in [node for node in tree.body if isinstance(node, ast.ClassDef)]:
        docstrings[section.name, ""] = ast.get_docstring(section) or ""
        for entry, below in pairwise(section.body):
            match entry, below:
                case ast.AnnAssign(target=ast.Name(id=name)), ast.Expr(value=ast.Constant(value=str(text))):
                    docstrings[section.name, name] = " ".join(text.split())
    return docstrings


def section_description(section: type[BaseModel]) -> str:
    """Return the sentence that describes a section."""
    text = inspect.cleandoc(section.__doc__ or "") or _docstrings(section.__module__).get(
        (section.__name__, ""), ""
    )
    return " ".join(text.partition("\n\n")[0].split())


def default_of(section: type[BaseModel], key: str) -> str:
    """Return the default as text; empty if there is none."""
    info = section.model_fields[key]
    value = info.default
    if info.is_required() or info.default_factory or value is None or value in ("", (), {}):
        return ""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, tuple):
        return str(list(value))
    return str(value)


class Example(NamedTuple):
    """The example of a key: its value as text and as data, and its node."""

    text: str
    data: object
    entry: nodes.Entry

    @classmethod
    def of(cls, entry: nodes.Entry) -> Example:
        span = entry.value.span
        return cls(span.source.text[span.start : span.end].strip(), nodes.to_data(entry.value), entry)


def example_of(section: type[BaseModel], key: str) -> Example | None:
    """Return the example of a key of a section, or of the nearest base that has one."""
    return next(
        (example for model in section.__mro__ if (example := examples().get(model.__name__, {}).get(key))),
        None,
    )


@cache
def examples() -> Mapping[str, Mapping[str, Example]]:
    """Return the examples by the name of the model, and by key."""
    findings = Findings()
    root = parse(Source(EXAMPLES_FILE.name, EXAMPLES_FILE.read_text(encoding="utf-8")), findings)
    if root is None or list(findings):
        raise ValueError(f"{EXAMPLES_FILE} is broken: {[finding.headline for finding in findings]}")
    return {
        section.key.text: {entry.key.text: Example.of(entry) for entry in _entries(section.value)}
        for section in _entries(root)
    }


def _entries(node: nodes.Node) -> tuple[nodes.Entry, ...]:
    return tuple(node.entries.values()) if isinstance(node, nodes.MappingNode) else ()


# Words that people write instead


SYNONYMS_FILE = Path(__file__).with_name("synonyms.yaml")


class Synonyms(NamedTuple):
    """The words that are written instead of each key (`xyz`, or `Model.key` for the sections of one model),
    and instead of each word that a key takes; and lines for words that need more than one word."""

    keys: Mapping[str, frozenset[str]]
    words: Mapping[str, frozenset[str]]
    lines: Mapping[str, str]


@cache
def synonyms() -> Synonyms:
    findings = Findings()
    root = parse(Source(SYNONYMS_FILE.name, SYNONYMS_FILE.read_text(encoding="utf-8")), findings)
    tables = to_data(root) if root is not None else None
    if not isinstance(tables, dict) or list(findings):
        raise ValueError(f"{SYNONYMS_FILE} is broken: {[finding.headline for finding in findings]}")
    keys, words = (
        {word: frozenset(others.split()) for word, others in tables[name].items()}
        for name in ("keys", "words")
    )
    return Synonyms(keys, words, tables["lines"])


def key_for(word: str, keys: Iterable[str], models: Iterable[str] = ()) -> str | None:
    """Return the one of the `keys` of a section for which `word` is written; None if there is none. `models`
    are the names of the section's classes.

    A word of British spelling is read as the American one.
    """
    table = synonyms().keys
    names = tuple(models)
    american = word.replace("colour", "color")
    candidates = tuple(keys)
    if american != word and american in candidates:
        return american
    plain = word.lower().replace("-", "_")
    qualified = next(
        (key for key in candidates if any(plain in table.get(f"{name}.{key}", ()) for name in names)), None
    )
    return qualified or next((key for key in candidates if plain in table.get(key, ())), None)


def word_for(word: str, words: Iterable[str]) -> str | None:
    """Return the one of the `words` of the language that corresponds to a name from another tool; None if
    there is none."""
    plain = word.lower().replace("-", "_").replace(" ", "_")
    return next((candidate for candidate in words if plain in synonyms().words.get(candidate, ())), None)


def line_for(word: str, words: Iterable[str]) -> str | None:
    """Return the line for a name from another tool that no single one of the `words` stands for, such as
    `type: stairs, inverted: true`; None if there is none."""
    line = synonyms().lines.get(word)
    return line if line is not None and re.split("[:,] ", line)[1] in words else None


# Terms of Isaac Lab


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
    for name, entry in _entries_of(data, "reward"):
        if "func" in entry:
            yield _for_reward(name, entry)
    groups = [
        name
        for name, entry in _entries_of(data, "observation")
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
    for name, entry in _entries_of(data, "disturbances"):
        if "velocity" in entry and not {"force", "torque"} & entry.keys():
            yield Advice(
                ("disturbances", name, "velocity"),
                (("disturbances", name),),
                "a push with a velocity",
                "a push is a force, mass * change of velocity / duration: 12 kg get 0.5 m/s by"
                " `force: uniform(-60 -60 0 .. 60 60 0 N), duration: 100 ms`",
            )


def _entries_of(data: Any, section: str) -> Iterator[tuple[str, Mapping[str, Any]]]:
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
