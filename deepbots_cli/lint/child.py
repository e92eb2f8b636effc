"""The process in which a scenario is simulated: compiles it from a folder of copies, writes what it measures to stdout.

It limits itself before it reads anything, so that a scenario that would hang, fill the memory or crash the engine takes
down this process and no other. Where the system knows no such limits (Windows) the parent's clock is left.
"""

from __future__ import annotations

import json
import os
import signal
import sys
import traceback
from io import FileIO
from pathlib import Path
from typing import Any

from deepbots_cli.lint.limits import OUT_OF_MEMORY, Limits

_MIB = 2**20


def main(limits: Limits) -> None:
    """Told by lines: `~17` before step 17, and JSON objects."""
    out = FileIO(os.dup(sys.stdout.fileno()), "wb")
    _hush()
    _keep(limits)
    request = json.loads(sys.stdin.buffer.read())
    try:
        _measure(request, out, limits.step)
    except MemoryError:
        os._exit(OUT_OF_MEMORY)
    except Exception as error:  # noqa: BLE001  # a fault of ours, which the parent tells
        from deepbots_cli.diagnostics.findings import described

        if isinstance(error, ImportError) and "failed to map segment" in str(error):  # a library for which there is no memory
            os._exit(OUT_OF_MEMORY)
        out.write(json.dumps({"fault": described(error), "traceback": traceback.format_exc()}).encode() + b"\n")


def _measure(request: dict[str, Any], out: FileIO, most: float) -> None:
    """Every line gives another `most` seconds of CPU time."""
    from deepbots_cli import api
    from deepbots_cli.compiler.inputs import RESOLVED
    from deepbots_cli.lint.rolls import Rolls

    def say(told: dict[str, Any]) -> None:
        _in_time(most)
        out.write(json.dumps(told).encode() + b"\n")

    def step(number: int) -> None:
        _in_time(most)
        out.write(b"~%d\n" % number)

    _in_time(most)
    folder = Path(request["folder"])
    compiled = api.compile(api.load(folder / RESOLVED, allow_code=request["allow_code"], project=folder))
    Rolls(compiled.ir, say, step, allow_code=request["allow_code"]).run()
    say({"done": True})


def _hush() -> None:
    """What engines print goes nowhere."""
    nowhere = os.open(os.devnull, os.O_WRONLY)
    for fd in (1, 2):
        os.dup2(nowhere, fd)


def _keep(limits: Limits) -> None:
    """From here on, and in whatever this process starts."""
    try:
        import resource
    except ImportError:
        return
    for what, most in ((resource.RLIMIT_CPU, limits.cpu), (resource.RLIMIT_AS, limits.memory * _MIB), (resource.RLIMIT_CORE, 0)):
        hard = resource.getrlimit(what)[1]
        resource.setrlimit(what, (most if hard == resource.RLIM_INFINITY else min(most, hard), hard))


def _in_time(most: float) -> None:
    """What comes next has so much CPU time; then SIGPROF ends the process, and nothing of it need answer."""
    if hasattr(signal, "setitimer"):
        signal.setitimer(signal.ITIMER_PROF, most)


if __name__ == "__main__":
    main(Limits.read(sys.argv[1:]))
