"""Names that a JSON Schema may list: those of the language, and, for one scenario, its own joints, links, signals ...

What another file defines (joints and links of a robot file) is listed and checked. What the scenario itself defines is only
offered: the schema is older than the next name that is written into the file, which is no mistake.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from deepbots_cli.document import shipped
from deepbots_cli.scenario.fields import Expression, FilePath, JsonSchema, Leaf, Pattern, Quantity, Range, Reference
from deepbots_cli.scenario.hover import unit_of
from deepbots_cli.scenario.plain import COLOURS, Colour, Word

_WILD: JsonSchema = {"title": "a pattern", "type": "string", "pattern": r"[*?\[]"}


@dataclass(frozen=True)
class Offer:
    """Names for one kind of value, each with what is said of it; `only` these are right, and patterns over them."""

    names: Mapping[str, str]
    only: bool = False

    def laid_upon(self, schema: JsonSchema, noun: str) -> JsonSchema:
        """The schema of a value called `noun`, with the names as an enumeration beside whatever else may stand there.

        Where anything else may, the enumeration is there to be offered: one of the two forms always holds, and what is
        wrong is said by the rest of the schema. Both have titles, or the YAML language server would show the texts of both.
        """
        if not self.names:
            return schema
        known: JsonSchema = {"title": "a known name", "enum": list(self.names)}
        if any(self.names.values()):
            known["enumDescriptions"] = list(self.names.values())
        if self.only:
            return {"anyOf": [known, _WILD]}
        return schema | {"anyOf": [known, {"title": noun, "not": {"enum": list(self.names)}}]}


Names = Mapping[str, Offer]
"""Offers by the topic of a value (`topics`)."""


@dataclass(frozen=True)
class Known:
    """What is known of one scenario: names that are the same everywhere, and those that differ from robot to robot."""

    everywhere: Names = field(default_factory=dict)
    robots: Mapping[str, Names] = field(default_factory=dict)


def figure_topic(unit: str, stage: str) -> str:
    """The topic of single figures that are kept in this unit and settled at this stage."""
    return f"{unit}, {stage}"


def topics(leaf: Leaf) -> tuple[str, ...]:
    """The words under which names for a value of this kind are looked up."""
    match leaf:
        case Reference(kind=kind) | FilePath(kind=kind):
            return (kind,)
        case Pattern(kind=kind):
            return (f"{kind} pattern",)
        case Expression(context=context):
            return (f"{context} expression",)
        case Quantity(components=None, stage=stage):
            return tuple(figure_topic(unit, stage) for unit in unit_of(leaf).split(" or "))
        case Colour():
            return ("colour",)
        case Range(auto=True):
            return ("known range",)
        case _:
            return ()


def offered(leaf: Leaf, names: Names) -> Offer | None:
    """What is known for a value of this kind; for a word it is all words."""
    if isinstance(leaf, Word):
        return Offer(dict.fromkeys(leaf.words, ""))
    offers = [names[topic] for topic in topics(leaf) if topic in names]
    together = {name: said for offer in offers for name, said in offer.names.items()}
    return Offer(together, offers[0].only) if together else None


def listed(leaf: Leaf, names: Names) -> JsonSchema:
    """The schema of a single value, or of several, with the names that are known for it."""
    schema, offer = leaf.json_schema(), offered(leaf, names)
    if offer is None or isinstance(leaf, Word):
        return schema
    if isinstance(leaf, Reference) and leaf.several:
        one = offer.laid_upon({"type": "string"}, leaf.noun)
        return schema | {"items": one, "anyOf": [{"title": leaf.noun, "type": "array"}, *_forms(one)]}
    return offer.laid_upon(schema, leaf.noun)


def lists(schema: JsonSchema, value: object) -> bool:
    """Whether editors offer this value by what the schema lists: words, names, truth values, the default."""
    words = [word for form in (schema, *_forms(schema)) if isinstance(form, dict) for word in form.get("enum", ())]
    return value in words or schema.get("type") == "boolean" or schema.get("default") == value


def _forms(schema: JsonSchema) -> list[object]:
    forms = schema.get("anyOf")
    return list(forms) if isinstance(forms, list) else []


LANGUAGE: Names = {
    "robot file": Offer(dict.fromkeys(shipped.robot_names(), "a robot that comes with deepbots")),
    "region": Offer({"arena": "the floor of the arena"}),
    "colour": Offer(dict.fromkeys(COLOURS, "")),
    "known range": Offer({"auto": "the interval that is known of the value"}),
}
