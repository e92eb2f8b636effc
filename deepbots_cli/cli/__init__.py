"""The command `deepbots`.

verbs/       one thin module per verb, imported when that verb is asked for
group.py     how the verbs hang together
options.py   arguments that several verbs share
terminal.py  what goes to stdout and stderr, and when in colour
outlets.py   stdout and stderr whose reader may be gone
tables.py    aligned columns
words.py     keys and functions, as `explain` tells of them
linting.py   what `lint` looks at          reports.py   its formats
exits.py     from exceptions to exit codes
anatomy.py   what `inspect` shows, robot_file.py of a robot file
measure.py   what `bench` times
ageing.py    when actions act, how old observations are
picture.py   a picture as PNG              replay.py   episodes of a policy without a network
progress.py  how many of them are done
rewriting.py  files of the user written anew
copying.py   what `copy` writes            project.py  what `eject` writes
upgrading.py steps from one version of the language to the next
comparison/  what `diff` shows              starters/   what `new` writes, editing.py with a schema beside it
health.py    what `doctor` looks at
"""

from __future__ import annotations

import gc
from collections.abc import Sequence

__all__ = ["main"]

_COLLECT_EVERY = 50_000
"""New objects between two looks for garbage; at Python's 700 the imports alone take 5 % longer, and leave none."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command line, by default the process's own, and return its exit code.

    0 done; 1 findings, or a demanded result not met; 2 wrong usage, a missing file, not a run, a missing extra;
    3 a fault of deepbots; 130 interrupted.
    """
    gc.set_threshold(_COLLECT_EVERY)
    from deepbots_cli.cli.exits import guarded

    def run() -> None:
        from deepbots_cli.cli import group

        group.run(arguments)

    return guarded(run)
