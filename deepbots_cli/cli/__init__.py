"""The command `deepbots`.

verbs/         one module per verb, imported when that verb is asked for
group.py       the verbs as one command           options.py     arguments that several verbs share
exits.py       exceptions to exit codes           terminal.py    output, colour, progress
tables.py      tables as text                     sources.py     scenarios, runs and robots as arguments
rewriting.py   files that commands write          starters/      what `new` writes
linting.py     what `lint` looks at               reports.py     its formats
comparison.py  what `diff` shows                  inspection.py  what `inspect` shows
timing.py      when actions act, how old observations are
glossary.py    what `explain` says of words       project/       templates of `eject`
"""

from __future__ import annotations

import gc
from collections.abc import Sequence

__all__ = ["main"]

_COLLECT_EVERY = 50_000
"""New objects between two garbage collections; at Python's 700 the imports alone take 5 % longer."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command line, by default that of the process, and return its exit code.

    0 done; 1 findings, or a demanded result not met; 2 wrong usage, a missing file, not a run, a missing extra;
    3 a fault of deepbots; 130 interrupted.
    """
    gc.set_threshold(_COLLECT_EVERY)
    from deepbots_cli.cli.exits import guarded

    def run() -> None:
        from deepbots_cli.cli import group

        group.run(arguments)

    return guarded(run)
