"""Checkpoints, from which a training that was killed goes on to the bit as if it had never been interrupted.

    checkpoints/000012288/      state.json, arrays.npz, model.zip: a checkpoint after 12 288 steps; only the last one is kept
    checkpoints/replay/         the rows of a replay buffer, in segments that are written once

A checkpoint is taken between two roll-outs, before anything of the next one happens. There the roll-out buffer is empty, and every local
variable of Stable-Baselines3's loops has its initial value, except a count of roll-outs (`ResumableAlgorithm.dump_logs`). A resumed
training calls the same `learn`. Once that has set everything up, `_setup_learn` puts the state of the checkpoint in its place. The
running episodes are repeated (`VectorEnvironment.repeat`), and random generators are restored last. What was logged after the checkpoint
is cut off, and logged again.

Nothing is unpickled, and no array takes more memory than its file.
"""

from __future__ import annotations

import math
import os
import random
import re
import shutil
import time
import zipfile
from collections.abc import Iterator, Mapping, Sequence
from inspect import signature
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import torch
from pydantic import BaseModel, NonNegativeInt
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.buffers import ReplayBuffer
from stable_baselines3.common.logger import TensorBoardOutputFormat
from stable_baselines3.common.off_policy_algorithm import OffPolicyAlgorithm
from stable_baselines3.common.on_policy_algorithm import OnPolicyAlgorithm
from stable_baselines3.common.type_aliases import RolloutReturn
from stable_baselines3.her import HerReplayBuffer

from deepbots_cli.errors import RunError
from deepbots_cli.files import unwritable_message
from deepbots_cli.learning import models
from deepbots_cli.learning.algorithms import DecayingNoise
from deepbots_cli.learning.callbacks import CallbackState, TrainingCallback, check_finite
from deepbots_cli.learning.curriculum import CurriculumState
from deepbots_cli.learning.environments import VectorEnvironment, observation_digest
from deepbots_cli.learning.episodes import StatisticsState
from deepbots_cli.learning.run import Run, read_json
from deepbots_cli.runtime.batch import EpisodeHistory
from deepbots_cli.runtime.streams import derive_seed

Array = npt.NDArray[Any]
Arrays = Mapping[str, Array]

INTERVAL_S = 10.0
"""Time between checkpoints: what a killed training loses, unless a large replay buffer makes them rare."""
MIN_INTERVAL_PER_COST = 40
"""A checkpoint that takes a second is followed by 40 without one: at most 2.5 % of the time goes into checkpoints."""

_MAX_STATE_BYTES = 100_000_000
_COUNTER_ATTRIBUTES = ("num_timesteps", "_episode_num", "_n_updates", "_n_calls", "_current_progress_remaining", "exploration_rate")
_ROW_ATTRIBUTES = ("_last_obs", "_last_original_obs", "_last_episode_starts")
_BUFFER_COLUMNS = ("observations", "next_observations", "actions", "rewards", "dones", "timeouts", "ep_start")


class CheckpointState(BaseModel, strict=True):
    """The part of a checkpoint that is JSON."""

    digest: str
    """Of the scenario."""
    arithmetic: dict[str, str]
    statistics: StatisticsState
    curriculum: CurriculumState
    callback: CallbackState
    stages: list[NonNegativeInt]
    """The stage of the curriculum that each world is in."""
    starts: list[int | dict[str, Any]]
    """How the running episode of each world began: its seed, or the states of its random generators."""
    observed: str
    """The fingerprint of the last observations."""
    counts: dict[str, Any]
    infos: list[dict[str, Any]]
    successes: list[bool]
    pending: list[dict[str, Any]]
    """What was recorded for the logger and is not yet written."""
    action_space: dict[str, Any]
    python: list[Any]
    numpy: tuple[int, int, float]
    segments: list[tuple[NonNegativeInt, NonNegativeInt]]
    """First and last step (of a row of the environment) of each file of the replay buffer."""
    replay: tuple[NonNegativeInt, NonNegativeInt]
    """The size of the replay buffer, and the step in its first row."""
    logs: dict[str, int]
    """Bytes of each log."""
    inexact: list[str]


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
    """Takes the checkpoints of a run, and goes back to the last of them.

    Make it before the logs are opened: what was logged after the last checkpoint is cut off.

    Raises:
        RunError: The last checkpoint is damaged.
    """

    def __init__(self, run: Run) -> None:
        self.run = run
        self.stages: list[int] = []
        """The stage that each world is in, which the training keeps up to date."""
        self.inexact: list[str] = []
        self._segments: list[tuple[int, int]] = []
        self._offset = 0
        self._last = -1
        self._previous = 0
        self._due = 0.0
        self._found = latest_checkpoint(run)
        self.state = None if self._found is None else read_state(self._found)
        if self.state is not None:
            self.stages, self.inexact = list(self.state.stages), list(self.state.inexact)
        sizes = self.state.logs if self.state else {}
        for path in self._logs():
            size = sizes.get(path.relative_to(run.path).as_posix(), 0)
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
            models.save(self.run.models / f"step-{steps:09d}.zip", model)
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
            arrays, state = self._collect(model)
            _write_arrays(folder / "arrays.npz", arrays)
            (folder / "state.json").write_text(state.model_dump_json())
            for path in [*folder.iterdir(), folder]:
                _flush(path)
            for name in ("last", "best") if self.callback.best is None else ("last",):
                shutil.copyfile(folder / "model.zip", copy)
                _flush(copy)
                os.replace(copy, self.run.models / f"{name}.zip")
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

    def _collect(self, model: BaseAlgorithm) -> tuple[dict[str, Array], CheckpointState]:
        env = _environment(model)
        histories, numpy_state = env.histories(), np.random.get_state(legacy=False)
        arrays = {
            key: part
            for name in _ROW_ATTRIBUTES
            if getattr(model, name, None) is not None
            for key, part in _flat(name, getattr(model, name))
        }
        arrays |= {f"actions/{index}": np.array(history.actions) for index, history in enumerate(histories)}
        arrays |= {f"noise/{i}": noise.drift for i, noise in enumerate(_noises(model)) if noise.drift is not None}
        arrays |= {f"lstm/{index}": tensor.cpu().numpy() for index, tensor in enumerate(_memory(model))}
        arrays |= {"torch": torch.get_rng_state().numpy(), "numpy": numpy_state["state"]["key"]}
        if model.device.type == "cuda":
            arrays["cuda"] = torch.cuda.get_rng_state().numpy()
        if (normalizer := model.get_vec_normalize_env()) is not None:
            statistics = normalizer.ret_rms
            arrays |= {"returns": normalizer.returns, "return_statistics": np.array([statistics.mean, statistics.var, statistics.count])}
        if isinstance(buffer := getattr(model, "replay_buffer", None), HerReplayBuffer):
            arrays["episode_starts"] = buffer._current_ep_start
        for output in model.logger.output_formats:
            if isinstance(output, TensorBoardOutputFormat):
                output.writer.flush()
        state = CheckpointState(
            digest=self.run.digest,
            arithmetic=arithmetic(model),
            statistics=self.callback.statistics.state(),
            curriculum=self.callback.curriculum.state(),
            callback=self.callback.state(),
            stages=self.stages,
            starts=[history.start for history in histories],
            observed=observation_digest(env.last_observations),
            counts={name: getattr(model, name) for name in _COUNTER_ATTRIBUTES if hasattr(model, name)},
            infos=[_encoded(info) for info in model.ep_info_buffer or ()],
            successes=[bool(success) for success in model.ep_success_buffer or ()],
            pending=[_encoded(part) for part in _pending(model)],
            action_space=_plain(model.action_space.np_random.bit_generator.state),
            python=list(random.getstate()),
            numpy=(numpy_state["state"]["pos"], numpy_state["has_gauss"], numpy_state["gauss"]),
            segments=self._segments,
            replay=(getattr(getattr(model, "replay_buffer", None), "buffer_size", 0), self._offset),
            logs={path.relative_to(self.run.path).as_posix(): path.stat().st_size for path in self._logs()},
            inexact=self.inexact,
        )
        return arrays, state

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
        _write_arrays(path, {name: column[rows] for name, column in _columns(buffer).items()})
        _flush(path)

    # Going back to one

    def restore(self, model: BaseAlgorithm) -> None:
        """Put the state of the checkpoint in the place of a fresh one; without a checkpoint, the training begins.

        Raises:
            RunError: The checkpoint is damaged, or of another network.
        """
        if self.state is None or self._found is None:
            return
        models.load(self._found / "model.zip", model)
        try:
            self._restore(model, self.state, read_arrays(self._found / "arrays.npz"))
        except (AttributeError, IndexError, KeyError, OverflowError, RuntimeError, TypeError, ValueError) as error:
            reason = " ".join(str(error).split())[:200]
            raise RunError(f"{self._found} is damaged, or of another training ({type(error).__name__}: {reason})") from error
        self._last = self._previous = model.num_timesteps
        self._due = time.monotonic() + INTERVAL_S

    def _restore(self, model: BaseAlgorithm, state: CheckpointState, arrays: Arrays) -> None:
        if any(name not in _COUNTER_ATTRIBUTES for name in state.counts):
            raise ValueError("unknown counts")
        for name, value in state.counts.items():
            setattr(model, name, type(getattr(model, name))(value))
        model._num_timesteps_at_start = model.num_timesteps
        model.ep_info_buffer.extend(_decoded(info) for info in state.infos)  # type: ignore[union-attr]  # made by _setup_learn
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
            normalizer.ret_rms.mean, normalizer.ret_rms.var, normalizer.ret_rms.count = mean, var, float(count)
            normalizer.returns = arrays["returns"]
        if isinstance(model, OffPolicyAlgorithm) and model.replay_buffer is not None:
            self._refill(model.replay_buffer, state, model.num_timesteps // model.n_envs, arrays if same else {}, model.action_space)
        for part, kept in zip(_pending(model), state.pending, strict=True):
            part.update({name: tuple(v) if isinstance(v, list) else v for name, v in _decoded(kept).items()})
        model.action_space.np_random.bit_generator.state = state.action_space
        python = state.python
        random.setstate((python[0], tuple(python[1]), python[2]))
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
        if len(state.starts) != len(env.worlds):
            raise ValueError(f"{len(state.starts)} worlds")
        histories = [EpisodeHistory(start, list(arrays[f"actions/{index}"])) for index, start in enumerate(state.starts)]
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
        for first, last in self._segments:
            read, rows = read_arrays(self._segment(first, last)), self._rows(buffer, first, last)[-buffer.buffer_size :]
            for name, column in columns.items():
                column[rows] = read[name][-len(rows) :]
            _check_actions(read["actions"], action_space)
        buffer.pos, buffer.full = (added - self._offset) % buffer.buffer_size, added - self._offset >= buffer.buffer_size
        if isinstance(buffer, HerReplayBuffer):
            self._find_episodes(buffer, oldest, added, begin_anew=not same)
            buffer._current_ep_start[:] = arrays["episode_starts"] if same and "episode_starts" in arrays else buffer.pos

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
                if (not begin_anew or first) and buffer.ep_start[episode[0], row] == episode[0]:  # else its beginning was overwritten
                    buffer.ep_length[episode, row] = end - first
                first = end


def latest_checkpoint(run: Run) -> Path | None:
    """The last checkpoint of a run, if there is one."""
    folders = run.checkpoints.iterdir() if run.checkpoints.is_dir() else ()
    return max((path for path in folders if re.fullmatch(r"\d{12}", path.name)), default=None)


def read_state(folder: Path) -> CheckpointState:
    """Raises: RunError: The checkpoint is damaged."""
    return read_json(folder / "state.json", CheckpointState, _MAX_STATE_BYTES)


def _write_arrays(path: Path, arrays: Arrays) -> None:
    with zipfile.ZipFile(path, "w", zipfile.ZIP_STORED) as archive:
        for name, array in arrays.items():
            with archive.open(f"{name}.npy", "w", force_zip64=True) as member:
                np.lib.format.write_array(member, np.asarray(array, order="C"), version=(1, 0), allow_pickle=False)


def read_arrays(path: Path) -> dict[str, Array]:
    """The arrays of an uncompressed `.npz`; none is larger than the file, and none holds objects.

    Raises:
        RunError: The file is missing, damaged, or holds anything else.
    """
    if not path.is_file():
        raise RunError(f"{path} is missing")
    try:
        with zipfile.ZipFile(path) as archive:
            members = archive.infolist()
            if sum(member.file_size for member in members) > path.stat().st_size or any(m.compress_type for m in members):
                raise ValueError("it is compressed")
            return {member.filename.removesuffix(".npy"): _read_array(archive, member) for member in members}
    except Exception as error:  # numpy parses headers as Python, and raises a dozen kinds
        reason = str(error).splitlines()[0][:120] if str(error) else "cut short"
        raise RunError(f"{path} is damaged ({reason})") from error


def _read_array(archive: zipfile.ZipFile, member: zipfile.ZipInfo) -> Array:
    with archive.open(member) as stream:
        if np.lib.format.read_magic(stream) != (1, 0):
            raise ValueError(f"{member.filename} is of an unknown version")
        shape, fortran, dtype = np.lib.format.read_array_header_1_0(stream)
        content = stream.read()
        if fortran or dtype.hasobject or math.prod(shape) * dtype.itemsize != len(content):
            raise ValueError(f"{member.filename} does not hold what its header says")
        return np.frombuffer(content, dtype).reshape(shape).copy()


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
        raise ValueError("the replay buffer holds actions that the scenario does not have")


def _noises(model: BaseAlgorithm) -> list[DecayingNoise]:
    noise = getattr(model, "action_noise", None)
    return [] if noise is None else list(getattr(noise, "noises", [noise]))


def _memory(model: BaseAlgorithm) -> list[torch.Tensor]:
    """The state of a recurrent policy between two steps."""
    states = getattr(model, "_last_lstm_states", None)
    return [] if states is None else [*states.pi, *states.vf]


def _pending(model: BaseAlgorithm) -> Sequence[dict[str, Any]]:
    return model.logger.name_to_value, model.logger.name_to_count, model.logger.name_to_excluded


def _flat(name: str, value: Any) -> Iterator[tuple[str, Array]]:
    """An observation is an array, or a dictionary of arrays."""
    yield from ((f"{name}/{key}", part) for key, part in value.items()) if isinstance(value, dict) else [(name, value)]


def _unflat(name: str, arrays: Arrays) -> Any:
    parts = {key[len(name) + 1 :]: part for key, part in arrays.items() if key.startswith(f"{name}/")}
    return arrays.get(name, parts or None)


def _encoded(values: Mapping[str, Any]) -> dict[str, Any]:
    """Numbers of numpy keep their type: the mean of float32 is not that of float64."""
    return {
        name: {"dtype": str(value.dtype), "value": value.tolist()} if isinstance(value, np.generic | np.ndarray) else value
        for name, value in values.items()
    }


def _decoded(values: Mapping[str, Any]) -> dict[str, Any]:
    return {
        name: np.array(value["value"], dtype=value["dtype"])[()] if isinstance(value, dict) else value for name, value in values.items()
    }


def _plain(value: Any) -> Any:
    """Numbers and arrays of numpy as JSON can hold them."""
    if isinstance(value, Mapping):
        return {str(key): _plain(inner) for key, inner in value.items()}
    return value.tolist() if isinstance(value, np.generic | np.ndarray) else value


def _flush(path: Path) -> None:
    """Have the system write a file or folder to the disk, for a power cut."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
