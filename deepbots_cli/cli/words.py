"""What a key or a function of the language is, as `deepbots explain` tells it."""

from __future__ import annotations

from collections.abc import Iterator

from deepbots_cli.lang.examples import EXAMPLES
from deepbots_cli.lang.table import FUNCTIONS
from deepbots_cli.schema.examples import example_of
from deepbots_cli.schema.hover import default_of, unit_of
from deepbots_cli.schema.part import REQUIRED, Alternatives, Kinds, Listed, Mapped, Part, Spec, fields, noun_of
from deepbots_cli.schema.scenario import Scenario

# A name such as `range` is a key of many parts.
_SHOWN = 8

Said = tuple[str, ...]


def explained(word: str) -> list[str]:
    """Lines about a function called `word`, and about the keys of that name; none if there is neither."""
    lines = list(_of_function(word))
    places: dict[Said, list[str]] = {}
    for path, part in _homes(Scenario, (), word):
        found = places.setdefault(tuple(_of_key(part, word)), [])
        if path not in found:
            found.append(path)
    for said, paths in list(places.items())[:_SHOWN]:
        more = f" and {len(paths) - _SHOWN} more places" if len(paths) > _SHOWN else ""
        lines += [*([""] if lines else []), f"{word}: a key of {', '.join(paths[:_SHOWN])}{more}", *said]
    return lines


def _of_function(word: str) -> Iterator[str]:
    function = FUNCTIONS.get(word.removesuffix("("))
    if function is not None:
        yield f"{function.signature}: a function"
        yield function.doc
        if function.name in EXAMPLES:
            yield f"For example: {EXAMPLES[function.name]}"


def _of_key(part: type[Part] | Kinds, key: str) -> Iterator[str]:
    if isinstance(part, Kinds):
        yield f"Its kind, one of {', '.join(part.names)}."
        return
    yield part.declared[key].description
    spec, default = fields(part)[key], default_of(part, key)
    unit = unit_of(spec)
    measured = f"in {'the unit ' if unit.startswith('of ') else ''}{unit}" if unit not in ("", "1") else ""
    facts = [noun_of(spec), measured, f"{default} unless given" if default else ""]
    if part.declared[key].default is REQUIRED:
        facts.append("required")
    yield f"It takes {', '.join(fact for fact in facts if fact)}."
    if example := example_of(part, key):
        yield f"For example: {key}: {example.text}"


def _homes(spec: Spec, path: Said, key: str) -> Iterator[tuple[str, type[Part] | Kinds]]:
    """The parts that have the key, each with its place in a scenario; `<name>` is one of the user's own."""
    match spec:
        case Listed():
            yield from _homes(spec.item, path, key)
        case Mapped():
            yield from _homes(spec.value, (*path, "<name>"), key)
        case Alternatives():
            for option in spec.options:
                yield from _homes(option, path, key)
        case Kinds() if spec.key == key:
            yield f"`{'.'.join(path)}`", spec
        case Kinds():
            for model in (*map(spec.model, spec.names), *(model for _, model in spec.marked)):
                yield from _homes(model, path, key)
        case type() if issubclass(spec, Part):
            for name, known in fields(spec).items():
                if name == key:
                    yield f"`{'.'.join(path)}`" if path else "a scenario", spec
                yield from _homes(known, (*path, name), key)
