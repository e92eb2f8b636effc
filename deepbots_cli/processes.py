"""Further processes of Python, which import nothing from the working directory: its modules may be anyone's.

`python -m` and `python -c` put the working directory first on the path of imports, so a `typer.py` there
would run. deepbots starts every process with the arguments that this module returns.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

# Processes inherit the variable; the option -P would have to be in each command line.
_SAFE_PATH = "PYTHONSAFEPATH"


def python_command(module: str, *arguments: str) -> list[str]:
    """Return the command line that runs `module` of deepbots in a process of its own, together with
    `python_environment`."""
    return [sys.executable, "-m", module, *arguments]


def python_script(text: str) -> list[str]:
    """Return the command line that runs a script of the standard library alone: without packages, the
    environment and the working directory."""
    return [sys.executable, "-ISc", text]


def python_environment(changes: Mapping[str, str] | None = None) -> dict[str, str]:
    """Return the environment of such a process, in which this very deepbots is found.

    An empty entry of PYTHONPATH, which is the working directory, is left out.
    """
    path = [str(Path(__file__).parents[1]), *filter(None, os.environ.get("PYTHONPATH", "").split(os.pathsep))]
    return {**os.environ, "PYTHONPATH": os.pathsep.join(path), _SAFE_PATH: "1", **(changes or {})}


@contextmanager
def safe_path() -> Iterator[None]:
    """Keep processes that `multiprocessing` starts in the block from importing modules of the working
    directory."""
    before = os.environ.get(_SAFE_PATH)
    os.environ[_SAFE_PATH] = "1"
    try:
        yield
    finally:
        if before is None:
            del os.environ[_SAFE_PATH]
        else:
            os.environ[_SAFE_PATH] = before
