"""The start of an episode, its variations and its disturbances; the draws of the reset, every number and
every name, by its place in the scenario.

The names of draws are those of `drawn` in the info of a reset, and of the `options` that a reset takes.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import field
from functools import cached_property
from typing import TYPE_CHECKING, Literal, NamedTuple, TypedDict

from deepbots_cli.expressions.dimensions import NUMBER, Unit
from deepbots_cli.expressions.functions import FUNCTIONS, Family
from deepbots_cli.expressions.lower import fold_operation
from deepbots_cli.expressions.scalar import Const, Draw, Scalar, is_drawn, names_in, walk
from deepbots_cli.expressions.types import Invocation, TypedNode, unit_of_text
from deepbots_cli.expressions.types import walk as walk_typed
from deepbots_cli.program.values import Expression, NamedScalars, numbers
from deepbots_cli.program.world import EngineParameter
from deepbots_cli.records import dataclass
from deepbots_cli.robots import kinematics
from deepbots_cli.robots.model import RobotModel, Shape

if TYPE_CHECKING:
    from deepbots_cli.program import Program


MAX_SPOTS = 1_000_000  # the spots of a region with a grid

Triple = tuple[Scalar, Scalar, Scalar]

_NOTHING: Triple = (Const(0.0), Const(0.0), Const(0.0))


@dataclass(frozen=True)
class Region:
    """A rectangle in the ground plane, from `low` to `high` in m, where the origin of a body is drawn.

    With a `mesh` (m) the spots are the middles of as many cells of that size as fit, about the middle of the
    rectangle.
    """

    low: tuple[float, float]
    high: tuple[float, float]
    mesh: float | None = None

    @property
    def spots(self) -> float:
        """The number of its cells; 1 without a mesh."""
        return (
            math.prod(
                max(1.0, (end - start) / self.mesh) for start, end in zip(self.low, self.high, strict=True)
            )
            if self.mesh
            else 1.0
        )

    @property
    def is_too_small(self) -> bool:
        """Whether no cell fits into it."""
        # 0.3 / 0.1 is 2.9999999999999996.
        return any(
            (high - low) * (1 + 1e-9) < (self.mesh or 0.0)
            for low, high in zip(self.low, self.high, strict=True)
        )


@dataclass(frozen=True)
class Cells:
    """Fixed spots (m), one for each body."""

    spots: tuple[tuple[float, float], ...]


@dataclass(frozen=True)
class Top:
    """The level top of the object `of`, wherever it is: the body is drawn so that it stands on the top as a
    whole.

    With a `region` (world frame) only its part on the top is used; with a `mesh` (m) from the middles of
    cells of that size.
    """

    of: str
    region: Region | None = None
    mesh: float | None = None


@dataclass(frozen=True, eq=False)
class Placement:
    """The initial state of a body, or of each present copy of a group: the pose of its root link's origin,
    and its velocities.

    `coordinates` contains x, y, z in m and roll, pitch, yaw in rad; a missing coordinate is 0, and `heading`
    (rad) is added to the yaw. Velocities are in m/s and rad/s in the world frame; without them, the body is
    at rest. If the body `rests`, it has no height: z counts from its height at rest on the ground, or on the
    top of an object if the `spot` is one. The height of `lying`, its shape on flat ground with its `joints`
    at these positions (rad or m), is known beforehand. With a `spot`, x and y are drawn from there, by a
    stream named after the `owner`: within the arena's walls and clear of bodies that have a place already,
    `clearance` m at least. For a group, at most `at_most` copies are placed, and each stands `spacing` (m
    along x and y) from the one before.
    """

    body: str
    coordinates: Mapping[str, Expression]
    velocity: Expression | None = None
    angular_velocity: Expression | None = None
    rests: bool = False
    heading: float = 0.0
    spot: Region | Cells | Top | None = None
    clearance: float = 0.0
    at_most: int | None = None
    spacing: tuple[float, float] = (0.0, 0.0)
    owner: str = ""
    lying: Shape | RobotModel | None = None
    joints: Mapping[str, float] = field(default_factory=dict)

    def _coordinate(self, key: str) -> Scalar:
        return self.coordinates[key].scalar if key in self.coordinates else Const(0.0)

    @cached_property
    def rpy(self) -> Triple:
        return (
            self._coordinate("roll"),
            self._coordinate("pitch"),
            fold_operation("add", Const(self.heading), self._coordinate("yaw")),
        )

    @cached_property
    def xyz(self) -> Triple:
        height = self._coordinate("z") if self._height is None else Const(self._height)
        return self._coordinate("x"), self._coordinate("y"), height

    @cached_property
    def _height(self) -> float | None:
        """The height (m) at which a lying body in a known attitude rests."""
        roll, pitch, _ = self.rpy
        if (
            not self.rests
            or self.lying is None
            or not isinstance(roll, Const)
            or not isinstance(pitch, Const)
        ):
            return None
        return kinematics.resting_height(self.lying, roll.value, pitch.value, self.joints)

    @property
    def seeks_height(self) -> bool:
        """Whether the height is found when an episode begins."""
        return self.rests and self._height is None

    @property
    def stream(self) -> str:
        return self.owner if self.spot else ""

    @property
    def velocities(self) -> tuple[tuple[str, tuple[Scalar, ...]], ...]:
        """The velocities that are given, by name."""
        velocities = (("velocity", self.velocity), ("angular_velocity", self.angular_velocity))
        return tuple((name, value.scalars) for name, value in velocities if value is not None)

    @property
    def pose(self) -> dict[str, Scalar]:
        """The values of x, y, z, roll, pitch and yaw."""
        return dict(zip(("x", "y", "z", "roll", "pitch", "yaw"), (*self.xyz, *self.rpy), strict=True))

    def drawn(self, path: str) -> Iterator[NamedScalars]:
        for axis, value in self.pose.items():
            yield NamedScalars(f"{path}.{self.body}.{axis}", (), (value,))
        for key, values in self.velocities:
            yield NamedScalars(f"{path}.{self.body}.{key}", ("x", "y", "z"), values)


@dataclass(frozen=True, eq=False)
class Layout:
    """An arrangement of bodies, and its share of the episodes; the bodies of `Reset.placements` are in all
    arrangements."""

    name: str
    share: float
    placements: tuple[Placement, ...]


@dataclass(frozen=True, eq=False)
class ObjectGroup:
    """Copies `name#1` to `name#capacity` of a body, of which the first `count` take part in an episode."""

    name: str
    capacity: int
    count: Expression

    @property
    def copies(self) -> tuple[str, ...]:
        return tuple(f"{self.name}#{index + 1}" for index in range(self.capacity))


@dataclass(frozen=True, eq=False)
class JointStart:
    """Joints that start at a position (rad or m; one value per joint, or one for all), at a velocity (rad/s
    or m/s, 0 if None)."""

    robot: str
    joints: tuple[str, ...]
    position: Expression
    velocity: Expression | None

    @cached_property
    def states(self) -> tuple[tuple[str, Scalar, Scalar], ...]:
        """Each joint with its position and its velocity."""
        velocities = self.velocity.scalars if self.velocity else (Const(0.0),) * len(self.joints)
        return tuple(zip(self.joints, self.position.scalars, velocities, strict=True))


class OfWorld(NamedTuple):
    """The world itself."""


class OfLink(NamedTuple):
    """A link of a body; the root link of an object has an empty name."""

    body: str
    link: str = ""


class OfJoint(NamedTuple):
    robot: str
    joint: str


class OfActuator(NamedTuple):
    robot: str
    actuator: str


class OfSensor(NamedTuple):
    """A field of the noise model of a sensor, or its `latency`."""

    robot: str
    sensor: str
    field: str


class OfWalls(tuple[str, ...]):
    """Several fixed bodies that have one value."""


Owner = OfWorld | OfLink | OfJoint | OfActuator | OfSensor | OfWalls
"""The owner of a value."""
ActuatorParameter = Literal[
    "actuator_strength",
    "actuator_max_torque",
    "actuator_stiffness",
    "actuator_damping",
    "actuator_delay",
    "actuator_time_constant",
]
Randomizable = EngineParameter | ActuatorParameter | Literal["walls_friction", "sensor"]


@dataclass(frozen=True, eq=False)
class RandomizedParameter:
    """A value that is drawn anew in every episode, such as the `mass` of `OfLink("dog", "trunk")`.

    The program has the nominal value in the place of the parameter. A single value is used for all of `size`
    values. `max` cuts values off, one limit per value. The first value of a `color` is the number of one of
    the colors after it, three shares each.
    """

    what: Randomizable
    of: Owner
    value: Expression
    size: int = 1
    max: tuple[float | None, ...] = ()

    @cached_property
    def scalars(self) -> tuple[Scalar, ...]:
        scalars = self.value.scalars
        scalars = scalars * self.size if len(scalars) == 1 else scalars
        if not self.max:
            return scalars
        pairs = zip(scalars, self.max, strict=True)
        return tuple(
            scalar if limit is None else fold_operation("min", scalar, Const(limit))
            for scalar, limit in pairs
        )


@dataclass(frozen=True, eq=False)
class Reset:
    """The steps of a reset, in order: randomized parameters, a layout, placements, joints, then physics for
    `settle` seconds.

    While the world settles, actuators keep their joints in place. Bodies with coordinates are placed before
    bodies that need a free spot. If a body has no spot or `require` is false, the reset draws again from the
    layout on, at most `attempts` times.
    """

    placements: tuple[Placement, ...] = ()
    joint_starts: tuple[JointStart, ...] = ()
    settle: float = 0.0
    variations: tuple[RandomizedParameter, ...] = ()
    groups: tuple[ObjectGroup, ...] = ()
    layouts: tuple[Layout, ...] = ()
    require: Expression | None = None
    attempts: int = 100

    @cached_property
    def joint_positions(self) -> dict[str, dict[str, float]]:
        """The positions (rad or m) of the joints of each robot that start at the same one in every episode; a
        drawn one is not among them."""
        positions: dict[str, dict[str, float]] = {}
        for start in self.joint_starts:
            for joint, position, _ in start.states:
                if isinstance(position, Const):
                    positions.setdefault(start.robot, {})[joint] = position.value
        return positions

    @property
    def drawn(self) -> Iterator[NamedScalars]:
        """Drawn places and joints, by their paths in the scenario; copies of a group have none.

        Coordinates and joints are single numbers (m, rad), velocities of bodies have three components (m/s,
        rad/s).
        """
        groups = {group.name for group in self.groups}
        entries = [
            entry for path, place in self._arranged if place.body not in groups for entry in place.drawn(path)
        ]
        for start in self.joint_starts:
            for joint, position, velocity in start.states:
                path = f"reset.joints.{start.robot}.{joint}"
                entries += [
                    NamedScalars(path, (), (position,)),
                    NamedScalars(f"{path}.velocity", (), (velocity,)),
                ]
        yield from (entry for entry in entries if any(map(is_drawn, entry.scalars)))

    @property
    def expressions(self) -> Iterator[tuple[str, Expression]]:
        """The expressions of places and joints, by the names of `drawn`."""
        for path, place in self._arranged:
            velocities = {"velocity": place.velocity, "angular_velocity": place.angular_velocity}
            for key, value in (*place.coordinates.items(), *velocities.items()):
                if value is not None:
                    yield f"{path}.{place.body}.{key}", value
        for start in self.joint_starts:
            for joint in start.joints:
                path = f"reset.joints.{start.robot}.{joint}"
                yield path, start.position
                if start.velocity is not None:
                    yield f"{path}.velocity", start.velocity

    @property
    def _arranged(self) -> Iterator[tuple[str, Placement]]:
        """Each placement with the path of its section."""
        yield from (("reset.place", place) for place in self.placements)
        for layout in self.layouts:
            yield from ((f"reset.layouts.{layout.name}", place) for place in layout.placements)


@dataclass(frozen=True, eq=False)
class Disturbance:
    """Pushes of a link at its origin (`link` None is the root link, or an object), in the axes of the world.

    The first push begins `first` s into the episode (by default after one interval), each further one `every`
    s after the one before; without `every` there is one. Force (N), torque (N m), `duration` (s) and `every`
    are computed anew for each push.
    """

    name: str
    body: str
    link: str | None
    force: Expression | None
    torque: Expression | None
    first: Expression | None
    every: Expression | None
    duration: Expression

    @property
    def begins(self) -> Scalar:
        """The time when the first push begins, in s."""
        begins = self.first or self.every
        return Const(0.0) if begins is None else begins.scalar

    @property
    def wrench(self) -> tuple[tuple[Scalar, ...], tuple[Scalar, ...]]:
        """Force and torque, three components each."""
        force, torque = (_NOTHING if value is None else value.scalars for value in (self.force, self.torque))
        return force, torque


# Draws


_PLANE = ("x", "y")

_OF_MEMBER = r"(?:reset\.place|reset\.layouts\.\w+|objects)\.\w+#\d+\."

_OF_COPY = r"\w+#\d+\."


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
    return re.match(_OF_MEMBER, name) is not None


def without_copy(name: str) -> str:
    """Return the name of a draw without the copy of a robot that it is for, such as `cart#2.`."""
    return re.sub(_OF_COPY, "", name, count=1) if re.match(_OF_COPY, name) else name


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
