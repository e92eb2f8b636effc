"""The best model of a run after its training: chosen again on new starts, or by hand (`deepbots eval
--keep`).

All models that the run has play new starts by the rule of the training (`order.play_off`). The best one
becomes `best.zip`, and the best one of before `earlier-1.zip`. Nothing is lost: a resumed training begins
with the models of its checkpoint again, so what it would overwrite is copied to `step-000020000.zip`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from shlex import quote
from typing import Any

from deepbots_cli.document import Permissions
from deepbots_cli.errors import RunError, StorageError, UsageError
from deepbots_cli.files import unwritable_message
from deepbots_cli.learning.calls import Counter
from deepbots_cli.learning.environments import WorldFactory
from deepbots_cli.learning.evaluation import play_models
from deepbots_cli.learning.executor import SERIAL, Executor
from deepbots_cli.learning.model_files import steps_of
from deepbots_cli.learning.runs.directories import run_lock
from deepbots_cli.learning.runs.order import (
    Candidate,
    Measure,
    copy_model,
    measure_of,
    play_off,
)
from deepbots_cli.learning.runs.records import BestModel
from deepbots_cli.learning.runs.run import ModelName, ModelRef, Run, has_model
from deepbots_cli.rollout import Episode
from deepbots_cli.runtime.streams import derive_seed

_KINDS = ("best", "step", "candidate", "earlier", "last")
"""The names of models that may become the best one, before a hyphen. If models have the same steps, the first
kind is used."""


@dataclass(frozen=True)
class PlayedModel:
    """A model that played new starts, and its result."""

    name: ModelName
    result: Candidate


@dataclass(frozen=True)
class KeptModel:
    """The model that is the best one of a run from now on.

    Attributes:
        run: The run, with its new record.
        name: The name of the chosen model.
        best: Its entry in the record.
        earlier: The file of the best model of before; None if it is the same model, or there was none.
        played: The models that played new starts, the best one first; none if a person chose.
    """

    run: Run
    name: ModelName
    best: BestModel
    earlier: Path | None
    played: tuple[PlayedModel, ...]


def keep(
    ref: ModelRef,
    *,
    permissions: Permissions = Permissions(),
    build: WorldFactory | None = None,
    on_model: Callable[[int, int], object] | None = None,
    executor: Executor = SERIAL,
) -> KeptModel:
    """Make a model the best one of its run: the model that was named, or of a run, the best one on new
    starts.

    Args:
        ref: The run or the model.
        permissions: With `code`, the scenario may run functions of installed Python packages.
        build: Function that makes a world of the scenario, in place of the generated supervisor.
        on_model: Called after each model of each round with the number of those done and of all.
        executor: Where the models play; the result does not depend on it.

    Raises:
        UsageError: A training is at work in the run or has not ended, or the run has a single model.
        RunError: A model is damaged, or the run cannot be written to.
    """
    folder = ref.run.path
    with run_lock(folder):
        # A training that has just ended in the folder has changed the record.
        run = Run.open(folder)
        result = run.record.result
        if result is None:
            raise UsageError(
                f"the training of {folder} has not ended; continue it with: deepbots resume"
                f" {quote(str(folder))}"
            )
        if ref.is_named and not has_model(folder, ref.name):
            raise RunError(
                f"{ref.path} is not a model that can be kept; names are such as last.zip and"
                " step-000020000.zip"
            )
        program = run.program
        before = result.best_model
        measure = measure_of(program.agent.solved, defines_success=program.defines_success)
        previous = 0 if before is None or before.evaluation_seed is None else before.evaluation_seed
        evaluation_seed = _six_digits(run, "kept", previous)
        played: list[PlayedModel] = []
        if ref.is_named:
            name = ref.name
            best = BestModel(
                steps=steps_of(ref.path), chosen_by="hand", measure=measure, evaluation_seed=evaluation_seed
            )
        else:
            options = {
                "seed": _six_digits(run, "choice", previous),
                "permissions": permissions,
                "build": build,
            }
            played = _played(run, measure, on_model, executor, options)
            name, winner = played[0].name, played[0].result
            best = BestModel(
                steps=winner.steps,
                chosen_by="new starts",
                measure=measure,
                episodes=winner.episodes,
                success_rate=winner.success_rate if program.defines_success else None,
                mean_return=winner.mean_return,
                evaluation_seed=evaluation_seed,
            )
        try:
            is_same = _is_best(run, name)
            earlier = None if is_same else _put_first(run, name)
        except OSError as error:
            raise StorageError(unwritable_message(run.model("best"), error)) from error
        if is_same:  # the evaluations and the confirmation of this model stay
            run.update(updated=run.record.updated, result=result.model_copy(update={"best": best}))
        else:
            result = result.model_copy(update={"best": best, "confirmed_seed": None})
            run.update(result=result, quoted=None)
    return KeptModel(run, name, best, earlier, tuple(played))


def _six_digits(run: Run, stream: str, number: int) -> int:
    """Return a root seed that is easy to repeat."""
    return 100_000 + derive_seed(run.record.seed, stream, number) % 900_000


def kept_models(run: Run) -> dict[int, ModelName]:
    """Return the models of a run by their steps; two models with the same steps are the same model."""
    names = [
        path.stem for path in sorted(run.model("best").parent.glob("*.zip")) if has_model(run.path, path.stem)
    ]
    models: dict[int, ModelName] = {}
    for kind in _KINDS:
        for name in names:
            if name.partition("-")[0] == kind:
                models.setdefault(steps_of(run.model(name)), name)
    return models


def _played(
    run: Run,
    measure: Measure,
    on_model: Callable[[int, int], object] | None,
    executor: Executor,
    options: dict[str, Any],
) -> list[PlayedModel]:
    """Play new starts with all models of a run. Returns them with their results, the best one first.

    Raises:
        UsageError: There is a single model.
    """
    names = kept_models(run)
    if len(names) < 2:
        raise UsageError(
            f"{run.path} has a single model, so there is nothing to choose; `deepbots train"
            " --keep-checkpoints N` keeps more of them"
        )
    watcher = Counter(on_model, _model_count(len(names)))

    def play(steps: Sequence[int], numbers: range) -> Iterable[list[Episode]]:
        return play_models(
            run, [names[step] for step in steps], numbers, watcher=watcher, executor=executor, **options
        )

    results, _ = play_off(list(names), play, measure)
    return [PlayedModel(names[result.steps], result) for result in results]


def _model_count(models: int) -> int:
    """Return the number of models that play, over all rounds."""
    count = models
    while (models := (models + 1) // 2) > 1:
        count += models
    return count


def _is_best(run: Run, name: ModelName) -> bool:
    best = run.model("best")
    return best.is_file() and steps_of(best) == steps_of(run.model(name))


def _put_first(run: Run, name: ModelName) -> Path | None:
    """Make a model the best one. Returns the file of the best model of before, if there is one."""
    best = run.model("best")
    source = run.model(name)
    earlier = None
    if best.is_file():
        number = 1
        while run.model(f"earlier-{number}").exists():
            number += 1
        earlier = run.model(f"earlier-{number}")
        copy_model(best, earlier)
    checkpoint = run.model(f"step-{steps_of(source):09d}")
    if name == "last" and not checkpoint.exists():
        copy_model(source, checkpoint)
    copy_model(source, best)
    return earlier
