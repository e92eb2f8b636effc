"""Prints the values that an episode draws, and those that change within it: parameters, and the figures of routes."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from deepbots_cli.compiler.emit.printer import Printer
from deepbots_cli.compiler.emit.text import indent
from deepbots_cli.compiler.emit.workspace import Workspace
from deepbots_cli.expressions.scalar import Const, Scalar, names_in
from deepbots_cli.ir import Parameter, Redraw, Route, Setting

_ROUNDING = 1e-9
"""In s: a period of a whole number of steps must not become one more by rounding."""


def print_first_draws(space: Workspace, printer: Printer) -> None:
    """Parameters and figures of routes, as they are at the beginning of an episode."""
    for entry in space.scenario.parameters:
        _print_first_period(space, printer, entry.redraw, entry.name)
        printer.lines += _assignments(space, printer, entry)
    for name, setting in _settings(space):
        if not isinstance(setting.value, Const) and not _of_message(setting):
            _print_first_period(space, printer, setting.redraw, name)
            printer.assign(f"self.{name}", setting.value)


def print_redraws(space: Workspace, printer: Printer) -> None:
    """What a step draws or computes anew before it sends anything; it is not yet counted itself."""
    changing: set[str] = set()
    for entry in space.scenario.parameters:
        if entry.redraw is not None or _reads(entry.values, changing):
            changing.add(entry.name)
            _print_when_due(space, printer, entry.redraw, entry.name, _assignments(space, printer, entry))
    for name, setting in _settings(space):
        if setting.redraw.period is not None if setting.redraw else _reads((setting.value,), changing):
            _print_when_due(space, printer, setting.redraw, name, [f"self.{name} = {printer.value(setting.value)}"])


def print_draws_of_message(printer: Printer, channel: str, route: Route) -> None:
    """The figures of a route that are drawn for each message, before one is sent."""
    for figure, setting in route.settings:
        if _of_message(setting):
            printer.assign(f"{channel}.{figure}", setting.value)


def _settings(space: Workspace) -> Iterator[tuple[str, Setting]]:
    """Every figure of every route, with the attribute that holds it."""
    for robot in space.scenario.robots:
        for channel, route in ((f"to_{robot.name}", robot.to_route), (f"from_{robot.name}", robot.from_route)):
            yield from ((f"{channel}.{figure}", setting) for figure, setting in route.settings)


def _of_message(setting: Setting) -> bool:
    return setting.redraw is not None and setting.redraw.period is None


def _assignments(space: Workspace, printer: Printer, entry: Parameter) -> list[str]:
    targets = [space.parameter(entry.name, component) for component in entry.components or (None,)]
    return [f"{target} = {printer.value(value)}" for target, value in zip(targets, entry.values, strict=True)]


def _due(space: Workspace, name: str) -> str:
    """The attribute that holds the time (s) from which a value is drawn again."""
    return f"self.{space.names('due', name)}"


def _print_first_period(space: Workspace, printer: Printer, redraw: Redraw | None, name: str) -> None:
    if redraw is not None and redraw.period is not None:
        printer.line(f"{_due(space, name)} = {printer.value(redraw.period)} - {_ROUNDING!r}")


def _print_when_due(space: Workspace, printer: Printer, redraw: Redraw | None, name: str, lines: list[str]) -> None:
    if redraw is None or redraw.period is None:
        printer.lines += lines
        return
    due = _due(space, name)
    printer.line(f"if {space.tick} * {space.scenario.world.timestep!r} >= {due}:")
    printer.lines += indent([f"{due} += {printer.value(redraw.period)}", *lines])


def _reads(values: Iterable[Scalar], names: set[str]) -> bool:
    return any(leaf.name in names for value in values for leaf in names_in(value))
