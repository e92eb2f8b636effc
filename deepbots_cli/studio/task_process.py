"""The process of a task: it runs one command, and writes output and exit code into the folder of the task."""

from __future__ import annotations

import os
import sys
from pathlib import Path

from deepbots_cli.cli import main as deepbots
from deepbots_cli.learning.runs.directories import run_lock, write_text
from deepbots_cli.studio.tasks import EXIT_NAME, LOG_NAME, TASK_NAME, TaskRecord


def run_task(folder: Path) -> int:
    """Run the command of a folder. Returns its exit code."""
    record = TaskRecord.model_validate_json((folder / TASK_NAME).read_bytes())
    with run_lock(folder):
        log = os.open(folder / LOG_NAME, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o600)
        os.dup2(log, 1)
        os.dup2(log, 2)
        started = record.model_copy(update={"pid": os.getpid()})
        write_text(folder / TASK_NAME, started.model_dump_json(indent=2))
        code = 1
        try:
            code = _run(record)
        finally:
            sys.stdout.flush()
            sys.stderr.flush()
            (folder / EXIT_NAME).write_text(str(code), encoding="ascii")
    return code


def _run(record: TaskRecord) -> int:
    sys.argv = ["deepbots", *record.words]  # which a run records as its command
    try:
        return deepbots()
    except SystemExit as error:
        return error.code if isinstance(error.code, int) else int(error.code is not None)


if __name__ == "__main__":
    sys.exit(run_task(Path(sys.argv[1])))
