"""The floor of a picture: tiles, and lines painted on them."""

from __future__ import annotations

from collections.abc import Sequence
from math import ceil, hypot
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from deepbots_cli.program.world import Line

    Figures = NDArray[np.float32]
    Colour = tuple[float, float, float, float]

TILE = 0.25  # m
_LIGHT, _DARK = np.array([222, 227, 232], np.float32), np.array([198, 206, 214], np.float32)
_SHADE = 0.9  # of the darker tiles of a floor that has a colour of its own
_FINE, _CELLS = 0.002, 2000  # m across a cell of paint, and how many there are along a side before they grow
_MOST_PAINTS = 255


class Floor:
    """Colours of points of the plane z = 0."""

    def __init__(self, colour: Colour | None, lines: Sequence[Line]) -> None:
        self.usual = colour
        self.colour(colour)
        self._paint = Paint(lines) if lines else None

    def colour(self, colour: Colour | None) -> None:
        """Tiles of this colour, or of two greys for None."""
        self.tiles = colour
        self._light = _LIGHT if colour is None else np.array(colour[:3], np.float32) * np.float32(255.0)
        self._dark = _DARK if colour is None else self._light * np.float32(_SHADE)

    def __call__(self, x: Figures, y: Figures, across: Figures) -> Figures:
        """Shape (n, 3), 0 to 255, seen in pixels `across` m long; tiles too small for a pixel melt into their mean."""
        sharp = np.clip(1.5 - across * np.float32(1 / TILE), 0.0, 1.0)
        odd = (np.floor(x * np.float32(1 / TILE)) + np.floor(y * np.float32(1 / TILE))).astype(np.int32) & 1
        shade = 0.5 + (odd - np.float32(0.5)) * sharp
        colours = self._light + (self._dark - self._light) * shade[:, None]
        return colours if self._paint is None else self._paint.over(colours, x, y)


class Paint:
    """Painted lines as a picture from above: cells of 2 mm, or larger for paint that covers more than 4 m."""

    def __init__(self, lines: Sequence[Line]) -> None:
        edges = [(x + s * line.width, y + s * line.width) for line in lines for x, y in line.points for s in (-0.5, 0.5)]
        xs, ys = zip(*edges, strict=True)
        self._corner = min(xs), min(ys)
        size = max(max(xs) - min(xs), max(ys) - min(ys))
        self._cell = max(_FINE, size / _CELLS)
        shape = tuple(ceil((max(values) - min(values)) / self._cell) + 1 for values in (xs, ys))
        self._cells = np.zeros(shape, np.uint8)
        self._colours = np.zeros((_MOST_PAINTS + 1, 3), np.float32)
        for place, line in enumerate(lines[:_MOST_PAINTS], start=1):
            self._colours[place] = np.array(line.colour[:3], np.float32) * 255.0
            for start, end in line.pieces:
                self._stroke(start, end, line.width / 2, place)

    def _stroke(self, start: tuple[float, float], end: tuple[float, float], half: float, paint: int) -> None:
        """All cells whose centre is within `half` m of a straight piece."""
        spans = []
        for axis in (0, 1):
            ends = sorted((start[axis], end[axis]))
            first = max(int((ends[0] - half - self._corner[axis]) / self._cell), 0)
            last = min(int((ends[1] + half - self._corner[axis]) / self._cell) + 1, self._cells.shape[axis])
            spans.append(slice(first, last))
        x, y = (self._corner[axis] + self._cell * (np.arange(span.start, span.stop) + 0.5) for axis, span in enumerate(spans))
        dx, dy = end[0] - start[0], end[1] - start[1]
        length = hypot(dx, dy) or 1.0
        ahead = ((x[:, None] - start[0]) * dx + (y[None, :] - start[1]) * dy) / length
        foot = np.clip(ahead, 0.0, length)
        apart = np.hypot(x[:, None] - start[0] - foot * dx / length, y[None, :] - start[1] - foot * dy / length)
        self._cells[spans[0], spans[1]][apart <= half] = paint

    def over(self, colours: Figures, x: Figures, y: Figures) -> Figures:
        """The colours with the paint at points over them."""
        column, row = ((values - np.float32(low)) * np.float32(1 / self._cell) for values, low in zip((x, y), self._corner, strict=True))
        inside = np.flatnonzero((column >= 0) & (row >= 0) & (column < self._cells.shape[0]) & (row < self._cells.shape[1]))
        paints = self._cells[column[inside].astype(np.int32), row[inside].astype(np.int32)]
        painted = inside[paints > 0]
        colours[painted] = self._colours[paints[paints > 0]]
        return colours
