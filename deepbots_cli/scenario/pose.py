"""Places and attitudes, of sensors on a link and of bodies in the world."""

from __future__ import annotations

from typing import Annotated, ClassVar

from deepbots_cli.scenario.fields import Quantity, Scalar
from deepbots_cli.scenario.part import Keys, Part, field
from deepbots_cli.scenario.quantity import DrawnAngle, DrawnCoordinate

_ONE_WAY = tuple(Keys((whole, part)) for whole, parts in (("xyz", "xyz"), ("rpy", ("roll", "pitch", "yaw"))) for part in parts)

Coordinate = Annotated[Scalar, Quantity("length")]
Angle = Annotated[Scalar, Quantity("angle")]


class Mount(Part):
    """A frame on a link, fixed once and for all."""

    needs: ClassVar[tuple[Keys, ...]] = _ONE_WAY

    x: Coordinate = field(default=0, description="Position along x of the link, m.")
    y: Coordinate = field(default=0, description="Position along y of the link, m.")
    z: Coordinate = field(default=0, description="Position along z of the link, m.")
    xyz: Annotated[Scalar, Quantity("length", components=3)] | None = field(
        default=None, description="All three coordinates at once, such as `30 0 40 mm`."
    )
    roll: Angle = field(default=0, description="Turn about x.")
    pitch: Angle = field(default=0, description="Turn about y.")
    yaw: Angle = field(default=0, description="Turn about z; left is positive.")
    rpy: Annotated[Scalar, Quantity("angle", components=3)] | None = field(
        default=None, description="Roll, pitch and yaw at once, such as `0 0 90 deg`."
    )


class Pose(Part):
    """A pose in the world, which may be drawn in every episode."""

    needs: ClassVar[tuple[Keys, ...]] = _ONE_WAY

    x: DrawnCoordinate | None = field(default=None, description="Position along x of the world, m.")
    y: DrawnCoordinate | None = field(default=None, description="Position along y of the world, m.")
    z: DrawnCoordinate | None = field(default=None, description="Height above the ground or the terrain, m.")
    xyz: Annotated[Scalar, Quantity("length", 3, "episode")] | None = field(default=None, description="All three coordinates at once.")
    roll: DrawnAngle | None = field(default=None, description="Turn about x; `any` draws it from the whole circle.")
    pitch: DrawnAngle | None = field(default=None, description="Turn about y; `any` draws it from the whole circle.")
    yaw: DrawnAngle | None = field(default=None, description="Turn about z; `any` draws it from the whole circle.")
    rpy: Annotated[Scalar, Quantity("angle", 3, "episode")] | None = field(default=None, description="Roll, pitch and yaw at once.")
