"""The state of an algorithm of Stable-Baselines3 in a checkpoint, beside its model: the part that is JSON,
and the replay buffer.

Between two rollouts the rollout buffer is empty, and every local variable of the library's loops has its
initial value. The rows of a replay buffer are written once, into files that several checkpoints share.
"""

from __future__ import annotations

from collections.abc import Iterable
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any, Self

import numpy as np
from pydantic import Field, model_validator
from stable_baselines3.common.buffers import ReplayBuffer
from stable_baselines3.common.preprocessing import get_action_dim
from stable_baselines3.her import HerReplayBuffer

from deepbots_cli.learning.checkpoint_files import (
    Array,
    ArraySpec,
    CheckpointPart,
    CheckpointState,
    Count,
    GeneratorState,
    Number,
    check_actions,
    flush_to_disk,
    read_arrays,
    write_arrays,
)
from deepbots_cli.learning.sb3.internals import Counter, episode_starts

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
            specs = {
                name: ArraySpec(column.dtype, (last - first, *column.shape[1:]))
                for name, column in columns.items()
            }
            arrays = read_arrays(self._path(first, last), specs)
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
