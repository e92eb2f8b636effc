"""Syntax tree to typed tree: every name, dimension, shape, interval and stage is settled here.

A part that is wrong becomes None, which satisfies whatever is checked above it: one fault, one finding.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

from deepbots_cli.expressions import agree, operators, syntax
from deepbots_cli.expressions.calls import call
from deepbots_cli.expressions.dimensions import NUMBER, TIME
from deepbots_cli.expressions.functions import Family
from deepbots_cli.expressions.guesses import swapped
from deepbots_cli.expressions.intervals import TRUTH, Interval, exact, hull
from deepbots_cli.expressions.names import pick, reference
from deepbots_cli.expressions.size import MAX_SIZE, size
from deepbots_cli.expressions.table import FUNCTIONS
from deepbots_cli.expressions.typed import Constant, Invocation, Redraw, Typed, TypedRange, Vector
from deepbots_cli.expressions.types import PLANE, SPACE, Components, Report, Scope, Stage, Symbol, Type
from deepbots_cli.expressions.units import multiple, suggest_unit

_NUMBERED = {Family.STATEFUL, Family.DRAW}


class Checked(NamedTuple):
    """A whole text: its value, and how often its draws are repeated (None: once per episode)."""

    value: Typed
    redraw: Redraw | None = None


def check(tree: syntax.Node, scope: Scope, report: Report) -> Typed | None:
    """The typed tree of a text that gives one value; None after a finding that leaves it without a type."""
    if isinstance(tree, syntax.Redrawn):
        report(
            "DB407",
            tree.value.end,
            tree.end,
            "a draw that is repeated",
            "only parameters and channel settings are drawn `every` period or `each step`",
        )
        return None
    return _whole(tree, _Checker(scope, report), report)


def check_drawn(tree: syntax.Node, scope: Scope, report: Report) -> Checked | None:
    """As `check`, where the text may end in `every 5 s` or `each step`."""
    if not isinstance(tree, syntax.Redrawn):
        value = _whole(tree, _Checker(scope, report), report)
        return Checked(value) if value else None
    checker = _Checker(scope, report)
    value = _whole(tree.value, checker, report)
    period = checker.visit(tree.period) if tree.period else None
    if period and not (agree.numbers([period], report) and agree.has_dimension(period, TIME, "the period", report)):
        return None
    if value is None or (tree.period and period is None):
        return None
    if not checker.draws:
        report(
            "DB401",
            tree.value.end,
            tree.end,
            "a repetition without a draw",
            "`every` and `each step` repeat draws such as `uniform(a .. b)`",
        )
    return Checked(value._replace(type=value.type._replace(stage=Stage.STEP)), Redraw(period))


def check_range(tree: syntax.Node, scope: Scope, report: Report, *, falling: bool = False) -> TypedRange | None:
    """The typed ends of a text `low .. high`; with `falling`, the first may be above the second."""
    if not isinstance(tree, syntax.Range):
        report("DB401", tree.start, tree.end, "a single value where a range is needed", "write both ends: `low .. high`")
        return None
    checker = _Checker(scope, report)
    low, high = _whole(tree.low, checker, report), _whole(tree.high, checker, report)
    if low is None or high is None or not agree.numbers((low, high), report):
        return None
    if agree.dimension_of((low, high), tree.start, tree.end, report) is None:
        return None
    if agree.components_of((low, high), tree.start, tree.end, report) is None:
        return None
    if not falling and low.type.interval.low > high.type.interval.high:
        headline = "a range whose low end is above its high end"
        report("DB105", tree.start, tree.end, headline, "give the low end first", meant=swapped(tree.low, tree.high))
        return None
    return TypedRange(low, high, tree.start, tree.end)


def _whole(tree: syntax.Node, checker: _Checker, report: Report) -> Typed | None:
    if isinstance(tree, syntax.Range):
        report("DB401", tree.start, tree.end, "a range where a single value is needed")
        return None
    value = checker.visit(tree)
    if value is not None and value.type.copies:
        help = "there may be any number of them: take `min`, `max`, `sum`, `norm`, `any` or `all` of it"
        report("DB404", tree.start, tree.end, "a value for each copy of a group", help)
        return None
    if value is not None and size(value) > MAX_SIZE:
        report(
            "DB005",
            tree.start,
            tree.end,
            f"an expression of more than {MAX_SIZE} operations on single numbers",
            "name parts of it, as signals or parameters",
        )
        return None
    return value


class _Checker:
    """Visits one text; counts its stateful calls and draws, which are told apart by their number."""

    def __init__(self, scope: Scope, report: Report) -> None:
        self._scope = scope
        self._report = report
        self._occurrences = 0
        self.draws = 0

    def visit(self, node: syntax.Node) -> Typed | None:
        match node:  # what there is most of comes first
            case syntax.Name():
                return reference(node, self._scope, self._report)
            case syntax.Number():
                return self._number(node)
            case syntax.Binary():
                left, right = self.visit(node.left), self.visit(node.right)
                return operators.binary(node, left, right, self._report) if left and right else None
            case syntax.Call():
                return self._call(node)
            case syntax.Member():
                value = self.visit(node.value)
                return pick(value, node.member, node.start, node.end, self._report) if value else None
            case syntax.Unary():
                operand = self.visit(node.operand)
                return operators.unary(node, operand, self._report) if operand else None
            case syntax.When():
                return self._when(node)
            case syntax.Vector():
                return self._vector(node)
            case syntax.Truth():
                return Constant(Type(boolean=True, interval=TRUTH), node.start, node.end, (node.value,))
            case _:
                self._report("DB401", node.start, node.end, "a range or draw where a single value is needed")
                return None

    def _call(self, node: syntax.Call) -> Typed | None:
        function = FUNCTIONS.get(node.function)
        occurrence = self._occurrences
        if function is not None and function.family in _NUMBERED:
            self._occurrences += 1
            self.draws += function.family is Family.DRAW
        return call(node, self._scope, self.visit, self._report, occurrence)

    def _when(self, node: syntax.When) -> Typed | None:
        """`a when c` is `where(c, a, 0)`."""
        value, condition = self.visit(node.value), self.visit(node.condition)
        if value is None or condition is None:
            return None
        if not (agree.numbers([value], self._report) and agree.truths([condition], self._report)):
            return None
        components = agree.components_of((value, condition), node.start, node.end, self._report)
        if components is None:
            return None
        nothing = Constant(Type(interval=exact(0.0)), node.end, node.end, (0.0,))
        stage = max(value.type.stage, condition.type.stage)
        result = Type(value.type.dimension, components[0], interval=hull((value.type.interval, exact(0.0))), stage=stage)
        return Invocation(result, node.start, node.end, "where", (), (condition, value, nothing))

    def _number(self, node: syntax.Number) -> Constant | None:
        value = node.unit.to_si(node.value) if node.unit else node.value
        if not math.isfinite(value):
            self._too_large(node)
            return None
        dimension = node.unit.dimension if node.unit else NUMBER
        return Constant(Type(dimension, interval=exact(value)), node.start, node.end, (value,), node.unit)

    def _too_large(self, node: syntax.Number | syntax.Vector) -> None:
        self._report("DB401", node.start, node.end, "a quantity too large to be kept")

    def _numbers(self, items: Sequence[syntax.Number], node: syntax.Vector, components: Components) -> Constant | None:
        """Numbers in the unit of `node`, which stands behind the last of them."""
        unit = node.unit
        values = tuple(unit.to_si(item.value) if unit else item.value for item in items)
        if not all(map(math.isfinite, values)):
            self._too_large(node)
            return None
        dimension = unit.dimension if unit else NUMBER
        return Constant(Type(dimension, components, interval=Interval(min(values), max(values))), node.start, node.end, values, unit)

    def _vector(self, node: syntax.Vector) -> Typed | None:
        last = node.items[-1]
        if isinstance(last, syntax.Name) and self._misspelt_unit(node, last):
            return None
        components = _positions(len(node.items))
        if all(isinstance(item, syntax.Number) for item in node.items):
            return self._numbers([item for item in node.items if isinstance(item, syntax.Number)], node, components)
        items = [self.visit(item) for item in node.items]
        known = [item for item in items if item is not None]
        if len(known) < len(items) or not agree.numbers(known, self._report):
            return None
        nested = next((item for item in known if item.type.components is not None), None)
        if nested is not None:
            self._report("DB404", nested.start, nested.end, "a vector inside a vector", "pick a component, as in `v.x`")
            return None
        dimension = agree.dimension_of(known, node.start, node.end, self._report)
        if dimension is None:
            return None
        stage = max(item.type.stage for item in known)
        result = Type(dimension, components, interval=hull([item.type.interval for item in known]), stage=stage)
        return Vector(result, node.start, node.end, tuple(known))

    def _misspelt_unit(self, node: syntax.Vector, name: syntax.Name) -> bool:
        """Whether the name behind the numbers is no value of a vector; reports what it is instead."""
        named = self._scope.lookup(name.parts[0]) or self._scope.lookup(name.dotted)
        if named is not None and len(node.items) > 2:
            return False
        if named is not None:
            self._report_missing(node, name, named)
            return True
        meant, scaled = suggest_unit(name.dotted), multiple(name.dotted)
        help = "units are m, mm, cm, s, ms, kg, g, N, rad, deg, Hz, % and their products, as in `N*m/rad`"
        if meant is not None:
            help = f"did you mean `{meant.text}`?"
        elif scaled is not None:
            help = f"give it in {scaled[1]}: 1 {name.dotted} is {scaled[0]:g} {scaled[1]}"
        self._report("DB501", name.start, name.end, f"unknown unit `{name.dotted}`", help, meant=meant)
        return True

    def _report_missing(self, node: syntax.Vector, name: syntax.Name, named: Symbol) -> None:
        """What was left out before a value: `when` before a condition, an operator before a number."""
        start, is_condition = node.items[0].start, named.type is not None and named.type.boolean
        headline = f"{'`when`' if is_condition else 'an operator'} is missing before `{name.dotted}`"
        if not is_condition:
            self._report("DB401", start, name.end, headline, f"to multiply, write `*` before `{name.dotted}`")
            return
        help = f"what is paid on a condition is written `5 when {name.dotted}`"
        at = name.start - start  # only a whole text can take it
        meant = (lambda piece: f"{piece[:at]}when {piece[at:]}") if start == 0 else None
        self._report("DB401", start, name.end, headline, help, meant=meant)


def _positions(count: int) -> Components:
    """Two numbers are x y, three are x y z; longer lists are numbered from 1."""
    return {len(PLANE): PLANE, len(SPACE): SPACE}.get(count) or tuple(str(n + 1) for n in range(count))
