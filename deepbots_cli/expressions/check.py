"""Syntax tree to typed tree: names, dimensions, shapes, intervals and stages are settled here.

A part that is wrong becomes None, which every check above it accepts: one fault, one finding.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from fractions import Fraction
from typing import NamedTuple

from deepbots_cli.diagnostics.nearest import Meant, meant
from deepbots_cli.expressions import syntax, unification
from deepbots_cli.expressions.dimensions import ANGLE, NUMBER, TIME, Dimension, Exponent, multiple, suggest_unit
from deepbots_cli.expressions.functions import ALLOWED, FUNCTIONS, OPERATORS, Family, Form, Function, Param
from deepbots_cli.expressions.intervals import INF, TRUTH, Interval, exact, hull
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

_LOGIC = ("and", "or")
_COMPARISONS = {"<": "less", "<=": "less_equal", ">": "greater", ">=": "greater_equal", "==": "equal", "!=": "not_equal"}
_ARITHMETIC = {"+": "add", "-": "sub", "*": "mul", "/": "div", "^": "pow"}
_MAX_EXPONENT = 12
# Roots that physics meets: halves, thirds and quarters. A float stands for one if it is the nearest.
_MAX_DENOMINATOR = 4
_NO_ZERO = "keep it away from zero, as in `max(x, 0.01 m)`"
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
    period = checker.visit(tree.period) if tree.period else None
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


class _Checker:
    """Visits one text; numbers its stateful calls and draws."""

    def __init__(self, scope: Scope, report: Report) -> None:
        self._scope = scope
        self._report = report
        self._occurrences = 0
        self.draws = 0

    def whole(self, tree: syntax.Node) -> Typed | None:
        """A whole text, or one end of a range."""
        if isinstance(tree, syntax.Range):
            self._report("DB401", tree.start, tree.end, "a range where a single value is needed")
            return None
        value = self.visit(tree)
        if value is not None and value.type.copies:
            help = "there may be any number of them: take `min`, `max`, `sum`, `norm`, `any` or `all` of it"
            self._report("DB404", tree.start, tree.end, "a value for each copy of a group", help)
            return None
        if value is not None and size(value) > MAX_SIZE:
            headline = f"an expression of more than {MAX_SIZE} operations on single numbers"
            self._report("DB005", tree.start, tree.end, headline, "name parts of it, as signals or parameters")
            return None
        return value

    def visit(self, node: syntax.Node) -> Typed | None:
        match node:  # the commonest first
            case syntax.Name():
                return self._reference(node)
            case syntax.Number():
                return self._constant(node, (node,), None)
            case syntax.Binary():
                left, right = self.visit(node.left), self.visit(node.right)
                return self._binary(node, left, right) if left and right else None
            case syntax.Call():
                return self._call(node)
            case syntax.Member():
                value = self.visit(node.value)
                return self._pick(value, node.member, node.start, node.end) if value else None
            case syntax.Unary():
                operand = self.visit(node.operand)
                return self._unary(node, operand) if operand else None
            case syntax.When():
                return self._when(node)
            case syntax.Vector():
                return self._vector(node)
            case syntax.Truth():
                return Constant(Type(boolean=True, interval=TRUTH), node.start, node.end, (node.value,))
            case _:
                self._report("DB401", node.start, node.end, "a range or draw where a single value is needed")
                return None

    # names

    def _reference(self, node: syntax.Name) -> Typed | None:
        """The symbol of the longest known part of a dotted name; the rest of it picks components."""
        for length in range(len(node.parts), 0, -1):
            symbol = self._scope.lookup(".".join(node.parts[:length]))
            if symbol is None:
                continue
            if symbol.refused is not None:
                self._report("DB407", node.start, node.end, f"`{symbol.name}` has no value here", symbol.refused)
            if symbol.type is None:
                return None
            value: Typed | None = Reference(symbol.type, node.start, node.end, symbol)
            written = symbol.name
            for member in node.parts[length:]:
                value = value and self._pick(value, member, node.start, node.end, written)
                written = f"{written}.{member}"
            return value
        self._report_no_value(node)
        return None

    def _pick(self, value: Typed, member: str, start: int, end: int, written: str | None = None) -> Typed | None:
        """One component by its name, or several by single letters (`.xy`); `written` is the value's text, where it is a name."""
        components = value.type.components
        if components is None:
            self._report("DB402", start, end, f"`.{member}` of a single value", "only vectors have components")
            return None
        wanted = (member,) if member in components else tuple(member)
        if not set(wanted) <= set(components) or len(set(wanted)) < len(wanted):
            self._report_unknown("component", member, components, start, end, None if written is None else f"{written}.")
            return None
        chosen = value.type._replace(components=None if len(wanted) == 1 else wanted)
        return Pick(chosen, start, end, value, tuple(components.index(name) for name in wanted))

    def _subject(self, node: syntax.Node, kinds: frozenset[Kind], function: str) -> Subject | None:
        """The part of the world that an argument names; DB203 for one of another kind, DB402 for none."""
        wanted = _one_of(kinds)
        if not isinstance(node, syntax.Name):
            headline, help = f"a value where `{function}` needs {wanted}", "name a part of the world, as in `position(cart.tip)`"
            self._report("DB203", node.start, node.end, headline, help)
            return None
        scope, name = self._scope, node.dotted
        subject = scope.subject(name, kinds)
        if subject is not None and (subject.kind is Kind.BROKEN or subject.kind in kinds):
            return None if subject.kind is Kind.BROKEN else subject
        fitting = [known for known in dict.fromkeys(scope.subjects()) if (other := scope.subject(known, kinds)) and other.kind in kinds]
        if subject is not None:
            headline = f"`{name}` is {subject.kind.words}, but `{function}` needs {wanted}"
            self._report("DB203", node.start, node.end, headline, _known(fitting))
        elif (symbol := scope.lookup(name)) is not None:
            if symbol.type is not None or symbol.refused is not None:
                headline = f"`{name}` is a value, but `{function}` needs {wanted}"
                self._report("DB203", node.start, node.end, headline, _known(fitting))
        else:
            self._report_unknown("name", name, fitting, node.start, node.end)
        return None

    def _report_no_value(self, node: syntax.Name) -> None:
        """A name that is no value: a part of the world, a function, or unknown."""
        scope, name = self._scope, node.dotted
        subject = scope.subject(name)
        if subject is not None:
            if subject.kind is not Kind.BROKEN:
                help = f"ask for one of its values, as in `{_ASKED.get(subject.kind, 'position')}({name})`"
                self._report("DB203", node.start, node.end, f"`{name}` is {subject.kind.words}, not a value", help)
        elif name in FUNCTIONS:
            self._report("DB402", node.start, node.end, f"`{name}` is a function", f"call it: `{FUNCTIONS[name].signature}`")
        elif asked := self._asked_of_a_body(node):
            help = f"what is known of the world is asked for by functions: `{asked}`"
            self._report("DB402", node.start, node.end, f"unknown name `{name}`", help, meant=Meant(asked, safe=False))
        else:
            also = _NAMED.get(name.lower(), _ELSEWHERE.get(scope.context))
            self._report_unknown("name", name, scope.names(), node.start, node.end, also=also)

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

    def _report_unknown(
        self, what: str, name: str, known: Iterable[str], start: int, end: int, before: str | None = "", also: str | None = None
    ) -> None:
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

    # literals

    def _constant(
        self, node: syntax.Number | syntax.Vector, items: Sequence[syntax.Number], components: Components | None
    ) -> Constant | None:
        """Numbers in the unit of `node`, which stands behind the last of them."""
        unit = node.unit
        values = tuple(unit.to_si(item.value) if unit else item.value for item in items)
        if not all(map(math.isfinite, values)):
            self._report("DB401", node.start, node.end, "a quantity too large to be kept")
            return None
        known = Type(unit.dimension if unit else NUMBER, components, interval=Interval(min(values), max(values)))
        return Constant(known, node.start, node.end, values, unit)

    def _vector(self, node: syntax.Vector) -> Typed | None:
        last = node.items[-1]
        if isinstance(last, syntax.Name) and self._is_no_item(node, last):
            return None
        components = _positions(len(node.items))
        literals = [item for item in node.items if isinstance(item, syntax.Number)]
        if len(literals) == len(node.items):
            return self._constant(node, literals, components)
        items = [item for item in map(self.visit, node.items) if item is not None]
        if len(items) < len(node.items) or not unification.numbers(items, self._report):
            return None
        nested = next((item for item in items if item.type.components is not None), None)
        if nested is not None:
            self._report("DB404", nested.start, nested.end, *_NESTED)
            return None
        dimension = unification.dimension_of(items, node.start, node.end, self._report)
        if dimension is None:
            return None
        interval, stage = hull([item.type.interval for item in items]), max(item.type.stage for item in items)
        return Vector(Type(dimension, components, interval=interval, stage=stage), node.start, node.end, tuple(items))

    def _is_no_item(self, node: syntax.Vector, name: syntax.Name) -> bool:
        """Whether the name behind the numbers is not their last item; reports the misspelt unit or the missing operator."""
        named = self._scope.lookup(name.parts[0]) or self._scope.lookup(name.dotted)
        if named is not None and len(node.items) > 2:
            return False
        if named is not None:
            self._report_missing(node, name, named)
            return True
        unit, scaled = suggest_unit(name.dotted), multiple(name.dotted)
        help = "units are m, mm, cm, s, ms, kg, g, N, rad, deg, Hz, % and their products, as in `N*m/rad`"
        if unit is not None:
            help = f"did you mean `{unit.text}`?"
        elif scaled is not None:
            help = f"give it in {scaled[1]}: 1 {name.dotted} is {scaled[0]:g} {scaled[1]}"
        self._report("DB501", name.start, name.end, f"unknown unit `{name.dotted}`", help, meant=unit)
        return True

    def _report_missing(self, node: syntax.Vector, name: syntax.Name, named: Symbol) -> None:
        """`when` is missing before a condition, an operator before a number."""
        start, is_condition = node.items[0].start, named.type is not None and named.type.boolean
        headline = f"{'`when`' if is_condition else 'an operator'} is missing before `{name.dotted}`"
        if not is_condition:
            self._report("DB401", start, name.end, headline, f"to multiply, write `*` before `{name.dotted}`")
            return
        help = f"what is paid on a condition is written `5 when {name.dotted}`"
        at = name.start - start  # only a whole text can take it
        fix = (lambda piece: f"{piece[:at]}when {piece[at:]}") if start == 0 else None
        self._report("DB401", start, name.end, headline, help, meant=fix)

    # operators

    def _when(self, node: syntax.When) -> Typed | None:
        """`a when c` is `where(c, a, 0)`."""
        value, condition = self.visit(node.value), self.visit(node.condition)
        if value is None or condition is None:
            return None
        if not (unification.numbers([value], self._report) and unification.truths([condition], self._report)):
            return None
        components = unification.components_of((value, condition), node.start, node.end, self._report)
        if components is None:
            return None
        nothing = Constant(Type(interval=exact(0.0)), node.end, node.end, (0.0,))
        stage = max(value.type.stage, condition.type.stage)
        result = Type(value.type.dimension, components[0], interval=hull((value.type.interval, exact(0.0))), stage=stage)
        return Invocation(result, node.start, node.end, "where", (), (condition, value, nothing))

    def _unary(self, node: syntax.Unary, operand: Typed) -> Typed | None:
        if node.operator == "not":
            fits = unification.truths([operand], self._report)
            return Operation(operand.type, node.start, node.end, "not", (operand,)) if fits else None
        if not unification.numbers([operand], self._report):
            return None
        result = operand.type._replace(interval=OPERATORS["neg"].interval(operand.type.interval))
        if isinstance(operand, Constant):
            return operand._replace(type=result, start=node.start, values=tuple(-value for value in operand.values))
        return Operation(result, node.start, node.end, "neg", (operand,))

    def _binary(self, node: syntax.Binary, left: Typed, right: Typed) -> Typed | None:
        components = unification.components_of((left, right), node.start, node.end, self._report)
        if components is None:
            return None
        stage = max(left.type.stage, right.type.stage)
        truth = Type(components=components[0], boolean=True, interval=TRUTH, stage=stage)
        if node.operator in _LOGIC:
            fits = unification.truths((left, right), self._report)
            return Operation(truth, node.start, node.end, node.operator, (left, right)) if fits else None
        if node.operator in _COMPARISONS:
            operator = _COMPARISONS[node.operator]
            return Operation(truth, node.start, node.end, operator, (left, right)) if self._comparable(node, left, right) else None
        if not unification.numbers((left, right), self._report):
            return None
        operator = _ARITHMETIC[node.operator]
        dimension = self._result_dimension(operator, node, left, right)
        if dimension is None:
            return None
        self._warn_of_domain(operator, left, right)
        interval = OPERATORS[operator].interval(left.type.interval, right.type.interval)
        settled = all(value.type.interval.finite and value.type.interval.single for value in (left, right))
        if settled and interval.single and abs(interval.low) == INF:  # a division by zero gives an interval that is not single
            self._report("DB406", node.start, node.end, "a result too large to be kept")
        return Operation(Type(dimension, components[0], interval=interval, stage=stage), node.start, node.end, operator, (left, right))

    def _comparable(self, node: syntax.Binary, left: Typed, right: Typed) -> bool:
        if left.type.boolean and right.type.boolean and node.operator in ("==", "!="):
            return True
        if not unification.numbers((left, right), self._report):
            return False
        shared = unification.dimension_of((left, right), node.start, node.end, self._report)
        if shared == ANGLE:
            unification.warn_of_degrees(left, self._report)
            unification.warn_of_degrees(right, self._report)
        return shared is not None

    def _result_dimension(self, operator: str, node: syntax.Binary, left: Typed, right: Typed) -> Dimension | None:
        match operator:
            case "mul":
                return left.type.dimension * right.type.dimension
            case "div":
                return left.type.dimension / right.type.dimension
            case "pow":
                plain = unification.has_dimension(right, NUMBER, "the exponent", self._report, alone=False)
                return self._raised(left.type.dimension, right) if plain else None
            case _:
                return unification.dimension_of((left, right), node.start, node.end, self._report)

    def _raised(self, base: Dimension, exponent: Typed) -> Dimension | None:
        """The dimension of a power: a quantity takes only exponents that are known and simple."""
        if base == NUMBER:
            return NUMBER
        known = exponent.type.interval
        fraction = _simple(known.low) if known.single and exponent.type.components is None else None
        if fraction is None:
            headline = f"{base.words} to a power that is not a known, simple number"
            help = "divide by a unit first: only a plain number takes any exponent"
            self._report("DB503", exponent.start, exponent.end, headline, help)
            return None
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
            self._report("DB406", left.start, left.end, headline, "keep it above with `max(x, ...)`")
        if 0.0 in a and b.high < 0.0:
            self._report("DB405", left.start, left.end, "a negative power of a value that can be zero", _NO_ZERO)

    # calls

    def _call(self, node: syntax.Call) -> Typed | None:
        function = FUNCTIONS.get(node.function)
        if function is None:
            if help := _CALLED_ELSEWHERE.get(node.function):
                self._report("DB402", node.start, node.name_end, f"unknown function `{node.function}`", help)
            else:
                self._report_unknown("function", node.function, FUNCTIONS, node.start, node.name_end)
            return None
        occurrence = None
        if function.family in (Family.STATEFUL, Family.DRAW):
            occurrence = self._occurrences
            self._occurrences += 1
            self.draws += function.family is Family.DRAW
        allowed = self._is_allowed(node, function)
        arguments = self._arguments(node, function)
        typed = self._invocation(node, function, *arguments, occurrence) if arguments is not None else None
        return typed if allowed else None

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

    def _arguments(self, node: syntax.Call, function: Function) -> tuple[tuple[Subject, ...], list[tuple[Param, Typed]]] | None:
        """The subjects, and each value with its parameter (both ends of a range have one); None after a finding."""
        params = function.params
        fewest, given = sum(not param.optional for param in params), len(node.args)
        if given < fewest or (given > len(params) and not params[-1].many):
            wanted = f"at least {fewest}" if params[-1].many else " or ".join(str(n) for n in sorted({fewest, len(params)}))
            headline = f"`{function.name}` takes {wanted} {'argument' if wanted == '1' else 'arguments'}, not {given}"
            self._report("DB401", node.start, node.end, headline, _usage(function))
            return None
        subjects: list[Subject] = []
        bound: list[tuple[Param, Typed]] = []
        wrong = False
        for index, arg in enumerate(node.args):
            param = params[min(index, len(params) - 1)]
            if param.form is Form.SUBJECT:
                subject = self._subject(arg, param.kinds, function.name)
                subjects += [subject] if subject else []
                wrong = wrong or subject is None
            else:
                parts = self._parts(param, arg, function)
                values = [self.visit(part) for part in parts or ()]
                bound += [(param, value) for value in values if value is not None]
                wrong = wrong or parts is None or None in values
        return None if wrong else (tuple(subjects), bound)

    def _parts(self, param: Param, arg: syntax.Node, function: Function) -> Sequence[syntax.Node] | None:
        """The values in one argument: one, both ends of a range, or all options."""
        match param.form, arg:
            case Form.VALUE, syntax.Range() | syntax.Spread() | syntax.Options():
                self._report("DB401", arg.start, arg.end, "a range or draw where a single value is needed", _usage(function))
                return None
            case Form.VALUE, _:
                return (arg,)
            case Form.RANGE, syntax.Range(low=low, high=high):
                return (low, high)
            case Form.SPREAD, syntax.Spread(mean=mean, deviation=deviation):
                return (mean, deviation)
            case Form.OPTIONS, syntax.Options(items=items):
                return items
        self._report("DB401", arg.start, arg.end, f"`{function.name}` needs `{param}` here", _usage(function))
        return None

    def _invocation(
        self,
        node: syntax.Call,
        function: Function,
        subjects: tuple[Subject, ...],
        bound: list[tuple[Param, Typed]],
        occurrence: int | None,
    ) -> Typed | None:
        """The typed call: dimension, shape, interval and stage of the result."""
        values = tuple(value for _, value in bound)
        boolean = self._is_boolean(function, bound)
        if boolean is None:
            return None
        shared = self._shared_dimension(node, function, subjects, bound)
        components = self._components(node, function, subjects, bound)
        if shared is None or components is None:
            return None
        interval = TRUTH
        reduced = function.reduction is not None and components[0] is None and values[0].type.components is not None
        if not boolean:
            given = [subject.interval for subject in subjects] + [value.type.interval for value in values]
            count = len(values[0].type.components or ()) if reduced else 0
            interval = function.reduction.interval(given[0], count) if function.reduction and reduced else function.interval(*given)
        if reduced and function.reduction and values[0].type.copies:
            interval = hull([interval, exact(float(function.reduction.empty or 0.0))])
        self._warn(function, bound)
        dimension = NUMBER if boolean else function.result(shared)
        result = Type(dimension, components[0], boolean, interval, _stage(function, values))
        if function.name == "vector":
            return Vector(result, node.start, node.end, values)
        return Invocation(result, node.start, node.end, function.name, subjects, values, occurrence)

    def _is_boolean(self, function: Function, bound: list[tuple[Param, Typed]]) -> bool | None:
        """Whether the result is a truth value; None after DB403."""
        conditions = [value for param, value in bound if param.truth]
        others = [value for param, value in bound if not param.truth]
        truths = function.truths and any(value.type.boolean for value in others)
        fits = unification.truths(conditions, self._report)
        fits = (unification.truths if truths else unification.numbers)(others, self._report) and fits
        return (function.boolean or truths) if fits else None

    def _shared_dimension(
        self, node: syntax.Call, function: Function, subjects: tuple[Subject, ...], bound: list[tuple[Param, Typed]]
    ) -> Dimension | None:
        """The dimension of all arguments that have none of their own."""
        what = f"the argument of `{function.name}`"
        own = [(param.dimension, value) for param, value in bound if param.dimension is not None and not param.truth]
        fits = [unification.has_dimension(value, dimension, what, self._report) for dimension, value in own]
        if not all(fits):
            return None
        shared = [value for param, value in bound if param.dimension is None and not param.truth]
        if not shared and subjects:
            return subjects[0].dimension
        return unification.dimension_of(shared, node.start, node.end, self._report)

    def _components(
        self, node: syntax.Call, function: Function, subjects: tuple[Subject, ...], bound: list[tuple[Param, Typed]]
    ) -> tuple[Components | None] | None:
        """The components of the result in a tuple of one; None after DB404."""
        values = [value for _, value in bound]
        fault: tuple[int, int, str, str | None] | None = None
        first = values[0] if values else None
        if function.components is not None:
            for param, value in bound:
                if param.components and value.type.components != param.components:
                    fault = (value.start, value.end, f"{value.type.shape_words} where a vector of x, y, z is needed", None)
            found: Components | None = function.components
        elif function.name == "vector":
            nested = next((value for value in values if value.type.components is not None), None)
            if nested is not None:
                fault = (nested.start, nested.end, *_NESTED)
            elif len(values) > len(SPACE) or len(values) < len(PLANE):
                help = "`vector` takes two (x, y) or three (x, y, z)"
                fault = (node.start, node.end, f"a vector of {len(values)} values", help)
            found = PLANE if len(values) == len(PLANE) else SPACE
        elif function.reduction is not None and first is not None and len(values) == 1:
            if first.type.copies and function.reduction.empty is None:
                help = "there may be none of them: take `min`, `max`, `sum`, `norm`, `any` or `all`"
                fault = (node.start, node.end, f"a {function.name} over the copies of a group", help)
            elif first.type.components is None:
                fault = (first.start, first.end, f"a single value where `{function.name}` needs a vector", _usage(function))
            found = None
        else:
            groups = [subject.components for subject in subjects if subject.components is not None]
            if len(groups) <= 1:
                return (groups[0],) if groups else unification.components_of(values, node.start, node.end, self._report)
            fault, found = (node.start, node.end, "a group on both sides", "name a single one on one side"), None
        if fault is not None:
            self._report("DB404", *fault)
            return None
        return (found,)

    def _warn(self, function: Function, bound: list[tuple[Param, Typed]]) -> None:
        """DB504 for angles beyond a turn, DB406 for an argument out of the domain, DB105 for a draw from a falling range."""
        values = [value for _, value in bound]
        for param, value in bound:
            if param.dimension == ANGLE and function.result(ANGLE) != ANGLE:
                unification.warn_of_degrees(value, self._report)
        interval = values[0].type.interval if values else TRUTH
        if interval.finite and interval.low < function.domain.low:
            headline = f"the argument of `{function.name}` can be as low as {interval.low:g}"
            self._report("DB406", values[0].start, values[0].end, headline, "keep it above with `max(x, ...)`")
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
