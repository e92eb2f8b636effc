"""The observations of policies while an episode runs: frames in a ring, stacks of pictures, goals; in one
world, and as columns in a batch."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from struct import Struct
from typing import Any

import numpy as np
from numpy.typing import NDArray

from deepbots_cli.errors import EvaluationError
from deepbots_cli.program.task import Agent
from deepbots_cli.runtime.columns import stacked, where_running
from deepbots_cli.runtime.spaces import Column, recompute_rewards, scaled_goal


def frame_indices(agent: Agent) -> NDArray[np.intp]:
    """Return the indices of the numbers of an observation in a ring of frames; row p is for a newest frame in
    place p."""
    entries = np.array(agent.seen, np.intp).reshape(-1, 2)
    frames = agent.frame_stack + max([entry.history for entry in agent.observation], default=1) - 1
    newest = np.arange(frames)[:, None]
    return (newest - entries[:, 1]) % frames * len(agent.numbers) + entries[:, 0]


class FrameStack:
    """A ring of pictures, uint8; which of them are seen together follows from their ages in steps."""

    def __init__(self, shape: Sequence[int], ages: Sequence[int], depth: int) -> None:
        self.frames = np.zeros((depth, *shape), np.uint8)
        self._indices = (np.arange(depth)[:, None] - np.array(ages)) % depth
        self._shape = (*shape[:2], shape[2] * len(ages))

    def seen(self, newest: int) -> NDArray[np.uint8]:
        """Return the pictures, oldest first, with their channels side by side; a copy. `newest` is the place
        of the last one."""
        return np.reshape(self.frames[self._indices[newest]].transpose(1, 2, 0, 3), self._shape)


class ObservedFrames:
    """The observation of the policy of an agent: the numbers and pictures of the last steps, and the goal.

    Attributes:
        frames: The numbers of all frames in a row, float32; the newest ones are in frame `newest`.
        frame_stacks: The frames of each image, by its key.
        goal: The achieved and the desired goal, each in [-1, 1].
    """

    newest: int

    def __init__(self, agent: Agent) -> None:
        self.agent = agent
        self.views = frame_indices(agent)
        self.depth = len(self.views)
        self.frame_stacks = {
            entry.key: FrameStack(entry.shape, entry.ages(agent.frame_stack), self.depth)
            for entry in agent.images
        }
        self.frames = np.zeros(self.depth * len(agent.numbers), np.float32)
        self._buffer = self.frames.data
        self._width = 4 * len(agent.numbers)  # bytes of a frame of float32
        # `struct` raises an OverflowError for a number beyond float32, of which numpy would make inf.
        self._pack = Struct(f"{len(agent.numbers)}f").pack_into
        self.goal = np.zeros(2 * len(agent.goal.low) if agent.goal else 0, np.float32)

    def set_observation(self, *numbers: float) -> None:
        """Let the policy see these numbers, in the newest frame, as float32; a truth value is 0 or 1."""
        self._pack(self._buffer, self._width * self.newest, *numbers)

    def next_frame(self) -> None:
        """Make room for the observation after this step, if the policy sees several steps."""
        self.newest = (self.newest + 1) % self.depth

    def fill_frames(self) -> None:
        """Let every frame be as the newest, which is in place 0: before an episode there was nothing else."""
        width = len(self.agent.numbers)
        self.frames.reshape(self.depth, width)[1:] = self.frames[:width]
        for stack in self.frame_stacks.values():
            stack.frames[1:] = stack.frames[0]

    def seen(self) -> NDArray[np.float32]:
        """Return the numbers that the policy sees; a copy."""
        return self.frames.copy() if self.depth == 1 else self.frames.take(self.views[self.newest])

    def set_goal_observation(
        self, achieved: Sequence[float], desired: Sequence[float]
    ) -> tuple[list[float], list[float]]:
        """Set the achieved and desired goal in the observation, and return both as the policy sees them.

        Both are mapped to [-1, 1], clipped and rounded to float32, and mapped back: a reward that is
        recomputed from the observation is then the same reward.

        Raises:
            FloatingPointError: A number is not a number.
        """
        goal = self.agent.goal
        assert goal is not None
        size = len(goal.low)
        self.goal[:] = scaled_goal(goal, achieved) + scaled_goal(goal, desired)
        values = [
            middle + half * number
            for middle, half, number in zip(
                goal.middles * 2, goal.halves * 2, self.goal.tolist(), strict=True
            )
        ]
        return values[:size], values[size:]

    def reward_for(self, achieved_goal: Any, desired_goal: Any) -> Any:
        """Return the reward for goals as the policy sees them: for arrays (n, k) an array of n, for arrays
        (k,) a number.

        Raises:
            UsageError: The scenario has no goal, or the arrays do not fit it.
        """
        achieved, desired = np.asarray(achieved_goal), np.asarray(desired_goal)
        if achieved.ndim == 1:
            return recompute_rewards(self.agent, achieved[None], np.atleast_2d(desired)).item()
        return recompute_rewards(self.agent, achieved, desired)


class ObservedColumns(ABC):
    """The observations of the policies of a batch, like `ObservedFrames`, in columns with a number per row.

    Attributes:
        frames: The numbers, float32 (frame, number, row); the newest ones are in frame `newest`.
        goal: The achieved and the desired goal, each in [-1, 1], float32 (number, row).
        running: The rows that take part in this tick, as truth values; None for all.
        lost: Whether the world of a row is no longer finite.
    """

    running: Column | None
    lost: Column

    def __init__(self, agent: Agent, count: int) -> None:
        """Create the columns; `count` is the number of rows."""
        self.agent = agent
        self.count = count
        self._views = frame_indices(agent)
        self.depth = len(self._views)
        self.newest = 0
        self.frames = np.zeros((self.depth, len(agent.numbers), count), np.float32)
        self._size = len(agent.goal.low) if agent.goal else 0
        self.goal = np.zeros((2 * self._size, count), np.float32)

    @abstractmethod
    def failed(self, row: int, problem: str) -> EvaluationError:
        """Return the error of an episode, with the place of its row."""

    def set_observation(self, *numbers: Any) -> None:
        """Let the policies see these numbers in the newest frame."""
        frame = self.frames[self.newest]
        for column, number in zip(frame, numbers, strict=True):
            if self.running is None:
                column[:] = number
            else:
                np.copyto(
                    column, np.broadcast_to(number, self.count), where=self.running, casting="same_kind"
                )
        if not np.isfinite(frame).all():
            worlds = np.flatnonzero(~np.isfinite(frame).all(axis=0) & ~self.lost)
            if len(worlds):
                indices = np.flatnonzero(~np.isfinite(frame[:, worlds]).all(axis=1))
                names = ", ".join(dict.fromkeys(self.agent.numbers[index].name for index in indices))
                raise self.failed(int(worlds[0]), f"the observation {names} is not finite")

    def next_frame(self) -> None:
        """Make room for the observations after this step."""
        self.newest = (self.newest + 1) % self.depth

    def set_goal_observation(self, achieved: Any, desired: Any) -> tuple[Column, Column]:
        """See `Supervisor.set_goal_observation`."""
        goal = self.agent.goal
        assert goal is not None
        middle, half = (np.array(values * 2)[:, None] for values in (goal.middles, goal.halves))
        numbers = np.clip((stacked((*achieved, *desired), self.count) - middle) / half, -1.0, 1.0).astype(
            np.float32
        )
        self.goal = where_running(self.running, numbers, self.goal)
        lost = np.flatnonzero(~np.isfinite(self.goal).all(axis=0) & ~self.lost)
        if len(lost):
            raise self.failed(int(lost[0]), "the goal is not finite")
        goal_values = middle + half * self.goal.astype(float)
        return goal_values[: self._size], goal_values[self._size :]

    def observations(self) -> Any:
        """Return the observations, float32, a row per agent; a copy."""
        frames = self.frames.reshape(-1, self.count)
        numbers = np.ascontiguousarray(frames[self._views[self.newest]].T)
        if not self._size:
            return numbers
        goals = np.ascontiguousarray(self.goal.T)
        return {
            "observation": numbers,
            "achieved_goal": goals[:, : self._size].copy(),
            "desired_goal": goals[:, self._size :].copy(),
        }
