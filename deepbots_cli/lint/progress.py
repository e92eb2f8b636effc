"""Rules about the direction of a reward, in the family DB7: whether it pays for what the endings ask, and for what can be seen."""

from __future__ import annotations

from collections.abc import Iterator

from deepbots_cli.compiler import Checked
from deepbots_cli.diagnostics import Finding, Fix, Label
from deepbots_cli.expressions.intervals import Interval
from deepbots_cli.expressions.scalar import Name, Op, Scalar, State
from deepbots_cli.expressions.unification import negated
from deepbots_cli.lint.meaning import Book, book_of
from deepbots_cli.lint.payments import Payments, payments_of
from deepbots_cli.lint.reach import NEVER, Reach
from deepbots_cli.lint.thresholds import FOLLOWING, Threshold, is_clock, thresholds
from deepbots_cli.program.task import Ending
from deepbots_cli.program.values import Expression
from deepbots_cli.scenario.sensors import SENSORS

_RISING = FOLLOWING | {"delta", "integral", "accumulate", "exp", "log", "sqrt", "clamp"}
"""Functions that rise with their first argument."""
_SHOWN = 60
"""Sensors that may tell of any body."""


def suspicious_sign(checked: Checked) -> Iterator[Finding]:
    """DB703: a reward with the sign of its opposite: failing pays, success costs, or coming nearer to success costs.

    An agent learns what is written. With the reward that the paper prints for its pit, which is the difference of the metric the
    wrong way round, it learns to sit still at the bottom.

    A term is said to pay for the opposite of success where it falls as the quantity goes where the success asks it to, and no other
    term rises with it. Distances between two bodies count as one quantity, however they are measured.

    Example::

        augment: {left: abs(x - 30 cm)}
        observation: {left: 0 .. 0.8 m}
        reward: {nearer: 10 * delta(left) / m}
        termination: {success: {arrived: left < 5 cm}}

    Instead::

        augment: {left: abs(x - 30 cm)}
        observation: {left: 0 .. 0.8 m}
        reward: {nearer: -10 * delta(left) / m}
        termination: {success: {arrived: left < 5 cm}}
    """
    if checked.program is None:
        return
    payments = payments_of(checked.program)
    ordinary, final = payments.split()
    for term, node in final:
        for ending in checked.program.endings:
            paid = payments.at(ending).of(node)
            if _is_for_others_too(payments, node, ending):
                continue
            if paid.low > 0.0 if ending.outcome == "failure" else paid.high < 0.0:
                verb = f"pays {paid.low:.3g}" if paid.low > 0.0 else f"costs {-paid.high:.3g}"
                kind = "a failure" if ending.outcome == "failure" else "a success"
                also = (Label(ending.value.span, f"{kind} here"),)
                yield _turn(term, f"`{ending.value.name}` is {kind}, and {verb}", also)
                break
    successes = [ending for ending in checked.program.endings if ending.outcome == "success"]
    if payments.is_whole and len(successes) == 1:
        yield from _away(payments, ordinary, successes[0])


def _turn(term: Expression, headline: str, also: tuple[Label, ...]) -> Finding:
    turned = negated(term.typed)(term.text)
    fix = Fix.replacing(term.span, term.text, turned, safe=False)
    help = f"turn the sign round: `{turned}`" if len(turned) <= _SHOWN else "turn the sign round"
    return Finding("DB703", term.span, headline, help=help, also=also, fix=fix)


def _is_for_others_too(payments: Payments, node: Scalar, ending: Ending) -> bool:
    """Whether a term is paid at ends of another kind as well, so that its sign says nothing about this one."""
    others = [other for other in payments.program.endings if other.outcome != ending.outcome]
    return any(payments.at(other).of(node) != NEVER for other in (*others, None))


def _away(payments: Payments, ordinary: list[tuple[Expression, Scalar]], ending: Ending) -> Iterator[Finding]:
    """Terms that pay for the opposite of the one thing that a success asks for."""
    compared = list(payments.book.comparisons(ending.value))
    if len(compared) != 1 or _is_joined(payments.book, ending):
        return
    running = payments.running()
    for asked in thresholds(compared[0], payments.book, running):
        if is_clock(payments.book, asked.quantity):
            continue
        slope = Slope(payments.book, running, asked)
        wrong = _going(slope, ordinary, -1.0 if asked.above else 1.0)
        for term in wrong:
            headline = f"`{term.name}` pays less the nearer `{ending.value.name}` comes"
            also = (Label(ending.value.span, "success asks for the opposite"),)
            yield _turn(term, headline, also)
        if wrong:
            return


def _going(slope: Slope, terms: list[tuple[Expression, Scalar]], way: float) -> list[Expression]:
    """The terms with this slope; none if another has the opposite, or one that is not known."""
    found: list[Expression] = []
    for term, node in terms:
        known = slope.of(node)
        if known == way:
            found.append(term)
        elif known != 0.0:
            return []
    return found


def _is_joined(book: Book, ending: Ending) -> bool:
    """Whether the condition is more than one comparison."""
    meaning = book.meaning(book.scalars(ending.value)[0])
    return isinstance(meaning, Op) and meaning.op in ("and", "or")


class Slope:
    """Which way a value goes when the quantity of a threshold grows: 1, -1, 0 where it does not depend on it, None where that is not known.

    Of conditions only whether they depend on it is asked: `where` goes the way of its branches.
    """

    def __init__(self, book: Book, reach: Reach, asked: Threshold) -> None:
        self._book = book
        self._reach = reach
        self._quantity = book.identity(asked.quantity)
        self._pair = book.pair(asked.quantity)
        self._known: dict[Name, float | None] = {}

    def of(self, node: Scalar) -> float | None:
        if self._is_it(node):
            return 1.0
        match node:
            case Name():
                if node not in self._known:
                    meaning = self._book.meaning(node)
                    self._known[node] = 0.0 if isinstance(meaning, Name) else self.of(meaning)
                return self._known[node]
            case State("previous", _):
                return 0.0
            case State(function, args):
                return self.of(args[0]) if function in _RISING else self._none_of(args)
            case Op(op, args):
                return self._op(op, args)
            case _:
                return 0.0

    def _is_it(self, node: Scalar) -> bool:
        if self._book.identity(node) == self._quantity:
            return True
        return self._pair is not None and self._book.pair(node) == self._pair

    def _op(self, op: str, args: tuple[Scalar, ...]) -> float | None:
        match op:
            case "neg":
                return _turned(self.of(args[0]), -1.0)
            case "add" | "min" | "max":
                return _joined([self.of(arg) for arg in args])
            case "sub":
                return _joined([self.of(args[0]), _turned(self.of(args[1]), -1.0)])
            case "where":
                branches = [self.of(arg) for arg in args[1:]]
                found = _joined(branches)
                return found if found or self.of(args[0]) == 0.0 else None
            case "mul":
                return self._product(args[0], args[1])
            case "div":
                return self._quotient(args[0], args[1])
            case "abs":
                return _turned(self.of(args[0]), _side(self._reach.of(args[0])))
            case "pow":
                known, exponent = self._reach.of(args[0]), self._reach.of(args[1])
                side = 1.0 if known.low >= 0.0 and exponent.low > 0.0 else -1.0 if known.low > 0.0 and exponent.high < 0.0 else None
                return _turned(self.of(args[0]), side)
            case _ if op in _RISING:
                return self.of(args[0]) if len(args) == 1 else _joined([self.of(arg) for arg in args])
            case _:
                return self._none_of(args)

    def _product(self, a: Scalar, b: Scalar) -> float | None:
        return _joined([_turned(self.of(a), _side(self._reach.of(b))), _turned(self.of(b), _side(self._reach.of(a)))])

    def _quotient(self, a: Scalar, b: Scalar) -> float | None:
        above = _turned(self.of(a), _side(self._reach.of(b)))
        side = _side(self._reach.of(a))
        return _joined([above, _turned(self.of(b), None if side is None else -side)])

    def _none_of(self, args: tuple[Scalar, ...]) -> float | None:
        return 0.0 if all(self.of(arg) == 0.0 for arg in args) else None


def _side(known: Interval) -> float | None:
    """On which side of 0 values lie."""
    return 1.0 if known.low >= 0.0 else -1.0 if known.high <= 0.0 else None


def _turned(slope: float | None, side: float | None) -> float | None:
    if slope == 0.0:
        return 0.0
    return None if slope is None or side is None else slope * side


def _joined(slopes: list[float | None]) -> float | None:
    """Of a sum: what all that depend on it agree in."""
    found = {slope for slope in slopes if slope != 0.0}
    return 0.0 if not found else found.pop() if len(found) == 1 else None


# What cannot be seen


def hidden_state_reward(checked: Checked) -> Iterator[Finding]:
    """DB706: the reward depends on something that differs between episodes and that nothing in the observation tells of.

    A parameter that is drawn, such as a target or a command, or a body that no entry of the observation speaks of, while no sensor
    that could meet it is seen either. The agent can do no better than to act for the average. Shaping by what only the supervisor
    knows, such as a way around obstacles, is not meant: there the target is seen.

    Example::

        parameters: {aim: uniform(-0.2 .. 0.2 m)}
        reward: {near: -abs(x - aim) / m}

    Instead::

        parameters: {aim: uniform(-0.2 .. 0.2 m)}
        augment: {left: x - aim}
        observation: {left: -0.6 .. 0.6 m}
        reward: {near: -abs(left) / m}
    """
    if checked.program is None:
        return
    book = book_of(checked.program, ideal=True)
    program = checked.program
    seen: set[str] = set()
    for entry in program.observation:
        for node in book.scalars(entry.value):
            seen |= book.told(node)
    if program.goal is not None:
        for value in (program.goal.achieved, program.goal.desired):
            seen |= {found for node in book.scalars(value) for found in book.told(node)}
    feels = any(SENSORS[sensor.kind].perceives for robot in program.robots for sensor in robot.sensors) or any(
        entry.value.typed.type.picture for entry in program.observation
    )
    drawn = {value.name for value in program.parameters}
    walls = set(checked.namespace.walls) if checked.namespace else set()  # their pieces, such as `bay 1`, are in the same place always
    things = {thing.name for thing in program.world.objects if thing.name.partition(" ")[0] not in walls}
    bodies = set() if feels else things | {robot.name for robot in program.world.robots}
    for term in program.reward:
        if term.foreign is None:
            hidden = sorted((book.told(book.scalars(term)[0]) - seen) & (drawn | bodies))
            if hidden:
                what = f"`{hidden[0]}`, {'a parameter that is drawn' if hidden[0] in drawn else 'a body'}"
                help = "let the policy see it: compute what it needs under `augment`"
                yield Finding("DB706", term.span, f"`{term.name}` depends on {what}, and nothing that is seen tells of it", help=help)


RULES = (suspicious_sign, hidden_state_reward)
