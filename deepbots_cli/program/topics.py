"""The fields that cross between a robot and its policy, and where ROS 2 has them: sensors, readings of the world, commands."""

from __future__ import annotations

from collections.abc import Iterator

from deepbots_cli.program import Program
from deepbots_cli.program.robots import Actuator, Cartesian, Motor, Robot, Sensor, Thrust
from deepbots_robot.topics import Field, Topic, first_mapping

_UNITS = {"velocity_motor": ("rad/s", "m/s"), "position_motor": ("rad", "m"), "torque_motor": ("N*m", "N")}


def sensor_fields(program: Program) -> list[Field]:
    """The sensors of the robots that the agent moves."""
    return [sensor_field(robot, sensor) for robot in _robots(program) for sensor in robot.sensors]


def command_fields(program: Program) -> list[Field]:
    """The actuators of the robots that the agent moves, in the order of their commands; those without a command are left out."""
    return [command_field(program, robot, entry.actuator) for robot in _robots(program) for entry in robot.commands]


def sensor_field(robot: Robot, sensor: Sensor) -> Field:
    """A sensor as a field."""
    on_joints = sensor.kind.startswith("joint_")
    scan = None
    if sensor.beams is not None and sensor.optics is None:
        angles = [pose.rpy[2] for pose in sensor.beams.rays]
        scan = (angles[0], angles[-1], sensor.beams.reach)
    return Field(
        name=f"{robot.name}.{sensor.name}",
        robot=robot.name,
        kind=sensor.kind,
        unit=sensor.unit or "1",
        shape=sensor.optics.shape if sensor.optics is not None else (max(1, len(sensor.components)),),
        joints=sensor.subjects if on_joints else (),
        components=sensor.components,
        scan=scan,
    )


def command_field(program: Program, robot: Robot, actuator: Actuator) -> Field:
    """The command of an actuator as a field."""
    kind = actuator.kind if isinstance(actuator, Motor) else type(actuator).__name__.lower()
    joints = actuator.joints if isinstance(actuator, Motor) else ()
    unit = "1"
    if isinstance(actuator, Motor):
        model = next(body.model for body in program.world.robots if body.name == robot.name)
        unit = _UNITS[kind][model.joint(joints[0]).type == "prismatic"]
    elif isinstance(actuator, Thrust):
        unit = "N"
    elif isinstance(actuator, Cartesian):
        unit = "m"
    return Field(f"{robot.name}.{actuator.name}", robot.name, kind, unit, (len(actuator.components),), joints, actuator.components)


def mapping(program: Program) -> dict[str, Topic]:
    """The topic of each sensor and of each command: as the scenario says under `ros`, else a first one."""
    return {**first_mapping(sensor_fields(program)), **first_mapping(command_fields(program), commands=True), **program.ros}


def _robots(program: Program) -> Iterator[Robot]:
    return (robot for robot in program.robots if robot.name in program.agent.robots)
