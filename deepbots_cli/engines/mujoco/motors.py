"""Motors and springs on joints, and forces on links."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from deepbots_cli import frames
from deepbots_cli.engines.mujoco import mujoco as mj
from deepbots_cli.engines.mujoco.model import finite_limit
from deepbots_cli.port import SERVO_TIME, ZERO_VECTOR

if TYPE_CHECKING:
    from deepbots_cli.engines.curves import TorqueCurve
    from deepbots_cli.engines.mujoco.state import MujocoWorld
    from deepbots_cli.frames import Triple
    from deepbots_cli.port import MotorWriter, Pusher, TorqueReader, WrenchReader

MAX_GAIN = 1000.0
"""Largest gain of a velocity motor, in inertias of its joint per engine step."""
MIN_ERROR_SHARE = 0.1
"""Share of its target by which a velocity motor must be off to exert its limit."""


class Motors:
    """The joints of a world: each has one actuator, which obeys the motor that was written last.

    The torque of an actuator is `ctrl - stiffness * position - damping * velocity`, limited.
    """

    def __init__(self, world: MujocoWorld) -> None:
        self.world = world
        self._motor_of_joint: dict[int, Motor] = {}
        self.gain_updates: dict[Motor, Callable[[], None]] = {}
        """The functions to call before each engine step, for motors whose limits keep them from their
        targets."""
        self.nominal_inverse_inertia = world.model.dof_invweight0.copy()
        self.actuators = {
            joint: actuator for actuator, joint in enumerate(world.model.actuator_trnid[:, 0].tolist())
        }
        world.state_accessors.append(
            (
                lambda: (dict(self._motor_of_joint), dict(self.gain_updates)),
                lambda memory: self.restore(*memory),
            )
        )

    def activate(self, motor: Motor) -> None:
        """Let a motor drive its joints."""
        for joint in motor.joints:
            before = self._motor_of_joint.get(joint)
            if before is not None:
                before.is_active = False
                self.gain_updates.pop(before, None)
            self._motor_of_joint[joint] = motor
        motor.is_active = True

    def restore(self, of_joint: dict[int, Motor], renewed: dict[Motor, Callable[[], None]]) -> None:
        """Let these motors drive joints, and no others."""
        for motor in self._motor_of_joint.values():
            motor.is_active = False
        self._motor_of_joint = dict(of_joint)
        self.gain_updates.clear()
        self.gain_updates.update(renewed)
        for motor in of_joint.values():
            motor.is_active = all(of_joint.get(joint) is motor for joint in motor.joints)
            # The caller restores the arrays of the model too, so the next command writes its gains again.
            motor.gains = []

    def torques(self, joints: Sequence[int]) -> TorqueReader:
        """Return a reader of the torques of motors in the last engine step: without the part that went into
        the inertia that velocity motors add."""
        world = self.world
        model = self.world.model
        dofs = model.jnt_dofadr[list(joints)]
        exerted = world.data.qfrc_actuator
        armature = model.dof_armature
        accelerations = world.data.qacc
        usual = world.armature
        return lambda: (exerted[dofs] - (armature[dofs] - usual[dofs]) * accelerations[dofs]).tolist()


class WrenchMonitor:
    """Computes the wrenches in joints in every engine step, for all of their readers in a world."""

    def __init__(self, world: MujocoWorld) -> None:
        self._world = world
        self._links: list[int] = []
        self._wrenches: list[tuple[Triple, Triple]] = []
        world.state_accessors.append((lambda: list(self._wrenches), self._restore))

    def reset(self) -> None:
        self._wrenches[:] = [(ZERO_VECTOR, ZERO_VECTOR)] * len(self._links)

    def _restore(self, wrenches: list[tuple[Triple, Triple]]) -> None:
        self._wrenches[: len(wrenches)] = wrenches

    def step(self, model: Any, data: Any) -> None:
        """Advance by one engine step, and compute its wrenches: with the velocities at its start, to which
        the positions and accelerations of MuJoCo belong."""
        before = data.qvel.copy()
        mj.mj_step(model, data)
        after = data.qvel.copy()
        data.qvel[:] = before
        # `mj_step` computes `cfrc_int` only if the model has sensors that need it.
        mj.mj_rnePostConstraint(model, data)
        data.qvel[:] = after
        for index, link in enumerate(self._links):
            tx, ty, tz, fx, fy, fz = data.cfrc_int[link].tolist()  # at the center of mass of the tree
            arm = (data.subtree_com[model.body_rootid[link]] - data.xpos[link]).tolist()
            w, x, y, z = data.xquat[link].tolist()
            force, rotation = (fx, fy, fz), (x, y, z, w)
            torque = frames.add((tx, ty, tz), frames.cross(arm, force))
            self._wrenches[index] = frames.rotate_back(rotation, force), frames.rotate_back(rotation, torque)

    def reader(self, link: int) -> WrenchReader:
        index = len(self._links)
        wrenches = self._wrenches
        self._links.append(link)
        wrenches.append((ZERO_VECTOR, ZERO_VECTOR))
        return lambda: wrenches[index]


class Motor:
    """A motor on some joints; `is_active` is true if it drives them.

    `gains` and `targets` are those of a velocity motor that the model has; no gains if it has others.
    """

    def __init__(self, motors: Motors, joints: Sequence[int], max_torque: Sequence[float]) -> None:
        world = motors.world
        model = world.model
        self.joints = tuple(joints)
        self.is_active = False
        self.gains: list[float] = []
        self.targets: tuple[float, ...] = ()
        self._motors = motors
        self._world = world
        self._limits = [finite_limit(limit) for limit in max_torque]
        self._actuators = array_index([motors.actuators[joint] for joint in joints])
        self._dof_index = array_index(model.jnt_dofadr[list(joints)].tolist())
        self._position_index = array_index(model.jnt_qposadr[list(joints)].tolist())
        self._joint_index = array_index(self.joints)

    def _activate(self, *, soft: bool) -> None:
        """Drive the joints; `soft` limits are limits of the joint, beyond which the damping still acts on the
        inertia."""
        model = self._world.model
        ranges = [(-limit, limit) for limit in self._limits]
        model.actuator_biasprm[self._actuators] = 0.0
        model.dof_armature[self._dof_index] = self._world.armature[self._dof_index]
        model.dof_invweight0[self._dof_index] = self._motors.nominal_inverse_inertia[self._dof_index]
        model.actuator_forcelimited[self._actuators] = not soft
        model.actuator_forcerange[self._actuators] = ranges
        model.jnt_actfrclimited[self._joint_index] = soft
        model.jnt_actfrcrange[self._joint_index] = ranges
        self._motors.activate(self)

    def _activate_curve(self, curve: TorqueCurve | None) -> None:
        """Bound the torques by the speed before each engine step, if there is a curve."""
        if curve is None:
            return
        ranges = self._world.model.actuator_forcerange
        actuators = self._actuators
        limits = self._limits
        velocity = array_reader(self._world.data.qvel, self._dof_index)

        def renew() -> None:
            ranges[actuators] = curve.bounds(velocity(), limits)

        self._motors.gain_updates[self] = renew

    def torque_writer(self, curve: TorqueCurve | None = None) -> MotorWriter:
        ctrl = self._world.data.ctrl
        actuators = self._actuators
        limits = self._limits

        def write(targets: Sequence[float]) -> None:
            if not self.is_active:
                self._activate(soft=False)
                self._activate_curve(curve)
            ctrl[actuators] = [
                min(max(target, -limit), limit) for target, limit in zip(targets, limits, strict=True)
            ]

        return write

    def spring_writer(
        self,
        stiffness: Sequence[float],
        damping: Sequence[float] | None,
        curve: TorqueCurve | None = None,
    ) -> MotorWriter:
        """Return a writer of targets of a spring, whose torque is `stiffness * (target - position) - damping
        * velocity`."""
        ctrl = self._world.data.ctrl
        actuators = self._actuators
        bias = self._world.model.actuator_biasprm
        stiffness, damping = list(stiffness), list(damping or [0.0] * len(stiffness))

        def write(targets: Sequence[float]) -> None:
            if not self.is_active:
                self._activate(soft=False)
                self._activate_curve(curve)
                bias[actuators, 1], bias[actuators, 2] = [-k for k in stiffness], [-d for d in damping]
            ctrl[actuators] = [k * target for k, target in zip(stiffness, targets, strict=True)]

        return write

    def tracking_writer(self, rate: float = 0.0) -> MotorWriter:
        """Return a writer of targets of a velocity motor, or with a `rate` (1/s) of a servo: the target
        velocity is then the error times the rate.

        The torque is `gain * (target - velocity)` with the velocity at the end of each engine step. That is
        the torque by the velocity at its beginning, and `gain * step` more inertia: the motor is stable
        however light its joint is, and the solver of contacts takes it into account. A gain is such that the
        limit is exerted at the present error, or, close to the target, at a tenth of the target; then the
        motor does not overshoot. It is renewed in each engine step while the joint needs several of them to
        reach the target: else the torque would fall below the limit as the joint speeds up, and a servo would
        swing.
        """
        data, model = self._world.data, self._world.model
        step = model.opt.timestep
        renewed = self._motors.gain_updates
        velocity = array_reader(data.qvel, self._dof_index)
        position = array_reader(data.qpos, self._position_index)
        usual: list[float] = []
        inertias = model.dof_M0[self._dof_index].tolist()
        moved = [1.0 / inverse for inverse in self._motors.nominal_inverse_inertia[self._dof_index].tolist()]
        stiff = [MAX_GAIN * inertia / step for inertia in inertias]
        # The third bound is the error at which the largest gain exerts the limit.
        bounds = [(most, limit, limit / most) for most, limit in zip(stiff, self._limits, strict=True)]
        # Gains below these are renewed in each engine step.
        least = [4.0 * inertia * rate if rate else inertia / step for inertia in inertias]
        # A number is written through a memoryview in 0.04 us, a list into a slice of an array in 0.6 us.
        ctrl: Any = memoryview(data.ctrl)
        bias: Any = memoryview(model.actuator_biasprm.reshape(-1))
        armature: Any = memoryview(model.dof_armature)
        # MuJoCo scales the stiffness of joint limits by these.
        inverses: Any = memoryview(model.dof_invweight0)
        width = model.actuator_biasprm.shape[1]
        actuators = [self._motors.actuators[joint] for joint in self.joints]
        dofs = model.jnt_dofadr[list(self.joints)].tolist()
        addresses = [width * actuator for actuator in actuators]
        by_joint = list(zip(actuators, addresses, dofs, moved, strict=True))

        def aim(targets: Sequence[float]) -> None:
            target_velocities = targets
            if rate:
                pairs = zip(targets, position(), strict=True)
                target_velocities = [(target - now) * rate for target, now in pairs]
            gains = velocity_gains(target_velocities, velocity(), bounds)
            targets = tuple(targets)
            if gains == self.gains and targets == self.targets:
                return
            if gains != self.gains:
                if not self.gains:  # the motor begins, perhaps in an episode with another armature
                    usual[:] = self._world.armature[self._dof_index].tolist()
                self.gains = gains
                for gain, base, (_, address, dof, inertia) in zip(gains, usual, by_joint, strict=True):
                    added = gain * step
                    bias[address + 2] = -gain
                    armature[dof] = base + added
                    inverses[dof] = 1.0 / (inertia + added)
                    if rate:
                        bias[address + 1] = -gain * rate
            self.targets = targets
            for gain, target, (act, *_) in zip(gains, targets, by_joint, strict=True):
                ctrl[act] = gain * (rate or 1.0) * target

        def write(targets: Sequence[float]) -> None:
            if not self.is_active:
                self._activate(soft=True)
                self.gains = []
            aim(targets)
            if any(gain < bound for gain, bound in zip(self.gains, least, strict=True)):
                renewed[self] = partial(aim, tuple(targets))
            else:
                renewed.pop(self, None)

        return write


def servo_rate(model: Any) -> float:
    """Return the share of its error that a servo removes per s."""
    return 1.0 / max(SERVO_TIME, model.opt.timestep)  # type: ignore[no-any-return]


def velocity_gains(
    targets: Sequence[float], velocities: Sequence[float], bounds: Sequence[tuple[float, float, float]]
) -> list[float]:
    """Return the gains of a velocity motor; `bounds` are the largest gain, the limit, and the error at which
    this gain exerts the limit."""
    gains = []
    for target, now, (stiffest, limit, error_at_limit) in zip(targets, velocities, bounds, strict=True):
        off = abs(target - now)
        least = MIN_ERROR_SHARE * abs(target)
        if least > off:
            off = least
        gains.append(limit / off if off > error_at_limit else stiffest)
    return gains


def array_index(numbers: Sequence[int]) -> Any:
    """Return an index of these places: a slice where they follow each other, which numpy reads in half the
    time."""
    first = numbers[0]
    count = len(numbers)
    return (
        slice(first, first + count)
        if list(numbers) == list(range(first, first + count))
        else np.array(numbers)
    )


def array_reader(array: Any, numbers: Any) -> Callable[[], list[float]]:
    """Return a reader of these places of an array of the state: through a view if they follow each other,
    which saves making a copy."""
    index = numbers if isinstance(numbers, slice) else array_index(list(numbers))
    if isinstance(index, slice):
        return array[index].tolist  # type: ignore[no-any-return]
    return lambda: array[index].tolist()


def pusher(world: MujocoWorld, link: int, frame: Literal["world", "link"]) -> Pusher:
    """Return a function that pushes a link; MuJoCo's forces act at the center of mass, in the axes of the
    world."""
    model, data = world.model, world.data
    applied = data.xfrc_applied[link]
    rotation = data.xquat[link]
    varies = link in world.varying_centers
    position = model.body_ipos[link]
    center = tuple(position.tolist())
    centered = center == ZERO_VECTOR and not varies

    def push(force: Triple, torque: Triple) -> None:
        nonlocal center
        if varies:
            center = tuple(position.tolist())
        if frame == "link" or not centered:
            world.update_positions()
            w, x, y, z = rotation.tolist()
            if frame == "link":
                force, torque = frames.rotate((x, y, z, w), force), frames.rotate((x, y, z, w), torque)
            if not centered:
                torque = frames.add(torque, frames.cross(force, frames.rotate((x, y, z, w), center)))
        applied[:3] += force
        applied[3:] += torque
        world.has_pushes = True

    return push
