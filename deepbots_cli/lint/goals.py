"""DB807: goals that cannot be reached, because solid bodies are in the way."""

from __future__ import annotations

from collections.abc import Iterator
from math import sqrt
from typing import NamedTuple

from deepbots_cli import footprint
from deepbots_cli.diagnostics import Finding, Label
from deepbots_cli.expressions.dimensions import LENGTH
from deepbots_cli.expressions.intervals import NEVER
from deepbots_cli.expressions.scalar import World
from deepbots_cli.lint.analysis import Analysis
from deepbots_cli.lint.conditions import Threshold, has_choice, thresholds
from deepbots_cli.lint.context import Context
from deepbots_cli.lint.ranges import with_unit
from deepbots_cli.program.robots import Thrust
from deepbots_cli.robots.model import Box, Capsule, Cylinder, RobotModel, Shape, Sphere

_TOLERANCE = 0.98
"""Engines let bodies penetrate each other a little."""


class Core(NamedTuple):
    """A solid part around the vertical through the origin of a body: a disc of some radius (m) at each height from `low` to `high` (m).

    A `ball` has its full radius in the middle.
    """

    low: float
    high: float
    radius: float
    ball: bool = False

    def width(self, low: float, high: float) -> float:
        """The largest radius between two heights."""
        if not self.ball:
            return self.radius
        middle = (self.low + self.high) / 2
        off = max(0.0, low - middle, middle - high)
        return sqrt(max(0.0, self.radius**2 - off**2))


def unreachable_goal(context: Context) -> Iterator[Finding]:
    """DB807: a success requires an impossible distance: bodies touch before their origins meet, or one lies beyond the walls.

    `distance` and `ground_distance` are measured between origins. A robot of 4 cm radius and a ball of 7 cm radius never come closer
    than 11 cm. `gap` is measured between surfaces.

    Example::

        objects: {ball: {shape: sphere, radius: 7 cm, fixed: true, pose: {x: 0.3 m, z: 7 cm}}}
        augment:
          left: ground_distance(cart, ball)
        observation: {left: 0 .. 1 m}
        termination: {success: {there: left < 5 cm}}

    Instead::

        objects: {ball: {shape: sphere, radius: 7 cm, fixed: true, pose: {x: 0.3 m, z: 7 cm}}}
        augment:
          left: gap(cart, ball)
        observation: {left: 0 .. 1 m}
        termination: {success: {there: left < 2 cm}}
    """
    if context.program.world.terrain is not None:
        return
    analysis = context.analysis
    for ending in context.program.endings:
        if ending.outcome != "success" or ending.foreign is not None or has_choice(analysis, ending.value):
            continue
        for entry in analysis.comparisons(ending.value):
            asked = (asked for asked in thresholds(entry, analysis.ranges) if not asked.above)
            reason = next((reason for reason in (_unreachable(analysis, threshold) for threshold in asked) if reason is not None), None)
            if reason is not None:
                words, help = reason
                also = () if entry.value is ending.value else (Label(entry.value.span, f"`{ending.value.name}` is made of it"),)
                yield Finding("DB807", ending.value.span, f"`{ending.value.name}` {words}", help=help, also=also)
                break


def _unreachable(analysis: Analysis, asked: Threshold) -> tuple[str, str] | None:
    """Why two bodies cannot come so near, and a help; None where they can, or where that is unknown."""
    pair = analysis.pair(asked.quantity)
    if pair is None or len(pair) != 2 or isinstance(analysis.meaning(asked.quantity), World):
        return None
    a, b = sorted(pair)
    limit = asked.bound.high
    if limit <= 0.0 or any(_may_be_above(analysis, body) for body in pair):  # below zero it is DB801
        return None
    touching = _touching_distance(_cores(analysis, a), _cores(analysis, b))
    if limit < _TOLERANCE * touching:
        apart = with_unit(round(touching, 4), LENGTH)
        words = f"asks for {with_unit(limit, LENGTH)} between origins that are {apart} apart when `{a}` and `{b}` touch"
        return words, "ask for more than that, or for the `gap` between surfaces"
    outside = next((body for body in (a, b) if _is_outside(analysis, body, limit)), None)
    if outside and any(robot.name in pair - {outside} and not robot.fixed_base for robot in analysis.program.world.robots):
        words = f"asks to come to `{outside}`, which lies beyond the walls of the arena"
        return words, f"place `{outside}` within the walls, or make the arena larger"
    return None


def _may_be_above(analysis: Analysis, body: str) -> bool:
    """Whether a body may be above another: a robot with rotors, or an arm."""
    is_fixed = any(robot.name == body and robot.fixed_base for robot in analysis.program.world.robots)
    flying = (robot.name for robot in analysis.program.robots if any(isinstance(actuator, Thrust) for actuator in robot.actuators))
    return is_fixed or body in flying


def _touching_distance(first: list[Core], second: list[Core]) -> float:
    """The distance of two origins, seen from above, at which the first parts touch; 0 where none do."""
    found = 0.0
    for a in first:
        for b in second:
            low, high = max(a.low, b.low), min(a.high, b.high)
            if high > low:
                found = max(found, a.width(low, high) + b.width(low, high))
    return found


def _cores(analysis: Analysis, body: str) -> list[Core]:
    """The solid parts around the vertical through the origin of a body in its initial attitude."""
    world = analysis.program.world
    for thing in world.objects:
        if thing.name == body:
            height = _height(analysis, body, thing.shape)
            is_known = thing.solid and not thing.pooled and not thing.variants and height is not None
            return _core(thing.shape, height or 0.0, upright=thing.fixed) if is_known else []
    model = next((robot.model for robot in world.robots if robot.name == body), None)
    if model is None or (height := _height(analysis, f"{body}.{model.root}", model)) is None:
        return []
    parts = model.link(model.root).collisions
    centred = [part for part in parts if part.origin.rpy == (0.0, 0.0, 0.0) and abs(part.origin.xyz[0]) + abs(part.origin.xyz[1]) < 1e-6]
    return [core for part in centred for core in _core(part.shape, height + part.origin.xyz[2], upright=True)]


def _height(analysis: Analysis, subject: str, shape: Shape | RobotModel) -> float | None:
    """The initial height of the origin, m; None where it is drawn or unknown, or where the body is tilted."""
    start = analysis.start
    if any(start.initial(World("orientation", (subject,), axis)) != NEVER for axis in "xy"):
        return None
    known = start.initial(World("position", (subject,), "z"))
    if known is None:
        return None
    if known.single:
        return known.low
    return footprint.resting(shape) if not known.finite else None


def _core(shape: Shape, height: float, *, upright: bool) -> list[Core]:
    """The part of a shape that is solid for certain; of a shape that may topple, the sphere within it."""
    match shape:
        case Sphere(radius):
            return [Core(height - radius, height + radius, radius, ball=True)]
        case Box(size) if upright:
            return [Core(height - size[2] / 2, height + size[2] / 2, min(size[0], size[1]) / 2)]
        case Cylinder(radius, length) | Capsule(radius, length) if upright:
            return [Core(height - length / 2, height + length / 2, radius)]
        case _:
            return []


def _is_outside(analysis: Analysis, body: str, near: float) -> bool:
    """Whether an object begins farther than `near` (m) beyond the walls of the arena."""
    arena = analysis.program.world.arena
    if arena is None or not any(thing.name == body for thing in analysis.program.world.objects):
        return False
    for axis, size in zip("xy", arena.size, strict=True):
        known = analysis.start.initial(World("position", (body,), axis))
        if known is not None and (known.low > size / 2 + near or known.high < -size / 2 - near):
            return True
    return False


RULES = (unreachable_goal,)
