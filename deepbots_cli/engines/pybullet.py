"""PyBullet behind the port; the only module that imports it.

What PyBullet leaves to its callers, and is settled here:

- a joint starts with a braking motor: ours start free, but for the friction that their file states
- a fresh world and a reset one differ by what contacts and motors left behind, unless every body was far
  from every other for one step, and by how bodies are grouped for the solver, unless all are one group;
  both worlds are made by the same `reset`
- links without an inertial would weigh 1 kg: ours weigh nothing, which a link that moves may not
- the friction of a pair is the product of the two; a link that states none has 1, so that the other decides
- links of one robot do not touch each other
- poses of bodies are those of their centre of mass, velocities too: converted where the two points differ
- poses of links lag one engine step behind unless their kinematics are asked for
- cylinders are hulls, 1 mm too large and bumpy, unless implicit: a cart driven at 0.2 m/s did 0.2049 and lost
  half of it in 1.3 s of coasting; implicit, 0.2000 and nothing
"""

from __future__ import annotations

import tempfile
import weakref
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from itertools import pairwise
from math import copysign, degrees, isfinite
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from deepbots_cli import frames
from deepbots_cli.engines import loadable, solids
from deepbots_cli.engines.backdrop import axes, backdrop, smoothed
from deepbots_cli.engines.lookup import find
from deepbots_cli.engines.lump import held_by
from deepbots_cli.engines.quiet import hushed
from deepbots_cli.engines.servo import SERVO_TIME, Servo
from deepbots_cli.errors import EngineError
from deepbots_cli.urdf.model import Mesh, RobotModel
from deepbots_cli.urdf.writer import write

with hushed():  # the library prints the time of its build
    import pybullet as p

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from deepbots_cli.frames import Quaternion, Triple
    from deepbots_cli.ir import WorldModel
    from deepbots_cli.port import Capability, Image, JointReader, MotorWriter, PoseReader, TorqueReader, VelocityReader, View

STILL: Triple = (0.0, 0.0, 0.0)
BASE = -1  # PyBullet's number for the root link
APART = 1000.0  # m between bodies that are parked to forget their contacts
UNREACHABLE = 1e9  # rad/s or m/s; a velocity motor that aims there exerts exactly its limit
STRONGEST = 1e12  # N m or N; stands for an unlimited motor
FAINT = 1e-200  # N m or N; stands for none, at which a motor would go on reporting what it last exerted
GAINS = (0.1, 1.0, -1.0)  # PyBullet's own position and velocity gain, and no cap; positional arguments cost half of named ones


class Body:
    """A robot or an object: its PyBullet number, links and joints by name, a link that moves and touches, and where it starts."""

    def __init__(self, name: str, number: int, model: RobotModel, fixed: bool, client: int) -> None:
        self.name = name
        self.number = number
        self.links = {model.root: BASE}
        self.joints: dict[str, int] = {}
        for index in range(p.getNumJoints(number, client)):
            info = p.getJointInfo(number, index, client)
            self.joints[info[1].decode()] = index
            self.links[info[12].decode()] = index
        self.brakes = {self.joints[joint.name]: joint.friction for joint in model.moving_joints}
        still = held_by(model, model.root) if fixed else {}
        touching = [self.links[link.name] for link in model.links if link.collisions and link.name not in still]
        self.anchor = touching[0] if touching else None
        base = p.getDynamicsInfo(number, BASE, client)
        self.centre: Triple = base[3]
        self.principal: Quaternion = base[4]
        self.home: tuple[Triple, Quaternion] = (STILL, frames.UPRIGHT)

    @property
    def centred(self) -> bool:
        """Whether the root link's frame is that of its inertia, so that PyBullet's figures are ours."""
        return self.centre == STILL and self.principal == frames.UPRIGHT

    def of_centre(self, position: Triple, orientation: Quaternion) -> tuple[Triple, Quaternion]:
        """The pose of the inertia, from that of the root link."""
        if self.centred:
            return position, orientation
        return frames.add(position, frames.rotate(orientation, self.centre)), frames.multiply(orientation, self.principal)

    def of_origin(self, position: Triple, orientation: Quaternion) -> tuple[Triple, Quaternion]:
        """The pose of the root link, from that of the inertia."""
        turned = frames.multiply(orientation, frames.inverse(self.principal))
        return frames.subtract(position, frames.rotate(turned, self.centre)), turned


class PyBulletEngine:
    """One world in a client of its own: about 29 MB until it is closed or dropped, and its readers and writers with it."""

    name = "pybullet"
    capabilities: frozenset[Capability] = frozenset({"contacts", "rendering"})

    def __init__(self, world: WorldModel) -> None:
        self._client: int = p.connect(p.DIRECT)
        if self._client < 0:
            raise EngineError("PyBullet holds no further world in this process; close some environments")
        self._has_floor = world.ground is not None
        self._moving: list[Body] = []
        self._bodies: dict[str, Body] = {}
        self._servos: list[Servo] = []
        self._each_substep: list[Callable[[], None]] = []
        self._backdrop: tuple[View, Image] | None = None
        self._timestep = world.timestep / world.substeps
        self._release = weakref.finalize(self, _release, self._client, self._each_substep)
        self.step = _stepper(self._client, self._each_substep)
        try:
            self._build(world)
        except BaseException:
            self.close()
            raise

    def _build(self, world: WorldModel) -> None:
        client = self._client
        p.setGravity(*world.gravity, client)
        p.setPhysicsEngineParameter(
            fixedTimeStep=self._timestep, deterministicOverlappingPairs=1, enableFileCaching=0, physicsClientId=client
        )
        if world.ground is not None:
            plane = p.createCollisionShape(p.GEOM_PLANE, physicsClientId=client)
            unseen = p.createVisualShape(p.GEOM_SPHERE, radius=1e-3, rgbaColor=(0, 0, 0, 0), physicsClientId=client)
            ground = p.createMultiBody(0, plane, unseen, physicsClientId=client)
            p.changeDynamics(ground, BASE, lateralFriction=world.ground.friction, physicsClientId=client)
            p.changeDynamics(ground, BASE, restitution=world.ground.restitution, physicsClientId=client)
        with tempfile.TemporaryDirectory(prefix="deepbots-") as folder:
            for thing in (*(solids.walls(world.arena) if world.arena else ()), *world.objects):
                known = not isinstance(thing.shape, Mesh)
                body = self._load(thing.name, solids.as_robot(thing), not solids.moves(thing), folder, inertia_known=known)
                body.home = body.of_centre(*frames.frame(thing.pose))
            for robot in world.robots:
                body = self._load(robot.name, loadable.movable(robot.name, robot.model, robot.fixed_base), robot.fixed_base, folder)
                body.home = body.of_centre(*frames.frame(robot.pose))
        self._join_islands()
        self.reset()

    def _join_islands(self) -> None:
        """Tie all that moves to one another with gears that exert nothing, so that the solver sees one group.

        It solves bodies whose boxes overlap together, iterates until such a group is done, and forgets overlaps
        at a moment that depends on the whole past. Of 150 episodes of three carts after a reset 34 differed from
        a fresh world's; tied together, none. 20 idle balls then cost 50 us a step; a robot by itself nothing.
        """
        anchors = [(body.number, body.anchor) for body in self._moving if body.anchor is not None]
        for (one, link), (other, other_link) in pairwise(anchors):
            gear = p.createConstraint(one, link, other, other_link, p.JOINT_GEAR, (0, 1, 0), STILL, STILL, physicsClientId=self._client)
            p.changeConstraint(gear, maxForce=0.0, physicsClientId=self._client)

    def _load(self, name: str, model: RobotModel, fixed: bool, folder: str, inertia_known: bool = True) -> Body:
        file = Path(folder, f"{len(self._bodies)}.urdf")
        file.write_text(write(loadable.dressed(model)), encoding="utf-8")
        flags = p.URDF_USE_IMPLICIT_CYLINDER | (p.URDF_USE_INERTIA_FROM_FILE if inertia_known else 0)
        with hushed() as said:
            try:
                number = p.loadURDF(str(file), useFixedBase=int(fixed), flags=flags, physicsClientId=self._client)
            except p.error as error:
                raise EngineError(f"PyBullet cannot load '{name}': {said() or error}") from error
        body = Body(name, number, model, fixed, self._client)
        self._bodies[name] = body
        if not fixed or body.joints:
            self._moving.append(body)
        self._set_dynamics(body, model)
        return body

    def _set_dynamics(self, body: Body, model: RobotModel) -> None:
        """One property per call: of several in one, PyBullet gives some to the root link instead."""
        change = partial(p.changeDynamics, body.number, physicsClientId=self._client)
        for link in model.links:
            index, friction = body.links[link.name], link.friction
            change(index, lateralFriction=1.0 if friction.lateral is None else friction.lateral)
            change(index, spinningFriction=friction.spinning or 0.0)
            change(index, rollingFriction=friction.rolling or 0.0)
            change(index, restitution=friction.restitution or 0.0)
        change(BASE, linearDamping=0.0)
        change(BASE, angularDamping=0.0)
        change(BASE, maxJointVelocity=UNREACHABLE)
        change(BASE, activationState=p.ACTIVATION_STATE_DISABLE_SLEEPING)

    def reset(self) -> None:
        """As the port says. A world whose figures are no longer finite cannot be reset, only built again."""
        self.require_finite()
        for servo in self._servos:
            servo.targets = None
        for row, body in enumerate(self._moving, start=1):
            self._restart(body, ((row * APART, 0.0, APART), frames.UPRIGHT), dict.fromkeys(body.brakes, FAINT))
        p.stepSimulation(self._client)
        for body in self._bodies.values():
            self._restart(body, body.home, body.brakes)

    def _restart(self, body: Body, pose: tuple[Triple, Quaternion], brakes: dict[int, float]) -> None:
        """Put the centre of a body there, all of it at rest, with brakes of so many N m or N on its joints."""
        number, client = body.number, self._client
        p.resetBasePositionAndOrientation(number, *pose, client)
        p.resetBaseVelocity(number, STILL, STILL, client)
        for index, brake in brakes.items():
            p.resetJointState(number, index, 0.0, 0.0, client)
            p.setJointMotorControl2(number, index, p.VELOCITY_CONTROL, 0.0, 0.0, brake, *GAINS, client)

    def place(self, body: str, position: Triple, orientation: Quaternion) -> None:
        placed = self._body(body)
        pose = placed.of_centre(position, frames.normalised(orientation))
        p.resetBasePositionAndOrientation(placed.number, *pose, self._client)
        p.resetBaseVelocity(placed.number, STILL, STILL, self._client)

    def set_joint(self, robot: str, joint: str, position: float, velocity: float) -> None:
        number, (index,) = self._joints(robot, (joint,))
        p.resetJointState(number, index, position, velocity, self._client)

    def require_finite(self) -> None:
        client = self._client
        for body in reversed(self._open()._moving):  # robots before objects, to which they spread what is not a number
            joints = p.getJointStates(body.number, tuple(body.brakes), client) if body.brakes else ()
            for what, figures in (("pose", p.getBasePositionAndOrientation(body.number, client)), ("joints", (j[:2] for j in joints))):
                if not isfinite(sum(map(sum, figures))):
                    raise EngineError(f"the {what} of '{body.name}' left the range of numbers")

    def joint_states(self, robot: str, joints: Sequence[str]) -> JointReader:
        return partial(p.getJointStates, *self._joints(robot, joints), self._client)

    def joint_torques(self, robot: str, joints: Sequence[str]) -> TorqueReader:
        read = self.joint_states(robot, joints)
        return lambda: [state[3] for state in read()]

    def pose(self, body: str, link: str | None = None) -> PoseReader:
        owner, index = self._link(body, link)
        number, client = owner.number, self._client
        if index != BASE:
            read_link = partial(p.getLinkState, number, index, 0, 1, client)
            return lambda: read_link()[4:6]
        read: PoseReader = partial(p.getBasePositionAndOrientation, number, client)
        return read if owner.centred else lambda: owner.of_origin(*read())

    def velocity(self, body: str, link: str | None = None) -> VelocityReader:
        owner, index = self._link(body, link)
        number, client = owner.number, self._client
        if index != BASE:
            return _link_velocity(partial(p.getLinkState, number, index, 1, 1, client))
        read: VelocityReader = partial(p.getBaseVelocity, number, client)
        if owner.centre == STILL:
            return read
        read_pose = partial(p.getBasePositionAndOrientation, number, client)

        def of_origin() -> tuple[Triple, Triple]:
            (linear, angular), (centre, turned) = read(), read_pose()
            arm = frames.subtract(owner.of_origin(centre, turned)[0], centre)
            return frames.add(linear, frames.cross(angular, arm)), angular

        return of_origin

    def velocity_motor(self, robot: str, joints: Sequence[str], max_torque: Sequence[float]) -> MotorWriter:
        body, indices = self._joints(robot, joints)
        limits, client, mode = _limits(max_torque), self._client, p.VELOCITY_CONTROL
        if len(indices) == 1:
            (index,), (limit,), set_one = indices, limits, p.setJointMotorControl2
            return lambda targets: set_one(body, index, mode, 0.0, targets[0], limit, *GAINS, client)
        zeros, gains, set_all = [0.0] * len(indices), [[gain] * len(indices) for gain in GAINS[:2]], p.setJointMotorControlArray
        return lambda targets: set_all(body, indices, mode, zeros, targets, limits, *gains, client)

    def torque_motor(self, robot: str, joints: Sequence[str], max_torque: Sequence[float]) -> MotorWriter:
        """A velocity motor that aims out of reach, and so exerts its limit, which is the target torque.

        PyBullet forgets plain torques after every engine step; renewing them costs as much as the motor from
        four substeps on, and their reader would not show them. The motions agree to the last digit or two.
        """
        body, indices = self._joints(robot, joints)
        client, mode, set_one = self._client, p.VELOCITY_CONTROL, p.setJointMotorControl2

        def exert(index: int, limit: float, torque: float) -> None:
            set_one(body, index, mode, 0.0, copysign(UNREACHABLE, torque), min(max(abs(torque), FAINT), limit), *GAINS, client)

        if len(indices) == 1:
            (index,), (limit,) = indices, _limits(max_torque)
            return lambda targets: exert(index, limit, targets[0])
        limits = _limits(max_torque)

        def exert_all(targets: Sequence[float]) -> None:
            for index, limit, torque in zip(indices, limits, targets, strict=True):
                exert(index, limit, torque)

        return exert_all

    def position_motor(
        self,
        robot: str,
        joints: Sequence[str],
        max_torque: Sequence[float],
        stiffness: Sequence[float] | None,
        damping: Sequence[float] | None,
    ) -> MotorWriter:
        if stiffness is not None:
            exert = self.torque_motor(robot, joints, max_torque)
            servo = Servo(self.joint_states(robot, joints), exert, stiffness, damping)
            self._servos.append(servo)
            self._each_substep.append(servo.act)
            return servo.aim
        body, indices = self._joints(robot, joints)
        limits, client, mode = _limits(max_torque), self._client, p.POSITION_CONTROL
        gains = [[min(1.0, self._timestep / SERVO_TIME)] * len(indices), [1.0] * len(indices)]
        zeros, set_all = [0.0] * len(indices), p.setJointMotorControlArray
        return lambda targets: set_all(body, indices, mode, targets, zeros, limits, *gains, client)

    def render(self, view: View) -> Image:
        self._open()
        fine = replace(view, width=view.width * view.samples, height=view.height * view.samples)
        if self._backdrop is None or self._backdrop[0] != fine:
            self._backdrop = (fine, backdrop(fine, self._has_floor))
        bodies, is_body = self._photograph(fine)
        return smoothed(np.where(is_body[..., None], bodies, self._backdrop[1]), view.samples)

    def close(self) -> None:
        self._release()

    def _photograph(self, view: View) -> tuple[Image, NDArray[np.bool_]]:
        """What the engine draws, and where it drew a body."""
        _, _, pixels, _, bodies = p.getCameraImage(
            view.width,
            view.height,
            p.computeViewMatrix(view.eye, view.target, axes(view)[2].tolist()),
            p.computeProjectionMatrixFOV(degrees(view.fov), view.width / view.height, 0.02, 100.0),
            lightDirection=(1.0, -1.5, 3.0),
            lightColor=(1.0, 1.0, 1.0),
            lightAmbientCoeff=0.55,
            lightDiffuseCoeff=0.5,
            lightSpecularCoeff=0.05,
            shadow=0,
            renderer=p.ER_TINY_RENDERER,
            physicsClientId=self._client,
        )
        shape = (view.height, view.width)
        return np.asarray(pixels, dtype=np.uint8).reshape(*shape, 4)[..., :3], np.asarray(bodies).reshape(shape) >= 0

    def _open(self) -> PyBulletEngine:
        if not self._release.alive:
            _refuse()
        return self

    def _body(self, name: str) -> Body:
        return find(self._open()._bodies, name, "the world has no body")

    def _link(self, body: str, link: str | None) -> tuple[Body, int]:
        owner = self._body(body)
        return owner, BASE if link is None else find(owner.links, link, f"'{body}' has no link")

    def _joints(self, robot: str, names: Sequence[str]) -> tuple[int, tuple[int, ...]]:
        body = self._body(robot)
        return body.number, tuple(find(body.joints, name, f"'{robot}' has no joint") for name in names)


def _stepper(client: int, each_substep: list[Callable[[], None]]) -> Callable[[int], None]:
    """`Engine.step`. The list is empty in most worlds; looking costs 1 % of the cheapest step."""
    advance = p.stepSimulation

    def step(substeps: int) -> None:
        if each_substep:
            for _ in range(substeps):
                for act in each_substep:
                    act()
                advance(client)
        else:
            for _ in range(substeps):
                advance(client)

    return step


def _limits(max_torque: Sequence[float]) -> list[float]:
    return [min(max(limit, FAINT), STRONGEST) for limit in max_torque]


def _link_velocity(read: Callable[[], Sequence[Triple]]) -> VelocityReader:
    def of_origin() -> tuple[Triple, Triple]:
        centre, _, _, _, origin, _, linear, angular = read()
        return frames.add(linear, frames.cross(angular, frames.subtract(origin, centre))), angular

    return of_origin


def _release(client: int, each_substep: list[Callable[[], None]]) -> None:
    p.disconnect(client)
    each_substep.insert(0, _refuse)  # another world may get this client's number


def _refuse() -> None:
    raise EngineError("this world was closed")
