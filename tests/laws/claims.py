"""Laws of static claims: what the analysis states about values, and what lint states about a scenario, is
true in every simulated step."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import NamedTuple

from hypothesis import reject

from deepbots_cli import api
from deepbots_cli.analysis import Analysis
from deepbots_cli.analysis.ranges import Ranges
from deepbots_cli.analysis.speeds import SpeedRanges, rate_of
from deepbots_cli.errors import EvaluationError
from deepbots_cli.expressions.functions import FUNCTIONS
from deepbots_cli.expressions.intervals import Interval
from deepbots_cli.expressions.scalar import Const, Name, Op, Scalar, children, is_drawn, walk
from deepbots_cli.expressions.types import Constant, Invocation, Operation, TypedNode, ValueType
from deepbots_cli.expressions.types import children as typed_children
from deepbots_cli.expressions.types import walk as typed_walk
from deepbots_cli.program import Program, generated
from deepbots_cli.program.values import Expression
from deepbots_cli.runtime import Supervisor
from tests.laws.episodes import actions
from tests.laws.law import Case, law, reference

STEPS = 40
SEEDS = (1, 2)
MAX_PROBES = 150
_ROUNDING = 1e-9
"""The relative difference between a value and the same value computed in another order."""
_OF_THE_END = frozenset({"terminated", "truncated", "ended", "episode_return", "previous_reward"})


def within(value: float, interval: Interval) -> bool:
    """Return whether a value lies in an interval, but for rounding."""
    slack = _ROUNDING * max(1.0, abs(value))
    return interval.low - slack <= value <= interval.high + slack


# Probes


@dataclass(eq=False)
class Probe:
    """A part of an expression whose value the supervisor stores, and the intervals that types state for it."""

    name: str
    text: str
    tree: Scalar
    stated: list[Interval]

    def value(self, world: Supervisor) -> float:
        return float(getattr(world, generated.last(self.name)))


def probes_of(analysis: Analysis) -> list[Probe]:
    """Return a probe for each part of each expression of the supervisor that has a value in every step."""
    program = analysis.program
    hidden = _OF_THE_END | {ending.name for ending in program.endings}
    probes: dict[int, Probe] = {}

    def add(tree: Scalar, text: str, stated: Iterable[Interval] = ()) -> None:
        leaves = {part.name for part in walk(tree) if isinstance(part, Name)}
        if isinstance(tree, Const) or is_drawn(tree) or leaves & hidden or len(probes) >= MAX_PROBES:
            return
        probe = probes.setdefault(analysis.identity(tree), Probe(f"probe{len(probes)}", text, tree, []))
        probe.stated.extend(stated)

    for expression in (*program.signals, *program.endings, *program.agent.reward):
        if expression.foreign is not None:
            continue
        for node in evaluated(expression.typed):
            names = node.type.components or (None,)
            text = f"{expression.owner}: {expression.text[node.start : node.end]}"
            trees = analysis.lowered(node, expression.owner)
            for name, tree in zip(names, trees, strict=False):
                add(tree, text, () if node.type.boolean else (node.type.interval_of(name),))
        for tree in analysis.scalars(expression):
            for part in evaluated_parts(tree):
                add(part, f"in {expression.owner}")
    return list(probes.values())


def evaluated(node: TypedNode) -> Iterator[TypedNode]:
    """Yield the parts of an expression that are computed in every step, whichever branch it takes."""
    yield node
    inner = typed_children(node)
    if isinstance(node, Operation) and node.operator in ("where", "and", "or"):
        inner = inner[:1]
    for part in inner:
        yield from evaluated(part)


def evaluated_parts(tree: Scalar) -> Iterator[Scalar]:
    """Yield the parts of a tree that are computed in every step, whichever branch it takes."""
    yield tree
    inner = children(tree)
    if isinstance(tree, Op) and tree.op in ("where", "and", "or"):
        inner = inner[:1]
    for part in inner:
        yield from evaluated_parts(part)


def with_probes(program: Program, probes: Sequence[Probe]) -> Program:
    """Return the program whose supervisor stores the values of the probes."""
    place = program.agent.observation[0].value.span
    signals = []
    for probe in probes:
        number = Constant(ValueType(), 0, 0, (0.0,))
        owner = f"signals.{probe.name}"
        signals.append(Expression(probe.name, place, probe.text, number, owner, lowered=(probe.tree,)))
    stored = program.stored_signals | {probe.name for probe in probes}
    return replace(program, signals=(*program.signals, *signals), stored_signals=stored)


# Episodes


class Moment(NamedTuple):
    """A reset (step 0) or a step: the values of the probes, the reward terms, the endings, and the ends."""

    step: int
    values: tuple[float, ...]
    terms: Mapping[str, float]
    endings: tuple[str, ...]
    terminated: bool
    truncated: bool

    @property
    def is_last(self) -> bool:
        return self.terminated or self.truncated


def moments(world: Supervisor, probes: Sequence[Probe], seed: int, steps: int = STEPS) -> list[Moment]:
    """Return the moments of an episode with random actions."""
    _, info = world.reset(seed=seed)
    values = tuple(probe.value(world) for probe in probes)
    episode = [Moment(0, values, {}, (), False, False)]
    for number, action in zip(range(1, steps + 1), actions(world, seed), strict=False):
        _, _, terminated, truncated, info = world.step(action)
        values = tuple(probe.value(world) for probe in probes)
        terms = dict(info["reward_terms"])
        episode.append(Moment(number, values, terms, tuple(info["endings"]), terminated, truncated))
        if terminated or truncated:
            break
    return episode


def unsafe_parts(program: Program) -> list[str]:
    """Return the parts of expressions that, by the intervals of their types, may have no value."""
    return [
        expression.text[node.start : node.end]
        for expression in (
            *program.computed_expressions,
            *(value for robot in program.robots for value in (*robot.emit, *robot.receive)),
            *(command.target for robot in program.robots for command in robot.commands),
        )
        for node in typed_walk(expression.typed)
        if may_lack_value(node)
    ]


def intervals_of(node: TypedNode) -> Sequence[Interval]:
    return node.type.intervals or (node.type.interval,)


def may_lack_value(node: TypedNode) -> bool:
    """Return whether a division by zero, an argument out of its domain or an overflow is possible."""
    match node:
        case Operation(operator="div", args=(_, divisor)):
            return any(0.0 in interval for interval in intervals_of(divisor))
        case Operation(operator="pow", args=(base, exponent)):
            low = min(interval.low for interval in intervals_of(base))
            size = max(max(-interval.low, interval.high) for interval in intervals_of(base))
            return low <= 0.0 or size > 1e30 or any(abs(end) > 9.0 for end in exponent.type.interval)
        case Invocation(function="exp", args=(exponent,)):
            return exponent.type.interval.high > 700.0
        case Invocation(function=name, args=args) if len(args) == len(FUNCTIONS[name].params):
            return not all(
                interval.is_within(param.domain)
                for param, arg in zip(FUNCTIONS[name].params, args, strict=True)
                for interval in intervals_of(arg)
            )
    return False


@contextmanager
def with_every_value(program: Program) -> Iterator[None]:
    """Reject a scenario that cannot be played (`reference`).

    A value may be missing only where the intervals of the types allow it.
    """
    with reference("no start was found", "is not stable", "infinite or NaN"):
        try:
            yield
        except EvaluationError as error:
            if "no value for" not in str(error) or not unsafe_parts(program):
                raise
            reject()


# Intervals


@law(cost=120)
def every_value_is_within_its_interval(case: Case) -> None:
    """An interval contains every value that it is stated for: in any step, right after a reset, in a known
    step, and within limits of speed. Rounding is excepted: the analysis folds in another order."""
    compiled = case.compile()
    program = compiled.program
    analysis = Analysis(program)
    probes = probes_of(analysis)
    ranges = [(probe, [*probe.stated, analysis.ranges.of(probe.tree)]) for probe in probes]
    fast = SpeedRanges(analysis, {}, (1.0, float(analysis.last_step)))
    speeds = [rate_of(analysis, probe.tree, exact=True) * analysis.period for probe in probes]
    world = api.build(with_probes(program, probes))
    try:
        for seed in SEEDS:
            with with_every_value(program):
                episode = moments(world, probes, seed)
            for moment in episode:
                for (probe, intervals), value in zip(ranges, moment.values, strict=True):
                    now = in_step(analysis, fast, moment.step)
                    for interval in (*intervals, *(one.of(probe.tree) for one in now)):
                        assert within(value, interval), (probe.text, probe.tree, moment.step, value, interval)
            for before, after in pairwise(episode):
                for probe, first, second, limit in zip(
                    probes, before.values, after.values, speeds, strict=True
                ):
                    change = abs(second - first)
                    assert within(change, Interval(0.0, limit)), (probe.text, after.step, change, limit)
    finally:
        world.close()


def in_step(analysis: Analysis, fast: Ranges, step: int) -> list[Ranges]:
    """Return the ranges that hold in one step; those of most steps are not tried, as they take long."""
    if step == 0:
        return [analysis.start]
    known = [analysis.ranges_in(step, step)] if step in (1, 2, analysis.last_step) else []
    return [fast, *known]
