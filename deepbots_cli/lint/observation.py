"""Rules about what the policy sees, the family DB6."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from functools import reduce
from typing import NamedTuple

from deepbots_cli.compiler import Checked
from deepbots_cli.compiler.namespace import Origin
from deepbots_cli.diagnostics import Edit, Finding, Fix, Label, Span
from deepbots_cli.document.layout import removing
from deepbots_cli.expressions.dimensions import Dimension
from deepbots_cli.expressions.functions import FUNCTIONS, Family
from deepbots_cli.expressions.intervals import Interval
from deepbots_cli.expressions.scalar import Const, Name, Op, Scalar
from deepbots_cli.expressions.scalar import children as parts_of
from deepbots_cli.expressions.types import Invocation, Reference, Typed, children
from deepbots_cli.lint.meaning import Book, book_of
from deepbots_cli.lint.reach import reach_of
from deepbots_cli.lint.wording import between, span_of
from deepbots_cli.program import Program
from deepbots_cli.program.task import Observation
from deepbots_cli.program.values import Expression, Noise

_ROUNDING = 1e-6
"""How far, as a share, a value may be beyond a bound by rounding alone."""
_ROOM = 1.2
"""Suggested ranges go a fifth beyond what they have to hold."""
_SHARE = 0.25
"""How much of the range of a noisy value an exact one shows at least."""


class Seen(NamedTuple):
    """One number of the observation: its entry, what it shows and the bounds of its range in SI units."""

    entry: Observation
    node: Scalar
    low: float
    high: float

    @property
    def dimension(self) -> Dimension:
        return self.entry.value.typed.type.dimension


def numbers_seen(book: Book) -> Iterator[Seen]:
    """Every number of the observation that has a range."""
    for entry in book.program.observation:
        known = entry.value.typed.type
        if not known.picture and not known.boolean:
            for node, low, high in zip(book.scalars(entry.value), entry.low, entry.high, strict=True):
                yield Seen(entry, node, low, high)


def range_span(checked: Checked, entry: Observation) -> Span:
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
    if checked.program is None or checked.namespace is None:
        return
    privileged = _privileged(checked.program)
    for observed in checked.program.observation:
        head = observed.value.name.partition(".")[0]
        if head in privileged:
            origin = checked.namespace.origin(head)
            helps = "move it to `augment`" if origin is Origin.SIGNAL else f"grant it: `augment: [{head}]`"
            what = Origin.SIGNAL.value if origin is Origin.SIGNAL else Origin.PARAMETER.value
            headline = f"the policy sees `{observed.value.name}`, {what} that it is not granted"
            yield Finding("DB609", observed.value.span, headline, help=helps)


def _privileged(program: Program) -> set[str]:
    """Drawn parameters, and signals that are made of them or of the world, without those that `augment` grants."""
    found = {value.name for value in program.parameters} - program.augmented
    for value in program.signals:
        if value.name not in program.augmented and _tells(value.typed, found):
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
        reward: {alive: 1 when goal_reached}
        train: {algorithm: DQN, total_timesteps: 50_000, learning_starts: 1000, replay: her}

    Instead::

        parameters: {mark: uniform(-0.3 .. 0.3 m)}
        goal: {achieved: position(cart).x, desired: mark, within: 5 cm, range: -0.4 .. 0.4 m}
        reward: {alive: 1 when goal_reached}
        train: {algorithm: DQN, total_timesteps: 50_000, learning_starts: 1000, replay: her}
    """
    program = checked.program
    if program is None or program.goal is None or program.training is None or program.training.replay is None:
        return
    book = book_of(program, ideal=True)
    bodies = {thing.name for thing in program.world.objects} | {robot.name for robot in program.world.robots}
    known = bodies | {value.name for value in program.parameters}
    achieved, desired = (_told(book, side) for side in (program.goal.achieved, program.goal.desired))
    ours = (desired - achieved) & known
    for entry in program.observation:
        told = _told(book, entry.value)
        if told & ours:
            headline = f"`{entry.value.name}` tells of the goal, which hindsight replaces in `desired` alone"
            help = "take it out: the policy sees `achieved` and `desired` beside the observation"
            also = (Label(program.goal.desired.span, f"made of `{min(told & ours)}` too"),)
            yield Finding("DB614", entry.value.span, headline, help=help, also=also)


def _told(book: Book, value: Expression) -> set[str]:
    return {name for node in book.scalars(value) for name in book.told(node)}


class Sight(NamedTuple):
    """One number that the policy sees, in the observation or as a goal; `noise` is what this place adds to it."""

    name: str
    span: Span
    node: Scalar
    reach: Interval
    noise: Noise | None


class Linear(NamedTuple):
    """A sum of measurements, each by its identity, with fixed coefficients, and a fixed offset."""

    terms: Mapping[int, float]
    offset: float = 0.0


def noise_without_effect(checked: Checked) -> Iterator[Finding]:
    """DB616: a value has noise, and the policy sees the exact value elsewhere.

    The policy reads the exact value there, in `achieved_goal` for instance, and learns nothing about noise. Two values are the
    same if one is the other times a fixed factor, plus a fixed offset. An exact value whose range covers less than a quarter of the
    noisy one is not meant: it may stand for a sensor of short reach.

    Example::

        parameters: {mark: uniform(-0.3 .. 0.3 m)}
        goal: {achieved: position(cart).x, desired: mark, within: 5 cm, range: -0.4 .. 0.4 m}
        observation: {x: {range: -0.4 .. 0.4 m, noise: 5 mm}}
        reward: {alive: 1 when goal_reached}

    Instead::

        parameters: {mark: uniform(-0.3 .. 0.3 m)}
        augment: {x: {value: position(cart).x, noise: 5 mm}}
        goal: {achieved: x, desired: mark, within: 5 cm, range: -0.4 .. 0.4 m}
        reward: {alive: 1 when goal_reached}
    """
    program = checked.program
    if program is None or not any((*(entry.noise for entry in program.observation), *(value.noise for value in _measured(program)))):
        return
    book = book_of(program)
    seen = [(sight, _noises(book, sight)) for sight in _sights(book)]
    known: dict[int, Linear] = {}
    exact = [(sight, _linear(book, sight.node, known)) for sight, noises in seen if not noises]
    told: set[int] = set()
    for sight, noises in seen:
        shown = next((other for other, form in exact if noises and _shows(other, form, sight, _linear(book, sight.node, known))), None)
        if shown is not None and id(noises[0]) not in told:
            told.add(id(noises[0]))
            headline = f"`{sight.name}` has noise, and the policy sees its exact value in `{shown.name}`"
            help = "give the value its noise once, under `augment`, as `{value: ..., noise: ...}`, and use that name in both places"
            also = (Label(shown.span, "seen exactly"),)
            yield Finding("DB616", noises[0].std.span, headline, help=help, also=also)


def _measured(program: Program) -> tuple[Expression, ...]:
    """What may have noise whatever the policy sees."""
    return (*program.signals, *([program.goal.achieved] if program.goal else []))


def _sights(book: Book) -> Iterator[Sight]:
    """Every number of the observation and of the goal; none that comes by messages which may be late."""
    program = book.program
    routes = [robot.from_route for robot in program.robots]
    late = program.timing == "paper" or any(route.settings for route in routes)
    found = [
        Sight(seen.entry.value.name, seen.entry.value.span, seen.node, Interval(seen.low, seen.high), seen.entry.noise)
        for seen in numbers_seen(book)
    ]
    if program.goal is not None:
        for value in (program.goal.achieved, program.goal.desired):
            nodes = book.scalars(value)
            ranges = zip(nodes, program.goal.low, program.goal.high, strict=False)
            found += [Sight(value.name, value.span, node, Interval(low, high), value.noise) for node, low, high in ranges]
    return (sight for sight in found if not (late and any("." in name for name in book.names_behind(sight.node))))


def _noises(book: Book, sight: Sight) -> list[Noise]:
    """The noise that a number has, its own first."""
    names = [part.name for part in book.unfold(sight.node) if isinstance(part, Name) and book.is_noisy(part.name)]
    measured = [value for name in names if (value := book.named(name)) is not None]
    return [noise for noise in (sight.noise, *(value.noise for value in measured)) if noise is not None]


def _linear(book: Book, node: Scalar, known: dict[int, Linear]) -> Linear:
    """The value without noise; what is no sum of products with fixed factors is one measurement. `known` holds what was asked before."""
    node = book.meaning(node)
    number = book.identity(node)
    if number not in known:
        exact = book.measured(node) if isinstance(node, Name) and book.is_noisy(node.name) else None
        parts = [_linear(book, part, known) for part in ((exact,) if exact is not None else parts_of(node))]
        match node:
            case Name() if exact is not None:
                known[number] = parts[0]
            case Const(value):
                known[number] = Linear({}, float(value))
            case Op("neg"):
                known[number] = _scaled(parts[0], -1.0)
            case Op("add"):
                known[number] = reduce(_sum, parts)
            case Op("sub"):
                known[number] = _sum(parts[0], _scaled(parts[1], -1.0))
            case Op("mul", (Const(factor), _)) | Op("mul", (_, Const(factor))):
                known[number] = _scaled(parts[1] if isinstance(node.args[0], Const) else parts[0], float(factor))
            case Op("div", (_, Const(divisor))) if divisor:
                known[number] = _scaled(parts[0], 1.0 / float(divisor))
            case _:
                known[number] = Linear({number: 1.0})
    return known[number]


def _scaled(value: Linear, factor: float) -> Linear:
    return Linear({term: factor * of for term, of in value.terms.items() if factor * of}, factor * value.offset)


def _sum(one: Linear, other: Linear) -> Linear:
    terms = {term: one.terms.get(term, 0.0) + other.terms.get(term, 0.0) for term in (*one.terms, *other.terms)}
    return Linear({term: of for term, of in terms.items() if of}, one.offset + other.offset)


def _shows(shown: Sight, exact: Linear, sight: Sight, hidden: Linear) -> bool:
    """Whether `shown` is an affine function of what noise hides in `sight`, over a good part of its range."""
    if not hidden.terms or exact.terms.keys() != hidden.terms.keys():
        return False
    factors = [exact.terms[term] / of for term, of in hidden.terms.items()]
    if any(abs(factor - factors[0]) > _ROUNDING * abs(factors[0]) for factor in factors):
        return False
    offset = exact.offset - factors[0] * hidden.offset
    ends = sorted((end - offset) / factors[0] for end in (shown.reach.low, shown.reach.high))
    common = min(ends[1], sight.reach.high) - max(ends[0], sight.reach.low)
    return common >= _SHARE * (sight.reach.high - sight.reach.low)


def observation_unbounded(checked: Checked) -> Iterator[Finding]:
    """DB601: an entry of the observation is not clipped, and nothing is known to bound it.

    A network that was trained on numbers around 1 does anything at all when it meets 1000: a robot that is thrown, a
    collision, a physics engine that blew up for a tick. Clipping costs one comparison.

    Example::

        observation: {speed: {range: -0.8 .. 0.8 m/s, clip: false}}

    Instead::

        observation: {speed: -0.8 .. 0.8 m/s}
    """
    if checked.program is None:
        return
    book = book_of(checked.program)
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
    if checked.program is None:
        return
    book = book_of(checked.program)
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
    noise_without_effect,
    observation_unbounded,
    bounds_mismatch,
    privileged_observation,
    goal_in_observation,
)
