"""Prints how a robot gets at its sensors: a fact of the engine where it is needed, or a device that is sampled once per tick."""

from __future__ import annotations

from collections.abc import Iterable

from deepbots_cli.codegen.names import Names
from deepbots_cli.codegen.text import quoted
from deepbots_cli.expressions.scalar import Draw, Name, Op, Scalar, State, World, names_in, walk
from deepbots_cli.program import Program
from deepbots_cli.program.robots import Robot, Sensor


class Sensing:
    """The sensors of one robot, in its printed controller."""

    def __init__(self, scenario: Program, robot: Robot, names: Names) -> None:
        self._robot = robot
        self._names = names
        self._received = {entry.name for entry in robot.received}
        self._sensors = {sensor.name: sensor for sensor in robot.sensors}
        self._devices = devices(scenario, robot)

    def resolved(self, expression: Scalar) -> Scalar:
        """The expression with the name of each sensor that is a fact replaced by that fact."""
        match expression:
            case Name(name, component) if name not in self._received and name not in self._devices:
                return self._sensors[name].fact_of(self._robot.name, component)
            case Op(op, args):
                return Op(op, tuple(self.resolved(argument) for argument in args))
            case State(function, args, slot):
                return State(function, tuple(self.resolved(argument) for argument in args), slot)
            case Draw(distribution, args, stream):
                return Draw(distribution, tuple(self.resolved(argument) for argument in args), stream)
            case _:
                return expression

    def bind_lines(self) -> list[str]:
        """Statements that take the devices."""
        return [f"self.sense_{name} = self.device({quoted(name)})" for name in self._devices]

    def sample_lines(self) -> list[str]:
        """Statements that sample each device once."""
        return [f"self.sense_{name}()" for name in self._devices]

    def call_lines(self, expressions: Iterable[Scalar]) -> list[str]:
        """Statements that take what the devices in these expressions delivered last."""
        used = {leaf.name for expression in expressions for leaf in names_in(expression)} - self._received
        return [f"{self._local(name)} = self.sense_{name}.reading" for name in self._devices if name in used]

    def code(self, leaf: Name) -> str | None:
        """The code of one component of a device; None for other names."""
        if leaf.name in self._received or leaf.name not in self._devices:
            return None
        components = self._devices[leaf.name].components
        return f"{self._local(leaf.name)}[{components.index(leaf.component) if leaf.component else 0}]"

    def age(self, leaf: World) -> str:
        """The code of how old the reading of a device is."""
        return f"self.sense_{leaf.subjects[0].partition('.')[2]}.age"

    def _local(self, sensor: str) -> str:
        return self._names(f"{sensor} reading")  # the blank keeps it apart from every name of the scenario


def devices(scenario: Program, robot: Robot) -> dict[str, Sensor]:
    """The sensors that are sampled once per tick, by name: those that something reads, and that are no facts."""
    on_board = [value for entry in (*robot.emitted, *robot.commands) for value in entry.scalars]
    sent = [entry for other in scenario.robots for entry in other.receive]
    judged = [value for entry in (*scenario.signals, *sent) for value in entry.scalars]
    judged += [*(ending.value.scalar for ending in scenario.endings), *(term.scalar for term in scenario.reward)]
    judged += [value for script in scenario.scripts for value in script.scalars]
    judged += [*scenario.goal.achieved.scalars, *scenario.goal.targets] if scenario.goal is not None else []
    read = {leaf.name for value in on_board for leaf in names_in(value)}
    asked = {node.subjects[0] for value in (*on_board, *judged) for node in walk(value) if isinstance(node, World)}
    used = [sensor for sensor in robot.sensors if sensor.name in read or f"{robot.name}.{sensor.name}" in asked]
    return {sensor.name: sensor for sensor in used if not sensor.is_fact}
