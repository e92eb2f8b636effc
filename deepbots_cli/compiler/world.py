"""The world: timestep, ground, arena, terrain, painted lines, walls and objects, with the files that they are made from."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path as FilePath
from typing import Any

from deepbots_cli.compiler.namespace import Namespace, ParameterScope
from deepbots_cli.compiler.robots import RobotScene
from deepbots_cli.compiler.values import colour, figure, figures
from deepbots_cli.diagnostics import Edit, Fix
from deepbots_cli.document import files
from deepbots_cli.document.nodes import Path
from deepbots_cli.expressions.dimensions import ACCELERATION, LENGTH, MASS, NUMBER, TIME
from deepbots_cli.expressions.intervals import Interval
from deepbots_cli.expressions.lower import lower, op
from deepbots_cli.expressions.scalar import Const, Name, Op, Scalar
from deepbots_cli.expressions.types import PLANE, SPACE, Context, Stage, Symbol, Type
from deepbots_cli.program.world import (
    ARENA_WALLS,
    GROUND,
    MAX_BODIES,
    MAX_POINTS,
    WALL_COLOUR,
    Arena,
    Colour,
    Formula,
    Ground,
    Line,
    ObjectBody,
    Picture,
    Pit,
    Point,
    RobotBody,
    Terrain,
    TerrainShape,
    Variant,
    WorldModel,
)
from deepbots_cli.reading import read_at_most
from deepbots_cli.robots import meshes
from deepbots_cli.robots.inertia import volume
from deepbots_cli.robots.meshes import measure
from deepbots_cli.robots.model import Box, Capsule, Cylinder, Mesh, Pose, Shape, Sphere
from deepbots_cli.scenario import world as object_spec
from deepbots_cli.scenario import world as world_spec
from deepbots_cli.scenario.fields import COLOURS
from deepbots_cli.scenario.scenario import Scenario
from deepbots_cli.scenario.world import Line as LineSpec
from deepbots_cli.scenario.world import Wall as WallSpec
from deepbots_cli.terrain import png

MAX_TRIANGLES = 200_000
_SMALLEST, _SMALL, _LARGE, _LARGEST = 1e-5, 1e-4, 1e3, 1e6  # m; beyond the inner two a mesh is probably in another unit


def mesh(namespace: Namespace, path: Path, reference: str, scale: object) -> Mesh | None:
    """The mesh file at `path`, which holds `file` and `scale`; None after a finding."""
    values, place = namespace.values, (*path, "file")
    factors = values.numbers(
        (*path, "scale"), scale if scale is not None else "1 1 1", NUMBER, SPACE, ParameterScope(namespace, Context.FIXED)
    )
    found = _located(namespace, place, reference)
    if found is None or factors is None:
        return None
    loaded = meshes.Meshes(lambda _reference: found).load(reference)
    if isinstance(loaded, meshes.Refusal):
        values.findings.add("DB301", values.span(place), loaded.why, help=loaded.help)
        return None
    if 0.0 in factors:
        values.findings.add("DB105", values.span((*path, "scale")), "a mesh that is scaled to nothing", help="give factors other than 0")
        return None
    namespace.files[place] = found
    made = Mesh(str(loaded[0]), loaded[1], (factors[0], factors[1], factors[2]))
    return made if _is_sensible(namespace, place, found, made) else None


def _is_sensible(namespace: Namespace, place: Path, file: FilePath, mesh: Mesh) -> bool:
    """Whether an engine can hold so many triangles; a size that is hardly meant is a warning."""
    findings, span = namespace.values.findings, namespace.values.span(place)
    measured = measure(file.suffix.lower(), file.read_bytes())
    if measured is None:
        return True
    if measured.triangles > MAX_TRIANGLES:
        headline = f"the mesh has {measured.triangles:_} triangles, more than {MAX_TRIANGLES:_}"
        findings.add("DB005", span, headline, help="simplify it")
        return False
    size = [abs(factor) * (high - low) for factor, low, high in zip(mesh.scale, measured.lower, measured.upper, strict=True)]
    code = None if _SMALL <= max(size) <= _LARGE else "DB505" if _SMALLEST <= max(size) <= _LARGEST else "DB105"
    if code is not None:
        shown = " x ".join(f"{side:.3g}" for side in size)
        findings.add(code, span, f"the mesh is {shown} m in size", help="a mesh in millimetres needs `scale: 0.001 0.001 0.001`")
    return code != "DB105"


def picture(namespace: Namespace, path: Path, reference: str) -> tuple[str, str] | None:
    """The path and the digest of a grey picture; None after a finding."""
    found = _located(namespace, path, reference)
    if found is None:
        return None
    data = read_at_most(found, png.MAX_BYTES + 1)
    wrong = png.fault(data)
    if wrong is not None:
        help = "save it as a grey PNG of 8 or 16 bits, without interlacing"
        namespace.values.findings.add("DB103", namespace.values.span(path), wrong, help=help)
        return None
    namespace.files[path] = found
    return str(found), hashlib.sha256(data).hexdigest()


def _located(namespace: Namespace, path: Path, reference: str) -> FilePath | None:
    """The file that the scenario names, in the project or in an installed package."""
    values, document = namespace.values, namespace.document
    span = values.span(path)
    if reference.startswith("package://"):
        found = meshes.in_package(reference)
        if found is not None:
            return found
        values.findings.add("DB204", span, f"`{reference}` does not exist", help="the package must be installed, and hold such a file")
        return None
    beside = files.resolve(reference, document.directory_of(span), document.roots)
    if isinstance(beside, FilePath):
        return beside
    library = meshes.library_reference(reference)
    help = f"did you mean `{library}`?" if library else beside.help
    fix = Fix.replacing(span, reference, library, safe=False) if library else None
    values.findings.add("DB204", span, beside.headline, help=help, fix=fix)
    return None


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


_PATH: Path = ("world", "terrain")
_RIM = 2.7 * math.sqrt(2.0 * math.log(2.0))  # m; where that of a pit of 20 m is
_HIGHEST = 1e4  # m
_TRIED = 8  # places along either side at which a formula is tried


def terrain(given: world_spec.Terrain, namespace: Namespace) -> Terrain | None:
    """The terrain; None after a finding."""
    drawn = ParameterScope(namespace, Context.FIELD)
    friction = figure(namespace, (*_PATH, "friction"), given.friction, NUMBER, drawn, "lateral_friction", (GROUND, ""))
    paint = colour(namespace, (*_PATH, "colour"), given.colour, (GROUND, ""))
    relief = _relief(given, namespace, ParameterScope(namespace, Context.FIXED))
    return None if relief is None else Terrain(relief, 1.0 if friction is None else friction, paint)


def _relief(given: world_spec.Terrain, namespace: Namespace, scope: ParameterScope) -> TerrainShape | None:
    values = namespace.values
    match given:
        case world_spec.Pit():
            height = values.number((*_PATH, "height"), given.height, LENGTH, scope)
            radius = _RIM if given.radius is None else values.number((*_PATH, "radius"), given.radius, LENGTH, scope)
            noise = values.number((*_PATH, "noise"), given.noise, NUMBER, scope)
            return None if height is None or radius is None or noise is None else Pit(height, radius, noise)
        case world_spec.MeshTerrain():
            if given.file.lower().endswith(".dae"):
                headline = "ground from a COLLADA file"
                values.findings.add("DB104", values.span((*_PATH, "file")), headline, help="convert it to STL or OBJ")
                return None
            return mesh(namespace, _PATH, given.file, given.scale)
        case world_spec.Heightfield():
            file = picture(namespace, (*_PATH, "file"), given.file)
            size = values.numbers((*_PATH, "size"), given.size, LENGTH, PLANE, scope)
            height = values.number((*_PATH, "height"), given.height, LENGTH, scope)
            return None if file is None or size is None or height is None else Picture(*file, (size[0], size[1]), height)
        case world_spec.Formula():
            size = values.numbers((*_PATH, "size"), given.size, LENGTH, PLANE, scope)
            return None if size is None else _formula(given, (size[0], size[1]), namespace)
    return None


def _formula(given: world_spec.Formula, size: tuple[float, float], namespace: Namespace) -> Formula | None:
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


_WATER = 1000.0  # kg/m^3, the default density of objects
_GREY: Colour = (*COLOURS["grey"], 1.0)
_OF_ALL = ("solid", "spinning_friction", "rolling_friction", "restitution")


class Bodies:
    """Makes the bodies of the objects; figures that are drawn become variations."""

    def __init__(self, namespace: Namespace) -> None:
        self._namespace = namespace
        self._values = namespace.values
        self._scope = ParameterScope(namespace, Context.FIXED)
        self._drawn = ParameterScope(namespace, Context.FIELD)

    def bodies(self, name: str, thing: object_spec.Placed) -> list[ObjectBody]:
        """The object, or every copy of a group; none after a finding about its shape."""
        path: Path = ("objects", name)
        group = self._namespace.groups.get(name)
        if isinstance(thing, object_spec.VariedObject):
            variants = tuple(self._variant(kind, given, thing, (*path, "one_of", kind)) for kind, given in thing.one_of.items())
            if None in variants or not variants:  # none is left where each of them has a finding
                return []
            forms = tuple(variant for variant in variants if variant is not None)
            return [self._body(copy, thing, forms[0].shape, path, forms) for copy in (group.copies if group else (name,))]
        shape = self.shape(thing, path)
        if shape is None:
            return []
        bodies = [self._body(copy, thing, shape, path) for copy in (group.copies if group else (name,))]
        return [replace(body, pooled=True) for body in bodies] if group else bodies

    def _body(self, name: str, thing: object_spec.Placed, shape: Shape, path: Path, variants: tuple[Variant, ...] = ()) -> ObjectBody:
        made_of, of = thing if isinstance(thing, object_spec.Material) else object_spec.Material(), (name, "")
        return ObjectBody(
            name,
            shape,
            mass=variants[0].mass if variants else self._mass((*path, "mass"), made_of, shape, of),
            colour=(None if variants else colour(self._namespace, (*path, "colour"), made_of.colour, of)) or _GREY,
            fixed=bool(made_of.fixed),
            solid=made_of.solid is not False,
            friction=1.0 if variants else self._number((*path, "friction"), made_of.friction, 1.0, "lateral_friction", of),
            spinning_friction=self._number((*path, "spinning_friction"), made_of.spinning_friction, 0.0, "spinning_friction", of),
            rolling_friction=self._number((*path, "rolling_friction"), made_of.rolling_friction, 0.0, "rolling_friction", of),
            restitution=self._number((*path, "restitution"), made_of.restitution, 0.0, "restitution", of),
            pooled=bool(variants),
            variants=variants,
        )

    def _variant(self, kind: str, given: object_spec.Shaped, thing: object_spec.VariedObject, path: Path) -> Variant | None:
        """A form that a body may take: what it does not say of itself, the object says for all; its figures are fixed."""
        for key in _OF_ALL:
            if getattr(given, key) is not None:
                help = f"give `{key}` for all variants, beside `one_of`"
                self._values.findings.add(
                    "DB108", self._values.key_span((*path, key)), f"`{key}` of one variant is not supported yet", help=help
                )
        shape = self.shape(given, path)
        if shape is None:
            return None
        (mass_at, mass), (friction_at, friction), (colour_at, paint), (_, fixed) = (
            _said(key, given, thing, path) for key in ("mass", "friction", "colour", "fixed")
        )
        weight = self._values.figure(mass_at, mass, MASS, self._drawn)
        grip = self._values.figure(friction_at, friction, NUMBER, self._drawn)
        return Variant(
            kind,
            shape,
            mass=self._usual_mass(shape, path, still=bool(fixed) or thing.solid is False) if mass is None else weight or 0.0,
            colour=colour(self._namespace, colour_at, paint) or _GREY,
            friction=1.0 if grip is None else grip,
            fixed=bool(fixed),
        )

    def shape(self, thing: object, path: Path) -> Shape | None:
        """The shape of an object or of a variant at `path`; None after a finding."""
        if isinstance(thing, object_spec.Box):
            size = self._values.numbers((*path, "size"), thing.size, LENGTH, SPACE, self._scope)
            return Box((size[0], size[1], size[2])) if size else None
        if isinstance(thing, object_spec.Sphere):
            radius = self._length((*path, "radius"), thing.radius)
            return Sphere(radius) if radius else None
        if isinstance(thing, (object_spec.Cylinder, object_spec.Capsule)):
            radius, height = self._length((*path, "radius"), thing.radius), self._length((*path, "height"), thing.height)
            kind = Cylinder if isinstance(thing, object_spec.Cylinder) else Capsule
            return kind(radius, height) if radius and height else None
        return mesh(self._namespace, path, thing.file, thing.scale) if isinstance(thing, object_spec.Mesh) else None

    def _mass(self, path: Path, made_of: object_spec.Material, shape: Shape, of: tuple[str, str]) -> float:
        """In kg."""
        still = bool(made_of.fixed) or made_of.solid is False
        if made_of.mass is not None:
            if still:  # there is nothing that a drawn mass would change
                return self._values.figure(path, made_of.mass, MASS, self._drawn) or 0.0
            return figure(self._namespace, path, made_of.mass, MASS, self._drawn, "mass", of) or 0.0
        return self._usual_mass(shape, path[:-1], still=still)

    def _usual_mass(self, shape: Shape, path: Path, *, still: bool) -> float:
        """That of as much water, in kg; a mesh that can move has to say its own."""
        if isinstance(shape, Mesh) and not still:
            help = "give its `mass`, or write `fixed: true`"
            self._values.findings.add("DB102", self._values.key_span(path), "a mesh that can move has no `mass`", help=help)
        return _WATER * (volume(shape) or 0.0)

    def _number(self, path: Path, given: object, default: float, what: str, of: tuple[str, str]) -> float:
        number = figure(self._namespace, path, given, NUMBER, self._drawn, what, of)
        return default if number is None else number

    def _length(self, path: Path, given: object) -> float | None:
        return self._values.number(path, given, LENGTH, self._scope)


def _said(key: str, given: object_spec.Shaped, thing: object_spec.VariedObject, path: Path) -> tuple[Path, Any]:
    """What a variant at `path` or, for all variants, the object says under `key`, and where."""
    own = getattr(given, key)
    return ((*path, key), own) if own is not None else ((*path[:2], key), getattr(thing, key))


# Seconds: a timestep beyond the outer two cannot be run, one beyond the inner two is hardly meant.
_SHORTEST, _SHORT, _LONG, _LONGEST = 1e-6, 1e-4, 1.0, 60.0


class WorldBuilder:
    """Reads the figures of the world in the scope of fixed parameters."""

    def __init__(self, spec: Scenario, namespace: Namespace) -> None:
        self._spec = spec
        self._namespace = namespace
        self._values = namespace.values
        self._scope = ParameterScope(namespace, Context.FIXED)
        self._drawn = ParameterScope(namespace, Context.FIELD)

    def build(self, robots: list[RobotScene], painted: tuple[Line, ...]) -> WorldModel:
        spec = self._spec.world
        timestep = self._values.number(("world", "timestep"), spec.timestep, TIME, self._scope)
        if timestep is None:
            self._values.lose("timestep")  # the stand-in below is nothing to measure periods by
        else:
            self._check_timestep(timestep)
        path: Path = ("world", "gravity")
        gravity = figures(self._namespace, path, spec.gravity, ACCELERATION, self._drawn, "gravity", (), SPACE) or (0.0, 0.0, -9.81)
        if gravity[2] > 0:
            span, downwards = self._values.span(path), f"{gravity[0]:g} {gravity[1]:g} {-gravity[2]:g} m/s^2"
            fix = None if "(" in span.text else Fix((Edit(span, downwards),), safe=False)  # a draw says more
            self._values.findings.add("DB505", span, "gravity that pulls upwards", help=f"z points up: write `{downwards}`", fix=fix)
        bodies = Bodies(self._namespace)
        objects = [body for name, thing in self._spec.objects.items() for body in bodies.bodies(name, thing)]
        pieces = walls(self._spec, self._namespace)
        self._check_bodies(len(robots), sum(thing.bodies for thing in objects), len(pieces))
        return WorldModel(
            timestep or 0.032,
            spec.substeps,
            (gravity[0], gravity[1], gravity[2]),
            self._ground() if spec.terrain is None else None,
            self._arena(),
            tuple(RobotBody(robot.name, robot.model, robot.spec.base == "fixed") for robot in robots),
            (*pieces, *objects),
            terrain=terrain(spec.terrain, self._namespace) if spec.terrain is not None else None,
            lines=painted,
            light=self._number(("world", "light"), spec.light, 1.0, "light", ()),
        )

    def _ground(self) -> Ground:
        spec, path, body = self._spec.world.ground, ("world", "ground"), (GROUND, "")
        return Ground(
            self._number((*path, "friction"), spec.friction, 1.0, "lateral_friction", body),
            self._number((*path, "restitution"), spec.restitution, 0.0, "restitution", body),
            colour(self._namespace, (*path, "colour"), spec.colour, body),
        )

    def _check_bodies(self, robots: int, objects: int, pieces: int) -> None:
        """DB005 for more bodies than a world may have, each variant of each copy among them."""
        counts: dict[Path, int] = {("robots",): robots, ("objects",): objects, ("world", "walls"): pieces}
        if sum(counts.values()) > MAX_BODIES:
            more = max(counts, key=lambda section: counts[section])
            headline = f"the world has {sum(counts.values()):_} robots, objects and pieces of walls, more than {MAX_BODIES}"
            self._values.findings.add("DB005", self._values.key_span(more), headline, help="an engine would take minutes to build it")

    def _check_timestep(self, timestep: float) -> None:
        code = None if _SHORT <= timestep <= _LONG else "DB505" if _SHORTEST <= timestep <= _LONGEST else "DB105"
        if code:
            span = self._values.span(("world", "timestep"))
            self._values.findings.add(code, span, f"a timestep of {timestep:g} s", help="10 to 100 ms are usual")

    def _number(self, path: Path, given: object, default: float, what: str, of: tuple[str, ...]) -> float:
        """A plain number that may be drawn."""
        number = figure(self._namespace, path, given, NUMBER, self._drawn, what, of)
        return default if number is None else number

    def _arena(self) -> Arena | None:
        spec = self._spec.world.arena
        if spec is None:
            return None
        path: Path = ("world", "arena")
        size = self._values.numbers((*path, "size"), spec.size, LENGTH, PLANE, self._scope)
        height = self._length((*path, "wall_height"), spec.wall_height)
        thickness = self._length((*path, "wall_thickness"), spec.wall_thickness)
        friction = self._number((*path, "friction"), spec.friction, 1.0, "walls_friction", ARENA_WALLS)
        if size is None or height is None or thickness is None:
            return None
        paint = colour(self._namespace, (*path, "colour"), spec.colour)
        return Arena((size[0], size[1]), height, thickness, friction, paint)

    def _length(self, path: Path, given: object) -> float | None:
        return self._values.number(path, given, LENGTH, self._scope)
