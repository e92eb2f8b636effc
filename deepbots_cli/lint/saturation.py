"""Rules about values of the observation that come to the end of their range, in the family DB6."""

from __future__ import annotations

from collections.abc import Iterator
from math import isnan, nan
from typing import NamedTuple

from deepbots_cli import footprint, frames
from deepbots_cli.compiler import Checked
from deepbots_cli.compiler.robots import held
from deepbots_cli.diagnostics import Finding, Label
from deepbots_cli.expressions.dimensions import ACCELERATION
from deepbots_cli.expressions.intervals import Interval, exact
from deepbots_cli.expressions.scalar import Draw, Name, Scalar, World, children
from deepbots_cli.lint.meaning import Book, Comparison, book_of
from deepbots_cli.lint.observation import Seen, another_range, numbers_seen, once, range_span
from deepbots_cli.lint.precedence import forestalled
from deepbots_cli.lint.reach import Kept, Reach, reach_of
from deepbots_cli.lint.start import AtStart
from deepbots_cli.lint.thresholds import Threshold, thresholds
from deepbots_cli.lint.wording import between, figure, span_of
from deepbots_cli.program.values import Expression

_ROUNDING = 1e-6
"""How far, as a share, a value may be beyond a bound by rounding alone."""
_ROOM = 1.2
"""Suggested ranges go a fifth beyond what they have to hold."""
_NEAR = 0.05
"""Before a limit, as a share of the way to it: where a policy must see it come."""
_HALVINGS = 40


def saturates_before_termination(checked: Checked) -> Iterator[Finding]:
    """DB603: a value leaves its range in the observation before it ends the episode: the agent cannot see the failure coming.

    Between the end of the range and the limit every value looks the same to the policy, just where it would have to act. The
    CartPole of the original collection clips the angle of the pole at 0.23 rad and ends at 0.2618 rad. What is made of the value
    counts as well, such as a share of it that is clamped; one entry that goes on changing up to the limit is enough.

    Example::

        observation: {cart.pole_angle: -0.23 .. 0.23 rad}
        termination: {failure: {fallen: abs(cart.pole_angle) > 15 deg}}

    Instead::

        observation: {cart.pole_angle: -20 .. 20 deg}
        termination: {failure: {fallen: abs(cart.pole_angle) > 15 deg}}
    """
    if checked.program is None or checked.namespace is None:
        return
    book = book_of(checked.program, ideal=True)
    reach = reach_of(book)
    shown = [(seen, _made_of(book, seen.node)) for seen in numbers_seen(book)]
    met = set()
    for ending in checked.program.endings:
        is_meant = ending.outcome == "failure" and ending not in forestalled(checked.program)
        for comparison in book.comparisons(ending.value) if is_meant else ():
            asked = [threshold for threshold in thresholds(comparison, book, reach) if _can_be_met(threshold, reach)]
            for sight in _blind(shown, asked, reach):
                if (id(sight.seen.entry), ending.value.name) not in met:
                    met.add((id(sight.seen.entry), ending.value.name))
                    yield _unseen(checked, book, sight, ending.value, comparison)


class Sight(NamedTuple):
    """A number of the observation, and the value of a threshold's quantity from which on it tells nothing; NaN if it does to the end."""

    seen: Seen
    threshold: Threshold
    edge: float

    @property
    def is_blind(self) -> bool:
        return not isnan(self.edge)


def _made_of(book: Book, node: Scalar) -> set[int]:
    """The identities of all that a value is made of, itself among them."""
    found: set[int] = set()
    waiting = [node]
    while waiting:
        node = waiting.pop()
        if book.identity(node) not in found:
            found.add(book.identity(node))
            waiting += children(book.meaning(node))
    return found


def _can_be_met(threshold: Threshold, reach: Reach) -> bool:
    known = reach.of(threshold.quantity)
    return known.high > threshold.limit if threshold.above else known.low < threshold.limit


def _blind(shown: list[tuple[Seen, set[int]]], asked: list[Threshold], reach: Reach) -> Iterator[Sight]:
    """For each threshold of a comparison that nothing tells of, the first number that should."""
    sights: list[tuple[int, list[Sight]]] = []
    for threshold in asked:
        quantity = reach.book.identity(threshold.quantity)
        sights.append((quantity, [Sight(seen, threshold, _edge(seen, threshold, reach)) for seen, parts in shown if quantity in parts]))
    for quantity, found in sights:
        # `abs(x) > 1 m` asks something of `x` as well: whoever sees that needs not see `abs(x)`, and the other way round.
        others = [sight for other, there in sights if other != quantity for sight in there]
        if found and all(sight.is_blind for sight in (*found, *others)):
            yield found[0]


def _edge(seen: Seen, threshold: Threshold, reach: Reach) -> float:
    """The end of its range for the quantity itself; for what is made of it, where it stops changing."""
    book, bound = reach.book, threshold.bound
    known, quantity = reach.of(threshold.quantity), book.identity(threshold.quantity)
    slack = _ROUNDING * max(abs(bound.low), abs(bound.high))
    limit = threshold.limit
    if not seen.entry.clip:
        return nan
    if quantity == book.identity(seen.node):
        edge = seen.high if threshold.above else seen.low
        is_within = known.low < seen.high and known.high > seen.low  # or else DB602
        return edge if is_within and (edge < limit - slack if threshold.above else edge > limit + slack) else nan

    def is_level(start: float) -> bool:
        kept = Interval(min(start, limit), max(start, limit))
        shown = Kept(reach, quantity, kept).of(seen.node)
        return min(max(shown.low, seen.low), seen.high) == min(max(shown.high, seen.low), seen.high)

    safe = -1.0 if threshold.above else 1.0
    far = 0.0 if safe * limit < 0.0 else limit + safe * (abs(limit) or 1.0)
    far = min(max(far, known.low), known.high)
    near = limit + _NEAR * (far - limit)
    if not is_level(near) or is_level(far):
        return nan
    for _ in range(_HALVINGS):
        half = (near + far) / 2.0
        near, far = (half, far) if is_level(half) else (near, half)
    return near


def _unseen(checked: Checked, book: Book, sight: Sight, ending: Expression, comparison: Comparison) -> Finding:
    assert checked.namespace is not None  # as the caller found
    seen, name = sight.seen, sight.seen.entry.value.name
    help, fix = "let it go on beyond the limit: widen its range, or what it is clamped to", None
    if book.identity(seen.node) == book.identity(sight.threshold.quantity):
        headline = f"`{name}` is seen no further than {figure(sight.edge, seen.dimension)}, and the episode fails"
        headline += f" at {figure(sight.threshold.limit, seen.dimension)}"
        wide = _wide(seen, sight.threshold)
        help = f"let its range go beyond the limit, as `{span_of(wide, seen.dimension)}` does"
        fix = another_range(checked, seen, wide, seen.dimension)
    elif (dimension := sight.threshold.dimension) is not None:
        headline = f"`{name}` stays the same from {figure(sight.edge, dimension)} on, and the episode fails"
        headline += f" at {figure(sight.threshold.limit, dimension)}"
    else:
        headline = f"`{name}` stays the same for some way before `{ending.name}` ends the episode"
    place = ending.span
    if comparison.value.owner:
        text = checked.namespace.values.text(tuple(comparison.value.owner.split(".")))
        place = text.part(comparison.node.start, comparison.node.end)
    also = (Label(place, f"`{ending.name}` ends it here"),)
    return Finding("DB603", range_span(checked, seen.entry), headline, help=help, also=also, fix=fix)


def _wide(seen: Seen, threshold: Threshold) -> Interval:
    """A range that goes beyond a limit, on both sides if it is even."""
    beyond = threshold.limit + (_ROOM - 1.0) * abs(threshold.limit) * (1.0 if threshold.above else -1.0)
    other = -beyond if seen.low == -seen.high else beyond
    return Interval(min(seen.low, beyond, other), max(seen.high, beyond, other))


def observation_saturates(checked: Checked) -> Iterator[Finding]:
    """DB611: a value is at the end of its range in ordinary operation: an accelerometer at rest, or a start beyond the range.

    An accelerometer at rest reads the acceleration of gravity, upwards. Where its range ends below that, its axis shows the
    end of the range as long as the robot stands, and says nothing. The same is true of what begins beyond its range.

    Example::

        robots: {cart: {sensors: {accel: {type: accelerometer, link: body}}, emit: [pole_angle, accel]}}
        observation: {cart.accel: -5 .. 5 m/s^2}

    Instead::

        robots: {cart: {sensors: {accel: {type: accelerometer, link: body}}, emit: [pole_angle, accel]}}
        observation: {cart.accel: -15 .. 15 m/s^2}
    """
    if checked.program is None:
        return
    book = book_of(checked.program)
    start, reach = AtStart(book), reach_of(book)
    for seen in once(seen for seen in numbers_seen(book) if seen.entry.clip):
        first = start.of(seen.node)
        known = reach.of(seen.node)
        if known.low >= seen.high or known.high <= seen.low:
            continue  # DB602
        slack = _ROUNDING * (seen.high - seen.low)
        is_beyond = first.low > seen.high + slack or first.high < seen.low - slack
        fact = book.meaning(seen.node)
        drawn = start.standing(fact) if isinstance(fact, World) else None
        if drawn is not None and drawn.finite:  # what is drawn itself, no hull around it
            is_beyond = drawn.high > seen.high + slack or drawn.low < seen.low - slack
        if is_beyond:
            headline = f"`{seen.entry.value.name}` begins beyond its range: it is {between(first, seen.dimension)}"
            yield Finding("DB611", range_span(checked, seen.entry), headline, help="widen its range, or let the episode begin within it")
    yield from _goal(checked, book, start)
    yield from _gravity(checked, book)


def _goal(checked: Checked, book: Book, start: AtStart) -> Iterator[Finding]:
    """Goals that are drawn from more than their range: the policy, reward and endings know what is left of them within."""
    goal = book.program.goal
    if goal is None:
        return
    for node, low, high in zip(book.scalars(goal.desired), goal.low, goal.high, strict=True):
        meant = book.meaning(node)
        drawn = start.of(meant) if isinstance(meant, Draw) else start.standing(meant) if isinstance(meant, World) else None
        slack = _ROUNDING * (high - low)
        if drawn is not None and drawn.finite and (drawn.low < low - slack or drawn.high > high + slack):
            assert checked.namespace is not None  # there is a task
            dimension = goal.desired.typed.type.dimension
            headline = f"`desired` begins beyond its range: it is {between(drawn, dimension)}"
            yield Finding("DB611", checked.namespace.values.span(("goal", "range")), headline, help="widen it, or draw from less")
            return


def _gravity(checked: Checked, book: Book) -> Iterator[Finding]:
    met = set()
    for seen in numbers_seen(book):
        leaf = book.meaning(seen.node)
        reading = _at_rest(book, leaf)
        if reading is None or not seen.entry.clip or id(seen.entry) in met or seen.low <= reading <= seen.high:
            continue
        met.add(id(seen.entry))
        axis = leaf.component if isinstance(leaf, Name) else ""
        size = abs(reading) * _ROOM
        wide = Interval(min(seen.low, -size), max(seen.high, size))
        headline = f"`{seen.entry.value.name}` ends at {figure(seen.high if reading > 0 else seen.low, ACCELERATION)}"
        headline += f", and at rest its {axis} is {figure(reading, ACCELERATION)}"
        help = f"let its range hold gravity, as `{span_of(wide, ACCELERATION)}` does"
        fix = another_range(checked, seen, wide, ACCELERATION)
        yield Finding("DB611", range_span(checked, seen.entry), headline, help=help, fix=fix)


def _at_rest(book: Book, leaf: Scalar) -> float | None:
    """What an axis of an accelerometer reads of a robot that stands as it was built, m/s^2; None where that is not known."""
    found = book.sensor(leaf)
    if found is None or found[1].kind != "accelerometer" or not isinstance(leaf, Name):
        return None
    robot, sensor = found
    model = next(body.model for body in book.program.world.robots if body.name == robot)
    if held(model, sensor.subjects[0])[0] != model.root or not _stands(book, robot):
        return None
    link = footprint.link_frames(model)[sensor.subjects[0]]
    turn = frames.inside(link, frames.frame(sensor.mount))[1]
    gravity = book.program.world.gravity
    up = frames.rotate_back(turn, (-gravity[0], -gravity[1], -gravity[2]))
    return up["xyz".index(leaf.component or "x")]


def _stands(book: Book, robot: str) -> bool:
    """Whether a robot begins neither rolled nor pitched."""
    start = AtStart(book)
    body = next(body for body in book.program.world.robots if body.name == robot)
    leaning = (World("orientation", (f"{robot}.{body.model.root}",), axis) for axis in "xy")
    return all(start.of(part) == exact(0.0) or start.of(part) == Interval(-1.0, 1.0) for part in leaning)


RULES = (saturates_before_termination, observation_saturates)
