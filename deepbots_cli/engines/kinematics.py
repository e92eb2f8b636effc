"""Inverse kinematics of a chain of joints: damped least squares, within the ranges of the joints.

The rule is that of Levenberg and Marquardt on the error of position (m) and attitude (rad, counted as
`METERS_PER_RAD` m each): a step is (J^T J + c 1)^-1 J^T e, and c falls after steps that help and grows after
steps that do not.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import atan2, inf
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from deepbots_cli import frames
from deepbots_cli.errors import EngineError
from deepbots_cli.frames import IDENTITY_FRAME, Frame, Quaternion, Triple

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from deepbots_cli.port import Engine, Kinematics, Part
    from deepbots_cli.robots.model import Joint, RobotModel

    FloatArray = NDArray[np.float64]

METERS_PER_RAD = 0.3  # m; the weight of an error of 1 rad
TOLERANCE_M = 1e-7  # m; an error to stop at
MAX_ITERATIONS = 100
STALL_RATIO = 0.99  # a round that leaves more than this share of the square of the error has not helped
MAX_STALLED_ITERATIONS = 12  # in a row, after which the search gives up
MAX_STEP = 0.5  # rad or m; of a joint in one round


class Segment(NamedTuple):
    """The step from one link to the next: a fixed frame, then a joint, at `place` among all moving joints of
    the chain, or None."""

    frame: Frame
    axis: Triple
    turns: bool
    place: int | None


class _Drive(NamedTuple):
    """The axis of a moving joint in the frame of the root: its direction, a point of it, and whether the
    joint turns about it or slides along it."""

    axis: Triple
    pivot: Triple
    turns: bool

    def movement_of(self, point: Triple) -> Triple:
        """Return the movement of a point per rad, or m, of the joint."""
        return frames.cross(self.axis, frames.subtract(point, self.pivot)) if self.turns else self.axis

    @property
    def rotation(self) -> Triple:
        """The rotation per rad, or m, of the joint, counted as `METERS_PER_RAD` m per rad."""
        return frames.scaled(self.axis, METERS_PER_RAD) if self.turns else IDENTITY_FRAME[0]


class Chain:
    """The chain from the root of a robot to one of its links. `moving_joints` names the joints on the way, of
    which `driven` may be solved for."""

    def __init__(self, model: RobotModel, link: str, driven: Sequence[str]) -> None:
        path = _path(model, link)
        self.moving_joints = tuple(joint.name for joint in path if joint.moves)
        strange = [name for name in driven if name not in self.moving_joints]
        if strange:
            raise EngineError(f"joint '{strange[0]}' does not move link '{link}' of '{model.name}'")
        self._segments = [
            Segment(
                frames.frame(j.origin),
                j.axis,
                j.type != "prismatic",
                self.moving_joints.index(j.name) if j.moves else None,
            )
            for j in path
        ]
        self._driven = [self.moving_joints.index(name) for name in driven]
        self._followers = [
            (index, self._driven.index(self.moving_joints.index(mimic.joint)), mimic)
            for index, name in enumerate(self.moving_joints)
            if (mimic := model.followers.get(name)) is not None and mimic.joint in driven
        ]
        """The followers of driven joints: their place, that of the leader among the driven joints, and their
        linear relation."""
        ranges = [model.joint(name).ends(inf) for name in driven]
        self._lower, self._upper = (np.array([ends[side] for ends in ranges]) for side in (0, 1))

    def solve(
        self, root: Frame, positions: Sequence[float], target: Triple, attitude: Quaternion | None
    ) -> list[float]:
        """Return positions of the driven joints that bring the link's origin to a position, or as near as the
        search gets.

        `root` is the pose of the root link, `positions` are the positions of all `moving_joints`. The search
        begins there, and once more in the middle of the ranges if it misses the target: from a stretched arm
        it does not find a way to bend.
        """
        inward = frames.inverse(root[1])
        goal = frames.rotate(inward, frames.subtract(target, root[0]))
        local_attitude = None if attitude is None else frames.multiply(inward, frames.normalized(attitude))
        solution, missing = self._search(list(positions), goal, local_attitude)
        if missing > TOLERANCE_M * TOLERANCE_M:
            second_solution, still_missing = self._search(self._middle(positions), goal, local_attitude)
            if still_missing < missing:
                solution = second_solution
        return [solution[index] for index in self._driven]

    def _middle(self, positions: Sequence[float]) -> list[float]:
        """Return these positions, with the driven joints in the middle of their ranges, if they have any."""
        middle = list(positions)
        for index, low, high in zip(self._driven, self._lower.tolist(), self._upper.tolist(), strict=True):
            if low > -inf and high < inf:
                middle[index] = (low + high) / 2
        return middle

    def _search(
        self, joints: list[float], goal: Triple, local_attitude: Quaternion | None
    ) -> tuple[list[float], float]:
        """Return the end of the search from these positions, and the square of the error that is left."""
        error, jacobian = self._linearized(joints, goal, local_attitude)
        damping = 1e-4
        missing = float(error @ error)
        idle = 0
        for _ in range(MAX_ITERATIONS):
            if missing < TOLERANCE_M * TOLERANCE_M or damping > 1e8 or idle > MAX_STALLED_ITERATIONS:
                break
            now = np.array([joints[index] for index in self._driven])
            normal = jacobian.T @ jacobian + damping * np.eye(len(now))
            # Damping keeps the matrix invertible where a stretched chain makes the Jacobian lose rank.
            step = np.clip(np.linalg.solve(normal, jacobian.T @ error), -MAX_STEP, MAX_STEP)
            tried = list(joints)
            for index, value in zip(
                self._driven, np.clip(now + step, self._lower, self._upper).tolist(), strict=True
            ):
                tried[index] = value
            new_error, new_jacobian = self._linearized(tried, goal, local_attitude)
            left = float(new_error @ new_error)
            idle = idle + 1 if left > STALL_RATIO * missing else 0
            if left < missing:
                joints = tried
                error = new_error
                jacobian = new_jacobian
                missing = left
                damping = max(damping * 0.2, 1e-9)
            else:
                damping *= 10.0
        return joints, missing

    def _linearized(
        self, joints: Sequence[float], goal: Triple, attitude: Quaternion | None
    ) -> tuple[FloatArray, FloatArray]:
        """Return the error at these positions, and how it shrinks with each driven joint."""
        end_frame, drives = self._forward(joints)
        error = list(frames.subtract(goal, end_frame[0]))
        columns = [drive.movement_of(end_frame[0]) for drive in drives]
        if attitude is None:
            return np.array(error), self._with_followers(np.array(columns)).T
        error += frames.scaled(
            _rotation_vector(frames.multiply(attitude, frames.inverse(end_frame[1]))), METERS_PER_RAD
        )
        full = [(*column, *drive.rotation) for column, drive in zip(columns, drives, strict=True)]
        return np.array(error), self._with_followers(np.array(full)).T

    def _forward(self, joints: Sequence[float]) -> tuple[Frame, list[_Drive]]:
        """Return the frame of the part at these positions, and the axes of the driven joints and of their
        followers in the world."""
        joints = list(joints)
        for follower, leader, mimic in self._followers:
            joints[follower] = mimic.position(joints[self._driven[leader]])
        end_frame = IDENTITY_FRAME
        drives = [_Drive(IDENTITY_FRAME[0], IDENTITY_FRAME[0], True)] * len(joints)
        for frame, axis, turning, index in self._segments:
            end_frame = frames.compose(end_frame, frame)
            if index is not None:
                drive = drives[index] = _Drive(frames.rotate(end_frame[1], axis), end_frame[0], turning)
                if turning:
                    end_frame = (
                        end_frame[0],
                        frames.multiply(end_frame[1], frames.from_axis_angle(axis, joints[index])),
                    )
                else:
                    end_frame = (
                        frames.add(end_frame[0], frames.scaled(drive.axis, joints[index])),
                        end_frame[1],
                    )
        indices = [*self._driven, *(follower for follower, _, _ in self._followers)]
        return end_frame, [drives[index] for index in indices]

    def _with_followers(self, rows: FloatArray) -> FloatArray:
        """Return a row for each driven joint, from its own row and those of its followers."""
        count = len(self._driven)
        for row, (_, leader, mimic) in zip(rows[count:], self._followers, strict=True):
            rows[leader] += mimic.multiplier * row
        return rows[:count]


def inverse_kinematics(engine: Engine, model: RobotModel, part: Part, joints: Sequence[str]) -> Kinematics:
    """Return `Engine.inverse_kinematics` for a robot of this model."""
    chain = Chain(model, part[1] or model.root, joints)
    root = engine.pose(part[0])
    read = engine.joint_states(part[0], chain.moving_joints)
    return lambda position, attitude: chain.solve(root(), [state[0] for state in read()], position, attitude)


def _path(model: RobotModel, link: str) -> list[Joint]:
    """Return the joints from the root to a link, in this order."""
    above = {joint.child: joint for joint in model.joints}
    path = []
    while link in above:
        path.append(above[link])
        link = above[link].parent
    return path[::-1]


def _rotation_vector(q: Quaternion) -> Triple:
    """Return the axis of a rotation times its angle (rad), at most half a turn."""
    # q and -q are the same rotation; the one with w >= 0 is the shorter way.
    x, y, z, w = q if q[3] >= 0.0 else (-q[0], -q[1], -q[2], -q[3])
    length = float(np.hypot(np.hypot(x, y), z))
    # 2 is the limit of the ratio for small angles.
    return frames.scaled((x, y, z), 2.0 * atan2(length, w) / length if length > 0.0 else 2.0)
