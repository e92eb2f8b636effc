"""Results for people, as aligned text, and for machines, as plain dictionaries."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import asdict
from pathlib import Path
from shlex import quote
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from deepbots_cli.learning.evaluation import EvaluationResult
    from deepbots_cli.learning.intervals import Pair
    from deepbots_cli.learning.summary import Summary
    from deepbots_cli.learning.training import TrainingResult

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
    lines = [f"training {result.status}", *_aligned(rows)]
    if result.interrupted:
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
        *_figures(result, success_defined=result.success_defined),
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
    """The same figures of episodes without a trained policy."""
    return "\n".join([f"summary of {summary.episodes:,} episodes", *_aligned(_figures(summary, success_defined=success_defined))])


def _figures(result: EvaluationResult | Summary, *, success_defined: bool) -> list[Row]:
    rows = [
        ("mean return", f"{_figure(result.mean_return)}{_deviation(result)}"),
        ("least, greatest", f"{_figure(result.least_return)}, {_figure(result.greatest_return)}"),
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


def _between(interval: Pair | None) -> str:
    return "" if interval is None else f"{interval[0]:.4g} .. {interval[1]:.4g}"


def to_json(result: TrainingResult | EvaluationResult) -> dict[str, Any]:
    """The fields of a result, with paths as text."""
    return {key: str(value) if isinstance(value, Path) else value for key, value in asdict(result).items()}


def _deviation(result: EvaluationResult | Summary) -> str:
    if result.deviation is None or result.return_interval is None:
        return ""
    low, high = result.return_interval
    return f", deviation {_figure(result.deviation)} (95 % interval of the mean: {_figure(low)} .. {_figure(high)})"


def _figure(value: float) -> str:
    """Two decimals; four where returns are small."""
    return f"{value:.4f}" if 0 < abs(value) < 1 else f"{value:.2f}"


def _aligned(rows: Iterable[Row]) -> list[str]:
    rows = list(rows)
    width = max(len(label) for label, _ in rows)
    return [f"  {label:<{width}}  {value}" for label, value in rows]
