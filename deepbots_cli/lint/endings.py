"""Rules about when episodes end, the family DB8; `goals` has the one about goals that are out of reach."""

from __future__ import annotations

import math
from collections.abc import Iterator

from deepbots_cli.compiler import Checked
from deepbots_cli.diagnostics import Finding, Label
from deepbots_cli.expressions.intervals import INF, Interval, hull
from deepbots_cli.expressions.scalar import Name, Op, Scalar, World, children
from deepbots_cli.lint.meaning import Book, Comparison, book_of
from deepbots_cli.lint.payments import Payments, payments_of, versions
from deepbots_cli.lint.precedence import forestalled
from deepbots_cli.lint.reach import ALWAYS, NEVER, Reach, Supposing, reach_of
from deepbots_cli.lint.start import AtStart
from deepbots_cli.lint.wording import between
from deepbots_cli.program import Program
from deepbots_cli.program.task import Ending

_CLOCK = frozenset({"time", "step"})
_ENDLESS = (0.0, INF)


def never_true(checked: Checked) -> Iterator[Finding]:
    """DB801: an ending can never hold, whatever happens in an episode.

    The joint has a stop before the limit, the distance cannot be negative, the angle is given in degrees and compared in radians.
    The episodes that it should end run on to the time limit.

    Example::

        termination: {failure: {fallen: abs(cart.pole_angle) > 90 deg}}

    Instead::

        termination: {failure: {fallen: abs(cart.pole_angle) > 15 deg}}
    """
    if checked.program is None:
        return
    silent: set[str] | None = None
    for program in versions(checked):
        found = {ending.value.name for ending in program.endings if _unlimited(book_of(program), ending) == NEVER}
        silent = found if silent is None else silent & found
    for ending in checked.program.endings:
        if ending.value.name in (silent or ()):
            headline = f"`{ending.value.name}` can never hold"
            notes = tuple(_reasons(book_of(checked.program), ending))
            yield Finding("DB801", ending.value.span, headline, help="give a limit that can be met, or take it out", notes=notes)


def _unlimited(book: Book, ending: Ending) -> Interval:
    """Whether an ending holds in an episode that may last for ever; 0 .. 1 where that depends."""
    if ending.value.foreign is not None:
        return Interval(0.0, 1.0)
    return reach_of(book, _ENDLESS).of(book.scalars(ending.value)[0])


def _reasons(book: Book, ending: Ending) -> Iterator[str]:
    """Comparisons that never hold, and where their sides lie; or why they never hold together."""
    reach = reach_of(book, _ENDLESS)
    (node,) = book.scalars(ending.value)
    never = [
        entry
        for entry in book.comparisons(ending.value)
        if all(reach.of(part) == NEVER for part in book.lowered(entry.node, entry.value.owner))
    ]
    for entry in never:
        yield from _where(book, reach, entry)
    touched = (part for part in book.unfold(node) if isinstance(part, World) and part.function in ("contact", "collided"))
    marks = sorted({mark for part in touched for mark in book.marks.intersection(part.subjects)})
    yield from (f"nothing touches `{mark}`, which is not solid" for mark in marks)
    if not never and not marks and isinstance(meaning := book.meaning(node), Op) and meaning.op == "and":
        yield "its parts exclude each other"


def _where(book: Book, reach: Reach, entry: Comparison) -> Iterator[str]:
    for arg in entry.node.args:
        known = hull([reach.of(part) for part in book.lowered(arg, entry.value.owner)])
        text = entry.value.text[arg.start : arg.end]
        if (known.low > -INF or known.high < INF) and not known.single:
            yield f"`{text}` is {between(known, arg.type.dimension)}"


def always_true(checked: Checked) -> Iterator[Finding]:
    """DB802: an ending holds in every step, so that no episode can run.

    Example::

        termination: {failure: {fallen: abs(cart.pole_angle) > -15 deg}}

    Instead::

        termination: {failure: {fallen: abs(cart.pole_angle) > 15 deg}}
    """
    if checked.program is None:
        return
    book = book_of(checked.program)
    for ending in checked.program.endings:
        if _unlimited(book, ending) == ALWAYS:
            headline = f"`{ending.value.name}` holds in every step"
            yield Finding("DB802", ending.value.span, headline, help="give a limit that an episode can keep within")


def shadowed_limit(checked: Checked) -> Iterator[Finding]:
    """DB804: of two limits one always comes first, so the other has no effect.

    `max_time` after `max_steps`, an ending that could hold only after the episode is cut short or after another one has ended it, or
    one that is sure to hold before it is. The CartPole of the original collection ends an episode once its score exceeds 195, so that
    the best one lasts 197 steps of the 200 that are allowed.

    Example::

        termination: {failure: {enough: episode_return > 195}}
        truncation: {max_steps: 200}

    Instead::

        truncation: {max_steps: 200}
    """
    if checked.program is None or checked.namespace is None:
        return
    yield from _two_limits(checked)
    yield from _one_behind_another(checked)
    book = book_of(checked.program)
    payments = payments_of(checked.program)
    for ending in checked.program.endings:
        if ending.value.foreign is not None or _unlimited(book, ending).single:
            continue  # DB801, DB802
        (node,) = book.scalars(ending.value)
        limit = f"an episode is cut short, after {book.last} steps"
        names = _leaves(book, node)
        if _within(payments, (0.0, float(book.last))).of(node) == NEVER:
            headline = f"`{ending.value.name}` cannot hold before {limit}"
            span = checked.namespace.values.key_span(("truncation",))
            help = "raise the limit under `truncation`, or take the ending out"
            yield Finding("DB804", ending.value.span, headline, help=help, also=(Label(span, "cut short here"),))
        elif not names <= _CLOCK and book.last > 1 and _before(payments, book.last - 1).of(node) == ALWAYS:
            headline = f"`{ending.value.name}` is sure to hold before {limit}"
            span = checked.namespace.values.key_span(("truncation",))
            help = "take it out: the limit under `truncation` ends an episode, and `solved` says what a good one is"
            yield Finding("DB804", ending.value.span, headline, help=help, also=(Label(span, "never reached"),))


def _within(payments: Payments, steps: tuple[float, float]) -> Reach:
    """What can be within these steps, the return included."""
    ordinary = payments.total(list(payments.terms), payments.running())
    ticks = steps[1] * payments.program.agent.repeat
    known = Interval(min(0.0, ordinary.low * ticks), max(0.0, ordinary.high * ticks)) if payments.is_whole else Interval()
    return Supposing(payments.book, {"episode_return": known}, steps)


def _before(payments: Payments, step: int) -> Reach:
    """What is in one step, before which the episode has been paid for all steps before."""
    ordinary = payments.total(list(payments.terms), payments.running())
    ticks = float((step - 1) * payments.program.agent.repeat)
    known = Interval(ordinary.low * ticks, ordinary.high * ticks) if payments.is_whole and ordinary.finite else Interval()
    return Supposing(payments.book, {"episode_return": known}, (float(step), float(step)))


def _two_limits(checked: Checked) -> Iterator[Finding]:
    """Of `max_steps` and `max_time` the one that is later in every case and every stage."""
    assert checked.program is not None  # as the caller found
    assert checked.namespace is not None
    later = {_later(program) for program in versions(checked)}
    if len(later) == 1 and (name := later.pop()):
        other = "max_steps" if name == "max_time" else "max_time"
        values = checked.namespace.values
        headline = f"`{name}` comes after `{other}`, which always ends an episode before"
        also = (Label(values.span(("truncation", other)), "comes first"),)
        yield Finding("DB804", values.span(("truncation", name)), headline, help="keep the one that is meant", also=also)


def _one_behind_another(checked: Checked) -> Iterator[Finding]:
    """Endings that come too late in every case and every stage."""
    assert checked.program is not None  # as the caller found
    found = forestalled(checked.program)
    later = [{late.value.name for late in forestalled(program)} for program in versions(checked)] if found else []
    for late, first in found.items():
        if all(late.value.name in names for names in later):
            headline = f"`{late.value.name}` comes after `{first.value.name}`, which always ends an episode before"
            help = "give it a limit that is met first" if late.outcome != first.outcome else "keep the one that is meant"
            yield Finding("DB804", late.value.span, headline, help=help, also=(Label(first.value.span, "comes first"),))


def _later(program: Program) -> str:
    limits, tick = program.truncation, program.world.timestep
    if limits.max_steps is None or limits.max_time is None:
        return ""
    steps, time = limits.max_steps * program.agent.repeat, math.ceil(limits.max_time / tick - 1e-9)
    return "max_time" if time > steps else "max_steps" if steps > time else ""


def _leaves(book: Book, node: Scalar) -> set[str]:
    """The names at the bottom of a value, parameters aside; facts of the world by their function."""
    found: set[str] = set()
    parameters = {value.name for value in book.program.parameters}
    met: set[Scalar] = set()
    waiting = [node]
    while waiting:
        node = book.meaning(waiting.pop())
        match node:
            case Name(name) if name not in parameters:
                found.add(name)
            case World(function):
                found.add(f"{function}()")
            case _ if node not in met:
                met.add(node)
                waiting += children(node)
    return found


def timeout_as_termination(checked: Checked) -> Iterator[Finding]:
    """DB805: an ending that depends on the time alone, which the agent cannot see.

    A time limit is no part of the task: the world would have gone on. Told by `truncation`, the learner estimates what would have
    come; told by an ending, it learns that states are worthless for no reason that it can see. A limit that is part of the task, and
    that the policy sees (`observation: {time: 0 .. 10 s}`), is not meant.

    Example::

        termination: {failure: {late: time > 5 s}}

    Instead::

        truncation: {max_steps: 156}
    """
    if checked.program is None or checked.namespace is None:
        return
    book = book_of(checked.program)
    shown = {name for entry in checked.program.observation for node in book.scalars(entry.value) for name in _leaves(book, node)}
    if shown & _CLOCK:
        return
    reach = reach_of(book)
    for ending in checked.program.endings:
        if ending.value.foreign is not None:
            continue
        (node,) = book.scalars(ending.value)
        names = _leaves(book, node)
        if names and names <= _CLOCK and not reach.of(node).single:
            headline = f"`{ending.value.name}` ends the task by the clock, which the policy does not see"
            kept = " or ".join(f"`{'max_time: 5 s' if name == 'time' else 'max_steps: 200'}`" for name in sorted(names))
            yield Finding("DB805", ending.value.span, headline, help=f"let `truncation` cut the episode short: {kept}")


def ends_at_reset(checked: Checked) -> Iterator[Finding]:
    """DB806: an ending already holds where every episode begins.

    Example::

        reset: {set: {cart.pole_hinge: uniform(20 .. 30 deg)}}

    Instead::

        reset: {set: {cart.pole_hinge: uniform(-1 .. 1 deg)}}
    """
    if checked.program is None:
        return
    book = book_of(checked.program)
    start = AtStart(book)
    for ending in checked.program.endings:
        if ending.value.foreign is None and start.of(book.scalars(ending.value)[0]) == ALWAYS != _unlimited(book, ending):
            headline = f"`{ending.value.name}` already holds when an episode begins"
            notes = tuple(
                f"`{entry.value.text[arg.start : arg.end]}` begins {between(known, arg.type.dimension)}"
                for entry in book.comparisons(ending.value)
                for arg in entry.node.args
                if not (known := hull([start.of(part) for part in book.lowered(arg, entry.value.owner)])).single and known.finite
            )
            help = "let the episode begin clear of it, under `reset`, widen it, or turn its comparison round"
            yield Finding("DB806", ending.value.span, headline, help=help, notes=notes)


RULES = (never_true, always_true, shadowed_limit, timeout_as_termination, ends_at_reset)
