"""One entry of `reset.place` or of a layout: where a body stands, and how it moves."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from math import atan2, pi

from deepbots_cli import footprint
from deepbots_cli.compiler.namespace import Namespace, Origin
from deepbots_cli.compiler.room import check_room, has_top
from deepbots_cli.compiler.scopes import ParameterScope
from deepbots_cli.document.nodes import Path
from deepbots_cli.expressions.dimensions import ANGLE, LENGTH, TIME, Dimension
from deepbots_cli.expressions.intervals import TURN, exact
from deepbots_cli.expressions.lower import constant
from deepbots_cli.expressions.types import PLANE, SPACE, Constant, Context, Invocation, Pick, Stage, Type, Typed
from deepbots_cli.program.resets import MAX_SPOTS, Cells, Placement, Region, Top
from deepbots_cli.program.values import Expression
from deepbots_cli.program.world import WorldModel
from deepbots_cli.scenario.scenario import Scenario
from deepbots_cli.scenario.task import Placement as PlacementSpec
from deepbots_cli.scenario.task import Region as RegionSpec
from deepbots_cli.scenario.world import Pose

_TURNS = ("roll", "pitch", "yaw")


def _turn(angle: float) -> Constant:
    return Constant(Type(ANGLE, interval=exact(angle)), 0, 0, (angle,))


_ANYWHERE = Invocation(Type(ANGLE, interval=TURN, stage=Stage.EPISODE), 0, 0, "uniform", (), (_turn(-pi), _turn(pi)), 0)
"""`any`: a turn drawn from the whole circle."""


class Places:
    """Reads placements in the scope of a reset, where figures may be drawn."""

    def __init__(self, spec: Scenario, namespace: Namespace, world: WorldModel) -> None:
        self._spec = spec
        self._namespace = namespace
        self._values = namespace.values
        self._world = world
        self._scope = ParameterScope(namespace, Context.RESET)
        self._fixed = ParameterScope(namespace, Context.FIXED)

    def placements(self, given: Mapping[str, Pose], path: Path, *, used: bool = True) -> list[Placement]:
        """Those of one layout, or of `reset.place`; whether there is room is asked of layouts that are used."""
        found = []
        for body, pose in given.items():
            if self._namespace.origin(body) in (Origin.ROBOT, Origin.OBJECT):
                found.append(self.placement(body, pose, (*path, body), used=used))
            else:
                known = self._namespace.named(Origin.ROBOT, Origin.OBJECT)
                self._values.unknown(self._values.key_span((*path, body)), "robot or object", body, known)
        return found

    def at_home(self, body: str) -> Placement:
        """At the body's own `pose`."""
        section, known = ("robots", self._spec.robots) if body in self._spec.robots else ("objects", self._spec.objects)
        return self.placement(body, known[body].pose, (section, body, "pose"))

    def placement(self, body: str, pose: Pose, path: Path, *, used: bool = True) -> Placement:
        """The placement of a known body; what had findings is left out of it."""
        place = Placement(body, self.coordinates(pose, path), owner=owner_of(path))
        if not isinstance(pose, PlacementSpec):
            return self.resting(place)
        place = replace(
            place,
            clearance=self._values.number((*path, "clearance"), pose.clearance, LENGTH, self._fixed) or 0.0,
            at_most=pose.at_most,
            spacing=self._spacing(pose, path),
            velocity=self._vector("velocity", pose.velocity, path, LENGTH / TIME),
            angular_velocity=self._vector("angular_velocity", pose.angular_velocity, path, ANGLE / TIME),
        )
        place = self._on_line(place, pose.line, path) if pose.line else place
        if pose.on is not None:
            place = replace(place, spot=self._top(pose.on, pose, path))
        elif pose.region is not None:
            place = replace(place, spot=self._region(pose, path))
        elif pose.grid is not None:
            span = self._values.key_span((*path, "grid"))
            self._values.findings.add("DB102", span, "a grid without a region", help="say where its cells are: `region: arena`")
        self._check_spots(place.spot, path)
        if isinstance(place.spot, Region) and used:
            check_room(place, place.spot, self._world, self._namespace, path)
        self._check_copies(place, path, used=used)
        return self.resting(place)

    def coordinates(self, pose: Pose, path: Path) -> dict[str, Expression]:
        found: dict[str, Expression] = {}
        for whole, parts, dimension in (("xyz", SPACE, LENGTH), ("rpy", _TURNS, ANGLE)):
            for part in parts:
                given = getattr(pose, part)
                if given is not None:
                    coordinate = self._coordinate(given, (*path, part), dimension)
                    found |= {part: coordinate} if coordinate else {}
            if getattr(pose, whole) is not None:
                found |= self._components(getattr(pose, whole), (*path, whole), parts, dimension)
        return found

    def resting(self, place: Placement) -> Placement:
        """The placement of a body that lies on the ground where no height is given; a robot with a fixed base is built in at 0."""
        robot = self._spec.robots.get(place.body)
        is_built_in = robot is not None and robot.base == "fixed"
        shapes = {thing.name: thing.shape for thing in self._world.objects if not thing.pooled}
        models = {body.name: body.model for body in self._world.robots}
        lying = None if self._world.terrain else shapes.get(place.body) or models.get(place.body)
        return replace(place, rests=not is_built_in and "z" not in place.coordinates, lying=lying)

    def _coordinate(self, given: object, path: Path, dimension: Dimension) -> Expression | None:
        text = self._values.text(path, given)
        typed = _ANYWHERE if given == "any" else self._values.quantity(text, f"`{path[-1]}`", self._scope, dimension, None, Stage.EPISODE)
        return Expression(str(path[-1]), text.span, text.text, typed, owner_of(path)) if typed else None

    def _components(self, given: object, path: Path, parts: tuple[str, ...], dimension: Dimension) -> dict[str, Expression]:
        """The components of `xyz` or `rpy`, each picked from the same typed vector."""
        text = self._values.text(path, given)
        typed = self._values.quantity(text, f"`{path[-1]}`", self._scope, dimension, SPACE, Stage.EPISODE)
        if typed is None:
            return {}
        owner, single = owner_of(path), typed.type._replace(components=None)
        picks: list[Typed] = [Pick(single, typed.start, typed.end, typed, (index,)) for index in range(len(parts))]
        trees = picks if typed.type.components else [typed] * len(parts)
        return {part: Expression(part, text.span, text.text, tree, owner) for part, tree in zip(parts, trees, strict=True)}

    def _vector(self, name: str, given: object, path: Path, dimension: Dimension) -> Expression | None:
        if given is None:
            return None
        text = self._values.text((*path, name), given)
        typed = self._values.quantity(text, f"`{name}`", self._scope, dimension, SPACE, Stage.EPISODE)
        return Expression(name, text.span, text.text, typed, owner_of((*path, name))) if typed else None

    def _spacing(self, pose: PlacementSpec, path: Path) -> tuple[float, float]:
        if pose.spacing is None:
            return (0.0, 0.0)
        found = self._values.numbers((*path, "spacing"), pose.spacing, LENGTH, PLANE, self._fixed)
        return (found[0], found[1]) if found else (0.0, 0.0)

    def _on_line(self, place: Placement, line: str, path: Path) -> Placement:
        """The beginning of a painted line, heading along it."""
        stroke = next((stroke for stroke in self._world.lines if stroke.name == line), None)
        if stroke is None:
            self._values.unknown(self._values.span((*path, "line")), "line", line, self._namespace.named(Origin.LINE))
            return place
        self._namespace.touch(line)
        first, second = stroke.pieces[0]
        span, owner = self._values.span((*path, "line")), owner_of(path)
        here = {axis: Expression(axis, span, line, _length(first[index]), owner) for index, axis in enumerate(PLANE)}
        return replace(place, coordinates={**place.coordinates, **here}, heading=atan2(second[1] - first[1], second[0] - first[0]))

    def _top(self, name: str, pose: PlacementSpec, path: Path) -> Top | None:
        """The top of the object called `name`, for the body at `path` to stand on."""
        span = self._values.span((*path, "on"))
        flat = [thing.name for thing in self._world.objects if has_top(thing) and self._namespace.origin(thing.name) is Origin.OBJECT]
        if self._namespace.origin(name) is None:
            self._values.unknown(span, "object", name, flat)
        elif name not in flat and not self._values.is_lost(name):
            headline = f"`{name}` has no flat top that a body could stand on"
            help = f"name a single, solid box or cylinder{f', such as `{flat[0]}`' if flat else ''}"
            self._values.findings.add("DB203", span, headline, help=help)
        if name not in flat or (pose.region is not None and (region := self._region(pose, path)) is None):
            return None
        mesh = self._values.number((*path, "grid"), pose.grid, LENGTH, self._fixed) if pose.grid is not None else None
        return Top(name, region if pose.region is not None else None, mesh)

    def _region(self, pose: PlacementSpec, path: Path) -> Region | None:
        mesh = None
        if pose.grid is not None and (mesh := self._values.number((*path, "grid"), pose.grid, LENGTH, self._fixed)) is None:
            return None
        if isinstance(pose.region, RegionSpec):
            ends = [
                self._values.ends(self._values.text((*path, "region", axis), given), f"`{axis}`", self._fixed, dimension=LENGTH)
                for axis, given in (("x", pose.region.x), ("y", pose.region.y))
            ]
            return Region((x.low[0], y.low[0]), (x.high[0], y.high[0]), mesh) if (x := ends[0]) and (y := ends[1]) else None
        arena = self._world.arena
        if pose.region != "arena":
            self._values.unknown(self._values.span((*path, "region")), "region", str(pose.region), ["arena"])
        elif self._spec.world.arena is None:
            if not self._values.is_lost("world.arena"):
                span, help = self._values.span((*path, "region")), "give the region as `{x: -1 .. 1 m, y: -1 .. 1 m}`"
                self._values.findings.add("DB201", span, "the world has no arena", help=help)
        elif arena is not None:
            half_x, half_y = arena.size[0] / 2, arena.size[1] / 2
            return Region((-half_x, -half_y), (half_x, half_y), mesh)
        return None

    def _check_spots(self, spot: Region | Cells | Top | None, path: Path) -> None:
        if isinstance(spot, Top):
            reach = next(footprint.of_shape(thing.shape).radius for thing in self._world.objects if thing.name == spot.of)
            spot = Region((-reach, -reach), (reach, reach), spot.mesh)
        if isinstance(spot, Region) and spot.spots > MAX_SPOTS:
            headline = f"a region of {spot.spots:.0f} cells, more than {MAX_SPOTS:_}"
            self._values.findings.add("DB005", self._values.span((*path, "grid")), headline, help="give a coarser grid")

    def _check_copies(self, place: Placement, path: Path, *, used: bool) -> None:
        """Keys that only groups know; copies of a group that would stand within each other."""
        group = self._namespace.groups.get(place.body)
        if group is not None:
            if used:
                self._check_spread(place, min(group.capacity, group.capacity if place.at_most is None else place.at_most), path)
            return
        for key, given in (("at_most", place.at_most is not None), ("spacing", any(place.spacing))):
            if given and not self._values.is_lost(place.body):
                headline = f"`{key}` of `{place.body}`, of which there is one"
                help = "it is for groups: bodies with a `count`"
                self._values.findings.add("DB203", self._values.key_span((*path, key)), headline, help=help)

    def _check_spread(self, place: Placement, most: int, path: Path) -> None:
        """DB105 where up to `most` copies stand at the same coordinates."""
        if any(self._values.stands((*path, way)) for way in ("region", "line", "grid", "on")):
            return  # there would be spots, were it not for a finding
        known = [place.coordinates[axis] for axis in PLANE if axis in place.coordinates]
        is_fixed = all(constant(coordinate.typed) is not None for coordinate in known)
        if most > 1 and is_fixed and place.spot is None and not any(place.spacing):
            headline = f"up to {most} copies of `{place.body}` at one spot"
            help = "draw their spots with `region`, put them in a row with `spacing`, or place `at_most: 1`"
            self._values.findings.add("DB105", self._values.key_span(path), headline, help=help)


def owner_of(path: Path) -> str:
    """The place of an item in the scenario, after which its draws are named."""
    return ".".join(map(str, path))


def _length(figure: float) -> Constant:
    return Constant(Type(LENGTH, interval=exact(figure)), 0, 0, (figure,))
