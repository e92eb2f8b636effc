"""The places of bodies at the start: placements, regions, layouts and maps.

Whether there is room for them is found by placing them: a reset that finds no position names the body, and
`lint --deep` reports it.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from math import atan2, pi

from deepbots_cli import footprint
from deepbots_cli.compiler.namespace import Namespace, NamespaceReader, Origin
from deepbots_cli.compiler.texts import SourceText
from deepbots_cli.diagnostics import Span
from deepbots_cli.document.nodes import NodePath
from deepbots_cli.expressions.dimensions import ANGLE, LENGTH, NUMBER, Dimension
from deepbots_cli.expressions.intervals import TURN, single
from deepbots_cli.expressions.scalar import is_drawn
from deepbots_cli.expressions.types import (
    PLANE,
    SPACE,
    ComponentSelection,
    Constant,
    Context,
    Invocation,
    Known,
    ValueType,
)
from deepbots_cli.program.resets import MAX_SPOTS, Cells, Layout, ObjectGroup, Placement, Region, Top
from deepbots_cli.program.values import Expression
from deepbots_cli.program.world import MAX_BODIES, WALL_COLOR, ObjectBody, WorldModel
from deepbots_cli.robots.model import Box, Cylinder
from deepbots_cli.scenario.task import MapLayout
from deepbots_cli.scenario.task import Placement as PlacementSpec
from deepbots_cli.scenario.task import Region as RegionSpec
from deepbots_cli.scenario.world import Pose

_ROTATION_KEYS = ("roll", "pitch", "yaw")

_EMPTY_CELL = "."
_WALL_CELL = "wall"
_MAX_CELLS = 250_000


def has_top(body: ObjectBody) -> bool:
    """Return whether other bodies can stand on an object: a single one with a level top that is solid."""
    return body.solid and not body.pooled and not body.variants and isinstance(body.shape, (Box, Cylinder))


def _is_tilted(place: Placement) -> bool:
    """Return whether a body may stand otherwise than upright."""
    turns = [place.coordinates[turn] for turn in ("roll", "pitch") if turn in place.coordinates]
    return any(turn.typed.type.interval != single(0.0) for turn in turns)


def _fixed(value: float, dimension: Dimension) -> Constant:
    """Return a number in SI units that is not written in the text."""
    return Constant(ValueType(dimension, interval=single(value)), 0, 0, (value,))


_ANY_ANGLE = Invocation(
    ValueType(ANGLE, interval=TURN, known=Known.EPISODE),
    0,
    0,
    "uniform",
    (),
    (_fixed(-pi, ANGLE), _fixed(pi, ANGLE)),
    0,
)
"""The expression `any`: a turn drawn from the whole circle."""


class Places(NamespaceReader):
    """Reads placements in the scope of a reset, where values may be drawn."""

    def __init__(self, namespace: Namespace, world: WorldModel) -> None:
        super().__init__(namespace)
        self._world = world
        self._scope = namespace.scope(Context.RESET)

    def placements(self, spec: Mapping[str, Pose], path: NodePath, *, used: bool = True) -> list[Placement]:
        """Compile the placements of a layout, or of `reset.place`. Free room is checked only for layouts that
        are `used`."""
        placements = []
        for body, pose in spec.items():
            if self._namespace.origin(body) in (Origin.ROBOT, Origin.OBJECT):
                placements.append(self.placement(body, pose, used=used))
            else:
                bodies = self._namespace.names_of(Origin.ROBOT, Origin.OBJECT)
                self._values.report_unknown(
                    self._values.key_span((*path, body)), "robot or object", body, bodies
                )
        return placements

    def at_own_pose(self, body: str) -> Placement:
        """Return the placement at the body's own `pose`."""
        spec = self._spec.robots[body] if body in self._spec.robots else self._spec.objects[body]
        return self.placement(body, spec.pose)

    def placement(self, body: str, pose: Pose, *, used: bool = True) -> Placement:
        """Return the placement of a known body, without the parts that had findings."""
        place = Placement(body, self.coordinates(pose), owner=draws_owner(pose.path))
        if not isinstance(pose, PlacementSpec):
            return self.resting_placement(place)
        spacing = self._fields.pair(pose, "spacing")
        has_finding = spacing is None and self._values.is_present((*pose.path, "spacing"))
        place = replace(
            place,
            clearance=self._fields.fixed(pose, "clearance") or 0.0,
            at_most=pose.at_most,
            spacing=spacing or (0.0, 0.0),
            velocity=self._fields.expression(pose, "velocity", scope=self._scope),
            angular_velocity=self._fields.expression(pose, "angular_velocity", scope=self._scope),
        )
        place = self._on_line(place, pose, pose.line) if pose.line else place
        if pose.on is not None:
            place = replace(place, spot=self._top(pose.on, pose))
        elif pose.region is not None:
            place = replace(place, spot=self._region(pose))
        elif pose.grid is not None:
            self._values.add_at_key(
                "DB102", (*pose.path, "grid"), "`grid` needs a `region`", "add one, as in `region: arena`"
            )
        self._check_spots(place.spot, pose.path)
        self._check_copies(place, pose.path, used=used and not has_finding)
        return self.resting_placement(place)

    def coordinates(self, pose: Pose) -> dict[str, Expression]:
        """Return the coordinates x, y, z, roll, pitch and yaw of a pose, given singly or as components of
        `xyz` or `rpy`."""
        coordinates: dict[str, Expression | None] = {}
        for vector_key, parts in (("xyz", SPACE), ("rpy", _ROTATION_KEYS)):
            for part in parts:
                if parts is _ROTATION_KEYS and getattr(pose, part) == "any":
                    coordinates[part] = self._values.field(pose, part).expression(_ANY_ANGLE)
                else:
                    coordinates[part] = self._fields.expression(pose, part, scope=self._scope)
            vector = self._fields.expression(pose, vector_key, scope=self._scope)
            if vector is not None:
                typed = vector.typed
                for index, part in enumerate(parts):
                    tree = (
                        ComponentSelection(
                            typed.type.selected((index,)), typed.start, typed.end, typed, (index,)
                        )
                        if typed.type.components
                        else typed
                    )
                    coordinates[part] = replace(vector, name=part, typed=tree)
        return {part: coordinate for part, coordinate in coordinates.items() if coordinate is not None}

    def resting_placement(self, place: Placement) -> Placement:
        """Return the placement of a body that lies on the ground where no height is given; a robot with a
        fixed base is built in at 0."""
        robot = self._spec.robots.get(place.body)
        is_built_in = robot is not None and robot.base == "fixed"
        shapes = {body.name: body.shape for body in self._world.objects if not body.pooled}
        models = {body.name: body.model for body in self._world.robots}
        lying = None if self._world.terrain else shapes.get(place.body) or models.get(place.body)
        return replace(place, rests=not is_built_in and "z" not in place.coordinates, lying=lying)

    def _on_line(self, place: Placement, pose: PlacementSpec, line: str) -> Placement:
        """Return the beginning of a painted line, heading along it."""
        span = self._values.field(pose, "line").span
        stroke = next((stroke for stroke in self._world.lines if stroke.name == line), None)
        if stroke is None:
            self._values.report_unknown(span, "line", line, self._namespace.names_of(Origin.LINE))
            return place
        self._namespace.mark_used(line)
        first, second = stroke.pieces[0]
        start = {
            axis: Expression(axis, span, line, _fixed(first[index], LENGTH), place.owner)
            for index, axis in enumerate(PLANE)
        }
        return replace(
            place,
            coordinates={**place.coordinates, **start},
            heading=atan2(second[1] - first[1], second[0] - first[0]),
        )

    def _top(self, name: str, pose: PlacementSpec) -> Top | None:
        span = self._values.field(pose, "on").span
        flat = [
            body.name
            for body in self._world.objects
            if has_top(body) and self._namespace.origin(body.name) is Origin.OBJECT
        ]
        if self._namespace.origin(name) is None:
            self._values.report_unknown(span, "object", name, flat)
        elif name not in flat and not self._values.is_invalid(name):
            self._values.add(
                "DB203",
                span,
                f"`{name}` has no flat top to place a body on",
                f"use a single, solid box or cylinder{f', such as `{flat[0]}`' if flat else ''}",
            )
        if name not in flat or (pose.region is not None and (region := self._region(pose)) is None):
            return None
        return Top(name, region if pose.region is not None else None, self._fields.fixed(pose, "grid"))

    def _region(self, pose: PlacementSpec) -> Region | None:
        mesh = self._fields.fixed(pose, "grid")
        if mesh is None and pose.grid is not None:
            return None
        if isinstance(pose.region, RegionSpec):
            x, y = self._fields.ends(pose.region, "x"), self._fields.ends(pose.region, "y")
            return Region((x.low[0], y.low[0]), (x.high[0], y.high[0]), mesh) if x and y else None
        arena = self._world.arena
        span = self._values.span((*pose.path, "region"))
        if pose.region != "arena":
            self._values.report_unknown(span, "region", str(pose.region), ["arena"])
        elif self._spec.world.arena is None:
            if not self._values.is_invalid("world.arena"):
                self._values.add(
                    "DB201",
                    span,
                    "the world has no arena",
                    "write the region as `{x: -1 .. 1 m, y: -1 .. 1 m}`",
                )
        elif arena is not None:
            half_x, half_y = arena.size[0] / 2, arena.size[1] / 2
            return Region((-half_x, -half_y), (half_x, half_y), mesh)
        return None

    def _check_spots(self, spot: Region | Cells | Top | None, path: NodePath) -> None:
        if isinstance(spot, Top):
            reach = next(
                footprint.shape_footprint(body.shape).radius
                for body in self._world.objects
                if body.name == spot.of
            )
            spot = Region((-reach, -reach), (reach, reach), spot.mesh)
        if isinstance(spot, Region) and spot.spots > MAX_SPOTS:
            self._values.add(
                "DB005",
                (*path, "grid"),
                f"the region has {spot.spots:,.0f} cells; the limit is {MAX_SPOTS:,}",
                "write a larger `grid`",
            )
        elif isinstance(spot, Region) and spot.is_too_small:
            self._values.add_at_key(
                "DB105",
                (*path, "grid"),
                "the region has no room for a cell",
                "use a larger region, or a smaller `grid`",
            )

    def _check_copies(self, place: Placement, path: NodePath, *, used: bool) -> None:
        """Report keys that only a group may have, and copies of a group that would overlap."""
        group = self._namespace.groups.get(place.body)
        if group is not None:
            if used:
                self._check_spread(place, group, path)
            return
        for key, spec in (("at_most", place.at_most is not None), ("spacing", any(place.spacing))):
            if spec and not self._values.is_invalid(place.body):
                self._values.add_at_key(
                    "DB203",
                    (*path, key),
                    f"`{key}` applies only to groups, but `{place.body}` is a single body",
                    f"remove it, or add a `count` to `{place.body}`",
                )

    def _check_spread(self, place: Placement, group: ObjectGroup, path: NodePath) -> None:
        """Report DB105 if several copies of a group may be placed at the same coordinates."""
        copies = group.capacity if place.at_most is None else min(group.capacity, place.at_most)
        written = [place.coordinates[axis] for axis in SPACE if axis in place.coordinates]
        unread = {*SPACE, *(() if "x" in place.coordinates else ("line", "xyz"))} - place.coordinates.keys()
        if any(self._values.is_present((*path, key)) for key in ("region", "grid", "on", *unread)):
            return  # there would be spots or coordinates, were it not for a finding
        if (
            copies > 1
            and place.spot is None
            and not any(place.spacing)
            and not any(is_drawn(coordinate.scalar) for coordinate in written)
        ):
            self._values.add_at_key(
                "DB105",
                path,
                f"up to {copies} copies of `{place.body}` at one position",
                "draw the positions with `region`, place the copies in a row with `spacing`, or keep one"
                " copy with `at_most: 1`",
            )

    def check_tops(self, common: Sequence[Placement], layouts: Sequence[Layout]) -> None:
        """Report bodies that stand on each other (DB207), or on a top that is not level (DB203), in any
        layout."""
        for layout in layouts or (Layout("", 1.0, ()),):
            standing = {place.body: place for place in (*common, *layout.placements)}
            for place in standing.values():
                span = self._values.span((*place.owner.split("."), "on"))
                if not isinstance(place.spot, Top) or self._check_stack(place, standing, span):
                    continue
                if _is_tilted(standing[place.spot.of]):
                    self._values.add(
                        "DB203",
                        span,
                        f"the top of `{place.spot.of}` is not level",
                        f"remove `roll` and `pitch` of `{place.spot.of}`",
                    )

    def _check_stack(self, place: Placement, standing: Mapping[str, Placement], span: Span) -> bool:
        """Return whether a body stands on itself, or on bodies that stand on each other, with DB207 once for
        each cycle."""
        stack: list[str] = []
        below: Placement | None = place
        while below is not None and below.body not in stack:
            stack.append(below.body)
            below = standing.get(below.spot.of) if isinstance(below.spot, Top) else None
        if below is None:
            return False
        # The cycle is reported once, of the first of its bodies.
        is_first = below.body == next(body for body in standing if body in stack)
        if is_first and below.body == place.body:
            notes = (f"the cycle is {' -> '.join((*stack, place.body))}",) if len(stack) > 1 else ()
            self._values.add(
                "DB207",
                span,
                f"`{place.body}` is placed on itself",
                f"remove `on` of `{place.body}`, which then rests on the ground",
                notes=notes,
            )
        return not is_first or below.body == place.body


def draws_owner(path: NodePath) -> str:
    """Return the place of an item in the scenario, after which its draws are named."""
    return ".".join(map(str, path))


class Layouts(NamespaceReader):
    """The layouts that episodes use. `walls` are the bodies in cells of walls, absent in other layouts."""

    def __init__(self, namespace: Namespace, places: Places, world: WorldModel) -> None:
        super().__init__(namespace)
        self._places = places
        self._world = world
        self.walls: list[ObjectBody] = []

    def weighted_layouts(self) -> tuple[Layout, ...]:
        """Return each layout with its share; all others are read for their findings alone."""
        spec, layouts = self._spec.reset.layout, self._spec.reset.layouts
        if isinstance(spec, dict):
            shares = self._shares()
        elif spec is not None:
            shares = {spec: 1.0}
        else:
            shares = dict.fromkeys(list(layouts)[:1], 1.0)
        if spec is None and len(layouts) > 1:
            first, second = list(layouts)[:2]
            self._values.add_at_key(
                "DB102",
                ("reset", "layouts"),
                "missing key `layout`",
                f"choose one with `layout: {first}`, or draw one with"
                f" `layout: {{{first}: 50 %, {second}: 50 %}}`",
            )
        for name in shares:
            if name not in layouts:
                path: NodePath = ("reset", "layout", name) if isinstance(spec, dict) else ("reset", "layout")
                span = self._values.key_span(path) if isinstance(spec, dict) else self._values.span(path)
                self._values.report_unknown(span, "layout", name, list(layouts))
        weights = {
            name: tuple(
                self._map(name, layout, used=name in shares)
                if isinstance(layout, MapLayout)
                else self._places.placements(layout, ("reset", "layouts", name), used=name in shares)
            )
            for name, layout in layouts.items()
        }
        return tuple(Layout(name, share, weights[name]) for name, share in shares.items() if name in weights)

    def _shares(self) -> dict[str, float]:
        spec = self._spec.reset.layout
        assert isinstance(spec, dict)  # the caller has checked it
        all_shares = {name: self._fields.fixed(self._spec.reset, "layout", name) for name in spec}
        shares = {name: share for name, share in all_shares.items() if share is not None}
        # 0.7 + 0.2 + 0.1 is 0.9999999999999999.
        if len(shares) == len(all_shares) and abs(sum(shares.values()) - 1.0) > 1e-6:
            self._values.add_at_key(
                "DB105",
                ("reset", "layout"),
                f"the shares add up to {100 * sum(shares.values()):g} %",
                "make the shares add up to 100 %",
            )
        return shares

    # Maps

    def _map(self, name: str, layout: MapLayout, *, used: bool) -> list[Placement]:
        """Return each letter's body on the cells with this letter; the first row is the farthest along y, the
        middle is the origin."""
        cell = self._fields.fixed(layout, "cell")
        text = self._values.field(layout, "map")
        rows = _rows(text) if self._is_small(text) else []
        if cell is None or not rows or not self._is_even(rows):
            return []
        self._check_size(len(rows[0]) * cell, len(rows) * cell, (*layout.path, "cell"))
        legend = self._legend(layout)
        spots: dict[str, list[tuple[float, float]]] = {letter: [] for letter in legend}
        for number, row in enumerate(rows):
            for column, (letter, span) in enumerate(row):
                if letter in spots:
                    spots[letter].append(
                        ((column - (len(row) - 1) / 2) * cell, ((len(rows) - 1) / 2 - number) * cell)
                    )
                elif letter != _EMPTY_CELL and letter not in layout.legend:
                    self._values.report_unknown(span, "letter", letter, [_EMPTY_CELL, *layout.legend])
        bodies: dict[str, list[tuple[float, float]]] = {}
        for letter, body in legend.items():
            bodies.setdefault(body, []).extend(spots[letter])
        return [
            self._standing(name, body, cell, tuple(cells), layout.path, used=used)
            for body, cells in bodies.items()
            if cells
        ]

    def _legend(self, layout: MapLayout) -> dict[str, str]:
        """Return the letters whose bodies are known."""
        legend = {}
        for letter, body in layout.legend.items():
            if body == _WALL_CELL or self._namespace.origin(body) in (Origin.ROBOT, Origin.OBJECT):
                legend[letter] = body
            else:
                standing = [*self._namespace.names_of(Origin.ROBOT, Origin.OBJECT), _WALL_CELL]
                self._values.report_unknown(
                    self._values.field(layout, "legend", letter).span, "robot or object", body, standing
                )
        return legend

    def _is_small(self, text: SourceText) -> bool:
        if len(text.text.split()) <= _MAX_CELLS:
            return True
        self._values.add(
            "DB005", text.span, f"the map has more than {_MAX_CELLS:,} cells", "use larger cells"
        )
        return False

    def _is_even(self, rows: list[list[tuple[str, Span]]]) -> bool:
        for row in rows[1:]:
            if len(row) != len(rows[0]):
                self._values.add(
                    "DB106",
                    row[0][1],
                    f"this row has {len(row)} cells, but the first row has {len(rows[0])}",
                    "separate cells by spaces, and write a dot for an empty cell",
                )
                return False
        return True

    def _check_size(self, width: float, depth: float, path: NodePath) -> None:
        arena = self._world.arena
        if arena is not None and (width > arena.size[0] + 1e-9 or depth > arena.size[1] + 1e-9):
            self._values.add_at_key(
                "DB105",
                path,
                f"the map is {width:g} by {depth:g} m, but the arena is only {arena.size[0]:g} by"
                f" {arena.size[1]:g} m",
                "use smaller cells, or a larger arena",
            )

    def _standing(
        self,
        layout: str,
        body: str,
        cell: float,
        spots: tuple[tuple[float, float], ...],
        path: NodePath,
        *,
        used: bool,
    ) -> Placement:
        """Return the body on the spots of its letters, in the attitude of its own `pose`."""
        if body == _WALL_CELL and self._namespace.origin(_WALL_CELL) not in (Origin.ROBOT, Origin.OBJECT):
            name = f"{layout} wall"
            if used:
                self._build(name, cell, len(spots))
            return Placement(name, {}, rests=True, spot=Cells(spots), owner=draws_owner((*path, _WALL_CELL)))
        home = self._places.at_own_pose(body)
        orientation = {
            key: coordinate for key, coordinate in home.coordinates.items() if key not in ("x", "y")
        }
        return replace(home, coordinates=orientation, spot=Cells(spots), owner=draws_owner((*path, body)))

    def _build(self, name: str, cell: float, count: int) -> None:
        arena = self._world.arena
        height, color = (arena.wall_height, arena.color or WALL_COLOR) if arena else (0.1, WALL_COLOR)
        span = self._values.key_span(("reset", "layouts"))
        bodies = (
            len(self._world.robots)
            + sum(body.bodies for body in self._world.objects)
            + len(self.walls)
            + count
        )
        if bodies > MAX_BODIES:
            self._values.add(
                "DB005",
                span,
                f"the world has {bodies:,} bodies, including the walls of maps; the limit is {MAX_BODIES}",
                "write long walls under `world.walls`, or use larger cells",
            )
            return
        group = ObjectGroup(name, count, Expression("count", span, "", _fixed(float(count), NUMBER), name))
        self._namespace.groups[name] = group
        self.walls += [
            ObjectBody(copy, Box((cell, cell, height)), color=color, fixed=True, pooled=True)
            for copy in group.copies
        ]


def _rows(text: SourceText) -> list[list[tuple[str, Span]]]:
    """Return the cells of each row that is not empty, with their places in the file."""
    rows = (
        re.compile(r"\S+").finditer(text.text, *line.span()) for line in re.finditer(r"[^\n]+", text.text)
    )
    cells = ([(cell[0], text.part(*cell.span())) for cell in row] for row in rows)
    return [row for row in cells if row]
