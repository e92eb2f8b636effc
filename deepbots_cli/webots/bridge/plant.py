"""The state of a world in Webots, by the functions of its supervisor.

Frames are those of root links: m in the world, quaternions (x, y, z, w).
"""

from __future__ import annotations

from math import atan2, hypot
from typing import TYPE_CHECKING, Any, NamedTuple

from deepbots_cli import frames
from deepbots_cli.engines.objects import is_movable
from deepbots_cli.webots.bridge.names import def_name, joint_def

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from deepbots_cli.frames import Quaternion, Triple
    from deepbots_cli.port import Part
    from deepbots_cli.program.world import WorldModel
    from deepbots_cli.robots.model import Joint


class Motion(NamedTuple):
    """The frame and the velocities of a body: m, quaternion, m/s, rad/s."""

    position: Triple
    orientation: Quaternion
    linear: Triple
    angular: Triple


class Plant:
    """Reads and sets the bodies of a world."""

    def __init__(self, supervisor: Any, world: WorldModel) -> None:
        """Take the nodes of the world.

        Args:
            supervisor: The `controller.Supervisor` of the world.
            world: The world of the scenario; the world of Webots has the same names.
        """
        self.supervisor = supervisor
        self._nodes: dict[str, Any] = {}
        robots = {robot.name: robot for robot in world.robots}
        self.moving_bodies = [
            *(name for name, robot in robots.items() if not robot.fixed_base),
            *(body.name for body in world.objects if is_movable(body)),
        ]
        self.joints = [
            (robot.name, _JointReader(self, robot.name, joint))
            for robot in world.robots
            for joint in robot.model.moving_joints
        ]
        self._roots = {name: robot.model.root for name, robot in robots.items()}

    def node(self, *parts: str) -> Any:
        """Return the node of a body, or of one of its links."""
        if len(parts) == 2 and self._roots.get(parts[0], parts[0]) == parts[1]:
            parts = parts[:1]
        return self._node(def_name(*parts))

    def _node(self, name: str) -> Any:
        if name not in self._nodes:
            node = self.supervisor.getFromDef(name)
            if node is None:
                raise LookupError(f"the world has no node DEF {name}; export the scenario again")
            self._nodes[name] = node
        return self._nodes[name]

    def reset(self, timestep: int) -> None:
        """Bring the world back to its start, at rest; this takes a step of `timestep` ms."""
        self.supervisor.simulationReset()
        self.wait(timestep)
        # The reset happens within a step, whose physics has set bodies in motion already.
        self.supervisor.simulationResetPhysics()

    def wait(self, timestep: int) -> None:
        """Let the world run for some ms.

        Raises:
            SystemExit: Webots ends the simulation.
        """
        from controller import Robot  # type: ignore[import-not-found]

        if Robot.step(self.supervisor, timestep) == -1:
            raise SystemExit

    def motion(self, body: str, link: str | None = None) -> Motion:
        """Return the motion of a body, or of one of its links."""
        node = self.node(body) if link is None else self.node(body, link)
        x, y, z = node.getPosition()
        u, v, w, a, b, c = node.getVelocity()
        return Motion((x, y, z), _quaternion(node.getOrientation()), (u, v, w), (a, b, c))

    def place(
        self, body: str, position: Triple, orientation: Quaternion, linear: Triple, angular: Triple
    ) -> None:
        """Set the frame and the velocities of a body."""
        node = self.node(body)
        node.getField("translation").setSFVec3f(list(position))
        node.getField("rotation").setSFRotation(axis_angle(orientation))
        if any((*linear, *angular)):  # at rest since the reset of the physics, which comes before
            node.setVelocity([*linear, *angular])

    def set_joint(self, robot: str, joint: str, position: float) -> None:
        self._node(joint_def(robot, joint)).setJointPosition(position)

    def joint_node(self, robot: str, joint: str) -> Any:
        return self._node(joint_def(robot, joint))

    def set_gravity(self, gravity: Sequence[float]) -> None:
        """Set gravity, m/s^2; that of Webots is a number, and downward."""
        self._node("WORLD_INFO").getField("gravity").setSFFloat(-gravity[2])

    def touch(self, part: Part) -> Callable[[], bool]:
        """Return whether anything touches a body, or one of its links, at the end of the last timestep."""
        body, link = part
        node = self.node(body) if link is None else self.node(body, link)
        inner = link is None
        return lambda: bool(node.getContactPoints(inner))


class _JointReader:
    """The state of a joint: rad or m, and the velocity by those of its two links."""

    def __init__(self, plant: Plant, robot: str, joint: Joint) -> None:
        self.name = joint.name
        self._plant, self._robot, self._joint = plant, robot, joint
        # URDF has the axis in the frame of the joint; this is that of the parent link.
        self._axis = frames.rotate(frames.frame(joint.origin)[1], joint.axis)
        self._field: Any = None

    def __call__(self) -> tuple[float, float]:
        joint = self._joint
        if self._field is None:
            node = self._plant.joint_node(self._robot, joint.name)
            self._field = node.getField("jointParameters").getSFNode().getField("position")
        parent = self._plant.motion(self._robot, joint.parent)
        child = self._plant.motion(self._robot, joint.child)
        axis = frames.rotate(parent.orientation, self._axis)
        if joint.type == "prismatic":
            arm = frames.subtract(child.position, parent.position)
            carried = frames.add(parent.linear, frames.cross(parent.angular, arm))
            return self._field.getSFFloat(), frames.dot(frames.subtract(child.linear, carried), axis)
        return self._field.getSFFloat(), frames.dot(frames.subtract(child.angular, parent.angular), axis)


def axis_angle(turned: Quaternion) -> list[float]:
    """Return a rotation as Webots writes it: an axis and an angle in rad."""
    x, y, z, w = turned
    length = hypot(x, y, z)
    if length == 0.0:
        return [0.0, 0.0, 1.0, 0.0]
    return [x / length, y / length, z / length, 2.0 * atan2(length, w)]


def _quaternion(rows: Sequence[float]) -> Quaternion:
    """Return the quaternion of a rotation matrix, row by row.

    The largest of its four numbers is computed first, so that none of the others loses digits (Shepperd).
    """
    a, b, c, d, e, f, g, h, i = rows
    trace = a + e + i
    largest = max(trace, a, e, i)
    if largest == trace:
        quaternion = (h - f, c - g, d - b, 1.0 + trace)
    elif largest == a:
        quaternion = (1.0 + 2.0 * a - trace, b + d, c + g, h - f)
    elif largest == e:
        quaternion = (b + d, 1.0 + 2.0 * e - trace, f + h, c - g)
    else:
        quaternion = (c + g, f + h, 1.0 + 2.0 * i - trace, d - b)
    return frames.normalized(quaternion)
