"""How an episode begins."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

from deepbots_cli.expressions.scalar import Scalar, is_drawn
from deepbots_cli.ir.values import NamedValues

MOST_SPOTS = 1_000_000  # of a region with a grid


@dataclass(frozen=True)
class Region:
    """A rectangle in the ground plane, from `low` to `high` in m, where the origin of a body is drawn.

    With a `mesh` (m) the spots are the middles of as many cells of that size as fit, about the middle of the rectangle.
    """

    low: tuple[float, float]
    high: tuple[float, float]
    mesh: float | None = None

    @property
    def spots(self) -> float:
        """How many cells it has; 1 without a mesh."""
        return math.prod(max(1.0, (end - start) / self.mesh) for start, end in zip(self.low, self.high, strict=True)) if self.mesh else 1.0


@dataclass(frozen=True)
class Cells:
    """Certain spots (m), one for each body."""

    spots: tuple[tuple[float, float], ...]


@dataclass(frozen=True)
class Top:
    """The level top of the object `of`, wherever that stands: the body is drawn so that it stands on it as a whole.

    With a `region` (world frame) only what of it lies on the top; with a `mesh` (m) from the middles of cells of that size.
    """

    of: str
    region: Region | None = None
    mesh: float | None = None


@dataclass(frozen=True)
class Place:
    """Where a body, or each present copy of a group, begins: the pose of its root link's origin, and how that moves.

    x, y, z in m; roll, pitch, yaw in rad; velocities in m/s and rad/s in the world frame, or nothing for rest. What
    `rests` has its z counted from where it would lie on the ground, or on the top of an object where the `spot` is one. With a
    `spot`, x and y are drawn from there, by the stream of that name: within the arena's walls and clear of what has a place
    already, `clearance` m at least. Of a group, `at_most` so many copies are placed, and each stands `spacing` (m along x and y)
    from the one before.
    """

    body: str
    xyz: tuple[Scalar, Scalar, Scalar]
    rpy: tuple[Scalar, Scalar, Scalar]
    velocity: tuple[Scalar, ...] = ()
    angular_velocity: tuple[Scalar, ...] = ()
    rests: bool = False
    spot: Region | Cells | Top | None = None
    clearance: float = 0.0
    at_most: int | None = None
    spacing: tuple[float, float] = (0.0, 0.0)
    stream: str = ""


@dataclass(frozen=True)
class Layout:
    """One way to arrange bodies, taken in this share of the episodes; the bodies of `Reset.places` stand in all of them."""

    name: str
    share: float
    places: tuple[Place, ...]


@dataclass(frozen=True)
class Group:
    """Copies `name#1` to `name#capacity` of a body, of which the first `count` take part in an episode."""

    name: str
    capacity: int
    count: Scalar


@dataclass(frozen=True)
class SetJoint:
    """The position of a joint at reset, in rad or m; its velocity in rad/s or m/s is 0 unless given."""

    robot: str
    joint: str
    position: Scalar
    velocity: Scalar


@dataclass(frozen=True)
class Variation:
    """A figure that is drawn anew in every episode, and whose it is.

    `what` is an entry of the table of variations (`compiler.emit.variations`), such as `mass` of
    ("dog", "trunk"), which says how many values it takes; where the figure belongs in the compiled
    scenario stands its nominal value.
    """

    what: str
    of: tuple[str, ...]
    values: tuple[Scalar, ...]


@dataclass(frozen=True)
class Reset:
    """In order: variations, a layout, places, joints, then `settle` seconds of physics with the actuators holding.

    What has coordinates is placed before what looks for a spot. Where there is none, or what is required does not hold,
    everything from the layout on is drawn again, `attempts` times at most.
    """

    places: tuple[Place, ...] = ()
    joints: tuple[SetJoint, ...] = ()
    settle: float = 0.0
    variations: tuple[Variation, ...] = ()
    groups: tuple[Group, ...] = ()
    layouts: tuple[Layout, ...] = ()
    require: Scalar | None = None
    attempts: int = 100

    @property
    def drawn(self) -> Iterator[NamedValues]:
        """The places and joints of which an episode draws something, by their paths in the scenario; copies of a group have none.

        Coordinates and joints are single numbers (m, rad), velocities of bodies have three components (m/s, rad/s).
        """
        groups = {group.name for group in self.groups}
        arranged = (("reset.place", self.places), *((f"reset.layouts.{layout.name}", layout.places) for layout in self.layouts))
        found = [entry for path, places in arranged for place in places if place.body not in groups for entry in _of_place(path, place)]
        for joint in self.joints:
            path = f"reset.set.{joint.robot}.{joint.joint}"
            found += [NamedValues(path, (), (joint.position,)), NamedValues(f"{path}.velocity", (), (joint.velocity,))]
        yield from (entry for entry in found if any(map(is_drawn, entry.values)))


def _of_place(path: str, place: Place) -> Iterator[NamedValues]:
    for axis, value in zip(("x", "y", "z", "roll", "pitch", "yaw"), (*place.xyz, *place.rpy), strict=True):
        yield NamedValues(f"{path}.{place.body}.{axis}", (), (value,))
    for key, values in (("velocity", place.velocity), ("angular_velocity", place.angular_velocity)):
        yield NamedValues(f"{path}.{place.body}.{key}", ("x", "y", "z"), values)
