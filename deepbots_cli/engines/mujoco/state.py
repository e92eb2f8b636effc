"""The state of a world, what is derived from it when somebody asks, and the values that an episode varies.

After `mj_step`, MuJoCo's positions of links, velocities and contacts are those of the state before the step. Therefore joints and
free root links are read from the state itself, and positions and velocities of other links are computed from it once, when they are first
asked for. Contacts and forces are those of the last step, which is what the port promises.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from math import atan2, exp, pi, sqrt
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from deepbots_cli.engines.mujoco import mujoco as mj
from deepbots_cli.engines.mujoco.model import IMPEDANCE, SOLID, Body
from deepbots_cli.engines.objects import Pool, find
from deepbots_cli.errors import EngineError

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from deepbots_cli.program.world import EngineParameter, WorldModel

    FloatArray = NDArray[np.float64]

WHOLE = int(mj.mjtState.mjSTATE_INTEGRATION)
VARIED = (
    *("body_mass", "body_inertia", "body_subtreemass", "body_invweight0", "body_gravcomp"),
    *("dof_invweight0", "dof_M0", "dof_damping", "dof_frictionloss", "dof_armature", "jnt_actfrclimited", "jnt_actfrcrange"),
    *("actuator_biasprm", "actuator_forcelimited", "actuator_forcerange", "actuator_acc0"),
    *("geom_group", "pair_friction", "pair_dim", "pair_solref", "pair_solimp"),
)
"""The arrays of a model that an episode may change, and those that follow from them."""
LATERAL, SPINNING, ROLLING, RESTITUTION = range(4)
_SURFACE = {"lateral_friction": LATERAL, "spinning_friction": SPINNING, "rolling_friction": ROLLING, "restitution": RESTITUTION}
BOUNCE_STEPS, BOUNCE_TIME = (6.0, 16.0), 0.016
"""Engine steps and time (s) that a bounce takes: the time, as far as the steps allow.

A longer bounce keeps its restitution better and sinks deeper. Of 0.8, 0.79 to 0.81 is left at steps of 1 ms, and 0.77 to 0.85 at 4 ms and
at 16 ms, by how far a ball sinks before the first step sees it.
"""
RIGID = 0.99  # the impedance of a bounce: the share of its spring that the solver applies
Force = tuple[int, int, float]
"""Two geoms that touch, and the normal force between them in N."""


class WorldSnapshot(NamedTuple):
    """A snapshot."""

    state: FloatArray
    varied: list[Any]
    mean_inertia: float
    exerted: FloatArray
    accelerations: FloatArray
    forces: Sequence[Force]
    memory: tuple[Any, ...]


class World:
    """A model with its state. `posed` and `timed` say whether positions and velocities of links are those of the state."""

    def __init__(self, model: Any, world: WorldModel, pools: Sequence[Pool[Body]]) -> None:
        self.model, self.data, self.spare = model, mj.MjData(model), mj.MjData(model)
        self.pools = {pool.name: pool for pool in pools}
        self.closed = self.posed = self.timed = self.pushed = False
        self.colours: dict[tuple[str, str], Sequence[float]] = {}
        self.light = self._usual_light = world.light
        self._forces: Sequence[Force] | None = ()
        self._heavy = self._rough = True
        self.unsettled = True
        self.memories: list[tuple[Callable[[], object], Callable[[Any], object]]] = []
        """How to read and to write what others remember of an episode; a reset restores what they remembered at first."""
        self.surfaces = np.zeros((model.ngeom, 4))
        for pool in pools:
            for body in pool:
                for link, geoms in body.geoms.items():
                    rubs = body.model.link(link).friction
                    lateral = 1.0 if rubs.lateral is None else rubs.lateral
                    self.surfaces[geoms] = (lateral, rubs.spinning or 0.0, rubs.rolling or 0.0, rubs.restitution or 0.0)
                body.on_entrance = self._enter
        self._homes = model.qpos0.copy(), np.array(self.data.mocap_pos), np.array(self.data.mocap_quat)
        """Positions of joints and of bodies at the beginning of an episode."""
        for body in (body for pool in pools for body in pool):
            position, (x, y, z, w) = body.home
            if body.mocap >= 0:
                self._homes[1][body.mocap], self._homes[2][body.mocap] = position, (w, x, y, z)
            elif body.position >= 0:
                self._homes[0][body.position : body.position + 7] = (*position, w, x, y, z)
        model.dof_simplenum[:] = 0  # MuJoCo would take the inertia of simple bodies from `dof_M0`; motors change `dof_armature`
        self._varied = [model.opt.gravity, self.surfaces, *(getattr(model, name) for name in VARIED)]
        self._usual = [np.array(values) for values in self._varied]
        self.settle()
        self._fresh = self._keep_values()

    # What is derived

    def pose(self) -> None:
        """Let positions of links be those of the state."""
        if not self.posed:
            mj.mj_kinematics(self.model, self.data)
            self.posed = True

    def motion(self) -> None:
        """Let positions and velocities of links be those of the state."""
        if not self.timed:
            self.pose()
            mj.mj_comPos(self.model, self.data)
            mj.mj_comVel(self.model, self.data)
            self.timed = True

    def changed(self) -> None:
        self.posed = self.timed = False

    def stepped(self) -> None:
        self.posed = self.timed = False
        self._forces = None

    @property
    def forces(self) -> Sequence[Force]:
        """What touched in the last engine step."""
        if self._forces is None:
            contact, exerted = self.data.contact, self.data.efc_force.tolist()
            pairs = zip(contact.geom.tolist(), contact.efc_address.tolist(), strict=True)
            self._forces = [(one, other, exerted[place] if place >= 0 else 0.0) for (one, other), place in pairs]
        return self._forces

    # Course of an episode

    def reset(self) -> None:
        mj.mj_resetData(self.model, self.data)
        data = self.data
        self._restore_values(*self._fresh)
        self.light = self._usual_light
        self.colours.clear()
        for pool in self.pools.values():
            pool.leave()
        data.qpos[:], data.mocap_pos[:], data.mocap_quat[:] = self._homes
        self.changed()
        self._forces, self.pushed = (), False

    def settle(self) -> None:
        """Compute what follows from values that were set.

        Raises:
            EngineError: The world was closed.
        """
        self.open()
        if self._heavy:
            mj.mj_setConst(self.model, self.spare)
        if self._rough:
            self._rub()
        self._heavy = self._rough = self.unsettled = False

    def open(self) -> World:
        if self.closed:
            raise EngineError("this world was closed")
        return self

    def close(self) -> None:
        self.closed = self.unsettled = True

    def keep(self) -> WorldSnapshot:
        if self.unsettled:
            self.settle()
        state = np.empty(mj.mj_stateSize(self.model, WHOLE))
        mj.mj_getState(self.model, self.data, state, WHOLE)
        pools = tuple((pool.present, pool.chosen) for pool in self.pools.values())
        memory = (pools, dict(self.colours), self.light, *(read() for read, _ in self.memories))
        data = self.data
        return WorldSnapshot(state, *self._keep_values(), data.qfrc_actuator.copy(), data.qacc.copy(), self.forces, memory)

    def restore(self, kept: WorldSnapshot) -> None:
        self.open()
        self._restore_values(kept.varied, kept.mean_inertia)
        mj.mj_resetData(self.model, self.data)
        mj.mj_setState(self.model, self.data, kept.state, WHOLE)
        self.data.qfrc_actuator[:], self.data.qacc[:] = kept.exerted, kept.accelerations
        pools, colours, light, *memories = kept.memory
        self.colours, self.light = dict(colours), light
        for pool, (present, chosen) in zip(self.pools.values(), pools, strict=True):
            pool.present, pool.chosen = present, chosen
        for (_, write), memory in zip(self.memories, memories, strict=False):
            write(memory)
        self.changed()
        self._forces, self.pushed = kept.forces, bool(self.data.xfrc_applied.any())

    def _keep_values(self) -> tuple[list[Any], float]:
        return [np.array(values) for values in self._varied], self.model.stat.meaninertia

    def _restore_values(self, varied: list[Any], mean_inertia: float) -> None:
        for values, kept in zip(self._varied, varied, strict=True):
            values[...] = kept
        self.model.stat.meaninertia = mean_inertia
        self._heavy = self._rough = False
        self.unsettled = self.closed

    def _enter(self, body: Body) -> None:
        """A pooled body is placed: it has weight, and rays meet it."""
        self.model.geom_group[body.of(None)] = SOLID
        self.model.body_gravcomp[list(body.links.values())] = 0.0

    # Values of an episode

    def set(self, what: EngineParameter, of: tuple[str, ...], values: Sequence[float]) -> None:
        """See `Engine.set_parameter`."""
        self.unsettled = True
        match what:
            case "gravity":
                self.model.opt.gravity[:] = values
            case "light":
                (self.light,) = values
            case "joint_damping" | "joint_friction":
                body = self.body(of[0])
                dof = self.model.jnt_dofadr[find(body.joints, of[1], f"'{of[0]}' has no joint")]
                (self.model.dof_damping if what == "joint_damping" else self.model.dof_frictionloss)[dof] = values[0]
            case _:
                body = self.body(of[0])
                link = of[1] or body.model.root
                place = find(body.links, link, f"'{of[0]}' has no link")
                if what == "colour":
                    self.colours[of[0], link] = values
                elif what == "mass":
                    self._weigh(body, place, values[0])
                else:
                    self.surfaces[body.geoms[link], _SURFACE[what]] = values[0]
                    self._rough = True

    def body(self, name: str) -> Body:
        return find(self.open().pools, name, "the world has no body").chosen

    def _weigh(self, body: Body, link: int, mass: float) -> None:
        """The inertia scales with the mass. The base of a fixed body keeps its mass, which means nothing."""
        if body.fixed and link == body.root:
            return
        masses, moments = (self._usual[2 + VARIED.index(name)] for name in ("body_mass", "body_inertia"))
        usual = float(masses[link])
        if not (usual > 0.0 and mass > 0.0):
            raise EngineError(f"the mass of a link of '{body.name}' cannot go from {usual:g} kg to {mass:g} kg")
        self.model.body_mass[link] = mass
        self.model.body_inertia[link] = moments[link] * (mass / usual)
        self._heavy = True

    def _rub(self) -> None:
        """Friction and restitution of all pairs.

        Friction and restitution are products; of spinning and rolling friction each side counts with the friction of the other. This is how
        PyBullet combines them.
        """
        model = self.model
        one, other = self.surfaces[model.pair_geom1].T, self.surfaces[model.pair_geom2].T
        sliding = one[LATERAL] * other[LATERAL]
        spinning, rolling = (one[kind] * other[LATERAL] + other[kind] * one[LATERAL] for kind in (SPINNING, ROLLING))
        model.pair_friction[:] = np.stack([sliding, sliding, spinning, rolling, rolling], axis=1)
        model.pair_dim[:] = np.where(rolling > 0.0, 6, np.where(spinning > 0.0, 4, np.where(sliding > 0.0, 3, 1)))
        model.pair_solref[:], model.pair_solimp[:] = (self._usual[2 + VARIED.index(name)] for name in ("pair_solref", "pair_solimp"))
        bounces = one[RESTITUTION] * other[RESTITUTION]
        for place in np.flatnonzero(bounces > 0.0):
            model.pair_solref[place] = spring(float(bounces[place]), model.opt.timestep)
            model.pair_solimp[place] = (RIGID, RIGID, *IMPEDANCE[2:])

    def require_finite(self) -> None:
        """Raises: EngineError: A pose or joint is not finite; names the body."""
        data = self.open().data
        if np.isfinite(data.qpos.sum() + data.qvel.sum() + data.mocap_pos.sum()):
            return
        robots_first = reversed(self.pools.values())  # to objects they spread what is not a number
        for body in (pool.chosen for pool in robots_first):
            joints = list(body.joints.values())
            places, speeds = self.model.jnt_qposadr[joints], self.model.jnt_dofadr[joints]
            states: Iterable[tuple[str, FloatArray]] = (("joints", data.qpos[places]), ("joints", data.qvel[speeds]))
            if body.position >= 0:
                pose, speed = data.qpos[body.position : body.position + 7], data.qvel[body.velocity : body.velocity + 6]
                states = (("pose", pose), ("pose", speed), *states)
            for what, values in states:
                if not np.isfinite(values).all():
                    raise EngineError(f"the {what} of '{body.name}' left the range of numbers")


def spring(restitution: float, step: float) -> tuple[float, float]:
    """Stiffness and damping of a contact, per mass and negative as MuJoCo takes them, which give this share of the speed back.

    A damped spring that lets go when it exerts nothing keeps exp(-z / s * (pi - atan2(2 z s, s^2 - z^2))) with the damping ratio z and
    s = sqrt(1 - z^2); see Schwager and Poeschel, Granular Matter 9 (2007). Nothing bounces by less than exp(-2) here.
    """
    low, high = 0.0, 1.0 - 1e-9
    for _ in range(60):
        ratio = (low + high) / 2
        rest = sqrt(1.0 - ratio * ratio)
        kept = exp(-ratio / rest * (pi - atan2(2 * ratio * rest, rest * rest - ratio * ratio)))
        low, high = (ratio, high) if kept > restitution else (low, ratio)
    duration = min(max(BOUNCE_TIME, BOUNCE_STEPS[0] * step), BOUNCE_STEPS[1] * step)
    rate = pi / (duration * max(sqrt(1.0 - low * low), 0.5))
    return -rate * rate, -2.0 * low * rate
