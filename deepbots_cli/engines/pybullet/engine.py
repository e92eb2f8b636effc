"""One world in a PyBullet client of its own."""

from __future__ import annotations

import weakref
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from math import inf, isfinite
from typing import TYPE_CHECKING, Any, Literal, NamedTuple, ParamSpec, TypeVar

import numpy as np

from deepbots_cli import frames
from deepbots_cli.engines.mechanics import (
    JointSpeed,
    fastest,
    inverse_kinematics,
    named,
    require_possible,
    torque_curve,
)
from deepbots_cli.engines.pybullet import (
    BASE_LINK,
    DEFAULT_GAINS,
    NEGLIGIBLE_FORCE,
    loading,
    motors,
    state,
    surfaces,
)
from deepbots_cli.engines.pybullet import pybullet as p
from deepbots_cli.engines.pybullet.motors import Damping
from deepbots_cli.engines.pybullet.state import Parameters, ReadCache
from deepbots_cli.engines.pybullet.surfaces import Floor, brightened, downsampled
from deepbots_cli.errors import EngineError
from deepbots_cli.port import ZERO_VECTOR, CameraImage, Overlap
from deepbots_cli.program.world import GROUND

if TYPE_CHECKING:
    from deepbots_cli.engines.mechanics import Pool
    from deepbots_cli.engines.pybullet.state import Body
    from deepbots_cli.frames import Frame, Quaternion, Triple
    from deepbots_cli.port import (
        CameraReader,
        Capability,
        ClearanceReader,
        ContactReader,
        ForceReader,
        Gain,
        Image,
        JointReader,
        Kinematics,
        MotionReader,
        MotorWriter,
        Part,
        PoseReader,
        Pusher,
        RayReader,
        TorqueReader,
        VectorReader,
        VelocityReader,
        View,
        WrenchReader,
    )
    from deepbots_cli.program.world import EngineParameter, WorldModel

Callback = Callable[[], object]
P = ParamSpec("P")
R = TypeVar("R")


class Substeps(NamedTuple):
    """The functions that a step calls: `starts` once, then in each engine step `callbacks`, `drives`, the
    physics, and `monitors`.

    Drives are motors that renew their torque. They see the targets that the callbacks have just set.
    """

    starts: list[Callback]
    callbacks: list[Callback]
    drives: list[Callback]
    monitors: list[Callback]

    def stepper(self, client: int, now: list[int]) -> Callable[[int], None]:
        """Return `Engine.step`. Most worlds have none of these; checking for them costs 1 % of the
        cheapest step. `now` counts states of the world."""
        advance = p.stepSimulation
        starts, callbacks, drives, monitors = self

        def step(substeps: int) -> None:
            if starts or callbacks or drives or monitors:
                for start in starts:
                    start()
                for _ in range(substeps):
                    for callback in callbacks:
                        callback()
                    for drive in drives:
                        drive()
                    advance(client)
                    now[0] += 1
                    for update in monitors:
                        update()
            else:
                for _ in range(substeps):
                    advance(client)
                now[0] += 1

        return step


class Drives:
    """The springs and the damping of all robots with joints, which act in each engine step once they are
    set."""

    def __init__(self, substeps: Substeps) -> None:
        self.springs: dict[tuple[int, tuple[int, ...]], motors.Springs] = {}
        self.damping: dict[int, Damping] = {}
        self._substeps = substeps

    def add(self, springs: motors.Springs, body: int) -> MotorWriter:
        """Let springs renew their torques, in place of earlier ones on the same joints."""
        self.springs[body, springs.indices] = springs
        self._order()
        return springs.set_targets

    def damp(self, body: Body) -> Damping:
        """Return the damping of a robot, which acts from now on."""
        damping = self.damping[body.number]
        if damping.update not in self._substeps.starts:
            self._substeps.starts.append(damping.update)
            self._order()
        return damping

    def _order(self) -> None:
        """Let the damping follow the springs, whose torques it takes into account."""
        self._substeps.drives[:] = [
            *(springs.apply for springs in self.springs.values()),
            *(damping.apply for damping in self.damping.values() if damping.update in self._substeps.starts),
        ]

    def reset(self) -> None:
        for damping in self.damping.values():
            damping.reset()
        for springs in self.springs.values():
            springs.reset()


class PyBulletEngine:
    """One world: about 29 MB until it is closed or dropped, and its readers and writers with it."""

    name = "pybullet"
    capabilities: frozenset[Capability] = frozenset(
        {"contacts", "mimic", "rendering", "joint_wrench", "self_collision", "torque_curve"}
    )

    def __init__(self, world: WorldModel) -> None:
        self._client = loading.create_client(world)
        self._cache = ReadCache()
        self._substeps = Substeps([], [], [], [])
        # A finalizer has no reference to the engine, so that a dropped engine is released too.
        self._release = weakref.finalize(self, _release, self._client, self._substeps, self._cache)
        self.step = self._substeps.stepper(self._client, self._cache.generation)
        self._timestep = world.timestep / world.substeps
        self._floor = Floor(world.ground.color, world.lines) if world.ground and not world.terrain else None
        self._drives = Drives(self._substeps)
        self._contact_monitors: dict[int, surfaces.ContactMonitor] = {}
        self._force_monitors: dict[tuple[int, int], surfaces.ForceMonitor] = {}
        self._wrench_monitors: dict[tuple[int, int], motors.WrenchMonitor] = {}
        self._rays: surfaces.Rays | None = None
        self._backdrop: tuple[object, Image] | None = None
        try:
            self._pools: dict[str, Pool[Body]] = {
                pool.name: pool for pool in loading.bodies(self._client, world)
            }
            self._parameters = Parameters(self._client, world, self._pools, self._floor, self._drives.damp)
            bodies = [body for pool in self._pools.values() for body in pool]
            for body in bodies:
                if body.brakes:
                    self._drives.damping[body.number] = Damping(
                        self._client, body, self._timestep, self._drives.springs
                    )
                if any(joint.damping for joint in body.model.moving_joints):
                    self._drives.damp(body)
                stops = motors.Stops(self._client, body)
                if stops.ranges:
                    self._substeps.starts.append(stops.apply)
            self._moving = [body for body in bodies if not body.fixed or body.brakes]
            self._fixed = [body for body in bodies if body.fixed and not body.brakes]
            # `brakes` has the moving joints in this order.
            self._speed_limits = [
                (body, [fastest(joint) for joint in body.model.moving_joints])
                for body in bodies
                if body.brakes
            ]
            self._ground = [body.number for body in self._pools.get(GROUND, ())]
            loading.join_islands(self._client, self._pools.values())
            self.reset()
        except BaseException:  # also Ctrl-C: the client would stay in memory
            self.close()
            raise

    def reset(self) -> None:
        """See `Engine.reset`. A world with values that are not finite cannot be reset; it must be built
        again."""
        self._require_numbers()
        self._parameters.restore()
        self._drives.reset()
        for watch in self._contact_monitors.values():
            watch.reset()
        for monitor in self._force_monitors.values():
            monitor.reset()
        for wrench in self._wrench_monitors.values():
            wrench.reset()
        for pool in self._pools.values():
            pool.deactivate()
        for row, body in enumerate(self._moving, start=1):
            self._reset_body(
                body,
                ((row * loading.PARKING_SPACING_M, 0.0, loading.PARKING_SPACING_M), frames.IDENTITY_ROTATION),
                dict.fromkeys(body.brakes, NEGLIGIBLE_FORCE),
            )
        # All bodies are far apart in this step, so that the solver forgets the contacts of the past episode.
        # PyBullet removes only some of the pairs of bodies that are no longer close. In a pit, it lists those of
        # the terrain in another order from the third step on that the terrain was not entered anew.
        bodies = (*self._fixed, *self._moving)
        for body in bodies:
            loading.set_self_contact(self._client, body, is_on=False)
        p.stepSimulation(self._client)
        for body in bodies:
            body.forget_pairs()
        for body in bodies:
            loading.set_self_contact(self._client, body, is_on=True)
            self._reset_body(body, body.initial_pose, body.brakes)
        self._cache.invalidate()

    def _reset_body(self, body: Body, pose: Frame, brakes: dict[int, float]) -> None:
        """Put the center of a body at a pose, all of it at rest, with brakes of so many N m or N on its
        joints."""
        number = body.number
        client = self._client
        p.resetBasePositionAndOrientation(number, *pose, client)
        p.resetBaseVelocity(number, ZERO_VECTOR, ZERO_VECTOR, client)
        for index, brake in brakes.items():
            p.resetJointState(number, index, body.offsets.get(index, 0.0), 0.0, client)
            p.setJointMotorControl2(
                number, index, p.VELOCITY_CONTROL, 0.0, 0.0, brake, *DEFAULT_GAINS, client
            )

    def place(
        self,
        body: str,
        position: Triple,
        orientation: Quaternion,
        velocity: Triple = ZERO_VECTOR,
        angular_velocity: Triple = ZERO_VECTOR,
    ) -> None:
        form = self._pool(body).activate()
        pose = form.center_pose(position, frames.normalized(orientation))
        p.resetBasePositionAndOrientation(form.number, *pose, self._client)
        if form.fixed:  # PyBullet would keep a velocity with which nothing moves
            velocity = angular_velocity = ZERO_VECTOR
        # PyBullet has the velocity of the center of mass; a reset of the pose before sets it to 0.
        of_center = frames.add(velocity, frames.cross(angular_velocity, frames.subtract(pose[0], position)))
        p.resetBaseVelocity(form.number, of_center, angular_velocity, self._client)
        self._cache.invalidate()

    def set_joint(self, robot: str, joint: str, position: float, velocity: float) -> None:
        self._joints(robot, (joint,))
        self._pool(robot).current.set_joint(joint, position, velocity)
        self._cache.invalidate()

    def choose(self, body: str, variant: str) -> None:
        self._pool(body).choose(variant)

    def set_parameter(self, parameter: EngineParameter, owner: tuple[str, ...], *values: float) -> None:
        self._require_open()._parameters.set(parameter, owner, values)

    @property
    def gravity(self) -> Triple:
        return self._parameters.gravity

    def before_substep(self, callback: Callable[[], object]) -> None:
        self._substeps.callbacks.append(callback)

    def pusher(self, part: Part, frame: Literal["world", "link"] = "world") -> Pusher:
        return self._bound(part, lambda body, index: motors.pusher(self._client, body, index, frame))

    def contact(
        self, one: Part, others: Sequence[Part] | None = None, *, ground: bool = True
    ) -> ContactReader:
        if others is None:
            left_out = () if ground else self._ground
            return self._bound(
                one,
                lambda body, link: self._contact_monitor(body).touches_any_but(link, left_out),
                surfaces.ANY_LINK,
            )
        link_keys = [
            (body.number, _index(body, link, surfaces.ANY_LINK))
            for name, link in others
            for body in self._pool(name)
        ]
        return self._bound(
            one,
            lambda body, link: self._contact_monitor(body).touches_any_of(link, link_keys),
            surfaces.ANY_LINK,
        )

    def contact_force(self, one: Part) -> ForceReader:
        return self._bound(
            one, lambda body, link: self._force_monitor(body, link).normal_force(), surfaces.ANY_LINK
        )

    def contact_force_vector(self, one: Part) -> VectorReader:
        return self._bound(
            one, lambda body, link: self._force_monitor(body, link).force_vector(), surfaces.ANY_LINK
        )

    def _force_monitor(self, body: Body, link: int) -> surfaces.ForceMonitor:
        key = body.number, link
        if key not in self._force_monitors:
            monitor = self._force_monitors[key] = surfaces.ForceMonitor(self._client, body, link)
            self._substeps.starts.append(monitor.reset)
            self._substeps.monitors.append(monitor.update)
        return self._force_monitors[key]

    def clearance(self, one: Part, other: Part) -> ClearanceReader:
        pools = (self._pool(one[0]), self._pool(other[0]))

        def between(body: Body, link: int) -> ClearanceReader:
            first_key = (body.number, link)
            return self._bound(
                other,
                lambda far_body, far_link: surfaces.clearance(
                    self._client, first_key, (far_body.number, far_link)
                ),
                surfaces.ANY_LINK,
            )

        read = self._bound(one, between, surfaces.ANY_LINK)
        if not any(pool.pooled for pool in pools):
            return read
        return lambda: read() if all(pool.present for pool in pools) else inf

    def rays(self, part: Part, rays: Sequence[Frame], reach: float, *, upright: bool = False) -> RayReader:
        cast = self._ray_caster()
        return self._bound(part, partial(cast.reader, rays=tuple(rays), reach=reach, upright=upright))

    def _ray_caster(self) -> surfaces.Rays:
        if self._rays is None:
            self._rays = surfaces.Rays(
                self._client, [body for pool in self._pools.values() for body in pool], self._cache
            )
        return self._rays

    def inverse_kinematics(self, part: Part, joints: Sequence[str]) -> Kinematics:
        return inverse_kinematics(self, self._pool(part[0]).current.model, part, joints)

    def overlaps(self) -> list[Overlap]:
        bodies = {
            body.number: (pool.name, body)
            for pool in self._pools.values()
            if pool.present
            for body in (pool.current,)
        }
        deepest: dict[tuple[str, str], Overlap] = {}
        for ((number, link), (other_number, other_link)), depth in surfaces.penetrations(
            self._client
        ).items():
            if number in bodies and other_number in bodies:
                (a, first), (b, second) = bodies[number], bodies[other_number]
                overlap = Overlap((a, first.link(link).name), (b, second.link(other_link).name), depth)
                deepest_here = deepest.get((a, b))
                deepest[a, b] = (
                    overlap if deepest_here is None or deepest_here.depth < depth else deepest_here
                )
        return sorted(deepest.values(), key=lambda overlap: -overlap.depth)

    def _contact_monitor(self, body: Body) -> surfaces.ContactMonitor:
        if body.number not in self._contact_monitors:
            watch = self._contact_monitors[body.number] = surfaces.ContactMonitor(self._client, body)
            self._substeps.starts.append(watch.reset)
            self._substeps.monitors.append(watch.update)
        return self._contact_monitors[body.number]

    def require_finite(self) -> None:
        """See `Engine.require_finite`."""
        self._require_numbers()
        for body, limits in self._speed_limits:
            states = self._brake_states(body)
            if any(abs(state[1]) > limit for state, limit in zip(states, limits, strict=True)):
                stiffness: dict[int, float] = {}
                for (number, _), springs in self._drives.springs.items():
                    stiffness |= springs.stiffness if number == body.number else {}
                joints = {body.joints[joint.name]: joint for joint in body.model.moving_joints}
                speeds = (
                    JointSpeed(body.name, joints[index], state[1], stiffness.get(index, 0.0))
                    for index, state in zip(body.brakes, states, strict=True)
                )
                require_possible(speeds, self._timestep)

    def _require_numbers(self) -> None:
        # Robots come before objects, which get values that are not finite from them.
        for body in reversed(self._require_open()._moving):
            for quantity, values in (
                ("pose", p.getBasePositionAndOrientation(body.number, self._client)),
                ("joints", (j[:2] for j in self._brake_states(body))),
            ):
                if not isfinite(sum(map(sum, values))):
                    raise EngineError(f"the {quantity} of '{body.name}' became infinite or NaN")

    def _brake_states(self, body: Body) -> Any:
        return p.getJointStates(body.number, tuple(body.brakes), self._client) if body.brakes else ()

    def joint_states(self, robot: str, joints: Sequence[str]) -> JointReader:
        return state.joint_reader(self._client, *self._joints(robot, joints), self._cache)

    def joint_torques(self, robot: str, joints: Sequence[str]) -> TorqueReader:
        body, indices = self._joints(robot, joints)
        return motors.torques(self.joint_states(robot, joints), body, indices, self._drives.springs)

    def joint_wrench(self, part: Part) -> WrenchReader:
        body = self._pool(part[0]).current
        key = body.number, _index(body, part[1])
        if key not in self._wrench_monitors:
            self._wrench_monitors[key] = motors.WrenchMonitor(self._client, body, key[1])
            self._substeps.monitors.append(self._wrench_monitors[key].update)
        return self._wrench_monitors[key].read

    def pose(self, body: str, link: str | None = None) -> PoseReader:
        return self._bound(
            (body, link), lambda owner, index: state.pose_reader(self._client, owner, index, self._cache)
        )

    def velocity(self, body: str, link: str | None = None) -> VelocityReader:
        return self._bound(
            (body, link), lambda owner, index: state.velocity_reader(self._client, owner, index, self._cache)
        )

    def motion(self, body: str, link: str | None = None) -> MotionReader:
        return self._bound(
            (body, link), lambda owner, index: state.motion_reader(self._client, owner, index, self._cache)
        )

    def angular_momentum(self, robot: str) -> VectorReader:
        return state.angular_momentum_reader(self._client, self._pool(robot).current, self._cache)

    def velocity_motor(self, robot: str, joints: Sequence[str], max_torque: Sequence[float]) -> MotorWriter:
        return motors.velocity_motor(self._client, *self._joints(robot, joints), max_torque)

    def torque_motor(
        self,
        robot: str,
        joints: Sequence[str],
        max_torque: Sequence[float],
        *,
        stall_torque: Gain = None,
        no_load_speed: Gain = None,
    ) -> MotorWriter:
        body, indices = self._joints(robot, joints)
        curve = torque_curve(stall_torque, no_load_speed)
        if curve is None:
            return motors.torque_motor(self._client, body, indices, max_torque)
        read = self.joint_states(robot, joints)
        drive = motors.CurvedMotor(self._client, body, indices, read, max_torque, curve)
        return self._drives.add(drive, body)

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
        body, indices = self._joints(robot, joints)
        if stiffness is None:
            return motors.position_motor(self._client, body, indices, max_torque, self._timestep)
        curve = torque_curve(stall_torque, no_load_speed)
        arguments = (self._client, body, indices)
        read = self.joint_states(robot, joints)
        springs = (
            motors.Springs(*arguments, read, max_torque, stiffness, damping)
            if curve is None
            else motors.CurvedMotor(*arguments, read, max_torque, curve, stiffness, damping)
        )
        return self._drives.add(springs, body)

    def camera(self, part: Part, mount: Frame, width: int, height: int, fov: float) -> CameraReader:
        camera = surfaces.Camera(self._client, width, height, fov, self._floor)
        pose = self.pose(*part)
        # `name_indices` has the index among the names for each of PyBullet's numbers.
        names = tuple(self._pools)
        name_indices = np.zeros(p.getNumBodies(self._client) + 1, np.int32)
        for index, pool in enumerate(self._pools.values()):
            name_indices[[body.number for body in pool]] = index
        ground = names.index(GROUND) if GROUND in names else -1

        def look() -> CameraImage:
            image = camera.camera_image(
                surfaces.pose_along(frames.compose(pose(), mount)), name_indices, ground, names
            )
            return image._replace(colors=brightened(image.colors, self._parameters.light))

        return look

    def render(self, view: View) -> Image:
        self._require_open()
        fine = replace(view, width=view.width * view.samples, height=view.height * view.samples)
        camera = surfaces.Camera(self._client, fine.width, fine.height, fine.fov, self._floor)
        aim = surfaces.pose_of_view(view)
        key = (fine, self._floor.tiles if self._floor else None)
        if self._backdrop is None or self._backdrop[0] != key:
            self._backdrop = (key, camera.background(aim))
        return brightened(
            downsampled(camera.render(aim, self._backdrop[1]), view.samples), self._parameters.light
        )

    def snapshot(self) -> object:
        """Refuse a snapshot: PyBullet's `saveState` leaves out motors, masses and frictions, and is not exact
        in every world (docs/engines.md)."""
        raise EngineError(
            "PyBullet has no exact snapshot of a world; begin the episode again and repeat its actions"
        )

    def restore(self, snapshot: object) -> None:
        self.snapshot()

    def close(self) -> None:
        self._release()

    def _require_open(self) -> PyBulletEngine:
        if not self._release.alive:
            _raise_closed()
        return self

    def _pool(self, name: str) -> Pool[Body]:
        return named(self._require_open()._pools, name, "the world has no body")

    def _joints(self, robot: str, names: Sequence[str]) -> tuple[int, tuple[int, ...]]:
        body = self._pool(robot).current
        return body.number, tuple(named(body.joints, name, f"'{body.name}' has no joint") for name in names)

    def _bound(
        self, part: Part, bind: Callable[[Body, int], Callable[P, R]], none: int = BASE_LINK
    ) -> Callable[P, R]:
        """Bind a function to a link, in whichever form its body takes; `none` replaces the link None."""
        return self._pool(part[0]).bind_current(lambda body: bind(body, _index(body, part[1], none)))


def _index(body: Body, link: str | None, none: int = BASE_LINK) -> int:
    return none if link is None else named(body.links, link, f"'{body.name}' has no link")


def _release(client: int, substeps: Substeps, cache: ReadCache) -> None:
    p.disconnect(client)
    for callbacks in substeps:
        callbacks.clear()
    substeps.callbacks.append(_raise_closed)  # another world may get this client's number
    cache.invalidate()


def _raise_closed() -> None:
    raise EngineError("this world was closed")
