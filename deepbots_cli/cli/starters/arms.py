"""Arms: reaching for a place with the tip, and closing the gripper there."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import combinations, product
from math import degrees, dist, hypot

from deepbots_cli import frames
from deepbots_cli.cli.starters.draft import Draft, grouped_by_unit, round_position, short_number
from deepbots_cli.frames import Triple
from deepbots_cli.robots.build import Build, Limb, mean_point, neutral, range_of
from deepbots_cli.robots.meshes import Bounds
from deepbots_cli.robots.model import Joint

_SPREADING_SHARE = 0.02
"""The least change of the distance between fingertips, as a share of the size of the hand, of a joint that
closes the hand."""
_CLOSED_SHARE = 0.9
"""How far a finger joint closes, as a share of the way to the end of its range."""
_BENDING_RATIO = 1.5
"""How much further a finger joint bends than it stretches, at least."""
_LARGEST_ANGLE = 6.3
"""The largest angle (rad) of an arm's joint that the policy distinguishes."""
_SCATTER = 0.1
"""The largest distance of the ball from its mean place along each axis, in its radius."""
_BENDING_SHARE = 0.4
"""How far a joint bends, as a share of the way to the end of its range, where its direction is tried: at the
end, fingers have passed each other."""
_STEPS_OF_CLOSING = 10
_PARALLEL = 0.999
"""The cosine of the angle between axes that count as parallel."""
_TIP_TOLERANCE = 0.02
"""The largest distance of the tip of a limb from its target, as a fraction of the limb's reach."""


def reach(draft: Draft) -> dict[str, object] | None:
    """Bring the tip of an arm to a place in space; None if no box of places is found that it can reach."""
    build = draft.build
    limb = next(iter(build.arms or build.limbs), None)
    if limb is None or len(limb.joints) < 2:
        return None
    joints = limb.joints
    if any(joint not in build.driven or joint.type == "prismatic" for joint in joints):
        return None
    box = _reachable_box(build, limb)
    if box is None:
        return None
    low, high, positions = box
    group = draft.add_group("arm", joints)
    draft.add_start(group, "ready", positions, joints)
    draft.add_motor(
        "motors",
        "position_motor",
        group,
        joints,
        "angles + stride * move    # each joint goes on from where it is",
    )
    gripper = add_gripper(draft, limb.fingers, "0.5 - 0.5 * grip")
    draft.hold([joint for joint in build.driven if joint not in joints and joint.name not in gripper])
    lift = (0.0, 0.0, draft.height)
    ends = [
        " ".join(short_number(round(value, 3)) for value in frames.add(corner, lift))
        for corner in (low, high)
    ]
    largest = max(abs(end) for joint in joints for end in range_of(joint))
    plane = "".join(
        name for name, minimum, maximum in zip("xyz", low, high, strict=True) if minimum < maximum
    )
    values = {
        "arm": group,
        "low": ends[0],
        "high": ends[1],
        "tip": limb.tip,
        "reach": limb.reach,
        "largest": min(largest, _LARGEST_ANGLE),
        "gripper": bool(gripper),
    }
    return values | {"plane": "" if plane == "xyz" else f".{plane}"}


def add_gripper(draft: Draft, fingers: Sequence[Joint], command: str) -> list[str]:
    """Add a gripper that opens and closes the joints of a hand. Returns their names: none for a hand without
    motors, or with slides and hinges."""
    joints = [joint for joint in fingers if joint in draft.build.driven]
    if not joints or len({joint.type == "prismatic" for joint in joints}) > 1:
        return []
    opened, closed = draft.build.ends(joints, joints)
    group = draft.add_group("fingers", joints)
    open_pose = draft.add_start(group, "open", opened, joints)
    values = {"open": _joint_values(joints, opened), "closed": _joint_values(joints, closed)}
    if all(len(texts) == 1 for texts in values.values()):
        settings = {key: texts.pop() for key, texts in values.items()}
        draft.add_motor("gripper", "gripper", group, joints, command, settings)
    else:  # the actuator `gripper` has one position for all joints
        closed_pose = draft.add_pose(group, "closed", closed, joints)
        command = f"{closed_pose} + ({open_pose} - {closed_pose}) * ({command})"
        draft.add_motor("gripper", "position_motor", group, joints, command)
    return draft.groups[group]


def grasp(draft: Draft) -> dict[str, object] | None:
    """Close the fingers of a hand around a ball that hangs between them; None for fewer than two fingers."""
    build = draft.build
    fingers = _fingers(build)
    joints = [joint for finger in fingers for joint in finger if joint in build.driven]
    parts = [_shapes(build, finger) for finger in fingers]
    tips = [part[-1] for part in parts if part]
    if len(tips) < 2 or not joints:
        return None
    opened, closed = _grasp(build, joints, tips)
    moved = []
    for kind, unit, unit_joints in grouped_by_unit(joints):
        group = draft.add_group(f"finger_{kind}", unit_joints)
        open_pose = draft.add_start(group, f"open_{kind}", opened, unit_joints)
        closed_pose = draft.add_pose(group, f"closed_{kind}", closed, unit_joints)
        draft.add_motor(
            f"close_{kind}",
            "position_motor",
            group,
            unit_joints,
            f"{open_pose} + ({closed_pose} - {open_pose}) * ((squeeze_{kind} + 1) / 2)",
        )
        moved.append({"name": kind, "group": group, "unit": unit})
    draft.hold([joint for joint in build.driven if joint not in joints])
    center, radius = _held_ball(build, tips, opened, closed)
    center = frames.add(center, (0.0, 0.0, draft.height))
    low, high = (
        " ".join(short_number(round(value + sign * _SCATTER * radius, 4)) for value in center)
        for sign in (-1.0, 1.0)
    )
    return {
        "moved": moved,
        "fingers": [
            draft.add_links(f"finger_{number}", part)
            for number, part in enumerate(filter(None, parts), start=1)
        ],
        "needed": 3 if len(tips) > 3 else 2,
        "low": low,
        "high": high,
        "radius": radius,
    }


def _fingers(build: Build) -> list[list[Joint]]:
    """Return the joints of each finger: of each limb, or of each part beyond the wrist."""
    if len(build.limbs) > 1:
        return [[*limb.joints, *limb.fingers] for limb in build.limbs]
    beyond = build.limbs[0].fingers
    behind = {joint.child for joint in beyond}
    firsts = [joint for joint in beyond if not any(joint.parent in build.rigid(link) for link in behind)]
    return [
        [joint for joint in beyond if joint.child in build.model.links_below(first.child)] for first in firsts
    ]


def _shapes(build: Build, finger: Sequence[Joint]) -> list[str]:
    """Return the links of a finger that have a shape, from the palm to the tip."""
    links = [name for joint in finger for name in build.rigid(joint.child)]
    return [name for name in dict.fromkeys(links) if name in build.boxes]


def _grasp(
    build: Build, joints: Sequence[Joint], tips: Sequence[str]
) -> tuple[dict[str, float], dict[str, float]]:
    """Return the positions of finger joints in an open and in a closed hand.

    A joint closes toward the end of its range that is further from its neutral position, because fingers bend
    further than they stretch. Where both ends are alike, it closes toward the middle of all fingertips;
    where neither is nearer to it, the joint only spreads the fingers, and stays.
    """
    opened = {joint.name: neutral(joint) for joint in joints}
    closed = dict(opened)
    center = mean_point(build.middles(tips, opened))
    for joint in joints:
        start = opened[joint.name]
        near, far = sorted(range_of(joint), key=lambda end: -abs(end - start))
        own = [tip for tip in tips if tip in build.model.links_below(joint.child)]
        if joint.type == "prismatic" or abs(near - start) < _BENDING_RATIO * abs(far - start):
            distances = {
                end: _mean_distance(build, own, {joint.name: start + _BENDING_SHARE * (end - start)}, center)
                for end in (near, far)
            }
            near, far = sorted((near, far), key=distances.__getitem__)
            if distances[far] - distances[near] < _SPREADING_SHARE * build.size:
                continue
        closed[joint.name] = start + _CLOSED_SHARE * (near - start)
        opened[joint.name] = far if joint.type == "prismatic" else start
    return opened, closed


def _mean_distance(
    build: Build, links: Sequence[str], positions: Mapping[str, float], center: Triple
) -> float:
    places = build.middles(links, positions)
    return sum(dist(center, place) for place in places) / max(len(places), 1)


def _held_ball(
    build: Build, tips: Sequence[str], opened: Mapping[str, float], closed: Mapping[str, float]
) -> tuple[Triple, float]:
    """Return the center and the radius of a ball that as many fingertips as possible meet while the hand
    closes, and that is clear of the open hand."""
    paths = []
    for number in range(_STEPS_OF_CLOSING + 1):
        share = number / _STEPS_OF_CLOSING
        positions = {name: start + share * (closed[name] - start) for name, start in opened.items()}
        paths.append(build.middles(tips, positions))
    boxes = build.boxes_at(opened)
    balls: list[tuple[int, float, Triple]] = []
    for places in paths:
        centers = [mean_point(places), *(mean_point(pair) for pair in combinations(places, 2))]
        for center in centers:
            clearance = min(_distance(center, box) for box in boxes)
            radius = min(0.9 * clearance, 0.25 * build.size)
            meeting = sum(
                min(dist(step[finger], center) for step in paths) < radius for finger in range(len(tips))
            )
            balls.append((meeting, radius, center))
    _, radius, center = max(balls)
    return center, max(radius, 0.02 * build.size)


def _distance(point: Triple, box: Bounds) -> float:
    """Return the distance (m) of a point from a box; 0 inside."""
    beyond = (max(low - value, value - high, 0.0) for value, low, high in zip(point, *box, strict=True))
    return hypot(*beyond)


def _joint_values(joints: Sequence[Joint], positions: Mapping[str, float]) -> set[str]:
    """Return the different positions of several joints of one unit as texts."""
    scale, unit = (1e3, "mm") if joints[0].type == "prismatic" else (degrees(1.0), "deg")
    return {f"{scale * round_position(joint, positions[joint.name]) + 0.0:.6g} {unit}" for joint in joints}


def _reachable_box(build: Build, limb: Limb) -> tuple[Triple, Triple, dict[str, float]] | None:
    """Return a box in front of an arm, or beside it, whose corners its tip reaches, and joint positions at
    the start.

    The arm starts with its tip in the middle. The box of an arm that moves in a plane along two axes of the
    world is flat, and the tip starts beside it: in the middle it would often be at the drawn place already.
    """
    bending = [limb.joints[0], *(joint for joint in limb.joints if abs(build.axis(joint)[2]) < 0.3)]
    shoulder = next((joint for joint in limb.joints if abs(build.axis(joint)[2]) < 0.7), limb.joints[0])
    far = limb.reach
    tolerance = _TIP_TOLERANCE * limb.reach
    across = next(
        (axis for axis in range(3) if all(abs(build.axis(joint)[axis]) > _PARALLEL for joint in limb.joints)),
        None,
    )
    sides = ((1.0, 0.0), (0.0, 1.0), (0.0, -1.0), (-1.0, 0.0))
    for half, (x, y), rise in product((0.2, 0.12, 0.06), sides, (0.1, 0.3, 0.0)):
        away = (0.5 if across is None else 0.65) * far
        middle = frames.add(build.frames[shoulder.child][0], (away * x, away * y, rise * far))
        starts = [middle]
        orders = [bending, None]
        inner = []
        sizes = [half * far] * 3
        if across is not None:
            middle, sizes[across] = (
                _moved(middle, across, build.frames[limb.tip][0][across] - middle[across]),
                0.0,
            )
            starts = [
                _moved(middle, axis, 1.5 * sign * half * far)
                for axis in (2, 1, 0)
                if axis != across
                for sign in (1, -1)
            ]
            orders.append(bending[::-1])  # which often bends the elbow the other way
            # The circle that a hinge at its limit leaves out may reach into a flat box between two corners.
            inner = [
                middle,
                *(_moved(middle, axis, sign * sizes[axis]) for axis in range(3) for sign in (1, -1)),
            ]
        low, high = (
            frames.add(middle, (sign * sizes[0], sign * sizes[1], sign * sizes[2])) for sign in (-1, 1)
        )
        if across != 2:
            low = low[0], low[1], max(low[2], build.lowest + 0.05 * far)
        tried = [limb.positions_for(start, order) for start in starts for order in orders]
        reached = [positions for positions, missing in tried if missing < tolerance]
        corners = product((low[0], high[0]), (low[1], high[1]), (low[2], high[2]))
        if reached and all(limb.positions_for(point)[1] < tolerance for point in (*corners, *inner)):
            return (
                low,
                high,
                reached[0] if across is None else max(reached, key=limb.lowest),
            )  # above the ground
    return None


def _moved(point: Triple, axis: int, distance: float) -> Triple:
    x, y, z = (value + distance * (number == axis) for number, value in enumerate(point))
    return x, y, z
