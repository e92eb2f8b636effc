"""Starts the process that simulates, and reads what it told, however it ended."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import tempfile
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import deepbots_cli
from deepbots_cli.compiler.inputs import Inputs
from deepbots_cli.errors import MissingExtraError
from deepbots_cli.lint.limits import OUT_OF_MEMORY, Limits
from deepbots_cli.lint.report import Halt, Report

_NEEDED = ("gymnasium", "msgspec", "numpy", "pybullet")
_FAULTS = {"SIGSEGV", "SIGBUS", "SIGFPE", "SIGILL", "SIGABRT"}


def require_simulator() -> None:
    """Without importing it.

    Raises:
        MissingExtraError: A package that simulating needs is not installed.
    """
    if any(find_spec(name) is None for name in _NEEDED):
        raise MissingExtraError("sim", "lint --deep")


def measured(inputs: Inputs, limits: Limits, *, allow_code: bool = False) -> Report:
    """Simulate a scenario in a process of its own, which compiles it from copies; whatever becomes of that, there is a report.

    Raises:
        UsageError: The copies cannot be written.
        RuntimeError: The process failed by a fault of deepbots itself, and DEEPBOTS_DEBUG is 1; holds its traceback.
    """
    with tempfile.TemporaryDirectory(prefix="deepbots-") as folder:
        inputs.write(Path(folder))
        return _told_by_child({"folder": folder, "allow_code": allow_code}, limits)


def _told_by_child(request: dict[str, Any], limits: Limits) -> Report:
    # -P, since modules in the working directory may be anyone's
    command = [sys.executable, "-P", "-m", "deepbots_cli.lint.child", *limits.told()]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, env=_environment()) as process:
        try:
            out, _ = process.communicate(json.dumps(request).encode(), limits.wall)
            late = False
        except subprocess.TimeoutExpired:
            process.kill()
            out, _ = process.communicate()
            late = True
        except BaseException:
            process.kill()
            raise
    report = _read(out)
    if not report.done and report.halt is None:
        report.halt = Halt("slow", f"{limits.wall:g} s") if late else _halt(process.returncode, limits)
    return report


def _environment() -> dict[str, str]:
    """One thread for the numbers, and this very deepbots."""
    ours = str(Path(deepbots_cli.__file__).parents[1])
    path = os.pathsep.join([ours, *filter(None, [os.environ.get("PYTHONPATH")])])
    return {**os.environ, "PYTHONPATH": path, "OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1", "MKL_NUM_THREADS": "1"}


def _read(out: bytes) -> Report:
    """A last line that was cut off by the end of the process counts for nothing."""
    report = Report()
    for line in out.split(b"\n"):
        if line.startswith(b"~"):
            report.step = int(line[1:]) if line[1:].isdigit() else report.step
            continue
        try:
            told: Any = json.loads(line) if line else None
        except ValueError:
            continue
        if isinstance(told, dict):
            if "fault" in told and os.environ.get("DEEPBOTS_DEBUG") == "1":
                raise RuntimeError(f"the simulation failed by a fault of deepbots\n{told.get('traceback')}")
            report.take(told)
    return report


def _halt(code: int, limits: Limits) -> Halt:
    """Why the process ended before it was done."""
    name = signal.Signals(-code).name if -code in signal.valid_signals() else ""
    if name == "SIGPROF":
        return Halt("hang", f"{limits.step:g} s of CPU time")
    if name == "SIGXCPU":
        return Halt("slow", f"{limits.cpu} s of CPU time")
    if code == OUT_OF_MEMORY:
        return Halt("memory", f"{limits.memory} MiB")
    return Halt("crash" if name in _FAULTS else "killed", name or f"exit code {code}")
