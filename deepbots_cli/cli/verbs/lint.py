"""`deepbots lint`."""

from __future__ import annotations

import re
from collections.abc import Iterator
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from deepbots_cli import api
from deepbots_cli.cli import terminal
from deepbots_cli.cli.exits import FAILED
from deepbots_cli.cli.options import AllowCode, AllowPaths, Sets
from deepbots_cli.cli.reports import report
from deepbots_cli.diagnostics import Finding, Severity
from deepbots_cli.diagnostics.render import summary
from deepbots_cli.errors import UsageError

_SCENARIO = re.compile(rb"^(?:\xef\xbb\xbf)?deepbots[ \t]*:", re.MULTILINE)
_LOOKED_AT = 65_536


class Format(StrEnum):
    full = "full"
    concise = "concise"
    json = "json"
    github = "github"
    sarif = "sarif"
    junit = "junit"


class FailOn(StrEnum):
    error = "error"
    warning = "warning"
    never = "never"


_FAILING: dict[FailOn, tuple[Severity, ...]] = {FailOn.error: ("error",), FailOn.warning: ("error", "warning"), FailOn.never: ()}


def command(
    scenarios: Annotated[list[str], typer.Argument(metavar="SCENARIO", help="Files, names of shipped scenarios, or folders of scenarios.")],
    sets: Sets = None,
    format: Annotated[Format, typer.Option("--format", help="With the lines in question, one line each, or for programs.")] = Format.full,
    as_json: Annotated[bool, typer.Option("--json", help="The same as --format json.")] = False,
    fail_on: Annotated[FailOn, typer.Option("--fail-on", help="What makes the exit code 1.")] = FailOn.error,
    preview: Annotated[bool, typer.Option("--preview", help="Also the rules that may still misfire.")] = False,
    fix: Annotated[bool, typer.Option("--fix", help="Write what can only have been meant into the files.")] = False,
    unsafe_fixes: Annotated[bool, typer.Option("--unsafe-fixes", help="Good guesses as well, with --fix or --diff.")] = False,
    diff: Annotated[bool, typer.Option("--diff", help="Show what --fix would change, and write nothing.")] = False,
    allow_paths: AllowPaths = None,
    allow_code: AllowCode = False,
) -> None:
    """Say everything that is wrong with scenarios.

    Every problem is shown at once, with its place and what to write instead. Nothing is run, and no simulator is needed.
    In a folder, every .yaml file with a `deepbots:` key is read.

    \b
      deepbots lint cartpole.yaml
      deepbots lint scenarios/ --fail-on warning
      deepbots lint cartpole.yaml --set world.timestep=50ms --format concise
      deepbots lint cartpole.yaml --fix --unsafe-fixes

    A warning is suppressed by a comment on its line, or on the line above: # deepbots: ignore[DB603]
    """
    names = list(dict.fromkeys(name for given in scenarios for name in _expanded(given)))
    for name in names:
        api.locate(name)
    if fix or diff or unsafe_fixes:
        _check_fixing(fix, diff, sets)
        from deepbots_cli.cli.mending import Mender, mend

        mender = Mender(names, unsafe=unsafe_fixes, allow_paths=allow_paths or (), allow_code=allow_code, preview=preview)
        left, changes = mend(mender, show=diff)
        if not diff:
            _show(left, names, Format.json if as_json else format, _FAILING[fail_on])
        if _fails(left, fail_on) or (diff and changes):
            raise typer.Exit(FAILED)
        return
    linted = (api.lint(name, sets=sets or (), allow_paths=allow_paths or (), allow_code=allow_code, preview=preview) for name in names)
    # What scenarios share is read for each of them, and told once.
    findings = list({finding.sort_key: finding for found in linted for finding in found}.values())
    _show(findings, names, Format.json if as_json else format, _FAILING[fail_on])
    if format is Format.full and not as_json and any(finding.fix for finding in findings):
        from deepbots_cli.cli.mending import hint

        terminal.note(hint(findings) or "")
    if _fails(findings, fail_on):
        raise typer.Exit(FAILED)


def _check_fixing(fix: bool, diff: bool, sets: list[str] | None) -> None:
    if not (fix or diff):
        raise UsageError("--unsafe-fixes goes with --fix, or with --diff to see what it would do")
    if sets:
        raise UsageError("--set changes values for one look only; fix the files without it")


def _expanded(given: str) -> Iterator[str]:
    """The scenarios meant by one argument."""
    folder = Path(given)
    if not folder.is_dir():
        yield given
        return
    found = [str(path) for path in sorted(folder.glob("*.yaml")) if path.is_file() and _is_scenario(path)]
    if not found:
        raise UsageError(f"there is no scenario in {given}: no .yaml file there has a `deepbots:` key")
    yield from found


def _is_scenario(path: Path) -> bool:
    with path.open("rb") as file:
        return _SCENARIO.search(file.read(_LOOKED_AT)) is not None


def _show(findings: list[Finding], names: list[str], format: Format, failing: tuple[Severity, ...]) -> None:
    print(report(findings, format.value, names, failing), end="")
    if format is Format.full:
        terminal.say(summary(findings) if findings else f"{names[0] if len(names) == 1 else f'{len(names)} scenarios'}: no findings")


def _fails(findings: list[Finding], fail_on: FailOn) -> bool:
    return any(finding.severity in _FAILING[fail_on] for finding in findings)
