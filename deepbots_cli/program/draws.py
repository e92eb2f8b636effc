"""The draws of the reset of an episode: every number and every name, by its place in the scenario.

The names are those of `drawn` in the info of a reset, and of the `options` that a reset takes.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, NamedTuple, TypedDict

from deepbots_cli.expressions.dimensions import NUMBER, Unit
from deepbots_cli.expressions.functions import FUNCTIONS, Family
from deepbots_cli.expressions.scalar import Const, Draw, Scalar, is_drawn, names_in, walk
from deepbots_cli.expressions.types import Invocation, TypedNode, unit_of_text
from deepbots_cli.expressions.types import walk as walk_typed
from deepbots_cli.program.resets import (
    Cells,
    ObjectGroup,
    OfJoint,
    OfLink,
    OfWalls,
    OfWorld,
    Placement,
    RandomizedParameter,
    Region,
    Top,
)
from deepbots_cli.program.values import Expression, NamedScalars, numbers

if TYPE_CHECKING:
    from deepbots_cli.program import Program

_PLANE = ("x", "y")

_OF_MEMBER = re.compile(r"(?:reset\.place|reset\.layouts\.\w+|objects)\.\w+#\d+\.")

_OF_COPY = re.compile(r"\w+#\d+\.")


class _Units(TypedDict):
    """The SI unit of a draw, and the unit in which the scenario writes it."""

    si: str
    unit: Unit | None


_SI = _Units(si="1", unit=None)
_FACTOR = Unit("(factor)", NUMBER)
"""The unit of a number by which the scenario multiplies another one, as in `urdf * uniform(0.9 .. 1.1)`."""


class EpisodeDraw(NamedTuple):
    """A number (SI units) or a word that a reset draws.

    `key` is the name under which the runtime notes it. `tree` computes a number; a position that is looked
    for lies from `low` to `high`; a word is one of `words`. With copies of a robot, the draw may be one for
    each copy. It may change within the episode.

    `si` is the SI unit of a number, and `unit` the unit in which the scenario writes it, None if it writes
    none. `is_parameter` is true for parameters of the scenario.
    """

    name: str
    key: str
    tree: Scalar | None = None
    words: tuple[str, ...] = ()
    low: float = -math.inf
    high: float = math.inf
    is_of_copy: bool = False
    changes: bool = False
    si: str = "1"
    unit: Unit | None = None
    is_parameter: bool = False


def key_of_member(member: str, name: str) -> str:
    """Return the key of a draw that is made once for each member `crate#2` of a group; `name` is the name of
    its stream."""
    return f"{member}|{name}"


def is_of_member(name: str) -> bool:
    """Return whether a name is that of a draw for one member of a group, such as `reset.place.crate#2.x`."""
    return _OF_MEMBER.match(name) is not None


def without_copy(name: str) -> str:
    """Return the name of a draw without the copy of a robot that it is for, such as `cart#2.`."""
    return _OF_COPY.sub("", name, count=1) if _OF_COPY.match(name) else name


def kind_key(body: str) -> str:
    """Return the name and the key of the kind of a body that is one of several kinds."""
    return f"objects.{body}.one_of"


@dataclass(frozen=True, eq=False)
class EpisodeDraws:
    """The draws of the episodes of a program."""

    program: Program

    @cached_property
    def entries(self) -> tuple[EpisodeDraw, ...]:
        """All draws: those of the scenario's expressions, then words and positions that are looked for."""
        copies = self.program.agent.copies
        robot = copies.robot if copies else ""
        entries: dict[str, EpisodeDraw] = {}
        for body, entry in self._all_draws():
            entry = entry._replace(is_of_copy=bool(robot) and body == robot)
            # A value may be given for several bodies in one place.
            entries[entry.key if entry.name in entries else entry.name] = entry
        return tuple(entry._replace(name=name) for name, entry in entries.items())

    @cached_property
    def by_name(self) -> Mapping[str, EpisodeDraw]:
        return {entry.name: entry for entry in self.entries}

    @cached_property
    def noted(self) -> tuple[EpisodeDraw, ...]:
        """The draws that last for the whole episode."""
        return tuple(entry for entry in self.entries if not entry.changes)

    @property
    def vary_start(self) -> bool:
        """Whether episodes may begin differently: a reset draws something, or looks for a position."""
        reset = self.program.reset
        arranged = (reset.placements, *(layout.placements for layout in reset.layouts))
        return bool(self.entries) or any(place.spot is not None for places in arranged for place in places)

    @cached_property
    def vectors(self) -> Mapping[str, NamedScalars]:
        """The vectors that are set as a whole, of which some components may be fixed."""
        return {entry.name: entry for entry in self.program.settable_draws if entry.components}

    def _all_draws(self) -> Iterator[tuple[str | None, EpisodeDraw]]:
        """Yield each draw with the body that it belongs to, if it belongs to one."""
        reset, agent = self.program.reset, self.program.agent
        robot = agent.copies.robot if agent.copies else None
        # Parameters with new values within an episode: their own, or those that they depend on.
        changing: set[str] = set()
        for value in self.program.parameters:
            if value.redraw is not None or _reads(value, changing):
                changing.add(value.name)
            parameter = EpisodeDraw(
                "", "", changes=value.name in changing, **_units(value.typed), is_parameter=True
            )
            yield from (
                (None, parameter._replace(name=full, key=full, tree=tree))
                for full, tree in value.numbers
                if is_drawn(tree)
            )
        yield from self._of_reset()
        routes = [
            (spec.name, route) for spec in self.program.robots for route in (spec.to_route, spec.from_route)
        ]
        routes += [(link.receiver, link.route) for link in self.program.links]
        for robot_name, route in routes:
            if route.settings:
                lasting = (
                    value
                    for _, value in route.settings
                    if value.redraw is None and not _reads(value, changing)
                )
                yield from ((robot_name, entry) for value in lasting for entry in _draws(value))
        noises = [entry.noise for entry in agent.observation]
        noises += [value.noise for value in self.program.signals]
        noises += [agent.goal.achieved.noise] if agent.goal else []
        yield from ((robot, entry) for noise in noises if noise is not None for entry in _draws(noise.std))
        for variation in reset.variations:
            body = None if isinstance(variation.of, OfWorld | OfWalls) else variation.of[0]
            yield from ((body, entry) for entry in _draws(variation.value, _name(variation)))
        yield from (
            (push.body, entry)
            for push in self.program.disturbances
            if push.first is not None
            for entry in _draws(push.first)
        )
        if len(reset.layouts) > 1:
            names = tuple(layout.name for layout in reset.layouts)
            yield None, EpisodeDraw("reset.layout", "reset.layout", words=names)
        yield from ((None, entry) for group in reset.groups for entry in _draws(group.count))
        for object_body in self.program.world.objects:
            if len(object_body.variants) > 1:
                name = kind_key(object_body.name)
                names = tuple(variant.name for variant in object_body.variants)
                yield object_body.name, EpisodeDraw(name, name, words=names)
        yield from self._of_placements()

    def _of_reset(self) -> Iterator[tuple[str | None, EpisodeDraw]]:
        """Yield the numbers of poses and joints."""
        units = self._reset_units
        for entry in self.program.reset.drawn:
            body = None if entry.name.startswith("reset.layouts.") else entry.name.split(".")[2]
            unit = units.get(entry.name, _SI)
            for full, tree in entry.numbers:
                if is_drawn(tree):
                    yield body, EpisodeDraw(full, full, tree, **unit)

    def _of_placements(self) -> Iterator[tuple[str | None, EpisodeDraw]]:
        """Yield the positions that are looked for."""
        reset = self.program.reset
        units = self._reset_units
        groups = {group.name: group for group in reset.groups}
        arranged = (
            ("reset.place", reset.placements),
            *((f"reset.layouts.{layout.name}", layout.placements) for layout in reset.layouts),
        )
        for path, places in arranged:
            for place in places:
                for entry in _places(path, place, groups.get(place.body), units):
                    yield place.body, entry

    @cached_property
    def _reset_units(self) -> dict[str, _Units]:
        return {name: _units(value.typed) for name, value in self.program.reset.expressions}


def _units(value: TypedNode) -> _Units:
    return _Units(si=str(value.type.dimension), unit=unit_of_text(value))


def _reads(value: Expression, names: set[str]) -> bool:
    return any(leaf.name in names for tree in value.scalars for leaf in names_in(tree))


def _draws(value: Expression, name: str | None = None) -> Iterator[EpisodeDraw]:
    """Yield the draws in an expression, each under the name of the component that it is for."""
    components = value.per_component or value.components
    units: dict[int | None, _Units] = {}
    for call in walk_typed(value.typed):
        if isinstance(call, Invocation) and FUNCTIONS[call.function].family is Family.DRAW:
            is_factor = call.type.dimension == NUMBER != value.typed.type.dimension
            units[call.occurrence] = _Units(si="1", unit=_FACTOR) if is_factor else _units(call)
    for entry in _named(numbers(name or value.owner, tuple(filter(None, components)), value.scalars)):
        occurrence = re.search(r"#(\d+)", entry.key.removeprefix(value.owner))
        yield entry._replace(**units.get(int(occurrence[1]), _SI) if occurrence else _SI)


def _named(trees: Iterator[tuple[str, Scalar]], member: str = "") -> Iterator[EpisodeDraw]:
    """Yield the draws in the tree of each name; several in one tree have numbers."""
    for name, tree in trees:
        draws = [node for node in walk(tree) if isinstance(node, Draw)]
        for number, draw in enumerate(draws):
            key = key_of_member(member, draw.stream) if member else draw.stream
            yield EpisodeDraw(f"{name}#{number}" if len(draws) > 1 else name, key, draw)


def _name(variation: RandomizedParameter) -> str:
    """Return the place of a randomized value, with the link, joint or member that it is for in place of a
    pattern or a group."""
    path = variation.value.owner.partition(":")[0].split(".")
    if isinstance(variation.of, OfLink | OfJoint) and path[0] in ("robots", "objects"):
        body, part = variation.of
        path[1] = body
        if len(path) > 4 and part:
            path[3:-1] = [part]
    return ".".join(path)


def _places(
    path: str, place: Placement, group: ObjectGroup | None, units: Mapping[str, _Units]
) -> Iterator[EpisodeDraw]:
    """Yield positions that are looked for, and the draws for each member of a group; `units` are those of
    coordinates with a value."""
    bounds = _bounds(place, group)
    for body in group.copies if group else (place.body,):
        member = body if group else ""
        body_path = f"{path}.{body}"
        if group:
            trees = [
                (f"{body_path}.{axis}", value)
                for axis, value in place.pose.items()
                if place.spot is None or axis not in _PLANE
            ]
            trees += [
                pair
                for key, values in place.velocities
                for pair in numbers(f"{body_path}.{key}", ("x", "y", "z"), values)
            ]
            if not bounds and not any(is_drawn(tree) for _, tree in trees):
                return
            for entry in _named(iter(trees), member):
                of_group = f"{path}.{place.body}{entry.name.removeprefix(body_path).partition('#')[0]}"
                si = "m" if of_group.endswith((".x", ".y", ".z")) else "rad"
                yield entry._replace(
                    **units.get(of_group, units.get(of_group.rpartition(".")[0], _Units(si=si, unit=None)))
                )
        # `bounds` is empty for a position that is given.
        for axis, (low, high) in zip(_PLANE, bounds, strict=False):
            stream = f"{place.stream}.{axis}"
            key = key_of_member(member, stream) if member else stream
            yield EpisodeDraw(f"{body_path}.{axis}", key, low=low, high=high, si="m")


def _bounds(place: Placement, group: ObjectGroup | None) -> Sequence[tuple[float, float]]:
    """Return the limits of x and y (m) of a position that is looked for; none if it is not."""
    match place.spot:
        case Region(low, high):
            return tuple(zip(low, high, strict=True))
        case Top(region=region):
            return (
                tuple(zip(region.low, region.high, strict=True)) if region else ((-math.inf, math.inf),) * 2
            )
        case Cells(spots):
            count = group.count.scalar if group else Const(1.0)
            is_drawn_from = not isinstance(count, Const) or count.value < len(spots)
            return tuple((min(axis), max(axis)) for axis in zip(*spots, strict=True)) if is_drawn_from else ()
    return ()
