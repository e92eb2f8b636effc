"""How an episode begins."""

from __future__ import annotations

from dataclasses import dataclass

from deepbots_cli.lang.scalar import Scalar


@dataclass(frozen=True)
class Place:
    """The pose of a body's root link origin at reset: x, y, z in m; roll, pitch, yaw in rad."""

    body: str
    xyz: tuple[Scalar, Scalar, Scalar]
    rpy: tuple[Scalar, Scalar, Scalar]


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
    """In order: variations, places, joints, then `settle` seconds of physics with the actuators holding."""

    places: tuple[Place, ...] = ()
    joints: tuple[SetJoint, ...] = ()
    settle: float = 0.0
    variations: tuple[Variation, ...] = ()
