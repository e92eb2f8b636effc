"""The state of a world, the values that are derived from it on demand, and the values that an episode varies.

After `mj_step`, MuJoCo's positions of links, velocities and contacts are those of the state before the step.
Therefore joints and free root links are read from the state itself, and positions and velocities of other
links are computed from it once, on first use. Contacts and forces are those of the last step, as the port
requires.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping, Sequence
from math import atan2, exp, inf, isfinite, pi, sqrt
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import numpy as np

from deepbots_cli import frames
from deepbots_cli.engines.mechanics import JointSpeed, Pool, fastest, named, require_possible
from deepbots_cli.engines.mujoco import mujoco as mj
from deepbots_cli.engines.mujoco.model import CONTACT_IMPEDANCE, SOLID_GROUP, Body, ModelBuilder
from deepbots_cli.errors import EngineError
from deepbots_cli.port import ZERO_VECTOR

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from deepbots_cli.frames import Quaternion, Triple
    from deepbots_cli.program.world import EngineParameter, WorldModel
    from deepbots_cli.robots.model import Mimic

    FloatArray = NDArray[np.float64]
    JointPlace = tuple[int, int, Mimic | None]
    """The places of a joint in `qpos` and `qvel`, and how it follows the joint that is set; None for itself."""

FULL_STATE = int(mj.mjtState.mjSTATE_INTEGRATION)
VARIED_ARRAYS = (
    *("body_mass", "body_inertia", "body_ipos"),
    *("body_subtreemass", "body_invweight0", "body_gravcomp"),
    *(
        "dof_invweight0",
        "dof_M0",
        "dof_damping",
        "dof_frictionloss",
        "dof_armature",
        "jnt_actfrclimited",
        "jnt_actfrcrange",
    ),
    *("actuator_biasprm", "actuator_forcelimited", "actuator_forcerange", "actuator_acc0"),
    *("geom_group", "pair_friction", "pair_dim", "pair_solref", "pair_solimp"),
)
"""The arrays of a model that an episode may change, and the arrays computed from them."""
MASS, OWN = range(2)
"""The factors on the inertia of a link: that of its mass, and its own."""
LATERAL, SPINNING, ROLLING, RESTITUTION = range(4)
_SURFACE = {
    "lateral_friction": LATERAL,
    "spinning_friction": SPINNING,
    "rolling_friction": ROLLING,
    "restitution": RESTITUTION,
}
BOUNCE_STEPS, BOUNCE_TIME = (6.0, 16.0), 0.016
"""The duration of a bounce in engine steps and in s: the time, as far as the steps allow.

A longer bounce keeps its restitution better and sinks deeper. Of 0.8, 0.79 to 0.81 is left at steps of 1 ms,
and 0.77 to 0.85 at 4 ms and at 16 ms, by how far a ball sinks before the first step sees it.
"""
BOUNCE_IMPEDANCE = 0.99  # the impedance of a bounce: the share of its spring that the solver applies


class BatchState(ABC):
    """What motors and observers read and write of a batch, which sets these attributes: arrays with a row per
    world, and the fields of the model that differ between worlds."""

    builder: ModelBuilder
    nominal: Any
    count: int
    actuators: Mapping[int, int]
    """The actuator of each joint."""
    state: FloatArray
    ctrl: FloatArray
    qpos: FloatArray
    qvel: FloatArray
    rows: dict[str, NDArray[Any]]
    armature: FloatArray
    inverse_inertia: FloatArray
    """`dof_armature` and `dof_invweight0` of each world without the part that velocity motors add."""
    write_mask: NDArray[Any] | None = None
    """The worlds that motors are written in, as truth values; None for all."""
    has_commands = False
    """Whether members have commanded motors since the last step."""

    @abstractmethod
    def take_commands(self) -> None:
        """Copy the changes of members to the worlds, and their commands to the motors."""

    @abstractmethod
    def update_constants(self, worlds: NDArray[Any]) -> None:
        """Compute the values that depend on masses, in those of these worlds that have new ones."""


class StateRow(NamedTuple):
    """What `place_body` and `put_joint` write: arrays of `MjData`, or of one world of a batch."""

    qpos: FloatArray
    qvel: FloatArray
    qacc_warmstart: FloatArray
    mocap_pos: FloatArray
    mocap_quat: FloatArray


def place_body(
    data: StateRow,
    form: Body,
    position: Triple,
    orientation: Quaternion,
    velocity: Triple = ZERO_VECTOR,
    angular_velocity: Triple = ZERO_VECTOR,
) -> None:
    """Write the pose and the velocity of a body; see `Engine.place`."""
    rotation = x, y, z, w = frames.normalized(orientation)
    if form.mocap_index >= 0:
        data.mocap_pos[form.mocap_index] = position
        data.mocap_quat[form.mocap_index] = (w, x, y, z)
    elif form.position_index >= 0:
        data.qpos[form.position_index : form.position_index + 7] = (*position, w, x, y, z)
        # A free joint has its linear velocity in the world frame, its angular one in that of the link.
        data.qvel[form.velocity_index : form.velocity_index + 6] = (
            *velocity,
            *frames.rotate_back(rotation, angular_velocity),
        )
        # The accelerations are those of the motion before.
        data.qacc_warmstart[form.velocity_index : form.velocity_index + 6] = 0.0


def put_joint(data: StateRow, places: Sequence[JointPlace], position: float, velocity: float) -> None:
    """Write the position and velocity of a joint, and those of the joints that follow it."""
    for at, dof, mimic in places:
        data.qpos[at] = position if mimic is None else mimic.position(position)
        data.qvel[dof] = velocity if mimic is None else mimic.multiplier * velocity


class WorldSnapshot(NamedTuple):
    """A snapshot."""

    state: FloatArray
    values: list[Any]
    mean_inertia: float
    actuator_forces: FloatArray
    accelerations: FloatArray
    memory: tuple[Any, ...]


class MujocoWorld:
    """A model with its state. `has_positions` and `has_velocities` are true if positions and velocities of
    links are those of the state."""

    def __init__(self, model: Any, world: WorldModel, pools: Sequence[Pool[Body]]) -> None:
        self.model = model
        self.data = mj.MjData(model)
        self.scratch_data = mj.MjData(model)  # for computations that overwrite the state
        self.pools = {pool.name: pool for pool in pools}
        self.closed = self.has_positions = self.has_velocities = self.has_pushes = False
        self.colors: dict[tuple[str, str], Sequence[float]] = {}
        self.light = self._nominal_light = world.light
        self._mass_changed = self._friction_changed = True
        self.is_stale = True
        self.state_accessors: list[tuple[Callable[[], object], Callable[[Any], object]]] = []
        """The functions that read and write the memories of other objects in an episode; a reset restores
        their first values."""
        self.varying_centers = frozenset(
            body.links[link.name]
            for pool in pools
            for body in pool
            for link in body.model.links
            if link.center_varies
        )
        """The links whose center of mass an episode may move."""
        self._joints = {
            int(model.jnt_dofadr[number]): (body.name, body.model.joint(name))
            for pool in pools
            for body in pool
            for name, number in body.joints.items()
        }
        self.fastest = np.full(model.nv, inf)
        """The speeds that no motor and no fall gives the joints, rad/s or m/s."""
        for dof, (_, joint) in self._joints.items():
            self.fastest[dof] = fastest(joint)
        self._least_fastest = self.fastest.min(initial=inf)
        arrays = (self.data.qpos, self.data.qvel, self.data.mocap_pos.reshape(-1))
        self._coordinates: tuple[Any, ...] = tuple(map(memoryview, arrays))
        self._inertia_factors = np.ones((model.nbody, 2))
        self.armature = model.dof_armature.copy()
        """The armature of the present episode, to which velocity motors add."""
        self.inverse_inertia = model.dof_invweight0.copy()
        """`dof_invweight0` of the present episode, with that armature."""
        self.surfaces = np.zeros((model.ngeom, 4))
        for body in (body for pool in pools for body in pool):
            self._set_surfaces(body)
        self._initial_positions = (
            model.qpos0.copy(),
            np.array(self.data.mocap_pos),
            np.array(self.data.mocap_quat),
        )
        """The positions of joints and of bodies at the beginning of an episode."""
        for body in (body for pool in pools for body in pool):
            self._set_initial_position(body)
        # MuJoCo would take the inertia of simple bodies from `dof_M0`; motors change `dof_armature`.
        model.dof_simplenum[:] = 0
        self._varied_arrays = [
            model.opt.gravity,
            self.surfaces,
            *(getattr(model, name) for name in VARIED_ARRAYS),
            self._inertia_factors,
            self.armature,
            self.inverse_inertia,
        ]
        self._nominal = [np.array(values) for values in self._varied_arrays]
        self.update_constants()
        self._initial_values = self._copy_values()

    def _set_surfaces(self, body: Body) -> None:
        """Set the friction and restitution of the geoms of a body, as its model has them."""
        for link, geoms in body.geoms.items():
            rubs = body.model.link(link).friction
            lateral = 1.0 if rubs.lateral is None else rubs.lateral
            self.surfaces[geoms] = (
                lateral,
                rubs.spinning or 0.0,
                rubs.rolling or 0.0,
                rubs.restitution or 0.0,
            )

    def _set_initial_position(self, body: Body) -> None:
        """Set the position of a body, and of the joints that follow others, at the beginning of an
        episode."""
        joints, positions, orientations = self._initial_positions
        position, (x, y, z, w) = body.initial_pose
        if body.mocap_index >= 0:
            positions[body.mocap_index] = position
            orientations[body.mocap_index] = (w, x, y, z)
        elif body.position_index >= 0:
            joints[body.position_index : body.position_index + 7] = (*position, w, x, y, z)
        for follower, mimic in body.model.followers.items():
            joints[self.model.jnt_qposadr[body.joints[follower]]] = mimic.offset

    # Derived values

    def update_positions(self) -> None:
        """Compute the positions of links from the state."""
        if not self.has_positions:
            mj.mj_kinematics(self.model, self.data)
            self.has_positions = True

    def update_velocities(self) -> None:
        """Compute the positions and velocities of links from the state."""
        if not self.has_velocities:
            self.update_positions()
            mj.mj_comPos(self.model, self.data)
            mj.mj_comVel(self.model, self.data)
            self.has_velocities = True

    def invalidate(self) -> None:
        self.has_positions = self.has_velocities = False

    # Course of an episode

    def reset(self) -> None:
        mj.mj_resetData(self.model, self.data)
        data = self.data
        self._restore_values(*self._initial_values)
        self.light = self._nominal_light
        self.colors.clear()
        for pool in self.pools.values():
            pool.deactivate()
        data.qpos[:], data.mocap_pos[:], data.mocap_quat[:] = self._initial_positions
        self.invalidate()
        self.has_pushes = False

    def update_constants(self) -> None:
        """Compute the values that depend on the values that were set.

        Raises:
            EngineError: The world was closed.
        """
        self.require_open()
        if self.settle_values():
            model = self.model
            armature, inverse = model.dof_armature.copy(), model.dof_invweight0.copy()
            model.dof_armature[:] = self.armature
            # `mj_setConst` computes at the reference position, and leaves its data there.
            mj.mj_setConst(model, self.scratch_data)
            self.inverse_inertia[:] = model.dof_invweight0
            # A copy of a robot may drive its joints before the masses of the next copy are set.
            driven = armature != self.armature
            model.dof_armature[driven], model.dof_invweight0[driven] = armature[driven], inverse[driven]

    def settle_values(self) -> bool:
        """Compute the values that depend on all values that were set except masses; return whether masses
        were set."""
        if self._friction_changed:
            self._update_contact_pairs()
        has_new_masses = self._mass_changed
        self._mass_changed = self._friction_changed = self.is_stale = False
        return has_new_masses

    def require_open(self) -> MujocoWorld:
        if self.closed:
            raise EngineError("this world was closed")
        return self

    def close(self) -> None:
        self.closed = self.is_stale = True

    def snapshot(self) -> WorldSnapshot:
        if self.is_stale:
            self.update_constants()
        state = np.empty(mj.mj_stateSize(self.model, FULL_STATE))
        mj.mj_getState(self.model, self.data, state, FULL_STATE)
        memory = (*self.memory(), *(read() for read, _ in self.state_accessors))
        data = self.data
        return WorldSnapshot(
            state,
            *self._copy_values(),
            data.qfrc_actuator.copy(),
            data.qacc.copy(),
            memory,
        )

    def restore(self, snapshot: WorldSnapshot) -> None:
        self.require_open()
        self._restore_values(snapshot.values, snapshot.mean_inertia)
        mj.mj_resetData(self.model, self.data)
        mj.mj_setState(self.model, self.data, snapshot.state, FULL_STATE)
        # mjSTATE_INTEGRATION leaves these out; `Motors.torques` reads them before the next step.
        self.data.qfrc_actuator[:], self.data.qacc[:] = snapshot.actuator_forces, snapshot.accelerations
        # Not strict: readers that were bound after the snapshot have no memory in it.
        for (_, write), memory in zip(self.state_accessors, snapshot.memory[3:], strict=False):
            write(memory)
        self.remember(snapshot.memory[:3])
        self.invalidate()
        self.has_pushes = bool(self.data.xfrc_applied.any())

    def memory(self) -> tuple[Any, ...]:
        """Return the memory of an episode besides its state and the values of the model: the bodies that are
        present and their forms, colors, light."""
        return (
            tuple((pool.present, pool.current) for pool in self.pools.values()),
            dict(self.colors),
            self.light,
        )

    def remember(self, memory: tuple[Any, ...]) -> None:
        pools, colors, self.light = memory
        self.colors = dict(colors)
        for pool, (present, current) in zip(self.pools.values(), pools, strict=True):
            pool.present = present
            pool.current = current

    def _copy_values(self) -> tuple[list[Any], float]:
        return [np.array(values) for values in self._varied_arrays], self.model.stat.meaninertia

    def _restore_values(self, varied: list[Any], mean_inertia: float) -> None:
        for values, saved in zip(self._varied_arrays, varied, strict=True):
            values[...] = saved  # in place: motors and readers keep views of these arrays
        # MuJoCo's solver scales its tolerance by the mean inertia, which `mj_setConst` recomputes.
        self.model.stat.meaninertia = mean_inertia
        self._mass_changed = self._friction_changed = False
        self.is_stale = self.closed

    def show(self, body: Body) -> None:
        """Show a pooled body that is placed: it has weight, and rays meet it."""
        self.model.geom_group[body.geoms_of(None)] = SOLID_GROUP
        self.model.body_gravcomp[list(body.links.values())] = 0.0

    # Values of an episode

    def set_parameter(
        self, parameter: EngineParameter, owner: tuple[str, ...], values: Sequence[float]
    ) -> None:
        """See `Engine.set_parameter`."""
        self.is_stale = True
        match parameter:
            case "gravity":
                self.model.opt.gravity[:] = values
            case "light":
                (self.light,) = values
            case "joint_damping" | "joint_friction" | "joint_armature":
                self._set_joint(parameter, owner[0], owner[1], values[0])
            case _:
                body = self.body(owner[0])
                link = owner[1] or body.model.root
                number = named(body.links, link, f"'{owner[0]}' has no link")
                if parameter == "color":
                    self.colors[owner[0], link] = values
                elif parameter == "mass":
                    self._set_mass(body, number, values[0])
                elif parameter in ("inertia", "center_of_mass"):
                    self._set_inertial(parameter, body, number, values)
                else:
                    self.surfaces[body.geoms[link], _SURFACE[parameter]] = values[0]
                    self._friction_changed = True

    def body(self, name: str) -> Body:
        return named(self.require_open().pools, name, "the world has no body").current

    def _set_joint(
        self,
        parameter: Literal["joint_damping", "joint_friction", "joint_armature"],
        robot: str,
        joint: str,
        value: float,
    ) -> None:
        body = self.body(robot)
        model = self.model
        dof = model.jnt_dofadr[named(body.joints, joint, f"'{robot}' has no joint")]
        if parameter == "joint_damping":
            model.dof_damping[dof] = value
        elif parameter == "joint_friction":
            model.dof_frictionloss[dof] = value
        else:
            model.dof_armature[dof] = self.armature[dof] = value
            self._mass_changed = True

    def _set_mass(self, body: Body, link: int, mass: float) -> None:
        """Set the mass of a link, and scale its inertia. The base of a fixed body keeps its mass, which has
        no effect."""
        if body.fixed and link == body.root_id:
            return
        usual = float(self._nominal_values("body_mass")[link])
        if not (usual > 0.0 and mass > 0.0):
            raise EngineError(
                f"the mass of a link of '{body.name}' cannot go from {usual:g} kg to {mass:g} kg"
            )
        self.model.body_mass[link] = mass
        self._inertia_factors[link, MASS] = mass / usual
        self._update_inertia(link)

    def _set_inertial(
        self,
        parameter: Literal["inertia", "center_of_mass"],
        body: Body,
        link: int,
        values: Sequence[float],
    ) -> None:
        """Set the factor on the inertia of a link, or the offset of its center of mass. Neither has an effect
        on the base of a fixed body."""
        if body.fixed and link == body.root_id:
            return
        if parameter == "center_of_mass":
            self._move_center(body, link, values)
            return
        if not values[0] > 0.0:
            raise EngineError(f"the inertia of a link of '{body.name}' cannot be multiplied by {values[0]:g}")
        self._inertia_factors[link, OWN] = values[0]
        self._update_inertia(link)

    def _update_inertia(self, link: int) -> None:
        mass_factor, inertia_factor = self._inertia_factors[link].tolist()
        self.model.body_inertia[link] = (
            self._nominal_values("body_inertia")[link] * mass_factor * inertia_factor
        )
        self._mass_changed = True

    def _move_center(self, body: Body, link: int, offset: Sequence[float]) -> None:
        """Move the center of mass of a link by an offset (m, axes of the link)."""
        if link not in self.varying_centers:
            raise EngineError(
                f"the center of mass of a link of '{body.name}' is fixed; build the world with"
                " `center_varies` of the link"
            )
        self.model.body_ipos[link] = self._nominal_values("body_ipos")[link] + offset
        self._mass_changed = True

    def _nominal_values(self, name: str) -> FloatArray:
        return self._nominal[2 + VARIED_ARRAYS.index(name)]  # after gravity and surfaces

    def _update_contact_pairs(self) -> None:
        """Set the friction and restitution of all pairs.

        Friction and restitution are products; of spinning and rolling friction each side counts with the
        friction of the other. This is how PyBullet combines them.
        """
        model = self.model
        first, second = self.surfaces[model.pair_geom1].T, self.surfaces[model.pair_geom2].T
        sliding = first[LATERAL] * second[LATERAL]
        spinning, rolling = (
            first[kind] * second[LATERAL] + second[kind] * first[LATERAL] for kind in (SPINNING, ROLLING)
        )
        # In MuJoCo's order: sliding along both tangents, spinning, rolling about both tangents.
        model.pair_friction[:] = np.stack([sliding, sliding, spinning, rolling, rolling], axis=1)
        # The smallest dimension with all frictions of the pair: each further one adds a row for the solver.
        model.pair_dim[:] = np.where(
            rolling > 0.0, 6, np.where(spinning > 0.0, 4, np.where(sliding > 0.0, 3, 1))
        )
        model.pair_solref[:] = self._nominal_values("pair_solref")
        model.pair_solimp[:] = self._nominal_values("pair_solimp")
        bounces = first[RESTITUTION] * second[RESTITUTION]
        for index in np.flatnonzero(bounces > 0.0):
            model.pair_solref[index] = bounce_spring(float(bounces[index]), model.opt.timestep)
            model.pair_solimp[index] = (BOUNCE_IMPEDANCE, BOUNCE_IMPEDANCE, *CONTACT_IMPEDANCE[2:])

    def require_finite(self) -> None:
        """See `Engine.require_finite`."""
        data = self.require_open().data
        # A sum is finite only if each number is; an overflow of finite values leads to the full check below.
        # Sums in Python take 0.3 us for 8 numbers; those of numpy take 0.7 us, and warn of infinity.
        if isfinite(sum(map(sum, self._coordinates))):
            if max(map(abs, self._coordinates[1]), default=0.0) <= self._least_fastest:
                return  # without a closer look at each speed, which takes 4 us
            impossible = np.abs(data.qvel) > self.fastest
            if impossible.any():
                fast = np.flatnonzero(impossible).tolist()
                model = self.model
                # Servos have no limit of their actuator, but of their joint.
                springs = -model.actuator_biasprm[:, 1] * model.actuator_forcelimited
                stiffness = dict(zip(model.jnt_dofadr[model.actuator_trnid[:, 0]], springs, strict=True))
                speeds = (
                    JointSpeed(*self._joints[dof], data.qvel[dof], stiffness.get(dof, 0.0)) for dof in fast
                )
                require_possible(speeds, model.opt.timestep)
            return
        # Robots are checked first: objects get values that are not finite from them.
        robots_first = reversed(self.pools.values())
        for body in (pool.current for pool in robots_first):
            joints = list(body.joints.values())
            position_addresses = self.model.jnt_qposadr[joints]
            velocity_addresses = self.model.jnt_dofadr[joints]
            states: Iterable[tuple[str, FloatArray]] = (
                ("joints", data.qpos[position_addresses]),
                ("joints", data.qvel[velocity_addresses]),
            )
            if body.position_index >= 0:
                pose = data.qpos[body.position_index : body.position_index + 7]
                speed = data.qvel[body.velocity_index : body.velocity_index + 6]
                states = (("pose", pose), ("pose", speed), *states)
            for quantity, values in states:
                if not np.isfinite(values).all():
                    raise EngineError(f"the {quantity} of '{body.name}' became infinite or NaN")


class LinkMotions(NamedTuple):
    """Masses (kg), principal moments (kg m^2) and motions of the links of a robot in many worlds.

    The shapes are (worlds, links, ...): `places` and `axes` are those of the inertia, `velocities` those of
    MuJoCo's `cvel` at `origins`, of shape (worlds, 3).
    """

    masses: FloatArray
    moments: FloatArray
    places: FloatArray
    axes: FloatArray
    velocities: FloatArray
    origins: FloatArray

    def angular_momentum(self) -> FloatArray:
        """Return the angular momentum about the center of mass of all links, of shape (worlds, 3)."""
        masses = self.masses[..., None]
        turning = self.velocities[..., :3]
        axes = self.axes.reshape(*self.places.shape, 3)
        speeds = self.velocities[..., 3:] + np.cross(turning, self.places - self.origins[:, None])
        arms = self.places - self.places[:, :1]
        spins = np.einsum("wlij,wlj,wlkj,wlk->wli", axes, self.moments, axes, turning)
        about_root = (spins + masses * np.cross(arms, speeds)).sum(axis=1)
        first, flow = ((masses * part).sum(axis=1) for part in (arms, speeds))
        # From the center of the root link to that of the robot: L - r x p.
        momentum: FloatArray = about_root - np.cross(first, flow) / masses.sum(axis=1)
        return momentum


def bounce_spring(restitution: float, step: float) -> tuple[float, float]:
    """Return stiffness and damping of a contact, per mass and negative as MuJoCo takes them, which give this
    share of the speed back.

    A damped spring that lets go when it exerts nothing keeps exp(-z / s * (pi - atan2(2 z s, s^2 - z^2)))
    with the damping ratio z and s = sqrt(1 - z^2); see Schwager and Poeschel, Granular Matter 9 (2007).
    Nothing bounces by less than exp(-2) here.
    """
    low, high = 0.0, 1.0 - 1e-9
    for _ in range(60):  # 2^-60 is below the resolution of a float near 1
        ratio = (low + high) / 2
        root = sqrt(1.0 - ratio * ratio)
        rebound = exp(-ratio / root * (pi - atan2(2 * ratio * root, root * root - ratio * ratio)))
        low, high = (ratio, high) if rebound > restitution else (low, ratio)
    duration = min(max(BOUNCE_TIME, BOUNCE_STEPS[0] * step), BOUNCE_STEPS[1] * step)
    rate = pi / (duration * max(sqrt(1.0 - low * low), 0.5))
    return -rate * rate, -2.0 * low * rate
