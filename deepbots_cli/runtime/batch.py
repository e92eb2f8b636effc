"""The supervisor of a batch: many worlds of one scenario, acted on, observed and scored as arrays.

Each world of a batch is a single world with its supervisor, which resets it. Generated code for a batch
computes each step over columns, arrays with one number per world. When an episode begins, the batch copies
the state of the single world into the columns: memories of functions, drawn parameters, readings. A function
without a form over columns is called in each single world in turn (`PerWorldCall`).
"""

from __future__ import annotations

import operator
import warnings
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Sequence
from functools import reduce
from operator import itemgetter
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from deepbots_cli.errors import EngineError, EvaluationError
from deepbots_cli.port import BatchEngine
from deepbots_cli.program import generated
from deepbots_cli.program.robots import Direction, Sensor
from deepbots_cli.runtime.columns import BatchMemory, stacked
from deepbots_cli.runtime.controllers import RobotController
from deepbots_cli.runtime.copies import CopyResult, result_of_all
from deepbots_cli.runtime.devices import BatchDevice, stack_worlds
from deepbots_cli.runtime.messages import LossyChannel
from deepbots_cli.runtime.spaces import by_part, frame_indices, joined, mask_of_space
from deepbots_cli.runtime.supervisor import Supervisor

Column = NDArray[Any]
NOT_FINITE = "not_finite"
"""How an episode ends whose world is no longer finite."""


class BatchStep(NamedTuple):
    """The result of a step, one row per agent, or one per world; observations are those that the agent acts
    on next.

    `terms` has a row per term of the reward and a column per agent. `done` holds the numbers of the rows
    whose episode ended, `final_observations` their last observations, `infos` their infos. Their next
    episodes have begun.
    """

    observations: Any
    rewards: Column
    terms: Column
    terminated: Column
    truncated: Column
    done: Column
    final_observations: Any
    infos: list[dict[str, Any]]


class LostWorld(NamedTuple):
    """A world that was no longer finite: its number, the seed of its random generators, the step of its
    episode, and the error."""

    world: int
    seed: int
    step: int
    error: str

    def __str__(self) -> str:
        return (
            f"world {self.world} (seed {self.seed}) became infinite or NaN in step {self.step} and was reset"
        )


class EpisodeHistory(NamedTuple):
    """The running episode of a world: its seed or the states of its random generators when it began, and the
    actions since then.

    Physics engines have no exact snapshot. An episode is brought back by the same start and the same actions.
    """

    start: int | dict[str, Any]
    actions: list[Any]


class PerWorldCall:
    """Asks the single worlds in turn: functions that take and give single numbers, over columns."""

    def __init__(self, functions: Sequence[Callable[..., Any]], engine: BatchEngine) -> None:
        self._functions, self._engine = functions, engine

    def __call__(self, *arguments: Any) -> Any:
        if not arguments:
            return stack_worlds([function() for function in self._functions])
        rows = zip(*(_rows(argument, len(self._functions)) for argument in arguments), strict=True)
        chosen = self._engine.write_mask
        by_world = [
            function(*row) if chosen is None or chosen[world] else None
            for world, (function, row) in enumerate(zip(self._functions, rows, strict=True))
        ]
        return None if by_world[0] is None else stack_worlds(by_world)


def _rows(argument: Any, count: int) -> list[Any]:
    """A column, or a vector of columns, as one number or list per world."""
    if isinstance(argument, np.ndarray):
        return list(argument.T.tolist())
    if isinstance(argument, (tuple, list)):
        return list(stacked(argument, count).T.tolist())
    return [argument] * count


class BatchChannel:
    """A channel that delivers each message in the timestep in which it was sent; all formats carry numbers
    exactly."""

    def __init__(self) -> None:
        self._message: Any = ()

    def send(self, message: Any) -> None:
        self._message = message

    def receive(self) -> Any:
        return self._message


class BatchLossyChannel:
    """A channel on which messages come late or are lost: those of the single worlds, in turn."""

    def __init__(self, channels: Sequence[LossyChannel], batch: BatchSupervisor) -> None:
        self._channels, self._batch = channels, batch

    @property
    def age(self) -> Column:
        return np.array([channel.age for channel in self._channels])

    @property
    def message_received(self) -> Column:
        return np.array([channel.message_received for channel in self._channels])

    def send(self, message: Any) -> None:
        count = len(self._channels)
        messages = (
            zip(*(_rows(field, count) for field in message), strict=True) if message else iter([()] * count)
        )
        running = self._batch.running
        for world, (channel, one) in enumerate(zip(self._channels, messages, strict=True)):
            if running is None or running[world]:
                channel.send(one)

    def newest(self) -> Any:
        return [
            stack_worlds(values)
            for values in zip(*(channel.newest() for channel in self._channels), strict=True)
        ]

    def receive(self) -> Iterator[Any]:
        """First the first message of each world that got one, then the second; meanwhile motors of the others
        are left alone."""
        arrived = [channel.receive() for channel in self._channels]
        for number in range(max(map(len, arrived))):
            having = np.array([len(messages) > number for messages in arrived])
            usual = arrived[int(having.argmax())][number]
            messages = [messages[number] if len(messages) > number else usual for messages in arrived]
            self._batch.engine.write_mask = having
            yield [stack_worlds(values) for values in zip(*messages, strict=True)]
        self._batch.engine.write_mask = None


class _BatchPart:
    """Base of supervisor and controllers, which take over from those of the single worlds when an episode
    begins."""

    STATE: tuple[str, ...] = ()
    """The attributes whose columns begin with what the single worlds have: drawn values, and values that the
    next step reads."""

    def __init__(self, singles: Sequence[Any], batch: BatchSupervisor) -> None:
        self._singles, self._batch = singles, batch
        self._loaded: list[BatchMemory | BatchDevice] = []

    def each(self, attribute: str) -> PerWorldCall:
        """A call of the attribute of this name of each single world."""
        return PerWorldCall([getattr(single, attribute) for single in self._singles], self._batch.engine)

    def memory(self, attribute: str) -> BatchMemory:
        """The memory of a stateful function."""
        memory = BatchMemory(
            [getattr(single, attribute) for single in self._singles], lambda: self._batch.engine.write_mask
        )
        self._loaded.append(memory)
        return memory

    def take_over(self, worlds: Sequence[int]) -> None:
        """Begin with what the single worlds began with."""
        for part in self._loaded:
            for world in worlds:
                part.load(world)
        self._take_columns(worlds, self.STATE)

    def _take_columns(self, worlds: Sequence[int], names: Sequence[str]) -> None:
        count = len(self._singles)
        for name in names:
            values = np.array([getattr(self._singles[world], name) for world in worlds]).T
            is_new = len(worlds) == count or not hasattr(self, name)
            column = (
                np.zeros((*values.shape[:-1], count), values.dtype)
                if is_new
                else columns_array(getattr(self, name), count)
            )
            column[..., worlds] = values
            setattr(self, name, column)


def columns_array(value: Any, count: int) -> Column:
    """A column or a vector of columns as an array that can be written."""
    if isinstance(value, (tuple, list)):
        return stacked(value, count)
    return np.array(np.broadcast_to(value, (*np.shape(value)[:-1], count)))


class BatchController(_BatchPart):
    """Base of the generated controllers of robots."""

    def __init__(self, singles: Sequence[RobotController], batch: BatchSupervisor) -> None:
        super().__init__(singles, batch)
        self.devices: dict[str, BatchDevice] = {}
        self.bind(batch.engine)

    def bind(self, engine: BatchEngine) -> None:
        """Take readers and writers from the engine."""

    def device(self, name: str) -> BatchDevice:
        """The devices behind a sensor."""
        sensor: Sensor = next(sensor for sensor in self._singles[0].spec.sensors if sensor.name == name)
        device = BatchDevice(
            [single.devices[name] for single in self._singles],
            sensor,
            self._singles[0].spec.name,
            self._batch,
        )
        self._loaded.append(device)
        self.devices[name] = device
        return device

    def observe(self) -> None:
        """Sample what is sampled once per tick."""


class BatchSupervisor(_BatchPart, ABC):
    """Base of the generated supervisors of a batch, over single supervisors and the engine that holds all of
    their worlds.

    A row of columns, observations and actions is an agent. Where worlds have copies of a robot, each world
    has a row for each copy, and the episode ends for all of them when it ends for one. `by_world` turns rows
    into what the single worlds take and give.
    """

    TERMS: tuple[str, ...] = ()

    def __init__(self, singles: Sequence[Supervisor], engine: BatchEngine) -> None:
        super().__init__([agent for single in singles for agent in single.agents.values()], self)
        first: Supervisor = self._singles[0]
        self.singles, self.engine, self.scenario, self.count = (
            singles,
            engine,
            first.scenario,
            len(self._singles),
        )
        self.copies = self.count // len(singles)
        """The rows of a world."""
        self._has_copies = self.scenario.agent.copies is not None
        self.observation_space, self.action_space = first.observation_space, first.action_space
        self.controllers: dict[str, BatchController] = {}
        self.channels: dict[tuple[str, str], BatchChannel | BatchLossyChannel] = {}
        self.losses: list[LostWorld] = []
        """The worlds that were no longer finite, in the order in which it was noticed."""
        self._errors: dict[int, str] = {}
        self._starts: list[int | dict[str, Any]] = [0] * len(singles)
        self._first = np.zeros(len(singles), int)
        """Of each world, how its episode began, and the place of its first action in `_actions`, those of all
        worlds (`by_world`)."""
        self._actions: list[Any] = []
        self._views = frame_indices(self.scenario.agent)
        self.depth, self.newest = len(self._views), 0
        self.frames = np.zeros((self.depth, len(self.scenario.agent.numbers), self.count), np.float32)
        self._ranges = len(self.scenario.agent.range_names)
        size = len(self.scenario.agent.goal.low) if self.scenario.agent.goal else 0
        self.goal = np.zeros((2 * size, self.count), np.float32)
        self._size = size
        choices = self.scenario.agent.choices
        self.forbids_options = any(option.forbidden for part in choices for option in part.options)
        self._allowed = {part.name: np.ones((len(part.options), self.count), bool) for part in choices}
        """Which options of each choice may be chosen next, a row per option."""
        self._forget()
        self.bind(engine)

    def _forget(self) -> None:
        count = self.count
        self.running: Column | None = None
        """The rows that take part in this tick, as truth values; None for all. `_acting` are those of the
        step."""
        self._acting: Column | None = None
        self.step_count, self.timestep_count = np.zeros(count, np.int64), np.zeros(count, np.int64)
        self.reward: Any = np.zeros(count)
        self.previous_reward: Any = np.zeros(count)
        self.episode_return: Any = np.zeros(count)
        self.terminated, self.truncated, self.is_success, self._lost = (
            np.zeros(count, bool) for _ in range(4)
        )
        self._holds: dict[str, Column] = {}
        self._limit = ""
        self._fresh = [True] * count

    # What `bind` makes

    @abstractmethod
    def bind(self, engine: BatchEngine) -> None:
        """Take readers from the engine."""

    @abstractmethod
    def _advance(self, action: Any) -> None:
        """One step of all worlds: act, let them go on, and observe."""

    def robot(self, name: str, controller: type[BatchController]) -> Any:
        """The controllers of a robot."""
        robot = self.controllers[name] = controller(
            [single.controllers[name] for single in self._singles], self
        )
        return robot

    def channel(self, name: str, direction: Direction) -> BatchChannel:
        """The paths of messages to or from a robot, where they are direct."""
        channel = self.channels[name, direction] = BatchChannel()
        return channel

    def lossy_channel(self, name: str, direction: Direction) -> BatchLossyChannel:
        """The paths of messages to or from a robot, where messages come late or may be lost."""
        attribute = generated.channel(name, direction)
        channel = self.channels[name, direction] = BatchLossyChannel(
            [getattr(single, attribute) for single in self._singles], self
        )
        return channel

    # Rows and worlds

    def rows_of(self, worlds: Any) -> Any:
        """The numbers of the rows of these worlds."""
        return (
            worlds
            if self.copies == 1
            else (self.copies * np.asarray(worlds)[:, None] + np.arange(self.copies)).ravel()
        )

    def by_row(self, values: Any) -> Any:
        """Actions or observations of worlds with a row per agent."""
        return by_part(lambda part: part.reshape(-1, *part.shape[2:]), values) if self._has_copies else values

    def by_world(self, values: Any) -> Any:
        """Actions or observations with a row per agent as those of worlds."""
        copies = self.copies
        return (
            by_part(lambda part: part.reshape(-1, copies, *part.shape[1:]), values)
            if self._has_copies
            else values
        )

    def step_by_world(self, step: BatchStep) -> BatchStep:
        """The result of a step with a row per world, as the single worlds give it."""
        if not self._has_copies:
            return step
        copies = self.copies
        rewards, *terms = (
            reduce(operator.add, row.reshape(-1, copies).T) / copies for row in (step.rewards, *step.terms)
        )
        terminated, truncated = (
            np.any(column.reshape(-1, copies), axis=1) for column in (step.terminated, step.truncated)
        )
        results = [
            CopyResult(float(step.rewards[row]), bool(step.terminated[row]), bool(step.truncated[row]), info)
            for row, info in zip(step.done.tolist(), step.infos, strict=True)
        ]
        return BatchStep(
            self.by_world(step.observations),
            rewards,
            np.array(terms),
            terminated,
            truncated & ~terminated,
            step.done[::copies] // copies,
            self.by_world(step.final_observations) if results else None,
            [result_of_all(results[first : first + copies]).info for first in range(0, len(results), copies)],
        )

    def _of_world(self, flags: Column) -> Column:
        """Whether a flag is set in any row of the world, for each row."""
        return flags if self.copies == 1 else flags.reshape(-1, self.copies).any(axis=1).repeat(self.copies)

    # Course

    def reset(self, seeds: Sequence[int | None], options: dict[str, Any] | None = None) -> Any:
        """Begin an episode in all worlds, each with a seed of its own or going on with its streams; the
        observations.

        Args:
            options: Values of this episode in place of draws, the same in all worlds.

        Raises:
            UsageError: A world could not draw what `options` hold. The episodes go on.
        """
        if options:
            self.singles[0].require_drawable(options)
        self._forget()
        self.begin(range(len(self.singles)), seeds, options)
        return self.observations()

    def step(self, action: Any) -> BatchStep:
        """One step of all worlds; episodes that end are followed by new ones at once.

        A world that is no longer finite is truncated by `not_finite` with a reward of 0. It begins anew, and
        is told in `losses` and as a warning.

        Raises:
            EvaluationError: An expression has no value in a world that is finite, all options of a choice are
                forbidden, or an episode would end before its first step.
        """
        losses_before = len(self.losses)
        outcome = self.advance(action)
        for loss in self.losses[losses_before:]:
            warnings.warn(str(loss), RuntimeWarning, stacklevel=3)
        if not len(outcome.done):
            return outcome
        worlds = (outcome.done[:: self.copies] // self.copies).tolist()
        self.begin(worlds, [None] * len(worlds))
        return outcome._replace(observations=self.observations())

    def advance(self, action: Any, resting: Column | None = None) -> BatchStep:
        """One step of all worlds but those that are `resting` (truth values), whose episodes have ended; no
        episode begins."""
        action = by_part(np.array, action)
        self._actions.append(self.by_world(action))
        resting = None if resting is None else resting.repeat(self.copies)
        self._acting = self.running = None if resting is None else ~resting
        with np.errstate(all="ignore"):
            self._advance(action)
        self._acting = self.running = None
        if self._lost.any():
            self._give_up()
        if self.forbids_options:
            self._require_choices(resting)
        observations, rewards, terms = self.observations(), self.rewards(), self.terms()
        terminated, truncated = self.terminated, self.truncated
        ended = self._of_world(terminated | truncated)
        done = np.flatnonzero(ended if resting is None else ended & ~resting)
        if not len(done):
            return BatchStep(observations, rewards, terms, terminated, truncated, done, None, [])
        last, infos = by_part(itemgetter(done), observations), [self.info(world) for world in done.tolist()]
        return BatchStep(observations, rewards, terms, terminated, truncated, done, last, infos)

    def begin(
        self, worlds: Sequence[int], seeds: Sequence[int | None], options: dict[str, Any] | None = None
    ) -> None:
        """Let some worlds begin episodes, each with a seed of its own or going on with its streams, and with
        the same `options`."""
        for world, seed in zip(worlds, seeds, strict=True):
            single = self.singles[world]
            self._starts[world] = single.random_state() if seed is None else seed
            single.reset(seed=seed, options=options)
        self._first[worlds] = len(self._actions)
        if (ended := int(self._first.min())) > 1000:
            del self._actions[:ended]
            self._first -= ended
        self._take_over_from(worlds)

    def snapshot(self) -> list[EpisodeHistory]:
        """The running episode of each world, from which `restore` goes on; its size is proportional to the
        number of actions."""
        begun = enumerate(zip(self._starts, self._first, strict=True))
        return [
            EpisodeHistory(start, [by_part(itemgetter(w), each) for each in self._actions[first:]])
            for w, (start, first) in begun
        ]

    def start_of(self, world: int) -> int | dict[str, Any]:
        """How the running episode of a world began."""
        return self._starts[world]

    def restore(
        self, episodes: Sequence[EpisodeHistory], on_step: Callable[[Column], None] = lambda acting: None
    ) -> Any:
        """Bring the worlds back to the moment of a snapshot, exactly: each episode begins again and repeats
        its actions.

        All end in the same step, so that short ones begin late. `on_step` is called after each step with the
        rows that repeated an action in it, as truth values.

        Returns:
            The observations.
        """
        last = max(len(episode.actions) for episode in episodes)
        idle = next((episode.actions[0] for episode in episodes if episode.actions), None)
        self._forget()
        self._actions = []
        for step in range(last + 1):
            begun = [world for world, episode in enumerate(episodes) if step == last - len(episode.actions)]
            for start, single in ((episodes[world].start, self.singles[world]) for world in begun):
                if isinstance(start, dict):
                    single.set_random_state(start)
                single.reset(seed=None if isinstance(start, dict) else start)
            if begun:
                self._take_over_from(begun)
            if step < last:
                places = [step - last + len(episode.actions) for episode in episodes]
                rows = [
                    episode.actions[place] if place >= 0 else idle
                    for place, episode in zip(places, episodes, strict=True)
                ]
                self._actions.append(joined(rows))
                with np.errstate(all="ignore"):
                    self._advance(self.by_row(self._actions[-1]))
                on_step((np.array(places) >= 0).repeat(self.copies))
        self._starts = [episode.start for episode in episodes]
        self._first = np.array([last - len(episode.actions) for episode in episodes])
        return self.observations()

    def _take_over_from(self, worlds: Sequence[int]) -> None:
        """Go on from what single worlds have begun with."""
        self.engine.begin_episodes(list(worlds))
        rows = list(self.rows_of(worlds))
        for part in (self, *self.controllers.values()):
            part.take_over(rows)
        for row in rows:
            single = self._singles[row]
            self.frames[:, :, row] = single.frames[: self.frames.shape[1]]
            self.goal[:, row] = single.goal
            if self.forbids_options:
                for mask, allowed in zip(self._allowed.values(), single.allowed(), strict=True):
                    mask[:, row] = allowed
        counts = ("step_count", "timestep_count", "reward", "previous_reward", "episode_return")
        ends = ("terminated", "truncated")
        for name in (*counts, *ends, "is_success", "_lost"):
            column = columns_array(getattr(self, name), self.count)
            column[rows] = 0
            setattr(self, name, column)

    def _give_up(self) -> None:
        """End the episodes of worlds that are no longer finite."""
        lost = self._lost
        for world in np.flatnonzero(lost[:: self.copies]).tolist():
            error = self._errors.pop(world, "the state became infinite or NaN")
            self.losses.append(
                LostWorld(
                    world, self.singles[world].streams.root, int(self.step_count[world * self.copies]), error
                )
            )
        self.reward = np.where(lost, 0.0, self.reward)
        self.terminated, self.truncated = self.terminated & ~lost, self.truncated | lost
        self.is_success = self.is_success & ~lost
        self.frames[:, :, lost] = 0.0

    def info(self, row: int) -> dict[str, Any]:
        """The info of a row for the last step of an episode, as its agent gives it."""
        held = (
            tuple(name for name, column in self._holds.items() if column[row]) if self.terminated[row] else ()
        )
        if self.truncated[row]:
            held = (NOT_FINITE if self._lost[row] else self._limit,)
        terms = {
            name: float(np.broadcast_to(getattr(self, generated.term(name)), self.count)[row])
            for name in self.TERMS
        }
        info = {
            "is_success": bool(self.is_success[row]),
            "ended_by": held[0] if held else None,
            "endings": held,
        }
        masks = {"action_mask": self.action_mask(row)} if self.forbids_options else {}
        return {**info, **masks, "reward_terms": terms}

    def rewards(self) -> Column:
        """The rewards of the last step, a copy."""
        return np.array(np.broadcast_to(self.reward, self.count), float)

    def terms(self) -> Column:
        """The terms of the last rewards, a row each; a copy."""
        terms = np.zeros((len(self.TERMS), self.count))
        for row, name in zip(terms, self.TERMS, strict=True):
            row[:] = getattr(self, generated.term(name))
        return terms

    def observations(self) -> Any:
        """The observations, float32, a row per agent; a copy."""
        frames = self.frames.reshape(-1, self.count)
        seen = np.ascontiguousarray(frames[self._views[self.newest]].T)
        if not self._size:
            return seen
        goals = np.ascontiguousarray(self.goal.T)
        return {
            "observation": seen,
            "achieved_goal": goals[:, : self._size].copy(),
            "desired_goal": goals[:, self._size :].copy(),
        }

    def action_masks(self) -> Column:
        """`Supervisor.action_masks` of each agent, a row each; a copy."""
        return np.concatenate(list(self._allowed.values())).T.copy()

    def action_mask(self, rows: Any = slice(None)) -> Any:
        """`Supervisor.action_mask` of some agents, with a row for each in each array."""
        return mask_of_space(
            self.action_space, [mask.T[rows].astype(np.int8) for mask in self._allowed.values()]
        )

    def close(self) -> None:
        """Release all worlds."""
        for single in self.singles:
            single.close()
        self.engine.close()

    # What generated code calls

    def physics(self, substeps: int) -> None:
        """Let the worlds go on; those that are no longer finite are set aside until the end of the step."""
        self.engine.step(substeps, self.running)
        lost = self.engine.non_finite_worlds()
        if len(lost):
            self._lost = self._lost.copy()
            self._lost[self.rows_of(lost)] = True
            for world in lost.tolist():
                member = self.engine.members[world]
                try:
                    member.require_finite()
                except EngineError as error:
                    self._errors[world] = str(error)
                member.reset()  # so that nothing that reads it fails
            self.engine.begin_episodes(lost.tolist())

    def ranges(self, action: Any) -> Column:
        """The numbers of an action, a column each, within [-1, 1]."""
        columns: Column = np.clip(np.asarray(action, float), -1.0, 1.0).T
        return columns

    def add(self, column: Any, more: Any) -> Any:
        """The sum, in worlds whose episode goes on."""
        return self._where_running(column + more, column)

    def _where_running(self, now: Any, before: Any) -> Any:
        return now if self.running is None else np.where(self.running, now, before)

    def ticks(self, count: int) -> Iterator[None]:
        """The ticks of a step; only worlds whose episode goes on take part in the later ones."""
        for number in range(count):
            yield
            if number < count - 1:
                goes_on = ~self._of_world(self.terminated | self.truncated | self._lost)
                if self._acting is not None:
                    goes_on &= self._acting
                self.running = None if goes_on.all() else goes_on
                if not goes_on.any():
                    break
        self.running = self._acting

    def redraw(self, due: Any, draw: Callable[[Any], None], *names: str) -> None:
        """Let the single worlds that are due draw values anew."""
        rows = np.flatnonzero(
            np.broadcast_to(due if self.running is None else due & self.running, self.count)
        ).tolist()
        for row in rows:
            single = self._singles[row]
            single.step_count, single.timestep_count = (
                int(self.step_count[row]),
                int(self.timestep_count[row]),
            )
            draw(single)
        if rows:
            self._take_columns(rows, names)

    def normals(self, stream: str, count: int) -> Column:
        """Standard normal numbers, a column each."""
        running = self.running
        drawn = np.zeros((count, self.count))
        for row, single in enumerate(self._singles):
            if running is None or running[row]:
                drawn[:, row] = single.streams[stream].standard_normal(count)
        return drawn

    def set_observation(self, *numbers: Any) -> None:
        """Let the policies see these numbers in the newest frame."""
        frame = self.frames[self.newest]
        for row, number in zip(frame, numbers, strict=True):
            if self.running is None:
                row[:] = number
            else:
                np.copyto(row, np.broadcast_to(number, self.count), where=self.running, casting="same_kind")
        if not np.isfinite(frame).all():
            worlds = np.flatnonzero(~np.isfinite(frame).all(axis=0) & ~self._lost)
            if len(worlds):
                rows = np.flatnonzero(~np.isfinite(frame).all(axis=1))
                names = ", ".join(dict.fromkeys(self.scenario.agent.numbers[row].name for row in rows))
                raise self._failed(int(worlds[0]), f"the observation {names} is not finite")

    def allow(self, choice: str, *allowed: Any) -> None:
        """Let some options of a choice be allowed next: a column of truth values for each."""
        for row, may in zip(self._allowed[choice], allowed, strict=True):
            row[:] = self._where_running(may, row)

    def _require_choices(self, resting: Column | None) -> None:
        """Raise: EvaluationError: Every option of a choice is forbidden in a world whose episode goes on."""
        for name, mask in self._allowed.items():
            stuck = ~(
                mask.any(axis=0) | self.terminated | self.truncated | (False if resting is None else resting)
            )
            if stuck.any():
                options = next(part.options for part in self.scenario.agent.choices if part.name == name)
                names = ", ".join(option.name for option in options)
                raise self._failed(int(stuck.argmax()), f"every option of '{name}' is forbidden: {names}")

    def next_frame(self) -> None:
        """Make room for what the policies see after this step."""
        self.newest = (self.newest + 1) % self.depth

    def set_goal_observation(self, achieved: Any, desired: Any) -> tuple[Column, Column]:
        """See `Supervisor.set_goal_observation`."""
        goal = self.scenario.agent.goal
        assert goal is not None
        low, high = (np.array(ends * 2)[:, None] for ends in (goal.low, goal.high))
        middle, half = (high + low) / 2, (high - low) / 2
        seen = np.clip((stacked((*achieved, *desired), self.count) - middle) / half, -1.0, 1.0).astype(
            np.float32
        )
        self.goal = self._where_running(seen, self.goal)
        meant = middle + half * self.goal.astype(float)
        return meant[: self._size], meant[self._size :]

    def _terminate(self, endings: dict[str, Any], *, success: Any = False) -> None:
        """End the task where one of the endings holds, of which the first counts."""
        self._holds = {
            name: self._where_running(np.broadcast_to(column, self.count), self._holds.get(name, False))
            for name, column in endings.items()
        }
        ended = np.logical_or.reduce(list(self._holds.values()))
        self.is_success = self._where_running(ended & success, self.is_success)
        self.terminated = self._where_running(ended, self.terminated)

    def _truncate(self, limit: str, reached: Any, success: Any = None) -> None:
        """Cut the episodes short that reached a limit."""
        self._limit = limit
        now = reached & ~self.terminated
        self.truncated = self._where_running(now, self.truncated)
        if success is not None:
            self.is_success = np.where(now, success, self.is_success)

    def require_finite(self, reward: Any) -> None:
        """Raise: EvaluationError: The reward of a world is not finite; names the terms."""
        wrong = ~(np.abs(reward) < 1e300) & ~self._lost
        if wrong.any() and (self.running is None or (wrong & self.running).any()):
            world = int(np.flatnonzero(wrong)[0])
            terms = [
                name
                for name, value in zip(self.TERMS, self.terms()[:, world], strict=True)
                if not np.isfinite(value)
            ]
            culprit = f"the reward term '{terms[0]}'" if terms else "the sum of the reward terms"
            raise self._failed(world, f"{culprit} is not finite")

    def _failed(self, row: int, what: str) -> EvaluationError:
        world = row // self.copies
        seed = self.singles[world].streams.root
        return EvaluationError(f"step {int(self.step_count[row])} of world {world} (seed {seed}): {what}")
