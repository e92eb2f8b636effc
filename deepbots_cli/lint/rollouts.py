"""Resets and episodes of `lint --deep`, with their measurements. They run in a process of their own
(`simulation_process`).

Every result is written at once: if an engine crashes, the last line shows how far the simulation got.
"""

from __future__ import annotations

import functools
import math
import traceback
from collections.abc import Callable, Iterator
from contextlib import closing
from dataclasses import replace
from itertools import count, islice, repeat
from math import inf
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from deepbots_cli import api
from deepbots_cli.document import Permissions
from deepbots_cli.errors import DeepbotsError, EngineError, EvaluationError
from deepbots_cli.lint.simulation import (
    HELD_RANDOM,
    HOLD_STEPS,
    IDLE,
    RANDOM,
    Activity,
    EarlyEnding,
    Entry,
    MeasuredOverlap,
    NumberStatistics,
    PolicyStatistics,
    Rollout,
    Stop,
    Summary,
    TermStatistics,
    simulation_plan,
    variant_plan,
)
from deepbots_cli.lint.watches import ArmWatch, RayWatch, SpeedWatch, TiltWatch, WheelWatch
from deepbots_cli.program import Program
from deepbots_cli.program.task import SAME_OBSERVATION, idle_action
from deepbots_cli.rollout import Driver, Start, Step, steps
from deepbots_cli.rollout.source import Source
from deepbots_cli.runtime import Supervisor

_MIN_TERM_SIZE = 1e-9
"""A term of the reward has fired in a step in which its absolute value is above this."""
_FIRST_EPISODES = 2
"""The number of episodes in which the first command of each arm is checked."""
_FIRST_STEPS = 10
"""The steps within which an arm must arrive at its first command."""
_VARIANTS_LABEL = "cases and stages"


class StoppedError(Exception):
    """The error that ends the plan; its reason has been written."""


def compiled(folder: Path) -> Program:
    """Compile the scenario whose files were copied into a folder."""
    return api.compile(Source.kept(folder)).program


class Player:
    """Builds the world of a scenario and plays episodes in it. `write` takes a result, `begin_step` the
    number of the next step."""

    def __init__(
        self,
        program: Program,
        write: Callable[[Entry], None],
        begin_step: Callable[[int], None],
        permissions: Permissions,
    ) -> None:
        self._program = program
        self._write = write
        self._begin_step = begin_step
        self._permissions = permissions
        self._version = ""

    def _build(self, program: Program) -> Supervisor:
        """Raises: StoppedError: The world cannot be built, which has been written."""
        self._write(Activity("build", 0, self._version))
        try:
            return api.build(program, permissions=self._permissions)
        except DeepbotsError as error:
            self._write(Stop("build", str(error)))
            raise StoppedError from None

    def _steps(
        self, environment: Supervisor, act: Callable[[Any], Any], start: Start, longest: int
    ) -> Iterator[Step]:
        """Yield the state after the reset, then each step, whose number is written before it begins."""
        numbers = count(1)

        def numbered(observation: Any) -> Any:
            self._begin_step(next(numbers))
            return act(observation)

        return islice(steps(environment, Driver(numbered), start), longest + 1)


class Simulator(Player):
    """Carries out the plan of a scenario."""

    def __init__(
        self,
        program: Program,
        write: Callable[[Entry], None],
        begin_step: Callable[[int], None],
        permissions: Permissions,
    ) -> None:
        super().__init__(program, write, begin_step, permissions)
        self._plan = simulation_plan(program)
        self._statistics: dict[str, StepStatistics] = {}
        self._rays = RayWatch(program)
        self._wheels = WheelWatch(program)
        self._tilts = TiltWatch(program)

    def run(self) -> None:
        """Carry out the plan, until an error stops it."""
        try:
            self._check_starts()
            with closing(self._build(self._program)) as environment:
                for seed in range(self._plan.resets if self._program.reset.settle else 0):
                    self._reset(environment, seed, report=True)
                arms = ArmWatch(environment)
                if arms.actuators:
                    self._check_first_commands(environment, arms)
                self._run_episodes(environment, self._plan.rollouts, arms)
            self._run_variants()
        except StoppedError:
            return
        self._write(
            Summary(
                {
                    policy: statistics.summary()
                    for policy, statistics in self._statistics.items()
                    if policy != _VARIANTS_LABEL
                },
                self._constant_numbers(),
                self._silent(),
                [(*key, clearance) for key, clearance in self._rays.clearances.items()],
                [(*key, depth) for key, depth in self._rays.depths.items() if 0.0 < depth < inf],
                self._wheels.robots,
                {name: tilt for name, (_, tilt) in self._tilts.tilts.items()},
            )
        )

    def _begin(self, activity: str, seed: int) -> None:
        self._write(Activity(activity, seed, self._version))

    # Starts

    def _check_starts(self) -> None:
        """Find bodies that overlap before anything moves, thus before the world settles."""
        deepest: dict[tuple[str, str], MeasuredOverlap] = {}
        program = replace(self._program, reset=replace(self._program.reset, settle=0.0))
        with closing(self._build(program)) as environment:
            for seed in range(self._plan.resets):
                self._reset(environment, seed, report=not self._program.reset.settle)
                for pair in environment.engine.overlaps():
                    bodies = pair.one[0], pair.other[0]
                    if pair.depth > (deepest[bodies].depth if bodies in deepest else 0.0):
                        deepest[bodies] = MeasuredOverlap(pair.one, pair.other, pair.depth, seed)
        for overlap in deepest.values():
            self._write(overlap)

    def _reset(self, environment: Supervisor, seed: int, *, report: bool) -> None:
        """Reset; with `report`, write whether an ending already holds."""
        self._begin("reset", seed)
        try:
            environment.reset(seed=seed)
        except DeepbotsError as error:
            if not (isinstance(error, EvaluationError) and environment.terminated):
                raise self._stopped(environment, error) from None
            if report and environment.ended_by is not None:
                self._write(EarlyEnding(environment.ended_by, seed))

    def _check_first_commands(self, environment: Supervisor, arms: ArmWatch) -> None:
        """Check whether arms reach their first commanded pose. Every choice should lead to one; the end of a
        range need not."""
        policy = IDLE if idle_action(self._program.agent.action) is not None else RANDOM
        if policy == RANDOM and self._program.agent.ranges:
            return
        for seed in range(_FIRST_EPISODES):
            arms.is_watching = True
            self._begin(policy, seed)
            try:
                for _ in self._planned_steps(environment, Rollout(policy, seed, _FIRST_STEPS)):
                    if arms.commands:
                        break
            except DeepbotsError:  # reported by the episodes that follow
                pass
            self._write_misses(arms, policy, seed)

    def _write_misses(self, arms: ArmWatch, policy: str, seed: int) -> None:
        arms.is_watching = False
        for miss in arms.take_misses(policy, seed):
            self._write(miss)

    # Episodes

    def _run_episodes(
        self,
        environment: Supervisor,
        rollouts: tuple[Rollout, ...],
        arms: ArmWatch | None = None,
        counted_as: str | None = None,
    ) -> None:
        for rollout in rollouts:
            random_steps = sum(
                statistics.steps
                for policy, statistics in self._statistics.items()
                if policy in (RANDOM, HELD_RANDOM)
            )
            if (
                counted_as is None
                and rollout.policy in (RANDOM, HELD_RANDOM)
                and random_steps >= self._plan.min_random_steps
            ):
                continue
            statistics = self._statistics.setdefault(
                counted_as or rollout.policy, StepStatistics(self._program)
            )
            self._begin(rollout.policy, rollout.seed)
            if arms is not None:
                arms.is_watching = rollout.script is not None
            try:
                self._episode(environment, rollout, statistics, report=counted_as is None)
            except DeepbotsError as error:
                if (
                    isinstance(error, EvaluationError)
                    and environment.step_count == 0
                    and environment.terminated
                ):
                    continue  # reported by its reset
                raise self._stopped(environment, error) from None
            finally:
                if arms is not None:
                    self._write_misses(arms, rollout.policy, rollout.seed)

    def _episode(
        self, environment: Supervisor, rollout: Rollout, statistics: StepStatistics, *, report: bool
    ) -> None:
        episode_steps = self._planned_steps(environment, rollout)
        next(episode_steps)
        speeds = SpeedWatch(environment)
        check_rays = self._rays.watch(environment)
        check_wheels = (
            self._wheels.watch(environment.engine) if report else lambda: None
        )  # a case may have another robot file
        if report:
            self._tilts.begin(environment.engine, is_idle=rollout.policy == IDLE)
        statistics.episodes += 1
        for step in episode_steps:
            statistics.add(step.observation, step.info["reward_terms"])
            check_rays()
            check_wheels()
            self._tilts.check(step.number * environment.scenario.period)
            violation = speeds.check(step.number * environment.scenario.period)
            if speeds.new_maximum:
                self._write(speeds.new_maximum)
            if violation:
                self._write(violation)
                raise StoppedError
            if not environment.observation_space.contains(step.observation):
                self._write(Stop("space", numbers=_outside(environment, step.observation)))
                raise StoppedError
        self._tilts.close()

    def _planned_steps(self, environment: Supervisor, rollout: Rollout) -> Iterator[Step]:
        actions = _actions(environment, rollout)
        return self._steps(environment, lambda _: next(actions), Start(rollout.seed), rollout.steps)

    # What has been constant so far

    def _constant_numbers(self) -> list[int]:
        """Return the places of the numbers of the observation that were the same in every step of every
        episode; pictures after them."""
        total = functools.reduce(
            StepStatistics.joined, self._statistics.values(), StepStatistics(self._program)
        )
        return [
            index
            for index in range(len(self._program.agent.numbers) + len(self._program.agent.images))
            if not total.varies(index)
        ]

    def _silent(self) -> list[int]:
        """Return the places of the terms of the reward that were always 0."""
        return [
            index
            for index in range(len(self._program.agent.reward))
            if not any(statistics.fired[index] for statistics in self._statistics.values())
        ]

    def _run_variants(self) -> None:
        """Run cases and stages, which may vary values that are constant in the scenario itself."""
        base, *others = self._program.versions.items()
        for self._version, program in others:
            if not self._constant_numbers() and not self._silent():
                return
            sizes = [
                (len(agent.numbers) + len(agent.images), len(agent.reward))
                for agent in (base[1].agent, program.agent)
            ]
            if sizes[0] == sizes[1]:
                with closing(self._build(program)) as environment:
                    self._run_episodes(environment, variant_plan(program), counted_as=_VARIANTS_LABEL)

    def _stopped(self, environment: Supervisor, error: DeepbotsError) -> StoppedError:
        """Write the reason why an episode stopped, and return the exception to raise."""
        lost = SpeedWatch(environment).lost()
        if lost:
            stop = Stop("lost", str(error), lost[0])
        elif isinstance(error, EngineError):
            stop = Stop("engine", str(error))
        else:
            stop = Stop("value", str(error), lines=_lines(error), terms=_infinite(environment))
        self._write(stop)
        return StoppedError()


class StepStatistics:
    """Statistics over the episodes of one policy, per number of the observation and per term of the
    reward."""

    def __init__(self, program: Program) -> None:
        self._program = program
        self._columns = program.agent.newest
        self._pictures = [entry.key for entry in program.agent.images]
        self._first: dict[str, NDArray[np.uint8]] = {}
        self._changed: set[str] = set()
        numbers, terms = len(program.agent.numbers), len(program.agent.reward)
        self.steps = self.episodes = self.rows = 0
        self.low, self.high = np.full(numbers, np.inf), np.full(numbers, -np.inf)
        self.at_low, self.at_high = np.zeros(numbers, int), np.zeros(numbers, int)
        self.sums = np.zeros(terms)
        self.sizes = np.zeros(terms)
        self.fired = np.zeros(terms, bool)
        self.least, self.greatest = np.full(terms, np.inf), np.full(terms, -np.inf)

    def add(self, observation: Any, terms: dict[str, float]) -> None:
        """Count one step; of a team there is a row for each copy."""
        self.steps += 1
        self._add_terms(np.array(list(terms.values())))
        if isinstance(observation, dict):
            for key in self._pictures:
                if (
                    key not in self._changed
                    and (observation[key] != self._first.setdefault(key, observation[key])).any()
                ):
                    self._changed.add(key)
            observation = observation.get("observation", np.zeros((1, 0)))
        for row in np.atleast_2d(observation)[:, self._columns]:
            self.rows += 1
            np.minimum(self.low, row, out=self.low)
            np.maximum(self.high, row, out=self.high)
            self.at_low += row <= -1.0
            self.at_high += row >= 1.0

    def _add_terms(self, values: NDArray[np.float64]) -> None:
        self.sums += values
        self.sizes += np.abs(values)
        self.fired |= np.abs(values) > _MIN_TERM_SIZE
        np.minimum(self.least, values, out=self.least)
        np.maximum(self.greatest, values, out=self.greatest)

    def joined(self, other: StepStatistics) -> StepStatistics:
        """Join the ranges of both. A number or a picture that is constant in each, but at different values,
        then counts as varying."""
        joined = StepStatistics(self._program)
        joined.low, joined.high = np.minimum(self.low, other.low), np.maximum(self.high, other.high)
        joined._first = self._first | other._first
        joined._changed = self._changed | other._changed
        joined._changed |= {
            key
            for key in self._first.keys() & other._first.keys()
            if not np.array_equal(self._first[key], other._first[key])
        }
        return joined

    def varies(self, index: int) -> bool:
        """Return whether an entry was not the same throughout."""
        numbers = len(self._columns)
        return (
            bool(self.high[index] - self.low[index] > SAME_OBSERVATION)
            if index < numbers
            else self._pictures[index - numbers] in self._changed
        )

    def summary(self) -> PolicyStatistics:
        """Return the statistics of all steps."""
        if not self.steps:
            return PolicyStatistics(0, 0, 0, [], [])
        numbers = zip(
            *(part.tolist() for part in (self.low, self.high, self.at_low, self.at_high)), strict=True
        )
        terms = zip(
            *(part.tolist() for part in (self.sums, self.sizes, self.least, self.greatest)), strict=True
        )
        return PolicyStatistics(
            self.steps,
            self.episodes,
            self.rows,
            [NumberStatistics(*row) for row in numbers],
            [TermStatistics(*row) for row in terms],
        )


def _actions(environment: Supervisor, rollout: Rollout) -> Iterator[Any]:
    """Return an endless sequence of actions, none of them forbidden."""
    if rollout.script is not None:
        return (environment.script(rollout.script) for _ in count())
    if rollout.policy == IDLE:
        idle = idle_action(environment.scenario.agent.action)
        assert idle is not None  # or it would not be in the plan
        return repeat(environment.make_action(*idle))
    return _random(environment, HOLD_STEPS if rollout.policy == HELD_RANDOM else 1)


def _random(environment: Supervisor, hold: int) -> Iterator[Any]:
    agent = environment.scenario.agent
    masked = agent.copies is None and any(
        option.forbidden for part in agent.action for option in getattr(part, "options", ())
    )
    for number in count():
        # An action that is held may be forbidden in the next step.
        if number % hold == 0 or masked:
            action = (
                environment.action_space.sample(environment.action_mask())
                if masked
                else environment.action_space.sample()
            )
        yield action


def _outside(environment: Supervisor, observation: Any) -> list[str]:
    """Return the numbers of an observation that are outside of its space, by name."""
    numbers = np.atleast_2d(observation["observation"] if isinstance(observation, dict) else observation)
    return [
        entry.name
        for entry, column in zip(environment.scenario.agent.inputs, numbers.T, strict=True)
        if not np.isfinite(column).all() or (entry.clipped and (np.abs(column) > 1.0).any())
    ]


def _infinite(environment: Supervisor) -> list[str]:
    if not environment.step_count:
        return []
    return [
        name for name, value in environment.get_info()["reward_terms"].items() if not math.isfinite(value)
    ]


def _lines(error: BaseException) -> list[str]:
    """Return the lines of the generated module in which an expression had no value, the innermost first."""
    raised = [error.__cause__, error] if error.__cause__ else [error]
    frames = [
        frame for exception in raised for frame in reversed(traceback.extract_tb(exception.__traceback__))
    ]
    # The lines come from `linecache`, where `codegen.load_module` registers them.
    return [frame.line or "" for frame in frames if frame.filename.startswith("<deepbots")]
