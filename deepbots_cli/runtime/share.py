"""A world that several copies of a robot share, as the supervisor of one of them sees it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Literal

from deepbots_cli.frames import Frame, Quaternion, Triple
from deepbots_cli.port import (
    STILL,
    CameraReader,
    ContactReader,
    Engine,
    ForceReader,
    GapReader,
    JointReader,
    Kinematics,
    MotionReader,
    MotorWriter,
    Overlap,
    Part,
    PoseReader,
    Pusher,
    RayReader,
    TorqueReader,
    VelocityReader,
    View,
)
from deepbots_cli.program.task import RobotCopies

if TYPE_CHECKING:
    from deepbots_cli.port import Image


def copy_name(copies: RobotCopies, number: int) -> str:
    """The name of a copy in the world, numbered from 1."""
    return f"{copies.robot}#{number}"


def offset(copies: RobotCopies, number: int) -> Triple:
    """Where a copy stands in the row, from its middle (m)."""
    steps = number - (copies.count + 1) / 2
    x, y, z = (steps * step for step in copies.spacing)
    return x, y, z


def _leave_it(_force: Triple, _torque: Triple) -> None:
    """How a copy pushes what is no part of it: the first one does that for all."""


class Share:
    """An engine in which the robot's name means one of its copies.

    What is not of a copy is set by the first one alone, and time is not for a copy to advance: `step` only notes
    how far the world shall go on after the reset.
    """

    def __init__(self, engine: Engine, copies: RobotCopies, number: int) -> None:
        self._engine = engine
        self._robot = copies.robot
        self._copy = copy_name(copies, number)
        self._offset = offset(copies, number)
        self._leads = number == 1
        self.name = engine.name
        self.capabilities = engine.capabilities
        self.settling = 0

    def _of(self, body: str) -> str:
        return self._copy if body == self._robot else body

    def _at(self, part: Part) -> Part:
        return self._of(part[0]), part[1]

    def _sets(self, body: str | None) -> bool:
        """Whether this copy sets figures of the body."""
        return self._leads or body == self._robot

    # Episodes

    def reset(self) -> None:
        self.settling = 0

    def step(self, substeps: int) -> None:
        self.settling = substeps

    def close(self) -> None:
        """The world is not its own to close."""

    def place(
        self, body: str, position: Triple, orientation: Quaternion, velocity: Triple = STILL, angular_velocity: Triple = STILL
    ) -> None:
        if body == self._robot:
            (x, y, z), (dx, dy, dz) = position, self._offset
            position = (x + dx, y + dy, z + dz)
        if self._sets(body):
            self._engine.place(self._of(body), position, orientation, velocity, angular_velocity)

    def set_joint(self, robot: str, joint: str, position: float, velocity: float) -> None:
        if self._sets(robot):
            self._engine.set_joint(self._of(robot), joint, position, velocity)

    def choose(self, body: str, variant: str) -> None:
        if self._sets(body):
            self._engine.choose(self._of(body), variant)

    def set_mass(self, body: str, link: str | None, mass: float) -> None:
        if self._sets(body):
            self._engine.set_mass(self._of(body), link, mass)

    def set_friction(
        self,
        body: str,
        link: str | None,
        *,
        lateral: float | None = None,
        spinning: float | None = None,
        rolling: float | None = None,
        restitution: float | None = None,
    ) -> None:
        if self._sets(body):
            self._engine.set_friction(self._of(body), link, lateral=lateral, spinning=spinning, rolling=rolling, restitution=restitution)

    def set_joint_damping(self, robot: str, joint: str, damping: float) -> None:
        if self._sets(robot):
            self._engine.set_joint_damping(self._of(robot), joint, damping)

    def set_joint_friction(self, robot: str, joint: str, friction: float) -> None:
        if self._sets(robot):
            self._engine.set_joint_friction(self._of(robot), joint, friction)

    def set_gravity(self, gravity: Triple) -> None:
        if self._leads:
            self._engine.set_gravity(gravity)

    def set_colour(self, body: str, link: str | None, colour: tuple[float, float, float, float]) -> None:
        if self._sets(body):
            self._engine.set_colour(self._of(body), link, colour)

    def set_light(self, brightness: float) -> None:
        if self._leads:
            self._engine.set_light(brightness)

    # What is bound once

    @property
    def gravity(self) -> Triple:
        return self._engine.gravity

    def before_substep(self, act: Callable[[], object]) -> None:
        self._engine.before_substep(act)

    def pusher(self, part: Part, frame: Literal["world", "link"] = "world") -> Pusher:
        return self._engine.pusher(self._at(part), frame) if self._sets(part[0]) else _leave_it

    def contact(self, one: Part, others: Sequence[Part] | None = None, *, ground: bool = True) -> ContactReader:
        return self._engine.contact(self._at(one), None if others is None else [self._at(other) for other in others], ground=ground)

    def contact_force(self, one: Part) -> ForceReader:
        return self._engine.contact_force(self._at(one))

    def gap(self, one: Part, other: Part) -> GapReader:
        return self._engine.gap(self._at(one), self._at(other))

    def rays(self, part: Part, rays: Sequence[Frame], reach: float) -> RayReader:
        return self._engine.rays(self._at(part), rays, reach)

    def camera(self, part: Part, mount: Frame, width: int, height: int, fov: float) -> CameraReader:
        return self._engine.camera(self._at(part), mount, width, height, fov)

    def inverse_kinematics(self, part: Part, joints: Sequence[str]) -> Kinematics:
        return self._engine.inverse_kinematics(self._at(part), joints)

    def joint_states(self, robot: str, joints: Sequence[str]) -> JointReader:
        return self._engine.joint_states(self._of(robot), joints)

    def joint_torques(self, robot: str, joints: Sequence[str]) -> TorqueReader:
        return self._engine.joint_torques(self._of(robot), joints)

    def pose(self, body: str, link: str | None = None) -> PoseReader:
        return self._engine.pose(self._of(body), link)

    def velocity(self, body: str, link: str | None = None) -> VelocityReader:
        return self._engine.velocity(self._of(body), link)

    def motion(self, body: str, link: str | None = None) -> MotionReader:
        return self._engine.motion(self._of(body), link)

    def velocity_motor(self, robot: str, joints: Sequence[str], max_torque: Sequence[float]) -> MotorWriter:
        return self._engine.velocity_motor(self._of(robot), joints, max_torque)

    def position_motor(
        self,
        robot: str,
        joints: Sequence[str],
        max_torque: Sequence[float],
        stiffness: Sequence[float] | None,
        damping: Sequence[float] | None,
    ) -> MotorWriter:
        return self._engine.position_motor(self._of(robot), joints, max_torque, stiffness, damping)

    def torque_motor(self, robot: str, joints: Sequence[str], max_torque: Sequence[float]) -> MotorWriter:
        return self._engine.torque_motor(self._of(robot), joints, max_torque)

    def overlaps(self) -> Sequence[Overlap]:
        return self._engine.overlaps()

    def require_finite(self) -> None:
        self._engine.require_finite()

    def render(self, view: View) -> Image:
        return self._engine.render(view)
