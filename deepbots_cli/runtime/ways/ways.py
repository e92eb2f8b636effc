"""Ways between bodies: each pair that is asked for has a chart, drawn anew when what it shows has changed."""

from __future__ import annotations

from collections.abc import Callable, Iterator

from deepbots_cli.footprint import Patch, Spot
from deepbots_cli.frames import Quaternion, Triple, roll_pitch_yaw
from deepbots_cli.port import Engine, Part, PoseReader
from deepbots_cli.program import Program
from deepbots_cli.program.world import ObjectBody
from deepbots_cli.runtime.placement import Arrangement
from deepbots_cli.runtime.placement.forms import Forms
from deepbots_cli.runtime.ways.chart import Area, Chart

Shown = tuple[Area, float, list[Patch], Spot, float]
"""What a chart is drawn from: the area, the disc that goes, the solids, the goal and its radius."""
_LEEWAY = 0.5  # m around everything, where no arena says how far ways may go
_LEVEL = 1e-6  # m; what rises no higher is no obstacle


class Ways:
    """Ways of robots and objects around the solid objects of a world, robots apart.

    What goes is a disc as wide as the narrower side of its body: it turns as it must.
    """

    def __init__(self, scenario: Program, engine: Engine, bodies: Arrangement | None = None) -> None:
        """`bodies` knows which copies take part, where there are any."""
        world = scenario.world
        self._engine = engine
        self._bodies = bodies
        self._arena = world.arena
        self.forms = bodies.forms if bodies else Forms(world)
        self._solids = [(thing, engine.pose(thing.name)) for thing in world.objects if thing.solid]
        self._ways: dict[tuple[Part, Part], Way] = {}

    def reset(self) -> None:
        """A new episode begins: charts are compared with the world before they are used again."""
        for way in self._ways.values():
            way.is_current = False

    def distance(self, one: Part, other: Part) -> Callable[[], float]:
        """A reader of the length of the shortest way, m."""
        return self._way(one, other).length

    def reachable(self, one: Part, other: Part) -> Callable[[], bool]:
        """A reader of whether there is a way."""
        return self._way(one, other).is_open

    def _way(self, one: Part, other: Part) -> Way:
        if (one, other) not in self._ways:
            self._ways[one, other] = Way(self, one, other, self._engine.pose(*one), self._engine.pose(*other))
        return self._ways[one, other]

    def radius(self, part: Part) -> float:
        """Of the disc around a body; a link of it is a point."""
        return self.forms.footprint(part[0]).radius if part[1] is None else 0.0

    def is_fixed(self, part: Part) -> bool:
        return self.forms.is_fixed(part[0]) or (part[0] in self.forms.things and not self.forms.things[part[0]].solid)

    def solids(self, *but: str) -> Iterator[tuple[ObjectBody, PoseReader]]:
        """The solid objects of this episode."""
        there = self._bodies.placed if self._bodies else ()
        return ((thing, pose) for thing, pose in self._solids if thing.name not in but and (not thing.pooled or thing.name in there))

    def patch(self, thing: ObjectBody, pose: tuple[Triple, Quaternion]) -> Patch | None:
        """What an object covers where it is; nothing if it does not rise above the ground."""
        (x, y, z), turn = pose
        rpy = roll_pitch_yaw(turn)
        if self.forms.top(thing.name, z, rpy) <= _LEVEL:
            return None
        return self.forms.footprint(thing.name, rpy).at(x, y, rpy[2])

    def area(self, patches: list[Patch], ends: tuple[Spot, Spot], radius: float) -> Area:
        """The inside of the arena; without one, what there is and some room around it."""
        if self._arena is not None:
            x, y = self._arena.size[0] / 2, self._arena.size[1] / 2
            return (-x, -y, x, y)
        spots = [*((patch.x, patch.y, patch.radius) for patch in patches), *((x, y, radius) for x, y in ends)]
        room = 2 * radius + _LEEWAY
        return (
            min(x - r for x, _, r in spots) - room,
            min(y - r for _, y, r in spots) - room,
            max(x + r for x, _, r in spots) + room,
            max(y + r for _, y, r in spots) + room,
        )


class Way:
    """The way from one part of the world to another."""

    def __init__(self, ways: Ways, one: Part, other: Part, here: PoseReader, there: PoseReader) -> None:
        self.is_current = False
        self._chart: Chart | None = None
        self._shown: Shown | None = None
        self._ways = ways
        self._one, self._other = one, other
        self._here, self._there = here, there
        self._watched: list[tuple[PoseReader, float, float]] = []
        """What may move, and where it was when the chart was drawn."""

    def length(self) -> float:
        x, y, _ = self._here()[0]
        return self._current().length(x, y)

    def is_open(self) -> bool:
        x, y, _ = self._here()[0]
        return self._current().reaches(x, y)

    def _current(self) -> Chart:
        """The chart; a new one where something has moved by more than a cell."""
        if self._chart is None or not self.is_current:
            return self._draw()
        limit = self._chart.cell**2
        for read, x, y in self._watched:
            (now_x, now_y, _), _ = read()
            if (now_x - x) ** 2 + (now_y - y) ** 2 > limit:
                return self._draw()
        return self._chart

    def _draw(self) -> Chart:
        """A chart of the world as it is; the one before if that shows the same, as in a world whose bodies start where they did."""
        ways, goal = self._ways, self._there()[0]
        standing = [(thing, read, read()) for thing, read in ways.solids(self._one[0], self._other[0])]
        patches = [patch for thing, _, pose in standing if (patch := ways.patch(thing, pose)) is not None]
        self._watched = [(read, *pose[0][:2]) for thing, read, pose in standing if not ways.forms.is_fixed(thing.name)]
        if not ways.is_fixed(self._other):
            self._watched.append((self._there, goal[0], goal[1]))
        radius = ways.forms.half_width(self._one[0])
        x, y, _ = self._here()[0]
        area = ways.area(patches, ((x, y), goal[:2]), radius)
        shown: Shown = (area, radius, patches, goal[:2], ways.radius(self._other))
        if self._chart is None or shown != self._shown:
            self._chart, self._shown = Chart(*shown), shown
        self.is_current = True
        return self._chart
