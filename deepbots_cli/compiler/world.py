"""The world section, in the form an engine builds; figures that an episode may vary are noted as variations."""

from __future__ import annotations

from deepbots_cli.compiler.bodies import Bodies
from deepbots_cli.compiler.colours import colour
from deepbots_cli.compiler.namespace import Namespace
from deepbots_cli.compiler.robots import RobotScene
from deepbots_cli.compiler.scopes import ParameterScope
from deepbots_cli.compiler.strokes import walls
from deepbots_cli.compiler.terrain import terrain
from deepbots_cli.compiler.variations import figure, figures
from deepbots_cli.diagnostics import Edit, Fix
from deepbots_cli.document.nodes import Path
from deepbots_cli.expressions.dimensions import ACCELERATION, LENGTH, NUMBER, TIME
from deepbots_cli.expressions.types import PLANE, SPACE, Context
from deepbots_cli.program.world import ARENA_WALLS, GROUND, MAX_BODIES, Arena, Ground, Line, RobotBody, WorldModel
from deepbots_cli.scenario.scenario import Scenario

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
