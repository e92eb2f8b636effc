"""DB411: measures that are asked to be a figure exactly."""

from __future__ import annotations

from collections.abc import Iterator

from deepbots_cli.compiler import Checked
from deepbots_cli.diagnostics import Finding
from deepbots_cli.expressions.scalar import Op, Scalar, World
from deepbots_cli.expressions.types import Constant, Operation, Stage, Typed, children
from deepbots_cli.lint.meaning import Book, book_of
from deepbots_cli.program import Program
from deepbots_cli.program.values import Expression

_MEASURED = frozenset({"position", "velocity", "angular_velocity", "orientation", "joint_position", "joint_velocity", "beside", "along"})
_SMOOTH = frozenset({"add", "sub", "mul", "div", "neg", "abs", "hypot", "sqrt", "pow", "sin", "cos", "tan", "atan2", "exp", "log"})
"""What leaves a measure one; `clamp`, `min` and `where` give figures that can be met."""


def equality_of_measures(checked: Checked) -> Iterator[Finding]:
    """DB411: a condition asks a measure to be equal to a figure.

    A distance, an angle or a speed is a number of sixteen digits, new in every tick. It passes 20 cm without ever being 20 cm, so that
    `==` never holds, or holds by chance alone, and `!=` holds at the slightest change. What is counted, chosen or clamped can be equal to
    a figure, and so can the place of what never moves: these are not meant.

    Example::

        reward: {alive: 1, there: 5 when x == 20 cm}

    Instead::

        reward: {alive: 1, there: 5 when abs(x - 20 cm) < 1 cm}
    """
    if checked.program is None or checked.namespace is None:
        return
    book = book_of(checked.program, ideal=True)
    for value in judged(checked.program):
        for node in _compared(value.typed):
            pairs = [pair for pair in (node.args, node.args[::-1]) if _is_met_by_chance(book, value, *pair)]
            if pairs:
                text = checked.namespace.values.text(tuple(value.owner.split(".")))
                measure, figure, written = (text.text[part.start : part.end] for part in (*pairs[0], node))
                outcome, sign = ("holds by chance alone", "<") if node.operator == "equal" else ("holds at the slightest change", ">")
                is_zero = isinstance(pairs[0][1], Constant) and not any(pairs[0][1].values)
                apart = measure if is_zero else f"{measure} - {figure}"
                help = f"ask how near it is, as `abs({apart}) {sign} ...` does"
                yield Finding("DB411", text.part(node.start, node.end), f"`{written}` {outcome}", help=help)


def judged(program: Program) -> Iterator[Expression]:
    """What the supervisor computes in a step, as it is written."""
    yield from (value for value in (*program.signals, *program.reward) if value.foreign is None)
    yield from (ending.value for ending in program.endings if ending.value.foreign is None)


def _compared(node: Typed) -> Iterator[Operation]:
    if isinstance(node, Operation) and node.operator in ("equal", "not_equal") and not node.args[0].type.boolean:
        yield node
    for part in children(node):
        yield from _compared(part)


def _is_met_by_chance(book: Book, value: Expression, measure: Typed, figure: Typed) -> bool:
    settled = figure.type.stage is not Stage.STEP
    return settled and all(_is_measure(book, part) for part in book.lowered(measure, value.owner))


def _is_measure(book: Book, node: Scalar, known: dict[int, bool] | None = None) -> bool:
    """`known` is what was asked before, so that what names stand for is looked at once."""
    known = {} if known is None else known
    number = book.identity(node)
    if number not in known:
        known[number] = _measures(book, node, known)
    return known[number]


def _measures(book: Book, node: Scalar, known: dict[int, bool]) -> bool:
    still = {thing.name for thing in book.program.world.objects if thing.fixed}
    match book.meaning(node):
        case World(function, subjects):
            return function in _MEASURED and still.isdisjoint(subject.partition("#")[0] for subject in subjects)
        case Op(op, args):
            return op in _SMOOTH and any(_is_measure(book, arg, known) for arg in args)
        case _:
            return False


RULES = (equality_of_measures,)
