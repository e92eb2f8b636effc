"""Paths in the plane: along painted lines, and the shortest ones around solid objects.

`Follower` gives the place of a body beside and along a line, `PaintedGround` the reflectance of the ground.
Both use plain floats and only the segments near by, so that the cost does not grow with the length of a line.

`Ways` hands out readers of lengths. Each pair of bodies has a `DistanceField`, which is computed anew when
something in it has moved. `path_lengths` fills a field.

scipy's Dijkstra gives the same lengths on the same graph to 1.1e-5 m (10,000 random
arenas), in 5.0 ms a field against 7.3 ms here. It is not used: the last digits of its
lengths differ, and with them the rewards of shipped scenarios; importing it takes another 0.2 s of CPU.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from math import atan, atan2, cos, floor, hypot, pi, sqrt
from operator import mul
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from deepbots_cli.footprint import Patch, Spot
from deepbots_cli.frames import Quaternion, Triple, roll_pitch_yaw
from deepbots_cli.port import Engine, Part, PoseReader
from deepbots_cli.program import Program
from deepbots_cli.program.world import Line, ObjectBody
from deepbots_cli.runtime.placement import Area, Arrangement, Forms

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

MAX_CELLS = 100  # along the longer side of a field
MARGIN_CELLS = 2  # cells around the grid that no way enters: a knight's move leaps over one
UNREACHABLE_LENGTH = 1e4  # m; stands for "no way yet"
LENGTH_SCALE = 2.0 / (1.0 + 1.0 / cos(atan(0.5) / 2))  # of the lengths of 16 directions, to a mean error of 0
_CLEARANCE = 0.5  # m around everything, where no arena limits the ways
_MIN_OBSTACLE_HEIGHT_M = 1e-6  # m; an object that rises no higher is not an obstacle
_BARRED_COST = 50.0  # times; the price of a line through a barred place
_WIDE_AREA_M = 20.0  # m; wider areas have lengths in a longer unit, below `UNREACHABLE_LENGTH`
_OBSTACLE_OFFSET_M = 1e6  # m; lowers lengths beyond an obstacle, so that no length before it is smaller
_MAX_ROUNDS = 200
MOVES = ((0, 1), (1, 0), (1, 1), (1, -1), (1, 2), (1, -2), (2, 1), (2, -1))
"""Rows and columns of the moves between nodes; the way back of each is a move, too."""
_FieldInputs = tuple[Area, float, list[Patch], Spot, float]
"""The arguments of a field: the area, the disc that moves, the solids, the goal and its radius."""


class Ways:
    """Paths of robots and objects around the solid objects of a world; robots are not obstacles.

    A body moves as a disc as wide as its narrower side, since it can turn.
    """

    def __init__(self, scenario: Program, engine: Engine, bodies: Arrangement | None = None) -> None:
        """Create paths. `bodies` has the copies that take part; None in a world without groups."""
        world = scenario.world
        self._engine = engine
        self._bodies = bodies
        self._arena = world.arena
        self.forms = bodies.forms if bodies else Forms(world, scenario.reset.joint_positions)
        self._solids = [(body, engine.pose(body.name)) for body in world.objects if body.solid]
        self._ways: dict[tuple[Part, Part], _PathQuery] = {}

    def reset(self) -> None:
        """Begin an episode: each field is compared with the world before it is used again."""
        for query in self._ways.values():
            query.is_current = False

    def distance(self, start: Part, goal: Part) -> Callable[[], float]:
        """Return a reader of the length of the shortest path, m."""
        return self._way(start, goal).length

    def bearing(self, start: Part, goal: Part) -> Callable[[], float]:
        """Return a reader of the angle from the forward axis to where the shortest path leads, rad; left is
        positive."""
        return self._way(start, goal).bearing

    def reachable(self, start: Part, goal: Part) -> Callable[[], bool]:
        """Return a reader of whether there is a path."""
        return self._way(start, goal).is_open

    def _way(self, first: Part, second: Part) -> _PathQuery:
        if (first, second) not in self._ways:
            self._ways[first, second] = _PathQuery(
                self, first, second, self._engine.pose(*first), self._engine.pose(*second)
            )
        return self._ways[first, second]

    def last_read_paths(self) -> list[list[Spot]]:
        """Return the points of the shortest paths whose lengths were read last, from where the bodies are
        now; reading them changes nothing."""
        return [query.points() for query in self._ways.values()]

    def radius(self, part: Part) -> float:
        """Return the radius of the disc around a body; a link is a point."""
        return self.forms.footprint(part[0]).radius if part[1] is None else 0.0

    def is_fixed(self, part: Part) -> bool:
        return self.forms.is_fixed(part[0]) or (
            part[0] in self.forms.things and not self.forms.things[part[0]].solid
        )

    def solids(self, *but: str) -> Iterator[tuple[ObjectBody, PoseReader]]:
        """Return the solid objects of this episode."""
        placed = self._bodies.placed if self._bodies else ()
        return (
            (body, pose)
            for body, pose in self._solids
            if body.name not in but and (not body.pooled or body.name in placed)
        )

    def patch(self, body: ObjectBody, pose: tuple[Triple, Quaternion]) -> Patch | None:
        """Return the patch of an object at a pose; None if it does not rise above the ground."""
        (x, y, z), turn = pose
        rpy = roll_pitch_yaw(turn)
        if self.forms.top(body.name, z, rpy) <= _MIN_OBSTACLE_HEIGHT_M:
            return None
        return self.forms.footprint(body.name, rpy).at(x, y, rpy[2])

    def corner_distance(self, body: ObjectBody) -> float:
        """Return the distance of the corners of a standing object from its origin, m; 0 for a disc."""
        footprint = self.forms.footprint(body.name)
        return hypot(*footprint.middle) + footprint.radius if footprint.half else 0.0

    def area(self, patches: list[Patch], ends: tuple[Spot, Spot], radius: float) -> Area:
        """Return the inside of the arena; without an arena, the box around everything and `_CLEARANCE`."""
        if self._arena is not None:
            x, y = self._arena.size[0] / 2, self._arena.size[1] / 2
            return (-x, -y, x, y)
        spots = [*((patch.x, patch.y, patch.radius) for patch in patches), *((x, y, radius) for x, y in ends)]
        room = 2 * radius + _CLEARANCE
        return (
            min(x - r for x, _, r in spots) - room,
            min(y - r for _, y, r in spots) - room,
            max(x + r for x, _, r in spots) + room,
            max(y + r for _, y, r in spots) + room,
        )


class _PathQuery:
    """The way from one part of the world to another."""

    def __init__(
        self, ways: Ways, start: Part, goal: Part, start_pose: PoseReader, goal_pose: PoseReader
    ) -> None:
        self.is_current = False
        self._field: DistanceField | None = None
        self._shown: _FieldInputs | None = None
        self._ways = ways
        self._one, self._other = start, goal
        self._here, self._there = start_pose, goal_pose
        self._watched: list[tuple[PoseReader, float, float, Quaternion, float]] = []
        """The bodies that may move, where they were and how they were turned when the field was computed, and
        how far their corners are from their origins: 0 for discs."""

    def length(self) -> float:
        x, y, _ = self._here()[0]
        return self._current().length(x, y)

    def bearing(self) -> float:
        (x, y, _), turn = self._here()
        ahead_x, ahead_y = self._current().ahead(x, y)
        angle = atan2(ahead_y - y, ahead_x - x) - roll_pitch_yaw(turn)[2]
        # From -pi, excluded, to pi: the remainder has the sign of the divisor in Python.
        return pi - (pi - angle) % (2.0 * pi)

    def is_open(self) -> bool:
        x, y, _ = self._here()[0]
        return self._current().reaches(x, y)

    def points(self) -> list[Spot]:
        """Return the path in the field as it is, which is computed only when a length is read."""
        x, y, _ = self._here()[0]
        return self._field.path(x, y) if self._field is not None else []

    def _current(self) -> DistanceField:
        """Return the field; a new one where something has moved by more than a cell."""
        if self._field is None or not self.is_current:
            return self._renew()
        for read, x, y, turn, reach in self._watched:
            (now_x, now_y, _), now_turn = read()
            moved = hypot(now_x - x, now_y - y)
            if reach > 0.0:
                # A turn by an angle moves a corner by 2 * reach * sin(angle / 2).
                cosine = sum(map(mul, turn, now_turn))
                moved += 2.0 * reach * sqrt(max(0.0, 1.0 - cosine**2))
            if moved > self._field.cell:
                return self._renew()
        return self._field

    def _renew(self) -> DistanceField:
        """Return the field of the world as it is; the last one if it has the same arguments, as in a world
        whose bodies start where they did."""
        ways = self._ways
        goal, goal_turn = self._there()
        standing = [(body, read, read()) for body, read in ways.solids(self._one[0], self._other[0])]
        patches = [patch for body, _, pose in standing if (patch := ways.patch(body, pose)) is not None]
        self._watched = [
            (read, *pose[0][:2], pose[1], ways.corner_distance(body))
            for body, read, pose in standing
            if not ways.forms.is_fixed(body.name)
        ]
        if not ways.is_fixed(self._other):
            self._watched.append((self._there, goal[0], goal[1], goal_turn, 0.0))
        radius = ways.forms.half_width(self._one[0])
        x, y, _ = self._here()[0]
        area = ways.area(patches, ((x, y), goal[:2]), radius)
        inputs: _FieldInputs = (area, radius, patches, goal[:2], ways.radius(self._other))
        if self._field is None or inputs != self._shown:
            self._field = DistanceField(*inputs)
            self._shown = inputs
        self.is_current = True
        return self._field


class DistanceField:
    """The lengths of paths to a goal, by the place where they start.

    A path is that of the center of a disc of `radius`, and ends when the disc touches the disc of the goal. A
    place without a path, such as one at which the disc touches an obstacle, gets the length of the straight
    line to the nearest place with a path plus the length from there. So all lengths are finite.
    """

    def __init__(
        self, area: Area, radius: float, solids: Iterable[Patch], goal: Spot, goal_radius: float
    ) -> None:
        """Create a field. `area` is the inside of the walls, or the box that ways may cross; lengths in m."""
        self.cell = max(area[2] - area[0], area[3] - area[1], 1e-6) / MAX_CELLS
        (self._left, columns), (self._low, rows) = (
            _nodes(area[axis] + radius, area[axis + 2] - radius, self.cell) for axis in (0, 1)
        )
        self._x = self._left + self.cell * (np.arange(columns + 2 * MARGIN_CELLS) - MARGIN_CELLS)
        self._y = self._low + self.cell * (np.arange(rows + 2 * MARGIN_CELLS) - MARGIN_CELLS)
        self._outside: Mask = np.ones((len(self._y), len(self._x)), np.bool_)
        self._outside[MARGIN_CELLS:-MARGIN_CELLS, MARGIN_CELLS:-MARGIN_CELLS] = False
        blocked = self._outside.copy()
        for patch in solids:
            self._block(blocked, patch, radius)
        self._goal = goal
        self._radius = radius
        away = np.hypot(self._x - goal[0], (self._y - goal[1])[:, None])
        self._unit = max(1.0, self.cell * MAX_CELLS / _WIDE_AREA_M)
        self._step = self.cell / self._unit
        # A goal may be 0.71 cells from the nearest node, so nodes up to 1.5 cells away count.
        starts = np.where(
            (away <= max(radius + goal_radius, 1.5 * self.cell)) & ~blocked,
            away / self._unit,
            UNREACHABLE_LENGTH,
        )
        lengths = path_lengths(blocked, starts, self._step)
        self._reached: Mask = lengths < UNREACHABLE_LENGTH
        if not self._reached.any():  # The goal is enclosed: use straight lines.
            lengths = np.where(self._outside, UNREACHABLE_LENGTH, away / self._unit)
        self._found = lengths
        self._filled = False
        # Elements of lists are floats, and single numbers of numpy are slower to index and to compute with.
        self._lengths: list[list[float]] = lengths.tolist()
        self._open: list[list[bool]] = self._reached.tolist()
        self._rows, self._columns = rows, columns

    def _fill(self) -> None:
        """Give each node without a path the length of the nearest node with one, and of the line there.

        Straight lines have a high cost, so that the nearest node is chosen and not the one with the shortest
        path, which may be beyond a wall.
        """
        self._filled = True
        line = path_lengths(self._outside, np.where(self._reached, 0.0, UNREACHABLE_LENGTH), self._step)
        dear = path_lengths(
            self._outside, np.where(self._reached, self._found, UNREACHABLE_LENGTH), self._step * _BARRED_COST
        )
        self._found = np.where(self._reached | self._outside, self._found, dear - (_BARRED_COST - 1.0) * line)
        self._lengths = self._found.tolist()

    def _block(self, blocked: Mask, patch: Patch, radius: float) -> None:
        """Take away the nodes at which the disc would cut into a patch."""
        # Shorter by a micrometer: rounding must not block a disc that only touches the patch.
        reach = radius - 1e-6
        wide, deep = patch.half_extents
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
        """Return the length from a place to the goal, interpolated between four nodes; beyond the area, the
        distance to the area is added."""
        column, row = (x - self._left) / self.cell, (y - self._low) / self.cell
        inside_column = min(max(column, 0.0), self._columns - 1.0)
        inside_row = min(max(row, 0.0), self._rows - 1.0)
        # At the last node there is no cell beyond: u or v is 1 in the cell before.
        i, j = min(int(inside_column), self._columns - 2), min(int(inside_row), self._rows - 2)
        u, v = inside_column - i, inside_row - j
        i, j = i + MARGIN_CELLS, j + MARGIN_CELLS
        row_lengths, next_lengths = self._lengths[j], self._lengths[j + 1]
        # One of the four nodes has no path.
        if (
            not self._filled
            and row_lengths[i] + row_lengths[i + 1] + next_lengths[i] + next_lengths[i + 1]
            >= UNREACHABLE_LENGTH
        ):
            self._fill()
            return self.length(x, y)
        low = row_lengths[i] + u * (row_lengths[i + 1] - row_lengths[i])
        length = low + v * (next_lengths[i] + u * (next_lengths[i + 1] - next_lengths[i]) - low)
        if column == inside_column and row == inside_row:
            return length * self._unit
        return length * self._unit + self.cell * hypot(column - inside_column, row - inside_row)

    def ahead(self, x: float, y: float) -> Spot:
        """Return the first place on the way that is farther away than the radius of the disc and a cell, or
        the goal.

        If no way begins, such as beside an obstacle that the disc touches, the way is that of the nearest
        node with one.
        """
        limit = self._radius + self.cell
        points = self.path(x, y, limit)
        if len(points) == 1 and self._reached.any():
            away = np.where(self._reached, np.hypot(self._x - x, (self._y - y)[:, None]), np.inf)
            row, column = divmod(int(away.argmin()), away.shape[1])
            points = self.path(float(self._x[column]), float(self._y[row]), limit)
        return points[-1] if len(points) > 1 else self._goal

    def path(self, x: float, y: float, limit: float = float("inf")) -> list[Spot]:
        """Return a place, the nodes of a shortest way from it, and the goal, m; the place alone if no way
        begins there.

        The way ends with the first node that is farther from the place than `limit`.
        """
        points = [(x, y)]
        column = min(max(round((x - self._left) / self.cell), 0), self._columns - 1) + MARGIN_CELLS
        row = min(max(round((y - self._low) / self.cell), 0), self._rows - 1) + MARGIN_CELLS
        while self._reached[row, column] and hypot(points[-1][0] - x, points[-1][1] - y) <= limit:
            points.append((float(self._x[column]), float(self._y[row])))
            # The length of a node is that of the next node and of the move there.
            length = self._found[row, column]
            nodes = [
                (row + sign * up, column + sign * aside, hypot(up, aside))
                for up, aside in MOVES
                for sign in (1, -1)
            ]
            misfit, row, column = min(
                (abs(self._found[i, j] + self._step * LENGTH_SCALE * move - length), i, j)
                for i, j, move in nodes
            )
            if misfit > 1e-6 or self._found[row, column] >= length:
                return [*points, self._goal]
        return points

    def reaches(self, x: float, y: float) -> bool:
        """Return whether there is a way from a place, or from a node beside it."""
        i = min(max(int((x - self._left) / self.cell), 0), self._columns - 2) + MARGIN_CELLS
        j = min(max(int((y - self._low) / self.cell), 0), self._rows - 2) + MARGIN_CELLS
        open_row, next_row = self._open[j], self._open[j + 1]
        return open_row[i] or open_row[i + 1] or next_row[i] or next_row[i + 1]


def _nodes(low: float, high: float, cell: float) -> tuple[float, int]:
    """Return the place of the first node between two ends, about their middle, and the number of nodes: two
    at least."""
    # Where the ends are a whole number of cells apart, rounding must not lose a node.
    count = max(2, int((high - low) / cell + 1e-6) + 1)
    return (low + high - (count - 1) * cell) / 2, count


class _GridLines:
    """All straight lines of a grid in one direction, and where obstacles part them."""

    def __init__(self, blocked: Mask, rows: int, columns: int, cell: float) -> None:
        width = blocked.shape[1]
        self.stride = rows * width + columns
        self.length = -(-blocked.size // self.stride)
        self.padding = self.length * self.stride - blocked.size
        broken = blocked.copy()
        for row, column in passed_cells(rows, columns):
            broken |= np.roll(blocked, (row, column), (0, 1))  # any blocked cell that a move touches bars it
        step = cell * LENGTH_SCALE * hypot(rows, columns)
        walls = np.cumsum(self.view(broken.ravel().astype(np.float64), 1.0), axis=0)
        back = np.cumsum(
            self.view(np.roll(broken.ravel(), -self.stride).astype(np.float64), 1.0)[::-1], axis=0
        )
        along = step * np.arange(self.length, dtype=np.float64)[:, None]
        self.forward = along + _OBSTACLE_OFFSET_M * walls
        self.backward = along + _OBSTACLE_OFFSET_M * back

    def view(self, flat: Array, fill: float) -> Array:
        """Return each line as a column."""
        padded = np.concatenate([flat, np.full(self.padding, fill)]) if self.padding else flat
        return padded.reshape(self.length, self.stride)

    def sweep(self, lengths: Array) -> Array:
        """Return the lengths when ways may also go along these lines, either way."""
        lines = self.view(lengths, UNREACHABLE_LENGTH)
        # The minimum over j <= i of lines[j] + (forward[i] - forward[j]); obstacles are very long.
        ahead = np.minimum.accumulate(lines - self.forward, axis=0)
        ahead += self.forward
        behind = np.minimum.accumulate(lines[::-1] - self.backward, axis=0)
        behind += self.backward
        return np.minimum(np.minimum(lines, ahead), behind[::-1]).ravel()[: lengths.size]


def passed_cells(rows: int, columns: int) -> tuple[tuple[int, int], ...]:
    """Return the cells that a move passes before it ends, as seen from its end: they are shifted onto it."""
    side = 1 if columns > 0 else -1
    if abs(rows) + abs(columns) == 1:
        return ()
    if abs(rows) == abs(columns):
        return ((1, 0), (0, side))
    return ((1, 0), (1, side)) if rows == 2 else ((0, side), (1, side))


def path_lengths(blocked: Mask, starts: Array, cell: float) -> Array:
    """Return the length of the shortest way from each node to a start, plus the length of that start;
    `UNREACHABLE_LENGTH` where there is none.

    A way goes from node to node in 16 directions. Its length differs from the straight line's by less than 3
    %; all are scaled so that the error is the same either side. One sweep of numpy (`minimum.accumulate`
    along every line of the grid) takes straight stretches of any length, so that a field costs a few sweeps
    per bend of its ways and not one per cell.

    Args:
        blocked: Nodes that no way passes, with a margin of blocked ones all around, shape (rows, columns).
        starts: Lengths at which ways may end, UNREACHABLE_LENGTH elsewhere, of the same shape.
        cell: The distance of neighboring nodes, m.
    """
    directions = [_GridLines(blocked, rows, columns, cell) for rows, columns in MOVES]
    lengths = starts.ravel().copy()
    barred = blocked.ravel()
    lengths[barred] = UNREACHABLE_LENGTH
    for _ in range(_MAX_ROUNDS):
        before = lengths
        for lines in directions:
            lengths = lines.sweep(lengths)
            lengths[barred] = UNREACHABLE_LENGTH
        if not np.any(before - lengths > 1e-6):
            break
    return lengths.reshape(blocked.shape)


# Painted lines

_CELL = 0.1  # m, at least; the mesh in which `PaintedGround` sorts the pieces
_MOST_CELLS = 100_000


class Segment(NamedTuple):
    """A straight piece: where it begins (m), its direction, its length (m), how far along the line it begins
    (m)."""

    x: float
    y: float
    along_x: float
    along_y: float
    length: float
    start: float

    def nearest_point(self, x: float, y: float) -> tuple[float, float, float]:
        """Return the nearest of its points to (x, y): how far along the piece, the distance squared, and the
        side (left positive)."""
        dx, dy = x - self.x, y - self.y
        along = min(max(dx * self.along_x + dy * self.along_y, 0.0), self.length)
        off_x, off_y = dx - along * self.along_x, dy - along * self.along_y
        return along, off_x * off_x + off_y * off_y, self.along_x * dy - self.along_y * dx


def line_segments(line: Line) -> list[Segment]:
    segments = []
    start = 0.0
    for (x, y), (end_x, end_y) in line.pieces:
        length = hypot(end_x - x, end_y - y)
        if length > 0.0:
            segments.append(Segment(x, y, (end_x - x) / length, (end_y - y) / length, length, start))
        start += length
    return segments


class Follower:
    """Follows one body along one line.

    It keeps to the part of the line where the body was, so that a line may cross itself or come near itself:
    it looks as far along the line as the body moved and as it is beside it, twice over, and a width more.
    """

    def __init__(self, line: Line) -> None:
        self._pieces = line_segments(line)
        self._length = line.length
        self._closed = line.closed
        self._width = line.width
        self.reset()

    def reset(self) -> None:
        """Begin an episode: the next place is where the way along the line begins."""
        self._at = -1  # the piece that the body is beside; none yet
        self._position = (0.0, 0.0)
        self._cross_track_error = self._arc_length = self._arc = 0.0

    def __call__(self, position: Sequence[float]) -> tuple[float, float]:
        """Return how far the body is to the left of the line, and how far it has come along it since the
        reset, in m.

        The way along a closed line goes on growing from lap to lap. Calling it twice at one place changes
        nothing.
        """
        x, y = position[0], position[1]
        if self._at < 0:
            candidates: Iterable[int] = range(len(self._pieces))
        elif (x, y) == self._position:
            return self._cross_track_error, self._arc_length
        else:
            moved = hypot(x - self._position[0], y - self._position[1])
            candidates = self._near(2.0 * (moved + abs(self._cross_track_error)) + self._width)
        at = max(self._at, 0)
        arc = self._arc
        nearest = float("inf")
        side = nearest_along = 0.0
        for index in candidates:
            piece = self._pieces[index]
            along, squared, left = piece.nearest_point(x, y)
            if squared < nearest:
                arc = piece.start + along
                nearest = squared
                side = left
                nearest_along = along
                at = index
        if (neighbor := self._neighbor(at, nearest_along)) is not None:
            # At a corner, the normal is the sum of those of both pieces: the side of one alone changes
            # its sign outside of a corner that turns by more than 90 deg.
            side += neighbor.nearest_point(x, y)[2]
        if self._at >= 0:
            step = arc - self._arc
            # From the end of a lap to its beginning, the shorter way around is a small step.
            self._arc_length += step - self._length * round(step / self._length) if self._closed else step
        self._at = at
        self._arc = arc
        self._position = (x, y)
        self._cross_track_error = sqrt(nearest) if side >= 0.0 else -sqrt(nearest)
        return self._cross_track_error, self._arc_length

    def _neighbor(self, index: int, along: float) -> Segment | None:
        """Return the piece that shares the corner at a place along a piece; None between corners, and at the
        ends of an open line."""
        if 0.0 < along < self._pieces[index].length:
            return None
        index += 1 if along > 0.0 else -1
        if not (self._closed or 0 <= index < len(self._pieces)):
            return None
        return self._pieces[index % len(self._pieces)]

    def _near(self, reach: float) -> Iterator[int]:
        """Yield pieces that begin or end within `reach` along the line of the body's last place, that one
        first."""
        count = len(self._pieces)
        piece = self._pieces[self._at]
        yield self._at
        for sign, distance in ((1, piece.start + piece.length - self._arc), (-1, self._arc - piece.start)):
            index = self._at
            for _ in range(count - 1):
                index += sign
                if distance > reach or not (self._closed or 0 <= index < count):
                    break
                index %= count
                distance += self._pieces[index].length
                yield index


class PaintedGround:
    """The reflectance of the ground at a position: 1 where nothing is painted. A later line covers an earlier
    one."""

    def __init__(self, lines: Sequence[Line], spot: float) -> None:
        """Create the ground. `spot` is the radius (m) of the patch of ground that is measured, over which the
        light is a mean."""
        self._spot = max(spot, 1e-6)
        self._halves = [0.5 * line.width for line in lines]
        self._reflectances = [line.reflectance for line in lines]
        strokes = [
            (number, piece, 0.5 * line.width + self._spot)
            for number, line in enumerate(lines)
            for piece in line_segments(line)
        ]
        self._cell = max(
            _CELL,
            sum(piece.length for _, piece, _ in strokes) * 10 / _MOST_CELLS,
            *(reach for _, _, reach in strokes),
            0.0,
        )
        self._cells: dict[tuple[int, int], list[tuple[int, Segment]]] = {}
        for number, piece, reach in strokes:
            for cell in _touched(piece, reach, self._cell):
                self._cells.setdefault(cell, []).append((number, piece))

    def __call__(self, x: float, y: float) -> float:
        cell = self._cells.get((floor(x / self._cell), floor(y / self._cell)))
        if cell is None:
            return 1.0
        nearest: dict[int, float] = {}
        for number, piece in cell:
            squared = piece.nearest_point(x, y)[1]
            if squared < nearest.get(number, float("inf")):
                nearest[number] = squared
        light = 1.0
        for number, squared in nearest.items():
            distance = sqrt(squared)
            half = self._halves[number]
            spot = self._spot
            covered = (min(distance + spot, half) - max(distance - spot, -half)) / (2.0 * spot)
            if covered > 0.0:
                light += covered * (self._reflectances[number] - light)
        return light


def _touched(piece: Segment, reach: float, cell: float) -> Iterator[tuple[int, int]]:
    """Yield the cells of a square mesh that come within `reach` of a piece, and some of their neighbors."""
    count = int(piece.length / cell) + 1
    cells = set()
    for step in range(count + 1):
        along = piece.length * step / count
        x, y = piece.x + along * piece.along_x, piece.y + along * piece.along_y
        for column in range(floor((x - reach - cell) / cell), floor((x + reach + cell) / cell) + 1):
            for row in range(floor((y - reach - cell) / cell), floor((y + reach + cell) / cell) + 1):
                if (column, row) not in cells:
                    cells.add((column, row))
                    yield column, row
