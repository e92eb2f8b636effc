"""The motors of a batch, and the pushes of its members: commands and forces of all worlds as columns."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from deepbots_cli import frames
from deepbots_cli.engines.mujoco import motors
from deepbots_cli.engines.mujoco.model import finite_limit

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from deepbots_cli.engines.curves import TorqueCurve
    from deepbots_cli.engines.mujoco.batch import MuJoCoBatch
    from deepbots_cli.frames import Triple
    from deepbots_cli.port import MotorWriter

    Column = NDArray[Any]

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

    def begin(self, world: int) -> None:
        self.waits[world] = False
        self._values[world] = 0.0

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

    def __init__(self, batch: MuJoCoBatch, joints: Sequence[int]) -> None:
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
        self._actuators = motors.array_index([batch.single.motors.actuators[joint] for joint in joints])
        self._dofs = motors.array_index(self._model.jnt_dofadr[list(joints)].tolist())
        self._joint_index = motors.array_index(self.joints)

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
            if any(rival._is_given[world] for rival in self.rivals):
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
        rows = self._batch.rows
        limits = self._limits[worlds]
        joints = cells(worlds, self._joint_index)
        actuators, dofs = cells(worlds, self._actuators), cells(worlds, self._dofs)
        bias = rows["actuator_biasprm"]
        bias[actuators] = 0.0
        if self._is_spring:
            bias[..., 1][actuators] = -self._stiffness[worlds]
            bias[..., 2][actuators] = -self._damping[worlds]
        rows["dof_armature"][dofs] = self._batch.usual_armature(worlds, self._dofs)
        rows["dof_invweight0"][dofs] = self._model.dof_invweight0[self._dofs]
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

    def begin(self, world: int) -> None:
        """Begin an episode in a world."""
        self._is_active[world] = self._is_given[world] = self.waits[world] = False


class CurvedMotor(BatchMotor):
    """A motor whose largest torque falls with its speed; see `TorqueCurve.bounds`, which computes the same
    for one world."""

    def __init__(self, batch: MuJoCoBatch, joints: Sequence[int]) -> None:
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

    def __init__(self, batch: MuJoCoBatch, joints: Sequence[int], rate: float) -> None:
        super().__init__(batch, joints)
        model = self._model
        self._rate = rate
        self._step = self._model.opt.timestep
        self._position_columns = motors.array_index(model.jnt_qposadr[list(joints)].tolist())
        inertias = model.dof_M0[self._dofs]
        self._moved = 1.0 / model.dof_invweight0[self._dofs]
        self._stiffest = motors.MAX_GAIN * inertias / self._step
        self._least = 4.0 * inertias * rate if rate else inertias / self._step
        self._gains = np.full(self._targets.shape, np.nan)  # unequal to any gain, so the first are written

    def _activate(self, worlds: Column) -> None:
        super()._activate(worlds)
        self._gains[worlds] = np.nan

    def _exert(self, targets: Column, worlds: Any) -> None:
        self._targets[worlds] = targets
        self.waits[worlds] = (self._aim(worlds) < self._least).any(axis=1)

    def renew(self, goes: Column) -> None:
        worlds = np.flatnonzero(self.waits & goes)
        if len(worlds):
            self._aim(worlds)

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
        off = np.maximum(
            np.abs(target_velocities - batch.qvel[cells(worlds, self._dofs)]),
            motors.MIN_ERROR_SHARE * np.abs(target_velocities),
        )
        # `np.where` computes both branches: without the maximum below, an error of 0 would divide by 0.
        threshold = limits / self._stiffest
        gains = np.where(off > threshold, limits / np.maximum(off, threshold), self._stiffest)
        batch.ctrl[cells(worlds, self._actuators)] = gains * (self._rate or 1.0) * targets
        aimed: Column = gains
        renewed = (gains != self._gains[worlds]).any(axis=1)
        if not renewed.all():
            worlds = np.arange(batch.count)[worlds][renewed]
            gains = gains[renewed]
        added = gains * self._step
        bias = batch.rows["actuator_biasprm"]
        self._gains[worlds] = gains
        bias[..., 2][cells(worlds, self._actuators)] = -gains
        if self._rate:
            bias[..., 1][cells(worlds, self._actuators)] = -gains * self._rate
        usual = batch.usual_armature(worlds, self._dofs)
        batch.rows["dof_armature"][cells(worlds, self._dofs)] = usual + added
        batch.rows["dof_invweight0"][cells(worlds, self._dofs)] = 1.0 / (self._moved + added)
        return aimed
