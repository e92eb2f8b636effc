"""The JSON Schema of a scenario, for editors that complete, explain and check while one types.

It is made from the same specs as the models, and says what the file may look like before `extends` and
`include` are resolved: a file that extends another may leave out anything, so every part exists twice, complete
and as a fragment. Kinds are told apart by `if` and `then`, since an editor shows of `oneOf` every branch that failed.
"""

from __future__ import annotations

import inspect
import json
from collections.abc import Iterator
from itertools import combinations
from pathlib import Path

from deepbots_cli.schema.examples import example_of
from deepbots_cli.schema.fields import JsonSchema, Leaf
from deepbots_cli.schema.part import REQUIRED, Alternatives, Kinds, Listed, Mapped, Part, Spec, fields
from deepbots_cli.schema.scenario import VERSION, Scenario

FILE_NAME = f"deepbots-{VERSION}.schema.json"
_INCLUDE = {"$ref": "#/$defs/include"}
_WITH_INCLUDE: JsonSchema = {"required": ["include"]}


def json_schema() -> JsonSchema:
    """The schema (draft 2020-12), in stable order."""
    complete, fragments = _Writer(fragment=False), _Writer(fragment=True)
    whole, part = complete.schema(Scenario), fragments.schema(Scenario)
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "$id": FILE_NAME,
        "title": "deepbots scenario",
        "if": {"required": ["extends"]},
        "then": part,
        "else": whole,
        "$defs": {
            "include": {"type": "string", "description": "A file with the value of this mapping; what stands beside it is merged over it."},
            **complete.definitions,
            **fragments.definitions,
        },
    }


class _Writer:
    """Writes specs as schemas; parts become definitions. A fragment lacks nothing that is required."""

    def __init__(self, *, fragment: bool) -> None:
        self.definitions: dict[str, JsonSchema] = {}
        self._fragment = fragment

    def schema(self, spec: Spec) -> JsonSchema:
        match spec:
            case Leaf():
                return spec.json_schema()
            case Listed():
                return {"type": "array", "items": self.schema(spec.item)} | self._at_least("minItems", spec.size.least)
            case Mapped():
                return self._mapped(spec)
            case Alternatives():
                return self._alternatives(spec.options)
            case Kinds():
                return self._kinds(spec)
            case _:
                return self._reference(spec)

    def _at_least(self, keyword: str, least: int) -> JsonSchema:
        return {keyword: least} if least and not self._fragment else {}

    def _mapped(self, spec: Mapped) -> JsonSchema:
        return {
            "type": "object",
            "properties": {"include": _INCLUDE},
            "propertyNames": spec.key.json_schema(),
            "additionalProperties": self.schema(spec.value),
        } | self._at_least("minProperties", min(spec.size.least, 1))

    def _alternatives(self, options: tuple[Spec, ...]) -> JsonSchema:
        first, *others = options
        if not others:
            return self.schema(first)
        return {"if": _shape_of(first), "then": self.schema(first), "else": self._alternatives(tuple(others))}

    def _kinds(self, spec: Kinds) -> JsonSchema:
        branches: list[JsonSchema] = [
            {"if": {"properties": {spec.key: {"const": name}}, "required": [spec.key]}, "then": self._reference(spec.model(name))}
            for name in spec.names
        ]
        branches += [
            {"if": {"required": [mark], "not": {"required": [spec.key]}}, "then": self._reference(model)} for mark, model in spec.marked
        ]
        told_by: JsonSchema = {"anyOf": [{"required": [key]} for key in (spec.key, *(mark for mark, _ in spec.marked), "include")]}
        return {
            "type": "object",
            "properties": {spec.key: {"enum": list(spec.names)}},
            "allOf": branches if self._fragment else [told_by, *branches],
        }

    def _reference(self, part: type[Part]) -> JsonSchema:
        name = f"{part.__name__}Fragment" if self._fragment else part.__name__
        if name not in self.definitions:
            self.definitions[name] = {}  # holds the place in the order, and ends a recursion
            self.definitions[name] = self._part(part)
        return {"$ref": f"#/$defs/{name}"}

    def _part(self, part: type[Part]) -> JsonSchema:
        properties: JsonSchema = {name: self._property(part, name, spec) for name, spec in fields(part).items()}
        if part is Scenario:
            properties["extends"] = {"type": "string", "description": "Another scenario that this one changes."}
            properties["remove"] = {
                "type": "array",
                "items": {"type": "string"},
                "description": "Paths to take out of the extended scenario, such as `observation.tip_speed`.",
            }
        properties["include"] = _INCLUDE
        schema: JsonSchema = {
            "type": "object",
            "description": inspect.cleandoc(part.__doc__ or ""),
            "properties": properties,
            "additionalProperties": False,
        }
        demands = list(self._demands(part))
        return schema | ({"allOf": demands} if demands else {})

    def _property(self, part: type[Part], name: str, spec: Spec) -> JsonSchema:
        info = part.declared[name]
        schema = self.schema(spec) | {"description": info.description}
        if isinstance(info.default, (str, int, float)) and info.default != "":
            schema["default"] = info.default
        example = example_of(part, name)
        return schema | ({"examples": [example.data]} if example else {})

    def _demands(self, part: type[Part]) -> Iterator[JsonSchema]:
        required = [name for name, info in part.declared.items() if info.default is REQUIRED]
        if required and not self._fragment:
            yield {"anyOf": [{"required": required}, _WITH_INCLUDE]}
        for keys in part.needs:
            if keys.least and not self._fragment:
                yield {"anyOf": [*({"required": [name]} for name in keys.names), _WITH_INCLUDE]}
            if keys.most == 1:
                for pair in combinations(keys.names, 2):
                    yield {"not": {"required": list(pair)}}


def _shape_of(spec: Spec) -> JsonSchema:
    """What data of this spec looks like from outside, told apart from the other forms."""
    match spec:
        case Listed():
            return {"type": "array"}
        case Leaf():
            return {"type": ["string", "number", "boolean"]}
        case type() if spec.marks:
            return {"type": "object", "anyOf": [{"required": [mark]} for mark in sorted(spec.marks)]}
        case _:
            return {"type": "object"}


def to_text() -> str:
    """The schema as it is committed."""
    return json.dumps(json_schema(), indent=1, ensure_ascii=False) + "\n"


def main() -> None:
    """Write the schema to `schemas/` below the working directory."""
    target = Path("schemas") / FILE_NAME
    target.parent.mkdir(exist_ok=True)
    target.write_text(to_text(), encoding="utf-8")


if __name__ == "__main__":
    main()
