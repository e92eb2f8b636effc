"""Layouts: places for some bodies under a name, and maps drawn in letters."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import replace

from deepbots_cli.compiler.namespace import Namespace, Origin
from deepbots_cli.compiler.places import Places, owner_of
from deepbots_cli.compiler.scopes import ParameterScope
from deepbots_cli.compiler.values import Text
from deepbots_cli.diagnostics import Span
from deepbots_cli.document.nodes import Path
from deepbots_cli.expressions.dimensions import LENGTH, NUMBER
from deepbots_cli.expressions.intervals import exact
from deepbots_cli.expressions.types import Constant, Context, Type
from deepbots_cli.program.resets import Cells, Group, Layout, Placement
from deepbots_cli.program.values import Expression
from deepbots_cli.program.world import MAX_BODIES, WALL_COLOUR, ObjectBody, WorldModel
from deepbots_cli.robots.model import Box
from deepbots_cli.scenario.scenario import Scenario
from deepbots_cli.scenario.task import MapLayout

_NOTHING = "."
_WALL = "wall"
_MOST_CELLS = 250_000


class Layouts:
    """The layouts that episodes use. `walls` are the bodies that stand in cells of walls, absent in other layouts."""

    def __init__(self, spec: Scenario, namespace: Namespace, places: Places, world: WorldModel) -> None:
        self._spec = spec
        self._namespace = namespace
        self._values = namespace.values
        self._places = places
        self._world = world
        self._fixed = ParameterScope(namespace, Context.FIXED)
        self.walls: list[ObjectBody] = []

    def used(self) -> tuple[Layout, ...]:
        """Each layout with its share; all others are read for their findings alone."""
        given, layouts = self._spec.reset.layout, self._spec.reset.layouts
        shares = self._shares() if isinstance(given, dict) else {given: 1.0} if given is not None else dict.fromkeys(list(layouts)[:1], 1.0)
        if given is None and len(layouts) > 1:
            help = f"name one, or a mixture: `layout: {next(iter(layouts))}`"
            self._values.findings.add("DB102", self._values.key_span(("reset", "layouts")), "missing key `layout`", help=help)
        for name in shares:
            if name not in layouts:
                path: Path = ("reset", "layout", name) if isinstance(given, dict) else ("reset", "layout")
                span = self._values.key_span(path) if isinstance(given, dict) else self._values.span(path)
                self._values.unknown(span, "layout", name, list(layouts))
        found = {name: tuple(self._layout(name, used=name in shares)) for name in layouts}
        return tuple(Layout(name, share, found[name]) for name, share in shares.items() if name in found)

    def _shares(self) -> dict[str, float]:
        given = self._spec.reset.layout
        assert isinstance(given, dict)  # as the caller found
        path: Path = ("reset", "layout")
        read = {name: self._values.number((*path, name), share, NUMBER, self._fixed) for name, share in given.items()}
        shares = {name: share for name, share in read.items() if share is not None}
        if len(shares) == len(read) and abs(sum(shares.values()) - 1.0) > 1e-6:
            headline = f"shares of {100 * sum(shares.values()):g} % together"
            self._values.findings.add("DB105", self._values.key_span(path), headline, help="let them add up to 100 %")
        return shares

    def _layout(self, name: str, *, used: bool) -> list[Placement]:
        path: Path = ("reset", "layouts", name)
        layout = self._spec.reset.layouts[name]
        if isinstance(layout, MapLayout):
            return self._map(name, layout, path, used=used)
        return self._places.placements(layout, path, used=used)

    # Maps

    def _map(self, name: str, layout: MapLayout, path: Path, *, used: bool) -> list[Placement]:
        """Each letter's body on the cells that bear it; the first row is the farthest along y, the middle is the origin."""
        cell = self._values.number((*path, "cell"), layout.cell, LENGTH, self._fixed)
        text = self._values.text((*path, "map"), layout.map)
        rows = _rows(text) if self._is_small(text) else []
        if cell is None or not rows or not self._is_even(rows):
            return []
        self._check_size(len(rows[0]) * cell, len(rows) * cell, (*path, "cell"))
        legend = self._legend(layout, path)
        spots: dict[str, list[tuple[float, float]]] = {letter: [] for letter in legend}
        for number, row in enumerate(rows):
            for column, (letter, span) in enumerate(row):
                if letter in spots:
                    spots[letter].append(((column - (len(row) - 1) / 2) * cell, ((len(rows) - 1) / 2 - number) * cell))
                elif letter != _NOTHING and letter not in layout.legend:
                    self._values.unknown(span, "letter", letter, [_NOTHING, *layout.legend])
        bodies: dict[str, list[tuple[float, float]]] = {}
        for letter, body in legend.items():
            bodies.setdefault(body, []).extend(spots[letter])
        return [self._standing(name, body, cell, tuple(found), path, used=used) for body, found in bodies.items() if found]

    def _legend(self, layout: MapLayout, path: Path) -> dict[str, str]:
        """The letters whose bodies are known."""
        found = {}
        for letter, body in layout.legend.items():
            if body == _WALL or self._namespace.origin(body) in (Origin.ROBOT, Origin.OBJECT):
                found[letter] = body
            else:
                known = [*self._namespace.named(Origin.ROBOT, Origin.OBJECT), _WALL]
                self._values.unknown(self._values.span((*path, "legend", letter)), "robot or object", body, known)
        return found

    def _is_small(self, text: Text) -> bool:
        if len(text.text.split()) <= _MOST_CELLS:
            return True
        self._values.findings.add("DB005", text.span, f"a map of more than {_MOST_CELLS:_} cells", help="use larger cells")
        return False

    def _is_even(self, rows: list[list[tuple[str, Span]]]) -> bool:
        for row in rows[1:]:
            if len(row) != len(rows[0]):
                headline = f"a row of {len(row)} cells below one of {len(rows[0])}"
                self._values.findings.add("DB106", row[0][1], headline, help="write a dot for each empty cell, and blanks between cells")
                return False
        return True

    def _check_size(self, width: float, depth: float, path: Path) -> None:
        arena = self._world.arena
        if arena is not None and (width > arena.size[0] + 1e-9 or depth > arena.size[1] + 1e-9):
            headline = f"a map of {width:g} by {depth:g} m in an arena of {arena.size[0]:g} by {arena.size[1]:g} m"
            self._values.findings.add("DB105", self._values.key_span(path), headline, help="give smaller cells, or a larger arena")

    def _standing(
        self, layout: str, body: str, cell: float, spots: tuple[tuple[float, float], ...], path: Path, *, used: bool
    ) -> Placement:
        """The body on the spots of its letters, in the attitude of its own `pose`."""
        if body == _WALL and self._namespace.origin(_WALL) not in (Origin.ROBOT, Origin.OBJECT):
            name = f"{layout} wall"
            if used:
                self._build(name, cell, len(spots))
            return Placement(name, {}, rests=True, spot=Cells(spots), owner=owner_of((*path, _WALL)))
        home = self._places.at_home(body)
        turned = {key: coordinate for key, coordinate in home.coordinates.items() if key not in ("x", "y")}
        return replace(home, coordinates=turned, spot=Cells(spots), owner=owner_of((*path, body)))

    def _build(self, name: str, cell: float, count: int) -> None:
        arena = self._world.arena
        height, colour = (arena.wall_height, arena.colour or WALL_COLOUR) if arena else (0.1, WALL_COLOUR)
        number = Constant(Type(NUMBER, interval=exact(float(count))), 0, 0, (float(count),))
        span = self._values.key_span(("reset", "layouts"))
        bodies = len(self._world.robots) + sum(thing.bodies for thing in self._world.objects) + len(self.walls) + count
        if bodies > MAX_BODIES:
            headline = f"the world has {bodies:_} bodies, the walls of maps among them, more than {MAX_BODIES}"
            self._values.findings.add("DB005", span, headline, help="put up long walls under `world.walls`, or use larger cells")
            return
        group = Group(name, count, Expression("count", span, "", number, name))
        self._namespace.groups[name] = group
        self.walls += [ObjectBody(copy, Box((cell, cell, height)), colour=colour, fixed=True, pooled=True) for copy in group.copies]


def _rows(text: Text) -> list[list[tuple[str, Span]]]:
    """The cells of each row that is not empty, with their places in the file."""
    return [row for row in _lines(text) if row]


def _lines(text: Text) -> Iterator[list[tuple[str, Span]]]:
    for line in re.finditer(r"[^\n]+", text.text):
        cells = re.finditer(r"\S+", line[0])
        yield [(cell[0], text.part(line.start() + cell.start(), line.start() + cell.end())) for cell in cells]
