"""The logs of trainings as curves: of runs of deepbots, and of files of TensorBoard.

`TrainingLog` is the one table of curves: `plots.py` paints it for paper, and the studio for its page.
"""

from __future__ import annotations

import json
import math
from collections import Counter, deque
from collections.abc import Iterator, Sequence
from dataclasses import field
from pathlib import Path
from statistics import fmean
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from deepbots_cli.errors import MissingExtraError, RunError
from deepbots_cli.learning.runs.directories import run_folders
from deepbots_cli.learning.runs.episodes import AGENTS_COLUMN, KeptNames, read_evaluations, read_log
from deepbots_cli.learning.runs.evaluations import EvaluationResult
from deepbots_cli.learning.runs.run import (
    DEMONSTRATIONS_NAME,
    Run,
    RunRecord,
    changed_settings,
    short_settings,
)
from deepbots_cli.learning.runs.verdict import Decline, decline_of, quoted_evaluation
from deepbots_cli.program import Member
from deepbots_cli.records import dataclass
from deepbots_cli.rollout.source import SourceKind, folder_kind
from deepbots_cli.words import shell_word

_MAX_ENDINGS = 20
"""The number of endings with a curve of their own."""
_MAX_STAGES = 100
# Per curve and stage. Without a limit, the means of 20 endings over a million episodes take 400 MB.
_MAX_MEANS = 20_000
_EPISODE_COLUMNS = [
    *((name, float) for name in ("steps", "returns", "lengths", "successes")),
    *((name, object) for name in ("endings", "stages", "drawn")),
]
# The limits of the kept drawn values, in episodes and in letters.
_MAX_DRAWN = 2_500
_MAX_DRAWN_LETTERS = 1 << 23
_EVENT_FILES = "events.out.tfevents.*"
_MAX_EVENT_BYTES, _MAX_TAGS = 1 << 20, 2_000
_LEAST_VALUE_BYTES = 30
"""The smallest event of one scalar has 41 bytes."""
Curve = tuple[NDArray[np.float64], NDArray[np.float64]]
"""Timesteps and values."""
Measure = Literal["mean_return", "success_rate"]
"""The two measures that trainings and evaluations have in common."""
_AGENT_RETURNS = "/rollout/ep_rew_mean"
"""The end of the tags of the returns of several agents, whose names come before it."""


class StageStart(NamedTuple):
    """A stage of a curriculum, and the number of timesteps of the training after which it began."""

    name: str
    steps: float


@dataclass(eq=False)
class TrainingLog:
    """The curves and results of one training. Reward terms and shares of endings are by name. `group` is the
    scenario with its digest, and whether a recording teaches; `settings` are the values that `--set` changed,
    and `name` is the name of its line.

    `stages` are the stages of a curriculum that have begun. A curve has a nan where one of them begins,
    because the next stage is another task. `model_steps` are the steps after which the model of `evaluation`
    was saved, None if they are unknown. `evaluation_stages` are the stages in which the policy acted in
    `evaluations`, empty for none. `teacher` is that of the `TaskRecord`, and `lessons` are its curves:
    `agreement`, `weight` of the imitation loss, `driven_worlds` (their share), and its own `mean_return` and
    `success_rate`, of a script from the starts of the evaluations. `agents` are the returns of each of
    several agents; `agent` is the one whose log this is, empty for one agent or all.

    Who shows a log may set `solved_return`, the mean return with which the task is solved, and
    `planned_steps`, the timesteps of the whole training while it runs.
    """

    path: Path
    group: str
    name: str = ""
    settings: str = ""
    returns: Curve | None = None
    successes: Curve | None = None
    evaluations: Curve | None = None
    evaluated_successes: Curve | None = None
    evaluation_stages: Sequence[str] = ()
    stages: Sequence[StageStart] = ()
    terms: dict[str, Curve] = field(default_factory=dict)
    endings: dict[str, Curve] = field(default_factory=dict)
    evaluation: EvaluationResult | None = None
    model_steps: float | None = None
    teacher: str | None = None
    lessons: dict[str, Curve] = field(default_factory=dict)
    decline: Decline | None = None
    agents: dict[str, Curve] = field(default_factory=dict)
    agent: str = ""
    solved_return: float | None = None
    planned_steps: float = 0.0

    def curves(self, measure: Measure) -> tuple[Curve | None, Curve | None]:
        """Return a measure of training episodes, and that of the evaluations during the training."""
        if measure == "mean_return":
            return self.returns, self.evaluations
        return self.successes, self.evaluated_successes

    @property
    def last_step(self) -> float:
        """The timesteps at the end of the axis."""
        curves = [curve for curve in self.curves("mean_return") if curve is not None]
        return max([self.planned_steps, *(float(steps[-1]) for steps, _ in curves)])


def read_logs(paths: Sequence[str | Path], window: int = 100, *, by_agent: bool = False) -> list[TrainingLog]:
    """Read runs, folders of runs, and folders of TensorBoard files that other programs wrote.

    Args:
        window: The number of episodes that returns and successes are averaged over.
        by_agent: Whether each of several agents of a run has a log of its own.

    Raises:
        RunError: A path is neither, is damaged, or has no episode yet.
        MissingExtraError: TensorBoard is not installed.
    """
    logs = list[TrainingLog]()
    for path in run_folders(paths):
        logs += [read_run(path, window)] if folder_kind(path) is SourceKind.RUN else _read_tensorboard(path)
    first = {log.group: log.path for log in reversed(logs)}  # the first run of each scenario
    # Scenarios of one name that differ are called after the folder of their first run or group, or its path
    # if folders share a name.
    folders = {
        group: path.parent if folder_kind(path.parent) is SourceKind.GROUP else path
        for group, path in ((group, path.resolve()) for group, path in first.items())
    }
    candidates = (
        {group: group.rpartition(" ")[0] for group in first},
        {group: path.name for group, path in folders.items()},
        {group: str(path) for group, path in first.items()},
    )
    for log in logs:
        name = next(
            (names[log.group] for names in candidates if list(names.values()).count(names[log.group]) == 1),
            log.group,
        )
        log.name = f"{name} ({log.settings})" if log.settings and len(first) > 1 else name
    if not by_agent:
        return logs
    return [agent_log for log in logs for agent_log in _agent_logs(log, window, is_only=len(first) == 1)]


def _agent_logs(log: TrainingLog, window: int, *, is_only: bool) -> Iterator[TrainingLog]:
    """Yield the log of each of several agents of a run, or the log of a run with one agent."""
    if not log.agents:
        yield log
        return
    for agent, member in Run.open(log.path).program.members.items():
        agent_log = read_run(log.path, window, member)
        agent_log.agent = agent
        agent_log.name = agent if is_only else f"{log.name}: {agent}"
        yield agent_log


def read_run(path: Path, window: int = 100, member: Member | None = None) -> TrainingLog:
    """Read the log of a run, or of a run as it is for one of its several agents.

    Raises:
        RunError: The run is damaged, or an older version wrote it, which did not log each agent.
    """
    record = RunRecord.read(path)
    teacher = record.task.teacher
    # A recording is not part of the scenario.
    recorded = "-recorded" if teacher == DEMONSTRATIONS_NAME else ""
    settings = short_settings(changed_settings(record.command))
    log = TrainingLog(
        path, f"{record.scenario} {record.digest}{recorded}", settings=settings, teacher=teacher
    )
    episodes, evaluations = logs_of(path, "" if member is None else member.name)
    if not len(episodes):
        longer = f"or continue it with: deepbots resume {shell_word(path)}"
        raise RunError(f"{path} contains no finished episode yet; wait for it, {longer}")
    log.stages = stage_starts(record, episodes)
    log.returns = _averaged(episodes, episodes.returns, window, log.stages)
    endings = episodes.endings  # as objects, because each text of numpy would take the memory of the longest
    common = [name for name, _ in Counter(endings).most_common(_MAX_ENDINGS)]
    # These two names have a space, unlike that of an ending.
    shares = {name or "unknown ending": endings == name for name in common} | {
        "other endings": ~np.isin(endings, common)
    }
    log.endings = {
        name: _averaged(episodes, share.astype(float), window, log.stages)
        for name, share in shares.items()
        if share.any()
    }
    if quoted := quoted_evaluation(path, record):
        evaluation = quoted.evaluation
        log.evaluation = evaluation if member is None else evaluation.of_agent(member.name)
        best = record.result.best if record.result else None
        steps = evaluation.model_steps if evaluation.model_steps is not None or best is None else best.steps
        log.model_steps = None if steps is None else float(max(0, min(steps, 2**63)))
    if record.task.defines_success if member is None else member.defines_success:
        log.successes = _averaged(episodes, episodes.successes, window, log.stages)
    if evaluations:
        at = np.array([line["steps"] for line in evaluations])
        means, rates = (
            np.array([fmean(line[name]) for line in evaluations]) for name in ("returns", "successes")
        )
        log.evaluations = (at, means)
        log.evaluated_successes = (at, rates) if log.successes is not None else None
        log.evaluation_stages = [line["stage"] for line in evaluations]
    log.decline = decline_of(path, record) if member is None else None
    scalars = scalars_of(path / "tensorboard")
    finite = {
        tag: (at[np.isfinite(values)], values[np.isfinite(values)]) for tag, (at, values) in scalars.items()
    }
    curves = {tag: _with_breaks(curve, log.stages) for tag, curve in finite.items() if len(curve[0])}
    log.terms = {
        tag.removeprefix("reward/"): curve for tag, curve in curves.items() if tag.startswith("reward/")
    }
    if member is not None:
        names = {joint: term for term, joint in member.terms.items()}
        log.terms = {names[name]: curve for name, curve in log.terms.items() if name in names}
        return log
    log.agents = {
        tag.removesuffix(_AGENT_RETURNS): curve
        for tag, curve in curves.items()
        if tag.endswith(_AGENT_RETURNS) and tag.count("/") == _AGENT_RETURNS.count("/")
    }
    if teacher is not None:
        log.lessons = {
            tag.removeprefix("teacher/"): curve for tag, curve in curves.items() if tag.startswith("teacher/")
        }
    return log


def stage_starts(record: RunRecord, episodes: Any) -> list[StageStart]:
    """Return when the stages of a training began: from its record, or else, while it runs, with their first
    episode in `episodes`."""
    recorded_starts = (
        {stage.name: float(max(0, min(stage.steps, 2**63))) for stage in record.result.stages}
        if record.result
        else {}
    )
    starts: list[StageStart] = []
    for name in [name for name in dict.fromkeys([*recorded_starts, *episodes.stages]) if name][:_MAX_STAGES]:
        own_steps = episodes.steps[episodes.stages == name]
        begun: float | None = 0.0
        if starts:
            first_step = own_steps[0] if len(own_steps) else None
            begun = recorded_starts.get(starts[-1].name) or first_step
        if begun is not None and (not starts or begun >= starts[-1].steps):
            starts.append(StageStart(name, float(begun)))
    return starts


def _read_tensorboard(path: Path) -> list[TrainingLog]:
    """Read the scalars that a learner writes; of each folder with files, because it is a training."""
    if not path.is_dir():
        raise RunError(f"{path} is neither a run nor a folder of TensorBoard files")
    tags = ("rollout/ep_rew_mean", "rollout/success_rate", "eval/mean_reward")
    logs = []
    for folder in sorted({file.parent for file in path.glob(f"**/{_EVENT_FILES}")}):
        scalars = scalars_of(folder, _EVENT_FILES)
        if scalars.keys() & set(tags):
            place = folder.resolve()
            log = TrainingLog(folder, f"{place.name} {place.as_uri()}")
            log.returns, log.successes, log.evaluations = map(scalars.get, tags)
            logs.append(log)
    if not logs:
        raise RunError(f"{path} is not a run, and its TensorBoard files hold none of {', '.join(tags)}")
    return logs


def logs_of(run: Path, agent: str = "") -> tuple[Any, list[dict[str, Any]]]:
    """Return the episodes of a training and its evaluations, both in order. A last line that is half written
    is left out. Of several agents, `agent` is the one whose returns and successes are read.

    Episodes are a record array with the timesteps at their end (`steps`), `returns`, `lengths`, `successes`
    (1 or 0), `endings`, `stages` of the curriculum ("" without one), and `drawn`, the drawn values of the
    newest thousands as JSON ("" without them). Evaluations are dictionaries of `steps`, of the `stage` in
    which the policy acted, and of the `returns` and `successes` of their episodes.

    Raises:
        RunError: A file is not a regular file, too large, or damaged.
    """
    path = run / "monitor.csv"
    names = KeptNames(path)
    newest = deque[str]()
    letters = 0

    def episodes() -> Iterator[tuple[Any, ...]]:
        nonlocal letters
        for row in read_log(path):
            numbers = [float(row[name]) for name in ("steps", "r", "l", "is_success")]
            if agent:
                if AGENTS_COLUMN not in row:
                    raise RunError(
                        f"the log of {run} has no returns of each agent; an older version wrote it"
                    )
                numbers[1], numbers[3] = map(float, json.loads(row[AGENTS_COLUMN])[agent])
            if not all(map(math.isfinite, numbers)) or numbers[0] < 0:
                raise ValueError("a number is not finite, or a step is negative")
            newest.append(row.get("drawn") or "")
            letters += len(newest[-1])
            while len(newest) > _MAX_DRAWN or letters > _MAX_DRAWN_LETTERS:
                letters -= len(newest.popleft())
            yield (*numbers, *(names.keep(row.get(name) or "") for name in ("ended_by", "stage")), "")

    try:
        table = np.fromiter(episodes(), _EPISODE_COLUMNS)
    except (KeyError, TypeError, ValueError, OverflowError, RecursionError) as error:
        raise RunError(f"{run} is damaged: one of its logs cannot be read") from error
    table["drawn"][len(table) - len(newest) :] = newest
    return table.view(np.recarray), read_evaluations(run, agent)


def scalars_of(path: Path, pattern: str = f"**/{_EVENT_FILES}") -> dict[str, Curve]:
    """Return the scalars of the TensorBoard files of a pattern in a folder, by tag; by default of all files
    in the folder and those below.

    Raises:
        RunError: A file is not a regular file, damaged, or has more tags or values than a logger writes.
        MissingExtraError: TensorBoard is not installed.
    """
    files = sorted(path.glob(pattern))
    if not files:
        return {}
    for file in files:
        if not file.is_file():  # opening a pipe waits for ever
            raise RunError(f"{file} is not a regular file")
    try:
        from tensorboard.backend.event_processing.event_accumulator import EventAccumulator
    except ModuleNotFoundError as error:
        raise MissingExtraError("train", "reading TensorBoard files") from error
    for file in files:
        _check_events(file)
    scalars: dict[str, list[tuple[float, float]]] = {}
    for folder in sorted({file.parent for file in files}):
        events = EventAccumulator(str(folder), size_guidance={"scalars": 0})
        events.Reload()
        for tag in events.Tags()["scalars"]:
            scalars.setdefault(tag, []).extend(
                (float(event.step), event.value) for event in events.Scalars(tag)
            )
    return {
        tag: (np.array([s for s, _ in sorted(rows)]), np.array([v for _, v in sorted(rows)]))
        for tag, rows in scalars.items()
    }


def _check_events(file: Path) -> None:
    """Refuse a file that takes much memory: `EventAccumulator` needs 4 kB for a tag, and 400 bytes for a
    value."""
    from google.protobuf.message import DecodeError
    from tensorboard.backend.event_processing.event_file_loader import RawEventFileLoader
    from tensorboard.compat.proto.event_pb2 import Event

    tags = set[str]()
    values = 0
    try:
        for record in RawEventFileLoader(str(file)).Load():
            if len(record) > _MAX_EVENT_BYTES:
                raise RunError(f"{file} has an event of more than {_MAX_EVENT_BYTES >> 20} MiB")
            summary = Event.FromString(record).summary.value
            values += len(summary)
            tags.update(value.tag for value in summary)
            if len(tags) > _MAX_TAGS:
                raise RunError(f"{file} has more than {_MAX_TAGS:,} tags")
    except DecodeError as error:
        raise RunError(f"{file} is damaged: an event of it cannot be read") from error
    if values > 1_000 + file.stat().st_size / _LEAST_VALUE_BYTES:
        raise RunError(f"{file} has more values than a logger writes into its size")


def _averaged(episodes: Any, values: NDArray[np.float64], window: int, stages: Sequence[StageStart]) -> Curve:
    """Return means over so many episodes up to each, for each stage by itself; in a long stage, up to
    thousands of them."""
    pieces = []
    for start, following in zip(
        stages or [StageStart("", 0.0)], [*stages[1:], StageStart("", np.inf)], strict=True
    ):
        # Worlds change over one by one: the last episodes of a stage end after the next one has begun.
        mine = (
            (episodes.stages == start.name) & (episodes.steps <= following.steps)
            if stages
            else np.full(len(values), True)
        )
        # Means by differences of sums: linear in the number of episodes, whatever the window.
        sums = np.concatenate([[0.0], np.cumsum(values[mine])])
        count = len(sums) - 1
        ends = 1 + np.linspace(0, count - 1, min(count, _MAX_MEANS)).round().astype(int)
        begins = np.maximum(0, ends - window)
        pieces.append((episodes.steps[mine][ends - 1], (sums[ends] - sums[begins]) / (ends - begins)))
    return _with_breaks(
        (np.concatenate([at for at, _ in pieces]), np.concatenate([means for _, means in pieces])), stages
    )


def _with_breaks(curve: Curve, stages: Sequence[StageStart]) -> Curve:
    """Return a curve with a nan where each stage but the first begins."""
    at, values = curve
    for start in stages[1:]:
        index = int(np.searchsorted(at, start.steps, side="right"))
        if 0 < index < len(at):
            at, values = np.insert(at, index, start.steps), np.insert(values, index, np.nan)
    return at, values
