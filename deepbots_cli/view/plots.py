"""Plots of trainings: returns, success rates, reward terms and endings over the timesteps, with a band over
seeds."""

from __future__ import annotations

import logging
import math
import textwrap
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from deepbots_cli.errors import MissingExtraError, UsageError
from deepbots_cli.files import atomic_write
from deepbots_cli.learning.runs.statistics import Statistic, bootstrap_interval, interquartile_means
from deepbots_cli.view.frames import COLORS
from deepbots_cli.view.training_logs import Curve, Measure, TrainingLog
from deepbots_cli.words import number_text, rate_text

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

DATA = ".csv"
"""The suffix of a file with the points of the lines, in place of a picture."""
SUFFIXES = (".png", ".svg", ".pdf", DATA)
_LABELS = {Statistic.mean: "mean, 95 % interval", Statistic.iqm: "IQM, 95 % interval"}
_MAX_CURVE_POINTS = 200
_LINE_STYLES = ("-", "--", "-.", ":")
_MARKS = ("o", "s", "^", "v", "P", "X")
_PANEL_WIDTH = 4.3
"""The width of a panel in one column, in inches."""
_LETTER_WIDTH = 0.068
"""The width of a letter in the legend of a panel, in inches."""
_STAGE_NAME_HEIGHT = 9
"""The height of a row of names of stages above a panel, in points."""
_MAX_LINE = 58
"""The length of a name below a panel, in letters."""
_MAX_TITLE_LINE = 64
"""The length of the title of a panel, in letters."""
THEMES = {"light": ("#ffffff", "#202428", "#d5d8dc"), "dark": ("#16181c", "#e4e6ea", "#3c4046")}
"""The colors of background, text and grid."""
DECLINE_COLOR = "#c0392b"


def import_matplotlib() -> None:
    """Import matplotlib with its default settings.

    By default it reads the file `matplotlibrc` of the current folder. This file may be a stranger's, and can
    make it run LaTeX.
    """
    logging.getLogger("matplotlib").setLevel(logging.ERROR)  # unknown entries in such a file are not reported
    import matplotlib

    matplotlib.rcdefaults()


def plot(logs: Sequence[TrainingLog], *, theme: str = "light", statistic: Statistic | None = None) -> Figure:
    """Draw a figure of trainings. Those of one scenario and agent are one line, with a band (`seed_band`).

    Raises:
        MissingExtraError: matplotlib is not installed.
        UsageError: There are more scenarios or agents than colors.
    """
    try:
        import_matplotlib()
        from matplotlib.figure import Figure
    except ModuleNotFoundError as error:
        raise MissingExtraError("train", "a plot") from error
    groups = by_task(logs)
    if len(groups) > len(COLORS):
        raise UsageError(f"a plot can show at most {len(COLORS)} scenarios or agents, not {len(groups)}")
    detailed = [members for members in groups.values() if any(log.terms or log.endings for log in members)]
    taught = [members for members in groups.values() if any(log.lessons for log in members)]
    below = 1 + math.ceil(len(taught) / 2)
    figure = Figure(
        figsize=(10.0, 0.7 + 2.7 * (below + len(detailed))), layout="constrained", facecolor=THEMES[theme][0]
    )
    axes = figure.subplots(below + len(detailed), 2, squeeze=False)
    returns, successes = axes[0]
    terms = [{term for log in members for term in log.terms} for members in detailed]
    for left, own_terms in zip(axes[below + 1 :, 0], terms[1:], strict=True):
        if own_terms & terms[0]:
            left.sharey(axes[below, 0])  # the same terms of two scenarios are compared by eye
    member_lists = list(groups.values())
    for number, members in enumerate(member_lists):
        _plot_group(returns, successes, members, number, statistic, is_only=len(groups) == 1)
    marks = {"dots": any(log.evaluations for log in logs), "diamond": any(log.evaluation for log in logs)}
    named = ", ".join(mark for mark, is_there in marks.items() if is_there)
    marked = f"of training episodes{f'; {named}: evaluations' if named else ''}"
    has_successes = bool(successes.lines)
    if not has_successes:
        _remove_right(axes[0])
    heights = [style_panel(returns, f"return {marked}", theme, stages=member_lists)]
    if has_successes:
        style_panel(successes, f"success rate {marked}", theme, legend=False, stages=member_lists)
        successes.set_ylim(-0.03, 1.03)
    heights += _plot_taught(axes[1:below], taught, theme, with_names=len(groups) > 1)
    heights += _plot_detailed(axes[below:], logs, detailed, theme, with_names=len(groups) > 1)
    figure.set_figheight(figure.get_figheight() + sum(heights))
    return figure


def _plot_taught(
    rows: Any, taught: Sequence[Sequence[TrainingLog]], theme: str, *, with_names: bool
) -> list[float]:
    """Plot the lessons of teachers, a panel for each scenario and agent. Returns the heights (inches) of the
    legends."""
    if len(taught) % 2:
        _remove_right(rows[-1])
    heights = []
    for panel, members in zip(rows.flat, taught, strict=False):
        plot_lessons(panel, members)
        name = f"{members[0].name}: " if with_names else ""
        heights.append(style_panel(panel, f"{name}teacher {members[0].teacher}", theme, stages=[members]))
    return heights


def _plot_detailed(
    rows: Any,
    logs: Sequence[TrainingLog],
    detailed: Sequence[Sequence[TrainingLog]],
    theme: str,
    *,
    with_names: bool,
) -> list[float]:
    """Plot reward terms and endings, a row for each scenario and agent. Returns the heights (inches) of the
    legends."""
    styles = term_styles(logs)
    endings = ending_colors(logs)
    groups_with_endings: set[str] = set()
    is_one_task = len({log.group for log in logs}) == 1
    heights = []
    for row, members in zip(rows, detailed, strict=True):
        left, right = row
        name = f"{members[0].name}: " if with_names else ""
        # Agents of one group have the same episodes.
        has_endings = members[0].group not in groups_with_endings and any(log.endings for log in members)
        if not has_endings:
            _remove_right(row)
        heights.append(_plot_terms(left, members, styles, f"{name}reward terms of an episode", theme))
        if has_endings:
            plot_endings(right, members, endings)
            title = f"{'' if is_one_task else name}endings, share of episodes"
            heights[-1] = max(heights[-1], style_panel(right, title, theme, stages=[members]))
        groups_with_endings.add(members[0].group)
    return heights


def _plot_group(
    returns: Axes,
    successes: Axes,
    members: Sequence[TrainingLog],
    number: int,
    statistic: Statistic | None,
    *,
    is_only: bool,
) -> None:
    """Plot returns and success rates of the trainings of a scenario, which is the only one or has this
    number."""
    name = members[0].name
    color = COLORS[number]
    drawn = f"{_LABELS[statistic]} of " if statistic else ""
    style = _line_style(number, name if len(members) == 1 else f"{name} ({drawn}{len(members)} seeds)")
    script = f"teacher {members[0].teacher}" if is_only else f"{name}: teacher {members[0].teacher}"
    plot_scores(returns, members, "mean_return", style, (color, ""), (color, script), statistic)
    plot_scores(successes, members, "success_rate", style, (color, ""), (color, script), statistic)


def plot_scores(
    panel: Axes,
    logs: Sequence[TrainingLog],
    measure: Measure,
    style: Mapping[str, Any],
    marks: tuple[str, str],
    teacher: tuple[str, str],
    statistic: Statistic | None = None,
) -> None:
    """Plot a measure of trainings: of their episodes, of their evaluations, and of their teacher. `marks` and
    `teacher` are the color and the label of the evaluations and of the teacher."""
    curves = [curve for log in logs if (curve := log.curves(measure)[0]) is not None]
    plot_band(panel, curves, style, statistic)
    _plot_evaluations(panel, logs, measure, *marks)
    for log in logs:
        _plot_evaluation(panel, log, measure, marks[0])
        _plot_decline(panel, log, measure)
    _plot_teacher(panel, logs, measure, *teacher)


def _plot_terms(
    panel: Axes,
    members: Sequence[TrainingLog],
    styles: Mapping[str, Mapping[str, Any]],
    title: str,
    theme: str,
) -> float:
    """Plot the reward terms of the trainings of a scenario. Returns the height (inches) of the legend."""
    for term in sorted({term for log in members for term in log.terms}):
        plot_band(panel, [log.terms[term] for log in members if term in log.terms], styles[term])
    return style_panel(panel, title, theme, stages=[members])


def _remove_right(row: Any) -> None:
    """Remove the right panel of a row; the left one takes its place too."""
    left, right = row
    right.remove()
    left.set_subplotspec(left.get_gridspec()[left.get_subplotspec().rowspan.start, :])


def _line_style(number: int, label: str) -> dict[str, Any]:
    """Return the style of the line with this number in a panel."""
    return {
        "color": COLORS[number % len(COLORS)],
        "linestyle": _LINE_STYLES[number % len(_LINE_STYLES)],
        "label": label,
    }


def term_styles(logs: Sequence[TrainingLog]) -> dict[str, dict[str, Any]]:
    """Return the style of the line of each reward term, the same wherever it is drawn."""
    terms = sorted({term for log in logs for term in log.terms})
    return {
        term: {
            "color": COLORS[number % len(COLORS)],
            "linestyle": _LINE_STYLES[number // len(COLORS) % len(_LINE_STYLES)],
            "label": term,
        }
        for number, term in enumerate(terms)
    }


def ending_colors(logs: Sequence[TrainingLog]) -> dict[str, str]:
    """Return the color of each ending, the same wherever it is drawn. The most frequent endings come first,
    and colors are paler after the eighth."""
    shares = Counter[str]()
    for log in logs:
        shares.update({name: float(np.nanmean(curve[1])) for name, curve in log.endings.items()})
    names = [name for name, _ in shares.most_common()]
    return {
        name: _paler(COLORS[number % len(COLORS)], number // len(COLORS)) for number, name in enumerate(names)
    }


def _paler(color: str, rounds: int) -> str:
    parts = [int(color[start : start + 2], 16) for start in (1, 3, 5)]
    return "#" + "".join(f"{round(255 - (255 - part) * 0.6**rounds):02x}" for part in parts)


def plot_agents(panel: Axes, logs: Sequence[TrainingLog]) -> None:
    """Plot the returns of each of several agents, which have no common measure."""
    for number, agent in enumerate(dict.fromkeys(agent for log in logs for agent in log.agents)):
        curves = [log.agents[agent] for log in logs if agent in log.agents]
        plot_band(panel, curves, _line_style(number, agent))


def save(figure: Figure, path: Path) -> None:
    """Write a figure in the format of the suffix, with text as text."""
    import matplotlib

    # By default, text in SVG files is drawn as lines, and many journals refuse the fonts of type 3 of PDF.
    text_as_text = matplotlib.rc_context({"svg.fonttype": "none", "pdf.fonttype": 42})
    with atomic_write(path) as draft, text_as_text:
        figure.savefig(draft, format=path.suffix[1:].lower(), dpi=130)


def seed_band(
    curves: Sequence[Curve], statistic: Statistic | None = None
) -> tuple[NDArray[np.float64], ...] | None:
    """Return the timesteps that all curves cover, a statistic of the curves, and the limits of its 95 %
    interval; without a statistic the mean, and the lowest and the highest value. None without a curve."""
    curves = [(steps, values) for steps, values in curves if len(steps)]
    if not curves:
        return None
    steps = _common_steps(curves)
    rows = np.stack([np.interp(steps, *curve) for curve in curves])
    if statistic is None:
        return steps, rows.mean(axis=0), rows.min(axis=0), rows.max(axis=0)
    is_iqm = statistic is Statistic.iqm
    of_columns: Callable[[Any], Any] = interquartile_means if is_iqm else partial(np.mean, axis=0)
    return steps, of_columns(rows), *bootstrap_interval(rows, of_columns)


def plot_band(
    panel: Axes, curves: Sequence[Curve], style: Mapping[str, Any], statistic: Statistic | None = None
) -> None:
    """Plot the line and the band of curves."""
    band = seed_band(curves, statistic)
    if band is None:
        return
    steps, center, low, high = band
    panel.plot(steps, center, linewidth=1.8, **style)
    if len(curves) > 1:
        panel.fill_between(steps, low, high, color=style["color"], alpha=0.22, linewidth=0)


def by_task(logs: Sequence[TrainingLog]) -> dict[tuple[str, str], list[TrainingLog]]:
    """Return the trainings of each scenario and agent."""
    groups: dict[tuple[str, str], list[TrainingLog]] = {}
    for log in logs:
        groups.setdefault((log.group, log.agent), []).append(log)
    return groups


def curve_rows(logs: Sequence[TrainingLog], statistic: Statistic | None = None) -> list[dict[str, object]]:
    """Return the points of the lines of `plot`, and the evaluations of each run."""
    rows: list[dict[str, object]] = []

    def add(log: TrainingLog, run: str, seeds: int, curve: str, points: Iterable[Sequence[float]]) -> None:
        rows.extend(
            {"scenario": log.name, "agent": log.agent, "run": run, "seeds": seeds, "curve": curve}
            | dict(zip(("timesteps", "value", "low", "high"), point, strict=False))
            for point in points
        )

    for members in by_task(logs).values():
        of_seeds: dict[str, list[Curve]] = {}
        for log in members:
            like = log.returns or (np.empty(0), np.empty(0))
            measures = {"return": log.returns, "success_rate": log.successes}
            terms = {f"reward.{name}": curve for name, curve in log.terms.items()}
            # The share of an ending is 0 in a training that never had it.
            endings = {
                f"ended_by.{name}": log.endings.get(name, (like[0], 0.0 * like[1]))
                for name in dict.fromkeys(name for member in members for name in member.endings)
            }
            for name, curve in {**measures, **terms, **endings}.items():
                of_seeds.setdefault(name, []).extend([] if curve is None else [curve])
            evaluated = {"return": log.evaluations, "success_rate": log.evaluated_successes}
            for name, curve in evaluated.items():
                add(log, str(log.path), 1, f"evaluation.{name}", zip(*(curve or ()), strict=True))
        for name, curves in of_seeds.items():
            band = seed_band(curves, statistic if name in measures else None)
            add(members[0], "", len(curves), name, zip(*(band or ()), strict=True))
    return rows


def _plot_evaluations(
    panel: Axes, logs: Sequence[TrainingLog], measure: Measure, color: str, label: str
) -> None:
    """Plot the evaluations during trainings: a dot each, and a different mark for each stage of a curriculum,
    which the legend names."""
    names = list(dict.fromkeys(start.name for log in logs for start in log.stages))
    evaluated = [
        (steps, value, name if name in names else "")
        for log in logs
        if (curve := log.curves(measure)[1]) is not None
        for steps, value, name in zip(*curve, log.evaluation_stages or [""] * len(curve[0]), strict=True)
    ]
    for name in dict.fromkeys(name for _, _, name in evaluated):
        steps, values = zip(*((at, value) for at, value, series in evaluated if series == name), strict=True)
        mark = _MARKS[names.index(name) % len(_MARKS)] if name else _MARKS[0]
        text = f"evaluations in stage {name}" if name else label
        panel.plot(steps, values, mark, color=color, markersize=4, alpha=0.8, linestyle="none", label=text)


def _plot_evaluation(panel: Axes, log: TrainingLog, measure: Measure, color: str) -> None:
    """Plot a diamond at the step of the evaluated model."""
    evaluation = log.evaluation
    if evaluation is None or log.returns is None:
        return
    rate = evaluation.success_rate if evaluation.success_defined else None
    value = evaluation.mean_return if measure == "mean_return" else rate
    if value is not None:
        step = log.returns[0][-1] if log.model_steps is None else log.model_steps
        panel.plot(
            step, value, "D", color=color, markersize=6, markeredgecolor="white", clip_on=False, zorder=3
        )


def _plot_decline(panel: Axes, log: TrainingLog, measure: Measure) -> None:
    """Plot a line at the fall of a training, and its size, if this is the measure of the task."""
    fall = log.decline
    if fall is None or fall.measure != measure:
        return
    form = rate_text if measure == "success_rate" else number_text
    best, last = form(fall.best_value), form(fall.last_value)
    # A late line has no room for the text at its right.
    is_late = log.returns is not None and fall.since_steps > 0.7 * log.returns[0][-1]
    panel.axvline(fall.since_steps, color=DECLINE_COLOR, linewidth=1.2, linestyle="--")
    panel.annotate(
        f"got worse: {best} to {last}",
        (fall.since_steps, 0.03),
        (-3 if is_late else 3, 0),
        xycoords=("data", "axes fraction"),
        textcoords="offset points",
        horizontalalignment="right" if is_late else "left",
        fontsize=7,
        color=DECLINE_COLOR,
    ).set_in_layout(False)


def _plot_teacher(panel: Axes, logs: Sequence[TrainingLog], measure: Measure, color: str, label: str) -> None:
    """Plot the score of the teacher, a dotted line for each training."""
    for log in logs:
        if measure in log.lessons:
            steps, values = log.lessons[measure]
            steps, values = np.insert(steps, 0, 0.0), np.insert(values, 0, values[0])
            panel.plot(steps, values, color=color, linestyle=":", linewidth=1.4, label=label)
            label = ""


def plot_lessons(panel: Axes, logs: Sequence[TrainingLog]) -> None:
    """Plot the agreement, weight and driven worlds of a teacher, means over seeds."""
    names = {"agreement": "agreement", "weight": "loss weight", "driven_worlds": "driven worlds"}
    for number, (name, label) in enumerate(names.items()):
        curves = [log.lessons[name] for log in logs if name in log.lessons]
        plot_band(panel, curves, _line_style(number, label))
    panel.set_ylim(-0.03, 1.03)


def _common_steps(curves: Sequence[Curve]) -> NDArray[np.float64]:
    """Return equally spaced timesteps that all curves cover, and the timesteps at which a curve is
    interrupted."""
    first, last = max(steps[0] for steps, _ in curves), min(steps[-1] for steps, _ in curves)
    if last < first:  # no timestep is in all of them
        return np.empty(0)
    last = max(last, first + 1)
    # The breaks are points too: a gap between two equal distances would otherwise be drawn as a line.
    breaks = np.concatenate([steps[np.isnan(values)] for steps, values in curves])
    return np.union1d(np.linspace(first, last, _MAX_CURVE_POINTS), breaks[(breaks > first) & (breaks < last)])


def plot_endings(panel: Axes, logs: Sequence[TrainingLog], colors: Mapping[str, str]) -> None:
    """Plot the endings of episodes, as moving shares, means over seeds; `colors` are those of
    `ending_colors`."""
    curves = [curve for log in logs for curve in log.endings.values()]
    if not curves:
        return
    steps = _common_steps(curves)
    members = [log.endings for log in logs if log.endings]
    counts = {
        name: np.mean(
            [
                np.interp(steps, *endings[name]) if name in endings else np.zeros(len(steps))
                for endings in members
            ],
            axis=0,
        )
        for name in {name: None for endings in members for name in endings}
    }
    names = sorted(counts, key=lambda name: -np.nansum(counts[name]))
    panel.stackplot(
        steps,
        [counts[name] for name in names],
        labels=names,
        colors=[colors[name] for name in names],
        alpha=0.85,
        linewidth=0,
    )
    panel.set_ylim(0, 1)


def _width(panel: Axes) -> float:
    """Return the width of a panel in inches, by the columns that it takes."""
    place: Any = panel.get_subplotspec()
    return _PANEL_WIDTH * len(place.colspan)


def mark_stages(panel: Axes, groups: Sequence[Sequence[TrainingLog]], theme: str) -> tuple[int, list[str]]:
    """Mark the beginning of each stage of a curriculum by a line, and its name above the panel, or its number
    if the name does not fit.

    Each group of trainings has a row of names. Returns the number of rows, and the meaning of the numbers.
    """
    low, high = panel.get_xlim()
    width = _width(panel)
    rows = 0
    key: list[str] = []
    for number, members in enumerate(groups):
        color = THEMES[theme][1] if len(groups) == 1 else COLORS[number]
        starts: dict[str, list[float]] = {}
        for start in (start for log in members for start in log.stages):
            starts.setdefault(start.name, []).append(start.steps)
        first = sorted((min(steps), name) for name, steps in starts.items())
        for index, (begin, name) in enumerate(first):
            if index:
                for steps in starts[name]:
                    panel.axvline(steps, color=color, linestyle=(0, (4, 3)), linewidth=0.9, alpha=0.8)
            end = first[index + 1][0] if index + 1 < len(first) else high
            fits = (len(name) + 1) * _LETTER_WIDTH < (end - max(begin, low)) / (high - low) * width
            text = name if fits else str(index + 1)
            key += [] if fits else [f"{index + 1} {name}"]
            panel.annotate(
                text,
                (max(begin, low), 1.0),
                (2, 2 + _STAGE_NAME_HEIGHT * rows),
                xycoords=("data", "axes fraction"),
                textcoords="offset points",
                fontsize=7,
                color=color,
                parse_math=False,
            ).set_in_layout(False)
        rows += bool(first)
    return rows, list(dict.fromkeys(key))


def style_panel(
    panel: Axes,
    title: str,
    theme: str,
    *,
    legend: bool = True,
    axes: tuple[str, str] | None = None,
    stages: Sequence[Sequence[TrainingLog]] = (),
) -> float:
    """Style a panel. Returns the height (inches) of its legend, which is below the panel.

    `axes` are the names of its axes, by default timesteps below. `stages` are groups of trainings whose
    stages are marked.
    """
    from matplotlib.ticker import EngFormatter

    ground, text, grid = THEMES[theme]
    panel.set_facecolor(ground)
    rows, key = mark_stages(panel, stages, theme)
    # A `$` in a name would begin a formula.
    panel.set_title(
        textwrap.fill(title, _MAX_TITLE_LINE),
        fontsize=10,
        color=text,
        loc="left",
        pad=6 + _STAGE_NAME_HEIGHT * rows,
        parse_math=False,
    )
    below, beside = axes or (f"timesteps; stage {', '.join(key)}" if key else "timesteps", "")
    panel.set_xlabel(textwrap.fill(below, _MAX_LINE), fontsize=9, color=text, parse_math=False)
    panel.set_ylabel(beside, fontsize=9, color=text)
    if axes is None:
        panel.xaxis.set_major_formatter(EngFormatter(sep=""))
    panel.tick_params(colors=text, labelsize=8)
    panel.grid(color=grid, linewidth=0.6)
    panel.set_axisbelow(True)
    for side, spine in panel.spines.items():
        spine.set_visible(side in ("left", "bottom"))
        spine.set_color(grid)
    return _legend_below(panel, theme) if legend else 0.0


def _legend_below(panel: Axes, theme: str) -> float:
    """Add a legend under the names of the axis, and return its height in inches. Long names take several
    lines."""
    from matplotlib.transforms import ScaledTranslation

    handles, names = panel.get_legend_handles_labels()
    if not names:
        return 0.0
    names = [textwrap.fill(name, _MAX_LINE) for name in names]
    longest = max(len(line) for name in names for line in name.splitlines())
    columns = max(1, min(len(names), int(_width(panel) / (0.5 + _LETTER_WIDTH * longest))))
    lines = max(name.count("\n") + 1 for name in names) * math.ceil(len(names) / columns)
    # The room in inches below the panel for the numbers and the name of the axis.
    room = 0.42 + 0.14 * panel.get_xlabel().count("\n")
    figure: Any = panel.figure
    transform = panel.transAxes + ScaledTranslation(0.0, -room, figure.dpi_scale_trans)
    box = panel.legend(
        handles,
        names,
        loc="upper left",
        bbox_to_anchor=(0.0, 0.0),
        bbox_transform=transform,
        borderaxespad=0.0,
        ncols=columns,
        fontsize=8,
        labelcolor=THEMES[theme][1],
        frameon=False,
        borderpad=0.0,
        columnspacing=1.2,
    )
    for label in box.get_texts():
        label.set_parse_math(False)
    return 0.08 + 0.16 * float(lines)
