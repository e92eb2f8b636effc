"""Prints the observation: every entry mapped to [-1, 1], clipped, and packed as float32."""

from __future__ import annotations

from deepbots_cli.compiler.emit.printer import Printer
from deepbots_cli.compiler.emit.workspace import Workspace
from deepbots_cli.ir import Observed
from deepbots_cli.lang.emit import operand


def print_observation(space: Workspace, printer: Printer) -> None:
    packed = []
    for entry in space.scenario.observation:
        name = space.names(f"seen {entry.name}", entry.component)  # the blank keeps it apart from a signal called `seen`
        if entry.truth:
            packed.append(f"1.0 if {printer.value(entry.value)} else 0.0")
            continue
        printer.line(f"{name} = {_normalised(printer.value(entry.value), entry)}")
        printer.line(f"if not -1.0 <= {name} <= 1.0:")
        printer.line(f"    {name} = clipped({name})")
        packed.append(name)
    printer.line(f"self.pack({', '.join(['self.observed', '0', *packed])})")


def _normalised(code: str, entry: Observed) -> str:
    """Code that maps [low, high] to [-1, 1]."""
    half, middle = (entry.high - entry.low) / 2, (entry.high + entry.low) / 2
    if middle == 0.0:
        return f"{operand(code)} * {1 / half!r}" if half != 1.0 else code
    return f"({code} - {middle!r}) * {1 / half!r}"
