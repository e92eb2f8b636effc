"""The age of a reading: a robot sends how old it is, and the supervisor adds the age of the message."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from deepbots_cli import ir
from deepbots_cli.compiler.rewriting import rewritten
from deepbots_cli.compiler.sensors import is_fact
from deepbots_cli.expressions.scalar import Name, Op, Scalar, World

Layout = Callable[[str, ir.Direction, tuple[ir.Field, ...]], ir.MessageLayout]


def with_stamps(scenario: ir.CompiledScenario, layout: Layout) -> ir.CompiledScenario:
    """The scenario with a further field in the messages of robots for each sensor whose age is asked for.

    A sensor that is read when the message is written, as perfect ones are, is as old as the message.
    """
    sensors = {f"{robot.name}.{sensor.name}": sensor for robot in scenario.robots for sensor in robot.sensors}
    emitted = {f"{robot.name}.{entry.name}" for robot in scenario.robots for entry in robot.emit}
    fields: dict[str, str] = {}

    def change(node: Scalar) -> Scalar | None:
        if not isinstance(node, World) or node.function != "age" or node.subjects[0] not in sensors:
            return None
        robot, _, sensor = node.subjects[0].partition(".")
        message = World("age", (robot,))
        if is_fact(sensors[node.subjects[0]]):
            return message
        field = f"{sensor}_age"
        while f"{robot}.{field}" in emitted:
            field += "_"
        fields[node.subjects[0]] = field
        return Op("add", (message, Name(f"{robot}.{field}")))

    parts = ("action", "signals", "observation", "reward", "endings", "scripts")
    scenario = replace(scenario, **{part: rewritten(getattr(scenario, part), change) for part in parts})
    robots = tuple(replace(robot, receive=rewritten(robot.receive, change)) for robot in scenario.robots)
    return replace(scenario, robots=tuple(_stamped(robot, fields, layout) for robot in robots)) if fields else scenario


def _stamped(robot: ir.Robot, fields: dict[str, str], layout: Layout) -> ir.Robot:
    mine = {sensor: field for sensor, field in fields.items() if sensor.partition(".")[0] == robot.name}
    told = tuple(ir.NamedValues(field, (), (World("age", (sensor,)),)) for sensor, field in mine.items())
    added = tuple(ir.Field(field, "s") for field in mine.values())
    return replace(robot, emit=(*robot.emit, *told), from_robot=layout(robot.name, "from_robot", (*robot.from_robot.fields, *added)))
