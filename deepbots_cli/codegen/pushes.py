"""Prints the disturbances of an episode: one method per disturbance, which draws a push."""

from __future__ import annotations

from deepbots_cli.codegen.printer import Printer
from deepbots_cli.codegen.text import block, quoted, tuple_code
from deepbots_cli.codegen.workspace import Workspace
from deepbots_cli.program.resets import Disturbance


def bind_pushes(space: Workspace) -> list[str]:
    """Statements that take what pushes from `engine`."""
    substep = space.scenario.world.timestep / space.scenario.world.substeps
    return [
        f"self.push_{push.name} = Push(engine, ({quoted(push.body)}, {quoted(push.link) if push.link else None}), "
        f"self._draw_{push.name}, {substep!r})"
        for push in space.scenario.disturbances
    ]


def print_first_pushes(space: Workspace, printer: Printer) -> None:
    """Statements of a reset that say when the first push of each disturbance begins."""
    settling = round(space.scenario.reset.settle / space.scenario.world.timestep) * space.scenario.world.substeps
    for push in space.scenario.disturbances:
        printer.line(f"self.push_{push.name}.reset({printer.value(push.begins)}, {settling})")


def drawing(space: Workspace) -> list[str]:
    """The methods that draw a push."""
    return [line for push in space.scenario.disturbances for line in _drawing(space, push)]


def _drawing(space: Workspace, push: Disturbance) -> list[str]:
    printer = space.printer()
    printer.line('"""Force, torque and duration of a push, and the time from its beginning to that of the next."""')
    force, torque = (tuple_code([printer.value(value) for value in vector]) for vector in push.wrench)
    lasts, every = printer.value(push.lasts.scalar), "inf" if push.every is None else printer.value(push.every.scalar)
    printer.line(f"return {force}, {torque}, {lasts}, {every}")
    return block(f"def _draw_{push.name}(self) -> Any:", printer.lines)
