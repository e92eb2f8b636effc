"""The entry point of the process that simulates a scenario for `lint --deep` and `lint --exploits`.

    echo '{"folder": ..., "allow_code": false, "search": false}' | python -m
    deepbots_cli.lint.simulation_process CPU STEP MEMORY WALL

It writes lines to stdout: `~17` before step 17, and the entries of a `simulation.SimulationReport`.
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
from pathlib import Path
from typing import IO, Any

from deepbots_cli.document import Permissions
from deepbots_cli.lint.simulation import OUT_OF_MEMORY, Done, Fault, Limits, encode
from deepbots_cli.processes import limit, line_of, message_streams


def main(limits: Limits) -> None:
    source, out = message_streams()
    limit(limits.cpu, limits.memory)
    request = json.loads(line_of(source))
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


def _simulate(request: dict[str, Any], out: IO[bytes], seconds: float) -> None:
    """Simulate, where each line grants further `seconds` of CPU time; after these SIGPROF ends the
    process."""

    def write(line: bytes) -> None:
        if sys.platform != "win32":
            signal.setitimer(signal.ITIMER_PROF, seconds)
        out.write(line)
        out.flush()  # it reaches the parent even if a limit ends this process after it

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


if __name__ == "__main__":
    cpu, step, memory, wall = sys.argv[1:]
    main(Limits(int(cpu), float(step), int(memory), float(wall)))
