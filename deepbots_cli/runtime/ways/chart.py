"""A map of an area: where the middle of a disc can be, and how far it has to go from there."""

from __future__ import annotations

from collections.abc import Iterable
from math import hypot

import numpy as np

from deepbots_cli.footprint import Patch, Spot
from deepbots_cli.runtime.ways.sweep import FAR, MARGIN, Mask, lengths

CELLS = 100  # along the longer side
_DEAR = 50.0  # times; the price of a line through what no way passes
_WIDE = 20.0  # m; lengths in wider areas are kept in a longer unit, so that none comes near FAR
Area = tuple[float, float, float, float]
"""Least x and y, greatest x and y, in m."""


class Chart:
    """The lengths of ways to a goal, by the place where one starts.

    A way is one that the middle of a disc of `radius` can go, and ends where the disc meets the disc of the goal. From
    a place without any, such as one that the disc of a robot touches from, its length is that of the nearest place that
    has one, and of the straight line there: it is finite everywhere.
    """

    def __init__(self, area: Area, radius: float, solids: Iterable[Patch], goal: Spot, goal_radius: float) -> None:
        """`area` is what walls leave, or whatever ways may go through; lengths in m."""
        self.cell = max(area[2] - area[0], area[3] - area[1], 1e-6) / CELLS
        (self._left, columns), (self._low, rows) = (_nodes(area[axis] + radius, area[axis + 2] - radius, self.cell) for axis in (0, 1))
        self._x = self._left + self.cell * (np.arange(columns + 2 * MARGIN) - MARGIN)
        self._y = self._low + self.cell * (np.arange(rows + 2 * MARGIN) - MARGIN)
        self._outside: Mask = np.ones((len(self._y), len(self._x)), np.bool_)
        self._outside[MARGIN:-MARGIN, MARGIN:-MARGIN] = False
        blocked = self._outside.copy()
        for patch in solids:
            self._block(blocked, patch, radius)
        away = np.hypot(self._x - goal[0], (self._y - goal[1])[:, None])
        self._unit = max(1.0, self.cell * CELLS / _WIDE)
        self._step = self.cell / self._unit
        starts = np.where((away <= max(radius + goal_radius, 1.5 * self.cell)) & ~blocked, away / self._unit, FAR)
        found = lengths(blocked, starts, self._step)
        self._reached: Mask = found < FAR
        if not self._reached.any():  # the goal itself is shut in: as the crow flies
            found = np.where(self._outside, FAR, away / self._unit)
        self._found = found
        self._filled = False
        self._lengths: list[list[float]] = found.tolist()
        self._open: list[list[bool]] = self._reached.tolist()
        self._rows, self._columns = rows, columns

    def _fill(self) -> None:
        """Give each node that no way reaches the length of the nearest that one does, and of the line there.

        Lines are made so dear that the nearest counts and not the one with the shortest way, which may be beyond a wall.
        """
        self._filled = True
        line = lengths(self._outside, np.where(self._reached, 0.0, FAR), self._step)
        dear = lengths(self._outside, np.where(self._reached, self._found, FAR), self._step * _DEAR)
        self._found = np.where(self._reached | self._outside, self._found, dear - (_DEAR - 1.0) * line)
        self._lengths = self._found.tolist()

    def _block(self, blocked: Mask, patch: Patch, radius: float) -> None:
        """Take away the nodes at which the disc would cut into a patch."""
        reach = radius - 1e-6
        wide, deep = patch.extent
        columns = slice(*np.searchsorted(self._x, (patch.x - wide - reach, patch.x + wide + reach)))
        rows = slice(*np.searchsorted(self._y, (patch.y - deep - reach, patch.y + deep + reach)))
        dx, dy = self._x[columns] - patch.x, (self._y[rows] - patch.y)[:, None]
        if patch.half is None:
            blocked[rows, columns] |= dx * dx + dy * dy < (patch.radius + reach) ** 2
            return
        along = np.maximum(np.abs(patch.cos * dx + patch.sin * dy) - patch.half[0], 0.0)
        across = np.maximum(np.abs(patch.cos * dy - patch.sin * dx) - patch.half[1], 0.0)
        blocked[rows, columns] |= along * along + across * across < reach * reach

    def length(self, x: float, y: float) -> float:
        """How far it is from a place to the goal, between four nodes; beyond the area the way back to it is added."""
        column, row = (x - self._left) / self.cell, (y - self._low) / self.cell
        inside_column = min(max(column, 0.0), self._columns - 1.0)
        inside_row = min(max(row, 0.0), self._rows - 1.0)
        i, j = min(int(inside_column), self._columns - 2), min(int(inside_row), self._rows - 2)
        u, v = inside_column - i, inside_row - j
        i, j = i + MARGIN, j + MARGIN
        here, there = self._lengths[j], self._lengths[j + 1]
        if not self._filled and here[i] + here[i + 1] + there[i] + there[i + 1] >= FAR:  # one of them is reached by no way
            self._fill()
            return self.length(x, y)
        low = here[i] + u * (here[i + 1] - here[i])
        length = low + v * (there[i] + u * (there[i + 1] - there[i]) - low)
        if column == inside_column and row == inside_row:
            return length * self._unit
        return length * self._unit + self.cell * hypot(column - inside_column, row - inside_row)

    def reaches(self, x: float, y: float) -> bool:
        """Whether there is a way from a place, or from a node beside it."""
        i = min(max(int((x - self._left) / self.cell), 0), self._columns - 2) + MARGIN
        j = min(max(int((y - self._low) / self.cell), 0), self._rows - 2) + MARGIN
        here, there = self._open[j], self._open[j + 1]
        return here[i] or here[i + 1] or there[i] or there[i + 1]


def _nodes(low: float, high: float, cell: float) -> tuple[float, int]:
    """Where the first of the nodes between two ends stands, about their middle, and how many there are: two at least."""
    count = max(2, int((high - low) / cell + 1e-6) + 1)
    return (low + high - (count - 1) * cell) / 2, count
