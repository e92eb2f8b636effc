"""The world: timestep, ground, arena, terrain, painted lines, walls and objects, with the files that they are
made from."""

from __future__ import annotations

import hashlib
import math
import re
from collections.abc import Sequence
from dataclasses import fields, replace
from pathlib import Path as FilePath
from typing import TYPE_CHECKING, Any, cast, get_args

from deepbots_cli.compiler.namespace import Namespace, Origin
from deepbots_cli.compiler.robots import ResolvedRobot, locate_file
from deepbots_cli.diagnostics import Edit, Fix
from deepbots_cli.document.nodes import NodePath
from deepbots_cli.expressions.dimensions import LENGTH
from deepbots_cli.expressions.intervals import Interval
from deepbots_cli.expressions.lower import fold_operation, lower
from deepbots_cli.expressions.scalar import Const, Name, Op, Scalar, is_drawn, names_in
from deepbots_cli.expressions.types import PLANE, Context, Known, Symbol, ValueType
from deepbots_cli.files import read_at_most
from deepbots_cli.pictures import MAX_PICTURE_BYTES, picture_problem
from deepbots_cli.program.resets import ObjectGroup, OfLink, OfWalls, OfWorld
from deepbots_cli.program.world import (
    ARENA_WALLS,
    GROUND,
    MAX_BODIES,
    MAX_POINTS,
    TILE_MARGIN_M,
    WALL_COLOR,
    Arena,
    Color,
    Formula,
    Ground,
    Line,
    LinkParameter,
    ObjectBody,
    Picture,
    Pit,
    Point,
    RobotBody,
    Terrain,
    TerrainShape,
    Tile,
    Tiles,
    Variant,
    WorldModel,
    WorldParameter,
)
from deepbots_cli.robots import meshes
from deepbots_cli.robots.meshes import mesh_size
from deepbots_cli.robots.model import Box, Capsule, Cylinder, Mesh, Pose, Shape, Sphere, volume
from deepbots_cli.robots.packages import UnusableMesh
from deepbots_cli.scenario import world as world_spec
from deepbots_cli.scenario.base import Section
from deepbots_cli.scenario.fields import COLORS

if TYPE_CHECKING:
    from deepbots_cli.scenario import objects as object_spec
    from deepbots_cli.scenario import terrains as terrain_spec

MAX_TRIANGLES = 200_000
# Sizes in m; beyond the inner two a mesh is probably in another unit.
_MIN_MESH_M = 1e-5
_SMALL_MESH_M = 1e-4
_LARGE_MESH_M = 1e3
_MAX_MESH_M = 1e6

_PIT_RIM_M = 2.7 * math.sqrt(2.0 * math.log(2.0))  # m; where that of a pit of 20 m is
_MAX_HEIGHT_M = 1e4
_FORMULA_SAMPLES = 8  # places along either side at which a formula is tried

_TILE_LENGTHS = ("side", "platform", "border", "cell")
_MAX_HEIGHTS = 2_000_000
_MAX_SLOPE = math.radians(80.0)  # rad; its tangent is 5.7, that of a right angle has no end
_TOLERANCE = 1e-6  # of a multiple, as a share of a cell

_WATER_DENSITY = 1000.0  # kg/m^3, the default density of objects
_DEFAULT_COLOR: Color = (*COLORS["gray"], 1.0)
_OF_ALL = ("solid", "spinning_friction", "rolling_friction", "restitution")

# Seconds: a timestep beyond the outer two cannot be run, one beyond the inner two is hardly meant.
_MIN_TIMESTEP_S = 1e-6
_SHORT_TIMESTEP_S = 1e-4
_LONG_TIMESTEP_S = 1.0
_MAX_TIMESTEP_S = 10.0


def define_bodies(namespace: Namespace) -> None:
    """Give robots, objects, walls and lines their names, and groups their size."""
    spec = namespace.scenario
    for name in spec.robots:
        namespace.define(name, Origin.ROBOT, ("robots", name))
    for name, body in spec.objects.items():
        namespace.define(name, Origin.OBJECT, ("objects", name))
        if body.count is not None:
            group = _group(name, body, namespace)
            namespace.groups |= {name: group} if group else {}
            if group is None:
                namespace.values.mark_invalid(name)
    for name, wall in spec.world.walls.items():
        namespace.define(name, Origin.WALL, ("world", "walls", name))
        if namespace.origin(name) is Origin.WALL:
            namespace.walls[name] = wall_piece_names(name, wall)
    if spec.world.arena is not None:
        namespace.walls["arena"] = ARENA_WALLS
    for name in spec.world.lines:
        namespace.define(name, Origin.LINE, ("world", "lines", name))


def _group(name: str, body: world_spec.PlacedBody, namespace: Namespace) -> ObjectGroup | None:
    """Return the group of an object with a `count`; None after a finding.

    There are as many bodies as the greatest count, and one at least; an episode without copies leaves them
    absent.
    """
    values = namespace.values
    count = namespace.fields.expression(body, "count")
    if count is None:
        return None
    highest = count.typed.type.interval.high
    if not math.isfinite(highest):
        values.add(
            "DB105", count.span, "a count without a maximum", "draw it from a range: `integer(1 .. 10)`"
        )
        return None
    if highest > MAX_BODIES:
        values.add(
            "DB005",
            count.span,
            f"the count can be {highest:,.0f}; the limit is {MAX_BODIES}",
            "use fewer bodies: an engine would take minutes to build this world",
        )
        return None
    return ObjectGroup(name, max(1, int(highest)), count)


def mesh(namespace: Namespace, spec: object_spec.Mesh | terrain_spec.MeshTerrain) -> Mesh | None:
    """Return the mesh file of an object or a terrain; None after a finding."""
    values = namespace.values
    reference = spec.file
    key_path = (*spec.path, "file")
    factors = (1.0, 1.0, 1.0) if spec.scale is None else namespace.fields.triple(spec, "scale")
    path = locate_file(reference, values.span(key_path), namespace.document, values)
    if path is None or factors is None:
        return None
    loaded = meshes.MeshReader(lambda _reference: path).load(reference, factors)
    if isinstance(loaded, UnusableMesh):
        values.add("DB301", key_path, loaded.headline, loaded.help)
        return None
    if 0.0 in factors:
        values.add(
            "DB105", (*spec.path, "scale"), "a mesh cannot be scaled by 0", "write factors other than 0"
        )
        return None
    namespace.files[key_path] = path
    mesh_shape = Mesh(str(loaded[0]), loaded[1], factors)
    return mesh_shape if _is_sensible(namespace, key_path, path, mesh_shape) else None


def _is_sensible(namespace: Namespace, path: NodePath, file: FilePath, mesh: Mesh) -> bool:
    """Return whether an engine can hold so many triangles; a size that is hardly meant is a warning."""
    values = namespace.values
    measured = mesh_size(file.suffix.lower(), meshes.read_mesh(file))
    if measured.triangles > MAX_TRIANGLES:
        values.add(
            "DB005",
            path,
            f"the mesh has {measured.triangles:,} triangles; the limit is {MAX_TRIANGLES:,}",
            "simplify it",
        )
        return False
    size = [
        abs(factor) * (high - low)
        for factor, low, high in zip(mesh.scale, measured.lower, measured.upper, strict=True)
    ]
    if _SMALL_MESH_M <= max(size) <= _LARGE_MESH_M:
        code = None
    elif _MIN_MESH_M <= max(size) <= _MAX_MESH_M:
        code = "DB505"
    else:
        code = "DB105"
    if code is not None:
        dimensions = " x ".join(f"{side:.3g}" for side in size)
        values.add(
            code,
            path,
            f"the mesh is {dimensions} m in size",
            "a mesh in millimeters needs `scale: 0.001 0.001 0.001`",
        )
    return code != "DB105"


def picture(namespace: Namespace, path: NodePath, reference: str) -> tuple[str, str] | None:
    """Return the path and the digest of a gray picture; None after a finding."""
    span = namespace.values.span(path)
    located = locate_file(reference, span, namespace.document, namespace.values)
    if located is None:
        return None
    # One byte more than allowed shows `picture_problem` that the file is too large.
    data = read_at_most(located, MAX_PICTURE_BYTES + 1)
    wrong = picture_problem(data)
    if wrong is not None:
        namespace.values.add(
            "DB103", span, wrong, "save it as a gray PNG of 8 or 16 bits, without interlacing"
        )
        return None
    namespace.files[path] = located
    return str(located), hashlib.sha256(data).hexdigest()


def lines(namespace: Namespace) -> tuple[Line, ...]:
    """Return the painted lines; their lengths are noted in the namespace."""
    compiled = [_line(name, line, namespace) for name, line in namespace.scenario.world.lines.items()]
    complete = tuple(line for line in compiled if line is not None)
    if sum(len(line.points) for line in complete) > MAX_POINTS:
        namespace.values.add_at_key(
            "DB005",
            ("world", "lines"),
            f"the lines together have more than {MAX_POINTS:,} points",
            "leave out points",
        )
    namespace.lengths |= {line.name: line.length for line in complete}
    return complete


def _line(name: str, spec: world_spec.Line, namespace: Namespace) -> Line | None:
    points = _points(spec, namespace)
    width, reflectance = namespace.fields.fixed(spec, "width"), namespace.fields.fixed(spec, "reflectance")
    if points is None or width is None or reflectance is None:
        namespace.values.mark_invalid(name)
        return None
    return Line(
        name, points, spec.closed, width, reflectance, namespace.fields.color(spec) or (*COLORS["black"], 1.0)
    )


def _points(spec: world_spec.Line | world_spec.Wall, namespace: Namespace) -> tuple[Point, ...] | None:
    """Return the corners; None after a finding."""
    corners = [namespace.fields.pair(spec, "points", index) for index in range(len(spec.points))]
    points = [point for point in corners if point is not None]
    if len(points) < len(corners):
        return None
    for index, (start, end) in enumerate(
        zip(points, [*points[1:], points[0]] if spec.closed else points[1:], strict=False)
    ):
        if start == end:
            after = (index + 1) % len(points)
            headline = (
                "two points in a row are the same" if after else "the last point repeats the first point"
            )
            help = "leave one of them out" if after else "remove it; `closed: true` already joins the ends"
            namespace.values.add(
                "DB105", namespace.values.span((*spec.path, "points", after or index)), headline, help
            )
            return None
    return tuple(points)


def walls(namespace: Namespace) -> tuple[ObjectBody, ...]:
    """Return the walls, a fixed box for each straight piece; the engine makes the walls around an arena."""
    return tuple(
        box for name, wall in namespace.scenario.world.walls.items() for box in _wall(name, wall, namespace)
    )


def wall_piece_names(name: str, spec: world_spec.Wall) -> tuple[str, ...]:
    """Return the names of the boxes of a wall; the blank keeps them apart from every object."""
    return tuple(f"{name} {number}" for number in range(1, len(spec.points) + (1 if spec.closed else 0)))


def _wall(name: str, spec: world_spec.Wall, namespace: Namespace) -> Sequence[ObjectBody]:
    points = _points(spec, namespace)
    height, thickness = namespace.fields.fixed(spec, "height"), namespace.fields.fixed(spec, "thickness")
    names = wall_piece_names(name, spec)
    friction = namespace.fields.scalar_or_randomized(spec, "friction", "walls_friction", OfWalls(names), None)
    if points is None or height is None or thickness is None or friction is None:
        namespace.values.mark_invalid(name)
        return ()
    paint = namespace.fields.color(spec) or WALL_COLOR
    boxes = []
    ends = (*points[1:], points[0]) if spec.closed else points[1:]
    for piece, start, end in zip(names, points, ends, strict=False):
        # The longer side of the box is along its x axis, and yaw 0 is along x of the world.
        heading = math.atan2(end[1] - start[1], end[0] - start[0])
        middle = ((start[0] + end[0]) / 2, (start[1] + end[1]) / 2, height / 2)
        box = Box((math.dist(start, end) + thickness, thickness, height))  # so that corners are closed
        boxes.append(
            ObjectBody(
                piece, box, Pose(middle, (0.0, 0.0, heading)), color=paint, friction=friction, fixed=True
            )
        )
    return boxes


def terrain(spec: world_spec.Terrain, namespace: Namespace) -> Terrain | None:
    """Return the terrain; None after a finding."""
    friction = namespace.fields.scalar_or_randomized(
        spec, "friction", "lateral_friction", OfLink(GROUND), 1.0
    )
    paint = namespace.fields.color(spec, OfLink(GROUND))
    relief = _relief(spec, namespace)
    return None if relief is None else Terrain(relief, friction, paint)


def _relief(spec: world_spec.Terrain, namespace: Namespace) -> TerrainShape | None:
    from deepbots_cli.scenario import terrains as terrain_spec

    values = namespace.values
    fixed = namespace.fields.fixed
    match spec:
        case terrain_spec.Pit():
            height = fixed(spec, "height")
            _check_height(spec, "height", None if height is None else height / 4, namespace)
            radius = _PIT_RIM_M if spec.radius is None else fixed(spec, "radius")
            noise = fixed(spec, "noise")
            return None if height is None or radius is None or noise is None else Pit(height, radius, noise)
        case terrain_spec.MeshTerrain():
            if spec.file.lower().endswith(".dae"):
                values.add(
                    "DB104", (*spec.path, "file"), "ground from a COLLADA file", "convert it to STL or OBJ"
                )
                return None
            return mesh(namespace, spec)
        case terrain_spec.Heightfield():
            file = picture(namespace, (*spec.path, "file"), spec.file)
            size = namespace.fields.pair(spec, "size")
            height = fixed(spec, "height")
            _check_height(spec, "height", height, namespace)
            return None if file is None or size is None or height is None else Picture(*file, size, height)
        case terrain_spec.Formula():
            size = namespace.fields.pair(spec, "size")
            return None if size is None else _formula(spec, size, namespace)
        case terrain_spec.TileTerrain():
            return _tiles(spec, namespace)
    return None


def _tiles(spec: terrain_spec.TileTerrain, namespace: Namespace) -> Tiles | None:
    values = namespace.values
    findings_before = len(namespace.values.findings)
    lengths = {key: namespace.fields.fixed(spec, key) for key in _TILE_LENGTHS}
    tiles = {name: _tile(tile, namespace) for name, tile in spec.tiles.items()}
    side, platform, border, cell = (lengths[key] for key in _TILE_LENGTHS)
    if side is None or platform is None or border is None or cell is None or None in tiles.values():
        return None
    for key, length in (("side", side), ("border", border)):
        cells = length / cell
        if abs(cells - round(cells)) > _TOLERANCE:
            headline = f"`{key}` is {length:g} m, which is not a multiple of `cell`, {cell:g} m"
            path = (*spec.path, key if key in spec.model_fields_set else "cell")
            values.add("DB308", values.span(path), headline, "write a multiple, or another `cell`")
    largest = side - 2 * TILE_MARGIN_M
    _check_width(spec, spec, "platform", platform, 0.0, largest, namespace)
    for tile_spec, tile in zip(spec.tiles.values(), tiles.values(), strict=True):
        if tile is not None:
            for key, width in _widths(tile):
                # Without gaps and trenches, a level is flat.
                smallest = 0.0 if key in ("gap", "width") and width == 0.0 else cell
                _check_width(spec, tile_spec, key, width, smallest, largest, namespace)
    terrain = Tiles(
        tuple(tile for tile in tiles.values() if tile is not None),
        spec.levels,
        side,
        border,
        platform,
        cell,
        spec.seed,
    )
    for kind, tile_spec in enumerate(spec.tiles.values() if len(values.findings) == findings_before else ()):
        key = next(key for key in ("angle", "height", "depth") if key in type(tile_spec).model_fields)
        _check_height(tile_spec, key, terrain.largest_height(kind), namespace)
    rows, columns = (round(extent / cell) + 1 for extent in terrain.size)
    if rows * columns > _MAX_HEIGHTS:
        headline = f"the terrain has {rows * columns:,} heights; the limit is {_MAX_HEIGHTS:,}"
        values.add_at_key(
            "DB005", spec.path, headline, "write fewer levels, smaller tiles or a larger `cell`"
        )
    return terrain if len(values.findings) == findings_before else None


def _check_height(section: Section, key: str, height: float | None, namespace: Namespace) -> None:
    """Report a measure with which the ground is too high or too deep for an engine."""
    if height is not None and height >= _MAX_HEIGHT_M:
        headline = f"the ground is up to {height:g} m {'deep' if key == 'depth' else 'high'}"
        path = (*section.path, key) if key in section.model_fields_set else section.path
        namespace.values.add("DB105", path, headline, "write heights between -10 km and 10 km")


def _check_width(
    terrain: terrain_spec.TileTerrain,
    section: terrain_spec.Tile | terrain_spec.TileTerrain,
    key: str,
    width: float,
    smallest: float,
    largest: float,
    namespace: Namespace,
) -> None:
    """Report a measure along the ground that is finer than the grid of heights, or wider than a tile."""
    if smallest <= width <= largest:
        return
    is_fine = width < smallest
    headline = f"`{key}` is {width:g} m, but a tile has room for {largest:g} m within its edge"
    help = "write a smaller one, or a larger `side`"
    if is_fine:
        headline = f"`{key}` is {width:g} m, but heights are {smallest:g} m apart"
        help = "write a larger one, or a smaller `cell`"
    path = (*section.path, key)
    if key not in section.model_fields_set:
        path = (*terrain.path, "cell" if is_fine else "side")
    namespace.values.add("DB105", namespace.values.span(path), headline, help)


def _tile(spec: terrain_spec.Tile, namespace: Namespace) -> Tile | None:
    """The measures of a tile at the lowest and at the highest level; None after a finding."""
    measures: list[tuple[str, float, float]] = []
    for key in type(spec).model_fields:
        value = getattr(spec, key)
        if key == "type":
            continue
        if isinstance(value, bool):
            measures.append((key, float(value), float(value)))
        elif isinstance(value, str) and ".." in value:
            ends = namespace.fields.ends(spec, key, falling=True)
            if ends is None:
                return None
            (low,), (high,) = ends.low, ends.high
            if min(low, high) < 0.0:
                namespace.values.add("DB105", (*spec.path, key), f"`{key}` is below 0", "write values from 0")
                return None
            if key == "angle" and max(low, high) > _MAX_SLOPE:
                headline = f"a slope of {math.degrees(max(low, high)):g} deg"
                namespace.values.add("DB105", (*spec.path, key), headline, "write at most 80 deg")
                return None
            measures.append((key, low, high))
        else:
            number = namespace.fields.fixed(spec, key)
            if number is None:
                return None
            measures.append((key, number, number))
    return Tile(spec.type, tuple(measures))


def _widths(tile: Tile) -> list[tuple[str, float]]:
    """Measures along the ground, which must fit into a tile, by key."""
    along = ("tread", "length", "grain", "side", "gap", "width", "spacing")
    return [(name, end) for name, *ends in tile.measures if name in along for end in {*ends}]


def _formula(spec: terrain_spec.Formula, size: tuple[float, float], namespace: Namespace) -> Formula | None:
    values = namespace.values
    sides = {
        name: ValueType(LENGTH, interval=Interval(-side / 2, side / 2), known=Known.STEP)
        for name, side in zip(PLANE, size, strict=True)
    }
    scope = namespace.scope(Context.FIXED, {name: Symbol(name, length) for name, length in sides.items()})
    text = values.field(spec, "heights")
    typed = values.quantity(text, "`heights`", scope, LENGTH, None, Known.STEP)
    if typed is None:
        return None
    (heights,) = lower(typed, text.owner)
    drawn_names = dict.fromkeys(name.name for name in names_in(heights) if name.name not in sides)
    if drawn_names or is_drawn(heights):
        subject = (
            f"`{next(iter(drawn_names))}`, which is drawn in every episode"
            if drawn_names
            else "a random draw"
        )
        help = "give it a fixed value; a stage of `curriculum` or a case of `evaluation` may set another one"
        values.add("DB407", text.span, f"`heights` must be fixed, but uses {subject}", help)
        return None
    steps = [step / _FORMULA_SAMPLES - 0.5 for step in range(_FORMULA_SAMPLES + 1)]
    for x, y in ((along_x * size[0], along_y * size[1]) for along_y in steps for along_x in steps):
        grid = _formula_at(heights, {"x": x, "y": y})
        if not (isinstance(grid, Const) and abs(grid.value) < _MAX_HEIGHT_M):
            position_text = f"at x = {x:g} m, y = {y:g} m"
            if isinstance(grid, Const) and math.isfinite(grid.value):
                headline = f"the ground is {grid.value:g} m high {position_text}"
                help = "write heights between -10 km and 10 km"
            else:
                headline = f"the height of the ground cannot be computed {position_text}"
                help = (
                    "correct `heights`: the expression divides by zero, leaves the domain of a function,"
                    " or gives too large a number"
                )
            values.add("DB105", text.span, headline, help)
            return None
    return Formula(heights, size)


def _formula_at(heights: Scalar, position: dict[str, float]) -> Scalar:
    """Return the formula at one place: a number, where it has one."""
    match heights:
        case Name(name=name) if name in position:
            return Const(position[name])
        case Op(op=operation, args=args):
            return fold_operation(operation, *(_formula_at(arg, position) for arg in args))
        case _:
            return heights


def bodies(name: str, body: world_spec.PlacedBody, namespace: Namespace) -> list[ObjectBody]:
    """Return the object, or every copy of a group; none after a finding about its shape. Figures that are
    drawn become variations."""
    from deepbots_cli.scenario import objects as object_spec

    group = namespace.groups.get(name)
    names = group.copies if group else (name,)
    if isinstance(body, object_spec.VariedObject):
        variants = tuple(_variant(kind, spec, body, namespace) for kind, spec in body.one_of.items())
        if None in variants or not variants:  # none is left where each of them has a finding
            return []
        forms = tuple(variant for variant in variants if variant is not None)
        return [_body(copy, body, forms[0].shape, namespace, forms) for copy in names]
    body_shape = shape(body, namespace)
    if not isinstance(body, object_spec.Material):
        return []
    if body_shape is None:  # its other values are checked all the same
        _body(name, body, Sphere(1.0), namespace)
        return []
    return [replace(_body(copy, body, body_shape, namespace), pooled=group is not None) for copy in names]


def _body(
    name: str,
    material: object_spec.Material,
    body_shape: Shape,
    namespace: Namespace,
    variants: tuple[Variant, ...] = (),
) -> ObjectBody:
    value = namespace.fields.scalar_or_randomized
    subject = OfLink(name)
    return ObjectBody(
        name,
        body_shape,
        mass=variants[0].mass if variants else _mass(material, body_shape, subject, namespace),
        color=(None if variants else namespace.fields.color(material, subject)) or _DEFAULT_COLOR,
        fixed=bool(material.fixed),
        solid=material.solid is not False,
        friction=1.0 if variants else value(material, "friction", "lateral_friction", subject, 1.0),
        spinning_friction=value(material, "spinning_friction", "spinning_friction", subject, 0.0),
        rolling_friction=value(material, "rolling_friction", "rolling_friction", subject, 0.0),
        restitution=value(material, "restitution", "restitution", subject, 0.0),
        pooled=bool(variants),
        variants=variants,
    )


def _variant(
    kind: str, spec: object_spec.ShapedBody, varied: object_spec.VariedObject, namespace: Namespace
) -> Variant | None:
    """Return a form that a body may take: properties that it does not set are those of the object; its values
    are fixed."""
    for key in _OF_ALL:
        if getattr(spec, key) is not None:
            namespace.values.add_at_key(
                "DB108",
                (*spec.path, key),
                f"`{key}` of one variant is not supported yet",
                f"write one `{key}` for all variants, next to `one_of`",
            )
    variant_shape = shape(spec, namespace)
    massive, rough, painted, still = (
        spec if getattr(spec, key) is not None else varied for key in ("mass", "friction", "color", "fixed")
    )
    weight = namespace.fields.fixed(massive, "mass", known=Known.EPISODE)
    grip = namespace.fields.fixed(rough, "friction", known=Known.EPISODE)
    stays = bool(still.fixed)
    if variant_shape is None:
        return None
    return Variant(
        kind,
        variant_shape,
        mass=_usual_mass(variant_shape, spec, namespace, still=stays or varied.solid is False)
        if massive.mass is None
        else weight or 0.0,
        color=namespace.fields.color(painted) or _DEFAULT_COLOR,
        friction=1.0 if grip is None else grip,
        fixed=stays,
    )


def shape(body: object_spec.Material | world_spec.PlacedBody, namespace: Namespace) -> Shape | None:
    """Return the shape of an object or of a variant; None after a finding."""
    from deepbots_cli.scenario import objects as object_spec

    match body:
        case object_spec.Box():
            size = namespace.fields.triple(body, "size")
            return Box(size) if size else None
        case object_spec.Sphere():
            radius = namespace.fields.fixed(body, "radius")
            return Sphere(radius) if radius else None
        case object_spec.Cylinder() | object_spec.Capsule():
            radius, height = namespace.fields.fixed(body, "radius"), namespace.fields.fixed(body, "height")
            kind = Cylinder if isinstance(body, object_spec.Cylinder) else Capsule
            return kind(radius, height) if radius and height else None
        case object_spec.Mesh():
            return mesh(namespace, body)
    return None


def _mass(material: object_spec.Material, body_shape: Shape, subject: OfLink, namespace: Namespace) -> float:
    """Return the mass in kg."""
    still = bool(material.fixed) or material.solid is False
    if material.mass is None:
        return _usual_mass(body_shape, material, namespace, still=still)
    if still:  # there is nothing that a drawn mass would change
        return namespace.fields.fixed(material, "mass", known=Known.EPISODE) or 0.0
    return namespace.fields.scalar_or_randomized(material, "mass", "mass", subject, 0.0)


def _usual_mass(
    body_shape: Shape, material: object_spec.Material, namespace: Namespace, *, still: bool
) -> float:
    """Return the mass (kg) of the same volume of water; a mesh that can move needs a mass of its own."""
    if isinstance(body_shape, Mesh) and not still:
        namespace.values.add_at_key(
            "DB102", material.path, "a movable mesh needs a `mass`", "add `mass`, or write `fixed: true`"
        )
    return _WATER_DENSITY * (volume(body_shape) or 0.0)


def world(namespace: Namespace, robots: list[ResolvedRobot], painted: tuple[Line, ...]) -> WorldModel:
    """Return the world with `robots` and `painted` lines in it."""
    values = namespace.values
    spec = namespace.scenario.world
    timestep = namespace.fields.fixed(spec, "timestep")
    if timestep is None:
        values.mark_invalid("timestep")  # the stand-in below is nothing to measure periods by
    else:
        _check_timestep(timestep, spec, namespace)
    parameters = _parameters(spec, namespace)
    gravity = parameters.get("gravity")
    if gravity is not None and gravity[2] > 0:
        span = values.field(spec, "gravity").span
        downwards = f"{gravity[0]:g} {gravity[1]:g} {-gravity[2]:g} m/s^2"
        # A fix would replace a draw by a number.
        fix = (
            None
            if namespace.fields.is_randomized("gravity", OfWorld())
            else Fix((Edit(span, downwards),), safe=False)
        )
        values.add("DB505", span, "gravity that pulls upwards", f"z points up: write `{downwards}`", fix=fix)
    objects = [
        body
        for name, placed in namespace.scenario.objects.items()
        for body in bodies(name, placed, namespace)
    ]
    pieces = walls(namespace)
    _check_bodies(len(robots), sum(body.bodies for body in objects), len(pieces), namespace)
    return WorldModel(
        # After DB105, the nearest one that can be run: 4 s have no number of timesteps of 1e-323 s.
        min(max(timestep or 0.032, _MIN_TIMESTEP_S), _MAX_TIMESTEP_S),
        spec.substeps,
        ground=_ground(spec.ground, namespace) if spec.terrain is None else None,
        arena=None if spec.arena is None else _arena(spec.arena, namespace),
        robots=tuple(
            RobotBody(
                robot.name,
                robot.model,
                robot.spec.base == "fixed",
                self_collision=robot.spec.self_collision,
            )
            for robot in robots
        ),
        objects=(*pieces, *objects),
        terrain=terrain(spec.terrain, namespace) if spec.terrain is not None else None,
        lines=painted,
        **parameters,
    )


def _parameters(spec: world_spec.World, namespace: Namespace) -> dict[str, Any]:
    """Return the fields of `WorldModel` that the section gives, without fields that had a finding."""
    parameters: tuple[WorldParameter, ...] = get_args(WorldParameter)
    values = {
        parameter: namespace.fields.vector_or_randomized(spec, parameter, parameter, OfWorld())
        for parameter in parameters
    }
    return {
        parameter: numbers if len(numbers) > 1 else numbers[0]
        for parameter, numbers in values.items()
        if numbers
    }


def _check_timestep(timestep: float, spec: world_spec.World, namespace: Namespace) -> None:
    if _SHORT_TIMESTEP_S <= timestep <= _LONG_TIMESTEP_S:
        code = None
    elif _MIN_TIMESTEP_S <= timestep <= _MAX_TIMESTEP_S:
        code = "DB505"
    else:
        code = "DB105"
    if code:
        text = namespace.values.field(spec, "timestep")
        match = re.fullmatch(r"\s*([0-9.]+)\s*s\s*", text.text)
        hint = (
            f"write `{match[1]} ms` if you mean milliseconds; "
            if match and timestep > _LONG_TIMESTEP_S
            else ""
        )
        namespace.values.add(
            code, text.span, f"the timestep is {timestep:g} s", f"{hint}a timestep of 10 to 100 ms is usual"
        )


def _check_bodies(robots: int, objects: int, pieces: int, namespace: Namespace) -> None:
    """Report DB005 for more bodies than a world may have, each variant of each copy among them."""
    counts: dict[NodePath, int] = {("robots",): robots, ("objects",): objects, ("world", "walls"): pieces}
    if sum(counts.values()) > MAX_BODIES:
        most = max(counts, key=lambda section: counts[section])
        namespace.values.add_at_key(
            "DB005",
            most,
            f"the world has {sum(counts.values()):,} robots, objects and pieces of walls; the limit"
            f" is {MAX_BODIES}",
            "use fewer bodies: an engine would take minutes to build this world",
        )


def _ground(spec: world_spec.Ground, namespace: Namespace) -> Ground:
    subject = OfLink(GROUND)
    contact = [field for field in fields(Ground) if field.name != "color"]
    parameters = {
        field.name: "lateral_friction" if field.name == "friction" else field.name for field in contact
    }
    ground: dict[str, Any] = {
        field.name: namespace.fields.scalar_or_randomized(
            spec, field.name, cast("LinkParameter", parameters[field.name]), subject, field.default
        )
        for field in contact
    }
    return Ground(**ground, color=namespace.fields.color(spec, subject))


def _arena(spec: world_spec.Arena, namespace: Namespace) -> Arena | None:
    size = namespace.fields.pair(spec, "size")
    height = namespace.fields.fixed(spec, "wall_height")
    thickness = namespace.fields.fixed(spec, "wall_thickness")
    friction = namespace.fields.scalar_or_randomized(
        spec, "friction", "walls_friction", OfWalls(ARENA_WALLS), 1.0
    )
    if size is None or height is None or thickness is None:
        return None
    return Arena(size, height, thickness, friction, namespace.fields.color(spec))
