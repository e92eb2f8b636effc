"""The worlds of a training or an evaluation, one by one or as a batch: how they are created, the held-out
episodes in them, and their failures.

A failure of an episode is a number that is not finite, or a world that explodes. Failures are located, and
kept for reproduction:

    failures/0001.json      the start of the episode, its actions, and the error

`FailureRecorder` wraps each single world of a training or an evaluation of a run; `BatchFailureRecorder` does
the same for a batch of worlds. `reproduce` repeats the episode of a file.
"""

from __future__ import annotations

import math
import random
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager, suppress
from functools import partial
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn, Protocol

import gymnasium as gym
import numpy as np
import torch
from pydantic import BaseModel, ConfigDict, NonNegativeInt

from deepbots_cli import api, engines
from deepbots_cli.api import build_batch
from deepbots_cli.codegen import batch_obstacles
from deepbots_cli.document import Permissions
from deepbots_cli.errors import (
    DeepbotsError,
    EndsAtResetError,
    EngineError,
    EvaluationError,
    RunError,
    UsageError,
)
from deepbots_cli.learning.executor import Interruption
from deepbots_cli.learning.runs.curriculum import Curriculum
from deepbots_cli.learning.runs.directories import SKIPPED, read_json, write_numbered
from deepbots_cli.learning.runs.run import Run
from deepbots_cli.program import Program
from deepbots_cli.rollout import Episode, Start, play, steps
from deepbots_cli.rollout.collector import ShardedCollector
from deepbots_cli.rollout.drivers import named_driver, sequence_driver
from deepbots_cli.rollout.episode import OnEpisode, set_random_state
from deepbots_cli.rollout.policies import (
    StopCondition,
    ordered_episodes,
    play_batch,
    play_episodes,
    play_together,
)
from deepbots_cli.rollout.source import SourceKind, folder_kind
from deepbots_cli.rollout.worlds import HistoryRecorder, has_copies
from deepbots_cli.runtime.batch import BatchSupervisor, EpisodeHistory, LostWorld
from deepbots_cli.runtime.spaces import FORWARD_BATCH_SIZE, Predictor
from deepbots_cli.runtime.streams import derive_seed
from deepbots_cli.words import shell_word

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
        batch: The number of worlds of a batch. Fewer episodes are left to a single world.
    """

    def __init__(
        self,
        build: WorldFactory,
        run: Run | None = None,
        *,
        engine: str = "",
        batch: int = 0,
    ) -> None:
        self._build = build
        self._run = run
        self._engine = engine
        self._size = batch
        self._program: Program | None = None
        self._batch: BatchSupervisor | None = None
        self._singles: list[FailureRecorder] = []
        self._played = 0

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
        return self._single_worlds(0)[0] if self._batch is None else self._batch.singles[0]

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

        They are the same in a batch and in a single world; unless `deterministic`, single worlds play. With
        `until`, they end with the first episode for which it returns True.
        """
        numbers = range(len(seeds)) if numbers is None else numbers
        if deterministic and self._batch is not None and self.has_batch_for(len(numbers)):
            with suppress(DeepbotsError):  # a single world reports its place, and keeps the episode
                finished = play_batch(policy, self._batch, [seeds[number] for number in numbers])
                return ordered_episodes(finished, range(len(numbers)), on_episode, until)
        goes_together = deterministic and not has_copies(self.first)
        worlds = self._single_worlds(len(numbers)) if goes_together else self._single_worlds(0)[:1]
        for world in worlds:
            world.seeds = seeds
        finished = (
            play_together(policy, worlds, seeds, numbers)
            if goes_together
            else play_episodes(policy, worlds[0], seeds, deterministic=deterministic, numbers=numbers)
        )
        return ordered_episodes(finished, numbers, on_episode, until)

    def _single_worlds(self, episodes: int) -> list[FailureRecorder]:
        """Return the single worlds, one for each `EVALUATION_EPISODES` episodes so far: a world takes longer
        to build than a forward pass that also acts in it saves in fewer."""
        if self._program is None:
            raise RuntimeError("the worlds have no scenario yet")
        self._played += episodes
        while len(self._singles) < min(FORWARD_BATCH_SIZE, max(1, self._played // EVALUATION_EPISODES)):
            world = self._build(self._program)
            recorder = FailureRecorder(world, self._run, self._program, case=self._case, stage=self._stage)
            self._singles.append(recorder)
        return self._singles

    def close(self) -> None:
        for single in self._singles:
            single.close()
        if self._batch is not None:
            self._batch.close()
        self._singles, self._played = [], 0
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


def six_digits(seed: int, stream: str, number: int) -> int:
    """Return a root seed that is easy to repeat, from the named stream of another one."""
    return 100_000 + derive_seed(seed, stream, number) % 900_000


@contextmanager
def random_numbers_kept() -> Iterator[None]:
    """Context after which the generators of this process continue as if nothing had been drawn in it."""
    states = torch.get_rng_state(), np.random.get_state(), random.getstate()
    try:
        yield
    finally:
        torch.set_rng_state(states[0])
        np.random.set_state(states[1])
        random.setstate(states[2])


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

        def look(count: int = 0, total: int = len(seeds)) -> None:
            if interruption.requested:
                raise KeyboardInterrupt

        look()
        with random_numbers_kept():
            self._worlds.enter(scenario, stage=stage)
            if self.shards is not None and not without_shards and not self._worlds.has_batch_for(len(seeds)):
                return self.shards.evaluate(model.actor(), seeds, stage)
            return self._worlds.play(model, seeds, on_episode=look)

    def close(self) -> None:
        self._worlds.close()


# Failures

FAILURES_FOLDER = "failures"
_MAX_FILE_BYTES = 20_000_000
"""The largest size of a file in bytes: 80,000 steps of a robot with 12 motors."""
# A training stops when `MAX_LOST_EPISODES` of the last `LOSS_WINDOW_EPISODES` episodes were lost.
MAX_LOST_EPISODES = 10
LOSS_WINDOW_EPISODES = 100


class Failure(BaseModel, strict=True):
    """An episode that failed.

    `episode` is its number: of an evaluation from 0, as `--episode` takes it; of a training from 1, as in
    `monitor.csv`. `start` is the seed of its reset, or the states of the random generators before it.
    `actions` are in the action space, one per step. `case` and `stage` name the variant of the scenario, if
    it is not the scenario itself, and `options` are the values that the episode took in place of draws. With
    `ends_at_reset`, the error is that an ending was already true when the episode began.
    """

    error: str
    step: NonNegativeInt
    episode: NonNegativeInt
    case: str | None
    stage: str | None
    start: NonNegativeInt | dict[str, Any]
    actions: list[Any]
    ends_at_reset: bool = False
    options: dict[str, Any] | None = None


class _FailureKeys(BaseModel):
    """The keys by which the file of a failed episode is recognized."""

    model_config = ConfigDict(json_schema_extra={SKIPPED: None})

    error: Any
    start: Any
    actions: Any


class FailureRecorder(HistoryRecorder):
    """A world with the `history` of its running episode. Its failures name field or term, step, episode and
    seed.

    A failure is an error of the world, a reward that is not finite, or an observation that is not finite.

    Args:
        world: The world; the wrapper closes it.
        run: The run that keeps a file of each failure.
        program: The scenario of the world, for the names of the observation.
        seeds: The seeds of the first, second, ... episode, if they are known.
        episode: Returns the number of an episode that none of the seeds begins.
        case: The case of the scenario, by name.
        stage: The stage of the curriculum, by name.
    """

    def __init__(
        self,
        world: gym.Env[Any, Any],
        run: Run | None = None,
        program: Program | None = None,
        *,
        seeds: Sequence[int] = (),
        episode: Callable[[], int] = lambda: 0,
        case: str | None = None,
        stage: str | None = None,
    ) -> None:
        super().__init__(world)
        self._run = run
        self._program = program
        self.seeds = seeds
        self._episode = episode
        self._case = case
        self._stage = stage

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        try:
            observation, info = super().reset(seed=seed, options=options)
        except DeepbotsError as error:
            self._fail(error)
        if not is_finite(observation):
            self._fail(EvaluationError(f"at reset {self._name(observation)} is not finite"))
        return observation, info

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        try:
            outcome = super().step(action)
        except DeepbotsError as error:
            self._fail(error)
        if not math.isfinite(outcome[1]):
            terms = [
                name for name, value in outcome[4].get("reward_terms", {}).items() if not math.isfinite(value)
            ]
            culprit = f"the reward term '{terms[0]}'" if terms else "the sum of the reward terms"
            self._fail(EvaluationError(f"step {len(self.history.actions)}: {culprit} is not finite"))
        if not is_finite(outcome[0]):
            self._fail(
                EvaluationError(f"step {len(self.history.actions)}: {self._name(outcome[0])} is not finite")
            )
        return outcome

    def _name(self, observation: Any) -> str:
        """Return the name of the first field of an observation that is not finite."""
        parts = observation if isinstance(observation, dict) else {"observation": observation}
        key, part = next((key, part) for key, part in parts.items() if not np.isfinite(part).all())
        if key != "observation" or self._program is None:
            return f"the {key.replace('_', ' ')}"
        names = [value.name for value in self._program.agent.inputs]
        index = int(np.flatnonzero(~np.isfinite(part).reshape(-1))[0])
        return f"the observation '{names[index % len(names)]}'" if names else "the observation"

    def _fail(self, error: DeepbotsError) -> NoReturn:
        """Raise the error with its place, and with the command that reproduces it.

        An action that is not finite is an error of the policy, which the world refuses.
        """
        if isinstance(error, UsageError):
            raise error
        start = self.history.start
        number = (
            self.seeds.index(start) if isinstance(start, int) and start in self.seeds else self._episode()
        )
        text = _failure_text(
            str(error),
            number,
            self.history,
            run=self._run,
            case=self._case,
            stage=self._stage,
            ends_at_reset=isinstance(error, EndsAtResetError),
        )
        raise type(error)(text) from error


class BatchFailureRecorder:
    """The failures of a batch of worlds in a training.

    A world whose state becomes infinite or NaN is reset, and its episode is lost. A batch that raises an
    error has failed.

    Args:
        run: The run that keeps a file of each failure.
        guarded: Builds a single world of a stage of the curriculum, by its number, in a `FailureRecorder`.
        next_episode: Returns the number of the next episode.
        curriculum: Names the stages.
        note: Called with the text of a lost episode.
    """

    def __init__(
        self,
        run: Run,
        guarded: Callable[[int], FailureRecorder],
        next_episode: Callable[[], int],
        curriculum: Curriculum,
        note: Callable[[str], None],
    ) -> None:
        self._run = run
        self._guarded = guarded
        self._next_episode = next_episode
        self._curriculum = curriculum
        self._note = note
        self._losses: deque[int] = deque(maxlen=MAX_LOST_EPISODES)
        self._files = 0

    def record_lost(self, stage: int, loss: LostWorld, history: EpisodeHistory) -> None:
        """Report a lost episode. The first ten have files, and so does the one that ends the training.

        Raises:
            EngineError: Ten of the last hundred episodes were lost.
        """
        number = self._next_episode()
        self._losses.append(number)
        again_and_again = (
            len(self._losses) == MAX_LOST_EPISODES and number - self._losses[0] < LOSS_WINDOW_EPISODES
        )
        has_file = again_and_again or self._files < MAX_LOST_EPISODES
        self._files += has_file
        text = _failure_text(
            f"step {loss.step}: {loss.error}",
            number,
            history,
            run=self._run if has_file else None,
            stage=self._curriculum.name_of(stage),
        )
        if again_and_again:
            window = min(number, LOSS_WINDOW_EPISODES)
            raise EngineError(
                f"in {MAX_LOST_EPISODES} of the last {window} episodes the physics was not stable; the"
                f" last one is {text}"
            )
        self._note(f"{text}\nworld {loss.world} was reset")

    def record_failed(self, stage: int, histories: Sequence[EpisodeHistory]) -> None:
        """Find the episode that fails: repeat the running episodes of a stage in a single world, until one
        fails.

        Raises:
            DeepbotsError: An episode failed. It is kept.
        """
        with closing(self._guarded(stage)) as world:
            for history in histories:
                for _ in islice(
                    steps(world, sequence_driver(history.actions), _start(history.start, history.options)),
                    len(history.actions) + 1,
                ):
                    pass


def _failure_text(
    error: str,
    number: int,
    history: EpisodeHistory,
    *,
    run: Run | None,
    case: str | None = None,
    stage: str | None = None,
    ends_at_reset: bool = False,
) -> str:
    """Return the error with its episode, and with the command that repeats it if a file could be written."""
    start = history.start
    root = start if isinstance(start, int) else start.get("root")
    text = f"episode {number:,}{'' if root is None else f' (seed {root})'}, {error}"
    if run is None:
        return text
    actions = [_plain(action) for action in history.actions]
    failure = Failure(
        error=error,
        step=len(actions),
        episode=number,
        case=case,
        stage=stage,
        start=start,
        actions=actions,
        ends_at_reset=ends_at_reset,
        options=None if history.options is None else dict(history.options),
    )
    try:
        path = write_numbered(run.path / FAILURES_FOLDER, failure.model_dump_json() + "\n")
    except RunError:  # the run cannot be written to
        return text
    return f"{text}\nreproduce it with: deepbots try {shell_word(path)}"


def is_finite(observation: Any) -> bool:
    """Return whether all numbers of an observation are finite. A dot product takes 0.3 us, a third of
    `numpy.isfinite`."""
    parts = observation.values() if isinstance(observation, dict) else (observation,)
    return all(
        # The sum of squares may overflow although every number is finite.
        math.isfinite(np.vdot(part, part)) or bool(np.isfinite(part).all())
        for part in parts
        if part.dtype != np.uint8
    )


def is_failure(path: Path) -> bool:
    """Return whether a file is that of a failed episode, by its content; any JSON file in a folder `failures`
    is one, which may be damaged."""
    if path.suffix != ".json" or path.absolute().parent.name == FAILURES_FOLDER:
        return path.suffix == ".json"
    try:
        read_json(path, _FailureKeys, _MAX_FILE_BYTES)
    except RunError:
        return False
    return True


def read_failure(path: Path) -> tuple[Failure, Run, Program]:
    """Read a file that `FailureRecorder` wrote. Returns the failure, its run, and the scenario, case or stage
    that failed.

    Raises:
        RunError: The file is damaged, or does not lie in the folder `failures` of a run.
    """
    failure = read_json(path, Failure, _MAX_FILE_BYTES)
    folder = path.absolute().parent
    if folder.name != FAILURES_FOLDER or folder_kind(folder.parent) is not SourceKind.RUN:
        raise RunError(
            f"{path} is a failed episode without its run, which has the scenario; copy the file into the"
            f" folder `{FAILURES_FOLDER}` of the run"
        )
    run = Run.open(folder.parent)
    return failure, run, run.program.variant(failure.case, failure.stage)


def repeat_steps(failure: Failure, program: Program, world: gym.Env[Any, Any], path: Path) -> Iterator[int]:
    """Repeat the episode in a world of the program. Yields the number of completed actions, from 0, until all
    are done or the episode ends.

    Raises:
        RunError: The file `path` of the failure is damaged.
        DeepbotsError: The episode fails again.
    """
    try:
        actions = [_action(world.action_space, action) for action in failure.actions]
        start = _start(failure.start, failure.options)
        if start.state is not None:
            set_random_state(world, start.state)
    except (AttributeError, KeyError, TypeError, ValueError, OverflowError) as error:
        raise RunError(f"{path} is damaged, or of another scenario ({type(error).__name__})") from error
    guarded = FailureRecorder(world, program=program, episode=lambda: failure.episode)
    again = steps(guarded, sequence_driver(actions), start._replace(state=None))
    try:
        yield from (step.number for step in islice(again, len(actions) + 1))
    except UsageError as error:  # an action does not fit
        raise RunError(f"{path} is damaged, or of another scenario ({error})") from error


def reproduce(path: Path, *, permissions: Permissions = Permissions()) -> tuple[Failure, str | None]:
    """Repeat the episode of a file that `FailureRecorder` wrote. Returns the failure, and the error of the
    repetition (None: it did not fail).

    If the episode ends earlier now, the actions of the returned failure are those that were repeated.

    Raises:
        RunError: The file is damaged, or does not lie in the folder `failures` of a run.
    """
    failure, run, program = read_failure(path)
    step_count = 0
    with closing(api.build(program, engine=run.record.engine, permissions=permissions)) as world:
        try:
            for step_count in repeat_steps(failure, program, world, path):  # noqa: B007
                pass
            world.engine.require_finite()  # a batch checks every step, a single world does not
        except RunError:  # the recording is damaged; the world did not fail
            raise
        except DeepbotsError as error:
            return failure, str(error)
    return failure.model_copy(update={"actions": failure.actions[:step_count]}), None


def _start(start: int | dict[str, Any], options: Mapping[str, Any] | None) -> Start:
    return Start(options=options, state=start) if isinstance(start, dict) else Start(start, options)


def _plain(action: Any) -> Any:
    if isinstance(action, dict):
        return {key: _plain(part) for key, part in action.items()}
    return np.asarray(action).tolist()


def _action(space: gym.Space[Any], action: Any) -> Any:
    if isinstance(space, gym.spaces.Dict):
        return {key: _action(part, action[key]) for key, part in space.spaces.items()}
    return np.array(action, dtype=space.dtype)
