"""The pairs of keys, functions and options that scenarios combine, and those that they may combine.

A night reports which share of them it has met: functions by context, keys by kind of sensor, actuator and
object, formats of messages by their timing and channel, and endings by case.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from functools import cache
from itertools import product
from typing import Any

from deepbots_cli.expressions.parser import parse
from deepbots_cli.expressions.syntax import Call, Node, children
from deepbots_cli.expressions.types import Context
from deepbots_cli.message_formats import FORMATS
from deepbots_cli.scenario.actuators import ACTUATORS
from deepbots_cli.scenario.base import Section, section_fields, visit_values
from deepbots_cli.scenario.quantities import Expression
from deepbots_cli.scenario.robots import Messages, Route
from deepbots_cli.scenario.scenario import Scenario
from deepbots_cli.scenario.sensors import SENSORS
from tests.laws.expressions import functions_in
from tests.laws.scenarios import LEFT_OUT

Pair = tuple[str, str, str]
"""What kind of pair it is, and the two of it."""
_CHANNELS = ("to_robot", "from_robot")
_ENDINGS = ("success", "failure", "max_steps", "max_time", "goal", "endings")
_CASES = ("none", "case", "stage", "level", "test", "role")


def pairs_of(data: Mapping[str, Any]) -> set[Pair]:
    """Return the pairs of a scenario: those in `all_pairs`."""
    return all_pairs() & {*_functions(data), *_options(data), *_messages(data), *_endings(data)}


@cache
def all_pairs() -> frozenset[Pair]:
    """Return all pairs that a scenario may have."""
    pairs = {
        ("function", function.name, name)
        for name, context in _CONTEXTS.items()
        for function in functions_in(context)
    }
    for noun, table in (("sensor", SENSORS), ("actuator", ACTUATORS)):
        for word, model in table.built_in.items():
            pairs |= {(noun, word, key) for key in _keys(model)}
    timings = product(FORMATS.built_in, section_fields(Messages)["timing"].words)
    pairs |= {("message", *pair) for pair in timings if pair[0] != "none"}
    pairs |= {("channel", *pair) for pair in product(_CHANNELS, section_fields(Route))}
    pairs |= {("ending", *pair) for pair in product(_ENDINGS, _CASES) if pair not in _NEVER}
    return frozenset(pairs)


_NEVER = {
    ("endings", "stage"),
    ("endings", "level"),
    ("endings", "none"),
    ("success", "role"),
    ("failure", "role"),
    ("goal", "role"),
}
"""Endings and cases that exclude each other: those of one agent and of several."""
_CONTEXTS = {
    context.name.lower(): context
    for context in Context
    if context not in (Context.FIXED, Context.FIELD, Context.OBSERVATION, Context.RESET)
}
"""The contexts of whole expressions. Those of single values take few functions."""


def _keys(model: type[Section]) -> set[str]:
    left_out = {key for base in model.__mro__ for key in LEFT_OUT.get(base.__name__, ())}
    return set(model.model_fields) - left_out - {"type"}


def _functions(data: Mapping[str, Any]) -> Iterator[Pair]:
    scenario = Scenario.model_validate(data)
    for _, kind, value in visit_values(scenario):
        if isinstance(kind, Expression) and isinstance(value, str):
            tree = parse(value, lambda *_args, **_options: None)
            for name in set(_calls(tree)) if tree is not None else ():
                yield "function", name, kind.context


def _calls(node: Node) -> Iterator[str]:
    if isinstance(node, Call):
        yield node.function
    for child in children(node):
        yield from _calls(child)


def _options(data: Mapping[str, Any]) -> Iterator[Pair]:
    for robot in data["robots"].values():
        for noun in ("sensor", "actuator"):
            for entry in robot.get(f"{noun}s", {}).values():
                yield from ((noun, entry["type"], key) for key in entry)


def _messages(data: Mapping[str, Any]) -> Iterator[Pair]:
    messages = data.get("messages", {})
    yield "message", messages.get("format", "struct"), messages.get("timing", "immediate")
    for channel in _CHANNELS:
        yield from (("channel", channel, key) for key in messages.get(channel, {}))


def _endings(data: Mapping[str, Any]) -> Iterator[Pair]:
    names = [*data.get("termination", {}), *data["truncation"]]
    names += [key for key in ("goal", "endings") if key in data]
    curriculum = data.get("curriculum")
    cases = {
        "none": True,
        "case": bool(data.get("evaluation", {}).get("cases")),
        "stage": isinstance(curriculum, list),
        "level": isinstance(curriculum, dict),
        "test": "tests" in data,
        "role": "role" in data,
    }
    yield from (
        ("ending", *pair) for pair in product(names, (case for case, is_there in cases.items() if is_there))
    )


def report(met: Iterable[Pair]) -> dict[str, Any]:
    """Return the share of the pairs of each kind that were met, and those that were not."""
    every, met = all_pairs(), set(met)
    kinds = sorted({kind for kind, *_ in every})
    missing = {kind: sorted(pair[1:] for pair in every - met if pair[0] == kind) for kind in kinds}
    shares = {kind: 1 - len(missing[kind]) / sum(pair[0] == kind for pair in every) for kind in kinds}
    return {"share": len(every & met) / len(every), "shares": shares, "missing": missing}
