"""The start of an episode, its variations, and its disturbances."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Literal, NamedTuple

from deepbots_cli.expressions.lower import fold_operation
from deepbots_cli.expressions.scalar import Const, Scalar, is_drawn
from deepbots_cli.program.values import Expression, NamedScalars
from deepbots_cli.program.world import EngineParameter
from deepbots_cli.robots import kinematics
from deepbots_cli.robots.model import RobotModel, Shape

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

    def digest_fields(self) -> dict[str, object]:
        names = (
            "body",
            "xyz",
            "rpy",
            "velocity",
            "angular_velocity",
            "seeks_height",
            "spot",
            "clearance",
            "at_most",
            "spacing",
            "stream",
        )
        return {name: getattr(self, name) for name in names}

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

    def digest_fields(self) -> dict[str, object]:
        return {"robot": self.robot, "states": self.states}


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

    def digest_fields(self) -> dict[str, object]:
        return {"what": self.what, "of": self.of, "scalars": self.scalars}


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
