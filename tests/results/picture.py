"""The learning curves of a scenario, drawn so that light and dark pages both show them."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from deepbots_cli.learning.atomic import write_text
from tests.results.experiment import Experiment, Mark

INK = "#7d8590"
"""Of axes and texts: as far from white as from near black."""

SEEDS = ("#2f81f7", "#d2762a", "#2da44e", "#bf5fb5", "#c9423c", "#14a3a8", "#8a7be0", "#a38a1f", "#e0669b", "#6b8fae")
STYLES = ("-", "--", ":", "-.")
"""One for each training of the experiment."""

FAR = 1.5
"""An hour that is so many times beyond the curves is told at the edge and not drawn, or the curves would be a sliver."""


def has_curves(record: Mapping[str, Any]) -> bool:
    return any(record.get("trainings", {}).values())


def state(experiment: Experiment, record: Mapping[str, Any]) -> str:
    """A digest of all that the picture shows; the picture carries it, so that a test can tell whether it is current."""
    shown = [experiment.title, experiment.curve, [vars(mark) for mark in experiment.marks]]
    curves = [(name, seed, entry["curve"], entry["stages"]) for name, seed, entry in _entries(experiment, record)]
    return hashlib.sha256(json.dumps([shown, curves]).encode()).hexdigest()[:16]


def is_current(experiment: Experiment, record: Mapping[str, Any], path: Path) -> bool:
    if not has_curves(record):
        return not path.exists()
    return path.is_file() and f"state {state(experiment, record)}" in path.read_text(encoding="utf-8")


def write(experiment: Experiment, record: Mapping[str, Any], path: Path) -> None:
    """Draw it where its data have changed; remove one that has no data any more."""
    if is_current(experiment, record, path):
        return
    if not has_curves(record):
        path.unlink()
        return
    path.parent.mkdir(parents=True, exist_ok=True)
    write_text(path, drawn(experiment, record))


def _entries(experiment: Experiment, record: Mapping[str, Any]) -> Iterator[tuple[str, str, Mapping[str, Any]]]:
    for training in experiment.trainings:
        found = record.get("trainings", {}).get(training.name, {})
        yield from ((training.name, str(seed), found[str(seed)]) for seed in training.seeds if str(seed) in found)


def drawn(experiment: Experiment, record: Mapping[str, Any]) -> str:
    """The text of the SVG: the same for the same data, wherever it is drawn."""
    import io

    import matplotlib as mpl
    from matplotlib.backends.backend_svg import FigureCanvasSVG
    from matplotlib.figure import Figure

    settings = {"svg.hashsalt": "deepbots", "svg.fonttype": "none", "font.family": "sans-serif", "font.size": 9, "path.simplify": True}
    ink = dict.fromkeys(("text.color", "axes.edgecolor", "axes.labelcolor", "xtick.color", "ytick.color"), INK)
    with mpl.rc_context({**settings, **ink}):
        figure = Figure(figsize=(7.2, 3.4), layout="constrained")
        figure.patch.set_alpha(0)
        axes = figure.add_subplot(facecolor="none")
        _draw(axes, experiment, list(_entries(experiment, record)))
        stream = io.StringIO()
        FigureCanvasSVG(figure).print_svg(stream, metadata={"Date": None, "Description": f"state {state(experiment, record)}"})
    return "\n".join(line.rstrip() for line in stream.getvalue().splitlines()) + "\n"


def _draw(axes: Any, experiment: Experiment, entries: list[tuple[str, str, Mapping[str, Any]]]) -> None:
    names = [training.name for training in experiment.trainings]
    seeds = list(dict.fromkeys(seed for _, seed, _ in entries))
    scale = 100 if experiment.curve == "success" else 1
    for name, seed, entry in entries:
        colour, label = SEEDS[seeds.index(seed) % len(SEEDS)], seed if name == names[0] else f"{seed}, {name}"
        hours, values = entry["curve"]["simulated_hours"], [scale * value for value in entry["curve"][experiment.curve]]
        axes.plot(hours, values, STYLES[names.index(name) % len(STYLES)], color=colour, linewidth=1.3, label=label)
        for end in entry["stages"]:
            axes.axvline(end["simulated_hours"], color=colour, linewidth=0.6, alpha=0.6, linestyle=(0, (1, 2)))
    if len(seeds) == 1:
        _name_stages(axes, entries)
    end = max(entry["simulated_hours"] for _, _, entry in entries)
    axes.set_xlim(0, max([end, *(mark.hours for mark in experiment.marks if mark.hours and mark.hours < FAR * end)]) * 1.02)
    for place, mark in enumerate(experiment.marks):
        _mark(axes, mark, scale, end, place)
    axes.set_xlabel("simulated hours")
    axes.set_ylabel("successes in 100 episodes, %" if experiment.curve == "success" else "mean return of 100 episodes")
    axes.spines[["top", "right"]].set_visible(False)
    axes.grid(color=INK, alpha=0.2, linewidth=0.5)
    axes.legend(title="seed", frameon=False, fontsize=8, title_fontsize=8, loc="center left", bbox_to_anchor=(1.0, 0.5))


def _name_stages(axes: Any, entries: list[tuple[str, str, Mapping[str, Any]]]) -> None:
    for _, _, entry in entries[:1]:
        for end in entry["stages"]:
            where = (end["simulated_hours"], 0.02)
            axes.text(*where, f"{end['name']} ", transform=axes.get_xaxis_transform(), rotation=90, ha="right", va="bottom", fontsize=7)


def _mark(axes: Any, mark: Mark, scale: float, end: float, place: int) -> None:
    if mark.value is not None:
        axes.axhline(scale * mark.value, color=INK, linewidth=0.9, linestyle="--")
        axes.annotate(
            mark.words, (0, scale * mark.value), (3, 2), xycoords=("axes fraction", "data"), textcoords="offset points", fontsize=8
        )
    elif mark.hours is not None and mark.hours < FAR * end:
        axes.axvline(mark.hours, color=INK, linewidth=0.9, linestyle="--")
        axes.annotate(
            mark.words, (mark.hours, 0.03), (-3, 0), xycoords=axes.get_xaxis_transform(), textcoords="offset points", ha="right", fontsize=8
        )
    elif mark.hours is not None:
        axes.annotate(f"{mark.words} \u2192", (0.99, 0.05 + 0.08 * place), xycoords="axes fraction", ha="right", fontsize=8)
