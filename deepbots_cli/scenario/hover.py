"""What is said of a key where it is looked up: what it is, its unit, its default, an example; for the reference and for editors."""

from __future__ import annotations

from deepbots_cli.scenario.examples import example_of
from deepbots_cli.scenario.fields import Column, JsonSchema, Quantity, Range
from deepbots_cli.scenario.part import REQUIRED, Alternatives, Listed, Mapped, Part, Spec

_KEPT_IN = {
    "length": "m",
    "time": "s",
    "angle": "rad",
    "mass": "kg",
    "density": "kg/m^3",
    "number": "1",
    "speed": "m/s",
    "angular speed": "rad/s",
    "acceleration": "m/s^2",
    "angular acceleration or acceleration": "rad/s^2 or m/s^2",
    "force": "N",
    "torque": "N*m",
    "torque or force": "N*m or N",
    "stiffness": "N*m/rad or N/m",
    "damping": "N*m*s/rad or N*s/m",
    "angle or length": "rad or m",
    "angular speed or speed": "rad/s or m/s",
    "reading": "of the sensor",
    "any": "of the value",
}


def unit_of(spec: Spec) -> str:
    """The unit in which a figure is kept, `1` for a plain number; empty where there is no figure."""
    match spec:
        case Quantity(dimension=measure) | Range(dimension=measure) | Column(dimension=measure):
            return _KEPT_IN[measure]
        case Mapped(value=inner) | Listed(item=inner):
            return unit_of(inner)
        case Alternatives(options=options):
            return next((unit for unit in map(unit_of, options) if unit), "")
        case _:
            return ""


def default_of(part: type[Part], key: str) -> str:
    """The default as it would be written; empty where there is none to write."""
    value = part.declared[key].default
    if value is None or value is REQUIRED or isinstance(value, (dict, Part)) or value in ("", ()):
        return ""
    return str(value).lower() if isinstance(value, bool) else str(list(value)) if isinstance(value, tuple) else str(value)


def hover(part: type[Part], key: str, spec: Spec, example: str = "") -> JsonSchema:
    """The annotations of a key: the sentence about it alone, and with unit, default and example as Markdown.

    An `example` goes before that of `examples.yaml`, which has none of the keys that tell the kind of a part.
    """
    sentence = part.declared[key].description
    facts = [f"**Unit:** {_shown(unit)}"] if (unit := unit_of(spec)) else []
    if part.declared[key].default is REQUIRED:
        facts.append("**Required**")
    elif default := default_of(part, key):
        facts.append(f"**Default:** `{default}`")
    if not example and (found := example_of(part, key)):
        example = found.text
    return {"description": sentence, "markdownDescription": as_markdown(sentence, facts, f"{key}: {example}")}


def as_markdown(sentence: str, facts: list[str], example: str) -> str:
    """A hover text: editors show `markdownDescription` as it stands, and the marks of a plain `description` as signs."""
    return "\n\n".join([sentence, *([" · ".join(facts)] if facts else []), f"```yaml\n{example}\n```"])


def _shown(unit: str) -> str:
    if unit == "1":
        return "none, a plain number"
    return unit if unit.startswith("of the ") else f"`{unit.replace(' or ', '` or `')}`"
