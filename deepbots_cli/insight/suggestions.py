"""Changes of a scenario for a phrase such as `make the pole longer`.

    suggestions(checked, "make the cart faster")
    # [Suggestion(text="...", path="parameters.wheel_speed", value="7.5 rad/s")]

The words are matched with the names of links, joints and parameters; comparatives give the factor.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, replace

from deepbots_cli.compiler import CheckedScenario
from deepbots_cli.document.nodes import ScalarNode, entries_at, node_at
from deepbots_cli.insight.inspection import Row, link_rows
from deepbots_cli.robots.model import Joint
from deepbots_cli.scenario.fields.base import with_article

_MAX_SUGGESTIONS = 4
_TIMES = re.compile(r"(?<![\w.])\d{1,3}(?:\.\d{1,3})?(?= times\b|x\b)")
_PLAIN = re.compile(
    r"((?:urdf \* |[\d.]+ +[\d.]+ +)?[-+]?)(\d[\d_]*(?:\.\d+)?(?:[eE][-+]?\d+)?)( *[A-Za-z%][\w*/^() ]*)?"
)
"""A number with its unit, a factor of the value in the robot file, or a vector of three numbers. Formulas and
draws are not multiplied."""
_QUANTITY = re.compile(r"(?<![\w.])(\d{1,4}(?:\.\d{1,4})?) ?(m|cm|mm|kg|g)\b")
_UNITS = {"m": 1.0, "cm": 0.01, "mm": 0.001, "kg": 1.0, "g": 0.001}
"""The units of a size and of a mass, in m and kg."""
_LONG_SHAPE = re.compile(r"(?:box|cylinder|capsule) .*?([\d.]+)")
"""A shape whose last number is its size along z, in m."""
_WORD = re.compile(r"[^\W_]+")
_LARGER, _SMALLER = 1.5, 2 / 3  # so that `shorter` takes `longer` back
_PROPERTIES = {
    "longer": "length",
    "shorter": "length",
    "heavier": "mass",
    "lighter": "mass",
    "heavy": "mass",
    "light": "mass",
    "weight": "mass",
    "faster": "speed",
    "slower": "speed",
    "quicker": "speed",
    "fast": "speed",
    "slow": "speed",
}
"""The property that a word is about."""
_TIMES_WORDS = {"half": 0.5, "twice": 2.0, "double": 2.0}
_LARGER_WORDS = {"longer", "larger", "bigger", "heavier", "faster", "quicker", "higher"}
_SMALLER_WORDS = {"shorter", "smaller", "lighter", "slower", "lower"}
_QUESTIONS = {"what", "when", "where", "which", "who", "why"}
"""The words of a phrase that asks for no change."""
_OF_LEARNING = {"learn", "learning", "learns", "train", "training"}


@dataclass(frozen=True)
class Suggestion:
    """A link, a joint or a parameter that a phrase names.

    Attributes:
        text: What it is, and how the scenario changes it, as Markdown.
        path, value: A change of it that fits the phrase: the keys to a value, and the value, which is that of
            the scenario if deepbots cannot change it. The value is empty if the phrase asks for no change, or
            for one that is not clear.
    """

    text: str
    path: str
    value: str


def properties(phrase: str) -> set[str]:
    """Return the properties that the words of a phrase are about: `faster` is about a speed."""
    return {_PROPERTIES[word] for word in _words(phrase) & _PROPERTIES.keys()}


def suggestions(checked: CheckedScenario, phrase: str) -> list[Suggestion]:
    """Return the changes of links, joints and parameters that a phrase names."""
    words = _words(phrase)
    is_smaller = bool(words & _SMALLER_WORDS)
    times = [float(number) for number in _TIMES.findall(phrase)]
    times += [_TIMES_WORDS[word] for word in sorted(words & _TIMES_WORDS.keys())]
    # `2 times lighter` is half as heavy; `half` is so already.
    factors = [1 / number if is_smaller and number > 1 else number for number in times if number > 0]
    factors += [_SMALLER] * is_smaller + [_LARGER] * bool(words & _LARGER_WORDS)
    factor = factors[0] if factors else _LARGER
    quantity = _QUANTITY.search(phrase)
    named = list(_parts(checked, words | properties(phrase), factor, quantity))
    if words & _OF_LEARNING:
        named += _length_of_training(checked, words, factor)
    elif factors and quantity is None:
        named += _parameters(checked, words, properties(phrase), factor)
    if words & _QUESTIONS or not (factors or quantity):
        named = [replace(suggestion, value="") for suggestion in named]
    return named[:_MAX_SUGGESTIONS]


def _words(text: str) -> set[str]:
    return {word.lower() for word in _WORD.findall(text)}


def _parts(
    checked: CheckedScenario, words: set[str], factor: float, quantity: re.Match[str] | None
) -> Iterator[Suggestion]:
    """Yield the links and joints that the words name; a `quantity` is the size or the mass of a link."""
    root = checked.document.root
    for robot in (checked.robots or {}).values():
        for row in link_rows(robot.model):
            if _words(str(row["link"])) <= words:
                is_mass = "mass" in words if quantity is None else quantity[2] in ("kg", "g")
                key, default = ("mass", "urdf * 1") if is_mass else ("scale", "1 1 1")
                path = ("robots", robot.name, "links", str(row["link"]), key)
                node = node_at(root, *path)
                written = node.text if isinstance(node, ScalarNode) else ""
                text = _link_text(robot.name, row, f"{key}: {written}" if written else "")
                value = _multiplied(written or default, factor)
                if quantity is not None:
                    value = quantity[0] if is_mass else _scaled_to(written or default, row, quantity)
                yield Suggestion(text, ".".join(path), value)
        for joint in robot.model.moving_joints:
            if _words(joint.name) <= words:
                unit = "N*s/m" if joint.type == "prismatic" else "N*m*s/rad"
                path_of_joint = f"robots.{robot.name}.joints.{joint.name}.damping"
                yield Suggestion(_joint_text(robot.name, joint), path_of_joint, f"0.01 {unit}")


def _parameters(
    checked: CheckedScenario, words: set[str], asked: set[str], factor: float
) -> Iterator[Suggestion]:
    """Yield the parameters of one number whose names have the property that is asked for or, without one, a
    word of the phrase."""
    for name, entry in entries_at(checked.document.root, "parameters").items():
        node = entry.value
        if isinstance(node, ScalarNode) and _PLAIN.fullmatch(node.text) and _words(name) & (asked or words):
            text = f"`{name}` is a parameter of this scenario: {node.text}."
            yield Suggestion(text, f"parameters.{name}", _multiplied(node.text, factor))


def _scaled_to(scale: str, row: Row, quantity: re.Match[str]) -> str:
    """Return the scale with which a link has this size along z; empty if its shape has no such size."""
    shapes = row["seen_as"] or row["collides_as"]
    assert isinstance(shapes, list)
    shape = _LONG_SHAPE.fullmatch(shapes[0]) if shapes else None
    if shape is None:
        return ""
    return _multiplied(scale, float(quantity[1]) * _UNITS[quantity[2]] / float(shape[1]))


def _length_of_training(checked: CheckedScenario, words: set[str], factor: float) -> Iterator[Suggestion]:
    """Yield the timesteps of the training, if the scenario has them and a phrase asks for a longer or a
    shorter one."""
    node = node_at(checked.document.root, "train", "total_timesteps")
    if isinstance(node, ScalarNode) and words & {"longer", "shorter"}:
        text = f"`total_timesteps` is the length of the training, in timesteps: {node.text}."
        yield Suggestion(text, "train.total_timesteps", _multiplied(node.text, factor))


def _multiplied(text: str, factor: float) -> str:
    """Return a value whose last number is multiplied; the value itself if it is not plain."""
    plain = _PLAIN.fullmatch(text)
    if plain is None:
        return text
    number = float(plain[2]) * factor
    return f"{plain[1]}{number:_.0f}" if "_" in plain[2] else f"{plain[1]}{number:.6g}{plain[3] or ''}"


def _link_text(robot: str, row: Row, written: str) -> str:
    shapes = row["seen_as"] or row["collides_as"]
    assert isinstance(shapes, list)
    sizes = f": {', '.join(shapes)} m" if shapes else ""
    mass = f", {row['mass_kg']:.4g} kg" if row["mass_kg"] else ""
    joint = f", on the joint `{row['joint']}`" if row["joint"] else ""
    present = f" The file has `{written}`." if written else ""
    return (
        f"`{row['link']}` is a link of the robot `{robot}`{sizes}{mass}{joint}.{present} The section `links`"
        " of the robot changes it: `scale` multiplies its size along x, y and z, and its mass follows the"
        " volume; `mass`, `friction` and `color` replace those of the robot file."
    )


def _joint_text(robot: str, joint: Joint) -> str:
    return (
        f"`{joint.name}` is {with_article(joint.type)} joint of the robot `{robot}`: it joins `{joint.child}`"
        f" to `{joint.parent}`. The section `joints` of the robot changes it: `damping`, `friction`, `range`,"
        " `armature`."
    )
