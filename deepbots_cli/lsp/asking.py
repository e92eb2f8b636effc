"""What the language takes at a place of a scenario, as far as what is there so far decides it."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from deepbots_cli.document.nodes import Path
from deepbots_cli.scenario.base import Forms, Kinds, ListOf, MappingOf, Section, Shape, fields
from deepbots_cli.scenario.fields import FieldType, Reference
from deepbots_cli.scenario.scenario import Scenario

_OPTION = Reference("option")


def specs(path: Path, data: Any) -> list[Shape]:
    """Every spec that a value at `path` may have; more than one where the forms of a value are still open."""
    found = list(dict.fromkeys(_specs(Scenario, data, path)))
    # What a script decides is an expression or, which the schema cannot tell apart, one of the options of the action.
    return [_OPTION, *found] if path[:1] == ("scripts",) and len(path) == 3 else found


def leaves(path: Path, data: Any) -> list[FieldType]:
    """The single values that may stand there."""
    return [spec for spec in specs(path, data) if isinstance(spec, FieldType)]


def key_of(path: Path, data: Any) -> type[Section] | None:
    """The part that knows the key at the end of `path`; None for a name that the user chose."""
    if not path or not isinstance(path[-1], str):
        return None
    for spec in specs(path[:-1], data):
        for part in _parts(spec, at(data, path[:-1])):
            if path[-1] in fields(part):
                return part
    return None


def at(data: Any, path: Path) -> Any:
    """The plain value at `path`; an empty text where there is none."""
    for step in path:
        if isinstance(data, dict):
            data = data.get(step, "")
        elif isinstance(data, list) and isinstance(step, int) and step < len(data):
            data = data[step]
        else:
            return ""
    return data


def _specs(spec: Shape, data: Any, path: Path) -> Iterator[Shape]:
    if isinstance(spec, Forms):
        for option in _forms(spec, data, bool(path)):
            yield from _specs(option, data, path)
        return
    if not path:
        yield spec
        return
    step, rest = path[0], path[1:]
    below = at(data, (step,))
    match spec:
        case ListOf() if isinstance(step, int):
            yield from _specs(spec.item, below, rest)
        case MappingOf() if isinstance(step, str):
            yield from _specs(spec.value, below, rest)
        case FieldType() if isinstance(step, int) and not rest:
            yield spec  # a list of names is one value
        case FieldType() | ListOf() | MappingOf():
            return
        case _:
            for part in _parts(spec, data):
                if step in fields(part):
                    yield from _specs(fields(part)[str(step)], below, rest)


def _forms(spec: Forms, data: Any, goes_on: bool) -> tuple[Shape, ...]:
    """The forms that are left: that of the data, or all of them while there is little."""
    if isinstance(data, (dict, list)) and data:
        chosen = spec.choose(data)
        if chosen is not None:
            return (chosen,)
    if isinstance(data, str) and data and not goes_on:
        return tuple(option for option in spec.options if isinstance(option, FieldType)) or spec.options
    return spec.options


def _parts(spec: Shape, data: Any) -> tuple[type[Section], ...]:
    """The models whose keys may stand in data of this spec."""
    if isinstance(spec, Kinds):
        found = spec.find(data)
        return (found,) if found else spec.every
    return (spec,) if isinstance(spec, type) else ()
