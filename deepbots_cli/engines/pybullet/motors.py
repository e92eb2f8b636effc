"""Motors on joints, springs, forces on links, and the damping of joints, by their velocities at the end of
each physics step.

PyBullet exerts `-d * velocity` with the velocity at the start of a physics step of h s. A joint with the
inertia I then keeps `1 - x` of its velocity, x = d h / I: it swings from x = 1 on, and ever wider from x = 2
on. The velocities at the end of the step are those of the linearly implicit step,

    v' = (M + h D)^-1 (M v + h f),

with the mass matrix M of the joints, their damping D, and the torques f of motors, springs, gravity and
inertia. The torques -D v' are stable for any D. M, and the torques of gravity and inertia, are those at the
start of a control step. Contacts and limits are not in f: what they push turns up to 1 + x times as fast.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from math import copysign, inf
from operator import add
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from deepbots_cli import frames
from deepbots_cli.engines.pybullet import (
    BASE_LINK,
    DEFAULT_GAINS,
    NEGLIGIBLE_FORCE,
    UNLIMITED_FORCE,
    UNREACHABLE_SPEED,
)
from deepbots_cli.engines.pybullet import pybullet as p
from deepbots_cli.port import SERVO_TIME, ZERO_VECTOR

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from deepbots_cli.engines.mechanics import TorqueCurve
    from deepbots_cli.engines.pybullet.state import Body
    from deepbots_cli.frames import Triple
    from deepbots_cli.port import JointReader, MotorWriter, Pusher, TorqueReader

    FloatArray = NDArray[Any]


def velocity_motor(
    client: int, body: int, indices: Sequence[int], max_torque: Sequence[float]
) -> MotorWriter:
    limits = _limits(max_torque)
    mode = p.VELOCITY_CONTROL
    if len(indices) == 1:
        (index,) = indices
        (limit,) = limits
        set_one = p.setJointMotorControl2
        return lambda targets: set_one(body, index, mode, 0.0, targets[0], limit, *DEFAULT_GAINS, client)
    zeros = [0.0] * len(indices)
    gains = [[gain] * len(indices) for gain in DEFAULT_GAINS[:2]]
    set_all = p.setJointMotorControlArray
    return lambda targets: set_all(body, indices, mode, zeros, targets, limits, *gains, client)


def torque_motor(client: int, body: int, indices: Sequence[int], max_torque: Sequence[float]) -> MotorWriter:
    """Return a velocity motor that aims out of reach, and so exerts its limit, which is the target torque.

    PyBullet forgets plain torques after every engine step; renewing them costs as much as the motor from
    four substeps on, and their reader would not show them. The motions agree to the last digit or two.
    """
    mode, set_one = p.VELOCITY_CONTROL, p.setJointMotorControl2

    def exert(index: int, limit: float, torque: float) -> None:
        set_one(
            body,
            index,
            mode,
            0.0,
            copysign(UNREACHABLE_SPEED, torque),
            min(max(abs(torque), NEGLIGIBLE_FORCE), limit),
            *DEFAULT_GAINS,
            client,
        )

    limits = _limits(max_torque)
    if len(indices) == 1:
        (index,), (limit,) = indices, limits
        return lambda targets: exert(index, limit, targets[0])

    def exert_all(targets: Sequence[float]) -> None:
        for index, limit, torque in zip(indices, limits, targets, strict=True):
            exert(index, limit, torque)

    return exert_all


def position_motor(
    client: int, body: int, indices: Sequence[int], max_torque: Sequence[float], timestep: float
) -> MotorWriter:
    """Return PyBullet's own servo; `timestep` (s) is that of an engine step."""
    limits = _limits(max_torque)
    mode = p.POSITION_CONTROL
    set_all = p.setJointMotorControlArray
    zeros = [0.0] * len(indices)
    gains = [[min(1.0, timestep / SERVO_TIME)] * len(indices), [1.0] * len(indices)]
    return lambda targets: set_all(body, indices, mode, targets, zeros, limits, *gains, client)


class Springs:
    """Exerts `stiffness * (target - position) - damping * velocity`, limited, once joints have targets;
    `apply` renews it.

    `torques` are the torques on the joints in the last engine step. 12 joints take 5 us of an engine step of
    45 us (a walking robot); PyBullet's own plug-in for the same purpose takes 20, and cannot be stopped.
    """

    def __init__(
        self,
        client: int,
        body: int,
        indices: Sequence[int],
        read: JointReader,
        max_torque: Sequence[float],
        stiffness: Sequence[float],
        damping: Sequence[float] | None,
    ) -> None:
        self.indices = tuple(indices)
        limits = _limits(max_torque)
        self._columns = (
            tuple(stiffness),
            tuple(damping or (0.0,) * len(stiffness)),
            tuple(-limit for limit in limits),
            tuple(limits),
        )
        self._read = read
        self._exert = exert_torques(client, body, indices)
        self.torques = self._nothing = [0.0] * len(indices)
        self._targets: Sequence[float] | None = None

    @property
    def stiffness(self) -> dict[int, float]:
        """The stiffness (N m/rad or N/m) by joint."""
        return dict(zip(self.indices, self._columns[0], strict=True))

    def set_targets(self, targets: Sequence[float]) -> None:
        self._targets = tuple(targets)

    def reset(self) -> None:
        self._targets = None
        self.torques = self._nothing

    def apply(self) -> None:
        targets = self._targets
        if targets is not None:
            self.torques = torques = [
                _limited(k * (target - state[0]) - d * state[1], low, high)
                for k, d, low, high, target, state in zip(*self._columns, targets, self._read(), strict=True)
            ]
            self._exert(torques)


class CurvedMotor(Springs):
    """Springs, or motors with target torques where `stiffness` is None, whose largest torque falls with their
    speed."""

    def __init__(
        self,
        client: int,
        body: int,
        indices: Sequence[int],
        read: JointReader,
        max_torque: Sequence[float],
        curve: TorqueCurve,
        stiffness: Sequence[float] | None = None,
        damping: Sequence[float] | None = None,
    ) -> None:
        nothing = [0.0] * len(indices)
        super().__init__(client, body, indices, read, max_torque, stiffness or nothing, damping)
        self._is_spring = stiffness is not None
        self._curve = curve

    def apply(self) -> None:
        targets = self._targets
        if targets is None:
            return
        states = self._read()
        stiffness, damping, _, limits = self._columns
        efforts = targets
        if self._is_spring:
            efforts = [
                k * (target - state[0]) - d * state[1]
                for k, d, target, state in zip(stiffness, damping, targets, states, strict=True)
            ]
        bounds = self._curve.bounds([state[1] for state in states], limits)
        self.torques = [
            min(max(torque, low), high) for torque, (low, high) in zip(efforts, bounds, strict=True)
        ]
        self._exert(self.torques)


def _limited(torque: float, low: float, high: float) -> float:
    if torque > high:
        return high
    return low if torque < low else torque


def exert_torques(client: int, body: int, indices: Sequence[int]) -> Callable[[list[float]], object]:
    """Return a function that exerts torques in the next engine step alone; the friction of the joints' brakes
    acts as well."""
    joints = tuple(indices)
    zeros = [0.0] * len(indices)
    mode = p.TORQUE_CONTROL
    if len(joints) == 1:
        index = joints[0]
        set_one = p.setJointMotorControl2
        return lambda torques: set_one(body, index, mode, 0.0, 0.0, torques[0], *DEFAULT_GAINS, client)
    # Positional arguments cost a quarter less, even with those that have no meaning here.
    set_all = p.setJointMotorControlArray
    return lambda torques: set_all(body, joints, mode, zeros, zeros, torques, zeros, zeros, client)


def _limits(max_torque: Sequence[float]) -> list[float]:
    return [min(max(limit, NEGLIGIBLE_FORCE), UNLIMITED_FORCE) for limit in max_torque]


def torques(
    read: JointReader,
    body: int,
    indices: Sequence[int],
    springs: Mapping[tuple[int, tuple[int, ...]], Springs],
) -> TorqueReader:
    """Return a reader of the torques that the motors of joints exerted. PyBullet does not report the torques
    of `springs`; they are looked up in each reading, because they are not known when the reader is bound."""

    def read_torques() -> list[float]:
        exerted = [state[3] for state in read()]
        for (driven, _), drive in springs.items():
            if driven == body:
                if drive.indices == joint_indices:
                    exerted = list(map(add, exerted, drive.torques))
                    continue
                for index, torque in zip(drive.indices, drive.torques, strict=True):
                    if index in rows_by_index:
                        exerted[rows_by_index[index]] += torque
        return exerted

    joint_indices = tuple(indices)
    rows_by_index = {index: row for row, index in enumerate(joint_indices)}
    return read_torques


class WrenchMonitor:
    """Reads the wrench in the joint that carries a link; 0 until an engine step after a reset.

    PyBullet gives it at the center of mass in the axes of the inertia, without what the motor of the joint
    exerts along its axis, which is added here, and without what a limit or a leader of the joint exerts.
    """

    def __init__(self, client: int, owner: Body, index: int) -> None:
        p.enableJointForceTorqueSensor(owner.number, index, True, client)
        self._read = partial(p.getJointState, owner.number, index, client)
        self._center, self._principal = owner.dynamics(index).inertia_frame
        link = owner.link(index).name
        joint = next(joint for joint in owner.model.joints if joint.child == link)
        self._axis = joint.axis
        self._slides = joint.type == "prismatic"
        self._has_stepped = False

    def reset(self) -> None:
        self._has_stepped = False

    def update(self) -> None:
        self._has_stepped = True

    def read(self) -> tuple[Triple, Triple]:
        if not self._has_stepped:
            return ZERO_VECTOR, ZERO_VECTOR
        _, _, (fx, fy, fz, tx, ty, tz), exerted = self._read()
        force, torque = (frames.rotate(self._principal, part) for part in ((fx, fy, fz), (tx, ty, tz)))
        along = frames.scaled(self._axis, exerted)
        if self._slides:
            force = frames.add(force, along)
        else:
            torque = frames.add(torque, along)
        return force, frames.add(torque, frames.cross(self._center, force))


def pusher(client: int, owner: Body, index: int, frame: Literal["world", "link"]) -> Pusher:
    """Return a function that pushes a link. PyBullet's own frame of a link is that of its inertia, and it
    uses the pose of a link before its last move; both are corrected here."""
    return _in_link(client, owner, index) if frame == "link" else _in_world(client, owner, index)


def _in_link(client: int, owner: Body, index: int) -> Pusher:
    number = owner.number
    center, principal = owner.dynamics(index).inertia_frame
    back = frames.inverse(principal)
    origin = frames.rotate(back, frames.scaled(center, -1.0))
    force_it = p.applyExternalForce
    turn_it = p.applyExternalTorque
    mode = p.LINK_FRAME
    straight = back == frames.IDENTITY_ROTATION
    refresh = (lambda: None) if index == BASE_LINK else partial(p.getLinkState, number, index, 0, 1, client)

    def push(force: Triple, torque: Triple) -> None:
        refresh()
        if force != ZERO_VECTOR:
            force_it(number, index, force if straight else frames.rotate(back, force), origin, mode, client)
        if torque != ZERO_VECTOR:
            turn_it(number, index, torque if straight else frames.rotate(back, torque), mode, client)

    return push


def _in_world(client: int, owner: Body, index: int) -> Pusher:
    number = owner.number
    force_it = p.applyExternalForce
    turn_it = p.applyExternalTorque
    mode = p.WORLD_FRAME
    read_base = partial(p.getBasePositionAndOrientation, number, client)
    read_link = partial(p.getLinkState, number, index, 0, 1, client)

    def push(force: Triple, torque: Triple) -> None:
        if force != ZERO_VECTOR:
            origin = owner.origin_pose(*read_base())[0] if index == BASE_LINK else read_link()[4]
            force_it(number, index, force, origin, mode, client)
        if torque != ZERO_VECTOR:
            turn_it(number, index, torque, mode, client)

    return push


STOP_REACH = 0.04
"""How far (rad or m) beyond a limit PyBullet returns a joint by itself; one that is farther stays there
(`m_splitImpulsePenetrationThreshold`). Without split impulses, it returns at up to 80 rad/s."""


class Stops:
    """Puts joints that are far beyond a limit back on it, at rest."""

    def __init__(self, client: int, body: Body) -> None:
        self._client = client
        self._body = body
        self.ranges = [
            (joint.name, low, high)
            for joint in body.model.moving_joints
            for low, high in (joint.ends(inf),)
            if low <= high and (-inf < low or high < inf) and joint.mimic is None
        ]
        self._indices = [body.joints[name] for name, _, _ in self.ranges]

    def apply(self) -> None:
        """Check the joints at the start of a step."""
        states = p.getJointStates(self._body.number, self._indices, self._client)
        for (name, low, high), (position, *_) in zip(self.ranges, states, strict=True):
            if not low - STOP_REACH <= position <= high + STOP_REACH:
                self._body.set_joint(name, low if position < low else high, 0.0)


# Damping


NEGLIGIBLE_SHARE = 0.005
"""The x up to which PyBullet damps a joint itself; the way in which it comes to rest is off by this share."""
SMALL_INERTIA = 1e-16  # kg m^2 or kg; keeps a mass matrix invertible, and is below that of any link


class Damping:
    """Damps the joints of one robot.

    `update` begins a control step, and `apply` a physics step. The first control step of an episode decides
    whether PyBullet damps the joints itself.
    """

    def __init__(
        self, client: int, body: Body, step: float, springs: Mapping[tuple[int, tuple[int, ...]], Springs]
    ) -> None:
        self._client = client
        self._body = body
        self._step = step
        self._indices = tuple(sorted(body.brakes))
        damping = {body.joints[joint.name]: joint.damping for joint in body.model.moving_joints}
        self._nominal = np.array([damping[index] for index in self._indices])
        self._damping = self._nominal.copy()
        self._states: Any = ()
        self._read_torques = torques(lambda: self._states, body.number, self._indices, springs)
        self._exert = exert_torques(client, body.number, self._indices)
        self._is_decided = False
        self._is_implicit = False
        count = len(self._indices)
        self._gains: FloatArray = np.zeros((count, 2 * count))
        """The matrices D (M + h D)^-1 M and D (M + h D)^-1 h, side by side."""
        self._constant: FloatArray = np.zeros(count)
        """The torques D (M + h D)^-1 h f of gravity and inertia."""
        self._mass_matrix([0.0] * count)  # PyBullet keeps the masses of the first call

    def reset(self) -> None:
        """Restore the damping of the file."""
        self._damping[:] = self._nominal
        self._is_decided = False

    def set(self, index: int, damping: float) -> None:
        """Set the damping (N m s/rad or N s/m) of a joint."""
        self._damping[self._indices.index(index)] = damping
        self._is_decided = False

    def update(self) -> None:
        if self._is_decided and not self._is_implicit:
            return
        states = p.getJointStates(self._body.number, self._indices, self._client)
        positions = [state[0] for state in states]
        masses = self._mass_matrix(positions)
        if not self._is_decided:
            # The articulated inertia of a joint, with all others free, is 1 / (M^-1)_ii.
            scales = self._step * np.diag(np.linalg.inv(masses))
            self._decide(bool(np.any(scales * self._damping > NEGLIGIBLE_SHARE)))
        count = len(positions)
        damped = masses.copy()
        damped.ravel()[:: count + 1] += self._step * self._damping
        solution = self._damping[:, None] * np.linalg.inv(damped)
        np.matmul(solution, masses, out=self._gains[:, :count])
        np.multiply(solution, self._step, out=self._gains[:, count:])
        if self._body.fixed:
            loads = self._loads(positions, [state[1] for state in states])
            self._constant = self._gains[:, count:] @ loads

    def _decide(self, is_implicit: bool) -> None:
        self._is_decided = True
        self._is_implicit = is_implicit
        for index, damping in zip(self._indices, self._damping.tolist(), strict=True):
            p.changeDynamics(
                self._body.number,
                index,
                jointDamping=0.0 if is_implicit else damping,
                physicsClientId=self._client,
            )

    def _mass_matrix(self, positions: list[float]) -> FloatArray:
        """Return the mass matrix of the joints, while a free base follows them."""
        number, client = self._body.number, self._client
        masses = np.array(p.calculateMassMatrix(number, positions, physicsClientId=client))
        if not self._body.fixed:
            coupling = masses[6:, :6]
            masses = masses[6:, 6:] - coupling @ np.linalg.solve(masses[:6, :6], coupling.T)
        masses *= self._body.least_inertia_factor
        masses.ravel()[:: len(masses) + 1] += SMALL_INERTIA
        return masses

    def _loads(self, positions: list[float], velocities: list[float]) -> FloatArray:
        """Return the torques of gravity and inertia on the joints of a fixed robot. PyBullet computes them in
        the frame of the base."""
        number, client = self._body.number, self._client
        settings = p.getPhysicsEngineParameters(client)
        x, y, z = (settings[f"gravityAcceleration{axis}"] for axis in "XYZ")
        rotation = p.getBasePositionAndOrientation(number, client)[1]
        p.setGravity(*frames.rotate_back(rotation, (x, y, z)), client)
        loads = p.calculateInverseDynamics(
            number, positions, velocities, [0.0] * len(positions), physicsClientId=client
        )
        p.setGravity(x, y, z, client)
        return -self._body.least_inertia_factor * np.array(loads)

    def apply(self) -> None:
        if self._is_implicit:
            self._states = p.getJointStates(self._body.number, self._indices, self._client)
            inputs = [*(state[1] for state in self._states), *self._read_torques()]
            self._exert((-(self._gains @ inputs) - self._constant).tolist())
