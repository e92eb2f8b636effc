"""Arms: reaching for a place with the tip, and closing the gripper there."""

from __future__ import annotations

from itertools import product

from deepbots_cli import frames
from deepbots_cli.cli.starters.draft import Draft
from deepbots_cli.cli.starters.text import short_number
from deepbots_cli.frames import Triple
from deepbots_cli.robots.build import Build, Limb

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
    draft.hold([joint for joint in build.driven if joint not in joints])
    lift = (0.0, 0.0, draft.height)
    ends = [
        " ".join(short_number(round(value, 3)) for value in frames.add(corner, lift))
        for corner in (low, high)
    ]
    bounded = all(
        joint.type != "continuous" and joint.limit.lower is not None and joint.limit.upper is not None
        for joint in joints
    )
    plane = "".join(
        name for name, minimum, maximum in zip("xyz", low, high, strict=True) if minimum < maximum
    )
    values = {
        "arm": group,
        "low": ends[0],
        "high": ends[1],
        "tip": limb.tip,
        "reach": limb.reach,
        "bounded": bounded,
    }
    return values | {"plane": "" if plane == "xyz" else f".{plane}"}


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
