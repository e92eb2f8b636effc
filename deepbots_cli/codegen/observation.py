"""Prints the observation: every entry mapped to [-1, 1], clipped, and packed as float32.

Where the policy sees several steps in a row, the numbers of a step are one row of a ring, and what it
sees is gathered from there. The noise on measurements of the supervisor is printed here too.
"""

from __future__ import annotations

from deepbots_cli.codegen.printer import Printer
from deepbots_cli.codegen.text import quoted, targets_code
from deepbots_cli.codegen.workspace import Workspace
from deepbots_cli.expressions.printer import operand
from deepbots_cli.expressions.scalar import Const, Name, Scalar
from deepbots_cli.program import Program
from deepbots_cli.program.task import ImageObservation, ObservedNumber


def print_observation(space: Workspace, printer: Printer) -> None:
    noise = _print_noise(space, printer)
    packed = []
    for entry in space.scenario.numbers:
        name = space.names(f"seen {entry.name}", entry.component)  # the blank keeps it apart from a signal called `seen`
        if entry.truth:
            packed.append(f"1.0 if {printer.value(entry.scalar)} else 0.0")
            continue
        code = _value(printer, entry)
        if entry.noise is not None:
            printer.line(f"{name} = {code}")
            code = (
                f"{name} + {_scale(space, (entry.std, entry.noise.relative), entry.name, entry.component, name)} * {noise[entry.full_name]}"
            )
        printer.line(f"{name} = {_normalised(code, entry)}")
        if entry.clip:
            printer.line(f"if not -1.0 <= {name} <= 1.0:")
            printer.line(f"    {name} = clipped({name})")
        else:
            printer.line(f"if not -1e30 < {name} < 1e30:")
            printer.line(f"    unbounded({name})")
        packed.append(name)
    if packed and space.remembers:
        place = "0" if printer.starting else f"self.newest * {4 * len(packed)}"
        printer.line(f"self.pack({', '.join(['self.frames', place, *packed])})")
    elif packed:
        printer.line(f"self.pack({', '.join(['self.observed', '0', *packed])})")
    for pictured in space.scenario.images:
        printer.line(f"{album(space, pictured)}[{'0' if printer.starting else 'self.newest'}] = {printer.value(pictured.value.scalar)}")
    if space.remembers and printer.starting:
        printer.line("self.fill_frames()")


def album(space: Workspace, pictured: ImageObservation) -> str:
    """The attribute that holds the last pictures of one kind, a ring as that of the numbers."""
    return f"self.{space.names('album', pictured.key)}"


def print_next_frame(space: Workspace, printer: Printer) -> None:
    """Make room for what the policy sees after this step."""
    if space.remembers:
        printer.line("self.newest = (self.newest + 1) % self.depth")


def print_deviations(space: Workspace, printer: Printer) -> None:
    """Draw the standard deviations that differ between episodes."""
    observed = [(entry.name, entry.component, entry.std) for entry in space.scenario.numbers]
    measured = [(path, part, std) for path, (parts, _) in _measured(space.scenario).items() for part, std in parts]
    for name, component, std in (*observed, *measured):
        if std is not None and not isinstance(std, Const):
            printer.assign(_deviation(space, name, component), std)


def print_noise(space: Workspace, printer: Printer, path: str, targets: list[str]) -> None:
    """Add noise to the local variables of the value at `path`; nothing where the scenario gives it none."""
    if path not in (measured := _measured(space.scenario)):
        return
    parts, relative = measured[path]
    normals = [space.names(f"noise {path.partition('.')[2]}", component) for component, _ in parts]
    _print_normals(printer, path, normals)
    for target, (component, std), normal in zip(targets, parts, normals, strict=True):
        printer.line(f"{target} += {_scale(space, (std, relative), path, component, target)} * {normal}")


def _measured(scenario: Program) -> dict[str, tuple[list[tuple[str | None, Scalar]], bool]]:
    """What the supervisor measures with noise: by path, which also names the random stream, the standard deviation of each component,
    and whether they are relative to the value.
    """
    values = {f"augment.{value.name}": value for value in scenario.signals}
    values |= {"goal.achieved": scenario.goal.achieved} if scenario.goal else {}
    return {
        path: (list(zip(value.components or (None,), value.noise.std.scalars, strict=True)), value.noise.relative)
        for path, value in values.items()
        if value.noise is not None
    }


def _deviation(space: Workspace, name: str, component: str | None) -> str:
    """The attribute that holds a standard deviation which every episode draws."""
    return f"self.{space.names('deviation', name, component)}"


def _value(printer: Printer, entry: ObservedNumber) -> str:
    # the reward of this step is known here; everywhere else the name means that of the step before
    return "self.reward" if entry.scalar == Name("previous_reward") else printer.value(entry.scalar)


def _print_noise(space: Workspace, printer: Printer) -> dict[str, str]:
    """Standard normal numbers for all entries that want them, from one stream per name; the local of each full name."""
    groups: dict[str, list[ObservedNumber]] = {}
    for entry in space.scenario.numbers:
        if entry.noise is not None:
            groups.setdefault(entry.name, []).append(entry)
    locals_: dict[str, str] = {}
    for name, entries in groups.items():
        targets = [space.names(f"noise {entry.name}", entry.component) for entry in entries]
        _print_normals(printer, f"observation.{name}", targets)
        locals_ |= {entry.full_name: target for entry, target in zip(entries, targets, strict=True)}
    return locals_


def _print_normals(printer: Printer, stream: str, targets: list[str]) -> None:
    """Standard normal numbers from one stream."""
    printer.line(f"{targets_code(targets)} = self.streams[{quoted(stream)}].standard_normal({len(targets)}).tolist()")


def _scale(space: Workspace, noise: tuple[Scalar | None, bool], name: str, component: str | None, exact: str) -> str:
    """Code of the standard deviation of the noise on the variable `exact`; `noise` is that and whether it is relative."""
    std, relative = noise
    value = repr(std.value) if isinstance(std, Const) else _deviation(space, name, component)
    return f"{value} * {exact}" if relative else value


def _normalised(code: str, entry: ObservedNumber) -> str:
    """Code that maps [low, high] to [-1, 1]."""
    half, middle = (entry.high - entry.low) / 2, (entry.high + entry.low) / 2
    if middle == 0.0:
        return f"{operand(code)} * {1 / half!r}" if half != 1.0 else code
    return f"({code} - {middle!r}) * {1 / half!r}"
