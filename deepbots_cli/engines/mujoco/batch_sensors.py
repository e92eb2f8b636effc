"""The sensors that a batch adds to its model, and `Observer`: links, rays and distances of all worlds."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from copy import copy
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

from mujoco.batch import Batch

from deepbots_cli.engines.mujoco import mujoco as mj
from deepbots_cli.engines.mujoco.model import HIDDEN_GROUP, ModelBuilder
from deepbots_cli.engines.mujoco.state import VARIED_ARRAYS
from deepbots_cli.engines.mujoco.surfaces import MAX_CLEARANCE_M

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from deepbots_cli.engines.mujoco.batch import MuJoCoBatch

    Column = NDArray[Any]

OBSERVED_FIELDS = ("geom_group", "body_mass", "body_ipos", "body_subtreemass")
"""The arrays of a model that positions, velocities and rays depend on."""
FORCE_SLOTS = 32
"""Contacts of a link whose forces a batch adds up."""
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

    def __init__(self, batch: MuJoCoBatch, threads: int) -> None:
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
