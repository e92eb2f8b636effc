"""What a key, a kind, a function or a unit of the language is, as `deepbots explain` tells it."""

from __future__ import annotations

from collections.abc import Iterator

from deepbots_cli.diagnostics.nearest import nearest
from deepbots_cli.lang.examples import EXAMPLES
from deepbots_cli.lang.table import FUNCTIONS
from deepbots_cli.lang.units import UNITS
from deepbots_cli.schema.examples import example_of
from deepbots_cli.schema.fields import article
from deepbots_cli.schema.hover import default_of, unit_of
from deepbots_cli.schema.part import REQUIRED, Alternatives, Kinds, Listed, Mapped, Part, Spec, fields, noun_of
from deepbots_cli.schema.scenario import Scenario

# A name such as `range` is a key of many parts.
_SHOWN = 8

Said = tuple[str, ...]


def explained(word: str) -> list[str]:
    """Lines about a function, a unit or a kind called `word`, and about the keys of that name; none if there is nothing so called."""
    places: dict[Said, list[str]] = {}
    for path, part, mark in _parts(Scenario, (), ""):
        for said in _told(part, mark, word):
            found = places.setdefault(said, [])
            if path not in found:
                found.append(path)
    blocks = [block for block in (list(_of_function(word)), list(_of_unit(word))) if block]
    for (what, *lines), paths in list(places.items())[:_SHOWN]:
        more = f" and {len(paths) - _SHOWN} more places" if len(paths) > _SHOWN else ""
        blocks.append([f"{word}: {article(what)} of {', '.join(paths[:_SHOWN])}{more}", *lines])
    return [line for number, block in enumerate(blocks) for line in ([""] if number else []) + block]


def unknown(word: str) -> str:
    """What to say of a word that nothing is called by."""
    names = [*FUNCTIONS, *UNITS]
    for _, part, _ in _parts(Scenario, (), ""):
        names += part.names if isinstance(part, Kinds) else fields(part)
    by_letters = {name.lower(): name for name in names}
    near = nearest(word.lower(), list(by_letters))
    hint = f"; did you mean {by_letters[near]}?" if near else "; deepbots explain without a word lists the findings"
    return f"there is no finding, key, kind, function or unit '{word}'{hint}"


def _of_function(word: str) -> Iterator[str]:
    function = FUNCTIONS.get(word.removesuffix("("))
    if function is not None:
        yield f"{function.signature}: a function"
        yield function.doc
        if function.name in EXAMPLES:
            yield f"For example: {EXAMPLES[function.name]}"


def _of_unit(word: str) -> Iterator[str]:
    unit = UNITS.get(word)
    if unit is not None:
        yield f"{word}: a unit"
        yield f"1 {word} is {unit.scale / unit.divisor:.9g} {unit.dimension}." if str(unit.dimension) != word else "Figures are kept in it."


def _told(part: type[Part] | Kinds, mark: str, word: str) -> Iterator[Said]:
    """What a word is to a part: its key, its kind; of `mark`, the key that tells the kind, the kinds themselves tell."""
    if not isinstance(part, Kinds):
        if word in fields(part) and word != mark:
            yield "key", *_of_key(part, word)
        return
    if part.key == word:
        yield "key", f"Its kind, one of {', '.join(part.names)}."
    if word in part.names:
        yield part.key, *_of_kind(part, word)


def _of_kind(kinds: Kinds, name: str) -> Iterator[str]:
    yield kinds.about(name)
    model = kinds.model(name)
    keys = {key: model.declared[key].default is REQUIRED for key in fields(model) if key != kinds.key}
    needed, others = ([key for key, required in keys.items() if required is wanted] for wanted in (True, False))
    if needed:
        yield f"It needs {', '.join(needed)}."
    if others:
        yield f"It may have {', '.join(others)}."


def _of_key(part: type[Part], key: str) -> Iterator[str]:
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


def _parts(spec: Spec, path: Said, mark: str) -> Iterator[tuple[str, type[Part] | Kinds, str]]:
    """All parts of a scenario, each with its place and the key that tells its kind; `<name>` is one of the user's own."""
    place = f"`{'.'.join(path)}`" if path else "a scenario"
    match spec:
        case Listed():
            yield from _parts(spec.item, path, "")
        case Mapped():
            yield from _parts(spec.value, (*path, "<name>"), "")
        case Alternatives():
            for option in spec.options:
                yield from _parts(option, path, "")
        case Kinds():
            yield place, spec, ""
            for model in (*map(spec.model, spec.names), *(model for _, model in spec.marked)):
                yield from _parts(model, path, spec.key)
        case type() if issubclass(spec, Part):
            yield place, spec, mark
            for name, known in fields(spec).items():
                yield from _parts(known, (*path, name), "")
