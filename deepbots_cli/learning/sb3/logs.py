"""The log of a training: scalars for TensorBoard and for the loggers of other packages, and the entries that
are not yet written; and the callbacks and loggers of other packages, which a training takes by name.

A callback that fails ends the training with one sentence that names it; so does a logger. Both are made anew
when a training is resumed, and files in `logs/` of the run are cut back to the checkpoint (`checkpoints.py`),
so that what they append there is written once.
"""

from __future__ import annotations

import csv
import math
import time
import traceback
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.logger import HParam, KVWriter, Logger, TensorBoardOutputFormat

from deepbots_cli.compiler.inputs import RESOLVED_NAME
from deepbots_cli.diagnostics.nearest import did_you_mean
from deepbots_cli.errors import PluginError, UsageError
from deepbots_cli.learning.callbacks import ActiveTraining
from deepbots_cli.learning.checkpoints import NumpyScalar, Pending
from deepbots_cli.learning.runs.episodes import Summary, agent_returns
from deepbots_cli.learning.runs.run import Run
from deepbots_cli.learning.sb3.defaults import effective_hyperparameters
from deepbots_cli.learning.teaching import Plan, Teaching
from deepbots_cli.plugins import PluginTable
from deepbots_cli.program.task import Training
from deepbots_cli.rollout.collector import own_entries, own_name

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


def check_plugins(callbacks: Sequence[str], loggers: Sequence[str]) -> None:
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
        run.joinpath("logs").mkdir(exist_ok=True)
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

    def scalars(self, active: ActiveTraining) -> Scalars:
        """Return what records the scalars of a training in this log."""
        return Scalars(active)

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


class Scalars:
    """Records scalars of the episodes, the policy, the evaluations and the teacher of a training."""

    def __init__(self, active: ActiveTraining) -> None:
        self._active = active
        agent = active.run.program.agent
        newest = zip(agent.numbers, agent.newest, strict=True)
        self._seen = {
            number.full_name: index for number, index in newest if number.clip and not number.is_truth
        }
        """The place of the newest value of each clipped number in an observation. Truth values are left out,
        because they are always at an end of their range."""
        self._began = time.monotonic(), active.statistics.steps

    def record_episodes(self) -> None:
        """Record scalars beside those of the learner, which writes them with its own."""
        log = self._active.log
        statistics = self._active.statistics
        curriculum = self._active.curriculum
        log.record("rollout/episodes", statistics.episodes)
        log.record("rollout/simulated_hours", statistics.simulated_hours)
        began, steps = self._began
        simulated = (statistics.steps - steps) * statistics.period
        log.record("time/real_time_factor", simulated / max(1e-9, time.monotonic() - began))
        value = curriculum.value(statistics.steps)
        if curriculum.stages:
            log.record("curriculum/stage", curriculum.index + 1)
        if (levels := curriculum.levels) is not None:
            log.record("curriculum/mean_level", levels.mean)
            log.record("curriculum/lowest_level", levels.lowest)
            log.record("curriculum/highest_level", levels.highest)
            for with_value, mean_level in levels.by_value.items():
                log.record(f"curriculum/mean_level/{with_value}", mean_level)
        if curriculum.criterion is not None and value is not None:
            log.record(f"curriculum/{curriculum.criterion.metric}", value)
            log.record("curriculum/threshold", curriculum.criterion.threshold)
        for name, mean in statistics.term_means().items():
            log.record(f"reward/{name}", mean)
        shares = statistics.ended_by()
        # A share that is 0 now may wait in the log with its last value.
        program = self._active.run.program
        ends = (*(ending.name for ending in program.endings), *program.truncation.limits) if shares else ()
        for name in dict.fromkeys((*ends, *shares)):
            log.record(f"ended_by/{name}", shares.get(name, 0.0))

    def record_policy(self) -> None:
        """Record scalars about the policy in the last rollout, or in the last steps of the replay buffer.

        `saturation/NAME` is the share of observations at the ends of their range, `action/OPTION` is the
        share of steps in which an option was chosen, and `action/probability` the mean probability of the
        chosen actions.
        """
        log, learner = self._active.log, self._active.learner
        choices = self._active.run.program.agent.choices
        observations, actions, log_probs = learner.recent()
        if log_probs is not None and choices:
            log.record("action/probability", float(np.exp(log_probs).mean()))
        if isinstance(observations, dict):
            observations = observations.get("observation")
        # A world of the caller may have other observations.
        if observations is not None and observations.shape[-1] > max(self._seen.values(), default=0):
            shares = (np.abs(observations) >= 1.0).mean(axis=(0, 1))
            for name, number_index in self._seen.items():
                log.record(f"saturation/{name}", float(shares[number_index]))
        for part, column in zip(
            choices, np.asarray(actions).reshape(-1, max(1, len(choices))).T, strict=False
        ):
            for index, option in enumerate(part.options):
                name = f"{part.name}/{option.name}" if len(choices) > 1 else option.name
                log.record(f"action/{name}", float((column == index).mean()))

    def record_evaluation(self, summary: Summary) -> None:
        log = self._active.log
        members = self._active.run.program.members
        for name, mean in agent_returns(members, summary.term_means).items():
            log.record(f"{name}/eval/mean_return", mean)
        log.record("eval/mean_return", summary.mean_return)
        log.record("eval/mean_length", summary.mean_length)
        if self._active.defines_success:
            log.record("eval/success_rate", summary.success_rate)

    def record_teacher(self, teaching: Teaching, plan: Plan) -> None:
        log = self._active.log
        log.record("teacher/weight", plan.weight)
        if teaching.demonstrations is None and teaching.policy is None:
            driven = 0 if plan.lesson is None else plan.lesson.worlds
            log.record("teacher/driven_worlds", driven / self._active.learner.setup.training.environments)
        if teaching.score is not None:  # each stage of a curriculum has its own score
            log.record("teacher/mean_return", teaching.score.mean_return)
            if self._active.defines_success:
                log.record("teacher/success_rate", teaching.score.success_rate)


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
