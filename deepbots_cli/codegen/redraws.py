"""Prints the values that an episode draws, and those that change within it: parameters, and the figures of routes."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from deepbots_cli.codegen.printer import Printer
from deepbots_cli.codegen.text import indent
from deepbots_cli.codegen.workspace import Workspace
from deepbots_cli.expressions.scalar import Const, Scalar, names_in
from deepbots_cli.program.robots import Route
from deepbots_cli.program.values import Expression

_ROUNDING = 1e-9
"""In s: a period of a whole number of steps must not become one more by rounding."""


def print_first_draws(space: Workspace, printer: Printer) -> None:
    """Parameters and values of routes, as they are at the beginning of an episode."""
    for entry in space.scenario.parameters:
        _print_first_period(space, printer, entry, entry.name)
        printer.lines += _assignments(space, printer, entry)
    for name, value in _settings(space):
        if not isinstance(value.scalar, Const) and not _of_message(value):
            _print_first_period(space, printer, value, name)
            printer.assign(f"self.{name}", value.scalar)


def print_redraws(space: Workspace, printer: Printer) -> None:
    """What a step draws or computes anew before it sends anything; it is not yet counted itself."""
    changing: set[str] = set()
    for entry in space.scenario.parameters:
        if entry.redraw is not None or _reads(entry.scalars, changing):
            changing.add(entry.name)
            _print_when_due(space, printer, entry, entry.name, _assignments(space, printer, entry))
    for name, value in _settings(space):
        if value.period is not None if value.redraw else _reads(value.scalars, changing):
            _print_when_due(space, printer, value, name, [f"self.{name} = {printer.value(value.scalar)}"])


def print_draws_of_message(printer: Printer, channel: str, route: Route) -> None:
    """The values of a route that are drawn for each message, before one is sent."""
    for name, value in route.settings:
        if _of_message(value):
            printer.assign(f"{channel}.{name}", value.scalar)


def _settings(space: Workspace) -> Iterator[tuple[str, Expression]]:
    """Every value of every route, with the attribute that holds it."""
    for robot in space.scenario.robots:
        for channel, route in ((f"to_{robot.name}", robot.to_route), (f"from_{robot.name}", robot.from_route)):
            yield from ((f"{channel}.{name}", value) for name, value in route.settings)


def _of_message(value: Expression) -> bool:
    return value.redraw is not None and value.period is None


def _assignments(space: Workspace, printer: Printer, entry: Expression) -> list[str]:
    targets = [space.parameter(entry.name, component) for component in entry.components or (None,)]
    return [f"{target} = {printer.value(value)}" for target, value in zip(targets, entry.scalars, strict=True)]


def _due(space: Workspace, name: str) -> str:
    """The attribute that holds the time (s) from which a value is drawn again."""
    return f"self.{space.names('due', name)}"


def _print_first_period(space: Workspace, printer: Printer, value: Expression, name: str) -> None:
    if value.period is not None:
        printer.line(f"{_due(space, name)} = {printer.value(value.period)} - {_ROUNDING!r}")


def _print_when_due(space: Workspace, printer: Printer, value: Expression, name: str, lines: list[str]) -> None:
    if value.period is None:
        printer.lines += lines
        return
    due = _due(space, name)
    printer.line(f"if {space.tick} * {space.scenario.world.timestep!r} >= {due}:")
    printer.lines += indent([f"{due} += {printer.value(value.period)}", *lines])


def _reads(values: Iterable[Scalar], names: set[str]) -> bool:
    return any(leaf.name in names for value in values for leaf in names_in(value))
