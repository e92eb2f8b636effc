"""The world section and the objects: fixed figures, in the form an engine builds."""

from __future__ import annotations

from deepbots_cli import ir
from deepbots_cli.compile.namespace import Namespace
from deepbots_cli.compile.robots import RobotScene
from deepbots_cli.compile.scopes import ParameterScope
from deepbots_cli.lang.dimensions import ACCELERATION, LENGTH, MASS, NUMBER, TIME
from deepbots_cli.lang.types import PLANE, SPACE, Context
from deepbots_cli.schema.objects import BoxObject, CapsuleObject, CylinderObject, Placed, SphereObject
from deepbots_cli.schema.scenario import Scenario
from deepbots_cli.source.nodes import Path
from deepbots_cli.urdf.inertia import volume
from deepbots_cli.urdf.model import Box, Capsule, Cylinder, Shape, Sphere

_WATER = 1000.0  # kg/m^3, the default density of objects

COLOURS: dict[str, tuple[float, float, float, float]] = {
    "white": (0.95, 0.95, 0.95, 1.0),
    "grey": (0.6, 0.6, 0.6, 1.0),
    "black": (0.1, 0.1, 0.1, 1.0),
    "red": (0.85, 0.2, 0.2, 1.0),
    "orange": (0.95, 0.55, 0.15, 1.0),
    "yellow": (0.95, 0.85, 0.2, 1.0),
    "green": (0.25, 0.65, 0.3, 1.0),
    "blue": (0.2, 0.4, 0.8, 1.0),
    "purple": (0.55, 0.3, 0.7, 1.0),
    "brown": (0.5, 0.35, 0.2, 1.0),
}


class WorldBuilder:
    """Reads the figures of the world in the scope of fixed parameters."""

    def __init__(self, spec: Scenario, namespace: Namespace) -> None:
        self._spec = spec
        self._values = namespace.values
        self._scope = ParameterScope(namespace, Context.FIXED)

    def build(self, robots: list[RobotScene]) -> ir.WorldModel:
        spec = self._spec.world
        timestep = self._values.number(("world", "timestep"), spec.timestep, TIME, self._scope)
        if timestep is not None and not 0 < timestep <= 60:
            self._values.findings.add(
                "DB105",
                self._values.span(("world", "timestep")),
                f"a timestep of {timestep:g} s",
                help="give more than 0 s and at most 60 s; 10 to 100 ms are usual",
            )
            timestep = None
        gravity = self._values.numbers(("world", "gravity"), spec.gravity, ACCELERATION, SPACE, self._scope) or (0.0, 0.0, -9.81)
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

    def _number(self, path: Path, given: object, default: float) -> float:
        number = self._values.number(path, given, NUMBER, self._scope)
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
        if min(size) <= 0:
            self._values.findings.add(
                "DB105", self._values.span((*path, "size")), "an arena without extent", help="give two lengths above 0 m"
            )
            return None
        return ir.Arena((size[0], size[1]), height, thickness, friction)

    def _length(self, path: Path, given: object) -> float | None:
        """A length above 0."""
        length = self._values.number(path, given, LENGTH, self._scope)
        if length is not None and length <= 0:
            self._values.findings.add("DB105", self._values.span(path), f"a length of {length:g} m", help="give more than 0 m")
            return None
        return length

    def _object(self, name: str, spec: Placed) -> ir.ObjectBody | None:
        path: Path = ("objects", name)
        shape = self._shape(spec, path)
        if shape is None:
            return None
        fixed, solid = bool(getattr(spec, "fixed", False)), getattr(spec, "solid", None) is not False
        given = getattr(spec, "mass", None)
        mass = self._values.number((*path, "mass"), given, MASS, self._scope) if given is not None else _WATER * (volume(shape) or 0.0)
        friction = getattr(spec, "friction", None)
        colour = self._colour(getattr(spec, "colour", None), path)
        return ir.ObjectBody(
            name,
            shape,
            mass=mass or 0.0,
            colour=colour,
            friction=1.0 if friction is None else self._number((*path, "friction"), friction, 1.0),
            fixed=fixed,
            solid=solid,
        )

    def _shape(self, spec: Placed, path: Path) -> Shape | None:
        if isinstance(spec, BoxObject):
            size = self._values.numbers((*path, "size"), spec.size, LENGTH, SPACE, self._scope)
            return Box((size[0], size[1], size[2])) if size and min(size) > 0 else None
        if isinstance(spec, SphereObject):
            radius = self._length((*path, "radius"), spec.radius)
            return Sphere(radius) if radius else None
        if isinstance(spec, (CylinderObject, CapsuleObject)):
            radius, height = self._length((*path, "radius"), spec.radius), self._length((*path, "height"), spec.height)
            kind = Cylinder if isinstance(spec, CylinderObject) else Capsule
            return kind(radius, height) if radius and height else None
        return None  # `support` has said that this shape is not delivered yet

    def _colour(self, given: str | None, path: Path) -> tuple[float, float, float, float]:
        if given is None:
            return COLOURS["grey"]
        if given.startswith("#") and len(given) == 7:
            return (int(given[1:3], 16) / 255, int(given[3:5], 16) / 255, int(given[5:7], 16) / 255, 1.0)
        if given not in COLOURS:
            self._values.findings.add(
                "DB108",
                self._values.span((*path, "colour")),
                f"the colour `{given}` is not supported yet",
                help=f"use one of {', '.join(COLOURS)}",
            )
        return COLOURS.get(given, COLOURS["grey"])
