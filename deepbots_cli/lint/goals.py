"""DB807: goals that are out of reach, since what is solid is in the way."""

from __future__ import annotations

from collections.abc import Iterator
from math import sqrt
from typing import NamedTuple

from deepbots_cli import footprint
from deepbots_cli.compiler import Checked
from deepbots_cli.diagnostics import Finding, Label
from deepbots_cli.expressions.dimensions import LENGTH
from deepbots_cli.expressions.intervals import Interval
from deepbots_cli.expressions.scalar import World
from deepbots_cli.lint.meaning import Book, book_of
from deepbots_cli.lint.reach import reach_of
from deepbots_cli.lint.start import AtStart
from deepbots_cli.lint.thresholds import Threshold, has_choice, thresholds
from deepbots_cli.lint.wording import figure
from deepbots_cli.program.robots import Thrust
from deepbots_cli.robots.model import Box, Capsule, Cylinder, Shape, Sphere

_SURE = 0.98
"""Engines let bodies sink into each other a little."""


class Core(NamedTuple):
    """A part of a body around the vertical through its origin: between two heights (m), a disc of some radius (m) at each.

    A `ball` is widest in its middle, and its radius is that of the sphere.
    """

    low: float
    high: float
    radius: float
    ball: bool = False

    def width(self, low: float, high: float) -> float:
        """The greatest radius between two heights."""
        if not self.ball:
            return self.radius
        middle = (self.low + self.high) / 2
        off = max(0.0, low - middle, middle - high)
        return sqrt(max(0.0, self.radius**2 - off**2))


def unreachable_goal(checked: Checked) -> Iterator[Finding]:
    """DB807: a success asks for a distance that cannot be: bodies touch before their origins meet, or one lies beyond the walls.

    `distance` and `ground_distance` count from origin to origin. A robot of 4 cm radius and a ball of 7 cm never come nearer than
    11 cm. `gap` counts from surface to surface.

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
    if checked.program is None or checked.program.world.terrain is not None:
        return
    book = book_of(checked.program)
    reach = reach_of(book)
    for ending in checked.program.endings:
        if ending.outcome == "success" and ending.value.foreign is None and not has_choice(book, ending.value):
            for entry in book.comparisons(ending.value):
                found = (_out_of_reach(book, asked) for asked in thresholds(entry, book, reach) if not asked.above)
                reason = next((reason for reason in found if reason is not None), None)
                if reason is not None:
                    also = () if entry.value is ending.value else (Label(entry.value.span, f"`{ending.value.name}` is made of it"),)
                    yield Finding("DB807", ending.value.span, f"`{ending.value.name}` {reason.words}", help=reason.help, also=also)
                    break


class Reason(NamedTuple):
    """Why two bodies cannot come so near, for a sentence, and what to do."""

    words: str
    help: str


def _out_of_reach(book: Book, asked: Threshold) -> Reason | None:
    """None where they can, or where that is not known."""
    pair = book.pair(asked.quantity)
    if pair is None or len(pair) != 2 or isinstance(book.meaning(asked.quantity), World):
        return None
    a, b = sorted(pair)
    limit = asked.bound.high
    if limit <= 0.0 or any(_flies(book, body) for body in pair):  # below zero it is DB801
        return None
    least = _touching(_cores(book, a), _cores(book, b))
    if limit < _SURE * least:
        apart = figure(round(least, 4), LENGTH)
        words = f"asks for {figure(limit, LENGTH)} between origins that are {apart} apart when `{a}` and `{b}` touch"
        return Reason(words, "ask for more than that, or for the `gap` between surfaces")
    outside = next((body for body in (a, b) if _is_outside(book, body, limit)), None)
    if outside and any(robot.name in pair and robot.name != outside and not robot.fixed_base for robot in book.program.world.robots):
        words = f"asks to come to `{outside}`, which lies beyond the walls of the arena"
        return Reason(words, f"place `{outside}` within the walls, or make the arena larger")
    return None


def _flies(book: Book, body: str) -> bool:
    """Whether a body may be above another: a robot with rotors, or an arm."""
    robot = next((robot for robot in book.program.robots if robot.name == body), None)
    fixed = any(entry.name == body and entry.fixed_base for entry in book.program.world.robots)
    return fixed or (robot is not None and any(isinstance(actuator, Thrust) for actuator in robot.actuators))


def _touching(first: list[Core], second: list[Core]) -> float:
    """How near two origins come, seen from above, before any of the parts touch; 0 where none do."""
    least = 0.0
    for a in first:
        for b in second:
            low, high = max(a.low, b.low), min(a.high, b.high)
            if high > low:
                least = max(least, a.width(low, high) + b.width(low, high))
    return least


def _cores(book: Book, body: str) -> list[Core]:
    """The solid parts around the vertical through the origin of a body that stands as it begins."""
    world = book.program.world
    thing = next((thing for thing in world.objects if thing.name == body), None)
    robot = next((robot for robot in world.robots if robot.name == body), None)
    if thing is not None:
        height = _height(book, body, thing.shape)
        known = thing.solid and not thing.pooled and not thing.variants and height is not None
        return _around(thing.shape, height or 0.0, thing.fixed) if known else []
    if robot is None or (height := _height(book, body, robot.model)) is None:
        return []
    parts = robot.model.link(robot.model.root).collisions
    centred = [part for part in parts if part.origin.rpy == (0.0, 0.0, 0.0) and abs(part.origin.xyz[0]) + abs(part.origin.xyz[1]) < 1e-6]
    return [core for part in centred for core in _around(part.shape, height + part.origin.xyz[2], True)]


def _height(book: Book, body: str, shape: Shape | object) -> float | None:
    """Of the origin, where it begins; None where that is drawn or not known, or where the body leans."""
    start = AtStart(book)
    model = next((robot.model for robot in book.program.world.robots if robot.name == body), None)
    subject = body if model is None else f"{body}.{model.root}"
    leaning = [start.standing(World("orientation", (subject,), axis)) for axis in "xy"]
    if any(part != Interval(0.0, 0.0) for part in leaning):
        return None
    known = start.standing(World("position", (subject,), "z"))
    if known is None:
        return None
    if known.single:
        return known.low
    return footprint.resting(model if model is not None else shape) if not known.finite else None  # type: ignore[arg-type]


def _around(shape: Shape, height: float, upright: bool) -> list[Core]:
    """What surely is solid around the middle of a shape; of one that may topple, the sphere within it."""
    match shape:
        case Sphere(radius):
            return [Core(height - radius, height + radius, radius, ball=True)]
        case Box(size) if upright:
            return [Core(height - size[2] / 2, height + size[2] / 2, min(size[0], size[1]) / 2)]
        case Cylinder(radius, length) | Capsule(radius, length) if upright:
            return [Core(height - length / 2, height + length / 2, radius)]
        case _:
            return []


def _is_outside(book: Book, body: str, near: float) -> bool:
    """Whether a body begins farther than `near` beyond the walls."""
    arena = book.program.world.arena
    thing = next((thing for thing in book.program.world.objects if thing.name == body), None)
    if arena is None or thing is None:
        return False
    start = AtStart(book)
    for axis, size in zip("xy", arena.size, strict=True):
        known = start.standing(World("position", (body,), axis))
        if known is not None and (known.low > size / 2 + near or known.high < -size / 2 - near):
            return True
    return False


RULES = (unreachable_goal,)
