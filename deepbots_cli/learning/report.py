"""Results for people, as aligned text, and for machines, as plain dictionaries; and the progress of a training."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from shlex import quote
from typing import TYPE_CHECKING, Any, TextIO

from pydantic import BaseModel

from deepbots_cli.learning.episodes import Interval, SolvedAt, Summary
from deepbots_cli.learning.run import TrainingResult
from deepbots_cli.progress import ProgressBar

if TYPE_CHECKING:
    from deepbots_cli.learning.evaluation import EvaluationResult

Row = tuple[str, str]


def training_text(result: TrainingResult) -> str:
    """What a training came to, one figure per line, and how to go on."""
    rows = [
        ("run", str(result.run)),
        ("steps", f"{result.steps:,} of {result.total_timesteps:,}"),
        ("episodes", f"{result.episodes:,}"),
        ("simulated time", f"{result.simulated_hours:.3f} h"),
        ("CPU time", f"{result.cpu_seconds:.1f} s"),
    ]
    for end in result.stages:
        rows.append((f"stage {end.name}", f"done after {end.steps:,} steps, {end.episodes:,} episodes"))
    if result.stage is not None:
        rows.append(("last stage", result.stage))
    if result.mean_return is not None:
        rows.append(("mean return", f"{result.mean_return:.1f} over the recent episodes"))
    if result.success_rate:
        rows.append(("success rate", f"{result.success_rate:.0%}"))
    at = result.solved_at
    if at is not None:
        rows.append(
            ("solved", f"in episode {at.episode:,}, after {at.simulated_hours:.3f} simulated h and {at.cpu_seconds:.1f} s of CPU time")
        )
    if result.initialized_from is not None:
        rows.append(("initialized from", result.initialized_from))
    lines = [f"training {result.status}", *_aligned(rows), *(f"note: {reason}" for reason in result.inexact)]
    if result.interrupted:
        lines.append(f"evaluate what was learned with: deepbots eval {quote(str(result.run))}")
        lines.append(f"what was learned is kept; go on with: deepbots train --resume {quote(str(result.run))}")
    return "\n".join(lines)


def evaluation_text(result: EvaluationResult, elsewhere: str | None = None) -> str:
    """Figures with their intervals, how the episodes ended, and the verdict as last line.

    `elsewhere` is the scenario, in words, where it is not the one of the training.
    """
    rows = [
        ("model", f"{result.run} ({result.model})"),
        *([("scenario", elsewhere)] if elsewhere is not None else []),
        ("episodes", f"{result.episodes:,} held-out starts from seed {result.seed}{'' if result.deterministic else ', actions sampled'}"),
        *_rows(result, success_defined=result.success_defined),
    ]
    rows += (
        [(f"reward {name}", f"{mean:.2f} per episode") for name, mean in result.term_means.items()] if len(result.term_means) > 1 else []
    )
    if result.video is not None:
        rows.append(("video", str(result.video)))
    notes = (f"note: {note}" for note in result.notes)
    return "\n".join(
        [f"evaluation of {result.scenario}{f', case {result.case}' if result.case else ''}", *_aligned(rows), *notes, result.verdict]
    )


def summary_text(summary: Summary, *, success_defined: bool) -> str:
    """The same rows for episodes without a trained policy."""
    return "\n".join([f"summary of {summary.episodes:,} episodes", *_aligned(_rows(summary, success_defined=success_defined))])


def _rows(result: EvaluationResult | Summary, *, success_defined: bool) -> list[Row]:
    rows = [
        ("mean return", f"{_number(result.mean_return)}{_deviation(result)}"),
        ("minimum, maximum", f"{_number(result.least_return)}, {_number(result.greatest_return)}"),
        ("mean length", f"{result.mean_length:.1f} steps"),
        ("ended by", ", ".join(f"{name} {count}" for name, count in result.endings.items())),
    ]
    if success_defined:
        low, high = result.success_interval
        rows.append(("success rate", f"{result.success_rate:.1%} (95 %: {low:.1%} .. {high:.1%})"))
    return rows


def case_rows(results: Sequence[EvaluationResult]) -> list[dict[str, object]]:
    """A row for each evaluation, to be shown side by side; ranges are intervals of 95 %."""
    rows: list[dict[str, object]] = []
    for result in results:
        row: dict[str, object] = {
            "case": result.case or "(the scenario itself)",
            "episodes": result.episodes,
            "mean_return": result.mean_return,
        }
        row["of_return"] = _between(result.return_interval)
        if any(other.success_defined for other in results):
            row |= {"success": result.success_rate, "of_success": _between(result.success_interval)}
        rows.append(row | {"mean_length": result.mean_length})
    return rows


def _between(interval: Interval | None) -> str:
    return "" if interval is None else f"{interval[0]:.4g} .. {interval[1]:.4g}"


def to_json(result: TrainingResult | EvaluationResult) -> dict[str, Any]:
    """The fields of a result, with paths as text."""
    if isinstance(result, BaseModel):
        return result.model_dump(mode="json")
    return {key: str(value) if isinstance(value, Path) else value for key, value in asdict(result).items()}


def _deviation(result: EvaluationResult | Summary) -> str:
    if result.deviation is None or result.return_interval is None:
        return ""
    low, high = result.return_interval
    return f"; standard deviation {_number(result.deviation)} (95 % confidence interval of the mean: {_number(low)} .. {_number(high)})"


def _number(value: float) -> str:
    """Two decimals; four where returns are small."""
    return f"{value:.4f}" if 0 < abs(value) < 1 else f"{value:.2f}"


def solved_text(at: SolvedAt | None) -> str:
    return "not yet" if at is None else f"in episode {at.episode:,}"


def _aligned(rows: Iterable[Row]) -> list[str]:
    rows = list(rows)
    width = max(len(label) for label, _ in rows)
    return [f"  {label:<{width}}  {value}" for label, value in rows]


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

    def note(self, text: str) -> None:
        """Called before `start` with what the user should know."""

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

    def note(self, text: str) -> None:
        print(f"note: {text}", file=self._stream or sys.stderr)

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
