"""Sensors: what each measures, where it sits, and how it errs."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from deepbots_cli.robots.model import Pose

MOST_RAYS = 4096
MOST_SENSED_RAYS = 4 * MOST_RAYS  # of all sensors of a robot
MOST_PIXELS = 1024
"""Per side of a picture."""
FINEST = 1e-12
"""The least step between two readings, in the sensor's unit."""

Combined = Literal["each", "nearest", "mean"]
Channels = Literal["rgb", "grey", "depth", "mask"]


@dataclass(frozen=True)
class Faults:
    """How a sensor errs; figures have one entry per component, and none where there is no such fault.

    Noises are standard deviations. Figures are in the sensor's unit, `drift` in that unit per second, and
    those that are relative are fractions of the value. `period` is in ticks, `latency` in s. Where a
    figure is drawn in every episode, its nominal value stands here and a `Variation` beside it.
    """

    period: int = 1
    latency: float = 0.0
    noise: tuple[float, ...] = ()
    relative_noise: tuple[float, ...] = ()
    bias: tuple[float, ...] = ()
    relative_bias: tuple[float, ...] = ()
    drift: tuple[float, ...] = ()
    low: tuple[float, ...] = ()
    high: tuple[float, ...] = ()
    quantise: tuple[float, ...] = ()


@dataclass(frozen=True)
class Lookup:
    """The reading at each distance (m, rising), straight in between and constant beyond; `noise` in fractions of the reading."""

    distance: tuple[float, ...]
    value: tuple[float, ...]
    noise: tuple[float, ...] = ()


@dataclass(frozen=True)
class Beams:
    """Rays along x of frames in the sensor's frame, free up to `reach` m; `combined` says what becomes of several.

    `spot` is the diameter in m of what a reflectance sensor sees of the ground, along -z of those frames.
    """

    rays: tuple[Pose, ...]
    reach: float
    combined: Combined = "each"
    lookup: Lookup | None = None
    spot: float = 0.0


@dataclass(frozen=True)
class Optics:
    """A picture of so many columns and rows, that covers `fov` rad from top to bottom.

    In a picture of depths, `near` m is black and `far` m white.
    """

    width: int
    height: int
    fov: float
    channels: Channels = "rgb"
    near: float = 0.0
    far: float = 10.0

    @property
    def shape(self) -> tuple[int, int, int]:
        """Rows, columns, channels."""
        return (self.height, self.width, 3 if self.channels == "rgb" else 1)


@dataclass(frozen=True)
class Sensor:
    """What a robot can read. `subjects` are joints or links, as its kind says; `mount` is its frame in its link.

    `components` is empty for a single value. `against` lists what a touch sensor feels (full names, or
    `ground`), None for everything. `faults` None is a perfect sensor.
    """

    name: str
    kind: str
    subjects: tuple[str, ...]
    components: tuple[str, ...]
    unit: str
    mount: Pose = Pose()
    faults: Faults | None = None
    beams: Beams | None = None
    optics: Optics | None = None
    against: tuple[str, ...] | None = None
