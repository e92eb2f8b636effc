"""Commands of deepbots in copies of a process that has imported it.

The imports of `deepbots webots` take 0.8 s of CPU.
"""

from __future__ import annotations

import gc
import io
import json
import os
import signal
import subprocess
import sys
import tempfile
from contextlib import redirect_stdout
from pathlib import Path
from typing import Any, Self

from deepbots_cli.cli import main
from deepbots_cli.webots import rendering, runner, viewer  # noqa: F401  # before the process is copied
from deepbots_cli.webots.remote import server  # noqa: F401
from tests.webots.exported_projects import HEADER

ROOT = Path(__file__).parents[2]
ENVIRONMENT = {**os.environ, "PYTHONPATH": str(ROOT)}


class CopiedProcess:
    """A process that has imported deepbots, and runs each command in a copy of itself."""

    def __enter__(self) -> Self:
        self._process = subprocess.Popen(
            [sys.executable, "-m", __name__],
            cwd=ROOT,
            env=ENVIRONMENT,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        return self

    def __exit__(self, *exception: object) -> None:
        self._process.communicate(timeout=60)

    def run(self, words: list[str], folder: Path) -> subprocess.CompletedProcess[str]:
        """Run a command in a folder; one that takes more than 120 s is ended."""
        if not hasattr(os, "fork"):  # Windows
            command = [sys.executable, "-m", "deepbots_cli", *words]
            return subprocess.run(
                command,
                cwd=folder,
                env=ENVIRONMENT,
                capture_output=True,
                encoding="utf-8",
                timeout=120,
                check=False,
            )
        outputs = [folder / "stdout.txt", folder / "stderr.txt"]
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        print(json.dumps([words, str(folder), *map(str, outputs)]), file=self._process.stdin, flush=True)
        code = int(self._process.stdout.readline())
        texts: list[Any] = [path.read_text(encoding="utf-8") for path in outputs]
        return subprocess.CompletedProcess(words, code, *texts)


def serve() -> None:
    """Run the commands of standard input one after another, and print their exit codes."""
    with tempfile.TemporaryDirectory() as folder, redirect_stdout(io.StringIO()):
        world = Path(folder, "empty.wbt")
        world.write_text(f"{HEADER}Robot {{ }}", encoding="utf-8")
        main(["webots", str(world)])  # everything is imported
    gc.freeze()  # copies look for garbage among their own objects alone
    for line in sys.stdin:
        words, folder, *outputs = json.loads(line)
        copy = os.fork()
        if copy == 0:
            signal.alarm(120)
            os.chdir(folder)
            for descriptor, path in enumerate((os.devnull, *outputs)):
                os.dup2(os.open(path, os.O_RDWR | os.O_CREAT | os.O_TRUNC), descriptor)
            raise SystemExit(main(words))
        print(os.waitstatus_to_exitcode(os.waitpid(copy, 0)[1]), flush=True)


if __name__ == "__main__":
    serve()
