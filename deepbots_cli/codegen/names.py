"""The names in generated code: identifiers for the names of a scenario, and constants for its parameters.

Identifiers are readable, unique, and never a word that is taken.
"""

from __future__ import annotations

import builtins
import keyword
import math
import re
from collections.abc import Hashable, Sequence

from deepbots_cli.codegen.text import comment, constants_tuple_code, quoted, tuple_code
from deepbots_cli.expressions.code import number_code
from deepbots_cli.expressions.functions import FUNCTIONS, OPERATORS
from deepbots_cli.expressions.scalar import NamedFloat
from deepbots_cli.program import generated

FORMULA_NAMES = frozenset(function.name for function in FUNCTIONS.values() if function.tree) | frozenset(
    function.helper for function in (*OPERATORS.values(), *FUNCTIONS.values()) if function.helper
)
RUNTIME_NAMES = (
    *(
        "Arrangement",
        "Cartesian",
        "Follower",
        "Motor",
        "Push",
        "RobotController",
        "Supervisor",
        "Thrust",
        "Ways",
    ),
    *(function.memory for function in FUNCTIONS.values() if function.memory),
    *sorted(FORMULA_NAMES),
    *("clip", "python_function", "quaternion", "scale", "scale_each", "scale_freely"),
    *("to_body_frame", "total"),
)
"""The names that a printed module may import from `deepbots_cli.runtime`."""
COLUMN_NAMES = (
    *(
        "all_of",
        "any_of",
        "atan2",
        "clip",
        "cos",
        "exp",
        "hypot",
        "log",
        "maximum",
        "minimum",
        "pick",
        "pow",
        "scale",
        "scale_each",
    ),
    *("scale_freely", "sin", "tan", "to_body_frame", "total"),
    *sorted(FORMULA_NAMES),
)
"""The names that a module for a batch may import from `deepbots_cli.runtime.columns`."""

LOOP_VARIABLES = "abcdefgh"
"""The variables of comprehensions."""

_RESERVED_NAMES = frozenset(
    # Printed modules import functions of `math` by their names.
    {*keyword.kwlist, *keyword.softkwlist, *dir(builtins), *(n for n in dir(math) if not n.startswith("_"))}
    | {
        "self",
        "engine",
        "action",
        "message",
        "reward",
        "terminated",
        "truncated",
        "ended",
        "Any",
        "Iterator",
        "previous_reward",
    }
    | {*RUNTIME_NAMES, *LOOP_VARIABLES, "copysign", "ranges"}
    | {"bodies", "body", "layout", "spot", "spots"}
)


class Names:
    """The identifiers of a module: one for each key, the same for the same key."""

    def __init__(self) -> None:
        self._identifiers: dict[Hashable, str] = {}
        self._used: set[str] = set(_RESERVED_NAMES)

    def __call__(self, *parts: str | None) -> str:
        """Return the identifier of a dotted name, such as `cart_pole_angle` for ("cart.pole_angle",)."""
        return self.identifier(parts, *parts)

    def identifier(self, key: Hashable, *parts: str | None) -> str:
        """Return the identifier for `key`, made of these parts."""
        if key not in self._identifiers:
            base = generated.identifier(*parts)
            self._identifiers[key] = _unused(f"_{base}" if base[0].isdigit() else base, self._used)
            self._used.add(self._identifiers[key])
        return self._identifiers[key]


def _unused(base: str, used: set[str]) -> str:
    name = base
    number = 1
    while name in used:
        name = f"{base}_{number}"
        number = number + 1
    return name


class Constants:
    """The constants of a module: fixed parameters of the scenario under their names, and lists of joints."""

    def __init__(self) -> None:
        self._lines: dict[str, str] = {}
        self._names: dict[tuple[str, str], str] = {}
        self._list_names: dict[tuple[str, ...], str] = {}

    @property
    def lines(self) -> list[str]:
        """The statements that define the constants that are used."""
        return list(self._lines.values())

    def name_strings(self, name: str, items: tuple[str, ...]) -> None:
        """Set the name of the constant for a list of names, such as the joints of an actuator."""
        self._list_names.setdefault(items, name)

    def number(self, value: NamedFloat) -> str:
        """Return the constant of a fixed parameter."""
        return self._defined(value.name, repr(float(value)), value.text)

    def vector(self, values: Sequence[float | bool]) -> str:
        """Return the code of a tuple of numbers: a constant if a fixed parameter names some of them."""
        code = constants_tuple_code([number_code(value).text for value in values])
        named_values = [value for value in values if isinstance(value, NamedFloat)]
        if len({value.name for value in named_values}) != 1 or len(values) < 3:
            return code
        # The text of the parameter explains the tuple only if no other numbers are in it.
        text = named_values[0].text if len(named_values) == len(values) else ""
        return self._defined(named_values[0].name, code, text)

    def strings(self, items: tuple[str, ...]) -> str:
        """Return the code of a tuple of names: a constant if the tuple has a name and more than two
        items."""
        code = tuple_code([quoted(item) for item in items])
        return (
            self._defined(self._list_names[items], code, "")
            if items in self._list_names and len(items) > 2
            else code
        )

    def _defined(self, base: str, code: str, text: str) -> str:
        if (base, code) not in self._names:
            upper = re.sub(r"\W", "_", base).upper()
            name = _unused(f"_{upper}" if upper[0].isdigit() else upper, set(self._lines))
            note = comment(text) if text and comment(text).isprintable() and len(text) < 60 else ""
            self._lines[name] = f"{name} = {code}" + (f"  {note}" if note and note[2:] != code else "")
            self._names[base, code] = name
        return self._names[base, code]


def class_name(text: str) -> str:
    """Return the class name of a robot: `LineFollower` for `line_follower` or `Line follower`."""
    words = re.findall(r"[A-Za-z0-9]+", text)
    name = "".join(word[:1].upper() + word[1:] for word in words) or "Scenario"
    return f"S{name}" if name[0].isdigit() else name
