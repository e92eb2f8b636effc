"""One world in MuJoCo."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cache, partial
from math import inf
from typing import TYPE_CHECKING, Any, Literal

from deepbots_cli import frames
from deepbots_cli.engines.mechanics import Pool, inverse_kinematics, named, torque_curve
from deepbots_cli.engines.mujoco import cameras, motors, sliding, surfaces
from deepbots_cli.engines.mujoco import mujoco as mj
from deepbots_cli.engines.mujoco.model import Body, ModelBuilder
from deepbots_cli.engines.mujoco.state import (
    LinkMotions,
    MujocoWorld,
    WorldSnapshot,
    place_body,
    put_joint,
)
from deepbots_cli.errors import EngineError
from deepbots_cli.port import ZERO_VECTOR, Overlap
from deepbots_cli.program.world import GROUND

if TYPE_CHECKING:
    from deepbots_cli.engines.mujoco.state import JointPlace
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
        Motion,
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


class MuJoCoEngine:
    """One world, with exact snapshots."""

    name = "mujoco"

    def __init__(self, world: WorldModel, builder: ModelBuilder | None = None) -> None:
        built = builder or ModelBuilder(world)
        self._world = MujocoWorld(built.compile(), world, built.pools)
        self.motors = motors.Motors(self._world)
        self._contact_monitor: surfaces.ContactMonitor | None = None
        self._wrench_monitor: motors.WrenchMonitor | None = None
        self._substep_callbacks: list[Callable[[], object]] = []
        self._renderer = cameras.WorldRenderer(world, self._world)
        self.joint_places = cache(self._joint_places)
        drawing: frozenset[Capability] = frozenset({"rendering"} if cameras.is_available() else ())
        self.capabilities: frozenset[Capability] = drawing | {
            *("contacts", "mimic", "snapshot"),
            *("armature", "center_of_mass", "joint_wrench", "self_collision", "torque_curve"),
        }
        self.reset()

    # Time

    def reset(self) -> None:
        self._world.require_open().reset()
        self.motors.restore({}, {})
        self._reset_monitors()

    def _reset_monitors(self) -> None:
        for monitor in (self._contact_monitor, self._wrench_monitor):
            if monitor is not None:
                monitor.reset()

    def step(self, substeps: int) -> None:
        world = self._world
        if world.is_stale:
            world.update_constants()
        model, data = world.model, world.data
        contact_monitor = self._contact_monitor
        advance: Callable[..., None] = (
            sliding.stepper() if self._wrench_monitor is None else self._wrench_monitor.step
        )
        callbacks = self._substep_callbacks
        gain_updates = self.motors.gain_updates
        if contact_monitor is not None:
            contact_monitor.reset()
        if not (callbacks or gain_updates or world.has_pushes or self._wrench_monitor):
            if contact_monitor is None:
                # One call for 8 substeps of a free body takes 12.6 us, 8 calls take 14.4 us.
                advance(model, data, substeps)
            else:
                for _ in range(substeps):
                    advance(model, data)
                    contact_monitor.update()
            world.invalidate()
            return
        for _ in range(substeps):
            for callback in callbacks:
                callback()
            for update in gain_updates.values():
                update()
            advance(model, data)
            world.invalidate()
            if world.has_pushes:
                data.xfrc_applied[:] = 0.0  # MuJoCo keeps it, but a push lasts for one engine step
                world.has_pushes = False
            if contact_monitor is not None:
                contact_monitor.update()

    def before_substep(self, callback: Callable[[], object]) -> None:
        self._substep_callbacks.append(callback)

    def require_finite(self) -> None:
        self._world.require_finite()

    def snapshot(self) -> object:
        return self._world.require_open().snapshot()

    def restore(self, snapshot: object) -> None:
        if not isinstance(snapshot, WorldSnapshot):
            raise EngineError("this is not a snapshot of a world in MuJoCo")
        self._reset_monitors()  # readers that were bound after the snapshot have no memory in it
        self._world.restore(snapshot)

    def close(self) -> None:
        self._substep_callbacks.clear()
        self._renderer.close()
        self._world.close()

    # Values of an episode

    @property
    def gravity(self) -> Triple:
        x, y, z = self._world.model.opt.gravity.tolist()
        return x, y, z

    def place(
        self,
        body: str,
        position: Triple,
        orientation: Quaternion,
        velocity: Triple = ZERO_VECTOR,
        angular_velocity: Triple = ZERO_VECTOR,
    ) -> None:
        pool = self.pool(body)
        form = pool.activate()
        if pool.pooled:
            self._world.show(form)
        place_body(self._world.data, form, position, orientation, velocity, angular_velocity)
        self._world.invalidate()

    def set_joint(self, robot: str, joint: str, position: float, velocity: float) -> None:
        put_joint(self._world.require_open().data, self.joint_places(robot, joint), position, velocity)
        self._world.invalidate()

    def _joint_places(self, robot: str, joint: str) -> list[JointPlace]:
        """Return the places of a joint in the state, and of the joints that follow it."""
        model = self._world.model
        # A follower that stays behind would be pulled to its leader in the next step, with a jolt.
        joints = {joint: None, **self.pool(robot).current.model.followers_of(joint)}
        numbers = self.joint_numbers(robot, list(joints))
        addresses = zip(
            model.jnt_qposadr[[*numbers]], model.jnt_dofadr[[*numbers]], joints.values(), strict=True
        )
        return [(int(position), int(velocity), mimic) for position, velocity, mimic in addresses]

    def choose(self, body: str, variant: str) -> None:
        self.pool(body).choose(variant)

    def set_parameter(self, parameter: EngineParameter, owner: tuple[str, ...], *values: float) -> None:
        self._world.require_open().set_parameter(parameter, owner, values)

    # Motors

    def velocity_motor(self, robot: str, joints: Sequence[str], max_torque: Sequence[float]) -> MotorWriter:
        return self._motor(robot, joints, max_torque).tracking_writer()

    def torque_motor(
        self,
        robot: str,
        joints: Sequence[str],
        max_torque: Sequence[float],
        *,
        stall_torque: Gain = None,
        no_load_speed: Gain = None,
    ) -> MotorWriter:
        curve = torque_curve(stall_torque, no_load_speed)
        return self._motor(robot, joints, max_torque).torque_writer(curve)

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
        motor = self._motor(robot, joints, max_torque)
        if stiffness is None:
            return motor.tracking_writer(motors.servo_rate(self._world.model))
        return motor.spring_writer(stiffness, damping, torque_curve(stall_torque, no_load_speed))

    def pusher(self, part: Part, frame: Literal["world", "link"] = "world") -> Pusher:
        return self.pool(part[0]).bind_current(
            lambda form: motors.pusher(self._world, link_number(form, part[1]), frame)
        )

    # Readers of motion

    def joint_states(self, robot: str, joints: Sequence[str]) -> JointReader:
        model = self._world.model
        data = self._world.data
        numbers = list(self.joint_numbers(robot, joints))
        addresses, dofs = model.jnt_qposadr[numbers].tolist(), model.jnt_dofadr[numbers].tolist()
        # A number is read through a memoryview in 0.04 us; slices of two arrays take 0.8 us.
        positions: Any = memoryview(data.qpos)
        velocities: Any = memoryview(data.qvel)
        states = list(zip(addresses, dofs, strict=True))
        return lambda: [(positions[address], velocities[dof]) for address, dof in states]

    def joint_torques(self, robot: str, joints: Sequence[str]) -> TorqueReader:
        return self.motors.torques(self.joint_numbers(robot, joints))

    def joint_wrench(self, part: Part) -> WrenchReader:
        if self._wrench_monitor is None:
            self._wrench_monitor = motors.WrenchMonitor(self._world)
        return self._wrench_monitor.reader(link_number(self.pool(part[0]).current, part[1]))

    def pose(self, body: str, link: str | None = None) -> PoseReader:
        return self.pool(body).bind_current(lambda form: self._pose(form, link_number(form, link)))

    def velocity(self, body: str, link: str | None = None) -> VelocityReader:
        return self.pool(body).bind_current(lambda form: self._velocity(form, link_number(form, link)))

    def angular_momentum(self, robot: str) -> VectorReader:
        world = self._world
        body = self.pool(robot).current
        model = world.model
        data = world.data
        links = list(body.links.values())

        def read() -> Triple:
            world.update_velocities()
            motions = LinkMotions(
                model.body_mass[None, links],
                model.body_inertia[None, links],
                data.xipos[None, links],
                data.ximat[None, links],
                data.cvel[None, links],
                data.subtree_com[None, body.root_id],
            )
            ((x, y, z),) = motions.angular_momentum().tolist()
            return x, y, z

        return read

    def motion(self, body: str, link: str | None = None) -> MotionReader:
        pose = self.pose(body, link)
        velocity = self.velocity(body, link)

        def read() -> Motion:
            return pose(), velocity()

        return read

    def _pose(self, body: Body, link: int) -> PoseReader:
        """Return a reader of the pose of a root link from the state, of another link from positions that are
        computed on demand."""
        world = self._world
        data = self._world.data
        if link == body.root_id and body.position_index >= 0:
            numbers = data.qpos[body.position_index : body.position_index + 7]

            def read_free() -> Frame:
                px, py, pz, w, x, y, z = numbers.tolist()
                return (px, py, pz), (x, y, z, w)

            return read_free
        at_rest = link == body.root_id and body.mocap_index >= 0
        position, rotation = (
            (data.mocap_pos[body.mocap_index], data.mocap_quat[body.mocap_index])
            if at_rest
            else (data.xpos[link], data.xquat[link])
        )

        def read() -> Frame:
            if not (at_rest or world.has_positions):
                world.update_positions()
            w, x, y, z = rotation.tolist()
            return tuple(position.tolist()), (x, y, z, w)

        return read

    def _velocity(self, body: Body, link: int) -> VelocityReader:
        world = self._world
        model = self._world.model
        data = self._world.data
        if link == body.root_id and body.position_index >= 0:
            rotation = data.qpos[body.position_index + 3 : body.position_index + 7]
            numbers = data.qvel[body.velocity_index : body.velocity_index + 6]

            def read_free() -> tuple[Triple, Triple]:
                vx, vy, vz, wx, wy, wz = numbers.tolist()
                w, x, y, z = rotation.tolist()
                return (vx, vy, vz), frames.rotate((x, y, z, w), (wx, wy, wz))

            return read_free
        # `cvel` is the velocity of the link at the center of mass of its tree; `mj_objectVelocity` begins
        # with it too, at three times the cost.
        of_center = data.cvel[link]
        center = data.subtree_com[model.body_rootid[link]]
        origin = data.xpos[link]

        def read() -> tuple[Triple, Triple]:
            if not world.has_velocities:
                world.update_velocities()
            wx, wy, wz, vx, vy, vz = of_center.tolist()
            (px, py, pz), (cx, cy, cz) = origin.tolist(), center.tolist()
            px, py, pz = px - cx, py - cy, pz - cz
            return (vx + wy * pz - wz * py, vy + wz * px - wx * pz, vz + wx * py - wy * px), (wx, wy, wz)

        return read

    def inverse_kinematics(self, part: Part, joints: Sequence[str]) -> Kinematics:
        return inverse_kinematics(self, self.pool(part[0]).current.model, part, joints)

    # Readers of surfaces

    def contact(
        self, one: Part, others: Sequence[Part] | None = None, *, ground: bool = True
    ) -> ContactReader:
        geoms = self.geoms_of(one)
        if others is None:
            others = self.others(one[0], ground=ground)
        met = [geom for part in others for geom in self.geoms_of(part)]
        return self._monitor().reader(geoms, met)

    def _monitor(self) -> surfaces.ContactMonitor:
        if self._contact_monitor is None:
            self._contact_monitor = surfaces.ContactMonitor(self._world)
        return self._contact_monitor

    def others(self, body: str, *, ground: bool) -> list[Part]:
        """Return the bodies that a body may touch: a robot with `self_collision` is one of its own."""
        left_out = {body} if not self.pool(body).current.self_collision else set()
        left_out |= set() if ground else {GROUND}
        return [(name, None) for name in self._world.pools if name not in left_out]

    def contact_force(self, one: Part) -> ForceReader:
        return self._monitor().normal_force(self.geoms_of(one))

    def contact_force_vector(self, one: Part) -> VectorReader:
        return self._monitor().force_vector(self.geoms_of(one))

    def clearance(self, one: Part, other: Part) -> ClearanceReader:
        pool, other_pool = self.pool(one[0]), self.pool(other[0])
        for geom in (*self.geoms_of(one), *self.geoms_of(other)):
            if self._world.model.geom_type[geom] == mj.mjtGeom.mjGEOM_HFIELD:
                raise EngineError(
                    "MuJoCo cannot compute distances to terrain; measure them with a ray sensor, or use the"
                    " engine 'pybullet'"
                )
        read = pool.bind_current(
            lambda form: other_pool.bind_current(
                lambda other_form: surfaces.clearance(
                    self._world, form.geoms_of(one[1]), other_form.geoms_of(other[1])
                )
            )
        )
        return lambda: read() if pool.present and other_pool.present else inf

    def rays(self, part: Part, rays: Sequence[Frame], reach: float, *, upright: bool = False) -> RayReader:
        return self.pool(part[0]).bind_current(
            lambda form: surfaces.rays(
                self._world, form, link_number(form, part[1]), tuple(rays), reach, upright=upright
            )
        )

    def overlaps(self) -> list[Overlap]:
        owners = {
            geom: (pool.name, link)
            for pool in self._world.require_open().pools.values()
            if pool.present
            for link, geoms in pool.current.geoms.items()
            for geom in geoms
        }
        deepest: dict[frozenset[str], Overlap] = {}
        for first, second, depth in surfaces.penetrations(self._world):
            if first in owners and second in owners:
                overlap = Overlap(owners[first], owners[second], depth)
                bodies = frozenset((overlap.one[0], overlap.other[0]))  # in either order, by their shapes
                deepest[bodies] = max(deepest.get(bodies, overlap), overlap, key=lambda each: each.depth)
        return sorted(deepest.values(), key=lambda overlap: -overlap.depth)

    # Pictures

    def camera(self, part: Part, mount: Frame, width: int, height: int, fov: float) -> CameraReader:
        return partial(self._renderer.render_camera, self.pose(*part), mount, width, height, fov)

    def render(self, view: View) -> Image:
        self._world.require_open()
        return self._renderer.render_view(view)

    # Names

    def pool(self, name: str) -> Pool[Body]:
        """Return the forms of a body.

        Raises:
            EngineError: There is no such body.
        """
        return named(self._world.require_open().pools, name, "the world has no body")

    def joint_numbers(self, robot: str, names: Sequence[str]) -> tuple[int, ...]:
        """Return the numbers of joints in the model."""
        body = self.pool(robot).current
        return tuple(named(body.joints, name, f"'{body.name}' has no joint") for name in names)

    def _motor(self, robot: str, joints: Sequence[str], max_torque: Sequence[float]) -> motors.Motor:
        return motors.Motor(self.motors, self.joint_numbers(robot, joints), max_torque)

    def geoms_of(self, part: Part) -> list[int]:
        """Return the geoms of a body in all its forms, or of one link."""
        pool = self.pool(part[0])
        if part[1] is not None:
            link_number(pool.current, part[1])
        return [geom for body in pool for geom in body.geoms_of(part[1])]


def link_number(body: Body, link: str | None) -> int:
    """Return the number of a link in the model; None is the root."""
    return body.root_id if link is None else named(body.links, link, f"'{body.name}' has no link")
