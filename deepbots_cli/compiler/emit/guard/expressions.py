"""Every node of every expression: only operations, functions, draws and facts that are in their tables."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator

from deepbots_cli.canonical import CanonicalError
from deepbots_cli.expressions.functions import FUNCTIONS, OPERATORS
from deepbots_cli.expressions.scalar import Draw, Name, Op, State, World
from deepbots_cli.ir.records import members

_DRAWS = frozenset({"uniform", "integer", "normal", "choice"})
# The least and the greatest number of arguments; what is not here takes one or more.
_ARGUMENTS: dict[str, tuple[int, float]] = {
    **dict.fromkeys(("neg", "not", "abs", "wrap", "sqrt", "exp", "log", "sin", "cos", "tan"), (1, 1)),
    **dict.fromkeys(("running_max", "running_min", "integral", "duration", "rising"), (1, 1)),
    **dict.fromkeys(("delta", "previous"), (1, 2)),
    **dict.fromkeys(("sub", "mul", "div", "pow", "atan2", "hold", "smooth", "uniform", "integer", "normal"), (2, 2)),
    **dict.fromkeys(("less", "less_equal", "greater", "greater_equal", "equal", "not_equal"), (2, 2)),
    **dict.fromkeys(("min", "max"), (2, math.inf)),
    **dict.fromkeys(("where", "clamp"), (3, 3)),
    "accumulate": (4, 4),
}
_COPY = re.compile(r"[a-z_][a-z0-9_]*#[1-9][0-9]{0,3}", re.ASCII)
_OF_TWO = ("beside", "along", "visible", "gap", "contact", "path_distance", "reachable")
_FACTS: dict[str, tuple[str | None, ...]] = {
    **dict.fromkeys(("position", "velocity", "angular_velocity"), ("x", "y", "z")),
    "orientation": ("x", "y", "z", "w"),
    **dict.fromkeys(("age", "fresh"), (None,)),
    **dict.fromkeys(("joint_position", "joint_velocity", "joint_torque"), (None,)),
    **dict.fromkeys((*_OF_TWO, "collided", "present"), (None,)),
}


def require_known_nodes(scenario: object) -> None:
    """Refuse a node that the compiler would never have written."""
    for node in nodes(scenario):
        _require_arguments(node)
        match node:
            case Op(op=word) if word not in OPERATORS and not (word in FUNCTIONS and FUNCTIONS[word].python):
                raise CanonicalError(f"{word[:40]!r} is no operation")
            case State(function=word) if word not in FUNCTIONS or FUNCTIONS[word].memory is None:
                raise CanonicalError(f"{word[:40]!r} is no stateful function")
            case Draw(distribution=word) if word not in _DRAWS:
                raise CanonicalError(f"{word[:40]!r} is no distribution")
            case World(function=word, subjects=subjects, component=component):
                joint, wanted = word.startswith("joint_"), 2 if word in _OF_TWO else 1
                if component not in _FACTS.get(word, ()) or len(subjects) != wanted or (joint and "." not in subjects[0]):
                    raise CanonicalError(f"{word[:40]!r} of {str(subjects)[:60]} is nothing that an engine can tell")
                if word == "present" and not _COPY.fullmatch(subjects[0]):
                    raise CanonicalError(f"{subjects[0][:60]!r} is no copy of anything")


def _require_arguments(node: Op | State | Draw | World | Name) -> None:
    """As many arguments as the operation, stateful function or draw takes; an unknown one is refused by its name."""
    match node:
        case Op(op=word, args=args) | State(function=word, args=args) | Draw(distribution=word, args=args):
            least, most = _ARGUMENTS.get(word, (1, math.inf))
            if not least <= len(args) <= most:
                raise CanonicalError(f"{word[:40]!r} of {len(args)} arguments")


def nodes(value: object) -> Iterator[Op | State | Draw | World | Name]:
    """Every node of every expression, wherever it stands."""
    waiting = [value]
    while waiting:
        here = waiting.pop()
        if isinstance(here, (Op, State, Draw, World, Name)):
            yield here
        inside = members(here)
        waiting.extend(here if inside is None and isinstance(here, tuple) else (inside or {}).values())
