"""The exact equations of motion of two small worlds: for tests, for lessons, and to measure other engines by.

It holds robots of two shapes, told by their joints whatever their names:

- on a fixed base, a link that slides (prismatic) and carries a link that turns (revolute or continuous)
- links that do not move against each other: a rigid body, at rest if its base is fixed

and objects, as rigid bodies. Nothing touches anything else, nothing sees and nothing can be drawn. A joint
that passes the end of its range is an error, since there are no stops.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from copy import deepcopy
from functools import partial
from typing import TYPE_CHECKING, Any

from deepbots_cli import frames
from deepbots_cli.engines.mechanics import as_robot, is_movable, named
from deepbots_cli.errors import EngineError
from deepbots_cli.port import ZERO_VECTOR
from deepbots_cli.robots.model import with_mass
from exact_engine.lump import joined
from exact_engine.motion import CartPole, Drive, RigidBody

if TYPE_CHECKING:
    from deepbots_cli.frames import Quaternion, Triple
    from deepbots_cli.port import (
        Capability,
        JointReader,
        MotionReader,
        MotorWriter,
        Overlap,
        PoseReader,
        TorqueReader,
        VelocityReader,
    )
    from deepbots_cli.program.world import EngineParameter, RobotBody, WorldModel
    from deepbots_cli.robots.model import RobotModel


LACKING = {
    "choose": "bodies of several forms",
    "pusher": "forces on links",
    **dict.fromkeys(("contact", "contact_force", "contact_force_vector"), "contacts"),
    "joint_wrench": "wrenches in joints",
    "angular_momentum": "angular momenta",
    "clearance": "surfaces",
    "rays": "surfaces that rays could meet",
    **dict.fromkeys(("camera", "render"), "rendering"),
    "inverse_kinematics": "inverse kinematics",
}
"""What the methods of the port need that it has not."""


class Servo:
    """Exerts `stiffness * (target - position) - damping * velocity` once it has targets; `act` renews it."""

    def __init__(
        self,
        read: JointReader,
        exert: MotorWriter,
        stiffness: Sequence[float],
        damping: Sequence[float] | None,
    ) -> None:
        self.targets: Sequence[float] | None = None
        self._read, self._exert = read, exert
        self._gains = tuple(zip(stiffness, damping or (0.0,) * len(stiffness), strict=True))

    def aim(self, targets: Sequence[float]) -> None:
        self.targets = tuple(targets)

    def act(self) -> None:
        if self.targets is not None:
            sides = zip(self._gains, self.targets, self._read(), strict=True)
            self._exert(
                [
                    stiffness * (target - state[0]) - damping * state[1]
                    for (stiffness, damping), target, state in sides
                ]
            )


class ExactEngine:
    """One world of exact motions."""

    name = "exact"
    capabilities: frozenset[Capability] = frozenset({"snapshot"})

    def __init__(self, world: WorldModel) -> None:
        self._timestep = world.timestep / world.substeps
        self.gravity = world.gravity
        self._models: dict[str, RobotModel] = {}
        self._ways_back: list[Callable[[], object]] = []
        self._callbacks: list[Callable[[], object]] = []
        self._motions: dict[str, RigidBody | CartPole] = {}
        self._homes: dict[str, frames.Frame] = {}
        self._servos: dict[tuple[str, tuple[str, ...]], Servo] = {}
        self._closed = False
        for thing in world.objects:
            if thing.pooled:
                raise _lacks(f"bodies that come and go, such as '{thing.name}'")
            model = as_robot(thing)
            motion = RigidBody(joined(model, model.root), world.gravity, is_movable(thing))
            self._add(thing.name, model, motion, frames.frame(thing.pose))
        for robot in world.robots:
            self._add(robot.name, robot.model, _motion(robot, world.gravity), frames.frame(robot.pose))
        flying = [
            name for name, motion in self._motions.items() if isinstance(motion, RigidBody) and motion.flies
        ]
        if flying and (world.ground or world.arena):
            raise EngineError(
                f"the exact engine has no contacts: '{flying[0]}' would fall through the ground; use engine"
                " 'pybullet'"
            )
        self.reset()

    def _add(self, name: str, model: RobotModel, motion: RigidBody | CartPole, home: frames.Frame) -> None:
        self._motions[name], self._models[name], self._homes[name] = motion, model, home

    def reset(self) -> None:
        for back in reversed(self._ways_back):
            back()
        self._ways_back.clear()
        for servo in self._servos.values():
            servo.targets = None
        for name, motion in self._open().items():
            motion.place(self._homes[name])
            if isinstance(motion, CartPole):
                motion.rest()

    def place(
        self,
        body: str,
        position: Triple,
        orientation: Quaternion,
        velocity: Triple = ZERO_VECTOR,
        angular_velocity: Triple = ZERO_VECTOR,
    ) -> None:
        motion = self._motion(body)
        motion.place((position, frames.normalized(orientation)))
        motion.throw(velocity, angular_velocity)

    def set_joint(self, robot: str, joint: str, position: float, velocity: float) -> None:
        motion, (index,) = self._joints(robot, (joint,))
        motion.set_joint(index, position, velocity)

    def set_parameter(self, parameter: EngineParameter, owner: tuple[str, ...], *values: float) -> None:
        if parameter in ("color", "light"):
            return  # nothing sees it
        setter = getattr(self, f"_set_{parameter}", None)
        if setter is None:
            raise _lacks(f"parameters such as {parameter}")
        setter(*owner, *values)

    def _set_mass(self, body: str, link: str, mass: float) -> None:
        motion, name = self._link(body, link or None)
        usual = self._models[body]
        inertial = usual.link(name).inertial
        if inertial is None or inertial.mass <= 0.0:
            raise EngineError(f"link '{name}' of '{body}' has no mass that could change")
        changed = with_mass(usual, name, mass)
        assert not isinstance(changed, str)
        self._weigh(body, motion, changed)
        self._ways_back.append(partial(self._weigh, body, motion, usual))

    def _weigh(self, body: str, motion: RigidBody | CartPole, model: RobotModel) -> None:
        """Give it the masses of `model`, where it stands."""
        frame = motion.pose(model.root)
        motion.weigh(*(joined(model, lump) for lump in motion.lumps))
        motion.place(frame)
        self._models[body] = model

    def _set_joint_damping(self, robot: str, joint: str, damping: float) -> None:
        motion, (index,) = self._joints(robot, (joint,))
        motion.damp(index, damping)
        self._ways_back.append(partial(motion.damp, index, self._models[robot].joint(joint).damping))

    def _set_joint_friction(self, robot: str, joint: str, friction: float) -> None:
        if friction:
            raise _lacks("friction in joints")

    def _set_gravity(self, x: float, y: float, z: float) -> None:
        self._ways_back.append(partial(self._pull, self.gravity))
        self._pull((x, y, z))

    def _pull(self, gravity: Triple) -> None:
        self.gravity = gravity
        for motion in self._open().values():
            motion.pull(gravity)

    def before_substep(self, callback: Callable[[], object]) -> None:
        self._callbacks.append(callback)

    def step(self, substeps: int) -> None:
        motions = self._open().values()
        for _ in range(substeps):
            for callback in self._callbacks:
                callback()
            for servo in self._servos.values():
                servo.act()
            for motion in motions:
                motion.advance(self._timestep)

    def overlaps(self) -> tuple[Overlap, ...]:
        """None: bodies know nothing of each other here."""
        return ()

    def require_finite(self) -> None:
        for name, motion in self._open().items():
            if not motion.finite:
                raise EngineError(f"the pose of '{name}' became infinite or NaN")

    def joint_states(self, robot: str, joints: Sequence[str]) -> JointReader:
        motion, indices = self._joints(robot, joints)

        def read() -> Sequence[Sequence[float]]:
            state = motion.state
            return [(state[i], state[i + 2]) for i in indices]

        return read

    def joint_torques(self, robot: str, joints: Sequence[str]) -> TorqueReader:
        motion, indices = self._joints(robot, joints)
        return lambda: [motion.efforts[i] for i in indices]

    def pose(self, body: str, link: str | None = None) -> PoseReader:
        motion, name = self._link(body, link)
        return lambda: motion.pose(name)

    def velocity(self, body: str, link: str | None = None) -> VelocityReader:
        motion, name = self._link(body, link)
        return lambda: motion.velocity(name)

    def motion(self, body: str, link: str | None = None) -> MotionReader:
        motion, name = self._link(body, link)
        return lambda: (motion.pose(name), motion.velocity(name))

    def velocity_motor(self, robot: str, joints: Sequence[str], max_torque: Sequence[float]) -> MotorWriter:
        return self._motor(
            robot, joints, max_torque, lambda target, limit: Drive(velocity=target, limit=limit)
        )

    def torque_motor(self, robot: str, joints: Sequence[str], max_torque: Sequence[float]) -> MotorWriter:
        return self._motor(
            robot, joints, max_torque, lambda target, limit: Drive(torque=min(max(target, -limit), limit))
        )

    def position_motor(
        self,
        robot: str,
        joints: Sequence[str],
        max_torque: Sequence[float],
        stiffness: Sequence[float] | None,
        damping: Sequence[float] | None,
    ) -> MotorWriter:
        if stiffness is None:
            return self._motor(
                robot, joints, max_torque, lambda target, limit: Drive(position=target, limit=limit)
            )
        exert = self.torque_motor(robot, joints, max_torque)
        servo = Servo(self.joint_states(robot, joints), exert, stiffness, damping)
        self._servos[robot, tuple(joints)] = servo
        return servo.aim

    def snapshot(self) -> object:
        motions = {name: deepcopy(vars(motion)) for name, motion in self._open().items()}
        targets = {key: servo.targets for key, servo in self._servos.items()}
        return motions, targets, self.gravity, dict(self._models), list(self._ways_back)

    def restore(self, snapshot: Any) -> None:
        motions, targets, self.gravity, models, ways_back = snapshot
        for name, motion in self._open().items():
            vars(motion).update(deepcopy(motions[name]))
        for key, servo in self._servos.items():
            servo.targets = targets.get(key)
        self._models = dict(models)
        self._ways_back = list(ways_back)

    def __getattr__(self, method: str) -> Callable[..., Any]:
        if method not in LACKING:
            raise AttributeError(method)

        def refuse(*args: Any, **options: Any) -> None:
            raise _lacks(LACKING[method])

        return refuse

    def close(self) -> None:
        self._closed = True

    def _motor(
        self,
        robot: str,
        joints: Sequence[str],
        max_torque: Sequence[float],
        driven: Callable[[float, float], Drive],
    ) -> MotorWriter:
        motion, indices = self._joints(robot, joints)
        limits = tuple(max_torque)

        def write(targets: Sequence[float]) -> None:
            for index, target, limit in zip(indices, targets, limits, strict=True):
                motion.drives[index] = driven(target, limit)

        return write

    def _open(self) -> dict[str, RigidBody | CartPole]:
        if self._closed:
            raise EngineError("this world was closed")
        return self._motions

    def _motion(self, body: str) -> RigidBody | CartPole:
        return named(self._open(), body, "the world has no body")

    def _link(self, body: str, link: str | None) -> tuple[RigidBody | CartPole, str]:
        motion = self._motion(body)
        name = link or self._models[body].root
        if name not in motion.links:
            raise EngineError(f"'{body}' has no link '{name}'; there are {', '.join(motion.links)}")
        return motion, name

    def _joints(self, robot: str, names: Sequence[str]) -> tuple[CartPole, list[int]]:
        motion = self._motion(robot)
        if not isinstance(motion, CartPole):
            raise EngineError(f"'{robot}' has no joints")
        return motion, [named(motion.joints, name, f"'{robot}' has no joint") for name in names]


def _lacks(what: str) -> EngineError:
    return EngineError(f"the exact engine has no {what}; use engine 'pybullet'")


def _motion(robot: RobotBody, gravity: Triple) -> RigidBody | CartPole:
    """The equations that fit the robot's joints."""
    model = robot.model
    base = joined(robot.model, robot.model.root)
    if len(base.members) == len(model.links):
        return RigidBody(base, gravity, flies=not robot.fixed_base)
    for joint in model.joints:
        if joint.friction or joint.mimic:
            raise EngineError(
                f"the exact engine has no friction in joints and no mimic joints, such as '{joint.name}' of"
                f" '{robot.name}'"
            )
    moving = sorted(model.moving_joints, key=lambda joint: joint.type != "prismatic")
    if robot.fixed_base and [joint.type == "prismatic" for joint in moving] == [True, False]:
        slide, hinge = moving
        cart, pole = joined(model, slide.child), joined(model, hinge.child)
        members = base.members | cart.members | pole.members
        if slide.parent in base.members and hinge.parent in cart.members and len(members) == len(model.links):
            return CartPole(base, cart, pole, slide, hinge, gravity)
    raise EngineError(
        f"the exact engine has no equations for robot '{robot.name}': it knows single bodies, and on a fixed"
        " base "
        "a sliding link that carries a turning one"
    )
