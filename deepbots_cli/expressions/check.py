"""Syntax tree to typed tree: resolves names, dimensions, shapes, intervals, and when values are known.

A finding stops the check of all nodes above its own, but not of its neighbors: each fault gives one finding.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import suppress
from fractions import Fraction
from functools import partial
from itertools import chain
from typing import NamedTuple, TypeVar

from deepbots_cli.diagnostics.nearest import (
    FOREIGN_FUNCTION_HELP,
    MAX_BESIDE,
    Replacement,
    is_typo,
    suggest_replacement,
    with_owner,
)
from deepbots_cli.expressions import syntax
from deepbots_cli.expressions.dimensions import ANGLE, NUMBER, TIME, Dimension, prefixed_unit, suggest_unit
from deepbots_cli.expressions.functions import (
    ALLOWED_FAMILIES,
    FUNCTIONS,
    OPERATORS,
    Family,
    Form,
    Function,
    Param,
)
from deepbots_cli.expressions.intervals import TRUTH, Interval, hull, single
from deepbots_cli.expressions.types import (
    CORRECTED_LINE,
    MAX_SIZE,
    PLANE,
    SPACE,
    Components,
    ComponentSelection,
    Constant,
    Context,
    FindingReporter,
    GroupComponents,
    Invocation,
    Kind,
    Known,
    Operation,
    Redraw,
    Reference,
    RowComponents,
    Scope,
    Subject,
    TypedNode,
    TypedRange,
    ValueType,
    Vector,
    size,
)
from deepbots_cli.expressions.unification import (
    CONTEXT_HELP,
    CONTEXT_NAME_HELP,
    FAMILY_HELP,
    FUNCTION_OF_KIND,
    NAME_HELP,
    WHOLE_TEXT,
    StopChecking,
    aligned,
    components_of,
    dimension_of,
    keep_above_help,
    known_names_help,
    no_zero_help,
    none_after_finding,
    one_of,
    report_at,
    require_dimension,
    require_kind,
    usage,
    warn_of_degrees,
)

A = TypeVar("A")
B = TypeVar("B")

_ARITHMETIC = {"+": "add", "-": "sub", "*": "mul", "/": "div", "^": "pow"}
COMPARISONS = {
    "<": "less",
    "<=": "less_equal",
    ">": "greater",
    ">=": "greater_equal",
    "==": "equal",
    "!=": "not_equal",
}
_NUMBER = r"[-+]?[\d_]*\.?\d+(?:[eE][-+]?\d+)?"
_MAX_EXPONENT = 12
# Physical formulas contain halves, thirds and quarters as exponents. A float counts as such a fraction if it
# is the nearest float to it.
_MAX_DENOMINATOR = 4


class TypedExpression(NamedTuple):
    """A whole text: its value, and how often its draws are repeated (None: once per episode)."""

    value: TypedNode
    redraw: Redraw | None = None


@none_after_finding
def check(tree: syntax.Node, scope: Scope, report: FindingReporter) -> TypedNode:
    """Return the typed tree of a text that gives one value; None after a finding that leaves it without a
    type."""
    if isinstance(tree, syntax.Redrawn):
        help = "only parameters and channel settings may be drawn again with `every` or `each step`"
        report("DB407", tree.value.end, tree.end, "a draw that is repeated", help)
        raise StopChecking
    return _Checker(scope, report).whole(tree)


@none_after_finding
def check_drawn(tree: syntax.Node, scope: Scope, report: FindingReporter) -> TypedExpression:
    """Check a text like `check`; it may end in `every 5 s` or `each step`."""
    checker = _Checker(scope, report)
    if not isinstance(tree, syntax.Redrawn):
        return TypedExpression(checker.whole(tree))
    value, *periods = checker.each(checker.whole, (tree.value, *([tree.period] if tree.period else [])))
    for period in periods:
        require_kind([period], report)
        require_dimension(period, TIME, "the period", report)
    if not checker.draws:
        help = "put a draw such as `uniform(a .. b)` before `every` or `each step`"
        report("DB401", tree.value.end, tree.end, "there is no draw to repeat", help)
    return TypedExpression(
        value._replace(type=value.type._replace(known=Known.STEP)), Redraw(periods[0] if periods else None)
    )


@none_after_finding
def check_range(
    tree: syntax.Node, scope: Scope, report: FindingReporter, *, falling: bool = False
) -> TypedRange:
    """Return the typed ends of a text `low .. high`; with `falling`, the first may be above the second."""
    if not isinstance(tree, syntax.Range):
        raise report_at(
            report, "DB401", tree, "expected a range, found a single value", "write both ends: `low .. high`"
        )
    checker = _Checker(scope, report)
    low, high = checker.each(checker.whole, (tree.low, tree.high))
    typed = TypedRange(low, high, tree.start, tree.end)
    require_kind((low, high), report)
    dimension_of((low, high), tree, report)
    low, high = aligned((low, high), tree, report)
    typed = typed._replace(low=low, high=high)
    if not falling:
        _require_rising(typed, report)
    return typed


def _require_rising(typed: TypedRange, report: FindingReporter) -> None:
    columns = list(_columns((typed.low.type, typed.high.type)))
    if any(low.low > high.high for low, high in columns):
        headline, help = "a range whose low end is above its high end", "write the low end first"
        if len(columns) > 1:  # perhaps of one component only
            raise report_at(report, "DB105", typed, headline, help)
        help += f": {CORRECTED_LINE}"
        raise report_at(report, "DB105", typed, headline, help, WHOLE_TEXT, corrected=partial(_turned, typed))


def _turned(typed: TypedRange, text: str) -> str:
    """Return a text with the ends of a range in the other order; a unit behind both ends stays there."""
    low, high = (text[end.start : end.end] for end in (typed.low, typed.high))
    is_number = re.fullmatch(_NUMBER, low) is not None
    first = high[: match.end()] if is_number and (match := re.match(_NUMBER, high)) else high
    between, unit = text[typed.low.end : typed.high.start], high[len(first) :]
    return f"{text[: typed.low.start]}{first}{between}{low}{unit}{text[typed.high.end :]}"


def _summed(tree: syntax.Node) -> Iterator[syntax.Node]:
    """Yield the sums that give the value of a text: the whole, its summands, and the left side of `when`."""
    waiting = [tree]
    while waiting:
        node = waiting.pop()
        if isinstance(node, syntax.Binary) and node.operator in ("+", "-", "when"):
            yield node
            waiting += (node.left,) if node.operator == "when" else (node.left, node.right)


class _Checker:
    """Visits one text; numbers its stateful calls and draws."""

    def __init__(self, scope: Scope, report: FindingReporter) -> None:
        self._scope = scope
        self._report = report
        self._fault = partial(report_at, report)
        self._occurrences = 0
        self._reward_sums: frozenset[int] = frozenset()
        self.draws = 0

    def whole(self, tree: syntax.Node) -> TypedNode:
        """Check a whole text, or one end of a range."""
        if isinstance(tree, syntax.Range):
            raise self._fault("DB401", tree, "expected a single value, found a range")
        if self._scope.context is Context.REWARD:
            self._reward_sums = frozenset(map(id, _summed(tree)))
        value = self.visit(tree)
        if value.type.has_group_components:
            help = (
                "combine the values with `min`, `max`, `sum`, `norm`, `any` or `all`, because the number"
                " of copies varies"
            )
            raise self._fault(
                "DB404", tree, "expected a single value, found one value for each copy of a group", help
            )
        if size(value) > MAX_SIZE:
            headline = f"the expression has more than {MAX_SIZE} operations on single numbers"
            raise self._fault("DB005", tree, headline, "define parts of it as signals or parameters")
        return value

    def visit(self, node: syntax.Node) -> TypedNode:
        match node:  # the most frequent first
            case syntax.Name():
                return self._reference(node)
            case syntax.Number():
                return self._constant(node, (node,), None)
            case syntax.Binary():
                self._require_unit(node)
                left, right = self.each(self.visit, (node.left, node.right))
                return (
                    self._when(node, left, right)
                    if node.operator == "when"
                    else self._binary(node, left, right)
                )
            case syntax.Call():
                return self._call(node)
            case syntax.Conditional():  # in Python's order, in which states and draws are numbered
                condition, *values = self.each(self.visit, (node.condition, node.value, node.otherwise))
                return self._conditional(node, condition, values)
            case syntax.Member():
                return self._pick(self.visit(node.value), node.member, node)
            case syntax.Unary():
                return self._unary(node, self.visit(node.operand))
            case syntax.Vector():
                return self._vector(node)
            case syntax.Truth():
                return Constant(ValueType(boolean=True, interval=TRUTH), node.start, node.end, (node.value,))
            case _:
                raise self._fault("DB401", node, "expected a single value, found a range or a draw")

    @staticmethod
    def each(visit: Callable[[A], B], items: Sequence[A]) -> list[B]:
        """Return the result for every item: the faults of all of them are reported before the check stops."""
        values: list[B] = []
        for item in items:
            try:  # 0.1 us, with `contextlib.suppress` 1.4 us; called for every operator
                values.append(visit(item))
            except StopChecking:
                continue
        if len(values) < len(items):
            raise StopChecking
        return values

    # names

    def _reference(self, node: syntax.Name) -> TypedNode:
        """Return the symbol of the longest known part of a dotted name; the rest of the name picks
        components."""
        for length in range(len(node.parts), 0, -1):
            symbol = self._scope.lookup(".".join(node.parts[:length]))
            if symbol is None:
                continue
            if symbol.refusal is not None:
                self._fault("DB407", node, f"`{symbol.name}` has no value here", symbol.refusal)
            if symbol.type is None:
                raise StopChecking
            value: TypedNode = Reference(symbol.type, node.start, node.end, symbol)
            for index in range(length, len(node.parts)):
                value = self._pick(value, node.parts[index], node, ".".join([*node.parts[:index], ""]))
            return value
        raise self._no_value(node)

    def _pick(self, value: TypedNode, member: str, node: syntax.Node, before: str | None = None) -> TypedNode:
        """Return one component by its name, or several by single letters (`.xy`); `before` is the text of the
        value, if it is a name."""
        components = value.type.components
        if components is None:
            raise self._fault("DB402", node, f"`.{member}` of a single value", "only vectors have components")
        if isinstance(components, RowComponents):
            return self._pick_of_rows(value, components, member, node, before)
        names = (member,) if member in components else tuple(member)
        if not set(names) <= set(components) or len(set(names)) < len(names):
            raise self._unknown("component", member, components, node, before)
        indices = tuple(components.index(name) for name in names)
        return ComponentSelection(value.type.selected(indices), node.start, node.end, value, indices)

    def _pick_of_rows(
        self, value: TypedNode, components: RowComponents, member: str, node: syntax.Node, before: str | None
    ) -> TypedNode:
        """Return a row by its name, or one or several components of all rows."""
        rows, columns = components.rows, components.columns
        selection: Components
        if member in rows:
            selection = columns
            indices = components.row(member)
        elif member in columns:
            selection = rows
            indices = components.column(member)
        else:
            if not set(member) <= set(columns) or len(set(member)) < len(member):
                raise self._unknown("component", member, (*rows, *columns), node, before)
            selection = RowComponents(rows, tuple(member))
            by_column = [components.column(name) for name in member]
            indices = tuple(index for row in zip(*by_column, strict=True) for index in row)
        selected = value.type.selected(indices)._replace(components=selection)
        return ComponentSelection(selected, node.start, node.end, value, indices)

    def _subject(self, node: syntax.Node, kinds: frozenset[Kind], function: str) -> Subject:
        """Return the part of the world that an argument names; DB203 for one of another kind, DB402 for
        none."""
        expected = one_of(kinds)
        if not isinstance(node, syntax.Name):
            help = "write the name of one, as in `position(cart.tip)`"
            raise self._fault("DB203", node, f"`{function}` needs {expected}, not a value", help)
        scope = self._scope
        name = node.dotted
        subject = scope.subject(name, kinds)
        if subject is not None and subject.kind in kinds:
            return subject
        symbol = scope.lookup(name) if subject is None else None
        is_invalid = symbol is not None and symbol.type is None and symbol.refusal is None
        if is_invalid or (subject is not None and subject.kind is Kind.BROKEN):
            raise StopChecking
        fitting = [
            fitting_name
            for fitting_name in dict.fromkeys(scope.subjects())
            if (candidate := scope.subject(fitting_name, kinds)) and candidate.kind in kinds
        ]
        if subject is None and symbol is None:
            raise self._unknown("name", name, fitting, node)
        description = subject.kind.description if subject is not None else "a value"
        help = known_names_help(fitting, f"the scenario does not have {expected}")
        if subject is not None and subject.kind is Kind.OBJECTS and fitting:
            help = f"use a function of two bodies, as in `min(distance({min(fitting)}, {name}))`; {help}"
        if kinds == {Kind.CAMERA}:
            description = (
                f"{description} of another type" if description == Kind.SENSOR.description else description
            )
            help = (
                help
                if fitting
                else f"add a sensor with `type: camera` to a robot, and write its name in place of `{name}`"
            )
        raise self._fault(
            "DB203", node, f"`{name}` is {description}, but `{function}` needs {expected}", help
        )

    def _no_value(self, node: syntax.Name) -> StopChecking:
        """Return the error for a name that is not a value: a part of the world, a function, or unknown."""
        scope = self._scope
        name = node.dotted
        subject = scope.subject(name)
        if subject is not None:
            help = f"use one of its values, as in `{FUNCTION_OF_KIND.get(subject.kind, 'position')}({name})`"
            is_invalid = subject.kind is Kind.BROKEN
            return (
                StopChecking()
                if is_invalid
                else self._fault("DB203", node, f"`{name}` is {subject.kind.description}, not a value", help)
            )
        if name in FUNCTIONS:
            return self._fault(
                "DB402", node, f"`{name}` is a function", f"call it: `{FUNCTIONS[name].signature}`"
            )
        if call := self._asked_of_a_body(node):
            what = FUNCTIONS[call.partition("(")[0]].doc.removesuffix(".")
            help = f"read values of the world with a function: `{call}`, {what[0].lower()}{what[1:]}"
            beside = sorted(other for other in scope.names() if other.startswith(f"{node.parts[0]}."))
            if beside:
                help += f"; names of `{node.parts[0]}`: {', '.join(beside[:MAX_BESIDE])}"
            return self._fault("DB402", node, f"unknown name `{name}`", help, Replacement(call, safe=False))
        return self._unknown(
            "name",
            name,
            scope.names(),
            node,
            also=NAME_HELP.get(name.lower(), CONTEXT_NAME_HELP.get(scope.context)),
        )

    def _asked_of_a_body(self, node: syntax.Name) -> str | None:
        """Return `position(cart).x` for `cart.position.x` and for `cart.x`."""
        for length in range(len(node.parts) - 1, 0, -1):
            body = ".".join(node.parts[:length])
            member, *components = node.parts[length:]
            subject = (
                self._scope.subject(body) if Family.WORLD in ALLOWED_FAMILIES[self._scope.context] else None
            )
            if subject is not None and subject.kind in (Kind.ROBOT, Kind.LINK, Kind.OBJECT, Kind.WALL):
                function = FUNCTIONS.get(member)
                if function is not None and function.family is Family.WORLD and len(function.params) == 1:
                    return ".".join([f"{member}({body})", *components])
                return f"position({body}).{member}" if member in SPACE and not components else None
        return None

    def _unknown(
        self,
        noun: str,
        name: str,
        choices: Iterable[str],
        node: syntax.Node,
        before: str | None = "",
        also: str | None = None,
    ) -> StopChecking:
        """Return the error DB402 with the nearest of the known names, and a list of them.

        `before` and the name are the text of `node`; with None, no fix is offered. The help `also` is for
        names that are like none of the known.
        """
        names = sorted(choices)
        owned = with_owner(name, names)
        suggestion = owned or suggest_replacement(name, names)
        available = known_names_help(names, "no name can be used here", name)
        listed = "; ".join(filter(None, (available, None if suggestion else also)))
        is_clear = (
            suggestion is not None
            and len(names) > MAX_BESIDE
            and (owned is not None or is_typo(name, suggestion.text))
        )
        question = f"did you mean `{suggestion.text}`?" if suggestion else ""
        help = " ".join(filter(None, (question, "" if is_clear else listed)))
        fix = (
            suggestion._replace(text=f"{before}{suggestion.text}")
            if suggestion and before is not None
            else None
        )
        return self._fault("DB402", node, f"unknown {noun} `{name}`", help, fix)

    # literals

    def _constant(
        self,
        node: syntax.Number | syntax.Vector,
        items: Sequence[syntax.Number],
        components: Components | None,
    ) -> Constant:
        """Return numbers in the unit of `node`, which is written behind the last of them."""
        unit = node.unit
        values = tuple(unit.to_si(item.value) if unit else item.value for item in items)
        if not all(map(math.isfinite, values)):
            raise self._fault("DB401", node, "a quantity too large for a number")
        constant_type = ValueType(unit.dimension if unit else NUMBER, components).with_intervals(
            map(single, values)
        )
        return Constant(constant_type, node.start, node.end, values, unit)

    def _vector(self, node: syntax.Vector) -> TypedNode:
        if isinstance(node.items[-1], syntax.Name):
            self._require_item(node, node.items[-1])
        literals = [item for item in node.items if isinstance(item, syntax.Number)]
        if len(literals) == len(node.items):
            return self._constant(node, literals, _positions(len(literals)))
        items = self.each(self.visit, node.items)
        require_kind(items, self._report)
        for item in items:
            if item.type.components is not None:
                help = "pick a component, as in `v.x`, or use `vector(...)`"
                raise self._fault("DB404", item, "a vector inside a vector", help)
        components = _positions(len(items))
        result = ValueType(
            dimension_of(items, node, self._report), components, known=max(item.type.known for item in items)
        )
        return Vector(
            result.with_intervals(item.type.interval for item in items), node.start, node.end, tuple(items)
        )

    def _stacked_components(self, values: Sequence[TypedNode]) -> Components:
        """Return the components of single values side by side, or those of vectors as rows."""
        vectors = [value for value in values if value.type.components is not None]
        if not vectors:
            return _positions(len(values))
        columns = vectors[0].type.components or ()
        for value in vectors:
            if isinstance(value.type.components, (RowComponents, GroupComponents)):
                raise self._fault("DB404", value, f"{value.type.shape_description} inside a vector")
            if value.type.components != columns or len(vectors) < len(values):
                help = (
                    "pick a component, as in `v.x`; or write vectors of the same components, which become"
                    " rows"
                )
                raise self._fault("DB404", value, "a vector beside other values", help)
        return RowComponents(tuple(str(number) for number in range(1, len(values) + 1)), columns)

    def _require_item(self, node: syntax.Vector, name: syntax.Name) -> None:
        """Require that the name behind the numbers is their last item; otherwise it is a misspelled unit, or
        an operator is missing."""
        name_text = name.dotted
        symbol = self._scope.lookup(name.parts[0]) or self._scope.lookup(name_text)
        if symbol is None:
            raise self._unknown_unit(name)
        if len(node.items) == 2:
            missing = "an operator"
            help = f"to multiply, write `*` before `{name_text}`"
            if symbol.type is not None and symbol.type.boolean:
                missing = "`when`"
                help = f"write `when {name_text}` if it is the condition of a reward"
            raise self._fault("DB401", node, f"{missing} is missing before `{name_text}`", help)

    def _require_unit(self, node: syntax.Binary) -> None:
        """Require that a name right behind a unit, as in `5 rad/sx`, is a value; otherwise it is a misspelled
        unit."""
        if not isinstance(node.left, syntax.Number) or not isinstance(node.right, syntax.Name):
            return
        is_in_unit = node.left.unit is not None and node.right.start == node.left.end + len(node.operator)
        if is_in_unit and node.operator in ("*", "/") and not self._is_name(node.right):
            raise self._unknown_unit(node.right)

    def _is_name(self, node: syntax.Name) -> bool:
        first = node.parts[0]
        return any(
            look(name) for look in (self._scope.lookup, self._scope.subject) for name in (first, node.dotted)
        )

    def _unknown_unit(self, name: syntax.Name) -> StopChecking:
        name_text = name.dotted
        unit = suggest_unit(name_text)
        scaled = prefixed_unit(name_text)
        help = "units are m, mm, cm, s, ms, kg, g, N, rad, deg, Hz, % and their products, as in `N*m/rad`"
        if unit is not None:
            help = f"did you mean `{unit.text}`?"
        elif scaled is not None:
            help = f"write it in {scaled[1]}: 1 {name_text} is {scaled[0]:g} {scaled[1]}"
        return self._fault("DB501", name, f"unknown unit `{name_text}`", help, unit)

    # operators

    def _when(self, node: syntax.Binary, value: TypedNode, condition: TypedNode) -> TypedNode:
        """Return `a when c` as `a if c else 0`."""
        require_kind([value], self._report)
        require_kind([condition], self._report, boolean=True)
        value, condition = both = aligned((value, condition), node, self._report)
        components = components_of(both, node, self._report)
        nothing = Constant(ValueType(interval=single(0.0)), node.end, node.end, (0.0,))
        known = max(value.type.known, condition.type.known)
        result = _ranged(
            ValueType(value.type.dimension, components, known=known),
            lambda interval: hull((interval, single(0.0))),
            (value.type,),
        )
        return Operation(result, node.start, node.end, "where", (condition, value, nothing))

    def _conditional(
        self, node: syntax.Conditional, condition: TypedNode, values: Sequence[TypedNode]
    ) -> TypedNode:
        require_kind([condition], self._report, boolean=True)
        boolean = any(value.type.boolean for value in values)
        require_kind(values, self._report, boolean=boolean)
        dimension = dimension_of(values, node, self._report)
        condition, *values = parts = aligned((condition, *values), node, self._report)
        components = components_of(parts, node, self._report)
        known = max(value.type.known for value in parts)
        result = ValueType(dimension, components, boolean, TRUTH, known)
        if not boolean:
            result = _ranged(result, OPERATORS["where"].interval, [part.type for part in parts])
        return Operation(result, node.start, node.end, "where", (condition, *values))

    def _unary(self, node: syntax.Unary, operand: TypedNode) -> TypedNode:
        require_kind([operand], self._report, boolean=node.operator == "not")
        if node.operator == "not":
            return Operation(operand.type, node.start, node.end, "not", (operand,))
        result = _ranged(operand.type, OPERATORS["neg"].interval, (operand.type,))
        if isinstance(operand, Constant):
            return operand._replace(
                type=result, start=node.start, values=tuple(-value for value in operand.values)
            )
        return Operation(result, node.start, node.end, "neg", (operand,))

    def _binary(self, node: syntax.Binary, left: TypedNode, right: TypedNode) -> TypedNode:
        left, right = both = aligned((left, right), node, self._report)
        components = components_of(both, node, self._report)
        known = max(left.type.known, right.type.known)
        if operator := _ARITHMETIC.get(node.operator):
            require_kind(both, self._report)
            result = ValueType(self._result_dimension(node, left, right), components, known=known)
            self._warn_of_domain(node.operator, left, right, node)
            result = _ranged(result, OPERATORS[operator].interval, (left.type, right.type))
            # A division by zero gives an interval that is not single.
            overflows = result.interval.is_single and not result.interval.is_finite
            if overflows and all(
                value.type.interval.is_finite and value.type.interval.is_single for value in both
            ):
                self._fault("DB406", node, "a result too large for a number")
            return Operation(result, node.start, node.end, operator, both)
        if node.operator not in COMPARISONS:
            require_kind(both, self._report, boolean=True)
        elif not (left.type.boolean and right.type.boolean and node.operator in ("==", "!=")):
            require_kind(both, self._report)
            if dimension_of(both, node, self._report) == ANGLE:
                warn_of_degrees(left, self._report)
                warn_of_degrees(right, self._report)
        truth = ValueType(components=components, boolean=True, interval=TRUTH, known=known)
        return Operation(truth, node.start, node.end, COMPARISONS.get(node.operator, node.operator), both)

    def _result_dimension(self, node: syntax.Binary, left: TypedNode, right: TypedNode) -> Dimension:
        left_dimension, right_dimension = left.type.dimension, right.type.dimension
        match node.operator:
            case "*":
                return left_dimension * right_dimension
            case "/":
                return left_dimension / right_dimension
            case "^":
                require_dimension(right, NUMBER, "the exponent", self._report)
                interval = right.type.interval
                if left_dimension == NUMBER:
                    return NUMBER
                # A quantity takes only exponents that are known and simple.
                if (
                    interval.is_single
                    and right.type.components is None
                    and abs(interval.low) <= _MAX_EXPONENT
                ):
                    exponent = Fraction(interval.low).limit_denominator(_MAX_DENOMINATOR)
                    if float(exponent) == interval.low:
                        return left_dimension ** (exponent if exponent.denominator > 1 else int(exponent))
                help = "divide by a unit first, because only a plain number can have any exponent"
                raise self._fault(
                    "DB503",
                    right,
                    f"the exponent of {left_dimension.description} must be a fixed, simple number",
                    help,
                )
            case _:
                return dimension_of((left, right), node, self._report, is_paid=id(node) in self._reward_sums)

    def _warn_of_domain(self, operator: str, left: TypedNode, right: TypedNode, node: syntax.Binary) -> None:
        """Report DB405 for a divisor that can be zero, DB406 for a root of a value that can be negative."""
        columns = _columns((left.type, right.type))
        b = next((b for _, b in columns if b.is_finite and 0.0 in b), None)
        if operator == "/" and b is not None:
            between = f"the divisor is between {b.low:g} and {b.high:g}, and can be zero"
            self._fault(
                "DB405", node.right, "a division by zero" if b.is_single else between, no_zero_help(right)
            )
        if operator == "^":
            powers = [(a, b) for a, b in columns if a.is_finite]
            low = min((a.low for a, b in powers if b.is_single and not b.low.is_integer()), default=0.0)
            if low < 0.0:
                self._fault(
                    "DB406",
                    node.left,
                    f"a fractional power of a value that can be as low as {low:g}",
                    keep_above_help(0.0),
                )
            if any(0.0 in a and b.high < 0.0 for a, b in powers):
                self._fault(
                    "DB405", node.left, "a negative power of a value that can be zero", no_zero_help(left)
                )

    # calls

    def _call(self, node: syntax.Call) -> TypedNode:
        function = FUNCTIONS.get(node.function)
        called = syntax.Name(node.start, node.name_end, (node.function,))
        if function is None:
            if help := FOREIGN_FUNCTION_HELP.get(node.function):
                raise self._fault("DB402", called, f"unknown function `{node.function}`", help)
            raise self._unknown("function", node.function, FUNCTIONS, called)
        occurrence = None
        if function.family in (Family.STATEFUL, Family.DRAW):
            occurrence = self._occurrences
            self._occurrences += 1
            self.draws += function.family is Family.DRAW
        context = self._scope.context
        is_allowed = function.family in ALLOWED_FAMILIES[context]
        if not is_allowed:
            help = CONTEXT_HELP.get((context, function.family)) or FAMILY_HELP.get(function.family)
            headline = f"`{function.name}` cannot be used in {context.value}"
            if context is Context.FIXED and function.family is Family.DRAW:
                headline = f"this value must be fixed, but `{function.name}` draws a random number"
            self._fault("DB407", called, headline, help)
        subjects, bound = self._arguments(node, function)
        values = tuple(value for _, value in bound)
        if function.components is None and function.name != "vector":
            values = aligned(values, node, self._report)
            bound = [(param, value) for (param, _), value in zip(bound, values, strict=True)]
        result = self._result(node, function, subjects, bound)
        self._check_values(function, bound)
        if not is_allowed:
            raise StopChecking
        if function.name == "vector":
            return Vector(result, node.start, node.end, values)
        return Invocation(result, node.start, node.end, function.name, subjects, values, occurrence)

    def _arguments(
        self, node: syntax.Call, function: Function
    ) -> tuple[tuple[Subject, ...], list[tuple[Param, TypedNode]]]:
        """Return the subjects, and each value with its parameter: both ends of a range have the same."""
        params = function.params
        count = len(node.args)
        fewest = sum(not param.optional for param in params)
        if count < fewest or (count > len(params) and not params[-1].variadic):
            expected = (
                f"at least {fewest}"
                if params[-1].variadic
                else " or ".join(str(n) for n in sorted({fewest, len(params)}))
            )
            noun = "argument" if expected == "1" else "arguments"
            raise self._fault(
                "DB401", node, f"`{function.name}` takes {expected} {noun}, not {count}", usage(function)
            )

        def argument(index: int) -> tuple[list[Subject], list[tuple[Param, TypedNode]]]:
            param = params[min(index, len(params) - 1)]
            arg = node.args[index]
            if param.form is Form.SUBJECT:
                return [self._subject(arg, param.kinds, function.name)], []
            return [], [(param, value) for value in self.each(self.visit, self._parts(param, arg, function))]

        values = self.each(argument, range(count))
        return tuple(subject for subjects, _ in values for subject in subjects), [
            pair for _, pairs in values for pair in pairs
        ]

    def _parts(self, param: Param, arg: syntax.Node, function: Function) -> Sequence[syntax.Node]:
        """Return the values in one argument: one, both ends of a range, or all options."""
        match param.form, arg:
            case Form.VALUE, syntax.Range() | syntax.Spread() | syntax.Options():
                raise self._fault(
                    "DB401", arg, "expected a single value, found a range or a draw", usage(function)
                )
            case Form.VALUE, _:
                return (arg,)
            case (
                (Form.RANGE, syntax.Range())
                | (Form.SPREAD, syntax.Spread())
                | (Form.OPTIONS, syntax.Options())
            ):
                return syntax.children(arg)
        raise self._fault("DB401", arg, f"`{function.name}` needs `{param}` here", usage(function))

    def _result(
        self,
        node: syntax.Call,
        function: Function,
        subjects: tuple[Subject, ...],
        bound: list[tuple[Param, TypedNode]],
    ) -> ValueType:
        """Return the type of the value of a call."""
        values = [value for _, value in bound]
        truths = [value for param, value in bound if param.boolean]
        quantities = [value for param, value in bound if not param.boolean]
        any_truth = function.accepts_truths and any(value.type.boolean for value in quantities)
        require_kind(truths, self._report, boolean=True)
        require_kind(quantities, self._report, boolean=any_truth)
        boolean = function.boolean or any_truth

        for param, value in bound:
            if param.dimension is not None:
                require_dimension(value, param.dimension, f"the argument of `{function.name}`", self._report)
        shared = [value for param, value in bound if param.dimension is None and not param.boolean]
        measured = (
            subjects[0].dimension if subjects and not shared else dimension_of(shared, node, self._report)
        )

        components = self._components(node, function, subjects, bound)
        reduction = function.reduction if len(values) == 1 else None

        known = max((value.type.known for value in values), default=Known.FIXED)
        if function.family is Family.DRAW:
            known = max(known, Known.EPISODE)
        elif function.family is not Family.PURE:
            known = Known.STEP
        result = ValueType(
            NUMBER if boolean else function.result(measured), components, boolean, TRUTH, known
        )
        if boolean:
            return result
        if reduction:
            count = len(values[0].type.components or ()) // len(components or ("",))
            joined_interval = reduction.interval(values[0].type.interval, count)
            if values[0].type.has_group_components:  # there may be none of them
                joined_interval = hull([joined_interval, single(float(reduction.empty or 0.0))])
            return result._replace(interval=joined_interval)
        if function.name == "vector":
            return result.with_intervals(chain.from_iterable(map(_intervals, values)))
        return _ranged(result, function.interval, (*subjects, *(value.type for value in values)))

    def _components(
        self,
        node: syntax.Call,
        function: Function,
        subjects: tuple[Subject, ...],
        bound: list[tuple[Param, TypedNode]],
    ) -> Components | None:
        """Return the components of the result; DB404 where the arguments have others than they must."""
        values = [value for _, value in bound]
        for param, value in bound:
            if param.components and param.components not in (value.type.components, _columns_of(value)):
                raise self._fault(
                    "DB404", value, f"expected a vector of x, y, z, found {value.type.shape_description}"
                )
        if function.components is not None:
            if values and _columns_of(values[0]):
                return values[0].type.components
            members = subjects[0].components
            return RowComponents(members, function.components) if members else function.components
        if function.name == "vector":
            return self._stacked_components(values)
        if function.reduction is not None and len(values) == 1:
            (vector,) = values
            if vector.type.has_group_components and function.reduction.empty is None:
                help = "use `min`, `max`, `sum`, `norm`, `any` or `all`, because a group may be empty"
                raise self._fault("DB404", node, f"`{function.name}` cannot be used on a group", help)
            if vector.type.components is None:
                raise self._fault(
                    "DB404", vector, f"`{function.name}` needs a vector, not a single value", usage(function)
                )
            if isinstance(vector.type.components, RowComponents):
                rows, columns = vector.type.components.rows, vector.type.components.columns
                return rows if function.reduction.of_rows else columns
            return None
        groups = [subject.components for subject in subjects if subject.components is not None]
        if len(groups) > 1:
            raise self._fault(
                "DB404",
                node,
                "only one of the two arguments can be a group",
                "write a single body for the other one",
            )
        return groups[0] if groups else components_of(values, node, self._report)

    def _check_values(self, function: Function, bound: list[tuple[Param, TypedNode]]) -> None:
        """Report DB504 for angles beyond a turn, DB406 for an argument out of the domain, DB105 for a falling
        range or a negative standard deviation."""
        for param, value in bound:
            if param.dimension == ANGLE and function.result(ANGLE) != ANGLE:
                warn_of_degrees(value, self._report)
            interval = value.type.interval
            if interval.is_finite and interval.low < param.domain.low:
                argument = f"the argument of `{function.name}`" if len(bound) == 1 else f"`{param.name}`"
                headline = f"{argument} can be as low as {interval.low:g}"
                self._fault("DB406", value, headline, keep_above_help(param.domain.low))
        values = [value for _, value in bound]
        if ends := [value for param, value in bound if param.form is Form.RANGE]:
            low, high = ends
            with suppress(StopChecking):
                typed = TypedRange(low, high, low.start, high.end)
                _require_rising(typed, self._report)
                if function.name == "integer" and not _contains_whole(low.type.interval, high.type.interval):
                    headline = "a range without a whole number"
                    self._fault("DB105", typed, headline, "write whole numbers as its ends")
        if function.family is Family.DRAW and function.params[0].form is Form.SPREAD:
            deviation = values[1]
            if any(interval.high < 0.0 for interval in _intervals(deviation)):
                self._fault("DB105", deviation, "a standard deviation below 0", "write it without the sign")


def _contains_whole(low: Interval, high: Interval) -> bool:
    """Return whether a whole number can lie between two ends, which rounding may have moved."""
    return math.ceil(low.low - 1e-9) <= high.high + 1e-9


def _columns_of(value: TypedNode) -> Components | None:
    """Return the components of each row; None where there are no rows."""
    components = value.type.components
    return components.columns if isinstance(components, RowComponents) else None


def _intervals(value: TypedNode) -> Sequence[Interval]:
    """Return the interval of each component."""
    return value.type.intervals or (value.type.interval,) * len(value.type.components or ("",))


def _columns(arguments: Sequence[ValueType | Subject]) -> list[tuple[Interval, ...]]:
    """Return the intervals of values for each component; for all at once, if those of single components are
    not known."""
    count = max((len(value.intervals) for value in arguments), default=0) or 1
    return [
        tuple(value.intervals[at] if value.intervals else value.interval for value in arguments)
        for at in range(count)
    ]


def _ranged(
    result: ValueType, rule: Callable[..., Interval], arguments: Sequence[ValueType | Subject]
) -> ValueType:
    """Return the result type with the interval that `rule` makes of the given intervals, for each
    component."""
    return result.with_intervals(rule(*column) for column in _columns(arguments))


def _positions(count: int) -> Components:
    """Return the component names: two numbers are x y, three are x y z; longer lists are numbered from 1."""
    return {len(PLANE): PLANE, len(SPACE): SPACE}.get(count) or tuple(str(n + 1) for n in range(count))
