"""What a robot can drive: one model per kind, in the table `ACTUATORS`."""

from __future__ import annotations

from typing import Annotated, ClassVar

from deepbots_cli.scenario.fields import Pattern, Quantity, Range, Scalar
from deepbots_cli.scenario.part import FORMS, Keys, Kinds, Part, field
from deepbots_cli.scenario.quantity import DrawnDelay, DrawnFactor, JointName, JointNames, Length, LinkName, LinkNames, Prose

MaxTorque = Annotated[Scalar, Quantity("torque or force", stage="episode", minimum=0)]
Stiffness = Annotated[Scalar, Quantity("stiffness", stage="episode", minimum=0)]
Damping = Annotated[Scalar, Quantity("damping", stage="episode", minimum=0)]
JointSpeed = Annotated[Scalar, Quantity("angular speed or speed", minimum=0)]
JointAcceleration = Annotated[Scalar, Quantity("angular acceleration or acceleration", minimum=0, exclusive=True)]
JointPosition = Annotated[Scalar, Quantity("angle or length")]


class Actuator(Part):
    """What all actuators have: the faults of real ones."""

    type: Prose = field(description="The kind of actuator.")
    strength: DrawnFactor = field(default=1, description="Factor on the torque, force or thrust that it exerts; below 1 it is worn.")
    delay: DrawnDelay = field(default="0 ms", description="Time from a command to its effect.")
    lag: DrawnDelay = field(default="0 ms", description="Time constant with which it follows a command.")


class Motor(Actuator):
    """Drives one joint, or several under their names."""

    needs: ClassVar[tuple[Keys, ...]] = (Keys(("joint", "joints"), least=1),)

    joint: JointName | None = field(default=None, description="The joint that it drives.")
    joints: JointNames | None = field(default=None, description="The joints that it drives: names, patterns such as `wheel_*`, or a group.")
    max_torque: MaxTorque | None = field(
        default=None, description="Largest torque (N*m) or force (N) per joint; by default the effort limit of the robot file."
    )


class VelocityMotor(Motor):
    """Drives a joint at a commanded velocity."""

    max_velocity: JointSpeed | None = field(default=None, description="Largest velocity; by default the limit of the robot file.")
    max_acceleration: JointAcceleration | None = field(
        default=None, description="How fast the velocity that it drives at may change; by default at once."
    )


class PositionMotor(Motor):
    """Drives a joint to a commanded position, as a spring with a damper."""

    stiffness: Stiffness | None = field(default=None, description="Torque per angle, N*m/rad, or force per length, N/m.")
    damping: Damping | None = field(default=None, description="Torque per angular speed, N*m*s/rad, or force per speed, N*s/m.")
    max_velocity: JointSpeed | None = field(
        default=None,
        description="How fast the position that it drives to may move; by default the robot file's limit, with stiffness at once.",
    )


class TorqueMotor(Motor):
    """Puts a commanded torque or force on a joint."""


class Thrust(Actuator):
    """Pushes links along their z axis, as a rotor does."""

    needs: ClassVar[tuple[Keys, ...]] = (Keys(("link", "links"), least=1),)

    link: LinkName | None = field(default=None, description="The link that it pushes.")
    links: LinkNames | None = field(default=None, description="The links that it pushes: names, patterns, or a group.")
    range: Annotated[str, Range("force")] = field(description="Smallest and largest thrust, such as `0 .. 0.15 N`.")
    drag: Length = field(default=0, description="Torque about z per thrust, N*m/N = m.")
    spin: Annotated[
        dict[Annotated[str, Pattern("link")], Annotated[Scalar, Quantity("number", minimum=-1, maximum=1)]]
        | Annotated[Scalar, Quantity("number", minimum=-1, maximum=1)],
        FORMS,
    ] = field(
        default=1, description="Sense of that torque, 1 or -1, for all or per link; 1 for a rotor that turns clockwise seen from above."
    )


class Cartesian(Actuator):
    """Moves a link to a commanded position in the world, by inverse kinematics."""

    link: LinkName = field(description="The link that is moved.")
    joints: JointNames = field(description="The joints that move it.")
    rpy: Annotated[Scalar, Quantity("angle", components=3)] | None = field(
        default=None, description="Attitude that the link keeps in the world: roll, pitch, yaw; by default any."
    )
    max_torque: MaxTorque | None = field(default=None, description="Largest torque or force per joint.")
    max_velocity: JointSpeed | None = field(default=None, description="Largest velocity per joint.")


class Gripper(Actuator):
    """Opens and closes fingers; its command is 0 (closed) to 1 (open)."""

    joints: JointNames = field(description="The finger joints.")
    open: JointPosition = field(description="Position of the joints when open.")
    closed: JointPosition = field(description="Position of the joints when closed.")
    max_torque: MaxTorque | None = field(default=None, description="Largest torque or force per joint.")


ACTUATORS: dict[str, type[Actuator]] = {
    "velocity_motor": VelocityMotor,
    "position_motor": PositionMotor,
    "torque_motor": TorqueMotor,
    "thrust": Thrust,
    "cartesian": Cartesian,
    "gripper": Gripper,
}
AnyActuator = Annotated[Actuator, Kinds("type", tuple(ACTUATORS), ACTUATORS.__getitem__)]
