"""`deepbots tune`: a study, its progress and its table, and its best values in a file."""

from __future__ import annotations

import json
import shutil
import sys
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from shlex import quote
from statistics import fmean
from typing import Annotated, Any, get_args

import typer

from deepbots_cli import api
from deepbots_cli.cli import processes, terminal
from deepbots_cli.cli.command import (
    ADVANCED,
    MAX_SEED,
    MAX_SEEDS,
    OUTPUT,
    ClusterAddress,
    Engine,
    Json,
    Overrides,
    Workers,
    integer,
    option,
    seed_list,
    whole_number,
)
from deepbots_cli.cli.exits import INTERRUPTED
from deepbots_cli.cli.records import interval_text
from deepbots_cli.cli.tables import Row, table
from deepbots_cli.compiler import CheckedScenario
from deepbots_cli.document import Permissions
from deepbots_cli.engine_kinds import with_engine
from deepbots_cli.errors import DeepbotsError, UsageError
from deepbots_cli.learning.study import Objective, Study, StudyReporter, StudyTrial, TrialProgress, create_study
from deepbots_cli.learning.trials import run_study

_MAX_SHOWN = 10
"""Trials in the table; --json has all."""
_LONG_JOURNAL_MB = 5
"""Reading this much takes a second."""


def command(
    scenario: Annotated[
        str | None,
        typer.Argument(
            metavar="SCENARIO",
            help="A scenario file, or the name of a scenario that comes with deepbots; with --apply, the file to change.",
        ),
    ] = None,
    params: Annotated[
        list[str] | None,
        option(
            "--param PATH=VALUES",
            "Values to try, such as train.learning_rate=1e-4..1e-2:log, parameters.pole_length=0.5..1.5m or train.batch_size='64 | 128';"
            " may be repeated. By default those of `tune.search`.",
        ),
    ] = None,
    overrides: Overrides = None,
    trials: Annotated[int | None, integer("--trials N", "Number of trials in all; by default `tune.trials`, else 40.", 1, 100_000)] = None,
    seeds: Annotated[
        str | None, option("--seeds N|LIST", "Number of seeds of each trial, or a list such as 0..4; by default `tune.seeds`, else 3.")
    ] = None,
    timesteps: Annotated[
        int | None,
        integer("--timesteps N", "Timesteps of each training, such as 50k; by default `tune.timesteps`, else `train.total_timesteps`."),
    ] = None,
    objective: Annotated[
        str | None,
        option(
            "--objective NAME",
            "What makes a trial good: `solved` (few timesteps until the task is solved), `success_rate` or `mean_return` (of an evaluation"
            " of the best models). By default the first of them that the scenario defines.",
        ),
    ] = None,
    seed: Annotated[int, integer("--seed N", "Seed of the search; 0 by default.", 0, MAX_SEED)] = 0,
    run: Annotated[Path | None, option("--run DIR", "Directory to create for the study; by default a new one in ./runs.")] = None,
    resume: Annotated[Path | None, option("--resume STUDY", "Continue this study, also while other processes work on it.")] = None,
    apply: Annotated[bool, option("--apply", "With --resume, write the best values into the scenario file and run no trial.")] = False,
    prune: Annotated[bool | None, option("--prune/--no-prune", "End trials early that are worse than the median.", ADVANCED)] = None,
    workers: Workers = None,
    address: ClusterAddress = None,
    engine: Engine = None,
    quiet: Annotated[bool, option("--quiet -q", "Print no progress.", OUTPUT)] = False,
    as_json: Json = False,
    permissions: Permissions = Permissions(),
) -> None:
    """Search for better values of a scenario.

    The values are hyperparameters, or parameters of the task. A trial trains the scenario with one set of values, once for each seed,
    and evaluates the best models. The values of the next trial follow from the scores so far (TPE, by Optuna). The first trial has the
    values of the scenario itself, where they are in the ranges. A trial whose evaluations during the training are worse than the median
    of other trials ends early.

    Values are a range, `1e-4..1e-2` or `0.5..1.5m`, or choices, `64 | 128` or `[[64, 64], [10, 10]]`. `:log` behind a range draws values by
    their logarithm. A key that takes whole numbers gets whole numbers. The section `tune` of the scenario has the same settings.

    \b
      deepbots tune cartpole --param train.learning_rate=1e-4..1e-2:log --trials 20 --seeds 3
      deepbots tune mine.yaml --param fall_angle=10..20deg --param train.network.activation='tanh|relu'
      deepbots tune mine.yaml --workers 4
      deepbots tune --resume runs/cartpole-tune-1 --trials 40
      deepbots tune --resume runs/cartpole-tune-1 --apply mine.yaml

    A study is a folder with a group of runs for each trial: `deepbots runs STUDY` lists them, and `eval`, `compare`, `plot` and `report`
    take each of them. Several processes may work on one study: start `deepbots tune --resume STUDY` in each. A study that was interrupted
    continues with the trials that were begun, each from its last checkpoint. --trials is the number in all. With --workers N, N trials
    run at a time; the values of later trials then depend on which trials end first.

    The score of the objective `solved` is the fraction of the timesteps until the task is solved, the mean over the seeds; a seed that does
    not solve it counts 1 to 2, by its distance from what `solved` requires. Of equal scores, the higher success rate comes first, then
    the higher return. The best of many trials looks better than it is: the command says whether it is clearly better than the values of
    the scenario itself, and advises --apply only then. Confirm it with seeds that the study did not use.

    Next: `deepbots report STUDY` shows the history, which values matter, and slices.
    """
    if resume is not None:
        others = (workers, address) if apply else (scenario,)
        given = (params, overrides, seeds, timesteps, objective, run, prune, engine, seed or None, *others)
        if any(option is not None for option in given):
            raise UsageError(
                "--resume continues with the scenario and options of the study; only these options can be added: --trials, --apply,"
                " --workers, --cluster, --quiet, --allow-code, --json"
            )
        study = Study.open(resume)
        if not quiet and (megabytes := study.journal_bytes // 1_000_000) > _LONG_JOURNAL_MB:
            terminal.note(f"reading the trials of {study.path} ({megabytes} MB) ...")
        if apply:
            _apply(study, scenario or study.record.source, permissions, as_json=as_json)
            return
        if trials is not None and trials != study.record.trials:
            study = study.with_trials(trials)
    elif apply:
        raise UsageError("--apply writes the best values of a study; name it with --resume STUDY")
    elif scenario is None:
        raise UsageError("there is no scenario; name one, such as: deepbots tune cartpole --param train.learning_rate=1e-4..1e-2:log")
    else:
        if objective not in (None, *get_args(Objective)):
            raise UsageError(f"--objective: there is no objective '{objective}'; choose one of: {', '.join(get_args(Objective))}")
        if run is not None and run.exists():
            raise UsageError(f"--run: {run} already exists; choose another directory, because studies are not overwritten")
        checked = _checked(scenario, params or (), with_engine(overrides, engine), permissions)
        settings: dict[str, Any] = {"trials": trials, "timesteps": timesteps, "objective": objective, "prune": prune, "seed": seed}
        study = create_study(
            checked, folder=run, seeds=None if seeds is None else _seeds(seeds), command=["deepbots", *sys.argv[1:]], **settings
        )
    with ExitStack() as stack:
        try:
            spread = stack.enter_context(processes.spread(workers, address, study.record.trials, quiet=quiet))
        except (DeepbotsError, KeyboardInterrupt):
            if resume is None:
                shutil.rmtree(study.path, ignore_errors=True)
            raise
        display = _Display(study, quiet=quiet)
        stack.callback(display.stop)
        done = run_study(study, reporter=display, permissions=permissions, spread=spread)
    _show(study, done=done, as_json=as_json)


def _checked(scenario: str, params: Sequence[str], overrides: Sequence[str] | None, permissions: Permissions) -> CheckedScenario:
    """The scenario with the search of the options.

    Raises:
        UsageError: An option is wrong; one sentence.
        ScenarioError: The scenario has errors, in its section `tune` too.
    """
    overrides = list(overrides or ())
    if not params:
        return api.load(scenario, overrides=overrides, permissions=permissions, tests=True)
    search: dict[str, str] = {}
    for text in params:
        path, _, values = (part.strip() for part in text.partition("="))
        if not path or not values:
            raise UsageError(f"--param {text}: write PATH=VALUES, such as --param train.learning_rate=1e-4..1e-2:log")
        if path in search:
            raise UsageError(f"--param names {path} twice")
        search[path] = values
    before = api.load(scenario, overrides=overrides, permissions=permissions)
    if before.program is None:  # its own errors, in full
        api.compile(before)
    # A list is YAML already; anything else is one text.
    entries = (f"{json.dumps(path)}: {values if values.startswith('[') else json.dumps(values)}" for path, values in search.items())
    checked = api.load(scenario, overrides=[*overrides, f"tune.search={{{', '.join(entries)}}}"], permissions=permissions, tests=True)
    for found in checked.findings.errors:
        if found.span.source.name.startswith("--set tune"):
            name = next((f" {path}={values}" for path, values in search.items() if found.span.text.strip("\"'") in (path, values)), "")
            raise UsageError(f"--param{name}: {found.headline}{f'; {found.help}' if found.help else ''}")
    return checked


def _seeds(text: str) -> Sequence[int]:
    """`3`: that many seeds from 0; `0..4` or `0,3,7`: these."""
    if ".." in text or "," in text:
        return seed_list(text)
    return range(whole_number(1, MAX_SEEDS)(text))


class _Display(StudyReporter):
    """A line for each trial that ends; on a terminal, a line below it that is rewritten during a training."""

    def __init__(self, study: Study, *, quiet: bool) -> None:
        self._study, self._quiet, self._best = study, quiet, ""
        self._line = terminal.LiveLine() if not quiet else None
        self._begun: dict[int, StudyTrial] = {}
        self._at_work: dict[int, TrialProgress] = {}
        self._noted: set[str] = set()
        record = study.record
        if not quiet:
            keys = ", ".join(f"{name} = {space}" for name, space in record.search.items())
            terminal.note(f"study {study.path}: {keys}")
            terminal.note(
                f"{record.trials} trial{'s' * (record.trials > 1)} with {len(record.seeds)} seed{'s' * (len(record.seeds) > 1)} and at most"
                f" {record.total_timesteps:,} timesteps each; {_OBJECTIVES[record.objective]}; Ctrl-C keeps everything"
            )
            if task := [name for name in record.search if not name.startswith("train.")]:
                terminal.note(f"note: {', '.join(task)} may change the task itself; each trial is evaluated in its own task")

    def note(self, text: str) -> None:
        if not self._quiet and text not in self._noted:  # all trainings may have the same
            self._noted.add(text)
            self.stop()
            terminal.note(f"note: {text}")

    def begin_trial(self, trial: StudyTrial) -> None:
        self._begun[trial.number] = trial

    def update(self, number: int, progress: TrialProgress) -> None:
        self._at_work[number] = progress
        if self._line is not None:
            self._line.show("  ".join(filter(None, [self._work(), self._best])))

    def _work(self) -> str:
        """How far the trials at work are."""
        if len(self._at_work) > 1:
            return "at work: " + ", ".join(f"trial {number} ({each.fraction:.0%})" for number, each in self._at_work.items())
        ((number, each),) = self._at_work.items()
        steps = f"{each.training.steps:,} of {each.training.total_steps:,} steps"
        return f"seed {each.seed}, {each.place} of {each.count}: {steps}  trial {number}: {_settings(self._begun[number].values)}"

    def stop(self) -> None:
        if self._line is not None:
            self._line.clear()

    def end_trial(self, trial: StudyTrial) -> None:
        self._at_work.pop(trial.number, None)
        if self._line is None:
            return
        self._line.clear()
        best = next(iter(self._study.ranked(self._study.trials())), None)
        self._best = f"best so far: trial {best.number}, score {best.score:.4g}" if best else ""
        result = trial.reason or trial.state if trial.score is None else _result(trial)
        terminal.note(f"trial {trial.number}: {_settings(trial.values)}: {result}")


_OBJECTIVES: Mapping[str, str] = {
    "solved": "score: fraction of the timesteps until solved, the mean over the seeds; above 1: not solved",
    "success_rate": "score: success rate of the evaluation, the mean over the seeds",
    "mean_return": "score: mean return of the evaluation, the mean over the seeds",
}


def _settings(values: Mapping[str, str]) -> str:
    return ", ".join(f"{name}={text}" for name, text in values.items())


def _result(trial: StudyTrial) -> str:
    solved = [each.steps for each in trial.seeds if each.steps is not None]
    after = f", {len(solved)} of {len(trial.seeds)} seeds solved" + (f" after {fmean(solved):,.0f} steps" if solved else "")
    return f"score {trial.score:.4g}{after}"


def _row(study: Study, trial: StudyTrial) -> Row:
    solved = [each.steps for each in trial.seeds if each.steps is not None]
    return {
        "trial": trial.number,
        **trial.values,
        "score": trial.score,
        "score_95 %": interval_text(study.record.score_interval(trial)),
        "solved": f"{len(solved)} of {len(trial.seeds)}",
        "steps": round(fmean(solved)) if solved else None,
        "return": trial.mean_return,
        "success": None if trial.success_rate is None else f"{trial.success_rate:.1%}",
    }


def _show(study: Study, *, done: bool, as_json: bool) -> None:
    """The best trials, and what to do next."""
    found = study.trials()
    ranked, path = study.ranked(found), quote(str(study.path))
    counts = {state: sum(trial.state == state for trial in found) for state in ("complete", "pruned", "failed", "running")}
    rows = [_row(study, trial) for trial in ranked[:_MAX_SHOWN]]
    summary = ", ".join(f"{count} {state}" for state, count in counts.items() if count)
    lines = [f"study {study.path}: {summary or 'no trial'} of {study.record.trials} trials", *([table(rows)] if rows else [])]
    best = ranked[0] if ranked else None
    over_first = study.over_first(found)
    if best is not None:
        lines.append(_best_text(study, ranked))
    if done and counts["running"]:
        lines.append(f"another process still trains {counts['running']} of them; this table shows what is complete")
    data = {
        "study": study.path,
        "objective": study.record.objective,
        "done": done,
        "best": best.number if best else None,
        "over_first": over_first,
        "trials": [{**vars(trial), "score_interval": study.record.score_interval(trial)} for trial in found],
    }
    further = [f"deepbots report {path}", f"deepbots tune --resume {path} --trials {2 * study.record.trials}"]
    if not done:
        further = [f"deepbots tune --resume {path}"]
    elif best is not None:
        if over_first is not None and over_first.is_clear:
            further.insert(1, f"deepbots tune --resume {path} --apply")
        if len(ranked) == 1 or ranked[1].score != best.score:  # of equal scores, too few starts chose the best one
            settings = " ".join(f"--set {quote(text)}" for text in (*study.record.set, *best.assignments))
            further.append(f"deepbots train {quote(study.record.source)} {settings} --seeds {_unused_seeds(study)}")
    terminal.show(data, *lines, as_json=as_json, next_commands=further)
    if not done:
        raise typer.Exit(INTERRUPTED)


def _best_text(study: Study, ranked: Sequence[StudyTrial]) -> str:
    """The best trial, those with its score, and whether it is clearly better than the values of the scenario itself."""
    best, over_first = ranked[0], study.over_first(ranked)
    text = f"best: trial {best.number}, score {best.score:.4g}"
    if equals := sum(trial.score == best.score for trial in ranked) - 1:
        measures = "the return" if study.record.objective == "mean_return" else "the success rate, then the return"
        text += f"; {equals} other trial{'s have' if equals > 1 else ' has'} this score, and {measures} chose the best one"
    if over_first is None:
        is_first = best.number == 0 and study.record.present
        return text + ("; it has the values of the scenario itself" if is_first else "")
    difference, first = over_first.difference, next(trial for trial in ranked if trial.number == 0)
    own = f"the values of the scenario itself (trial 0, score {first.score:.4g})"
    if over_first.is_clear:
        return f"{text}; it is clearly better than {own}"
    if difference.interval is None:
        why = "one seed does not show it"
    else:
        low, high = difference.interval
        why = f"the interval of the difference, {low:.4g} .. {high:.4g} for {len(ranked)} trials, contains 0"
    return f"{text}; it is not clearly better than {own}: {why}"


def _apply(study: Study, name: str, permissions: Permissions, *, as_json: bool) -> None:
    """Write the values of the best trial into a scenario file.

    Raises:
        UsageError: No trial is complete, the file comes with deepbots, or its text does not allow a change.
    """
    from deepbots_cli.cli.commands.rewriting import write_values  # which imports the rules of lint

    trials = study.trials()
    best = next(iter(study.ranked(trials)), None)
    if best is None:
        raise UsageError(f"{study.path} has no complete trial yet; continue it with: deepbots tune --resume {quote(str(study.path))}")
    file = write_values(name, best.values, f"tuned by {study.path.name}, trial {best.number}", permissions)
    over_first = study.over_first(trials)
    if over_first is not None and not over_first.is_clear:
        terminal.note(f"note: trial {best.number} is not clearly better than the values of the scenario itself")
    data = {"file": file, "trial": best.number, "score": best.score, "values": best.values, "over_first": over_first}
    rows = [{"key": path, "value": text} for path, text in best.values.items()]
    further = [f"deepbots lint {quote(str(name))}", f"deepbots train {quote(str(name))} --seeds {_unused_seeds(study)}"]
    terminal.show(
        data, f"{file}: values of trial {best.number}, score {best.score:.4g}\n{table(rows)}", as_json=as_json, next_commands=further
    )


def _unused_seeds(study: Study) -> str:
    first = max(study.record.seeds) + 1
    return f"{first}..{first + 4}"
