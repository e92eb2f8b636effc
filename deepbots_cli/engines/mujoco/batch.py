"""Many worlds of one model, stepped by a pool of threads, which read and write as arrays over the worlds.

Each world is a `MuJoCoEngine` with a copy of the model, since motors and episodes change values of the model. MuJoCo releases
the interpreter lock while it steps, so that threads use all cores. A vector is a sequence of columns, one number per world in each.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from copy import copy, deepcopy
from typing import TYPE_CHECKING, Any

import numpy as np
from mujoco.batch import Batch

from deepbots_cli import frames
from deepbots_cli.engines.mujoco import cameras, motors
from deepbots_cli.engines.mujoco.engine import MuJoCoEngine, _link
from deepbots_cli.engines.mujoco.model import HIDDEN_GROUP, Body, ModelBuilder, finite_limit
from deepbots_cli.engines.mujoco.state import MujocoWorld
from deepbots_cli.engines.objects import Pool

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from deepbots_cli.frames import Frame, Triple
    from deepbots_cli.port import MotorWriter, Part
    from deepbots_cli.program.world import WorldModel

    Column = NDArray[Any]


class BatchMember(MuJoCoEngine):
    """One world of a batch, from a model that was compiled once for all of them."""

    def __init__(self, world: WorldModel, model: Any, pools: Sequence[Pool[Body]]) -> None:
        self._world = MujocoWorld(model, world, pools)
        self._motors = motors.Motors(self._world)
        self._contact_monitor = None
        self._substep_callbacks = []
        self._renderer = cameras.WorldRenderer(world, self._world)
        self.capabilities = frozenset({"contacts", "mimic", "snapshot"})
        self.reset()


class MuJoCoBatch:
    """`count` worlds of one model; `members` are the single engines, which a reset and rare readers use."""

    name = "mujoco"

    def __init__(self, world: WorldModel, count: int, threads: int | None = None) -> None:
        """Without `threads`, as many as there are cores for this process."""
        built = ModelBuilder(world)
        model = built.compile()
        shared = {id(body.model): body.model for pool in built.pools for body in pool}
        self.members = [BatchMember(world, copy(model), deepcopy(built.pools, dict(shared))) for _ in range(count)]
        self._worlds = [member._world for member in self.members]
        self._threads = threads or len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else threads or os.cpu_count() or 1
        self._pool = ThreadPoolExecutor(self._threads, thread_name_prefix="worlds") if min(self._threads, count) > 1 else None
        self._gathered_arrays: dict[str, Column] = {}
        self._views: dict[str, list[memoryview]] = {}
        """Of arrays of all worlds, whose memory stays where it is."""
        self._on_begin: list[Callable[[Sequence[int]], object]] = []
        """Called with the worlds that have begun an episode."""
        self._derivation: Callable[[MujocoWorld], object] | None = None
        """Computes what readers need beside the state; `_last_derivation` is what was computed in all worlds since they changed."""
        self._last_derivation: Callable[[MujocoWorld], object] | None = None
        self.write_mask: Column | None = None
        """The worlds that motors are written in, as truth values; None for all."""

    @property
    def gravity(self) -> Triple:
        """In the first world."""
        return self.members[0].gravity

    # Time

    def step(self, substeps: int, running: Column | None = None) -> None:
        """Let the worlds go on, or only those that are `running` (truth values)."""
        chosen = self.members if running is None else [self.members[index] for index in np.flatnonzero(running)]
        derives = self._derivation
        waiting = iter(chosen)  # each thread takes the next world, so that none waits for one that was disturbed

        def advance(_: int) -> None:
            for member in waiting:
                member.step(substeps)
                if derives is not None:
                    derives(member._world)

        if self._pool is None:
            advance(0)
        else:
            for _ in self._pool.map(advance, range(self._threads)):
                pass
        self._gathered_arrays = {}
        self._last_derivation = derives if running is None else None

    def begin_episodes(self, worlds: Iterable[int]) -> None:
        """Take notice of new episodes in these worlds."""
        self._gathered_arrays = {}
        self._last_derivation = None
        for follower in self._on_begin:
            follower(list(worlds))

    def non_finite_worlds(self) -> Column:
        """The numbers of the worlds whose state is not finite."""
        return np.flatnonzero(~np.isfinite(self._state("qpos").sum(axis=0) + self._state("qvel").sum(axis=0)))

    def close(self) -> None:
        if self._pool is not None:
            self._pool.shutdown()
        for member in self.members:
            member.close()

    # What is read

    def _state(self, name: str) -> Column:
        """An array of MuJoCo's data, flat, with a column per world; made anew after each step, so that what was read stays."""
        return self._gather(name, lambda world: getattr(world.data, name))

    def _gather(self, name: str, part: Callable[[MujocoWorld], Column]) -> Column:
        found = self._gathered_arrays.get(name)
        if found is None:
            parts = self._views.get(name)
            if parts is None:
                parts = self._views[name] = [part(world).reshape(-1).data.cast("B") for world in self._worlds]
            # Joining bytes takes a sixth of `np.concatenate`. What results cannot be written, so nothing is changed by mistake.
            found = self._gathered_arrays[name] = np.frombuffer(b"".join(parts)).reshape(len(parts), -1).T
        return found

    def joint_states(self, robot: str, joints: Sequence[str]) -> Callable[[], Any]:
        first, numbers = self._worlds[0].model, list(self.members[0]._joints(robot, joints))
        positions, velocities = (adr[numbers].tolist() for adr in (first.jnt_qposadr, first.jnt_dofadr))

        def read() -> Any:
            qpos, qvel = self._state("qpos"), self._state("qvel")
            return tuple((qpos[position], qvel[velocity]) for position, velocity in zip(positions, velocities, strict=True))

        return read

    def joint_torques(self, robot: str, joints: Sequence[str]) -> Callable[[], Any]:
        """See `motors.Motors.torques`."""
        first = self.members[0]
        dofs = self._worlds[0].model.jnt_dofadr[list(first._joints(robot, joints))]
        usual = first._motors.nominal_armature[dofs][:, None]

        def read() -> Any:
            armature = self._gather("dof_armature", lambda world: world.model.dof_armature)
            return self._state("qfrc_actuator")[dofs] - (armature[dofs] - usual) * self._state("qacc")[dofs]

        return read

    def pose(self, body: str, link: str | None = None) -> Callable[[], Any]:
        place = self._form_and_link(body, link)
        if place is None:
            return self._read_each(lambda member: member.pose(body, link))
        form, number = place
        if number == form.root_id and form.position_index >= 0:
            at = form.position_index

            def read_free() -> Any:
                px, py, pz, w, x, y, z = self._state("qpos")[at : at + 7]
                return (px, py, pz), (x, y, z, w)

            return read_free
        if number == form.root_id and form.mocap_index >= 0:
            places, turns, index = "mocap_pos", "mocap_quat", form.mocap_index
        else:
            places, turns, index = "xpos", "xquat", number
            self._derivation = self._derivation or MujocoWorld.update_positions

        def read() -> Any:
            if places == "xpos":
                self._require_derived()
            w, x, y, z = self._gather(f"{turns}{index}", lambda world: getattr(world.data, turns)[index])
            return tuple(self._gather(f"{places}{index}", lambda world: getattr(world.data, places)[index])), (x, y, z, w)

        return read

    def velocity(self, body: str, link: str | None = None) -> Callable[[], Any]:
        place = self._form_and_link(body, link)
        if place is None:
            return self._read_each(lambda member: member.velocity(body, link))
        form, number = place
        if number == form.root_id and form.position_index >= 0:
            pose, at = self.pose(body, link), form.velocity_index

            def read_free() -> Any:
                numbers = self._state("qvel")[at : at + 6]
                return tuple(numbers[:3]), frames.rotate(pose()[1], tuple(numbers[3:]))

            return read_free
        self._derivation = MujocoWorld.update_velocities
        root = int(self._worlds[0].model.body_rootid[number])

        def read() -> Any:
            """Of the link's origin, from the velocity of the body at the centre of mass of its tree, as `mj_objectVelocity` does."""
            self._require_derived()
            spatial = self._gather(f"cvel{number}", lambda world: world.data.cvel[number])
            apart = self._gather(f"xpos{number}", lambda world: world.data.xpos[number])
            apart = apart - self._gather(f"subtree_com{root}", lambda world: world.data.subtree_com[root])
            angular = tuple(spatial[:3])
            return frames.subtract(tuple(spatial[3:]), frames.cross(tuple(apart), angular)), angular

        return read

    def motion(self, body: str, link: str | None = None) -> Callable[[], Any]:
        pose, velocity = self.pose(body, link), self.velocity(body, link)
        return lambda: (pose(), velocity())

    def rays(self, part: Part, rays: Sequence[Frame], reach: float) -> Callable[[], Column]:
        """See `Engine.rays`."""
        place = self._form_and_link(*part)
        if place is None:
            readers = [member.rays(part, rays, reach) for member in self.members]
            return lambda: np.array([reader() for reader in readers]).T
        form, link = place
        starts = np.array([origin for origin, _ in rays])
        ways = np.array([frames.rotate(turned, (1.0, 0.0, 0.0)) for _, turned in rays])
        seen = np.ones(6, np.uint8)
        seen[HIDDEN_GROUP] = 0
        # One call for the rays of all worlds takes a quarter of the time of a call for each ray. It has one thread: with
        # two, the physics of FindBall took 3 to 30 us more CPU per world, probably since idle threads wait in a loop.
        casts = Batch(self._worlds[0].model, len(self._worlds), 1)
        casts_groups, casts_qpos = casts.expand("geom_group"), casts.bind("qpos")
        at_rest = [(name, casts.bind(name)) for name in ("mocap_pos", "mocap_quat") if self._worlds[0].model.nmocap]
        own = form.geoms_of(None)

        def begun(worlds: Sequence[int]) -> None:
            """Bodies come and go with an episode, and a robot does not see itself."""
            for world in worlds:
                casts_groups[world] = self._worlds[world].model.geom_group
                casts_groups[world, own] = HIDDEN_GROUP
                for name, places in at_rest:
                    places[world] = getattr(self._worlds[world].data, name)

        begun(range(len(self._worlds)))
        self._on_begin.append(begun)
        self._derivation = self._derivation or MujocoWorld.update_positions

        def read() -> Column:
            self._require_derived()
            axes = self._gather(f"xmat{link}", lambda world: world.data.xmat[link]).T.reshape(-1, 3, 3)
            position = self._gather(f"xpos{link}", lambda world: world.data.xpos[link]).T
            casts_qpos[:] = self._state("qpos").T
            free, _ = casts.ray(position[:, None] + starts @ axes.transpose(0, 2, 1), ways @ axes.transpose(0, 2, 1), seen)
            return np.where((free < 0.0) | (free > reach), reach, free).T

        return read

    def _require_derived(self) -> None:
        """Compute for all worlds what a step computes, since some began an episode."""
        compute = self._derivation
        if compute is not None and self._last_derivation is not compute:
            for world in self._worlds:
                compute(world)
            self._last_derivation = compute

    def _form_and_link(self, body: str, link: str | None) -> tuple[Body, int] | None:
        """The form of a body and the number of the link; None where it has several forms."""
        pool = self.members[0]._pool(body)
        return (pool.current, _link(pool.current, link)) if len(list(pool)) == 1 else None

    def _read_each(self, bind: Callable[[BatchMember], Callable[[], Any]]) -> Callable[[], Any]:
        readers = [bind(member) for member in self.members]

        def read() -> Any:
            first, second = zip(*(reader() for reader in readers), strict=True)
            return np.array(first).T, np.array(second).T

        return read

    # Motors

    def velocity_motor(self, robot: str, joints: Sequence[str], max_torque: Sequence[float]) -> MotorWriter:
        singles = [member._motor(robot, joints, max_torque) for member in self.members]
        motor = BatchMotor(self, [single.velocity_writer() for single in singles], robot, joints)
        return motor.tracking_writer(singles, [finite_limit(limit) for limit in max_torque])

    def torque_motor(self, robot: str, joints: Sequence[str], max_torque: Sequence[float]) -> MotorWriter:
        motor = BatchMotor(self, [member.torque_motor(robot, joints, max_torque) for member in self.members], robot, joints)
        limits = np.array([finite_limit(limit) for limit in max_torque])[:, None]
        return motor.writer(lambda targets: np.minimum(np.maximum(targets, -limits), limits), holds=False)

    def position_motor(
        self,
        robot: str,
        joints: Sequence[str],
        max_torque: Sequence[float],
        stiffness: Sequence[float] | None,
        damping: Sequence[float] | None,
    ) -> MotorWriter:
        """A spring is written as an array; a servo renews its gains in each engine step, and is written world by world."""
        own = [member.position_motor(robot, joints, max_torque, stiffness, damping) for member in self.members]
        motor = BatchMotor(self, own, robot, joints)
        if stiffness is None:
            return motor.each_writer
        rates = np.array(stiffness)[:, None]
        return motor.writer(lambda targets: rates * targets, holds=True)


class ArrayWriter:
    """The same places of an array of MuJoCo in all worlds, written as columns.

    Copying one view onto another takes 0.06 us per world, writing a row of an array into a slice of another 0.2 us.
    """

    def __init__(self, arrays: Sequence[Column], places: Any) -> None:
        """`places` are a slice, or numbers that do not follow each other."""
        parts = [places] if isinstance(places, slice) else [slice(place, place + 1) for place in places.tolist()]
        self._values = np.zeros((len(arrays), len(arrays[0][places])))
        own = [slice(None)] if isinstance(places, slice) else [slice(number, number + 1) for number in range(len(parts))]
        self._pairs = [
            [(array[part].data, row[mine].data) for part, mine in zip(parts, own, strict=True)]
            for array, row in zip(arrays, self._values, strict=True)
        ]
        self._all = [pair for pairs in self._pairs for pair in pairs]

    def write(self, columns: Column, worlds: Column) -> None:
        """Write a row per place and a column per world, in these worlds."""
        self._values[:] = columns.T
        whole = slice(None)
        chosen = self._all if len(worlds) == len(self._pairs) else [pair for world in worlds.tolist() for pair in self._pairs[world]]
        for target, source in chosen:
            target[whole] = source


class BatchMotor:
    """A motor on the same joints of all worlds; in a new episode, its first command goes through the motor of the single world."""

    def __init__(self, batch: MuJoCoBatch, own: Sequence[MotorWriter], robot: str, joints: Sequence[str]) -> None:
        self._batch, self._own, self._count = batch, own, len(joints)
        numbers = list(batch.members[0]._joints(robot, joints))
        self._numbers = numbers
        self._model = batch._worlds[0].model
        self._acts = motors.array_index([batch.members[0]._motors.actuators[number] for number in numbers])
        self._ctrl = ArrayWriter([world.data.ctrl for world in batch._worlds], self._acts)
        self._let_go = np.zeros(len(own), bool)
        self._holds = True
        batch._on_begin.append(self.begin_episodes)

    def begin_episodes(self, worlds: Sequence[int]) -> None:
        """These worlds have begun an episode; most motors hold their joints since then, and drive them."""
        self._let_go[worlds] = not self._holds

    def each_writer(self, targets: Any) -> None:
        """Command each world by itself."""
        self._write_own(self._columns(targets), self._written_worlds())

    def writer(self, control: Callable[[Column], Column], *, holds: bool) -> MotorWriter:
        """A motor whose law stays the same: the numbers that its actuators get follow from the targets.

        One that does not hold its joints at the beginning takes them by the first command of an episode.
        """
        self._holds = holds
        self._let_go[:] = not holds

        def write(targets: Any) -> None:
            columns, chosen = self._columns(targets), self._written_worlds()
            if self._let_go.any():
                self._write_own(columns, chosen[self._let_go[chosen]])
            self._ctrl.write(control(columns), chosen)

        return write

    def tracking_writer(self, singles: Sequence[motors.Motor], limits: Sequence[float]) -> MotorWriter:
        """A velocity motor; see `motors.Motor.velocity_writer`. Worlds in which gains are renewed are written by their `singles`."""
        model, batch = self._model, self._batch
        joint_motors, step = batch.members[0]._motors, model.opt.timestep
        dofs = motors.array_index(model.jnt_dofadr[self._numbers].tolist())
        usual, moved = joint_motors.nominal_armature[dofs][:, None], 1.0 / joint_motors.nominal_inverse_inertia[dofs][:, None]
        bounds = np.array(limits)[:, None]
        inertias = model.dof_M0[dofs][:, None]
        stiffest, least = motors.MAX_GAIN * inertias / step, inertias / step
        renewed = [member._motors.gain_updates for member in batch.members]
        models = [world.model for world in batch._worlds]
        biases = ArrayWriter([each.actuator_biasprm[:, 2] for each in models], self._acts)
        armatures, inverses = (ArrayWriter([getattr(each, name) for each in models], dofs) for name in ("dof_armature", "dof_invweight0"))

        def write(targets: Any) -> None:
            columns, chosen = self._columns(targets), self._written_worlds()
            off = np.maximum(np.abs(columns - batch._state("qvel")[dofs]), motors.MIN_ERROR_SHARE * np.abs(columns))
            gains = np.where(off * stiffest > bounds, bounds / off, stiffest)
            slow = (gains < least).any(axis=0).tolist()
            one_by_one = [world for world in chosen.tolist() if slow[world] or renewed[world]]
            if one_by_one:
                for world in one_by_one:
                    singles[world].gains = []  # the model may have others
                self._write_own(columns, np.array(one_by_one))
                chosen = np.setdiff1d(chosen, one_by_one)
            added = gains * step
            biases.write(-gains, chosen)
            armatures.write(usual + added, chosen)
            inverses.write(1.0 / (moved + added), chosen)
            self._ctrl.write(gains * columns, chosen)

        return write

    def _columns(self, targets: Any) -> Column:
        """The targets as an array with a row per joint and a column per world."""
        return np.stack([np.broadcast_to(np.asarray(target, float), len(self._own)) for target in targets])

    def _written_worlds(self) -> Column:
        chosen = self._batch.write_mask
        return np.arange(len(self._own)) if chosen is None else np.flatnonzero(chosen)

    def _write_own(self, columns: Column, worlds: Column) -> None:
        for world, row in zip(worlds.tolist(), columns.T[worlds].tolist(), strict=True):
            self._own[world](row)
        self._let_go[worlds] = False
