"""What `lint` looks at, and how: files, folders and standard input, one after the other or in several processes."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from deepbots_cli import api
from deepbots_cli.cli import terminal
from deepbots_cli.compiler import Checked
from deepbots_cli.diagnostics import Finding, Source
from deepbots_cli.diagnostics.findings import failure
from deepbots_cli.errors import DeepbotsError
from deepbots_cli.lint import review
from deepbots_cli.lint.settings import Settings, scenarios_in

STDIN = "-"
_NAMELESS = "<stdin>"


@dataclass(frozen=True)
class Look:
    """How each scenario is read, and whether it is simulated (`deep`); `stdin_name` is the file that standard input would be."""

    sets: tuple[str, ...] = ()
    allow_paths: tuple[Path, ...] = ()
    allow_code: bool = False
    preview: bool = False
    deep: bool = False
    stdin_name: str | None = None

    def findings(self, name: str) -> list[Finding]:
        """What is wrong with one scenario."""
        if name == STDIN:
            return self._of_stdin()
        checked = api.load(name, sets=self.sets, allow_paths=self.allow_paths, allow_code=self.allow_code)
        return self._reviewed(checked, self.called(name))

    def _of_stdin(self) -> list[Finding]:
        """Paths in the text start from the folder of the file that it would be, and its root is that of its project."""
        from dataclasses import replace

        from deepbots_cli.compiler import check
        from deepbots_cli.document import files, load

        path = Path(self.stdin_name or _NAMELESS).resolve()
        data = sys.stdin.buffer.read(files.MAX_BYTES + 1) if sys.stdin else b""
        display = self.stdin_name or _NAMELESS
        document = load(path, self.sets, display=display, allow_paths=self.allow_paths, drafts={path: data})
        return self._reviewed(check(replace(document, allow_code=self.allow_code)), display)

    def _reviewed(self, checked: Checked, called: str) -> list[Finding]:
        try:
            return self._found(checked, called)
        finally:
            checked.release()

    def _found(self, checked: Checked, called: str) -> list[Finding]:
        """What the text tells, and then what a simulation does; a scenario with errors cannot be simulated."""
        found = review(checked, preview=self.preview)
        if not self.deep:
            return found
        if any(finding.severity == "error" and not finding.is_fault for finding in found):
            terminal.note(f"{called}: not simulated, since it has errors")
            return found
        from deepbots_cli.lint import simulate

        with terminal.passing(f"{called}: simulating"):
            simulated = simulate(checked, preview=self.preview)
        if simulated.left:
            terminal.note(f"{called}: the simulation was left {simulated.left}; what it would have found is not told")
        return review(checked, preview=self.preview, measured=simulated.findings)

    def called(self, name: str) -> str:
        """How findings call the scenario `name`."""
        return (self.stdin_name or _NAMELESS) if name == STDIN else api.locate(name)[1]


def named(given: Iterable[str], project: Settings) -> list[str]:
    """The scenarios meant by the arguments, each once; what the project excludes is left out of folders.

    Raises:
        UsageError: One of them is nowhere, or a folder holds none.
    """
    names = list(dict.fromkeys(name for argument in given for name in _expanded(argument, project)))
    for name in names:
        if name != STDIN:
            api.locate(name)
    return names


def _expanded(given: str, project: Settings) -> Iterator[str]:
    folder = Path(given)
    if given == STDIN or not folder.is_dir():
        yield given
        return
    yield from map(str, scenarios_in(folder, project))


def findings_of(names: Sequence[str], look: Look, jobs: int = 1) -> list[Finding]:
    """Everything that is wrong with the scenarios, in their order; what several of them share is told once."""
    look_at = partial(_look_at, look)
    jobs = min(jobs, len(names))
    each = _in_processes(look_at, names, jobs) if jobs > 1 else map(look_at, names)
    return list({finding.sort_key: finding for findings in each for finding in findings}.values())


def _look_at(look: Look, name: str) -> list[Finding]:
    """The findings of one scenario. An exception that is a fault of deepbots becomes the only one, so that the others are linted."""
    try:
        return look.findings(name)
    except (DeepbotsError, OSError):
        raise
    except Exception as error:  # a fault of ours  # noqa: BLE001
        return [failure("the compiler", Source(look.called(name), ""), error)]


def _in_processes(look_at: partial[list[Finding]], names: Sequence[str], jobs: int) -> list[list[Finding]]:
    """The same in `jobs` processes; standard input stays with this one."""
    import signal
    from concurrent.futures import ProcessPoolExecutor

    others = [name for name in names if name != STDIN]
    # Ctrl-C reaches every process; this one answers it.
    with ProcessPoolExecutor(jobs, initializer=signal.signal, initargs=(signal.SIGINT, signal.SIG_IGN)) as pool:
        found = dict(zip(others, pool.map(look_at, others, chunksize=max(1, len(others) // (4 * jobs))), strict=True))
    return [found[name] if name in found else look_at(name) for name in names]
