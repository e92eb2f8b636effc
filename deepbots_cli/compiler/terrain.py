"""Ground that is not flat."""

from __future__ import annotations

import math

from deepbots_cli.compiler.colours import colour
from deepbots_cli.compiler.files import mesh, picture
from deepbots_cli.compiler.namespace import Namespace
from deepbots_cli.compiler.scopes import ParameterScope
from deepbots_cli.compiler.variations import figure
from deepbots_cli.document.nodes import Path
from deepbots_cli.expressions.dimensions import LENGTH, NUMBER
from deepbots_cli.expressions.intervals import Interval
from deepbots_cli.expressions.lower import lower, op
from deepbots_cli.expressions.scalar import Const, Name, Op, Scalar
from deepbots_cli.expressions.types import PLANE, Context, Stage, Symbol, Type
from deepbots_cli.program.world import GROUND, Formula, Picture, Pit, Terrain, TerrainShape
from deepbots_cli.scenario import world as spec

_PATH: Path = ("world", "terrain")
_RIM = 2.7 * math.sqrt(2.0 * math.log(2.0))  # m; where that of a pit of 20 m is
_HIGHEST = 1e4  # m
_TRIED = 8  # places along either side at which a formula is tried


def terrain(given: spec.Terrain, namespace: Namespace) -> Terrain | None:
    """The terrain; None after a finding."""
    drawn = ParameterScope(namespace, Context.FIELD)
    friction = figure(namespace, (*_PATH, "friction"), given.friction, NUMBER, drawn, "lateral_friction", (GROUND, ""))
    paint = colour(namespace, (*_PATH, "colour"), given.colour, (GROUND, ""))
    relief = _relief(given, namespace, ParameterScope(namespace, Context.FIXED))
    return None if relief is None else Terrain(relief, 1.0 if friction is None else friction, paint)


def _relief(given: spec.Terrain, namespace: Namespace, scope: ParameterScope) -> TerrainShape | None:
    values = namespace.values
    match given:
        case spec.Pit():
            height = values.number((*_PATH, "height"), given.height, LENGTH, scope)
            radius = _RIM if given.radius is None else values.number((*_PATH, "radius"), given.radius, LENGTH, scope)
            noise = values.number((*_PATH, "noise"), given.noise, NUMBER, scope)
            return None if height is None or radius is None or noise is None else Pit(height, radius, noise)
        case spec.MeshTerrain():
            if given.file.lower().endswith(".dae"):
                headline = "ground from a COLLADA file"
                values.findings.add("DB104", values.span((*_PATH, "file")), headline, help="convert it to STL or OBJ")
                return None
            return mesh(namespace, _PATH, given.file, given.scale)
        case spec.Heightfield():
            file = picture(namespace, (*_PATH, "file"), given.file)
            size = values.numbers((*_PATH, "size"), given.size, LENGTH, PLANE, scope)
            height = values.number((*_PATH, "height"), given.height, LENGTH, scope)
            return None if file is None or size is None or height is None else Picture(*file, (size[0], size[1]), height)
        case spec.Formula():
            size = values.numbers((*_PATH, "size"), given.size, LENGTH, PLANE, scope)
            return None if size is None else _formula(given, (size[0], size[1]), namespace)
    return None


def _formula(given: spec.Formula, size: tuple[float, float], namespace: Namespace) -> Formula | None:
    values, path = namespace.values, (*_PATH, "heights")
    sides = {name: Type(LENGTH, interval=Interval(-side / 2, side / 2), stage=Stage.STEP) for name, side in zip(PLANE, size, strict=True)}
    scope = ParameterScope(namespace, Context.FIXED, {name: Symbol(name, known) for name, known in sides.items()})
    text = values.text(path, given.heights)
    typed = values.quantity(text, "`heights`", scope, LENGTH, None, Stage.STEP)
    if typed is None:
        return None
    (heights,) = lower(typed, "world.terrain.heights")
    steps = [step / _TRIED - 0.5 for step in range(_TRIED + 1)]
    for x, y in ((along_x * size[0], along_y * size[1]) for along_y in steps for along_x in steps):
        found = _at(heights, {"x": x, "y": y})
        if not (isinstance(found, Const) and abs(found.value) < _HIGHEST):
            headline = f"the ground has no height, or one beyond 10 km, at x = {x:g} m, y = {y:g} m"
            values.findings.add("DB105", text.span, headline, help="it divides by zero, leaves the domain of a function, or is too large")
            return None
    return Formula(heights, size)


def _at(heights: Scalar, place: dict[str, float]) -> Scalar:
    """The formula at one place: a number, where it has one."""
    match heights:
        case Name(name=name) if name in place:
            return Const(place[name])
        case Op(op=operation, args=args):
            return op(operation, *(_at(arg, place) for arg in args))
        case _:
            return heights
