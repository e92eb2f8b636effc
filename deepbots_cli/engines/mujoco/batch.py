"""Many worlds of one model on `mujoco.batch.Batch`: one call steps all of them, and they are read and written
as columns.

Values that differ between worlds (gains of motors, masses, frictions) are rows of expanded model fields.
Episodes begin in one engine of a single world, which all members share: it takes the state of the world that
is used, and its changes are copied to the rows of the world. A vector is a sequence of columns, one number
per world in each.

Positions and velocities of links, rays and distances come from `Observer`, a second batch of the same model
without contacts: after a step, those of MuJoCo belong to the state before its last substep. Gains that are
written between two steps change the inertia of joints, so that a step cannot continue from positions that
were computed before.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partialmethod
from typing import TYPE_CHECKING, Any, Literal, cast

import numpy as np
from mujoco.batch import Batch

from deepbots_cli.engines.mechanics import torque_curve
from deepbots_cli.engines.mujoco import motors, sliding
from deepbots_cli.engines.mujoco import mujoco as mj
from deepbots_cli.engines.mujoco.batch_readers import BatchReaders, model_with_sensors
from deepbots_cli.engines.mujoco.engine import MuJoCoEngine, link_number
from deepbots_cli.engines.mujoco.motors import (
    MOTOR_FIELDS,
    BatchMotor,
    CurvedMotor,
    Pushes,
    TrackingMotor,
)
from deepbots_cli.engines.mujoco.state import FULL_STATE, VARIED_ARRAYS
from deepbots_cli.errors import EngineError
from deepbots_cli.port import EngineProxy

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from deepbots_cli.frames import Frame, Triple
    from deepbots_cli.port import Engine, Gain, MotorWriter, P, Part, PoseReader, Pusher, R
    from deepbots_cli.program.world import WorldModel

    Column = NDArray[Any]

VARIED_FIELDS = ("opt.gravity", *VARIED_ARRAYS)


class BatchMember(EngineProxy):
    """One world of a batch. Reads and changes use the shared engine; steps and motors use the batch."""

    def __init__(self, batch: MuJoCoBatch, index: int) -> None:
        self._batch = batch
        self._index = index
        self.name = batch.name
        self.capabilities = batch.capabilities
        self.substep_callbacks: list[Callable[[], object]] = []
        self._pushers = 0

    @property
    def engine(self) -> Engine:  # type: ignore[override]
        return self._batch.attach(self._index)

    def bound(self, read: Callable[P, R]) -> Callable[P, R]:
        attach = self._batch.attach
        index = self._index

        def read_attached(*args: P.args, **kwargs: P.kwargs) -> R:
            attach(index)
            return read(*args, **kwargs)

        return read_attached

    def changing(self, body: str = "") -> Engine:
        return self._batch.attach(self._index, changes=True)

    def reset(self) -> None:
        self._batch.begin(self._index)

    def step(self, substeps: int) -> None:
        self._batch.step(substeps, np.arange(self._batch.count) == self._index)

    def snapshot(self) -> object:
        raise EngineError("a world of a batch has no snapshots; repeat its episode")

    def restore(self, snapshot: object) -> None:
        self.snapshot()

    def pose(self, body: str, link: str | None = None) -> PoseReader:
        """Read the pose of a free body from its row of the batch, unless the shared engine has this world: 1
        us instead of 8."""
        read_attached: PoseReader = super().pose(body, link)
        batch = self._batch
        index = self._index
        form_and_link = self._batch.form_and_link(body, link)
        if (
            form_and_link is None
            or form_and_link[1] != form_and_link[0].root_id
            or form_and_link[0].position_index < 0
        ):
            return read_attached
        at = form_and_link[0].position_index

        def read_free() -> Frame:
            # The shared engine may have changes that the row lacks until `_release`.
            if batch.attached == index:
                return read_attached()
            px, py, pz, w, x, y, z = batch.qpos[index, at : at + 7].tolist()
            return (px, py, pz), (x, y, z, w)

        return read_free

    def before_substep(self, callback: Callable[[], object]) -> None:
        self.substep_callbacks.append(callback)
        self._batch.has_substep_callbacks = True

    def pusher(self, part: Part, frame: Literal["world", "link"] = "world") -> Pusher:
        pushes = self._batch.pushes(self._pushers, frame)
        index = self._index
        pool = self._batch.single.pool(part[0])
        self._pushers += 1
        link = link_number(pool.current, part[1])

        def push(force: Triple, torque: Triple) -> None:
            at = (
                link
                if len(list(pool)) == 1
                else link_number(self._batch.attach(index).pool(part[0]).current, part[1])
            )
            pushes.give(index, at, force, torque)

        return push

    def _of_columns(self, method: str, *args: Any, **options: Any) -> Callable[[], Any]:
        read = getattr(self._batch, method)(*args, **options)
        index = self._index
        return lambda: read()[..., index].tolist()

    contact = partialmethod(_of_columns, "contact")
    contact_force = partialmethod(_of_columns, "contact_force")
    contact_force_vector = partialmethod(_of_columns, "contact_force_vector")
    joint_torques = partialmethod(_of_columns, "joint_torques")
    joint_wrench = partialmethod(_of_columns, "joint_wrench")

    def _motor(self, kind: str, *args: Any, **curve: Any) -> MotorWriter:
        return self._batch.motor(kind, *args, **curve, world=self._index).writer(self._index)

    velocity_motor = partialmethod(_motor, "velocity")
    position_motor = partialmethod(_motor, "position")
    torque_motor = partialmethod(_motor, "torque")


class MuJoCoBatch(BatchReaders):
    """`count` worlds of one model; `members` are engines of one world each, which resets and rare readers
    use."""

    members: list[BatchMember]
    name = "mujoco"
    capabilities: frozenset[Any] = frozenset(
        {
            *("contacts", "mimic"),
            *("armature", "center_of_mass", "joint_wrench", "self_collision", "torque_curve"),
        }
    )

    def __init__(self, world: WorldModel, count: int) -> None:
        sliding.install()
        super().__init__(world, count)
        self.attached: int | None = None
        """The world that the shared engine has."""
        self._has_changes = False
        """Whether the shared engine has changed it."""
        self._stale: set[int] = set()
        """The worlds with new masses, until the first step computes the values that depend on them."""
        self._updated_armatures: dict[int, Column] = {}
        """The worlds whose mean inertia is not that of the model, and the armature that it was computed
        with."""
        self.has_substep_callbacks = False
        """Whether members act in each substep."""
        self._pushes: list[Pushes] = []
        """The pushes of all members, in the order in which each of them binds its pushers."""
        self.motors: dict[Any, BatchMotor] = {}
        self.rows = dict.fromkeys(MOTOR_FIELDS, np.zeros(0))
        """The fields of the model that differ between worlds."""
        if any(pool.pooled for pool in self._world.pools.values()):
            self.rows |= dict.fromkeys(("body_gravcomp", "geom_group"), np.zeros(0))
        self._pooled = [name for name in self.rows if name not in MOTOR_FIELDS]
        # `require_finite` of the shared engine names the springs of a world.
        self._usual_rows = frozenset(self.rows) - {"actuator_biasprm", "actuator_forcelimited"}
        self._fields, self._nominal_fields = (
            {name: _field(model, name) for name in VARIED_FIELDS}
            for model in (self._world.model, self.nominal)
        )
        self._batch: Any = None
        self._build()
        self.members = [BatchMember(self, index) for index in range(count)]

    def _build(self) -> None:
        """Build the batch of MuJoCo, anew if sensors were added."""
        before, fields = self._batch, self.rows
        readings = {name: rows.copy() for name, rows in self._outputs.items()}
        self._batch = Batch(
            model_with_sensors(self.builder, self.nominal, self._sensors), self.count, self._threads
        )
        self.state = self._batch.state
        model = self._batch.model
        self.ctrl, self.qpos, self.qvel = (self._batch.bind(name) for name in ("ctrl", "qpos", "qvel"))
        self.rows = {name: self._batch.expand(name) for name in fields}
        if before is None:
            mj.mj_getState(self._world.model, self._world.data, self.state[0], FULL_STATE)
            self.state[1:] = self.state[0]
        else:
            self.state[:] = before.state
            for name, rows in fields.items():
                self.rows[name][:] = rows
            if self._updated_armatures:
                worlds = sorted(self._updated_armatures)
                self._update_constants(worlds, np.array([self._updated_armatures[i] for i in worlds]))
        for name in [
            *self._outputs,
            *["sensordata" for sensor in self._sensors if sensor.measures != "touch"][:1],
        ]:
            self._keep_output(name)
        for name, rows in readings.items():
            self._outputs[name][:, : rows.shape[1]] = rows  # new sensors come last
        self._built = len(self._sensors)
        self._touch_columns = np.array(
            [column for sensor, column in self._sensors.items() if sensor.measures == "touch"], int
        )
        self._touch_places = np.array([model.sensor_adr[column] for column in self._touch_columns], int)

    @property
    def gravity(self) -> Triple:
        """The gravity of the model, if no episode sets another."""
        x, y, z = self.nominal.opt.gravity.tolist()
        return x, y, z

    # Time

    def step(self, substeps: int, running: Column | None = None) -> None:
        """Step all worlds, or only those that are `running` (truth values)."""
        if len(self._sensors) != self._built:
            self._build()
        self.take_commands()
        goes = np.ones(self.count, bool) if running is None else running
        if stale := sorted(index for index in self._stale if goes[index]):
            self._stale.difference_update(stale)
            self._update_constants(stale, self.rows["dof_armature"][stale])
        if len(self._touch_columns):
            self.touched[goes] = False
        if self._force_means:
            self._force_means.reset(goes)
        waits = [part.waits for parts in (self.motors.values(), self._pushes) for part in parts]
        if not (self.has_substep_callbacks or any(column.any() for column in waits)):
            self._advance(goes, substeps)
            return
        for _ in range(substeps):
            if self.has_substep_callbacks:
                for index in np.flatnonzero(goes).tolist():
                    for act in self.members[index].substep_callbacks:
                        act()
                self.take_commands()
            for motor in self.motors.values():
                motor.renew(goes)
            if not self._pushes:
                self._advance(goes, 1)
                continue
            applied = self._push(goes)
            self._advance(goes, 1)
            applied[goes] = 0.0

    def _advance(self, goes: Column, substeps: int) -> None:
        ids = np.flatnonzero(goes)
        if not len(ids):
            return
        self._forget()
        if not (len(self._touch_columns) or self._force_means):
            self._batch.step(None if len(ids) == self.count else ids, substeps)
            return
        before, warned = (self.state.copy(), self._batch.warning.copy()) if substeps > 1 else (None, None)
        readings = self._batch.rollout(substeps, ids=ids, record=("sensordata",))["sensordata"]
        self.touched[np.ix_(ids, self._touch_columns)] |= (readings[..., self._touch_places] > 0.0).any(
            axis=1
        )
        again = np.zeros(self.count, bool)
        if warned is not None:
            again = (self._batch.warning != warned).any(axis=(1, 2))
        went = ~again[ids]
        self._force_means.add(self._batch.model.sensor_adr, readings[went], ids[went])
        if before is not None and again.any():
            # MuJoCo's `rollout` stops at a warning, and its `step` does not.
            self.state[again] = before[again]
            for _ in range(substeps):
                self._advance(again, 1)

    def _push(self, goes: Column) -> Column:
        """Push links in the next substep, and return the applied forces."""
        applied: Column = self._batch.bind("xfrc_applied")
        for pushes in self._pushes:
            worlds = np.flatnonzero(pushes.waits & goes)
            if len(worlds):
                links = pushes.links[worlds]
                rotations = self._observer.read("xquat")[worlds, links].T[[1, 2, 3, 0]]  # MuJoCo has w first
                centers = (
                    self.rows["body_ipos"][worlds, links]
                    if "body_ipos" in self.rows
                    else self.nominal.body_ipos[links]
                )
                applied[worlds, links] += pushes.take(worlds, rotations, centers.T)
        return applied

    def take_commands(self) -> None:
        """Copy the changes of members to the worlds, and their commands to the motors."""
        self._write_back()
        if self.has_commands:
            self.has_commands = False
            for motor in self.motors.values():
                motor.command()

    def _forget(self) -> None:
        """Forget the readings after worlds have changed."""
        self._columns = {}
        self._observer.is_current = False

    def non_finite_worlds(self) -> Column:
        """Return the numbers of the worlds that `Engine.require_finite` refuses."""
        is_finite = np.isfinite(self.qpos.sum(axis=1) + self.qvel.sum(axis=1))
        return np.flatnonzero(~is_finite | (np.abs(self.qvel) > self._world.fastest).any(axis=1))

    def close(self) -> None:
        self.single.close()

    # Episodes

    def begin(self, index: int) -> None:
        """Begin an episode of a world in the shared engine."""
        self._write_back()
        self.single.reset()
        self.attached = index
        self._has_changes = True
        for name, rows in self.rows.items():
            rows[index] = self._nominal_fields[name]
        if self._armature is not None:
            self._armature[index] = self.nominal.dof_armature
        if self._updated_armatures.pop(index, None) is not None:
            self._batch.set_const([index])
        self._stale.discard(index)
        for motor in self.motors.values():
            motor.begin(index)
        for pushes in self._pushes:
            pushes.begin(index)
        self.touched[index] = False
        self._force_means.reset(index)
        for output in self._outputs.values():
            output[index] = 0.0

    def begin_episodes(self) -> None:
        """Take over the episodes that members have begun."""
        self.take_commands()
        self._forget()

    def attach(self, index: int, *, changes: bool = False) -> MuJoCoEngine:
        """Return the shared engine with a world as it is now."""
        if self.attached != index:
            self._write_back()
            world = self._world
            mj.mj_setState(world.model, world.data, self.state[index], FULL_STATE)
            changed = [*(self.rows.keys() - self._usual_rows)]
            if self._memories[index] != self._remembered:
                self._remembered = self._memories[index]
                world.remember(self._remembered)
                changed += self._pooled
            for name in changed:
                self._fields[name][...] = self.rows[name][index]
            world.invalidate()
            self.attached = index
        self._has_changes |= changes
        return self.single

    def _write_back(self) -> None:
        """Copy the changes of the shared engine to its world."""
        index, world = self.attached, self._world
        self.attached = None
        if index is None or not self._has_changes:
            return
        self._has_changes = False
        mj.mj_getState(world.model, world.data, self.state[index], FULL_STATE)
        changed = self._pooled
        if world.is_stale:
            if world.settle_values():
                self._stale.add(index)
            self._take_armature(index)
            for name in VARIED_FIELDS:
                if name not in self.rows and not np.array_equal(
                    self._fields[name], self._nominal_fields[name]
                ):
                    self.rows[name] = self._batch.expand(name)
            changed = [name for name in self.rows if name not in MOTOR_FIELDS]
        for name in changed:
            self.rows[name][index] = self._fields[name]
        self._memories[index] = self._remembered = world.memory()
        self._forget()

    def _take_armature(self, index: int) -> None:
        """Copy the armature that an episode has set to its world."""
        usual = self._world.armature
        nominal = self.nominal.dof_armature
        if self._armature is None and not np.array_equal(usual, nominal):
            self._armature = np.tile(nominal, (self.count, 1))
        if self._armature is not None:
            self._armature[index] = self.rows["dof_armature"][index] = usual

    def _update_constants(self, worlds: list[int], armatures: Column) -> None:
        """Recompute the constants of the model that depend on the masses of these worlds, in ascending
        order."""
        now = self.rows["dof_armature"][worlds]
        self.rows["dof_armature"][worlds] = armatures
        self._batch.set_const(worlds)
        if not self._updated_armatures:  # the first time, `set_const` expands all fields that it computes
            self.rows |= {
                name: self._batch.expand(name)
                for name in VARIED_FIELDS
                if self._batch.expanded(name) is not None
            }
        self.rows["dof_armature"][worlds] = now
        self._updated_armatures |= zip(worlds, armatures, strict=True)

    def pushes(self, number: int, frame: Literal["world", "link"]) -> Pushes:
        """Return the pushes with this number, which are new if no member has bound them yet."""
        if number == len(self._pushes):
            self._pushes.append(Pushes(self.count, frame))
        return self._pushes[number]

    # Motors

    def velocity_motor(self, robot: str, joints: Sequence[str], max_torque: Sequence[float]) -> MotorWriter:
        return self.motor("velocity", robot, joints, max_torque)

    def torque_motor(
        self,
        robot: str,
        joints: Sequence[str],
        max_torque: Sequence[float],
        *,
        stall_torque: Gain = None,
        no_load_speed: Gain = None,
    ) -> MotorWriter:
        return self.motor(
            "torque",
            robot,
            joints,
            max_torque,
            stall_torque=stall_torque,
            no_load_speed=no_load_speed,
        )

    def position_motor(
        self,
        robot: str,
        joints: Sequence[str],
        max_torque: Sequence[float],
        stiffness: Gain,
        damping: Gain,
        *,
        stall_torque: Gain = None,
        no_load_speed: Gain = None,
    ) -> MotorWriter:
        return self.motor(
            "position",
            robot,
            joints,
            max_torque,
            stiffness,
            damping,
            stall_torque=stall_torque,
            no_load_speed=no_load_speed,
        )

    def motor(
        self,
        kind: str,
        robot: str,
        joints: Sequence[str],
        limits: Sequence[float],
        *gains: Gain,
        stall_torque: Gain = None,
        no_load_speed: Gain = None,
        world: int | None = None,
    ) -> BatchMotor:
        """Return the motor of this kind on the same joints of all worlds, with these limits, gains and curve
        of torques in one of them or in all."""
        stiffness, damping = gains or (None, None)
        curve = torque_curve(stall_torque, no_load_speed)
        worlds = slice(None) if world is None else slice(world, world + 1)
        numbers = self.single.joint_numbers(robot, joints)
        key = kind, numbers, stiffness is None, curve is None
        if key not in self.motors:
            is_servo = kind == "position" and stiffness is None
            rate = motors.servo_rate(self.nominal) if is_servo else 0.0
            motor: BatchMotor
            if kind == "velocity" or is_servo:
                motor = TrackingMotor(self, numbers, rate)
            elif curve is not None:
                motor = CurvedMotor(self, numbers)
            else:
                motor = BatchMotor(self, numbers)
            for rival in self.motors.values():
                if not set(rival.joints).isdisjoint(numbers):
                    motor.rivals.append(rival)
                    rival.rivals.append(motor)
            self.motors[key] = motor
        bound = self.motors[key]
        bound.bind(worlds, limits, stiffness, damping)
        if isinstance(bound, CurvedMotor) and curve is not None:
            bound.bind_curve(worlds, curve)
        return bound


def _field(model: Any, name: str) -> Column:
    """Return the array of a model that a batch calls by this name."""
    return cast("Column", model.opt.gravity if name == "opt.gravity" else getattr(model, name))
