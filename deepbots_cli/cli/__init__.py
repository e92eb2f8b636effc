"""The command `deepbots`.

command.py             the commands as one program; arguments that several commands share
commands/              the commands, a module for each or for those of one topic, imported when called
arguments.py           what arguments name: scenarios, folders, runs, robots, worker processes
exits.py               exceptions to exit codes
terminal.py            output, color, progress
tables.py              tables as text
records.py             results of trainings and evaluations as text, JSON and CSV; failed episodes
written_files.py       the files that commands write: new ones, changes of the user's files, recordings of
                       exploits
explanations.py        the entries of `explain` about a word
studies.py             the display and the table of a study of `tune`
help/                  the text of `--help` of each command, without its options
starters/              the scenarios that `new` writes
glossary.yaml          the glossary, printed by `explain`, and a page of the site
project/               templates of `compile --project`
"""

from __future__ import annotations

import gc
import os
from collections.abc import Sequence

__all__ = ["main"]

_COLLECT_EVERY = (400_000, 3, 4)
"""The thresholds of the garbage collection: all objects are searched after 5 million new ones, and none while
a scenario is linted, which would take 7 % of its time."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command line, by default that of the process, and return its exit code.

    0: success. 1: findings, or a required result was not reached. 2: wrong usage, a missing file, not a run,
    a missing extra. 3: an internal error of deepbots. 130: interrupted.
    """
    gc.set_threshold(*_COLLECT_EVERY)
    # To look for plug-ins of pydantic in all installed packages takes 10 ms.
    os.environ.setdefault("PYDANTIC_DISABLE_PLUGINS", "__all__")
    from deepbots_cli.cli.exits import run_guarded

    def run() -> None:
        from deepbots_cli.cli.command import run_command

        run_command(arguments)

    return run_guarded(run)
