"""Lints hostile files, each in a folder of its own, and says what came of it.

The linting is done by a process of its own, since the watch over opened files cannot be taken off again, and
since the peak of memory is that of a process, which shall not hold what the files were made from.
"""

from __future__ import annotations

import io
import json
import os
import shutil
import tempfile
import time
from collections.abc import Iterator
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import dataclass
from pathlib import Path

from deepbots_cli import api
from deepbots_cli.cli import main as command_line
from tests.fuzz.harness import OUTSIDE, allow, answers, peak_memory, serve, watch
from tests.hostile.cases import Hostile, cases

ROOT = Path(__file__).parents[2]


@dataclass(frozen=True)
class Outcome:
    """What became of a hostile file: the codes found at error level, CPU seconds, the exit code, what was
    opened that is none of its business.

    `memory` is the peak of the process so far, in bytes.
    """

    codes: list[str]
    seconds: float
    exit_code: int
    outside: list[str]
    memory: int


def outcomes(*, slow: bool = True) -> Iterator[tuple[Hostile, Outcome]]:
    """The cases, also those that are `slow`, and the outcome of each; fewer than all if lint took its process
    down."""
    tried = [case for case in cases() if slow or not case.slow]
    with tempfile.TemporaryDirectory() as name:
        folders = [Path(name).resolve() / str(number) / "project" for number in range(len(tried))]

        def written() -> Iterator[str]:
            for case, folder in zip(tried, folders, strict=True):
                folder.mkdir(parents=True)
                yield str(case.write(folder))

        for case, folder, (_, answer) in zip(tried, folders, answers(__name__, written()), strict=True):
            shutil.rmtree(folder.parent, ignore_errors=True)
            if answer is None:
                return
            yield case, Outcome(**answer)


def examine(main: Path) -> Outcome:
    """Lint a scenario by the command line."""
    os.chdir(main.parent)
    allow(main.parent)
    OUTSIDE.clear()
    start = time.process_time()
    with redirect_stdout(io.StringIO()) as output, redirect_stderr(io.StringIO()):
        exit_code = command_line(["lint", str(main), "--format", "json"])
    seconds = time.process_time() - start
    os.chdir(main.parents[2])
    findings = json.loads(output.getvalue())["findings"]
    codes = sorted({finding["code"] for finding in findings if finding["severity"] == "error"})
    return Outcome(codes, seconds, exit_code, list(OUTSIDE), peak_memory())


def main() -> None:
    api.lint("cartpole")  # everything is imported
    watch()
    serve(lambda path: vars(examine(Path(path))))


if __name__ == "__main__":
    main()
