"""The readers of a batch: functions that read one thing of all worlds as columns, with the sensors that a
batch adds to its model.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from copy import copy
from math import inf
from typing import TYPE_CHECKING, Any, Literal, NamedTuple, cast

import numpy as np
from mujoco.batch import Batch

from deepbots_cli import frames
from deepbots_cli.engines.mujoco import mujoco as mj
from deepbots_cli.engines.mujoco.engine import MuJoCoEngine, link_number
from deepbots_cli.engines.mujoco.model import HIDDEN_GROUP, Body, ModelBuilder
from deepbots_cli.engines.mujoco.state import VARIED_ARRAYS, BatchState, LinkMotions
from deepbots_cli.engines.mujoco.surfaces import ELLIPSOID, MAX_CLEARANCE_M, level_axes
from deepbots_cli.errors import EngineError
from deepbots_cli.processes import available_cores
from deepbots_cli.program.world import GROUND

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from deepbots_cli.frames import Frame
    from deepbots_cli.port import EngineProxy, Part
    from deepbots_cli.program.world import WorldModel

    Column = NDArray[Any]


OBSERVED_FIELDS = ("geom_group", "body_mass", "body_ipos", "body_subtreemass")
"""The arrays of a model that positions, velocities and rays depend on."""
FORCE_SLOTS = 32
"""Contacts of a link whose forces a batch adds up."""
WORK_OF_A_THREAD = 200
"""The degrees of freedom and half the pairs of geoms of all worlds that a thread steps."""
SEEN_GROUPS = [number != HIDDEN_GROUP for number in range(int(mj.mjNGROUP))]

_FOUND = mj.mjtConDataField.mjCONDATA_FOUND
_FORCE = mj.mjtConDataField.mjCONDATA_FORCE
_CONTACT_SENSORS: dict[str, tuple[tuple[Any, ...], int, int]] = {
    "touch": ((_FOUND,), 0, 1),
    "forces": ((_FOUND, _FORCE), 0, FORCE_SLOTS),
    "force": ((_FORCE,), 3, 1),
}
"""The fields of MuJoCo's contact sensors, whether their contacts are reduced (3: to the net force in the
world frame), and the number of contacts."""

_SITE_SENSORS = {"joint_force": mj.mjtSensor.mjSENS_FORCE, "joint_torque": mj.mjtSensor.mjSENS_TORQUE}


class Sensor(NamedTuple):
    """A sensor that a batch adds to its model: whether `one` touches `other` (None: anything), the normal
    forces of up to `FORCE_SLOTS` contacts, the sum of all forces as a vector, the force or the torque of the
    joint that carries `one`, or the distance of two geoms.

    Each side is a link number, and whether the links below it belong to it. For a distance, the number is
    that of a geom.
    """

    one: tuple[int, bool]
    other: tuple[int, bool] | None
    measures: Literal["touch", "forces", "force", "joint_force", "joint_torque", "distance"] = "touch"


def model_with_sensors(builder: ModelBuilder, model: Any, sensors: Collection[Sensor]) -> Any:
    """Return a copy of the compiled model with sensors."""
    if not sensors:
        return copy(model)
    spec = builder.spec.copy()
    kinds = mj.mjtObj
    for index, sensor in enumerate(sensors):
        subjects = {}
        for (kind, name), part_name in zip(
            (("objtype", "objname"), ("reftype", "refname")), (sensor.one, sensor.other), strict=True
        ):
            if part_name is not None:
                number, has_subtree = part_name
                link = kinds.mjOBJ_XBODY if has_subtree else kinds.mjOBJ_BODY
                is_geom = sensor.measures == "distance"
                subjects[kind] = kinds.mjOBJ_GEOM if is_geom else link
                subjects[name] = (model.geom if is_geom else model.body)(number).name
        if sensor.measures == "distance":
            spec.add_sensor(type=mj.mjtSensor.mjSENS_GEOMDIST, cutoff=MAX_CLEARANCE_M, **subjects)
        elif sensor.measures in _SITE_SENSORS:
            site = spec.body(subjects["objname"]).add_site(name=f"s{index}")
            spec.add_sensor(type=_SITE_SENSORS[sensor.measures], objtype=kinds.mjOBJ_SITE, objname=site.name)
        else:
            fields, reduced, slots = _CONTACT_SENSORS[sensor.measures]
            added = spec.add_sensor(type=mj.mjtSensor.mjSENS_CONTACT, **subjects)
            added.intprm[:3] = sum(1 << int(field) for field in fields), reduced, slots
    compiled = spec.compile()
    # `ModelBuilder.compile` and `MujocoWorld` set these in the compiled model, not in the specification.
    compiled.opt.disableflags = model.opt.disableflags
    compiled.opt.jacobian = model.opt.jacobian
    compiled.stat.meaninertia = model.stat.meaninertia
    for name in ("dof_simplenum", "body_sameframe", "geom_sameframe", *VARIED_ARRAYS):
        getattr(compiled, name)[:] = getattr(model, name)
    return compiled


class Observer:
    """Links, rays and distances of all worlds in their present state, from the same model without contacts
    and motors."""

    def __init__(self, batch: BatchState, threads: int) -> None:
        self._batch = batch
        self._threads = threads
        self._distances: dict[Sensor, int] = {}
        self._stage = int(mj.mjtStage.mjSTAGE_POS)
        self._built = -1
        self._bound: set[str] = set()
        self.is_current = False

    def distances(self, pairs: Sequence[tuple[int, int]]) -> list[int]:
        """Return the places in `sensordata` of the distances between geoms."""
        sensors = [Sensor((first, False), (second, False), "distance") for first, second in pairs]
        return [self._distances.setdefault(sensor, len(self._distances)) for sensor in sensors]

    def read(self, name: str) -> Column:
        """Return an array of MuJoCo's data, with a row per world."""
        batch = self._batch
        if self._built != len(self._distances):
            model = model_with_sensors(batch.builder, batch.nominal, self._distances)
            off = mj.mjtDisableBit
            model.opt.disableflags |= off.mjDSBL_CONTACT | off.mjDSBL_CONSTRAINT | off.mjDSBL_ACTUATION
            self._views = Batch(model, batch.count, self._threads)
            self._built = len(self._distances)
            self._bound.clear()
        bound: Column = self._views.bind(name)
        # The only array that needs velocities.
        stage = int(mj.mjtStage.mjSTAGE_VEL) if name == "cvel" else self._stage
        if not self.is_current or name not in self._bound or stage > self._stage:
            self._bound.add(name)
            self._stage = max(stage, self._stage)
            self._views.state[:] = batch.state
            for field in OBSERVED_FIELDS:
                if field in batch.rows:
                    self._views.expand(field)[:] = batch.rows[field]
            self._views.forward(stage=self._stage)
            self.is_current = True
        return bound

    def cast(self, starts: Column, ways: Column, own_geoms: Sequence[int]) -> Column:
        """Return the free distance of rays, -1 if they meet nothing; geoms of `own_geoms` are not seen."""
        groups = self._views.expand("geom_group")
        saved_groups = groups[:, own_geoms]
        groups[:, own_geoms] = HIDDEN_GROUP
        try:
            free: Column = self._views.ray(starts, ways, SEEN_GROUPS)[0]
        finally:
            groups[:, own_geoms] = saved_groups
        return free


class ForceMeans:
    """The contact forces of all worlds, added up over the engine steps of the last step; `contacts` are the
    most contacts of a link in one of them."""

    def __init__(self, count: int) -> None:
        self._steps = np.zeros(count, int)
        self._sums: dict[int, Column] = {}
        self._contacts: dict[int, Column] = {}

    def include(self, number: int, width: int) -> None:
        """Add up the readings of a sensor: forces of a number of components."""
        self._sums.setdefault(number, np.zeros((width, len(self._steps))))
        self._contacts.setdefault(number, np.zeros(len(self._steps)))

    def __bool__(self) -> bool:
        return bool(self._sums)

    def reset(self, worlds: Any) -> None:
        self._steps[worlds] = 0
        for columns in (*self._sums.values(), *self._contacts.values()):
            columns[..., worlds] = 0.0

    def add(self, places: Sequence[int], readings: Column, worlds: Column) -> None:
        """Add the readings of these worlds (worlds, engine steps, sensor data); `places` are those of the
        sensors in the data, in the order of their numbers."""
        self._steps[worlds] += readings.shape[1]
        for number, sums in self._sums.items():
            data = readings[..., places[number] :]
            if len(sums) == 1:
                # The fields of a slot: the number of contacts, and the force with the normal first.
                counts, forces = data[..., : 4 * FORCE_SLOTS].reshape(*data.shape[:2], FORCE_SLOTS, 4).T[:2]
                most = np.maximum(self._contacts[number][worlds], counts[0].max(axis=0))
                self._contacts[number][worlds] = most
                forces = np.where(counts > 0.0, forces, 0.0)
                total = np.zeros(forces.shape[1:])
                for force in forces:  # in the order of contacts, as a single world does
                    total += force
                steps = total[:, None]
            else:
                steps = data[..., : len(sums)].transpose(1, 2, 0)
            for step in steps:
                sums[:, worlds] += step

    def mean(self, number: int) -> Column:
        """Return the means of a sensor, of shape (components, worlds)."""
        means: Column = self._sums[number] / np.maximum(self._steps, 1)
        return means

    def contacts(self, number: int) -> Column:
        return self._contacts[number]


class BatchReaders(BatchState):
    """The readers of `MuJoCoBatch`, which builds the batch and has the members."""

    members: Sequence[EngineProxy]
    _batch: Any
    _built: int

    def __init__(self, world: WorldModel, count: int) -> None:
        """Create a batch, whose worlds are stepped by as many threads as there are cores for this process, or
        by fewer that have enough to do."""
        self.builder = ModelBuilder(world)
        self.single = MuJoCoEngine(world, self.builder)
        self.actuators = self.single.motors.actuators
        self._world = self.single._world
        self.nominal = copy(self._world.model)  # a deep copy: MuJoCo's models copy their arrays
        self.count = count
        # A thread that has less to do takes more time to start: 16 carts on rails need 45 us, 100 us with two.
        work = count * (self.nominal.nv + self.nominal.npair // 2)
        self._threads = min(available_cores(), count, max(1, work // WORK_OF_A_THREAD))
        self._remembered = self._world.memory()
        self._first_memory = self._remembered
        self._memories = [self._remembered] * count
        """The memory of the shared engine besides the state, for each world: the bodies that are present,
        colors, light."""
        self.armature, self.inverse_inertia = (
            np.tile(values, (count, 1)) for values in (self.nominal.dof_armature, self.nominal.dof_invweight0)
        )
        self._sensors: dict[Sensor, int] = {}
        """The sensors of the model by number, which is also their column in `touched`."""
        self.touched = np.zeros((count, 0), bool)
        self._force_means = ForceMeans(count)
        self._outputs: dict[str, Column] = {}
        """The arrays that a step computes and that are read after it."""
        self._columns: dict[Any, Column] = {}
        self._observer = Observer(self, self._threads)

    def _column(self, key: Any, part: Callable[[], Column]) -> Column:
        """Return a part of an array of all worlds with a column per world. Each step creates new columns, so
        earlier readings do not change."""
        column = self._columns.get(key)
        if column is None:
            rows = part()
            column = self._columns[key] = np.array(rows.reshape(self.count, -1).T, order="C")
            column.flags.writeable = False  # several readers share it
        return column

    def _state_columns(self, name: str) -> Column:
        return self._column(name, lambda: self._batch.bind(name))

    def _observed(self, name: str, number: int) -> Column:
        """Return an array of a link in the present state of the worlds."""
        return self._column((name, number), lambda: self._observer.read(name)[:, number])

    def _keep_output(self, name: str) -> None:
        """Read an array after each step; a reset sets it to 0."""
        self._outputs[name] = self._batch.bind(name)
        self._outputs[name].flags.writeable = True

    def joint_states(self, robot: str, joints: Sequence[str]) -> Callable[[], Any]:
        numbers = list(self.single.joint_numbers(robot, joints))
        positions, velocities = (
            adr[numbers].tolist() for adr in (self.nominal.jnt_qposadr, self.nominal.jnt_dofadr)
        )

        def read() -> Any:
            qpos, qvel = self._state_columns("qpos"), self._state_columns("qvel")
            return tuple(
                (qpos[position], qvel[velocity])
                for position, velocity in zip(positions, velocities, strict=True)
            )

        return read

    def joint_torques(self, robot: str, joints: Sequence[str]) -> Callable[[], Any]:
        """See `motors.Motors.torques`."""
        numbers = list(self.single.joint_numbers(robot, joints))
        dofs = self.nominal.jnt_dofadr[numbers]
        for name in ("qfrc_actuator", "qacc"):
            self._keep_output(name)

        def read() -> Any:
            armature = self._column("dof_armature", lambda: self.rows["dof_armature"])[dofs]
            added = armature - self.armature[:, dofs].T
            torques = self._state_columns("qfrc_actuator")[dofs] - added * self._state_columns("qacc")[dofs]
            ranges = self.rows["jnt_actfrcrange"][:, numbers]
            return np.minimum(np.maximum(torques, ranges[..., 0].T), ranges[..., 1].T)

        return read

    def joint_wrench(self, part: Part) -> Callable[[], Column]:
        """See `Engine.joint_wrench`."""
        link = link_number(self.single.pool(part[0]).current, part[1])
        force, torque = (
            self._sensor_number(Sensor((link, False), None, kind)) for kind in ("joint_force", "joint_torque")
        )
        return lambda: np.stack([self._reading(force, 3), self._reading(torque, 3)])

    def pose(self, body: str, link: str | None = None) -> Callable[[], Any]:
        form_and_link = self.form_and_link(body, link)
        if form_and_link is None:
            return self._read_each(lambda member: member.pose(body, link))
        form, number = form_and_link
        if number == form.root_id and form.position_index >= 0:
            at = form.position_index

            def read_free() -> Any:
                px, py, pz, w, x, y, z = self._state_columns("qpos")[at : at + 7]
                return (px, py, pz), (x, y, z, w)

            return read_free

        def read() -> Any:
            w, x, y, z = self._observed("xquat", number)
            return tuple(self._observed("xpos", number)), (x, y, z, w)

        return read

    def velocity(self, body: str, link: str | None = None) -> Callable[[], Any]:
        form_and_link = self.form_and_link(body, link)
        if form_and_link is None:
            return self._read_each(lambda member: member.velocity(body, link))
        form, number = form_and_link
        if number == form.root_id and form.position_index >= 0:
            pose = self.pose(body, link)
            at = form.velocity_index

            def read_free() -> Any:
                numbers = self._state_columns("qvel")[at : at + 6]
                return tuple(numbers[:3]), frames.rotate(pose()[1], tuple(numbers[3:]))

            return read_free
        root = int(self.nominal.body_rootid[number])

        def read() -> Any:
            """Read the velocity of the link's origin from that of the body at the center of mass of its tree,
            in the order of `MuJoCoEngine._velocity`, so that both round alike."""
            wx, wy, wz, vx, vy, vz = self._observed("cvel", number)
            px, py, pz = self._observed("xpos", number) - self._observed("subtree_com", root)
            return (vx + wy * pz - wz * py, vy + wz * px - wx * pz, vz + wx * py - wy * px), (wx, wy, wz)

        return read

    def angular_momentum(self, robot: str) -> Callable[[], Column]:
        """See `Engine.angular_momentum`."""
        body = self.single.pool(robot).current
        links = list(body.links.values())

        def read() -> Column:
            masses, moments = (
                self.rows[name][:, links] if name in self.rows else getattr(self.nominal, name)[None, links]
                for name in ("body_mass", "body_inertia")
            )
            velocities = self._observer.read("cvel")[:, links]
            positions, axes = (self._observer.read(name)[:, links] for name in ("xipos", "ximat"))
            origins = self._observer.read("subtree_com")[:, body.root_id]
            motions = LinkMotions(masses, moments, positions, axes, velocities, origins)
            return motions.angular_momentum().T

        return read

    def motion(self, body: str, link: str | None = None) -> Callable[[], Any]:
        pose = self.pose(body, link)
        velocity = self.velocity(body, link)
        return lambda: (pose(), velocity())

    def contact(
        self, one: Part, others: Sequence[Part] | None = None, *, ground: bool = True
    ) -> Callable[[], Column]:
        """See `Engine.contact`."""
        links = self._links(one)
        met: list[tuple[int, bool] | None] = [None]
        if others is not None or not ground:
            others = self.single.others(one[0], ground=False) if others is None else others
            met = [link for part in others for link in self._links(part)]
        columns = [self._sensor_number(Sensor(link, target)) for link in links for target in met]
        return lambda: cast("Column", self.touched[:, columns].any(axis=1))

    def contact_force(self, one: Part) -> Callable[[], Column]:
        """See `Engine.contact_force`."""
        numbers = [self._sensor_number(Sensor(link, None, "forces")) for link in self._links(one)]
        for number in numbers:
            self._force_means.include(number, 1)

        def read() -> Column:
            total = np.zeros(self.count)
            for number in numbers:
                contacts = self._force_means.contacts(number)
                if (contacts > FORCE_SLOTS).any():
                    where = (
                        f"world {int(contacts.argmax())}: a link of '{one[0]}' has"
                        f" {int(contacts.max())} contacts"
                    )
                    raise EngineError(
                        f"{where}, but a batch supports at most {FORCE_SLOTS}; simplify its collision shapes"
                    )
                total += self._force_means.mean(number)[0]
            return total

        return read

    def contact_force_vector(self, one: Part) -> Callable[[], Column]:
        """See `Engine.contact_force_vector`."""
        body = self.single.pool(one[0]).current
        links = self._links(one)
        if one[1] is None and body.self_collision:  # forces between its own links then cancel
            links = [(number, False) for number in body.links.values()]
        numbers = [self._sensor_number(Sensor(link, None, "force")) for link in links]
        for number in numbers:
            self._force_means.include(number, 3)

        def read() -> Column:
            total = np.zeros((3, self.count))
            for number in numbers:  # the force of the link on the others
                total -= self._force_means.mean(number)
            return total

        return read

    def _reading(self, number: int, width: int) -> Column:
        """Return the reading of a sensor in the last step, of shape (width, worlds); 0 before the first
        one."""
        if self._built != len(self._sensors):
            return np.zeros((width, self.count))
        at = self._batch.model.sensor_adr[number]
        reading: Column = self._outputs["sensordata"][:, at : at + width].T
        return reading

    def clearance(self, one: Part, other: Part) -> Callable[[], Column]:
        """See `Engine.clearance`."""
        self.single.clearance(one, other)  # raises where there is none
        pools = [self.single.pool(name) for name, _ in (one, other)]
        if any(len(list(pool)) > 1 for pool in pools):
            return self._read_each(lambda member: member.clearance(one, other))
        first_geoms, second_geoms = (
            pool.current.geoms_of(part[1]) for pool, part in zip(pools, (one, other), strict=True)
        )
        kinds = self.nominal.geom_type
        pairs = [(a, b) for a in first_geoms for b in second_geoms if ELLIPSOID not in (kinds[a], kinds[b])]
        # MuJoCo takes no pair of a geom with itself, as between a robot and one of its links.
        numbers = self._observer.distances([(a, b) for a, b in pairs if a != b])
        nearest = 0.0 if any(a == b for a, b in pairs) else MAX_CLEARANCE_M
        absent = [
            index for index, pool in enumerate(self._world.pools.values()) if pool.pooled and pool in pools
        ]

        def read() -> Column:
            # `nearest` stands for bodies without a pair of geoms, such as those that are only seen.
            apart = self._observer.read("sensordata")[:, numbers].min(axis=1, initial=nearest)
            apart = np.where(apart < MAX_CLEARANCE_M, np.maximum(0.0, apart), inf)
            for index in absent:
                apart[[not memory[0][index][0] for memory in self._memories]] = inf
            return apart

        return read

    def rays(
        self, part: Part, rays: Sequence[Frame], reach: float, *, upright: bool = False
    ) -> Callable[[], Column]:
        """See `Engine.rays`."""
        form_and_link = self.form_and_link(*part)
        if form_and_link is None:
            return self._read_each(lambda member: member.rays(part, rays, reach, upright=upright))
        form, link = form_and_link
        starts = np.array([origin for origin, _ in rays])
        ways = np.array([frames.rotate(rotation, (1.0, 0.0, 0.0)) for _, rotation in rays])
        geoms = form.geoms_of(None)

        def read() -> Column:
            """Cast the rays of all worlds in one call, which takes a quarter of the time of a call for each
            ray."""
            matrix = self._observed("xmat", link).T.reshape(-1, 3, 3)
            axes = level_axes(matrix[:, 0, 0], matrix[:, 1, 0]) if upright else matrix
            axes = axes.transpose(0, 2, 1)
            position = self._observed("xpos", link).T
            free = self._observer.cast(position[:, None] + starts @ axes, ways @ axes, geoms)
            return np.where((free < 0.0) | (free > reach), reach, free).T

        return read

    def _sensor_number(self, sensor: Sensor) -> int:
        """Return the number of a sensor, after it is added if it is new."""
        if sensor not in self._sensors:
            self._sensors[sensor] = len(self._sensors)
            self.touched = np.hstack([self.touched, np.zeros((self.count, 1), bool)])
        return self._sensors[sensor]

    def _links(self, part: Part) -> list[tuple[int, bool]]:
        """Return the links of a part in all its forms, and whether the links that they carry belong to it."""
        pool = self.single.pool(part[0])
        self.single.geoms_of(part)  # raises where the part does not exist
        if part[1] is None and part[0] != GROUND:
            return [(body.root_id, True) for body in pool]
        return [(link_number(body, part[1]), False) for body in pool]

    def form_and_link(self, body: str, link: str | None) -> tuple[Body, int] | None:
        """Return the form of a body and the number of the link; None if it has several forms."""
        pool = self.single.pool(body)
        return (pool.current, link_number(pool.current, link)) if len(list(pool)) == 1 else None

    def _read_each(self, bind: Callable[[EngineProxy], Callable[[], Any]]) -> Callable[[], Any]:
        """Return a reader that reads the members in turn, for bodies with several forms."""
        readers = [bind(member) for member in self.members]

        def read() -> Any:
            values = [reader() for reader in readers]
            if isinstance(values[0], tuple):
                return tuple(np.array(part).T for part in zip(*values, strict=True))
            return np.array(values).T

        return read
