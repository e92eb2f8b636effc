"""Lints hostile files, each in a folder and a forked process of its own, and says what came of it: the watch
over opened files cannot be taken off again.

The forks are those of a process with one thread: a fork of pytest's workers, which have several, may wait for
a lock of another thread for ever.
"""

from __future__ import annotations

import io
import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path

from deepbots_cli.cli import main as command_line
from tests.fuzz.harness import OUTSIDE, allow, in_fork, rise_of_memory, watch
from tests.hostile.cases import Hostile, cases


@dataclass(frozen=True)
class Outcome:
    """What became of a hostile file: the codes found at error level, CPU seconds, the exit code, what was
    opened that is none of its business.

    `memory` is what the process took at most, in bytes.
    """

    codes: list[str]
    seconds: float
    exit_code: int
    outside: list[str]
    memory: int


def outcomes(*, slow: bool = True) -> Iterator[tuple[Hostile, Outcome]]:
    """The cases, also those that are `slow`, and the outcome of each; fewer than all if lint took its process
    down."""
    command = [sys.executable, "-m", "tests.hostile.trial", *(["slow"] if slow else [])]
    ran = subprocess.run(command, stdout=subprocess.PIPE, check=True, cwd=Path(__file__).parents[2])
    for case, line in zip(_chosen(slow=slow), ran.stdout.splitlines(), strict=False):
        yield case, Outcome(**json.loads(line))


def _chosen(*, slow: bool) -> list[Hostile]:
    """Return all cases, or every second one that is not `slow`."""
    return [*cases()] if slow else [case for case in cases() if not case.slow][1::2]


def main(*, slow: bool) -> None:
    """Print the outcome of each case as a line."""
    with tempfile.TemporaryDirectory() as name:
        lint(Hostile("empty", (), b"").write(Path(name)))  # everything is imported
        for number, case in enumerate(_chosen(slow=slow)):
            folder = Path(name).resolve() / str(number) / "project"
            folder.mkdir(parents=True)
            fork = in_fork(partial(examine, case.write(folder)))
            shutil.rmtree(folder.parent, ignore_errors=True)
            if fork.result is None:
                return
            print(json.dumps(asdict(fork.result)), flush=True)


def examine(main: Path) -> Outcome:
    """Lint a scenario by the command line."""
    os.chdir(main.parent)
    allow(main.parent)
    watch()
    ran: list[tuple[int, str]] = []
    start = time.process_time()
    memory = rise_of_memory(lambda: ran.append(lint(main)))
    seconds = time.process_time() - start
    ((exit_code, output),) = ran
    findings = json.loads(output)["findings"]
    errors = sorted({finding["code"] for finding in findings if finding["severity"] == "error"})
    outside = [path for path in OUTSIDE if not path.endswith("/clear_refs")]
    return Outcome(errors, seconds, exit_code, outside, memory)


def lint(main: Path) -> tuple[int, str]:
    """The exit code and the output of the command."""
    with redirect_stdout(io.StringIO()) as output, redirect_stderr(io.StringIO()):
        return command_line(["lint", str(main), "--format", "json"]), output.getvalue()


if __name__ == "__main__":
    main(slow="slow" in sys.argv[1:])
