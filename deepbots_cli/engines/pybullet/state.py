"""The state of a PyBullet world: bodies by name, readers, and the parameters that an episode varies.

A reading is kept until the world changes. A change of a parameter records how to undo it, for the next reset.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any, TypeVar

from deepbots_cli import frames
from deepbots_cli.engines.mechanics import named, rigid_group
from deepbots_cli.engines.pybullet import BASE_LINK, DEFAULT_GAINS
from deepbots_cli.engines.pybullet import pybullet as p
from deepbots_cli.errors import EngineError
from deepbots_cli.frames import IDENTITY_FRAME, Frame
from deepbots_cli.port import ZERO_VECTOR
from deepbots_cli.program.world import GROUND
from deepbots_cli.records import dataclass

if TYPE_CHECKING:
    from deepbots_cli.engines.mechanics import Pool
    from deepbots_cli.engines.pybullet.motors import Damping
    from deepbots_cli.engines.pybullet.surfaces import Floor
    from deepbots_cli.frames import Quaternion, Triple
    from deepbots_cli.port import (
        JointReader,
        Motion,
        MotionReader,
        PoseReader,
        VectorReader,
        VelocityReader,
    )
    from deepbots_cli.program.world import Color, EngineParameter, WorldModel
    from deepbots_cli.robots.model import Friction, Link, RobotModel

MOVING, STATIC = 1, 2
"""PyBullet's collision groups: the second is that of fixed roots."""


@dataclass(frozen=True)
class Dynamics:
    """The dynamics with which a link was loaded: mass (kg), principal moments (kg m^2), and its frame of
    inertia in its own frame."""

    mass: float
    moments: Triple
    inertia_frame: Frame


class Body:
    """One PyBullet body.

    `brakes` is the friction (N m or N) of each joint by index, `offsets` the position (rad or m) at a reset
    of each joint that follows another one, `anchor` a link that moves and touches, `static_links` the links
    that never move, `own_pairs` the pairs of its links that touch each other.
    """

    def __init__(self, name: str, number: int, model: RobotModel, fixed: bool, client: int) -> None:
        self.name = name
        self.own_pairs: tuple[tuple[int, int], ...] = ()
        self.group: int | None = None
        self._is_deactivated = False
        self.number = number
        self.model = model
        self.fixed = fixed
        self.links = {model.root: BASE_LINK}
        self.joints: dict[str, int] = {}
        for index in range(p.getNumJoints(number, client)):
            info = p.getJointInfo(number, index, client)
            # PyBullet numbers a joint and its child link alike; 1 is the joint's name, 12 the link's.
            self.joints[info[1].decode()] = index
            self.links[info[12].decode()] = index
        self.brakes = {self.joints[joint.name]: joint.friction for joint in model.moving_joints}
        self.offsets = {self.joints[name]: mimic.offset for name, mimic in model.followers.items()}
        self.static_links = frozenset(rigid_group(model, model.root) if fixed else ())
        touching = [
            self.links[link.name]
            for link in model.links
            if link.collisions and link.name not in self.static_links
        ]
        self.anchor = touching[0] if touching else None
        self._client = client
        self._dynamics: dict[int, Dynamics] = {}
        self.center, self.principal = self.dynamics(BASE_LINK).inertia_frame
        self._back = frames.inverse(self.principal)
        self._parallel = self.principal == frames.IDENTITY_ROTATION
        self.initial_pose: Frame = IDENTITY_FRAME
        self._factors: dict[int, tuple[float, float]] = {}
        """The factors on mass and inertia of links, and the further factors on their inertia."""

    def dynamics(self, index: int) -> Dynamics:
        """Return the dynamics with which a link was loaded. They are read and kept before any parameter
        changes."""
        if index not in self._dynamics:
            info = p.getDynamicsInfo(self.number, index, self._client)
            self._dynamics[index] = Dynamics(info[0], info[2], (info[3], info[4]))
        return self._dynamics[index]

    def forget_pairs(self) -> None:
        """Set the groups of all links, after which PyBullet pairs them anew with what they may touch.

        It otherwise keeps most pairs that are no longer close, with the caches of their collision tests.
        """
        for index in self.links.values():
            # As PyBullet does when it loads them: links that are fixed to a fixed root touch static bodies. A
            # body without mass is static.
            is_static = index == BASE_LINK and (self.fixed or self._is_deactivated)
            group, mask = (STATIC, ~STATIC) if is_static else (MOVING, -1)
            p.setCollisionFilterGroupMask(self.number, index, self.group or group, mask, self._client)

    def link(self, index: int) -> Link:
        return self.model.link(next(name for name, number in self.links.items() if number == index))

    def set_joint(self, joint: str, position: float, velocity: float) -> None:
        """Set a joint (rad or m, and per s) and its followers, which would be pulled to it with a jolt."""
        p.resetJointState(self.number, self.joints[joint], position, velocity, self._client)
        for follower, mimic in self.model.followers_of(joint).items():
            self.set_joint(follower, mimic.position(position), mimic.multiplier * velocity)

    def scale_mass(self, index: int, factor: float) -> None:
        """Multiply the mass with which a link was loaded by a factor, and its inertia."""
        self._scale(index, factor, self._factors.get(index, (1.0, 1.0))[1])

    def scale_inertia(self, index: int, factor: float) -> None:
        """Multiply the inertia with which a link was loaded by a factor, beside that of its mass."""
        self._scale(index, self._factors.get(index, (1.0, 1.0))[0], factor)

    def _scale(self, index: int, of_mass: float, of_inertia: float) -> None:
        self.dynamics(index)  # reads it before it changes
        self._factors[index] = of_mass, of_inertia
        if not self._is_deactivated:
            self._apply_weight(index)

    def _apply_weight(self, index: int) -> None:
        """Set mass and inertia in one call: a mass alone would get the inertia of the link's shape."""
        loaded = self.dynamics(index)
        of_mass, of_inertia = self._factors[index]
        p.changeDynamics(
            self.number,
            index,
            mass=loaded.mass * of_mass,
            localInertiaDiagonal=frames.scaled(frames.scaled(loaded.moments, of_mass), of_inertia),
            physicsClientId=self._client,
        )

    @property
    def least_inertia_factor(self) -> float:
        """The least factor on the mass or the inertia of a link that moves; 1 for those that were not set."""
        factors = (
            self._factors.get(index, (1.0, 1.0))
            for index in self.links.values()
            if index != BASE_LINK or not self.fixed
        )
        return min((mass * min(inertia, 1.0) for mass, inertia in factors), default=1.0)

    def deactivate(self) -> None:
        """Take the mass of the body. PyBullet does not simulate a body without mass: it stays in place.
        This does nothing for a fixed body."""
        if not self.fixed and not self._is_deactivated:
            self._is_deactivated = True
            p.changeDynamics(self.number, BASE_LINK, mass=0.0, physicsClientId=self._client)

    def activate(self) -> None:
        """Give a deactivated body its set mass again."""
        if self._is_deactivated:
            self._is_deactivated = False
            self._factors.setdefault(BASE_LINK, (1.0, 1.0))
            self._apply_weight(BASE_LINK)

    @property
    def is_centered(self) -> bool:
        """Whether the root link's frame is that of its inertia, so that the poses of PyBullet need no
        conversion."""
        return self.center == ZERO_VECTOR and self._parallel

    def center_pose(self, position: Triple, orientation: Quaternion) -> Frame:
        """Return the pose of the inertia, from that of the root link."""
        if self.is_centered:
            return position, orientation
        return frames.add(position, frames.rotate(orientation, self.center)), frames.multiply(
            orientation, self.principal
        )

    def origin_pose(self, position: Triple, orientation: Quaternion) -> Frame:
        """Return the pose of the root link, from that of the inertia."""
        rotation = orientation if self._parallel else frames.multiply(orientation, self._back)
        return frames.subtract(position, frames.rotate(rotation, self.center)), rotation


# Readings

R = TypeVar("R")
# Reading up to 3 joints takes less time than checking the cache.
MAX_UNCACHED_JOINTS = 3


class ReadCache:
    """Counts the states of a world, so that a pose that several sensors, signals and rewards read is computed
    once per state.

    `generation` is a list with the number of the present state; code that changes the world increments it.
    """

    def __init__(self) -> None:
        self.generation = [0]
        self._readers: dict[Hashable, Callable[[], Any]] = {}

    def invalidate(self) -> None:
        self.generation[0] += 1

    def cached(self, key: Hashable, read: Callable[[], R]) -> Callable[[], R]:
        """Return a reader that calls `read` once per state, for any number of readings; readers with the same
        key are one.

        The check costs 0.07 us, so it is for readings that take several times as long.
        """
        now = self.generation
        moment = -1
        value = None

        def reader() -> R | None:
            nonlocal moment, value
            if moment != now[0]:
                value = read()
                moment = now[0]
            return value

        return self._readers.setdefault(key, reader)


def joint_reader(client: int, number: int, indices: tuple[int, ...], read_cache: ReadCache) -> JointReader:
    """Return a reader of the states of joints."""
    read: JointReader = partial(p.getJointStates, number, indices, client)
    return (
        read if len(indices) <= MAX_UNCACHED_JOINTS else read_cache.cached(("joints", number, indices), read)
    )


def pose_reader(client: int, owner: Body, index: int, read_cache: ReadCache) -> PoseReader:
    """Return a reader of the pose of a link."""
    number = owner.number
    if index != BASE_LINK:
        read_link: Callable[[], tuple[Triple, ...]] = partial(p.getLinkState, number, index, 0, 1, client)
        key = ("pose", number, index)
        # 4 and 5 are the frame of the link; 0 and 1 would be that of its inertia.
        return read_cache.cached(key, lambda: read_link()[4:6])  # type: ignore[return-value, arg-type]
    if owner.is_centered:
        return partial(p.getBasePositionAndOrientation, number, client)
    root_frames = _root_frame_reader(client, owner, read_cache)
    return lambda: root_frames()[1]


def velocity_reader(client: int, owner: Body, index: int, read_cache: ReadCache) -> VelocityReader:
    """Return a reader of the velocity and the angular velocity of a link, at its origin."""
    if index == BASE_LINK and owner.center == ZERO_VECTOR:
        read: VelocityReader = partial(p.getBaseVelocity, owner.number, client)
        return read
    read_motion = motion_reader(client, owner, index, read_cache)
    return lambda: read_motion()[1]


def motion_reader(client: int, owner: Body, index: int, read_cache: ReadCache) -> MotionReader:
    """Return a reader of the pose and the velocities of a link."""
    number = owner.number
    if index != BASE_LINK:
        # The arguments 1, 1: with velocities, and with kinematics of the present state.
        read_link = partial(p.getLinkState, number, index, 1, 1, client)

        def of_link() -> Motion:
            center, _, _, _, origin, rotation, linear, angular = read_link()
            return (origin, rotation), (
                frames.add(linear, frames.cross(angular, frames.subtract(origin, center))),
                angular,
            )

        return read_cache.cached(("motion", number, index), of_link)
    read_velocity = partial(p.getBaseVelocity, number, client)
    if owner.is_centered:
        read_pose = partial(p.getBasePositionAndOrientation, number, client)
        return read_cache.cached(("motion", number, index), lambda: (read_pose(), read_velocity()))
    root_frames = _root_frame_reader(client, owner, read_cache)

    def of_origin() -> Motion:
        center, pose = root_frames()
        linear, angular = read_velocity()
        return pose, (frames.add(linear, frames.cross(angular, frames.subtract(pose[0], center))), angular)

    return read_cache.cached(("motion", number, index), of_origin)


def angular_momentum_reader(client: int, owner: Body, read_cache: ReadCache) -> VectorReader:
    """Return a reader of the angular momentum of a robot about its center of mass. PyBullet gives a fixed
    base no mass; it counts with that of the model."""
    number = owner.number
    below = tuple(index for index in owner.links.values() if index != BASE_LINK)
    root = owner.model.link(owner.model.root).inertial
    base_mass = root.mass if owner.fixed and root is not None else None

    def read() -> Triple:
        base, rotation = p.getBasePositionAndOrientation(number, client)
        states = p.getLinkStates(number, below, 1, 1, client) if below else ()
        motions = [
            (base, rotation, *p.getBaseVelocity(number, client)),
            *((*link[:2], *link[6:8]) for link in states),
        ]
        total = 0.0
        momentum = ZERO_VECTOR
        first_moment = ZERO_VECTOR
        linear_momentum = ZERO_VECTOR
        for index, (position, rotation, speed, turning) in zip((BASE_LINK, *below), motions, strict=True):
            mass, _, (ix, iy, iz) = p.getDynamicsInfo(number, index, client)[:3]
            mass = base_mass if base_mass is not None and index == BASE_LINK else mass
            arm = frames.subtract(position, base)
            x, y, z = frames.rotate_back(rotation, turning)
            spin = frames.rotate(rotation, (ix * x, iy * y, iz * z))
            momentum = frames.add(momentum, frames.add(spin, frames.scaled(frames.cross(arm, speed), mass)))
            first_moment = frames.add(first_moment, frames.scaled(arm, mass))
            linear_momentum = frames.add(linear_momentum, frames.scaled(speed, mass))
            total += mass
        of_center = frames.scaled(frames.cross(first_moment, linear_momentum), 1.0 / total)
        return frames.subtract(momentum, of_center)

    return read_cache.cached(("angular momentum", number), read)


def _root_frame_reader(client: int, owner: Body, read_cache: ReadCache) -> Callable[[], tuple[Triple, Frame]]:
    """Return a reader of the center of mass of a root link, and of the pose of the link."""
    read = partial(p.getBasePositionAndOrientation, owner.number, client)

    def placed() -> tuple[Triple, Frame]:
        center, rotation = read()
        return center, owner.origin_pose(center, rotation)

    return read_cache.cached(("placed", owner.number), placed)


# Parameters

_CONTACT_PARAMETERS = {
    "lateral_friction": "lateralFriction",
    "spinning_friction": "spinningFriction",
    "rolling_friction": "rollingFriction",
    "restitution": "restitution",
}
"""PyBullet's names of the parameters of contacts."""


class Parameters:
    """Sets a parameter by the method of its name, with its owner and the values.

    `light`, the brightness of pictures, and `gravity` (m/s^2) are the present ones; at first those of the
    world model.
    """

    def __init__(
        self,
        client: int,
        world: WorldModel,
        pools: dict[str, Pool[Body]],
        floor: Floor | None,
        damping: Callable[[Body], Damping],
    ) -> None:
        self.light = world.light
        self.gravity = world.gravity
        self._client = client
        self._pools = pools
        self._floor = floor
        self._damping = damping
        self._undo: dict[object, Callable[[], object]] = {}

    def restore(self) -> None:
        """Restore every parameter of the world model."""
        for back in self._undo.values():
            back()
        self._undo.clear()

    def set(self, parameter: EngineParameter, owner: tuple[str, ...], values: Sequence[float]) -> None:
        """See `Engine.set_parameter`."""
        if parameter in _CONTACT_PARAMETERS:
            self._set_contact(_CONTACT_PARAMETERS[parameter], *owner, *values)  # type: ignore[arg-type]
        else:
            set_value = getattr(self, f"_set_{parameter}", None)
            if set_value is None:
                raise EngineError(f"PyBullet cannot set `{parameter}` of {' '.join(map(repr, owner))}")
            set_value(*owner, *values)

    def _body(self, name: str) -> Body:
        return named(self._pools, name, "the world has no body").current

    def _link(self, body: str, link: str) -> tuple[Body, int]:
        owner = self._body(body)
        return owner, named(owner.links, link, f"'{body}' has no link") if link else BASE_LINK

    def _joint(self, robot: str, joint: str) -> tuple[Body, int]:
        owner = self._body(robot)
        return owner, named(owner.joints, joint, f"'{robot}' has no joint")

    def _set_mass(self, body: str, link: str, mass: float) -> None:
        """Set the mass of a link. The base of a fixed body keeps its mass, because another mass would free
        it."""
        owner, index = self._link(body, link)
        if index == BASE_LINK and owner.fixed:
            return
        usual = owner.dynamics(index).mass
        if not (usual > 0.0 and mass > 0.0):
            raise EngineError(
                f"the mass of a link of '{owner.name}' cannot go from {usual:g} kg to {mass:g} kg"
            )
        owner.scale_mass(index, mass / usual)
        self._undo["mass", owner.number, index] = partial(owner.scale_mass, index, 1.0)

    def _set_inertia(self, body: str, link: str, factor: float) -> None:
        """Multiply the inertia of a link. The inertia of the base of a fixed body has no effect."""
        owner, index = self._link(body, link)
        if index == BASE_LINK and owner.fixed:
            return
        if not factor > 0.0:
            raise EngineError(f"the inertia of a link of '{owner.name}' cannot be multiplied by {factor:g}")
        owner.scale_inertia(index, factor)
        self._undo["inertia", owner.number, index] = partial(owner.scale_inertia, index, 1.0)

    def _set_contact(self, name: str, body: str, link: str, value: float) -> None:
        """Set one property per call: with two in one call, one was set on the root link."""
        owner, index = self._link(body, link)
        change = partial(p.changeDynamics, owner.number, index, physicsClientId=self._client)
        usual = contact_parameters(owner.model.link(link or owner.model.root).friction)
        change(**{name: value})
        self._undo[name, owner.number, index] = partial(change, **{name: usual[name]})

    def _set_joint_damping(self, robot: str, joint: str, damping: float) -> None:
        """Set the damping of a joint. A reset restores that of every joint, so no undo is recorded."""
        owner, index = self._joint(robot, joint)
        self._damping(owner).set(index, damping)

    def _set_joint_friction(self, robot: str, joint: str, friction: float) -> None:
        """Set the friction of a joint. A reset brakes every joint anew, so no undo is recorded."""
        owner, index = self._joint(robot, joint)
        p.setJointMotorControl2(
            owner.number, index, p.VELOCITY_CONTROL, 0.0, 0.0, friction, *DEFAULT_GAINS, self._client
        )

    def _set_gravity(self, x: float, y: float, z: float) -> None:
        # The first call of an episode finds the value of the world model.
        self._undo.setdefault("gravity", partial(self._apply_gravity, self.gravity))
        self._apply_gravity((x, y, z))

    def _apply_gravity(self, gravity: Triple) -> None:
        self.gravity = gravity
        p.setGravity(*gravity, self._client)

    def _set_color(self, body: str, link: str, *color: float) -> None:
        if body == GROUND and self._floor is not None:
            self._floor.color(color)  # type: ignore[arg-type]
            self._undo["floor"] = partial(self._floor.color, self._floor.default_color)
            return
        owner, index = self._link(body, link)
        key = ("color", owner.number, index)
        if key not in self._undo:
            shapes = p.getVisualShapeData(owner.number, physicsClientId=self._client)
            usual = [shape[7] for shape in shapes if shape[1] == index]  # 1 is the link, 7 the color
            self._undo[key] = partial(self._paint, owner.number, index, usual)
        p.changeVisualShape(owner.number, index, rgbaColor=color, physicsClientId=self._client)

    def _paint(self, number: int, index: int, colors: list[Color]) -> None:
        for shape_index, color in enumerate(colors):
            p.changeVisualShape(
                number, index, shapeIndex=shape_index, rgbaColor=color, physicsClientId=self._client
            )

    def _set_light(self, brightness: float) -> None:
        self._undo.setdefault("light", partial(setattr, self, "light", self.light))
        self.light = brightness


def contact_parameters(friction: Friction) -> dict[str, float]:
    """Return the parameters under PyBullet's names. PyBullet multiplies the coefficients of both bodies, so a
    coefficient that is not given is 1 for `lateral`, and 0 for the others."""
    lateral = 1.0 if friction.lateral is None else friction.lateral
    other_coefficients = (friction.spinning or 0.0, friction.rolling or 0.0, friction.restitution or 0.0)
    return dict(zip(_CONTACT_PARAMETERS.values(), (lateral, *other_coefficients), strict=True))
