"""The digests of what `lint` says of some cases, one a line; run in a process of its own, with another hash
seed."""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

from tests.fuzz.workbench import Workbench, digest


def main() -> None:
    with tempfile.TemporaryDirectory() as folder, Workbench(Path(folder)) as bench:
        for number in sys.argv[1:]:
            try:
                print(digest(bench.examine(int(number))))
            except Exception as error:  # noqa: BLE001  # the other process tells of it in full
                print(type(error).__name__)


if __name__ == "__main__":
    main()
