"""Records as text, JSON and CSV.

A record is an object with statistics of episodes: an evaluation, which may be read from a run, a group, a
listed run, a level of robustness, or a part of the range of a drawn value. `scores` returns its columns in
every table, and `with_interval` a statistic in a list of lines.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from deepbots_cli.cli import terminal
from deepbots_cli.cli.tables import Measured, Row, row_as_lines, table, write_tables
from deepbots_cli.errors import RunError, UsageError
from deepbots_cli.learning.runs.episodes import RETURN_STATISTICS, Scores, Summary, agents_text
from deepbots_cli.learning.runs.evaluations import EvaluationResult, in_parentheses
from deepbots_cli.learning.runs.run import PATIENCE, ModelRef, Run, RunRecord, TrainingResult
from deepbots_cli.learning.runs.statistics import Interval, episodes_above
from deepbots_cli.learning.runs.verdict import last_episodes, run_verdict
from deepbots_cli.rollout.episode import own_episode
from deepbots_cli.words import counted, number_text, rate_text, shell_word

if TYPE_CHECKING:
    from deepbots_cli.learning.campaigns.group import GroupTraining
    from deepbots_cli.learning.comparison import EngineDifference, GroupDifference, GroupResult
    from deepbots_cli.learning.robustness import Robustness
    from deepbots_cli.view.frames import WorldFrame

MAX_DRAWN = 8
"""The number of drawn values with an effect that `--details` shows; `--json` has all of them."""


# Statistics


def scores(record: Any, *, success_defined: bool = True, intervals: bool = True) -> Row:
    """Return the columns of a record: return and success, with 95 % intervals. A table leaves out columns
    that are empty in every row.

    A success that the scenario does not define (`success_defined`, here or of the record) is empty. The
    interval of equal returns is not shown, since it follows from the possible returns alone.
    """
    is_defined = (
        success_defined and getattr(record, "success_defined", True) and record.success_rate is not None
    )
    row: dict[str, object] = {"return": record.mean_return}
    if intervals:
        row["return_95 %"] = (
            Measured("all equal", record.return_interval)
            if getattr(record, "std_return", None) == 0
            else interval_text(record.return_interval)
        )
    row["success"] = percent(record.success_rate) if is_defined else ""
    if intervals:
        row["success_95 %"] = interval_text(record.success_interval if is_defined else None, percent)
    return row


def differences(entry: GroupDifference | EngineDifference) -> Row:
    """Return the columns of a difference between two records."""
    row: dict[str, object] = dict.fromkeys(("return", "return_95 %", "success", "success_95 %"))
    if entry.mean_return is not None:
        row |= {"return": entry.mean_return.mean, "return_95 %": interval_text(entry.mean_return.interval)}
    if entry.success_rate is not None:
        row["success"] = Measured(f"{entry.success_rate.mean:+.1%}", entry.success_rate.mean)
        row["success_95 %"] = interval_text(entry.success_rate.interval, percent)
    return row


def engines_table(pairs: Sequence[EngineDifference]) -> str:
    """Return a row for each engine and case, against the first engine."""
    itself = "(the scenario itself)" if any(pair.case for pair in pairs) else ""
    return table(
        [
            {"difference": f"{pair.engine} - {pair.first}", "case": pair.case or itself, **differences(pair)}
            for pair in pairs
        ]
    )


def number(value: float) -> str:
    """Return a number with two decimals; four if returns are small."""
    return f"{value:z.4f}" if 0 < abs(value) < 1 else f"{value:z.2f}"


def percent(share: float) -> Measured:
    return Measured(rate_text(share, 1), share)


def interval_text(interval: tuple[Any, Any] | None, form: Callable[[Any], str] = number_text) -> Measured:
    """Return an interval as a cell."""
    return Measured(" .. ".join(dict.fromkeys(map(form, interval or ()))), (interval or (None, None)))


def with_interval(
    value: float, interval: Interval | None, form: Callable[[float], str] = number, remark: str = ""
) -> str:
    """Return a statistic and its interval, with a remark behind the interval."""
    return form(value) + (
        "" if interval is None else f" (95 %: {form(interval[0])} .. {form(interval[1])}{remark})"
    )


def means(
    record: Any, *, success_defined: bool = True, over: str = "", remark: str = "", stopped: str = ""
) -> Row:
    """Return the lines of a record: mean return and success rate with their intervals, by default those of
    the record; `over` is the end of the names of other ones. `remark` stands behind the interval of the
    return, `stopped` behind both."""
    interval, of_success = (getattr(record, f"{name}_interval{over}") for name in ("return", "success"))
    has_success = success_defined and record.success_rate is not None
    return {
        "mean return": with_interval(record.mean_return, interval, remark=remark + stopped),
        "success rate": with_interval(record.success_rate, of_success, percent, stopped)
        if has_success
        else "",
    }


def _statistics(result: Summary, *, success_defined: bool, agents: Mapping[str, Scores] | None = None) -> Row:
    """Return the lines about episodes; of several agents, the scores of each, and what all have in common."""
    is_early = (getattr(result, "planned", None) or 0) > result.episodes
    of_all = means(
        result,
        success_defined=success_defined,
        remark="; all returns are equal" if result.std_return == 0 else "",
        stopped=f"; as for {result.episodes} planned episodes" if is_early else "",
    )
    common = {
        "mean length": f"{result.mean_length:.1f} steps",
        "ended by": _endings(result),
        "success rate": of_all["success rate"],
    }
    if agents:
        return {name: _joined(means(scores)) for name, scores in agents.items()} | common
    return {
        "mean return": of_all["mean return"],
        "standard deviation": None if result.std_return is None else number(result.std_return),
        "interquartile mean": number(result.interquartile_mean) if result.episodes > 1 else "",
        "minimum, maximum": f"{number(result.least_return)}, {number(result.greatest_return)}",
        **common,
    }


_LEFT_TO_EVAL = ("standard deviation", "interquartile mean", "minimum, maximum", "mean length")
"""The lines of statistics that the result of a training leaves to `eval`."""


def _joined(row: Row) -> str:
    """Return lines as the text of one line."""
    return ", ".join(f"{name} {text}" for name, text in row.items() if text)


def _endings(result: Summary) -> str:
    return ", ".join(f"{name} {count}" for name, count in result.endings.items())


def result_sentence(summary: Summary, *, success_defined: bool) -> str:
    """Return how many episodes succeeded, their mean return, and how they ended, in one line."""
    episodes = counted(summary.episodes, "episode")
    if success_defined:
        episodes = f"{round(summary.success_rate * summary.episodes):,} of {episodes} succeeded"
    is_same = summary.episodes > 1 and len(summary.endings) == 1
    endings = f"all ended by {next(iter(summary.endings))}" if is_same else f"ended by {_endings(summary)}"
    return f"{episodes}, mean return {number(summary.mean_return)}, {endings}"


# Trainings


def training_text(result: TrainingResult) -> str:
    """Return how far an interrupted training came, one value per line, and the commands that go on with it."""
    lines = [f"training {result.status}", row_as_lines(_training_rows(result)), *_reasons(result)]
    if result.stop_requested and any(result.run.glob("models/*/best.zip")):  # not before the first checkpoint
        lines.append(f"evaluate the policy with: deepbots eval {shell_word(result.run)}")
    if result.interrupted:
        lines.append(f"all is kept; continue the training with: deepbots resume {shell_word(result.run)}")
    return "\n".join(lines)


def _training_rows(result: TrainingResult) -> dict[str, object]:
    rows: dict[str, object] = {
        "run": result.run,
        "steps": f"{result.steps:,} of {result.total_timesteps:,}, {result.cpu_seconds:.1f} s of CPU time",
    }
    for end in result.stages:
        rows[f"stage {end.name}"] = f"done after {end.steps:,} steps, {end.episodes:,} episodes"
    rows["last stage"] = result.stage
    if result.levels is not None:
        rows["level"] = result.levels
        if by_value := result.levels.by_value:
            rows["mean levels"] = ", ".join(f"{mean:.2f} with {value}" for value, mean in by_value.items())
    if result.mean_return is not None:
        mean = agents_text(result.agents) if result.agents else f"{result.mean_return:z.1f}"
        rows["mean return"] = f"{mean} over the most recent training episodes, with exploration"
    by_callback = result.stopped_by if result.stopped_by == PATIENCE else f"the callback {result.stopped_by}"
    rows["stopped by"] = result.stopped_by and by_callback
    rows["initialized from"] = result.initialized_from
    return rows


def _reasons(result: TrainingResult) -> list[str]:
    """Return why a resumed training is not exactly the one without interruption."""
    return [f"note: {reason}" for reason in result.inexact]


def group_training_text(result: GroupTraining) -> str:
    """Return the trainings of a group, a line for each seed that was trained, and the command that continues
    it."""
    rows = [
        {
            "run": training.run.name,
            "status": training.status,
            "steps": training.steps,
            "episodes": training.episodes,
            "recent_return": training.mean_return,
            "solved_after": training.solved_at.steps if training.solved_at else None,
            "best_at": training.best.steps if training.best else None,
            "cpu_s": round(training.cpu_seconds, 1),
        }
        for training in result.trained
    ]
    lines = [f"group {result.group}", *([table(rows)] if rows else [])]
    if result.skipped:
        lines.append(f"finished before: seed {', '.join(map(str, result.skipped))}")
    lines += [f"seed {seed} failed: {reason}" for seed, reason in result.failed.items()]
    if result.waiting:
        lines.append(f"unfinished: seed {', '.join(map(str, result.waiting))}")
    if result.waiting or result.failed:
        lines.append(f"continue the training with: deepbots resume {shell_word(result.group)}")
    return "\n".join(lines)


# Evaluations


def shown_model(run: str | Path, name: str) -> str:
    """Return the name of a model as it is shown: the best model of agents that compete is the newest one."""
    record = RunRecord.read(Path(run)) if name == "best" else None
    best = None if record is None or record.result is None else record.result.best
    return name if best is None else best.label


def held_out(episodes: int) -> str:
    """Return `1 held-out start`, `100 held-out starts`."""
    return f"{counted(episodes, 'held-out start')}"


def evaluation_text(
    result: EvaluationResult, cases: Sequence[EvaluationResult] = (), *, scenario: str | None = None
) -> str:
    """Return statistics with their intervals, the endings of the episodes, and the cases in a table.

    `scenario` is the scenario, in words, if it is not the one of the training.
    """
    terms = result.term_means if len(result.term_means) > 1 else {}
    after = "" if result.model_steps is None else f", after {result.model_steps:,} steps"
    rows = {
        "model": f"{result.run} ({shown_model(result.run, result.model)}{after})",
        "agent": None if result.against is None else f"{result.agent}, against {result.against}",
        "scenario": scenario,
        "episodes": f"{held_out(result.episodes)} from evaluation seed"
        f" {result.seed}, which no training uses{'' if result.deterministic else ', actions sampled'}",
        **_statistics(result, success_defined=result.success_defined, agents=result.agents),
        **{f"reward {name}": f"{mean:z.2f} per episode" for name, mean in terms.items()},
    }
    if result.case:
        where = f", case {result.case}"
    elif result.stage:
        where = f", stage {result.stage}"
    else:
        where = ""
    text = "\n".join([f"evaluation of {result.scenario}{where}", row_as_lines(rows), *_notes(result.notes)])
    return f"{text}\n\ncases\n{table(case_rows([result, *cases]))}" if cases else text


def evaluation_verdict(result: EvaluationResult) -> str:
    """Return whether the task is solved, and why; without a criterion, the result of the episodes."""
    if result.required_episodes is None and not result.agents:
        return result_sentence(result, success_defined=result.success_defined)
    return result.verdict


def trained_text(
    training: TrainingResult, result: EvaluationResult, cases: Sequence[EvaluationResult]
) -> str:
    """Return the few lines of a training and its evaluation that a person looks at first."""
    rows = {
        **_training_rows(training),
        "agent": None if result.against is None else f"{result.agent}, against {result.against}",
        "episodes": f"{held_out(result.episodes)}, which no training uses",
        "mean return": "",  # of agents that have their own
        **_statistics(result, success_defined=result.success_defined, agents=result.agents),
    }
    shown = {name: text for name, text in rows.items() if name not in _LEFT_TO_EVAL}
    return "\n".join(
        [
            row_as_lines(shown),
            *_reasons(training),
            *([f"cases\n{table(case_rows([result, *cases]))}"] if cases else []),
        ]
    )


def evaluation_json(result: EvaluationResult, cases: Sequence[EvaluationResult] = ()) -> dict[str, Any]:
    """Return an evaluation and its cases as a dictionary."""
    return result.model_dump(mode="json") | {"cases": [case.model_dump(mode="json") for case in cases]}


def summary_text(
    summary: Summary, *, success_defined: bool, agents: Mapping[str, Scores] | None = None
) -> str:
    """Return the statistics of episodes without a trained policy; with `agents`, those of each of them."""
    rows = _statistics(summary, success_defined=success_defined, agents=agents)
    return f"summary of {summary.episodes:,} episodes\n" + row_as_lines(rows)


def _notes(notes: Iterable[str]) -> list[str]:
    return [f"note: {note}" for note in dict.fromkeys(notes)]


def evaluation_rows(column: str, results: Iterable[tuple[str | None, EvaluationResult]]) -> list[Row]:
    """Return a row for each evaluation, whose name is in the column `column`."""
    return [
        {column: name, "episodes": result.episodes, **scores(result), "mean_length": result.mean_length}
        for name, result in results
    ]


def case_rows(results: Sequence[EvaluationResult]) -> list[Row]:
    """Return a row for each evaluation of one policy: in the scenario, in its cases, in the stages of its
    curriculum."""
    itself = "(the scenario itself)" if any(map(case_label, results)) else ""
    return evaluation_rows("case", ((case_label(result) or itself, result) for result in results))


def case_label(result: EvaluationResult) -> str | None:
    """Return the case or stage that an evaluation is in."""
    return f"stage {result.stage}" if result.stage else result.case


def drawn_text(result: EvaluationResult) -> str:
    """Return the drawn values that have an effect, with the episodes by the parts of their ranges; parameters
    of the scenario first."""
    effects = result.by_drawn_value
    if effects.starts < 2:
        return "by drawn value\n  a single episode shows no effect; evaluate more of them with --episodes N"
    if not effects.values:
        return "by drawn value\n  episodes of this scenario draw nothing that varies"
    rows = [
        {
            "name": value.name,
            "range": value.label.range_text(part),
            "episodes": part.episodes,
            **scores(part, success_defined=result.success_defined),
        }
        for value in effects.effective[:MAX_DRAWN]
        for part in value.parts
    ]
    left = len(effects.effective) - MAX_DRAWN
    more = f"\n  and {left} more; --json has all of them" if left > 0 else ""
    return (
        "by drawn value:"
        f" {effects.conclusion}\n{table(rows) if rows else '  --json has the parts of each value'}{more}"
    )


def _group_of_rivals_text(group: GroupResult) -> str:
    """Return a row for each seed with the mean return of each agent, which have no common measure."""
    first = group.evaluations[0]
    rows = [
        {
            "run": result.run.name,
            **{name: agent_scores.mean_return for name, agent_scores in result.agents.items()},
        }
        for result in group.evaluations
    ]
    head = (
        f"evaluation of {first.scenario}, group {group.name}: mean return of each agent, on"
        f" {held_out(first.episodes)} of each run, from evaluation seed {first.seed}"
    )
    return f"{head}\n{table(rows)}"


def group_text(group: GroupResult) -> str:
    """Return a row for each seed, and the statistics over the seeds."""
    first = group.evaluations[0]
    count = len(group.evaluations)
    has_success = group.success_defined
    solved = [solved_by(result) for result in group.evaluations]
    over_starts = means(group, success_defined=has_success, over="_over_starts")
    of_seeds = means(group, success_defined=has_success)
    rows = {
        "mean return": of_seeds["mean return"],
        "interquartile mean": number(group.interquartile_mean),
        "success rate": of_seeds["success rate"],
        "solved": "" if None in solved else f"{sum(map(bool, solved))} of {count} seeds",
    }
    seeds = f"over {counted(count, 'seed')}"
    if group.return_interval is not None or group.success_interval is not None:
        seeds += ": what another training may give; more seeds narrow the intervals"
    if first.agents and not has_success:
        return _group_of_rivals_text(group)
    starts = f"over {counted(group.starts, 'start')}"
    notes = [f"no model yet of seed {', '.join(map(str, group.waiting))}"] if group.waiting else []
    notes += [
        note
        for attribute in ("notes", "remarks")
        for result in group.evaluations
        for note in getattr(result, attribute)
    ]
    return "\n".join(
        [
            f"evaluation of {first.scenario}, group {group.name}: {held_out(first.episodes)} of each run,"
            f" from evaluation seed {first.seed}",
            table(evaluation_rows("run", ((result.run.name, result) for result in group.evaluations))),
            seeds,
            row_as_lines(rows),
            f"{starts}: what these policies give from other starts; more episodes narrow the intervals",
            row_as_lines(over_starts),
            *_notes(notes),
        ]
    )


def solved_by(result: EvaluationResult) -> bool | None:
    """Return whether a run is solved: by its verdict, or by the evaluation if it is not a usual one of
    the run."""
    if result.circumstances:
        return result.solved
    return run_verdict(result.run, RunRecord.read(result.run)).solved


def group_json(group: GroupResult, *, returns: bool = True, solved: bool = True) -> dict[str, Any]:
    """Return a group as a dictionary: its statistics over seeds, and the evaluation of each run. Without
    `returns`, what depends on the reward is None, and without `solved` the steps until it was solved."""
    names = [
        "name",
        "waiting",
        "mean_return",
        "return_interval",
        "return_interval_over_starts",
        "interquartile_mean",
        "solved_after",
    ]
    names += (
        ["success_rate", "success_interval", "success_interval_over_starts"] if group.success_defined else []
    )
    data = {name: getattr(group, name) for name in names}
    data |= {"solved": list(map(solved_by, group.evaluations))}
    data["runs"] = runs = [evaluation.model_dump(mode="json") for evaluation in group.evaluations]
    if not solved:
        data |= dict.fromkeys(("solved", "solved_after"))
    if not returns:
        data |= dict.fromkeys((*(name for name in names if "return" in name), "interquartile_mean", "solved"))
        data["runs"] = [run | dict.fromkeys(RETURN_STATISTICS) for run in runs]
    return data


def robustness_text(robustness: Robustness) -> str:
    """Return a row for each level of each condition, and for each side of a condition the level up to which
    the policy works."""
    nominal = robustness.nominal
    title = (
        f"robustness of {robustness.run} in {robustness.scenario}: {nominal.episodes} held-out episodes of"
        f" each level, from evaluation seed {nominal.seed}{in_parentheses(nominal.circumstances)}"
    )
    if robustness.bar is None:
        rate = with_interval(nominal.success_rate, nominal.success_interval, percent)
        return (
            f"{title}\nnothing to keep: without any change, the success rate is {rate}, so no changed"
            " condition was evaluated;"
            " train the policy further, or require a return with --min-return VALUE"
        )
    is_rate = robustness.metric == "success_rate"
    measure, text = ("success rate", percent) if is_rate else ("mean return", number)
    holds, certain = robustness.nominal_holds, robustness.nominal_certain
    rows = [_level_row("(no change)", "", nominal, holds=holds, certain=certain)]
    rows += [
        _level_row(condition.name, level.level, level.evaluation, holds=level.holds, certain=level.certain)
        for condition in robustness.conditions
        for level in condition.levels
    ]
    verdicts = {
        name: verdict for condition in robustness.conditions for name, verdict in condition.verdicts.items()
    }
    return "\n".join(
        [
            title,
            f"required: {measure} of at least {text(robustness.bar)} ({robustness.bar_source})",
            row_as_lines(verdicts),
            "",
            table(rows),
            *_notes(_robustness_notes(robustness, robustness.bar, is_rate=is_rate)),
        ]
    )


def _robustness_notes(robustness: Robustness, bar: float, *, is_rate: bool) -> Iterator[str]:
    """Yield notes on conditions without effect, too few episodes, and a score that is missed without any
    change."""
    nominal = robustness.nominal
    names = [
        condition.name
        for condition in robustness.conditions
        if condition.levels
        and all(_episodes(level.evaluation) == _episodes(nominal) for level in condition.levels)
    ]
    if names:
        yield f"no effect on any episode (the lengths and returns are unchanged): {', '.join(names)}"
    if is_rate and bar < 1.0:
        needed = episodes_above(bar)
        if nominal.episodes < needed:
            yield (
                f"{nominal.episodes} episodes are too few to be sure of {percent(bar)}, even if all of them"
                f" succeed; write --episodes {needed} or more"
            )
    if not robustness.nominal_holds:
        option = "--min-success" if is_rate else "--min-return"
        yield f"the policy misses the required score even without any change; set another one with {option}"


def _level_row(condition: str, level: str, result: EvaluationResult, *, holds: bool, certain: bool) -> Row:
    required = ("met" if holds else "missed") + ("" if certain else ", not significant")
    return {"condition": condition, "level": level, **scores(result), "required": required}


def _episodes(result: EvaluationResult) -> list[tuple[float, int]]:
    return [(episode.total_return, episode.length) for episode in result.outcomes]


# Recordings


def recorded_rows(ends: Iterable[tuple[int, WorldFrame]], *, have_rivals: bool = False) -> list[Row]:
    """Return a row for each episode of a recording, by its number and its last frame. Of agents that compete,
    the return is None: their returns have no useful sum."""
    rows = [
        (number, frame, None if have_rivals else next(iter(frame.agents.values())).episode_return)
        for number, frame in ends
    ]
    return [
        {
            "episode": number,
            "steps": frame.step,
            "time_s": frame.time,
            "ending": frame.ending,
            "ended_by": frame.ended_by,
            "return": total,
        }
        for number, frame, total in rows
    ]


def recorded_table(rows: Sequence[Row]) -> str:
    hidden = {"ended_by", *(name for row in rows for name, value in row.items() if value is None)}
    return table([{name: value for name, value in row.items() if name not in hidden} for row in rows])


# Failed episodes


def last_evaluation(ref: ModelRef) -> tuple[Path, EvaluationResult]:
    """Return the last evaluation of a run, or of a named model of it, in its own scenario and engine, with
    its episodes.

    Raises:
        UsageError: There is none.
    """
    evaluation = last_episodes(ref)
    if evaluation is None:
        path = ref.path if ref.is_named else ref.run.path
        suffix = f" of {ref.name}" if ref.is_named else ""
        raise UsageError(
            f"{ref.run.path} keeps no evaluation{suffix} in its own scenario and engine; make one with:"
            f" deepbots eval {shell_word(path)}"
        )
    return evaluation


def failed_episodes(ref: ModelRef, agent: str | None = None) -> tuple[list[int], EvaluationResult]:
    """Return the numbers of the failed episodes of the last evaluation, of one of several agents with
    `agent`, and the evaluation.

    Raises:
        RunError: The run has no such agent.
        UsageError: There is no evaluation, or none of its episodes failed.
    """
    _, record = last_evaluation(ref)
    program = ref.run.program
    if agent is not None:
        member = ref.run.member(agent)
        outcomes = [own_episode(member, outcome) for outcome in record.outcomes]
        record = record.model_copy(update={"outcomes": outcomes})
        program = member.program
    failed = record.failed(program)
    if not failed:
        raise UsageError(
            f"none of the {len(record.outcomes):,} episodes of the last evaluation of {ref.run.path} failed"
        )
    return failed, record


# Files


def write_evaluation(run: Run, evaluation: dict[str, Any]) -> None:
    """Keep an evaluation in its run. If this fails, print the reason; the evaluation is shown in either
    case."""
    try:
        run.write_evaluation(evaluation)
    except RunError as error:
        terminal.note(f"note: the run does not keep this evaluation: {error}")


def write_csv(path: Path, results: Iterable[EvaluationResult]) -> None:
    """Write a line for each episode: policy, circumstances, seed of the reset, outcome, reward terms as
    `reward.TERM`, drawn values as `drawn.PLACE`."""
    rows: list[dict[str, object]] = []
    for result in results:
        for index, episode in enumerate(result.outcomes):
            row: dict[str, object] = {"run": result.run, "model": result.model, **evaluated_in(result)}
            row |= {
                "episode": index,
                "seed": episode.seed,
                "return": episode.total_return,
                "length": episode.length,
            }
            row |= {
                "success": int(episode.is_success) if result.success_defined else "",
                "ended_by": episode.ended_by or "",
            }
            row |= {f"reward.{name}": value for name, value in episode.terms.items()}
            rows.append(row | {f"drawn.{name}": value for name, value in episode.drawn.items()})
    write_tables(rows, path, None)


def evaluated_in(result: EvaluationResult) -> dict[str, str]:
    """Return the world and the actions of an evaluation, as texts; a `scenario` of another file than that of
    the run has its name."""
    return {
        "engine": result.engine or "",
        "scenario": result.elsewhere or result.scenario,
        "set": " ".join(result.set),
        "case": result.case or "",
        "stage": result.stage or "",
        "deterministic": str(int(result.deterministic)),
        "remarks": "; ".join(result.remarks),
    }
