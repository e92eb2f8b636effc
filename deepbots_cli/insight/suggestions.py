"""Changes of a scenario for a phrase such as `make the pole longer`.

    suggestions(checked, "make the cart faster")
    # [Suggestion(text="...", path="parameters.wheel_speed", value="7.5 rad/s")]

The words are matched with the names of links, joints and parameters. One comparative and at most one number
give the change. A phrase with more of them, a difference such as `20 cm longer`, and a change that would not
compile get no value.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import replace
from typing import NamedTuple

from deepbots_cli import frames
from deepbots_cli.compiler import CheckedScenario, check
from deepbots_cli.document.load import load, setting_path
from deepbots_cli.document.nodes import MappingNode, ScalarNode, entries_at, node_at
from deepbots_cli.insight.inspection import Row, link_rows
from deepbots_cli.records import dataclass
from deepbots_cli.robots.kinematics import bounds_of_shape, box_around, box_sides
from deepbots_cli.robots.model import Link
from deepbots_cli.scenario.fields import with_article
from deepbots_cli.scenario.robots import JointOverride, LinkOverride

_MAX_SUGGESTIONS = 4
_PLAIN = re.compile(
    r"((?:urdf \* )?[-+]?)(\d+(?:_\d+)*(?:\.\d+(?:_\d+)*)?(?:[eE][-+]?\d+)?)( *[A-Za-z%][\w*/^()]*)?"
)
"""A number with its unit, or a factor of the value in the robot file. Formulas and draws are not
multiplied."""
_UNITS = {
    "m": ("length", 1.0),
    "cm": ("length", 0.01),
    "mm": ("length", 0.001),
    "kg": ("mass", 1.0),
    "g": ("mass", 0.001),
}
"""The property that has a unit, and the unit in m or kg."""
_AMOUNT = re.compile(
    r"(?<![\w.,/+-])((?:\d{1,3}(?:[,_]\d{3})+|\d{1,6})(?:\.\d{1,6})?) ?"
    rf"(times\b|x\b|percent\b|%|(?:{'|'.join(_UNITS)})(?![\w/*^]))"
)
"""A number with its unit."""
# The words before a percentage of the present value.
_TO = re.compile(r"\bto\s+(?:(?:about|around|exactly|just|only|roughly)\s+)?$")
# With these words, a number with a unit is no new value.
_DIFFERENCES = {"add", "by", "cut", "extend", "extra", "from", "lose", "off", "remove", "subtract", "take"}
_USUAL = ("1.5", "times")
"""The amount of a phrase without one; `shorter` takes `longer` back."""
_NUMBERS = {"half": "0.5 times", "twice": "2 times", "double": "2 times", "triple": "3 times"} | {
    name: str(number)
    for number, name in enumerate(["two", "three", "four", "five", "six", "seven", "eight", "nine", "ten"], 2)
}
_NUMBER_WORD = re.compile(rf"\b(?:{'|'.join(_NUMBERS)})\b(?! an?\b)")
_WORD = re.compile(r"[^\W_]+")
_LONGEST = 0.95
"""The second side of a link over its longest one, above which the link has no length."""
_PROPERTIES = {
    "long": "length",
    "short": "length",
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
    "length": "length",
    "mass": "mass",
    "speed": "speed",
}
"""The property that a word is about."""
_LARGER_WORDS = {
    *("longer", "larger", "bigger", "heavier", "faster", "quicker"),
    *("higher", "more", "increase", "raise"),
}
_SMALLER_WORDS = {"shorter", "smaller", "lighter", "slower", "lower", "less", "reduce", "decrease"}
_LOW = {"light", "slow", "short", "small", "low"}
"""A part that is twice as light has half the mass."""
_AS_LOW = re.compile(rf"\bas (?:{'|'.join(_LOW)})\b")
_FRACTIONS = {"third", "quarter", "fifth", "tenth", "hundred", "thousand", "dozen"}
_OF_OTHER_KEYS = {
    *("wide", "wider", "width", "thick", "thicker", "thin", "thinner", "radius", "diameter", "depth"),
    *(
        word
        for model in (LinkOverride, JointOverride)
        for key in model.model_fields
        for word in key.split("_")
    ),
} - {"mass", "scale"}
"""The words about a link that are neither about its mass nor about its length."""
_TRAINING, _EPISODE = {"learn", "learning", "learns", "train", "training"}, {"episode", "episodes"}
# The words about a setting, its keys, and what it is.
_SETTINGS = (
    (_TRAINING, ("train", "total_timesteps"), "the length of the training, in timesteps"),
    (_EPISODE | {"time"}, ("truncation", "max_time"), "the time limit of an episode"),
    (_EPISODE | {"time"}, ("truncation", "max_steps"), "the limit of an episode, in timesteps"),
)
_LESS_THAN = re.compile(r"<=?\s*(\w+)")
_FILL_WORDS = {"a", "an", "make", "of", "please", "the", "with"}
_QUESTIONS = {"what", "when", "where", "which", "who", "why", "no", "not", "don", "never", "without"}
"""The words of a phrase that asks for no change."""


@dataclass(frozen=True)
class Suggestion:
    """A link, a joint or a parameter that a phrase names.

    Attributes:
        text: What it is, and how the scenario changes it, as Markdown.
        path, value: A change of it that fits the phrase: the keys to a value, and the value, which is that of
            the scenario if deepbots cannot change it. The value is empty if the phrase asks for no change, or
            for one that is not clear or does not compile.
    """

    text: str
    path: str
    value: str


def properties(phrase: str) -> set[str]:
    """Return the properties that the words of a phrase are about: `faster` is about a speed."""
    return {_PROPERTIES[word] for word in _words(phrase) & _PROPERTIES.keys()}


class _Change(NamedTuple):
    """A change of a property.

    Attributes:
        amount: The factor, or the new value in m or kg.
        unit: The property that a new value is of, `length` or `mass`; empty for a factor.
        rest: The words of the phrase beside the amount.
    """

    amount: float
    unit: str
    rest: set[str]


def suggestions(checked: CheckedScenario, phrase: str) -> list[Suggestion]:
    """Return the changes of links, joints and parameters that a phrase names."""
    words, asked = _words(phrase), properties(phrase)
    change = _change(phrase)
    named = list(_parts(checked, words, asked, change))
    if change is not None and not change.unit:
        parameters = (
            () if words & (_TRAINING | _EPISODE) else _parameters(checked, words, asked, change.amount)
        )
        named += [*parameters] or _settings(checked, words, asked, change.amount)
    numbers = {  # those of names
        word
        for word in (change.rest if change is not None else ())
        if word[0].isdigit() or word in _FRACTIONS
    }
    return [
        suggestion
        if not words & _QUESTIONS and numbers <= _words(suggestion.path) and _compiles(checked, suggestion)
        else replace(suggestion, value="")
        for suggestion in named[:_MAX_SUGGESTIONS]
    ]


def _compiles(checked: CheckedScenario, suggestion: Suggestion) -> bool:
    """Return whether the scenario with the value of a suggestion has no further errors."""
    document, value = checked.document, suggestion.value
    if document.root is None or not value:
        return False
    keys = setting_path(document.root, suggestion.path)
    depth = max(n for n in range(len(keys)) if isinstance(node_at(document.root, *keys[:n]), MappingNode))
    for key in reversed(keys[depth + 1 :]):
        value = f"{{{key}: {value}}}"
    other = load(
        document.path,
        [*document.overrides, f"{'.'.join(map(str, keys[: depth + 1]))}={value}"],
        permissions=document.permissions,
        drafts={document.path: document.source.text.encode("utf-8", "surrogatepass")},
    )
    return len(check(other).findings.errors) <= len(checked.findings.errors)


def _change(phrase: str) -> _Change | None:
    """Return the change that a phrase asks for; None if it asks for none or several, or is not clear."""
    words, asked = _words(phrase), properties(phrase)
    text = _NUMBER_WORD.sub(lambda number: _NUMBERS[number[0]], phrase.lower())
    amounts = [*_AMOUNT.finditer(text)]
    is_larger, is_smaller, is_low = (bool(words & some) for some in (_LARGER_WORDS, _SMALLER_WORDS, _LOW))
    is_compared = is_larger or is_smaller
    if (
        is_larger + is_smaller + is_low > 1
        or len(asked) > 1
        or len(amounts) + is_compared == 0
        or amounts[1:]
    ):
        return None
    number, unit = amounts[0].groups() if amounts else _USUAL
    amount, rest = float(number.replace(",", "")), _words(_AMOUNT.sub(" ", text))
    if rest & {"percent", "times"}:  # of a number in words that is not read
        return None
    if unit in _UNITS:
        name, size = _UNITS[unit]
        is_unclear = is_compared or is_low or asked - {name} or rest & _DIFFERENCES
        return None if is_unclear else _Change(amount * size, name, rest)
    if unit in ("%", "percent"):
        amount /= 100
        if not _TO.search(text, 0, amounts[0].start()):
            amount = 1 + (is_larger - is_smaller) * amount if is_compared else 0.0
    elif amount and (((is_smaller or is_low) and amount > 1) or _AS_LOW.search(text)):
        amount = 1 / amount
    is_contrary = (is_larger and amount < 1) or (is_smaller and amount > 1)
    return _Change(amount, "", rest) if amount > 0 and not is_contrary else None


def _is_named(name: str, words: set[str]) -> bool:
    """Return whether the words contain a name, of which articles and the like are no part."""
    return set() < _words(name) - _FILL_WORDS <= words


def _words(text: str) -> set[str]:
    return {word.lower() for word in _WORD.findall(text)}


def _parts(
    checked: CheckedScenario, words: set[str], asked: set[str], change: _Change | None
) -> Iterator[Suggestion]:
    """Yield the links and joints that the words name, with the change of the mass or the size of a link."""
    root = checked.document.root
    for robot in (checked.robots or {}).values():
        for link, row in zip(robot.model.links, link_rows(robot.model), strict=True):
            if _is_named(link.name, words):
                key = "mass" if "mass" in words | asked or (change and change.unit == "mass") else "scale"
                path = ("robots", robot.name, "links", link.name, key)
                node = node_at(root, *path)
                written = node.text if isinstance(node, ScalarNode) else ""
                value = (
                    ""
                    if change is None or (words - _words(link.name)) & _OF_OTHER_KEYS
                    else _value_of_link(link, key, written, words | asked, change)
                )
                text = _link_text(robot.name, row, f"{key}: {written}" if written else "")
                yield Suggestion(text, ".".join(path), value)
        for joint in filter(lambda joint: _is_named(joint.name, words), robot.model.moving_joints):
            text = (
                f"`{joint.name}` is {with_article(joint.type)} joint of the robot `{robot.name}`: it joins"
                f" `{joint.child}` to `{joint.parent}`. The section `joints` of the robot changes it: `damping`,"
                " `friction`, `range`, `armature`."
            )
            yield Suggestion(text, f"robots.{robot.name}.joints.{joint.name}", "")


def _value_of_link(link: Link, key: str, written: str, words: set[str], change: _Change) -> str:
    """Return the changed `mass` or `scale` of a link, along its longest side or, of a `larger` link, along
    all sides. It is empty if the words name no size, or the link has no longest side."""
    if key == "mass":
        return f"{change.amount:.6g} kg" if change.unit else _multiplied(written or "urdf * 1", change.amount)
    ratio, axes = change.amount, {0, 1, 2}
    if change.unit or "length" in words or not words & {"larger", "bigger", "smaller"}:
        boxes = [
            bounds_of_shape(part.shape, frames.frame(part.origin)) for part in link.visuals or link.collisions
        ]
        sides = box_sides(box_around(boxes))
        axes = {sides.index(max(sides))}
        ratio = change.amount / max(sides) if change.unit else change.amount
        is_size = "length" in words or change.rest - _words(link.name) <= _FILL_WORDS
        if not is_size or sorted(sides)[1] > _LONGEST * max(sides):
            return ""
    factors = (written or "1 1 1").split()
    if len(factors) != 3 or not all(map(_PLAIN.fullmatch, factors)):
        return written
    return " ".join(
        _multiplied(factor, ratio) if axis in axes else factor for axis, factor in enumerate(factors)
    )


def _parameters(
    checked: CheckedScenario, words: set[str], asked: set[str], factor: float
) -> Iterator[Suggestion]:
    """Yield the parameters of one number that are in the phrase, or have the property that is asked for;
    for a goal, those below which a success is reached."""
    goals = {
        name
        for entry in entries_at(checked.document.root, "termination", "success").values()
        for name in _LESS_THAN.findall(getattr(entry.value, "text", ""))
        if words & {"goal", "target"}
    }
    for name, entry in entries_at(checked.document.root, "parameters").items():
        node, is_meant = entry.value, name in goals or _words(name) & asked or _is_named(name, words)
        if isinstance(node, ScalarNode) and _PLAIN.fullmatch(node.text) and is_meant:
            text = f"`{name}` is a parameter of this scenario: {node.text}."
            yield Suggestion(text, f"parameters.{name}", _multiplied(node.text, factor))


def _settings(
    checked: CheckedScenario, words: set[str], asked: set[str], factor: float
) -> Iterator[Suggestion]:
    """Yield the settings of the scenario that the words are about, if these ask for more or less of them."""
    if "episodes" in words and not asked:  # more of them, and not longer ones
        words = words - _EPISODE | _TRAINING
    for about, keys, meaning in _SETTINGS:
        node = node_at(checked.document.root, *keys)
        if (
            words & about
            and isinstance(node, ScalarNode)
            and (asked or words) & {"length", "less", "more", "time"}
        ):
            value = _multiplied(node.text, factor, whole=node.text.isdecimal() or "_" in node.text)
            yield Suggestion(f"`{keys[-1]}` is {meaning}: {node.text}.", ".".join(keys), value)


def _multiplied(text: str, factor: float, *, whole: bool = False) -> str:
    """Return a value whose last number is multiplied; the value itself if it is not plain."""
    plain = _PLAIN.fullmatch(text)
    if plain is None:
        return text
    number = float(plain[2]) * factor
    digits = f"{number:_.0f}" if whole or number >= 1e5 else f"{number:_.6g}"
    return f"{plain[1]}{digits if '_' in plain[2] else digits.replace('_', '')}{plain[3] or ''}"


def _link_text(robot: str, row: Row, written: str) -> str:
    shapes = row["seen_as"] or row["collides_as"]
    assert isinstance(shapes, list)
    sizes = f": {', '.join(shapes)}{'' if shapes[-1].startswith('mesh ') else ' m'}" if shapes else ""
    mass = f", {row['mass_kg']:.4g} kg" if row["mass_kg"] else ""
    joint = f", on the joint `{row['joint']}`" if row["joint"] else ""
    present = f" The file has `{written}`." if written else ""
    return (
        f"`{row['link']}` is a link of the robot `{robot}`{sizes}{mass}{joint}.{present} The section `links`"
        " of the robot changes it: `scale` multiplies its size along x, y and z, and its mass follows the"
        " volume; `mass`, `friction` and `color` replace those of the robot file."
    )
