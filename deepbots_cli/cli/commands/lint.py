"""`deepbots lint`: findings of files, folders and standard input, and their fixes; `fmt`: the canonical
layout."""

from __future__ import annotations

import sys
import time
from codecs import BOM_UTF8
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import field
from enum import StrEnum
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import Annotated, Literal

import typer

from deepbots_cli import api
from deepbots_cli.cli import terminal, written_files
from deepbots_cli.cli.arguments import (
    STDIN,
    is_robot,
    robot_findings,
    robot_path,
    scenario_names,
    xacro_arguments,
)
from deepbots_cli.cli.command import (
    ADVANCED,
    OUTPUT,
    Overrides,
    XacroArguments,
    check_options,
    integer,
    option,
)
from deepbots_cli.cli.exits import FAILED, INTERNAL_ERROR
from deepbots_cli.compiler import CheckedScenario
from deepbots_cli.diagnostics import Edit, Finding, Findings, Severity, Span
from deepbots_cli.diagnostics import Source as SourceText
from deepbots_cli.diagnostics.findings import RuleSelectors, Selection, exception_finding
from deepbots_cli.diagnostics.registry import RULES
from deepbots_cli.diagnostics.render import escape_log_commands, github, junit, render, sarif, summary
from deepbots_cli.document import Permissions, files
from deepbots_cli.document.layout import canonical_text
from deepbots_cli.document.load import Drafts
from deepbots_cli.document.nodes import MappingNode
from deepbots_cli.document.parse import parse
from deepbots_cli.errors import DeepbotsError, MissingExtraError, UsageError
from deepbots_cli.files import READS, Stamps, file_stamps, is_file, recorded_reads
from deepbots_cli.lint import all_findings, find_exploits, simulate
from deepbots_cli.lint.fixes import Fixer, LintResult, Rewrite
from deepbots_cli.lint.settings import scenarios_in, settings
from deepbots_cli.processes import safe_path
from deepbots_cli.records import dataclass
from deepbots_cli.rollout.source import Source, SourceKind
from deepbots_cli.words import counted, shell_word

_FAILING_SEVERITIES: dict[str, tuple[Severity, ...]] = {
    "error": ("error",),
    "warning": ("error", "warning"),
    "never": (),
}

_WATCH_INTERVAL_S = 0.3


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


Codes = list[str] | None
_RULES = "Rules"


def command(
    ctx: typer.Context,
    scenarios: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="SCENARIO",
            help="Scenario files, names of shipped scenarios, robot files, folders, or - for standard input; by"
            " default this folder.",
        ),
    ] = None,
    overrides: Overrides = None,
    xacro: XacroArguments = None,
    format: Annotated[
        Format | None, option("--format", "Output format; full by default, with the source lines.", OUTPUT)
    ] = None,
    as_json: Annotated[bool, option("--json", "Same as --format json.", OUTPUT)] = False,
    select: Annotated[
        Codes,
        option(
            "--select CODES",
            "Report only these findings: codes, prefixes of codes, or names, separated by commas.",
            _RULES,
        ),
    ] = None,
    ignore: Annotated[
        Codes,
        option(
            "--ignore CODES",
            "Do not report these findings. If --select also matches a finding, the longer code decides:"
            " `--select DB603 --ignore DB6` reports DB603. If both are equally long, the finding is ignored."
            " A name, such as term-dominates, counts as its code, DB702.",
            _RULES,
        ),
    ] = None,
    fail_on: Annotated[
        FailOn | None,
        option("--fail-on", "Lowest severity for which the exit code is 1; error by default.", OUTPUT),
    ] = None,
    exit_zero: Annotated[bool, option("--exit-zero", "Same as --fail-on never.", OUTPUT)] = False,
    preview: Annotated[
        bool | None,
        option(
            "--preview/--no-preview",
            "Also run the rules in preview, which can report false findings; off by default.",
            _RULES,
        ),
    ] = None,
    watch: Annotated[bool, option("--watch", "Lint again when a file is saved, until Ctrl-C.")] = False,
    statistics: Annotated[
        bool, option("--statistics", "Show the number of findings of each code.", OUTPUT)
    ] = False,
    deep: Annotated[
        bool, option("--deep", "Also simulate, for a short time, each scenario that has no errors.")
    ] = False,
    exploits: Annotated[
        bool,
        option(
            "--exploits",
            "Also search for exploits of the reward: episodes without success that pay more than a success."
            " Recordings of them, and a record of the search, are kept in ./exploits.",
        ),
    ] = False,
    fix: Annotated[bool, option("--fix", "Apply the safe fixes to the files.")] = False,
    unsafe_fixes: Annotated[
        bool,
        option(
            "--unsafe-fixes",
            "Also apply the unsafe fixes, which are guesses; with --fix or --diff.",
            ADVANCED,
        ),
    ] = False,
    diff: Annotated[bool, option("--diff", "Show the changes of --fix, and write nothing.")] = False,
    stdin_name: Annotated[
        str | None, option("--stdin-filename FILE", "File name for standard input.", ADVANCED)
    ] = None,
    jobs: Annotated[
        int, integer("--jobs -j N", "Number of processes; useful for tens of files or more.", group=ADVANCED)
    ] = 1,
    permissions: Permissions = Permissions(),
) -> None:
    """Check scenarios and robot files, and report their findings."""
    project = settings()
    previewed = bool(project.preview) if preview is None else preview
    selection = Selection(
        _words("--select", select) or project.select,
        _words("--ignore", ignore) or project.ignore,
        preview=previewed,
        deep=deep,
        exploits=exploits,
    )
    for option_name in ["--deep"] * deep + ["--exploits"] * exploits:
        _check_simulator(option_name)
    names = scenario_names(scenarios or ["."], project)
    arguments = xacro_arguments(xacro, of_robot=all(map(is_robot, names)))
    look = LintOptions(tuple(overrides or ()), permissions, previewed, deep, exploits, stdin_name, arguments)
    if any(map(is_robot, names)):
        check_options(ctx, "a robot file")
    check_options(ctx, "standard input" if STDIN in names else "files")
    format_ = Format.json if as_json else format or Format(project.format or Format.full)
    if statistics and format_ not in (Format.full, Format.concise, Format.json):
        raise UsageError("--statistics prints a table or JSON; leave out other formats")
    if watch:
        assert ctx.command.callback is not None  # this function, after the options are converted
        once = partial(ctx.command.callback, **{**ctx.params, "watch": False})
        _watch(once, partial(scenario_names, scenarios or ["."], project))
        return
    failing = _FAILING_SEVERITIES["never" if exit_zero else fail_on or project.fail_on or "error"]
    changes = False
    if fix or diff:
        findings, changes = _fixed(names, look, selection, unsafe=unsafe_fixes, show=diff)
    else:
        findings = findings_of(names, look, jobs)
    selected = [*selection.inactive_rules(), *filter(selection.selects, findings)]
    if (fix or diff) and selected and not changes:
        _explain_empty_diff([] if unsafe_fixes else selected)
    if statistics:
        _show_statistics(selected, as_json=format_ is Format.json)
    elif not diff:
        print(report(selected, format_, [look.called(name) for name in names], failing), end="")
        if format_ is Format.full:
            _sum_up(selected, names, selection, fixable=not (fix or overrides or STDIN in names), look=look)
    hidden = [
        finding for finding in findings if finding.severity == "error" and not selection.selects(finding)
    ]
    _note_hidden(hidden)
    if any(finding.is_internal_error for finding in selected):
        raise typer.Exit(INTERNAL_ERROR)
    if any(finding.severity in failing for finding in (*selected, *hidden)) or (diff and changes):
        raise typer.Exit(FAILED)


def _watch(lint_once: Callable[[], None], find_names: Callable[[], list[str]]) -> None:
    """Lint, and again whenever a file changes after it was read, or a folder has other scenarios, until
    Ctrl-C."""

    def names() -> list[str] | None:
        try:
            return find_names()
        except DeepbotsError:  # a file is missing for a moment while an editor saves
            return None

    with suppress(KeyboardInterrupt):
        while True:
            linted = names()
            with recorded_reads() as files:
                try:
                    lint_once()
                except typer.Exit:
                    pass  # the findings are shown
                except DeepbotsError as error:
                    terminal.print_error(error.full_message)
            sys.stdout.flush()
            terminal.note(
                f"{time.strftime('%H:%M:%S')}: watching {sum(map(is_file, files))} files; Ctrl-C ends it"
            )
            while (names(), file_stamps(files)) == (linted, files):
                time.sleep(_WATCH_INTERVAL_S)


def _show_statistics(findings: Sequence[Finding], *, as_json: bool) -> None:
    """Show a row for each code, the most frequent first."""
    from deepbots_cli.cli.tables import Row, table  # only this needs rich

    groups: dict[str, list[Finding]] = {}
    for finding in findings:
        groups.setdefault(finding.code, []).append(finding)
    rows: list[Row] = [
        {
            "count": len(group),
            "code": code,
            "name": group[0].name,
            "severity": group[0].severity,
            "fixable": sum(finding.fix is not None for finding in group),
        }
        for code, group in groups.items()
    ]
    rows.sort(key=lambda row: (-int(str(row["count"])), str(row["code"])))
    terminal.show(rows, table(rows, indent="") if rows else "no findings", as_json=as_json)


def _words(option: str, codes: Codes) -> RuleSelectors | None:
    """Return the codes of an option, which may be repeated and have several codes."""
    if codes is None:
        return None
    text = ",".join(codes)
    return RuleSelectors(tuple(word.strip() for word in text.split(",")), SourceText(option, text))


def _check_simulator(option_name: str) -> None:
    from deepbots_cli.lint.simulation import require_simulator

    require_simulator(f"lint {option_name}")
    if option_name == "--exploits" and find_spec("mcap") is None:
        raise MissingExtraError("sim", "a recording")


def _fixed(
    names: Sequence[str], look: LintOptions, selection: Selection, *, unsafe: bool, show: bool
) -> tuple[list[Finding], bool]:
    """Fix files. Returns the findings that are left, and whether a file changes; `show` prints the difference
    and writes nothing."""
    fixer = Fixer(names, look.load, unsafe=unsafe, selects=selection.selects, preview=look.preview)
    rewrites = fixer.fix()
    for rewrite in rewrites:
        if show:
            written_files.show_difference(rewrite)
        else:
            written_files.write_change(rewrite)
    for finding in fixer.fixed:
        edit = finding.fix.edits[0] if finding.fix else None
        terminal.note(
            f"{'would fix' if show else 'fixed'} {finding.span.location}: {finding.code}[{finding.name}]"
            f" {_change(edit)}"
        )
    if fixer.fixed:
        verb = "would be fixed" if show else "fixed"
        terminal.note(f"{len(fixer.fixed)} {verb} in {counted(len(rewrites), 'file')}")
    return fixer.remaining_findings, bool(rewrites)


def _change(edit: Edit | None) -> str:
    old, new = (" ".join(text.split())[:60] for text in (edit.span.text, edit.text)) if edit else ("", "")
    if not old:
        return f"`{new}` added" if new else "indented"
    return f"`{old}` -> `{new}`" if new else f"`{old}` removed"


def _hint(findings: Sequence[Finding]) -> str | None:
    """Return the number of findings that can be fixed, and the option that fixes them."""
    safe = sum(finding.fix is not None and finding.fix.safe for finding in findings)
    unsafe = sum(finding.fix is not None and not finding.fix.safe for finding in findings)
    if not safe:
        count = f"{unsafe} unsafe fix{'es' * (unsafe > 1)} available"
        return (
            f"{count}: show with --diff --unsafe-fixes, apply with --fix --unsafe-fixes" if unsafe else None
        )
    return f"{safe} can be fixed by --fix" + (f", {unsafe} more by --unsafe-fixes" if unsafe else "")


def _sum_up(
    findings: list[Finding], names: list[str], selection: Selection, *, fixable: bool, look: LintOptions
) -> None:
    """Print the number of findings, and of those with a fix."""
    if not findings:
        called = names[0] if len(names) == 1 else f"{len(names)} scenarios"
        scope = "" if selection.selects_all else " among the selected rules"
        terminal.print_verdict(f"{called}: no findings{scope}{look.included}")
        return
    reasons = ("; ".join(_sentences(finding)).replace("\n", " ") for finding in findings)
    terminal.print_verdict(summary(findings), list(reasons))
    if fixable and any(finding.fix for finding in findings):
        terminal.note(_hint(findings) or "")


def _sentences(finding: Finding) -> list[str]:
    """Return the place and the text of a finding, with its recording if it is an exploit."""
    recording = finding.notes[-1:] if RULES[finding.code].deep == "exploits" else ()
    return [f"{finding.span.location}: {finding.headline}", *filter(None, [finding.help]), *recording]


def _explain_empty_diff(left: list[Finding]) -> None:
    """Note that there are no changes, and which option shows the unsafe fixes among the findings that are
    `left`."""
    guesses = _hint([finding for finding in left if finding.fix and not finding.fix.safe])
    terminal.note("there are no changes" + (f"; {guesses}" if guesses else ""))


def _note_hidden(hidden: list[Finding]) -> None:
    """Name the errors that the selection hides: they still prevent compilation, and so the checks after
    it."""
    if hidden:
        file_names = ", ".join(dict.fromkeys(finding.span.source.name for finding in hidden))
        codes = ", ".join(sorted({finding.code for finding in hidden}))
        terminal.note(
            f"{summary(hidden)} not selected ({codes}) in {file_names}; these scenarios were not checked"
            " further"
        )


# Scenarios


_NAMELESS = "<stdin>"


@dataclass(frozen=True)
class LintOptions:
    """The options for reading each scenario, and for simulating (`deep`) and searching it; `stdin_name` is
    the file name for standard input, `xacro` has the arguments of a robot file alone."""

    overrides: tuple[str, ...] = ()
    permissions: Permissions = Permissions()
    preview: bool = False
    deep: bool = False
    exploits: bool = False
    stdin_name: str | None = None
    xacro: Mapping[str, str] = field(default_factory=dict)

    @property
    def included(self) -> str:
        """The checks besides linting, as a part of a sentence."""
        checks = ["the simulation"] * self.deep + ["the search for exploits"] * self.exploits
        return f", including {' and '.join(checks)}" if checks else ""

    def findings(self, name: str) -> list[Finding]:
        """Return the findings of one scenario."""
        if name == STDIN:
            return self._of_stdin()
        if is_robot(name):
            return robot_findings(name, self.permissions.folders, self.xacro)
        checked = api.load(name, overrides=self.overrides, permissions=self.permissions)
        return self._reviewed(checked, self.called(name), name)

    def load(self, name: str, drafts: Drafts) -> CheckedScenario | LintResult:
        """Return the check of a scenario, or the findings of a robot file."""
        if not is_robot(name):
            return api.load(name, permissions=self.permissions, drafts=drafts)
        findings = robot_findings(name, self.permissions.folders, self.xacro, drafts)
        path = robot_path(name, self.permissions.folders).resolve()
        fixable = next((finding.span.source for finding in findings if finding.fix), None)
        sources = {path: fixable} if fixable else {}
        nothing = MappingNode(Span(SourceText(name, ""), 0, 0), {})
        return LintResult(findings, sources, nothing, compiled=True)

    def _of_stdin(self) -> list[Finding]:
        """Lint standard input. Paths in the text are relative to the folder of `stdin_name`, and the project
        is that of this folder."""
        from deepbots_cli.compiler import check
        from deepbots_cli.document import files, load

        path = Path(self.stdin_name or _NAMELESS).resolve()
        data = sys.stdin.buffer.read(files.MAX_BYTES + 1) if sys.stdin else b""
        display = self.stdin_name or _NAMELESS
        document = load(
            path, self.overrides, display=display, permissions=self.permissions, drafts={path: data}
        )
        return self._reviewed(check(document), display, STDIN)

    def _reviewed(self, checked: CheckedScenario, called: str, name: str) -> list[Finding]:
        """Return the findings from the text and then from a simulation. A scenario with errors cannot be
        simulated."""
        try:
            findings = all_findings(checked, preview=self.preview)
            if not (self.deep or self.exploits):
                return findings
            if any(finding.severity == "error" and not finding.is_internal_error for finding in findings):
                terminal.note(f"{called}: not simulated because it has errors")
                return findings
            measured: list[Finding] | None = None
            if self.deep:
                with terminal.transient_line(f"{called}: simulating"):
                    simulated = simulate(checked, preview=self.preview)
                if simulated.incomplete:
                    terminal.note(
                        f"{called}: the simulation was stopped {simulated.incomplete}; its further findings"
                        " are missing"
                    )
                measured = simulated.findings
            exploits = self._exploits(checked, called, name) if self.exploits else None
            return all_findings(checked, preview=self.preview, measured=measured, exploits=exploits)
        finally:
            checked.release_names()

    def _exploits(self, checked: CheckedScenario, called: str, name: str) -> list[Finding]:
        """Return the findings of a search for exploits, whose episodes are recorded."""
        written_files.folder_of_exploits(checked)
        with terminal.transient_line(f"{called}: searching for exploits"):
            searched = find_exploits(checked)
        if searched.incomplete:
            terminal.note(f"{called}: the search for exploits is incomplete: {searched.incomplete}")
        if checked.program is not None and checked.program.defines_success and not searched.successes:
            terminal.note(
                f"{called}: no episode succeeded, so none was compared with a success; a script that"
                " succeeds serves the search"
            )
        with terminal.transient_line(f"{called}: recording exploits"):
            return written_files.keep_exploits(searched, checked, name, self.overrides, self.permissions)

    def called(self, name: str) -> str:
        """Return the name of the scenario `name` in findings."""
        if is_robot(name):
            return name
        return (
            (self.stdin_name or _NAMELESS)
            if name == STDIN
            else Source.open(name, self.permissions, SourceKind.SCENARIO).name
        )


def findings_of(names: Sequence[str], look: LintOptions, jobs: int = 1) -> list[Finding]:
    """Return the findings of the scenarios in their order. Findings in shared files are reported once."""
    look_at = partial(_look_at, look)
    jobs = min(jobs, len(names))
    results = _in_processes(look_at, names, jobs) if jobs > 1 else map(look_at, names)
    return list({finding.sort_key: finding for findings in results for finding in findings}.values())


def _look_at(look: LintOptions, name: str) -> list[Finding]:
    """Return the findings of one scenario. An internal error of deepbots becomes its only finding, and the
    other scenarios are still linted."""
    try:
        return look.findings(name)
    except (DeepbotsError, OSError):
        raise
    except Exception as error:  # an internal error  # noqa: BLE001
        return [exception_finding("the compiler", SourceText(look.called(name), ""), error)]


def _in_processes(look_at: partial[list[Finding]], names: Sequence[str], jobs: int) -> list[list[Finding]]:
    """Return the findings of the scenarios from `jobs` processes; standard input is read in this one."""
    import signal
    from concurrent.futures import ProcessPoolExecutor

    files = [name for name in names if name != STDIN]
    # Ctrl-C reaches every process; only this one handles it.
    with (
        safe_path(),
        ProcessPoolExecutor(
            jobs, initializer=signal.signal, initargs=(signal.SIGINT, signal.SIG_IGN)
        ) as pool,
    ):
        size = max(1, len(files) // (4 * jobs))
        results = dict(zip(files, pool.map(partial(_recorded, look_at), files, chunksize=size), strict=True))
    if (reads := READS.get()) is not None:
        for _, stamps in results.values():
            reads |= stamps
    return [results[name][0] if name in results else look_at(name) for name in names]


def _recorded(look_at: Callable[[str], list[Finding]], name: str) -> tuple[list[Finding], Stamps]:
    """Return the findings of a scenario, and the files that were read for them."""
    with recorded_reads() as reads:
        return look_at(name), reads


# Formats


def report(
    findings: Sequence[Finding], format: Format, names: Sequence[str], failing: Sequence[Severity]
) -> str:
    """Return the text for standard output; `names` are the names of the scenarios in findings."""
    match format:
        case Format.github:
            return github(findings)
        case Format.sarif:
            return sarif(findings, _page)
        case Format.junit:
            return junit(findings, names, failing)
        case Format.json:
            return render(findings, "json")
        case Format.full | Format.concise:
            form: Literal["full", "concise"] = "full" if format is Format.full else "concise"
            return escape_log_commands(
                render(findings, form, terminal.uses_color(sys.stdout), terminal.width())
            )


def _page(code: str) -> tuple[str, str]:
    from deepbots_cli.lint.pages import pages_of

    pages = pages_of(code)
    return "\n\n".join(page.text() for page in pages), "\n\n".join(page.markdown() for page in pages)


def command_fmt(
    paths: Annotated[
        list[Path] | None,
        typer.Argument(metavar="FILE", help="Scenario files, or folders of them; by default this folder."),
    ] = None,
    check: Annotated[
        bool, option("--check", "Write nothing, and exit with 1 if a file would change.")
    ] = False,
    diff: Annotated[bool, option("--diff", "Like --check, and show the changes.")] = False,
) -> None:
    """Format scenario files in the canonical layout."""
    rewrites = []
    refused = False
    for path in _scenario_files(paths or [Path(".")]):
        rewrite = _tidied(path)
        refused = refused or rewrite is None
        if rewrite is not None and rewrite.after != rewrite.before:
            rewrites.append(rewrite)
            if diff:
                written_files.show_difference(rewrite)
            elif not check:
                written_files.write_change(rewrite)
            terminal.note(f"{'would change' if check or diff else 'changed'} {path}")
    if refused or (rewrites and (check or diff)):
        raise typer.Exit(FAILED)


def _scenario_files(paths: Sequence[Path]) -> Iterator[Path]:
    """Yield the named files, and the scenarios in named folders that the project does not exclude."""
    for path in paths:
        if not path.exists():
            raise UsageError(f"there is no file {path}")
    project = settings() if any(path.is_dir() for path in paths) else None
    for path in paths:
        if project is not None and path.is_dir():
            yield from scenarios_in(path, project)
        else:
            yield path


def _tidied(path: Path) -> Rewrite | None:
    """Return the file in the canonical layout; None after an error message if it cannot be formatted."""
    data = _scenario_bytes(path)
    findings = Findings()
    source, readable = files.decode(data, str(path), findings)
    root = parse(source, findings) if readable else None
    if root is None or findings.errors:
        terminal.print_error(
            f"{path} is not changed because it cannot be read; see: deepbots lint {shell_word(path)}"
        )
        return None
    new_text = canonical_text(source.text)
    if new_text is None:
        terminal.print_error(f"{path} is not changed because a new layout would change its values")
        return None
    return Rewrite(path.resolve(), data, (BOM_UTF8 if data.startswith(BOM_UTF8) else b"") + new_text.encode())


def _scenario_bytes(path: Path) -> bytes:
    if not path.is_file():
        raise UsageError(
            f"{path} {'is not a regular file' if path.exists() else 'does not exist'}; name a scenario file"
        )
    return files.read(path)
