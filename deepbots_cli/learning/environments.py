"""The worlds of a training or an evaluation: one by one, or as a batch; and held-out episodes in them: their
starts during a training, and the evaluator that plays them.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import closing, suppress
from functools import partial
from typing import TYPE_CHECKING, Any, Protocol

import gymnasium as gym
import torch

from deepbots_cli import api, engines
from deepbots_cli.api import build_batch
from deepbots_cli.codegen import batch_obstacles
from deepbots_cli.document import Permissions
from deepbots_cli.errors import DeepbotsError
from deepbots_cli.learning.executor import Interruption
from deepbots_cli.learning.failures import FailureRecorder
from deepbots_cli.learning.runs.run import Run
from deepbots_cli.program import Program
from deepbots_cli.rollout import Episode, Start, play
from deepbots_cli.rollout.collector import ShardedCollector
from deepbots_cli.rollout.drivers import named_driver
from deepbots_cli.rollout.episode import OnEpisode
from deepbots_cli.rollout.policies import StopCondition, ordered_episodes, play_batch, play_episodes
from deepbots_cli.runtime.batch import BatchSupervisor
from deepbots_cli.runtime.spaces import Predictor
from deepbots_cli.runtime.streams import derive_seed

if TYPE_CHECKING:
    from deepbots_cli.learning.learner import Learner

MIN_WORLDS = 8
"""The number of worlds, or of copies of a robot in all worlds, from which a batch is faster.

The array operations of a batch take as long per step as 5 single worlds.
"""


class WorldFactory(Protocol):
    """Makes the world of a compiled scenario; `render_mode` as in Gymnasium."""

    def __call__(self, program: Program, *, render_mode: str | None = None) -> gym.Env[Any, Any]: ...


def supervisor_factory(engine: str, *, permissions: Permissions = Permissions()) -> WorldFactory:
    """Build the generated supervisor on `engine`. Terms in Python run with the permission `code`."""
    return partial(api.build, engine=engine, permissions=permissions)


def reasons_against_batch(program: Program, worlds: int, engine: str, build: WorldFactory) -> list[str]:
    """Return the reasons why a training steps its worlds one by one; empty if it steps them as a batch."""
    if engine not in engines.BATCHES:
        return [f"the engine '{engine}' has no batches"]
    if _rows(program, worlds) < MIN_WORLDS:
        return [f"there are fewer than {MIN_WORLDS} worlds"]
    training = program.agent.training
    if training is not None and training.teacher is not None:
        return ["a script reads what only a single world computes"]
    reasons = [] if getattr(build, "func", None) is api.build else ["the argument `build` makes its worlds"]
    variants = [program, *(stage.program for stage in program.curriculum)]
    return list(
        dict.fromkeys(
            [*reasons, *(reason for variant in variants for reason in batch_obstacles(variant.with_critic))]
        )
    )


def _rows(program: Program, worlds: int) -> int:
    copies = program.agent.copies
    return worlds * (copies.count if copies else 1)


def stepping_text(program: Program, worlds: int, engine: str, build: WorldFactory) -> str:
    """Return a note on whether a training steps its worlds as a batch, and why not; empty if no batch is to
    be expected."""
    if engine not in engines.BATCHES or _rows(program, worlds) < MIN_WORLDS:
        return ""
    reasons = reasons_against_batch(program, worlds, engine, build)
    how = f"one by one: {'; '.join(reasons)}" if reasons else "together, as a batch"
    return f"{program.name} steps its {worlds} worlds {how}"


EVALUATION_EPISODES = 20
"""The number of starts of an evaluation. All evaluations have the same starts, so that two networks differ by
their actions and not by luck."""


class EvaluationWorlds:
    """Worlds of one scenario at a time: a batch if engine and scenario support it, otherwise single worlds.

    Args:
        build: Makes a single world.
        run: The run that keeps a file of each failure.
        engine: The engine of a batch; empty if there is none.
        batch: The number of worlds of a batch. Fewer episodes are left to single worlds.
        singles: The number of single worlds.
    """

    def __init__(
        self,
        build: WorldFactory,
        run: Run | None = None,
        *,
        engine: str = "",
        batch: int = 0,
        singles: int = 1,
    ) -> None:
        self._build = build
        self._run = run
        self._engine = engine
        self._size = batch
        self._count = singles
        self._program: Program | None = None
        self._batch: BatchSupervisor | None = None
        self._singles: list[FailureRecorder] = []

    def enter(self, program: Program, *, case: str | None = None, stage: str | None = None) -> None:
        """Play in this scenario from now on; it is the scenario of a case or stage."""
        if program is self._program:
            return
        self.close()
        self._program = program
        self._case = case
        self._stage = stage
        if not reasons_against_batch(program, self._size, self._engine, self._build):
            self._batch = build_batch(program, self._size, engine=self._engine)

    @property
    def first(self) -> gym.Env[Any, Any]:
        """A world, whose spaces are those of all worlds."""
        return self._single_worlds()[0] if self._batch is None else self._batch.singles[0]

    def has_batch_for(self, episodes: int) -> bool:
        """Return whether a batch plays so many episodes."""
        return self._batch is not None and episodes >= self._size

    def play(
        self,
        policy: Predictor,
        seeds: Sequence[int],
        numbers: Sequence[int] | None = None,
        *,
        deterministic: bool = True,
        on_episode: OnEpisode | None = None,
        until: StopCondition | None = None,
    ) -> list[Episode]:
        """Play an episode from each seed, or only the episodes with these `numbers`.

        They are the same in a batch and in any number of single worlds. With `until`, they end with the first
        episode for which it returns True.
        """
        numbers = range(len(seeds)) if numbers is None else numbers
        if self._batch is not None and self.has_batch_for(len(numbers)):
            with suppress(DeepbotsError):  # single worlds report its place, and keep the episode
                finished = play_batch(policy, self._batch, [seeds[number] for number in numbers])
                return ordered_episodes(finished, range(len(numbers)), on_episode, until)
        worlds = self._single_worlds()
        for world in worlds:
            world.seeds = seeds
        finished = play_episodes(policy, worlds, seeds, deterministic=deterministic, numbers=numbers)
        return ordered_episodes(finished, numbers, on_episode, until)

    def _single_worlds(self) -> list[FailureRecorder]:
        while self._program is not None and len(self._singles) < self._count:
            world = self._build(self._program)
            self._singles.append(
                FailureRecorder(world, self._run, self._program, case=self._case, stage=self._stage)
            )
        return self._singles

    def close(self) -> None:
        for world in self._singles:
            world.close()
        if self._batch is not None:
            self._batch.close()
        self._singles = []
        self._batch = None
        self._program = None


def play_script(build: WorldFactory, program: Program, name: str, seeds: Sequence[int]) -> list[Episode]:
    """Play the episodes of a script from these seeds."""
    with closing(build(program)) as world:
        return [play(world, named_driver(world, name), Start(seed)) for seed in seeds]


def evaluation_seeds(seed: int, numbers: range) -> list[int]:
    """Return the starts of evaluations during a training with the root seed `seed`. Neither the training nor
    a later evaluation has these. Each evaluation has the first `EVALUATION_EPISODES` of them."""
    return [derive_seed(seed, "trial", number) for number in numbers]


def confirmation_root(seed: int, number: int) -> int:
    """Return the root seed of the starts of a confirmation, by its number from 1: six digits, which are easy
    to repeat."""
    return 100_000 + derive_seed(seed, "confirmation", number) % 900_000


class Evaluator:
    """Plays held-out episodes of the current policy without noise: in a batch of worlds if engine and
    scenario support it, otherwise in the shards of the training if it has several, otherwise in its own
    world."""

    def __init__(self, build: WorldFactory, seed: int, run: Run | None = None) -> None:
        self.steps = 0
        """The steps of all evaluations, without confirmations and the last choice."""
        self.shards: ShardedCollector | None = None
        self.starts = evaluation_seeds(seed, range(EVALUATION_EPISODES))
        """The starts of every evaluation."""
        self.build = build
        self._worlds = EvaluationWorlds(
            build, run, engine="" if run is None else run.record.engine, batch=EVALUATION_EPISODES
        )

    def evaluate(
        self, model: Learner, scenario: Program, interruption: Interruption, stage: str | None = None
    ) -> list[Episode]:
        """Play the episodes of an evaluation; arguments and errors are those of `play`."""
        episodes = self.play(model, scenario, interruption, self.starts, stage)
        self.steps += sum(episode.length for episode in episodes)
        return episodes

    def play(
        self,
        model: Learner,
        scenario: Program,
        interruption: Interruption,
        seeds: Sequence[int],
        stage: str | None = None,
        *,
        without_shards: bool = False,
    ) -> list[Episode]:
        """Play an episode from each seed in `scenario`, which is that of `stage`. The training's random
        numbers stay as they were.

        Args:
            without_shards: Whether to leave out the shards, such as for a model other than that of the
                training.

        Raises:
            KeyboardInterrupt: The training was interrupted. When it is resumed, it continues from its last
                checkpoint, before this evaluation. Shards complete their part first.
        """
        state = torch.get_rng_state()

        def look(count: int = 0, total: int = len(seeds)) -> None:
            if interruption.requested:
                raise KeyboardInterrupt

        look()
        self._worlds.enter(scenario, stage=stage)
        try:
            if self.shards is not None and not without_shards and not self._worlds.has_batch_for(len(seeds)):
                return self.shards.evaluate(model.actor(), seeds, stage)
            return self._worlds.play(model, seeds, on_episode=look)
        finally:
            torch.set_rng_state(state)

    def close(self) -> None:
        self._worlds.close()
