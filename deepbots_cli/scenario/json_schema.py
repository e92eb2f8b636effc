"""The JSON Schema of a scenario, for editors that complete, explain and check while one types.

    python -m deepbots_cli.scenario.json_schema      writes it to schemas/

It describes a file before `extends` and `include` are resolved, and accepts everything that the compiler
accepts. Only keys of the top level and of its sections are required, and only if a file extends no other;
`lint` checks the other keys after the merge.

Every section is one definition. For `anyOf` or `oneOf` over several forms an editor shows the errors of each
of them, and offers the keys of all. Unions are therefore `if` and `then`: a form is chosen as the compiler
chooses it, by the word under one key, by a key of this form alone, or by the shape of the data. Beside the
standard, the schema uses keywords of the YAML language server: `enumDescriptions`, `errorMessage`,
`patternErrorMessage`, and `defaultSnippets`, which it offers as values. It offers `examples` too, but shows
them once more below the text of a hover.

For one scenario the schema also lists names. Names from another file (joints and links of a robot file) are
listed and checked. Names that the scenario itself defines are only offered, since the schema is older than
the next name in the file.
"""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from dataclasses import field
from itertools import combinations
from pathlib import Path
from typing import Any

from deepbots_cli.document import shipped
from deepbots_cli.records import dataclass
from deepbots_cli.scenario.base import (
    Forms,
    Kinds,
    ListOf,
    MappingOf,
    Section,
    Shape,
    example_text,
    noun_of,
    section_fields,
    unit_of,
)
from deepbots_cli.scenario.documentation import default_of, example_of, key_description, section_description
from deepbots_cli.scenario.fields import (
    COLORS,
    ColorValue,
    FieldType,
    FilePath,
    Name,
    Pattern,
    Reference,
    Word,
)
from deepbots_cli.scenario.quantities import Expression, Range
from deepbots_cli.scenario.robots import Robot
from deepbots_cli.scenario.scenario import VERSION, Scenario
from deepbots_cli.scenario.task import AgentOfSeveral

Json = dict[str, Any]

FILE_NAME = f"deepbots-{VERSION}.schema.json"
INCLUDE: Json = {"$ref": "#/$defs/include"}
_INCLUDE: Json = {
    "type": "string",
    "description": "A file with the value of this mapping; its other keys are merged over it.\n\nExample:"
    " include: parts/arena.yaml",
}


# Names


@dataclass(frozen=True)
class OfferedNames:
    """Names for one kind of value, each with a description; with `is_complete`, other names are errors unless
    they are patterns."""

    names: Mapping[str, str]
    is_complete: bool = False

    def added_to(self, schema: Json, noun: str) -> Json:
        """Return the schema of a value called `noun`, with the names as an enumeration beside its other
        forms.

        If any other value is valid, one of the two forms always holds. Both have titles, or the YAML language
        server would show the texts of both.
        """
        if not self.names:
            return schema
        offered: Json = {"title": "a known name", "enum": list(self.names)}
        if any(self.names.values()):
            offered["enumDescriptions"] = list(self.names.values())
        if self.is_complete:
            return {"anyOf": [offered, {"title": "a pattern", "type": "string", "pattern": r"[*?\[]"}]}
        return schema | {"anyOf": [offered, {"title": noun, "not": {"enum": list(self.names)}}]}


Names = Mapping[str, OfferedNames]
"""Offers by the topic of a value (`names_key_of`)."""

_LANGUAGE: Names = {
    "robot file": OfferedNames(dict.fromkeys(shipped.robot_names(), "a robot that comes with deepbots")),
    "region": OfferedNames({"arena": "the floor of the arena"}),
    "color": OfferedNames(dict.fromkeys(COLORS, "")),
    "known range": OfferedNames({"auto": "the interval that is known of the value"}),
}


@dataclass(frozen=True)
class ScenarioNames:
    """The names of one scenario: names that are valid everywhere, and names of each robot."""

    shared: Names = field(default_factory=dict)
    robots: Mapping[str, Names] = field(default_factory=dict)


def names_key_of(shape: Shape) -> str:
    """Return the key of the names for a value of this shape; empty if there are none."""
    match shape:
        case Reference(kind=kind) | FilePath(kind=kind):
            return kind
        case Pattern(kind=kind):
            return f"{kind} pattern"
        case Expression(context=context):
            return f"{context} expression"
        case ColorValue():
            return "color"
        case Range(auto=True):
            return "known range"
        case _:
            return ""


# Shapes


def json_schema(names: ScenarioNames | None = None) -> Json:
    """Return the schema (draft 2020-12), in stable order; without names of a scenario it is the committed
    schema."""
    definitions: Json = {"include": {**_INCLUDE}}
    _Writer(
        definitions, names or ScenarioNames(), {**_LANGUAGE, **(names.shared if names else {})}
    ).reference(Scenario)
    below = {
        name: _required(shape) for name, shape in section_fields(Scenario).items() if isinstance(shape, type)
    }
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        **({} if names else {"$id": FILE_NAME}),
        "title": "deepbots scenario",
        "$ref": f"#/$defs/{Scenario.__name__}",
        "if": {"not": {"anyOf": [{"required": ["extends"]}, {"required": ["include"]}]}},
        "then": {
            "required": [name for name in _required(Scenario) if name not in AgentOfSeveral.model_fields],
            # With several agents, each has the sections of the only agent.
            "if": {"not": {"required": ["agents"]}},
            "then": {
                "required": [name for name in _required(Scenario) if name in AgentOfSeveral.model_fields]
            },
            # The YAML language server would offer keys under `properties` a second time.
            "patternProperties": {
                f"^{name}$": {"if": {"not": {"required": ["include"]}}, "then": {"required": required}}
                for name, required in below.items()
                if required
            },
        },
        "$defs": definitions,
    }


def _required(section: type[Section]) -> list[str]:
    return [name for name, info in section.model_fields.items() if info.is_required()]


def schema_text(names: ScenarioNames | None = None) -> str:
    """Return the text of the schema; the keywords of a key are on one line."""
    return re.sub(r"\n {5,}", "", json.dumps(json_schema(names), indent=1, separators=(",", ":"))) + "\n"


_ACROSS_FILES: Json = {
    "extends": OfferedNames(
        dict.fromkeys(shipped.scenario_names(), "a scenario that comes with deepbots")
    ).added_to(
        {
            "type": "string",
            "description": "The scenario that this one changes: a path relative to this file, or the name of"
            " a shipped scenario."
            "\n\nExample: extends: cartpole",
        },
        "a path",
    ),
    "remove": {
        "type": "array",
        "items": {"type": "string"},
        "description": "Paths to remove from the extended scenario.\n\nExample: remove:"
        " [observation.tip_speed]",
    },
}


class _Writer:
    """Writes shapes as schemas; `definitions` has the schemas of the sections so far.

    `names` are listed where they are valid. Within a robot they are those of that robot, whose sections are
    definitions of their own, distinguished by `suffix`.
    """

    def __init__(
        self, definitions: Json, scenario_names: ScenarioNames, names: Names, suffix: str = ""
    ) -> None:
        self.definitions = definitions
        self._known = scenario_names
        self._names = names
        self._suffix = suffix

    def schema(self, shape: Shape) -> Json:
        match shape:
            case FieldType():
                return self._single(shape)
            case ListOf(item=item):
                return {"type": "array", "items": self.schema(item)}
            case MappingOf():
                return self._mapping(shape)
            case Forms():
                return self._forms(shape)
            case Kinds():
                return self._kinds(shape)
            case _:
                return self.reference(shape)

    def reference(self, section: type[Section]) -> Json:
        shared = definition_of(section)
        home = "" if shared.__module__.startswith("deepbots_cli.") else f"{shared.__module__}."
        name = f"{home}{shared.__name__}{self._suffix}"
        if name not in self.definitions:
            self.definitions[name] = {}  # holds the place in the order
            self.definitions[name] = written = self._section(shared)
            if shared is not section:
                written["properties"]["type"]["description"] = _text(section, "type")
        return {"$ref": f"#/$defs/{name}"}

    def _single(self, shape: FieldType) -> Json:
        schema = shape.json_schema()
        offer = self._names.get(names_key_of(shape))
        if offer is None or not offer.names:
            return self._shared("name", schema) if isinstance(shape, Name) else schema
        if isinstance(shape, ColorValue):
            return self._shared("color", offer.added_to(schema, shape.noun))
        if isinstance(shape, Reference) and shape.several:
            item = offer.added_to({"type": "string"}, shape.noun)
            return schema | {
                "items": item,
                "anyOf": [{"title": shape.noun, "type": "array"}, *item.get("anyOf", ())],
            }
        return offer.added_to(schema, shape.noun)

    def _shared(self, name: str, schema: Json) -> Json:
        """Return a reference to a schema that is used at dozens of places."""
        self.definitions.setdefault(name, schema)
        return {"$ref": f"#/$defs/{name}"}

    def _mapping(self, shape: MappingOf) -> Json:
        key = self._single(shape.key)
        if forms := key.get("anyOf"):
            key = {**key, "anyOf": [*forms, {"const": "include"}]}
        properties: Json = {"include": INCLUDE}
        if shape.value is Robot and not self._suffix:
            for robot, names in self._known.robots.items():
                properties[robot] = _Writer(
                    self.definitions, self._known, {**self._names, **names}, f".{robot}"
                ).reference(Robot)
        return {
            "type": "object",
            "properties": properties,
            "propertyNames": key,
            "additionalProperties": self.schema(shape.value),
        }

    def _forms(self, shape: Forms) -> Json:
        """Return a union as `if` and `then`. The YAML language server offers names and words that are listed
        beside the forms.

        It completes a key with a colon only if the schema has a type, words or properties.
        """
        plain = [
            option.json_schema() if isinstance(option, FieldType) else self.schema(option)
            for option in shape.options
        ]
        schema = plain.pop()
        for option, form in zip(reversed(shape.options[:-1]), reversed(plain), strict=True):
            schema = {
                "if": _form_of(option),
                "then": form,
                "else": self._with_identifying_keys(option, schema),
            }
        types = (
            {}
            if any(isinstance(option, FieldType) for option in shape.options)
            else {_form_of(option)["type"]: 0 for option in shape.options}
        )
        if len(types) > 1:
            schema = {"type": list(types), **schema}
        offers = [
            self._names[topic] for option in shape.options if (topic := names_key_of(option)) in self._names
        ]
        offers += [
            OfferedNames(dict.fromkeys(option.words, ""))
            for option in shape.options
            if isinstance(option, Word)
        ]
        return schema | (offers[0].added_to({}, noun_of(shape)) if offers else {})

    def _with_identifying_keys(self, form: Shape, other: Json) -> Json:
        """Return the schema of the other forms, with the identifying keys of this form as completions."""
        if not isinstance(form, type) or not form.identifying_keys:
            return other
        identifying_keys = {
            key: self._property(form, key) for key in section_fields(form) if key in form.identifying_keys
        }
        return other | {"properties": identifying_keys | other.get("properties", {})}

    def _kinds(self, shape: Kinds) -> Json:
        key = shape.key
        branches: list[Json] = [
            {
                "if": {
                    "properties": {key: {"const": name}},
                    **({} if name == shape.default else {"required": [key]}),
                },
                "then": self.reference(model),
            }
            for name, model in shape.models.items()
        ]
        for identifying_key, model in shape.models_by_key.items():
            branches.append(
                {
                    "if": {"required": [identifying_key], "not": {"required": [key]}},
                    "then": self.reference(model),
                }
            )
        kinds = {
            "enum": list(shape.models),
            "enumDescriptions": [section_description(shape.models[name]) for name in shape.models],
        }
        first = shape.models[shape.default or shape.names[0]]
        properties: Json = {key: kinds | {"description": _text(first, key, shape.names[0])}}
        properties |= {
            identifying_key: {"description": _text(model, identifying_key)}
            for identifying_key, model in shape.models_by_key.items()
        }
        return {"type": "object", "properties": properties | {"include": INCLUDE}, "allOf": branches}

    def _section(self, section: type[Section]) -> Json:
        properties = {name: self._property(section, name) for name in section_fields(section)}
        properties = {name: self._shared_key(name, schema) for name, schema in properties.items()}
        if section is Scenario:
            properties |= _ACROSS_FILES
        schema: Json = {
            "type": "object",
            "description": section_description(section),
            "properties": properties | {"include": INCLUDE},
            "additionalProperties": False,
        }
        excluding = [
            pair for keys in section.key_rules if keys.max == 1 for pair in combinations(keys.names, 2)
        ]
        return schema | ({"allOf": list(map(_excluding, excluding))} if excluding else {})

    def _shared_key(self, key: str, schema: Json) -> Json:
        """Return the schema of a key, by reference to the first section that has the same.

        Bodies share their contact keys, sensors their errors, algorithms their settings; editors resolve the
        reference.
        """
        home = next(
            (
                name
                for name, written in self.definitions.items()
                if written.get("properties", {}).get(key) == schema
            ),
            None,
        )
        short = {"$ref": f"#/$defs/{home}/properties/{key}"}
        return short if home is not None and len(json.dumps(short)) < len(json.dumps(schema)) else schema

    def _property(self, section: type[Section], key: str) -> Json:
        shape = section_fields(section)[key]
        schema = self.schema(shape)
        # Entries have no description of their own, unless they are sections.
        for keyword in ("additionalProperties", "items"):
            entries = schema.get(keyword)
            if isinstance(entries, dict) and not entries.keys() & {"$ref", "allOf"}:
                schema = schema | {keyword: entries | {"description": key_description(section, key)}}
        # The example of the docstring may have a name that the scenario does not have, such as `left_wheel`.
        offer = self._names.get(names_key_of(shape))
        first_name = next(iter(offer.names), "") if offer and offer.is_complete else ""
        schema = {**schema, "description": _text(section, key, first_name)}
        default = section.model_fields[key].default
        if isinstance(default, (str, int, float)) and default != "":
            schema["default"] = default
        example = example_of(section, key)
        listed = isinstance(shape, (Word, ColorValue)) or "anyOf" in schema or first_name
        if example and type(example.data) in (str, int, float) and example.data != default and not listed:
            escaped = re.sub(r"([\\$}])", r"\\\1", example.text)
            schema["defaultSnippets"] = [{"label": example.text, "body": f"${{1:{escaped}}}"}]
        return schema


def definition_of(section: type[Section]) -> type[Section]:
    """Return the section whose definition also describes this one: the nearest base that differs only in the
    word of `type`."""
    base = section.__base__
    while (
        base is not None
        and "type" in getattr(base, "model_fields", ())
        and vars(section).get("__annotations__", {}).keys() == {"type"}
    ):
        section = base
        base = base.__base__
    return section


def _text(section: type[Section], key: str, example: str = "") -> str:
    """Return the sentence about a key, its unit, default and example; `example` overrides the example of the
    key."""
    unit = unit_of(section_fields(section)[key])
    default = default_of(section, key)
    facts = [f"Unit: {'none, a plain number' if unit == '1' else unit}."] if unit else []
    if section.model_fields[key].is_required():
        facts.append("Required.")
    elif default:
        facts.append(f"Default: {default}.")
    shown = example or example_text(section, key)
    return "\n\n".join(
        [key_description(section, key), " ".join([*facts, *([f"Example: {key}: {shown}"] if shown else [])])]
    ).strip()


def _excluding(pair: tuple[str, str]) -> Json:
    first, second = pair
    return {
        "if": {"required": [first, second]},
        "then": {
            "properties": {second: False},
            "errorMessage": f"`{second}` cannot be combined with `{first}`",
        },
    }


def _form_of(shape: Shape) -> Json:
    """Return a schema that only distinguishes the form of this shape from the others."""
    match shape:
        case ListOf():
            return {"type": "array"}
        case FieldType():
            return {"type": ["string", "number", "boolean"]}
        case type() if shape.identifying_keys:
            return {
                "type": "object",
                "anyOf": [{"required": [key]} for key in sorted(shape.identifying_keys)],
            }
        case _:
            return {"type": "object"}


def main() -> None:
    """Write the schema to `schemas/` below the working directory."""
    target = Path("schemas") / FILE_NAME
    target.parent.mkdir(exist_ok=True)
    target.write_text(schema_text(), encoding="utf-8")


if __name__ == "__main__":
    main()
