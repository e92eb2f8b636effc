"""The entry point of the process that marks one step of one hand-in.

    echo '{"lesson": ..., "folder": ..., "work": ..., "step": "mend", "seed": 0, "train": false}' |
    python -m deepbots_cli.course.marking_process CPU MEMORY FILE

It limits its CPU time, memory, and the size of each file before it reads anything of the student. It answers
with lines of JSON: the seconds of CPU time that it has used, each second; the checks so far, after each; and
the marks.
"""

from __future__ import annotations

import json
import os
import shutil
import sys
import threading
import time
from dataclasses import asdict
from pathlib import Path
from typing import Any

from deepbots_cli.processes import limit, line_of, message_streams


def main(cpu_s: int, memory_mib: int, file_mib: int) -> None:
    source, out = message_streams()
    limit(cpu_s, memory_mib, file_mib)
    request = json.loads(line_of(source))
    work = Path(request["work"])
    os.chdir(work)
    from deepbots_cli.course.lessons import read_lesson
    from deepbots_cli.course.marking import Marker
    from deepbots_cli.errors import StorageError

    is_done = threading.Event()

    def tell(message: dict[str, Any]) -> None:
        out.write(json.dumps(message).encode() + b"\n")
        out.flush()

    def beat() -> None:
        while not is_done.wait(1.0):
            try:
                tell({"cpu": time.process_time()})
            except OSError:  # the grader has ended
                os._exit(1)

    threading.Thread(target=beat, daemon=True).start()
    marker = Marker(
        read_lesson(Path(request["lesson"])),
        Path(request["folder"]),
        work,
        seed=request["seed"],
        train=request["train"],
        on_check=lambda checks: tell({"checks": [vars(check) for check in checks]}),
    )
    try:
        answer = asdict(marker.mark(request["step"]))
    except (OSError, StorageError) as error:  # the disk of the grader is full
        first = error.args[0][0][-1] if isinstance(error, shutil.Error) else error
        answer = {"failed": str(first)}
    is_done.set()
    tell({**answer, "cpu": time.process_time()})


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
