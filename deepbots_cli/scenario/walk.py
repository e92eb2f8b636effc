"""Walking a scenario by its specs, which the models of a part and its annotations give."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from functools import cache

from deepbots_cli.document.nodes import Path
from deepbots_cli.scenario.fields import Leaf
from deepbots_cli.scenario.part import Alternatives, Kinds, Listed, Mapped, Part, Spec, fields

Visit = tuple[Path, Leaf, object]


def visit(part: Part, path: Path = ()) -> Iterator[Visit]:
    """Every single value that the user wrote in a validated part: its path, its kind, and the value as it was written.

    Chosen keys come as well, with the path of their entry, the kind of the key and the key itself as value, just before
    what the entry holds. Values left to their defaults have no place in the file and are not visited.
    """
    for name, spec in fields(type(part)).items():
        if name in part.given:
            yield from _visit(spec, getattr(part, name), (*path, name))


def _visit(spec: Spec, value: object, path: Path) -> Iterator[Visit]:
    if isinstance(value, Part):
        yield from visit(value, path)
        return
    match spec, value:
        case Leaf(), tuple():
            for index, item in enumerate(value):
                yield (*path, index), spec, item
        case Leaf(), _:
            yield path, spec, value
        case Listed(), tuple():
            for index, item in enumerate(value):
                yield from _visit(spec.item, item, (*path, index))
        case Mapped(), Mapping():
            for key, item in value.items():
                yield (*path, key), spec.key, key
                yield from _visit(spec.value, item, (*path, key))
        case Alternatives(), _:
            chosen = spec.choose(value)
            if chosen is not None:
                yield from _visit(chosen, value, path)


def parts(spec: Spec, data: object, path: Path = ()) -> Iterator[tuple[Path, type[Part], Mapping[str, object]]]:
    """Every part in raw data, as far as the data can be recognised: its path, its model, and its keys."""
    match spec, data:
        case (Alternatives(), _):
            chosen = spec.choose(data)
            if chosen is not None:
                yield from parts(chosen, data, path)
        case (Kinds(), _):
            model = spec.find(data)
            if model is not None:
                yield from parts(model, data, path)
        case (Listed(), list()):
            for index, item in enumerate(data):
                yield from parts(spec.item, item, (*path, index))
        case (Mapped(), dict()):
            for key, item in data.items():
                yield from parts(spec.value, item, (*path, key))
        case (type(), dict()):
            yield path, spec, data
            for key, known in fields(spec).items():
                if key in data:
                    yield from parts(known, data[key], (*path, key))


def spec_at(spec: Spec, data: object, path: Path, *, settled: bool = True) -> Spec | None:
    """The spec of the value at `path` in raw data; None where data and language part.

    Unless `settled`, the last one still has its forms and kinds.
    """
    for step in path:
        spec_here = settle(spec, data)
        match spec_here, data:
            case (Listed(), list()) if isinstance(step, int) and 0 <= step < len(data):
                spec, data = spec_here.item, data[step]
            case (Mapped(), dict()) if step in data:
                spec, data = spec_here.value, data[step]
            case (type(), dict()) if isinstance(step, str) and step in data and step in fields(spec_here):
                spec, data = fields(spec_here)[step], data[step]
            case _:
                return None
    return settle(spec, data) if settled else spec


def settle(spec: Spec, data: object) -> Spec | None:
    """The spec with its forms and kinds decided by the data."""
    match spec:
        case Alternatives():
            chosen = spec.choose(data)
            return None if chosen is None else settle(chosen, data)
        case Kinds():
            return spec.find(data)
        case _:
            return spec


Home = tuple[str, ...]


@cache  # a file may hold thousands of unknown keys, and the walk takes a millisecond
def homes(part: type[Part]) -> Mapping[str, frozenset[Home]]:
    """Where below a part each key of the language is known: the paths of the parts that have it, `*` for a name of the user's own."""
    found: dict[str, set[Home]] = {}
    for home, key in _homes(part, ()):
        found.setdefault(key, set()).add(home)
    return {key: frozenset(places) for key, places in found.items()}


def _homes(spec: Spec, path: Home) -> Iterator[tuple[Home, str]]:
    match spec:
        case Listed():
            yield from _homes(spec.item, path)
        case Mapped():
            yield from _homes(spec.value, (*path, "*"))
        case Alternatives():
            for option in spec.options:
                yield from _homes(option, path)
        case Kinds():
            for model in {*map(spec.model, spec.names), *(model for _, model in spec.marked)}:
                yield from _homes(model, path)
        case type():
            for name, known in fields(spec).items():
                yield path, name
                yield from _homes(known, (*path, name))
