"""Checkpoints, from which a killed training continues bit for bit as if it had never been interrupted.

    checkpoints/000012288/      state.json, arrays.npz, model.zip: a checkpoint after 12 288 steps; only the
                                last one is kept
    checkpoints/replay/         the rows of a replay buffer, in segments that are written once

A checkpoint is taken between an update and the next fragment, before anything of this fragment happens. The
learner defines its own part; the running episodes are kept as starts and actions, and repeated. Random
generators are restored last. Log entries from after the checkpoint are cut off, and logged again.
`checkpoint_files` defines the valid content of the files.
"""

from __future__ import annotations

import os
import random
import shutil
import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import torch

from deepbots_cli.errors import RunError, StorageError
from deepbots_cli.files import unwritable_message
from deepbots_cli.learning.callbacks import TrainingCallback
from deepbots_cli.learning.checkpoint_files import (
    Array,
    Arrays,
    ArraySpec,
    CheckpointState,
    check_actions,
    check_torch_generator,
    damage_explained,
    flush_to_disk,
    latest_checkpoint,
    read_arrays,
    read_state,
    write_arrays,
)
from deepbots_cli.learning.learner import Learner
from deepbots_cli.learning.runs.run import Run
from deepbots_cli.learning.sb3.defaults import longest_episode
from deepbots_cli.rollout.collector import ShardState
from deepbots_cli.runtime.batch import EpisodeHistory
from deepbots_cli.runtime.streams import derive_seed

if TYPE_CHECKING:
    from deepbots_cli.learning.sb3.logs import TrainingLog

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
        self.stages: list[int] = []
        """The stage of each world, which the training keeps up to date."""
        self.inexact: list[str] = []
        self._last = -1
        self._previous = 0
        self._due = 0.0
        self._folder = latest_checkpoint(run)
        with damage_explained(run, self._folder):
            self.state = None if self._folder is None else read_state(self._folder, model)
        if self.state is not None:
            self.stages = list(self.state.stages)
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
        """Keep the model at equal distances of steps, `--keep-checkpoints` models in all."""
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
            stages=self.stages,
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
                self._restore(self.state, read_arrays(self._folder / "arrays.npz", self._specs(self.state)))
            self._last = self._previous = self._learner.steps
            self._due = time.monotonic() + INTERVAL_S
        for follow in self.on_restored:
            follow()

    def _specs(self, state: CheckpointState) -> dict[str, ArraySpec]:
        """Return the specifications of the arrays of the checkpoint, derived from the arrays of a training
        that has just begun."""
        worlds = len(self._collector.state().episodes)
        if len(state.starts) != worlds:
            raise ValueError(f"{len(state.starts)} worlds after {state.steps} steps")
        specs = {
            name: ArraySpec.like(array)
            for name, array in self._arrays().items()
            if not name.startswith("actions/")
        }
        shape = np.shape(self._collector.action_space.sample())
        rows = self._collector.rows // worlds
        team = (rows, *shape) if rows > 1 else shape
        specs |= {
            f"actions/{index}": ArraySpec(np.dtype(float), team, longest_episode(self.run.program))
            for index in range(worlds)
        }
        if state.steps and self._learner.setup.training.staleness:
            weights = self._learner.actor().parameters()
            specs |= {
                f"stale/{name}": ArraySpec.like(array)
                for name, array in weights.items()
                if isinstance(array, np.ndarray)
            }
        return (
            specs
            | self._learner.specs(state)
            # Seed and offset of torch's generator for CUDA, 8 bytes each.
            | {"cuda": ArraySpec(np.dtype(np.uint8), (16,), is_optional=True)}
        )

    def _restore(self, state: CheckpointState, arrays: Arrays) -> None:
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
        for episode in episodes:
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
