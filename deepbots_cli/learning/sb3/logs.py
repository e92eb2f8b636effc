"""The log of a training: scalars for TensorBoard and for the loggers of other packages, and the entries that
are not yet written."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from stable_baselines3.common.logger import HParam, Logger, TensorBoardOutputFormat

from deepbots_cli.compiler.inputs import RESOLVED_NAME
from deepbots_cli.learning.checkpoint_files import NumpyScalar, Pending
from deepbots_cli.learning.runs.run import Run
from deepbots_cli.learning.sb3.defaults import effective_hyperparameters
from deepbots_cli.learning.sb3.plugins import PluginLogger
from deepbots_cli.program.task import Training
from deepbots_cli.rollout.seats import own_entries, own_name

_MAX_WAIT_S = 2.0


class TrainingLog(Logger):
    """Collects scalars by name. `open` comes after a checkpoint is restored, which cuts the files."""

    def __init__(self, run: Run) -> None:
        super().__init__(str(run.tensorboard), [])
        self._run = run

    def open(self, training: Training, *, is_new: bool) -> None:
        """Open the files. The file of a new training begins with the scenario as text, and a page of
        hyperparameters."""
        _wait_for_next_second(self._run.tensorboard)
        self._tensorboard = TensorBoardOutputFormat(str(self._run.tensorboard))
        self.output_formats.append(self._tensorboard)
        self.output_formats.extend(PluginLogger(name, self._run.path) for name in self._run.record.loggers)
        if is_new:
            self._describe(training)

    def _describe(self, training: Training) -> None:
        run = self._run
        hyperparameters = effective_hyperparameters(run.program, training.total_timesteps)
        values = {
            entry.name: entry.value if isinstance(entry.value, bool | int | float | str) else str(entry.value)
            for entry in hyperparameters
        }
        values |= {
            "algorithm": training.algorithm,
            "environments": training.environments,
            "seed": run.record.seed,
        }
        # TensorBoard shows the page only if it names metrics, and takes their values from the scalars.
        metrics = {"rollout/ep_rew_mean": 0.0, "eval/mean_return": 0.0}
        if run.program.defines_success:
            metrics |= {"rollout/success_rate": 0.0, "eval/success_rate": 0.0}
        scenario = (run.path / RESOLVED_NAME).read_text(encoding="utf-8")
        content = {
            "hparams": HParam(values, metrics),
            # TensorBoard renders texts as Markdown, in which four spaces begin a block of code.
            "scenario": "".join(f"    {line}\n" for line in scenario.splitlines()),
        }
        self._tensorboard.write(content, dict.fromkeys(content, ()))

    def flush(self) -> None:
        """Flush the file of TensorBoard, whose size is part of a checkpoint."""
        self._tensorboard.writer.flush()

    def pending(self) -> Pending:
        """Return the entries that are recorded but not yet written, without pictures and the like."""
        values = {
            name: encoded(value)
            for name, value in self.name_to_value.items()
            if isinstance(value, int | float | str | np.generic)
        }
        excluded = {name: list(names) for name, names in self.name_to_excluded.items()}
        return values, dict(self.name_to_count), excluded

    def restore(self, pending: Pending) -> None:
        values, counts, excluded = pending
        if not values.keys() <= excluded.keys():
            raise ValueError("the pending scalars and those with loggers to leave out have other names")
        self.name_to_value.update({name: number_of(value) for name, value in values.items()})
        self.name_to_count.update(counts)
        self.name_to_excluded.update({name: tuple(excluded[name]) for name in values})


class AgentLog(Logger):
    """The log of one of several agents: its scalars have the name of the agent before theirs.

    Args:
        log: The log of the training.
        agent: The name of the agent.
        steps: Returns the steps of the training.
    """

    def __init__(self, log: Logger, agent: str, steps: Callable[[], int]) -> None:
        self._log = log
        self._agent = agent
        self._steps = steps
        self.dir = log.dir
        self.output_formats = []
        self.level = log.level

    @property
    def name_to_value(self) -> Any:  # type: ignore[override]  # the scalars are in the log of all agents
        return own_entries(self._log.name_to_value, self._agent)

    def record(self, key: str, value: Any, exclude: Any = None) -> None:
        self._log.record(self._name(key), value, exclude)

    def record_mean(self, key: str, value: float | None, exclude: Any = None) -> None:
        self._log.record_mean(self._name(key), value, exclude)

    def dump(self, step: int = 0) -> None:
        """Write the scalars at the present step of all agents, which a learner with more rows counts
        otherwise."""
        self._log.dump(self._steps())

    def _name(self, key: str) -> str:
        """Return the name of a scalar; the speed of a training is that of all agents."""
        return key if key.startswith("time/") else own_name(self._agent, key)


def encoded(value: Any) -> Any:
    """Return a number of numpy with its type, and without NaN, which JSON does not have."""
    if isinstance(value, np.generic):
        plain: Any = value.tolist()
        dtype: Any = str(value.dtype)
        return NumpyScalar(dtype=dtype, value=plain if math.isfinite(plain) else None)
    return None if isinstance(value, float) and not math.isfinite(value) else value


def number_of(value: Any) -> Any:
    """Return the number that `encoded` returned."""
    if value is None:
        return math.nan
    return value.number() if isinstance(value, NumpyScalar) else value


def _wait_for_next_second(folder: Path) -> None:
    """Wait until the name of a new file is the last one: TensorBoard reads the files in the order of their
    names.

    A name has the second of its file and then a count, of which 10 is before 9.
    """
    names = [path.name.split(".") for path in folder.glob("events.out.tfevents.*")]
    newest = max((int(name[3]) for name in names if len(name) > 3 and name[3].isdigit()), default=0)
    wait = newest + 1 - time.time()
    if 0 < wait <= _MAX_WAIT_S:  # a file that is farther in the future has the time of another clock
        time.sleep(wait)
