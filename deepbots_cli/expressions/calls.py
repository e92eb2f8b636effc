"""Typing of calls: arguments against the table, then dimension, shape, interval and stage of the result."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

from deepbots_cli.expressions import agree, syntax
from deepbots_cli.expressions.dimensions import NUMBER, Dimension
from deepbots_cli.expressions.foreign import CALLED_ELSEWHERE
from deepbots_cli.expressions.functions import ALLOWED, Family, Form, Function, Param, Shape
from deepbots_cli.expressions.guesses import swapped
from deepbots_cli.expressions.intervals import INF, TRUTH, Interval, exact, hull
from deepbots_cli.expressions.names import subject_of, unknown
from deepbots_cli.expressions.table import FUNCTIONS
from deepbots_cli.expressions.typed import Invocation, Typed, Vector
from deepbots_cli.expressions.types import PLANE, SPACE, Components, Context, Report, Scope, Stage, Subject, Type

Visit = Callable[[syntax.Node], Typed | None]

_PLACE_WORDS = {
    Context.FIXED: "a fixed value",
    Context.PARAMETER: "a parameter",
    Context.FIELD: "a field of the world",
    Context.EMIT: "what a robot sends",
    Context.APPLY: "what drives an actuator",
    Context.RECEIVE: "what a robot receives",
    Context.SIGNAL: "a signal",
    Context.OBSERVATION: "the range of an observation",
    Context.FORBID: "what forbids a choice",
    Context.SCRIPT: "a script",
    Context.GOAL: "a goal",
    Context.REWARD: "a reward",
    Context.ENDING: "an ending",
    Context.RESET: "a reset",
    Context.REQUIRE: "a requirement on the start",
}
_FAMILY_HELP = {
    Family.DRAW: "draw it as a parameter, and name that here",
    Family.STATEFUL: "keep it as a signal, and name that where signals are known",
    Family.MESSAGE: "only the supervisor receives what robots send; keep it as a signal, or send it under `receive`",
    Family.WORLD: "a robot knows only its sensors and messages; send it the value under `receive`",
}


# What the reductions of numbers come to where no copy of a group is there; 0 for the others.
_OF_NONE = {"min": exact(INF), "max": exact(-INF)}


class Bound(NamedTuple):
    """One argument that stands where `param` wants it; a range gives two of these."""

    param: Param
    value: Typed


def call(node: syntax.Call, scope: Scope, visit: Visit, report: Report, occurrence: int) -> Typed | None:
    """The typed call, or None after a finding; `occurrence` numbers stateful calls and draws."""
    function = FUNCTIONS.get(node.function)
    if function is None:
        if help := CALLED_ELSEWHERE.get(node.function):
            report("DB402", node.start, node.name_end, f"unknown function `{node.function}`", help)
            return None
        unknown("function", node.function, FUNCTIONS, node.start, node.name_end, report)
        return None
    available = _availability(node, function, scope.context, report)
    paired = _pair(node, function, report)
    if paired is None:
        return None
    subjects: list[Subject] = []
    bound: list[Bound] = []
    sound = True
    for param, arg in paired:
        if param.form is Form.SUBJECT:
            subject = subject_of(arg, param.kinds, function.name, scope, report)
            sound = sound and subject is not None
            subjects += [subject] if subject else []
        else:
            values = _values(param, arg, function, visit, report)
            sound = sound and values is not None
            bound += [Bound(param, value) for value in values or ()]
    if not sound:
        return None
    typed = _typed(node, function, tuple(subjects), bound, occurrence, report)
    return typed if available else None


def _availability(node: syntax.Call, function: Function, context: Context, report: Report) -> bool:
    """Whether the function may be called in this place."""
    if function.family not in ALLOWED[context]:
        fixed = context is Context.FIXED and function.family is Family.DRAW
        help = "it is the same in every episode; give one figure" if fixed else _FAMILY_HELP.get(function.family)
        help = "compute it under `augment`, and name that here" if context is Context.FORBID else help
        help = "keep it as a signal, and name that here" if context is Context.SCRIPT and function.family is Family.STATEFUL else help
        report("DB407", node.start, node.name_end, f"`{function.name}` in {_PLACE_WORDS[context]}", help)
        return False
    return True


def _pair(node: syntax.Call, function: Function, report: Report) -> list[tuple[Param, syntax.Node]] | None:
    params = function.params
    least = sum(1 for param in params if not param.optional)
    most = None if params[-1].many else len(params)
    given = len(node.args)
    if given < least or (most is not None and given > most):
        wanted = f"at least {least}" if most is None else str(least) if least == most else f"{least} or {most}"
        noun = "argument" if wanted == "1" else "arguments"
        report(
            "DB401",
            node.start,
            node.end,
            f"`{function.name}` takes {wanted} {noun}, not {given}",
            f"`{function.signature}`: {function.doc}",
        )
        return None
    return [(params[min(index, len(params) - 1)], arg) for index, arg in enumerate(node.args)]


def _values(param: Param, arg: syntax.Node, function: Function, visit: Visit, report: Report) -> list[Typed] | None:
    """The values in one argument: one, both ends of a range, or all options."""
    match param.form, arg:
        case Form.VALUE, syntax.Range() | syntax.Spread() | syntax.Options():
            report("DB401", arg.start, arg.end, "a range or draw where a single value is needed", f"`{function.signature}`: {function.doc}")
            return None
        case Form.VALUE, _:
            parts: Sequence[syntax.Node] = (arg,)
        case Form.RANGE, syntax.Range(low=low, high=high):
            parts = (low, high)
        case Form.SPREAD, syntax.Spread(mean=mean, deviation=deviation):
            parts = (mean, deviation)
        case Form.OPTIONS, syntax.Options(items=items):
            parts = items
        case _:
            report("DB401", arg.start, arg.end, f"`{function.name}` needs `{param}` here", f"`{function.signature}`: {function.doc}")
            return None
    typed = [visit(part) for part in parts]
    return [value for value in typed if value is not None] if None not in typed else None


def _typed(
    node: syntax.Call, function: Function, subjects: tuple[Subject, ...], bound: list[Bound], occurrence: int, report: Report
) -> Typed | None:
    values = tuple(b.value for b in bound)
    truths = _kinds_fit(function, bound, report)
    if truths is None:
        return None
    shared = _shared_dimension(node, function, subjects, bound, report)
    components = _components(node, function, subjects, bound, report)
    if shared is None or components is None:
        return None
    intervals: list[Interval] = [subject.interval for subject in subjects] + [value.type.interval for value in values]
    first = values[0].type.components if values else None
    boolean = function.boolean or truths
    count = len(first) if first else 1
    reach = TRUTH if boolean else function.interval(intervals, count)
    if components[0] is None and values and values[0].type.copies:
        reach = hull([reach, _OF_NONE.get(function.name, exact(0.0))])
    _warn(function, values, report)
    result = Type(
        NUMBER if boolean else function.result(shared),
        components[0],
        boolean,
        reach,
        _stage(function, values),
    )
    if function.shape is Shape.GATHER:
        return Vector(result, node.start, node.end, values)
    numbered = occurrence if function.family in (Family.STATEFUL, Family.DRAW) else None
    return Invocation(result, node.start, node.end, function.name, subjects, values, numbered)


def _kinds_fit(function: Function, bound: list[Bound], report: Report) -> bool | None:
    """Whether the shared arguments are truth values; None after DB403."""
    conditions = [b.value for b in bound if b.param.truth]
    others = [b.value for b in bound if not b.param.truth]
    sound = agree.truths(conditions, report)
    if function.truths and any(value.type.boolean for value in others):
        return True if agree.truths(others, report) and sound else None
    return False if agree.numbers(others, report) and sound else None


def _shared_dimension(
    node: syntax.Call, function: Function, subjects: tuple[Subject, ...], bound: list[Bound], report: Report
) -> Dimension | None:
    sound = True
    for b in bound:
        if b.param.dimension is not None and not b.param.truth:
            sound = agree.has_dimension(b.value, b.param.dimension, f"the argument of `{function.name}`", report) and sound
    shared = [b.value for b in bound if b.param.dimension is None and not b.param.truth]
    if not sound:
        return None
    if not shared and subjects:
        return subjects[0].dimension
    return agree.dimension_of(shared, node.start, node.end, report)


def _components(
    node: syntax.Call, function: Function, subjects: tuple[Subject, ...], bound: list[Bound], report: Report
) -> tuple[Components | None] | None:
    values = [b.value for b in bound]
    if isinstance(function.shape, tuple):
        for b in bound:
            if b.param.components and b.value.type.components != b.param.components:
                report("DB404", b.value.start, b.value.end, f"{b.value.type.shape_words} where a vector of x, y, z is needed")
                return None
        return (function.shape,)
    if function.shape is Shape.GATHER:
        return _gathered(node, values, report)
    if function.name == "mean" and values[0].type.copies:
        help = "there may be none of them: take `min`, `max`, `sum`, `norm`, `any` or `all`"
        report("DB404", node.start, node.end, "a mean over the copies of a group", help)
        return None
    if function.shape is Shape.ONE or (function.shape is Shape.FOLD and len(values) == 1):
        if values[0].type.components is None:
            report(
                "DB404",
                values[0].start,
                values[0].end,
                f"a single value where `{function.name}` needs a vector",
                f"`{function.signature}`: {function.doc}",
            )
            return None
        return (None,)
    groups = [subject.components for subject in subjects if subject.components is not None]
    if len(groups) > 1:
        report("DB404", node.start, node.end, "a group on both sides", "name a single one on one side")
        return None
    return (groups[0],) if groups else agree.components_of(values, node.start, node.end, report)


def _gathered(node: syntax.Call, values: list[Typed], report: Report) -> tuple[Components | None] | None:
    for value in values:
        if value.type.components is not None:
            report("DB404", value.start, value.end, "a vector inside a vector", "pick a component, as in `v.x`")
            return None
    if len(values) not in (len(PLANE), len(SPACE)):
        report("DB404", node.start, node.end, f"a vector of {len(values)} values", "`vector` takes two (x, y) or three (x, y, z)")
        return None
    return (PLANE if len(values) == len(PLANE) else SPACE,)


def _stage(function: Function, values: Sequence[Typed]) -> Stage:
    latest = max((value.type.stage for value in values), default=Stage.FIXED)
    if function.family in (Family.WORLD, Family.MESSAGE, Family.STATEFUL):
        return Stage.STEP
    return max(latest, Stage.EPISODE) if function.family is Family.DRAW else latest


def _warn(function: Function, values: tuple[Typed, ...], report: Report) -> None:
    """DB406 where the argument is known to leave the domain, DB504 for angles beyond a turn."""
    if function.name in ("sin", "cos", "tan"):
        agree.warn_of_degrees(values[0], report)
    elif function.name in ("sqrt", "log") and values[0].type.interval.finite:
        low = values[0].type.interval.low
        if low < 0.0 or (low == 0.0 and function.name == "log"):
            report(
                "DB406",
                values[0].start,
                values[0].end,
                f"the argument of `{function.name}` can be as low as {low:g}",
                "keep it above with `max(x, ...)`",
            )
    elif function.family is Family.DRAW and function.name in ("uniform", "integer"):
        low_end, high_end = values[0].type.interval, values[1].type.interval
        if low_end.low > high_end.high:
            headline, ends = "a range whose low end is above its high end", swapped(values[0], values[1])
            report("DB105", values[0].start, values[1].end, headline, "give the low end first", meant=ends)
