"""Evaluation: a trained policy on held-out episodes, with intervals and a verdict."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import ExitStack, closing
from dataclasses import dataclass
from pathlib import Path

import torch
from stable_baselines3.common.base_class import BaseAlgorithm

from deepbots_cli import interface
from deepbots_cli.api import Compiled
from deepbots_cli.errors import RunError, UsageError
from deepbots_cli.learning import algorithms, video, weights
from deepbots_cli.learning.environments import BuildWorld, World, copies_over
from deepbots_cli.learning.episodes import Episode, meets
from deepbots_cli.learning.intervals import Pair
from deepbots_cli.learning.rollout import ROWS, OnEpisode, rollout
from deepbots_cli.learning.run import ModelName, Run
from deepbots_cli.learning.summary import Summary
from deepbots_cli.learning.training import compiled_of, default_build
from deepbots_cli.program import Program
from deepbots_cli.program.task import Solved
from deepbots_cli.runtime.streams import derive
from deepbots_cli.scenario import Scenario


@dataclass(frozen=True)
class EvaluationResult:
    """What a policy did in `episodes` held-out episodes; intervals are of 95 %.

    `case` is None for the scenario itself. `deviation` is the sample's; it and `return_interval` are None for a single
    episode. `solved` is None where the scenario says nothing, or asks for more episodes than there were; `verdict` puts it in
    words. Where the scenario knows no success (`success_defined`), the success rate is 0 and means nothing.
    """

    run: Path
    scenario: str
    case: str | None
    model: ModelName
    episodes: int
    seed: int
    deterministic: bool
    mean_return: float
    deviation: float | None
    return_interval: Pair | None
    least_return: float
    greatest_return: float
    success_defined: bool
    successes: int
    success_rate: float
    success_interval: Pair
    mean_length: float
    endings: Mapping[str, int]
    term_means: Mapping[str, float]
    solved: bool | None
    verdict: str
    video: Path | None
    notes: tuple[str, ...]


def evaluate(
    run: Run | str | Path,
    *,
    episodes: int | None = None,
    seed: int | None = None,
    deterministic: bool = True,
    model: ModelName = "best",
    scenario: Compiled | Scenario | str | Path | None = None,
    case: str | None = None,
    video_to: str | Path | None = None,
    copies: int = ROWS,
    allow_code: bool = False,
    build: BuildWorld | None = None,
    on_episode: OnEpisode | None = None,
) -> EvaluationResult:
    """Evaluate the policy of a run on episodes that it was not trained on.

    Episode k starts from a seed of its own, derived from the stream `evaluation` of `seed`: the result is the same however
    many worlds run at once, and the first ten of a hundred episodes are those of an evaluation of ten. No episode of the
    training starts from such a seed. All cases take the same seeds, so that they differ by their settings alone.

    Args:
        run: The run, or its directory.
        episodes: The scenario's figure by default.
        seed: The root of the stream, from 0; the training's by default.
        deterministic: Whether the policy takes its likeliest action; else it samples, from seeded streams too.
        model: `best` by its trial during the training, or `last`.
        scenario: Another scenario to evaluate in, as for `train`; its observation, action and messages must be those of the run.
        case: One of the scenario's cases to evaluate in, by name.
        video_to: Where to write the first episode as mp4.
        copies: Worlds at a time, 1 to 8.
        allow_code: Whether terms in Python run.
        build: Makes a world of the scenario in place of the generated supervisor.
        on_episode: Is told after each episode how many are done, and of how many.

    Raises:
        RunError: No run, a damaged one, or one that does not fit `scenario`; says field by field why.
        UsageError: The figures make no sense, or the video cannot be written.
        MissingExtraError: A video is wanted and imageio is not installed.
    """
    torch.set_num_threads(1)
    known = run if isinstance(run, Run) else Run.open(run)
    program = known.program if scenario is None else _fitting(known, compiled_of(scenario).program)
    count = program.evaluation.episodes if episodes is None else episodes
    if case is not None:
        chosen = program.case(case)
        program, count = chosen.program, chosen.episodes if episodes is None else episodes
    root = known.record.seed if seed is None else seed
    if count < 1 or root < 0:
        raise UsageError(f"{count} episodes from seed {root} cannot be evaluated; episodes count from 1, seeds from 0")
    video_to = None if video_to is None else Path(video_to)
    if video_to is not None:
        video.check(video_to)
    make = build or default_build(known.record.engine, allow_code=allow_code)
    seeds = [derive(root, "evaluation", k) for k in range(count)]
    with ExitStack() as stack:
        worlds = []
        for _ in range(min(count, max(1, min(copies, ROWS)) if deterministic else 1)):
            worlds.append(make(program))
            stack.callback(worlds[-1].close)
        policy = load(known, model, worlds[0])
        told = {} if on_episode is None else {"on_episode": on_episode}
        done = rollout(policy, worlds, seeds, deterministic=deterministic, **told)
    if video_to is not None:
        with closing(make(program, render_mode="rgb_array")) as world, video.filmed(world, video_to, 1 / program.period) as filmed:
            rollout(policy, [filmed], seeds[:1], deterministic=deterministic)
    return _summary(known, program, case, model, root, done, deterministic=deterministic, video_to=video_to)


def evaluate_cases(
    run: Run | str | Path,
    *,
    episodes: int | None = None,
    seed: int | None = None,
    model: ModelName = "best",
    scenario: Compiled | Scenario | str | Path | None = None,
    allow_code: bool = False,
    build: BuildWorld | None = None,
    on_episode: OnEpisode | None = None,
) -> tuple[EvaluationResult, ...]:
    """Evaluate in every case of the scenario, in file order; arguments and errors as for `evaluate`."""
    scenario = None if scenario is None else compiled_of(scenario)
    known = run if isinstance(run, Run) else Run.open(run)
    return tuple(
        evaluate(
            known,
            episodes=episodes,
            seed=seed,
            model=model,
            scenario=scenario,
            case=case.name,
            allow_code=allow_code,
            build=build,
            on_episode=on_episode,
        )
        for case in (known.program if scenario is None else scenario.program).cases
    )


def load(run: Run, name: ModelName, world: World) -> BaseAlgorithm:
    """The model of a run, rebuilt from its scenario for the spaces of `world`, with the weights of `models/<name>.npz`.

    Raises:
        RunError: The file is missing, damaged, or fits another policy.
    """
    training = run.program.policy.training
    if training is None:
        raise RunError(f"{run.path} holds a scenario without a 'train' section")
    algorithms.check(training)
    spaces_only = copies_over([world], [0])
    model = algorithms.create(training, spaces_only, seed=0, total_timesteps=1, to_learn=False)
    weights.put(model, weights.read(run.model(name), model))
    model.policy.set_training_mode(False)
    return model


def _fitting(run: Run, program: Program) -> Program:
    differences = interface.differences(run.program, program)
    if differences:
        lines = "\n  ".join(differences)
        raise RunError(f"{run.path} was trained for another observation, action or messages than {program.name} has:\n  {lines}")
    return program


def _summary(
    run: Run,
    program: Program,
    case: str | None,
    model: ModelName,
    seed: int,
    done: Sequence[Episode],
    *,
    deterministic: bool,
    video_to: Path | None,
) -> EvaluationResult:
    figures = Summary.of(done)
    solved, verdict = judge(program.solved, figures.episodes, figures.mean_return, figures.success_rate)
    return EvaluationResult(
        run=run.path,
        scenario=program.name,
        case=case,
        model=model,
        seed=seed,
        deterministic=deterministic,
        success_defined=program.defines_success,
        solved=solved,
        verdict=verdict,
        video=video_to,
        notes=(*run.notes(), *interface.other_conditions(run.program, program)),
        **vars(figures),
    )


def judge(solved: Solved | None, episodes: int, mean_return: float, success_rate: float) -> tuple[bool | None, str]:
    """Whether such an evaluation solves the task (None: cannot be told), and why."""
    if solved is None:
        return None, "the scenario does not say what counts as solved"
    if episodes < solved.episodes:
        return None, f"cannot be told from {episodes} episode{'' if episodes == 1 else 's'}: the scenario asks for {solved.episodes}"
    reasons = []
    if solved.mean_return is not None:
        reasons.append(f"mean return {mean_return:.4g} where {solved.mean_return:g} is asked")
    if solved.success_rate is not None:
        reasons.append(f"success rate {success_rate:.1%} where {solved.success_rate:.1%} is asked")
    met = meets(solved, mean_return, success_rate)
    return met, f"{'solved' if met else 'not solved'}: {', '.join(reasons)}"
