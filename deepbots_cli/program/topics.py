"""The fields that cross between a robot and its policy, and where ROS 2 has them: sensors, readings of the
world, commands."""

from __future__ import annotations

from collections.abc import Iterator
from math import isclose

from deepbots_cli.expressions.dimensions import ANGLE, LENGTH, NUMBER
from deepbots_cli.expressions.functions import FUNCTIONS
from deepbots_cli.expressions.scalar import EngineRead, walk
from deepbots_cli.expressions.types import Components
from deepbots_cli.program import Program
from deepbots_cli.program.robots import (
    Actuator,
    Cartesian,
    CustomActuator,
    Motor,
    RayConfig,
    Robot,
    Sensor,
    Thrust,
)
from deepbots_robot.topics import Field, Topic, first_mapping

_ANGLE_TOLERANCE = 1e-3  # rad; less than between two of 4,096 rays around a robot


def components_of(function: str) -> Components:
    """Return the components of a reading of the world; none for a single value."""
    return (FUNCTIONS[function].components if function in FUNCTIONS else None) or ()


def sensor_fields(program: Program) -> list[Field]:
    """Return the sensors of the robots that the agent moves, as fields."""
    return [sensor_field(robot, sensor) for robot in _robots(program) for sensor in robot.sensors]


def command_fields(program: Program) -> list[Field]:
    """Return the actuators of the robots that the agent moves, in the order of their commands; those without
    a command are left out."""
    return [
        command_field(program, robot, entry.actuator)
        for robot in _robots(program)
        for entry in robot.commands
    ]


def reading_fields(program: Program) -> list[Field]:
    """Return the readings of the world that expressions use, such as `position(ball)`, which no robot
    measures."""
    roots = {f"{body.name}.{body.model.root}": body.name for body in program.world.robots}
    joints = {
        f"{body.name}.{joint.name}": joint for body in program.world.robots for joint in body.model.joints
    }
    fields: dict[str, Field] = {}
    for value in program.computed_expressions:
        for leaf in (leaf for tree in value.scalars for leaf in walk(tree)):
            function = FUNCTIONS.get(leaf.function) if isinstance(leaf, EngineRead) else None
            if not isinstance(leaf, EngineRead) or function is None:
                continue
            joint = joints.get(leaf.subjects[0])
            shared = NUMBER if joint is None else ANGLE
            if joint is not None and joint.type == "prismatic":
                shared = LENGTH
            name = f"{leaf.function}({', '.join(roots.get(subject, subject) for subject in leaf.subjects)})"
            unit = "1" if function.boolean else str(function.result(shared))
            shape = (len(function.components or ()) or 1,)
            fields.setdefault(
                name, Field(name, "", leaf.function, unit, shape, components=function.components or ())
            )
    return list(fields.values())


def sensor_field(robot: Robot, sensor: Sensor) -> Field:
    """Return a sensor as a field."""
    on_joints = sensor.kind.startswith("joint_")
    return Field(
        name=f"{robot.name}.{sensor.name}",
        robot=robot.name,
        kind=sensor.kind,
        unit=sensor.unit or "1",
        shape=sensor.optics.shape if sensor.optics is not None else (max(1, len(sensor.components)),),
        joints=sensor.subjects if on_joints else (),
        components=sensor.components,
        scan=None if sensor.beams is None else _scan(sensor.beams),
    )


def _scan(beams: RayConfig) -> tuple[float, float, float] | None:
    """Return the first and the last angle of rays and their reach; None for readings of rays that are not a
    fan from one point with equal angles between them, as a `sensor_msgs/LaserScan` is."""
    first, last = beams.rays[0].rpy[2], beams.rays[-1].rpy[2]
    turn = (last - first) / max(1, len(beams.rays) - 1)
    is_fan = all(
        (ray.xyz, ray.rpy[:2]) == (beams.rays[0].xyz, beams.rays[0].rpy[:2])
        and isclose(ray.rpy[2], first + number * turn, abs_tol=_ANGLE_TOLERANCE)
        for number, ray in enumerate(beams.rays)
    )
    return (first, last, beams.reach) if is_fan or beams.combined != "each" else None


_MOTOR_UNITS = {
    "velocity_motor": ("rad/s", "m/s"),
    "position_motor": ("rad", "m"),
    "torque_motor": ("N*m", "N"),
}
"""The units of commands for joints that turn, and for those that slide."""


def command_field(program: Program, robot: Robot, actuator: Actuator) -> Field:
    """Return the command of an actuator as a field."""
    kind: str
    joints: tuple[str, ...] = ()
    match actuator:
        case Motor(kind=kind, joints=joints):
            model = next(body.model for body in program.world.robots if body.name == robot.name)
            unit = _MOTOR_UNITS[kind][model.joint(joints[0]).type == "prismatic"]
        case Thrust():
            kind, unit = "thrust", "N"
        case Cartesian():
            kind, unit = "cartesian", "m"
        case CustomActuator():
            kind, unit = "customactuator", "1"
    return Field(
        f"{robot.name}.{actuator.name}",
        robot.name,
        kind,
        unit,
        (len(actuator.components),),
        joints,
        actuator.components,
    )


def mapping(program: Program) -> dict[str, Topic]:
    """Return the topic of each sensor, reading of the world and command: the one under `ros` in the scenario,
    or else a default."""
    received = [*sensor_fields(program), *reading_fields(program)]
    return {**first_mapping(received), **first_mapping(command_fields(program), commands=True), **program.ros}


def _robots(program: Program) -> Iterator[Robot]:
    return (robot for robot in program.robots if robot.name in program.agent.robots)
