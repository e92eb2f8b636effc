"""Results as plain dictionaries, and the progress of a training."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, TextIO

from pydantic import BaseModel

from deepbots_cli.learning.episodes import SolvedAt
from deepbots_cli.learning.run import TrainingResult
from deepbots_cli.progress import ProgressBar

if TYPE_CHECKING:
    from deepbots_cli.learning.evaluation import EvaluationResult


def to_json(result: TrainingResult | EvaluationResult) -> dict[str, Any]:
    """The fields of a result, with paths as text; of an evaluation also the statistics by drawn value."""
    if isinstance(result, BaseModel):
        return result.model_dump(mode="json")
    data = {key: str(value) if isinstance(value, Path) else value for key, value in asdict(result).items()}
    return data | {"by_drawn_value": {name: list(map(asdict, bins)) for name, bins in result.by_drawn_value.items()}}


def solved_text(at: SolvedAt | None) -> str:
    return "not yet" if at is None else f"in episode {at.episode:,}"


# The progress of a training


@dataclass(frozen=True)
class TrainingProgress:
    """How far a training is.

    The means are over the recent episodes, None before the first has ended; the success rate is None too where the scenario knows no
    success. `stage` is for people to read.
    """

    steps: int
    total_steps: int
    episodes: int
    mean_return: float | None
    success_rate: float | None
    stage: str = ""


class Reporter:
    """Follows a training: `start` once, `update` from time to time, `stop` once, also after a failure. This one reports nothing."""

    def start(self, progress: TrainingProgress) -> None:
        pass

    def update(self, progress: TrainingProgress) -> None:
        pass

    def stop(self) -> None:
        pass


class ProgressReporter(Reporter):
    """A bar on a terminal, a line for every tenth of the way elsewhere."""

    def __init__(self, stream: TextIO | None = None) -> None:
        self._stream = stream
        self._bar: ProgressBar | None = None

    def start(self, progress: TrainingProgress) -> None:
        self._bar = ProgressBar(progress.total_steps, "steps", done=progress.steps, stream=self._stream)

    def update(self, progress: TrainingProgress) -> None:
        if self._bar is not None:
            self._bar.update(progress.steps, progress_text(progress))

    def stop(self) -> None:
        if self._bar is not None:
            self._bar.close()


def reporter(wish: bool | Reporter) -> Reporter:
    """The reporter meant by `progress=`: none, one of the caller's, or a display on standard error."""
    if not isinstance(wish, bool):
        return wish
    return ProgressReporter() if wish else Reporter()


def progress_text(progress: TrainingProgress) -> str:
    """`return 182.4  success 40 %  94 episodes`; what matters most comes first, as a narrow terminal cuts the rest off."""
    parts = []
    if progress.mean_return is not None:
        parts.append(f"return {progress.mean_return:.1f}")
    if progress.success_rate is not None:
        parts.append(f"success {progress.success_rate:.0%}")
    if progress.stage:
        parts.append(progress.stage)
    return "  ".join([*parts, f"{progress.episodes:,} episodes"])
