"""Motors and springs on joints, and forces on links; of one world, and of a batch as columns."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from deepbots_cli import frames
from deepbots_cli.engines.mujoco import mujoco as mj
from deepbots_cli.engines.mujoco import sliding
from deepbots_cli.engines.mujoco.model import finite_limit
from deepbots_cli.port import SERVO_TIME, ZERO_VECTOR

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from deepbots_cli.engines.mechanics import TorqueCurve
    from deepbots_cli.engines.mujoco.state import BatchState, MujocoWorld
    from deepbots_cli.frames import Triple
    from deepbots_cli.port import MotorWriter, Pusher, TorqueReader, WrenchReader

    Column = NDArray[Any]


MAX_GAIN = 10_000.0
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
        self.gain_updates: dict[Motor, Callable[[], object]] = {}
        """The functions to call before each engine step, for motors whose limits keep them from their
        targets."""
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

    def restore(self, of_joint: dict[int, Motor], renewed: dict[Motor, Callable[[], object]]) -> None:
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
        the inertia that velocity motors add, which a limit that stops the joint drives beyond theirs."""
        world = self.world
        model = self.world.model
        joints = list(joints)
        dofs = model.jnt_dofadr[joints]
        exerted, armature, usual, accelerations = (
            array_reader(array, dofs)
            for array in (world.data.qfrc_actuator, model.dof_armature, world.armature, world.data.qacc)
        )
        ranges = model.jnt_actfrcrange

        def read() -> list[float]:
            torques = exerted()
            if armature() != usual():
                lows, highs = ranges[joints].T
                added = np.subtract(armature(), usual())
                torques = np.minimum(np.maximum(torques - added * accelerations(), lows), highs).tolist()
            return torques

        return read


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
        sliding.advance(model, data)
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
        self._numbers = [motors.actuators[joint] for joint in joints]
        self._actuators = array_index(self._numbers)
        self._dof_index = array_index(model.jnt_dofadr[list(joints)].tolist())
        self._position_index = array_index(model.jnt_qposadr[list(joints)].tolist())
        self._joint_index = array_index(self.joints)

    def _activate(self, *, soft: bool) -> None:
        """Drive the joints; `soft` limits are limits of the joint, beyond which the damping still acts on the
        inertia."""
        world, model = self._world, self._world.model
        if world.is_stale:
            world.update_constants()  # with the armature of the joints, before motors add to it
        ranges = [(-limit, limit) for limit in self._limits]
        model.actuator_biasprm[self._actuators] = 0.0
        model.dof_armature[self._dof_index] = world.armature[self._dof_index]
        model.dof_invweight0[self._dof_index] = world.inverse_inertia[self._dof_index]
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
        # A number is written through a memoryview in 0.04 us, a list into a slice of an array in 0.6 us.
        ctrl: Any = memoryview(self._world.data.ctrl)
        limits = list(zip(self._numbers, self._limits, strict=True))

        def write(targets: Sequence[float]) -> None:
            if not self.is_active:
                self._activate(soft=False)
                self._activate_curve(curve)
            for target, (actuator, limit) in zip(targets, limits, strict=True):
                ctrl[actuator] = min(max(target, -limit), limit)

        return write

    def spring_writer(
        self,
        stiffness: Sequence[float],
        damping: Sequence[float] | None,
        curve: TorqueCurve | None = None,
    ) -> MotorWriter:
        """Return a writer of targets of a spring, whose torque is `stiffness * (target - position) - damping
        * velocity`."""
        ctrl: Any = memoryview(self._world.data.ctrl)
        actuators = self._actuators
        bias = self._world.model.actuator_biasprm
        stiffness, damping = list(stiffness), list(damping or [0.0] * len(stiffness))
        springs = list(zip(self._numbers, stiffness, strict=True))

        def write(targets: Sequence[float]) -> None:
            if not self.is_active:
                self._activate(soft=False)
                self._activate_curve(curve)
                bias[actuators, 1], bias[actuators, 2] = [-k for k in stiffness], [-d for d in damping]
            for target, (actuator, k) in zip(targets, springs, strict=True):
                ctrl[actuator] = k * target

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
        moved: list[float] = []
        lows, highs = (ends.tolist() for ends in servo_range(model, self._joint_index))
        inertias = model.dof_M0[self._dof_index].tolist()
        stiff = [MAX_GAIN * inertia / step for inertia in inertias]
        bounds = [
            (most, limit, limit / most, 4.0 * inertia * rate if rate else inertia / step)
            for most, limit, inertia in zip(stiff, self._limits, inertias, strict=True)
        ]
        factor = rate or 1.0
        ctrl: Any = memoryview(data.ctrl)
        bias: Any = memoryview(model.actuator_biasprm.reshape(-1))
        armature: Any = memoryview(model.dof_armature)
        # MuJoCo scales the stiffness of joint limits by these.
        inverses: Any = memoryview(model.dof_invweight0)
        width = model.actuator_biasprm.shape[1]
        actuators = self._numbers
        dofs = model.jnt_dofadr[list(self.joints)].tolist()
        addresses = [width * actuator for actuator in actuators]
        by_joint = list(zip(addresses, dofs, strict=True))

        def aim(targets: Sequence[float]) -> bool:
            """Renew gains; return whether a gain must be renewed in each engine step."""
            target_velocities = targets
            if rate:
                targets = list(map(max, lows, map(min, highs, targets)))
                pairs = zip(targets, position(), strict=True)
                target_velocities = [(target - now) * rate for target, now in pairs]
            gains, waits = velocity_gains(target_velocities, velocity(), bounds)
            targets = tuple(targets)
            if gains == self.gains and targets == self.targets:
                return waits
            if gains != self.gains:
                if not self.gains:  # the motor begins, perhaps in an episode with other masses
                    usual[:] = self._world.armature[self._dof_index].tolist()
                    moved[:] = (1.0 / self._world.inverse_inertia[self._dof_index]).tolist()
                self.gains = gains
                for gain, base, inertia, (address, dof) in zip(gains, usual, moved, by_joint, strict=True):
                    added = gain * step
                    bias[address + 2] = -gain
                    armature[dof] = base + added
                    inverses[dof] = 1.0 / (inertia + added)
                    if rate:
                        bias[address + 1] = -gain * rate
            self.targets = targets
            for gain, target, act in zip(gains, targets, actuators, strict=True):
                ctrl[act] = gain * factor * target
            return waits

        def write(targets: Sequence[float]) -> None:
            if not self.is_active:
                self._activate(soft=True)
                self.gains = []
            if aim(targets):
                renewed[self] = partial(aim, tuple(targets))
            else:
                renewed.pop(self, None)

        return write


def servo_range(model: Any, joints: Any) -> Any:
    """Return the lowest and the highest target of servos: the limits of the joints, as in PyBullet."""
    limited = model.jnt_limited[joints].astype(bool)
    lows, highs = model.jnt_range[joints].T
    return np.where(limited, lows, -np.inf), np.where(limited, highs, np.inf)


def servo_rate(model: Any) -> float:
    """Return the share of its error that a servo removes per s."""
    return 1.0 / max(SERVO_TIME, model.opt.timestep)  # type: ignore[no-any-return]


def velocity_gains(
    targets: Sequence[float],
    velocities: Sequence[float],
    bounds: Sequence[tuple[float, float, float, float]],
) -> tuple[list[float], bool]:
    """Return the gains of a velocity motor, and whether they must be renewed in each engine step.

    `bounds` are the largest gain, the limit, the error at which this gain exerts the limit, and the gain below
    which gains are renewed.
    """
    gains = []
    waits = False
    for target, now, (stiffest, limit, error_at_limit, least) in zip(
        targets, velocities, bounds, strict=True
    ):
        off = abs(target - now)
        smallest = MIN_ERROR_SHARE * abs(target)
        if smallest > off:
            off = smallest
        gain = limit / off if off > error_at_limit else stiffest
        gains.append(gain)
        if gain < least:
            waits = True
    return gains, waits


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
    view: Any = memoryview(array)
    places = index.tolist()
    return lambda: [view[place] for place in places]


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


MOTOR_FIELDS = (
    *("actuator_biasprm", "actuator_forcelimited", "actuator_forcerange"),
    *("dof_armature", "dof_invweight0", "jnt_actfrclimited", "jnt_actfrcrange"),
)
"""The arrays of a model that motors write."""


def cells(worlds: Any, columns: Any) -> tuple[Any, Any]:
    """Return the index of these places in the rows of these worlds, each a slice or an array."""
    return (
        (worlds, columns)
        if isinstance(worlds, slice) or isinstance(columns, slice)
        # numpy would pair two arrays of indices element by element.
        else (worlds[:, None], columns)
    )


class Pushes:
    """One push per world for the next substep: the pushes that the members bound at the same position in
    their order; see `motors.pusher`."""

    def __init__(self, count: int, frame: Literal["world", "link"]) -> None:
        self.waits = np.zeros(count, bool)
        self.links = np.zeros(count, int)
        self._values = np.zeros((count, 6))
        self._frame = frame

    def begin(self, worlds: Sequence[int]) -> None:
        self.waits[worlds] = False
        self._values[worlds] = 0.0

    def give(self, world: int, link: int, force: Triple, torque: Triple) -> None:
        self.waits[world] = True
        self.links[world] = link
        self._values[world] += (*force, *torque)

    def take(self, worlds: Column, turned: Column, center: Column) -> Column:
        """Return force and torque at the center of mass in the axes of the world, a row per world."""
        values = self._values[worlds].T
        turn = tuple(turned)
        self.waits[worlds] = False
        self._values[worlds] = 0.0
        force, torque = tuple(values[:3]), tuple(values[3:])
        if self._frame == "link":
            force, torque = frames.rotate(turn, force), frames.rotate(turn, torque)
        if center.any():
            torque = frames.add(torque, frames.cross(force, frames.rotate(turn, tuple(center))))
        return np.array((*force, *torque)).T


class BatchMotor:
    """A motor on the same joints of all worlds, which exerts torques, or pulls as a spring where it has
    gains; see `motors.Motor`."""

    is_soft = False

    def __init__(self, batch: BatchState, joints: Sequence[int]) -> None:
        self._batch = batch
        self._model = batch.nominal
        self.joints = tuple(joints)
        count = batch.count
        self.rivals: list[BatchMotor] = []
        """The motors that drive some of the same joints."""
        self.waits = np.zeros(count, bool)
        """The worlds in which gains are renewed in each substep."""
        self._given, self._targets, self._limits, self._stiffness, self._damping = (
            np.zeros((count, len(joints))) for _ in range(5)
        )
        self._is_spring = False
        self._is_active, self._is_given = np.zeros(count, bool), np.zeros(count, bool)
        """The worlds whose joints it drives, and those whose members have commanded it since."""
        self._actuators = array_index([batch.actuators[joint] for joint in joints])
        self._dofs = array_index(self._model.jnt_dofadr[list(joints)].tolist())
        self._joint_index = array_index(self.joints)

    def bind(
        self,
        worlds: slice,
        limits: Sequence[float],
        stiffness: Sequence[float] | None,
        damping: Sequence[float] | None,
    ) -> None:
        """Set the limits and gains of some worlds, which are in force from the next command."""
        self._limits[worlds] = [finite_limit(limit) for limit in limits]
        self._is_spring = stiffness is not None
        self._stiffness[worlds], self._damping[worlds] = stiffness or 0.0, damping or 0.0
        self._is_active[worlds] = False

    def writer(self, world: int) -> MotorWriter:
        """Return the motor of one world; commands are carried out before the world goes on."""

        def write(targets: Sequence[float]) -> None:
            if self.rivals and any(rival._is_given[world] for rival in self.rivals):
                self._batch.take_commands()
            self._given[world] = targets
            self._is_given[world] = self._batch.has_commands = True

        return write

    def __call__(self, targets: Any) -> None:
        """Command all worlds, or those of the batch's `write_mask`, with a column per joint."""
        rows = np.empty(self._targets.shape)
        for number, target in enumerate(targets):
            rows[:, number] = target
        mask = self._batch.write_mask
        worlds: Any = slice(None) if mask is None else np.flatnonzero(mask)
        self.write(rows[worlds], worlds)

    def command(self) -> None:
        """Carry out the commands of members."""
        if self._is_given.any():
            worlds = np.flatnonzero(self._is_given)
            self._is_given[:] = False
            self.write(self._given[worlds], worlds)

    def write(self, targets: Column, worlds: Any) -> None:
        """Write targets with a row per world of these."""
        if not self._is_active[worlds].all():
            self._activate(np.arange(len(self._is_active))[worlds][~self._is_active[worlds]])
        self._exert(targets, worlds)

    def _exert(self, targets: Column, worlds: Any) -> None:
        limits = self._limits[worlds]
        forces = (
            self._stiffness[worlds] * targets
            if self._is_spring
            # Takes a third of the time of `np.clip` on 8 x 12 values.
            else np.minimum(np.maximum(targets, -limits), limits)
        )
        self._batch.ctrl[cells(worlds, self._actuators)] = forces

    def _activate(self, worlds: Column) -> None:
        """Drive the joints in these worlds; see `motors.Motor`."""
        self._batch.update_constants(worlds)
        rows = self._batch.rows
        limits = self._limits[worlds]
        joints = cells(worlds, self._joint_index)
        actuators, dofs = cells(worlds, self._actuators), cells(worlds, self._dofs)
        bias = rows["actuator_biasprm"]
        bias[actuators] = 0.0
        if self._is_spring:
            bias[..., 1][actuators] = -self._stiffness[worlds]
            bias[..., 2][actuators] = -self._damping[worlds]
        rows["dof_armature"][dofs] = self._batch.armature[dofs]
        rows["dof_invweight0"][dofs] = self._batch.inverse_inertia[dofs]
        rows["actuator_forcelimited"][actuators] = not self.is_soft
        rows["jnt_actfrclimited"][joints] = self.is_soft
        rows["actuator_forcerange"][actuators] = rows["jnt_actfrcrange"][joints] = np.stack(
            [-limits, limits], axis=-1
        )
        for rival in self.rivals:
            rival._is_active[worlds] = rival.waits[worlds] = False
        self._is_active[worlds] = True

    def renew(self, goes: Column) -> None:
        """Renew gains in those worlds that go on, before a substep."""

    def begin(self, worlds: Sequence[int]) -> None:
        """Begin an episode in some worlds."""
        self._is_active[worlds] = self._is_given[worlds] = self.waits[worlds] = False


class CurvedMotor(BatchMotor):
    """A motor whose largest torque falls with its speed; see `TorqueCurve.bounds`, which computes the same
    for one world."""

    def __init__(self, batch: BatchState, joints: Sequence[int]) -> None:
        super().__init__(batch, joints)
        self._stall = np.zeros(self._targets.shape)
        self._fastest = np.ones(self._targets.shape)

    def bind_curve(self, worlds: slice, curve: TorqueCurve) -> None:
        """Set the curve of some worlds."""
        self._stall[worlds], self._fastest[worlds] = curve

    def _activate(self, worlds: Column) -> None:
        super()._activate(worlds)
        self.waits[worlds] = True

    def renew(self, goes: Column) -> None:
        worlds = np.flatnonzero(self.waits & goes)
        if not len(worlds):
            return
        stall = self._stall[worlds]
        limits = self._limits[worlds]
        share = self._batch.qvel[cells(worlds, self._dofs)] / self._fastest[worlds]
        low, high = (
            np.minimum(np.maximum(end, 0.0), limits) for end in (stall * (1.0 + share), stall * (1.0 - share))
        )
        self._batch.rows["actuator_forcerange"][cells(worlds, self._actuators)] = np.stack(
            [-low, high], axis=-1
        )


class TrackingMotor(BatchMotor):
    """A velocity motor, or a servo with a `rate` (1/s); see `motors.Motor.tracking_writer`, which computes
    the same for one world."""

    is_soft = True

    def __init__(self, batch: BatchState, joints: Sequence[int], rate: float) -> None:
        super().__init__(batch, joints)
        model = self._model
        self._rate = rate
        self._step = self._model.opt.timestep
        self._lows, self._highs = servo_range(model, self._joint_index)
        self._position_columns = array_index(model.jnt_qposadr[list(joints)].tolist())
        inertias = model.dof_M0[self._dofs]
        self._stiffest = MAX_GAIN * inertias / self._step
        self._least = 4.0 * inertias * rate if rate else inertias / self._step
        self._gains = np.full(self._targets.shape, np.nan)  # unequal to any gain, so the first are written
        self._near = np.zeros(self._targets.shape)
        """The errors up to which a motor has its largest gain."""

    def _activate(self, worlds: Column) -> None:
        super()._activate(worlds)
        self._gains[worlds] = np.nan
        self._near[worlds] = self._limits[worlds] / self._stiffest

    def _exert(self, targets: Column, worlds: Any) -> None:
        if self._rate:
            targets = np.minimum(np.maximum(targets, self._lows), self._highs)
        self._targets[worlds] = targets
        self.waits[worlds] = (self._aim(worlds) < self._least).any(axis=1)

    def renew(self, goes: Column) -> None:
        waits = self.waits & goes
        if waits.all():
            self._aim(slice(None))
        elif waits.any():
            self._aim(np.flatnonzero(waits))

    def _aim(self, worlds: Any) -> Column:
        """Return the gains, which are renewed."""
        batch = self._batch
        targets = self._targets[worlds]
        limits = self._limits[worlds]
        target_velocities = (
            (targets - batch.qpos[cells(worlds, self._position_columns)]) * self._rate
            if self._rate
            else targets
        )
        dofs, actuators = cells(worlds, self._dofs), cells(worlds, self._actuators)
        off = np.maximum(
            np.abs(target_velocities - batch.qvel[dofs]), MIN_ERROR_SHARE * np.abs(target_velocities)
        )
        gains = np.empty(off.shape)
        gains[:] = self._stiffest
        np.divide(limits, off, out=gains, where=off > self._near[worlds])
        batch.ctrl[actuators] = gains * self._rate * targets if self._rate else gains * targets
        aimed = gains
        renewed = (gains != self._gains[worlds]).any(axis=1)
        if not renewed.all():
            if not renewed.any():
                return aimed
            worlds = np.arange(batch.count)[worlds][renewed]
            gains = gains[renewed]
            dofs, actuators = cells(worlds, self._dofs), cells(worlds, self._actuators)
        added = gains * self._step
        bias = batch.rows["actuator_biasprm"]
        self._gains[worlds] = gains
        bias[..., 2][actuators] = -gains
        if self._rate:
            bias[..., 1][actuators] = -gains * self._rate
        batch.rows["dof_armature"][dofs] = batch.armature[dofs] + added
        batch.rows["dof_invweight0"][dofs] = 1.0 / (1.0 / batch.inverse_inertia[dofs] + added)
        return aimed
