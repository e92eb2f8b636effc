"""The display of a study while it runs, its table, and the next commands."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from shlex import quote
from statistics import fmean

import typer

from deepbots_cli.cli import arguments, terminal
from deepbots_cli.cli.exits import INTERRUPTED
from deepbots_cli.cli.records import interval_text
from deepbots_cli.cli.tables import Row, table
from deepbots_cli.display import Display
from deepbots_cli.document import Permissions
from deepbots_cli.learning.campaigns.study import Study, StudyReporter, StudyTrial, TrialProgress
from deepbots_cli.learning.campaigns.trials import run_study
from deepbots_cli.words import counted, number_text, rate_text, shell_word

_MAX_SHOWN = 10
"""The number of trials in the table; --json has all."""

_OBJECTIVES: Mapping[str, str] = {
    "solved": "score: fraction of the timesteps until solved, the mean over the seeds; above 1: not solved",
    "success_rate": "score: success rate of the evaluation, the mean over the seeds",
    "mean_return": "score: mean return of the evaluation, the mean over the seeds",
}


def continue_study(
    study: Study,
    workers: int | None,
    address: str | None,
    *,
    quiet: bool,
    as_json: bool,
    permissions: Permissions,
) -> None:
    """Train the trials of a study that are left, and show its table."""
    with arguments.executor(workers, address, study.record.trials, quiet=quiet) as executor:
        display = StudyDisplay(study, quiet=quiet)
        try:
            is_done = run_study(study, reporter=display, permissions=permissions, executor=executor)
        finally:
            display.stop()
    show_study(study, is_done=is_done, as_json=as_json)


class StudyDisplay(StudyReporter):
    """A line for each trial that ends; on a terminal, a line below it that is rewritten during a training."""

    def __init__(self, study: Study, *, quiet: bool) -> None:
        self._study = study
        self._quiet = quiet
        self._best = ""
        self._display = Display(transient=True)
        self._begun: dict[int, StudyTrial] = {}
        self._at_work: dict[int, TrialProgress] = {}
        self._noted: set[str] = set()
        record = study.record
        if not quiet:
            terminal.note(
                f"study {study.path}:"
                f" {', '.join(f'{name} = {space}' for name, space in record.search.items())}"
            )
            terminal.note(
                f"{counted(record.trials, 'trial')} with {counted(len(record.seeds), 'seed')} and at most"
                f" {record.total_timesteps:,} timesteps each; {_OBJECTIVES[record.objective]}; Ctrl-C keeps"
                " everything"
            )
            if task := [name for name in record.search if not name.startswith("train.")]:
                terminal.note(
                    f"note: {', '.join(task)} may change the task itself; each trial is evaluated in its own"
                    " task"
                )

    def note(self, text: str) -> None:
        if not self._quiet and text not in self._noted:  # all trainings may have the same
            self._noted.add(text)
            self._display.print(terminal.printable(f"note: {text}"))

    def begin_trial(self, trial: StudyTrial) -> None:
        self._begun[trial.number] = trial

    def update(self, number: int, progress: TrialProgress) -> None:
        self._at_work[number] = progress
        if not self._quiet:
            self._display.show(terminal.printable("  ".join(filter(None, [self._work(), self._best]))))

    def _work(self) -> str:
        """Return the progress of the trials at work."""
        if len(self._at_work) > 1:
            return "at work: " + ", ".join(
                f"trial {number} ({rate_text(progress.fraction)})"
                for number, progress in self._at_work.items()
            )
        ((number, progress),) = self._at_work.items()
        steps = f"{progress.training.steps:,} of {progress.training.total_steps:,} steps"
        return (
            f"seed {progress.seed}, {progress.place} of {progress.count}: {steps}  trial {number}:"
            f" {_settings(self._begun[number].values)}"
        )

    def stop(self) -> None:
        self._display.close()

    def end_trial(self, trial: StudyTrial) -> None:
        self._at_work.pop(trial.number, None)
        if self._quiet:
            return
        best = next(iter(self._study.ranked(self._study.trials())), None)
        self._best = f"best so far: trial {best.number}, {_score(best)}" if best else ""
        result = trial.reason or trial.state if trial.score is None else _result(self._study, trial)
        self._display.print(terminal.printable(f"trial {trial.number}: {_settings(trial.values)}: {result}"))


def _settings(values: Mapping[str, str]) -> str:
    return ", ".join(f"{name}={text}" for name, text in values.items())


def _score(trial: StudyTrial) -> str:
    return f"score {number_text(trial.score or 0.0)}"


def _solved(study: Study, trial: StudyTrial) -> tuple[str, float | None]:
    """Return how many seeds solved the task, and after how many steps; empty if it may have no `solved`."""
    steps = [seed.steps for seed in trial.seeds if seed.steps is not None]
    count = f"{len(steps)} of {len(trial.seeds)}" if steps or study.record.objective == "solved" else ""
    return count, fmean(steps) if steps else None


def _result(study: Study, trial: StudyTrial) -> str:
    count, steps = _solved(study, trial)
    after = "" if steps is None else f" after {steps:,.0f} steps"
    return _score(trial) + (f", {count} seeds solved{after}" if count else "")


def _row(study: Study, trial: StudyTrial) -> Row:
    count, steps = _solved(study, trial)
    return {
        "trial": trial.number,
        **trial.values,
        "score": trial.score,
        "score_95 %": interval_text(study.record.score_interval(trial)),
        "solved": count or None,
        "steps": None if steps is None else round(steps),
        "return": trial.mean_return,
        "success": None if trial.success_rate is None else f"{rate_text(trial.success_rate, 1)}",
    }


def show_study(study: Study, *, is_done: bool, as_json: bool) -> None:
    """Show the best trials, and the next commands."""
    trials = study.trials()
    ranked = study.ranked(trials)
    path = shell_word(study.path)
    counts = {
        state: sum(trial.state == state for trial in trials)
        for state in ("complete", "pruned", "failed", "running")
    }
    rows = [_row(study, trial) for trial in ranked[:_MAX_SHOWN]]
    summary = ", ".join(f"{count} {state}" for state, count in counts.items() if count)
    lines = [
        f"study {study.path}: {summary or 'no trial'} of {study.record.trials} trials",
        *([table(rows)] if rows else []),
    ]
    best = ranked[0] if ranked else None
    over_first = study.over_first(trials)
    if best is not None:
        lines.append(_best_text(study, ranked))
    if is_done and counts["running"]:
        lines.append(
            f"another process still trains {counts['running']} of them; this table shows what is complete"
        )
    data = {
        "study": study.path,
        "objective": study.record.objective,
        "done": is_done,
        "best": best.number if best else None,
        "over_first": over_first,
        "trials": [{**vars(trial), "score_interval": study.record.score_interval(trial)} for trial in trials],
    }
    further = [f"deepbots runs {path}", f"deepbots resume {path} --trials {2 * study.record.trials}"]
    if not is_done:
        further = [f"deepbots resume {path}"]
    elif best is not None:
        if over_first is not None and over_first.is_clear:
            further.insert(1, f"deepbots apply {path}")
        # The best of equal scores was chosen by too few starts.
        if len(ranked) == 1 or ranked[1].score != best.score:
            command = study.record.training_command(best.assignments, unused_seeds(study))
            # Only the scenario, the third word, is a path.
            further.append(" ".join([*command[:2], shell_word(command[2]), *map(quote, command[3:])]))
    terminal.show(data, *lines, as_json=as_json, next_commands=further)
    if not is_done:
        raise typer.Exit(INTERRUPTED)


def _best_text(study: Study, ranked: Sequence[StudyTrial]) -> str:
    """Return the best trial, those with its score, and whether it is clearly better than the values of the
    scenario itself."""
    best = ranked[0]
    over_first = study.over_first(ranked)
    text = f"best: trial {best.number}, {_score(best)}"
    if equals := sum(trial.score == best.score for trial in ranked) - 1:
        measures = (
            "the return" if study.record.objective == "mean_return" else "the success rate, then the return"
        )
        text += (
            f"; {equals} other trial{'s have' if equals > 1 else ' has'} this score, and {measures}"
            " chose the best one"
        )
    if over_first is None:
        is_first = best.number == 0 and study.record.present
        return text + ("; it has the values of the scenario itself" if is_first else "")
    difference = over_first.difference
    first = next(trial for trial in ranked if trial.number == 0)
    reference = f"the values of the scenario itself (trial 0, {_score(first)})"
    if over_first.is_clear:
        return f"{text}; it is clearly better than {reference}"
    if difference.interval is None:
        why = "one seed, or a few with equal scores, do not show it"
    else:
        interval = interval_text(difference.interval)
        why = f"the interval of the difference, {interval} for {len(ranked)} trials, contains 0"
    return f"{text}; it is not clearly better than {reference}: {why}"


def unused_seeds(study: Study) -> str:
    # The seeds of the study have chosen the values, so only other seeds judge them without bias.
    first = max(study.record.seeds) + 1
    return f"{first}..{first + 4}"
