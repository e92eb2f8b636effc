"""Chains of joints: where their ends are, and joint positions that bring them somewhere.

Positions are found by cyclic coordinate descent: joint after joint, from the last to the first, takes the position within
its range that brings the end nearest to the target, round after round. It needs no arrays, so no simulator's packages.
"""

from __future__ import annotations

from collections.abc import Container, Iterable, Mapping
from dataclasses import dataclass
from math import atan2, dist, pi

from deepbots_cli import frames
from deepbots_cli.footprint import behind
from deepbots_cli.frames import Frame, Triple
from deepbots_cli.robots.model import Joint

ROUNDS = 80
BENT = 0.4  # rad; where a search begins, since a straight limb does not know which way to bend

Positions = dict[str, float]
"""Of joints by name, in rad or m; one that is not named is at 0."""


@dataclass(frozen=True)
class Limb:
    """The joints from a link to another, in order, fixed ones too; `end` is the last link."""

    joints: tuple[Joint, ...]
    end: str

    @property
    def moving(self) -> tuple[Joint, ...]:
        return tuple(joint for joint in self.joints if joint.moves)

    @property
    def reach(self) -> float:
        """In m, from the first joint that moves to the end when stretched out, at most."""
        first = self.joints.index(self.moving[0])
        return sum(dist(joint.origin.xyz, (0.0, 0.0, 0.0)) for joint in self.joints[first + 1 :])


def range_of(joint: Joint) -> tuple[float, float]:
    """Where a joint may be; one without limits within half a turn either way, or a metre."""
    lower, upper = joint.limit.lower, joint.limit.upper
    if joint.type == "continuous" or lower is None or upper is None:
        return (-1.0, 1.0) if joint.type == "prismatic" else (-pi, pi)
    return lower, upper


def neutral(joint: Joint) -> float:
    """0, or the middle of the range of a joint that may not be there."""
    low, high = range_of(joint)
    return 0.0 if low <= 0.0 <= high else (low + high) / 2


def centre(joint: Joint) -> float:
    """0, or the middle of the range of a joint that can hardly move on one side of 0."""
    low, high = range_of(joint)
    return 0.0 if min(-low, high) > 0.2 * (high - low) else (low + high) / 2


def swing(joints: Iterable[Joint]) -> float:
    """By how much each of them can leave its centre, either way; at most 0.5."""
    return min(0.5, *(min(range_of(joint)[1] - centre(joint), centre(joint) - range_of(joint)[0]) for joint in joints))


def bring(limb: Limb, start: Frame, target: Triple, using: Container[Joint] | None = None) -> tuple[Positions, float]:
    """Positions of the limb's joints with its end near `target`, and how far it then is away (m).

    `start` is the frame that it begins in; joints that are not among `using` stay where they are neutral.
    """
    used = [joint for joint in limb.moving if using is None or joint in using]
    positions = {joint.name: neutral(joint) for joint in limb.moving}
    positions |= {joint.name: _begin(joint, number) for number, joint in enumerate(used)}
    missing = 0.0
    for _ in range(ROUNDS):
        for joint in reversed(used):
            _improve(limb, joint, start, target, positions)
        missing = dist(_trace(limb, start, positions)[-1][1][0], target)
        if missing < 1e-4:
            break
    return positions, missing


def _begin(joint: Joint, number: int) -> float:
    low, high = range_of(joint)
    bent = 0.0 if number == 0 else BENT if number % 2 else -BENT
    return (low + high) / 2 if joint.type == "prismatic" else min(max(neutral(joint) + bent, low), high)


def _improve(limb: Limb, joint: Joint, start: Frame, target: Triple, positions: Positions) -> None:
    """Move one joint to where the end is nearest to the target."""
    trace = _trace(limb, start, positions)
    before = trace[limb.joints.index(joint)][0]
    axis, pivot, end = frames.rotate(before[1], joint.axis), before[0], trace[-1][1][0]
    here, there = frames.subtract(end, pivot), frames.subtract(target, pivot)
    if joint.type == "prismatic":
        change = frames.dot(frames.subtract(target, end), axis)
    else:
        flat = frames.subtract(here, frames.scaled(axis, frames.dot(here, axis)))
        change = atan2(frames.dot(frames.cross(axis, flat), there), frames.dot(flat, there))
    low, high = range_of(joint)
    positions[joint.name] = min(max(positions[joint.name] + change, low), high)


def _trace(limb: Limb, start: Frame, positions: Mapping[str, float]) -> list[tuple[Frame, Frame]]:
    """Of every joint of the limb: the frame that it turns in, and that of the link behind it."""
    found: list[tuple[Frame, Frame]] = []
    here = start
    for joint in limb.joints:
        before, here = frames.inside(here, frames.frame(joint.origin)), behind(joint, here, positions.get(joint.name, 0.0))
        found.append((before, here))
    return found
