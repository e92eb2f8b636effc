"""Rules about the size of a reward and of its terms, in the family DB7; `progress` has those about its direction."""

from __future__ import annotations

from collections.abc import Iterator
from math import nextafter
from typing import NamedTuple

from deepbots_cli.compiler import Checked
from deepbots_cli.diagnostics import Finding, Label
from deepbots_cli.expressions.intervals import INF, TRUTH, Interval, absolute
from deepbots_cli.expressions.scalar import Name, Op, Scalar, State, walk
from deepbots_cli.expressions.types import Constant, Invocation, Operation, Reference, Typed, children
from deepbots_cli.lint.meaning import Book, book_of
from deepbots_cli.lint.payments import Payments, payments_of, versions
from deepbots_cli.lint.precedence import forestalled
from deepbots_cli.lint.reach import NEVER, Kept, Reach, Supposing, reach_of
from deepbots_cli.lint.thresholds import Threshold, is_clock, thresholds
from deepbots_cli.program.task import Ending
from deepbots_cli.program.values import Expression

_DWARFED = 100.0
"""A term that is so many times what an ending pays makes that invisible."""
_DISCOUNT = 0.99
"""The default of every algorithm."""


# Without bound


class Singular(NamedTuple):
    """What makes a term boundless: an expression in the text of a value."""

    value: Expression
    node: Typed
    is_divisor: bool


def reward_unbounded(checked: Checked) -> Iterator[Finding]:
    """DB701: a term of the reward grows beyond all bounds: it divides by what may be zero, or takes a power of what may be large.

    One step in which a distance is a thousandth is then worth more than all others together, and the value that an agent learns
    follows that step. At zero itself there is no reward at all, and the run stops. Divisors that a `where` or an ending keeps away
    from zero are not meant.

    Example::

        reward: {near: 1 / (abs(x) / m)}

    Instead::

        reward: {near: exp(-abs(x) / 10 cm)}
    """
    if checked.program is None or checked.namespace is None:
        return
    book = book_of(checked.program)
    reach = reach_of(book, (1.0, float(book.last)))
    guarded = _guarded(book, reach)
    for term in checked.program.reward:
        if term.foreign is None and not reach.of(book.scalars(term)[0]).finite:
            found = _singular(term, term.typed, book, reach, guarded, set())
            if found is not None:
                yield _boundless(checked, term, found)


def _guarded(book: Book, reach: Reach) -> set[int]:
    """Quantities that end the episode before they come near zero."""
    endings = [ending.value for ending in book.program.endings]
    asked = [asked for value in endings for entry in book.comparisons(value) for asked in thresholds(entry, book, reach)]
    return {book.identity(entry.quantity) for entry in asked if (entry.bound.high < 0.0 if entry.above else entry.bound.low > 0.0)}


def _singular(value: Expression, node: Typed, book: Book, reach: Reach, guarded: set[int], met: set[str]) -> Singular | None:
    """The first part that is infinite for no other reason than a pole or an exponential; branches of `where` are left alone."""
    if node.type.boolean or all(reach.of(part).finite for part in book.lowered(node, value.owner)):
        return None
    match node:
        case Operation(operator="div", args=(_, below)) if _may_vanish(value, below, book, reach, guarded):
            return Singular(value, below, True)
        case Operation(operator="pow", args=(base, exponent)) if exponent.type.interval.high < 0.0:
            return Singular(value, base, True) if _may_vanish(value, base, book, reach, guarded) else None
        case Invocation(function="log", args=(inner,)) if _may_vanish(value, inner, book, reach, guarded):
            return Singular(value, inner, True)
        case Invocation(function="exp", args=(inner,)):
            grows = any(known.low > -INF and known.high == INF for known in map(reach.of, book.lowered(inner, value.owner)))
            return Singular(value, inner, False) if grows else None
        case Invocation(function="where"):
            return None
        case Reference(symbol=symbol) if (meant := book.named(symbol.name)) is not None and symbol.name not in met:
            met.add(symbol.name)
            on_board = "." in symbol.name
            return None if on_board or meant.foreign else _singular(meant, meant.typed, book, reach, guarded, met)
    found = (_singular(value, part, book, reach, guarded, met) for part in children(node))
    return next((entry for entry in found if entry is not None), None)


def _may_vanish(value: Expression, node: Typed, book: Book, reach: Reach, guarded: set[int]) -> bool:
    """Whether a divisor may be zero; one that is known to lie between two finite ends is DB405."""
    for part in book.lowered(node, value.owner):
        known = reach.of(part)
        inner = {book.identity(entry) for entry in walk(part)}
        if 0.0 in known and not known.finite and not inner & guarded:
            return True
    return False


def _boundless(checked: Checked, term: Expression, found: Singular) -> Finding:
    assert checked.namespace is not None  # as the caller found
    text = checked.namespace.values.text(tuple(found.value.owner.split(".")))
    place = text.part(found.node.start, found.node.end)
    part = text.text[found.node.start : found.node.end]
    also = () if found.value is term else (Label(term.span, f"`{term.name}` is made of it"),)
    if found.is_divisor:
        headline = f"`{term.name}` grows without bound as `{part}` comes near zero"
        return Finding("DB701", place, headline, help="keep it away from zero, as in `max(x, 1 cm)`, or take `exp(-x / 10 cm)`", also=also)
    headline = f"`{term.name}` grows as the exponential of `{part}`, which nothing bounds"
    return Finding("DB701", place, headline, help="keep it below, as in `min(x, 3)`", also=also)


# Too large, too small


def term_dominates(checked: Checked) -> Iterator[Finding]:
    """DB702: over an episode a term adds up to more than a hundred times what any ending pays.

    Whether the agent reaches the goal or fails then makes no difference that it could learn from: the return is that term and noise.
    What counts is the least that the term adds up to in an episode that runs to its limit; a term that is the same in every step,
    such as `alive: 1`, is not meant.

    Example::

        reward: {time: -200 / step, fallen_over: -1 when fallen}

    Instead::

        reward: {time: -1 / 200, fallen_over: -1 when fallen}
    """
    if checked.program is None:
        return
    payments = payments_of(checked.program)
    ordinary, final = payments.split()
    prizes = [absolute(payments.total(final, payments.at(ending))).high for ending in (*checked.program.endings, None)]
    most = max(prizes, default=0.0)
    if not 0.0 < most < INF:
        return
    for term, node in ordinary:
        known = payments.running().of(node)
        largest = max(abs(known.low), abs(known.high)) * payments.book.last * payments.program.agent.repeat
        if known.single or largest <= _DWARFED * most:  # what it adds up to block by block is no more than that
            continue
        least = _least(payments, node)
        if least > _DWARFED * most:
            headline = f"`{term.name}` adds up to {least:.4g} or more over an episode, and the most that an ending pays is {most:.4g}"
            also = tuple(Label(paid.span, "paid at the end") for paid, _ in final)
            yield Finding("DB702", term.span, headline, help=f"scale `{term.name}` down, or let the endings pay more", also=also)


def _least(payments: Payments, node: Scalar) -> float:
    """The least size of the sum over all steps: block by block, since a term may depend on the number of the step."""
    first, last, total = 1, payments.book.last, 0.0
    sign = 0.0
    while first <= last:
        end = min(last, 2 * first - 1)
        known = payments.running((float(first), float(end))).of(node)
        side = 1.0 if known.low > 0.0 else -1.0 if known.high < 0.0 else 0.0
        if side == 0.0 or side == -sign:
            return 0.0
        sign = side
        total += min(abs(known.low), abs(known.high)) * (end - first + 1) * payments.program.agent.repeat
        first = end + 1
    return total


def inactive_term(checked: Checked) -> Iterator[Finding]:
    """DB704: a term of the reward is zero in every step, whatever happens.

    A condition that can never hold, a difference of two figures that never change, a factor of zero. The agent is not paid for
    what the term seems to pay for. A term that is written as 0 is one that someone has turned off, as is a parameter of 0: these
    are not meant.

    Example::

        reward: {alive: 1, upright: 1 when abs(cart.pole_angle) > 90 deg}

    Instead::

        reward: {alive: 1, upright: 1 when abs(cart.pole_angle) < 5 deg}
    """
    if checked.program is None:
        return
    silent: set[str] | None = None
    for program in versions(checked):
        book = book_of(program)
        given = {ending.value.name: Interval(0.0, 1.0) for ending in program.endings}  # one that never holds is DB801
        reach = Supposing(book, given, (1.0, float(book.last)))
        zero = {term.name for term in program.reward if term.foreign is None and reach.of(book.scalars(term)[0]) == NEVER}
        silent = zero if silent is None else silent & zero
    book = book_of(checked.program)
    for term in checked.program.reward:
        if term.name in (silent or ()) and not is_turned_down(term.typed, book):
            headline = f"`{term.name}` is zero in every step"
            yield Finding("DB704", term.span, headline, help="take it out, or mend its condition")


def is_turned_down(node: Typed, book: Book) -> bool:
    """Whether it is a 0, or has a factor that is one: written so, or a parameter of that value."""
    match node:
        case Constant(values=values):
            return not any(values)
        case Reference(symbol=symbol):
            meant = book.named(symbol.name)
            return (symbol.value is not None and not any(symbol.value)) or (meant is not None and is_turned_down(meant.typed, book))
        case Invocation(function="where", args=(_, paid, *_)):
            return is_turned_down(paid, book)
        case Operation(operator="div", args=(above, _)):
            return is_turned_down(above, book)
        case Operation(operator="add" | "sub", args=args):
            return all(is_turned_down(part, book) for part in args)
        case Invocation(args=args) if len(args) > 1:  # the 0 in `min(x, 0)` is no factor
            return any(is_turned_down(part, book) for part in args if not isinstance(part, Constant))
    return any(is_turned_down(part, book) for part in children(node))


# What pays


def rewards_early_death(checked: Checked) -> Iterator[Finding]:
    """DB705: every step costs, nothing is won at the end, and to fail costs less than to go on.

    The best that an agent can do is to fail at once, and that is what it learns first. Let success pay, let each step that goes
    well pay, or let failing cost more than all the steps that are left. In a task with a goal the steps short of the goal count: where
    each of them costs, as with `-1 when not goal_reached`, a failure that ends the episode ends these costs.

    Example::

        reward: {time: -1, crash: -10 when off_track}
        remove: [reward.alive]

    Instead::

        reward: {alive: 1, crash: -10 when off_track}
    """
    if checked.program is None:
        return
    payments = payments_of(checked.program)
    ordinary, final = payments.split()
    running = _short_of_the_goal(payments)
    step = payments.total(ordinary, running)
    if not payments.is_whole or step.high >= 0.0:
        return
    successes = [ending for ending in checked.program.endings if ending.outcome == "success"]
    if any(payments.total(final, payments.at(ending)).high > 0.0 for ending in successes):
        return
    if checked.program.goal is not None:  # no term can name the failure, so whatever may be paid as it happens is its price
        if payments.total(ordinary, payments.running()).high > 0.0:
            return
        final = [*ordinary, *final]
    ahead = step.high * checked.program.agent.repeat * (payments.book.last - 1)
    for ending in checked.program.endings:
        cost = payments.total(final, payments.at(ending)).low
        if ending.outcome == "failure" and cost > ahead:
            dearest = min((term for term in ordinary), key=lambda term: running.of(term[1]).high)[0]
            yield _cheap(dearest, ending, ahead, cost, has_goal=checked.program.goal is not None)
            return


def _short_of_the_goal(payments: Payments) -> Reach:
    """In a step that ends nothing, and, where there is a goal, does not reach it."""
    goal, running = payments.program.goal, payments.running()
    reached = payments.book.meaning(Name("goal_reached"))
    if goal is None or not isinstance(reached, Op):
        return running
    return Kept(running, payments.book.identity(reached.args[0]), Interval(nextafter(goal.within, INF), INF))


def _cheap(dearest: Expression, ending: Ending, ahead: float, cost: float, *, has_goal: bool) -> Finding:
    price = "costs nothing" if cost == 0.0 else f"costs {-cost:.3g}" if cost < 0.0 else f"even pays {cost:.3g}"
    headline = f"an episode that goes on costs {-ahead:.3g} or more, and `{ending.value.name}` {price}"
    help = "let a good step pay instead, such as `alive: 1`, or let failing cost more than all steps together"
    if has_goal:
        headline = f"an episode short of the goal costs {-ahead:.3g} or more, and one that ends by `{ending.value.name}` {price} or less"
        help = f"pay for the goal instead, as `1 when goal_reached` does, or take `{ending.value.name}` out"
    return Finding("DB705", dearest.span, headline, help=help, also=(Label(ending.value.span, "the way out"),))


class Staying(Kept):
    """The same where all that is compared with the tick before stays as it is too."""

    def _state(self, node: State) -> Interval:
        match node.function:
            case "delta" | "rising":
                return NEVER
            case "previous":
                return self.of(node.args[0])
            case _:
                return super()._state(node)


def hovering_pays(checked: Checked) -> Iterator[Finding]:
    """DB708: just outside of the goal every step pays so much that reaching it, which ends that, is worth less.

    The agent learns to stay there. The arm of the original collection earned more at 5 to 10 mm from its target than by touching it.
    Pay for what comes nearer (`-10 * delta(distance) / m`), or pay more for the end than the rest of an episode could.

    Example::

        augment: {left: abs(x - 30 cm)}
        observation: {left: 0 .. 0.8 m}
        reward: {near: 1 when left < 10 cm, there: 5 when arrived}
        termination: {success: {arrived: left < 5 cm}}
        remove: [reward.alive]

    Instead::

        augment: {left: abs(x - 30 cm)}
        observation: {left: 0 .. 0.8 m}
        reward: {nearer: -10 * delta(left) / m, there: 5 when arrived}
        termination: {success: {arrived: left < 5 cm}}
        remove: [reward.alive]
    """
    if checked.program is None:
        return
    payments = payments_of(checked.program)
    ordinary, _ = payments.split()
    successes = [ending for ending in checked.program.endings if ending.outcome == "success"]
    if not payments.is_whole or len(successes) != 1 or not ordinary:
        return
    success, running = successes[0], payments.running()
    possible = (
        reach_of(payments.book, (0.0, float(payments.book.last))).of(payments.book.scalars(success.value)[0])
        if success.value.foreign is None
        else TRUTH
    )
    if possible == NEVER or success in forestalled(checked.program):
        return  # DB801, DB804
    for entry in payments.book.comparisons(success.value):
        for asked in thresholds(entry, payments.book, running):
            quantity, kept = payments.book.identity(asked.quantity), _just_outside(asked)
            if is_clock(payments.book, asked.quantity):
                continue
            pay = payments.total(list(payments.terms), Staying(running, quantity, kept)).low
            if pay <= 0.0:
                continue
            prize = payments.total(list(payments.terms), Staying(payments.at(success), quantity, kept)).high
            if pay * horizon(payments) > prize:
                headline = f"staying just short of `{success.value.name}` pays {pay:.3g} in every step, and reaching it {prize:.3g} once"
                best = max(ordinary, key=lambda term: running.of(term[1]).high)[0]
                help = "pay for coming nearer, as `-10 * delta(distance) / m` does, or let the success pay more than the steps that it ends"
                yield Finding("DB708", best.span, headline, help=help, also=(Label(success.value.span, "ends what pays"),))
                return


def _just_outside(asked: Threshold) -> Interval:
    """Within a fifth of the threshold, on the side where the episode goes on."""
    bound = asked.bound
    return (
        Interval(bound.low - 0.2 * abs(bound.low), bound.low) if asked.above else Interval(bound.high, bound.high + 0.2 * abs(bound.high))
    )


def horizon(payments: Payments) -> float:
    """The ticks that count: half an episode, or as far as the discount of the training lets an agent see."""
    training = payments.program.training
    found = [entry.value for entry in training.hyperparameters if entry.name == "gamma"] if training else []
    gamma = found[0] if found and isinstance(found[0], float) else _DISCOUNT
    seen = INF if gamma >= 1.0 else 1.0 / (1.0 - gamma)
    return min(payments.book.last / 2, seen) * payments.program.agent.repeat


RULES = (reward_unbounded, term_dominates, inactive_term, rewards_early_death, hovering_pays)
