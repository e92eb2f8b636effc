"""Rules about what the policy sees, the family DB6."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

from deepbots_cli.compiler import Checked
from deepbots_cli.compiler.namespace import Origin
from deepbots_cli.diagnostics import Edit, Finding, Fix, Label, Span
from deepbots_cli.lang.dimensions import Dimension
from deepbots_cli.lang.functions import Family
from deepbots_cli.lang.intervals import Interval
from deepbots_cli.lang.scalar import Scalar
from deepbots_cli.lang.table import FUNCTIONS
from deepbots_cli.lang.typed import Invocation, Reference, Typed, children
from deepbots_cli.rules.meaning import Book, book_of
from deepbots_cli.rules.reach import reach_of
from deepbots_cli.rules.wording import between, span_of
from deepbots_cli.source.removal import removing
from deepbots_cli.task import ObservedValue, Task, Valued

_ROUNDING = 1e-6
"""How far, as a share, a value may be beyond a bound by rounding alone."""
_ROOM = 1.2
"""Suggested ranges go a fifth beyond what they have to hold."""


class Seen(NamedTuple):
    """One number of the observation: its entry, what it shows and the bounds of its range in SI units."""

    entry: ObservedValue
    node: Scalar
    low: float
    high: float

    @property
    def dimension(self) -> Dimension:
        return self.entry.value.typed.type.dimension


def numbers_seen(book: Book) -> Iterator[Seen]:
    """Every number of the observation that has a range."""
    for entry in book.task.observation:
        known = entry.value.typed.type
        if not known.picture and not known.boolean:
            for node, low, high in zip(book.scalars(entry.value), entry.low, entry.high, strict=True):
                yield Seen(entry, node, low, high)


def range_span(checked: Checked, entry: ObservedValue) -> Span:
    assert checked.namespace is not None  # there is a task
    return checked.namespace.values.span(("observation", entry.value.name, "range"))


def another_range(checked: Checked, seen: Seen, wide: Interval, dimension: Dimension) -> Fix | None:
    """`wide` in the place of the range; None where the components have ranges of their own."""
    is_one = len({*zip(seen.entry.low, seen.entry.high, strict=True)}) == 1
    return Fix((Edit(range_span(checked, seen.entry), span_of(wide, dimension)),), safe=False) if is_one else None


def privileged_observation(checked: Checked) -> Iterator[Finding]:
    """DB609: the policy is shown a signal or a parameter that `augment` does not grant, and that is not made of what arrives anyway.

    The supervisor alone knows the world and what was drawn: on a real robot nothing would measure them. Granting them says
    that this is meant. What robots send, when it came, what the agent did and the time need no grant.

    Example::

        signals: {height: position(cart.tip).z}
        observation: {height: 0 .. 2 m}

    Instead::

        augment: {height: position(cart.tip).z}
        observation: {height: 0 .. 2 m}
    """
    if checked.task is None or checked.namespace is None:
        return
    privileged = _privileged(checked.task)
    for observed in checked.task.observation:
        head = observed.value.name.partition(".")[0]
        if head in privileged:
            origin = checked.namespace.origin(head)
            helps = "move it to `augment`" if origin is Origin.SIGNAL else f"grant it: `augment: [{head}]`"
            what = Origin.SIGNAL.value if origin is Origin.SIGNAL else Origin.PARAMETER.value
            headline = f"the policy sees `{observed.value.name}`, {what} that it is not granted"
            yield Finding("DB609", observed.value.span, headline, help=helps)


def _privileged(task: Task) -> set[str]:
    """Drawn parameters, and signals that are made of them or of the world, without those that `augment` grants."""
    found = {value.name for value in task.parameters} - task.augmented
    for value in task.order:
        if value.name not in task.augmented and _tells(value.typed, found):
            found.add(value.name)
    return found


def _tells(value: Typed, privileged: set[str]) -> bool:
    if isinstance(value, Reference):
        return value.symbol.name in privileged
    if isinstance(value, Invocation) and FUNCTIONS[value.function].family is Family.WORLD:
        return True
    return any(_tells(part, privileged) for part in children(value))


def goal_in_observation(checked: Checked) -> Iterator[Finding]:
    """DB614: with hindsight replay, an entry of the observation is made of where the agent shall get.

    Hindsight stores each step once more, as if another goal had been desired. It replaces `desired`, which the policy sees anyway,
    and recomputes the reward. What an entry of `observation` says of the goal stays, so that the agent learns from steps in which it
    sees two goals at once.

    Example::

        parameters: {mark: uniform(-0.3 .. 0.3 m)}
        goal: {achieved: position(cart).x, desired: mark, within: 5 cm, range: -0.4 .. 0.4 m}
        augment: {left: mark - x}
        observation: {left: -0.8 .. 0.8 m}
        reward: {alive: -1 when not goal_reached}
        train: {algorithm: DQN, total_timesteps: 50_000, learning_starts: 1000, replay: her}

    Instead::

        parameters: {mark: uniform(-0.3 .. 0.3 m)}
        goal: {achieved: position(cart).x, desired: mark, within: 5 cm, range: -0.4 .. 0.4 m}
        reward: {alive: -1 when not goal_reached}
        train: {algorithm: DQN, total_timesteps: 50_000, learning_starts: 1000, replay: her}
    """
    task = checked.task
    if task is None or task.goal is None or task.training is None or task.training.replay is None:
        return
    book = book_of(task, ideal=True)
    bodies = {thing.name for thing in task.world.objects} | {robot.name for robot in task.world.robots}
    known = bodies | {value.name for value in task.parameters}
    achieved, desired = (_told(book, side) for side in (task.goal.achieved, task.goal.desired))
    ours = (desired - achieved) & known
    for entry in task.observation:
        told = _told(book, entry.value)
        if told & ours:
            headline = f"`{entry.value.name}` tells of the goal, which hindsight replaces in `desired` alone"
            help = "take it out: the policy sees `achieved` and `desired` beside the observation"
            also = (Label(task.goal.desired.span, f"made of `{min(told & ours)}` too"),)
            yield Finding("DB614", entry.value.span, headline, help=help, also=also)


def _told(book: Book, value: Valued) -> set[str]:
    return {name for node in book.scalars(value) for name in book.told(node)}


def observation_unbounded(checked: Checked) -> Iterator[Finding]:
    """DB601: an entry of the observation is not clipped, and nothing is known to bound it.

    A network that was trained on numbers around 1 does anything at all when it meets 1000: a robot that is thrown, a
    collision, a physics engine that blew up for a tick. Clipping costs one comparison.

    Example::

        observation: {speed: {range: -0.8 .. 0.8 m/s, clip: false}}

    Instead::

        observation: {speed: -0.8 .. 0.8 m/s}
    """
    if checked.task is None:
        return
    book = book_of(checked.task)
    reach = reach_of(book)
    for entry in {
        id(seen.entry): seen.entry for seen in numbers_seen(book) if not seen.entry.clip and not reach.of(seen.node).finite
    }.values():
        headline = f"`{entry.value.name}` is not clipped, and nothing bounds it"
        assert checked.namespace is not None  # there is a task
        fix = removing(checked.namespace.values.root, ("observation", entry.value.name, "clip"))
        help = "take `clip: false` out, or `clamp` the value under `augment`"
        yield Finding("DB601", range_span(checked, entry), headline, help=help, fix=fix)


def bounds_mismatch(checked: Checked) -> Iterator[Finding]:
    """DB602: a value can never lie in the range that the observation gives it.

    It is clipped to one end of the range in every step, so the policy sees a constant. Most often the range is in another
    unit, has lost a sign, or is that of another value.

    Example::

        observation: {cart.pole_angle: 80 .. 100 deg}

    Instead::

        observation: {cart.pole_angle: -20 .. 20 deg}
    """
    if checked.task is None:
        return
    book = book_of(checked.task)
    reach = reach_of(book)
    for seen in once(seen for seen in numbers_seen(book) if seen.entry.clip):
        known = reach.of(seen.node)
        if known.low >= seen.high or known.high <= seen.low:
            headline = f"`{seen.entry.value.name}` is {between(known, seen.dimension)}, and never within its range"
            is_known = known.finite and not known.single
            help = "give the range that it has" + (f": `{span_of(known, seen.dimension)}`" if is_known else "")
            fix = another_range(checked, seen, known, seen.dimension) if is_known else None
            yield Finding("DB602", range_span(checked, seen.entry), headline, help=help, fix=fix)


def once(found: Iterator[Seen]) -> Iterator[Seen]:
    """The first component of each entry, and the others only if they differ from it in their bounds."""
    met = set()
    for seen in found:
        key = (id(seen.entry), seen.low, seen.high)
        if key not in met:
            met.add(key)
            yield seen


RULES = (
    observation_unbounded,
    bounds_mismatch,
    privileged_observation,
    goal_in_observation,
)
