"""Functions of other packages, which are checked where they enter the table."""

from __future__ import annotations

import keyword
import math
from collections.abc import Collection, Iterator
from contextlib import suppress

from deepbots_cli.expressions import intervals as iv
from deepbots_cli.expressions.code import Code, names_in, printed, template
from deepbots_cli.expressions.dimensions import LENGTH, UNITS, Dimension
from deepbots_cli.expressions.functions.operators import OPERATORS
from deepbots_cli.expressions.functions.record import Family, Form, Function, Param
from deepbots_cli.expressions.intervals import EVERYTHING, Interval
from deepbots_cli.expressions.syntax import KEYWORDS

_FORMS = frozenset({Form.VALUE, Form.RANGE})
"""The forms of arguments that functions of other packages may have."""
_INTERNAL_FIELDS = ("reduction", "tree", "reads_link_pose", "method", "memory", "helper")
"""The fields that refer to code of deepbots."""
_CONSTANTS = frozenset({"pi", "tau", "e", "inf"})
_NAMES_IN_PYTHON = {*vars(math), "abs", "min", "max"}
_NAMES_IN_ARRAY = _CONSTANTS | {"abs", "np"}


def functions_of_entry(_name: str, entry: object) -> Iterator[tuple[str, Function]]:
    for function in [entry] if isinstance(entry, Function) else list(entry):  # type: ignore[call-overload]
        _require_usable(function)
        yield function.name, function


def _require_usable(function: object) -> None:
    """Refuse a function of another package that would break ours.

    Raises:
        ValueError: The entry is wrong; the message gives the reason, and what to write.
    """
    if not isinstance(function, Function):
        raise ValueError(f"{str(function)[:60]!r} is not a Function")
    name = function.name
    if not name.isidentifier() or name in OPERATORS or name in UNITS or hasattr(math, name):
        raise ValueError(f"the name {name!r} is taken or no identifier; choose another name")
    if name in KEYWORDS or name in ("true", "false") or keyword.iskeyword(name):
        raise ValueError(f"the name {name!r} is a word of the language; choose another name")
    if function.family is not Family.PURE or not function.python or not function.params or not function.doc:
        raise ValueError(f"{name!r} needs the family PURE, params, doc and python")
    internal = [field for field in _INTERNAL_FIELDS if getattr(function, field)]
    if internal:
        raise ValueError(f"{name!r} cannot have `{internal[0]}`; write its meaning as `python`")
    _require_usable_params(name, function.params)
    _require_usable_python(function, "python", _NAMES_IN_PYTHON)
    if function.array:
        _require_usable_python(function, "array", _NAMES_IN_ARRAY)
    _require_usable_result(function)


def _require_usable_params(name: str, params: tuple[Param, ...]) -> None:
    for param in params:
        if not param.name.isidentifier() or keyword.iskeyword(param.name):
            raise ValueError(
                f"the argument {param.name!r} of {name!r} is not an identifier; choose another name"
            )
        if param.form not in _FORMS:
            form = param.form.name
            raise ValueError(f"{name!r} cannot take the form {form}; write Form.VALUE or Form.RANGE")
        if param.optional or param.components:
            raise ValueError(f"{name!r} cannot have an optional argument, or one with components")
    if sum(param.form is Form.RANGE for param in params) > 1:
        raise ValueError(f"{name!r} cannot have two ranges; write the bounds of one as values")
    if any(param.variadic for param in params[:-1]):
        raise ValueError(f"only the last argument of {name!r} can be variadic")


def _require_usable_python(function: Function, field: str, allowed: Collection[str]) -> None:
    """Refuse Python that generated code cannot contain."""
    name, text = function.name, getattr(function, field)
    try:
        printed(template(text), dict.fromkeys(function.arguments, Code("x")))
    except SyntaxError as error:
        raise ValueError(f"the {field} of {name!r} is not a Python expression") from error
    names = names_in(text)
    arguments = [argument.removeprefix("*") for argument in function.arguments]
    if function.params[-1].variadic and not function.arguments[-1].startswith("*"):
        raise ValueError(f"the {field} of {name!r} must contain *{arguments[-1]}")
    # The code of an argument replaces its name, so a second occurrence would compute it again.
    if any(names.count(argument) != 1 for argument in arguments):
        raise ValueError(f"the {field} of {name!r} must contain each of {', '.join(arguments)} once")
    unknown = {*names} - {*arguments, *allowed}
    if unknown:
        raise ValueError(
            f"the {field} of {name!r} contains {', '.join(sorted(unknown))}; write it with"
            f" {'functions of math' if field == 'python' else 'functions of np'}"
        )


def _require_usable_result(function: Function) -> None:
    """Refuse a function whose value, interval or dimension has another type than it says."""
    name = function.name
    samples = [
        sample
        for param in function.params
        for sample in ([0.5, 0.5] if param.form is Form.RANGE else [param.boolean or 0.5])
    ]
    value: object = None
    with suppress(ArithmeticError, ValueError):  # it may have no value there
        value = function.compiled(function.python, {**vars(math)})(*samples)
    if isinstance(value, bool) and not (function.boolean or function.accepts_truths):
        raise ValueError(f"the python of {name!r} gives a truth value; write boolean=True")
    if function.boolean and not isinstance(value, bool | None):
        raise ValueError(
            f"the python of {name!r} does not give a truth value; write a comparison, or boolean=False"
        )
    intervals = [function.interval(*[sample] * len(samples)) for sample in (EVERYTHING, iv.TRUTH)]
    if not all(isinstance(interval, Interval) for interval in intervals) or not isinstance(
        function.result(LENGTH), Dimension
    ):
        raise ValueError(
            f"{name!r} needs an interval that gives an Interval, and a result that gives a Dimension"
        )
