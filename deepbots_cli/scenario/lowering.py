"""Specs to JSON Schema: parts become definitions, forms and kinds `if` and `then`, and every key says what it is.

Of `anyOf` or `oneOf` over several forms an editor shows what is wrong with each of them, and offers the keys of all. So they are left
to enumerations (`known`), and a form is chosen as the compiler does it: by the word under one key, by a key that
gives the form away, or by the shape of the data.

Beside the standard, the schema has what the YAML language server knows: `markdownDescription`, `enumDescriptions`, `errorMessage`,
`patternErrorMessage`, and `defaultSnippets`, which it offers as values. It offers `examples` too, but shows them once more
below the text of a hover, and a mapping among them is offered as `[object Object]`.
"""

from __future__ import annotations

import inspect
import re
from collections.abc import Iterator, Mapping
from itertools import combinations

from deepbots_cli.scenario.examples import example_of
from deepbots_cli.scenario.fields import JsonSchema, Leaf
from deepbots_cli.scenario.hover import as_markdown, hover
from deepbots_cli.scenario.known import Known, Names, listed, lists, offered
from deepbots_cli.scenario.part import REQUIRED, Alternatives, Keys, Kinds, Listed, Mapped, Part, Spec, fields, noun_of
from deepbots_cli.scenario.robot import Robot
from deepbots_cli.scenario.scenario import Scenario

INCLUDE: JsonSchema = {"$ref": "#/$defs/include"}


def annotated(schema: JsonSchema, sentence: str, example: str) -> JsonSchema:
    """The schema of a key that stands in no model."""
    return schema | {"description": sentence, "markdownDescription": as_markdown(sentence, [], example)}


_ACROSS_FILES = {
    "extends": annotated({"type": "string"}, "Another scenario that this one changes.", "extends: cartpole.yaml"),
    "remove": annotated(
        {"type": "array", "items": {"type": "string"}},
        "Paths to take out of the extended scenario, such as `observation.tip_speed`.",
        "remove: [observation.tip_speed]",
    ),
}


class Lowering:
    """Writes specs as schemas; `definitions` holds those of the parts that were met.

    A `fragment` lacks nothing that is required. `names` are listed where they may stand; within a robot those of that
    robot, whose parts are definitions of their own, told apart by `suffix`.
    """

    def __init__(self, definitions: dict[str, JsonSchema], known: Known, names: Names, *, fragment: bool, suffix: str = "") -> None:
        self.definitions = definitions
        self._known = known
        self._names = names
        self._fragment = fragment
        self._suffix = suffix

    def schema(self, spec: Spec) -> JsonSchema:
        match spec:
            case Leaf():
                return listed(spec, self._names)
            case Listed():
                return {"type": "array", "items": self.schema(spec.item)} | self._at_least("minItems", spec.size.least)
            case Mapped():
                return self._mapped(spec)
            case Alternatives():
                return self._alternatives(spec)
            case Kinds():
                return self._kinds(spec)
            case _:
                return self.reference(spec)

    def reference(self, part: type[Part], key: str = "", kind: str = "") -> JsonSchema:
        """The definition of a part; of one that is told by its `kind` under `key`, that word is the example."""
        name = f"{part.__name__}{'Fragment' if self._fragment else ''}{self._suffix}"
        if name not in self.definitions:
            self.definitions[name] = {}  # holds the place in the order, and ends a recursion
            self.definitions[name] = self._part(part, {key: kind})
        return {"$ref": f"#/$defs/{name}"}

    def _at_least(self, keyword: str, least: int) -> JsonSchema:
        return {keyword: least} if least and not self._fragment else {}

    def _mapped(self, spec: Mapped) -> JsonSchema:
        key = listed(spec.key, self._names)
        if isinstance(forms := key.get("anyOf"), list):
            key = {**key, "anyOf": [*forms, {"const": "include"}]}
        properties: JsonSchema = {"include": INCLUDE}
        if spec.value is Robot and not self._suffix:
            properties |= {name: self._within(name).reference(Robot) for name in self._known.robots}
        return {
            "type": "object",
            "properties": properties,
            "propertyNames": key,
            "additionalProperties": self.schema(spec.value),
        } | self._at_least("minProperties", min(spec.size.least, 1))

    def _within(self, robot: str) -> Lowering:
        names = {**self._names, **self._known.robots[robot]}
        return Lowering(self.definitions, self._known, names, fragment=self._fragment, suffix=f".{robot}")

    def _alternatives(self, spec: Alternatives) -> JsonSchema:
        """Names are listed beside the forms, where the YAML language server looks for what it may offer; there all forms hold."""
        *others, schema = map(self._form, spec.options)
        for option, form in zip(reversed(spec.options[:-1]), reversed(others), strict=True):
            schema = {"if": _shape_of(option), "then": form, "else": self._with_marks(option, schema)}
        offers = (offered(option, self._names) for option in spec.options if isinstance(option, Leaf))
        return schema | next((offer.laid_upon({}, noun_of(spec)) for offer in offers if offer), {})

    def _with_marks(self, form: Spec, other: JsonSchema) -> JsonSchema:
        """The other forms, and the keys that would make it this one: they do not stand there, and are offered."""
        marks = [key for key in fields(form) if key in form.marks] if isinstance(form, type) else []
        if not isinstance(form, type) or not marks:
            return other
        known = other.get("properties")
        offered_too: JsonSchema = {key: self._property(form, key, fields(form)[key], "") for key in marks}
        return other | {"properties": offered_too | (known if isinstance(known, dict) else {})}

    def _form(self, spec: Spec) -> JsonSchema:
        return spec.json_schema() if isinstance(spec, Leaf) else self.schema(spec)

    def _kinds(self, spec: Kinds) -> JsonSchema:
        models = {name: spec.model(name) for name in spec.names}
        branches: list[JsonSchema] = [
            {"if": {"properties": {spec.key: {"const": name}}, "required": [spec.key]}, "then": self.reference(model, spec.key, name)}
            for name, model in models.items()
        ]
        branches += [
            {"if": {"required": [mark], "not": {"required": [spec.key]}}, "then": self.reference(model)} for mark, model in spec.marked
        ]
        told_by = (spec.key, *(mark for mark, _ in spec.marked))
        kind = {"enum": list(models), "enumDescriptions": [spec.about(name) for name in models]}
        first = models[spec.names[0]]
        properties: JsonSchema = {spec.key: kind | hover(first, spec.key, fields(first)[spec.key], spec.names[0])}
        properties |= {mark: hover(model, mark, fields(model)[mark]) for mark, model in spec.marked}
        return {
            "type": "object",
            "properties": properties | {"include": INCLUDE},
            "allOf": branches if self._fragment else [_least_one(told_by), *branches],
        }

    def _part(self, part: type[Part], kinds: Mapping[str, str]) -> JsonSchema:
        properties: JsonSchema = {name: self._property(part, name, spec, kinds.get(name, "")) for name, spec in fields(part).items()}
        if part is Scenario:
            properties |= _ACROSS_FILES
        properties["include"] = INCLUDE
        schema: JsonSchema = {
            "type": "object",
            "description": _doc(part),
            "properties": properties,
            "additionalProperties": False,
        }
        demands = list(self._demands(part))
        return schema | ({"allOf": demands} if demands else {})

    def _property(self, part: type[Part], name: str, spec: Spec, kind: str) -> JsonSchema:
        offer = offered(spec, self._names) if isinstance(spec, Leaf) else None
        own = next(iter(offer.names)) if offer and offer.only else kind  # `joint: left_wheel` is no example for an arm
        said = hover(part, name, spec, own)
        schema = _said_of_entries(self.schema(spec), said) | said
        default = part.declared[name].default
        if isinstance(default, (str, int, float)) and default != "":
            schema["default"] = default
        example = example_of(part, name)
        single = isinstance(spec, Alternatives) or (example and isinstance(example.data, (str, int, float)))
        if example and single and not own and not lists(schema, example.data):
            schema["defaultSnippets"] = [{"label": example.text, "body": f"${{1:{_escaped(example.text)}}}"}]
        return schema

    def _demands(self, part: type[Part]) -> Iterator[JsonSchema]:
        required = [name for name, info in part.declared.items() if info.default is REQUIRED]
        if required and not self._fragment:
            yield _unless_included({"required": required})
        for keys in part.needs:
            if keys.least and not self._fragment:
                yield _least_one(keys.names)
            if keys.most == 1:
                yield from _excluding(keys)


def _said_of_entries(schema: JsonSchema, said: JsonSchema) -> JsonSchema:
    """What has no key of the language is told of like the list or mapping it stands in; parts tell of themselves."""
    for keyword in ("additionalProperties", "items"):
        entries = schema.get(keyword)
        if isinstance(entries, dict) and not entries.keys() & {"$ref", "allOf"}:
            schema = schema | {keyword: entries | said}
    return schema


def _escaped(text: str) -> str:
    """The text within the place holder of a snippet."""
    return re.sub(r"([\\$}])", r"\\\1", text)


def _doc(part: type[Part]) -> str:
    return inspect.cleandoc(part.__doc__ or "")


def _unless_included(demand: JsonSchema) -> JsonSchema:
    """A file that is included may bring what is missing."""
    return {"if": {"not": {"required": ["include"]}}, "then": demand}


def _least_one(names: tuple[str, ...]) -> JsonSchema:
    """One of several keys must stand there; the message names all of them, and the standard keyword the first."""
    message = f"missing key {' or '.join(f'`{name}`' for name in names)}"
    given = [{"required": [name]} for name in (*names, "include")]
    return {"if": {"not": {"anyOf": given}}, "then": {"required": [names[0]], "errorMessage": message}}


def _excluding(keys: Keys) -> Iterator[JsonSchema]:
    for first, second in combinations(keys.names, 2):
        message = f"`{second}` cannot stand beside `{first}`"
        yield {"if": {"required": [first, second]}, "then": {"properties": {second: False}, "errorMessage": message}}


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
