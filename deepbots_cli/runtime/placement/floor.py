"""The ground plane while bodies look for a place: what is taken, and which spots are free."""

from __future__ import annotations

from math import inf
from typing import NamedTuple

import numpy as np

from deepbots_cli import footprint
from deepbots_cli.footprint import Footprint, Patch, Spot

Area = tuple[float, float, float, float]
"""Least x and y, greatest x and y, in m."""
EVERYWHERE: Area = (-inf, -inf, inf, inf)
TOUCHING = 1e-9  # m that rounding may cost


class Floor:
    """What is taken, within the walls of an arena."""

    def __init__(self, size: Spot | None) -> None:
        """`size` is the inner size of the arena along x and y, in m."""
        self._half = (size[0] / 2, size[1] / 2) if size else (inf, inf)
        self._taken: list[tuple[Patch, float, float]] = []

    def clear(self) -> None:
        self._taken.clear()

    def take(self, patch: Patch, clearance: float, top: float) -> None:
        """Note that something is there, which reaches up to the height `top` (m)."""
        self._taken.append((patch, clearance, top))

    def within(self, area: Area, covered: Footprint, yaw: float, clearance: float) -> Area:
        """Where in the area the origin of a body may be, so that it keeps its clearance from the walls; perhaps nowhere."""
        at_origin = covered.at(0.0, 0.0, yaw)
        (reach_x, reach_y), (half_x, half_y) = at_origin.extent, self._half
        room_x, room_y = half_x - clearance - reach_x, half_y - clearance - reach_y
        x, y = at_origin.x, at_origin.y
        return max(area[0], -room_x - x), max(area[1], -room_y - y), min(area[2], room_x - x), min(area[3], room_y - y)

    def is_free(self, patch: Patch, clearance: float, base: float = -inf) -> bool:
        """Whether all that rises above the height `base` (m) is as far away as it or the patch asks for."""
        x, y, radius = patch.x, patch.y, patch.radius
        for other, own, top in self._taken:
            if top <= base + TOUCHING:
                continue
            least = (clearance if clearance > own else own) - TOUCHING
            dx, dy, near = x - other.x, y - other.y, radius + other.radius + least
            if dx * dx + dy * dy < near * near and footprint.gap(patch, other) < least:
                return False
        return True

    def hopeful(self, spots: list[Spot], covered: Footprint, yaw: float, clearance: float, base: float) -> list[Spot]:
        """Those where a disc that fits into the body would be free: in a crowd most go, at a fraction of the price."""
        taken = [(other, own) for other, own, top in self._taken if top > base + TOUCHING]
        if not spots or not taken:
            return spots
        at_origin = covered.at(0.0, 0.0, yaw)
        others = [(o.x, o.y, *(o.half or (0.0, 0.0)), o.cos, o.sin, 0.0 if o.half else o.radius, own) for o, own in taken]
        x, y, half_x, half_y, c, s, around, own = np.array(others).T
        dx, dy = np.add(spots, (at_origin.x, at_origin.y)).T[..., None] - np.array((x, y))[:, None]
        along = np.maximum(np.abs(c * dx + s * dy) - half_x, 0.0)
        across = np.maximum(np.abs(c * dy - s * dx) - half_y, 0.0)
        least = np.maximum(own, clearance) + around + covered.narrowest - TOUCHING
        free = np.all(along * along + across * across >= least * least, axis=1)
        return [spot for spot, hopeful in zip(spots, free.tolist(), strict=True) if hopeful]


class Surface(NamedTuple):
    """The level top of an object: what it covers, and its height in m."""

    patch: Patch
    height: float

    @property
    def area(self) -> Area:
        (x, y), (reach_x, reach_y) = (self.patch.x, self.patch.y), self.patch.extent
        return x - reach_x, y - reach_y, x + reach_x, y + reach_y

    def within(self, area: Area, covered: Footprint, yaw: float, margin: float) -> Area:
        """Where in the area the origin of a body may be at most, so that it keeps `margin` from the edge; perhaps nowhere."""
        at_origin, (low_x, low_y, high_x, high_y) = covered.at(0.0, 0.0, yaw), self.area
        reach_x, reach_y = (reach + margin for reach in at_origin.extent)
        x, y = at_origin.x, at_origin.y
        return cut(area, (low_x + reach_x - x, low_y + reach_y - y, high_x - reach_x - x, high_y - reach_y - y))

    def holds(self, patch: Patch, margin: float) -> bool:
        return self.patch.holds(patch, margin - TOUCHING)


def cut(one: Area, other: Area) -> Area:
    """What two areas have in common; perhaps nothing, and the least is then beyond the greatest."""
    return max(one[0], other[0]), max(one[1], other[1]), min(one[2], other[2]), min(one[3], other[3])


def anywhere(area: Area, count: int, generator: np.random.Generator) -> list[Spot]:
    """So many spots of an area, all alike likely; none of one that is empty."""
    if area[0] > area[2] or area[1] > area[3]:
        return []
    shares = generator.random((count, 2)).tolist()
    return [(area[0] + a * (area[2] - area[0]), area[1] + b * (area[3] - area[1])) for a, b in shares]


def on_grid(area: Area, within: Area, mesh: float, generator: np.random.Generator) -> list[Spot]:
    """The middles of the cells of an area that lie within another, in random order."""
    middles = grid(area, mesh)
    drawn = [middles[index] for index in generator.permutation(len(middles))]
    low_x, low_y, high_x, high_y = within
    return [(x, y) for x, y in drawn if low_x - TOUCHING <= x <= high_x + TOUCHING and low_y - TOUCHING <= y <= high_y + TOUCHING]


def grid(area: Area, mesh: float) -> list[Spot]:
    """The middles of the cells of size `mesh` that fit into an area, about its middle, row by row."""
    columns, rows = (max(1, int((area[axis + 2] - area[axis]) / mesh + 1e-9)) for axis in (0, 1))
    x, y = (area[0] + area[2]) / 2, (area[1] + area[3]) / 2
    return [(x + (i - (columns - 1) / 2) * mesh, y + (j - (rows - 1) / 2) * mesh) for j in range(rows) for i in range(columns)]
