"""The names in generated code, and pieces of its text: blocks, tuples, quotes, comments and templates.

Identifiers are readable, unique, and never a word that is taken. A statement is one line, however long:
`codegen.formatted` leaves its layout to a formatter.
"""

from __future__ import annotations

import builtins
import json
import keyword
import math
import re
import textwrap
from collections.abc import Hashable, Iterable, Sequence

from deepbots_cli.expressions.functions import FUNCTIONS, OPERATORS, number_code
from deepbots_cli.expressions.scalar import NamedFloat
from deepbots_cli.program import generated

WIDTH = 120
"""The length of a line up to which a comment is beside its statement."""

_DEPTH = 8
"""The indent of a statement in a method."""


def indent(lines: Iterable[str], depth: int = 1) -> list[str]:
    return [f"{'    ' * depth}{line}" if line else "" for line in lines]


def block(head: str, body: Sequence[str]) -> list[str]:
    """Return a function or class with its body, and an empty line after it."""
    return [head, *indent(body), ""]


def tuple_code(items: Sequence[str]) -> str:
    return f"({', '.join(items)}{',' if len(items) == 1 else ''})"


def targets_code(names: Sequence[str]) -> str:
    """Return the left side of an assignment that takes a sequence apart."""
    return ", ".join(names) if len(names) > 1 else tuple_code(names)


def quoted(text: str) -> str:
    """Return a string literal in double quotes and ASCII.

    The escapes of JSON are a subset of Python's, except for characters beyond 16 bits: JSON writes two
    halves, which Python does not join.
    """
    return json.dumps(text, ensure_ascii=False).encode("ascii", "backslashreplace").decode()


def docstring(text: str) -> list[str]:
    """Return a string in triple quotes, over as many lines as it needs; quotes and backslashes are
    escaped, so that the text cannot end it."""
    lines = textwrap.wrap(quoted(text)[1:-1], 100, break_long_words=False, break_on_hyphens=False) or [""]
    return [f'"""{lines[0]}"""'] if len(lines) == 1 else [f'"""{lines[0]}', *lines[1:], '"""']


def quoted_tuple(names: Sequence[str]) -> str:
    return tuple_code([quoted(name) for name in names])


def fill_template(template: str, **gaps: str | Sequence[str]) -> list[str]:
    """Return the lines of a template; `{name}` alone on a line is replaced by lines, which take its indent,
    and vanishes for none."""
    lines: list[str] = []
    for line in template.strip("\n").split("\n"):
        alone = re.fullmatch(r"( *)\{(\w+)\}", line)
        filling = gaps[alone[2]] if alone else None
        if alone and filling is not None and not isinstance(filling, str):
            lines += [f"{alone[1]}{inner}" if inner else "" for inner in filling]
        else:
            lines.append(line.format(**gaps))
    return lines


def comment(text: str) -> str:
    """Return a text of the scenario as a comment: on one line, in ASCII."""
    return "# " + " ".join(text.split()).encode("ascii", "backslashreplace").decode()


def with_comment(line: str, text: str) -> list[str]:
    """Return a statement of a method with a text of the scenario beside it, or above it where it is long."""
    note = comment(text)
    if not note[2:] or not note.isprintable() or line.partition(" = ")[2] == note[2:]:
        return [line]
    if _DEPTH + len(line) + 2 + len(note) <= WIDTH:
        return [f"{line}  {note}"]
    return [note, line] if _DEPTH + len(note) <= WIDTH else [line]


def constants_tuple_code(items: Sequence[str]) -> str:
    """Return a tuple of constants; runs of equal ones are written as a product where that is shorter."""
    runs: list[list[str]] = []
    for item in items:
        if runs and runs[-1][0] == item:
            runs[-1].append(item)
        else:
            runs.append([item])
    plain = tuple_code(items)
    short = " + ".join(f"({run[0]},) * {len(run)}" if len(run) > 1 else f"({run[0]},)" for run in runs)
    return short if len(items) > 3 and len(short) < len(plain) else plain


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
    | {*RUNTIME_NAMES, *COLUMN_NAMES, *LOOP_VARIABLES, "copysign", "np", "ranges"}
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
            self._identifiers[key] = unused_name(f"_{base}" if base[0].isdigit() else base, self._used)
            self._used.add(self._identifiers[key])
        return self._identifiers[key]


def unused_name(base: str, used: set[str]) -> str:
    """Return the name, with a number if it is used."""
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
            name = unused_name(f"_{upper}" if upper[0].isdigit() else upper, set(self._lines))
            note = comment(text) if text and comment(text).isprintable() and len(text) < 60 else ""
            self._lines[name] = f"{name} = {code}" + (f"  {note}" if note and note[2:] != code else "")
            self._names[base, code] = name
        return self._names[base, code]


def class_name(text: str) -> str:
    """Return the class name of a robot: `LineFollower` for `line_follower` or `Line follower`."""
    words = re.findall(r"[A-Za-z0-9]+", text)
    name = "".join(word[:1].upper() + word[1:] for word in words) or "Scenario"
    return f"S{name}" if name[0].isdigit() else name
