"""The names in generated code, and pieces of its text: blocks, tuples, quotes, comments and templates.

Identifiers are readable, unique, and never a word that is taken.
Long lines are broken where ruff and Black break them: a line is a text, and offsets of operators outside of
brackets and quotes say where it may be broken.
"""

from __future__ import annotations

import builtins
import json
import keyword
import math
import re
import textwrap
from collections.abc import Hashable, Iterable, Iterator, Sequence
from functools import lru_cache

from deepbots_cli.expressions.functions import FUNCTIONS, OPERATORS, number_code
from deepbots_cli.expressions.scalar import NamedFloat
from deepbots_cli.program import generated

WIDTH = 120

# From loose to tight; a line is broken at all operators of the first group that it has.
_OPERATORS = (
    (" if ", " else "),
    (" or ",),
    (" and ",),
    (" < ", " <= ", " > ", " >= ", " == ", " != "),
    (" + ", " - "),
    (" * ", " / "),
)
_LOOSER_THAN_NOT = (None, *_OPERATORS[:3])
_BRACKET_OR_QUOTED = re.compile(r'"(?:[^"\\]|\\.)*"|[][(){}]', re.DOTALL)
_DEEPER = dict.fromkeys("([{", 1) | dict.fromkeys(")]}", -1)
# Of a statement, or of the piece of a line that was broken before: the operator or the keyword of an argument
# in front, the comma behind.
_STATEMENT = re.compile(
    r"(?P<head>(?:(?:if|elif|else|return|or|and|[<>]=?|[=!]=|[-+*/]) )?(?:\w+=(?=[^= ]))?)(?P<body>.*?)(?P<tail>[:,]?)",
    re.DOTALL,
)


def wrap_line(line: str) -> list[str]:
    """Return the line, as several where it is longer than `WIDTH` and can be broken."""
    code = line.lstrip()
    pad = line[: len(line) - len(code)]
    if len(line) <= WIDTH or code.startswith(("#", '"')):
        return [line]
    if code.startswith("from "):
        head, names = code.split(" import ")
        return [f"{head} import (", *(f"    {name}," for name in names.split(", ")), ")"]
    if comments := list(_places(code, "  # ")):
        return [pad + code[comments[-1] + 2 :], *wrap_line(pad + code[: comments[-1]])]
    equals = list(_places(code, " = "))
    if equals and ", " in code[: equals[0]] and equals[0] > WIDTH // 2:
        return [f"{pad}(", *_one_each(pad, _split(code[: equals[0]], ", ")), f"{pad}){code[equals[0] :]}"]
    added = list(_places(code, " += "))
    if equals:
        start = equals[-1] + 3
    elif added:
        start = added[-1] + 4
    else:
        start = 0
    statement = _STATEMENT.fullmatch(code[start:])
    if statement is None or code.startswith("def "):
        return _broken_at_brackets(pad, code)
    before, body = _head_and_body(statement)
    head = f"{pad}{code[:start]}{before}("
    tail = f"{pad}){statement['tail']}"
    if code.startswith("for ") and " = " not in code and list(_places(code, " in ")):
        return _broken_at_brackets(pad, code)
    if list(_places(body, ", ")):
        return [head, *_one_each(pad, _split(body, ", ")), tail]
    operators = _loosest_operators(body)
    fits = len(pad) + 4 + len(body) <= WIDTH
    room = 0 if fits else WIDTH - len(pad) - start
    if operators is None or _ends_in_long_brackets(body, operators, room):
        return _broken_at_brackets(pad, code)
    if fits:
        return [head, f"{pad}    {body}", tail]
    return [head, *_one_operand_each(pad, body, operators), tail]


def _head_and_body(statement: re.Match[str]) -> tuple[str, str]:
    """Return what stays before the brackets that a long statement gets, and what is in them."""
    head, body = statement["head"], statement["body"]
    negations = re.match("(?:not )+", body)
    if negations is not None and _loosest_operators(body) not in _LOOSER_THAN_NOT:
        # Of `not a + b < c`, the piece `(not a + b)` would compare the negation.
        return head + negations[0], body[negations.end() :]
    return head, body


def _loosest_operators(body: str) -> tuple[str, ...] | None:
    """Return the operators at which a line is broken first, outside of brackets."""
    return next((group for group in _OPERATORS if any(list(_places(body, sign)) for sign in group)), None)


def _ends_in_long_brackets(body: str, operators: tuple[str, ...], width: int) -> bool:
    """Return whether a line has one operator of arithmetic within a width, and brackets behind it, inside
    which it is broken."""
    offsets = [offset for sign in operators for offset in _places(body, sign)]
    groups = list(_groups(body))
    if " if " in operators or len(offsets) != 1 or not groups:
        return False
    start, end = groups[-1]
    return offsets[0] < start < width and end == len(body) - 1


def _broken_at_brackets(pad: str, code: str) -> list[str]:
    """Return the line broken inside the last outermost brackets; for a definition, inside those around its
    arguments."""
    groups = list(_groups(code))
    if not groups:
        return [pad + code]
    start, end = groups[0] if code.startswith("def ") else groups[-1]
    head = pad + code[: start + 1]
    inner = code[start + 1 : end]
    tail = pad + code[end:]
    is_call = code[start] == "(" and re.search(r"[\w\])]$", code[:start]) is not None
    fits = len(pad) + 4 + len(inner) <= WIDTH and not inner.endswith(",")
    if fits and (is_call or not list(_places(inner, ", "))):
        return [head, f"{pad}    {inner}", tail]
    if list(_places(inner, " for ")):
        return [
            head,
            *(piece for part in _broken(inner, (" for ",)) for piece in wrap_line(f"{pad}    {part}")),
            tail,
        ]
    items = _split(inner.removesuffix(","), ", ")
    if len(items) == 1 and not inner.endswith(","):  # a comma would make a tuple of a mere group
        operators = _loosest_operators(inner)
        if operators is None or _ends_in_long_brackets(inner, operators, WIDTH - len(pad) - 4):
            return [head, *wrap_line(f"{pad}    {inner}"), tail]
        return [head, *_one_operand_each(pad, inner, operators), tail]
    return [head, *_one_each(pad, items), tail]


def _one_operand_each(pad: str, body: str, operators: tuple[str, ...]) -> list[str]:
    return [piece for part in _broken(body, operators) for piece in wrap_line(f"{pad}    {part}")]


def _one_each(pad: str, items: list[str]) -> list[str]:
    return [piece for item in items for piece in wrap_line(f"{pad}    {item},")]


def _broken(code: str, operators: tuple[str, ...]) -> list[str]:
    """Return the operands, each but the first with its operator before it."""
    offsets = sorted(offset for sign in operators for offset in _places(code, sign))
    return [code[a:b].strip() for a, b in zip([0, *offsets], [*offsets, len(code)], strict=True)]


def _split(code: str, sign: str) -> list[str]:
    return [part.removeprefix(sign.strip()).strip() for part in _broken(code, (sign,))]


def _places(code: str, sign: str) -> Iterator[int]:
    """Return the offsets of `sign` outside of brackets and quotes."""
    return (
        (match.start() for match in re.finditer(re.escape(sign), _outside(code)))
        if sign in code
        else iter(())
    )


@lru_cache(maxsize=16)
def _outside(code: str) -> str:
    """Return the code with a NUL for each character in brackets or quotes: a line is searched for about ten
    signs."""
    pieces = []
    depth = 0
    end = 0
    for match in _BRACKET_OR_QUOTED.finditer(code):
        between = code[end : match.start()]
        pieces += [between if depth == 0 else "\0" * len(between), "\0" * len(match[0])]
        depth = depth + _DEEPER.get(match[0], 0)
        end = match.end()
    return "".join([*pieces, "" if depth else code[end:]])


def _groups(code: str) -> Iterator[tuple[int, int]]:
    """Yield the offsets at which outermost brackets open and close."""
    start = depth = 0
    for match in _BRACKET_OR_QUOTED.finditer(code):
        deeper = _DEEPER.get(match[0], 0)
        if depth == 0 and deeper > 0:
            start = match.start()
        elif depth == 1 and deeper < 0:
            yield start, match.start()
        depth += deeper


# Names


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
