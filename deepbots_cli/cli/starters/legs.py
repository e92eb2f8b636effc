"""The task of a robot on legs: a pose in which it stands, springs that hold it, its gait, and the direction
in which it walks.

Directions and places are in the frame of the root link, in m; `down` is the direction of gravity at the
start.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from math import atan2, cos, degrees, dist, hypot, radians, sqrt
from statistics import mean
from typing import TYPE_CHECKING

from deepbots_cli import frames
from deepbots_cli.cli.starters.draft import height_text, short_number
from deepbots_cli.engine_kinds import ENGINES
from deepbots_cli.frames import Frame, Quaternion, Triple, quaternion
from deepbots_cli.records import dataclass
from deepbots_cli.robots.build import GRAVITY, Build, Limb, neutral, range_of
from deepbots_cli.robots.kinematics import (
    box_around,
    center_of_mass,
    corners,
    joint_inertia,
    link_frames,
    min_spring_inertia,
    resting_height,
)
from deepbots_cli.robots.meshes import Bounds
from deepbots_cli.robots.model import Joint

if TYPE_CHECKING:
    from deepbots_cli.cli.starters.draft import Draft

_TIMESTEP = 0.02
_SUBSTEPS = {"mujoco": 4, "pybullet": 10}
"""Engine steps in a timestep by engine."""
_STIFFNESS_PER_LOAD = 2.8
"""The stiffness of a leg's motors (N m/rad), per torque of its share of the weight at the length of a leg
(N m): as the quadruped that comes with deepbots has, about."""
_STIFFNESS_PER_TOPPLING = 2.0
"""The stiffness of a biped's motors (N m/rad), per torque by which its weight topples it over an ankle, in N
m per rad. At 1.2, Atlas leans back as its knees give way, and falls after 3 s."""
_DAMPING_PER_STIFFNESS = 0.025
"""In s."""
_ARMATURE_MARGIN = 2.0
"""The inertia of a joint on a spring, per least inertia that does not shake."""
_STANDING_LEG_SHARES = (0.75, 0.7, 0.8, 0.65, 0.85, 0.6, 0.9)
"""The lengths of a standing leg, as fractions of its reach, in the order in which they are tried."""
_SPRAWL = 50.0
"""The angle (deg) from down to a standing leg that begins with an upright hinge."""
_KNEE_BENDS = (25, 20, 15, 10, 5, 0)
"""The bends of a knee (deg) above a sole, in the order in which they are tried."""
_MAX_LEAN = 60
"""The largest angle (deg) of a hip above a sole."""
_MAX_SOLE_ANGLE = 60
"""The largest angle (deg) of a foot with all joints at 0 to the ground."""
_LEVEL_SHARE = 0.02
"""The largest height above the ground of points on which a foot stands, as a share of its size."""
_MIN_SOLE_SHARE = 0.5
"""The least length of a side on which a foot may stand, as a share of its longest side."""
_LEVEL_LENGTH = 0.95
"""The length of a side that is on the ground, as a share of the longest one."""
_LEVEL_ANGLE = 5
"""The largest angle (deg) of a level side."""
_STANCE_TOLERANCE = 0.05
"""The largest distance of a foot from the place below its hip, as a fraction of the reach of the leg."""
_LARGEST_FOOT_SHIFT = 0.35
"""The largest distance of a foot to the side of its hip, as a fraction of the reach of the leg."""
_FOOT_SHARE = 0.25
"""The largest distance from the origin of a foot to its end, as a fraction of the reach of the leg."""
_TIP_TOLERANCE = 0.02
"""The largest distance of a foot from its target, as a fraction of the reach of the leg."""
_FALLEN_TILT = 60.0
"""The tilt at which a robot on legs has fallen, in deg."""
_SPEED = 0.3
"""The largest command, as a Froude number: the speed per root of gravity times the length of a leg."""
_TOES = 0.1
"""The least difference of the parts of a foot before and behind its ankle, as a share of its length."""
_UPRIGHT = 0.7
"""The least cosine of the angle between an upright axis and down."""
_PARALLEL = 0.9
"""The cosine of the angle between axes that count as parallel."""

_FRONT = re.compile(r"(?<![A-Za-z])(?:FL|FR|LF|RF|lf|rf)(?![a-z])|front|fore", re.ASCII)
_REAR = re.compile(r"(?<![A-Za-z])(?:RL|RR|HL|HR|LH|RH|BL|BR|lh|rh|lr|rr)(?![a-z])|rear|hind|back", re.ASCII)
"""The words for legs in names of links and joints: `FR_hip`, `RL`, `LF_HAA`, `motor_front_leftR`."""


@dataclass(frozen=True)
class Stance:
    """How a robot on legs stands: `turn` brings it upright from the attitude in which it was drawn (roll and
    pitch in deg), `positions` are those of the joints of its legs (rad, m). `evidence` says why it walks
    `forward`, `remark` how well it stands."""

    build: Build
    turn: tuple[float, float]
    positions: Mapping[str, float]
    forward: Triple
    evidence: str
    remark: str

    @property
    def rotation(self) -> Quaternion:
        return quaternion(radians(self.turn[0]), radians(self.turn[1]), 0.0)

    @cached_property
    def height(self) -> float:
        """The height of the root above the ground when the lowest point touches it."""
        roll, pitch = map(radians, self.turn)
        return resting_height(self.build.model, roll, pitch, self.positions) or self.build.height(
            self.positions, self.rotation
        )

    @property
    def center_height(self) -> float:
        """The height of the center of mass (m)."""
        center = center_of_mass(self.build.model, link_frames(self.build.model, self.positions))
        return self.height + frames.rotate(self.rotation, center)[2]

    @property
    def low(self) -> float:
        """The height of the root (m) when the hips have sunk to half their height."""
        hips = [frames.rotate(self.rotation, hip)[2] for hip in _hips(self.build)]
        return self.height - 0.5 * (self.height + min(hips))

    @property
    def place(self) -> dict[str, str]:
        """The place in which episodes begin: just above the ground."""
        turns = {
            name: f"{short_number(angle)} deg"
            for name, angle in zip(("roll", "pitch"), self.turn, strict=True)
            if angle
        }
        return {"z": height_text(self.height + 1e-3), **turns, "yaw": "any"}


def walk(draft: Draft) -> dict[str, object]:
    """Walk forward at a commanded speed."""
    build = draft.build
    stance = stand(build)
    down = frames.rotate_back(stance.rotation, (0.0, 0.0, -1.0))
    joints = [joint for limb in build.legs for joint in limb.joints if joint in build.driven]
    group = draft.add_group("legs", joints)
    draft.add_start(group, "stand", stance.positions, joints)
    engine = "mujoco" if _takes_mujoco(build) else "pybullet"
    reach = max(_with_foot(build, limb).reach for limb in build.legs)
    load = build.model.mass * GRAVITY * reach / len(build.legs)
    gains: dict[str, str] = {}  # in PyBullet, which has no armature, the motors of the engine
    armature = 0.0
    if engine == "mujoco":
        toppling = build.model.mass * GRAVITY * stance.center_height
        stiffness = _STIFFNESS_PER_LOAD * load if len(build.legs) > 2 else _STIFFNESS_PER_TOPPLING * toppling
        gains, armature = _springs(build, joints, stiffness)
    draft.add_motor("motors", "position_motor", group, joints, "stand + swing * stride", gains)
    draft.hold([joint for joint in build.driven if joint not in joints])
    first, second = _gait(build, stance.rotation)
    if "density" not in draft.links.get(build.chassis, {}):
        draft.set_link(build.chassis, "mass", "urdf * uniform(0.9 .. 1.1)")
    for tip in [*first, *second]:
        draft.set_link(tip, "friction", "uniform(0.6 .. 1.2)")
    speed = float(short_number(_SPEED * sqrt(GRAVITY * reach)))
    return {
        "legs": group,
        "ahead": _component(stance.forward),
        "aside": _component(frames.cross(down, stance.forward)).lstrip("-"),
        "low": stance.low,
        "chassis": build.chassis,
        "place": stance.place,
        "feet": {"first": draft.add_links("feet_a", first), "second": draft.add_links("feet_b", second)},
        "stance": stance.remark,
        "evidence": stance.evidence,
        "fallen": _fallen(build, down),
        "lift": 0.18 * reach,
        "beat": 0.5 * sqrt(reach / 0.4),
        "speed": speed,
        "load": load,
        "engine": engine,
        "armature": armature,
        "substeps": _SUBSTEPS[engine],
    }


def _component(direction: Triple) -> str:
    """Return the component of a velocity `v` in the frame of the robot along an axis, as an expression."""
    axis = max(range(3), key=lambda number: abs(direction[number]))
    return f"{'-' if direction[axis] < 0 else ''}v.{'xyz'[axis]}"


def _takes_mujoco(build: Build) -> bool:
    """Whether MuJoCo is installed and takes the inertias of a robot."""
    return ENGINES["mujoco"].is_installed and all(
        link.inertial.is_plausible
        for link in build.model.links
        if link.inertial is not None and link.inertial.is_stated
    )


def _springs(build: Build, joints: Sequence[Joint], stiffness: float) -> tuple[dict[str, str], float]:
    """Return the gains of springs on joints, and the armature (kg m^2) without which they shake; 0 for
    none."""
    damping = _DAMPING_PER_STIFFNESS * stiffness
    gains = {
        "stiffness": f"{short_number(stiffness)} N*m/rad",
        "damping": f"{short_number(damping)} N*m*s/rad",
    }
    least = _ARMATURE_MARGIN * min_spring_inertia(stiffness, damping, _TIMESTEP / _SUBSTEPS["mujoco"])
    inertias = [joint_inertia(build.model, build.frames, joint) for joint in joints]
    return gains, least if min(inertias) < least else 0.0


# The pose


def stand(build: Build) -> Stance:
    """Return how a robot on legs stands."""
    turn = _upright(build)
    down = frames.rotate_back(quaternion(radians(turn[0]), radians(turn[1]), 0.0), (0.0, 0.0, -1.0))
    forward, evidence = _forward(build, down)
    if len(build.legs) == 2:
        positions = _on_soles(build, forward, down)
        if positions is not None:
            remark = "Its knees are bent, its soles level, and its center of mass is above their middle."
            return Stance(build, turn, positions, forward, evidence, remark)
    positions = {}
    off = 0.0
    for limb in build.legs:
        pose, missing = _standing(build, limb, down)
        positions |= pose
        off = max(off, missing / (limb.reach or 1.0))
    return Stance(build, turn, positions, forward, evidence, _stance_remark(build, off))


def _upright(build: Build) -> tuple[float, float]:
    """Return roll and pitch (deg) that bring the legs below the body, for a robot that was drawn lying on its
    side."""
    x, y, _ = build.down
    if y:
        return (90.0 if y < 0 else -90.0), 0.0
    return 0.0, 90.0 * x


def _stance_remark(build: Build, off: float) -> str:
    """Return what the head of a scenario says about feet that are `off` from their targets, as a fraction of
    the reach of their legs."""
    if off > _STANCE_TOLERANCE:
        return (
            f"A foot is {short_number(round(100 * off))} % of the length of its leg away from the place where"
            " it would stand. Look at the robot with `deepbots view`, and change the pose until it stands."
        )
    if len(build.legs) == 2:
        return "Its feet are points, or its ankles do not level them: it falls unless the policy balances it."
    return "Its legs are bent so that it stands on its feet; a better posture is worth more than longer training."


def _on_soles(build: Build, forward: Triple, down: Triple) -> dict[str, float] | None:
    """Return joint positions of a biped with level soles below its center of mass, with its knees bent; None
    if its legs do not bend at hip, knee and ankle about the same axis.

    The angles of hip, knee and ankle add up to that of the sole, which is 0 if the feet are level with all
    joints at 0. Angles are whole degrees, so that rounding does not tilt the soles.
    """
    left = frames.cross(forward, down)
    legs = [_sagittal(build, limb, left) for limb in build.legs]
    if any(len(leg) < 3 for leg in legs):
        return None
    soles = [_sole_angle(build, limb, forward, down) for limb in build.legs]
    rest = {joint.name: neutral(joint) for joint in build.model.moving_joints}
    for bend in _KNEE_BENDS:
        leans = set(range(-_MAX_LEAN, _MAX_LEAN + 1))
        for leg, sole in zip(legs, soles, strict=True):
            leans &= {lean for lean in leans if _bent_leg(leg, sole, bend, lean) is not None}
        if leans:
            break
    else:
        return None

    def positions(lean: int) -> dict[str, float]:
        bent = [_bent_leg(leg, sole, bend, lean) or {} for leg, sole in zip(legs, soles, strict=True)]
        return rest | {name: value for leg in bent for name, value in leg.items()}

    def excess(lean: int) -> float:
        """The distance of the soles ahead of the center of mass."""
        where = link_frames(build.model, positions(lean))
        ends = [end for limb in build.legs for end in _sole(build, limb, where)]
        return frames.dot(frames.subtract(frames.mean(ends), center_of_mass(build.model, where)), forward)

    low, high = min(leans), max(leans)  # a hip that turns further forward, about `left`, moves the sole back
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (middle, high) if excess(middle) > 0.0 else (low, middle)
    return positions(min((low, high), key=lambda lean: abs(excess(lean))))


def _sagittal(build: Build, limb: Limb, left: Triple) -> list[tuple[Joint, int]]:
    """Return the hinges of a leg about the axis `left`, each with the sign of its axis."""
    cosines = [(joint, frames.dot(build.axis(joint), left)) for joint in limb.joints]
    return [
        (joint, 1 if cosine > 0 else -1)
        for joint, cosine in cosines
        if joint.type != "prismatic" and abs(cosine) > _PARALLEL and joint in build.driven
    ]


def _bent_leg(leg: Sequence[tuple[Joint, int]], sole: int, bend: int, lean: int) -> dict[str, float] | None:
    """Return the positions of hip, knee and ankle for the turn of the sole, a bend of the knee, and a turn of
    the hip about the axis to the left (deg); None if the limits exclude them. Further hinges stay where they
    are neutral."""
    (hip, hip_sign), (knee, knee_sign), *others, (ankle, ankle_sign) = leg
    low, high = sorted(knee_sign * end for end in range_of(knee))
    turned = bend if high >= -low else -bend
    rest = sum(round(sign * degrees(neutral(joint))) for joint, sign in others)
    angles = {
        hip: hip_sign * lean,
        knee: knee_sign * turned,
        ankle: ankle_sign * (sole - lean - turned - rest),
    }
    positions = {joint: radians(angle) for joint, angle in angles.items()}
    allowed = all(range_of(joint)[0] <= value <= range_of(joint)[1] for joint, value in positions.items())
    return {joint.name: value for joint, value in positions.items()} if allowed else None


def _sole(build: Build, limb: Limb, where: Mapping[str, Frame]) -> Bounds:
    """Return the box around the foot of a leg, whose links have the frames `where`."""
    foot = limb.joints[-1].child
    boxes = [box for name in build.rigid(foot) if (box := build.box(name, where[name]))]
    return box_around(boxes) if boxes else (where[foot][0], where[foot][0])


def _sole_angle(build: Build, limb: Limb, forward: Triple, down: Triple) -> int:
    """Return the angle (deg) about the axis to the left by which the foot of a leg has to turn from its
    attitude with all joints at 0 to stand on its longest side; 0 if it does so already."""
    links = [(build.model.link(name), build.frames[name]) for name in build.rigid(limb.joints[-1].child)]
    points = [
        point
        for link, frame in links
        for part in link.collisions or link.visuals
        for point in corners(part.shape, frames.compose(frame, frames.frame(part.origin)))
    ]
    if not points:
        return 0
    left = frames.cross(forward, down)

    def length(angle: int) -> float:
        """The length of the side on the ground."""
        rotation = frames.from_axis_angle(left, radians(angle))
        turned = [frames.rotate(rotation, point) for point in points]
        deepest = max(frames.dot(point, down) for point in turned)
        level = max(dist(points[0], point) for point in points) * _LEVEL_SHARE
        ends = [frames.dot(point, forward) for point in turned if frames.dot(point, down) > deepest - level]
        return max(ends) - min(ends)

    lengths = {angle: length(angle) for angle in range(-_MAX_SOLE_ANGLE, _MAX_SOLE_ANGLE + 1)}
    longest = max(lengths.values())
    if lengths[0] > _MIN_SOLE_SHARE * longest:
        return 0
    level = [angle for angle, value in lengths.items() if value > _LEVEL_LENGTH * longest]
    nearest = min(level, key=abs)
    return round(mean(angle for angle in level if abs(angle - nearest) <= _LEVEL_ANGLE))


def _standing(build: Build, limb: Limb, down: Triple) -> tuple[dict[str, float], float]:
    """Return joint positions with the foot of a leg below its hip and the leg bent, and how far (m) the foot
    is from this place.

    A foot stays beside its hip as far as the joints that bend the leg cannot move it: along their axis. A leg
    that begins with an upright hinge stands outward. The lengths of the leg are tried in turn, because the
    limits of its joints may exclude the first ones.
    """
    limb = _with_foot(build, limb)
    first = limb.joints[0]
    is_sprawled = abs(frames.dot(build.axis(first), down)) > _UPRIGHT and len(limb.joints) > 2
    root = limb.joints[1] if is_sprawled else first
    hip = build.frames[root.child][0]
    reach = sum(hypot(*joint.origin.xyz) for joint in limb.path[limb.path.index(root) + 1 :])
    leg = frames.subtract(limb.frames({})[limb.path[-1].name][0], hip)
    direction, shift = down, (0.0, 0.0, 0.0)
    if is_sprawled:
        outward = _level(leg, down)
        if hypot(*outward) < _LARGEST_FOOT_SHIFT * reach:
            outward = _level(frames.subtract(hip, frames.mean(_hips(build))), down)
        outward = frames.scaled(outward, 1.0 / (hypot(*outward) or 1.0))
        angle = radians(_SPRAWL)
        direction = frames.add(
            frames.scaled(down, cos(angle)), frames.scaled(outward, sqrt(1.0 - cos(angle) ** 2))
        )
    else:
        level = _level(_bending_axis(build, limb), down)
        shift = frames.scaled(level, frames.dot(leg, level))
        if hypot(*shift) > _LARGEST_FOOT_SHIFT * reach:
            shift = (0.0, 0.0, 0.0)
    solutions = []
    for share in _STANDING_LEG_SHARES:
        foot = frames.add(hip, frames.add(shift, frames.scaled(direction, share * reach)))
        positions, missing = limb.positions_for(foot)
        solutions.append((missing, positions))
        if missing < _TIP_TOLERANCE * reach:
            break
    missing, positions = min(solutions, key=lambda solution: solution[0])
    return positions, missing


def _with_foot(build: Build, limb: Limb) -> Limb:
    """Return a leg up to its foot: to the far end of its last link, if the origin of this link is not near
    it."""
    box = build.box(limb.tip)
    if box is None:
        return limb
    low, high = box
    along = max(range(3), key=lambda axis: high[axis] - low[axis])
    end = max(low[along], high[along], key=abs)
    if abs(end) <= _FOOT_SHARE * limb.reach:
        return limb
    x, y, z = ((a + b) / 2 for a, b in zip(low, high, strict=True))
    place = [x, y, z]
    place[along] = end
    last = limb.path[-1]
    origin = replace(last.origin, xyz=(place[0], place[1], place[2]), rpy=(0.0, 0.0, 0.0))
    foot = replace(last, name=f"{last.name} foot", type="fixed", parent=last.child, origin=origin)
    return replace(limb, path=(*limb.path, foot))


def _level(vector: Triple, down: Triple) -> Triple:
    """Return the part of a vector across the direction `down`."""
    return frames.subtract(vector, frames.scaled(down, frames.dot(vector, down)))


def _bending_axis(build: Build, limb: Limb) -> Triple:
    """Return the axis to which most joints of a leg are parallel: of its plane."""
    axes = [build.axis(joint) for joint in limb.joints]
    return max(axes, key=lambda axis: sum(abs(frames.dot(axis, second_axis)) > 0.9 for second_axis in axes))


def _hips(build: Build) -> list[Triple]:
    return [build.frames[limb.joints[0].child][0] for limb in build.legs]


# The direction


def _forward(build: Build, down: Triple) -> tuple[Triple, str]:
    """Return the unit vector along an axis of the root in which a robot on legs walks, and the evidence as a
    phrase: across the line of two hips; from the hind legs of several to the front legs, as their names say,
    or else along the longer distance between hips, x by default."""
    hips = _hips(build)
    level = [axis for axis in range(3) if abs(down[axis]) < _UPRIGHT]
    spans = {axis: max(hip[axis] for hip in hips) - min(hip[axis] for hip in hips) for axis in level}
    if len(hips) == 2:
        axis = min(level, key=lambda number: spans[number])
        toes = _toes(build, axis)
        return _along(axis, toes), "across the line of its hips" + (", where its toes are" if toes else "")
    ahead = _from_hind_to_front(build)
    if ahead is not None:
        axis = max(level, key=lambda number: abs(ahead[number]))
        return _along(axis, ahead[axis]), "where its front legs are, as their names say"
    # Rounding must not choose y where the hips are on a circle.
    longer = max(level, key=lambda number: spans[number] * (1.01 if number == 0 else 1.0))
    return _along(longer, 1.0), "along the longer distance between its hips"


def _along(axis: int, sign: float) -> Triple:
    x, y, z = ((1.0 if sign >= 0 else -1.0) * (number == axis) for number in range(3))
    return x, y, z


def _toes(build: Build, axis: int) -> float:
    """Return how much farther the feet of a biped reach beyond their ankles along an axis than against it
    (m); 0 if that is too little to say where the toes are."""
    excess = 0.0
    length = 0.0
    for limb in build.legs:
        low, high = _sole(build, limb, build.frames)
        ankle = build.frames[limb.joints[-1].child][0]
        excess += high[axis] + low[axis] - 2.0 * ankle[axis]
        length += high[axis] - low[axis]
    return excess if abs(excess) > _TOES * length else 0.0


def _from_hind_to_front(build: Build) -> Triple | None:
    """Return the way from the hind legs to the front legs; None if the names of the legs do not say which are
    which."""
    fronts: list[Triple] = []
    rears: list[Triple] = []
    for limb, hip in zip(build.legs, _hips(build), strict=True):
        names = " ".join(f"{joint.name} {joint.child}" for joint in limb.joints)
        is_front, is_rear = bool(_FRONT.search(names)), bool(_REAR.search(names))
        if is_front and not is_rear:
            fronts.append(hip)
        elif is_rear and not is_front:
            rears.append(hip)
    return frames.subtract(frames.mean(fronts), frames.mean(rears)) if fronts and rears else None


def _fallen(build: Build, down: Triple) -> str:
    """Return the condition that a robot is tilted too far: by its frame if that is upright, else by the
    direction of gravity in the frame of its chassis."""
    if down[2] < -0.9:
        return f"tilt(robot) > {short_number(_FALLEN_TILT)} deg"
    gravity = frames.rotate_back(build.frames[build.chassis][1], down)
    axis = max(range(3), key=lambda number: abs(gravity[number]))
    share = short_number(cos(radians(_FALLEN_TILT)))
    component = f"robot.down.{'xyz'[axis]}"
    return f"{component} < {share}" if gravity[axis] > 0 else f"{component} > -{share}"


def _gait(build: Build, rotation: Quaternion) -> tuple[list[str], list[str]]:
    """Return the feet that swing first and those that swing second: legs around the body in turn, so that a
    quadruped trots and a hexapod stands on tripods."""
    hips = [frames.rotate(rotation, hip) for hip in _hips(build)]
    middle = frames.mean(hips)
    order = sorted(
        range(len(hips)),
        key=lambda leg: atan2(hips[leg][1] - middle[1], hips[leg][0] - middle[0]),
    )
    tips = [build.legs[leg].tip for leg in order]
    return tips[::2], tips[1::2]
