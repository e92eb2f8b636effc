"""Prints the supervisor class: reset and one tick, with everything that the paper's methods read."""

from __future__ import annotations

from deepbots_cli.compiler.emit.evaluation import EvaluationPrinter
from deepbots_cli.compiler.emit.names import class_name
from deepbots_cli.compiler.emit.printer import Printer, outer_states
from deepbots_cli.compiler.emit.robot import controller_name, decode_lines, keeps_state
from deepbots_cli.compiler.emit.text import (
    action_variables,
    block,
    docstring,
    flat,
    indent,
    quoted,
    sentence_list,
    targets_code,
    tuple_code,
)
from deepbots_cli.ir import Choices, CompiledScenario, Interval, Robot
from deepbots_cli.lang.scalar import Const, Name, Scalar, World, names_in


class SupervisorPrinter:
    """Prints the supervisor of one scenario."""

    def __init__(self, scenario: CompiledScenario) -> None:
        self._scenario = scenario
        self._evaluation = EvaluationPrinter(scenario)
        self._names = self._evaluation.names
        self._messages = scenario.format != "none"
        self._late = scenario.timing == "paper"
        self._sent = [value for robot in scenario.robots for entry in robot.receive for value in entry.values]
        self._told = self._told_locals()
        self._variables = [variable for part in scenario.action for variable in action_variables(part)]

    def text(self) -> list[str]:
        scenario = self._scenario
        controllers = ", ".join(f"{quoted(robot.name)}: {controller_name(robot)}" for robot in scenario.robots)
        lines = [f"class {class_name(scenario.name)}Supervisor(Supervisor):"]
        lines += indent([*docstring(scenario.summary or scenario.name), "", f"CONTROLLERS = {{{controllers}}}", *self._tables(), ""])
        for method in (self._bind(), self._begin(), self._start(), self._advance(), *self._readings()):
            lines += indent(method)
        return lines

    def _tables(self) -> list[str]:
        """What each choice sets, as one dictionary per discrete part of the action."""
        lines = []
        for part in self._choices():
            entries = ", ".join(
                f"{index}: {tuple_code([repr(v) for v in option.values]) if len(part.variables) > 1 else repr(option.values[0])}"
                for index, option in enumerate(part.options)
            )
            comment = ", ".join(option.name for option in part.options)
            lines.append(f"CHOICES_{part.name} = {{{entries}}}  # {comment}")
        return lines

    def _choices(self) -> list[Choices]:
        return [part for part in self._scenario.action if isinstance(part, Choices)]

    def _bind(self) -> list[str]:
        lines = self._evaluation.reads.bind_lines()
        lines.append(f'self.pack = Struct("{len(self._scenario.observation)}f").pack_into')
        return block("def bind(self, engine: Any) -> None:", lines)

    def _told_locals(self) -> list[str]:
        """Local variables of one tick that the messages of the next one tell: signals, and fields that robots sent."""
        scenario = self._scenario
        kept = [*flat(scenario.signals), *((f"{r.name}.{name}", component) for r in scenario.robots for name, component in flat(r.emit))]
        told = {(leaf.name, leaf.component) for value in self._sent for leaf in names_in(value)}
        return [self._evaluation.local(name, component) for name, component in kept if (name, component) in told]

    # Reset

    def _begin(self) -> list[str]:
        """Draws in order of dependency, then places, then joints; language reference, "Reset"."""
        printer = Printer(self._at_reset, self._names, self._scenario.world.timestep)
        printer.line('"""Draw what this episode varies, and put the world where it begins."""')
        for entry in self._scenario.parameters:
            for component, value in zip(entry.components or (None,), entry.values, strict=True):
                printer.assign(f"self.{self._names('parameter', entry.name, component)}", value)
        printer.line("self.engine.reset()")
        for place in self._scenario.reset.places:
            xyz, rpy = (tuple_code([printer.value(value) for value in values]) for values in (place.xyz, place.rpy))
            turn = "(0.0, 0.0, 0.0, 1.0)" if _all_zero(place.rpy) else f"quaternion{rpy}"
            printer.line(f"self.engine.place({quoted(place.body)}, {xyz}, {turn})")
        for joint in self._scenario.reset.joints:
            where = f"{quoted(joint.robot)}, {quoted(joint.joint)}"
            printer.line(f"self.engine.set_joint({where}, {printer.value(joint.position)}, {printer.value(joint.velocity)})")
        ticks = round(self._scenario.reset.settle / self._scenario.world.timestep)
        if ticks:
            printer.line(f"self.physics({ticks * self._scenario.world.substeps})")
        return block("def _begin(self) -> None:", printer.lines)

    def _at_reset(self, leaf: Name | World) -> str:
        if isinstance(leaf, World):
            raise TypeError(f"{leaf.function} cannot be read while a reset is under way")
        return f"self.{self._names('parameter', leaf.name, leaf.component)}"

    def _start(self) -> list[str]:
        printer = self._evaluation.printer(starting=True)
        printer.line('"""Receive the first messages and compute what the first observation needs."""')
        zeros = [self._evaluation.local(*variable) for variable in self._variables if self._evaluation.uses(variable[0])]
        if zeros:
            printer.line(" = ".join([*zeros, "0.0"]))
        for robot in self._scenario.robots:
            self._receive(printer, robot, first=True)
        self._evaluation.print_all(printer)
        self._remember_sent(printer)
        return block("def _start(self) -> None:", printer.lines)

    def _remember_sent(self, printer: Printer) -> None:
        """Begin what the values sent to robots remember; such a value begins with an action of 0."""
        states = [state for value in self._sent for state in outer_states(value)]
        if states:
            used = {leaf.name for state in states for leaf in names_in(state)}
            zeros = [v for v in self._variables if v[0] in used and not self._evaluation.uses(v[0])]
            printer.lines += [f"{self._evaluation.local(*variable)} = 0.0" for variable in zeros]
            printer.lines += [line for line in self._evaluation.reads.call_lines(states) if line not in printer.lines]
            printer.remember(self._sent)
        self._keep(printer)

    def _keep(self, printer: Printer) -> None:
        """Store what the next message to a robot tells of this tick."""
        printer.lines += [f"self.told_{local} = {local}" for local in self._told]

    # One tick

    def _advance(self) -> list[str]:
        printer = self._evaluation.printer(starting=False)
        world = self._scenario.world
        printer.line('"""One tick: act, let the world go on, receive, and compute all that is read afterwards."""')
        self._decode_action(printer)
        printer.line("self.step_count += 1")
        printer.lines += [f"{local} = self.told_{local}" for local in self._told]
        printer.lines += self._evaluation.reads.call_lines(self._sent)
        for robot in self._scenario.robots:
            self._send(printer, robot)
        printer.line(f"self.physics({world.substeps})")
        for robot in self._scenario.robots:
            self._receive(printer, robot, first=False)
        self._evaluation.print_all(printer)
        self._keep(printer)
        return block("def _advance(self, action: Any) -> None:", printer.lines)

    def _decode_action(self, printer: Printer) -> None:
        choices = self._choices()
        picks = ["action"] if len(choices) == 1 else [self._names(f"{part.name} pick") for part in choices]
        if len(picks) > 1:
            printer.line(f"{', '.join(picks)} = action")
        for part, pick in zip(choices, picks, strict=True):
            targets = ", ".join(self._evaluation.local(variable) for variable in part.variables)
            printer.line(f"{targets} = self.CHOICES_{part.name}[{pick}]")
        intervals = [part for part in self._scenario.action if isinstance(part, Interval)]
        targets_of = [(part, component) for part in intervals for component in (part.components or (None,))]
        if targets_of:
            locals_ = [self._evaluation.local(part.name, component) for part, component in targets_of]
            printer.line(f"{targets_code(locals_)} = action.tolist()")
            for (interval, _), name in zip(targets_of, locals_, strict=True):
                printer.line(f"if not -1.0 <= {name} <= 1.0:")
                printer.line(f"    {name} = clipped({name})")
                half, middle = (interval.high - interval.low) / 2, (interval.high + interval.low) / 2
                if (half, middle) != (1.0, 0.0):
                    printer.line(f"{name} = {middle!r} + {half!r} * {name}" if middle else f"{name} = {half!r} * {name}")

    def _send(self, printer: Printer, robot: Robot) -> None:
        values = [printer.value(value) for entry in robot.receive for value in entry.values]
        controller, channel = f"self.robot_{robot.name}", f"self.to_{robot.name}"
        if not self._messages:
            printer.line(f"{controller}.apply({', '.join(values)})")
            return
        printer.line(f"{channel}.send(self.encode_to_{robot.name}({', '.join(values)}))")
        if self._late:
            printer.line(f"message = {channel}.receive()")
            printer.line("if message is not None:")
            printer.line(f"    {controller}.use_message_data(message)")
        else:
            printer.line(f"{controller}.use_message_data({channel}.receive())")

    def _receive(self, printer: Printer, robot: Robot, *, first: bool) -> None:
        """Messages of one robot into local variables; the first of an episode arrives at once."""
        controller, channel = f"self.robot_{robot.name}", f"self.from_{robot.name}"
        targets = [self._evaluation.local(f"{robot.name}.{name}", component) for name, component in flat(robot.emit)]
        if keeps_state(robot) and not first:
            printer.line(f"{controller}.observe()")
        if not self._messages:
            printer.line(f"{targets_code(targets)} = {controller}.sense()" if targets else "")
            return
        if self._late and first:
            printer.line(f"message = {controller}.create_message()")
            printer.line(f"{channel}.send(message)")
        else:
            printer.line(f"{channel}.send({controller}.create_message())")
            printer.line(f"message = {channel}.receive()")
        error = f"self._rejected({controller}.spec.from_robot, message)"
        printer.lines += decode_lines(f"self.decode_from_{robot.name}(message)", targets, robot.from_robot.stamp, error)

    # The paper's methods: they read what `_advance` left, and change nothing

    def _readings(self) -> list[list[str]]:
        scenario = self._scenario
        seen = sentence_list(list(dict.fromkeys(entry.name for entry in scenario.observation)))
        summands = sentence_list([term.name for term in scenario.reward])
        ends = [f"the task ended ({sentence_list([ending.name for ending in scenario.endings], 'or')})"] if scenario.endings else []
        limits = [name for name in ("max_steps", "max_time") if getattr(scenario.truncation, name) is not None]
        ends.append(f"a limit cut the episode short ({sentence_list(limits, 'or')})")
        terms = ", ".join(f"{quoted(term.name)}: self.term_{term.name}" for term in scenario.reward)
        info = '"is_success": self.is_success, "ended_by": self.ended_by, "endings": self.endings'
        return [
            block(
                "def get_observations(self) -> Any:",
                [*docstring(f"What the policy sees, float32 in [-1, 1]: {seen}."), "return self.observed.copy()"],
            ),
            block("def get_reward(self) -> float:", [*docstring(f"The sum of {summands}."), "return self.reward"]),
            block(
                "def is_done(self) -> tuple[bool, bool]:",
                [*docstring(f"Whether {', and whether '.join(ends)}."), "return self.terminated, self.truncated"],
            ),
            block(
                "def get_info(self) -> dict[str, Any]:",
                [
                    *docstring("How the episode ended, if it has, and the terms of the last reward."),
                    f"terms = {{{terms}}}",
                    f'return {{{info}, "reward_terms": terms}}',
                ],
            ),
        ]


def _all_zero(values: tuple[Scalar, ...]) -> bool:
    return all(isinstance(value, Const) and value.value == 0.0 for value in values)
