"""The worlds of a training, and shards: groups of these worlds, each with a copy of the policy.

The worlds of a training are in this process (`make_worlds`), or belong to shards. A `Shard` needs only the
run directory and the numbers of its worlds, so it can be created in any process with access to this
directory. `LocalShards` has its shards in this process.
"""

from __future__ import annotations

import json
import random
from collections.abc import Callable, Collection, Mapping, Sequence
from contextlib import ExitStack, closing
from dataclasses import replace
from itertools import accumulate, pairwise
from typing import Any

import numpy as np
import torch

from deepbots_cli.api import build_batch
from deepbots_cli.errors import UsageError
from deepbots_cli.learning import learner as learners
from deepbots_cli.learning.environments import (
    BatchFailureRecorder,
    EvaluationWorlds,
    FailureRecorder,
    WorldFactory,
    random_numbers_kept,
    reasons_against_batch,
)
from deepbots_cli.learning.learner import Learner, Setup
from deepbots_cli.learning.runs.curriculum import Curriculum
from deepbots_cli.learning.runs.run import Run
from deepbots_cli.learning.sb3.defaults import longest_episode
from deepbots_cli.program.task import LIMITS, SUCCESS, Training
from deepbots_cli.records import dataclass
from deepbots_cli.rollout import Episode
from deepbots_cli.rollout.collector import (
    Evaluated,
    EvaluationOrder,
    Lesson,
    LocalCollector,
    Order,
    RunningEpisode,
    ShardResult,
)
from deepbots_cli.rollout.worlds import (
    ENDED_BY_ANOTHER_COPY,
    Array,
    BatchWorlds,
    SingleWorlds,
    Worlds,
    WorldsOptions,
)
from deepbots_cli.runtime.streams import derive_seed


@dataclass(frozen=True)
class WorldPlan:
    """The worlds of a training to create: those with these `numbers`, each in a stage of the curriculum.

    `stages` changes when a world begins an episode of another stage, which is `present()` then, or of another
    level.
    """

    run: Run
    build: WorldFactory
    numbers: Sequence[int]
    stages: list[int]
    present: Callable[[], int]


def world_seed(run: Run, world: int) -> int:
    """Return the seed of the first episode of a world."""
    return derive_seed(run.record.seed, "environment", world)


def make_worlds(
    stack: ExitStack,
    plan: WorldPlan,
    *,
    on_step: Callable[[], None],
    on_episode: Callable[[int, Episode, int, Mapping[str, Any]], None],
    next_episode: Callable[[], int],
    note: Callable[[str], None],
) -> Worlds:
    """Create the worlds of a plan, which are closed with `stack`.

    Args:
        on_step: Called after the step of each row.
        on_episode: Called after each episode of a row, with the place of its world in the plan, its stage and
            the values that it drew.
        next_episode: Returns the number of the next episode of the training, for failures.
        note: Called with messages for the user.
    """
    run, stages = plan.run, plan.stages
    curriculum = Curriculum(run.program, run.record.first_stage)
    engine = run.record.engine
    seeds = [world_seed(run, number) for number in plan.numbers]
    outcomes: list[list[str]] = [[] for _ in seeds]

    def guarded(stage: int) -> FailureRecorder:
        scenario = curriculum.scenario_of(stage).with_critic
        return FailureRecorder(
            plan.build(scenario), run, scenario, episode=next_episode, stage=curriculum.name_of(stage)
        )

    def end(world: int, episode: Episode) -> None:
        outcomes[world] += outcomes_of(episode, run.program.agent.success)
        on_episode(world, episode, stages[world], env.drawn[world])

    def options(world: int) -> Mapping[str, Any] | None:
        return curriculum.options(plan.numbers[world], stages[world])

    def next_seed(world: int) -> int | None:
        """Move a world into its next stage. Returns the seed with which it begins in another scenario, else
        None."""
        before = stages[world]
        stages[world] = curriculum.following(
            before, plan.present(), outcomes[world], lambda: _level_draw(plan, env, world)
        )
        outcomes[world].clear()
        if not curriculum.begins_anew(before, stages[world]):
            return None
        return derive_seed(run.record.seed, "environment", plan.numbers[world], "stage", stages[world])

    def next_world(world: int) -> tuple[FailureRecorder, int] | None:
        seed = next_seed(world)
        return None if seed is None else (guarded(stages[world]), seed)

    shared: WorldsOptions = {"on_step": on_step, "on_episode": end, "options": options}
    env: Worlds
    if not reasons_against_batch(run.program, len(seeds), engine, plan.build):
        recorder = BatchFailureRecorder(run, guarded, next_episode, curriculum, note)
        env = BatchWorlds(
            lambda stage: build_batch(curriculum.scenario_of(stage).with_critic, len(seeds), engine=engine),
            seeds,
            None if run.program.levels else stages,
            next_seed=next_seed,
            recorder=recorder,
            **shared,
        )
    else:
        with ExitStack() as partly:  # closes the built worlds when another one cannot be built
            worlds = [partly.enter_context(closing(guarded(stage))) for stage in stages]
            partly.pop_all()
        env = SingleWorlds(worlds, seeds, next_world=next_world, **shared)
    stack.callback(env.close)
    return env


def _level_draw(plan: WorldPlan, worlds: Worlds, world: int) -> int:
    """Return a random number that depends on the episodes of a world so far, for its next level."""
    state = json.dumps(worlds.random_state_of(world), sort_keys=True)
    return derive_seed(plan.run.record.seed, "environment", plan.numbers[world], "level", state)


def outcomes_of(episode: Episode, success: Collection[str]) -> list[str]:
    """Return the outcome of an episode for levels; none if a copy of the robot did not end it itself.

    `success` has the endings that are a success; another limit is one if the goal is reached.
    """
    if episode.ended_by is None or episode.ended_by == ENDED_BY_ANOTHER_COPY:
        return []
    is_reached = episode.is_success and episode.ended_by in LIMITS and episode.ended_by not in success
    return [SUCCESS if is_reached else episode.ended_by]


class Shard:
    """Some worlds of a training with a copy of its policy.

    Args:
        run: The run.
        build: Makes a world.
        number: The number of the shard, from 0.
        worlds: The numbers of its worlds.
    """

    def __init__(self, run: Run, build: WorldFactory, number: int, worlds: Sequence[int]) -> None:
        training = run.program.agent.training
        if training is None:
            raise UsageError(f"{run.program.name} has no `train` section")
        # A CPU gives the same numbers on every machine of a kind.
        self._training = replace(training, device="cpu")
        self._run = run
        self._build = build
        self._number = number
        self._numbers = worlds
        self._stack = ExitStack()
        self._ended: list[tuple[int, Mapping[str, Any]]] = []
        self._notes: list[str] = []
        self._stage = 0
        self._next_episode = 1
        self._policy: Learner | None = None
        self._evaluation = EvaluationWorlds(build, run)

    def work(
        self,
        order: Order | EvaluationOrder | None,
        memory: Mapping[str, Array],
        episodes: Sequence[RunningEpisode] | None,
    ) -> Any:
        """Bring the worlds to the end of `episodes`, if there are some. Returns the answer to the order, or
        the observations without one."""
        observations = None if episodes is None else self.begin(episodes)
        if order is None:
            return observations
        return self.evaluate(order) if isinstance(order, EvaluationOrder) else self.collect(order, memory)

    def begin(self, episodes: Sequence[RunningEpisode]) -> Any:
        """Bring the worlds to the end of these episodes. Returns the observations."""
        self._stack.close()
        self._stages = [episode.stage for episode in episodes]
        plan = WorldPlan(self._run, self._build, self._numbers, self._stages, lambda: self._stage)
        worlds = make_worlds(
            self._stack,
            plan,
            on_step=lambda: None,
            on_episode=lambda world, episode, stage, draws: self._ended.append((stage, draws)),
            next_episode=lambda: self._next_episode + len(self._ended),
            note=self._notes.append,
        )
        self._collector = LocalCollector(worlds)
        if self._policy is None:
            self._action_space = worlds.action_space
            with random_numbers_kept():
                self._policy = self._make_policy(worlds)
        return self._collector.repeat([episode.history for episode in episodes])

    def _make_policy(self, worlds: Worlds) -> Learner:
        """Return a copy of the policy, for the rows of these worlds."""
        setup = Setup(
            self._training,
            worlds.observation_space,
            worlds.action_space,
            total_timesteps=self._training.total_timesteps,
            longest_episode=longest_episode(self._run.program),
            rows=worlds.rows,
            policy_columns=self._run.program.with_critic.agent.policy_columns,
            program=self._run.program,
        )
        return learners.create(setup)

    def collect(self, order: Order, memory: Mapping[str, Array]) -> ShardResult:
        """Collect experience for an order; `memory` is the memory of the policy for the rows of this
        shard."""
        actor = self._begun().actor()
        self._stage = order.stage
        # An order may be older than the episodes of the one before it.
        self._next_episode = max(order.next_episode, self._next_episode + len(self._ended))
        self._ended.clear()
        self._notes.clear()
        actor.load(order.parameters)
        actor.remember(memory)
        with random_numbers_kept():
            self._seed(derive_seed(self._run.record.seed, "shard", self._number, order.begun))
            actor.begin()
            fragment = self._collector.collect(
                actor, order.steps, with_masks=order.with_masks, lesson=self._lesson(order.lesson)
            )
        if fragment is None:
            raise RuntimeError("nothing can end a fragment of a shard")
        worlds = self._collector.worlds
        rows = self._collector.rows // len(self._numbers)
        has_begun = fragment.starts[1:].any(axis=0) | fragment.following_starts
        begun = {
            world: (worlds.start_of(world), self._stages[world])
            for world in np.flatnonzero(has_begun[::rows]).tolist()
        }
        return ShardResult(fragment, actor.memory(), list(self._ended), begun, notes=list(self._notes))

    def evaluate(self, order: EvaluationOrder) -> Evaluated:
        """Play the episodes of this shard: one of `shards`, in turn."""
        policy = self._begun()
        policy.actor().load(order.parameters)
        numbers = range(self._number, len(order.seeds), self._training.shards)
        with random_numbers_kept():
            self._evaluation.enter(self._run.program.variant(None, order.stage), stage=order.stage)
            played = self._evaluation.play(policy, order.seeds, numbers)
        return Evaluated(dict(zip(numbers, played, strict=True)))

    def _lesson(self, lesson: Lesson | None) -> Lesson | None:
        """Return the part of this shard in a lesson."""
        if lesson is None:
            return None
        return lesson._replace(worlds=max(0, min(lesson.worlds - self._numbers[0], len(self._numbers))))

    def _begun(self) -> Learner:
        if self._policy is None:
            raise RuntimeError("a shard acts after it has begun")
        return self._policy

    def _seed(self, seed: int) -> None:
        """Seed all generators that a policy draws from, so that no shard needs to keep their states between
        two fragments."""
        torch.default_generator.manual_seed(seed)
        np.random.seed(seed % 2**32)
        random.seed(seed)
        self._action_space.seed(seed)

    def close(self) -> None:
        self._stack.close()
        self._evaluation.close()


class LocalShards:
    """Shards in this process, one after the other."""

    def __init__(self, shards: Sequence[Shard]) -> None:
        self._shards = shards

    def work(
        self,
        order: Order | EvaluationOrder | None,
        episodes: Sequence[Sequence[RunningEpisode]],
        memories: Sequence[Mapping[str, Array]],
    ) -> Callable[[], list[Any]]:
        answers = [
            shard.work(order, memory, begun if order is None else None)
            for shard, begun, memory in zip(self._shards, episodes, memories, strict=True)
        ]
        return lambda: answers

    def close(self) -> None:
        for shard in self._shards:
            shard.close()


def world_numbers(training: Training) -> list[range]:
    """Return the worlds of each shard. If the shards differ in size, the first ones have one world more."""
    ends = [number * training.environments // training.shards for number in range(training.shards + 1)]
    sizes = sorted((end - begin for begin, end in pairwise(ends)), reverse=True)
    ends = [0, *accumulate(sizes)]
    return [range(begin, end) for begin, end in pairwise(ends)]
