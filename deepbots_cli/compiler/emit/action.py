"""Prints how the agent's action becomes the action variables."""

from __future__ import annotations

from deepbots_cli.compiler.emit.printer import Printer
from deepbots_cli.compiler.emit.text import targets_code, tuple_code
from deepbots_cli.compiler.emit.workspace import Workspace
from deepbots_cli.ir import Choices, CompiledScenario, Interval


def choice_tables(scenario: CompiledScenario) -> list[str]:
    """What each choice sets, as one dictionary per discrete part of the action."""
    lines = []
    for part in _choices(scenario):
        entries = ", ".join(
            f"{index}: {tuple_code([repr(v) for v in option.values]) if len(part.variables) > 1 else repr(option.values[0])}"
            for index, option in enumerate(part.options)
        )
        comment = ", ".join(option.name for option in part.options)
        lines.append(f"CHOICES_{part.name} = {{{entries}}}  # {comment}")
    return lines


def print_decoding(space: Workspace, printer: Printer) -> None:
    """Statements that set the action variables from `action`."""
    choices = _choices(space.scenario)
    picks = ["action"] if len(choices) == 1 else [space.names(f"{part.name} pick") for part in choices]
    if len(picks) > 1:
        printer.line(f"{', '.join(picks)} = action")
    for part, pick in zip(choices, picks, strict=True):
        targets = ", ".join(space.local(variable) for variable in part.variables)
        printer.line(f"{targets} = self.CHOICES_{part.name}[{pick}]")
    intervals = [part for part in space.scenario.action if isinstance(part, Interval)]
    targets_of = [(part, component) for part in intervals for component in (part.components or (None,))]
    if targets_of:
        locals_ = [space.local(part.name, component) for part, component in targets_of]
        printer.line(f"{targets_code(locals_)} = action.tolist()")
        for (interval, _), name in zip(targets_of, locals_, strict=True):
            printer.line(f"if not -1.0 <= {name} <= 1.0:")
            printer.line(f"    {name} = clipped({name})")
            half, middle = (interval.high - interval.low) / 2, (interval.high + interval.low) / 2
            if (half, middle) != (1.0, 0.0):
                printer.line(f"{name} = {middle!r} + {half!r} * {name}" if middle else f"{name} = {half!r} * {name}")


def _choices(scenario: CompiledScenario) -> list[Choices]:
    return [part for part in scenario.action if isinstance(part, Choices)]
