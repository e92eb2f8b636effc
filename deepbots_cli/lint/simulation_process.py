"""The entry point of the process that simulates a scenario for `lint --deep` and `lint --exploits`.

    echo '{"folder": ..., "allow_code": false, "search": false}' | python -m
    deepbots_cli.lint.simulation_process CPU STEP MEMORY WALL

It writes lines to stdout: `~17` before step 17, and the entries of a `report.SimulationReport`.
It limits itself before it imports a simulator or reads the scenario. On Windows, which has no such limits,
the clock of the parent remains.
"""

from __future__ import annotations

import json
import os
import re
import signal
import sys
import traceback
from io import FileIO
from pathlib import Path
from typing import Any

from deepbots_cli.document import Permissions
from deepbots_cli.lint.simulation import OUT_OF_MEMORY, Done, Fault, Limits, encode

_MIB = 2**20


def main(limits: Limits) -> None:
    # Without a buffer, each line reaches the parent even if a limit kills this process after it.
    out = FileIO(os.dup(sys.stdout.fileno()), "wb")
    nowhere = os.open(os.devnull, os.O_WRONLY)
    # Engines print from C, past `sys.stdout`.
    for fd in (1, 2):  # whatever engines and scenarios print
        os.dup2(nowhere, fd)
    _limit(limits)
    request = json.loads(sys.stdin.buffer.read())
    try:
        _simulate(request, out, limits.step_seconds)
    except (MemoryError, SystemError):  # the latter when a library in C is imported without enough memory
        os._exit(OUT_OF_MEMORY)
    except Exception as error:  # noqa: BLE001  # a fault of deepbots, which the parent reports
        from deepbots_cli.diagnostics.findings import describe_exception

        # Messages of glibc and Linux where the address space is too small for a shared library.
        if isinstance(error, ImportError | OSError) and re.search(
            "failed to map segment|allocate memory", str(error)
        ):
            os._exit(OUT_OF_MEMORY)  # no memory for a library
        out.write(encode(Fault(describe_exception(error), traceback.format_exc())) + b"\n")


def _simulate(request: dict[str, Any], out: FileIO, seconds: float) -> None:
    """Simulate, where each line grants further `seconds` of CPU time; after these SIGPROF ends the
    process."""

    def write(line: bytes) -> None:
        if sys.platform != "win32":
            signal.setitimer(signal.ITIMER_PROF, seconds)
        out.write(line)

    write(b"")  # the imports below have a limit, too
    from deepbots_cli.lint.rollouts import Simulator, compiled
    from deepbots_cli.lint.search import ExploitSearch

    permissions = Permissions(code=request["allow_code"])
    simulator = (ExploitSearch if request["search"] else Simulator)(
        compiled(Path(request["folder"])),
        write=lambda entry: write(encode(entry) + b"\n"),
        begin_step=lambda number: write(b"~%d\n" % number),
        permissions=permissions,
    )
    simulator.run()
    write(encode(Done()) + b"\n")


def _limit(limits: Limits) -> None:
    """Limit this process and all that it starts."""
    if sys.platform == "win32":
        return
    import resource

    for kind, limit in (
        (resource.RLIMIT_CPU, limits.cpu),
        (resource.RLIMIT_AS, limits.memory * _MIB),
        (resource.RLIMIT_CORE, 0),  # an engine that crashes leaves no file of its memory
    ):
        hard = resource.getrlimit(kind)[1]
        resource.setrlimit(kind, (limit if hard == resource.RLIM_INFINITY else min(limit, hard), hard))


if __name__ == "__main__":
    cpu, step, memory, wall = sys.argv[1:]
    main(Limits(int(cpu), float(step), int(memory), float(wall)))
