"""The build of a robot: wheels, steering, limbs, rotors, and joints without a motor.

It is derived from shapes and joints with all joints at 0. Names are used only for rotors, which look like any
other link. All coordinates are in the frame of the root link, in m and rad.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import product
from math import atan2, dist, hypot, inf, pi, prod

from deepbots_cli import frames
from deepbots_cli.frames import IDENTITY_ROTATION, Frame, Quaternion, Triple
from deepbots_cli.robots.kinematics import (
    bounds_of_shape,
    box_around,
    box_sides,
    child_frame,
    link_frames,
    robot_bounds,
)
from deepbots_cli.robots.meshes import Bounds
from deepbots_cli.robots.model import Joint, Link, RobotModel

Positions = Mapping[str, float]
"""Joint positions by name, in rad or m; joints that are not named are at 0."""

_ROTOR = re.compile(r"prop|rotor", re.IGNORECASE)
_MAX_LEVEL_Z = 0.3
"""The largest z component of a level unit axis."""
_MIN_UPRIGHT_Z = 0.7
"""The smallest z component of an upright unit axis."""
_WHEEL_TOLERANCE = 0.15
"""The tolerance of a wheel's roundness and of its height above the ground, as a fraction of its radius."""
_MAX_ITERATIONS = 80
_LEAST_PROGRESS = 1e-3
"""The part of the distance by which a round of a search must shorten it. With a smaller progress the target
is out of reach."""
_LARGE_SHARE = 0.2
"""The share of the box around the robot that the box around a large link fills."""
_INITIAL_BEND = 0.4
"""The joint positions at which a search begins, in rad. A straight limb is a singular configuration, from
which the search does not move."""


@dataclass(frozen=True)
class Wheel:
    """A wheel on the ground; `axle` is a level unit vector."""

    joint: Joint
    radius: float
    axle: Triple
    center: Triple


@dataclass(frozen=True)
class Limb:
    """A chain of joints that does not branch. `path` has its joints in order, fixed ones too; `base` is the
    frame in which it begins."""

    path: tuple[Joint, ...]
    base: Frame

    @property
    def joints(self) -> tuple[Joint, ...]:
        return tuple(joint for joint in self.path if joint.moves)

    @property
    def tip(self) -> str:
        return self.path[-1].child

    @property
    def reach(self) -> float:
        """The length from the first joint that moves to the tip when stretched out, at most."""
        first = self.path.index(self.joints[0])
        return sum(hypot(*joint.origin.xyz) for joint in self.path[first + 1 :])

    def frames(self, positions: Positions) -> dict[str, Frame]:
        """Return the frame of the link behind each joint."""
        frame = self.base
        frames = {}
        for joint in self.path:
            frames[joint.name] = frame = child_frame(joint, frame, positions.get(joint.name, 0.0))
        return frames

    def lowest(self, positions: Positions) -> float:
        """Return the height of the lowest of these frames."""
        return min(position[2] for position, _ in self.frames(positions).values())

    def positions_for(
        self, target: Triple, using: Sequence[Joint] | None = None
    ) -> tuple[dict[str, float], float]:
        """Return joint positions that bring the tip near `target`, and the remaining distance.

        Cyclic coordinate descent: each of the joints `using`, from the last to the first, takes the position
        within its range that brings the tip nearest to the target, round after round. It needs no numpy,
        because `deepbots new` does not import it.
        """
        used = self.joints if using is None else using
        positions = {joint.name: neutral(joint) for joint in self.joints}
        positions |= {joint.name: _bent(joint, number) for number, joint in enumerate(used)}
        missing = inf
        for _ in range(_MAX_ITERATIONS):
            before = missing
            for joint in reversed(used):
                poses = self.frames(positions)
                pivot, turn = poses[joint.name]
                tip = poses[self.path[-1].name][0]
                axis = frames.rotate(turn, joint.axis)
                if joint.type == "prismatic":
                    change = frames.dot(frames.subtract(target, tip), axis)
                else:
                    arm, target_arm = frames.subtract(tip, pivot), frames.subtract(target, pivot)
                    level = frames.subtract(arm, frames.scaled(axis, frames.dot(arm, axis)))
                    change = atan2(
                        frames.dot(frames.cross(axis, level), target_arm), frames.dot(level, target_arm)
                    )
                positions[joint.name] = _clamped(joint, positions[joint.name] + change)
            missing = dist(self.frames(positions)[self.path[-1].name][0], target)
            if missing < 1e-4 or before - missing < _LEAST_PROGRESS * missing:
                break
        return positions, missing


def range_of(joint: Joint) -> tuple[float, float]:
    """Return the limits of a joint; of one without limits half a turn, or a meter, either way."""
    lower, upper = joint.limit.lower, joint.limit.upper
    if joint.type == "continuous" or lower is None or upper is None:
        return (-1.0, 1.0) if joint.type == "prismatic" else (-pi, pi)
    return lower, upper


def neutral(joint: Joint, margin: float = 0.0) -> float:
    """Return 0, or the middle of the range if 0 is not within it by `margin` (a fraction of the range) on
    either side."""
    low, high = range_of(joint)
    return 0.0 if min(-low, high) >= margin * (high - low) else (low + high) / 2


def _bent(joint: Joint, number: int) -> float:
    low, high = range_of(joint)
    if number == 0:
        bend = 0.0
    elif number % 2:
        bend = _INITIAL_BEND
    else:
        bend = -_INITIAL_BEND
    return (low + high) / 2 if joint.type == "prismatic" else _clamped(joint, neutral(joint) + bend)


def _clamped(joint: Joint, position: float) -> float:
    low, high = range_of(joint)
    return min(max(position, low), high)


@dataclass(frozen=True)
class Build:
    """A robot and the roles of its parts."""

    model: RobotModel

    @cached_property
    def frames(self) -> dict[str, Frame]:
        return link_frames(self.model)

    @cached_property
    def boxes(self) -> dict[str, Bounds]:
        """The box around the collision shapes of each link, or around its visuals if it has none."""
        return {link.name: box for link in self.model.links if (box := _box(link, self.frames[link.name]))}

    @property
    def lowest(self) -> float:
        return min((low[2] for low, _ in self.boxes.values()), default=0.0)

    def height(self, positions: Positions, tilt: Quaternion = IDENTITY_ROTATION) -> float:
        """Height of the root above the ground when the lowest point touches it."""
        tilted = ((0.0, 0.0, 0.0), tilt)
        poses = link_frames(self.model, positions)
        boxes = [_box(link, frames.compose(tilted, poses[link.name])) for link in self.model.links]
        return 0.0 - min((box[0][2] for box in boxes if box), default=0.0)

    def depth(self, link: str, positions: Positions, down: Triple) -> float:
        """Return how far the lowest point of a link is below its origin, along the unit vector `down`."""
        _, turn = link_frames(self.model, positions)[link]
        box = _box(self.model.link(link), ((0.0, 0.0, 0.0), turn))
        if box is None:
            return 0.0
        xs, ys, zs = zip(*box, strict=True)
        return max(frames.dot(corner, down) for corner in product(xs, ys, zs))

    @cached_property
    def size(self) -> float:
        """The longest side of the box around the robot."""
        return max(box_sides(robot_bounds(self.model))) or 1.0

    def rigid(self, link: str) -> list[str]:
        """Return a link and all links that fixed joints attach to it, downwards."""
        return self.model.links_below(link, rigid=True)

    @cached_property
    def trunk(self) -> list[str]:
        """The root link and all that is fixed to it."""
        return self.rigid(self.model.root)

    @property
    def chassis(self) -> str:
        """The heaviest link of the trunk, to which an inertial sensor belongs, because the root may be a mere
        point."""
        return max(self.trunk, key=lambda name: self.model.link(name).mass)

    def axis(self, joint: Joint) -> Triple:
        return frames.rotate(self.frames[joint.child][1], joint.axis)

    @property
    def _free(self) -> list[Joint]:
        return [joint for joint in self.model.moving_joints if not _is_locked(joint)]

    @cached_property
    def driven(self) -> list[Joint]:
        """The joints that a motor may move: those with an effort, or all if the file names no effort; locked
        joints never."""
        free = [joint for joint in self._free if joint.name not in self.model.followers]
        has_efforts = any(joint.limit.effort for joint in free)
        return [
            joint for joint in free if joint.limit.effort or (joint.limit.effort is None and not has_efforts)
        ]

    @property
    def idle(self) -> list[Joint]:
        """The joints that move without a motor, and follow none that has one."""
        driven = {joint.name for joint in self.driven}
        leaders = {name: mimic.joint for name, mimic in self.model.followers.items()}
        return [joint for joint in self._free if leaders.get(joint.name, joint.name) not in driven]

    @property
    def weightless(self) -> list[Joint]:
        """The joints that move no mass."""
        subtree_mass = self.model.subtree_mass()
        return [joint for joint in self.model.moving_joints if subtree_mass[joint.child] <= 0.0]

    @property
    def poles(self) -> list[Joint]:
        """Level hinges without a motor below the mass that they carry, such as the hinge of a pole on a
        cart."""
        level = [
            joint
            for joint in self.idle
            if joint.type != "prismatic" and abs(self.axis(joint)[2]) < _MAX_LEVEL_Z
        ]
        return [
            joint for joint in level if self._center_of_mass(joint.child)[2] > self.frames[joint.child][0][2]
        ]

    def _center_of_mass(self, link: str) -> Triple:
        inertial = self.model.link(link).inertial
        origin, turn = self.frames[link]
        return frames.add(origin, frames.rotate(turn, inertial.origin.xyz)) if inertial else origin

    @cached_property
    def wheels(self) -> list[Wheel]:
        """The wheels: two at least, or none."""
        wheels = [wheel for joint in self.driven if (wheel := self._wheel(joint))]
        return wheels if len(wheels) > 1 else []

    def _wheel(self, joint: Joint) -> Wheel | None:
        """Return the wheel on an endless joint with a level axle whose links are round, stand on the ground
        and carry no further joint."""
        axle = self.axis(joint)
        endless = joint.type == "continuous" or (joint.type == "revolute" and joint.limit.lower is None)
        links = self.rigid(joint.child)
        if not endless or abs(axle[2]) > _MAX_LEVEL_Z or self._joints_on(links):
            return None
        boxes = [self.boxes[name] for name in links if name in self.boxes]
        if not boxes:
            return None
        (low_x, low_y, low_z), (high_x, high_y, high_z) = box_around(boxes)
        center = self.frames[joint.child][0]
        radius = center[2] - low_z
        if (
            radius <= 0.0
            or abs(high_z - center[2] - radius) > _WHEEL_TOLERANCE * radius
            or low_z - self.lowest > _WHEEL_TOLERANCE * radius
        ):
            return None
        across = high_x - low_x if abs(axle[1]) > abs(axle[0]) else high_y - low_y
        if abs(across - 2.0 * radius) >= 4.0 * _WHEEL_TOLERANCE * radius:
            return None
        length = hypot(axle[0], axle[1])
        return Wheel(joint, radius, (axle[0] / length, axle[1] / length, 0.0), center)

    @property
    def forward(self) -> Triple:
        """The direction in which the robot rolls: along x or y rather than against it."""
        direction = frames.cross(self.wheels[0].axle, (0.0, 0.0, 1.0))
        return direction if direction[0] + 0.1 * direction[1] > 0 else frames.scaled(direction, -1.0)

    @property
    def steering(self) -> list[Joint]:
        """The upright hinges that carry a wheel."""
        upright = [
            joint
            for joint in self.driven
            if joint.type != "prismatic" and abs(self.axis(joint)[2]) > _MIN_UPRIGHT_Z
        ]
        return [
            joint
            for joint in upright
            if any(wheel.joint.parent in self.rigid(joint.child) for wheel in self.wheels)
        ]

    @property
    def balances(self) -> bool:
        """Whether the robot stands on two wheels and on nothing else."""
        rolling = {name for wheel in self.wheels for name in self.rigid(wheel.joint.child)}
        slack = 0.3 * self.wheels[0].radius if len(self.wheels) == 2 else 0.0
        return slack > 0.0 and all(
            low[2] - self.lowest >= slack for name, (low, _) in self.boxes.items() if name not in rolling
        )

    @cached_property
    def rotors(self) -> list[str]:
        """The links named after rotors whose z axis is upright: three at least, or none."""
        names = [link.name for link in self.model.links if _ROTOR.search(link.name)]
        upright = [
            name for name in names if frames.rotate(self.frames[name][1], (0.0, 0.0, 1.0))[2] > _MIN_UPRIGHT_Z
        ]
        return upright if len(upright) > 2 else []

    @property
    def intangible(self) -> list[str]:
        """The large links that are visible, but have no collision shape."""
        least = _LARGE_SHARE * prod(box_sides(robot_bounds(self.model)))
        return [
            link.name
            for link in self.model.links
            if link.visuals and not link.collisions and prod(box_sides(self.boxes[link.name])) > least
        ]

    @cached_property
    def limbs(self) -> list[Limb]:
        """The chains of joints that begin at the trunk, each as far as it does not branch."""
        return [self._limb(joint) for joint in self._joints_on(self.trunk)]

    def _joints_on(self, links: Sequence[str]) -> list[Joint]:
        """Return the joints that move and begin at one of these links."""
        return [joint for joint in self.model.joints if joint.moves and joint.parent in links]

    def _limb(self, first: Joint) -> Limb:
        joint = first
        links = self.rigid(first.child)
        while len(further := self._joints_on(links)) == 1:
            joint = further[0]
            links = self.rigid(further[0].child)
        tip = max(links, key=lambda name: dist(self.frames[name][0], self.frames[joint.child][0]))
        above = {joint.child: joint for joint in self.model.joints}
        path = [above[tip]]
        while path[0] is not first:
            path.insert(0, above[path[0].parent])
        return Limb(tuple(path), self.frames[first.parent])

    @property
    def is_fixed(self) -> bool:
        """Whether the base is to be fixed: the root is not a body, or all of the robot is one limb that
        reaches out of its foot."""
        if self.wheels or self.rotors:
            return False
        if self.model.root == "world" or not any(self.model.link(name).inertial for name in self.trunk):
            return True
        if len(self.limbs) != 1:
            return False
        (limb,) = self.limbs
        boxes = [self.boxes[name] for name in self.trunk if name in self.boxes]
        # A limb that stays within the foot is a weight in a ball, and no arm.
        width = max((high[axis] - low[axis] for low, high in boxes for axis in (0, 1)), default=0.0)
        return len(limb.joints) == 1 or limb.joints[0].type == "prismatic" or limb.reach > width


def _is_locked(joint: Joint) -> bool:
    return (
        joint.type != "continuous"
        and joint.limit.lower is not None
        and joint.limit.lower == joint.limit.upper
    )


def _box(link: Link, frame: Frame) -> Bounds | None:
    """Return the box around the shapes of a link that lies in `frame`."""
    parts = link.collisions or link.visuals
    boxes = [bounds_of_shape(part.shape, frames.compose(frame, frames.frame(part.origin))) for part in parts]
    return box_around(boxes) if boxes else None
