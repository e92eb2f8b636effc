"""Checkpoints, from which a killed training continues bit for bit as if it had never been interrupted.

    checkpoints/000012288/      state.json, arrays.npz, model.zip: a checkpoint after 12 288 steps; only the
                                last one is kept
    checkpoints/replay/         the rows of a replay buffer, in segments that are written once

A checkpoint is taken between an update and the next fragment, before anything of this fragment happens. The
learner defines its own part; the running episodes are kept as starts and actions, and repeated. Random
generators are restored last. Log entries from after the checkpoint are cut off, and logged again.

A run may come from someone else, and libraries do not check the state that they are given. Therefore every
number has bounds here, and an array must have the dtype and the shape of the one that it replaces. Nothing is
unpickled.
"""

from __future__ import annotations

import os
import random
import shutil
import struct
import time
import zipfile
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, Self, TypeVar

import numpy as np
import numpy.typing as npt
import torch
from pydantic import BaseModel, Field, NonNegativeInt, model_validator

from deepbots_cli.compiler.inputs import RESOLVED_NAME
from deepbots_cli.errors import DeepbotsError, RunError, StorageError
from deepbots_cli.files import unwritable_message
from deepbots_cli.learning.callbacks import MAX_CHECK_INTERVAL, CallbackState, TrainingCallback
from deepbots_cli.learning.runs.curriculum import CurriculumState
from deepbots_cli.learning.runs.directories import read_json
from deepbots_cli.learning.runs.episodes import StatisticsState
from deepbots_cli.learning.runs.run import MAX_STATE_BYTES, Run, opened_archive
from deepbots_cli.learning.sb3.defaults import longest_episode
from deepbots_cli.rollout.collector import ShardState
from deepbots_cli.runtime.batch import EpisodeHistory
from deepbots_cli.runtime.streams import derive_seed
from deepbots_cli.words import shell_word

if TYPE_CHECKING:
    from deepbots_cli.learning.learner import Learner
    from deepbots_cli.learning.sb3.logs import TrainingLog

Array = npt.NDArray[Any]
Arrays = Mapping[str, Array]

# The state

_MAX_WORLDS = 1_024
_WORDS = 624
"""Numbers of 32 bits in the state of a Mersenne Twister, the generator of Python, of numpy's functions and of
torch."""

Text = Annotated[str, Field(max_length=2_000)]
Count = Annotated[int, Field(ge=0, lt=2**62)]
Bit = Annotated[int, Field(ge=0, le=1)]
Word = Annotated[int, Field(ge=0, lt=2**32)]
LongWord = Annotated[int, Field(ge=0, lt=2**128)]  # for PCG64, whose state and increment have 128 bits each
WordIndex = Annotated[int, Field(ge=0, le=_WORDS)]


class CheckpointPart(BaseModel, strict=True, extra="forbid", allow_inf_nan=False):
    """Base of the models of a checkpoint."""


class NumpyScalar(CheckpointPart):
    """A number with its type in numpy, because the mean of float32 differs from that of float64. None stands
    for NaN, which JSON does not have."""

    dtype: Literal[
        "bool",
        "int8",
        "int16",
        "int32",
        "int64",
        "uint8",
        "uint16",
        "uint32",
        "uint64",
        "float16",
        "float32",
        "float64",
    ]
    value: bool | int | float | None

    @model_validator(mode="after")
    def _has_its_type(self) -> Self:
        try:
            self.number()
        except (OverflowError, TypeError) as error:
            raise ValueError(str(error)) from error
        return self

    def number(self) -> Any:
        return np.array(self.value, dtype=self.dtype)[()]


Number = int | float | NumpyScalar
Pending = tuple[dict[Text, bool | Number | str | None], dict[Text, Count], dict[Text, list[Text]]]
"""The entries of the log that are recorded but not yet written: their values, their counts, and the outputs
that leave them out."""


class _GeneratorWords(CheckpointPart):
    state: LongWord
    inc: LongWord


class GeneratorState(CheckpointPart):
    """The state of a generator PCG64 of numpy, in the words of numpy."""

    bit_generator: Literal["PCG64"]
    state: _GeneratorWords
    has_uint32: Bit
    uinteger: Word


class StreamsState(CheckpointPart):
    """The random generators of a world (`Supervisor.random_state`), and of each copy of a robot in it."""

    root: Annotated[int, Field(ge=0, lt=2**64)]
    generators: Annotated[dict[Text, GeneratorState], Field(max_length=10_000)]
    agents: Annotated[list[StreamsState], Field(max_length=_MAX_WORLDS)] | None = None


class CheckpointState(CheckpointPart):
    """The part of a checkpoint that is JSON."""

    digest: Text
    """The digest of the scenario."""
    arithmetic: dict[Text, Text]
    statistics: StatisticsState
    curriculum: CurriculumState
    callback: CallbackState
    stages: Annotated[list[NonNegativeInt], Field(max_length=_MAX_WORLDS)]
    """The stage of the curriculum that each world is in."""
    starts: Annotated[
        list[Annotated[int, Field(ge=0, lt=2**64)] | GeneratorState | StreamsState],
        Field(max_length=_MAX_WORLDS),
    ]
    """The start of each world's running episode: its seed, or the states of its random generators."""
    observed: Text
    """The fingerprint of the last observations."""
    pending: Pending
    # Python's generator has 624 words, and behind them the index of the next one.
    python: tuple[
        Literal[3], Annotated[list[Word], Field(min_length=_WORDS + 1, max_length=_WORDS + 1)], float | None
    ]
    numpy: tuple[WordIndex, Bit, float]
    logs: dict[Text, Count]
    """Bytes of each log."""
    inexact: Annotated[list[Text], Field(max_length=1_000)]

    @property
    def steps(self) -> int:
        return self.statistics.steps

    @model_validator(mode="after")
    def _agrees_with_itself(self) -> Self:
        steps, statistics = self.steps, self.statistics
        step_counts = [
            self.callback.evaluated_at,
            self.callback.improved_at,
            self.callback.next_beat - MAX_CHECK_INTERVAL,
            self.curriculum.first_step,
        ]
        step_counts += [
            statistics.episodes,
            *(stage.steps for stage in self.curriculum.ends),
            *([statistics.solved_at.steps] if statistics.solved_at else []),
        ]
        if max(step_counts) > steps:
            raise ValueError("its counts of steps contradict each other")
        if len(self.stages) != len(self.starts):
            raise ValueError("its counts of worlds contradict each other")
        return self


S = TypeVar("S", bound=CheckpointState)


def latest_checkpoint(run: Run) -> Path | None:
    """Return the last checkpoint of a run, if there is one."""
    # isdecimal alone also accepts the digits of other scripts.
    folders = run.checkpoints.iterdir() if run.checkpoints.is_dir() else ()
    return max(
        (path for path in folders if len(path.name) == 12 and path.name.isdecimal() and path.name.isascii()),
        default=None,
    )


def read_state(folder: Path, model: type[S]) -> S:
    """Read the state of a checkpoint.

    Raises:
        RunError: The checkpoint is damaged.
    """
    state = read_json(folder / "state.json", model, MAX_STATE_BYTES)
    if state.steps != int(folder.name):
        raise RunError(
            f"{folder} is damaged: its state was saved after {state.steps:,} steps, which its name"
            " contradicts"
        )
    return state


@contextmanager
def damage_explained(run: Run, folder: Path | None) -> Iterator[None]:
    """Context in which any error of a damaged checkpoint becomes one sentence, with what to do instead."""
    try:
        yield
    except (
        ArithmeticError,
        AttributeError,
        DeepbotsError,
        LookupError,
        MemoryError,
        RuntimeError,
        TypeError,
        ValueError,
    ) as error:
        explained = error
        if not isinstance(error, RunError):
            reason = " ".join(str(error).split())[:200]
            explained = RunError(
                f"{folder} is damaged, or belongs to another training ({type(error).__name__}: {reason})"
            )
        path = shell_word(run.path)
        explained.add_note(
            "the run has no earlier checkpoint; its policies can still be evaluated: deepbots eval " + path
        )
        scenario = shell_word(run.path / RESOLVED_NAME)
        explained.add_note(
            f"to start a new run with the weights of the best policy: deepbots train {scenario}"
            f" --initialize-from {path}"
        )
        raise explained from error


# The arrays


def write_arrays(path: Path, arrays: Arrays, data: str = "") -> None:
    """Write an uncompressed `.npz`, with a member `data` if there is such a text."""
    with zipfile.ZipFile(path, "w", zipfile.ZIP_STORED) as archive:
        if data:
            archive.writestr("data", data)
        for name, array in arrays.items():
            # zipfile does not know the size beforehand, and a replay buffer may exceed 2 GiB.
            with archive.open(f"{name}.npy", "w", force_zip64=True) as member:
                # write_array keeps Fortran order, which `_read_array` refuses.
                np.lib.format.write_array(
                    member, np.asarray(array, order="C"), version=(1, 0), allow_pickle=False
                )


def read_arrays(path: Path) -> dict[str, Array]:
    """Read the arrays of an uncompressed `.npz`. All are numbers, and finite.

    Raises:
        RunError: The file is missing, damaged, or has other content.
    """
    if not path.is_file():
        raise RunError(f"{path} is missing")
    try:
        opened_archive(path, path.stat().st_size).close()
        with np.load(path, allow_pickle=False) as file:
            arrays = {name: array for name, array in file.items() if isinstance(array, np.ndarray)}
        for name, array in arrays.items():
            if array.dtype.kind not in "biuf" or not np.isfinite(array).all():
                raise ValueError(f"'{name[:80]}' contains other values than finite numbers")
    except Exception as error:  # numpy parses headers as Python, and raises a dozen kinds of exceptions
        reason = str(error).splitlines()[0][:120] if str(error) else "cut short"
        raise RunError(f"{path} is damaged ({reason})") from error
    return arrays


def check_alike(arrays: Arrays, present: Arrays) -> None:
    """Refuse arrays of other shapes and types than the present ones of the same names.

    Raises:
        ValueError: One does not fit, or is missing.
    """
    for name, array in present.items():
        other = arrays.get(name)
        if other is None or (other.shape, other.dtype) != (array.shape, array.dtype):
            description = "missing" if other is None else f"{other.dtype.str[:20]} of shape {other.shape}"
            raise ValueError(f"'{name}' is {description}")


def check_torch_generator(state: Array) -> None:
    """Refuse a state that leads torch's generator beyond its own numbers.

    torch itself compares `left`, the count of unused numbers, and `following`, the index of the next one,
    with 624 each.
    """
    # Behind the initial seed (8 bytes): the fields `left`, `seeded` (skipped) and `next`.
    left, following = struct.unpack_from("<i4xQ", state.tobytes(), 8)
    if left + following not in (1, _WORDS + 1):  # 1 after a seed
        raise ValueError("the state of the generator of torch is impossible")


def flush_to_disk(path: Path) -> None:
    """Have the system write a file or folder to the disk, for a power cut."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def check_actions(actions: Array, space: Any) -> None:
    """Refuse a choice that the agent does not have, on which an update would fail."""
    if hasattr(space, "n") and not ((actions >= space.start) & (actions < space.start + space.n)).all():
        raise ValueError("it contains actions that the scenario does not have")


INTERVAL_S = 10.0
"""The time between checkpoints in s, and so the longest time that a killed training loses, unless a large
replay buffer makes checkpoints rare."""
MIN_INTERVAL_PER_COST = 40
"""The factor between the time of a checkpoint and the time until the next one, so that at most 2.5 % of the
time is spent on checkpoints."""


class Checkpoints:
    """Takes the checkpoints of a run, and restores the last one. Reading it changes nothing in the run.

    Args:
        run: The run.
        model: The model of the JSON part of a checkpoint (`Learner.State`).

    Raises:
        RunError: The last checkpoint is damaged.
    """

    def __init__(self, run: Run, model: type[CheckpointState]) -> None:
        self.run = run
        self.on_restored: list[Callable[[], None]] = [self._cut_logs]
        """Called once the state of the last checkpoint is restored. Until then, no file of the run changes.
        """
        self.inexact: list[str] = []
        self._last = -1
        self._previous = 0
        self._due = 0.0
        self._folder = latest_checkpoint(run)
        with damage_explained(run, self._folder):
            self.state = None if self._folder is None else read_state(self._folder, model)
        if self.state is not None:
            self.inexact = list(self.state.inexact)

    def _cut_logs(self) -> None:
        """Cut off the entries that were logged after the checkpoint, before the logs are opened."""
        sizes = self.state.logs if self.state else {}
        # The resumed training repeats the steps after the checkpoint, and logs them again.
        for path in self._logs():
            size = sizes.get(path.relative_to(self.run.path).as_posix(), 0)
            if not size:
                path.unlink()
            elif size < path.stat().st_size:
                os.truncate(path, size)

    def attach(self, callback: TrainingCallback, learner: Learner, log: TrainingLog) -> None:
        """Set the parts of the training whose state the checkpoints keep."""
        if learner.setup.collector is None:
            raise RuntimeError("a learner without worlds has no checkpoints")
        self.callback = callback
        self._learner = learner
        self._collector = learner.setup.collector
        self._log = log
        learner.attach(self.run.checkpoints)

    def _logs(self) -> list[Path]:
        logs = [
            self.run.monitor,
            self.run.evaluations / "training.jsonl",
            *self.run.tensorboard.glob("events.out.tfevents.*"),
        ]
        logs += (self.run.path / "logs").glob("*")
        return [path for path in logs if path.is_file()]

    # Taking one

    def before_rollout(self) -> bool:
        """Take a checkpoint if it is due, and return whether the training continues."""
        stop = self.callback.active.interruption.requested
        self._save_numbered()
        if stop or self._last < 0 or time.monotonic() >= self._due:
            self.save()
        return not stop

    def finish(self) -> None:
        """Take the last checkpoint of a training that ended between two rollouts."""
        self._save_numbered()
        self.save()

    @property
    def description(self) -> str:
        """The last checkpoint in words; empty before there is one."""
        return f"the last checkpoint, after {self._last:,} steps, is kept" if self._last >= 0 else ""

    @property
    def has_learned(self) -> bool:
        """Whether the last checkpoint was taken after the first step."""
        return self._last > 0

    def _save_numbered(self) -> None:
        """Keep the model at equal distances of steps: `--keep-checkpoints` models in all, beside those of a
        shorter training that was resumed."""
        steps = self._learner.steps
        count = self.run.record.keep_checkpoints
        total = self.callback.active.total
        if count and steps * count // total > self._previous * count // total:
            self._learner.save(self.run.model(f"step-{steps:09d}"))
        self._previous = steps

    def save(self) -> None:
        """Write the present models and a checkpoint. Until there are enough episodes for an evaluation, the
        last model is also the best.

        Raises:
            RunError: The model is not finite, or nothing can be written; the last checkpoint stays.
        """
        steps = self._learner.steps
        if steps == self._last:
            return
        self.callback.active.check_finite()
        began = time.monotonic()
        folder = self.run.checkpoints / "new"
        copy = self.run.checkpoints / "model.zip"
        try:
            shutil.rmtree(folder, ignore_errors=True)
            folder.mkdir(parents=True)
            self._learner.save(folder / "model.zip")
            state = self._state()
            write_arrays(folder / "arrays.npz", self._arrays())
            (folder / "state.json").write_text(state.model_dump_json())
            # Content first and the name last: after a power cut, a folder with a number is complete.
            for path in [*folder.iterdir(), folder]:
                flush_to_disk(path)
            # A copy and a rename, so that nobody who reads the model meanwhile gets half a file.
            for name in ("last", "best") if self.callback.best is None else ("last",):
                shutil.copyfile(folder / "model.zip", copy)
                flush_to_disk(copy)
                os.replace(copy, self.run.model(name))
            checkpoint = self.run.checkpoints / f"{steps:012d}"
            shutil.rmtree(checkpoint, ignore_errors=True)
            folder.rename(checkpoint)  # from here on, this is the last checkpoint
            flush_to_disk(self.run.checkpoints)
        except (OSError, RunError) as error:
            shutil.rmtree(folder, ignore_errors=True)
            if copy.is_file():
                copy.unlink()
            if isinstance(error, RunError):
                raise
            raise StorageError(unwritable_message(self.run.checkpoints, error)) from error
        self._remove_others({checkpoint, *self._learner.shared_files()})
        self._last = steps
        now = time.monotonic()
        self._due = now + max(INTERVAL_S, MIN_INTERVAL_PER_COST * (now - began))

    def _remove_others(self, remaining: set[Path]) -> None:
        """Remove everything but files and folders in the folder of the checkpoints, and the folders that they
        are in."""
        root = self.run.checkpoints
        above = {parent for path in remaining for parent in path.parents if parent.is_relative_to(root)}
        for folder in above:
            if folder.is_dir():
                for path in folder.iterdir():
                    if path not in remaining and path not in above:
                        shutil.rmtree(path) if path.is_dir() else path.unlink()

    def _arrays(self) -> dict[str, Array]:
        arrays = self._learner.arrays()
        arrays |= {
            f"actions/{index}": np.array(episode.actions)
            for index, episode in enumerate(self._collector.state().episodes)
        }
        arrays |= {f"stale/{name}": array for name, array in self._collector.stale.items()}
        arrays |= {
            "torch": torch.get_rng_state().numpy(),
            "numpy": np.random.get_state(legacy=False)["state"]["key"],
        }
        if self._learner.device == "cuda":
            arrays["cuda"] = torch.cuda.get_rng_state().numpy()
        return arrays

    def _state(self) -> CheckpointState:
        shard = self._collector.state()
        python_state = random.getstate()
        numpy_state = np.random.get_state(legacy=False)
        # Entries in a buffer are missing in the size of their file, to which a resumed training cuts it.
        self._log.flush()
        return self._learner.State(
            digest=self.run.digest,
            arithmetic=self._arithmetic(),
            statistics=self.callback.active.statistics.state(),
            curriculum=self.callback.active.curriculum.state(),
            callback=self.callback.state(),
            stages=self.callback.active.curriculum.world_stages,
            # The dictionaries become models.
            starts=[episode.start for episode in shard.episodes],  # type: ignore[misc]
            observed=shard.observed,
            pending=self._log.pending(),
            # 3 is the version of this state in all Pythons that deepbots supports.
            python=(3, list(python_state[1]), python_state[2]),
            numpy=(numpy_state["state"]["pos"], numpy_state["has_gauss"], numpy_state["gauss"]),
            logs={path.relative_to(self.run.path).as_posix(): path.stat().st_size for path in self._logs()},
            inexact=self.inexact,
            **self._learner.state(),
        )

    def _arithmetic(self) -> dict[str, str]:
        """Return the settings that affect the last bits of a training."""
        return {
            "torch": torch.__version__,
            "numpy": np.__version__,
            "threads of torch": str(torch.get_num_threads()),
            "CPU capability": torch.backends.cpu.get_cpu_capability(),
            "device": self._learner.device,
        }

    # Going back to one

    def restore(self) -> None:
        """Restore the state of the checkpoint. Without a checkpoint, the training begins.

        Raises:
            RunError: The checkpoint is damaged, or of another network.
        """
        if self.state is not None and self._folder is not None:
            with damage_explained(self.run, self._folder):
                self._learner.load(self._folder / "model.zip")
                self._restore(self.state, read_arrays(self._folder / "arrays.npz"))
            self._last = self._previous = self._learner.steps
            self._due = time.monotonic() + INTERVAL_S
        for follow in self.on_restored:
            follow()

    def _restore(self, state: CheckpointState, arrays: Arrays) -> None:
        worlds = len(self._collector.state().episodes)
        if len(state.starts) != worlds:
            raise ValueError(f"{len(state.starts)} worlds after {state.steps} steps")
        present = self._arrays()
        check_alike(
            arrays,
            {
                name: array
                for name, array in present.items()
                if not name.startswith("actions/") and (name != "cuda" or name in arrays)
            },
        )
        arithmetic = self._arithmetic()
        for name, value in state.arithmetic.items():
            if arithmetic.get(name) != value:
                self.note(f"{name} changed at {state.steps:,} steps from {value} to {arithmetic.get(name)}")
        if state.digest != self.run.digest:
            self.note(f"the scenario now compiles to a different program than at {state.steps:,} steps")
        self._learner.restore(state, arrays, same=self._repeat_episodes(state, arrays))
        self._collector.stale = {
            name.removeprefix("stale/"): array for name, array in arrays.items() if name.startswith("stale/")
        }
        self._log.restore(state.pending)
        version, words, gauss = state.python
        random.setstate((version, tuple(words), gauss))
        check_torch_generator(arrays["torch"])
        np.random.set_state(("MT19937", arrays["numpy"], *state.numpy))
        torch.set_rng_state(torch.from_numpy(arrays["torch"]))
        if self._learner.device == "cuda" and "cuda" in arrays:
            torch.cuda.set_rng_state(torch.from_numpy(arrays["cuda"]))

    def note(self, reason: str) -> None:
        """Note a reason why this training differs from one that was never interrupted."""
        if reason not in self.inexact:
            self.inexact.append(reason)

    def _repeat_episodes(self, state: CheckpointState, arrays: Arrays) -> bool:
        """Repeat the running episodes of the worlds, and return whether the observations are the same. If
        not, new episodes begin."""
        episodes = [
            EpisodeHistory(
                start if isinstance(start, int) else start.model_dump(exclude_none=True),
                list(arrays[f"actions/{index}"]),
            )
            for index, start in enumerate(state.starts)
        ]
        longest = longest_episode(self.run.program)
        for episode in episodes:
            if len(episode.actions) > longest:
                raise ValueError(
                    f"an episode of {len(episode.actions)} actions; the longest one has {longest}"
                )
            check_actions(np.array(episode.actions), self._collector.action_space)
        # Seeds of their own, because the model has been trained on the first episodes.
        seeds = [
            derive_seed(self.run.record.seed, "environment", i, "resumed", state.steps)
            for i in range(len(episodes))
        ]
        # No engine has an exact snapshot, so an episode comes back by its start and its actions.
        if self._collector.restore(ShardState(episodes, state.observed), seeds):
            return True
        self.note(
            f"the episodes at {state.steps:,} steps could not be repeated exactly, so new episodes began"
        )
        return False
