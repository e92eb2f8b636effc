"""Syntax tree to typed tree: names, dimensions, shapes, intervals and stages are settled here.

A part that is wrong becomes None, which every check above it accepts: one fault, one finding.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from contextlib import suppress
from fractions import Fraction
from typing import NamedTuple

from deepbots_cli.diagnostics.nearest import Meant, meant
from deepbots_cli.expressions import syntax, unification
from deepbots_cli.expressions.dimensions import ANGLE, NUMBER, TIME, Dimension, Exponent, multiple, suggest_unit
from deepbots_cli.expressions.functions import ALLOWED, FUNCTIONS, OPERATORS, Family, Form, Function, Param
from deepbots_cli.expressions.intervals import TRUTH, Interval, exact, hull
from deepbots_cli.expressions.types import (
    MAX_SIZE,
    PLANE,
    SPACE,
    Components,
    Constant,
    Context,
    Invocation,
    Kind,
    Operation,
    Pick,
    Redraw,
    Reference,
    Report,
    Rewriting,
    Scope,
    Stage,
    Subject,
    Symbol,
    Type,
    Typed,
    TypedRange,
    Vector,
    shown,
    size,
)

_OPERATORS = {
    "+": "add", "-": "sub", "*": "mul", "/": "div", "^": "pow",
    "<": "less", "<=": "less_equal", ">": "greater", ">=": "greater_equal", "==": "equal", "!=": "not_equal",
}  # fmt: skip
_MAX_EXPONENT = 12
# Roots that physics meets: halves, thirds and quarters. A float stands for one if it is the nearest.
_MAX_DENOMINATOR = 4
_NO_ZERO = "keep it away from zero, as in `max(x, 0.01 m)`"
_KEEP_ABOVE = "keep it above with `max(x, ...)`"
_NESTED = ("a vector inside a vector", "pick a component, as in `v.x`")
_FAMILY_HELP = {
    Family.DRAW: "draw it as a parameter, and name that here",
    Family.STATEFUL: "keep it as a signal, and name that where signals are known",
    Family.MESSAGE: "only the supervisor receives what robots send; keep it as a signal, or send it under `receive`",
    Family.WORLD: "a robot knows only its sensors and messages; send it the value under `receive`",
}
# A common question about a part of the world that has no position.
_ASKED = {
    Kind.JOINT: "joint_position",
    Kind.JOINTS: "joint_position",
    Kind.WALLS: "collided",
    Kind.LINE: "length",
    Kind.SENSOR: "age",
    Kind.CAMERA: "age",
}
# Hints for unknown names besides the known ones.
_NAMED = {"pi": "half a turn is `180 deg`"}
_ELSEWHERE = {Context.APPLY: "what the agent decides is named under `action`"}
# Functions that other languages have.
_CALLED_ELSEWHERE = {
    "random": "a draw is `uniform(low .. high)`, or `normal(mean +- deviation)`",
    "rand": "a draw is `uniform(low .. high)`",
    "randn": "a draw is `normal(mean +- deviation)`",
    "gauss": "a draw is `normal(mean +- deviation)`",
    "randint": "a draw of whole numbers is `integer(low .. high)`",
    "clip": "write `clamp(x, low .. high)`",
    "pow": "a power is `a ^ b`",
    "square": "a power is `a ^ b`: `x ^ 2`",
    "radians": "write the unit: `30 deg`",
    "degrees": "divide by the unit: `angle / deg`",
    "if": "write `where(condition, a, b)`, or `a when condition`",
}


_Bound = tuple[Param, Typed]


class Checked(NamedTuple):
    """A whole text: its value, and how often its draws are repeated (None: once per episode)."""

    value: Typed
    redraw: Redraw | None = None


def check(tree: syntax.Node, scope: Scope, report: Report) -> Typed | None:
    """The typed tree of a text that gives one value; None after a finding that leaves it without a type."""
    if isinstance(tree, syntax.Redrawn):
        help = "only parameters and channel settings are drawn `every` period or `each step`"
        report("DB407", tree.value.end, tree.end, "a draw that is repeated", help)
        return None
    return _Checker(scope, report).whole(tree)


def check_drawn(tree: syntax.Node, scope: Scope, report: Report) -> Checked | None:
    """As `check`, where the text may end in `every 5 s` or `each step`."""
    checker = _Checker(scope, report)
    if not isinstance(tree, syntax.Redrawn):
        value = checker.whole(tree)
        return Checked(value) if value else None
    value = checker.whole(tree.value)
    period = checker.whole(tree.period) if tree.period else None
    if period and not (unification.numbers([period], report) and unification.has_dimension(period, TIME, "the period", report)):
        return None
    if value is None or (tree.period and period is None):
        return None
    if not checker.draws:
        help = "`every` and `each step` repeat draws such as `uniform(a .. b)`"
        report("DB401", tree.value.end, tree.end, "a repetition without a draw", help)
    return Checked(value._replace(type=value.type._replace(stage=Stage.STEP)), Redraw(period))


def check_range(tree: syntax.Node, scope: Scope, report: Report, *, falling: bool = False) -> TypedRange | None:
    """The typed ends of a text `low .. high`; with `falling`, the first may be above the second."""
    if not isinstance(tree, syntax.Range):
        report("DB401", tree.start, tree.end, "a single value where a range is needed", "write both ends: `low .. high`")
        return None
    checker = _Checker(scope, report)
    low, high = checker.whole(tree.low), checker.whole(tree.high)
    if low is None or high is None or not unification.numbers((low, high), report):
        return None
    if unification.dimension_of((low, high), tree.start, tree.end, report) is None:
        return None
    if unification.components_of((low, high), tree.start, tree.end, report) is None:
        return None
    if not falling and low.type.interval.low > high.type.interval.high:
        _report_falling(tree.low, tree.high, tree.start, tree.end, report)
        return None
    return TypedRange(low, high, tree.start, tree.end)


def _report_falling(low: Typed | syntax.Node, high: Typed | syntax.Node, start: int, end: int, report: Report) -> None:
    headline = "a range whose low end is above its high end"
    report("DB105", start, end, headline, "give the low end first", meant=unification.swapped(low, high))


class _Stop(Exception):  # noqa: N818 - no error: it carries nothing
    """A part has a finding; nothing above it is checked."""


class _Checker:
    """Visits one text; numbers its stateful calls and draws."""

    def __init__(self, scope: Scope, report: Report) -> None:
        self._scope = scope
        self._report = report
        self._occurrences = 0
        self.draws = 0

    def whole(self, tree: syntax.Node) -> Typed | None:
        """A whole text, or one end of a range; None after a finding."""
        try:
            if isinstance(tree, syntax.Range):
                raise self._fault("DB401", tree, "a range where a single value is needed")
            value = self.visit(tree)
            if value.type.copies:
                help = "there may be any number of them: take `min`, `max`, `sum`, `norm`, `any` or `all` of it"
                raise self._fault("DB404", tree, "a value for each copy of a group", help)
            if size(value) > MAX_SIZE:
                headline = f"an expression of more than {MAX_SIZE} operations on single numbers"
                raise self._fault("DB005", tree, headline, "name parts of it, as signals or parameters")
        except _Stop:
            return None
        return value

    def visit(self, node: syntax.Node) -> Typed:
        match node:  # the commonest first
            case syntax.Name():
                return self._reference(node)
            case syntax.Number():
                return self._constant(node, (node,), None)
            case syntax.Binary():
                return self._binary(node, *self._visits(node.left, node.right))
            case syntax.Call():
                return self._call(node)
            case syntax.Member():
                return self._pick(self.visit(node.value), node.member, node)
            case syntax.Unary():
                return self._unary(node, self.visit(node.operand))
            case syntax.When():
                return self._when(node, *self._visits(node.value, node.condition))
            case syntax.Vector():
                return self._vector(node)
            case syntax.Truth():
                return Constant(Type(boolean=True, interval=TRUTH), node.start, node.end, (node.value,))
            case _:
                raise self._fault("DB401", node, "a range or draw where a single value is needed")

    def _visits(self, *nodes: syntax.Node) -> list[Typed]:
        """All of them: every fault is reported before the check stops."""
        found: list[Typed] = []
        for node in nodes:
            with suppress(_Stop):
                found.append(self.visit(node))
        self._require(len(found) == len(nodes))
        return found

    def _fault(self, code: str, place: syntax.Node | Typed, headline: str, help: str | None = None) -> _Stop:
        """Reports a finding, and stops the check where it is raised."""
        self._report(code, place.start, place.end, headline, help)
        return _Stop()

    def _require(self, fits: bool) -> None:
        if not fits:
            raise _Stop

    def _numbers(self, *values: Typed) -> None:
        self._require(unification.numbers(values, self._report))

    def _truths(self, *values: Typed) -> None:
        self._require(unification.truths(values, self._report))

    def _dimension_of(self, values: Sequence[Typed], node: syntax.Node) -> Dimension:
        found = unification.dimension_of(values, node.start, node.end, self._report)
        if found is None:
            raise _Stop
        return found

    def _components_of(self, values: Sequence[Typed], node: syntax.Node) -> Components | None:
        found = unification.components_of(values, node.start, node.end, self._report)
        if found is None:
            raise _Stop
        return found[0]

    # names

    def _reference(self, node: syntax.Name) -> Typed:
        """The symbol of the longest known part of a dotted name; the rest of it picks components."""
        for length in range(len(node.parts), 0, -1):
            symbol = self._scope.lookup(".".join(node.parts[:length]))
            if symbol is None:
                continue
            if symbol.refused is not None:
                self._report("DB407", node.start, node.end, f"`{symbol.name}` has no value here", symbol.refused)
            if symbol.type is None:
                raise _Stop
            value: Typed = Reference(symbol.type, node.start, node.end, symbol)
            written = symbol.name
            for member in node.parts[length:]:
                value = self._pick(value, member, node, f"{written}.")
                written = f"{written}.{member}"
            return value
        raise self._no_value(node)

    def _pick(self, value: Typed, member: str, node: syntax.Node, before: str | None = None) -> Typed:
        """One component by its name, or several by single letters (`.xy`); the text of the value stands `before`, where it is a name."""
        components = value.type.components
        if components is None:
            raise self._fault("DB402", node, f"`.{member}` of a single value", "only vectors have components")
        wanted = (member,) if member in components else tuple(member)
        if not set(wanted) <= set(components) or len(set(wanted)) < len(wanted):
            raise self._unknown("component", member, components, node.start, node.end, before)
        chosen = value.type._replace(components=None if len(wanted) == 1 else wanted)
        return Pick(chosen, node.start, node.end, value, tuple(components.index(name) for name in wanted))

    def _subject(self, node: syntax.Node, kinds: frozenset[Kind], function: str) -> Subject:
        """The part of the world that an argument names; DB203 for one of another kind, DB402 for none."""
        wanted = _one_of(kinds)
        if not isinstance(node, syntax.Name):
            help = "name a part of the world, as in `position(cart.tip)`"
            raise self._fault("DB203", node, f"a value where `{function}` needs {wanted}", help)
        scope, name = self._scope, node.dotted
        subject, symbol = scope.subject(name, kinds), None
        if subject is not None and subject.kind in kinds:
            return subject
        if subject is None:
            symbol = scope.lookup(name)
        is_invalid = symbol is not None and symbol.type is None and symbol.refused is None
        if is_invalid or (subject is not None and subject.kind is Kind.BROKEN):
            raise _Stop
        fitting = [known for known in dict.fromkeys(scope.subjects()) if (other := scope.subject(known, kinds)) and other.kind in kinds]
        if subject is None and symbol is None:
            raise self._unknown("name", name, fitting, node.start, node.end)
        found = subject.kind.words if subject is not None else "a value"
        raise self._fault("DB203", node, f"`{name}` is {found}, but `{function}` needs {wanted}", _known(fitting))

    def _no_value(self, node: syntax.Name) -> _Stop:
        """A name that is no value: a part of the world, a function, or unknown."""
        scope, name = self._scope, node.dotted
        subject = scope.subject(name)
        if subject is not None:
            help = f"ask for one of its values, as in `{_ASKED.get(subject.kind, 'position')}({name})`"
            is_invalid = subject.kind is Kind.BROKEN
            return _Stop() if is_invalid else self._fault("DB203", node, f"`{name}` is {subject.kind.words}, not a value", help)
        if name in FUNCTIONS:
            return self._fault("DB402", node, f"`{name}` is a function", f"call it: `{FUNCTIONS[name].signature}`")
        if asked := self._asked_of_a_body(node):
            help = f"what is known of the world is asked for by functions: `{asked}`"
            self._report("DB402", node.start, node.end, f"unknown name `{name}`", help, meant=Meant(asked, safe=False))
            return _Stop()
        also = _NAMED.get(name.lower(), _ELSEWHERE.get(scope.context))
        return self._unknown("name", name, scope.names(), node.start, node.end, also=also)

    def _asked_of_a_body(self, node: syntax.Name) -> str | None:
        """`position(cart).x` for `cart.position.x` and for `cart.x`."""
        for length in range(len(node.parts) - 1, 0, -1):
            body, (asked, *rest) = ".".join(node.parts[:length]), node.parts[length:]
            subject = self._scope.subject(body) if Family.WORLD in ALLOWED[self._scope.context] else None
            if subject is not None and subject.kind in (Kind.ROBOT, Kind.LINK, Kind.OBJECT, Kind.WALL):
                function = FUNCTIONS.get(asked)
                if function is not None and function.family is Family.WORLD and len(function.params) == 1:
                    return ".".join([f"{asked}({body})", *rest])
                return f"position({body}).{asked}" if asked in SPACE and not rest else None
        return None

    def _unknown(
        self, what: str, name: str, known: Iterable[str], start: int, end: int, before: str | None = "", also: str | None = None
    ) -> _Stop:
        """DB402 with the nearest of the known names, and a list of them.

        `before` and the name stand between `start` and `end`; None says that the text cannot be written again. The
        help `also` is for names that are like none of the known.
        """
        names = sorted(known)
        near = _with_owner(name, names) or meant(name, names)
        listed = "; ".join(filter(None, (_known(names), None if near else also)))
        help = f"did you mean `{near.text}`? {listed}" if near else listed
        fix = near._replace(text=f"{before}{near.text}") if near and before is not None else None
        self._report("DB402", start, end, f"unknown {what} `{name}`", help, meant=fix)
        return _Stop()

    # literals

    def _constant(self, node: syntax.Number | syntax.Vector, items: Sequence[syntax.Number], components: Components | None) -> Constant:
        """Numbers in the unit of `node`, which stands behind the last of them."""
        unit = node.unit
        values = tuple(unit.to_si(item.value) if unit else item.value for item in items)
        if not all(map(math.isfinite, values)):
            raise self._fault("DB401", node, "a quantity too large to be kept")
        known = Type(unit.dimension if unit else NUMBER, components, interval=Interval(min(values), max(values)))
        return Constant(known, node.start, node.end, values, unit)

    def _vector(self, node: syntax.Vector) -> Typed:
        last = node.items[-1]
        if isinstance(last, syntax.Name):
            self._require_item(node, last)
        components = _positions(len(node.items))
        literals = [item for item in node.items if isinstance(item, syntax.Number)]
        if len(literals) == len(node.items):
            return self._constant(node, literals, components)
        items = self._visits(*node.items)
        self._numbers(*items)
        for item in items:
            if item.type.components is not None:
                raise self._fault("DB404", item, *_NESTED)
        interval, stage = hull([item.type.interval for item in items]), max(item.type.stage for item in items)
        result = Type(self._dimension_of(items, node), components, interval=interval, stage=stage)
        return Vector(result, node.start, node.end, tuple(items))

    def _require_item(self, node: syntax.Vector, name: syntax.Name) -> None:
        """The name behind the numbers must be their last item; otherwise it is a misspelt unit, or an operator is missing."""
        symbol = self._scope.lookup(name.parts[0]) or self._scope.lookup(name.dotted)
        if symbol is not None and len(node.items) > 2:
            return
        if symbol is not None:
            raise self._missing(node, name, symbol)
        unit, scaled = suggest_unit(name.dotted), multiple(name.dotted)
        help = "units are m, mm, cm, s, ms, kg, g, N, rad, deg, Hz, % and their products, as in `N*m/rad`"
        if unit is not None:
            help = f"did you mean `{unit.text}`?"
        elif scaled is not None:
            help = f"give it in {scaled[1]}: 1 {name.dotted} is {scaled[0]:g} {scaled[1]}"
        self._report("DB501", name.start, name.end, f"unknown unit `{name.dotted}`", help, meant=unit)
        raise _Stop

    def _missing(self, node: syntax.Vector, name: syntax.Name, symbol: Symbol) -> _Stop:
        """`when` is missing before a condition, an operator before a number."""
        start, at = node.items[0].start, name.start - node.items[0].start
        headline, help = f"an operator is missing before `{name.dotted}`", f"to multiply, write `*` before `{name.dotted}`"
        fix: Rewriting | None = None
        if symbol.type is not None and symbol.type.boolean:
            headline, help = f"`when` is missing before `{name.dotted}`", f"what is paid on a condition is written `5 when {name.dotted}`"
            fix = (lambda piece: f"{piece[:at]}when {piece[at:]}") if start == 0 else None  # only a whole text can take it
        self._report("DB401", start, name.end, headline, help, meant=fix)
        return _Stop()

    # operators

    def _when(self, node: syntax.When, value: Typed, condition: Typed) -> Typed:
        """`a when c` is `where(c, a, 0)`."""
        self._numbers(value)
        self._truths(condition)
        components = self._components_of((value, condition), node)
        nothing = Constant(Type(interval=exact(0.0)), node.end, node.end, (0.0,))
        stage = max(value.type.stage, condition.type.stage)
        result = Type(value.type.dimension, components, interval=hull((value.type.interval, exact(0.0))), stage=stage)
        return Invocation(result, node.start, node.end, "where", (), (condition, value, nothing))

    def _unary(self, node: syntax.Unary, operand: Typed) -> Typed:
        if node.operator == "not":
            self._truths(operand)
            return Operation(operand.type, node.start, node.end, "not", (operand,))
        self._numbers(operand)
        result = operand.type._replace(interval=OPERATORS["neg"].interval(operand.type.interval))
        if isinstance(operand, Constant):
            return operand._replace(type=result, start=node.start, values=tuple(-value for value in operand.values))
        return Operation(result, node.start, node.end, "neg", (operand,))

    def _binary(self, node: syntax.Binary, left: Typed, right: Typed) -> Typed:
        components = self._components_of((left, right), node)
        stage = max(left.type.stage, right.type.stage)
        operator = _OPERATORS.get(node.operator, node.operator)
        if operator in ("add", "sub", "mul", "div", "pow"):
            self._numbers(left, right)
            dimension = self._result_dimension(operator, node, left, right)
            self._warn_of_domain(operator, left, right)
            interval = OPERATORS[operator].interval(left.type.interval, right.type.interval)
            settled = all(value.type.interval.finite and value.type.interval.single for value in (left, right))
            if settled and interval.single and not interval.finite:  # a division by zero gives an interval that is not single
                self._report("DB406", node.start, node.end, "a result too large to be kept")
            return Operation(Type(dimension, components, interval=interval, stage=stage), node.start, node.end, operator, (left, right))
        if operator in ("and", "or"):
            self._truths(left, right)
        elif not (left.type.boolean and right.type.boolean and operator in ("equal", "not_equal")):
            self._numbers(left, right)
            if self._dimension_of((left, right), node) == ANGLE:
                unification.warn_of_degrees(left, self._report)
                unification.warn_of_degrees(right, self._report)
        truth = Type(components=components, boolean=True, interval=TRUTH, stage=stage)
        return Operation(truth, node.start, node.end, operator, (left, right))

    def _result_dimension(self, operator: str, node: syntax.Binary, left: Typed, right: Typed) -> Dimension:
        match operator:
            case "mul":
                return left.type.dimension * right.type.dimension
            case "div":
                return left.type.dimension / right.type.dimension
            case "pow":
                self._require(unification.has_dimension(right, NUMBER, "the exponent", self._report, alone=False))
                return self._raised(left.type.dimension, right)
            case _:
                return self._dimension_of((left, right), node)

    def _raised(self, base: Dimension, exponent: Typed) -> Dimension:
        """The dimension of a power: a quantity takes only exponents that are known and simple."""
        if base == NUMBER:
            return NUMBER
        known = exponent.type.interval
        fraction = _simple(known.low) if known.single and exponent.type.components is None else None
        if fraction is None:
            help = "divide by a unit first: only a plain number takes any exponent"
            raise self._fault("DB503", exponent, f"{base.words} to a power that is not a known, simple number", help)
        return base**fraction

    def _warn_of_domain(self, operator: str, left: Typed, right: Typed) -> None:
        """DB405 for a division by what can be zero, DB406 for a root of what can be negative."""
        a, b = left.type.interval, right.type.interval
        if operator == "div" and b.finite and 0.0 in b:
            between = f"the divisor lies between {b.low:g} and {b.high:g}, and can be zero"
            self._report("DB405", right.start, right.end, "a division by zero" if b.single else between, _NO_ZERO)
        if operator != "pow" or not a.finite:
            return
        if a.low < 0.0 and b.single and not b.low.is_integer():
            headline = f"a broken power of a value that can be as low as {a.low:g}"
            self._report("DB406", left.start, left.end, headline, _KEEP_ABOVE)
        if 0.0 in a and b.high < 0.0:
            self._report("DB405", left.start, left.end, "a negative power of a value that can be zero", _NO_ZERO)

    # calls

    def _call(self, node: syntax.Call) -> Typed:
        function = FUNCTIONS.get(node.function)
        if function is None:
            if help := _CALLED_ELSEWHERE.get(node.function):
                self._report("DB402", node.start, node.name_end, f"unknown function `{node.function}`", help)
                raise _Stop
            raise self._unknown("function", node.function, FUNCTIONS, node.start, node.name_end)
        occurrence = None
        if function.family in (Family.STATEFUL, Family.DRAW):
            occurrence = self._occurrences
            self._occurrences += 1
            self.draws += function.family is Family.DRAW
        allowed = self._is_allowed(node, function)
        subjects, bound = self._arguments(node, function)
        typed = self._invocation(node, function, subjects, bound, occurrence)
        self._require(allowed)
        return typed

    def _is_allowed(self, node: syntax.Call, function: Function) -> bool:
        """Whether the function may be called in this place; DB407 otherwise."""
        context = self._scope.context
        if function.family in ALLOWED[context]:
            return True
        help = _FAMILY_HELP.get(function.family)
        if context is Context.FORBID:
            help = "compute it under `augment`, and name that here"
        elif context is Context.FIXED and function.family is Family.DRAW:
            help = "it is the same in every episode; give one figure"
        elif context is Context.SCRIPT and function.family is Family.STATEFUL:
            help = "keep it as a signal, and name that here"
        self._report("DB407", node.start, node.name_end, f"`{function.name}` in {context.value}", help)
        return False

    def _arguments(self, node: syntax.Call, function: Function) -> tuple[tuple[Subject, ...], list[_Bound]]:
        """The subjects, and each value with its parameter: both ends of a range have the same."""
        params = function.params
        fewest, given = sum(not param.optional for param in params), len(node.args)
        if given < fewest or (given > len(params) and not params[-1].many):
            wanted = f"at least {fewest}" if params[-1].many else " or ".join(str(n) for n in sorted({fewest, len(params)}))
            noun = "argument" if wanted == "1" else "arguments"
            raise self._fault("DB401", node, f"`{function.name}` takes {wanted} {noun}, not {given}", _usage(function))
        subjects: list[Subject] = []
        bound: list[_Bound] = []
        wrong = False
        for index, arg in enumerate(node.args):
            param = params[min(index, len(params) - 1)]
            try:
                if param.form is Form.SUBJECT:
                    subjects.append(self._subject(arg, param.kinds, function.name))
                else:
                    bound += [(param, value) for value in self._visits(*self._parts(param, arg, function))]
            except _Stop:
                wrong = True
        self._require(not wrong)
        return tuple(subjects), bound

    def _parts(self, param: Param, arg: syntax.Node, function: Function) -> Sequence[syntax.Node]:
        """The values in one argument: one, both ends of a range, or all options."""
        match param.form, arg:
            case Form.VALUE, syntax.Range() | syntax.Spread() | syntax.Options():
                raise self._fault("DB401", arg, "a range or draw where a single value is needed", _usage(function))
            case Form.VALUE, _:
                return (arg,)
            case Form.RANGE, syntax.Range(low=low, high=high):
                return (low, high)
            case Form.SPREAD, syntax.Spread(mean=mean, deviation=deviation):
                return (mean, deviation)
            case Form.OPTIONS, syntax.Options(items=items):
                return items
        raise self._fault("DB401", arg, f"`{function.name}` needs `{param}` here", _usage(function))

    def _invocation(
        self, node: syntax.Call, function: Function, subjects: tuple[Subject, ...], bound: list[_Bound], occurrence: int | None
    ) -> Typed:
        """The typed call: dimension, shape, interval and stage of the result."""
        values = tuple(value for _, value in bound)
        boolean = self._is_boolean(function, bound)
        shared = self._shared_dimension(node, function, subjects, bound)
        components = self._components(node, function, subjects, bound)
        given = [subject.interval for subject in subjects] + [value.type.interval for value in values]
        reduction = function.reduction if components is None and values and values[0].type.components else None
        if boolean:
            interval = TRUTH
        elif reduction is None:
            interval = function.interval(*given)
        else:
            interval = reduction.interval(given[0], len(values[0].type.components or ()))
        if reduction is not None and values[0].type.copies:  # there may be none of them
            interval = hull([interval, exact(float(reduction.empty or 0.0))])
        self._warn(function, bound)
        result = Type(NUMBER if boolean else function.result(shared), components, boolean, interval, _stage(function, values))
        if function.name == "vector":
            return Vector(result, node.start, node.end, values)
        return Invocation(result, node.start, node.end, function.name, subjects, values, occurrence)

    def _is_boolean(self, function: Function, bound: list[_Bound]) -> bool:
        """Whether the result is a truth value; DB403 for arguments that are not what they must be."""
        conditions = [value for param, value in bound if param.truth]
        others = [value for param, value in bound if not param.truth]
        truths = function.truths and any(value.type.boolean for value in others)
        fits = unification.truths(conditions, self._report)
        fits = (unification.truths if truths else unification.numbers)(others, self._report) and fits
        self._require(fits)
        return function.boolean or truths

    def _shared_dimension(self, node: syntax.Call, function: Function, subjects: tuple[Subject, ...], bound: list[_Bound]) -> Dimension:
        """The dimension of all arguments that have none of their own."""
        what = f"the argument of `{function.name}`"
        own = [(param.dimension, value) for param, value in bound if param.dimension is not None and not param.truth]
        fits = [unification.has_dimension(value, dimension, what, self._report) for dimension, value in own]
        self._require(all(fits))
        shared = [value for param, value in bound if param.dimension is None and not param.truth]
        return subjects[0].dimension if subjects and not shared else self._dimension_of(shared, node)

    def _components(self, node: syntax.Call, function: Function, subjects: tuple[Subject, ...], bound: list[_Bound]) -> Components | None:
        """The components of the result; DB404 where the arguments have others than they must."""
        values = [value for _, value in bound]
        if function.components is not None:
            for param, value in bound:
                if param.components and value.type.components != param.components:
                    raise self._fault("DB404", value, f"{value.type.shape_words} where a vector of x, y, z is needed")
            return function.components
        if function.name == "vector":
            return self._gathered(node, values)
        if function.reduction is not None and len(values) == 1:
            (vector,) = values
            if vector.type.copies and function.reduction.empty is None:
                help = "there may be none of them: take `min`, `max`, `sum`, `norm`, `any` or `all`"
                raise self._fault("DB404", node, f"a {function.name} over the copies of a group", help)
            if vector.type.components is None:
                raise self._fault("DB404", vector, f"a single value where `{function.name}` needs a vector", _usage(function))
            return None
        groups = [subject.components for subject in subjects if subject.components is not None]
        if len(groups) > 1:
            raise self._fault("DB404", node, "a group on both sides", "name a single one on one side")
        return groups[0] if groups else self._components_of(values, node)

    def _gathered(self, node: syntax.Call, values: list[Typed]) -> Components:
        for value in values:
            if value.type.components is not None:
                raise self._fault("DB404", value, *_NESTED)
        if len(values) not in (len(PLANE), len(SPACE)):
            raise self._fault("DB404", node, f"a vector of {len(values)} values", "`vector` takes two (x, y) or three (x, y, z)")
        return _positions(len(values))

    def _warn(self, function: Function, bound: list[_Bound]) -> None:
        """DB504 for angles beyond a turn, DB406 for an argument out of the domain, DB105 for a draw from a falling range."""
        values = [value for _, value in bound]
        for param, value in bound:
            if param.dimension == ANGLE and function.result(ANGLE) != ANGLE:
                unification.warn_of_degrees(value, self._report)
        interval = values[0].type.interval if values else TRUTH
        if interval.finite and interval.low < function.domain.low:
            headline = f"the argument of `{function.name}` can be as low as {interval.low:g}"
            self._report("DB406", values[0].start, values[0].end, headline, _KEEP_ABOVE)
        if function.family is Family.DRAW and function.params[0].form is Form.RANGE:
            low, high = values
            if low.type.interval.low > high.type.interval.high:
                _report_falling(low, high, low.start, high.end, self._report)


def _stage(function: Function, values: Sequence[Typed]) -> Stage:
    if function.family in (Family.WORLD, Family.MESSAGE, Family.STATEFUL):
        return Stage.STEP
    drawn = Stage.EPISODE if function.family is Family.DRAW else Stage.FIXED
    return max([drawn, *(value.type.stage for value in values)])


def _usage(function: Function) -> str:
    return f"`{function.signature}`: {function.doc}"


def _positions(count: int) -> Components:
    """Two numbers are x y, three are x y z; longer lists are numbered from 1."""
    return {len(PLANE): PLANE, len(SPACE): SPACE}.get(count) or tuple(str(n + 1) for n in range(count))


def _simple(value: float) -> Exponent | None:
    """The exponent as a whole number or a fraction with a small denominator."""
    if abs(value) > _MAX_EXPONENT:
        return None
    if value.is_integer():
        return int(value)
    near = Fraction(value).limit_denominator(_MAX_DENOMINATOR)
    return near if float(near) == value else None


def _with_owner(name: str, known: list[str]) -> Meant | None:
    """`cart.speed.x` for `speed.x`, if one part alone has a `speed`."""
    first, dot, rest = name.partition(".")
    longer = [other for other in known if other.endswith(f".{first}")]
    return Meant(f"{longer[0]}{dot}{rest}", safe=False) if len(longer) == 1 else None


def _known(names: list[str]) -> str:
    return f"known are {shown((f'`{name}`' for name in sorted(names)), 20)}" if names else "there is none to choose from"


def _one_of(kinds: frozenset[Kind]) -> str:
    named = [kind.words for kind in Kind if kind in kinds]
    if kinds >= {Kind.WALL, Kind.WALLS}:
        named.remove(Kind.WALLS.words)
        named[named.index(Kind.WALL.words)] = "a wall"
    return named[0] if len(named) == 1 else f"{', '.join(named[:-1])} or {named[-1]}"
