"""Checkpoints, from which a training that was killed goes on to the bit as if it had never been interrupted.

    checkpoints/000012288/      state.json, arrays.npz, model.zip: a checkpoint after 12 288 steps; only the last one is kept
    checkpoints/replay/         the rows of a replay buffer, in segments that are written once

A checkpoint is taken between two roll-outs, before anything of the next one happens. There the roll-out buffer is empty, and every local
variable of Stable-Baselines3's loops has its initial value, except a count of roll-outs (`ResumableAlgorithm.dump_logs`). A resumed
training calls the same `learn`. Once that has set everything up, `_setup_learn` puts the state of the checkpoint in its place. The
running episodes are repeated (`VectorEnvironment.repeat`), and random generators are restored last. What was logged after the checkpoint
is cut off, and logged again. `checkpoint_files` says what the files may hold.
"""

from __future__ import annotations

import math
import os
import random
import shutil
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from inspect import signature
from pathlib import Path
from typing import Any, get_args

import numpy as np
import torch
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.buffers import ReplayBuffer
from stable_baselines3.common.logger import Logger, TensorBoardOutputFormat
from stable_baselines3.common.off_policy_algorithm import OffPolicyAlgorithm
from stable_baselines3.common.on_policy_algorithm import OnPolicyAlgorithm
from stable_baselines3.common.type_aliases import RolloutReturn
from stable_baselines3.her import HerReplayBuffer

from deepbots_cli.errors import RunError
from deepbots_cli.files import unwritable_message
from deepbots_cli.learning.callbacks import TrainingCallback, check_finite
from deepbots_cli.learning.checkpoint_files import (
    Array,
    Arrays,
    ArraySpec,
    CheckpointState,
    CounterName,
    EpisodeInfo,
    NumpyScalar,
    check_torch_generator,
    damage_explained,
    latest_checkpoint,
    read_arrays,
    read_state,
    write_arrays,
)
from deepbots_cli.learning.environments import VectorEnvironment, observation_digest
from deepbots_cli.learning.run import Run
from deepbots_cli.learning.sb3 import models
from deepbots_cli.learning.sb3.algorithms import DecayingNoise
from deepbots_cli.learning.sb3.defaults import longest_episode
from deepbots_cli.runtime.batch import EpisodeHistory
from deepbots_cli.runtime.streams import derive_seed

INTERVAL_S = 10.0
"""Time between checkpoints: what a killed training loses, unless a large replay buffer makes them rare."""
MIN_INTERVAL_PER_COST = 40
"""A checkpoint that takes a second is followed by 40 without one: at most 2.5 % of the time goes into checkpoints."""

_ROW_ATTRIBUTES = ("_last_obs", "_last_original_obs", "_last_episode_starts")
_BUFFER_COLUMNS = ("observations", "next_observations", "actions", "rewards", "dones", "timeouts", "ep_start")


class ResumableAlgorithm:
    """Mixed in before an algorithm of Stable-Baselines3: it goes on from a checkpoint, and takes one between roll-outs."""

    checkpoints: Checkpoints

    def _setup_learn(self, *args: Any, **kwargs: Any) -> Any:
        result = super()._setup_learn(*args, **kwargs)  # type: ignore[misc]  # of the algorithm
        self.checkpoints.restore(self)  # type: ignore[arg-type]
        return result

    def collect_rollouts(self, *args: Any, **kwargs: Any) -> Any:
        if self.checkpoints.before_rollout(self):  # type: ignore[arg-type]
            return super().collect_rollouts(*args, **kwargs)  # type: ignore[misc]
        return RolloutReturn(0, 0, continue_training=False) if isinstance(self, OffPolicyAlgorithm) else False

    def save(self, path: str | Path, *_: Any, **__: Any) -> None:
        """Write the model as a run keeps it, for a callback: Stable-Baselines3 would also pickle the worlds and the checkpoints."""
        path = Path(path)
        path.parent.mkdir(parents=True, exist_ok=True)
        models.save(path if path.suffix else path.with_suffix(".zip"), self)  # type: ignore[arg-type]  # of the algorithm

    def dump_logs(self, *args: Any) -> None:
        """Log after every roll-out, or as often as the algorithm does by default (A2C after 100).

        Stable-Baselines3 counts the roll-outs of an on-policy algorithm in a process, and would log a resumed training at other steps.
        """
        model: Any = self
        if isinstance(self, OnPolicyAlgorithm):
            count = model.num_timesteps // (model.n_steps * model.n_envs)
            if count % signature(super().learn).parameters["log_interval"].default:  # type: ignore[misc]
                return
        super().dump_logs(*args)  # type: ignore[misc]


class Checkpoints:
    """Takes the checkpoints of a run, and goes back to the last of them. Reading it changes nothing in the run.

    Raises:
        RunError: The last checkpoint is damaged.
    """

    def __init__(self, run: Run) -> None:
        self.run = run
        self.on_restored: list[Callable[[], None]] = [self._cut_logs]
        """Called once the state of the last checkpoint is in its place. Until then, no file of the run changes."""
        self.stages: list[int] = []
        """The stage that each world is in, which the training keeps up to date."""
        self.inexact: list[str] = []
        self._segments: list[tuple[int, int]] = []
        self._offset = 0
        self._last = -1
        self._previous = 0
        self._due = 0.0
        self._found = latest_checkpoint(run)
        with damage_explained(run, self._found):
            self.state = None if self._found is None else read_state(self._found)
        if self.state is not None:
            self.stages, self.inexact = list(self.state.stages), list(self.state.inexact)

    def _cut_logs(self) -> None:
        """Cut off what was logged after the checkpoint; before the logs are opened."""
        sizes = self.state.logs if self.state else {}
        for path in self._logs():
            size = sizes.get(path.relative_to(self.run.path).as_posix(), 0)
            if not size:
                path.unlink()
            elif size < path.stat().st_size:
                os.truncate(path, size)

    def attach(self, callback: TrainingCallback) -> None:
        """Whose state the checkpoints keep."""
        self.callback = callback
        if self.state is not None:
            callback.restore(self.state.callback)

    def _logs(self) -> list[Path]:
        found = [self.run.monitor, self.run.evaluations / "training.jsonl", *self.run.tensorboard.glob("events.out.tfevents.*")]
        found += (self.run.path / "logs").glob("*")
        return [path for path in found if path.is_file()]

    # Taking one

    def before_rollout(self, model: BaseAlgorithm) -> bool:
        """Take a checkpoint if it is time; whether the training goes on."""
        stop = self.callback.interruption.requested
        self._save_numbered(model)
        if stop or self._last < 0 or time.monotonic() >= self._due:
            self.save(model)
        return not stop

    def finish(self, model: BaseAlgorithm) -> None:
        """Take the last checkpoint of a training that came to its end between two roll-outs."""
        self._save_numbered(model)
        self.save(model)

    @property
    def description(self) -> str:
        """The last checkpoint in words; empty before there is one."""
        return f"the last checkpoint, after {self._last:,} steps, is kept" if self._last >= 0 else ""

    @property
    def has_learned(self) -> bool:
        """Whether the last checkpoint was taken after the first step."""
        return self._last > 0

    def _save_numbered(self, model: BaseAlgorithm) -> None:
        """Keep the model at equal distances of steps, as many as `--keep-checkpoints` asks for."""
        steps, count = model.num_timesteps, self.run.record.keep_checkpoints
        if count and steps * count // self.callback.total > self._previous * count // self.callback.total:
            models.save(self.run.model(f"step-{steps:09d}"), model)
        self._previous = steps

    def save(self, model: BaseAlgorithm) -> None:
        """Write the models of the moment and a checkpoint; until there are enough episodes to tell, the last model is the best too.

        Raises:
            RunError: The model is not finite, or nothing can be written; the last checkpoint stays.
        """
        steps = model.num_timesteps
        if steps == self._last:
            return
        check_finite(model, self.run, steps)
        began = time.monotonic()
        folder = self.run.checkpoints / "new"
        copy = self.run.checkpoints / "model.zip"
        try:
            shutil.rmtree(folder, ignore_errors=True)
            folder.mkdir(parents=True)
            models.save(folder / "model.zip", model)
            if isinstance(model, OffPolicyAlgorithm) and model.replay_buffer is not None:
                self._append(model.replay_buffer, steps // model.n_envs)
            write_arrays(folder / "arrays.npz", self._arrays(model))
            (folder / "state.json").write_text(self._state(model).model_dump_json())
            for path in [*folder.iterdir(), folder]:
                _flush(path)
            for name in ("last", "best") if self.callback.best is None else ("last",):
                shutil.copyfile(folder / "model.zip", copy)
                _flush(copy)
                os.replace(copy, self.run.model(name))
            whole = self.run.checkpoints / f"{steps:012d}"
            shutil.rmtree(whole, ignore_errors=True)
            folder.rename(whole)  # from here on it counts
            _flush(self.run.checkpoints)
        except (OSError, RunError) as error:
            shutil.rmtree(folder, ignore_errors=True)
            if copy.is_file():
                copy.unlink()
            if isinstance(error, RunError):
                raise
            raise RunError(unwritable_message(self.run.checkpoints, error)) from error
        kept = {whole, self._replay, *(self._segment(*segment) for segment in self._segments)}
        for path in [*self.run.checkpoints.iterdir(), *(self._replay.iterdir() if self._replay.is_dir() else ())]:
            if path not in kept:
                shutil.rmtree(path) if path.is_dir() else path.unlink()
        self._last = steps
        now = time.monotonic()
        self._due = now + max(INTERVAL_S, MIN_INTERVAL_PER_COST * (now - began))

    def _arrays(self, model: BaseAlgorithm) -> dict[str, Array]:
        arrays = {
            key: part
            for name in _ROW_ATTRIBUTES
            if getattr(model, name, None) is not None
            for key, part in _flat(name, getattr(model, name))
        }
        arrays |= {f"actions/{index}": np.array(history.actions) for index, history in enumerate(_environment(model).histories())}
        arrays |= {f"noise/{i}": noise.drift for i, noise in enumerate(_noises(model)) if noise.drift is not None}
        arrays |= {f"lstm/{index}": tensor.cpu().numpy() for index, tensor in enumerate(_memory(model))}
        arrays |= {"torch": torch.get_rng_state().numpy(), "numpy": np.random.get_state(legacy=False)["state"]["key"]}
        if model.device.type == "cuda":
            arrays["cuda"] = torch.cuda.get_rng_state().numpy()
        if (normalizer := model.get_vec_normalize_env()) is not None:
            statistics = normalizer.ret_rms
            arrays |= {"returns": normalizer.returns, "return_statistics": np.array([statistics.mean, statistics.var, statistics.count])}
        if isinstance(buffer := getattr(model, "replay_buffer", None), HerReplayBuffer):
            arrays["episode_starts"] = buffer._current_ep_start
        return arrays

    def _state(self, model: BaseAlgorithm) -> CheckpointState:
        env, python_state, numpy_state = _environment(model), random.getstate(), np.random.get_state(legacy=False)
        for output in model.logger.output_formats:
            if isinstance(output, TensorBoardOutputFormat):
                output.writer.flush()
        return CheckpointState(
            digest=self.run.digest,
            arithmetic=arithmetic(model),
            statistics=self.callback.statistics.state(),
            curriculum=self.callback.curriculum.state(),
            callback=self.callback.state(),
            stages=self.stages,
            starts=[history.start for history in env.histories()],  # type: ignore[misc]  # dictionaries become models
            observed=observation_digest(env.last_observations),
            counts={name: getattr(model, name) for name in get_args(CounterName) if hasattr(model, name)},
            infos=[EpisodeInfo(r=_encoded(info["r"]), l=_encoded(info["l"])) for info in model.ep_info_buffer or ()],
            successes=[bool(success) for success in model.ep_success_buffer or ()],
            pending=_pending(model.logger),
            action_space=model.action_space.np_random.bit_generator.state,  # type: ignore[arg-type]  # a dictionary of it
            python=(3, list(python_state[1]), python_state[2]),
            numpy=(numpy_state["state"]["pos"], numpy_state["has_gauss"], numpy_state["gauss"]),
            segments=self._segments,
            replay=(getattr(getattr(model, "replay_buffer", None), "buffer_size", 0), self._offset),
            logs={path.relative_to(self.run.path).as_posix(): path.stat().st_size for path in self._logs()},
            inexact=self.inexact,
        )

    @property
    def _replay(self) -> Path:
        return self.run.checkpoints / "replay"

    def _segment(self, first: int, last: int) -> Path:
        return self._replay / f"{first:012d}-{last:012d}.npz"

    def _append(self, buffer: ReplayBuffer, added: int) -> None:
        """Write the rows that are new; forget the segments of which nothing is left in the buffer."""
        first = max(self._segments[-1][1] if self._segments else 0, added - buffer.buffer_size)
        self._segments = [segment for segment in self._segments if segment[1] > added - buffer.buffer_size]
        if first == added:
            return
        rows = self._rows(buffer, first, added)
        self._segments.append((first, added))
        self._replay.mkdir(exist_ok=True)
        path = self._segment(first, added)
        write_arrays(path, {name: column[rows] for name, column in _columns(buffer).items()})
        _flush(path)

    # Going back to one

    def restore(self, model: BaseAlgorithm) -> None:
        """Put the state of the checkpoint in the place of a fresh one; without a checkpoint, the training begins.

        Raises:
            RunError: The checkpoint is damaged, or of another network.
        """
        if self.state is not None and self._found is not None:
            self._go_back(model, self._found, self.state)
        for follow in self.on_restored:
            follow()

    def _go_back(self, model: BaseAlgorithm, folder: Path, state: CheckpointState) -> None:
        with damage_explained(self.run, folder):
            models.load(folder / "model.zip", model)
            self._restore(model, state, read_arrays(folder / "arrays.npz", self._specs(model, state)))
        self._last = self._previous = model.num_timesteps
        self._due = time.monotonic() + INTERVAL_S

    def _specs(self, model: BaseAlgorithm, state: CheckpointState) -> dict[str, ArraySpec]:
        """What the arrays of the checkpoint must be, after those of a model that has just begun."""
        env = _environment(model)
        if len(state.starts) != len(env.worlds) or state.steps % model.n_envs:
            raise ValueError(f"{len(state.starts)} worlds after {state.steps} steps")
        fresh = self._arrays(model)
        specs = {
            name.replace("_last_obs", "_last_original_obs"): replace(ArraySpec.like(array), is_optional=True)  # set by the first step
            for name, array in fresh.items()
            if name.startswith("_last_obs")
        }
        specs |= {name: ArraySpec.like(array) for name, array in fresh.items() if not name.startswith("actions/")}
        shape = np.shape(env.action_space.sample())
        rows = model.n_envs // len(env.worlds)
        longest = longest_episode(self.run.program)
        team = (rows, *shape) if rows > 1 else shape
        specs |= {f"actions/{index}": ArraySpec(np.dtype(float), team, longest) for index in range(len(env.worlds))}
        drift = np.dtype(float), shape
        specs |= {f"noise/{index}": ArraySpec(*drift, is_optional=True) for index in range(len(_noises(model)))}
        return specs | {"cuda": ArraySpec(np.dtype(np.uint8), (16,), is_optional=True)}

    def _restore(self, model: BaseAlgorithm, state: CheckpointState, arrays: Arrays) -> None:
        for counter, value in state.counts.items():
            setattr(model, counter, type(getattr(model, counter))(value))
        model._num_timesteps_at_start = model.num_timesteps
        model.ep_info_buffer.extend({"r": _number(info.r), "l": _number(info.l)} for info in state.infos)  # type: ignore[union-attr]
        model.ep_success_buffer.extend(state.successes)  # type: ignore[union-attr]
        self._compare(model, state)
        same = self._repeat_episodes(model, state, arrays)
        if same:
            for name in _ROW_ATTRIBUTES:
                if hasattr(model, name) and (value := _unflat(name, arrays)) is not None:
                    setattr(model, name, value)
        for index, tensor in enumerate(_memory(model)):
            tensor.copy_(torch.from_numpy(arrays[f"lstm/{index}"]))
        for index, noise in enumerate(_noises(model)):
            noise.drift = arrays.get(f"noise/{index}")
        if (normalizer := model.get_vec_normalize_env()) is not None:
            mean, var, count = arrays["return_statistics"]
            if var < 0 or count <= 0:
                raise ValueError("the statistics of the returns are impossible")
            normalizer.ret_rms.mean, normalizer.ret_rms.var, normalizer.ret_rms.count = mean, var, float(count)
            normalizer.returns = arrays["returns"]
        if isinstance(model, OffPolicyAlgorithm) and model.replay_buffer is not None:
            self._refill(model.replay_buffer, state, model.num_timesteps // model.n_envs, arrays if same else {}, model.action_space)
        logger, (values, counts, excluded) = model.logger, state.pending
        logger.name_to_value.update({name: _number(value) for name, value in values.items()})
        logger.name_to_count.update(counts)
        logger.name_to_excluded.update({name: tuple(names) for name, names in excluded.items()})
        model.action_space.np_random.bit_generator.state = state.action_space.model_dump()
        version, words, gauss = state.python
        random.setstate((version, tuple(words), gauss))
        check_torch_generator(arrays["torch"])
        np.random.set_state(("MT19937", arrays["numpy"], *state.numpy))
        torch.set_rng_state(torch.from_numpy(arrays["torch"]))
        if model.device.type == "cuda" and "cuda" in arrays:
            torch.cuda.set_rng_state(torch.from_numpy(arrays["cuda"]))

    def _compare(self, model: BaseAlgorithm, state: CheckpointState) -> None:
        here = arithmetic(model)
        for name, value in state.arithmetic.items():
            if here.get(name) != value:
                self.note(f"{name} was {value} before {model.num_timesteps:,} steps and is {here.get(name)} since")
        if state.digest != self.run.digest:
            self.note(f"the scenario has meant something else since {model.num_timesteps:,} steps")

    def note(self, reason: str) -> None:
        """Note a reason why this training differs from one that was never interrupted."""
        if reason not in self.inexact:
            self.inexact.append(reason)

    def _repeat_episodes(self, model: BaseAlgorithm, state: CheckpointState, arrays: Arrays) -> bool:
        """Bring the worlds back to where they were; whether that gave the same observations. If not, new episodes begin."""
        env = _environment(model)
        histories = [
            EpisodeHistory(start if isinstance(start, int) else start.model_dump(exclude_none=True), list(arrays[f"actions/{index}"]))
            for index, start in enumerate(state.starts)
        ]
        for history in histories:
            _check_actions(np.array(history.actions), env.action_space)
        if observation_digest(env.repeat(histories)) == state.observed:
            return True
        self.note(f"the episodes that ran at {model.num_timesteps:,} steps gave different results when repeated, so they were restarted")
        env.starts = [derive_seed(self.run.record.seed, "environment", i, "resumed", model.num_timesteps) for i in range(len(env.worlds))]
        model._last_obs = model.env.reset()  # type: ignore[union-attr, assignment]
        if (normalizer := model.get_vec_normalize_env()) is not None:
            model._last_original_obs = normalizer.get_original_obs()
        return False

    def _rows(self, buffer: ReplayBuffer, first: int, last: int) -> Array:
        """The rows of the ring for the steps from `first` to before `last`."""
        return (np.arange(first, last) - self._offset) % buffer.buffer_size

    def _refill(self, buffer: ReplayBuffer, state: CheckpointState, added: int, arrays: Arrays, action_space: Any) -> None:
        """Read the segments in their order. A training with another goal may have a buffer of another size."""
        size, self._offset = state.replay
        self._segments = list(state.segments)
        same = size == buffer.buffer_size
        oldest = max(self._segments[0][0] if self._segments else 0, added - min(size, buffer.buffer_size))
        if not same:
            self._offset = oldest
        columns = _columns(buffer)
        whole = self._segments[-1][1] == added and self._segments[0][0] <= max(self._offset, added - size) if self._segments else not added
        if not whole:
            raise ValueError("the segments of the replay buffer are not all there")
        for first, last in self._segments:
            specs = {name: ArraySpec(column.dtype, (last - first, *column.shape[1:])) for name, column in columns.items()}
            read, rows = read_arrays(self._segment(first, last), specs), self._rows(buffer, first, last)[-buffer.buffer_size :]
            for name, column in columns.items():
                column[rows] = read[name][-len(rows) :]
            _check_actions(read["actions"], action_space)
        buffer.pos, buffer.full = (added - self._offset) % buffer.buffer_size, added - self._offset >= buffer.buffer_size
        if isinstance(buffer, HerReplayBuffer):
            self._find_episodes(buffer, oldest, added, begin_anew=not same)
            starts = arrays["episode_starts"] if same and "episode_starts" in arrays else np.array(buffer.pos)
            if not ((starts >= 0) & (starts < buffer.buffer_size)).all():
                raise ValueError("an episode of the replay buffer begins outside of it")
            buffer._current_ep_start[:] = starts

    def _find_episodes(self, buffer: HerReplayBuffer, oldest: int, added: int, *, begin_anew: bool) -> None:
        """The length of each episode that ended and is whole; 0 elsewhere, which is not drawn from."""
        rows = self._rows(buffer, oldest, added)
        buffer.ep_length[:] = 0
        for row in range(buffer.n_envs):
            first = 0
            for end in (np.flatnonzero(buffer.dones[rows, row]) + 1).tolist():
                episode = rows[first:end]
                if begin_anew and first:
                    buffer.ep_start[episode, row] = episode[0]
                if (not begin_anew or first) and (buffer.ep_start[episode, row] == episode[0]).all():  # else its beginning was overwritten
                    buffer.ep_length[episode, row] = end - first
                first = end


def arithmetic(model: BaseAlgorithm) -> dict[str, str]:
    """What the last bits of a training depend on."""
    return {
        "torch": torch.__version__,
        "numpy": np.__version__,
        "threads of torch": str(torch.get_num_threads()),
        "CPU capability": torch.backends.cpu.get_cpu_capability(),
        "device": model.device.type,
    }


def _environment(model: BaseAlgorithm) -> VectorEnvironment:
    env = model.get_env()
    found = None if env is None else env.unwrapped
    if not isinstance(found, VectorEnvironment):
        raise TypeError("the model has another environment")
    return found


def _columns(buffer: ReplayBuffer) -> dict[str, Array]:
    """The arrays of a replay buffer that have a row for each step."""
    return {key: part for name in _BUFFER_COLUMNS if hasattr(buffer, name) for key, part in _flat(name, getattr(buffer, name))}


def _check_actions(actions: Array, space: Any) -> None:
    """Refuse a choice that the agent does not have, on which an update would fail."""
    if hasattr(space, "n") and not ((actions >= space.start) & (actions < space.start + space.n)).all():
        raise ValueError("it holds actions that the scenario does not have")


def _noises(model: BaseAlgorithm) -> list[DecayingNoise]:
    noise = getattr(model, "action_noise", None)
    return [] if noise is None else list(getattr(noise, "noises", [noise]))


def _memory(model: BaseAlgorithm) -> list[torch.Tensor]:
    """The state of a recurrent policy between two steps."""
    states = getattr(model, "_last_lstm_states", None)
    return [] if states is None else [*states.pi, *states.vf]


def _pending(logger: Logger) -> tuple[dict[str, Any], dict[str, int], dict[str, list[str]]]:
    """What was recorded and is not yet written, without pictures and the like."""
    values = {name: _encoded(value) for name, value in logger.name_to_value.items() if isinstance(value, int | float | str | np.generic)}
    excluded = {name: list(names) for name, names in logger.name_to_excluded.items()}
    return values, dict(logger.name_to_count), excluded


def _flat(name: str, value: Any) -> Iterator[tuple[str, Array]]:
    """An observation is an array, or a dictionary of arrays."""
    yield from ((f"{name}/{key}", part) for key, part in value.items()) if isinstance(value, dict) else [(name, value)]


def _unflat(name: str, arrays: Arrays) -> Any:
    parts = {key[len(name) + 1 :]: part for key, part in arrays.items() if key.startswith(f"{name}/")}
    return arrays.get(name, parts or None)


def _encoded(value: Any) -> Any:
    """A number of numpy with its type, and without NaN, which JSON does not have."""
    if isinstance(value, np.generic):
        plain = value.tolist()
        return NumpyScalar(dtype=str(value.dtype), value=plain if math.isfinite(plain) else None)  # type: ignore[arg-type]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _number(value: Any) -> Any:
    return value.number() if isinstance(value, NumpyScalar) else value


def _flush(path: Path) -> None:
    """Have the system write a file or folder to the disk, for a power cut."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
