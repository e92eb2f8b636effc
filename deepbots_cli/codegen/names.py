"""Python identifiers for the names of a scenario: readable, unique, and never a word that is taken."""

from __future__ import annotations

import builtins
import keyword
import math
import re
from collections.abc import Sequence

from deepbots_cli.codegen.layout import comment, quoted, repeated, tuple_code
from deepbots_cli.expressions.functions import FUNCTIONS, OPERATORS
from deepbots_cli.expressions.printer import number
from deepbots_cli.expressions.scalar import NamedFloat

FORMULAS = frozenset(function.name for function in FUNCTIONS.values() if function.tree) | frozenset(
    function.helper for function in (*OPERATORS.values(), *FUNCTIONS.values()) if function.helper
)
RUNTIME = (
    *("Arrangement", "Cartesian", "Follower", "Motor", "Push", "RobotController", "Supervisor", "Thrust", "Ways"),
    *(function.memory for function in FUNCTIONS.values() if function.memory),
    *sorted(FORMULAS),
    *("clip", "foreign", "to_body_frame", "quaternion", "scale", "scale_each", "scale_freely", "total"),
)
"""What a printed module may import from `deepbots_cli.runtime`."""
COLUMNS = (
    *("all_of", "any_of", "atan2", "cos", "exp", "hypot", "log", "maximum", "minimum", "pick", "pow", "scale", "scale_each"),
    *("scale_freely", "sin", "tan", "to_body_frame", "total"),
    *sorted(FORMULAS),
)
"""What a module for a batch may import from `deepbots_cli.runtime.columns`."""

VARIABLES = "abcdefgh"
"""The variables of comprehensions."""

_TAKEN = frozenset(
    {*keyword.kwlist, *keyword.softkwlist, *dir(builtins), *(n for n in dir(math) if not n.startswith("_"))}
    | {"self", "engine", "action", "message", "reward", "terminated", "truncated", "ended", "Any", "Iterator", "previous_reward"}
    | {*RUNTIME, *VARIABLES, "copysign", "ranges"}
    | {"bodies", "body", "layout", "spot", "spots"}
)


class Names:
    """Hands out one identifier per key, the same for the same key."""

    def __init__(self) -> None:
        self._given: dict[str, str] = {}
        self._used: set[str] = set(_TAKEN)

    def __call__(self, *parts: str | None) -> str:
        """The identifier of a dotted name, such as `cart_pole_angle` for ("cart.pole_angle",)."""
        return self.called("\0".join(part for part in parts if part), *parts)

    def called(self, key: str, *parts: str | None) -> str:
        """The identifier for `key`, made of these parts."""
        if key not in self._given:
            wanted = re.sub(r"\W", "_", "_".join(part for part in parts if part))
            self._given[key] = _unused(f"_{wanted}" if wanted[0].isdigit() else wanted, self._used)
            self._used.add(self._given[key])
        return self._given[key]


def _unused(wanted: str, used: set[str]) -> str:
    name, number = wanted, 1
    while name in used:
        name, number = f"{wanted}_{number}", number + 1
    return name


class Constants:
    """The constants of a module: fixed parameters of the scenario under their names, and lists of joints."""

    def __init__(self) -> None:
        self._lines: dict[str, str] = {}
        self._names: dict[tuple[str, str], str] = {}
        self._known: dict[tuple[str, ...], str] = {}

    @property
    def lines(self) -> list[str]:
        """The statements that define those that were asked for."""
        return list(self._lines.values())

    def know(self, name: str, items: tuple[str, ...]) -> None:
        """Let a list of names, such as the joints of an actuator, be called so."""
        self._known.setdefault(items, name)

    def number(self, value: NamedFloat) -> str:
        """The constant of a fixed parameter."""
        return self._defined(value.name, repr(float(value)), value.text)

    def vector(self, values: Sequence[float | bool]) -> str:
        """The code of a tuple of numbers: a constant where a fixed parameter names them."""
        code = repeated([number(value).text for value in values])
        named = [value for value in values if isinstance(value, NamedFloat)]
        if len({value.name for value in named}) != 1 or len(values) < 3:
            return code
        return self._defined(named[0].name, code, named[0].text)

    def strings(self, items: tuple[str, ...]) -> str:
        """The code of a tuple of names: a constant where it is known and not short."""
        code = tuple_code([quoted(item) for item in items])
        return self._defined(self._known[items], code, "") if items in self._known and len(items) > 2 else code

    def _defined(self, wanted: str, code: str, text: str) -> str:
        if (wanted, code) not in self._names:
            upper = re.sub(r"\W", "_", wanted).upper()
            name = _unused(f"_{upper}" if upper[0].isdigit() else upper, set(self._lines))
            said = comment(text) if text and comment(text).isprintable() and len(text) < 60 else ""
            self._lines[name] = f"{name} = {code}" + (f"  {said}" if said and said[2:] != code else "")
            self._names[wanted, code] = name
        return self._names[wanted, code]


def class_name(text: str) -> str:
    """`line_follower` or `Line follower` to `LineFollower`."""
    words = re.findall(r"[A-Za-z0-9]+", text)
    name = "".join(word[:1].upper() + word[1:] for word in words) or "Scenario"
    return f"S{name}" if name[0].isdigit() else name
