"""An engine that follows a world in Webots, by the functions of its supervisor.

Frames are those of root links: m in the world, quaternions (x, y, z, w).

The world moves in Webots. After each timestep, deepbots sets the engine to the poses and velocities of
Webots. So the engine computes every reading that these determine: poses, rays, clearances. Contacts come from
Webots, and the controllers of the robots drive the motors.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

from deepbots_cli import frames
from deepbots_cli.engines.mechanics import is_movable
from deepbots_cli.engines.mujoco import mujoco
from deepbots_cli.frames import Quaternion, Triple
from deepbots_cli.port import ZERO_VECTOR, ContactReader, Engine, EngineProxy, MotorWriter, Part
from deepbots_cli.program.world import ARENA_WALLS, EngineParameter, WorldModel
from deepbots_cli.robots.model import Joint
from deepbots_webots.bridge.names import def_name, joint_def
from deepbots_webots.nodes import axis_angle


class Motion(NamedTuple):
    """The frame and the velocities of a body: m, quaternion, m/s, rad/s."""

    position: Triple
    orientation: Quaternion
    linear: Triple
    angular: Triple


def _quaternion(rows: Sequence[float]) -> Quaternion:
    """Return the quaternion of a rotation matrix, row by row."""
    quaternion = np.zeros(4)
    mujoco.mju_mat2Quat(quaternion, np.array(rows))
    w, x, y, z = quaternion.tolist()
    return x, y, z, w


TOUCHING_M = 1e-3
"""The distance of two surfaces that touch, at a contact point of Webots."""


class MirrorEngine(EngineProxy):
    """The engine of a scenario in a world of Webots; what it sets, it sets in both."""

    def __init__(self, engine: Engine, supervisor: Any, world: WorldModel) -> None:
        """Take the nodes of the world.

        Args:
            engine: The engine that follows.
            supervisor: The `controller.Supervisor` of the world.
            world: The world of the scenario; the world of Webots has the same names.
        """
        super().__init__(engine)
        self._supervisor = supervisor
        self._timestep_ms, self._substeps = round(world.timestep * 1000), world.substeps
        self._nodes: dict[str, Any] = {}
        self._roots = {robot.name: robot.model.root for robot in world.robots}
        self._moving_bodies = [
            *(robot.name for robot in world.robots if not robot.fixed_base),
            *(body.name for body in world.objects if is_movable(body)),
        ]
        self._joints = [(robot.name, joint) for robot in world.robots for joint in robot.model.moving_joints]
        self._positions = [
            self._joint_node(robot, joint.name).getField("jointParameters").getSFNode().getField("position")
            for robot, joint in self._joints
        ]
        self._others = [*self._roots, *(body.name for body in world.objects)]
        if world.arena is not None:
            self._others += ARENA_WALLS
        self.let_timestep_pass: Callable[[], None] = self.wait
        """The function that lets a timestep pass."""
        self.is_starting = False
        """Whether the world is being placed for a new episode."""

    def _node(self, body: str, link: str | None = None) -> Any:
        """Return the node of a body, or of one of its links."""
        is_root = link is None or link == self._roots.get(body, body)
        return self._node_of_def(def_name(body) if is_root else def_name(body, link or ""))

    def _joint_node(self, robot: str, joint: str) -> Any:
        return self._node_of_def(joint_def(robot, joint))

    def _node_of_def(self, name: str) -> Any:
        """Return the node of a DEF name.

        Raises:
            LookupError: There is none.
        """
        if name not in self._nodes:
            node = self._supervisor.getFromDef(name)
            if node is None:
                raise LookupError(f"the world has no node DEF {name}; export the scenario again")
            self._nodes[name] = node
        return self._nodes[name]

    def motion_of(self, body: str, link: str | None = None) -> Motion:
        """Return the motion of a body, or of one of its links, in Webots."""
        node = self._node(body, link)
        x, y, z = node.getPosition()
        u, v, w, a, b, c = node.getVelocity()
        return Motion((x, y, z), _quaternion(node.getOrientation()), (u, v, w), (a, b, c))

    def wait(self) -> None:
        """Let the world run for a timestep.

        Raises:
            SystemExit: Webots ends the simulation.
        """
        from controller import Robot  # type: ignore[import-not-found]

        if Robot.step(self._supervisor, self._timestep_ms) == -1:
            raise SystemExit

    def reset(self) -> None:
        self.is_starting = True
        self.engine.reset()
        self._supervisor.simulationReset()
        self.wait()
        # The reset happens within a step, whose physics has set bodies in motion already.
        self._supervisor.simulationResetPhysics()
        for body in self._moving_bodies:
            self._place(body, *self.engine.pose(body)(), ZERO_VECTOR, ZERO_VECTOR)
        for robot, joint in self._joints:
            ((position, _),) = self.engine.joint_states(robot, (joint.name,))()
            self._set_joint(robot, joint.name, position)

    def step(self, substeps: int) -> None:
        """Let the world run, in whole timesteps, and take over its state."""
        for _ in range(max(1, round(substeps / self._substeps))):
            if self.is_starting:
                self.wait()
            else:
                self.let_timestep_pass()
        for body in self._moving_bodies:
            self.engine.place(body, *self.motion_of(body))
        for (robot, joint), position in zip(self._joints, self._positions, strict=True):
            self.engine.set_joint(robot, joint.name, position.getSFFloat(), self._speed(robot, joint))

    def _speed(self, robot: str, joint: Joint) -> float:
        """Return the velocity of a joint by those of its two links, rad/s or m/s."""
        parent, child = (self.motion_of(robot, link) for link in (joint.parent, joint.child))
        # URDF has the axis in the frame of the joint.
        axis = frames.rotate(parent.orientation, frames.rotate(frames.frame(joint.origin)[1], joint.axis))
        if joint.type != "prismatic":
            return frames.dot(frames.subtract(child.angular, parent.angular), axis)
        arm = frames.subtract(child.position, parent.position)
        carried = frames.add(parent.linear, frames.cross(parent.angular, arm))
        return frames.dot(frames.subtract(child.linear, carried), axis)

    def place(
        self,
        body: str,
        position: Triple,
        orientation: Quaternion,
        velocity: Triple = ZERO_VECTOR,
        angular_velocity: Triple = ZERO_VECTOR,
    ) -> None:
        self.engine.place(body, position, orientation, velocity, angular_velocity)
        self._place(body, position, orientation, velocity, angular_velocity)

    def _place(
        self, body: str, position: Triple, orientation: Quaternion, linear: Triple, angular: Triple
    ) -> None:
        node = self._node(body)
        node.getField("translation").setSFVec3f(list(position))
        node.getField("rotation").setSFRotation(axis_angle(orientation))
        if any((*linear, *angular)):  # at rest since the reset of the physics, which comes before
            node.setVelocity([*linear, *angular])

    def set_joint(self, robot: str, joint: str, position: float, velocity: float) -> None:
        self.engine.set_joint(robot, joint, position, velocity)
        self._set_joint(robot, joint, position)

    def _set_joint(self, robot: str, joint: str, position: float) -> None:
        self._joint_node(robot, joint).setJointPosition(position)

    def set_parameter(self, parameter: EngineParameter, owner: tuple[str, ...], *values: float) -> None:
        """Set a parameter of the engine; gravity also in the world. Webots changes no other in an episode."""
        self.engine.set_parameter(parameter, owner, *values)
        if parameter == "gravity":  # that of Webots is a number, and downward
            self._node_of_def("WORLD_INFO").getField("gravity").setSFFloat(-values[2])

    def contact(
        self, one: Part, others: Sequence[Part] | None = None, *, ground: bool = True
    ) -> ContactReader:
        """Return whether `one` touches one of `others` at the end of a timestep."""
        node, has_all_links = self._node(*one), one[1] is None

        def touches() -> bool:
            return bool(node.getContactPoints(has_all_links))

        if others is None and ground:
            return touches
        if others is None:
            others = [(name, None) for name in self._others if name != one[0]]
        # Webots shows that a body touches anything, and the engine shows which other bodies are that near.
        gaps = [self.engine.clearance(one, part) for part in others]
        return lambda: touches() and any(gap() < TOUCHING_M for gap in gaps)

    def _no_motor(self, *_of: Any, **_limits: Any) -> MotorWriter:
        return lambda targets: None

    velocity_motor = _no_motor
    position_motor = _no_motor
    torque_motor = _no_motor
