"""What must hold of every file, however damaged, and a folder to try it in.

No exception leaves `lint`, no rule fails (DB903), no file takes more than a second of CPU, and the process
never more than 300 MB. Findings lie inside of their texts, and are the same when asked for again, also under
another hash seed. The exit code is 1 if there is an error and 0 if not, in every format. What has no error
compiles to Python. Nothing outside of the project is opened.
"""

from __future__ import annotations

import contextlib
import hashlib
import io
import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from types import FrameType, TracebackType
from typing import TypeVar

from deepbots_cli import api
from deepbots_cli.cli import main as command_line
from deepbots_cli.diagnostics import Finding
from tests.fuzz.harness import OUTSIDE, peak_memory
from tests.fuzz.mutations import ROOT, Case, case

T = TypeVar("T")
MOST_SECONDS = 1.0
MOST_MEMORY = 300 * 10**6
"""Bytes that the process holds at most."""
FORMATS = ("full", "concise", "json", "github", "sarif", "junit")
COPIED = ("scenarios", "robots", "tests/fuzz/seeds", "tests/golden/lint", "tests/data/scenarios")


class FailedError(Exception):
    """Something that must hold of every file does not hold of this one."""


class _TooLong(BaseException):
    """Nothing in the package catches it."""


class Workbench:
    """A copy of everything that scenarios read, in which one file at a time is damaged, linted and put
    back."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.slowest = (0.0, -1)
        for name in COPIED:
            shutil.copytree(ROOT / name, folder / name)
        (folder / "deepbots.toml").touch()  # the root of the project
        self._before = Path.cwd()
        self._most_memory = max(
            MOST_MEMORY, peak_memory() + MOST_MEMORY // 3
        )  # tests may run in a process that held more before

    def __enter__(self) -> Workbench:
        os.chdir(self.folder)
        self._handler = signal.signal(signal.SIGVTALRM, _stop)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        signal.signal(signal.SIGVTALRM, self._handler)
        os.chdir(self._before)

    def examine(self, number: int) -> list[Finding]:
        """The findings of the case of a number."""
        return self.check(case(number))

    def check(self, damaged: Case) -> list[Finding]:
        """The findings of a case, of which everything holds that must; what costs more is looked at in every
        hundredth.

        Raises:
            FailedError: Something does not hold.
        """
        number = damaged.number
        with self.laid_out(damaged):
            findings = self._linted(damaged)
            _check_places(findings)
            check_rules([finding.headline for finding in findings if finding.is_internal_error])
            if number % 100 == 0:
                self._check_exit_code(damaged, findings, FORMATS[number // 100 % len(FORMATS)])
            if number % 100 == 1 and digest(self._linted(damaged)) != digest(findings):
                raise FailedError("the findings differ when asked for again")
            if number % 10 == 2 and not _has_error(findings):
                compile(api.compile(damaged.main).code, "generated", "exec")
        if OUTSIDE:
            opened = ", ".join(OUTSIDE)
            OUTSIDE.clear()
            raise FailedError(f"outside of the project was opened: {opened}")
        if peak_memory() > self._most_memory:
            raise FailedError(f"the process takes {peak_memory() / 1e6:.0f} MB")
        return findings

    @contextlib.contextmanager
    def laid_out(self, damaged: Case) -> Iterator[None]:
        """The damaged file is in place inside the context, and the whole one again after it."""
        whole = damaged.file.read_bytes()
        damaged.file.write_bytes(damaged.data)
        try:
            yield
        finally:
            damaged.file.write_bytes(whole)

    def _linted(self, damaged: Case) -> list[Finding]:
        for _ in range(3):  # of a busy machine some seconds are longer than others
            start = time.process_time()
            findings = limited(lambda: api.lint(damaged.main, preview=True), 5 * MOST_SECONDS)
            took = time.process_time() - start
            if took <= MOST_SECONDS:
                self.slowest = max(self.slowest, (took, damaged.number))
                return findings
        raise FailedError(f"it takes {took:.2f} s of CPU, and did so three times")

    def _check_exit_code(self, damaged: Case, findings: Sequence[Finding], format: str) -> None:
        out, err = io.StringIO(), io.StringIO()
        with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
            code = command_line(["lint", str(damaged.main), "--preview", "--format", format])
        expected = int(_has_error(findings))
        if code != expected:
            raise FailedError(
                f"the exit code with --format {format} is {code}, not {expected}: {err.getvalue()[-500:]}"
            )
        if format in ("json", "sarif"):
            json.loads(out.getvalue())


def _stop(number: int, frame: FrameType | None) -> None:
    raise _TooLong


def limited(action: Callable[[], T], seconds: float) -> T:
    """Return the result of an action.

    Raises:
        FailedError: It takes longer than so many seconds of CPU, inside of a workbench.
    """
    signal.setitimer(signal.ITIMER_VIRTUAL, seconds)
    try:
        return action()
    except _TooLong:
        raise FailedError(f"it takes longer than {seconds:g} s of CPU") from None
    finally:
        signal.setitimer(signal.ITIMER_VIRTUAL, 0)


def _has_error(findings: Sequence[Finding]) -> bool:
    return any(finding.severity == "error" for finding in findings)


def _check_places(findings: Sequence[Finding]) -> None:
    for finding in findings:
        for span in (finding.span, *(label.span for label in finding.labels)):
            if not 0 <= span.start <= span.end <= len(span.source.text):
                raise FailedError(
                    f"{finding.code} lies outside of its text: {span.start}..{span.end} of"
                    f" {len(span.source.text)}"
                )


def check_rules(faults: Sequence[str]) -> None:
    """Raises `FailedError` if there are any: the headlines of findings that report a fault of deepbots
    (DB903)."""
    if faults:
        raise FailedError(f"deepbots fails: {'; '.join(faults)}")


def digest(findings: Sequence[Finding]) -> str:
    """All that findings say, as a SHA-256 in hexadecimal."""
    rows = [
        (
            f.code,
            f.span.location,
            f.span.end,
            f.headline,
            f.help,
            f.notes,
            [(also.span.location, also.text) for also in f.labels],
        )
        for f in findings
    ]
    text = json.dumps(rows).replace(
        os.getcwd(), "<here>"
    )  # a file that is missing is told with where it was looked for
    return hashlib.sha256(text.encode("utf-8", "surrogatepass")).hexdigest()


def digests_elsewhere(numbers: Sequence[int], hash_seed: int) -> list[str]:
    """The digests that another process comes to, whose sets and dictionaries are in another order."""
    command = [sys.executable, "-m", "tests.fuzz.workbench", *map(str, numbers)]
    environment = {**os.environ, "PYTHONHASHSEED": str(hash_seed), "PYTHONPATH": str(ROOT)}
    return subprocess.run(command, env=environment, capture_output=True, text=True, check=True).stdout.split()


def main() -> None:
    """Print the digest of what `lint` says of each of some cases, in a line."""
    with tempfile.TemporaryDirectory() as folder, Workbench(Path(folder)) as bench:
        for number in sys.argv[1:]:
            try:
                print(digest(bench.examine(int(number))))
            except Exception as error:  # noqa: BLE001  # the other process tells of it in full
                print(type(error).__name__)


if __name__ == "__main__":
    main()
