"""Callbacks and loggers of other packages, which a training takes by name, and the logger `csv`.

A callback that fails ends the training with one sentence that names it; so does a logger. Both are made anew
when a training is resumed, and files in `logs/` of the run are cut back to the checkpoint (`checkpoints.py`),
so that what they append there is written once.
"""

from __future__ import annotations

import csv
import traceback
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.logger import KVWriter

from deepbots_cli.diagnostics.nearest import did_you_mean
from deepbots_cli.errors import PluginError, UsageError
from deepbots_cli.plugins import PluginTable

T = TypeVar("T")
R = TypeVar("R")


class CsvLogger(KVWriter):
    """Appends every scalar as a line `steps,name,value` to `logs/scalars.csv` of the run."""

    def __init__(self, run: Path) -> None:
        path = run / "logs" / "scalars.csv"
        path.parent.mkdir(exist_ok=True)
        self._file = path.open("a", newline="", encoding="utf-8")
        self._rows = csv.writer(self._file, lineterminator="\n")
        # A resumed training appends to the file, which has its header already.
        if not path.stat().st_size:
            self._rows.writerow(("steps", "name", "value"))

    def write(
        self, key_values: dict[str, Any], key_excluded: dict[str, tuple[str, ...]], step: int = 0
    ) -> None:
        scalars = (
            pair for pair in sorted(key_values.items()) if isinstance(pair[1], int | float | np.number)
        )
        self._rows.writerows(
            (step, name, value) for name, value in scalars if "csv" not in key_excluded[name]
        )
        # A checkpoint notes the size of the file, to which a resumed training cuts it.
        self._file.flush()

    def close(self) -> None:
        self._file.close()


def _read(name: str, plugin: Any) -> Iterator[tuple[str, Any]]:
    """Check that an entry point names something that can be called.

    Raises:
        TypeError: The entry point names nothing that can be called.
    """
    if not callable(plugin):
        raise TypeError(f"{plugin!r} is neither a class nor a function")
    yield name, plugin


CALLBACKS: PluginTable[Callable[[], BaseCallback]] = PluginTable("deepbots.callbacks", {}, _read)
"""The callbacks by name. A callback is created without arguments."""
LOGGERS: PluginTable[Callable[[Path], KVWriter]] = PluginTable("deepbots.loggers", {"csv": CsvLogger}, _read)
"""The loggers by name. A logger is created with the folder of the run."""


def check(callbacks: Sequence[str], loggers: Sequence[str]) -> None:
    """Check the names of callbacks or loggers.

    Raises:
        UsageError: No package registers a name, or a name is given twice.
    """
    for noun, names, table in (("callback", callbacks, CALLBACKS), ("logger", loggers, LOGGERS)):
        for name in names:
            if name not in table:
                registered = (
                    f"the known ones are {', '.join(table)}"
                    if table
                    else f"no installed package registers one under '{table.group}'"
                )
                raise UsageError(f"there is no {noun} '{name}'; {registered}{did_you_mean(name, table)}")
            if names.count(name) > 1:
                raise UsageError(f"the {noun} '{name}' is given twice")


class PluginCallback(BaseCallback):
    """A callback of a plug-in. A resumed training makes the same calls as a training without interruption."""

    def __init__(self, name: str) -> None:
        super().__init__()
        self.name = name
        self.stopped = False
        """Whether the callback has ended the training."""
        self._callback = _made("callback", name, CALLBACKS[name], BaseCallback)

    def _call(self, function: Callable[..., R], *arguments: Any) -> R:
        with _failure_explained(
            f"the callback '{self.name}' failed after {self.model.num_timesteps:,} steps"
        ):
            return function(*arguments)

    def _init_callback(self) -> None:
        self._call(self._callback.init_callback, self.model)

    def _on_training_start(self) -> None:
        # Callbacks such as `CheckpointCallback` act on every n-th call. A resumed training counts on.
        self._callback.n_calls = self.model.num_timesteps // self.training_env.num_envs
        self._call(self._callback.on_training_start, self.locals, self.globals)

    def _on_rollout_start(self) -> None:
        self._call(self._callback.on_rollout_start)

    def _on_step(self) -> bool:
        self.stopped = not self._call(self._callback.on_step)
        return not self.stopped

    def _on_rollout_end(self) -> None:
        self._call(self._callback.on_rollout_end)

    def _on_training_end(self) -> None:
        self._call(self._callback.on_training_end)

    def update_child_locals(self, locals_: dict[str, Any]) -> None:
        self._call(self._callback.update_locals, locals_)


class PluginLogger(KVWriter):
    """A logger of a plug-in."""

    def __init__(self, name: str, run: Path) -> None:
        self._name = name
        self._writer = _made("logger", name, partial(LOGGERS[name], run), KVWriter)

    def write(
        self, key_values: dict[str, Any], key_excluded: dict[str, tuple[str, ...]], step: int = 0
    ) -> None:
        with _failure_explained(f"the logger '{self._name}' failed after {step:,} steps"):
            # Copies, because the library passes the same dictionaries to the next logger.
            self._writer.write(dict(key_values), dict(key_excluded), step)

    def close(self) -> None:
        with _failure_explained(f"the logger '{self._name}' failed when it was closed"):
            self._writer.close()


def _made(noun: str, name: str, make: Callable[[], T], kind: type) -> T:
    with _failure_explained(f"the {noun} '{name}' cannot be made"):
        instance = make()
    if not isinstance(instance, kind):
        raise PluginError(
            f"the {noun} '{name}' is a {type(instance).__name__}, and not a {kind.__name__} of"
            " Stable-Baselines3"
        )
    return instance


@contextmanager
def _failure_explained(sentence: str) -> Iterator[None]:
    """Context in which an error of a plug-in becomes a sentence, with the line that raised it."""
    try:
        yield
    except Exception as error:
        frame = traceback.extract_tb(error.__traceback__)[-1]
        reason = " ".join(str(error).split())[:200]
        text = (
            f"{sentence}: {type(error).__name__}{f': {reason}' if reason else ''}"
            f" ({frame.filename}:{frame.lineno})"
        )
        raise PluginError(text) from error
