"""The entry point of the process that marks one step of one hand-in.

    echo '{"lesson": ..., "folder": ..., "work": ..., "step": "mend", "seed": 0, "train": false}' |
    python -m deepbots_cli.course.marking_process CPU MEMORY FILE

It limits its CPU time, memory, and the size of each file before it reads anything of the student, and answers
with one line: the marks as JSON.
"""

from __future__ import annotations

import json
import os
import sys
from pathlib import Path

from deepbots_cli.processes import limit, line_of, message_streams


def main(cpu_s: int, memory_mib: int, file_mib: int) -> None:
    source, out = message_streams()
    limit(cpu_s, memory_mib, file_mib)
    request = json.loads(line_of(source))
    work = Path(request["work"])
    os.chdir(work)
    from deepbots_cli.course.lessons import read_lesson
    from deepbots_cli.course.marking import Marker, as_data

    marker = Marker(
        read_lesson(Path(request["lesson"])),
        Path(request["folder"]),
        work,
        seed=request["seed"],
        train=request["train"],
    )
    out.write(json.dumps(as_data(marker.mark(request["step"]))).encode() + b"\n")
    out.flush()


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
