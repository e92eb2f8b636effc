"""A report about a study of `deepbots tune`: one HTML file with its history, the importance of values, and
slices."""

from __future__ import annotations

import platform
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from importlib.metadata import version
from math import ceil
from pathlib import Path
from shlex import join, quote
from statistics import fmean
from typing import TYPE_CHECKING, Any

import deepbots_cli
from deepbots_cli.errors import RunError
from deepbots_cli.insight.figures import new_figure, svg_uri, write_figure_files
from deepbots_cli.insight.templates import render_template
from deepbots_cli.learning.campaigns.study import Journal, Study, StudyTrial
from deepbots_cli.learning.runs.statistics import mean_interval
from deepbots_cli.view.frames import COLORS
from deepbots_cli.view.plots import THEMES, style_panel

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FIGURE_NAMES = ("history", "importance", "slices")
MEANINGS = {
    "solved": "The score is the fraction of the timesteps until the task is solved, the mean over the seeds."
    " A seed that does not solve it"
    " counts 1 to 2, by its distance from what `solved` requires.",
    "success_rate": "The score is the success rate in the evaluation of the best models, the mean over the"
    " seeds.",
    "mean_return": "The score is the mean return in the evaluation of the best models, the mean over the"
    " seeds.",
}
MIN_TRIALS = 8
"""The number of complete trials from which the importance of values is meaningful."""
_WIDE_WIDTH, _MAX_NAME = 8.0, 32


@dataclass(frozen=True, eq=False)
class StudyReport:
    """The content of the report of a study."""

    study: Study
    journal: Journal
    trials: Sequence[StudyTrial]
    notes: list[str] = field(default_factory=list)

    @staticmethod
    def read(path: Path) -> StudyReport:
        """Read a study with a complete trial.

        Raises:
            RunError: The study is damaged, or has no complete trial.
        """
        study = Study.open(path)
        resume = f"deepbots resume {quote(str(path))}"
        journal = study.connect()
        trials = study.trials(journal)
        report = StudyReport(study, journal, trials)
        if not report.ranked:
            raise RunError(f"{path} has no complete trial yet; continue it with: {resume}")
        if any(trial.state == "running" for trial in trials) or len(trials) < study.record.trials:
            report.notes.append(f"the study is not complete; continue it with: {resume}")
        if report.importances is None:
            report.notes.append(
                f"which values matter is shown from {MIN_TRIALS} complete trials with different scores on"
            )
        return report

    @property
    def path(self) -> Path:
        return self.study.path

    @cached_property
    def ranked(self) -> list[StudyTrial]:
        return self.study.ranked(self.trials)

    @cached_property
    def importances(self) -> dict[str, list[float]] | None:
        """The importance of each key, by seed; None with too few trials."""
        record = self.study.record
        if len(self.ranked) < MIN_TRIALS or len({trial.score for trial in self.ranked}) < MIN_TRIALS // 2:
            return None
        by_seed = self.journal.importances(len(record.seeds), lower_is_better=record.lower_is_better)
        return {name: [values.get(name, 0.0) for values in by_seed] for name in record.search}

    @property
    def result(self) -> str:
        """The best trial in one line."""
        best = self.ranked[0]
        interval = self.study.record.score_interval(best)
        over = "" if interval is None else " (95 % interval over seeds {:.4g} .. {:.4g})".format(*interval)
        values = ", ".join(f"{name}: {text}" for name, text in best.values.items())
        return f"best: trial {best.number} with {values}; score {best.score:.4g}{over}"

    # Figures

    def figures(self, theme: str) -> Iterator[tuple[str, str, str, Figure]]:
        """Yield name, title, caption and figure."""
        yield (
            "history",
            "History",
            "Score of each trial and the best so far. Marks below: trials that were pruned or failed.",
            self._history(theme),
        )
        if self.importances is not None:
            caption = (
                "How much each value matters for the best quarter of the trials (PED-ANOVA), as fractions of"
                " 1. Bars are means over the"
                " seeds, lines 95 % intervals; one alone says nothing."
            )
            yield "importance", "Importance", caption, self._importance(theme)
        caption = "Score against each value; darker points are later trials, the ring is the best one."
        yield "slices", "Slices", caption, self._slices(theme)

    def _history(self, theme: str) -> Figure:
        figure, ((panel,),) = new_figure(theme, 2.9)
        complete = sorted(self.ranked, key=lambda trial: trial.number)
        numbers, scores = [trial.number for trial in complete], [trial.score or 0.0 for trial in complete]
        better = min if self.study.record.lower_is_better else max
        best = [better(scores[: index + 1]) for index in range(len(scores))]
        panel.plot(numbers, scores, "o", color=COLORS[0], markersize=4, label="trials")
        panel.step(
            [*numbers, len(self.trials) - 1],
            [*best, best[-1]],
            where="post",
            color=COLORS[1],
            label="best so far",
        )
        ended = [trial.number for trial in self.trials if trial.state in ("pruned", "failed")]
        if ended:
            panel.plot(
                ended,
                [0.02] * len(ended),
                "|",
                color=THEMES[theme][1],
                transform=panel.get_xaxis_transform(),
                label="pruned or failed",
            )
        figure.set_figheight(figure.get_figheight() + style_panel(panel, "", theme, axes=("trial", "score")))
        return figure

    def _importance(self, theme: str) -> Figure:
        ordered = sorted((self.importances or {}).items(), key=lambda entry: fmean(entry[1]))
        figure, ((panel,),) = new_figure(theme, 0.9 + 0.32 * len(ordered))
        for index, (_, values) in enumerate(ordered):
            panel.barh(index, fmean(values), height=0.6, color=COLORS[0])
            interval = mean_interval(values, (0.0, 1.0))
            if interval is not None:
                panel.plot(interval, [index, index], color=THEMES[theme][1], linewidth=1.2)
        # Without `parse_math=False`, matplotlib would typeset names between two `$` as mathematics.
        panel.set_yticks(range(len(ordered)), [name[-_MAX_NAME:] for name, _ in ordered], parse_math=False)
        panel.set_xlim(0, 1)
        style_panel(panel, "", theme, legend=False, axes=("importance", ""))
        return figure

    def _slices(self, theme: str) -> Figure:
        from matplotlib.colors import LinearSegmentedColormap

        search = self.study.record.search
        columns = min(2, len(search))
        figure, panels = new_figure(
            theme, 0.4 + 2.3 * ceil(len(search) / columns), columns, ceil(len(search) / columns), _WIDE_WIDTH
        )
        shades = LinearSegmentedColormap.from_list("trials", [THEMES[theme][2], COLORS[0]])
        complete, best = sorted(self.ranked, key=lambda trial: trial.number), self.ranked[0]
        for panel, (name, space) in zip(panels.flat, search.items(), strict=False):
            at: list[Any] = [
                space.choices.index(t.values[name]) if space.choices else space.value_of(t.values[name])
                for t in complete
            ]
            scores = [trial.score for trial in complete]
            panel.scatter(at, scores, s=16, c=[trial.number for trial in complete], cmap=shades, linewidths=0)
            index = complete.index(best)
            panel.plot(at[index], scores[index], "o", color=COLORS[1], markerfacecolor="none", markersize=8)
            style_panel(
                panel,
                "",
                theme,
                legend=False,
                axes=(f"{name}{f', {space.unit}' if space.unit else ''}", "score"),
            )
            if space.choices:
                panel.set_xticks(
                    range(len(space.choices)), [choice[:12] for choice in space.choices], parse_math=False
                )
            elif space.log:
                panel.set_xscale("log")
        for panel in list(panels.flat)[len(search) :]:
            panel.set_visible(False)
        return figure

    def write_figures(self, folder: Path) -> list[Path]:
        """Write every figure as PNG.

        Raises:
            UsageError: A file cannot be written.
        """
        return write_figure_files(folder, ((name, figure) for name, _, _, figure in self.figures("light")))

    # The page

    def html(self) -> str:
        """Return the page."""
        record, dark = self.study.record, {name: figure for name, _, _, figure in self.figures("dark")}
        drawn = [
            {
                "name": name,
                "title": title,
                "caption": caption,
                "light": svg_uri(figure),
                "dark": svg_uri(dark[name]),
            }
            for name, title, caption, figure in self.figures("light")
        ]
        states = [trial.state for trial in self.trials]
        others = [trial for trial in self.trials if trial not in self.ranked]
        return render_template(
            "study.html.j2",
            html=True,
            report=self,
            record=record,
            figures=drawn,
            rows=[self._row(trial) for trial in [*self.ranked, *others]],
            counts=", ".join(f"{states.count(state)} {state}" for state in dict.fromkeys(states)),
            meaning=MEANINGS[record.objective],
            command=join(record.command) or "(from Python)",
            best=join(record.training_command(self.ranked[0].assignments)),
            version=deepbots_cli.__version__,
            python=platform.python_version(),
            matplotlib=version("matplotlib"),
        )

    def _row(self, trial: StudyTrial) -> dict[str, object]:
        interval = self.study.record.score_interval(trial)
        returns = [seed.mean_return for seed in trial.seeds if seed.mean_return is not None]
        solved = sum(seed.steps is not None for seed in trial.seeds)
        return {
            **{name: getattr(trial, name) for name in ("number", "state", "reason")},
            "texts": list(trial.values.values()),
            "score": "" if trial.score is None else f"{trial.score:.4g}",
            "interval": "" if interval is None else "{:.4g} .. {:.4g}".format(*interval),
            "solved": f"{solved} of {len(trial.seeds)}" if trial.seeds else "",
            "returns": f"{fmean(returns):.4g}" if returns else "",
        }
