"""The evidence about a training: its logs, and a few short episodes of its policy, of random and constant
actions and of scripts.

Logs are `monitor.csv`, the TensorBoard files and the evaluations during the training. Nothing is
written.
"""

from __future__ import annotations

import math
import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import field, replace
from functools import cached_property, partial
from itertools import islice
from pathlib import Path
from statistics import fmean
from typing import Any, Literal, NamedTuple

import numpy as np

from deepbots_cli import api
from deepbots_cli.document import Permissions
from deepbots_cli.document.files import display_path
from deepbots_cli.errors import DeepbotsError
from deepbots_cli.insight.scenario_facts import LintedScenario, ScenarioFacts, linted_scenario, named_source
from deepbots_cli.insight.statements import EvaluationRate, Percentage, SuccessRate
from deepbots_cli.insight.trace import Array, Trace, TraceRecorder, instrument_program, trace_episodes
from deepbots_cli.learning.environments import FAILURES_FOLDER, Failure, read_failure
from deepbots_cli.learning.report import longer_goal
from deepbots_cli.learning.runs.order import measure_of
from deepbots_cli.learning.runs.run import Run
from deepbots_cli.learning.runs.verdict import (
    LEARNED_RATE,
    ChangedValue,
    Decline,
    RunVerdict,
    find_decline,
    logged_episodes_meet,
    nearest_solved,
    quoted_episodes,
    run_verdict,
)
from deepbots_cli.learning.sb3.defaults import effective_hyperparameters
from deepbots_cli.program import CurriculumStage, Member, Program
from deepbots_cli.program.task import AdaptiveRate, Schedule, idle_action
from deepbots_cli.records import dataclass
from deepbots_cli.rollout import Driver, Episode, Start, steps
from deepbots_cli.rollout.drivers import action_from_values, constant_driver, named_driver, random_driver
from deepbots_cli.rollout.episode import own_episode
from deepbots_cli.rollout.source import SourceKind, folder_kind
from deepbots_cli.runtime import Supervisor
from deepbots_cli.runtime.streams import derive_seed
from deepbots_cli.view.training_logs import logs_of, scalars_of
from deepbots_cli.words import shell_word

MIN_EPISODES = 8
"""The number of episodes below which the returns of a training are not meaningful."""
TOTAL_TIMESTEPS = "train.total_timesteps"
"""The setting whose new value continues a training. A new value of another setting begins another
training."""
MIN_QUARTER = 30
"""Episodes in a quarter of a stage, below which its success rate is too uncertain for a trend."""


@dataclass(frozen=True)
class Trend:
    """Whether a mean of episodes rises in the present stage.

    Attributes:
        direction: "rises", "no longer rises", "falls", or "" if the episodes do not show which.
        before: The mean of the second quarter of the steps of the stage.
        late: The mean of the last quarter.
        gain: `late` - `before`, with its 95 % interval from `low` to `high`.
    """

    direction: Literal["rises", "no longer rises", "falls", ""] = ""
    before: float = 0.0
    late: float = 0.0
    gain: float = 0.0
    low: float = -np.inf
    high: float = np.inf


def trend_of(progress: Array, values: Array, least: int) -> Trend:
    """Return the trend of values of episodes, at their progress in a stage from 0 to 1. Each quarter needs at
    least so many episodes.

    The values rise if their gain since the second quarter, or from one half to the other, exceeds chance, and
    they have not leveled off: an interval ends below half of what a steady rise would gain. They no longer
    rise if they have leveled off, or if their interval excludes a gain of a tenth of their mean; where both
    gains are below 0, the interval may be wider. In 300 simulated trainings each of 400 to 20,000 episodes,
    rates that rose from 1 to 6 % were called flat in at most 4 %.
    """
    shares = [(0.0, 0.1), *((quarter / 4, (quarter + 1) / 4) for quarter in range(4))]
    start, *quarters = (values[(progress > low) & (progress <= high)] for low, high in shares)
    if min(map(len, quarters)) < least:
        return Trend()
    start, last = start if len(start) else quarters[0], quarters[3]
    gain, low, high = _gain(quarters[1], last)
    _, recent_low, recent_high = _gain(quarters[2], last)
    of_halves, low_of_halves, _ = _gain(np.concatenate(quarters[:2]), np.concatenate(quarters[2:]))
    is_clear = low > 0 or low_of_halves > of_halves / 4  # 99 % for halves, of which one has the start
    whole, level = float(last.mean() - start.mean()), abs(float(last.mean()))
    # A steady rise gains 0.6 of the whole since the second quarter, and 0.3 since the third.
    leveled = high < 0.3 * whole or recent_high < 0.15 * whole or (gain <= 0 and high < 0.6 * whole)
    margin = min(0.4 * float(last.std()), level) if max(gain, of_halves) <= 0 else 0.1 * level
    direction: Literal["rises", "no longer rises", "falls", ""] = ""
    if high < 0:
        direction = "falls"
    elif leveled:
        direction = "" if recent_low > 0 else "no longer rises"
    elif low > 0 or low_of_halves > 0:
        direction = "rises" if gain > 0 and is_clear else ""
    elif high <= margin:
        direction = "no longer rises"
    return Trend(direction, float(quarters[1].mean()), float(last.mean()), gain, low, high)


def _gain(before: Array, after: Array) -> tuple[float, float, float]:
    """Return the difference of two means, and the ends of its 95 % interval."""
    gain = float(after.mean() - before.mean())
    half = 1.96 * float(np.hypot(before.std() / np.sqrt(len(before)), after.std() / np.sqrt(len(after))))
    return gain, gain - half, gain + half


@dataclass(eq=False)
class TrainingEvidence:
    """The evidence about a training: its files, and short episodes.

    `all_episodes` and `all_evaluations` are those of `logs_of`; the quoted evaluation since the training is
    the last one, in stage "". `episodes`, `evaluations` and `program` are those of the present stage, because
    returns of other stages are not comparable. `scalars` are curves of TensorBoard by tag: steps and values.
    `failure` is the episode that ended the training. The short episodes have the same starts, in the present
    stage: `policy` those of the last policy, `random` those of random actions, `idle` those of an action that
    commands zeros, and `constant_actions` one for each constant action, by the part of the action that alone
    differs. `scripts` are whole episodes of the script that teaches the policy, or of each that could.
    `final_episodes` are those of the evaluation that `verdict` quotes, and `failed` are the first ones of
    them without success, repeated.

    If several agents learned, the evidence is about one, `agent`: its returns, successes, curves and
    actions, beside the policies of the others. `rivals` are the successes of the others in `all_episodes`, by
    name, if the agents compete.
    """

    run: Run
    all_episodes: Any
    all_evaluations: Sequence[Mapping[str, Any]]
    scalars: Mapping[str, tuple[Array, Array]]
    failure: Failure | None = None
    final_episodes: Sequence[Episode] = ()
    verdict: RunVerdict = RunVerdict(None, None)
    is_running: bool = False
    policy: list[Trace] = field(default_factory=list)
    random: list[Trace] = field(default_factory=list)
    idle: list[Trace] = field(default_factory=list)
    constant_actions: dict[str, dict[str, Trace]] = field(default_factory=dict)
    scripts: dict[str, list[Trace]] = field(default_factory=dict)
    failed: Sequence[Trace] = ()
    agent: str = ""
    rivals: Mapping[str, Array] = field(default_factory=dict)

    # Stages

    @property
    def stages(self) -> Sequence[CurriculumStage]:
        return self.run.program.curriculum

    @cached_property
    def stage_index(self) -> int:
        """The index of the present stage, the furthest that an episode or an evaluation was in; 0 without a
        curriculum."""
        names, result = [stage.name for stage in self.stages], self.run.record.result
        stages = {
            *self.all_episodes.stages,
            *(evaluation.get("stage", "") for evaluation in self.all_evaluations),
            result.stage if result else "",
        }
        return max((names.index(name) for name in stages if name in names), default=0)

    @property
    def stage(self) -> str:
        """The name of the present stage; "" without a curriculum."""
        return self.stages[self.stage_index].name if self.stages else ""

    @property
    def is_last_stage(self) -> bool:
        return self.stage_index >= len(self.stages) - 1

    @cached_property
    def program(self) -> Program:
        """The scenario of the present stage."""
        return self.stages[self.stage_index].program if self.stages else self.run.program

    @cached_property
    def facts(self) -> ScenarioFacts:
        """The facts of the scenario of the present stage."""
        return ScenarioFacts(self.program, self.run.compiled.units)

    @cached_property
    def linted(self) -> LintedScenario:
        """The scenario as `deepbots lint` reads it, with the positions of its nodes."""
        return linted_scenario(self.run)

    @property
    def scenario_argument(self) -> str:
        """The scenario as an argument of a command, quoted for a shell."""
        return shell_word(named_source(self.run.record.source))

    def episodes_of(self, stage: str) -> Any:
        return self.all_episodes[self.all_episodes.stages == stage]

    @cached_property
    def episodes(self) -> Any:
        """The episodes of the present stage."""
        return self.episodes_of(self.stage) if self.stages else self.all_episodes

    @cached_property
    def evaluations(self) -> Sequence[Mapping[str, Any]]:
        """The evaluations of the present stage; in the last stage, including the evaluations in the scenario
        itself."""
        names = {self.stage, ""} if self.is_last_stage else {self.stage}
        return [evaluation for evaluation in self.all_evaluations if evaluation.get("stage", "") in names]

    @cached_property
    def first_step(self) -> int:
        """The step in which the present stage began; a little too late for a running stage of several
        environments."""
        ends = self.run.record.result.stages if self.run.record.result else ()
        if self.stage_index and ends and ends[-1].name == self.stages[self.stage_index - 1].name:
            return ends[-1].steps
        return (
            int(self.episodes.steps[0] - self.episodes.lengths[0])
            if self.stage_index and len(self.episodes)
            else 0
        )

    @property
    def stage_steps(self) -> int:
        """Steps since the present stage began."""
        return max(0, self.steps - self.first_step)

    @property
    def planned(self) -> int:
        """The steps that the scenario plans."""
        settings = self.run.program.agent.training
        return settings.total_timesteps if settings else self.run.record.total_timesteps

    @property
    def is_mature(self) -> bool:
        """Whether the present stage has had half of its share of the planned steps, so that a missing success
        may never come."""
        return self.stage_steps >= 0.5 * self.planned / max(1, len(self.stages))

    @property
    def has_failed(self) -> bool:
        return self.run.record.status == "failed"

    @property
    def probes(self) -> list[Trace]:
        """The short episodes of the policy and of random actions."""
        return [*self.random, *self.policy]

    @property
    def probe_moments(self) -> int:
        """The number of moments of the short episodes."""
        return sum(len(trace.values) for trace in self.probes)

    def episodes_between(self, first: float, last: float) -> Any:
        """Return the episodes of the present stage from one share of them to another: `episodes_between(0.75,
        1)` is the last quarter."""
        return self.episodes[round(first * len(self.episodes)) : round(last * len(self.episodes))]

    def episodes_by_steps(self, first: float, last: float) -> Any:
        """Return the episodes of the present stage that ended between two shares of its steps."""
        low, high = (self.first_step + share * self.stage_steps for share in (first, last))
        return self.episodes[(self.episodes.steps > low) & (self.episodes.steps <= high)]

    @property
    def late_evaluations(self) -> list[Mapping[str, Any]]:
        """The evaluations during the last quarter of the present stage.

        The quoted evaluation after the training is not one of the last quarter: it may be of an earlier
        policy.
        """
        begin = self.first_step + 0.75 * self.stage_steps
        return [evaluation for evaluation in self.evaluations if evaluation.get("steps", 0) > begin]

    @property
    def longest(self) -> int:
        """The largest number of steps of an episode in the present stage."""
        return self.program.truncation.max_episode_steps(self.program.period)

    @cached_property
    def late_success(self) -> EvaluationRate:
        """The success in the evaluations during the last quarter of the present stage; if there is none, in
        the last evaluation.

        The rate has no episodes if the scenario defines no success or nothing was evaluated.
        """
        if not self.program.defines_success:
            return EvaluationRate([])
        evaluations = self.late_evaluations or self.evaluations[-1:]
        return EvaluationRate([evaluation["successes"] for evaluation in evaluations])

    @cached_property
    def settings(self) -> Mapping[str, Any]:
        """The hyperparameters that the training takes, by name."""
        return {
            entry.name: entry.value
            for entry in effective_hyperparameters(self.run.program, self.run.record.total_timesteps)
        }

    @cached_property
    def usual_settings(self) -> Mapping[str, Any]:
        """The hyperparameters that the training would take if the scenario gave none, by name."""
        program, training = self.run.program, self.run.program.agent.training
        if training is None:
            return {}
        bare = replace(training, hyperparameters=(), action_noise=None, replay=None)
        unset = program.with_agent(training=bare)
        return {
            entry.name: entry.value
            for entry in effective_hyperparameters(unset, self.run.record.total_timesteps)
        }

    def number_setting(self, name: str) -> float | None:
        """Return a hyperparameter as a number, of a schedule its first number; None if it is not a number."""
        value = self.settings.get(name)
        value = value.start if isinstance(value, Schedule | AdaptiveRate) else value
        return float(value) if isinstance(value, int | float) and not isinstance(value, bool) else None

    def noise_setting(self, sigma: str) -> tuple[str, str]:
        """Return the path and the value of the setting that gives the action noise the standard deviation
        `sigma`."""
        training = self.program.agent.training
        if training is not None and training.action_noise is not None:
            return "train.action_noise.sigma", sigma
        return "train.action_noise", f"{{type: normal, sigma: {sigma}}}"

    def progress(self, steps: float) -> float:
        """Return the progress of the training after these steps: 1 after its planned steps."""
        return steps / max(1, self.run.record.total_timesteps)

    @cached_property
    def decline(self) -> Decline | None:
        """The decline of the evaluations in the present stage; None if there is none."""
        program = self.run.program
        return find_decline(
            self.all_evaluations, measure_of(program.agent.solved, defines_success=program.defines_success)
        )

    @cached_property
    def earlier_solved(self) -> tuple[Run, list[ChangedValue]] | None:
        """The nearest earlier run that solved the scenario, and what has changed since; None without one."""
        try:
            # With several agents, the evidence is about the scenario of one of them.
            return nearest_solved(Run.open(self.run.path) if self.agent else self.run)
        except (DeepbotsError, OSError):
            return None

    @property
    def steps(self) -> int:
        """The steps of the whole training. The result of a running training is as old as its last process."""
        result = self.run.record.result
        logged_steps = int(self.all_episodes.steps[-1]) if len(self.all_episodes) else 0
        return max(logged_steps, result.steps if result is not None else 0)

    @property
    def late(self) -> Any:
        """The episodes of the last quarter of the present stage."""
        return self.episodes_between(0.75, 1.0)

    @property
    def late_training_success(self) -> float:
        """The success rate of the late episodes of the training, which explore; 0 without any."""
        return float(self.late.successes.mean()) if len(self.late) else 0.0

    def length(self, planned: int = 0) -> dict[str, Any]:
        """Return the length of the training as numbers of a cause, and the way to continue it: to the
        `planned` steps if they are more than 1.1 times as many, else further."""
        record, path = self.run.record, self.run.path
        # A single seed with more steps would no longer be one of its group.
        folder = path.parent if folder_kind(path.parent) is SourceKind.GROUP else path
        command = f"deepbots resume {shell_word(display_path(folder))}"
        more = planned if planned > 1.1 * self.steps else max(self.planned, longer_goal(self.steps))
        # An interrupted training goes on to its own total.
        if record.state(self.run.path) != "interrupted" or more != record.total_timesteps:
            command += f" --timesteps {more:_}"
        wait = f"Let it run: {self.steps:,} of {record.total_timesteps:,} steps have been made."
        return {
            "steps": self.steps,
            "episodes": len(self.all_episodes),
            "planned": self.planned,
            "share": Percentage(self.steps / self.planned),
            "more": more,
            "advice": wait if self.is_running else f"Continue the training with `{command}`.",
            "settings": {} if self.is_running else {TOTAL_TIMESTEPS: f"{more:_}"},
            "command": command,
        }

    # What was learned

    @property
    def solved(self) -> bool:
        """Whether the policy solves the task by `run_verdict`; before its evaluation, also by the evaluations
        of the last stage."""
        solved = self.run.program.agent.solved
        if solved is None or self.final_episodes or self.verdict.solved:
            return bool(self.verdict.solved)
        evaluations = self.evaluations if self.is_last_stage else ()
        return any(
            logged_episodes_meet(solved, evaluation["returns"], evaluation["successes"])
            for evaluation in evaluations
        )

    @cached_property
    def learned(self) -> Literal["exploring", "evaluated"] | None:
        """Where the policy has learned the task: in the episodes of the training, or only in evaluations,
        which do not explore.

        The task is the scenario itself, or the last stage of its curriculum. The task is not learned if an
        evaluation after the training excludes it, or its last one in the training does. In a scenario without
        `solved`, the task is learned at a success rate of 80 %.
        """
        solved, succeeds = self.run.program.agent.solved, self.run.program.defines_success
        required = LEARNED_RATE if solved is None else solved.success_rate or 0.0

        def suffices(successes: Sequence[float]) -> bool:
            """Return whether successes suffice in a scenario without `solved`."""
            return (
                solved is None
                and succeeds
                and len(successes) >= MIN_EPISODES
                and fmean(successes) >= required
            )

        last = self.evaluations[-1]["successes"] if succeeds and self.evaluations else []
        rates = SuccessRate.of(self.final_episodes), SuccessRate(last)
        excluded = succeeds and any(rate.episodes >= MIN_EPISODES and rate.high < required for rate in rates)
        is_learned = self.is_last_stage and suffices(self.episodes.successes[-100:])
        if not excluded and (is_learned or self._solved_while_exploring):
            return "exploring"
        evaluated = [episode.is_success for episode in self.final_episodes]
        if self.is_last_stage:
            is_defined = self.evaluations and self.program.defines_success
            evaluated = self.evaluations[-1]["successes"] if is_defined else []
        return "evaluated" if self.solved or suffices(evaluated) else None

    @property
    def _solved_while_exploring(self) -> bool:
        """Whether episodes of the training, which explore, met `solved`."""
        solved, result = self.run.program.agent.solved, self.run.record.result
        if result is None or result.solved_at is None:
            return False
        if solved is None:
            return True
        recent = self.episodes[-solved.episodes :] if self.is_last_stage else self.episodes[:0]
        return logged_episodes_meet(solved, recent.returns, recent.successes)

    @cached_property
    def policy_rate(self) -> SuccessRate:
        """The success rate of the policy: in the quoted evaluation, else in the last quarter of the
        training."""
        final = [episode.is_success for episode in self.final_episodes] if self.is_last_stage else []
        return SuccessRate(final or self.late.successes)

    @property
    def script_rates(self) -> dict[str, SuccessRate]:
        """The success rates of the scripts, of enough episodes each."""
        rates = {name: SuccessRate.of(traces) for name, traces in self.scripts.items()}
        return {name: rate for name, rate in rates.items() if rate.episodes >= MIN_EPISODES}

    @property
    def teacher(self) -> str | None:
        """The script that teaches the policy."""
        training = self.program.agent.training
        return training.teacher.script if training is not None and training.teacher is not None else None

    @property
    def is_taught(self) -> bool:
        return self.teacher is not None or self.run.demonstrations.exists() or self.run.teacher.exists()

    @cached_property
    def return_trend(self) -> Trend:
        """The trend of the returns in the present stage."""
        return trend_of(self._progress(self.episodes.steps), self.episodes.returns, MIN_EPISODES // 2)

    @cached_property
    def success_trend(self) -> Trend:
        """The trend of the success rate in the present stage: that of the evaluations, which do not explore,
        if it rises, or else that of the episodes of the training."""
        rows = [(row["steps"], won) for row in self.evaluations for won in row["successes"] if "steps" in row]
        steps, successes = np.array(rows, float).reshape(-1, 2).T
        evaluated = trend_of(self._progress(steps), successes, MIN_QUARTER)
        if evaluated.direction == "rises":
            return evaluated
        return trend_of(self._progress(self.episodes.steps), self.episodes.successes, MIN_QUARTER)

    def _progress(self, steps: Array) -> Array:
        """Return which share of the steps of the present stage was made after these steps."""
        return (steps - self.first_step) / max(1, self.stage_steps)

    def curve(self, tag: str) -> Array:
        """Return the values of a curve in the present stage, or of `train/...` in all stages; empty if
        TensorBoard has no such tag."""
        if tag not in self.scalars:
            return np.zeros(0)
        steps, values = self.scalars[tag]
        return values[steps > self.first_step] if self.first_step and not tag.startswith("train/") else values

    @property
    def term_curves(self) -> dict[str, Array]:
        """The mean of each reward term per episode over the present stage; without terms that were not
        logged."""
        curves = {term.name: self.curve(f"reward/{term.name}") for term in self.program.agent.reward}
        return {name: curve for name, curve in curves.items() if len(curve)}


def last_quarter(curve: Array) -> Array:
    return curve[-max(1, len(curve) // 4) :]


def mean_return(evidence: TrainingEvidence, first: float, last: float) -> float:
    """Return the mean return of `TrainingEvidence.episodes_between`."""
    return float(evidence.episodes_between(first, last).returns.mean())


def commonest_ending(episodes: Any) -> tuple[str, float]:
    """Return the most frequent ending of episodes of a log, and its share of them."""
    name, count = Counter(episodes.endings).most_common(1)[0]
    return name, count / len(episodes)


def latest_failure(run: Path) -> Path | None:
    """Return the file of the last episode that raised an error."""
    return max((run / FAILURES_FOLDER).glob("[0-9][0-9][0-9][0-9].json"), default=None)


def read_trainings(run: Run) -> list[TrainingEvidence]:
    """Read the logs of a run: one training, or that of each of several agents.

    Raises:
        RunError: A log is damaged.
    """
    return [_read_agent(run, name) for name in run.program.members] or [read_training(run)]


def _read_agent(run: Run, agent: str) -> TrainingEvidence:
    """Read the logs of a run of several agents, as they are about one of them.

    Raises:
        RunError: A log is damaged, or an older version wrote it, which did not log each agent.
    """
    of_all, members = read_training(run), run.program.members
    episodes, evaluations = logs_of(run.path, agent)
    final_episodes = [own_episode(members[agent], episode) for episode in of_all.final_episodes]
    if final_episodes:
        evaluations.append(_logged(final_episodes))
    return replace(
        of_all,
        run=run.of_agent(agent, beside_policies=run.model("best").is_file()),
        all_episodes=episodes,
        all_evaluations=evaluations,
        scalars=_scalars_of_agent(of_all.scalars, members[agent]),
        final_episodes=final_episodes,
        verdict=of_all.verdict.of_agent(agent) if run.program.has_rivals else of_all.verdict,
        agent=agent,
        rivals={
            name: logs_of(run.path, name)[0].successes
            for name in members
            if run.program.has_rivals and name != agent
        },
    )


def _logged(episodes: Sequence[Episode]) -> dict[str, Any]:
    """Return the episodes of the quoted evaluation in the form of the logs, without steps."""
    returns = [episode.total_return for episode in episodes]
    return {"stage": "", "returns": returns, "successes": [episode.is_success for episode in episodes]}


def _scalars_of_agent(of_all: Mapping[str, Any], member: Member) -> dict[str, Any]:
    """Return the scalars of one of several agents under its own tags, and those of all agents; an agent that
    plays the policy of another one has the updates of this policy."""
    scalars = {tag: curve for tag, curve in of_all.items() if tag.startswith("self_play/")}
    for name in (member.names.mirrors, member.name):
        prefix = f"{name}/"
        updates = "train/" if name != member.name else ""
        scalars |= {
            tag.removeprefix(prefix): curve
            for tag, curve in of_all.items()
            if tag.startswith(prefix) and tag.removeprefix(prefix).startswith(updates)
        }
    terms = {f"reward/{joint}": f"reward/{term}" for term, joint in member.terms.items()}
    return scalars | {own_tag: of_all[tag] for tag, own_tag in terms.items() if tag in of_all}


def read_training(run: Run) -> TrainingEvidence:
    """Read the logs of a run, without short episodes. Several agents are one, which drives all robots.

    Raises:
        RunError: A log is damaged.
    """
    # Evaluations and worlds of a batch that go on keep failed episodes, too.
    file = latest_failure(run.path) if run.record.status == "failed" else None
    failure = read_failure(file)[0] if file is not None else None
    episodes, evaluations = logs_of(run.path)
    running = run.record.state(run.path) == "training"
    final_episodes: Sequence[Episode] = ()
    if not running and (last := quoted_episodes(run)) is not None:
        final_episodes = last.outcomes
        evaluations.append(_logged(final_episodes))
    verdict = run_verdict(run.path, run.record)
    return TrainingEvidence(
        run, episodes, evaluations, scalars_of(run.tensorboard), failure, final_episodes, verdict, running
    )


_PROBE_EPISODES, _PROBE_STEPS, _CONSTANT_ACTION_STEPS = 4, 300, 40
"""The number of short episodes of each driver (policy, random actions, no commands), the largest number of
their steps, and the number of steps of an episode with a constant action."""
_MAX_OPTIONS, _MAX_RANGES = 4, 8
"""The options of each choice, and the ranges, that have an episode with a constant action."""
_SCRIPT_EPISODES = 8
"""The number of whole episodes of each script. If all 8 succeed, the lower end of the 95 % interval (Wilson)
of the success rate is 68 %."""
_FAILED_EPISODES = 6
"""The number of episodes without success of the quoted evaluation that are repeated."""


def run_probes(
    evidence: TrainingEvidence,
    *,
    permissions: Permissions = Permissions(),
    on_episode: Callable[[int, int], object] = lambda count, total: None,
    seconds: float = math.inf,
) -> None:
    """Run the short episodes of a training, all from the same starts, and put them into its evidence.

    Args:
        permissions: The permissions of the scenario.
        on_episode: Called after each episode with the number so far and in total.
        seconds: The time after which no episode continues.
    """
    from deepbots_cli.learning.sb3.algorithms import torch_settings

    deadline, run = time.monotonic() + seconds, evidence.run
    watch = instrument_program(evidence.program, include_observation=True)
    program = api.build(watch.program, engine=run.record.engine, permissions=permissions)
    with torch_settings(), closing(TraceRecorder(program, watch, run.compiled.units)) as world:
        probes = [*_probes(evidence, world)]
        for number, probe in enumerate(probes, 1):
            if time.monotonic() > deadline:
                break
            error = ""
            try:
                for _ in islice(steps(world, probe.driver(), Start(probe.seed)), probe.steps + 1):
                    if time.monotonic() > deadline:
                        break
            except DeepbotsError as failed:
                error = str(failed)
            probe.keep(world.trace("a short episode", error=error))
            on_episode(number, len(probes))
    for name, traces in evidence.scripts.items():  # without episodes that the deadline has cut
        evidence.scripts[name] = [trace for trace in traces if trace.outcome != "not ended"]
    evidence.failed = _repeat_failed(evidence, deadline, permissions)


class _Probe(NamedTuple):
    """A short episode to run: what keeps its trace, its seed, its driver and its largest number of steps."""

    keep: Callable[[Trace], object]
    seed: int
    driver: Callable[[], Driver]
    steps: int = _PROBE_STEPS


def _probes(evidence: TrainingEvidence, world: TraceRecorder) -> Iterator[_Probe]:
    """Yield the short episodes of a training. Episodes of the three drivers come in turn, so that there are
    some of each after a few seconds."""
    agent, seed = evidence.program.agent, evidence.run.record.seed
    seeds = [derive_seed(seed, "diagnosis", number) for number in range(_SCRIPT_EPISODES)]
    evidence.random, evidence.policy, evidence.idle = [], [], []
    drivers: list[tuple[list[Trace], Callable[[], Driver] | None]] = [
        (evidence.random, partial(random_driver, world)),
        (evidence.policy, _policy_driver(evidence, world)),
    ]
    idle = idle_action(agent.action)
    # Zeros can be commanded.
    if idle is not None and all(interval.low <= 0.0 <= interval.high for interval in agent.ranges):
        drivers.append((evidence.idle, partial(constant_driver, world.world.make_action(*idle))))
    for seed in seeds[:_PROBE_EPISODES]:
        yield from (_Probe(traces.append, seed, driver) for traces, driver in drivers if driver is not None)
    for part, actions in _constant_actions(world.world).items():
        traces_by_name = evidence.constant_actions[part] = {}
        for name, action in actions.items():
            keep, driver = partial(traces_by_name.__setitem__, name), partial(constant_driver, action)
            yield _Probe(keep, seeds[0], driver, _CONSTANT_ACTION_STEPS)
    for name in _scripts_to_play(evidence):
        played = evidence.scripts[name] = []
        for seed in seeds:
            yield _Probe(played.append, seed, partial(named_driver, world, name), evidence.longest)


def _policy_driver(evidence: TrainingEvidence, world: TraceRecorder) -> Callable[[], Driver] | None:
    """Return what makes a driver of the last policy; None before there is one."""
    from deepbots_cli.learning.policy import load_model
    from deepbots_cli.rollout.policies import PolicyDriver

    run = evidence.run
    name: Any = next((name for name in ("last", "best") if run.model(name).is_file()), None)
    return None if name is None else partial(PolicyDriver, load_model(run, name, world), world)


def _repeat_failed(evidence: TrainingEvidence, deadline: float, permissions: Permissions) -> list[Trace]:
    """Repeat the first episodes without success of the quoted evaluation, until the deadline."""
    quoted = (
        quoted_episodes(evidence.run)
        if evidence.final_episodes and evidence.run.program.defines_success
        else None
    )
    if quoted is None or evidence.run.program.agent.copies is not None or time.monotonic() > deadline:
        return []
    numbers = [number for number, episode in enumerate(evidence.final_episodes) if not episode.is_success]
    numbers = numbers[:_FAILED_EPISODES]
    traces = []
    try:
        for trace in trace_episodes(evidence.run, numbers, **quoted.replay_options, permissions=permissions):
            traces.append(trace)
            if time.monotonic() > deadline:
                break
    except DeepbotsError:  # its model is missing, for example
        pass
    return traces


def _scripts_to_play(evidence: TrainingEvidence) -> list[str]:
    """Return the script that teaches the policy, or else those that could teach it; empty if no success
    allows a comparison."""
    agent = evidence.program.agent
    if (
        evidence.agent
        or not evidence.program.defines_success
        or agent.copies is not None
        or agent.training is None
    ):
        return []
    if agent.training.teacher is not None:
        return [agent.training.teacher.script]
    return [script.name for script in agent.scripts]


def _constant_actions(env: Supervisor) -> dict[str, dict[str, Any]]:
    """Return, for each part of the action, constant actions in which it alone differs: the first options of a
    choice, both ends of a range."""
    agent = env.scenario.agent
    picks = {
        choice.name: {option.name: n for n, option in enumerate(choice.options[:_MAX_OPTIONS])}
        for choice in agent.choices
    }
    values: dict[str, Mapping[str, float]] = {
        **picks,
        **{name: {"-1": -1.0, "1": 1.0} for name in agent.range_names[:_MAX_RANGES]},
    }
    return {
        name: {word: action_from_values(env, {name: value}) for word, value in by_name.items()}
        for name, by_name in values.items()
    }
