"""A rule about rewards that lead into failures, in the family DB7."""

from __future__ import annotations

from collections.abc import Iterator

from deepbots_cli.compiler import Checked
from deepbots_cli.diagnostics import Finding, Label
from deepbots_cli.expressions.dimensions import ANGLE, LENGTH
from deepbots_cli.expressions.intervals import Interval
from deepbots_cli.expressions.scalar import Name, Op, Scalar, State, World, children
from deepbots_cli.lint.meaning import Book, Comparison
from deepbots_cli.lint.payments import Payments, payments_of
from deepbots_cli.lint.progress import Slope
from deepbots_cli.lint.reach import Kept
from deepbots_cli.lint.thresholds import Threshold, thresholds
from deepbots_cli.lint.wording import figure
from deepbots_cli.program.task import Ending
from deepbots_cli.program.values import Expression

_EDGE = 0.1
"""What counts as near, as a share of the way from the middle to the failure: near the middle, and near the failure."""
_RATES = frozenset({"velocity", "angular_velocity"})
"""Facts that may be great or small wherever a body is."""


def pays_towards_failure(checked: Checked) -> Iterator[Finding]:
    """DB710: a term pays the more the farther something is off, and too far off is a failure.

    The agent learns to keep at the very edge of failing, or beyond it: most often a sign is missing. It is said of lengths and
    angles that count from a middle (`abs(x)`, `tilt(robot)`, a distance), with a failure above a limit, where the term pays more just
    before that limit than in the middle for certain, and where no other term and no success speaks of the same. To go as fast as is
    allowed is a task of its own, and so is to come near without touching: neither is meant.

    Example::

        reward: {near: abs(x) / m}
        termination: {failure: {off_track: abs(x) > 39 cm}}

    Instead::

        reward: {near: exp(-abs(x) / 20 cm)}
        termination: {failure: {off_track: abs(x) > 39 cm}}
    """
    if checked.program is None or checked.program.goal is not None:
        return
    payments = payments_of(checked.program)
    if not payments.is_whole:
        return
    ordinary, _ = payments.split()
    for ending in checked.program.endings:
        compared = list(payments.book.comparisons(ending.value)) if ending.outcome == "failure" else []
        if len(compared) != 1 or _is_more(payments.book, ending):
            continue
        asked = next(iter(thresholds(compared[0], payments.book, payments.running())), None)
        if asked is None or not _is_deviation(payments, asked):
            continue
        for term in _towards(payments, asked, ordinary):
            headline = f"`{term.name}` pays the more the nearer `{ending.value.name}` comes"
            also = (Label(ending.value.span, "a failure"),)
            yield Finding("DB710", term.span, headline, help=_help(compared[0], asked), also=also)


def _is_more(book: Book, ending: Ending) -> bool:
    """Whether the condition is more than one comparison."""
    meaning = book.meaning(book.scalars(ending.value)[0])
    return not (isinstance(meaning, Op) and meaning.op.startswith(("less", "greater")))


def _is_deviation(payments: Payments, asked: Threshold) -> bool:
    """Whether it counts from a middle, up to a limit, and is where things are now rather than what has come together."""
    known = payments.running().of(asked.quantity)
    is_place = asked.dimension in (LENGTH, ANGLE) and asked.above and known.low == 0.0 < asked.bound.low
    return is_place and not _holds_memory(payments.book, asked.quantity)


def _holds_memory(book: Book, node: Scalar) -> bool:
    node = book.meaning(node)
    return isinstance(node, State) or any(_holds_memory(book, part) for part in children(node))


def _towards(payments: Payments, asked: Threshold, terms: list[tuple[Expression, Scalar]]) -> list[Expression]:
    """The terms that pay for it; none where another term, or a success, speaks of the same things."""
    book, slope = payments.book, Slope(payments.book, payments.running(), asked)
    things = _things(book, asked.quantity)
    wrong = [(term, node) for term, node in terms if slope.of(node) == 1.0 and _is_dearer(payments, asked, node)]
    others = [node for term, node in terms if term not in [found for found, _ in wrong]]
    others += [
        book.scalars(ending.value)[0] for ending in payments.program.endings if ending.outcome == "success" and not ending.value.foreign
    ]
    if any(ending.value.foreign for ending in payments.program.endings) or any(things & _things(book, node) for node in others):
        return []
    return [term for term, _ in wrong]


def _is_dearer(payments: Payments, asked: Threshold, node: Scalar) -> bool:
    """Whether it pays more just before the failure than in the middle, whatever else is so."""
    limit, quantity = asked.bound.low, payments.book.identity(asked.quantity)
    middle = Kept(payments.running(), quantity, Interval(0.0, _EDGE * limit)).of(node)
    edge = Kept(payments.running(), quantity, Interval((1.0 - _EDGE) * limit, limit)).of(node)
    return edge.low > middle.high


def _things(book: Book, node: Scalar) -> set[str]:
    """What a value is made of at the bottom: names that nothing defines, and bodies by where they are."""
    found: set[str] = set()
    for part in book.unfold(node):
        match part:
            case Name(name):
                found.add(name)
            case World(function, subjects) if function not in _RATES:
                found |= {subject.partition(".")[0] for subject in subjects}
    return found


def _help(compared: Comparison, asked: Threshold) -> str:
    side = compared.node.args[0 if compared.node.operator.startswith("greater") else 1]
    quantity = compared.value.text[side.start : side.end]
    assert asked.dimension is not None  # as that of a deviation
    return f"pay for the opposite, as in `exp(-{quantity} / {figure(asked.bound.low / 2, asked.dimension)})`"


RULES = (pays_towards_failure,)
