"""Lines painted on the ground: where a body is beside them, and how much light the ground throws back.

Plain floats, and only the pieces near by are looked at, so that the cost does not grow with the length of a line.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from math import floor, hypot, sqrt
from typing import NamedTuple

from deepbots_cli.program.world import Line

_CELL = 0.1  # m, at least; the mesh in which `Paint` sorts the pieces
_MOST_CELLS = 100_000


class Piece(NamedTuple):
    """A straight piece: where it begins (m), its direction, its length (m), how far along the line it begins (m)."""

    x: float
    y: float
    along_x: float
    along_y: float
    length: float
    start: float

    def foot(self, x: float, y: float) -> tuple[float, float, float]:
        """The nearest of its points to (x, y): how far along the piece, the distance squared, and the side (left positive)."""
        dx, dy = x - self.x, y - self.y
        along = min(max(dx * self.along_x + dy * self.along_y, 0.0), self.length)
        off_x, off_y = dx - along * self.along_x, dy - along * self.along_y
        return along, off_x * off_x + off_y * off_y, self.along_x * dy - self.along_y * dx


def pieces(line: Line) -> list[Piece]:
    found, start = [], 0.0
    for (x, y), (end_x, end_y) in line.pieces:
        length = hypot(end_x - x, end_y - y)
        if length > 0.0:
            found.append(Piece(x, y, (end_x - x) / length, (end_y - y) / length, length, start))
        start += length
    return found


class Follower:
    """Follows one body along one line.

    It keeps to the part of the line where the body was, so that a line may cross itself or come near itself:
    it looks as far along the line as the body moved and as it is beside it, twice over, and a width more.
    """

    def __init__(self, line: Line) -> None:
        self._pieces = pieces(line)
        self._length = line.length
        self._closed = line.closed
        self._width = line.width
        self.reset()

    def reset(self) -> None:
        """Begin an episode: the next place is where the way along the line begins."""
        self._at = -1  # the piece that the body is beside; none yet
        self._place = (0.0, 0.0)
        self._cross_track_error = self._arc_length = self._arc = 0.0

    def __call__(self, position: Sequence[float]) -> tuple[float, float]:
        """How far the body is to the left of the line, and how far it has come along it since the reset, in m.

        The way along a closed line goes on growing from lap to lap. Calling it twice at one place changes nothing.
        """
        x, y = position[0], position[1]
        if self._at < 0:
            candidates: Iterable[int] = range(len(self._pieces))
        elif (x, y) == self._place:
            return self._cross_track_error, self._arc_length
        else:
            moved = hypot(x - self._place[0], y - self._place[1])
            candidates = self._near(2.0 * (moved + abs(self._cross_track_error)) + self._width)
        at, arc, nearest, side = max(self._at, 0), self._arc, float("inf"), 0.0
        for index in candidates:
            piece = self._pieces[index]
            along, squared, left = piece.foot(x, y)
            if squared < nearest:
                arc, nearest, side, at = piece.start + along, squared, left, index
        if self._at >= 0:
            step = arc - self._arc
            self._arc_length += step - self._length * round(step / self._length) if self._closed else step
        self._at, self._arc, self._place = at, arc, (x, y)
        self._cross_track_error = sqrt(nearest) if side >= 0.0 else -sqrt(nearest)
        return self._cross_track_error, self._arc_length

    def _near(self, reach: float) -> Iterator[int]:
        """Pieces that begin or end within `reach` along the line of where the body was, that one first."""
        count, here = len(self._pieces), self._pieces[self._at]
        yield self._at
        for sign, way in ((1, here.start + here.length - self._arc), (-1, self._arc - here.start)):
            index = self._at
            for _ in range(count - 1):
                index += sign
                if way > reach or not (self._closed or 0 <= index < count):
                    break
                index %= count
                way += self._pieces[index].length
                yield index


class Paint:
    """The light that the ground throws back at a place: 1 where nothing is painted, a later line over an earlier one."""

    def __init__(self, lines: Sequence[Line], spot: float) -> None:
        """`spot` is the radius (m) of the patch of ground that is looked at, over which the light is a mean."""
        self._spot = max(spot, 1e-6)
        self._halves = [0.5 * line.width for line in lines]
        self._reflectances = [line.reflectance for line in lines]
        strokes = [(number, piece, 0.5 * line.width + self._spot) for number, line in enumerate(lines) for piece in pieces(line)]
        self._cell = max(_CELL, sum(piece.length for _, piece, _ in strokes) * 10 / _MOST_CELLS, *(reach for _, _, reach in strokes), 0.0)
        self._cells: dict[tuple[int, int], list[tuple[int, Piece]]] = {}
        for number, piece, reach in strokes:
            for cell in _touched(piece, reach, self._cell):
                self._cells.setdefault(cell, []).append((number, piece))

    def __call__(self, x: float, y: float) -> float:
        cell = self._cells.get((floor(x / self._cell), floor(y / self._cell)))
        if cell is None:
            return 1.0
        nearest: dict[int, float] = {}
        for number, piece in cell:
            squared = piece.foot(x, y)[1]
            if squared < nearest.get(number, float("inf")):
                nearest[number] = squared
        light = 1.0
        for number, squared in nearest.items():
            distance, half, spot = sqrt(squared), self._halves[number], self._spot
            covered = (min(distance + spot, half) - max(distance - spot, -half)) / (2.0 * spot)
            if covered > 0.0:
                light += covered * (self._reflectances[number] - light)
        return light


def _touched(piece: Piece, reach: float, cell: float) -> Iterator[tuple[int, int]]:
    """The cells of a square mesh that come within `reach` of a piece, and some of their neighbours."""
    count = int(piece.length / cell) + 1
    seen = set()
    for step in range(count + 1):
        along = piece.length * step / count
        x, y = piece.x + along * piece.along_x, piece.y + along * piece.along_y
        for column in range(floor((x - reach - cell) / cell), floor((x + reach + cell) / cell) + 1):
            for row in range(floor((y - reach - cell) / cell), floor((y + reach + cell) / cell) + 1):
                if (column, row) not in seen:
                    seen.add((column, row))
                    yield column, row
