"""The verdict about a run: the evaluation that is quoted everywhere, whether the run solves its task, whether
its training got worse, and what it changed against an earlier run.

`run_verdict` is the one definition of "solved" of `train`, `runs`, `report`, `diagnose` and the card of an
exported policy. Nothing but `changed_values` compiles a scenario, and torch is not imported.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, replace
from datetime import UTC, datetime
from itertools import accumulate, islice
from pathlib import Path
from statistics import NormalDist, fmean
from typing import Any, NamedTuple

from deepbots_cli.analysis.changes import Change, Effect, WrittenScenario, scenario_changes
from deepbots_cli.api import Compiled
from deepbots_cli.errors import RunError
from deepbots_cli.learning.runs.directories import numbered_files
from deepbots_cli.learning.runs.episodes import read_evaluations
from deepbots_cli.learning.runs.evaluations import EvaluationResult
from deepbots_cli.learning.runs.order import Measure
from deepbots_cli.learning.runs.run import ModelRef, QuotedEvaluation, Run, RunRecord, has_model
from deepbots_cli.learning.runs.statistics import UNBOUNDED, Confirmation, Interval, gate_rate
from deepbots_cli.program.task import Solved
from deepbots_cli.records import dataclass
from deepbots_cli.rollout import Episode
from deepbots_cli.rollout.source import SourceKind, folder_kind
from deepbots_cli.words import beside, number_text, rate_text


class SolvedVerdict(NamedTuple):
    """The verdict of episodes on whether a task is solved.

    Attributes:
        solved: True: the episodes show it. False: they do not meet the criterion, or would be refused as a
            confirmation. None: the scenario has no criterion, or more episodes are needed.
        text: The answer and its reason.
        required_episodes: The number of episodes from which on there is an answer; None without a criterion.
    """

    solved: bool | None
    text: str
    required_episodes: int | None


def solved_verdict(
    solved: Solved | None,
    outcomes: Sequence[Episode],
    returns: Interval = UNBOUNDED,
    number: int | None = None,
) -> SolvedVerdict:
    """Return whether these episodes show that the task is solved, and why.

    Args:
        solved: The criterion of the scenario.
        outcomes: The episodes.
        returns: The lowest and the highest possible return.
        number: The number of the confirmation that the episodes are; None for a policy that is confirmed,
            whose episodes need only meet the criterion.
    """
    episodes = len(outcomes)
    mean_return = fmean(episode.total_return for episode in outcomes)
    success_rate = fmean(episode.is_success for episode in outcomes)
    if solved is None:
        return SolvedVerdict(None, "the scenario has no `solved` criterion", None)
    if episodes < solved.episodes and solved.success_rate is not None:
        certain = gate_rate(solved.success_rate, round(success_rate * episodes), episodes, solved.episodes)
        if certain.met is False:
            required = f"a success rate of {100 * solved.success_rate:g}% is required"
            return SolvedVerdict(False, f"not solved: {required}, and {certain.reason}", solved.episodes)
    if episodes < solved.episodes:
        evaluated = f"{episodes} {'was' if episodes == 1 else 'were'} evaluated"
        needed = f"the criterion needs {solved.episodes} episodes and only {evaluated}"
        text = f"solved: unknown, because {needed}; evaluate with `--episodes {solved.episodes}`"
        return SolvedVerdict(None, text, solved.episodes)
    reasons = []
    if solved.mean_return is not None:
        reasons.append("mean return {} where {} is required".format(*beside(mean_return, solved.mean_return)))
    if solved.success_rate is not None:
        measured, bar = beside(100 * success_rate, 100 * solved.success_rate)
        reasons.append(f"success rate {measured}% where {bar}% is required")
    if not solved.is_met(mean_return, success_rate):
        return SolvedVerdict(False, f"not solved: {', '.join(reasons)}", solved.episodes)
    if number is None:
        return SolvedVerdict(True, f"solved: {', '.join(reasons)}", solved.episodes)

    lowest = min(episode.total_return for episode in outcomes)
    highest = max(episode.total_return for episode in outcomes)
    bounds = (
        returns[0] if math.isfinite(returns[0]) else lowest,
        returns[1] if math.isfinite(returns[1]) else highest,
    )
    confirmation = Confirmation.with_episodes(solved, number, bounds, episodes)
    if confirmation.passes(outcomes):
        return SolvedVerdict(True, f"solved: {', '.join(reasons)}", solved.episodes)
    plan = Confirmation.plan(solved, number, bounds, outcomes)
    if plan is not None and plan.episodes > episodes:
        few = f"{episodes:,} episodes are too few to be sure of it ({', '.join(reasons)})"
        text = f"solved: unknown, because {few}; evaluate with `--episodes {plan.episodes}`"
        return SolvedVerdict(None, text, plan.episodes)
    text = f"not solved: {', '.join(reasons)}, and to confirm it, {confirmation.requirement} must be reached"
    return SolvedVerdict(False, text, solved.episodes)


def logged_episodes_meet(solved: Solved | None, returns: Sequence[float], successes: Sequence[float]) -> bool:
    """Return whether episodes in the log of a training meet the criterion; False without one, or without
    episodes. They are the answer of a run that has no evaluation yet."""
    return solved is not None and len(returns) > 0 and solved.is_met(fmean(returns), fmean(successes))


LEARNED_RATE = 0.8
"""The success rate with which a task without `solved` is learned."""


@dataclass(frozen=True)
class RunVerdict:
    """The verdict on whether a run solves its task, by the evaluation that is quoted everywhere.

    `solved` is None where there is no such evaluation, where it has too few episodes, or where the scenario
    has no `solved`. A training that stopped because its task is solved has an evaluation: the confirmation.
    """

    solved: bool | None
    evaluation: EvaluationResult | None
    confirmed_after: int | None = None
    """The steps after which a confirmation showed that the task is solved."""

    def of_agent(self, agent: str) -> RunVerdict:
        """Return the verdict about one of several agents of the run; of a run of this agent alone, itself."""
        evaluation = self.evaluation
        if evaluation is None or not evaluation.agents:
            return self
        return RunVerdict(None, evaluation.of_agent(agent))

    @property
    def solved_after(self) -> int | None:
        """The steps of `confirmed_after` of a run that is solved. A later evaluation with more episodes may
        contradict the confirmation."""
        return self.confirmed_after if self.solved else None

    def is_unsolved(self, *, defines_success: bool) -> bool:
        """Return whether the task has a criterion that the run does not meet; without one, whether it defines
        success, and the run succeeds less often than `LEARNED_RATE`."""
        if self.solved is not None or not defines_success:
            return self.solved is False
        return self.evaluation is None or self.evaluation.success_rate < LEARNED_RATE

    @property
    def text(self) -> str:
        """Mean return and success rate with their intervals, the circumstances, and the verdict."""
        if self.evaluation is None:
            return "not evaluated since the end of the training"
        answer = {True: "; solved", False: "; not solved", None: ""}[self.solved]
        return f"{self.evaluation.text}{answer}"


def run_verdict(path: Path, record: RunRecord) -> RunVerdict:
    """Return the verdict about a run from its record. While the run trains, its evaluations are those of
    older models and are ignored."""
    quoted = None if record.state(path) == "training" else quoted_evaluation(path, record)
    if quoted is None:
        return RunVerdict(None, None)
    solved_at = record.result.solved_at if record.result is not None else None
    steps = solved_at.steps if solved_at is not None else None
    return RunVerdict(quoted.evaluation.solved, quoted.evaluation, steps)


def quoted_evaluation(path: Path, record: RunRecord) -> QuotedEvaluation | None:
    """Return the evaluation of the best model that is quoted everywhere: the one in the record.

    Where its file was removed, another one is chosen from the files since the training ended, as
    `RunRecord.with_evaluation` chooses it.
    """
    quoted = record.quoted
    if quoted is None or evaluation_file(path, quoted.number).is_file():
        return quoted
    record = record.model_copy(update={"quoted": None})
    for number, file in numbered_files(path / "evaluations"):
        with suppress(RunError):
            evaluation = EvaluationResult.read(file)
            record = record.with_evaluation(number, evaluation) if record.follows(evaluation) else record
    return record.quoted


def quoted_episodes(run: Run) -> EvaluationResult | None:
    """Return `quoted_evaluation` with its episodes.

    Raises:
        RunError: It is damaged.
    """
    quoted = quoted_evaluation(run.path, run.record)
    if quoted is None:
        return None
    evaluation = EvaluationResult.read(evaluation_file(run.path, quoted.number))
    return evaluation.model_copy(update={"solved": quoted.evaluation.solved})


def last_episodes(ref: ModelRef) -> tuple[Path, EvaluationResult] | None:
    """Return the last evaluation in the scenario and engine of the training, since the training ended,
    including evaluations with sampled actions, and its file.

    It is one of the named model, or of any model that the run still has if a run was named.

    Raises:
        RunError: It, or a later one, is damaged.
    """
    path, record = ref.run.path, ref.run.record
    for _, file in reversed(numbered_files(path / "evaluations")):
        evaluation = EvaluationResult.read(file)
        is_named = evaluation.model == ref.name if ref.is_named else has_model(path, evaluation.model)
        if record.follows(evaluation) and record.is_own(evaluation) and is_named:
            return file, evaluation
    return None


def evaluation_file(path: Path, number: int) -> Path:
    """Return the file of an evaluation of a run."""
    return path / "evaluations" / f"{number:04d}.json"


FALSE_ALARMS = 0.01
"""The largest probability of a reported decline in a training whose policy stays the same."""
MIN_EFFECT = 0.1
MIN_SHARE = 0.05
MIN_EFFECT_OF_FEW = 0.25
MIN_SHARE_OF_FEW = 0.2
LAST_SHARE = 0.25
"""The share of the present stage whose evaluations are compared with earlier ones."""
_WINDOWS = (1, 3)


@dataclass(frozen=True)
class Decline:
    """A decline of a training: its size, and its start.

    Attributes:
        measure: The measure of the task, whose values are compared.
        best_value: The value of the best window, a mean over its episodes.
        best_steps: Steps of the training at the best evaluation in this window.
        last_value: The value of the last evaluations.
        last: The last evaluations, in words.
        last_steps: Steps at the first of them.
        since_steps: Steps at the first of the worse evaluations: the split into two means with the smallest
            squared error.
        best_episodes: Episodes of `best_value`; `last_episodes` are those of `last_value`.
    """

    measure: Measure
    best_value: float
    best_steps: int
    last_value: float
    since_steps: int
    best_episodes: int
    last_episodes: int
    last: str
    last_steps: int

    def as_json(self) -> dict[str, Any]:
        """Return the attributes, and the sentence."""
        return {**asdict(self), "text": self.text}

    @property
    def text(self) -> str:
        """A sentence without a full stop: the measure that fell, its values before and after, and when."""
        is_rate = self.measure == "success_rate"
        name, form = ("success rate", rate_text) if is_rate else ("mean return", number_text)
        best, last = form(self.best_value), form(self.last_value)
        return (
            f"the training got worse: the {name} of its evaluations fell from {best} at {self.best_steps:,}"
            f" steps to {last} in {self.last} ({self.last_episodes:,} episodes), since about"
            f" {self.since_steps:,} steps"
        )


def decline_of(run: Path, record: RunRecord) -> Decline | None:
    """Return the decline of a training from the files of its run, even while it trains; None if it has none.

    Raises:
        RunError: Its evaluations cannot be read.
    """
    best = record.result.best if record.result is not None else None
    if best is None or best.chosen_by == "newest":  # of rivals: the other one may have learned more
        return None
    return find_decline(read_evaluations(run), best.measure)


def find_decline(evaluations: Sequence[Mapping[str, Any]], measure: Measure) -> Decline | None:
    """Return the decline of a training in its present stage; None if its evaluations are not worse than
    chance explains.

    The evaluations of a training have 20 fixed starts each, and the last one is at its end. Those of the last
    quarter of the present stage, and the last two alone, are compared with every earlier window of one or
    three evaluations in a row. A window shows a decline if three things hold:

    - It is better than the last evaluations by more than chance: with Student's paired test over the starts,
      because some of them are harder than others in every evaluation. The best of many windows looks better
      than it is, so the level of each test is `FALSE_ALARMS` divided by the number of comparisons
      (Bonferroni's inequality).
    - The difference is at least `MIN_EFFECT`: points of the success rate, or a share of the range of returns
      since then. It is also at least `MIN_SHARE` of the range of all returns, so that small differences
      between perfect returns do not count. One or two evaluations must differ by `MIN_EFFECT_OF_FEW` and
      `MIN_SHARE_OF_FEW`: the policy changes from update to update.
    - The very last evaluation is lower by this difference too, so that the training has not recovered.

    `tests/learning/test_confirmation.py` measures how often healthy trainings raise a false alarm. Nothing is
    compiled, and neither numpy nor torch is imported.

    Args:
        evaluations: The evaluations of `read_evaluations`, in order. Entries without `steps` are not of the
            training.
        measure: The measure of the task.
    """
    rows = [row for row in evaluations if "steps" in row]
    earlier = [number for number, row in enumerate(rows) if row["stage"] != rows[-1]["stage"]]
    stage_start = 0.0
    if earlier:
        stage_start = rows[earlier[-1]]["steps"]
        rows = rows[earlier[-1] + 1 :]
    if len(rows) < 2:
        return None
    quarter_start = rows[-1]["steps"] - LAST_SHARE * (rows[-1]["steps"] - stage_start)
    first_late = min(len(rows) - 1, sum(row["steps"] <= quarter_start for row in rows))
    splits = {first_late: "the last quarter"}
    if first_late < len(rows) - 2:
        splits[len(rows) - 2] = "the last two evaluations"
    for split, last in splits.items():
        if (fall := _fall(rows, split, last, measure, level=FALSE_ALARMS / len(splits))) is not None:
            return fall
    return None


def _fall(
    rows: Sequence[Mapping[str, Any]], split: int, last: str, measure: Measure, *, level: float
) -> Decline | None:
    """Return the decline of the evaluations from `split` on against earlier ones, if a test at this level
    shows it."""
    is_rate = measure == "success_rate"
    scores = [list(map(float, row["successes" if is_rate else "returns"])) for row in rows]
    late = _joined(scores[split:])
    late_mean = fmean(late)
    last_mean = max(late_mean, fmean(scores[-1]))
    late_scores = _mean_scores(scores[split:])
    ranges = _ranges(scores)
    is_few = len(rows) - split <= 2
    least, share = (MIN_EFFECT_OF_FEW, MIN_SHARE_OF_FEW) if is_few else (MIN_EFFECT, MIN_SHARE)
    windows = [range(start, start + size) for size in _WINDOWS for start in range(split - size + 1)]
    better: list[tuple[float, range]] = []
    for window in windows:
        episodes = _joined([scores[number] for number in window])
        effect = least if is_rate else max(least * ranges[window.start], share * ranges[0])
        if fmean(episodes) - last_mean < effect or effect <= 0:
            continue
        # Bonferroni's correction, because the best of many windows is good by chance.
        if paired(_mean_scores(scores[window.start : window.stop]), late_scores) <= level / len(windows):
            better.append((fmean(episodes), window))
    if not better:
        return None
    value, window = max(better, key=lambda candidate: (candidate[0], len(candidate[1]), candidate[1].start))
    means = list(map(fmean, scores))
    best = max(window, key=lambda number: (means[number], number))
    return Decline(
        measure=measure,
        best_value=value,
        best_steps=int(rows[best]["steps"]),
        last_value=late_mean,
        since_steps=int(rows[best + _change(means[best:])]["steps"]),
        best_episodes=sum(len(scores[number]) for number in window),
        last_episodes=len(late),
        last=last,
        last_steps=int(rows[split]["steps"]),
    )


def _joined(scores: Sequence[Sequence[float]]) -> list[float]:
    return [score for episodes in scores for score in episodes]


def _mean_scores(scores: Sequence[Sequence[float]]) -> list[float]:
    """Return the mean score of each start over some evaluations."""
    return [sum(column) / len(column) for column in zip(*scores, strict=False)]


def _ranges(scores: Sequence[Sequence[float]]) -> list[float]:
    """Return the range of all scores from each evaluation on."""
    highest = [*accumulate(map(max, reversed(scores)), max)]
    lowest = [*accumulate(map(min, reversed(scores)), min)]
    return [high - low for high, low in zip(reversed(highest), reversed(lowest), strict=True)]


def _change(means: Sequence[float]) -> int:
    """Return the place, from 1, at which a split into two means leaves the smallest squared error."""
    sums = [*accumulate(means)]

    def explained(split: int) -> float:
        return sums[split - 1] ** 2 / split + (sums[-1] - sums[split - 1]) ** 2 / (len(means) - split)

    return max(range(1, len(means)), key=explained)


def paired(better: Sequence[float], worse: Sequence[float]) -> float:
    """Return the one-sided p-value of the hypothesis that the mean of `better` is not higher, for the same
    starts in both, by Student's test of the differences.

    One more start has the largest of the differences, in the other direction: `better` is the best of many
    windows, in which rare failures are missing, so the variance is too small. Without it, up to 4 % of
    healthy trainings raised an alarm, with it 0.7 %. Student's t is transformed to a normal variable, which
    needs no scipy (D. L. Wallace, Ann. Math. Stat. 30, 1959, p. 1124).
    """
    differences = [first - second for first, second in zip(better, worse, strict=False)]
    freedom = len(differences)
    if freedom < 2:
        return 1.0
    differences.append(-max(map(abs, differences)))
    mean = fmean(differences)
    # `statistics.variance` computes with fractions, which takes 1 us a number.
    squares = sum((difference - mean) ** 2 for difference in differences)
    squared_error_of_mean = squares / freedom / (freedom + 1)
    if squared_error_of_mean <= 0:
        return 1.0
    scale = (8 * freedom + 1) / (8 * freedom + 3)
    z = math.copysign(
        scale * math.sqrt(freedom * math.log1p(mean**2 / squared_error_of_mean / freedom)), mean
    )
    return NormalDist().cdf(-z)


TIMESTEPS = "--timesteps"
SEED = "--seed"
MAX_COMPARED = 5
"""The number of solved runs that are compared. A comparison took 0.07 s (CartPole) to 0.4 s (Quadruped)."""
_MAX_LISTED = 3


@dataclass(frozen=True)
class ChangedValue:
    """A value that one of two runs has changed.

    Attributes:
        path: Its path in the scenario, or an option of `deepbots train`.
        before, after: Its texts in the earlier and in the later run, empty where there is none.
        is_written: Whether both scenarios have these texts at the path, so that writing `before` there, or
            removing the entry, sets the value back.
    """

    path: str
    before: str
    after: str
    is_written: bool = False

    def __str__(self) -> str:
        name = self.path.removeprefix("parameters.").removeprefix("--")  # of an option
        if not (self.before or self.after):
            return name
        return f"{name} {self.before or '(none)'} -> {self.after or '(none)'}"


def written_scenario(compiled: Compiled) -> WrittenScenario:
    """Return a compiled scenario with its text."""
    return WrittenScenario(compiled.program, None if compiled.document is None else compiled.document.root)


def changed_texts(before: Compiled, after: Compiled) -> list[ChangedValue]:
    """Return the values that a scenario changed against an earlier one, the most serious first, without those
    that have no effect. A text that means something else because of parameters is left out for the
    parameters."""
    sides = written_scenario(before), written_scenario(after)
    relevant = (change for change in scenario_changes(*sides) if change.group is not Effect.cosmetic)
    values = [
        replace(value, is_written=_is_written(value, *sides))
        for value in dict.fromkeys(value for change in relevant for value in _values(change))
    ]
    return [value for value in values if not _is_consequence(value, values)]


def changed_values(before: Run, after: Run) -> list[ChangedValue]:
    """Return the values that a run changed against an earlier one, as `changed_texts` does, with the options
    of the training."""
    values = changed_texts(before.compiled, after.compiled)
    one, other = before.record, after.record
    if one.total_timesteps != other.total_timesteps and not any(
        "total_timesteps" in value.path for value in values
    ):
        values.append(ChangedValue(TIMESTEPS, f"{one.total_timesteps:_}", f"{other.total_timesteps:_}"))
    if one.seed != other.seed:
        values.append(ChangedValue(SEED, str(one.seed), str(other.seed)))
    return values


def listed_values(values: Sequence[ChangedValue]) -> str:
    """Return the most serious changes in one line, and how many there are besides; empty without any."""
    more = f"; and {len(values) - _MAX_LISTED} more" if len(values) > _MAX_LISTED else ""
    return "; ".join(map(str, values[:_MAX_LISTED])) + more


def _is_written(value: ChangedValue, one: WrittenScenario, other: WrittenScenario) -> bool:
    texts = one.text_at(value.path), other.text_at(value.path)
    return any(texts) and texts == (value.before, value.after)


def _is_consequence(value: ChangedValue, values: Iterable[ChangedValue]) -> bool:
    """Return whether a value of a robot file follows from a change of `links` of the same robot: a longer
    link moves the joints on it."""
    section, robot, *rest = (*value.path.split("."), "", "")[:3]
    written = f"{section}.{robot}.links."
    return (
        not value.is_written
        and section == "robots"
        and rest in (["joints"], ["links"])
        and any(other.is_written and other.path.startswith(written) for other in values)
    )


def _values(change: Change) -> Iterator[ChangedValue]:
    if not change.through or change.one != change.other:
        yield ChangedValue(change.path, change.one, change.other)
        return
    for name, sides in change.through.items():
        yield ChangedValue(name if " " in name else f"parameters.{name}", *sides)


def nearest_solved(run: Run) -> tuple[Run, list[ChangedValue]] | None:
    """Return the earlier run with the fewest changes to a run, and these changes; None without one.

    The earlier run is among the last `MAX_COMPARED` that solved a scenario of the same name. Of equally near
    runs, it is the newest one.
    """
    solved = islice(solved_before(run), MAX_COMPARED)
    candidates = ((earlier, changed_values(earlier, run)) for earlier in solved)
    return min(candidates, key=lambda candidate: len(candidate[1]), default=None)


def solved_before(run: Run) -> Iterator[Run]:
    """Yield the earlier runs that solved a scenario of the same name, the newest first. They are in the
    same folder, in a group in it, or beside the group of the run."""
    begun = started(run.record)
    itself = run.path.absolute()
    earlier = []
    for path in set(_runs_beside(itself)) - {itself}:
        with suppress(RunError):  # damaged, or of another version
            record = RunRecord.read(path)
            if record.scenario == run.record.scenario and started(record) <= begun:
                earlier.append((started(record), path, record))
    for _, path, record in sorted(earlier, key=lambda entry: entry[:2], reverse=True):
        with suppress(RunError):
            if run_verdict(path, record).solved:
                yield Run.open(path)


def _runs_beside(run: Path) -> Iterator[Path]:
    folder = run.parent
    folder = folder.parent if folder_kind(folder) is SourceKind.GROUP else folder
    for path in folder.iterdir():
        kind = folder_kind(path)
        if kind is SourceKind.RUN:
            yield path
        elif kind is SourceKind.GROUP:
            yield from (member for member in path.iterdir() if folder_kind(member) is SourceKind.RUN)


def started(record: RunRecord) -> float:
    """Return the time at which a training began, in s since 1970; 0 if its record is unclear about it."""
    try:
        begun = datetime.fromisoformat(record.started)
    except ValueError:
        return 0.0
    return (begun if begun.tzinfo else begun.replace(tzinfo=UTC)).timestamp()
