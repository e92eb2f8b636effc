"""Prints how the agent's action becomes the action variables."""

from __future__ import annotations

from deepbots_cli.codegen.printer import Printer
from deepbots_cli.codegen.text import action_variables, targets_code, tuple_code
from deepbots_cli.codegen.workspace import Workspace
from deepbots_cli.program.task import ActionRange, Choices


def choice_tables(space: Workspace) -> list[str]:
    """What each choice sets, as one dictionary per discrete part of the action; and itself as one-hot where that is read."""
    lines = []
    choices, intervals = _parts(space)
    hot = ("1.0", "0.0") if intervals else ("True", "False")
    for part in choices:
        rows = [[repr(value) for value in option.values] for option in part.options]
        comment = ", ".join(option.name for option in part.options)
        lines.append(f"CHOICES_{part.name} = {_table([row[0] if len(row) == 1 else tuple_code(row) for row in rows])}  # {comment}")
        if space.taken:
            size = range(len(part.options))
            lines.append(f"TAKEN_{part.name} = {_table([tuple_code([hot[index != other] for other in size]) for index in size])}")
    return lines


def _table(rows: list[str]) -> str:
    return f"{{{', '.join(f'{index}: {row}' for index, row in enumerate(rows))}}}"


def print_decoding(space: Workspace, printer: Printer) -> None:
    """Statements that set the action variables from `action`, which holds `choices` and `ranges` where there are both."""
    choices, intervals = _parts(space)
    given = _own_action(space)
    chosen = ranged = "action"
    if choices and intervals:
        chosen, ranged = space.names("chosen part"), space.names("ranged part")
        printer.line(f'{chosen}, {ranged} = action["choices"], action["ranges"]')
    picks = [chosen] if len(choices) == 1 else [space.names(f"{part.name} pick") for part in choices]
    if len(picks) > 1:
        printer.line(f"{', '.join(picks)} = {chosen}")
    for part, pick in zip(choices, picks, strict=True):
        printer.line(f"{', '.join(space.local(variable) for variable in part.variables)} = self.CHOICES_{part.name}[{pick}]")
        if given:
            printer.line(f"{targets_code(given[part.name])} = self.TAKEN_{part.name}[{pick}]")
    if intervals:
        printer.line(f"{targets_code([space.local(*v) for part in intervals for v in action_variables(part)])} = {ranged}.tolist()")
    for interval in intervals:
        half, middle = (interval.high - interval.low) / 2, (interval.high + interval.low) / 2
        for index, variable in enumerate(action_variables(interval)):
            name = space.local(*variable)
            printer.line(f"if not -1.0 <= {name} <= 1.0:")
            printer.line(f"    {name} = clipped({name})")
            if given:
                printer.line(f"{given[interval.name][index]} = {name}")
            if (half, middle) != (1.0, 0.0):
                printer.line(f"{name} = {middle!r} + {half!r} * {name}" if middle else f"{name} = {half!r} * {name}")


def _own_action(space: Workspace) -> dict[str, list[str]]:
    """The locals that hold what the agent itself gave, by part; empty where nothing reads them."""
    names = iter(space.taken)
    sizes = {part.name: len(part.options) if isinstance(part, Choices) else max(1, len(part.components)) for part in space.scenario.action}
    return {part: [space.local(*next(names)) for _ in range(size)] for part, size in sizes.items()} if space.taken else {}


def _parts(space: Workspace) -> tuple[list[Choices], list[ActionRange]]:
    action = space.scenario.action
    return [part for part in action if isinstance(part, Choices)], [part for part in action if isinstance(part, ActionRange)]
