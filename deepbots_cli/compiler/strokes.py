"""What runs along straight pieces: lines painted on the ground, and walls."""

from __future__ import annotations

import math
from collections.abc import Sequence

from deepbots_cli.compiler.colours import colour
from deepbots_cli.compiler.namespace import Namespace
from deepbots_cli.compiler.scopes import ParameterScope
from deepbots_cli.compiler.variations import figure
from deepbots_cli.document.nodes import Path
from deepbots_cli.expressions.dimensions import LENGTH, NUMBER
from deepbots_cli.expressions.types import PLANE, Context
from deepbots_cli.program.world import MAX_POINTS, WALL_COLOUR, Line, ObjectBody, Point
from deepbots_cli.robots.model import Box, Pose
from deepbots_cli.scenario.fields import COLOURS
from deepbots_cli.scenario.scenario import Scenario
from deepbots_cli.scenario.world import Line as LineSpec
from deepbots_cli.scenario.world import Wall as WallSpec


def lines(spec: Scenario, namespace: Namespace) -> tuple[Line, ...]:
    """The painted lines; their lengths are noted in the namespace."""
    scope = ParameterScope(namespace, Context.FIXED)
    found = [_line(name, line, namespace, scope) for name, line in spec.world.lines.items()]
    known = tuple(line for line in found if line is not None)
    if sum(len(line.points) for line in known) > MAX_POINTS:
        headline = f"the lines have more than {MAX_POINTS:_} points together"
        namespace.values.findings.add("DB005", namespace.values.key_span(("world", "lines")), headline, help="leave out points")
    namespace.lengths |= {line.name: line.length for line in known}
    return known


def _line(name: str, spec: LineSpec, namespace: Namespace, scope: ParameterScope) -> Line | None:
    path: Path = ("world", "lines", name)
    points = _points(spec, path, namespace, scope)
    width = namespace.values.number((*path, "width"), spec.width, LENGTH, scope)
    reflectance = namespace.values.number((*path, "reflectance"), spec.reflectance, NUMBER, scope)
    if points is None or width is None or reflectance is None:
        namespace.values.lose(name)
        return None
    paint = colour(namespace, (*path, "colour"), spec.colour)
    return Line(name, points, spec.closed, width, reflectance, paint or (*COLOURS["black"], 1.0))


def _points(spec: LineSpec | WallSpec, path: Path, namespace: Namespace, scope: ParameterScope) -> tuple[Point, ...] | None:
    """The corners; None after a finding."""
    values = namespace.values
    found = [values.numbers((*path, "through", index), given, LENGTH, PLANE, scope) for index, given in enumerate(spec.through)]
    points = [(point[0], point[1]) for point in found if point is not None]
    if len(points) < len(found):
        return None
    for index, (one, other) in enumerate(zip(points, [*points[1:], points[0]] if spec.closed else points[1:], strict=False)):
        if one == other:
            after = (index + 1) % len(points)
            headline = "two points in a row are the same" if after else "the last point is the first one again"
            help = "leave one of them out" if after else "leave it out; `closed: true` joins the ends"
            values.findings.add("DB105", values.span((*path, "through", after or index)), headline, help=help)
            return None
    return tuple(points)


def walls(spec: Scenario, namespace: Namespace) -> tuple[ObjectBody, ...]:
    """The walls, a fixed box for each straight piece; those around an arena are the engine's."""
    scope = ParameterScope(namespace, Context.FIXED)
    return tuple(box for name, wall in spec.world.walls.items() for box in _wall(name, wall, namespace, scope))


def pieces(name: str, spec: WallSpec) -> tuple[str, ...]:
    """The names of the boxes of a wall; the blank keeps them apart from every object."""
    return tuple(f"{name} {number}" for number in range(1, len(spec.through) + (1 if spec.closed else 0)))


def _wall(name: str, spec: WallSpec, namespace: Namespace, scope: ParameterScope) -> Sequence[ObjectBody]:
    path: Path = ("world", "walls", name)
    points = _points(spec, path, namespace, scope)
    height = namespace.values.number((*path, "height"), spec.height, LENGTH, scope)
    thickness = namespace.values.number((*path, "thickness"), spec.thickness, LENGTH, scope)
    ends = () if points is None else (*points[1:], points[0]) if spec.closed else points[1:]
    names = pieces(name, spec)
    drawn = ParameterScope(namespace, Context.FIELD)
    friction = figure(namespace, (*path, "friction"), spec.friction, NUMBER, drawn, "walls_friction", names)
    if points is None or height is None or thickness is None or friction is None:
        namespace.values.lose(name)
        return ()
    paint = colour(namespace, (*path, "colour"), spec.colour) or WALL_COLOUR
    boxes = []
    for piece, one, other in zip(names, points, ends, strict=False):
        heading = math.atan2(other[1] - one[1], other[0] - one[0])
        middle = ((one[0] + other[0]) / 2, (one[1] + other[1]) / 2, height / 2)
        box = Box((math.dist(one, other) + thickness, thickness, height))  # so that corners are closed
        boxes.append(ObjectBody(piece, box, Pose(middle, (0.0, 0.0, heading)), colour=paint, friction=friction, fixed=True))
    return boxes
