"""One world in a PyBullet client of its own."""

from __future__ import annotations

import weakref
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from math import inf, isfinite
from typing import TYPE_CHECKING, Literal, ParamSpec, TypeVar

import numpy as np

from deepbots_cli import frames
from deepbots_cli.engines.kinematics import Chain
from deepbots_cli.engines.objects import find
from deepbots_cli.engines.pybullet import BASE, FAINT, GAINS, cameras, loading, motors, state, surfaces
from deepbots_cli.engines.pybullet import pybullet as p
from deepbots_cli.engines.pybullet.cameras import Floor, lit, smoothed
from deepbots_cli.engines.pybullet.state import Parameters, ReadCache
from deepbots_cli.errors import EngineError
from deepbots_cli.port import STILL, Overlap, Sight
from deepbots_cli.program.world import GROUND

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from deepbots_cli.engines.objects import Pool
    from deepbots_cli.engines.pybullet.state import Body
    from deepbots_cli.frames import Frame, Quaternion, Triple
    from deepbots_cli.port import (
        CameraReader,
        Capability,
        ClearanceReader,
        ContactReader,
        ForceReader,
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
        VelocityReader,
        View,
    )
    from deepbots_cli.program.world import EngineParameter, WorldModel

Act = Callable[[], object]
Given = ParamSpec("Given")
Told = TypeVar("Told")


class Substeps:
    """Acts, then drives (motors that renew their torque), then one step of physics, then watches.

    Drives come after acts, so that they see the targets that those have just set.
    """

    def __init__(self, moments: ReadCache) -> None:
        self._moments = moments
        self._begins: list[Act] = []
        self._acts: list[Act] = []
        self._drives: list[Act] = []
        self._before: list[Act] = []
        self._after: list[Act] = []

    def act(self, act: Act) -> None:
        self._acts.append(act)
        self._arrange()

    def watch(self, begin: Act, look: Act) -> None:
        """`begin` is called once per `step`, before everything else."""
        self._begins.append(begin)
        self._after.append(look)

    def drive(self, drives: list[Act]) -> None:
        """Replace all drives by these."""
        self._drives = drives
        self._arrange()

    def only(self, act: Act) -> None:
        """Call only `act`, and no other function or drive."""
        self._acts, self._drives = [act], []
        self._begins.clear()
        self._moments.go_on()
        self._arrange()

    def _arrange(self) -> None:
        self._before[:] = [*self._acts, *self._drives]

    def stepper(self, client: int) -> Callable[[int], None]:
        """`Engine.step`. In most worlds nothing acts or watches; asking costs 1 % of the cheapest step."""
        advance, before, after, begins, now = p.stepSimulation, self._before, self._after, self._begins, self._moments.now

        def step(substeps: int) -> None:
            if before or after:
                for begin in begins:
                    begin()
                for _ in range(substeps):
                    for act in before:
                        act()
                    advance(client)
                    now[0] += 1
                    for look in after:
                        look()
            else:
                for _ in range(substeps):
                    advance(client)
                now[0] += 1

        return step


class PyBulletEngine:
    """One world: about 29 MB until it is closed or dropped, and its readers and writers with it."""

    name = "pybullet"
    capabilities: frozenset[Capability] = frozenset({"contacts", "rendering"})

    def __init__(self, world: WorldModel) -> None:
        self._client = loading.create_client(world)
        self._moments = ReadCache()
        self._substeps = Substeps(self._moments)
        self._release = weakref.finalize(self, _release, self._client, self._substeps)
        self.step = self._substeps.stepper(self._client)
        self._timestep = world.timestep / world.substeps
        self._floor = Floor(world.ground.colour, world.lines) if world.ground and not world.terrain else None
        self._springs: dict[tuple[int, tuple[int, ...]], motors.Springs] = {}
        self._watches: dict[int, surfaces.Watch] = {}
        self._rays: surfaces.Rays | None = None
        self._backdrop: tuple[object, Image] | None = None
        try:
            self._pools: dict[str, Pool[Body]] = {pool.name: pool for pool in loading.bodies(self._client, world)}
            self._parameters = Parameters(self._client, world, self._pools, self._floor)
            every = [body for pool in self._pools.values() for body in pool]
            self._moving = [body for body in every if not body.fixed or body.brakes]
            self._still = [body for body in every if body.fixed and not body.brakes]
            self._ground = [body.number for body in self._pools.get(GROUND, ())]
            loading.join_islands(self._client, self._pools.values())
            self.reset()
        except BaseException:
            self.close()
            raise

    def reset(self) -> None:
        """See `Engine.reset`. A world with values that are not finite cannot be reset; it must be built again."""
        self.require_finite()
        self._parameters.restore()
        for springs in self._springs.values():
            springs.rest()
        for watch in self._watches.values():
            watch.forget()
        for pool in self._pools.values():
            pool.leave()
        for row, body in enumerate(self._moving, start=1):
            self._restart(
                body,
                ((row * loading.PARKING_SPACING, 0.0, loading.PARKING_SPACING), frames.IDENTITY_ROTATION),
                dict.fromkeys(body.brakes, FAINT),
            )
        p.stepSimulation(self._client)
        for body in (*self._still, *self._moving):
            self._restart(body, body.home, body.brakes)
        self._moments.go_on()

    def _restart(self, body: Body, pose: Frame, brakes: dict[int, float]) -> None:
        """Put the centre of a body there, all of it at rest, with brakes of so many N m or N on its joints."""
        number, client = body.number, self._client
        p.resetBasePositionAndOrientation(number, *pose, client)
        p.resetBaseVelocity(number, STILL, STILL, client)
        for index, brake in brakes.items():
            p.resetJointState(number, index, 0.0, 0.0, client)
            p.setJointMotorControl2(number, index, p.VELOCITY_CONTROL, 0.0, 0.0, brake, *GAINS, client)

    def place(
        self, body: str, position: Triple, orientation: Quaternion, velocity: Triple = STILL, angular_velocity: Triple = STILL
    ) -> None:
        placed = self._pool(body).enter()
        pose = placed.of_centre(position, frames.normalised(orientation))
        p.resetBasePositionAndOrientation(placed.number, *pose, self._client)
        of_centre = frames.add(velocity, frames.cross(angular_velocity, frames.subtract(pose[0], position)))
        p.resetBaseVelocity(placed.number, of_centre, angular_velocity, self._client)
        self._moments.go_on()

    def set_joint(self, robot: str, joint: str, position: float, velocity: float) -> None:
        number, (index,) = self._joints(robot, (joint,))
        p.resetJointState(number, index, position, velocity, self._client)
        self._moments.go_on()

    def choose(self, body: str, variant: str) -> None:
        self._pool(body).choose(variant)

    def set_parameter(self, what: EngineParameter, of: tuple[str, ...], *values: float) -> None:
        self._open()._parameters.set(what, of, values)

    @property
    def gravity(self) -> Triple:
        return self._parameters.gravity

    def before_substep(self, act: Callable[[], object]) -> None:
        self._substeps.act(act)

    def pusher(self, part: Part, frame: Literal["world", "link"] = "world") -> Pusher:
        return self._bound(part, lambda body, index: motors.pusher(self._client, body, index, frame))

    def contact(self, one: Part, others: Sequence[Part] | None = None, *, ground: bool = True) -> ContactReader:
        if others is None:
            left_out = () if ground else self._ground
            return self._bound(one, lambda body, link: self._watch(body).of_all_but(link, left_out), surfaces.ANY)
        places = [(body.number, _index(body, link, surfaces.ANY)) for name, link in others for body in self._pool(name)]
        return self._bound(one, lambda body, link: self._watch(body).of_some(link, places), surfaces.ANY)

    def contact_force(self, one: Part) -> ForceReader:
        return self._bound(one, lambda body, link: surfaces.force(self._client, body.number, link), surfaces.ANY)

    def clearance(self, one: Part, other: Part) -> ClearanceReader:
        pools = (self._pool(one[0]), self._pool(other[0]))

        def between(body: Body, link: int) -> ClearanceReader:
            near = (body.number, link)
            return self._bound(other, lambda its, its_link: surfaces.clearance(self._client, near, (its.number, its_link)), surfaces.ANY)

        read = self._bound(one, between, surfaces.ANY)
        if not any(pool.pooled for pool in pools):
            return read
        return lambda: read() if all(pool.present for pool in pools) else inf

    def rays(self, part: Part, rays: Sequence[Frame], reach: float) -> RayReader:
        if self._rays is None:
            self._rays = surfaces.Rays(self._client, [body for pool in self._pools.values() for body in pool], self._moments)
        return self._bound(part, partial(self._rays.reader, rays=tuple(rays), reach=reach))

    def inverse_kinematics(self, part: Part, joints: Sequence[str]) -> Kinematics:
        body, link = self._body(part[0]), part[1]
        chain = Chain(body.model, link or body.model.root, joints)
        root, read = self.pose(part[0]), self.joint_states(part[0], chain.moving)
        return lambda position, attitude: chain.solve(root(), [state[0] for state in read()], position, attitude)

    def overlaps(self) -> list[Overlap]:
        bodies = {body.number: (pool.name, body) for pool in self._pools.values() if pool.present for body in (pool.chosen,)}
        deepest: dict[tuple[str, str], Overlap] = {}
        for ((one, link), (other, other_link)), depth in surfaces.penetrations(self._client).items():
            if one in bodies and other in bodies:
                (a, first), (b, second) = bodies[one], bodies[other]
                found = Overlap((a, first.link(link).name), (b, second.link(other_link).name), depth)
                known = deepest.get((a, b))
                deepest[a, b] = found if known is None or known.depth < depth else known
        return sorted(deepest.values(), key=lambda found: -found.depth)

    def _watch(self, body: Body) -> surfaces.Watch:
        if body.number not in self._watches:
            watch = self._watches[body.number] = surfaces.Watch(self._client, body.number)
            self._substeps.watch(watch.forget, watch.look)
        return self._watches[body.number]

    def require_finite(self) -> None:
        client = self._client
        for body in reversed(self._open()._moving):  # robots before objects, to which they spread what is not a number
            joints = p.getJointStates(body.number, tuple(body.brakes), client) if body.brakes else ()
            for what, values in (("pose", p.getBasePositionAndOrientation(body.number, client)), ("joints", (j[:2] for j in joints))):
                if not isfinite(sum(map(sum, values))):
                    raise EngineError(f"the {what} of '{body.name}' left the range of numbers")

    def joint_states(self, robot: str, joints: Sequence[str]) -> JointReader:
        return state.joints(self._client, *self._joints(robot, joints), self._moments)

    def joint_torques(self, robot: str, joints: Sequence[str]) -> TorqueReader:
        body, indices = self._joints(robot, joints)
        return motors.torques(self.joint_states(robot, joints), body, indices, self._springs)

    def pose(self, body: str, link: str | None = None) -> PoseReader:
        return self._bound((body, link), lambda owner, index: state.pose(self._client, owner, index, self._moments))

    def velocity(self, body: str, link: str | None = None) -> VelocityReader:
        return self._bound((body, link), lambda owner, index: state.velocity(self._client, owner, index, self._moments))

    def motion(self, body: str, link: str | None = None) -> MotionReader:
        return self._bound((body, link), lambda owner, index: state.motion(self._client, owner, index, self._moments))

    def velocity_motor(self, robot: str, joints: Sequence[str], max_torque: Sequence[float]) -> MotorWriter:
        return motors.velocity_motor(self._client, *self._joints(robot, joints), max_torque)

    def torque_motor(self, robot: str, joints: Sequence[str], max_torque: Sequence[float]) -> MotorWriter:
        return motors.torque_motor(self._client, *self._joints(robot, joints), max_torque)

    def position_motor(
        self,
        robot: str,
        joints: Sequence[str],
        max_torque: Sequence[float],
        stiffness: Sequence[float] | None,
        damping: Sequence[float] | None,
    ) -> MotorWriter:
        body, indices = self._joints(robot, joints)
        if stiffness is None:
            return motors.position_motor(self._client, body, indices, max_torque, self._timestep)
        springs = motors.Springs(self._client, body, indices, self.joint_states(robot, joints), max_torque, stiffness, damping)
        self._springs[body, indices] = springs
        self._substeps.drive([each.act for each in self._springs.values()])
        return springs.aim

    def camera(self, part: Part, mount: Frame, width: int, height: int, fov: float) -> CameraReader:
        camera, pose = cameras.Camera(self._client, width, height, fov, self._floor), self.pose(*part)
        names, places = self._places()
        ground = names.index(GROUND) if GROUND in names else -1

        def look() -> Sight:
            sight = camera.sight(cameras.along(frames.compose(pose(), mount)), places, ground, names)
            return sight._replace(colours=lit(sight.colours, self._parameters.light))

        return look

    def _places(self) -> tuple[tuple[str, ...], NDArray[np.int32]]:
        """Names of all bodies, and the place of each of PyBullet's numbers among them."""
        names, places = tuple(self._pools), np.zeros(p.getNumBodies(self._client) + 1, np.int32)
        for place, pool in enumerate(self._pools.values()):
            places[[body.number for body in pool]] = place
        return names, places

    def render(self, view: View) -> Image:
        self._open()
        fine = replace(view, width=view.width * view.samples, height=view.height * view.samples)
        camera, aim = cameras.Camera(self._client, fine.width, fine.height, fine.fov, self._floor), cameras.at(view)
        seen = (fine, self._floor.tiles if self._floor else None)
        if self._backdrop is None or self._backdrop[0] != seen:
            self._backdrop = (seen, camera.behind(aim))
        return lit(smoothed(camera.picture(aim, self._backdrop[1]), view.samples), self._parameters.light)

    def snapshot(self) -> object:
        """Refused: PyBullet's `saveState` leaves out motors, masses and frictions, and is not exact in every world (docs/engines.md)."""
        raise EngineError("PyBullet has no exact snapshot of a world; begin the episode again and repeat its actions")

    def restore(self, snapshot: object) -> None:
        self.snapshot()

    def close(self) -> None:
        self._release()

    def _open(self) -> PyBulletEngine:
        if not self._release.alive:
            _refuse()
        return self

    def _pool(self, name: str) -> Pool[Body]:
        return find(self._open()._pools, name, "the world has no body")

    def _body(self, name: str) -> Body:
        return self._pool(name).chosen

    def _link(self, body: str, link: str | None) -> tuple[Body, int]:
        owner = self._body(body)
        return owner, _index(owner, link)

    def _joint(self, owner: Body, joint: str) -> int:
        return find(owner.joints, joint, f"'{owner.name}' has no joint")

    def _joints(self, robot: str, names: Sequence[str]) -> tuple[int, tuple[int, ...]]:
        body = self._body(robot)
        return body.number, tuple(self._joint(body, name) for name in names)

    def _bound(self, part: Part, bind: Callable[[Body, int], Callable[Given, Told]], none: int = BASE) -> Callable[Given, Told]:
        """What `bind` makes of a link, in whichever form its body takes; `none` stands for the link None."""
        return self._pool(part[0]).bound(lambda body: bind(body, _index(body, part[1], none)))


def _index(body: Body, link: str | None, none: int = BASE) -> int:
    return none if link is None else find(body.links, link, f"'{body.name}' has no link")


def _release(client: int, substeps: Substeps) -> None:
    p.disconnect(client)
    substeps.only(_refuse)  # another world may get this client's number


def _refuse() -> None:
    raise EngineError("this world was closed")
