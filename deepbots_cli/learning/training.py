"""Training: one scenario, one seed, one run directory."""

from __future__ import annotations

import platform
import time
from collections.abc import Sequence
from contextlib import ExitStack, closing
from dataclasses import asdict, dataclass, replace
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import torch
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.logger import configure

import deepbots_cli
from deepbots_cli import api, interface
from deepbots_cli.api import Compiled
from deepbots_cli.errors import MissingExtraError, UsageError
from deepbots_cli.learning import algorithms, weights
from deepbots_cli.learning.callbacks import Keeper, Rank, Watch, diverged
from deepbots_cli.learning.curriculum import Curriculum, StageEnd
from deepbots_cli.learning.defaults import longest_episode
from deepbots_cli.learning.environments import BuildWorld, Copies, World, copies_over
from deepbots_cli.learning.episodes import Episode, EpisodeFile, SolvedAt, Statistics
from deepbots_cli.learning.exclusive import sole_trainer
from deepbots_cli.learning.interruption import listening
from deepbots_cli.learning.progress import Reporter, reporter
from deepbots_cli.learning.record import FORMAT, Record, Status, now, versions
from deepbots_cli.learning.run import Run, input_digests, new_directory, read_record
from deepbots_cli.learning.trials import AT_ONCE, Trials
from deepbots_cli.program import Program
from deepbots_cli.program.task import Training
from deepbots_cli.runtime.streams import derive
from deepbots_cli.scenario import Scenario

_KEPT = (
    "networks, optimiser, counts, recent episodes, and the replay buffer of off-policy algorithms; "
    "a resumed training begins new episodes, from random streams of their own"
)


MOST_STEPS = 10**12
"""A goal beyond any training; what is far larger could not be read back from the record of the run."""


@dataclass(frozen=True)
class TrainingResult:
    """How a training ended.

    `status` is finished or interrupted; of an interrupted one everything learned is kept, and `resume(run)` goes on.
    Steps count over all copies of the environment; the means are over the recent episodes (None: none has ended).
    `best_return` is the mean return of the best model in its trial (None: too few episodes for one); `trial_steps` are those
    of all trials, from which nothing is learned and which are not among `steps`. `stage` is the one of the curriculum that it
    ended in, `stages` are those before.
    """

    run: Path
    status: Status
    steps: int
    total_timesteps: int
    episodes: int
    mean_return: float | None
    success_rate: float | None
    best_return: float | None
    simulated_hours: float
    trial_steps: int
    solved_at: SolvedAt | None
    cpu_seconds: float
    wall_seconds: float
    weights_digest: str
    stage: str | None = None
    stages: tuple[StageEnd, ...] = ()

    @property
    def interrupted(self) -> bool:
        return self.status == "interrupted"


def train(
    scenario: Compiled | Scenario | str | Path,
    *,
    run: str | Path | None = None,
    runs: str | Path = "runs",
    seed: int = 0,
    total_timesteps: int | None = None,
    stop_when_solved: bool = True,
    stage: str | None = None,
    progress: bool | Reporter = False,
    command: Sequence[str] = (),
    engine: str = "pybullet",
    build: BuildWorld | None = None,
) -> TrainingResult:
    """Train the policy of a scenario in a new run directory.

    The first Ctrl-C or SIGTERM ends the training between two steps: the result says `interrupted`.

    Args:
        scenario: What `deepbots_cli.compile` returned, a `Scenario`, the path of a file, or the name of a shipped scenario.
        run: The directory to make; it must not exist. By default `runs/<scenario>-<seed>-<n>`.
        runs: Where the default directory is made.
        seed: The root of every random stream, from 0. The same seed on the same machine gives the same weights.
        total_timesteps: Steps over all copies of the environment; the scenario's figure by default. On-policy algorithms
            finish the update that they are in.
        stop_when_solved: Whether to end when the scenario's `solved` is met by the episodes of the training and then by a trial.
        stage: The stage of the curriculum to begin in, by name; by default the first.
        progress: Whether to tell how it goes on standard error, or who tells it.
        command: The command line, for the record.
        engine: The physics engine of the generated supervisor.
        build: Makes a world of the scenario in place of the generated supervisor.

    Raises:
        UsageError: The directory exists, there is no such stage, or the settings cannot be trained with.
        RunError: The training diverged; the last good model is kept.
        DeepbotsError: The world failed; names step and cause.
    """
    compiled = compiled_of(scenario)
    training = _training_of(compiled.program, total_timesteps)
    if not 0 <= seed < 2**63:
        raise UsageError(f"{seed} cannot be a seed, which is a whole number from 0 to {2**63 - 1}")
    build = build or default_build(engine, allow_code=compiled.allow_code)
    curriculum = Curriculum(compiled.program, stage)
    _rehearse(compiled.program, training, build)
    path = new_directory(run, runs, compiled.program.name, seed)
    seeds = {f"environment/{i}": derive(seed, "environment", i) for i in range(training.environments)}
    record = Record(
        format=FORMAT,
        deepbots=deepbots_cli.__version__,
        status="running",
        scenario=compiled.program.name,
        source=str(compiled.source),
        digest=compiled.digest,
        interface=interface.interface(compiled.program),
        inputs=input_digests(compiled.inputs),
        engine=engine,
        seed=seed,
        seeds=seeds | {"policy": derive(seed, "policy"), "evaluation": derive(seed, "evaluation")},
        total_timesteps=training.total_timesteps,
        stop_when_solved=stop_when_solved,
        first_stage=stage,
        command=tuple(command),
        versions=versions(),
        platform=platform.platform(),
        started=now(),
        updated=now(),
        resumed_at=(),
        kept=_KEPT,
        result=None,
    )
    with sole_trainer(path):
        new = Run.create(path, record, compiled)
        statistics = Statistics(compiled.program.period, compiled.program.solved)
        return _learn(new, training, Keeper(new, statistics, curriculum, Trials(build, seed)), build, reporter(progress))


def resume(
    run: str | Path,
    *,
    total_timesteps: int | None = None,
    stop_when_solved: bool | None = None,
    progress: bool | Reporter = False,
    allow_code: bool = False,
    build: BuildWorld | None = None,
) -> TrainingResult:
    """Go on with a run from its last checkpoint, in the same directory; logs are appended to.

    Networks, optimiser, counts, recent episodes and (off-policy) the replay buffer are taken up; episodes begin anew from
    random streams of their own, so the result differs from that of a training that was never interrupted. Episodes that a
    killed process logged after its last checkpoint stay in `monitor.csv`, and their numbers come again.

    Args:
        run: The directory of the run.
        total_timesteps: The new goal, counted from the very start; the run's own by default.
        stop_when_solved: As for `train`; the run's own by default. A run that was solved before goes on regardless.
        progress: As for `train`.
        allow_code: Whether terms in Python run.
        build: As for `train`.

    Raises:
        RunError: No run, or one that is damaged; else as for `train`.
        UsageError: The run has already reached its goal, or another training is at work in it.
    """
    path = Path(run)
    read_record(path)  # a folder that is no run is told so, whoever is at work in it
    with sole_trainer(path):
        # Only now: a training that has just ended in there has changed the record.
        known = Run.open(path)
        build = build or default_build(known.record.engine, allow_code=allow_code)
        return _go_on(known, total_timesteps, stop_when_solved, reporter(progress), build)


def _go_on(known: Run, total_timesteps: int | None, stop_when_solved: bool | None, told: Reporter, build: BuildWorld) -> TrainingResult:
    record = known.record
    training = _training_of(known.program, record.total_timesteps if total_timesteps is None else total_timesteps)
    statistics = Statistics(known.program.period, known.program.solved)
    curriculum, best, tried = Curriculum(known.program, record.first_stage), None, 0
    if not known.stillborn:
        state = weights.read_state(known.checkpoint)
        statistics.restore(state)
        stages = state.optional_object("curriculum")
        if stages is not None:
            curriculum.restore(stages)
        kept = state.optional_object("best")
        best = None if kept is None else Rank(kept.flag("proven"), kept.flag("solves"), kept.number("mean_return"))
        tried = state.count("trial_steps")
    if statistics.steps >= training.total_timesteps:
        raise UsageError(
            f"{known.path} has trained {statistics.steps:,} of {training.total_timesteps:,} steps; name a higher total to go on with it"
        )
    known.update(
        status="running",
        resumed_at=(*record.resumed_at, statistics.steps),
        total_timesteps=training.total_timesteps,
        stop_when_solved=record.stop_when_solved if stop_when_solved is None else stop_when_solved,
    )
    return _learn(known, training, Keeper(known, statistics, curriculum, Trials(build, record.seed, tried), best), build, told)


def compiled_of(scenario: Compiled | Scenario | str | Path) -> Compiled:
    """The scenario as it is, or compiled if a `Scenario`, a path or the name of a shipped one is given."""
    return api.compile(scenario) if isinstance(scenario, (str, Path, Scenario)) else scenario


def default_build(engine: str, *, allow_code: bool = False) -> BuildWorld:
    """The generated supervisor on `engine`; with `allow_code`, terms in Python run."""
    return partial(api.build, engine=engine, allow_code=allow_code)


def _training_of(program: Program, total_timesteps: int | None) -> Training:
    if find_spec("tensorboard") is None:  # Stable-Baselines3 would only notice with the run half made
        raise MissingExtraError("train", "training")
    if program.policy.training is None:
        raise UsageError(f"{program.name} has no 'train' section, so there is nothing to train with")
    training = program.policy.training if total_timesteps is None else replace(program.policy.training, total_timesteps=total_timesteps)
    if training.total_timesteps < 1:
        raise UsageError(f"a training of {training.total_timesteps} steps teaches nothing; ask for at least 1")
    if training.total_timesteps > MOST_STEPS:
        raise UsageError(f"a training of {training.total_timesteps} steps would never end; ask for at most {MOST_STEPS}")
    algorithms.check(training)
    algorithms.check_memory(training.environments)
    return training


def _rehearse(program: Program, training: Training, build: BuildWorld) -> None:
    """Fail before there is a run directory, if a world cannot be built or the algorithm refuses its settings."""
    for stage in program.curriculum:
        build(stage.program).close()
    with closing(build(program)) as world:
        copies = copies_over([world] * training.environments, [0] * training.environments)
        algorithms.create(training, copies, seed=0, total_timesteps=training.total_timesteps, longest_episode=longest_episode(program))


def _learn(run: Run, training: Training, keeper: Keeper, build: BuildWorld, told: Reporter) -> TrainingResult:
    """One process's share in a run, from the statistics that `keeper` holds to the goal."""
    # One thread: networks of this size only lose by handing work around.
    torch.set_num_threads(1)
    began = time.perf_counter()
    statistics, curriculum = keeper.statistics, keeper.curriculum
    statistics.final = curriculum.is_last
    status: Status = "failed"
    try:
        with ExitStack() as stack:
            stack.callback(keeper.trials.close)
            copies = _copies(stack, run, training, build, keeper)
            model = _model(run, training, copies, statistics)
            interruption = stack.enter_context(listening())
            watch = Watch(run, keeper, told, interruption, training.total_timesteps)
            told.start(watch.standing())
            stack.callback(told.stop)
            status = _drive(model, watch, run)
            keeper.keep_best(model, interruption, AT_ONCE)
            keeper.keep_last(model)
            told.update(watch.standing())
    except KeyboardInterrupt:
        # Before the first step, or while models were written: files are whole, so there is something to go on from.
        status = "interrupted"
    finally:
        result = TrainingResult(
            run=run.path,
            status=status,
            steps=statistics.steps,
            total_timesteps=training.total_timesteps,
            episodes=statistics.episodes,
            mean_return=statistics.mean_return,
            success_rate=statistics.success_rate,
            best_return=keeper.best.mean_return if keeper.best else None,
            simulated_hours=statistics.simulated_hours,
            trial_steps=keeper.trials.steps,
            solved_at=statistics.solved_at,
            cpu_seconds=statistics.cpu_seconds,
            wall_seconds=time.perf_counter() - began,
            weights_digest=keeper.digest,
            stage=curriculum.name,
            stages=tuple(curriculum.ends),
        )
        run.update(status=status, result={key: value for key, value in asdict(result).items() if key != "run"})
    return result


def _copies(stack: ExitStack, run: Run, training: Training, build: BuildWorld, keeper: Keeper) -> Copies:
    """The copies of the world, which report to the statistics and the episode file; all closed with `stack`."""
    statistics, curriculum = keeper.statistics, keeper.curriculum
    file = EpisodeFile(run.monitor, run.program.name)
    stack.callback(file.close)
    stages = [curriculum.index] * training.environments
    branch: tuple[str | int, ...] = ("resumed", statistics.steps) if statistics.steps else ()

    def count_step() -> None:
        statistics.steps += 1

    def count_episode(copy: int, episode: Episode) -> None:
        present = stages[copy] == curriculum.index
        stage = curriculum.stages[stages[copy]].name if curriculum.stages else None
        statistics.add(episode, present=present)
        file.write(episode, statistics, stage)
        if present and curriculum.add(episode, statistics.steps, statistics.episodes):
            keeper.begin_stage()

    def renew(copy: int) -> tuple[World, int] | None:
        if stages[copy] == curriculum.index:
            return None
        stages[copy] = curriculum.index
        worlds[copy] = build(curriculum.scenario)
        return worlds[copy], derive(run.record.seed, "environment", copy, *branch, "stage", curriculum.index)

    def close() -> None:
        for world in worlds:
            world.close()

    worlds: list[World] = []
    stack.callback(close)
    for _ in range(training.environments):
        worlds.append(build(curriculum.scenario))
    seeds = [derive(run.record.seed, "environment", i, *branch) for i in range(training.environments)]
    return copies_over(worlds, seeds, on_step=count_step, on_episode=count_episode, renew=renew)


def _model(run: Run, training: Training, copies: Copies, statistics: Statistics) -> BaseAlgorithm:
    """A fresh model, or that of the checkpoint when there is something to go on from."""
    seed = run.record.seed
    model = algorithms.create(
        training,
        copies,
        seed=derive(seed, "policy"),
        total_timesteps=training.total_timesteps,
        longest_episode=longest_episode(run.program),
    )
    if statistics.steps:
        weights.put(model, weights.read(run.checkpoint, model))
        model.num_timesteps = statistics.steps
        model.set_random_seed(derive(seed, "policy", "resumed", statistics.steps))
    model.set_logger(configure(str(run.tensorboard), ["tensorboard"]))
    return model


def _drive(model: BaseAlgorithm, watch: Watch, run: Run) -> Status:
    try:
        masks: dict[str, Any] = {"use_masking": algorithms.has_masks(model)} if algorithms.takes_masks(model) else {}
        model.learn(watch.total - model.num_timesteps, callback=watch, reset_num_timesteps=False, **masks)
    except KeyboardInterrupt:
        return "interrupted"
    except ValueError as error:
        # torch's distributions refuse parameters that are no numbers before we look at the weights.
        name = weights.not_finite(weights.networks(model))
        if name is None:
            raise
        raise diverged(name, run, watch.statistics.steps) from error
    finally:
        model.logger.close()
    return "interrupted" if watch.interruption.requested and watch.statistics.steps < watch.total else "finished"
