"""The supervisor of a batch: many worlds of one scenario, acted on, observed and scored as arrays; also as a
vector environment of Gymnasium.

Each world of a batch is a single world with its supervisor, which resets it. Generated code for a batch
computes each step over columns, arrays with one number per world. When an episode begins, the batch copies
the state of the single world into the columns: memories of functions, drawn parameters, readings. A function
without a form over columns is called in each single world in turn (`PerWorldCall`).
"""

from __future__ import annotations

import warnings
from abc import abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import cached_property
from operator import itemgetter
from typing import Any, NamedTuple

import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space

from deepbots_cli.engine_kinds import diagonal_of
from deepbots_cli.errors import EngineError, EvaluationError, UsageError
from deepbots_cli.geometry import Heights, ground_heights
from deepbots_cli.port import BatchEngine
from deepbots_cli.program import generated
from deepbots_cli.runtime.batch_parts import BatchController, BatchRobots, OptionMasks, columns_array
from deepbots_cli.runtime.columns import column_of, where_running
from deepbots_cli.runtime.copies import WorldRows
from deepbots_cli.runtime.messages import excerpt
from deepbots_cli.runtime.spaces import (
    Column,
    ObservedColumns,
    apply_to_parts,
    compose_rows,
    fitting_rows,
    joined,
)
from deepbots_cli.runtime.supervisor import (
    EpisodeEnds,
    LimitedSpec,
    ResetNeededError,
    Supervisor,
    infinite_reward,
    without_option,
)

__all__ = ["BatchController", "BatchStep", "BatchSupervisor", "EpisodeHistory", "LostWorld"]


NOT_FINITE = "not_finite"
"""The name of the end of an episode whose world is no longer finite."""


class BatchStep(NamedTuple):
    """The result of a step, one row per agent, or one per world; observations are those that the agent acts
    on next.

    `terms` has a row per term of the reward and a column per agent. `done` has the numbers of the rows whose
    episode ended, `final_observations` their last observations, `infos` their infos. Their next episodes have
    begun.
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
    """A world whose physics was not stable: its number, the seed of its random generators, the step of its
    episode, and the error."""

    world: int
    seed: int
    step: int
    error: str

    def __str__(self) -> str:
        return f"world {self.world} (seed {self.seed}) was reset in step {self.step}: {self.error}"


class EpisodeHistory(NamedTuple):
    """The running episode of a world: its seed or the states of its random generators when it began, the
    actions since then, and the `options` of its reset.

    Physics engines have no exact snapshot. An episode is brought back by the same start and the same actions.
    """

    start: int | dict[str, Any]
    actions: list[Any]
    options: Mapping[str, Any] | None = None


class EpisodeHistories:
    """Records the running episode of each world.

    Attributes:
        starts: The start of each episode: its seed, or the states of its random generators.
        options: The values that each episode took in place of draws.
        actions: The actions of all worlds, with a row per world; `_first` are the places of the first ones.
    """

    def __init__(self, worlds: int) -> None:
        self.starts: list[int | dict[str, Any]] = [0] * worlds
        self.options: list[Mapping[str, Any] | None] = [None] * worlds
        self.actions: list[Any] = []
        self._first = np.zeros(worlds, int)

    def begin(self, worlds: Sequence[int]) -> None:
        """Begin the episodes of some worlds with the next action; actions that no episode has are
        forgotten."""
        self._first[worlds] = len(self.actions)
        # A deletion moves all later actions, so it waits until there are many to forget.
        if (ended := int(self._first.min())) > 1000:
            del self.actions[:ended]
            self._first -= ended

    def snapshot(self) -> list[EpisodeHistory]:
        """Return the running episode of each world, from which `BatchSupervisor.restore` goes on; its size is
        proportional to the number of actions."""
        return [
            EpisodeHistory(
                start, [apply_to_parts(itemgetter(world), action) for action in self.actions[first:]], options
            )
            for world, (start, first, options) in enumerate(
                zip(self.starts, self._first, self.options, strict=True)
            )
        ]

    def replace(self, episodes: Sequence[EpisodeHistory]) -> None:
        """Take these episodes, which have ended with the last action, for the running ones."""
        self.starts = [episode.start for episode in episodes]
        self.options = [episode.options for episode in episodes]
        self._first = np.array([len(self.actions) - len(episode.actions) for episode in episodes])


def advance_and_begin(batch: Any, action: Any) -> BatchStep:
    """Advance a batch, and let episodes that end be followed by new ones; see `BatchSupervisor.step`."""
    losses_before = len(batch.losses)
    outcome: BatchStep = batch.advance(action)
    for loss in batch.losses[losses_before:]:
        # Level 4 is the caller of `BatchEnvironment.step`.
        warnings.warn(str(loss), RuntimeWarning, stacklevel=4)
    if not len(outcome.done):
        return outcome
    worlds = (outcome.done[:: batch.copies] // batch.copies).tolist()
    batch.begin(worlds, [None] * len(worlds))
    return outcome._replace(observations=batch.observations())


class BatchSupervisor(BatchRobots, ObservedColumns, EpisodeEnds):
    """Base of the generated supervisors of a batch, over single supervisors and the engine of all of their
    worlds.

    A row of columns, observations and actions is an agent. Where worlds have copies of a robot, each world
    has a row for each copy, and the episode ends for all of them when it ends for one. `rows` converts
    between rows and the values of the single worlds. `histories` are the running episodes.
    """

    TERMS: tuple[str, ...] = ()

    def __init__(self, singles: Sequence[Supervisor], engine: BatchEngine) -> None:
        agents = [agent for single in singles for agent in single.agents.values()]
        BatchRobots.__init__(self, agents, self)
        ObservedColumns.__init__(self, agents[0].agent, len(agents))
        self.singles = singles
        self.engine = engine
        self.scenario = agents[0].scenario
        self.copies = self.count // len(singles)
        """The rows of a world."""
        self.rows = WorldRows(self.copies, has_copies=self.agent.copies is not None)
        self.observation_space, self.action_space = agents[0].observation_space, agents[0].action_space
        self.losses: list[LostWorld] = []
        """The worlds that were no longer finite, in the order in which it was noticed."""
        self._errors: dict[int, str] = {}
        self.histories = EpisodeHistories(len(singles))
        choices = self.agent.choices
        self.forbids_options = any(option.forbidden for part in choices for option in part.options)
        self.options = OptionMasks(self.agent, self.count)
        self._forget()
        self.bind(engine)

    def _forget(self) -> None:
        count = self.count
        self.running: Column | None = None
        self._acting: Column | None = None
        """The rows that take part in this step."""
        self.step_count = np.zeros(count, np.int64)
        self.timestep_count = np.zeros(count, np.int64)
        self.reward: Any = np.zeros(count)
        self.previous_reward: Any = np.zeros(count)
        self.episode_return: Any = np.zeros(count)
        self.lost = np.zeros(count, bool)
        self.forget_ends()

    @abstractmethod
    def _advance(self, action: Any) -> None:
        """Advance all worlds by one step: act, simulate, and observe."""

    # Course

    def reset(self, seeds: Sequence[int | None], options: dict[str, Any] | None = None) -> Any:
        """Begin an episode in all worlds, each with a seed of its own or continuing its streams, and return
        the observations.

        Args:
            options: Values of this episode in place of draws, the same in all worlds.

        Raises:
            UsageError: A world could not draw a value of `options`. The episodes go on.
        """
        if options:
            self.singles[0].require_drawable(options)
        self.begin_all(seeds, [options] * len(self.singles))
        return self.observations()

    def begin_all(self, seeds: Sequence[int | None], options: Sequence[Mapping[str, Any] | None]) -> None:
        """Begin an episode in all worlds, as `begin` does in some."""
        self._forget()
        self.begin(range(len(self.singles)), seeds, options)

    def step(self, action: Any) -> BatchStep:
        """Advance all worlds by one step; episodes that end are followed by new ones at once.

        A world that is no longer finite, or in which a joint has an impossible speed, is truncated by
        `not_finite` with a reward of 0. It starts again, and
        is reported in `losses` and as a warning.

        Raises:
            EvaluationError: An expression has no value in a world that is finite, all options of a choice are
                forbidden, or an episode would end before its first step.
        """
        return advance_and_begin(self, action)

    def advance(self, action: Any, resting: Column | None = None) -> BatchStep:
        """Advance by one step all worlds except those that are `resting` (truth values), whose episodes have
        ended; no episode begins."""
        # A copy, because the histories keep it and a caller may use its array again.
        action = apply_to_parts(np.array, action)
        self.histories.actions.append(self.rows.by_world(action))
        resting = None if resting is None else resting.repeat(self.copies)
        self._acting = self.running = None if resting is None else ~resting
        # Columns of lost and resting worlds may be NaN; `require_finite` checks the rewards of the others.
        with np.errstate(all="ignore"):
            self._advance(action)
        self._acting = self.running = None
        if self.lost.any():
            self._give_up()
        if self.forbids_options:
            going_on = ~(self.terminated | self.truncated)
            stuck = self.options.without_option(going_on if resting is None else going_on & ~resting)
            if stuck is not None:
                raise self.failed(stuck.row, without_option(self.agent, stuck.choice))
        observations = self.observations()
        rewards = self.rewards()
        terms = self.terms()
        terminated, truncated = self.terminated, self.truncated
        ended = self.rows.any_in_world(terminated | truncated)
        ended_worlds = np.flatnonzero(ended if resting is None else ended & ~resting)
        if not len(ended_worlds):
            return BatchStep(observations, rewards, terms, terminated, truncated, ended_worlds, None, [])
        last = apply_to_parts(itemgetter(ended_worlds), observations)
        infos = [self.info(world) for world in ended_worlds.tolist()]
        return BatchStep(observations, rewards, terms, terminated, truncated, ended_worlds, last, infos)

    def begin(
        self,
        worlds: Sequence[int],
        seeds: Sequence[int | None],
        options: Sequence[Mapping[str, Any] | None] | None = None,
    ) -> None:
        """Let some worlds begin episodes, each with a seed of its own or going on with its streams, and with
        the `options` of its reset."""
        options = options or [None] * len(worlds)
        for world, seed, world_options in zip(worlds, seeds, options, strict=True):
            self.histories.starts[world] = self.singles[world].random_state() if seed is None else seed
            self.histories.options[world] = world_options
        self._begin_singles(worlds, seeds, options)
        self.histories.begin(worlds)

    def _begin_singles(
        self,
        worlds: Sequence[int],
        starts: Sequence[int | dict[str, Any] | None],
        options: Sequence[Mapping[str, Any] | None],
    ) -> None:
        """Begin episodes of single worlds, each with a seed, with states of its random generators or going on
        with its streams; they settle together. Take over their start."""
        self.engine.begin(worlds)
        for world, start, world_options in zip(worlds, starts, options, strict=True):
            if isinstance(start, dict):
                self.singles[world].set_random_state(start)
            self.singles[world].place_world(None if isinstance(start, dict) else start, world_options)
        self.engine.begin_episodes()
        for world in worlds:
            self.singles[world].observe_start()
        self._take_over_from(worlds)

    def restore(
        self,
        episodes: Sequence[EpisodeHistory],
        on_step: Callable[[Column], None] = lambda acting: None,
        *,
        on_begin: Callable[[Sequence[int]], None] = lambda worlds: None,
        complete: Callable[[Any], Any] = lambda action: action,
    ) -> Any:
        """Bring the worlds back to the moment of a snapshot, exactly: each episode begins again and repeats
        its actions.

        All end in the same step, so that short ones begin late. `on_step` is called after each step with the
        rows that repeated an action in it, as truth values.

        Args:
            on_begin: Called with the worlds whose episodes begin.
            complete: Returns the action of all agents, given the actions of the episodes.

        Returns:
            The observations.
        """
        # All episodes take part in each step of the batch. Those that begin later repeat any valid action
        # until their reset.
        last = max(len(episode.actions) for episode in episodes)
        idle = next((episode.actions[0] for episode in episodes if episode.actions), None)
        self._forget()
        self.histories.actions = []
        for step in range(last + 1):
            begun = [world for world, episode in enumerate(episodes) if step == last - len(episode.actions)]
            if begun:
                starts = [episodes[world].start for world in begun]
                self._begin_singles(begun, starts, [episodes[world].options for world in begun])
                on_begin(begun)
            if step < last:
                indices = [step - last + len(episode.actions) for episode in episodes]
                rows = [
                    episode.actions[index] if index >= 0 else idle
                    for index, episode in zip(indices, episodes, strict=True)
                ]
                action = complete(self.rows.by_row(joined(rows)))
                self.histories.actions.append(self.rows.by_world(action))
                with np.errstate(all="ignore"):
                    self._advance(action)
                on_step((np.array(indices) >= 0).repeat(self.copies))
        self.histories.replace(episodes)
        return self.observations()

    def _take_over_from(self, worlds: Sequence[int]) -> None:
        """Take over the start of an episode from single worlds."""
        rows = list(self.rows.of(worlds))
        for part in (self, *self.controllers.values()):
            part.take_over(rows)
        starts = [self._singles[row] for row in rows]
        self.frames[:, :, rows] = np.array([start.frames[: self.frames.shape[1]] for start in starts]).T
        self.goal[:, rows] = np.array([start.goal for start in starts]).T
        if self.forbids_options:
            for row, start in zip(rows, starts, strict=True):
                self.options.load(row, start.allowed())
        counts = ("step_count", "timestep_count", "reward", "previous_reward", "episode_return")
        ends = ("terminated", "truncated")
        for name in (*counts, *ends, "is_success", "lost"):
            column = columns_array(getattr(self, name), self.count)
            column[rows] = 0
            setattr(self, name, column)

    def _give_up(self) -> None:
        """End the episodes of worlds that are no longer finite."""
        lost = self.lost
        for world in np.flatnonzero(lost[:: self.copies]).tolist():
            error = self._errors.pop(world, "the state became infinite or NaN")
            self.losses.append(
                LostWorld(
                    world, self.singles[world].streams.root, int(self.step_count[world * self.copies]), error
                )
            )
        # By selection and not by a product, which stays NaN.
        self.reward = np.where(lost, 0.0, self.reward)
        self.terminated, self.truncated = self.terminated & ~lost, self.truncated | lost
        self.is_success = self.is_success & ~lost
        self.frames[:, :, lost] = 0.0
        self.goal[:, lost] = 0.0

    def info(self, row: int) -> dict[str, Any]:
        """Return the info of a row for the last step of an episode, as its agent gives it."""
        endings = (
            tuple(name for name, column in self.holds.items() if column[row]) if self.terminated[row] else ()
        )
        alone = self.agent_endings_of(row)
        if self.terminated[row] and not endings:  # the episode of the last agent has ended
            last = [end for end in alone.values() if end.step == self.step_count[row]]
            endings = tuple(dict.fromkeys(name for end in last for name in end.endings))
        if self.truncated[row]:
            endings = (NOT_FINITE if self.lost[row] else self.limit,)
        terms = {
            name: float(np.broadcast_to(getattr(self, generated.term(name)), self.count)[row])
            for name in self.TERMS
        }
        info = {
            "is_success": bool(self.is_success[row]),
            "ended_by": endings[0] if endings else None,
            "endings": endings,
        }
        masks = {"action_mask": self.options.of_space(self.action_space, row)} if self.forbids_options else {}
        ends = {"agent_endings": alone} if self.agent_ends else {}
        return {**info, **ends, **masks, "reward_terms": terms}

    @cached_property
    def ground_height(self) -> Heights:
        """The heights (m) of the ground at x, y (m) of the world frame, over columns."""
        return ground_heights(self.scenario.world.terrain, diagonal_of(self.singles[0].engine.name))

    def rewards(self) -> Column:
        """Return the rewards of the last step, a copy."""
        return np.array(column_of(self.reward, self.count), float)

    def terms(self) -> Column:
        """Return the terms of the last rewards, a row each; a copy."""
        terms = np.zeros((len(self.TERMS), self.count))
        for row, name in zip(terms, self.TERMS, strict=True):
            row[:] = getattr(self, generated.term(name))
        return terms

    def script(self, name: str) -> Any:
        """Return the next actions of a script that the batch computes, in the action space."""
        return getattr(self, generated.script(name))()

    def make_action(self, choices: Sequence[Any], ranges: Sequence[Any]) -> Any:
        """Return the actions with these options and numbers, a column each."""
        of_choices, of_ranges = (
            np.array([column_of(column, self.count) for column in columns]).reshape(-1, self.count).T
            for columns in (choices, ranges)
        )
        return compose_rows(self.action_space, of_choices, of_ranges)

    def action_masks(self) -> Column:
        """Return `Supervisor.action_masks` of each agent, a row each; a copy."""
        return self.options.by_row()

    def close(self) -> None:
        """Release all worlds."""
        for single in self.singles:
            single.close()
        self.engine.close()

    # Methods for generated code

    def physics(self, substeps: int) -> None:
        """Simulate the worlds; those that are no longer finite are set aside until the end of the step."""
        self.engine.step(substeps, self.running)
        lost = self.engine.non_finite_worlds()
        if len(lost):
            self.lost = self.lost.copy()
            self.lost[self.rows.of(lost)] = True
            for world in lost.tolist():
                member = self.engine.members[world]
                try:
                    member.require_finite()
                except EngineError as error:
                    self._errors[world] = str(error)
                member.reset()  # so that nothing that reads it fails
            self.engine.begin_episodes()

    def ranges(self, action: Any) -> Column:
        """Return the numbers of an action, a column each, within [-1, 1]."""
        columns: Column = np.clip(np.asarray(action, float), -1.0, 1.0).T
        return columns

    def add(self, column: Any, more: Any) -> Any:
        """Return the sum, in worlds whose episode goes on."""
        return where_running(self.running, column + more, column)

    def ticks(self, count: int) -> Iterator[None]:
        """Yield the ticks of a step; only worlds whose episode goes on take part in the later ones."""
        for number in range(count):
            yield
            if number < count - 1:
                goes_on = ~self.rows.any_in_world(self.terminated | self.truncated | self.lost)
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
            # Its draws read these counts, as those of a single world do.
            single.step_count = int(self.step_count[row])
            single.timestep_count = int(self.timestep_count[row])
            draw(single)
        if rows:
            self.take_columns(rows, names)

    def normals(self, stream: str, count: int) -> Column:
        """Return standard normal numbers, a column each."""
        running = self.running
        numbers = np.zeros((count, self.count))
        for row, single in enumerate(self._singles):
            if running is None or running[row]:
                numbers[:, row] = single.streams[stream].standard_normal(count)
        return numbers

    def allow(self, choice: str, *allowed: Any) -> None:
        """Let some options of a choice be allowed next: a column of truth values for each."""
        self.options.allow(choice, allowed, self.running)

    def require_finite(self, reward: Any) -> None:
        """Raise: EvaluationError: The reward of a world is not finite; names the terms."""
        # The negation also finds NaN, of which every comparison is false.
        wrong = ~(np.abs(reward) < 1e300) & ~self.lost
        if wrong.any() and (self.running is None or (wrong & self.running).any()):
            world = int(np.flatnonzero(wrong)[0])
            terms = dict(zip(self.TERMS, self.terms()[:, world], strict=True))
            raise self.failed(world, infinite_reward(terms))

    def failed(self, row: int, problem: str) -> EvaluationError:
        world = row // self.copies
        seed = self.singles[world].streams.root
        return EvaluationError(f"step {int(self.step_count[row])} of world {world} (seed {seed}): {problem}")


class BatchEnvironment(LimitedSpec, VectorEnv[Any, Any, Any]):
    """Many worlds of one scenario; observations, rewards and flags have a row per world."""

    def __init__(self, batch: BatchSupervisor) -> None:
        """Take over `batch`, and close it with this environment."""
        self.batch = batch
        self.scenario = batch.scenario
        self.num_envs = len(batch.singles)
        self.metadata = {"autoreset_mode": AutoresetMode.SAME_STEP, "render_modes": []}
        single = batch.singles[0]
        self.single_observation_space = single.observation_space
        self.single_action_space = single.action_space
        self.observation_space = batch_space(single.observation_space, self.num_envs)
        self.action_space = batch_space(single.action_space, self.num_envs)
        self._begun = False

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Begin an episode in all worlds.

        Args:
            seed: World i begins from `seed + i`, or from the i-th seed of a sequence. Without a seed, each
                world continues its random streams.
            options: Values of this episode in place of draws, the same in all worlds; see `Supervisor.reset`.

        Returns:
            The observations, and the info of Gymnasium's vector environments. Its `drawn` contains, for each
            name, an array with one value per world. If the scenario forbids choices, its `action_mask` has
            one row per world.

        Raises:
            UsageError: The number of seeds differs from the number of worlds, or a world could not draw
                `options`. The episodes continue.
        """
        if seed is None or isinstance(seed, (int, np.integer)):
            seeds: Sequence[int | None] = [
                None if seed is None else int(seed) + world for world in range(self.num_envs)
            ]
        else:
            seeds = seed
        if len(seeds) != self.num_envs:
            raise UsageError(f"{len(seeds)} seeds for {self.num_envs} worlds")
        if seeds[0] is not None:
            self.action_space.seed(seeds[0])
        observations = self.batch.rows.by_world(self.batch.reset(seeds, options))
        self._begun = True
        infos: dict[str, Any] = {}
        for world, single in enumerate(self.batch.singles):
            infos = self._add_info(infos, {"drawn": single.drawn()}, world)
        return observations, infos | self._masks()

    def _masks(self) -> dict[str, Any]:
        """Return the part of an info with the options that may be chosen next; empty if that of a single
        world has none."""
        if not self.batch.forbids_options or self.batch.scenario.agent.copies:
            return {}
        masks = self.batch.options.of_space(self.batch.action_space)
        return {"action_mask": masks, "_action_mask": np.ones(self.num_envs, bool)}

    def step(self, actions: Any) -> tuple[Any, Any, Any, Any, dict[str, Any]]:
        """Advance all worlds by one step.

        Returns:
            Observations (for ended episodes, those of the next episode), rewards (float64), terminated,
            truncated, and infos. If episodes ended, infos contain `final_obs`, `final_info` and their masks
            `_final_obs`, `_final_info` as in Gymnasium's vector environments. `action_mask` is as in `reset`.

        Raises:
            ResetNeededError: Before the first reset.
            UsageError: An action does not fit the action space; the message names the world.
            EvaluationError: An expression has no value.
        """
        if not self._begun:
            raise ResetNeededError("call reset() before step()")
        self._require_fitting(actions)
        outcome = self.batch.rows.step_by_world(
            self.batch.step(self.batch.rows.by_row(apply_to_parts(np.asarray, actions)))
        )
        infos: dict[str, Any] = {}
        if len(outcome.done):
            ended = np.zeros(self.num_envs, bool)
            ended[outcome.done] = True
            # As in Gymnasium's own vector environments: an array of objects, None where the episode goes on.
            last = np.full(self.num_envs, None, object)
            for row, world in enumerate(outcome.done):
                last[world] = apply_to_parts(itemgetter(row), outcome.final_observations)
            final: dict[str, Any] = {}
            for world, info in zip(outcome.done, outcome.infos, strict=True):
                final = self._add_info(final, info, int(world))
            infos = {"final_obs": last, "_final_obs": ended, "final_info": final, "_final_info": ended.copy()}
        return (
            outcome.observations,
            outcome.rewards,
            outcome.terminated,
            outcome.truncated,
            infos | self._masks(),
        )

    def _require_fitting(self, actions: Any) -> None:
        """Raise: UsageError: An action does not fit the action space. With 256 worlds this takes 6 us, a step
        of CartPole 15 ms."""
        fits = fitting_rows(self.single_action_space, actions, self.num_envs)
        if fits is None:
            raise UsageError(
                f"actions {excerpt(actions)} do not fit {self.num_envs} worlds of {self.single_action_space}"
            )
        if not fits.all():
            world = int(fits.argmin())
            action = excerpt(apply_to_parts(itemgetter(world), actions))
            raise UsageError(f"world {world}: action {action} does not fit {self.single_action_space}")

    def close_extras(self, **kwargs: Any) -> None:
        """Release all worlds."""
        self.batch.close()
