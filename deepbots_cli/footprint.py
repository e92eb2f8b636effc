"""Footprints of bodies on the ground, as discs and rectangles, and the points where a robot touches it.

The footprint of an object is a rectangle or a disc, exact while it stands upright. The footprint of a robot
is the disc around its links with all joints at 0. Lengths are in m, angles in rad.

Distances do not use shapely: a patch and its distance to another take 19 us here and 17 us with shapely.
"""

from __future__ import annotations

from collections.abc import Iterator
from math import cos, hypot, sin
from typing import NamedTuple

from deepbots_cli import frames
from deepbots_cli.frames import Frame, quaternion
from deepbots_cli.robots.kinematics import bounds_of_shape, corners, placed
from deepbots_cli.robots.model import (
    Capsule,
    Cylinder,
    RobotModel,
    Shape,
    Sphere,
)

Spot = tuple[float, float]


class Footprint(NamedTuple):
    """A rectangle or a disc in the axes of a standing body.

    `middle` is relative to the body's origin; `radius` is that of the disc, or of the circle around the
    rectangle; `half` holds half the sides of the rectangle, None for a disc.
    """

    middle: Spot
    radius: float
    half: Spot | None = None

    @property
    def inradius(self) -> float:
        """Half the smaller width, in m."""
        return min(self.half) if self.half else self.radius

    def at(self, x: float, y: float, yaw: float) -> Patch:
        """Return the patch that the footprint covers when the body's origin is at (x, y)."""
        c, s = cos(yaw), sin(yaw)
        mx, my = self.middle
        return Patch(x + c * mx - s * my, y + s * mx + c * my, self.radius, self.half, c, s)


class Patch(NamedTuple):
    """A footprint in the world: the position of its middle, and the cosine and sine of its yaw."""

    x: float
    y: float
    radius: float
    half: Spot | None
    cos: float
    sin: float

    @property
    def half_extents(self) -> Spot:
        """Half the size along x and y of the world, in m."""
        if self.half is None:
            return self.radius, self.radius
        a, b = self.half
        c, s = abs(self.cos), abs(self.sin)
        return c * a + s * b, s * a + c * b

    def distance(self, x: float, y: float) -> float:
        """Return the distance of a point from the edge; 0 inside."""
        dx, dy = x - self.x, y - self.y
        if self.half is None:
            return max(0.0, hypot(dx, dy) - self.radius)
        along = abs(self.cos * dx + self.sin * dy) - self.half[0]
        across = abs(self.cos * dy - self.sin * dx) - self.half[1]
        return hypot(max(0.0, along), max(0.0, across))

    def contains(self, other: Patch, margin: float) -> bool:
        """Return whether another patch lies within this one, at least `margin` m from its edge."""
        if self.half is not None:
            dx, dy = other.x - self.x, other.y - self.y
            axes = ((self.cos, self.sin, self.half[0]), (-self.sin, self.cos, self.half[1]))
            return all(
                abs(c * dx + s * dy)
                + (_half_projection(other, c, s) if other.half else other.radius)
                + margin
                <= half
                for c, s, half in axes
            )
        if other.half is None:
            return hypot(other.x - self.x, other.y - self.y) + other.radius + margin <= self.radius
        # A disc is convex: it contains a rectangle if it contains the corners.
        return all(hypot(x - self.x, y - self.y) + margin <= self.radius for x, y in other.corners())

    def corners(self) -> Iterator[Spot]:
        """Yield the four corners of a rectangle."""
        a, b = self.half or (0.0, 0.0)
        for i, j in ((a, b), (a, -b), (-a, b), (-a, -b)):
            yield self.x + self.cos * i - self.sin * j, self.y + self.sin * i + self.cos * j


def patch_distance(a: Patch, b: Patch) -> float:
    """Return the distance between two patches; negative where they overlap."""
    if a.half is None or b.half is None:
        disc, patch = (a, b) if a.half is None else (b, a)
        return patch.distance(disc.x, disc.y) - disc.radius
    if not _parted(a, b):
        return -min(*a.half, *b.half)
    # The shortest way between two disjoint rectangles begins at a corner of one of them.
    return min(
        *(b.distance(*corner) for corner in a.corners()), *(a.distance(*corner) for corner in b.corners())
    )


def _parted(a: Patch, b: Patch) -> bool:
    """Return whether two rectangles are disjoint: the separating axis theorem."""
    dx, dy = b.x - a.x, b.y - a.y
    # Opposite sides are parallel, so each rectangle has two axes.
    axes = ((a.cos, a.sin), (-a.sin, a.cos), (b.cos, b.sin), (-b.sin, b.cos))
    return any(abs(c * dx + s * dy) >= _half_projection(a, c, s) + _half_projection(b, c, s) for c, s in axes)


def _half_projection(patch: Patch, c: float, s: float) -> float:
    """Return half the length of a rectangle's projection on the axis (c, s)."""
    a, b = patch.half or (0.0, 0.0)
    return a * abs(c * patch.cos + s * patch.sin) + b * abs(s * patch.cos - c * patch.sin)


# Footprints


def shape_footprint(shape: Shape, roll: float = 0.0, pitch: float = 0.0) -> Footprint:
    """Return the footprint of an object whose origin is the middle of its shape; the bounding rectangle if
    the object is tilted."""
    match shape:
        case Sphere(radius):
            return Footprint((0.0, 0.0), radius)
        case Cylinder(radius) | Capsule(radius) if roll == pitch == 0.0:
            return Footprint((0.0, 0.0), radius)
        case _:
            (low_x, low_y, _), (high_x, high_y, _) = bounds_of_shape(
                shape, (frames.IDENTITY_FRAME[0], quaternion(roll, pitch, 0.0))
            )
            half = ((high_x - low_x) / 2, (high_y - low_y) / 2)
            return Footprint(((low_x + high_x) / 2, (low_y + high_y) / 2), hypot(*half), half)


def robot_footprint(model: RobotModel) -> Footprint:
    """Return the disc around all collision shapes, or all visuals where there are none; a point for a robot
    without shapes."""
    discs = _all_discs(model)
    if not discs:
        return Footprint((0.0, 0.0), 0.0)
    low_x, high_x = min(x - r for x, _, r in discs), max(x + r for x, _, r in discs)
    low_y, high_y = min(y - r for _, y, r in discs), max(y + r for _, y, r in discs)
    middle = ((low_x + high_x) / 2, (low_y + high_y) / 2)
    return Footprint(middle, max(hypot(x - middle[0], y - middle[1]) + r for x, y, r in discs))


def half_width(model: RobotModel) -> float:
    """Return the reach of a robot's shapes from its origin, along x or y, whichever is less: its distance
    from a wall that it drives along."""
    return min(max((abs(disc[axis]) + disc[2] for disc in _all_discs(model)), default=0.0) for axis in (0, 1))


def _all_discs(model: RobotModel) -> list[tuple[float, float, float]]:
    """Return the discs of all collision shapes, or of all visuals where there are none, in the frame of the
    root link."""
    for pairs in (placed(model, lambda link: link.collisions), placed(model, lambda link: link.visuals)):
        discs = [disc for shape, frame in pairs for disc in _discs(shape, frame)]
        if discs:
            return discs
    return []


def _discs(shape: Shape, frame: Frame) -> Iterator[tuple[float, float, float]]:
    """Yield discs (x, y, radius) whose hull, seen from above, contains a shape of a robot; the hull is exact
    for upright and for lying shapes."""
    x, y, _ = frame[0]
    axis = frames.rotate(frame[1], (0.0, 0.0, 1.0))
    match shape:
        case Sphere(radius):
            yield x, y, radius
        case Capsule(radius, length):
            for end in (-length / 2, length / 2):
                yield x + end * axis[0], y + end * axis[1], radius
        # 1e-3 is the sine of the tilt: less than a milliradian from upright.
        case Cylinder(radius) if hypot(axis[0], axis[1]) < 1e-3:
            yield x, y, radius
        case _:
            yield from ((px, py, 0.0) for px, py, _ in corners(shape, frame))
