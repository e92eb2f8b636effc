"""The help in findings of `check.py`: what to write instead."""

from __future__ import annotations

from deepbots_cli.diagnostics.nearest import nearest_first
from deepbots_cli.expressions.dimensions import NUMBER
from deepbots_cli.expressions.functions import Family, Function
from deepbots_cli.expressions.types import Context, Kind, TypedNode, shortened_list
from deepbots_cli.words import sentence_list

_STATIC_HELP = (
    "use a number or a parameter; the state of the world and messages are known only during an episode"
)
FAMILY_HELP = {
    Family.DRAW: "define the draw under `parameters`, and use its name here",
    Family.STATEFUL: "define it under `signals`, and use the signal where signals are available",
    Family.MESSAGE: "define the value under `receive`, and use its name here; only the supervisor receives"
    " messages of robots",
    Family.WORLD: "define the value under `receive`, and use its name here; a robot knows only its sensors"
    " and the values that it receives",
}
"""The help for a function that cannot be used, by its family."""
_STATIC_PLACES = (Context.FIXED, Context.PARAMETER, Context.FIELD, Context.OBSERVATION, Context.RESET)
CONTEXT_HELP = {
    **{
        (Context.FORBID, family): "define the value under `augment`, and use its name here"
        for family in Family
    },
    **{
        (context, family): _STATIC_HELP
        for context in _STATIC_PLACES
        for family in (Family.WORLD, Family.MESSAGE)
    },
    (Context.EMIT, Family.WORLD): "define the value under `augment`; a robot knows only its sensors",
    (
        Context.EMIT,
        Family.MESSAGE,
    ): "define the value under `augment`; only the supervisor receives messages of robots",
    (Context.FIXED, Family.DRAW): "write one number for all episodes",
    (Context.SCRIPT, Family.STATEFUL): "define the value under `signals`, and use its name here",
    (Context.TEST, Family.STATEFUL): "define the value under `signals`, and use its name here",
    (Context.TEST, Family.MESSAGE): "define the value under `signals`, and use its name here",
    (Context.GOAL, Family.MESSAGE): "define the value under `signals`, and use its name here",
    (Context.REQUIRE, Family.MESSAGE): "remove it: no message has arrived when the start is drawn",
}
"""The help for a function that cannot be used in a context, where it is not that of `FAMILY_HELP`."""
# A common question about a part of the world that has no position.
FUNCTION_OF_KIND = {
    Kind.JOINT: "joint_position",
    Kind.JOINTS: "joint_position",
    Kind.WALLS: "collided",
    Kind.LINE: "length",
    Kind.SENSOR: "age",
    Kind.CAMERA: "age",
}
_MAX_LISTED = 20
"""The number of names that a message lists."""
# Names that are written often, and not near to the right word.
NAME_HELP = {"pi": "half a turn is `180 deg`"}
CONTEXT_NAME_HELP = {Context.APPLY: "the choices of the agent are defined under `action`"}
FOREIGN_FUNCTION_HELP = {
    "random": "a draw is `uniform(low .. high)`, or `normal(mean +- std)`",
    "rand": "a draw is `uniform(low .. high)`",
    "randn": "a draw is `normal(mean +- std)`",
    "gauss": "a draw is `normal(mean +- std)`",
    "randint": "a draw of whole numbers is `integer(low .. high)`",
    "clip": "write `clamp(x, low .. high)`",
    "pow": "a power is `a ^ b`",
    "square": "a power is `a ^ b`: `x ^ 2`",
    "radians": "write the unit: `30 deg`",
    "degrees": "divide by the unit: `angle / deg`",
}
"""The help for functions of other languages."""


def usage(function: Function) -> str:
    return f"`{function.signature}`: {function.doc}"


def known_names_help(names: list[str], none: str, like: str = "") -> str:
    """Return the names in their order; the most similar ones first, if there are too many to list."""
    ordered = nearest_first(like, sorted(names), _MAX_LISTED)
    return f"known names: {shortened_list((f'`{name}`' for name in ordered), _MAX_LISTED)}" if names else none


def one_of(kinds: frozenset[Kind]) -> str:
    """Return the kinds as alternatives, such as "a robot or an object"."""
    descriptions = [kind.description for kind in Kind if kind in kinds]
    if kinds >= {Kind.WALL, Kind.WALLS}:
        descriptions.remove(Kind.WALLS.description)
        descriptions[descriptions.index(Kind.WALL.description)] = "a wall"
    return sentence_list(descriptions, "or")


def keep_above_help(low: float) -> str:
    """Return the help for a value that can be below a domain, which begins at 0 or just above it."""
    return (
        "keep it above 0 with `max(..., 0.001)`" if low > 0.0 else "keep it at or above 0 with `max(..., 0)`"
    )


def no_zero_help(value: TypedNode) -> str:
    """Return the help for a value that can be zero: a bound in its unit."""
    dimension = value.type.dimension
    return (
        f"keep it away from zero, as in `max(..., {'0.01' if dimension == NUMBER else f'0.01 {dimension}'})`"
    )
