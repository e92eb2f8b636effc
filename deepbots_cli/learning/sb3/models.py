"""Models as Stable-Baselines3's `.zip` files, which plain Stable-Baselines3 loads without deepbots; and the
state of an algorithm in a checkpoint beside its model.

The algorithm is built from the run's scenario, and only tensors of the names, shapes and types that it has
are taken from the file, by `torch.load(weights_only=True)`. That function also calls `bytearray`, and makes
sparse and quantized tensors, and some without numbers; a pickle that names anything but plain tensors is
refused before. No member may be compressed, so a file from a stranger cannot take more memory than its size,
which is limited by that of the model.

Between two rollouts the rollout buffer is empty, and every local variable of the library's loops has its
initial value. The rows of a replay buffer are written once, into files that several checkpoints share.
"""

from __future__ import annotations

import io
import os
import pickle
import pickletools
import zipfile
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from itertools import pairwise
from operator import attrgetter
from pathlib import Path
from traceback import walk_tb
from typing import Annotated, Any, Self

import numpy as np
import torch
from pydantic import Field, model_validator
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.buffers import ReplayBuffer
from stable_baselines3.common.preprocessing import get_action_dim
from stable_baselines3.common.save_util import is_json_serializable, save_to_zip_file
from stable_baselines3.her import HerReplayBuffer

from deepbots_cli.errors import RunError, StorageError, UsageError
from deepbots_cli.files import atomic_write
from deepbots_cli.learning.checkpoints import (
    Array,
    CheckpointPart,
    CheckpointState,
    Count,
    GeneratorState,
    Number,
    check_actions,
    check_alike,
    flush_to_disk,
    read_arrays,
    write_arrays,
)
from deepbots_cli.learning.learner import Initialization
from deepbots_cli.learning.runs.run import opened_archive
from deepbots_cli.learning.sb3 import internals
from deepbots_cli.learning.sb3.internals import Counter, episode_starts

_STORAGES = ("Float", "Double", "Half", "BFloat16", "Long", "Int", "Short", "Char", "Byte", "Bool")
_PLAIN_GLOBALS = {
    "collections OrderedDict",
    "torch._utils _rebuild_tensor_v2",
    *(f"torch {name}Storage" for name in _STORAGES),
}
_OVERHEAD_BYTES = 8_000_000
NOT_FINITE = "the policy gives actions that are not finite: its weights are damaged, or the training diverged"
_DISTRIBUTION = "torch.distributions.distribution"
"""The module that checks the parameters of each distribution of torch."""
_MAX_MEMBERS = 32  # a model of SAC, which has three optimizers, has 8
# What a model cannot be loaded without, and JSON cannot hold; all of it is pickled by reference to
# Stable-Baselines3, Gymnasium and torch.
_PICKLED_ENTRIES = ("policy_class", "policy_kwargs", "observation_space", "action_space", "train_freq")
# Needs an environment to be loaded.
_HINDSIGHT_ENTRIES = ("replay_buffer_class", "replay_buffer_kwargs")


@contextmanager
def overflow_explained() -> Iterator[None]:
    """Context that turns torch's error about parameters of a distribution that are not finite into a
    RunError.

    torch raises a plain ValueError for these, which is recognized by the module that raises it.

    Raises:
        RunError: The parameters are not finite.
    """
    try:
        yield
    except ValueError as error:
        *_, (frame, _) = walk_tb(error.__traceback__)
        if frame.f_globals["__name__"] != _DISTRIBUTION:
            raise
        raise RunError(NOT_FINITE) from error


def save(path: Path, model: BaseAlgorithm) -> None:
    """Write a model that plain Stable-Baselines3 loads; schedules, noise and buffers are left out.

    Raises:
        RunError: The file cannot be written.
    """
    left_out = {
        *internals.unsaved_members(model),
        *_HINDSIGHT_ENTRIES,
        *(name.partition(".")[0] for name in _parts(model)),
    }
    data = {
        name: value
        for name, value in vars(model).items()
        if name not in left_out and (name in _PICKLED_ENTRIES or is_json_serializable(value))
    }
    if isinstance(getattr(model.policy, "columns", None), tuple):
        # The class of a policy whose critic sees more is made here: plain Stable-Baselines3 cannot load it.
        data = {name: value for name, value in data.items() if name != "policy_class"}
    # A schedule is a function of ours; training on elsewhere begins with the present rate.
    rate = data["learning_rate"] = float(model.lr_schedule(max(0.0, internals.progress_remaining(model))))
    parameters = model.get_parameters()
    for part in parameters.values():
        for group in part.get("param_groups", ()):
            group["lr"] = (
                # the library sets it in the next update only, so a resumed training would have another one
                # here
                rate
            )
    # In memory first: where a disk is full, torch's own writer ends in an error that does not say so.
    content = io.BytesIO()
    save_to_zip_file(content, data, parameters, dict(_variables(model)))
    with atomic_write(path, StorageError) as draft, draft.open("wb") as stream:
        stream.write(content.getbuffer())
        stream.flush()
        os.fsync(stream.fileno())  # so that the model survives a power cut


def load(path: Path, model: BaseAlgorithm) -> None:
    """Set the tensors of a model, its optimizers and its variables.

    Raises:
        RunError: The file is missing, damaged, no model of ours, or has other tensors than the model.
    """
    size = sum(tensor.numel() * tensor.element_size() for tensor in model.policy.state_dict().values())
    # The weights and the two moments of Adam take at most three times the size of the policy.
    tensors = _read(path, 4 * size + _OVERHEAD_BYTES)
    variables = tensors.pop("pytorch_variables", {})
    # Before the library looks the names up in the model.
    if tensors.keys() != set(_parts(model)):
        raise RunError(
            f"{path} has the parts {', '.join(sorted(tensors))[:200]}; the policy of this scenario has"
            f" {', '.join(sorted(_parts(model)))}"
        )
    try:
        for name, optimizer in _optimizers(model):
            # The settings of the optimizer are those of the scenario, not of the file.
            tensors[name] = {**optimizer.state_dict(), "state": tensors[name]["state"]}
        model.set_parameters(dict(tensors))  # type: ignore[arg-type]  # a dictionary of parts
        for name, variable in _variables(model):
            variable.data.copy_(variables[name])
    except (AttributeError, LookupError, RuntimeError, TypeError, ValueError) as error:
        reason = " ".join(str(error).split())[:200]
        raise RunError(f"{path} does not fit the policy of this scenario ({reason})") from error
    for name, tensor in {**model.policy.state_dict(), **dict(_variables(model))}.items():
        if not torch.isfinite(tensor).all():
            raise RunError(f"{path}: '{name}' contains infinite or NaN values")
    for name, optimizer in _optimizers(model):
        _check_moments(path, name, optimizer)


def initialize(path: Path, model: BaseAlgorithm) -> Initialization:
    """Copy each tensor of the policy that has the same name and shape in the file. Optimizers begin afresh.

    Raises:
        RunError: The file is missing, damaged, or no model.
        UsageError: Nothing in it fits.
    """
    file_tensors = _read(path, path.stat().st_size if path.is_file() else 0)["policy"]
    tensors = model.policy.state_dict()
    reasons: dict[str, str] = {}
    for name, tensor in tensors.items():
        file_tensor = file_tensors.get(name)
        if not isinstance(file_tensor, torch.Tensor):
            reasons[name] = "the other model does not have it"
        elif file_tensor.shape != tensor.shape:
            reasons[name] = f"{tuple(tensor.shape)} here, {tuple(file_tensor.shape)} there"
        elif not torch.isfinite(file_tensor).all():
            reasons[name] = "not finite there"
    copied = tuple(name for name in tensors if name not in reasons)
    if not copied:
        raise UsageError(f"no tensor of {path} fits the policy of this scenario")
    model.policy.load_state_dict(
        {name: file_tensors[name] if name in copied else tensor for name, tensor in tensors.items()}
    )
    return Initialization(copied, reasons)


def _parts(model: BaseAlgorithm) -> list[str]:
    return internals.saved_members(model)[0]


def _optimizers(model: BaseAlgorithm) -> Iterator[tuple[str, torch.optim.Optimizer]]:
    for name in _parts(model):
        part = attrgetter(name)(model)
        if isinstance(part, torch.optim.Optimizer):
            yield name, part


def _variables(model: BaseAlgorithm) -> Iterator[tuple[str, torch.Tensor]]:
    for name in internals.saved_members(model)[1]:
        yield name, attrgetter(name)(model)


def _read(path: Path, limit: int) -> dict[str, Mapping[str, Any]]:
    """Return the state dictionaries of a model file, by part."""
    if not path.is_file():
        raise RunError(f"{path} is missing; `deepbots resume RUN` continues a training without a model")
    if path.stat().st_size > limit:
        raise RunError(f"{path} is larger than the scenario's policy can be")
    tensors = {}
    try:
        with opened_archive(path, path.stat().st_size) as archive:
            if len(archive.infolist()) > _MAX_MEMBERS:
                raise ValueError(f"it has {len(archive.infolist())} members")
            for name in archive.namelist():
                if name.endswith(".pth"):
                    content = archive.read(name)
                    # torch would read other content as a file from before 2020.
                    if not content.startswith(b"PK\x03\x04"):
                        raise ValueError("it contains objects other than plain tensors")
                    with opened_archive(io.BytesIO(content), len(content)) as inner:
                        _check_pickle(inner)
                    tensors[name.removesuffix(".pth")] = torch.load(
                        io.BytesIO(content), map_location="cpu", weights_only=True
                    )
    except RunError:
        raise
    except pickle.UnpicklingError as error:
        raise RunError(
            f"{path} is damaged, or was not written by deepbots (it contains objects other than tensors)"
        ) from error
    except Exception as error:  # reading a damaged file raises a dozen kinds of exceptions
        reason = str(error).strip().splitlines()[0][:120] if str(error).strip() else "cut short"
        raise RunError(f"{path} is damaged, or was not written by deepbots ({reason})") from error
    if "policy" not in tensors or not all(isinstance(value, dict) for value in tensors.values()):
        raise RunError(f"{path} is damaged, or was not written by deepbots (it lacks 'policy')")
    return tensors


def _check_pickle(archive: zipfile.ZipFile) -> None:
    """Refuse a pickle of torch that names anything but dictionaries and plain tensors."""
    (name,) = (name for name in archive.namelist() if name.count("/") == 1 and name.endswith("/data.pkl"))
    for operation, argument, _ in pickletools.genops(archive.read(name)):
        if operation.name == "GLOBAL" and argument not in _PLAIN_GLOBALS:
            raise ValueError(f"it contains objects other than plain tensors: {str(argument)[:60]}")
        # The other operations that import an object. `torch.save` writes protocol 2, without them.
        if operation.name in ("STACK_GLOBAL", "INST", "EXT1", "EXT2", "EXT4"):
            raise ValueError("it contains objects other than plain tensors")


def _check_moments(path: Path, name: str, optimizer: torch.optim.Optimizer) -> None:
    """Refuse moments with which the next update would fail."""
    states = [*optimizer.state.items()]
    for parameter, moments in states:
        fits = moments.keys() == states[0][1].keys() and all(
            value.shape in ((), parameter.shape) and torch.isfinite(value).all() for value in moments.values()
        )
        if not fits or moments.get("step", 0) < 0:
            raise RunError(f"{path}: '{name}' has moments of another training")


_BUFFER_COLUMNS = ("observations", "next_observations", "actions", "rewards", "dones", "timeouts", "ep_start")


class EpisodeInfo(CheckpointPart):
    """Return and length of an episode, as Stable-Baselines3 keeps them."""

    r: Number
    l: Number  # noqa: E741  # the name of Stable-Baselines3


class StableState(CheckpointState):
    """The part of a checkpoint that is JSON."""

    counts: dict[Counter, Count | float]
    infos: list[EpisodeInfo]
    successes: list[bool]
    action_space: GeneratorState
    segments: Annotated[list[tuple[Count, Count]], Field(max_length=1_000_000)]
    """First and last step (of a row of the environment) of each file of the replay buffer."""
    replay: tuple[Count, Count]
    """The size of the replay buffer, and the step in its first row."""
    learning_rate: Annotated[float, Field(gt=0, le=1)] | None = None
    """The present rate, where it follows the divergence of the policy."""

    @model_validator(mode="after")
    def _fits_its_counters(self) -> Self:
        if self.counts.get("num_timesteps") != self.steps:
            raise ValueError("its counts of steps contradict each other")
        gaps = any(before[1] != after[0] for before, after in pairwise(self.segments))
        if (
            gaps
            or any(first >= last or last > self.steps for first, last in self.segments)
            or self.replay[1] > self.steps
        ):
            raise ValueError("the segments of its replay buffer contradict each other")
        return self


class ReplayFiles:
    """The rows of a replay buffer in segments: files in a folder, each written once."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self.segments: list[tuple[int, int]] = []
        self.offset = 0

    def paths(self) -> Iterable[Path]:
        return (self._path(*segment) for segment in self.segments)

    def _path(self, first: int, last: int) -> Path:
        return self._folder / f"{first:012d}-{last:012d}.npz"

    def append(self, buffer: ReplayBuffer, added: int) -> None:
        """Write the new rows, and forget the segments of which nothing is left in the buffer."""
        first = max(self.segments[-1][1] if self.segments else self.offset, added - buffer.buffer_size)
        self.segments = [segment for segment in self.segments if segment[1] > added - buffer.buffer_size]
        if first == added:
            return
        rows = self._rows(buffer, first, added)
        self.segments.append((first, added))
        self._folder.mkdir(parents=True, exist_ok=True)
        path = self._path(first, added)
        write_arrays(path, {name: column[rows] for name, column in _columns(buffer).items()})
        # On the disk before the checkpoint is, whose state names the segment.
        flush_to_disk(path)

    def forget(self, added: int) -> None:
        """Begin with an empty buffer after the steps so far. The files are removed with the checkpoints that
        have them."""
        self.segments = []
        self.offset = added

    def _rows(self, buffer: ReplayBuffer, first: int, last: int) -> Array:
        """Return the rows of the ring for the steps from `first` to before `last`."""
        return (np.arange(first, last) - self.offset) % buffer.buffer_size

    def refill(
        self, buffer: ReplayBuffer, state: StableState, added: int, starts: Array | None, action_space: Any
    ) -> None:
        """Read the segments in their order. A training with another goal may have a buffer of another size.

        `starts` are the rows in which running episodes begin, for hindsight; None where other episodes have
        begun.
        """
        size, self.offset = state.replay
        self.segments = list(state.segments)
        has_same_size = size == buffer.buffer_size
        oldest = max(self.segments[0][0] if self.segments else 0, added - min(size, buffer.buffer_size))
        if not has_same_size:
            self.offset = oldest
        columns = _columns(buffer)
        is_complete = (
            self.segments[-1][1] == added and self.segments[0][0] <= max(self.offset, added - size)
            if self.segments
            else self.offset == added
        )
        if not is_complete:
            raise ValueError("the segments of the replay buffer are not all there")
        for first, last in self.segments:
            arrays = read_arrays(self._path(first, last))
            check_alike(
                {name: array[:0] for name, array in arrays.items()},
                {name: column[:0] for name, column in columns.items()},
            )
            # The newest rows of a segment that is longer than a smaller buffer.
            rows = self._rows(buffer, first, last)[-buffer.buffer_size :]
            for name, column in columns.items():
                column[rows] = arrays[name][-len(rows) :]
            # The columns behind the actions are labels of a teacher.
            check_actions(arrays["actions"][..., : get_action_dim(action_space)], action_space)
        buffer.pos = (added - self.offset) % buffer.buffer_size
        buffer.full = added - self.offset >= buffer.buffer_size
        if isinstance(buffer, HerReplayBuffer):
            self._find_episodes(buffer, oldest, added, begin_anew=not has_same_size)
            starts = starts if has_same_size and starts is not None else np.array(buffer.pos)
            if not ((starts >= 0) & (starts < buffer.buffer_size)).all():
                raise ValueError("an episode of the replay buffer begins outside of it")
            episode_starts(buffer)[:] = starts

    def _find_episodes(self, buffer: HerReplayBuffer, oldest: int, added: int, *, begin_anew: bool) -> None:
        """Set the length of each complete episode that has ended; 0 elsewhere, which is not drawn from."""
        rows = self._rows(buffer, oldest, added)
        buffer.ep_length[:] = 0
        for row in range(buffer.n_envs):
            first = 0
            for end in (np.flatnonzero(buffer.dones[rows, row]) + 1).tolist():
                episode = rows[first:end]
                if begin_anew and first:
                    buffer.ep_start[episode, row] = episode[0]
                if (not begin_anew or first) and (
                    buffer.ep_start[episode, row] == episode[0]
                ).all():  # otherwise its beginning was overwritten
                    buffer.ep_length[episode, row] = end - first
                first = end


def _columns(buffer: ReplayBuffer) -> dict[str, Array]:
    """Return the arrays of a replay buffer that have a row for each step."""
    columns: dict[str, Array] = {}
    for name in (name for name in _BUFFER_COLUMNS if hasattr(buffer, name)):
        value = getattr(buffer, name)
        columns |= (
            {f"{name}/{key}": part for key, part in value.items()}
            if isinstance(value, dict)
            else {name: value}
        )
    return columns
