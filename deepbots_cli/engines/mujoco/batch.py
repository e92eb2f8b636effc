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
from deepbots_cli.engines.mujoco.state import FULL_STATE, VARIED_ARRAYS, StateRow, place_body, put_joint
from deepbots_cli.errors import EngineError
from deepbots_cli.port import EngineProxy

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from deepbots_cli.frames import Frame, Triple
    from deepbots_cli.port import Engine, Gain, JointReader, MotorWriter, P, Part, PoseReader, Pusher, R
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
        # Attempts to find a start reset the world again.
        if (self._batch.settling or {}).pop(self._index, 1):
            self._batch.reset([self._index])

    def step(self, substeps: int) -> None:
        if self._batch.settling is None:
            self._batch.step(substeps, np.arange(self._batch.count) == self._index)
        else:
            self._batch.settling[self._index] = substeps

    def place(self, body: str, *args: Any, **kwargs: Any) -> None:
        pool = self._batch.single.pool(body)
        if pool.pooled:
            super().place(body, *args, **kwargs)
        else:
            place_body(self._batch.row(self._index, changes=True), pool.current, *args, **kwargs)

    def set_joint(self, robot: str, joint: str, position: float, velocity: float) -> None:
        places = self._batch.single.joint_places(robot, joint)
        put_joint(self._batch.row(self._index, changes=True), places, position, velocity)

    def joint_states(self, robot: str, joints: Sequence[str]) -> JointReader:
        places = [self._batch.single.joint_places(robot, joint)[0] for joint in joints]

        def read() -> list[tuple[float, float]]:
            positions, velocities = self._batch.row(self._index)[:2]
            return [(float(positions[at]), float(velocities[dof])) for at, dof, _ in places]

        return read

    def snapshot(self) -> object:
        raise EngineError("a world of a batch has no snapshots; repeat its episode")

    def restore(self, snapshot: object) -> None:
        self.snapshot()

    def pose(self, body: str, link: str | None = None) -> PoseReader:
        """Read the pose of a free body from its row of the batch: 1 us instead of 8."""
        form_and_link = self._batch.form_and_link(body, link)
        if (
            form_and_link is None
            or form_and_link[1] != form_and_link[0].root_id
            or form_and_link[0].position_index < 0
        ):
            read_attached: PoseReader = super().pose(body, link)
            return read_attached
        at = form_and_link[0].position_index

        def read_free() -> Frame:
            px, py, pz, w, x, y, z = self._batch.row(self._index).qpos[at : at + 7].tolist()
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
        self._updated: set[int] = set()
        """The worlds whose mean inertia is not that of the model."""
        self.has_substep_callbacks = False
        """Whether members act in each substep."""
        self._begun: set[int] = set()
        """The worlds whose episode has begun since the shared engine last had their values."""
        self.settling: dict[int, int] | None = None
        """From `begin` to `begin_episodes`, the substeps for which members settle; 0 for worlds that are reset
        and whose members have not called `reset` yet."""
        self._restoring: set[int] = set()
        """The worlds whose constants belong to masses of the episode before."""
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
            self.state[1:] = self._first_state = self.state[0].copy()
        else:
            self.state[:] = before.state
            for name, rows in fields.items():
                self.rows[name][:] = rows
            if self._updated:
                self._update_constants(sorted(self._updated))
                self.rows["dof_invweight0"][:] = fields["dof_invweight0"]  # to which motors add
        parts = [self._batch.bind(name) for name in StateRow._fields]
        self._state_rows = [StateRow(*row) for row in zip(*parts, strict=True)]
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
        if self._stale:
            self.update_constants(np.flatnonzero(goes))
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
        if worlds := sorted(self._restoring - self._stale):
            self._batch.set_const(worlds)
            self._updated.difference_update(worlds)
        self._restoring.clear()
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

    def begin(self, worlds: Sequence[int]) -> None:
        """See `BatchEngine.begin`."""
        self.reset(worlds)
        self.settling = dict.fromkeys(worlds, 0)

    def reset(self, worlds: Sequence[int]) -> None:
        """Put worlds into the state in which they were built."""
        self._write_back()
        rows = list(worlds)
        self.state[rows] = self._first_state
        for name, values in self.rows.items():
            values[rows] = self._nominal_fields[name]
        self.armature[rows] = self.nominal.dof_armature
        self.inverse_inertia[rows] = self.nominal.dof_invweight0
        self._begun.update(rows)
        self._stale.difference_update(rows)
        self._restoring.update(self._updated.intersection(rows))
        for index in rows:
            self._memories[index] = self._first_memory
        parts: list[BatchMotor | Pushes] = [*self.motors.values(), *self._pushes]
        for part in parts:
            part.begin(rows)
        self.touched[rows] = False
        self._force_means.reset(rows)
        for output in self._outputs.values():
            output[rows] = 0.0

    def begin_episodes(self) -> None:
        """See `BatchEngine.begin_episodes`."""
        settling, self.settling = self.settling, None
        if settling:
            goes = np.zeros(self.count, bool)
            goes[list(settling)] = True
            self.step(max(settling.values()), goes)  # all settle for the same time
        self.take_commands()
        self._forget()

    def row(self, index: int, *, changes: bool = False) -> StateRow:
        """Return the state of a world, to read it, or to write it for `changes`."""
        if self.attached == index and (changes or self._has_changes):
            self._write_back()
        return self._state_rows[index]

    def attach(self, index: int, *, changes: bool = False) -> MuJoCoEngine:
        """Return the shared engine with a world as it is now."""
        begins = changes and index in self._begun
        if begins or self.attached != index:
            self._write_back()
            world = self._world
            if begins:
                # Values that no row has, such as frictions of geoms, are those of another world.
                self._begun.discard(index)
                self.single.reset()
                self._remembered = self._first_memory
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
            self.armature[index] = self.rows["dof_armature"][index] = world.armature
            for name in VARIED_FIELDS:
                if name not in self.rows and (self._fields[name] != self._nominal_fields[name]).any():
                    self.rows[name] = self._batch.expand(name)
            changed = [name for name in self.rows if name not in MOTOR_FIELDS]
        for name in changed:
            self.rows[name][index] = self._fields[name]
        self._memories[index] = self._remembered = world.memory()
        self._forget()

    def update_constants(self, worlds: Column) -> None:
        """See `BatchState.update_constants`."""
        if stale := sorted(self._stale.intersection(worlds.tolist())):
            self._stale.difference_update(stale)
            self._update_constants(stale)

    def _update_constants(self, worlds: list[int]) -> None:
        """Recompute the constants of the model that depend on the masses of these worlds, in ascending
        order."""
        now = self.rows["dof_armature"][worlds]
        self.rows["dof_armature"][worlds] = self.armature[worlds]
        self._batch.set_const(worlds)
        if not self._updated:  # the first time, `set_const` expands all fields that it computes
            self.rows |= {
                name: self._batch.expand(name)
                for name in VARIED_FIELDS
                if self._batch.expanded(name) is not None
            }
        self.rows["dof_armature"][worlds] = now
        self.inverse_inertia[worlds] = self.rows["dof_invweight0"][worlds]
        self._updated.update(worlds)

    def pushes(self, number: int, frame: Literal["world", "link"]) -> Pushes:
        """Return the pushes with this number, which are new if no member has bound them yet."""
        if number == len(self._pushes):
            self._pushes.append(Pushes(self.count, frame))
        return self._pushes[number]

    # Motors

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

    velocity_motor = partialmethod(motor, "velocity")
    torque_motor = partialmethod(motor, "torque")
    position_motor = partialmethod(motor, "position")


def _field(model: Any, name: str) -> Column:
    """Return the array of a model that a batch calls by this name."""
    return cast("Column", model.opt.gravity if name == "opt.gravity" else getattr(model, name))
