"""Prints one controller class per robot: `use_message_data` and `create_message`, as in the paper."""

from __future__ import annotations

from deepbots_cli.codegen.driving import Driving
from deepbots_cli.codegen.names import Names, class_name
from deepbots_cli.codegen.printer import Printer, outer_states
from deepbots_cli.codegen.reads import Reads
from deepbots_cli.codegen.sensing import Sensing, devices
from deepbots_cli.codegen.text import block, docstring, flat, indent, sentence_list, targets_code, tuple_code
from deepbots_cli.expressions.scalar import Name, Scalar, World
from deepbots_cli.program import Program
from deepbots_cli.program.robots import Robot


class RobotPrinter:
    """Prints the controller of one robot."""

    def __init__(self, scenario: Program, robot: Robot) -> None:
        self._scenario = scenario
        self._robot = robot
        self._messages = scenario.format != "none"
        self._names = Names()
        self._sensing = Sensing(scenario, robot, self._names)
        self._emitted = [self._sensing.resolved(value) for entry in robot.emitted for value in entry.scalars]
        self._applied = [self._sensing.resolved(value) for entry in robot.commands for value in entry.scalars]
        self._reads = Reads([*self._emitted, *self._applied], self._names)
        self._keeps_state = keeps_state(robot)

    def text(self) -> list[str]:
        robot = self._robot
        emitted = sentence_list([entry.name for entry in robot.emitted]) or "nothing"
        driven = sentence_list([entry.name for entry in robot.commands]) or "nothing"
        lines = [
            f"class {controller_name(robot)}(RobotController):",
            *indent([*docstring(f"Robot `{robot.name}`: emits {emitted}; drives {driven}."), ""]),
        ]
        lines += indent(self._bind())
        if self._keeps_state or any(outer_states(value) for value in self._applied):
            lines += indent(self._reset())
        if observes(self._scenario, robot):
            lines += indent(self._sense_once())
        lines += indent(self._use_message_data())
        lines += indent(self._create_message())
        return lines

    def _bind(self) -> list[str]:
        writers = Driving(self._scenario, self._robot).bind_lines()
        return block("def bind(self, engine: Any) -> None:", [*self._reads.bind_lines(), *self._sensing.bind_lines(), *writers] or ["pass"])

    def _reset(self) -> list[str]:
        """Memory of stateful functions as it is right after a reset; messages have not yet come, so received values are 0."""
        printer = self._printer(starting=True)
        printer.lines += self._call_lines([*self._emitted, *self._applied])
        applied = self._printer(starting=True, received="0.0")
        applied.remember(self._applied)
        printer.lines += applied.lines
        if self._keeps_state:
            self._store(printer)
        else:
            printer.remember(self._emitted)
        return block("def reset(self) -> None:", printer.lines)

    def _sense_once(self) -> list[str]:
        printer = self._printer()
        printer.lines += self._sensing.sample_lines()
        if self._keeps_state:
            printer.lines += self._call_lines(self._emitted)
            self._store(printer)
        doc = '"""Read the sensors and advance what is computed on board; once per tick."""'
        return block("def observe(self) -> None:", [doc, *printer.lines])

    def _call_lines(self, expressions: list[Scalar]) -> list[str]:
        return [*self._reads.call_lines(expressions), *self._sensing.call_lines(expressions)]

    def _store(self, printer: Printer) -> None:
        for (name, component), value in zip(flat(self._robot.emitted), self._emitted, strict=True):
            printer.assign(f"self.{self._stored(name, component)}", value)

    def _use_message_data(self) -> list[str]:
        printer = self._printer()
        received = [self._names(name, component) for name, component in flat(self._robot.received)]
        if self._messages:
            head = "def use_message_data(self, message: Any) -> None:"
            doc = docstring(f"Decode {sentence_list(received) or 'an empty message'} and drive the actuators.")
            printer.lines += decode_lines("self.decode(message)", received, self._robot.to_robot.layout_hash, "self.rejected(message)")
        else:
            head = f"def apply({', '.join(['self', *(f'{name}: Any' for name in received)])}) -> None:"
            doc = docstring("Drive the actuators.")
        printer.lines += self._call_lines(self._applied)
        applied = iter(self._applied)
        for entry in self._robot.commands:
            values = [printer.value(next(applied)) for _ in entry.scalars]
            if len(values) > 1 and len(set(values)) == 1:
                if not values[0].isidentifier():
                    printer.line(f"{printer.names(entry.name, 'target')} = {values[0]}")
                    values[0] = printer.names(entry.name, "target")
                printer.line(f"self.drive_{entry.name}(({', '.join([values[0]] * len(values))}))")
            else:
                printer.line(f"self.drive_{entry.name}({tuple_code(values)})")
        return block(head, [*doc, *printer.lines])

    def _create_message(self) -> list[str]:
        labels = [self._names(name, component) for name, component in flat(self._robot.emitted)]
        lines = []
        if self._keeps_state:
            values = [f"self.{self._stored(name, component)}" for name, component in flat(self._robot.emitted)]
        else:
            printer = self._printer()
            printer.lines += self._call_lines(self._emitted)
            values = [printer.value(value) for value in self._emitted]
            lines = printer.lines
        listed = sentence_list(labels) or "nothing"
        if self._messages:
            return block(
                "def create_message(self) -> Any:",
                [*docstring(f"A message that holds {listed}."), *lines, f"return self.encode({', '.join(values)})"],
            )
        doc = docstring(f"The values of {listed}.")
        return block("def sense(self) -> tuple[Any, ...]:", [*doc, *lines, f"return {tuple_code(values)}"])

    def _stored(self, name: str, component: str | None) -> str:
        return "emitted_" + self._names(name, component)

    def _printer(self, *, starting: bool = False, received: str | None = None) -> Printer:
        def resolve(leaf: Name | World) -> str:
            if isinstance(leaf, World):
                return self._sensing.age(leaf) if leaf.function == "age" else self._reads.code(leaf)
            return self._sensing.code(leaf) or received or self._names(leaf.name, leaf.component)

        return Printer(resolve, self._names, self._scenario.world.timestep, starting=starting)


def keeps_state(robot: Robot) -> bool:
    """Whether what the robot emits has a memory, which advances once per tick."""
    return any(outer_states(value) for entry in robot.emitted for value in entry.scalars)


def observes(scenario: Program, robot: Robot) -> bool:
    """Whether anything on board happens once per tick: a device is sampled, or a memory advances."""
    return keeps_state(robot) or bool(devices(scenario, robot))


def controller_name(robot: Robot) -> str:
    return f"{class_name(robot.name)}Controller"


def decode_lines(decode: str, targets: list[str], stamp: int, error: str) -> list[str]:
    """Statements that take a message apart, or raise the error that names robot, step and field."""
    return [
        "try:",
        f"    {targets_code(['stamp', *targets])} = {decode}",
        f"    if stamp != {stamp}:",
        "        raise ValueError(stamp)",
        "except MALFORMED:",
        f"    raise {error} from None",
    ]
