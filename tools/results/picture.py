"""The learning curves of a scenario, drawn so that light and dark pages both show them."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from deepbots_cli.learning.runs.directories import write_text
from tools.results.experiment import Crossed, Experiment, Mark, Solved

Entry = Mapping[str, Any]

INK = "#7d8590"
"""Of axes and texts: as far from white as from near black."""

SEEDS = (
    "#2f81f7",
    "#d2762a",
    "#2da44e",
    "#bf5fb5",
    "#c9423c",
    "#14a3a8",
    "#8a7be0",
    "#a38a1f",
    "#e0669b",
    "#6b8fae",
)
STYLES = ("-", "--", ":", "-.")
"""One for each training of the experiment."""

FAR = 2.2
"""An hour that is so many times beyond the curves is told at the edge and not drawn, or the curves would be a
sliver."""


def state(experiment: Experiment, record: Entry) -> str:
    """A digest of all that the picture shows; the picture carries it, so that a test can tell whether it is
    current."""
    shown = [experiment.title, experiment.curve, [vars(mark) for mark in marks(experiment)]]
    curves = [
        (name, seed, entry["curve"], entry["stages"]) for name, seed, entry in _curves(experiment, record)
    ]
    return hashlib.sha256(json.dumps([shown, curves]).encode()).hexdigest()[:16]


def is_current(experiment: Experiment, record: Entry, path: Path) -> bool:
    if not _curves(experiment, record):
        return not path.exists()
    return path.is_file() and f"state {state(experiment, record)}" in path.read_text(encoding="utf-8")


def write(experiment: Experiment, record: Entry, path: Path) -> None:
    """Draw it where its data have changed; remove one that has no data any more."""
    if is_current(experiment, record, path):
        return
    if not _curves(experiment, record):
        path.unlink()
        return
    path.parent.mkdir(parents=True, exist_ok=True)
    write_text(path, drawn(experiment, record))


def _curves(experiment: Experiment, record: Entry) -> list[tuple[str, int, Entry]]:
    pairs = [(training.name, seed) for training in experiment.trainings for seed in training.seeds]
    trainings = record["trainings"]
    return [
        (name, seed, trainings[name][str(seed)])
        for name, seed in pairs
        if str(seed) in trainings.get(name, {})
    ]


def drawn(experiment: Experiment, record: Entry) -> str:
    """The text of the SVG: the same for the same data, wherever it is drawn."""
    import io

    import matplotlib as mpl
    from matplotlib.backends.backend_svg import FigureCanvasSVG
    from matplotlib.figure import Figure

    settings: dict[Any, Any] = {  # of any type: matplotlib's keys are a union of literals
        "svg.hashsalt": "deepbots",
        "svg.fonttype": "none",
        "font.family": "sans-serif",
        "font.size": 9,
        "path.simplify": True,
    }
    colored = ("text.color", "axes.edgecolor", "axes.labelcolor", "xtick.color", "ytick.color")
    with mpl.rc_context(settings | dict.fromkeys(colored, INK)):
        figure = Figure(figsize=(7.2, 3.4), layout="constrained")
        figure.patch.set_alpha(0)
        axes = figure.add_subplot(facecolor="none")
        _draw(axes, experiment, _curves(experiment, record))
        stream = io.StringIO()
        canvas: Any = FigureCanvasSVG(figure)  # of any type: matplotlib does not annotate `print_svg`
        canvas.print_svg(
            stream,
            metadata={"Date": None, "Creator": None, "Description": f"state {state(experiment, record)}"},
        )
    return "\n".join(line.rstrip() for line in stream.getvalue().splitlines()) + "\n"


def marks(experiment: Experiment) -> list[Mark]:
    """Those of the experiment, and the hours that its bars ask for."""
    bars = [
        bar
        for bar in experiment.bars
        if isinstance(bar.figure, (Solved, Crossed)) and bar.figure.what == "simulated_hours"
    ]
    hours = [
        Mark(
            f"{'stretch' if bar.stretch else 'asked'}{'' if bar.over == 'all' else f' of the {bar.over}'}:"
            f" {bar.at_most:g} h",
            hours=bar.at_most,
        )
        for bar in bars
        if bar.at_most is not None
    ]
    return [*experiment.marks, *hours]


def _draw(axes: Any, experiment: Experiment, entries: list[tuple[str, int, Entry]]) -> None:
    names = [training.name for training in experiment.trainings]
    seeds = list(dict.fromkeys(seed for _, seed, _ in entries))
    scale = 100 if experiment.curve == "success" else 1
    for name, seed, entry in entries:
        color = SEEDS[seeds.index(seed) % len(SEEDS)]
        label = str(seed) if name == names[0] else f"{seed}, {name}"
        hours = entry["curve"]["simulated_hours"]
        values = [scale * value for value in entry["curve"][experiment.curve]]
        axes.plot(
            hours, values, STYLES[names.index(name) % len(STYLES)], color=color, linewidth=1.3, label=label
        )
        for end in entry["stages"]:
            axes.axvline(end["simulated_hours"], color=color, linewidth=0.9, linestyle=(0, (1, 2)))
    end = max(entry["simulated_hours"] for _, _, entry in entries)
    lines = marks(experiment)
    axes.set_xlim(
        0, max([end, *(mark.hours for mark in lines if mark.hours and mark.hours < FAR * end)]) * 1.05
    )
    if experiment.curve == "success":
        axes.set_ylim(0, 103)
    stages = entries[0][2]["stages"] if len(entries) == 1 else []
    _name_stages(axes, stages)
    for mark in lines:
        if mark.value is not None:
            _level(axes, mark.words, scale * mark.value, outside=bool(stages))
    for place, mark in enumerate(mark for mark in lines if mark.hours is not None):
        _upright(axes, mark, end, height=0.04 + 0.08 * place)
    axes.set_xlabel("simulated hours")
    axes.set_ylabel(
        "successes in 100 episodes, %" if experiment.curve == "success" else "mean return of 100 episodes"
    )
    axes.spines[["top", "right"]].set_visible(False)
    axes.grid(color=INK, alpha=0.2, linewidth=0.5)
    axes.legend(
        title="seed",
        frameon=False,
        fontsize=8,
        title_fontsize=8,
        loc="center left",
        bbox_to_anchor=(1.0, 0.5),
    )


def _name_stages(axes: Any, stages: list[Entry]) -> None:
    """Each above the line of its end, aslant and no closer than names are high, since stages may be short;
    the last one has none."""
    place, width = 0.0, axes.get_xlim()[1]
    for end in stages:
        place = max(end["simulated_hours"], place + 0.024 * width)
        axes.annotate(
            end["name"],
            (end["simulated_hours"], 1.0),
            (place, 1.06),
            axes.get_xaxis_transform(),
            axes.get_xaxis_transform(),
            arrowprops={"arrowstyle": "-", "color": INK, "linewidth": 0.5},
            rotation=75,
            rotation_mode="anchor",
            fontsize=7,
        )


def _level(axes: Any, words: str, value: float, *, outside: bool) -> None:
    """A horizontal line with its words at its beginning, or beyond its end where stages cross its
    beginning."""
    axes.axhline(value, color=INK, linewidth=0.9, linestyle="--")
    place = {
        "xycoords": ("axes fraction", "data"),
        "textcoords": "offset points",
        "va": "center" if outside else "baseline",
    }
    axes.annotate(words, (float(outside), value), (3, 0 if outside else 2), fontsize=8, **place)


def _upright(axes: Any, mark: Mark, end: float, *, height: float) -> None:
    """A line at its hours, or, far beyond the curves, an arrow at the edge."""
    if mark.hours is not None and mark.hours < FAR * end:
        axes.axvline(mark.hours, color=INK, linewidth=0.9, linestyle="--")
        place = {"xycoords": axes.get_xaxis_transform(), "textcoords": "offset points"}
        axes.annotate(mark.words, (mark.hours, height), (-3, 0), ha="right", fontsize=8, **place)
    else:
        axes.annotate(
            f"{mark.words} \u2192", (0.94, height), xycoords="axes fraction", ha="right", fontsize=8
        )
