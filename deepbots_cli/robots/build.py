"""The parts of a robot by their function: wheels, steering, legs, arms, hands, propellers, and joints without
a motor.

They are derived from shapes and joints with all joints at 0. Names count only where two parts have the same
structure: a propeller on a fixed joint looks like any other link, and an arm that hangs like a leg. All
coordinates are in the frame of the root link, in m and rad.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from itertools import product
from math import atan2, dist, hypot, inf, pi, prod

from deepbots_cli import frames
from deepbots_cli.frames import IDENTITY_FRAME, IDENTITY_ROTATION, Frame, Quaternion, Triple
from deepbots_cli.records import dataclass
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

GRAVITY = 9.81
"""The acceleration of gravity, in m/s^2."""
_PROPELLER = re.compile(r"prop(?!er)|rotor|thruster", re.IGNORECASE)
_ARM = re.compile(r"arm|shoulder|elbow|wrist|hand|gripper", re.IGNORECASE)
_LEG = re.compile(r"leg|hip|knee|ankle|foot|thigh|toe|shank|calf|femur|tibia", re.IGNORECASE)
_HEAD = re.compile(r"neck|head", re.IGNORECASE)
_JAW = re.compile(r"jaw|grip|finger|claw|pinc|thumb", re.IGNORECASE)
_TOOL = re.compile(
    r"(?:^|_)(?:tool0?|tcp|ee|eef|end_?effector|grasp\w*|gripper_?(?:center|frame)\w*)(?:_|$)", re.IGNORECASE
)
_ROLLERS = 5
"""The least number of rollers on an omnidirectional wheel."""
_LONG_SHARE = 0.15
"""The least reach of a limb, as a share of the size of the robot. A shorter one is a finger or a sensor."""
_GROUND_TOLERANCE = 0.15
"""The largest height of a foot above the lowest point of the robot, as a share of the reach of the leg."""
_CASTER_TRAIL = 0.01
"""The least distance of the wheel of a caster from its upright axis, as a share of the size of the robot."""
_ENDLESS_RANGE = 100.0
"""The range (rad) of limits that mean none."""
_PARALLEL = 0.999
"""The cosine of the angle between axes that count as parallel."""
_PROPELLER_MASS_SHARE = 0.1
"""The largest mass of a propeller, as a share of the mass of the robot."""
_FLAT_SHARE = 0.35
"""The largest thickness of a propeller, as a share of its width."""
_LEG_CLEARANCE = 0.2
"""The least height of the trunk above the foot of a leg, as a share of the reach of the leg."""
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
    rollers: int = 0
    is_caster: bool = False


@dataclass(frozen=True)
class Limb:
    """A chain of joints that does not branch. `path` has its joints in order, fixed ones too; `base` is the
    frame in which it begins; `fingers` are the joints of its hand."""

    path: tuple[Joint, ...]
    base: Frame
    fingers: tuple[Joint, ...] = ()

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
    reach = 1.0 if joint.type == "prismatic" else pi
    if joint.type == "continuous" or lower is upper is None:
        return -reach, reach
    low = min(-reach, (upper or 0.0) - reach) if lower is None else lower
    high = max(reach, low + reach) if upper is None else upper
    return low, high


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

    def box(self, link: str, frame: Frame = IDENTITY_FRAME) -> Bounds | None:
        """Return the box around the shapes of a link that lies in `frame`."""
        return _box(self.model.link(link), frame)

    @cached_property
    def size(self) -> float:
        """The longest side of the box around `boxes` and the origins of the links."""
        origins = [(origin, origin) for origin, _ in self.frames.values()]
        return max(box_sides(box_around([*self.boxes.values(), *origins]))) or 1.0

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

    def _is_level(self, joint: Joint) -> bool:
        """Whether a joint is a hinge with a level axis."""
        return joint.type != "prismatic" and abs(self.axis(joint)[2]) < _MAX_LEVEL_Z

    def _is_upright(self, joint: Joint) -> bool:
        """Whether a joint is a hinge with an upright axis."""
        return joint.type != "prismatic" and abs(self.axis(joint)[2]) > _MIN_UPRIGHT_Z

    # Motors

    @property
    def _free(self) -> list[Joint]:
        return [joint for joint in self.model.moving_joints if not _is_locked(joint)]

    @cached_property
    def driven(self) -> list[Joint]:
        """The joints that a motor may move: those with an effort, or all if the file names no effort; locked
        joints never. Many files leave out the limits of wheels, so the efforts of wheels are compared among
        themselves."""
        free = [joint for joint in self._free if joint.name not in self.model.followers]
        wheels = [wheel.joint for wheel in self.all_wheels if not wheel.is_caster]
        driven = []
        for joint in free:
            kindred = wheels if joint in wheels else free
            has_efforts = any(other.limit.effort for other in kindred)
            if joint.limit.effort or (joint.limit.effort is None and not has_efforts):
                driven.append(joint)
        return driven

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
        rolling = {wheel.joint.name for wheel in self.all_wheels}
        return [
            joint
            for joint in self.idle
            if self._is_level(joint)
            and joint.name not in rolling
            and self._center_of_mass(joint.child)[2] > self.frames[joint.child][0][2]
        ]

    def _center_of_mass(self, link: str) -> Triple:
        inertial = self.model.link(link).inertial
        origin, turn = self.frames[link]
        return frames.add(origin, frames.rotate(turn, inertial.origin.xyz)) if inertial else origin

    # Wheels

    @cached_property
    def all_wheels(self) -> list[Wheel]:
        """The wheels with and without a motor: two at least, or none."""
        wheels = [wheel for joint in self._free if (wheel := self._wheel(joint))]
        rolling = {wheel.joint.child for wheel in wheels}  # rollers on wheels look like wheels
        wheels = [wheel for wheel in wheels if wheel.joint.parent not in rolling]
        if all(wheel.is_caster for wheel in wheels):  # a base that steers with all its wheels
            wheels = [replace(wheel, is_caster=False) for wheel in wheels]
        return wheels if len(wheels) > 1 else []

    @cached_property
    def wheels(self) -> list[Wheel]:
        """The wheels with a motor: two at least, or none."""
        driven = {joint.name for joint in self.driven}
        wheels = [wheel for wheel in self.all_wheels if wheel.joint.name in driven and not wheel.is_caster]
        return wheels if len(wheels) > 1 else []

    def _wheel(self, joint: Joint) -> Wheel | None:
        """Return the wheel on an endless joint with a level axle whose links are round, stand on the ground
        and carry no further joint except rollers."""
        axle = self.axis(joint)
        if not is_endless(joint) or abs(axle[2]) > _MAX_LEVEL_Z:
            return None
        links = self.rigid(joint.child)
        rollers = self._joints_on(links)
        if rollers and (
            len(rollers) < _ROLLERS or any(self._joints_on([roller.child]) for roller in rollers)
        ):
            return None
        links = [*links, *(roller.child for roller in rollers)]
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
        if abs(axle[1]) > _PARALLEL or abs(axle[0]) > _PARALLEL:
            across = high_x - low_x if abs(axle[1]) > abs(axle[0]) else high_y - low_y
            if abs(across - 2.0 * radius) >= 4.0 * _WHEEL_TOLERANCE * radius:
                return None
        length = hypot(axle[0], axle[1])
        level = (axle[0] / length, axle[1] / length, 0.0)
        return Wheel(joint, radius, level, center, len(rollers), self._is_caster(joint, center))

    def _is_caster(self, joint: Joint, center: Triple) -> bool:
        """Whether an endless upright hinge beside its axle carries a wheel, so that it turns after its
        robot."""
        above = self._joint_above(joint)
        if above is None or not self._is_upright(above) or not is_endless(above):
            return False
        x, y, _ = frames.subtract(center, self.frames[above.child][0])
        return hypot(x, y) > _CASTER_TRAIL * self.size

    def _joint_above(self, joint: Joint) -> Joint | None:
        """Return the moving joint next above a joint."""
        above = {other.child: other for other in self.model.joints}
        link = joint.parent
        while link in above and not above[link].moves:
            link = above[link].parent
        return above.get(link)

    @property
    def forward(self) -> Triple:
        """The direction in which the robot rolls: along x or y rather than against it."""
        fixed = [wheel for wheel in self.wheels if self._joint_above(wheel.joint) not in self.steering]
        axle = (fixed or self.wheels)[0].axle
        direction = frames.cross(axle, (0.0, 0.0, 1.0))
        return direction if direction[0] + 0.1 * direction[1] > 0 else frames.scaled(direction, -1.0)

    @cached_property
    def steering(self) -> list[Joint]:
        """The upright hinges with a motor or with limits that carry a wheel."""
        carried = {wheel.joint.parent for wheel in self.all_wheels if not wheel.is_caster}
        return [
            joint
            for joint in self._free
            if self._is_upright(joint) and carried.intersection(self.rigid(joint.child))
        ]

    @property
    def rockers(self) -> list[Joint]:
        """The level hinges that carry two wheels or more, as those of a rover."""
        return [
            joint
            for joint in self._free
            if self._is_level(joint)
            and sum(wheel.joint.child in self.model.links_below(joint.child) for wheel in self.all_wheels) > 1
        ]

    @property
    def balances(self) -> bool:
        """Whether the robot stands on two wheels and on nothing else."""
        rolling = {name for wheel in self.wheels for name in self.rigid(wheel.joint.child)}
        slack = 0.3 * self.wheels[0].radius if len(self.wheels) == 2 else 0.0
        return slack > 0.0 and all(
            low[2] - self.lowest >= slack for name, (low, _) in self.boxes.items() if name not in rolling
        )

    # Propellers

    @cached_property
    def propellers(self) -> dict[str, Triple]:
        """The links that push by turning, with their axes: three at least, or none. They turn on endless
        joints and carry nothing, or are named after propellers."""
        axes: dict[str, Triple] = {}
        joint_above = {joint.child: joint for joint in self.model.joints}
        carrying = {joint.parent for joint in self._free}
        trunk = set(self.trunk)
        rolling = {wheel.joint.child for wheel in self.all_wheels}
        for link in self.model.links:
            joint = joint_above.get(link.name)
            if joint is None or link.name in rolling or carrying.intersection(self.rigid(link.name)):
                continue
            is_named = bool(_PROPELLER.search(link.name))
            if not joint.moves and is_named:
                axes[link.name] = frames.rotate(self.frames[link.name][1], (0.0, 0.0, 1.0))
            if not joint.moves or not is_endless(joint):
                continue
            if is_named or (joint.parent in trunk and self._is_flat(link.name, self.axis(joint))):
                axes[link.name] = self.axis(joint)
        return axes if len(axes) > 2 else {}

    def _is_flat(self, link: str, axis: Triple) -> bool:
        """Whether a link is a light disk or blade across `axis`."""
        if self.model.link(link).mass > _PROPELLER_MASS_SHARE * self.model.mass or link not in self.boxes:
            return False
        sides = box_sides(self.boxes[link])
        along = max(range(3), key=lambda number: abs(axis[number]))
        return sides[along] < _FLAT_SHARE * max(sides)

    @property
    def rotors(self) -> list[str]:
        """The propellers with an upright axis: three at least, or none."""
        upright = [name for name, axis in self.propellers.items() if abs(axis[2]) > _MIN_UPRIGHT_Z]
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

    # Limbs

    @property
    def limbs(self) -> list[Limb]:
        """The chains of joints that begin at the trunk, or at a torso on a waist, each up to its hand."""
        return self._members[1]

    @property
    def waist(self) -> list[Joint]:
        """The joints between the trunk and what carries several limbs."""
        return self._members[0]

    @cached_property
    def _members(self) -> tuple[list[Joint], list[Limb]]:
        waist: list[Joint] = []
        limbs: list[Limb] = []
        waiting = [self.trunk]
        while waiting:
            for joint in self._joints_on(waiting.pop()):
                chain, beyond = self._chain(joint)
                if sum(map(self._is_long, beyond)) > 1:
                    waist += chain
                    waiting.append(self.rigid(chain[-1].child))
                else:
                    limbs.append(self._limb(chain, beyond))
        return waist, limbs

    def _chain(self, first: Joint) -> tuple[list[Joint], list[Joint]]:
        """Return the joints from `first` to the link where the limb ends or branches into several parts, and
        the joints that begin there. Short parts beside a long one, such as a camera, are passed by."""
        chain = [first]
        while beyond := self._joints_on(self.rigid(chain[-1].child)):
            long = beyond if len(beyond) == 1 else list(filter(self._is_long, beyond))
            if len(long) != 1:
                break
            chain.append(long[0])
        return chain, beyond

    def _is_long(self, joint: Joint) -> bool:
        """Whether two joints at least and a reach like that of a limb begin with `joint`."""
        links = self.model.links_below(joint.child)
        if not self._joints_on(links):
            return False
        return self._extents[joint.name] > _LONG_SHARE * self.size

    @cached_property
    def _extents(self) -> dict[str, float]:
        """The length (m) of the longest way from each joint to a link behind it when stretched out."""
        extents: dict[str, float] = {}
        below = self.model.joints_below
        order = [self.model.root]
        for link in order:
            order += [joint.child for joint in below[link]]
        above = {joint.child: joint for joint in self.model.joints}
        for link in reversed(order[1:]):
            extents[above[link].name] = max(
                (hypot(*joint.origin.xyz) + extents[joint.name] for joint in below[link]),
                default=0.0,
            )
        return extents

    def _joints_on(self, links: Sequence[str]) -> list[Joint]:
        """Return the joints that move and begin at one of these links."""
        return [joint for joint in self.model.joints if joint.moves and joint.parent in links]

    def _limb(self, chain: list[Joint], beyond: list[Joint]) -> Limb:
        """Return the limb of a chain; the joints `beyond` are those of its hand, and a last joint that is a
        jaw is one too."""
        fingers = [joint for first in beyond for joint in self._joints_from(first)]
        if not fingers and len(chain) > 2 and self._is_jaw(chain):
            fingers = [chain[-1]]
            chain = chain[:-1]
        last = chain[-1]
        links = self.rigid(last.child)
        tools = [name for name in links if _TOOL.search(name)]
        tip = max(tools or links, key=lambda name: dist(self.frames[name][0], self.frames[last.child][0]))
        above = {joint.child: joint for joint in self.model.joints}
        path = [above[tip]]
        while path[0] is not chain[0]:
            path.insert(0, above[path[0].parent])
        return Limb(tuple(path), self.frames[chain[0].parent], tuple(fingers))

    def _joints_from(self, first: Joint) -> list[Joint]:
        """Return a joint and all moving joints behind it."""
        links = self.model.links_below(first.child)
        return [first, *self._joints_on(links)]

    def _is_jaw(self, chain: Sequence[Joint]) -> bool:
        """Whether the last joint of a chain opens and closes a jaw beside the end of the arm: a slide behind
        hinges, or a link that is named so."""
        last = chain[-1]
        if last.type == "prismatic":
            return all(joint.type != "prismatic" for joint in chain[:-1])
        first_name, last_name = (f"{joint.name} {joint.child}" for joint in (chain[0], last))
        return not is_endless(last) and bool(_JAW.search(last_name)) and not _JAW.search(first_name)

    @cached_property
    def down(self) -> Triple:
        """The direction in which the legs point: down, or along x or y for a robot that was drawn lying."""
        downs = [(0.0, 0.0, -1.0), (0.0, -1.0, 0.0), (0.0, 1.0, 0.0), (-1.0, 0.0, 0.0), (1.0, 0.0, 0.0)]
        legs = {down: self._legs_along(down) for down in downs}
        complete = [down for down in downs if len(legs[down]) == len(self.limbs) > 3]
        upright = downs[:1] if len(legs[downs[0]]) > 1 else []
        named = [down for down in downs[1:] if self._are_legs_by_name(legs[down])]
        return (complete or upright or named or downs)[0]

    def _are_legs_by_name(self, legs: Sequence[Limb]) -> bool:
        """Whether two limbs at least have the names of legs, and no other limb has."""
        return len(legs) > 1 and [limb for limb in self.limbs if _LEG.search(names_of_limb(limb))] == legs

    @cached_property
    def legs(self) -> list[Limb]:
        """The limbs that carry the trunk: two at least, or none."""
        legs = self._legs_along(self.down)
        names = " ".join(map(names_of_limb, legs))
        if len(legs) == 2 and _ARM.search(names) and not _LEG.search(names):
            return []
        return legs if len(legs) > 1 else self._mirrored_limbs

    def _legs_along(self, down: Triple) -> list[Limb]:
        """Return the limbs whose ends are the lowest points of the robot and clearly below its trunk."""
        depths = {name: _depth(box, down) for name, box in self.boxes.items()}
        deepest = max(depths.values(), default=0.0)
        trunk = max((depths[name] for name in self.trunk if name in depths), default=-inf)
        rolling = {wheel.joint.name for wheel in self.all_wheels}
        legs = []
        for limb in self.limbs:
            if len(limb.joints) < 2 or rolling.intersection(joint.name for joint in limb.joints):
                continue
            links = self.model.links_below(limb.joints[-1].child)
            foot = max((depths[name] for name in links if name in depths), default=-inf)
            is_low = foot > deepest - _GROUND_TOLERANCE * limb.reach
            if is_low and foot > trunk + _LEG_CLEARANCE * limb.reach:
                legs.append(limb)
        return legs

    @property
    def _mirrored_limbs(self) -> list[Limb]:
        """The limbs of a robot on many legs that are drawn stretched out: four at least, of one length, in
        pairs on both sides."""
        limbs = [limb for limb in self.limbs if len(limb.joints) > 1]
        names = " ".join(map(names_of_limb, limbs))
        reaches = [sum(hypot(*joint.origin.xyz) for joint in limb.joints[1:]) for limb in limbs]
        if len(limbs) < 4 or len(limbs) % 2 or _JAW.search(names) or self.all_wheels:
            return []
        if max(reaches) > 1.2 * min(reaches):
            return []
        hips = [self.frames[limb.joints[0].child][0] for limb in limbs]
        near = 0.1 * self.size
        for signs in ((1.0, -1.0), (-1.0, 1.0)):
            images = [(x * signs[0], y * signs[1], z) for x, y, z in hips]
            if all(min(dist(image, hip) for hip in hips) < near for image in images):
                return limbs
        return []

    @cached_property
    def arms(self) -> list[Limb]:
        """The limbs of three joints or more that are no legs and carry no wheels, the longest first."""
        legs = [limb.tip for limb in self.legs]
        rolling = {wheel.joint.name for wheel in self.all_wheels}
        arms = [
            limb
            for limb in self.limbs
            if limb.tip not in legs
            and len(limb.joints) > 2
            and not rolling.intersection(joint.name for joint in limb.joints)
            and not _HEAD.search(limb.joints[0].name)
        ]
        return sorted(arms, key=lambda limb: -limb.reach)

    def ends(
        self, joints: Sequence[Joint], around: Sequence[Joint]
    ) -> tuple[dict[str, float], dict[str, float]]:
        """Return the positions at which finger joints are open and closed: the ends of their ranges at which
        the links behind them are further from, and nearer to, the links behind the joints `around`."""
        opened: dict[str, float] = {}
        closed: dict[str, float] = {}
        for joint in joints:
            low, high = range_of(joint)
            others = [other for other in around if other is not joint]
            is_wider = self._gap(joint, others, high) > self._gap(joint, others, low)
            opened[joint.name], closed[joint.name] = (high, low) if is_wider else (low, high)
        return opened, closed

    def _gap(self, joint: Joint, others: Sequence[Joint], position: float) -> float:
        """Return the distance between the middle of what a joint moves and the middle of what the others
        move, or of the link that carries it where there are none."""
        moved = set(self.model.links_below(joint.child))
        fixed = {name for other in others for name in self.model.links_below(other.child)} - moved
        poses = link_frames(self.model, {joint.name: position})
        return dist(self._middle(moved, poses), self._middle(fixed or {joint.parent}, poses))

    def boxes_at(self, positions: Positions) -> list[Bounds]:
        """Return the box around each link that has a shape."""
        poses = link_frames(self.model, positions)
        return [box for link in self.model.links if (box := _box(link, poses[link.name]))]

    def middles(self, links: Sequence[str], positions: Positions) -> list[Triple]:
        """Return the middle of the box around each link."""
        poses = link_frames(self.model, positions)
        return [self._middle([link], poses) for link in links]

    def _middle(self, names: Iterable[str], poses: Mapping[str, Frame]) -> Triple:
        """Return the middle of the box around links."""
        boxes = [box for name in names if (box := _box(self.model.link(name), poses[name]))]
        if not boxes:
            boxes = [(poses[name][0], poses[name][0]) for name in names]
        low, high = box_around(boxes)
        return frames.scaled(frames.add(low, high), 0.5)

    @property
    def is_fixed(self) -> bool:
        """Whether the base is to be fixed: the root is not a body, or all of the robot is one limb that
        reaches out of its foot."""
        if self.wheels or self.propellers:
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


def mean_point(points: Sequence[Triple]) -> Triple:
    x, y, z = (sum(values) / len(points) for values in zip(*points, strict=True))
    return x, y, z


def is_endless(joint: Joint) -> bool:
    """Whether a hinge turns without limits, or with limits that are many turns apart."""
    lower, upper = joint.limit.lower, joint.limit.upper
    if joint.type == "continuous" or lower is None or upper is None:
        return joint.type in ("continuous", "revolute")
    return joint.type == "revolute" and upper - lower > _ENDLESS_RANGE


def names_of_limb(limb: Limb) -> str:
    return " ".join(f"{joint.name} {joint.child}" for joint in limb.path)


def _is_locked(joint: Joint) -> bool:
    return (
        joint.type != "continuous"
        and joint.limit.lower is not None
        and joint.limit.lower == joint.limit.upper
    )


def _depth(box: Bounds, down: Triple) -> float:
    """Return the largest component along the unit vector `down` of a point of a box."""
    xs, ys, zs = zip(*box, strict=True)
    return max(frames.dot(corner, down) for corner in product(xs, ys, zs))


def _box(link: Link, frame: Frame) -> Bounds | None:
    """Return the box around the shapes of a link that lies in `frame`."""
    parts = link.collisions or link.visuals
    boxes = [bounds_of_shape(part.shape, frames.compose(frame, frames.frame(part.origin))) for part in parts]
    return box_around(boxes) if boxes else None
