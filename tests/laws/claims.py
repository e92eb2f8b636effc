"""Laws of static claims: what the analysis states about values, and what lint states about a scenario, is
true in every simulated step."""

from __future__ import annotations

import copy
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

from hypothesis import reject
from hypothesis import strategies as st

from deepbots_cli import api
from deepbots_cli.analysis import Analysis
from deepbots_cli.analysis.ranges import Ranges, return_range
from deepbots_cli.diagnostics import Finding, edited
from deepbots_cli.errors import EndsAtResetError, EvaluationError
from deepbots_cli.expressions.functions import FUNCTIONS
from deepbots_cli.expressions.intervals import INF, Interval, multiply
from deepbots_cli.expressions.scalar import Const, EngineRead, Name, Op, Scalar, children, is_drawn, walk
from deepbots_cli.expressions.types import Constant, Invocation, Operation, TypedNode, ValueType
from deepbots_cli.expressions.types import children as typed_children
from deepbots_cli.expressions.types import walk as typed_walk
from deepbots_cli.lint import all_findings
from deepbots_cli.program import Program, generated
from deepbots_cli.program.values import Expression
from deepbots_cli.runtime import Supervisor
from tests.laws.episodes import actions, played
from tests.laws.expressions import chance, pick
from tests.laws.law import Case, law, reference, same
from tests.laws.scenarios import ALONE

STEPS = 40
SEEDS = (1, 2)
MAX_PROBES = 150
_ROUNDING = 1e-6
"""A relative difference that rounding causes: PyBullet's quaternions have a length of 1 within 1e-7."""
_OF_THE_END = frozenset({"terminated", "truncated", "ended", "episode_return", "previous_reward"})


def within(value: float, interval: Interval) -> bool:
    """Return whether a value lies in an interval, but for rounding."""
    slack = _ROUNDING * max(1.0, abs(value)) if abs(value) < INF else 0.0
    return interval.low - slack <= value <= interval.high + slack


def reads(reading: str, analysis: Analysis, tree: Scalar) -> bool:
    """Return whether a value depends on a reading of joints.

    The limit of a `joint_velocity` is that of the motor, which a load exceeds: `left_knee` of the biped,
    driven at 0.56 rad/s, reaches 0.81 rad/s. The type of a `joint_position` has the limits of the joint, from
    which `auto` makes the range of an observation; the range of the analysis goes beyond them.
    """
    for part in analysis.ideal.walk_definitions(tree):
        sensor = analysis.sensor(part)
        if isinstance(part, EngineRead) and part.function == reading:
            return True
        if sensor is not None and sensor[1].kind == reading:
            return True
        # A sensor on board may be anywhere in what a robot sends.
        if isinstance(part, Name) and ":" in part.name and sensor is None:
            return True
    return False


# Probes


@dataclass(eq=False)
class Probe:
    """A part of an expression whose value the supervisor stores, and the intervals that types state for
    it."""

    name: str
    text: str
    tree: Scalar
    stated: list[Interval]

    def value(self, world: Supervisor) -> float:
        return float(getattr(world, generated.last(self.name)))


def probes_of(analysis: Analysis) -> list[Probe]:
    """Return a probe for each part of each expression of the supervisor that has a value in every step."""
    program = analysis.program
    hidden = {*_OF_THE_END, "achieved", "desired", "goal_reached"} | {
        ending.name for ending in program.endings
    }
    probes: dict[int, Probe] = {}

    def add(tree: Scalar, text: str, stated: Iterable[Interval] = ()) -> None:
        leaves = {part.name for part in walk(tree) if isinstance(part, Name)}
        if isinstance(tree, Const) or is_drawn(tree) or leaves & hidden or len(probes) >= MAX_PROBES:
            return
        probe = probes.setdefault(analysis.identity(tree), Probe(f"probe{len(probes)}", text, tree, []))
        probe.stated.extend(stated)

    for body in program.world.robots:
        for joint in body.model.moving_joints:
            add(EngineRead("joint_velocity", (f"{body.name}.{joint.name}",)), joint.name)
        for axis in "xyz":
            root = (f"{body.name}.{body.model.root}",)
            add(EngineRead("position", root, axis), body.name)
            add(EngineRead("velocity", root, axis), body.name)
    for expression in (*program.signals, *program.endings, *program.agent.reward):
        if expression.foreign is not None:
            continue
        for node in evaluated(expression.typed, typed_children):
            names = node.type.components or (None,)
            text = f"{expression.owner}: {expression.text[node.start : node.end]}"
            trees = analysis.lowered(node, expression.owner)
            for name, tree in zip(names, trees, strict=False):
                add(tree, text, () if node.type.boolean else (node.type.interval_of(name),))
        for tree in analysis.scalars(expression):
            for part in evaluated(tree, children):
                add(part, f"in {expression.owner}")
    return list(probes.values())


def evaluated(node: Any, inner_of: Callable[[Any], Sequence[Any]]) -> Iterator[Any]:
    """Yield the parts of an expression, or of a tree, that are computed in every step, whichever branch it
    takes."""
    yield node
    inner = inner_of(node)
    if getattr(node, "operator", getattr(node, "op", None)) in ("where", "and", "or"):
        inner = inner[:1]
    for part in inner:
        yield from evaluated(part, inner_of)


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
    """A reset (step 0) or a step: the values of the probes, the reward terms, the endings, and the ends, with
    what the step takes and shows."""

    step: int
    values: tuple[float, ...]
    terms: Mapping[str, float]
    endings: tuple[str, ...]
    terminated: bool
    truncated: bool
    action: Any
    observation: Any
    reward: float
    info: Mapping[str, Any]

    @property
    def is_last(self) -> bool:
        return self.terminated or self.truncated


def moments(
    world: Supervisor,
    probes: Sequence[Probe],
    seed: int,
    steps: int = STEPS,
    after_step: Callable[[], object] = lambda: None,
) -> list[Moment]:
    """Return the moments of an episode with random actions."""
    shown: Any = world.reset(seed=seed)
    values = tuple(probe.value(world) for probe in probes)
    episode = [Moment(0, values, {}, (), False, False, None, shown[0], 0.0, shown[1])]
    for number, action in zip(range(1, steps + 1), actions(world, seed), strict=False):
        observation, reward, *ends, info = world.step(action)
        after_step()
        values = tuple(probe.value(world) for probe in probes)
        made = (dict(info["reward_terms"]), tuple(info["endings"]), *ends)
        episode.append(Moment(number, values, *made, action, observation, float(reward), info))
        if episode[-1].is_last:
            break
    return episode


def unsafe_parts(program: Program) -> list[str]:
    """Return the parts of expressions that, by the intervals of their types, may have no value."""
    members = program.others.world.members if program.others else program.members
    programs = [program, *(member.program for member in members.values())]
    return [
        expression.text[node.start : node.end]
        for expression in (
            *(value for one in programs for value in one.computed_expressions),
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
    with reference("no start was found", "is not stable", "infinite or NaN", "is not finite"):
        try:
            yield
        except EvaluationError as error:
            if "no value for" not in str(error) or not unsafe_parts(program):
                raise
            reject()


# Intervals


@law(cost=170, profile=ALONE)
def every_value_is_within_its_interval(case: Case) -> None:
    """An interval contains every value that it is stated for: in any step, right after a reset, in a known
    step, and within limits of speed. Rounding is excepted: the analysis folds in another order. Positions of
    joints are excepted in episodes in which one is too fast for its limits (`BeyondLimits`)."""
    program = case.compile().program
    analysis = Analysis(program)
    probes = probes_of(analysis)
    probes = [
        probe
        for probe in probes
        if not is_direction_of_zero(analysis, probe.tree)
        and not reads("joint_velocity", analysis, probe.tree)
    ]
    ranges = [(probe, [analysis.ranges.of(probe.tree)]) for probe in probes]
    for probe, intervals in ranges:
        if not reads("joint_position", analysis, probe.tree):
            intervals += probe.stated
    of_joints = {probe for probe in probes if reads("joint_position", analysis, probe.tree)}
    with closing(api.build(with_probes(program, probes))) as world:
        beyond = BeyondLimits(world, analysis)
        for seed in SEEDS:
            beyond.are_reached = False
            with with_every_value(program):
                episode = moments(world, probes, seed, after_step=beyond.update)
            excepted = of_joints if beyond.are_reached else ()
            for moment in episode:
                for (probe, intervals), value in zip(ranges, moment.values, strict=True):
                    if probe in excepted:
                        continue
                    now = in_step(analysis, moment.step)
                    for interval in (*intervals, *(one.of(probe.tree) for one in now)):
                        assert within(value, interval), (probe.text, probe.tree, moment.step, value, interval)


class BeyondLimits:
    """Whether a joint passed a limit by more than the analysis states, at a speed that takes it there in one
    engine step: a limit acts only on a joint that has passed it.

    A Panda that lies in the ground, in PyBullet: `panda_joint3` went from -0.02 to -4.39 rad at 219 rad/s.
    """

    def __init__(self, world: Supervisor, analysis: Analysis) -> None:
        self.are_reached = False
        self._joints = []
        self._step = analysis.program.world.timestep / analysis.program.world.substeps
        for body in analysis.program.world.robots:
            for joint in body.model.moving_joints:
                stated = analysis.ranges.of(EngineRead("joint_position", (f"{body.name}.{joint.name}",)))
                read = world.engine.joint_states(body.name, (joint.name,))
                self._joints.append((read, stated, joint.ends(INF)))
        world.engine.before_substep(self.update)

    def update(self) -> None:
        """Check the joints after an engine step: before the next one, or after the last of a step."""
        for read, stated, (low, high) in self._joints:
            position, velocity = read()[0][:2]
            beyond, reach = (
                (low - position, low - stated.low)
                if position < low
                else (position - high, stated.high - high)
            )
            self.are_reached |= reach < beyond and reach < abs(velocity) * self._step


def is_direction_of_zero(analysis: Analysis, tree: Scalar) -> bool:
    """Return whether a value depends on the direction of a vector that may be 0, or point straight back: that
    depends on the sign of a zero, which no interval has."""
    return any(
        isinstance(part, Op)
        and part.op == "atan2"
        and 0.0 in (ranges.of(part.args[0]).low, ranges.of(part.args[1]).low)
        and not is_size(part.args[1])
        for part in analysis.walk_definitions(tree)
        for ranges in (analysis.ranges, analysis.start)
    )


def is_size(tree: Scalar) -> bool:
    """Return whether a value is a length, whose zero has no sign."""
    return isinstance(tree, Op) and tree.op in ("hypot", "abs", "sqrt")


def in_step(analysis: Analysis, step: int) -> list[Ranges]:
    """Return the ranges that hold in one step; those of most steps are not tried, as they take long."""
    if step == 0:
        return [analysis.start]
    return [analysis.ranges_in(step, step)] if step in (1, 2, analysis.last_step) else []


# Rewards and observations


@law(cost=200, profile=ALONE)
def every_reward_is_within_its_bounds(case: Case) -> None:
    """The analysis states what each term pays in a step that ends nothing, at each ending and at the time
    limit, and what a whole episode pays. A rule says what is always zero, and what no episode changes."""
    compiled = case.compile()
    program = compiled.program
    analysis = Analysis(program)
    reward = analysis.reward
    terms = [(term, tree) for term, tree in reward.terms if not reads("joint_velocity", analysis, tree)]
    is_whole = len(terms) == len(program.agent.reward)
    findings = api.lint(case.path, preview=True)
    always_zero = {
        term.name
        for term, _ in reward.terms
        for finding in findings
        if finding.code == "DB704" and finding.span == term.span
    }
    totals = []
    with case.environment(compiled) as world:
        for seed in SEEDS:
            with with_every_value(program):
                episode = moments(world, (), seed)
            for moment in episode[1:]:
                for term, tree in terms:
                    paid = moment.terms[term.name]
                    where = (term.name, moment, paid)
                    assert paid == 0.0 or term.name not in always_zero, where
                    for ranges in ranges_at(analysis, moment):
                        paid_in_timestep = ranges.of(tree)
                        paid_in_step = multiply(paid_in_timestep, Interval(1.0, program.action_repeat))
                        assert within(paid, paid_in_step), (*where, paid_in_step)
            if episode[-1].is_last:
                totals.append(sum(sum(moment.terms.values()) for moment in episode))
    for total in totals if is_whole else ():
        assert within(total, return_range(analysis.reward)), (total, return_range(analysis.reward))
    place = program.agent.reward[0].span
    if any(finding.code == "DB711" and finding.span == place for finding in findings):
        assert all(within(total, Interval(totals[0], totals[0])) for total in totals), totals


def ranges_at(analysis: Analysis, moment: Moment) -> list[Ranges]:
    """Return the ranges of what a step pays, by how the episode goes on."""
    reward = analysis.reward
    every = analysis.ranges_in(1.0, float(analysis.last_step))
    if not moment.is_last:
        return [every, reward.ranges_while_running()]
    if not moment.terminated:
        return [every, reward.ranges_at(None)]
    if len(moment.endings) == 1 and not moment.truncated:
        ending = next(one for one in analysis.program.endings if one.name == moment.endings[0])
        return [every, reward.ranges_at(ending)]
    return [every]


# Findings


@law(cost=150, profile=replace(ALONE, agents=1))
def an_ending_comes_as_lint_says(case: Case) -> None:
    """An ending that lint calls impossible, or too late, never comes; one that is always true, or true when
    an episode begins, lets no episode begin; one that comes before another always does."""
    checked = api.load(case.write(with_bold_endings(case), "bold.yaml"))
    findings = all_findings(checked, preview=True)
    program = checked.program
    if program is None or any(one.severity == "error" and one.code not in AT_RESET for one in findings):
        reject()
    analysis = Analysis(program)
    if any(reads("joint_velocity", analysis, analysis.scalars(ending)[0]) for ending in program.endings):
        reject()
    about = {ending.name: [one for one in findings if one.span == ending.span] for ending in program.endings}
    with closing(api.build(program)) as world:
        for seed in SEEDS:
            if any(one.code in AT_RESET for marks in about.values() for one in marks):
                with with_every_value(program):
                    assert ends_at_reset(world, seed), (seed, about)
                continue
            with with_every_value(program), reference_of_start():
                episode = moments(world, (), seed)
            for moment in episode[1:]:
                for name, marks in about.items():
                    require_truth(name, marks, moment)


def ends_at_reset(world: Supervisor, seed: int) -> bool:
    try:
        world.reset(seed=seed)
    except EndsAtResetError:
        return True
    return False


AT_RESET = ("DB802", "DB806")
"""The findings of an ending that is true when an episode begins."""


def require_truth(ending: str, findings: Sequence[Finding], moment: Moment) -> None:
    """Require what findings say about an ending to be true in a moment."""
    for finding in findings:
        holds = ending in moment.endings
        if finding.code in ("DB801", "DB807") or "cannot become true" in finding.headline:
            assert not holds, (finding.headline, moment)
        elif finding.code == "DB804" and "has no effect" in finding.headline:
            first = finding.headline.split("`")[3]
            assert first in moment.endings or not holds, (finding.headline, moment)
        elif finding.code == "DB804":
            assert not moment.truncated, (finding.headline, moment)


@contextmanager
def reference_of_start() -> Iterator[None]:
    """Reject a scenario with an ending that some starts meet, of which only a simulation knows."""
    try:
        yield
    except EndsAtResetError:
        reject()


def with_bold_endings(case: Case) -> dict[str, Any]:
    """Return the scenario with endings that may be true at once, always, or behind one another."""
    data = copy.deepcopy(case.drawn.data)
    termination = data.setdefault("termination", {})
    for endings in termination.values():
        for name, text in endings.items():
            if chance(case.draw, 40):
                endings[name] = text.removeprefix("time > 50 ms and ")
    robot = next(iter(data["robots"]))
    quantities = [
        (f"position({robot}).z", "m"),
        (f"abs(position({robot}).x)", "m"),
        (f"tilt({robot})", "rad"),
        ("episode_return", ""),
        ("time", "s"),
        ("step", ""),
    ]
    for number in range(case.draw(st.integers(1, 3))):
        quantity, unit = pick(case.draw, quantities)
        sign = pick(case.draw, (">", "<", ">=", "<="))
        limit = pick(case.draw, (0, 0.1, -0.1, 0.2, 0.5, 1, 4, 20, -3))
        word = pick(case.draw, ("failure", "success"))
        termination.setdefault(word, {})[f"bold{number}"] = f"{quantity} {sign} {limit} {unit}".strip()
    return data


@law(cost=230, profile=ALONE)
def what_is_unused_changes_nothing(case: Case) -> None:
    """Without a definition that nothing uses (DB205), each episode is the same, and the fix removes it."""
    compiled = case.compile()
    shorter = case.write(case.drawn.text, "shorter.yaml")
    removed = []
    for _ in range(case.draw(st.integers(1, 3))):
        before = api.lint(shorter)
        if any(one.severity == "error" for one in before):  # of values, which `compile` does not judge
            reject()
        findings = [one for one in before if one.code == "DB205" and one.fix is not None]
        # Without an action, the action space is another one.
        findings = [one for one in findings if "an action variable" not in one.headline]
        if not findings:
            break
        finding = findings[case.draw(st.integers(0, len(findings) - 1))]
        removed.append(finding.headline)
        shorter.write_text(edited(finding.span.source, finding.fix.edits), encoding="utf-8")
        after = api.lint(shorter)
        assert all(one.severity == "warning" for one in after), (removed, after)
    if not removed:
        reject()
    with case.environment(compiled) as long, case.environment(case.compile(shorter)) as short:
        with reference():
            first, drawn, *steps = played(long, SEEDS[0])
        actual = played(short, SEEDS[0])
        left = {name: value for name, value in drawn.items() if name in actual[1]}
        same(actual, [first, left, *steps], str(removed))
