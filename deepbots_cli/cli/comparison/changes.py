"""What two scenarios do not share: by path, with the words of both."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Literal

from deepbots_cli import canonical
from deepbots_cli.canonical import members
from deepbots_cli.cli.comparison.items import LOOK, VALUE, Group, Item, items
from deepbots_cli.cli.comparison.sides import Side
from deepbots_cli.cli.tables import cell, formula
from deepbots_cli.expressions.scalar import Const, Draw, Name, Op, State, World
from deepbots_cli.program import Program

_NAME = re.compile(r"[a-z_][a-z0-9_]*")
_LISTED = 3
_MISSING = object()
_AXES = {"rpy": "roll pitch yaw"} | dict.fromkeys(("", "xyz", "size", "axis", "spacing", "scale"), "x y z")
"""Names of the three components of a member, and of a whole value such as gravity."""

Kind = Literal["changed", "added", "removed"]


@dataclass(frozen=True)
class Change:
    """`one` and `other` are the texts of both sides; `through` names the parameters that make a difference where the texts are the same."""

    path: str
    group: Group
    kind: Kind
    one: str
    other: str
    through: tuple[str, ...] = ()


def changes(one: Side, other: Side) -> list[Change]:
    """All differences, the gravest group first; empty exactly if both compile to the same, but for the place of files."""
    found = [*_of_items(one, other, items(one.ir), items(other.ir)), *_of_settings(one, other)]
    if not found and canonical.digest(one.ir) != canonical.digest(other.ir):
        group = Group.cosmetic if _shuffled(one.ir) == _shuffled(other.ir) else Group.task
        found.append(Change("order of keys" if group is Group.cosmetic else "what no key tells of", group, "changed", "", ""))
    ranks = list(Group)
    gravest: dict[str, Change] = {}
    for change in sorted(found, key=lambda change: ranks.index(change.group)):
        gravest.setdefault(change.path, change)
    return list(gravest.values())


def _shuffled(scenario: Program) -> object:
    """Everything of a scenario, without a regard for order: that which means something is compared before."""
    return _bag(json.loads(canonical.to_json(canonical.with_files(scenario, lambda file: replace(file, path="")))))


def _bag(data: object) -> object:
    if isinstance(data, dict):
        return {key: _bag(value) for key, value in data.items()}
    return sorted(map(_bag, data), key=json.dumps) if isinstance(data, list) else data


def _of_items(one: Side, other: Side, before: dict[str, Item], after: dict[str, Item]) -> Iterator[Change]:
    altered = _altered_parameters(one, other)
    for path in dict.fromkeys((*before, *after)):
        old, new = before.get(path), after.get(path)
        if old and new and _values(old.value) == _values(new.value):
            continue
        if path.startswith("order of ") and not (old and new and _is_reordered(old.value, new.value)):
            continue  # other names, which are told one by one
        shown = _place(path, one, other)
        if old and new and _values(old.value, digits=12) == _values(new.value, digits=12):
            yield Change(f"last digits of {shown}", Group.cosmetic, "changed", "", "")
            continue
        group = min((item.group for item in (old, new) if item), key=list(Group).index)
        texts = _texts(one, other, shown)
        kind: Kind = "changed" if (old and new) or all(texts) else "removed" if old else "added"
        used = set(_NAME.findall(texts[0])) if texts[0] == texts[1] else set()
        through = tuple(name for name in altered if name in used)
        if texts[0] == texts[1] and not through:
            texts = _figures(old, new)
        yield Change(shown, group, kind, *texts, through)


def _values(value: object, digits: int = 17) -> object:
    """A value as tuples of its members, to compare; `urdf * uniform(0.9 .. 1.1)` has its middle a last digit beside the file's value."""
    if isinstance(value, float):
        return float(f"{value:.{digits}g}")
    inside = members(value)
    if inside is not None:
        return (type(value).__name__, *((name, _values(member, digits)) for name, member in inside.items()))
    return tuple(_values(item, digits) for item in value) if isinstance(value, tuple) else value


def _is_reordered(old: object, new: object) -> bool:
    return isinstance(old, tuple) and isinstance(new, tuple) and sorted(old) == sorted(new)


def _place(path: str, one: Side, other: Side) -> str:
    """The path as it is written: what the supervisor adds stands under `augment`, a value that is observed under its own name."""
    section, _, name = path.partition(".")
    if section == "signals" and any(name in side.names("augment") for side in (one, other)):
        return f"augment.{name}"
    return path.removesuffix(VALUE)


def _texts(one: Side, other: Side, path: str) -> tuple[str, str]:
    """What both sides write there; of a look, its colour."""
    written = f"{path.removeprefix(LOOK)}.colour" if path.startswith(LOOK) else path
    return one.wording(written), other.wording(written)


def _altered_parameters(one: Side, other: Side) -> dict[str, tuple[str, str]]:
    """The parameters whose texts differ, and those that are made of such."""
    names = list(dict.fromkeys((*one.names("parameters"), *other.names("parameters"))))
    texts = {name: (one.wording(f"parameters.{name}"), other.wording(f"parameters.{name}")) for name in names}
    altered = {name: pair for name, pair in texts.items() if pair[0] != pair[1]}
    while more := {n: p for n, p in texts.items() if n not in altered and altered.keys() & set(_NAME.findall(p[0]))}:
        altered |= more
    return altered


def _of_settings(one: Side, other: Side) -> Iterator[Change]:
    """Cases and stages: what each makes of its scenario, apart from what that is."""
    for section, before, after in (
        ("evaluation.cases", _settings(one.ir, "cases"), _settings(other.ir, "cases")),
        ("curriculum", _settings(one.ir, "curriculum"), _settings(other.ir, "curriculum")),
    ):
        for name in dict.fromkeys((*before, *after)):
            if before.get(name, _MISSING) != after.get(name, _MISSING):
                kind: Kind = "added" if name not in before else "removed" if name not in after else "changed"
                was, now = (side.stage(name) if section == "curriculum" else side.wording(f"{section}.{name}") for side in (one, other))
                yield Change(f"{section}.{name}", Group.training, kind, was, now)
        if before.keys() == after.keys() and list(before) != list(after):
            yield Change(f"order of {section}", Group.training, "changed", ", ".join(before), ", ".join(after))


def _settings(scenario: Program, section: Literal["cases", "curriculum"]) -> dict[str, object]:
    base = items(scenario)
    found: dict[str, object] = {}
    for entry in getattr(scenario, section):
        made = items(entry.program)
        different = {path: _value(made.get(path)) for path in {**base, **made} if _value(base.get(path)) != _value(made.get(path))}
        found[entry.name] = (getattr(entry, "episodes", None), getattr(entry, "until", None), different)
    return found


def _value(item: Item | None) -> object:
    return _values(item.value) if item else None


def _figures(old: Item | None, new: Item | None) -> tuple[str, str]:
    """Both values by what differs in them, where the scenario's text says nothing of it: a default, or another file.

    What only one of them has is not told in more than a few figures, since a link has dozens.
    """
    here = dict(_leaves(old.value)) if old else {}
    there = dict(_leaves(new.value)) if new else {}
    differing = [name for name in dict.fromkeys((*here, *there)) if here.get(name) != there.get(name)]
    if len(differing) > _LISTED and not (old and new):
        return "", ""
    shown = differing[:_LISTED]
    rest = f", ... {len(differing)} in all" if len(differing) > len(shown) else ""
    one, other = (", ".join(f"{name} {leaves[name]}".strip() for name in shown if name in leaves) for leaves in (here, there))
    return (one + rest if one else "", other + rest if other else "")


def _leaves(value: object, path: str = "") -> Iterator[tuple[str, str]]:
    """The single figures in a value, each with its place there."""
    value = value.value if isinstance(value, Const) else value
    match value:
        case float():
            yield path, f"{value:.12g}"
        case Name() | World() | Op() | State() | Draw():
            yield path, formula(value)
        case None:
            return
        case (str() as name, inner) if name and not isinstance(inner, str):
            yield from _leaves(inner, f"{path}.{name}".lstrip("."))
        case (str() as kind, *pairs) if pairs and all(map(_is_pair, pairs)):
            yield f"{path}.kind".lstrip("."), kind.lower()
            for pair in pairs:
                yield from _leaves(pair, path)
        case (str(), *_) if all(isinstance(name, str) for name in value):
            yield path, ", ".join(map(str, value))
        case tuple():
            axes = _AXES.get(path.rpartition(".")[2]) if len(value) == 3 and all(isinstance(item, float) for item in value) else None
            for axis, item in zip(axes.split() if axes else range(len(value)), value, strict=True):
                yield from _leaves(item, path if _is_pair(item) or len(value) == 1 else f"{path}.{axis}".lstrip("."))
        case _ if (inside := members(value)) is not None:
            for name, member in inside.items():
                yield from _leaves(member, f"{path}.{name}".lstrip("."))
        case _:
            yield path, cell(value)


def _is_pair(value: object) -> bool:
    return isinstance(value, tuple) and members(value) is None and len(value) == 2 and isinstance(value[0], str)
