"""`deepbots lint`."""

from __future__ import annotations

from collections.abc import Sequence
from enum import StrEnum
from functools import partial
from typing import Annotated

import typer

from deepbots_cli import api
from deepbots_cli.cli import rewriting, terminal
from deepbots_cli.cli.exits import FAILED, FAULT
from deepbots_cli.cli.linting import STDIN, Look, findings_of, named
from deepbots_cli.cli.options import AllowCode, AllowPaths, Sets, whole
from deepbots_cli.cli.reports import report
from deepbots_cli.diagnostics import Edit, Finding, Severity, Source
from deepbots_cli.diagnostics.render import summary
from deepbots_cli.diagnostics.suppress import Selection, Words
from deepbots_cli.errors import UsageError
from deepbots_cli.lint.fixes import Fixer
from deepbots_cli.lint.settings import settings


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


_FAILING: dict[str, tuple[Severity, ...]] = {"error": ("error",), "warning": ("error", "warning"), "never": ()}

Codes = list[str] | None


def command(
    scenarios: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="[SCENARIO]...", help="Files, shipped scenarios by name, folders (by default this one), - for standard input."
        ),
    ] = None,
    sets: Sets = None,
    format: Annotated[Format | None, typer.Option("--format", help="With the lines in question, a line each, or a report.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="The same as --format json.")] = False,
    select: Annotated[Codes, typer.Option("--select", metavar="CODES", help="Only these: codes, beginnings of codes or names.")] = None,
    ignore: Annotated[Codes, typer.Option("--ignore", metavar="CODES", help="Not these; the longer of two beginnings counts.")] = None,
    fail_on: Annotated[FailOn | None, typer.Option("--fail-on", help="What makes the exit code 1; errors, unless said otherwise.")] = None,
    exit_zero: Annotated[bool, typer.Option("--exit-zero", help="The same as --fail-on never.")] = False,
    preview: Annotated[bool | None, typer.Option("--preview/--no-preview", help="Also the rules that may still misfire.")] = None,
    deep: Annotated[bool, typer.Option("--deep", help="Also simulate each scenario for a short while, and measure.")] = False,
    fix: Annotated[bool, typer.Option("--fix", help="Write what can only have been meant into the files.")] = False,
    unsafe_fixes: Annotated[bool, typer.Option("--unsafe-fixes", help="Good guesses as well, with --fix or --diff.")] = False,
    diff: Annotated[bool, typer.Option("--diff", help="Show what --fix would change, and write nothing.")] = False,
    stdin_name: Annotated[str | None, typer.Option("--stdin-filename", metavar="FILE", help="The file that standard input is of.")] = None,
    jobs: Annotated[int, typer.Option("--jobs", "-j", metavar="N", parser=whole(), help="Processes, which pay from tens of files on.")] = 1,
    allow_paths: AllowPaths = None,
    allow_code: AllowCode = False,
) -> None:
    """Check scenarios and report every problem.

    Every problem is shown at once, with its place and what to write instead. Nothing is run, and no simulator is needed,
    but for --deep, which simulates what has no errors in a process of its own and tells what it measures.
    Of a folder, every .yaml or .yml file with a `deepbots:` key is read, down through the folders inside. What a project
    always wants stands in its deepbots.toml, under [lint], or in its pyproject.toml, under [tool.deepbots.lint].

    \b
      deepbots lint cartpole.yaml
      deepbots lint scenarios/ --fail-on warning
      deepbots lint cartpole.yaml --set world.timestep=50ms --format concise
      deepbots lint cartpole.yaml --deep
      deepbots lint cartpole.yaml --diff --unsafe-fixes
      deepbots lint cartpole.yaml --fix --unsafe-fixes
      deepbots lint scenarios/ --select DB6,DB7 --ignore term-dominates

    A warning is suppressed by a comment on its line, or on the line above: # deepbots: ignore[DB603]
    """
    project = settings()
    previewed = bool(project.preview) if preview is None else preview
    selection = Selection(
        _words("--select", select) or project.select, _words("--ignore", ignore) or project.ignore, preview=previewed, deep=deep
    )
    if deep:
        _check_simulator(fix or diff or unsafe_fixes)
    look = Look(tuple(sets or ()), tuple(allow_paths or ()), allow_code, previewed, deep, stdin_name)
    names = named(scenarios or ["."], project)
    if stdin_name and STDIN not in names:
        raise UsageError("--stdin-filename goes with - for standard input")
    format_ = Format.json if as_json else format or Format(project.format or Format.full)
    failing = _FAILING["never" if exit_zero else fail_on or project.fail_on or "error"]
    changes = False
    if fix or diff or unsafe_fixes:
        _check_fixing(fix, diff, sets, names)
        if diff and (as_json or format):
            raise UsageError("--diff shows the change and no findings, so it takes no --format")
        findings, changes = _fixed(names, look, selection, unsafe=unsafe_fixes, show=diff)
    else:
        findings = findings_of(names, look, jobs)
    shown = [*selection.inactive_rules(), *filter(selection.wants, findings)]
    if diff and shown and not changes:
        _explain_empty_diff([] if unsafe_fixes else shown)
    if not diff:
        print(report(shown, format_.value, [look.called(name) for name in names], failing), end="")
        if format_ is Format.full:
            _sum_up(shown, names, selection, fixable=not (fix or sets), deep=deep)
    hidden = [finding for finding in findings if finding.severity == "error" and not selection.wants(finding)]
    _confess(hidden)
    if any(finding.is_fault for finding in shown):
        raise typer.Exit(FAULT)
    if any(finding.severity in failing for finding in (*shown, *hidden)) or (diff and changes):
        raise typer.Exit(FAILED)


def _words(option: str, given: Codes) -> Words | None:
    """The codes of an option, which may be repeated and hold several."""
    if given is None:
        return None
    text = ",".join(given)
    return Words(tuple(word.strip() for word in text.split(",")), Source(option, text))


def _check_simulator(fixing: bool) -> None:
    from deepbots_cli.lint.simulation import require_simulator

    if fixing:
        raise UsageError("--deep measures, and nothing that it finds can be fixed by a program; run it without --fix and --diff")
    require_simulator()


def _check_fixing(fix: bool, diff: bool, sets: list[str] | None, names: Sequence[str]) -> None:
    if not (fix or diff):
        raise UsageError("--unsafe-fixes goes with --fix, or with --diff to see what it would do")
    if sets:
        raise UsageError("--set changes values for one look only; fix the files without it")
    if STDIN in names:
        raise UsageError("standard input is no file that could be fixed; name the file")


def _fixed(names: Sequence[str], look: Look, selection: Selection, *, unsafe: bool, show: bool) -> tuple[list[Finding], bool]:
    """The findings that are left after fixing, and whether a file changes; `show` prints the difference and writes nothing."""
    load = partial(api.load, allow_paths=look.allow_paths, allow_code=look.allow_code)
    fixer = Fixer(names, load, unsafe=unsafe, wanted=selection.wants, preview=look.preview)
    rewrites = fixer.fix()
    for rewrite in rewrites:
        if show:
            rewriting.show(rewrite)
        else:
            rewriting.write(rewrite)
    for finding in fixer.fixed:
        edit = finding.fix.edits[0] if finding.fix else None
        terminal.note(f"{'would fix' if show else 'fixed'} {finding.span.where}: {finding.code}[{finding.name}] {_change(edit)}")
    if fixer.fixed:
        verb, files = "would be fixed" if show else "fixed", len(rewrites)
        terminal.note(f"{len(fixer.fixed)} {verb} in {files} file{'s' if files > 1 else ''}")
    return fixer.left, bool(rewrites)


def _change(edit: Edit | None) -> str:
    old, new = (" ".join(text.split())[:60] for text in (edit.span.text, edit.text)) if edit else ("", "")
    return f"`{old}` -> `{new}`" if new else f"`{old}` removed"


def _hint(findings: Sequence[Finding]) -> str | None:
    """How many findings can be fixed, and by which option."""
    safe = sum(finding.fix is not None and finding.fix.safe for finding in findings)
    unsafe = sum(finding.fix is not None and not finding.fix.safe for finding in findings)
    if not safe:
        return f"{unsafe} may be fixed by --fix --unsafe-fixes; see what they would do with --diff --unsafe-fixes" if unsafe else None
    return f"{safe} can be fixed by --fix" + (f", {unsafe} more by --unsafe-fixes" if unsafe else "")


def _sum_up(findings: list[Finding], names: list[str], selection: Selection, *, fixable: bool, deep: bool) -> None:
    """How many there are, or a friendly word; and how many of them can be fixed."""
    if not findings:
        called = names[0] if len(names) == 1 else f"{len(names)} scenarios"
        asked = "" if selection.is_everything else " of those asked for"
        terminal.say(f"{called}: no findings{asked}{', also when simulated' if deep else ''}")
        return
    terminal.say(summary(findings))
    if fixable and any(finding.fix for finding in findings):
        terminal.note(_hint(findings) or "")


def _explain_empty_diff(left: list[Finding]) -> None:
    """Say that there is no difference to show, and which option would show the good guesses among the fixes that are `left`."""
    guesses = _hint([finding for finding in left if finding.fix and not finding.fix.safe])
    terminal.note("there is no difference to show" + (f"; {guesses}" if guesses else ""))


def _confess(hidden: list[Finding]) -> None:
    """Say which errors are not shown: they keep a scenario from being compiled all the same, and other rules from looking at it."""
    if hidden:
        places = ", ".join(dict.fromkeys(finding.span.source.name for finding in hidden))
        codes = ", ".join(sorted({finding.code for finding in hidden}))
        terminal.note(f"{summary(hidden)} not asked for ({codes}) in {places}; nothing more was looked for there")
