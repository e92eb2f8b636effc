"""Prints how supervisor and robots talk: one message to each robot per step, one from each per tick."""

from __future__ import annotations

from deepbots_cli.codegen.printer import Printer, outer_states
from deepbots_cli.codegen.redraws import print_draws_of_message
from deepbots_cli.codegen.robot import decode_lines, observes
from deepbots_cli.codegen.text import flat, targets_code
from deepbots_cli.codegen.workspace import Workspace
from deepbots_cli.expressions.scalar import names_in
from deepbots_cli.program.robots import Robot


def print_sending(space: Workspace, printer: Printer, robot: Robot) -> None:
    """The message of this step; where its way has no surprises, it is acted on here."""
    values = [printer.value(value) for entry in robot.received for value in entry.scalars]
    controller, channel = f"self.robot_{robot.name}", f"self.to_{robot.name}"
    if space.scenario.format == "none":
        printer.line(f"{controller}.apply({', '.join(values)})")
        return
    print_draws_of_message(printer, channel, robot.to_route)
    printer.line(f"{channel}.send(self.encode_to_{robot.name}({', '.join(values)}))")
    if space.delivers_in_ticks(robot):
        return
    if space.scenario.timing == "paper":
        printer.line(f"message = {channel}.receive()")
        printer.line("if message is not None:")
        printer.line(f"    {controller}.use_message_data(message)")
    else:
        printer.line(f"{controller}.use_message_data({channel}.receive())")


def print_delivering(space: Workspace, printer: Printer, robot: Robot) -> None:
    """What arrives at a robot in this tick, where that is not what was sent in this step."""
    if space.delivers_in_ticks(robot):
        printer.line(f"for message in self.to_{robot.name}.receive():")
        printer.line(f"    self.robot_{robot.name}.use_message_data(message)")


def print_receiving(space: Workspace, printer: Printer, robot: Robot, *, first: bool) -> None:
    """Messages of one robot into local variables; the first of an episode arrives at once."""
    controller, channel = f"self.robot_{robot.name}", f"self.from_{robot.name}"
    targets = [space.local(f"{robot.name}.{name}", component) for name, component in flat(robot.emitted)]
    if observes(space.scenario, robot) and not first:
        printer.line(f"{controller}.observe()")
    if space.scenario.format == "none":
        printer.line(f"{targets_code(targets)} = {controller}.sense()" if targets else "")
        return
    if not robot.from_route.perfect:
        _print_imperfect(printer, robot, first=first)
    elif space.scenario.timing == "paper" and first:
        printer.line(f"message = {controller}.create_message()")
        printer.line(f"{channel}.send(message)")
    else:
        printer.line(f"{channel}.send({controller}.create_message())")
        printer.line(f"message = {channel}.receive()")
    error = f"self._rejected({controller}.spec.from_robot, message)"
    printer.lines += decode_lines(f"self.decode_from_{robot.name}(message)", targets, robot.from_robot.layout_hash, error)


def _print_imperfect(printer: Printer, robot: Robot, *, first: bool) -> None:
    """What the supervisor goes by: the message that arrived last, in this tick or an earlier one."""
    controller, channel = f"self.robot_{robot.name}", f"self.from_{robot.name}"
    if first:
        printer.line(f"{channel}.deliver({controller}.create_message())")
    else:
        print_draws_of_message(printer, channel, robot.from_route)
        printer.line(f"{channel}.send({controller}.create_message())")
        printer.line(f"{channel}.receive()")
    printer.line(f"message = {channel}.latest")


def print_first_telling(space: Workspace, printer: Printer) -> None:
    """Begin what the values sent to robots remember; such a value begins with an action of 0."""
    states = [state for value in space.sent for state in outer_states(value)]
    if states:
        used = {leaf.name for state in states for leaf in names_in(state)}
        zeros = [v for v in space.variables if v[0] in used and not space.uses(v[0])]
        printer.lines += [f"{space.local(*variable)} = 0.0" for variable in zeros]
        printer.lines += [line for line in space.reads.call_lines(states) if line not in printer.lines]
        printer.remember(space.sent)
    print_keeping(space, printer)


def print_keeping(space: Workspace, printer: Printer) -> None:
    """Store what the next message to a robot, or a script, tells of this tick."""
    printer.lines += [f"self.told_{local} = {local}" for local in (space.local(*name) for name in space.kept())]
