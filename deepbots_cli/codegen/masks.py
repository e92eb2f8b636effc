"""Prints which options of the choices may be chosen next."""

from __future__ import annotations

from deepbots_cli.codegen.printer import Printer
from deepbots_cli.codegen.text import block, docstring, quoted, sentence_list, tuple_code
from deepbots_cli.codegen.workspace import Workspace
from deepbots_cli.expressions.printer import operand
from deepbots_cli.program.task import Choices, Option


def print_masks(space: Workspace, printer: Printer) -> None:
    """What the agent may choose next; where it has to choose, it must be something."""
    if not space.forbids:
        return
    repeat = space.scenario.agent.repeat
    chooses = "not self.terminated and not self.truncated" + (f" and self.tick_count % {repeat} == 0" if space.repeats else "")
    for part in space.scenario.action:
        if isinstance(part, Choices) and any(option.forbidden is not None for option in part.options):
            allowed = f"self.allowed_{part.name}"
            printer.line(f"{allowed} = {tuple_code([_allowed(printer, option) for option in part.options])}")
            if all(option.forbidden is not None for option in part.options):
                printer.line(f"if not any({allowed}) and {chooses}:")
                printer.line(f"    self._nothing_allowed({quoted(part.name)})")


def allowed(space: Workspace) -> list[str]:
    """The method that tells what may be chosen next; nothing where no option is ever forbidden."""
    if not space.forbids:
        return []
    rows = []
    for part in space.scenario.action:
        if isinstance(part, Choices):
            some = any(option.forbidden is not None for option in part.options)
            rows.append(f"self.allowed_{part.name}" if some else tuple_code(["True"] * len(part.options)))
    names = sentence_list([part.name for part in space.scenario.action if isinstance(part, Choices)])
    doc = docstring(f"Which options of {names} may be chosen next.")
    return block("def allowed(self) -> tuple[tuple[bool, ...], ...]:", [*doc, f"return {tuple_code(rows)}"])


def _allowed(printer: Printer, option: Option) -> str:
    return "True" if option.forbidden is None else f"not {operand(printer.value(option.forbidden.scalar))}"
