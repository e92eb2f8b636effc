"""The age of a reading: a robot sends how old it is, and the supervisor adds the age of the message."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

from deepbots_cli.compiler.sensors import is_fact
from deepbots_cli.expressions.types import Invocation, walk
from deepbots_cli.program import Program
from deepbots_cli.program.robots import Robot
from deepbots_cli.program.task import Choices
from deepbots_cli.program.values import Expression


def with_reading_ages(program: Program) -> Program:
    """The program with a further field in the messages of robots for each sensor whose age the supervisor asks for.

    A sensor that is read when the message is written, as perfect ones are, is as old as the message.
    """
    if all(is_fact(sensor) for robot in program.robots for sensor in robot.sensors):
        return program
    calls = (node for value in _judged(program) for node in walk(value.typed) if isinstance(node, Invocation) and node.function == "age")
    asked = dict.fromkeys(call.subjects[0].name for call in calls)
    return replace(program, robots=tuple(_with_ages(robot, asked) for robot in program.robots)) if asked else program


def _judged(program: Program) -> Iterator[Expression]:
    """What the supervisor computes in a step."""
    for part in program.action:
        if isinstance(part, Choices):
            yield from (option.forbidden for option in part.options if option.forbidden is not None)
    yield from program.signals
    yield from (entry.value for entry in program.observation)
    yield from program.reward
    yield from (ending.value for ending in program.endings)
    if program.goal is not None:
        yield from (program.goal.achieved, program.goal.desired)
    for script in program.scripts:
        for decided in script.parts:
            yield from decided.values
    for robot in program.robots:
        yield from robot.receive


def _with_ages(robot: Robot, asked: dict[str, None]) -> Robot:
    taken = {value.name for value in robot.emit}
    sensors = {f"{robot.name}.{sensor.name}": sensor for sensor in robot.sensors}
    ages = []
    for name in asked:
        if name in sensors and not is_fact(sensors[name]):
            field = f"{sensors[name].name}_age"
            while field in taken:
                field += "_"
            ages.append((sensors[name].name, field))
    return replace(robot, ages=tuple(ages)) if ages else robot
