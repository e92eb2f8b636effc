"""Spaces of a compiled scenario, actions in their forms, and rewards for other goals; the observations of
policies while an episode runs (frames in a ring, stacks of pictures, goals), in one world, as columns in a
batch, and from named values without a world; the actions of a policy for several rows.

The results of a policy do not depend on the number of worlds. The rounding of a matrix product depends on the
number of rows and on the index of a row, and a rounding error can change an action. Therefore every forward
pass has `FORWARD_BATCH_SIZE` rows, and episode k always uses row k mod `FORWARD_BATCH_SIZE`. The content of
other rows does not affect it.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from struct import Struct
from typing import Any, Protocol, cast

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from deepbots_cli.arrays import evaluate
from deepbots_cli.errors import EvaluationError, UsageError
from deepbots_cli.expressions.scalar import Const, Name, Op, Scalar, names_in
from deepbots_cli.program import Program
from deepbots_cli.program.task import Agent, Goal
from deepbots_cli.runtime.columns import stacked, where_running
from deepbots_cli.runtime.formulas import clip, scale, scale_freely
from deepbots_cli.words import counted

Column = NDArray[Any]
Goals = NDArray[np.floating[Any]]


def observation_space(agent: Agent) -> gym.Space[Any]:
    """Return the space of one float32 per number that the policy sees: [-1, 1], [0, 1] for a truth value,
    without bounds if it is not clipped.

    With pictures or a goal, this space is `observation` in a Dict beside them: pictures under their names as
    uint8 (rows, columns, channels), and `achieved_goal` and `desired_goal`.
    """
    high = np.array([1.0 if entry.truth or entry.clipped else np.inf for entry in agent.inputs], np.float32)
    low = -high
    low[[entry.truth for entry in agent.inputs]] = 0.0
    box = gym.spaces.Box(low, high, dtype=np.float32)
    if agent.goal is None and not agent.images:
        return box
    parts: dict[str, gym.Space[Any]] = {"observation": box} if agent.inputs or not agent.images else {}
    for pictured in agent.images:
        rows, columns, channels = pictured.shape
        parts[pictured.key] = gym.spaces.Box(
            0, 255, (rows, columns, channels * len(pictured.ages(agent.frame_stack))), np.uint8
        )
    if agent.goal is not None:
        goal = gym.spaces.Box(-1.0, 1.0, (len(agent.goal.low),), np.float32)
        parts |= {"achieved_goal": goal, "desired_goal": goal}
    return gym.spaces.Dict(parts)


def scaled_goal(goal: Goal, values: Sequence[float]) -> list[float]:
    """Map the components of an achieved or a desired goal to [-1, 1], and clip them.

    Raises:
        FloatingPointError: A component is not a number.
    """
    scaled = [
        (value - middle) / half for value, middle, half in zip(values, goal.middles, goal.halves, strict=True)
    ]
    return [x if -1.0 <= x <= 1.0 else clip(x) for x in scaled]


def action_space(agent: Agent) -> gym.Space[Any]:
    """Return Discrete for one choice, MultiDiscrete for several, Box [-1, 1] for intervals; a Dict of
    `choices` and `ranges` for both."""
    options = [len(part.options) for part in agent.choices]
    size = len(agent.range_names)
    ranges = gym.spaces.Box(-1.0, 1.0, (size,), np.float32)
    if not options:
        return ranges
    choices: gym.Space[Any] = (
        gym.spaces.Discrete(options[0]) if len(options) == 1 else gym.spaces.MultiDiscrete(options)
    )
    return gym.spaces.Dict({"choices": choices, "ranges": ranges}) if size else choices


def compose_action(space: gym.Space[Any], choices: Sequence[int], ranges: Sequence[float]) -> Any:
    """Return the action of `space` with these options by number, one per choice, and these values from -1 to
    1."""
    if isinstance(space, gym.spaces.Dict):
        return {
            "choices": compose_action(space["choices"], choices, ()),
            "ranges": compose_action(space["ranges"], (), ranges),
        }
    if isinstance(space, gym.spaces.Discrete):
        return choices[0]
    return np.array(choices, np.int64) if choices else np.array(ranges, np.float32)


def compose_rows(space: gym.Space[Any], choices: NDArray[Any], ranges: NDArray[Any]) -> Any:
    """Return actions of `space`, given options by number (row, choice) and values from -1 to 1 (row,
    range)."""
    if isinstance(space, gym.spaces.Dict):
        return {
            "choices": compose_rows(space["choices"], choices, ranges),
            "ranges": compose_rows(space["ranges"], choices, ranges),
        }
    if isinstance(space, gym.spaces.Box):
        return ranges.astype(np.float32)
    options = choices.astype(np.int64)
    return options[:, 0] if isinstance(space, gym.spaces.Discrete) else options


def parts_of_rows(actions: Any) -> tuple[NDArray[Any], NDArray[Any]]:
    """Return the options by number (row, choice) and the values (row, range) in actions of one space, one a
    row."""
    if isinstance(actions, dict):
        return parts_of_rows(actions["choices"])[0], actions["ranges"]
    none = np.zeros((len(actions), 0), np.float32)
    if actions.dtype.kind == "f":
        return none.astype(np.int64), actions
    return actions.reshape(len(actions), -1), none


def mask_of_space(space: gym.Space[Any], masks: Sequence[NDArray[np.int8]]) -> Any:
    """Return masks of options, one of each choice, in the form that `space.sample` takes; each may have a row
    per world."""
    if isinstance(space, gym.spaces.Dict):
        return {"choices": mask_of_space(space["choices"], masks), "ranges": None}
    return masks[0] if isinstance(space, gym.spaces.Discrete) else tuple(masks)


def canonical_action(space: gym.Space[Any], action: Any) -> Any:
    """Return the action as generated code takes it (int or array); None if it has another shape or kind, is
    not finite, or names no option. Numbers beyond the bounds of a Box pass."""
    try:
        if isinstance(space, gym.spaces.Dict):
            parts = (
                {key: canonical_action(part, action[key]) for key, part in space.spaces.items()}
                if set(action) == set(space.spaces)
                else {}
            )
            return parts if parts and all(part is not None for part in parts.values()) else None
        array = np.asarray(action)
        if isinstance(space, gym.spaces.Box):
            fits = array.shape == space.shape and array.dtype.kind in "iuf" and np.isfinite(array).all()
            return array if fits else None
        if isinstance(space, gym.spaces.Discrete):
            return array.item() if array.ndim == 0 and space.contains(array.item()) else None
        return array if space.contains(array) else None
    except (TypeError, ValueError, OverflowError):
        return None


def fitting_rows(space: gym.Space[Any], actions: Any, count: int) -> NDArray[np.bool_] | None:
    """Return which of the actions of `count` worlds, one per row, are of this space; None if the actions have
    another shape or kind."""
    try:
        if isinstance(space, gym.spaces.Dict):
            if set(actions) != set(space.spaces):
                return None
            parts = [fitting_rows(part, actions[key], count) for key, part in space.spaces.items()]
            fitting = [part for part in parts if part is not None]
            return np.all(fitting, axis=0) if len(fitting) == len(parts) else None
        array = np.asarray(actions)
    except (TypeError, ValueError):
        return None
    if array.shape != (count, *(space.shape or ())) or array.dtype.kind not in (
        "iuf" if isinstance(space, gym.spaces.Box) else "iu"
    ):
        return None
    if isinstance(space, gym.spaces.Box):
        fits = np.isfinite(array)
    else:
        options = (
            space.n if isinstance(space, gym.spaces.Discrete) else cast(gym.spaces.MultiDiscrete, space).nvec
        )
        fits = (array >= 0) & (array < options)
    rows: NDArray[np.bool_] = np.logical_and.reduce(fits.reshape(count, -1), axis=1)
    return rows


def apply_to_parts(function: Callable[..., Any], *values: Any) -> Any:
    """Apply a function to observations or actions, or to each of their parts where they are dictionaries of
    arrays."""
    if isinstance(values[0], dict):
        return {key: function(*(value[key] for value in values)) for key in values[0]}
    return function(*values)


def joined(rows: Sequence[Any]) -> Any:
    """Return observations or actions, one of each world or agent, as one with a row for each."""
    return apply_to_parts(lambda *parts: np.array(parts), *rows)


def is_canonical(usual: Any, action: Any) -> bool:
    """Return whether an action came in the form in which generated code takes it."""
    if isinstance(usual, dict):
        return all(is_canonical(part, action[key]) for key, part in usual.items())
    return type(usual) is type(action) or isinstance(action, int | np.integer)


# Goals


def recompute_rewards(agent: Agent, achieved: Goals, desired: Goals) -> NDArray[np.float64]:
    """Return the reward that each transition would have got for another goal; `achieved` and `desired` are
    (n, k), as the policy sees them.

    Raises:
        UsageError: The scenario has no goal, or the arrays have another shape.
        EvaluationError: A reward is not finite; names the term.
    """
    goal = agent.goal
    if goal is None:
        raise UsageError("this scenario has no `goal`, so its reward cannot be recomputed for another")
    size = len(goal.low)
    if achieved.ndim != 2 or achieved.shape[1] != size or achieved.shape != desired.shape:
        raise UsageError(
            f"goals of shape {achieved.shape} and {desired.shape}, where this scenario has {size} numbers in"
            " each"
        )
    values = {
        **_goal_values_in_unit(goal, goal.names("achieved"), achieved),
        **_goal_values_in_unit(goal, goal.names("desired"), desired),
    }
    values[Name("goal_reached")] = evaluate(goal.reached, values)
    total = np.zeros(len(achieved))
    for term in agent.reward:
        reward = np.broadcast_to(np.asarray(evaluate(term.scalar, values), float), total.shape)
        if not np.isfinite(reward).all():
            raise EvaluationError(f"the reward term '{term.name}' is not finite for every goal")
        # Term by term as in a step, so that the last bits agree.
        total = total + reward
    return total


def _goal_values_in_unit(goal: Goal, names: tuple[Name, ...], goals: Goals) -> dict[Name, Any]:
    """Return the columns in the unit of the goal; exactly what the names mean in a step."""
    columns = goals.astype(np.float64).T
    return {
        name: middle + half * column
        for name, middle, half, column in zip(names, goal.middles, goal.halves, columns, strict=True)
    }


# Observations


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
        if self.depth > 1:
            self.frames.reshape(self.depth, -1)[1:] = self.frames[: len(self.agent.numbers)]
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


class Observer:
    """Makes observations of one policy.

    Attributes:
        values: The names of the values that an observation is made of: its own numbers, and with a goal the
            achieved goal. The achieved goal is computed from message fields (`panda.tip.x`) if the scenario
            computes it from them; otherwise its components (`achieved.x`) must be given.
    """

    def __init__(self, program: Program) -> None:
        agent = program.agent
        self._inputs = agent.inputs
        self._goal = agent.goal
        self._unsupported = self._unsupported_for(program)
        self._achieved: dict[str, Scalar] = {}
        sent = {f"{robot.name}.{field.name}" for robot in program.robots for field in robot.from_robot.fields}
        texts = {number: entry.value.text for entry in agent.observation for number, _ in entry.value.numbers}
        if self._goal is not None:
            names = [name.full_name for name in self._goal.names("achieved")]
            signals = {
                full: value
                for entry in program.signals
                for full, value in entry.numbers
                if entry.noise is None
            }
            trees = [_from_messages(tree, sent, signals) for tree in self._goal.achieved.scalars]
            computed = [tree for tree in trees if tree is not None]
            self._achieved = dict(
                zip(names, computed if len(computed) == len(names) else map(Name, names), strict=True)
            )
            texts |= dict.fromkeys(names, self._goal.achieved.text)
        texts |= {full: signal.text for signal in program.signals for full, _ in signal.numbers}
        leaf_names = (leaf.full_name for tree in self._achieved.values() for leaf in names_in(tree))
        self.values = tuple(dict.fromkeys((*(value.name for value in self._inputs), *leaf_names)))
        self._computed = {
            name: texts[name]
            for name in self.values
            if name in texts and sent.isdisjoint((name, name.rpartition(".")[0]))
        }

    def observe(self, values: Mapping[str, float], desired: Sequence[float] | None = None) -> Any:
        """Return the observation, float32: an array, or with a goal a dictionary of arrays.

        Args:
            values: The value of each name of `values`, in its unit. A value beyond its range is clipped, as
                in an environment.
            desired: The goal, a number per component in its unit; only for a policy with a goal.

        Raises:
            UsageError: The policy sees more than present values; a name is missing or unknown; a value is not
                finite; the goal is missing or has another size.
        """
        if self._unsupported:
            raise UsageError(self._unsupported)
        goal = self._desired(desired)
        self._require_complete(values)
        numbers = [
            float(bool(values[entry.name]))
            if entry.truth
            else (scale if entry.clipped else scale_freely)(float(values[entry.name]), entry.low, entry.high)
            for entry in self._inputs
        ]
        vector = np.array(numbers, np.float32)
        if self._goal is None:
            return vector
        by_name = {Name(name): np.asarray(float(value)) for name, value in values.items()}
        achieved = [float(evaluate(tree, by_name)) for tree in self._achieved.values()]
        return {
            "observation": vector,
            "achieved_goal": np.array(scaled_goal(self._goal, achieved), np.float32),
            "desired_goal": np.array(scaled_goal(self._goal, goal), np.float32),
        }

    def _desired(self, desired: Sequence[float] | None) -> list[float]:
        goal = self._goal
        if goal is None:
            if desired is not None:
                raise UsageError("this policy has no goal; leave out `desired`")
            return []
        size = len(goal.low)
        names = f" ({', '.join(goal.components)})" if goal.components else ""
        expected = f"{counted(size, 'number')}{names}{f' in {goal.unit}' if goal.unit != '1' else ''}"
        if desired is None:
            raise UsageError(f"this policy has a goal; give it as `desired`: {expected}")
        try:
            numbers = np.asarray(desired, float)
        except (TypeError, ValueError):
            numbers = np.asarray(None, float)
        if numbers.reshape(-1).shape != (size,) or not np.isfinite(numbers).all():
            raise UsageError(f"`desired` is {str(desired)[:80]}; give {expected}, all of them finite")
        return [float(value) for value in numbers.reshape(-1)]

    def _require_complete(self, values: Mapping[str, float]) -> None:
        missing = [name for name in self.values if name not in values]
        unknown = [name for name in values if name not in self.values]
        if missing:
            texts = [
                f"{name} (no message contains it; the scenario computes `{self._computed[name]}`)"
                if name in self._computed
                else name
                for name in missing
            ]
            raise UsageError(f"the observation needs {', '.join(self.values)}; missing: {', '.join(texts)}")
        if unknown:
            raise UsageError(
                f"the observation needs {', '.join(self.values)}; unknown: {', '.join(map(str, unknown))}"
            )
        for name, number in values.items():
            try:
                is_finite = math.isfinite(number)
            except (TypeError, ValueError, OverflowError):
                raise UsageError(f"the value of {name} is {str(number)[:80]}; it must be a number") from None
            if not is_finite:
                raise UsageError(f"the value of {name} is {number}; it must be finite")

    def _unsupported_for(self, program: Program) -> str:
        """Return why the present values are not enough for an observation; empty if they are."""
        if program.agent.images:
            return (
                f"this policy sees the image '{program.agent.images[0].key}'; take observations from the"
                " environment"
            )
        older = next((value.name for value in self._inputs if value.steps_ago), None)
        return (
            f"this policy sees older values of {older}; take observations from the environment"
            if older
            else ""
        )


def _from_messages(tree: Scalar, sent: set[str], signals: Mapping[str, Scalar]) -> Scalar | None:
    """Return the tree over full names of the fields that are `sent`, through `signals`; None if it reads
    something else."""
    match tree:
        case Const():
            return tree
        case Name():
            full = tree.full_name
            if tree.name in sent:
                return Name(full)
            return _from_messages(signals[full], sent, signals) if full in signals else None
        case Op(op=name, args=args):
            sent_args = [
                sent_arg for arg in args if (sent_arg := _from_messages(arg, sent, signals)) is not None
            ]
            return Op(name, tuple(sent_args)) if len(sent_args) == len(args) else None
    return None


# Actions of a policy for several rows


Array = NDArray[Any]

FORWARD_BATCH_SIZE = 8
"""The number of rows of a forward pass. A pass of a small policy takes about 0.1 ms for any number of rows up
to 16; more worlds than 8 gain little."""


class Predictor(Protocol):
    """A policy: actions for rows of observations, and the memory of a recurrent policy after them."""

    takes_masks: bool

    def predict(
        self,
        observation: Any,
        state: Any = None,
        episode_start: Any = None,
        deterministic: bool = False,
        action_masks: Any = None,
    ) -> tuple[Any, Any]: ...


class ForwardPass:
    """The observations of one forward pass. Rows of worlds that do not run keep their last values.

    If the policy takes action masks, `masks` has which of the `choices` of each row are allowed. A recurrent
    policy has a `memory` for each row, which is reset where `starts` is true because an episode begins.
    """

    def __init__(self, space: gym.Space[Any], choices: int | None, size: int = FORWARD_BATCH_SIZE) -> None:
        self.memory: Any = None
        self.starts = np.ones(size, dtype=bool)
        self.masks: Array | None = None if choices is None else np.ones((size, choices), dtype=bool)
        self.observations: Any = (
            {key: _zeros(part, size) for key, part in space.spaces.items()}
            if isinstance(space, gym.spaces.Dict)
            else _zeros(space, size)
        )

    def predict(self, policy: Predictor, *, deterministic: bool) -> Any:
        """Return an action for each row."""
        actions, self.memory = policy.predict(
            self.observations, self.memory, self.starts, deterministic, self.masks
        )
        self.starts[:] = False
        return actions

    def put_all(self, observations: Any, worlds: slice, masks: Array | None) -> None:
        """Put the rows of these worlds of a batch, from the first row on."""
        count = worlds.stop - worlds.start
        if self.masks is not None and masks is not None:
            self.masks[:count] = masks[worlds]
        if isinstance(self.observations, dict):
            for key, rows in self.observations.items():
                rows[:count] = observations[key][worlds]
        else:
            self.observations[:count] = observations[worlds]

    def put(self, row: int, observation: Any, masks: Array | None) -> None:
        """Put one row."""
        if self.masks is not None and masks is not None:
            self.masks[row] = masks
        if isinstance(self.observations, dict):
            for key, rows in self.observations.items():
                rows[row] = observation[key]
        else:
            self.observations[row] = observation


def _zeros(space: gym.Space[Any], rows: int) -> Array:
    return np.zeros((rows, *(space.shape or ())), dtype=space.dtype)
