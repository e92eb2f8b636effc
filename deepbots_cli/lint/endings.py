"""Ends of episodes, and goals that cannot be reached (family DB8)."""

from __future__ import annotations

from collections.abc import Iterator
from math import sqrt
from typing import NamedTuple

from deepbots_cli.analysis import Analysis
from deepbots_cli.analysis.conditions import (
    ConditionComparison,
    Threshold,
    comparisons,
    thresholds,
)
from deepbots_cli.analysis.ranges import Ranges, bounds_text, total_range, with_unit
from deepbots_cli.diagnostics import Finding, Label
from deepbots_cli.document.nodes import NodePath
from deepbots_cli.expressions import intervals as iv
from deepbots_cli.expressions.dimensions import LENGTH, TIME
from deepbots_cli.expressions.intervals import ALWAYS, INF, NEVER, TRUTH, ZERO, Interval, hull
from deepbots_cli.expressions.scalar import EngineRead, Name, Op, Scalar
from deepbots_cli.expressions.types import referenced_names
from deepbots_cli.lint.context import Match, RuleContext, Simulation, rule
from deepbots_cli.program import Program
from deepbots_cli.program.resets import OfSensor
from deepbots_cli.program.robots import Thrust
from deepbots_cli.program.task import ExpectedResult, ScenarioTest
from deepbots_cli.program.values import Expression
from deepbots_cli.robots import kinematics
from deepbots_cli.robots.model import Box, Capsule, Cylinder, RobotModel, Shape, Sphere

_TOUCHING_FACTOR = 0.98
"""The factor on distances for engines, which let bodies penetrate each other a little."""
_CLOCK_NAMES = frozenset({"time", "step"})
_OF_LAST_STEP = frozenset({"previous_reward", "episode_return"})
_MAX_SEEDS = 8
"""The number of seeds in a note."""


@rule("DB801", versions="every")
def never_true(context: RuleContext) -> Iterator[Finding]:
    """Report an ending that can never be true."""
    analysis = context.analysis
    for ending in context.program.endings:
        if _truth_over_episode(analysis, ending) == NEVER:
            headline = f"`{ending.name}` can never be true"
            notes = tuple(_reasons(analysis, ending))
            yield Finding("DB801", ending.span, headline, _help_for_untrue(analysis, ending), notes=notes)
        elif not ending.foreign and (why := impossible_contact(analysis, analysis.scalars(ending)[0])):
            yield Finding("DB801", ending.span, *why)


def impossible_contact(analysis: Analysis, node: Scalar) -> tuple[str, str] | None:
    """Return which contact between links of one robot is never true, with the reason, and a help."""
    copies = analysis.program.agent.copies
    robots = {body.name: body for body in analysis.program.world.robots}
    robots.pop(copies.robot if copies else "", None)  # a copy may touch another one
    for part in analysis.walk_definitions(node):
        if isinstance(part, EngineRead) and part.function == "contact":
            a, b = part.subjects
            body = robots.get(a.partition(".")[0])
            if body is None or body.name != b.partition(".")[0]:
                continue
            ends = (
                [{body.name, f"{body.name}.{link}"} for link in links]
                for pair in kinematics.self_collision_pairs(body.model)
                for links in (pair, pair[::-1])
            )
            text = f"`contact({a}, {b})` is never true: links"
            if not any(a in first and b in second for first, second in ends):
                return (
                    f"{text} that a joint joins do not touch each other",
                    "compare the position of the joint instead",
                )
            if not body.self_collision:
                return (
                    f"{text} of one robot do not touch each other",
                    "use `clearance(...)` of the two links instead, as in `clearance(a, b) < 1 cm`, or write"
                    " `self_collision: true` under the robot",
                )
    return None


def _truth_over_episode(analysis: Analysis, ending: Expression) -> Interval:
    """Return whether an ending holds in an episode without time limit; 0 .. 1 if that depends."""
    return TRUTH if ending.foreign else analysis.ranges_in(0.0, INF).of(analysis.scalars(ending)[0])


def _help_for_untrue(analysis: Analysis, ending: Expression) -> str:
    touches = _impossible_contacts(analysis, ending)
    if touches:
        intangible_body, *solid_bodies = sorted(
            touches[0].subjects, key=lambda name: name not in analysis.intangible
        )
        body = solid_bodies[0] if solid_bodies else "a"
        return f"use a distance, as in `distance({body}, {intangible_body}) < 5 cm`" + (
            "" if "." in intangible_body else f", or remove `solid: false` of `{intangible_body}`"
        )
    return "correct the condition, or remove the ending"


def _impossible_contacts(analysis: Analysis, ending: Expression) -> list[EngineRead]:
    """Return the contacts of an object that is not solid."""
    (node,) = analysis.scalars(ending)
    touches = (part for part in analysis.walk_definitions(node) if isinstance(part, EngineRead))
    return [
        part
        for part in touches
        if part.function in ("contact", "collided") and not analysis.intangible.isdisjoint(part.subjects)
    ]


def _reasons(analysis: Analysis, ending: Expression) -> Iterator[str]:
    """Yield comparisons that never hold, with the ranges of their sides; or why the parts never hold
    together."""
    ranges = analysis.ranges_in(0.0, INF)
    never = [
        entry
        for entry in comparisons(analysis, ending)
        if all(ranges.of(part) == NEVER for part in analysis.lowered(entry.node, entry.value.owner))
    ]
    for entry in never:
        yield from (
            f"`{text}` is {words}"
            for text, interval, words in _sides(entry, ranges)
            if interval.low > -INF or interval.high < INF
        )
    (node,) = analysis.scalars(ending)
    touched = _impossible_contacts(analysis, ending)
    intangible = sorted(
        {name for part in touched for name in analysis.intangible.intersection(part.subjects)}
    )
    yield from (
        f"nothing touches `{name}`, which {'has no collision shape' if '.' in name else 'is not solid'}"
        for name in intangible
    )
    if (
        not never
        and not intangible
        and isinstance(meaning := analysis.resolve_aliases(node), Op)
        and meaning.op == "and"
    ):
        yield "its parts are never true at the same time"


def _sides(entry: ConditionComparison, ranges: Ranges) -> Iterator[tuple[str, Interval, str]]:
    """Yield the text, the range and the range in words of both sides of a comparison, except constants."""
    for arg in entry.node.args:
        interval = hull([ranges.of(part) for part in ranges.analysis.lowered(arg, entry.value.owner)])
        if not interval.is_single:
            yield entry.value.text[arg.start : arg.end], interval, bounds_text(interval, arg.type.dimension)


@rule("DB802")
def always_true(context: RuleContext) -> Iterator[Finding]:
    """Report an ending that holds in every step, so that each episode ends at once."""
    for ending in context.program.endings:
        if _truth_over_episode(context.analysis, ending) == ALWAYS:
            headline = f"`{ending.name}` is true in every step"
            yield Finding("DB802", ending.span, headline, "write a condition that is not always true")


@rule("DB804", versions="every")
def shadowed_limit(context: RuleContext) -> Iterator[Finding]:
    """Report one of two limits without effect, because the other always comes first."""
    yield from _later_limit(context)
    yield from _later_ending(context)
    analysis = context.analysis
    last = context.analysis.last_step
    for ending in context.program.endings:
        if _truth_over_episode(analysis, ending).is_single or ending.foreign:
            continue  # DB801, DB802
        (node,) = analysis.scalars(ending)
        limit = f"the truncation at step {last}"
        if _with_return(analysis, 0, last).of(node) == NEVER:
            headline = f"`{ending.name}` cannot become true before {limit}"
            label = "the truncation"
            help = "raise the limit under `truncation`, or remove the ending"
        elif (
            not _leaves(analysis, node) <= _CLOCK_NAMES
            and last > 1
            and _with_return(analysis, last - 1, last - 1).of(node) == ALWAYS
        ):
            headline = f"`{ending.name}` ends every episode before {limit}"
            label = "never reached"
            help = (
                "remove this ending: `truncation` already ends the episode; describe a good result under"
                " `solved`"
            )
        else:
            continue
        also = (Label(context.values.key_span(("truncation",)), label),)
        yield Finding("DB804", ending.span, headline, help, labels=also)


def _with_return(analysis: Analysis, first: int, last: int) -> Ranges:
    """Return ranges in these steps, with the range of the return; `first` is 0 or `last`."""
    reward = analysis.reward
    step = total_range(reward.terms, reward.ranges_while_running())
    # Endings are computed before the reward of their step, so the return lacks the reward of a known step.
    ticks = float((last - bool(first)) * analysis.program.action_repeat)
    return_interval = Interval()
    if reward.is_complete and not first:
        return_interval = Interval(min(0.0, step.low * ticks), max(0.0, step.high * ticks))
    elif reward.is_complete and step.is_finite:
        return_interval = Interval(step.low * ticks, step.high * ticks)
    return Ranges(analysis, {"episode_return": return_interval}, (float(first), float(last)))


def _later_limit(context: RuleContext) -> Iterator[Finding]:
    """Report the later one of `max_steps` and `max_time`."""
    program = context.program
    ticks = program.truncation.timesteps(program.world.timestep, program.action_repeat)
    if len(ticks) < 2:
        return
    earlier, later = sorted(ticks, key=lambda name: ticks[name])
    if ticks[earlier] < ticks[later]:
        headline = f"`{later}` has no effect: `{earlier}` always ends the episode first"
        also = (Label(context.values.span(("truncation", earlier)), "ends the episode first"),)
        span = context.values.span(("truncation", later))
        yield Finding("DB804", span, headline, "remove one of the two", labels=also)


def _later_ending(context: RuleContext) -> Iterator[Finding]:
    """Report endings that come too late."""
    failures = context.program.failures
    for late, first in context.analysis.shadowed.items():
        headline = f"`{late.name}` has no effect: `{first.name}` always ends the episode first"
        help = (
            f"change the limit of `{late.name}` so that it is reached before `{first.name}`"
            if (late.name in failures) != (first.name in failures)
            else "remove one of the two"
        )
        also = (Label(first.span, "ends the episode first"),)
        yield Finding("DB804", late.span, headline, help, labels=also)


def _leaves(analysis: Analysis, node: Scalar) -> set[str]:
    """Return the names without definition that a value depends on, except parameters; facts of the world by
    their function."""
    parameters = {value.name for value in analysis.program.parameters}
    nodes = list(analysis.walk_definitions(node))
    names = {part.name for part in nodes if isinstance(part, Name)} - parameters
    return names | {f"{part.function}()" for part in nodes if isinstance(part, EngineRead)}


@rule(
    "DB805",
    "`{ending}` depends only on the time, which the policy does not observe",
    "observe the time, or limit the episode under `truncation` instead: {limits}",
    versions="training",
)
def timeout_as_termination(context: RuleContext) -> Iterator[Match]:
    """Report an ending that depends only on the time, which the agent does not observe."""
    analysis = context.analysis
    observed_names = {
        name
        for entry in context.program.agent.observation
        for node in analysis.scalars(entry.value)
        for name in _leaves(analysis, node)
    }
    if not observed_names & _CLOCK_NAMES:
        for ending in context.program.endings:
            names = _leaves(analysis, analysis.scalars(ending)[0]) if ending.foreign is None else set()
            if (
                names
                and names <= _CLOCK_NAMES
                and not analysis.ranges.of(analysis.scalars(ending)[0]).is_single
            ):
                limits = " or ".join(
                    f"`{'max_time: 5 s' if name == 'time' else 'max_steps: 200'}`" for name in sorted(names)
                )
                yield Match(ending.span, ending=ending.name, limits=limits)


@rule("DB806")
def ends_at_reset(context: RuleContext) -> Iterator[Finding]:
    """Report an ending that is already true at the start of every episode."""
    analysis = context.analysis
    start = context.analysis.start
    for ending in context.program.endings:
        if ending.foreign is None and start.of(analysis.scalars(ending)[0]) == ALWAYS != _truth_over_episode(
            analysis, ending
        ):
            sides = [side for entry in comparisons(analysis, ending) for side in _sides(entry, start)]
            notes = tuple(f"`{text}` begins {words}" for text, interval, words in sides if interval.is_finite)
            help = _help_for_early(
                context.program,
                ending,
                "change the initial state under `reset`, widen the limit, or reverse the comparison",
            )
            yield Finding(
                "DB806",
                ending.span,
                f"`{ending.name}` is already true when an episode begins",
                help,
                notes=notes,
            )


@rule("DB806", simulated=True)
def sometimes_ends_at_reset(simulation: Simulation) -> Iterator[Finding]:
    """Report an ending that holds when an episode begins, with at least one seed."""
    for ending in simulation.program.endings:
        seeds = simulation.report.endings_at_reset.get(ending.name, [])
        if seeds:
            headline = (
                f"`{ending.name}` is already true at the start of {len(seeds)} of"
                f" {simulation.plan.resets} episodes"
            )
            more = ", ..." if len(seeds) > _MAX_SEEDS else ""
            notes = (
                f"with seed{'s' if len(seeds) > 1 else ''} {', '.join(map(str, seeds[:_MAX_SEEDS]))}{more}",
            )
            help = _help_for_early(
                simulation.program, ending, "change the initial state under `reset`, or widen the limit"
            )
            yield Finding("DB806", ending.span, headline, help, notes=notes)


def _help_for_early(program: Program, ending: Expression, help_for_failure: str) -> str:
    if ending.name not in program.agent.success:
        return help_for_failure
    return (
        "change the initial state under `reset`, or add a condition that is false at the start, as in"
        " `... and time > 1 s`"
    )


@rule("DB808", simulated=True)
def undefined_value(simulation: Simulation) -> Iterator[Finding]:
    """Report an episode that cannot begin or continue, for a reason that no other code reports."""
    stop = simulation.report.stop
    failed = simulation.failed
    if failed is not None and failed.section == "other":
        help = (
            "write an expression that is always defined; keep divisors away from zero, as in `1 / max(d,"
            " 1 cm)` for a length `d`"
        )
        yield Finding("DB808", failed.span, f"`{failed.name}` has no value", help, notes=failed.notes)
    elif failed is None and stop is not None and stop.kind == "value":
        span = simulation.values.key_span(
            ("reset",) if simulation.report.where.activity == "reset" else ("robots",)
        )
        headline = (
            "an episode cannot begin"
            if simulation.report.where.activity == "reset"
            else "an episode cannot continue"
        )
        yield Finding("DB808", span, headline, notes=(simulation.when(), stop.text))


@rule(
    "DB811",
    "{event} at least {time}, but no episode lasts longer than {end}",
    "write a shorter time, or allow longer episodes under `truncation`",
    versions="every",
)
def after_the_end(context: RuleContext) -> Iterator[Match]:
    """Report a push, a reading or a message that would come only after the end of every episode."""
    end = context.analysis.last_step * context.analysis.period  # s
    for subject, time, path in _delays(context.analysis):
        if time >= end:
            delay, last = with_unit(time, TIME), with_unit(end, TIME)
            yield Match(context.values.span(path), event=subject, time=delay, end=last)


def _delays(analysis: Analysis) -> Iterator[tuple[str, float, NodePath]]:
    """Yield events that come with a delay, the smallest delay (s), and its place."""
    program = analysis.program

    def low(time: Expression) -> float:
        return analysis.ranges.of(analysis.scalars(time)[0]).low

    for push in program.disturbances:
        key, first = ("at", push.first) if push.first is not None else ("every", push.every)
        if first is not None:
            yield f"`{push.name}` begins after", low(first), ("disturbances", push.name, key)
    drawn = {variation.of for variation in program.reset.variations}
    for robot in program.robots:
        for sensor in robot.sensors:
            path = ("robots", robot.name, "sensors", sensor.name)
            if sensor.faults is not None and sensor.faults.period > 1:
                period = sensor.faults.period * program.world.timestep
                yield f"`{sensor.name}` is read again after", period, (*path, "period")
            if sensor.faults is not None and OfSensor(robot.name, sensor.name, "latency") not in drawn:
                yield f"a reading of `{sensor.name}` takes", sensor.faults.latency, (*path, "latency")
    # All robots have the same routes.
    routes = [("between_robots", link.route) for link in program.links[:1]]
    for robot in program.robots[:1]:
        routes += (("to_robot", robot.to_route), ("from_robot", robot.from_route))
    for key, route in routes:
        if route.latency is not None:
            yield "a message takes", low(route.latency), ("messages", key, "latency")


# Goals that cannot be reached


class SolidProfile(NamedTuple):
    """A solid part around the vertical through the origin of a body: a disc of some radius (m) at each height
    from `low` to `high` (m).

    A ball has its full radius in the middle.
    """

    low: float
    high: float
    radius: float
    is_ball: bool = False

    @property
    def middle(self) -> float:
        return (self.low + self.high) / 2

    def width(self, low: float, high: float) -> float:
        """Return the largest radius between two heights."""
        if not self.is_ball:
            return self.radius
        offset = max(0.0, low - self.middle, self.middle - high)
        return sqrt(max(0.0, self.radius**2 - offset**2))


@rule("DB807")
def unreachable_goal(context: RuleContext) -> Iterator[Finding]:
    """Report a success that requires a distance that cannot be reached."""
    if context.program.world.terrain is not None:
        return
    analysis = context.analysis
    for ending in context.program.endings:
        if ending.name not in context.program.agent.success:
            continue
        for entry in comparisons(analysis, ending, ["and"]):
            required = (each for each in thresholds(entry, analysis.ranges) if not each.one_of_two)
            upper = (threshold for threshold in required if not threshold.above)
            reason = next(filter(None, (_unreachable(analysis, threshold) for threshold in upper)), None)
            if reason is not None:
                words, help = reason
                also = (
                    ()
                    if entry.value is ending
                    else (Label(entry.value.span, f"`{ending.name}` depends on it"),)
                )
                yield Finding("DB807", ending.span, f"`{ending.name}` {words}", help, labels=also)
                break


def _unreachable(analysis: Analysis, threshold: Threshold) -> tuple[str, str] | None:
    """Return why two bodies cannot come so near, and a help; None if they can, or if that is unknown."""
    pair = analysis.distance_pair(threshold.quantity)
    if pair is None or len(pair) != 2 or isinstance(analysis.resolve_aliases(threshold.quantity), EngineRead):
        return None
    a, b = sorted(pair)
    limit = threshold.bound.high
    if limit <= 0.0 or _may_be_above(analysis, pair):  # below zero it is DB801
        return None
    touching = _touching_distance(_cores(analysis, a), _cores(analysis, b))
    if limit < _TOUCHING_FACTOR * touching:
        apart = with_unit(round(touching, 4), LENGTH)
        words = (
            f"requires the origins of `{a}` and `{b}` to come within {with_unit(limit, LENGTH)} of each other"
        )
        words += f", but they are {apart} apart when the bodies touch"
        return words, f"raise the limit above {apart}, or use the `clearance` between surfaces"
    outside = next((body for body in (a, b) if _beyond_walls(analysis, body).low > limit), None)
    if outside and any(
        robot.name in pair - {outside}
        and not robot.fixed_base
        and _beyond_walls(analysis, f"{robot.name}.{robot.model.root}").high <= 0.0
        for robot in analysis.program.world.robots
    ):
        words = f"requires the robot to reach `{outside}`, which lies outside the walls of the arena"
        return words, f"place `{outside}` within the walls, or make the arena larger"
    return None


def _may_be_above(analysis: Analysis, pair: frozenset[str]) -> bool:
    """Return whether one body may be above the other: an arm, a robot with rotors, or what one of them may
    lift."""
    world = analysis.program.world
    can_lift = any(robot.fixed_base for robot in world.robots) or any(
        isinstance(actuator, Thrust) for robot in analysis.program.robots for actuator in robot.actuators
    )
    return can_lift and not pair <= {body.name for body in world.objects if body.fixed}


def _touching_distance(first: list[SolidProfile], second: list[SolidProfile]) -> float:
    """Return the distance of two origins, seen from above, at which the first parts touch; 0 where none
    do."""
    distance = 0.0
    for a in first:
        for b in second:
            low, high = max(a.low, b.low), min(a.high, b.high)
            if a.is_ball and b.is_ball:
                apart = (a.radius + b.radius) ** 2 - (a.middle - b.middle) ** 2
                distance = max(distance, sqrt(max(0.0, apart)))
            elif high > low:
                distance = max(distance, a.width(low, high) + b.width(low, high))
    return distance


def _cores(analysis: Analysis, body: str) -> list[SolidProfile]:
    """Return the solid parts around the vertical through the origin of a body in its initial attitude."""
    world = analysis.program.world
    for object_body in world.objects:
        if object_body.name == body:
            height = _height(analysis, body, object_body.shape)
            is_known = (
                object_body.solid
                and not object_body.pooled
                and not object_body.variants
                and height is not None
            )
            return _core(object_body.shape, height or 0.0, upright=object_body.fixed) if is_known else []
    model = next((robot.model for robot in world.robots if robot.name == body), None)
    if model is None or (height := _height(analysis, f"{body}.{model.root}", model)) is None:
        return []
    parts = model.link(model.root).collisions
    centered = [
        part
        for part in parts
        if part.origin.rpy == (0.0, 0.0, 0.0) and abs(part.origin.xyz[0]) + abs(part.origin.xyz[1]) < 1e-6
    ]
    return [
        core for part in centered for core in _core(part.shape, height + part.origin.xyz[2], upright=True)
    ]


def _height(analysis: Analysis, subject: str, shape: Shape | RobotModel) -> float | None:
    """Return the initial height of the origin, m; None where it is drawn or unknown, or where the body is
    tilted."""
    start = analysis.start
    if any(start.initial(EngineRead("orientation", (subject,), axis)) != ZERO for axis in "xy"):
        return None
    heights = start.initial(EngineRead("position", (subject,), "z"))
    if heights is None:
        return None
    if heights.is_single:
        return heights.low
    # The height of a body that rests has no bounds here; a drawn height has finite ones.
    positions = analysis.program.reset.joint_positions.get(subject.partition(".")[0])
    return kinematics.resting_height(shape, positions=positions) if not heights.is_finite else None


def _core(shape: Shape, height: float, *, upright: bool) -> list[SolidProfile]:
    """Return the part of a shape that is solid for certain. A shape that may topple has one only if it is a
    sphere."""
    match shape:
        case Sphere(radius):
            return [SolidProfile(height - radius, height + radius, radius, is_ball=True)]
        # The circle within the base is solid at every yaw.
        case Box(size) if upright:
            return [SolidProfile(height - size[2] / 2, height + size[2] / 2, min(size[0], size[1]) / 2)]
        case Cylinder(radius, length) | Capsule(radius, length) if upright:
            return [SolidProfile(height - length / 2, height + length / 2, radius)]
        case _:
            return []


def _beyond_walls(analysis: Analysis, body: str) -> Interval:
    """Return how far beyond the walls of the arena an object or a root link begins, m; below 0 within
    them."""
    arena = analysis.program.world.arena
    places = (
        iv.subtract(
            iv.absolute(analysis.start.initial(EngineRead("position", (body,), axis)) or Interval()),
            iv.single(size / 2),
        )
        for axis, size in zip("xy", arena.size if arena else (INF, INF), strict=True)
    )
    return iv.maximum(*places)


@rule("DB813")
def idle_test(context: RuleContext) -> Iterator[Finding]:
    """Report a test that can only pass, or only fail."""
    for test in context.checked.tests:
        for expected in test.expected:
            outcome = _only_outcome(context.analysis, test, expected)
            if outcome is not None:
                headline = f"the test `{test.name}` cannot pass: `{expected.key}` is never met"
                help = f"change the condition, which is true in none of the {test.steps} steps of the test"
                if expected.key == "eventually":
                    help += ", or let the test run longer"
                if outcome:
                    headline = f"`{expected.key}` of the test `{test.name}` checks nothing: it is always met"
                    help = "write an expectation that a mistake in the scenario would violate"
                yield Finding("DB813", expected.span, headline, help)


def _only_outcome(analysis: Analysis, test: ScenarioTest, expected: ExpectedResult) -> bool | None:
    """Return whether an expectation is met in any case (True) or in none (False)."""
    if expected.endings:
        endings = {ending.name for ending in analysis.program.endings}
        endings |= {*analysis.program.truncation.limits}
        return True if endings <= set(expected.endings) and test.steps >= analysis.last_step else None
    if expected.condition is None:
        return (
            True if expected.key != "mean_return" and expected.low <= 0.0 and expected.high >= 1.0 else None
        )
    if not _OF_LAST_STEP.isdisjoint(referenced_names(expected.condition.typed)):
        return None  # their ranges are those of the step before
    outcome = analysis.ranges_in(1.0, float(test.steps)).of(analysis.scalars(expected.condition)[0])
    return outcome == ALWAYS if outcome.is_single else None
