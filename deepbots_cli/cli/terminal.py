"""Output: results on stdout, everything else, such as progress, on stderr; color on terminals only."""

from __future__ import annotations

import json
import math
import os
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import is_dataclass
from pathlib import Path
from shutil import get_terminal_size
from typing import TYPE_CHECKING, TextIO

from pydantic import BaseModel

from deepbots_cli import words
from deepbots_cli.diagnostics import Finding
from deepbots_cli.diagnostics.render import escape_log_commands, render, summary
from deepbots_cli.display import Display
from deepbots_cli.errors import UsageError
from deepbots_cli.files import atomic_write, check_output
from deepbots_cli.processes import VERDICT_FILE
from deepbots_cli.words import counted, shell_word

if TYPE_CHECKING:
    from deepbots_cli.document import Permissions
    from deepbots_cli.learning.runs.run import Run
    from deepbots_cli.program import Program


def print_result(text: str = "") -> None:
    """Print a result on stdout."""
    print(printable(text))


def print_verdict(text: str, reasons: Sequence[str] = ()) -> None:
    """Print the result of a command in a sentence, bold on a terminal, and write it into the file that
    `VERDICT_FILE` names, with a line for each of the `reasons`, which the command has printed already."""
    print(f"\x1b[1m{printable(text)}\x1b[0m" if uses_color(sys.stdout) else printable(text))
    if path := os.environ.get(VERDICT_FILE):
        with suppress(OSError):
            Path(path).write_text("\n".join([text, *reasons]), encoding="utf-8")


def note(text: str) -> None:
    """Print a remark on stderr."""
    print(printable(text), file=sys.stderr)


def print_error(text: str) -> None:
    """Print an error on stderr."""
    mark = "\x1b[1;31merror\x1b[0m" if uses_color(sys.stderr) else "error"
    print(f"{mark}: {printable(text)}", file=sys.stderr)


@contextmanager
def transient_line(text: str) -> Iterator[Callable[[str], None]]:
    """Context with a line on stderr, on a terminal only, which disappears at the end of the block.

    Yields a function that rewrites the line.
    """
    display = Display(transient=True)
    if text:
        display.show(printable(text))
    try:
        yield lambda further: display.show(printable(further))
    finally:
        display.close()


@contextmanager
def progress(unit: str = "episodes", *, always: bool = True) -> Iterator[Callable[[int, int], None]]:
    """Context with a function that shows the numbers of completed and of all items, again from 1 for the next
    row of them.

    Unless `always`, there is at most one line in 2 s if standard error is not a terminal.
    """
    bar: ProgressBar | None = None
    began = shown_at = time.perf_counter()

    def show(count: int, total: int) -> None:
        nonlocal bar, began, shown_at
        bar = bar or ProgressBar(total, unit, began=began)
        now = time.perf_counter()
        if always or sys.stderr.isatty() or now - shown_at >= _LINE_INTERVAL_S:
            bar.update(count)
            shown_at = now
        if count >= total:
            bar.close()
            bar, began = None, now

    try:
        yield show
    finally:
        if bar is not None:
            bar.close()


def scenario_options(permissions: Permissions, overrides: Iterable[str] = ()) -> list[str]:
    """Return the options with which another command reads the same scenario."""
    options = [f"--set {shell_word(text)}" for text in overrides]
    options += [f"--allow-path {shell_word(folder)}" for folder in permissions.folders]
    return [*options, *["--allow-code"] * permissions.code]


def _lint_command(names: Iterable[str], *options: str) -> str:
    return " ".join(["deepbots lint", *map(shell_word, names), *options])


def show_findings(findings: Sequence[Finding], permissions: Permissions) -> None:
    """Print findings in full on stderr, with their number, and the command that fixes some of them."""
    print(render(findings, "full", uses_color(sys.stderr), width()), end="", file=sys.stderr)
    note(summary(findings))
    fixes = [finding.fix for finding in findings if finding.fix is not None and finding.fix.safe]
    named = [[edit.span.source.name for edit in fix.edits] for fix in fixes]
    # A fix of a `--set` is left to the user.
    in_files = [names for names in named if all(Path(name).is_file() for name in names)]
    if files := dict.fromkeys(name for names in in_files for name in names):
        command = _lint_command(files, *scenario_options(permissions), "--fix")
        note(f"{len(in_files)} can be fixed by: {command}")


def note_warnings(
    warnings: Sequence[Finding], scenario: str, permissions: Permissions, overrides: Iterable[str] = ()
) -> None:
    """Print a note that there are warnings, and how to see them."""
    if warnings:
        command = _lint_command([scenario], *scenario_options(permissions, overrides))
        note(f"{summary(warnings)}; see: {command}")


def note_physics(run: Run) -> None:
    """Print a note if the run was trained with another version of the physics."""
    for text in run.notes_on_physics():
        note(f"note: {text}")


def note_faster_engine(program: Program, timesteps: int | None, permissions: Permissions) -> None:
    """Print a line if another engine than the default one is faster, and makes a training at least 30 s of
    CPU time shorter.
    """
    from deepbots_cli.insight.speed import engine_worth_naming

    faster = engine_worth_naming(program, timesteps, permissions=permissions)
    if faster is not None:
        note(f"note: {faster.text}")


def show_json(data: object) -> None:
    """Print data as JSON on stdout."""
    print(json_text(data), end="")


def show(
    data: object, *lines: str, as_json: bool, verdict: str = "", next_commands: Sequence[str] = ()
) -> None:
    """Print a result on stdout, as JSON or as its verdict and lines; after the lines, print the next commands
    on stderr."""
    if as_json:
        show_json(data)
        return
    if verdict:
        print_verdict(verdict)
        print_result()
    for line in lines:
        print_result(line)
    if next_commands:
        note("\n".join(["\nnext:", *(f"  {command}" for command in next_commands)]))


def json_text(data: object) -> str:
    """Return data as JSON with a final line feed. Infinite numbers are null, since JSON has none."""
    return json.dumps(json_compatible(data), indent=2, allow_nan=False) + "\n"


def uses_color(stream: TextIO) -> bool:
    """Return whether to write color to `stream`: a terminal, unless NO_COLOR is set."""
    # By no-color.org, any value of NO_COLOR but an empty one turns color off.
    return stream.isatty() and not os.environ.get("NO_COLOR") and os.environ.get("TERM") != "dumb"


def width() -> int:
    """Return the number of columns of the terminal, at most 140."""
    return min(get_terminal_size((100, 24)).columns, 140)


def printable(text: str) -> str:
    """Return `text`, which may quote a file, with control and invisible characters escaped, and commands to
    logs made inert."""
    return escape_log_commands(text if text.isprintable() else words.printable(text, "\n"))


def json_compatible(data: object) -> object:
    """Return `data` as lists, dictionaries, text and finite numbers; records as dictionaries of their
    fields, and of the properties that they name in `derived`."""
    match data:
        case float() if not math.isfinite(data):
            return None
        case Mapping():
            return {str(key): json_compatible(value) for key, value in data.items()}
        case list() | tuple():
            return [json_compatible(item) for item in data]
        case Path():
            return str(data)
        case BaseModel():
            return data.model_dump(mode="json")
        case _ if is_dataclass(data) and not isinstance(data, type):
            derived = {name: getattr(data, name) for name in getattr(data, "derived", ())}
            return json_compatible(vars(data) | derived)
        case _:
            return data


# Progress on standard error: a bar on a terminal, a line for every tenth of the way elsewhere

_MIN_TIMED_S = 0.5
"""The time before a speed is shown, in s."""
_LINE_INTERVAL_S = 2.0
"""The time between two lines of a work that need not be followed, in s."""


class ProgressBar:
    """The progress of a task, its speed, and the remaining time; `unit` is the name of the counted items, in
    the plural. The first item began at `began`, by default now.

    On a terminal, the bar disappears at the end. Elsewhere there is a line for every tenth.
    """

    def __init__(
        self, total: int, unit: str, *, began: float | None = None, stream: TextIO | None = None
    ) -> None:
        self._total = max(1, total)
        self._unit = unit
        self._display = Display(stream, transient=True)
        self._began = time.perf_counter() if began is None else began
        self._tenth = 0

    def update(self, count: int) -> None:
        """Show that `count` of the total is done."""
        line = self._line(count, time.perf_counter())
        tenth = 10 * count // self._total
        if tenth > self._tenth and not self._display.is_terminal:
            self._display.print(line)
        self._tenth = max(tenth, self._tenth)
        self._display.show(line, count, self._total, at_once=count >= self._total)

    def _line(self, count: int, now: float) -> str:
        parts = [f"{count:,} of {self._total:,} {self._unit}"]
        elapsed = now - self._began
        if elapsed < _MIN_TIMED_S:
            return parts[0]
        speed = count / elapsed
        if speed >= 1.0:
            parts.append(f"{counted(round(speed), self._unit.partition(' ')[0].removesuffix('s'))}/s")
        if speed > 0.0 and count < self._total:
            parts.append(f"{(self._total - count) / speed:.0f} s to go")
        return "  ".join(parts)

    def close(self) -> None:
        """Leave the terminal as it was."""
        self._display.close()


def output_file(output: Path | None) -> Path | None:
    """Return the file that an option `--output` names; None for standard output, which is also named `-`."""
    return None if output == Path("-") else output


def refuse_input(output: Path, files: Iterable[Path], contents: Iterable[bytes]) -> None:
    """Refuse to write over an input of a scenario, or over a copy of one.

    Args:
        output: The file to write.
        files: The resolved paths of the inputs.
        contents: The contents of the inputs.

    Raises:
        UsageError: The file has the path or the content of an input.
    """
    if output.resolve() in files or (output.is_file() and output.read_bytes() in contents):
        raise UsageError(f"{output} is an input of the scenario; name another output file")


def print_or_write(text: str, output: Path | None, *, force: bool) -> None:
    """Write a text to a file; print it if there is none."""
    if output is None:
        print(text, end="")
    else:
        check_output(output, force=force)
        with atomic_write(output) as draft:
            draft.write_text(text, encoding="utf-8")
