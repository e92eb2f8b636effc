"""Plots of trainings: returns, success rates, reward terms and endings over the timesteps, with a band over seeds."""

from __future__ import annotations

import json
import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from statistics import fmean
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from deepbots_cli.errors import MissingExtraError, RunError, UsageError
from deepbots_cli.files import read_at_most
from deepbots_cli.learning.episodes import read_log
from deepbots_cli.learning.group import is_group
from deepbots_cli.learning.run import RECORD_NAME, EvaluationRecord, RunRecord, changed_settings, run_folders, short_settings
from deepbots_cli.learning.verdict import quoted_evaluation
from deepbots_cli.view.page import COLOURS

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

SUFFIXES = (".png", ".svg")
_MAX_CURVE_POINTS = 200  # of a curve
_MAX_COLOURED_ENDINGS = 20  # that have a colour of their own
_MAX_LOG_BYTES = 1 << 28  # of a log
_LINE_STYLES = ("-", "--", "-.", ":")
THEMES = {"light": ("#ffffff", "#202428", "#d5d8dc"), "dark": ("#16181c", "#e4e6ea", "#3c4046")}
"""Background, text and grid."""
_EPISODE_COLUMNS = (
    *((name, float) for name in ("steps", "returns", "lengths", "successes")),
    *((name, object) for name in ("endings", "stages", "drawn")),
)
Curve = tuple[NDArray[np.float64], NDArray[np.float64]]
"""Timesteps and values."""


@dataclass
class TrainingLog:
    """What is known of one training: curves; reward terms and shares of endings by name. `group` is the scenario with
    its digest, `settings` are the values that `--set` changed, and `name` is what its line is called."""

    path: Path
    group: str
    name: str = ""
    settings: str = ""
    returns: Curve | None = None
    successes: Curve | None = None
    evaluations: Curve | None = None
    terms: dict[str, Curve] = field(default_factory=dict)
    endings: dict[str, Curve] = field(default_factory=dict)
    evaluation: EvaluationRecord | None = None


def read_logs(paths: Sequence[str | Path], window: int = 100) -> list[TrainingLog]:
    """Read runs, folders of runs, and folders of TensorBoard files that other programs wrote.

    Args:
        window: The number of episodes that returns and successes are averaged over.

    Raises:
        RunError: One is neither, is damaged, or holds no episode yet.
        MissingExtraError: TensorBoard is not installed.
    """
    found = [_read_run(path, window) if (path / RECORD_NAME).is_file() else _read_tensorboard(path) for path in run_folders(paths)]
    first = {log.group: log.path for log in reversed(found)}  # the first run of each scenario
    # Scenarios of one name that differ are called after the folder of their first run or group, or its path if folders share a name.
    folders = {group: path.parent if is_group(path.parent) else path for group, path in first.items()}
    candidates = (
        {group: group.rpartition(" ")[0] for group in first},
        {group: path.name for group, path in folders.items()},
        {group: str(path) for group, path in first.items()},
    )
    for log in found:
        name = next((names[log.group] for names in candidates if list(names.values()).count(names[log.group]) == 1), log.group)
        log.name = f"{name} ({log.settings})" if log.settings and len(first) > 1 else name
    return found


def _read_run(path: Path, window: int) -> TrainingLog:
    record = RunRecord.read(path)
    log = TrainingLog(path, f"{record.scenario} {record.digest}", settings=short_settings(changed_settings(record.command)))
    episodes, evaluations = logs_of(path)
    if not len(episodes):
        raise RunError(f"{path} holds no finished episode yet; plot it later")
    steps, successes = episodes.steps, episodes.successes
    log.returns = _averaged(steps, episodes.returns, window)
    endings = episodes.endings.astype(str)
    common = [name for name, _ in Counter(endings.tolist()).most_common(_MAX_COLOURED_ENDINGS)]
    shares = {name or "unknown": endings == name for name in common} | {"others": ~np.isin(endings, common)}
    log.endings = {name: _averaged(steps, share.astype(float), window) for name, share in shares.items() if share.any()}
    if found := quoted_evaluation(path, record):
        log.evaluation = found[1]
    log.successes = _averaged(steps, successes, window) if successes.any() else None
    if evaluations:
        log.evaluations = (np.array([line["steps"] for line in evaluations]), np.array([fmean(line["returns"]) for line in evaluations]))
    scalars = scalars_of(path / "tensorboard")
    finite = {tag: (at[np.isfinite(values)], values[np.isfinite(values)]) for tag, (at, values) in scalars.items()}
    log.terms = {tag.removeprefix("reward/"): curve for tag, curve in finite.items() if tag.startswith("reward/") and len(curve[0])}
    return log


def _read_tensorboard(path: Path) -> TrainingLog:
    """What Stable-Baselines3 writes."""
    if not path.is_dir():
        raise RunError(f"{path} is neither a run nor a folder of TensorBoard files")
    scalars = scalars_of(path)
    names = {"returns": "rollout/ep_rew_mean", "successes": "rollout/success_rate", "evaluations": "eval/mean_reward"}
    if not scalars.keys() & names.values():
        raise RunError(f"{path} is not a run, and its TensorBoard files hold none of {', '.join(names.values())}")
    log = TrainingLog(path, f"{path.name} ")
    log.returns, log.successes, log.evaluations = (scalars.get(tag) for tag in names.values())
    return log


def logs_of(run: Path) -> tuple[Any, list[dict[str, Any]]]:
    """The episodes of a training and its evaluations, both in order; a last line that is half written is left out.

    Episodes are a record array with the timesteps at their end (`steps`), `returns`, `lengths`, `successes` (1 or 0), `endings`, `stages`
    of the curriculum ("" without one), and `drawn`, the drawn values as JSON ("" without them). Evaluations are dictionaries of `steps`,
    of the `stage` in which the policy acted, and of the `returns` and `successes` of their episodes.

    Raises:
        RunError: A file is no regular file, too large, or damaged.
    """
    rows, text = read_log(run / "monitor.csv"), _text(run / "evaluations" / "training.jsonl")
    names = ("steps", "r", "l", "is_success")
    evaluations: list[dict[str, Any]] = []
    try:
        texts = ("ended_by", "stage", "drawn")
        found = [(*(float(row[name]) for name in names), *(row.get(name) or "" for name in texts)) for row in rows]
        for line in map(json.loads, text[: text.rfind("\n") + 1].splitlines()):
            lists = {name: [float(value) for value in line[name]] for name in ("returns", "successes")}
            evaluations.append({"steps": float(line["steps"]), "stage": str(line.get("stage") or ""), **lists})
        ends = [*(each[0] for each in found), *(each["steps"] for each in evaluations)]
        means = [fmean(each[name]) for each in evaluations for name in ("returns", "successes")]  # an error without an episode
        if not all(map(math.isfinite, [*ends, *means, *(number for each in found for number in each[1:4])])) or min(ends, default=0) < 0:
            raise ValueError("a number is not finite, or a step is negative")
    except (KeyError, TypeError, ValueError, OverflowError, RecursionError) as error:
        raise RunError(f"{run} is damaged: one of its logs cannot be read") from error
    return np.array(found, list(_EPISODE_COLUMNS)).view(np.recarray), evaluations


def _text(path: Path) -> str:
    if path.is_symlink() or (path.exists() and not path.is_file()):  # opening a pipe waits for ever
        raise RunError(f"{path} is not a regular file")
    text = read_at_most(path, _MAX_LOG_BYTES + 1).decode(errors="replace") if path.exists() else ""
    if len(text) > _MAX_LOG_BYTES:
        raise RunError(f"{path} is larger than {_MAX_LOG_BYTES >> 20} MiB")
    return text


def scalars_of(path: Path) -> dict[str, Curve]:
    """The scalars of the TensorBoard files in a folder and those below, by tag.

    Raises:
        RunError: One is no regular file.
        MissingExtraError: TensorBoard is not installed.
    """
    files = sorted(path.glob("**/events.out.tfevents.*"))
    if not files:
        return {}
    for file in files:
        if not file.is_file():  # opening a pipe waits for ever
            raise RunError(f"{file} is not a regular file")
    try:
        from tensorboard.backend.event_processing.event_accumulator import EventAccumulator
    except ModuleNotFoundError as error:
        raise MissingExtraError("train", "reading TensorBoard files") from error
    found: dict[str, list[tuple[float, float]]] = {}
    for folder in sorted({file.parent for file in files}):
        events = EventAccumulator(str(folder), size_guidance={"scalars": 0})
        events.Reload()
        for tag in events.Tags()["scalars"]:
            found.setdefault(tag, []).extend((float(event.step), event.value) for event in events.Scalars(tag))
    return {tag: (np.array([s for s, _ in sorted(rows)]), np.array([v for _, v in sorted(rows)])) for tag, rows in found.items()}


def _averaged(steps: NDArray[np.float64], values: NDArray[np.float64], window: int) -> Curve:
    """Means over so many episodes up to each."""
    sums = np.concatenate([[0.0], np.cumsum(values)])
    ends = np.arange(1, len(values) + 1)
    starts = np.maximum(0, ends - window)
    return steps, (sums[ends] - sums[starts]) / (ends - starts)


def plot(logs: Sequence[TrainingLog], *, theme: str = "light") -> Figure:
    """A figure of trainings: those of one scenario are one line, the mean of its seeds, with a band from the lowest to the highest seed.

    Raises:
        MissingExtraError: matplotlib is not installed.
    """
    try:
        from matplotlib.figure import Figure
    except ModuleNotFoundError as error:
        raise MissingExtraError("view", "a plot") from error
    groups: dict[str, list[TrainingLog]] = {}
    for log in logs:
        groups.setdefault(log.group, []).append(log)
    if len(groups) > len(COLOURS):
        raise UsageError(f"{len(groups)} scenarios are too many for one plot; at most {len(COLOURS)} can be told apart")
    detailed = [members for members in groups.values() if any(log.terms or log.endings for log in members)]
    figure = Figure(figsize=(10.0, 3.4 + 2.7 * len(detailed)), layout="constrained", facecolor=THEMES[theme][0])
    axes = figure.subplots(1 + len(detailed), 2, squeeze=False)
    returns, successes = axes[0]
    for left in axes[2:, 0]:
        left.sharey(axes[1, 0])  # reward terms of two scenarios are compared by eye
    for number, members in enumerate(groups.values()):
        name = members[0].name
        label = name if len(members) == 1 else f"{name} ({len(members)} seeds)"
        style: dict[str, Any] = {"color": COLOURS[number], "linestyle": _LINE_STYLES[number % len(_LINE_STYLES)], "label": label}
        plot_band(returns, [log.returns for log in members if log.returns is not None], style)
        plot_band(successes, [log.successes for log in members if log.successes is not None], style)
        for log in members:
            if log.evaluations is not None:
                returns.plot(*log.evaluations, "o", color=COLOURS[number], markersize=3, alpha=0.7)
            plot_evaluation(returns, successes, log, COLOURS[number])
    marks = {"dots": any(log.evaluations for log in logs), "diamond": any(log.evaluation for log in logs)}
    named = ", ".join(mark for mark, is_there in marks.items() if is_there)
    style_panel(returns, f"return of training episodes{f'; {named}: evaluations' if named else ''}", theme)
    style_panel(successes, "success rate of training episodes", theme, legend=False)
    successes.set_ylim(-0.03, 1.03)
    if not successes.lines:
        successes.remove()
        returns.set_subplotspec(returns.get_gridspec()[0, :])
    for (left, right), members in zip(axes[1:], detailed, strict=True):
        name = f"{members[0].name}: " if len(groups) > 1 else ""
        for number, term in enumerate(sorted({term for log in members for term in log.terms})):
            style = {
                "color": COLOURS[number % len(COLOURS)],
                "linestyle": _LINE_STYLES[number // len(COLOURS) % len(_LINE_STYLES)],
                "label": term,
            }
            plot_band(left, [log.terms[term] for log in members if term in log.terms], style)
        style_panel(left, f"{name}reward terms of an episode", theme)
        plot_endings(right, members)
        style_panel(right, f"{name}endings, share of episodes", theme)
    return figure


def plot_band(panel: Axes, curves: Sequence[Curve], style: Mapping[str, Any]) -> None:
    """The mean of curves as far as all go, between the lowest and the highest."""
    curves = [(steps, values) for steps, values in curves if len(steps)]
    if not curves:
        return
    at = _common_steps(curves)
    rows = np.stack([np.interp(at, steps, values) for steps, values in curves])
    panel.plot(at, rows.mean(axis=0), linewidth=1.8, **style)
    if len(rows) > 1:
        panel.fill_between(at, rows.min(axis=0), rows.max(axis=0), color=style["color"], alpha=0.22, linewidth=0)


def plot_evaluation(returns: Axes | None, successes: Axes | None, log: TrainingLog, colour: str) -> None:
    """A diamond at the end of the training, in the panel of returns and of success rates."""
    found = log.evaluation
    if found is None or log.returns is None:
        return
    for panel, value in ((returns, found.mean_return), (successes, found.success_rate if found.success_defined else None)):
        if panel is not None and value is not None:
            panel.plot(log.returns[0][-1], value, "D", color=colour, markersize=6, markeredgecolor="white", clip_on=False, zorder=3)


def _common_steps(curves: Sequence[Curve]) -> NDArray[np.float64]:
    """Timesteps at equal distances, as far as all curves go."""
    first, last = max(steps[0] for steps, _ in curves), min(steps[-1] for steps, _ in curves)
    return np.linspace(first, max(last, curves[0][0][0] + 1), _MAX_CURVE_POINTS)


def plot_endings(panel: Axes, logs: Sequence[TrainingLog]) -> None:
    """How episodes end, as moving shares, means over seeds."""
    curves = [curve for log in logs for curve in log.endings.values()]
    if not curves:
        return
    at, members = _common_steps(curves), [log.endings for log in logs if log.endings]
    found = {
        name: np.mean([np.interp(at, *endings[name]) if name in endings else np.zeros(len(at)) for endings in members], axis=0)
        for name in {name: None for endings in members for name in endings}
    }
    names = sorted(found, key=lambda name: -found[name].sum())
    colours = [COLOURS[number % len(COLOURS)] for number in range(len(names))]
    panel.stackplot(at, [found[name] for name in names], labels=names, colors=colours, alpha=0.85, linewidth=0)
    panel.set_ylim(0, 1)


def style_panel(panel: Axes, title: str, theme: str, *, legend: bool = True, axes: tuple[str, str] | None = None) -> None:
    """Style a panel; `axes` are the names of its axes, by default timesteps below."""
    from matplotlib.ticker import EngFormatter

    ground, text, grid = THEMES[theme]
    panel.set_facecolor(ground)
    panel.set_title(title, fontsize=10, color=text, loc="left", parse_math=False)  # a name may hold a $
    below, beside = axes or ("timesteps", "")
    panel.set_xlabel(below, fontsize=9, color=text, parse_math=False)
    panel.set_ylabel(beside, fontsize=9, color=text)
    if axes is None:
        panel.xaxis.set_major_formatter(EngFormatter(sep=""))
    panel.tick_params(colors=text, labelsize=8)
    panel.grid(color=grid, linewidth=0.6)
    panel.set_axisbelow(True)
    for side, spine in panel.spines.items():
        spine.set_visible(side in ("left", "bottom"))
        spine.set_color(grid)
    if legend and panel.get_legend_handles_labels()[1]:
        box = panel.legend(fontsize=8, labelcolor=text, facecolor=ground, edgecolor=grid, framealpha=0.85)
        for label in box.get_texts():
            label.set_parse_math(False)
