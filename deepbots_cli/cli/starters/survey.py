"""What a robot file shows of a robot's build: wheels, limbs, rotors, joints without a motor, what carries it.

Read from the shapes and joints, with all joints at 0; names count only for rotors, which nothing else tells from other links.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from math import hypot

from deepbots_cli import frames
from deepbots_cli.cli.starters.limbs import Limb
from deepbots_cli.footprint import Bounds, bounds, link_frames
from deepbots_cli.frames import UPRIGHT, Frame, Quaternion, Triple
from deepbots_cli.robots import inertia
from deepbots_cli.robots.model import Joint, Link, RobotModel

_ROTOR = re.compile(r"prop|rotor", re.IGNORECASE)
_LEVEL, _UPRIGHT = 0.3, 0.7  # the height of a unit axis: of one that lies, at most; of one that stands, at least
_ROUND = 0.15  # by how much of its radius a wheel may be out of round or above the ground


@dataclass(frozen=True)
class Wheel:
    """A wheel that stands on the ground: its axle's height is its radius (m); `axle` and `middle` in the frame of the root."""

    joint: Joint
    radius: float
    axle: Triple
    middle: Triple


@dataclass(frozen=True)
class Survey:
    """A robot and what its parts are."""

    model: RobotModel

    @cached_property
    def frames(self) -> dict[str, Frame]:
        return link_frames(self.model)

    @cached_property
    def extents(self) -> dict[str, Bounds]:
        """The box around each link that has a shape, in the frame of the root: around what touches, or else what is seen."""
        boxes = {link.name: _extent(link, self.frames[link.name]) for link in self.model.links}
        return {name: box for name, box in boxes.items() if box is not None}

    @property
    def lowest(self) -> float:
        return min((low[2] for low, _ in self.extents.values()), default=0.0)

    def height(self, positions: Mapping[str, float], tilt: Quaternion = UPRIGHT) -> float:
        """Of the root above the ground (m) when the lowest point of all touches it; joints that are not named are at 0."""
        where = link_frames(self.model, positions)
        tilted = [_extent(link, frames.inside((frames.HERE[0], tilt), where[link.name])) for link in self.model.links]
        return 0.0 - min((box[0][2] for box in tilted if box), default=0.0)

    @property
    def size(self) -> float:
        """In m, the longest side of the box around it."""
        low, high = bounds(self.model)
        return max(b - a for a, b in zip(low, high, strict=True)) or 1.0

    @property
    def mass(self) -> float:
        return sum(link.inertial.mass for link in self.model.links if link.inertial)

    @cached_property
    def trunk(self) -> tuple[str, ...]:
        """The links that are rigidly one with the root."""
        return self.rigid(self.model.root)

    @property
    def chassis(self) -> str:
        """The heaviest of them, where a sensor of motion belongs: a root link may be a mere point on the ground."""
        return max(self.trunk, key=lambda name: inertial.mass if (inertial := self.model.link(name).inertial) else 0.0)

    def rigid(self, link: str) -> tuple[str, ...]:
        """A link with all that is fixed to it, below."""
        found = [link]
        for name in found:
            found += [joint.child for joint in self.model.joints if joint.parent == name and joint.type == "fixed"]
        return tuple(found)

    def axis(self, joint: Joint) -> Triple:
        """In the frame of the root."""
        return frames.rotate(self.frames[joint.child][1], joint.axis)

    @cached_property
    def driven(self) -> tuple[Joint, ...]:
        """The joints that a motor may move: those with an effort, or all if the file gives none an effort; none that is locked."""
        free = [joint for joint in self.model.moving_joints if not _is_locked(joint)]
        told = any(joint.limit.effort for joint in free)
        return tuple(joint for joint in free if joint.limit.effort or (joint.limit.effort is None and not told))

    @property
    def weightless(self) -> tuple[Joint, ...]:
        """The joints that move nothing that has mass."""
        carried = inertia.carried(self.model)
        return tuple(joint for joint in self.model.moving_joints if carried[joint.child] <= 0.0)

    @property
    def idle(self) -> tuple[Joint, ...]:
        """The joints that move without a motor."""
        return tuple(joint for joint in self.model.moving_joints if joint not in self.driven and not _is_locked(joint))

    @property
    def inverted(self) -> tuple[Joint, ...]:
        """The idle hinges that lie below what they carry, as that of a pole on a cart."""
        hinges = [joint for joint in self.idle if joint.type != "prismatic" and abs(self.axis(joint)[2]) < _LEVEL]
        return tuple(joint for joint in hinges if self._height_of(joint.child) > self.frames[joint.child][0][2])

    def _height_of(self, link: str) -> float:
        """Of the middle of a link's mass."""
        inertial = self.model.link(link).inertial
        middle = inertial.origin.xyz if inertial else frames.HERE[0]
        return frames.add(self.frames[link][0], frames.rotate(self.frames[link][1], middle))[2]

    @cached_property
    def wheels(self) -> tuple[Wheel, ...]:
        """At least two of them, or none."""
        found = [wheel for joint in self.driven if (wheel := self._wheel(joint))]
        return tuple(found) if len(found) > 1 else ()

    def _wheel(self, joint: Joint) -> Wheel | None:
        """A joint without end whose axle lies, whose link is round about it and stands on the ground, and carries nothing that moves."""
        axle = self.axis(joint)
        endless = joint.type == "continuous" or (joint.type == "revolute" and joint.limit.lower is None)
        behind = self.rigid(joint.child)
        if not endless or abs(axle[2]) > _LEVEL or any(other.moves and other.parent in behind for other in self.model.joints):
            return None
        boxes = [self.extents[name] for name in behind if name in self.extents]
        if not boxes:
            return None
        low, high = min(low[2] for low, _ in boxes), max(high[2] for _, high in boxes)
        middle = self.frames[joint.child][0]
        radius = middle[2] - low
        if radius <= 0.0 or abs(high - middle[2] - radius) > _ROUND * radius or low - self.lowest > _ROUND * radius:
            return None
        along = hypot(axle[0], axle[1])
        length = max(b[0] - a[0] for a, b in boxes), max(b[1] - a[1] for a, b in boxes)
        across = length[0] if abs(axle[1]) > abs(axle[0]) else length[1]
        is_round = abs(across - 2.0 * radius) < 4.0 * _ROUND * radius
        return Wheel(joint, radius, (axle[0] / along, axle[1] / along, 0.0), middle) if is_round else None

    @property
    def balances(self) -> bool:
        """Whether it stands on two wheels of one axle and on nothing else."""
        rolling = {name for wheel in self.wheels for name in self.rigid(wheel.joint.child)}
        if len(self.wheels) != 2:
            return False
        slack = 0.3 * self.wheels[0].radius
        return not any(low[2] - self.lowest < slack for name, (low, _) in self.extents.items() if name not in rolling)

    @property
    def steering(self) -> tuple[Joint, ...]:
        """The upright hinges that carry a wheel."""
        hinges = [joint for joint in self.driven if joint.type != "prismatic" and abs(self.axis(joint)[2]) > _UPRIGHT]
        return tuple(joint for joint in hinges if any(wheel.joint.parent in self.rigid(joint.child) for wheel in self.wheels))

    @cached_property
    def rotors(self) -> tuple[str, ...]:
        """The links called so whose z axis stands; three at least, or none."""
        named = [link.name for link in self.model.links if _ROTOR.search(link.name)]
        upright = tuple(name for name in named if frames.rotate(self.frames[name][1], (0.0, 0.0, 1.0))[2] > _UPRIGHT)
        return upright if len(upright) > 2 else ()

    @cached_property
    def limbs(self) -> tuple[Limb, ...]:
        """What is joined to the trunk by joints that move: each as far as it does not branch."""
        return tuple(self._limb(joint) for joint in self.model.joints if joint.moves and joint.parent in self.trunk)

    def _limb(self, first: Joint) -> Limb:
        above = {joint.child: joint for joint in self.model.joints}
        joint = first
        while True:
            behind = self.rigid(joint.child)
            further = [other for other in self.model.joints if other.moves and other.parent in behind]
            if len(further) != 1:
                break
            joint = further[0]
        pivot = self.frames[joint.child][0]
        end = max(behind, key=lambda name: hypot(*frames.subtract(self.frames[name][0], pivot)))
        path = [above[end]]
        while path[0] is not first:
            path.insert(0, above[path[0].parent])
        return Limb(tuple(path), end)


def _is_locked(joint: Joint) -> bool:
    """Whether both of its limits are the same."""
    return joint.type != "continuous" and joint.limit.lower is not None and joint.limit.lower == joint.limit.upper


def _extent(link: Link, frame: Frame) -> Bounds | None:
    """The box around a link's shapes, in the frame that `frame` is given in."""
    parts = link.collisions or link.visuals
    if not parts:
        return None
    at = RobotModel("link", (replace(link, visuals=(), collisions=parts),), (), link.name)
    low, high = bounds(at)
    corners = [
        frames.add(frame[0], frames.rotate(frame[1], (x, y, z)))
        for x in (low[0], high[0])
        for y in (low[1], high[1])
        for z in (low[2], high[2])
    ]
    xs, ys, zs = zip(*corners, strict=True)
    return (min(xs), min(ys), min(zs)), (max(xs), max(ys), max(zs))
