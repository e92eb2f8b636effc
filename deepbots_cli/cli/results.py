"""Results of trainings and evaluations as text, as JSON, as CSV, and as JUnit XML."""

from __future__ import annotations

import csv
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from shlex import quote
from typing import TYPE_CHECKING, Any, NamedTuple
from xml.etree import ElementTree

from deepbots_cli.cli import terminal
from deepbots_cli.cli.tables import Row, row_as_lines, table
from deepbots_cli.errors import RunError
from deepbots_cli.files import atomic_write
from deepbots_cli.learning.episodes import DrawnBin, Interval, Summary
from deepbots_cli.learning.report import to_json
from deepbots_cli.learning.run import POLICY_NAME, EvaluationRecord, Run, TrainingResult, in_parentheses

if TYPE_CHECKING:
    from deepbots_cli.learning.comparison import GroupResult
    from deepbots_cli.learning.evaluation import EvaluationResult
    from deepbots_cli.learning.group import GroupTraining
    from deepbots_cli.learning.robustness import Robustness

MAX_DRAWN = 8
"""Drawn values that `--details` shows, those with the largest effect; `--json` has all of them."""


def training_text(result: TrainingResult) -> str:
    """What a training came to, one value per line, and how to go on."""
    rows: dict[str, object] = {
        "run": result.run,
        "steps": f"{result.steps:,} of {result.total_timesteps:,}",
        "episodes": result.episodes,
        "simulated time": f"{result.simulated_hours:.3f} h",
        "CPU time": f"{result.cpu_seconds:.1f} s",
    }
    for end in result.stages:
        rows[f"stage {end.name}"] = f"done after {end.steps:,} steps, {end.episodes:,} episodes"
    rows["last stage"] = result.stage
    if result.mean_return is not None:
        rows["mean return"] = f"{result.mean_return:.1f} over the most recent training episodes, with exploration"
    if result.success_rate is not None:
        rows["success rate"] = f"{result.success_rate:.0%}"
    at = result.solved_at
    if at is not None:
        took = f"{at.simulated_hours:.3f} simulated h, {at.cpu_seconds:.1f} s of CPU time"
        rows["solved"] = f"in training episode {at.episode:,}, after {took}"
    rows["stopped by"] = result.stopped_by and f"the callback {result.stopped_by}"
    rows["initialized from"] = result.initialized_from
    lines = [f"training {result.status}", row_as_lines(rows), *(f"note: {reason}" for reason in result.inexact)]
    if result.stop_requested and (result.run / "models" / POLICY_NAME / "best.zip").is_file():  # not before the first checkpoint
        lines.append(f"evaluate the policy with: deepbots eval {quote(str(result.run))}")
    if result.interrupted:
        lines.append(f"the policy is kept; continue the training with: deepbots train --resume {quote(str(result.run))}")
    return "\n".join(lines)


def group_training_text(result: GroupTraining) -> str:
    """The trainings of a group, a line for each seed that was trained, and how to go on."""
    rows = [
        {
            "run": found.run.name,
            "status": found.status,
            "steps": found.steps,
            "episodes": found.episodes,
            "recent_return": found.mean_return,
            "solved_in_episode": found.solved_at.episode if found.solved_at else None,
            "cpu_s": round(found.cpu_seconds, 1),
        }
        for found in result.trained
    ]
    lines = [f"group {result.group}", *([table(rows)] if rows else [])]
    if result.skipped:
        lines.append(f"finished before: seed {', '.join(map(str, result.skipped))}")
    lines += [f"seed {seed} failed: {reason}" for seed, reason in result.failed.items()]
    if result.waiting:
        lines.append(f"unfinished: seed {', '.join(map(str, result.waiting))}")
    if result.waiting or result.failed:
        lines.append(f"continue the training with: deepbots train --resume {quote(str(result.group))}")
    return "\n".join(lines)


def group_training_json(result: GroupTraining) -> dict[str, Any]:
    """The same as a dictionary."""
    known = {"skipped": result.skipped, "failed": result.failed, "waiting": result.waiting}
    return {"group": str(result.group), "trained": [to_json(found) for found in result.trained], **known}


def evaluation_text(result: EvaluationResult, scenario: str | None = None) -> str:
    """Statistics with their intervals, how the episodes ended, and the verdict as last line.

    `scenario` is the scenario, in words, where it is not the one of the training.
    """
    terms = result.term_means if len(result.term_means) > 1 else {}
    rows = {
        "model": f"{result.run} ({result.model})",
        "scenario": scenario,
        "episodes": f"{result.episodes:,} held-out starts from seed {result.seed}{'' if result.deterministic else ', actions sampled'}",
        **_statistics(result, success_defined=result.success_defined),
        **{f"reward {name}": f"{mean:.2f} per episode" for name, mean in terms.items()},
        "video": result.video,
    }
    where = f", case {result.case}" if result.case else f", stage {result.stage}" if result.stage else ""
    notes = (f"note: {note}" for note in result.notes)
    return "\n".join([f"evaluation of {result.scenario}{where}", row_as_lines(rows), *notes, result.verdict])


def summary_text(summary: Summary, *, success_defined: bool) -> str:
    """The same values for episodes without a trained policy."""
    return f"summary of {summary.episodes:,} episodes\n" + row_as_lines(_statistics(summary, success_defined=success_defined))


def _statistics(result: Summary, *, success_defined: bool) -> dict[str, object]:
    spread = ""
    if result.std_return == 0 and result.return_interval is not None:  # whose interval follows from the bounds of the return alone
        low, high = map(number, result.return_interval)
        spread = f" in all {result.episodes:,} episodes (95 % confidence interval, from the possible returns: {low} .. {high})"
    elif result.std_return is not None and result.return_interval is not None:
        low, high = map(number, result.return_interval)
        spread = f"; standard deviation {number(result.std_return)} (95 % confidence interval of the mean: {low} .. {high})"
    low_rate, high_rate = result.success_interval
    rate = f"{result.success_rate:.1%} (95 %: {low_rate:.1%} .. {high_rate:.1%})"
    return {
        "mean return": number(result.mean_return) + spread,
        "interquartile mean": number(result.interquartile_mean) if result.episodes > 1 else "",
        "minimum, maximum": f"{number(result.least_return)}, {number(result.greatest_return)}",
        "mean length": f"{result.mean_length:.1f} steps",
        "ended by": ", ".join(f"{name} {count}" for name, count in result.endings.items()),
        "success rate": rate if success_defined else "",
    }


def number(value: float) -> str:
    """Two decimals; four where returns are small."""
    return f"{value:.4f}" if 0 < abs(value) < 1 else f"{value:.2f}"


def interval_text(interval: Interval | None, *, percent: bool = False) -> str:
    """An interval as the text of a cell."""
    if interval is None:
        return ""
    return " .. ".join(dict.fromkeys(f"{end:.1%}" if percent else f"{end:.4g}" for end in interval))


def return_interval_text(result: EvaluationResult | EvaluationRecord) -> str:
    """The interval of the mean return as the text of a cell; that of equal returns follows from the possible returns alone."""
    return "all equal" if result.std_return == 0 else interval_text(result.return_interval)


def rows_of(what: str, results: Sequence[EvaluationResult], names: Sequence[str]) -> list[Row]:
    """A row for each evaluation, under its name in the column `what`; ranges are intervals of 95 %. An undefined success is left empty."""
    undefined = dict.fromkeys(_success(results[0]), "") if any(result.success_defined for result in results) else {}
    return [
        {
            what: name,
            "episodes": result.episodes,
            "mean_return": result.mean_return,
            "return_95 %": return_interval_text(result),
            **(_success(result) if result.success_defined else undefined),
            "mean_length": result.mean_length,
        }
        for name, result in zip(names, results, strict=True)
    ]


def _success(result: Summary | DrawnBin) -> dict[str, object]:
    return {"success": f"{result.success_rate:.1%}", "success_95 %": interval_text(result.success_interval, percent=True)}


def case_rows(results: Sequence[EvaluationResult]) -> list[Row]:
    """A row for each evaluation of one policy: in the scenario, in its cases, in the stages of its curriculum."""
    names = [result.case or (f"stage {result.stage}" if result.stage else "(the scenario itself)") for result in results]
    return rows_of("case", results, names)


def drawn_text(result: EvaluationResult) -> str:
    """Success, or the return where there is none, by the values that episodes draw; those with the largest effect first."""
    found = result.by_drawn_value
    if not found:
        return "by drawn value\n  episodes of this scenario draw nothing that varies"

    def effect(bins: Sequence[DrawnBin]) -> float:
        scores = [part.success_rate if result.success_defined else part.mean_return for part in bins]
        return max(scores) - min(scores)

    names = sorted(found, key=lambda name: -effect(found[name]))
    rows: list[Row] = []
    for name in names[:MAX_DRAWN]:
        for part in found[name]:
            span = (
                str(part.low)
                if isinstance(part.low, str)
                else f"{part.low:.4g}" + (f" .. {part.high:.4g}" if part.high != part.low else "")
            )
            scores = {"mean_return": part.mean_return, "return_95 %": interval_text(part.return_interval)}
            rows.append(
                {"name": name, "range": span, "episodes": part.episodes, **(_success(part) if result.success_defined else {}), **scores}
            )
    left = len(names) - MAX_DRAWN
    more = f"\n  and {left} more; --json has all of them" if left > 0 else ""
    return f"by drawn value, in SI units\n{table(rows)}{more}"


def group_text(group: GroupResult) -> str:
    """A row for each seed, and the statistics over the seeds."""
    first, count = group.evaluations[0], len(group.evaluations)
    rows: dict[str, object] = {
        "mean return": f"{number(group.mean_return)}{_over(interval_text(group.return_interval), count)}",
        "interquartile mean": number(group.interquartile_mean),
    }
    if group.success_defined:
        rows["success rate"] = f"{group.success_rate:.1%}{_over(interval_text(group.success_interval, percent=True), count)}"
    solved = [result.solved for result in group.evaluations]
    if None not in solved:
        rows["solved"] = f"{sum(map(bool, solved))} of {count} seeds"
    notes = [f"note: no model yet of seed {', '.join(map(str, group.waiting))}"] if group.waiting else []
    notes += dict.fromkeys(f"note: {note}" for result in group.evaluations for note in result.notes)
    return "\n".join(
        [
            f"evaluation of {first.scenario}, group {group.name}: {first.episodes:,} held-out starts of each run, from seed {first.seed}",
            table(rows_of("run", group.evaluations, [result.run.name for result in group.evaluations])),
            f"over {count} seed{'' if count == 1 else 's'}",
            row_as_lines(rows),
            *notes,
            *(f"note: {words}" for words in dict.fromkeys(words for each in group.evaluations for words in each.remarks)),
        ]
    )


def _over(interval: str, count: int) -> str:
    return f" (95 % over {count} seeds: {interval})" if interval else ""


def group_json(group: GroupResult) -> dict[str, Any]:
    """A group as a dictionary: its statistics over seeds, and the evaluation of each run."""
    names = ("name", "waiting", "mean_return", "return_interval", "interquartile_mean", "solved_after")
    success = ("success_rate", "success_interval") if group.success_defined else ()
    return {**{name: getattr(group, name) for name in (*names, *success)}, "runs": [to_json(result) for result in group.evaluations]}


def robustness_text(found: Robustness) -> str:
    """A row for each level of each condition, and for each condition where the result falls below the bar."""
    is_rate = found.metric == "success_rate"
    bar = f"{found.bar:.1%}" if is_rate else number(found.bar)
    unchanged = {"condition": "(no change)", "level": "", **_level(found.nominal, is_rate=is_rate)}
    rows: list[Row] = [unchanged | {"bar": _against_bar(holds=found.nominal_holds, certain=found.nominal_certain)}]
    for condition in found.conditions:
        for entry in condition.levels:
            row = {"condition": condition.name, "level": entry.level, **_level(entry.evaluation, is_rate=is_rate)}
            rows.append(row | {"bar": _against_bar(holds=entry.holds, certain=entry.certain)})
    without = _episodes(found.nominal)
    same = [
        condition.name
        for condition in found.conditions
        if condition.levels and all(_episodes(entry.evaluation) == without for entry in condition.levels)
    ]
    option = "--min-success" if is_rate else "--min-return"
    limits = {condition.name: condition.threshold for condition in found.conditions}
    return "\n".join(
        [
            f"robustness of {found.run} in {found.scenario}: {found.nominal.episodes} held-out episodes of each level,"
            f" from seed {found.nominal.seed}{in_parentheses(found.nominal.circumstances)}",
            f"bar: {'success rate' if is_rate else 'mean return'} of {bar} ({found.bar_source})",
            table(rows),
            "",
            row_as_lines(limits),
            *([f"note: no effect on any episode (the lengths and returns are unchanged): {', '.join(same)}"] if same else []),
            *([] if found.nominal_holds else [f"note: the policy is below the bar without any change; set another bar with {option}"]),
        ]
    )


def _against_bar(*, holds: bool, certain: bool) -> str:
    return ("holds" if holds else "below") + ("" if certain else ", uncertain")


def _episodes(result: EvaluationResult) -> list[tuple[float, int]]:
    return [(episode.total_return, episode.length) for episode in result.outcomes]


def _level(result: EvaluationResult, *, is_rate: bool) -> dict[str, object]:
    returns = {"mean_return": result.mean_return, "return_95 %": return_interval_text(result)}
    return _success(result) | {"mean_return": result.mean_return} if is_rate else returns


def robustness_json(found: Robustness) -> dict[str, Any]:
    """The same as a dictionary, with every evaluation."""
    conditions = [
        {
            "name": condition.name,
            "skipped": condition.skipped,
            "threshold": condition.threshold,
            "levels": [
                {"level": entry.level, "holds": entry.holds, "certain": entry.certain, "evaluation": to_json(entry.evaluation)}
                for entry in condition.levels
            ],
        }
        for condition in found.conditions
    ]
    known = {name: getattr(found, name) for name in ("scenario", "metric", "bar", "bar_source", "nominal_holds", "nominal_certain")}
    return {"run": str(found.run), **known, "nominal": to_json(found.nominal), "conditions": conditions}


# Files


def write_evaluation(run: Run, evaluation: dict[str, Any]) -> None:
    """Keep an evaluation in its run, or say why it is not kept; it is shown all the same."""
    try:
        run.write_evaluation(evaluation)
    except RunError as error:
        terminal.note(f"note: the run does not keep this evaluation: {error}")


def write_csv(path: Path, results: Iterable[EvaluationResult]) -> None:
    """A line for each episode: policy, what it was evaluated in, seed of the reset, outcome, reward terms as `reward.TERM`, drawn values as
    `drawn.PLACE`."""
    rows: list[dict[str, object]] = []
    for result in results:
        for index, episode in enumerate(result.outcomes):
            row: dict[str, object] = {"run": result.run, "model": result.model, **evaluated_in(result)}
            row |= {"episode": index, "seed": episode.seed, "return": episode.total_return, "length": episode.length}
            row |= {"success": int(episode.is_success) if result.success_defined else "", "ended_by": episode.ended_by or ""}
            row |= {f"reward.{name}": value for name, value in episode.terms.items()}
            rows.append(row | {f"drawn.{name}": value for name, value in episode.drawn.items()})
    columns = {name: None for row in rows for name in row}
    with atomic_write(path) as draft, draft.open("w", newline="", encoding="utf-8") as stream:
        writer = csv.DictWriter(stream, [*columns])
        writer.writeheader()
        writer.writerows(rows)


def evaluated_in(result: EvaluationResult) -> dict[str, str]:
    """The world and the actions of an evaluation, as texts; a `scenario` of another file than that of the run has its name."""
    return {
        "engine": result.engine or "",
        "scenario": result.elsewhere or result.scenario,
        "set": " ".join(result.set),
        "case": result.case or "",
        "stage": result.stage or "",
        "deterministic": str(int(result.deterministic)),
        "remarks": "; ".join(result.remarks),
    }


class JUnitCase(NamedTuple):
    """A requirement or a test: its text, whether it is met, the reason, and the wall time."""

    name: str
    met: bool
    reason: str
    seconds: float | None = None


def write_junit(path: Path, command: str, suites: Mapping[str, Sequence[JUnitCase]], properties: Mapping[str, str] | None = None) -> None:
    """The cases of each suite, as a document of JUnit; a single suite is its root. `properties` are those of each suite, by name."""
    found = []
    for suite, cases in suites.items():
        failures = sum(not case.met for case in cases)
        root = ElementTree.Element("testsuite", name=f"deepbots {command} {suite}", tests=str(len(cases)), failures=str(failures))
        if properties:
            listed = ElementTree.SubElement(root, "properties")
            for name, value in properties.items():
                ElementTree.SubElement(listed, "property", name=name, value=value)
        for case in cases:
            element = ElementTree.SubElement(root, "testcase", classname=suite, name=case.name)
            if case.seconds is not None:
                element.set("time", f"{case.seconds:.3f}")
            if case.met:
                ElementTree.SubElement(element, "system-out").text = case.reason
            else:
                ElementTree.SubElement(element, "failure", message=f"not met: {case.name} ({case.reason})")
        found.append(root)
    if len(found) > 1:
        root = ElementTree.Element("testsuites")
        root.extend(found)
    ElementTree.indent(root)
    with atomic_write(path) as draft:
        draft.write_bytes(ElementTree.tostring(root, encoding="utf-8", xml_declaration=True) + b"\n")
