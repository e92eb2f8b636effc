"""The repetition of a training, and whether it gives the same policy."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

from deepbots_cli.document import Permissions
from deepbots_cli.errors import RunError
from deepbots_cli.learning.executor import SERIAL, Executor
from deepbots_cli.learning.report import Reporter
from deepbots_cli.learning.runs.records import RunRecord, TrainingResult
from deepbots_cli.learning.runs.run import Run
from deepbots_cli.learning.training import train
from deepbots_cli.records import dataclass
from deepbots_cli.rollout.source import SourceKind, folder_kind
from deepbots_cli.words import shell_word


@dataclass(frozen=True)
class Repetition:
    """The repetition of a training.

    Attributes:
        original: The run that was repeated.
        training: The repeated training, in a run of its own.
        is_same: Whether the weights are the same, bit for bit.
        differences: What differs between the two trainings: versions, the processor, the scenario.
    """

    original: Path
    training: TrainingResult
    is_same: bool
    differences: tuple[str, ...]


def repeat(
    run: str | Path,
    *,
    new: str | Path | None = None,
    progress: bool | Reporter = False,
    permissions: Permissions = Permissions(),
    executor: Executor = SERIAL,
    on_start: Callable[[Path], object] = lambda run: None,
) -> Repetition:
    """Train a run again from its own scenario, seed and options, and compare the weights.

    Args:
        new: The directory of the new run; by default as for `train`, beside the old one or its group.
        permissions: With `code`, terms in Python run.

    Raises:
        RunError: The folder is not a run, its training is not finished, or a study or a callback ended it.
        DeepbotsError: As for `train`.
    """
    source = Run.open(run)
    record = source.record
    if record.result is None or not record.is_finished:
        raise RunError(
            f"the training of {source.path} is not finished; finish it with:"
            f" deepbots resume {shell_word(source.path)}"
        )
    taught = next((path for path in (source.demonstrations, source.teacher) if path.exists()), None)
    initial = source.model("initial")
    folder = source.path.resolve().parent
    training = train(
        replace(source.compiled, permissions=permissions),
        run=new,
        runs=folder.parent if folder_kind(folder) is SourceKind.GROUP else folder,
        seed=record.seed,
        total_timesteps=record.total_timesteps,
        stop_when_solved=record.stop_when_solved,
        stage=record.first_stage,
        keep_checkpoints=record.keep_checkpoints,
        initialize_from=initial if initial.exists() else None,
        demonstrations=taught,
        callbacks=record.callbacks,
        loggers=record.loggers,
        progress=progress,
        command=("deepbots", "repeat", str(run)),
        engine=record.engine,
        executor=executor,
        on_start=on_start,
    )
    is_same = training.weights_digest == record.result.weights_digest
    differences = tuple(_differences(record, RunRecord.read(training.run)))
    return Repetition(source.path, training, is_same, differences)


def _differences(before: RunRecord, now: RunRecord) -> Iterator[str]:
    if before.digest != now.digest:
        yield f"scenario: digest {before.digest[:8]}, now {now.digest[:8]}"
    if before.physics != now.physics:
        yield f"physics: version {before.physics}, now {now.physics}"
    if before.origin is None or now.origin is None:
        yield f"versions: {dict(before.versions)}, now {dict(now.versions)}"
    else:
        yield from before.origin.differences(now.origin)
    if before.resumed_at:
        steps = ", ".join(f"{step:,}" for step in before.resumed_at)
        yield f"the first training was resumed at {steps} steps, perhaps with other options"
