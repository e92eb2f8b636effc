"""Rays against shapes, points within them, and points beside lines, in closed form: the second
implementation of what engines and programs compute.

All points and directions are in the frame of the shape, in m; directions have the length 1.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from deepbots_cli.program.world import Line
from deepbots_cli.robots.model import Box, Capsule, Cylinder, Shape, Sphere

Array = np.ndarray[Any, Any]


def depth(shape: Shape, p: Array) -> float:
    """Return how far a point is within a shape, in m; negative outside."""
    match shape:
        case Box(size):
            return float((np.array(size) / 2 - np.abs(p)).min())
        case Sphere(radius):
            return float(radius - np.linalg.norm(p))
        case Cylinder(radius, length):
            return float(min(radius - np.hypot(p[0], p[1]), length / 2 - abs(p[2])))
        case Capsule(radius, length):
            nearest = np.array([0.0, 0.0, np.clip(p[2], -length / 2, length / 2)])
            return float(radius - np.linalg.norm(p - nearest))
    raise TypeError(shape)


def met(shape: Shape, start: Array, way: Array) -> float:
    """Return the distance at which a ray from outside meets a shape; infinite if it misses it."""
    match shape:
        case Box(size):
            return _within(_slab(start[i], way[i], size[i] / 2) for i in range(3))
        case Sphere(radius):
            return _first(_roots(1.0, start @ way, start @ start - radius**2))
        case Cylinder(radius, length):
            return _within((_side(start, way, radius), _slab(start[2], way[2], length / 2)))
        case Capsule(radius, length):
            middle = _within((_side(start, way, radius), _slab(start[2], way[2], length / 2)))
            ends = (start - (0.0, 0.0, end) for end in (length / 2, -length / 2))
            return min(middle, *(_first(_roots(1.0, p @ way, p @ p - radius**2)) for p in ends))
    raise TypeError(shape)


def _roots(a: float, b: float, c: float) -> tuple[float, float]:
    """Return where a t^2 + 2 b t + c is negative: an interval, which may be all or nothing."""
    if a < 1e-15:
        return (-np.inf, np.inf) if c <= 0.0 else (np.inf, -np.inf)
    square = b * b - a * c
    if square < 0.0:
        return np.inf, -np.inf
    return (-b - np.sqrt(square)) / a, (-b + np.sqrt(square)) / a


def _side(start: Array, way: Array, radius: float) -> tuple[float, float]:
    across, along = start[:2], way[:2]
    return _roots(along @ along, across @ along, across @ across - radius**2)


def _slab(start: float, way: float, half: float) -> tuple[float, float]:
    if abs(way) < 1e-15:
        return (-np.inf, np.inf) if abs(start) <= half else (np.inf, -np.inf)
    first, last = sorted(((-half - start) / way, (half - start) / way))
    return first, last


def _within(intervals: Any) -> float:
    """Return where a ray enters an intersection of convex sets."""
    starts, ends = zip(*intervals, strict=True)
    return _first((max(starts), min(ends)))


def _first(interval: tuple[float, float]) -> float:
    start, end = interval
    return float(start) if 0.0 <= start <= end else np.inf


def line_distance(line: Line, point: Array) -> tuple[float, float]:
    """Return the distance of a point from a line, and the sign of the side: 0 where it is not clear."""
    best, side = np.inf, 0.0
    for a, b in ((np.array(a), np.array(b)) for a, b in line.pieces):
        along = float(np.clip((point - a) @ (b - a) / ((b - a) @ (b - a)), 0.0, 1.0))
        apart = point - (a + along * (b - a))
        cross = (b - a)[0] * (point - a)[1] - (b - a)[1] * (point - a)[0]
        sign = float(np.sign(cross)) if abs(cross) > 1e-6 else 0.0
        length = float(np.linalg.norm(apart))
        if abs(length - best) < 1e-9 and sign != side:
            side = 0.0
        elif length < best - 1e-9:
            best, side = length, sign
    return best, side
