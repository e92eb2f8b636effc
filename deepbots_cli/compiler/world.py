"""The world section and the objects: fixed figures, in the form an engine builds."""

from __future__ import annotations

from deepbots_cli import ir
from deepbots_cli.compiler.namespace import Namespace
from deepbots_cli.compiler.robots import RobotScene
from deepbots_cli.compiler.scopes import ParameterScope
from deepbots_cli.lang.dimensions import ACCELERATION, LENGTH, MASS, NUMBER, TIME
from deepbots_cli.lang.types import PLANE, SPACE, Context
from deepbots_cli.schema.objects import BoxObject, CapsuleObject, CylinderObject, Placed, SphereObject
from deepbots_cli.schema.plain import COLOURS
from deepbots_cli.schema.scenario import Scenario
from deepbots_cli.source.nodes import Path
from deepbots_cli.urdf.inertia import volume
from deepbots_cli.urdf.model import Box, Capsule, Cylinder, Shape, Sphere

_WATER = 1000.0  # kg/m^3, the default density of objects

# Seconds: a timestep beyond the outer two cannot be run, one beyond the inner two is hardly meant.
_SHORTEST, _SHORT, _LONG, _LONGEST = 1e-6, 1e-4, 1.0, 60.0


class WorldBuilder:
    """Reads the figures of the world in the scope of fixed parameters."""

    def __init__(self, spec: Scenario, namespace: Namespace) -> None:
        self._spec = spec
        self._values = namespace.values
        self._scope = ParameterScope(namespace, Context.FIXED)
        self._drawn = ParameterScope(namespace, Context.FIELD)

    def build(self, robots: list[RobotScene]) -> ir.WorldModel:
        spec = self._spec.world
        self._check_bodies()
        timestep = self._values.number(("world", "timestep"), spec.timestep, TIME, self._scope)
        if timestep is not None:
            self._check_timestep(timestep)
        gravity = self._values.figures(("world", "gravity"), spec.gravity, ACCELERATION, self._drawn, SPACE) or (0.0, 0.0, -9.81)
        if gravity[2] > 0:
            self._values.findings.add(
                "DB505", self._values.span(("world", "gravity")), "gravity that pulls upwards", help="z points up: write `0 0 -9.81 m/s^2`"
            )
        friction = self._number(("world", "ground", "friction"), spec.ground.friction, 1.0)
        restitution = self._number(("world", "ground", "restitution"), spec.ground.restitution, 0.0)
        return ir.WorldModel(
            timestep or 0.032,
            spec.substeps,
            (gravity[0], gravity[1], gravity[2]),
            ir.Ground(friction, restitution),
            self._arena(),
            tuple(ir.RobotBody(robot.name, robot.model, robot.spec.base == "fixed") for robot in robots),
            tuple(body for name, spec in self._spec.objects.items() if (body := self._object(name, spec)) is not None),
        )

    def _check_bodies(self) -> None:
        counts = {"robots": len(self._spec.robots), "objects": len(self._spec.objects)}
        if sum(counts.values()) > ir.MOST_BODIES:
            more = max(counts, key=lambda section: counts[section])
            headline = f"the world has {sum(counts.values()):_} robots and objects, more than {ir.MOST_BODIES}"
            self._values.findings.add("DB005", self._values.key_span((more,)), headline, help="an engine would take minutes to build it")

    def _check_timestep(self, timestep: float) -> None:
        code = None if _SHORT <= timestep <= _LONG else "DB505" if _SHORTEST <= timestep <= _LONGEST else "DB105"
        if code:
            span = self._values.span(("world", "timestep"))
            self._values.findings.add(code, span, f"a timestep of {timestep:g} s", help="10 to 100 ms are usual")

    def _number(self, path: Path, given: object, default: float) -> float:
        """A plain number that may be drawn."""
        number = self._values.figure(path, given, NUMBER, self._drawn)
        return default if number is None else number

    def _arena(self) -> ir.Arena | None:
        spec = self._spec.world.arena
        if spec is None:
            return None
        path: Path = ("world", "arena")
        size = self._values.numbers((*path, "size"), spec.size, LENGTH, PLANE, self._scope)
        height = self._length((*path, "wall_height"), spec.wall_height)
        thickness = self._length((*path, "wall_thickness"), spec.wall_thickness)
        friction = self._number((*path, "friction"), spec.friction, 1.0)
        if size is None or height is None or thickness is None:
            return None
        return ir.Arena((size[0], size[1]), height, thickness, friction)

    def _length(self, path: Path, given: object) -> float | None:
        return self._values.number(path, given, LENGTH, self._scope)

    def _object(self, name: str, spec: Placed) -> ir.ObjectBody | None:
        path: Path = ("objects", name)
        shape = self._shape(spec, path)
        if shape is None:
            return None
        fixed, solid = bool(getattr(spec, "fixed", False)), getattr(spec, "solid", None) is not False
        given = getattr(spec, "mass", None)
        mass = self._values.figure((*path, "mass"), given, MASS, self._drawn) if given is not None else _WATER * (volume(shape) or 0.0)
        friction = getattr(spec, "friction", None)
        colour = self._colour(getattr(spec, "colour", None), path)
        return ir.ObjectBody(
            name,
            shape,
            mass=mass or 0.0,
            colour=colour,
            friction=self._number((*path, "friction"), friction, 1.0),
            fixed=fixed,
            solid=solid,
        )

    def _shape(self, spec: Placed, path: Path) -> Shape | None:
        if isinstance(spec, BoxObject):
            size = self._values.numbers((*path, "size"), spec.size, LENGTH, SPACE, self._scope)
            return Box((size[0], size[1], size[2])) if size else None
        if isinstance(spec, SphereObject):
            radius = self._length((*path, "radius"), spec.radius)
            return Sphere(radius) if radius else None
        if isinstance(spec, (CylinderObject, CapsuleObject)):
            radius, height = self._length((*path, "radius"), spec.radius), self._length((*path, "height"), spec.height)
            kind = Cylinder if isinstance(spec, CylinderObject) else Capsule
            return kind(radius, height) if radius and height else None
        return None  # `support` has said that this shape is not delivered yet

    def _colour(self, given: str | None, path: Path) -> tuple[float, float, float, float]:
        word = (given or "grey").strip()
        if word.startswith("#"):
            return (int(word[1:3], 16) / 255, int(word[3:5], 16) / 255, int(word[5:7], 16) / 255, 1.0)
        if word not in COLOURS:  # the schema lets words of this table through, and draws
            span = self._values.span((*path, "colour"))
            self._values.findings.add("DB108", span, "a colour that is drawn anew is not supported yet", help="give one colour")
        return (*COLOURS.get(word, COLOURS["grey"]), 1.0)
