"""The figures of a report, each drawn for a light or a dark background; figures as files and in pages; the
points of learning curves as rows."""

from __future__ import annotations

import base64
import io
import math
from collections.abc import Iterable, Sequence
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from deepbots_cli import frames
from deepbots_cli.expressions.dimensions import ONE, Unit
from deepbots_cli.files import atomic_write, check_folder
from deepbots_cli.frames import Frame, Triple
from deepbots_cli.learning.runs.evaluations import DrawnEffects
from deepbots_cli.program import Member
from deepbots_cli.program.world import WorldModel
from deepbots_cli.robots.kinematics import bounds_of_shape
from deepbots_cli.robots.model import Capsule, Cylinder, Sphere
from deepbots_cli.rollout import Episode
from deepbots_cli.runtime.spaces import joined, parts_of_rows
from deepbots_cli.view.frames import COLORS, LinkName
from deepbots_cli.view.pictures import Moving, has_moved
from deepbots_cli.view.plots import (
    THEMES,
    ending_colors,
    plot_agents,
    plot_endings,
    plot_lessons,
    plot_scores,
    style_panel,
    term_styles,
)
from deepbots_cli.view.training_logs import Measure, TrainingLog

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from deepbots_cli.insight.report import ReportEpisode

SUCCESS, FAILURE = "#009E73", "#D55E00"
_MAX_STARTS, _MAX_WITHOUT_EFFECT = 6, 2  # the largest number of drawn values in a figure
_MAX_TICKS = 6  # for an axis whose numbers may be long
_WIDTH, _WIDE_WIDTH = 5.0, 8.0  # inches
_MIN_CLIMB = 0.25  # share of the longer side; a trajectory that climbs more is also drawn from the side
_MIN_SIDE_M = 0.002  # m; the outline of a flat mesh would have no area
_MIN_WIDTH = 0.1  # share of the longer side; of a narrower trajectory, the longer side is drawn over time
_TIME = -1  # stands for the time instead of the number of an axis


def new_figure(
    theme: str, height: float, columns: int = 1, rows: int = 1, width: float = _WIDTH
) -> tuple[Figure, Any]:
    """Create a figure with rows of panels for a light or a dark background; sizes in inches."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), layout="constrained", facecolor=THEMES[theme][0])
    return figure, figure.subplots(rows, columns, squeeze=False)


def _with_legend(figure: Figure, height: float) -> Figure:
    """Return the figure with room for a legend of this height (inches)."""
    figure.set_figheight(figure.get_figheight() + height)
    return figure


def scores(logs: Sequence[TrainingLog], theme: str, measure: Measure) -> Figure | None:
    """Draw a measure of training episodes, the mean over seeds with a band from the lowest to the highest, of
    evaluations, and of the teacher; the returns of each of several agents."""
    if all(log.curves(measure)[0] is None for log in logs):
        return None
    figure, ((panel,),) = new_figure(theme, 2.9)
    is_return = measure == "mean_return"
    if is_return and any(log.agents for log in logs):
        plot_agents(panel, logs)
    else:
        seeds = "" if len(logs) == 1 else f", mean of {len(logs)} seeds"
        style = {"color": COLORS[0] if is_return else COLORS[2], "label": f"training episodes{seeds}"}
        marks = COLORS[1], "evaluations during the training"
        plot_scores(panel, logs, measure, style, marks, (THEMES[theme][1], f"teacher {logs[0].teacher}"))
    if not is_return:
        panel.set_ylim(-0.03, 1.03)
    return _with_legend(
        figure, style_panel(panel, "return" if is_return else "success rate", theme, stages=[logs])
    )


def actions(member: Member, taken: Sequence[Any], theme: str) -> Figure | None:
    """Draw what one of several agents does, given actions of all agents: how often it chooses each option,
    and how the numbers of its ranges are distributed."""
    agent = member.program.agent
    if not taken:
        return None
    choices, ranges = parts_of_rows(joined(taken))
    own_choices, own_ranges = choices[:, slice(*member.choices)], ranges[:, slice(*member.ranges)]
    parts = [bool(agent.choices), bool(agent.range_names)]
    figure, panels = new_figure(theme, 2.9 * sum(parts), rows=sum(parts))
    rows, height = iter(panels[:, 0]), 0.0
    if agent.choices:
        panel = next(rows)
        for choice, column in zip(agent.choices, own_choices.T, strict=True):
            shares = np.bincount(column.astype(int), minlength=len(choice.options)) / len(column)
            panel.bar([option.name for option in choice.options], shares, label=choice.name)
        height += style_panel(panel, "share of the steps with each option", theme, axes=("", ""))
    if agent.range_names:
        panel = next(rows)
        for name, column in zip(agent.range_names, np.clip(own_ranges, -1, 1).T, strict=True):
            panel.hist(column, bins=_ACTION_BINS, range=(-1, 1), density=True, histtype="step", label=name)
        height += style_panel(panel, "density of each number of the action", theme, axes=("", ""))
    return _with_legend(figure, height)


_ACTION_BINS = 20


def lessons(logs: Sequence[TrainingLog], theme: str) -> Figure | None:
    """Draw the share of the teacher in the training."""
    if not any(log.lessons for log in logs):
        return None
    figure, ((panel,),) = new_figure(theme, 2.9)
    plot_lessons(panel, logs)
    return _with_legend(figure, style_panel(panel, f"teacher {logs[0].teacher}", theme, stages=[logs]))


def shares(logs: Sequence[TrainingLog], theme: str) -> Figure | None:
    """Draw the size of each reward term of an episode, as a share of all their sizes; means over seeds."""
    styles = term_styles(logs)
    terms = list(styles)
    curves = [curve for log in logs for curve in log.terms.values() if len(curve[0])]
    if len(terms) < 2 or not curves:
        return None
    at = np.linspace(min(steps[0] for steps, _ in curves), max(steps[-1] for steps, _ in curves), 200)
    # The points where a stage begins are included.
    at = np.union1d(at, np.concatenate([steps[np.isnan(values)] for steps, values in curves]))
    sizes = np.array(
        [
            np.mean(
                [
                    np.interp(at, steps, np.abs(values))
                    for steps, values in (log.terms[term] for log in logs if term in log.terms)
                ],
                axis=0,
            )
            for term in terms
        ]
    )
    figure, ((panel,),) = new_figure(theme, 2.9)
    panel.stackplot(
        at,
        sizes / np.maximum(sizes.sum(axis=0), 1e-12),
        labels=terms,
        colors=[styles[term]["color"] for term in terms],
        alpha=0.85,
        linewidth=0,
    )
    panel.set_ylim(0, 1)
    return _with_legend(figure, style_panel(panel, "fraction of each reward term", theme, stages=[logs]))


def endings(logs: Sequence[TrainingLog], theme: str) -> Figure | None:
    """Draw the endings of training episodes, as shares over time."""
    if not any(log.endings for log in logs):
        return None
    figure, ((panel,),) = new_figure(theme, 2.9)
    plot_endings(panel, logs, ending_colors(logs))
    return _with_legend(
        figure, style_panel(panel, "fraction of training episodes by ending", theme, stages=[logs])
    )


def starts(
    episodes: Sequence[Episode], effects: DrawnEffects, theme: str, *, success_defined: bool
) -> Figure | None:
    """Draw drawn values of evaluation episodes against the return. Bars are means of parts of the range with
    their intervals.

    The values that have an effect are shown; without one, those that `effects` lists first.
    """
    plotted = effects.effective[:_MAX_STARTS] or list(effects.values.values())[:_MAX_WITHOUT_EFFECT]
    if not plotted:
        return None
    columns = min(2, len(plotted))
    rows = math.ceil(len(plotted) / columns)
    figure, panels = new_figure(theme, 0.4 + 2.3 * rows, columns, rows, _WIDE_WIDTH)
    for panel, value in zip(panels.flat, plotted, strict=False):
        name, unit = value.name, value.label.unit
        drawn = [episode for episode in episodes if name in episode.drawn]
        words = (
            sorted({str(episode.drawn[name]) for episode in drawn})
            if isinstance(drawn[0].drawn[name], str)
            else []
        )

        def coordinate(number: float | str, words: Sequence[str] = words, unit: Unit = unit) -> float:
            return words.index(str(number)) if words else unit.from_si(float(number))

        at = [coordinate(episode.drawn[name]) for episode in drawn]
        by_outcome = {True: SUCCESS, False: FAILURE} if success_defined else {}
        panel.scatter(
            at,
            [episode.total_return for episode in drawn],
            s=12,
            c=[by_outcome.get(episode.is_success, COLORS[0]) for episode in drawn],
            alpha=0.8,
            linewidths=0,
            # An SVG has an element for each point, and thousands of them make a page large.
            rasterized=len(drawn) > 300,
        )
        for drawn_bin in value.parts:
            low, high = coordinate(drawn_bin.low), coordinate(drawn_bin.high)
            middle, wide = (low + high) / 2, high > low
            panel.plot(
                (low, high) if wide else (middle - 0.02, middle + 0.02),
                [drawn_bin.mean_return] * 2,
                color=THEMES[theme][1],
                linewidth=2,
            )
            if drawn_bin.return_interval is not None:
                panel.plot([middle] * 2, drawn_bin.return_interval, color=THEMES[theme][1], linewidth=1)
        style_panel(
            panel, "", theme, legend=False, axes=(name if unit == ONE else f"{name}, {unit.text}", "return")
        )
        panel.locator_params(axis="x", nbins=_MAX_TICKS)
        if words:
            panel.set_xticks(range(len(words)), [word[:12] for word in words], parse_math=False)
    for panel in list(panels.flat)[len(plotted) :]:
        panel.set_visible(False)
    return figure


def trajectories(
    episodes: Sequence[ReportEpisode],
    moving: Moving,
    world: WorldModel,
    fixed: Sequence[Sequence[Triple]],
    theme: str,
) -> Figure:
    """Draw trajectories of the parts that move, from above, and from the side where they climb; along a line,
    over time.

    The first part is drawn as a line, others and moving targets in dots, a target that stands still as a
    star. `fixed` are the outlines of objects that stand still.
    """
    tracks = [
        episode.positions[part] for episode in episodes for part in moving.parts if part in episode.positions
    ]
    spans = np.max([np.nanmax(track, axis=0) - np.nanmin(track, axis=0) for track in tracks], axis=0)
    side = int(spans[1] > spans[0])  # the horizontal axis in the view from the side
    targets = [
        episode.positions[part]
        for episode in episodes
        for part in moving.targets
        if part in episode.positions
    ]
    climbs = bool(spans[2] > _MIN_CLIMB * spans[side])
    if not climbs and spans[1 - side] < _MIN_WIDTH * spans[side]:
        return _over_time(episodes, moving, side, world.timestep, theme)
    planes = [(0, 1)] + [(side, 2)] * climbs
    limits = [_limits(np.concatenate(tracks + targets), plane, world, fixed) for plane in planes]
    width = (_WIDE_WIDTH - 1.0) / len(planes)
    height = max(width * (high[1] - low[1]) / (high[0] - low[0]) for low, high in limits)
    figure, (panels,) = new_figure(
        theme, min(6.0, max(1.8, 1.3 + height)), columns=len(planes), width=_WIDE_WIDTH
    )
    for panel, plane, (low, high) in zip(panels, planes, limits, strict=True):
        if plane == (0, 1):
            _draw_surroundings(panel, world, fixed, theme)
        _draw_episodes(panel, plane, episodes, moving, world.timestep, theme)
        panel.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), aspect="equal")
        panel.locator_params(axis="x", nbins=_MAX_TICKS)
        style_panel(panel, "", theme, legend=False, axes=(f"{'xyz'[plane[0]]}, m", f"{'xyz'[plane[1]]}, m"))
    return _with_titles(figure, panels[0], theme)


def _over_time(
    episodes: Sequence[ReportEpisode], moving: Moving, axis: int, timestep: float, theme: str
) -> Figure:
    """Draw one coordinate of the parts that move over time, because from above a motion along a line is a
    line."""
    figure, ((panel,),) = new_figure(theme, 3.0, width=_WIDE_WIDTH)
    _draw_episodes(panel, (_TIME, axis), episodes, moving, timestep, theme)
    style_panel(panel, "", theme, legend=False, axes=("time, s", f"{'xyz'[axis]}, m"))
    return _with_titles(figure, panel, theme)


def _with_titles(figure: Figure, panel: Any, theme: str) -> Figure:
    """Return the figure with the titles of its episodes below."""
    ground, text, grid = THEMES[theme]
    handles, titles = panel.get_legend_handles_labels()
    box = figure.legend(
        handles,
        titles,
        loc="outside lower center",
        fontsize=8,
        labelcolor=text,
        facecolor=ground,
        edgecolor=grid,
    )
    for entry in box.get_texts():
        # A name in the scenario may contain `$`, with which Matplotlib begins a formula.
        entry.set_parse_math(False)
    return figure


def _draw_episodes(
    panel: Any,
    plane: tuple[int, int],
    episodes: Sequence[ReportEpisode],
    moving: Moving,
    timestep: float,
    theme: str,
) -> None:
    """Draw all episodes, those with a label above the others."""
    labeled = [episode for episode in episodes if episode.label]
    for episode in [*(episode for episode in episodes if not episode.label), *labeled]:
        _draw_episode(
            panel,
            plane,
            episode,
            moving,
            COLORS[labeled.index(episode) if episode.label else 6],
            timestep,
            theme,
        )


def _draw_episode(
    panel: Any,
    plane: tuple[int, int],
    episode: ReportEpisode,
    moving: Moving,
    color: str,
    timestep: float,
    theme: str,
) -> None:
    ground = THEMES[theme][0]
    width, alpha = (2.0, 1.0) if episode.label else (0.9, 0.7)
    for part in [*moving.parts, *moving.targets]:
        if part not in episode.positions:
            continue
        points = episode.positions[part]
        xs, ys = (timestep * np.arange(len(points)) if axis == _TIME else points[:, axis] for axis in plane)
        is_target, is_first = part in moving.targets, _base(part) == _base(moving.parts[0])
        if is_target:
            panel.plot(
                xs[-1:],
                ys[-1:],
                "*",
                color=color,
                markersize=9,
                alpha=alpha,
                markeredgecolor=ground,
                markeredgewidth=0.5,
            )
        if not is_target or has_moved(episode.positions[part]):
            style = (
                {"linestyle": "-", "linewidth": width} if is_first else {"linestyle": ":", "linewidth": 1.2}
            )
            panel.plot(
                xs,
                ys,
                color=color,
                alpha=alpha,
                label=episode.title if episode.label and part == moving.parts[0] else "",
                **style,
            )
        if not is_target:
            panel.plot(
                xs[:1], ys[:1], "o", color=color, markerfacecolor=ground, markersize=5 if is_first else 3
            )
        if is_first:
            panel.plot(xs[-1:], ys[-1:], "o" if episode.is_success else "X", color=color, markersize=6)


def _base(part: LinkName) -> str:
    """Return the name of a body without the number of a copy."""
    return part[0].partition("#")[0]


def _draw_surroundings(panel: Any, world: WorldModel, fixed: Sequence[Sequence[Triple]], theme: str) -> None:
    """Draw the arena, painted lines and objects that stand still, from above."""
    _, text, grid = THEMES[theme]
    if world.arena is not None:
        x, y = (side / 2 for side in world.arena.size)
        panel.plot([-x, x, x, -x, -x], [-y, -y, y, y, -y], color=text, linewidth=1.2)
    for line in world.lines:
        points = [*line.points, *line.points[: int(line.closed)]]
        panel.plot(*zip(*points, strict=True), color=grid, linewidth=3)
    for outline in fixed:
        panel.fill([x for x, _, _ in outline], [y for _, y, _ in outline], color=grid, alpha=0.5, linewidth=0)


def _limits(
    points: Any, plane: tuple[int, int], world: WorldModel, fixed: Sequence[Sequence[Triple]]
) -> tuple[Any, Any]:
    """Return the limits of the panel: the surroundings of points (n, 3), with objects that reach into them.

    From above, they are those of the arena if the points span more than a third of it.
    """
    low, high = np.nanmin(points, axis=0)[list(plane)], np.nanmax(points, axis=0)[list(plane)]
    if plane == (0, 1) and world.arena is not None and ((high - low) > np.array(world.arena.size) / 3).any():
        low = np.minimum(low, -np.array(world.arena.size) / 2)
        high = np.maximum(high, np.array(world.arena.size) / 2)
    if plane == (0, 1):
        for outline in map(np.array, fixed):
            start, end = outline[:, :2].min(axis=0), outline[:, :2].max(axis=0)
            if (end - start).max() <= (high - low).max() and (start <= high).all() and (end >= low).all():
                low, high = np.minimum(low, start), np.maximum(high, end)
    margin = np.maximum(0.05 * (high - low).max(), (0.15 * (high - low).max() + 0.02 - (high - low)) / 2)
    return low - margin, high + margin


def outline(shape: Any, pose: Frame) -> list[Triple]:
    """Return the outline of an object from above, with 24 points for a circle; that of a mesh is that of its
    box."""
    from scipy.spatial import ConvexHull

    ring = [(math.cos(turn), math.sin(turn)) for turn in np.arange(24) * (math.tau / 24)]

    def placed(corners: Iterable[Triple]) -> list[Triple]:
        return [frames.add(pose[0], frames.rotate(pose[1], corner)) for corner in corners]

    match shape:
        case Sphere(radius) | Capsule(radius):
            # A ball is a circle however it is turned, and a capsule is the hull of the balls at its ends.
            half = shape.length / 2 if isinstance(shape, Capsule) else 0.0
            points = [
                frames.add(center, (radius * x, radius * y, 0.0))
                for center in placed([(0.0, 0.0, -half), (0.0, 0.0, half)])
                for x, y in ring
            ]
        case Cylinder(radius, length):
            points = placed((radius * x, radius * y, z) for x, y in ring for z in (-length / 2, length / 2))
        case _:
            low, high = bounds_of_shape(shape)
            ends = zip(low, np.maximum(high, np.add(low, _MIN_SIDE_M)).tolist(), strict=True)
            points = placed(product(*ends))
    return [points[number] for number in ConvexHull([point[:2] for point in points]).vertices]


# Files


def write_figure_files(folder: Path, figures: Iterable[tuple[str, Figure]]) -> list[Path]:
    """Write figures by their names as PNG.

    Raises:
        UsageError: A file cannot be written, or the folder is a file.
    """
    check_folder(folder)
    paths = []
    folder.mkdir(parents=True, exist_ok=True)
    for name, figure in figures:
        paths.append(folder / f"{name}.png")
        with atomic_write(paths[-1]) as draft:
            figure.savefig(draft, dpi=150)
    return paths


def svg_uri(figure: Any) -> str:
    """Return a figure as SVG in a data URI."""
    import matplotlib

    stream = io.BytesIO()
    with matplotlib.rc_context({"svg.hashsalt": "deepbots"}):  # the same names of clip paths each time
        figure.savefig(stream, format="svg", metadata={"Date": None, "Creator": None})
    return data_uri("image/svg+xml", stream.getvalue())


def data_uri(kind: str, data: bytes) -> str:
    """Return data as a URI that contains it; `kind` is its media type."""
    return f"data:{kind};base64,{base64.b64encode(data).decode()}"
