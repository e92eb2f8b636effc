"""The evidence about a training: its logs, and a few short episodes of its policy and of random actions.

Logs are `monitor.csv`, the TensorBoard files and the evaluations during the training. Nothing is written.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from itertools import islice
from pathlib import Path
from shlex import quote
from statistics import fmean
from typing import Any

import numpy as np

from deepbots_cli import api, engine_kinds
from deepbots_cli.document import Permissions
from deepbots_cli.errors import DeepbotsError
from deepbots_cli.insight.conditions import instrument_program
from deepbots_cli.insight.linted import LintedScenario, linted_scenario, named_source
from deepbots_cli.insight.scenario_facts import ScenarioFacts
from deepbots_cli.insight.statements import EvaluationRate
from deepbots_cli.insight.trace import Array, Trace, TraceRecorder, trace_episodes
from deepbots_cli.learning.failures import FAILURES_FOLDER, Failure, read_failure
from deepbots_cli.learning.runs.changes import ChangedValue, nearest_solved
from deepbots_cli.learning.runs.decline import Decline, find_decline
from deepbots_cli.learning.runs.directories import is_training
from deepbots_cli.learning.runs.episodes import meets_solved
from deepbots_cli.learning.runs.order import measure_of
from deepbots_cli.learning.runs.records import changed_settings
from deepbots_cli.learning.runs.run import Run
from deepbots_cli.learning.runs.verdict import RunVerdict, quoted_episodes, run_verdict
from deepbots_cli.learning.sb3.defaults import effective_hyperparameters
from deepbots_cli.program import CurriculumStage, Program
from deepbots_cli.program.members import Member
from deepbots_cli.program.task import AdaptiveRate, Schedule, idle_action
from deepbots_cli.rollout import Driver, Episode, Start, steps
from deepbots_cli.rollout.drivers import action_from_values, constant_driver, named_driver, random_driver
from deepbots_cli.rollout.episode import own_episode
from deepbots_cli.runtime import Supervisor
from deepbots_cli.runtime.streams import derive_seed
from deepbots_cli.view.training_logs import logs_of, scalars_of

PROBE_EPISODES, PROBE_STEPS, CONSTANT_ACTION_STEPS = 4, 300, 40
"""The number of short episodes of each driver (policy, random actions, no commands), the largest number of
their steps, and the number of steps of an episode with a constant action."""

SCRIPT_EPISODES = 8
"""The number of whole episodes of each script. If all 8 succeed, the lower end of the 95 % interval (Wilson)
of the success rate is 68 %."""

FAILED_EPISODES = 6
"""The number of episodes without success of the quoted evaluation that are repeated."""

MIN_EPISODES = 8
"""The number of episodes below which the returns of a training are not meaningful."""


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
    policy: Sequence[Trace] = ()
    random: Sequence[Trace] = ()
    idle: Sequence[Trace] = ()
    constant_actions: dict[str, Mapping[str, Trace]] = field(default_factory=dict)
    scripts: dict[str, Sequence[Trace]] = field(default_factory=dict)
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
        return quote(named_source(self.run.record.source))

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
        """The step in which the present stage began."""
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
        return self.failure is not None or self.run.record.status == "failed"

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

    @cached_property
    def late_success(self) -> EvaluationRate:
        """The success in the evaluations of the last quarter of the present stage, at least in the last one.

        It has no episodes if the scenario defines no success or nothing was evaluated.
        """
        if not self.program.defines_success:
            return EvaluationRate([])
        begin = self.first_step + 0.75 * self.stage_steps
        late = [evaluation for evaluation in self.evaluations if evaluation.get("steps", 0) > begin]
        return EvaluationRate([evaluation["successes"] for evaluation in late or self.evaluations[-1:]])

    @cached_property
    def settings(self) -> Mapping[str, Any]:
        """The hyperparameters that the training takes, by name."""
        return {
            entry.name: entry.value
            for entry in effective_hyperparameters(self.run.program, self.run.record.total_timesteps)
        }

    def number_setting(self, name: str) -> float | None:
        """Return a hyperparameter as a number, the first one of a schedule; None if it is none."""
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

    # What was learned

    @property
    def solved(self) -> bool:
        """Whether the policy solves the task by `run_verdict`; before its evaluation, also by the evaluations
        of the last stage."""
        solved = self.run.program.agent.solved
        if solved is None or self.final_episodes or self.verdict.solved:
            return bool(self.verdict.solved)
        means = [
            (fmean(evaluation["returns"]), fmean(evaluation["successes"]))
            for evaluation in self.evaluations
            if self.is_last_stage
        ]
        return any(meets_solved(solved, *pair) for pair in means)

    def curve(self, tag: str) -> Array:
        """Return the values of a curve in the present stage, or of `train/...` in all stages; empty if
        TensorBoard has no such tag."""
        if tag not in self.scalars:
            return np.zeros(0)
        steps, values = self.scalars[tag]
        return values[steps > self.first_step] if self.first_step and not tag.startswith("train/") else values


def mean_return(evidence: TrainingEvidence, first: float, last: float) -> float:
    """Return the mean return of `TrainingEvidence.episodes_between`."""
    return float(evidence.episodes_between(first, last).returns.mean())


def returns_rise(evidence: TrainingEvidence) -> tuple[float, float, float, float] | None:
    """Return the mean returns of the first half and of the last quarter of the present stage, their
    difference, and twice its standard error.

    The result is None if the return does not rise, or levels off.
    """
    early, late = evidence.episodes_between(0.0, 0.5).returns, evidence.episodes_between(0.75, 1.0).returns
    if len(evidence.episodes) < 2 * MIN_EPISODES:
        return None
    gain = float(late.mean() - early.mean())
    chance = 2 * float(np.hypot(early.std() / np.sqrt(len(early)), late.std() / np.sqrt(len(late))))
    # A return that rises evenly gains a third of its total rise in the last quarter; below half of that it
    # levels off.
    start, before = mean_return(evidence, 0.0, 0.25), mean_return(evidence, 0.5, 0.75)
    if not gain > chance > 0 or late.mean() - before < (late.mean() - start) / 6:
        return None
    return float(early.mean()), float(late.mean()), gain, chance


def usual_settings(evidence: TrainingEvidence) -> Mapping[str, Any]:
    """Return the hyperparameters that the training would take if the scenario gave none, by name."""
    program = evidence.run.program
    training = program.agent.training
    if training is None:
        return {}
    bare = replace(training, hyperparameters=(), action_noise=None, replay=None)
    unset = program.with_agent(training=bare)
    return {
        entry.name: entry.value
        for entry in effective_hyperparameters(unset, evidence.run.record.total_timesteps)
    }


def training_command(run: Run, assignments: Sequence[str]) -> list[str]:
    """Return the command that trains the scenario of a run again, with its seed, options and `--set`, and
    further assignments."""
    record, settings = run.record, dict[str, str]()
    for text in (*changed_settings(record.command), *assignments):
        path, _, value = text.partition("=")
        settings.pop(path, None)
        settings[path] = value
    words = ["deepbots", "train", named_source(record.source), "--seed", str(record.seed)]
    training = run.program.agent.training
    if (
        training is not None
        and record.total_timesteps != training.total_timesteps
        and "train.total_timesteps" not in settings
    ):
        words += ["--timesteps", str(record.total_timesteps)]
    teacher = (
        training.teacher
        if training is not None and any(word.partition("=")[0] == "--teacher" for word in record.command)
        else None
    )
    words += [] if teacher is None or "train.teacher" in settings else ["--teacher", teacher.script]
    words += ["--teacher", str(run.demonstrations)] if run.demonstrations.exists() else []
    words += ["--teacher", str(run.teacher)] if run.teacher.exists() else []
    words += [word for path, value in settings.items() for word in ("--set", f"{path}={value}")]
    is_given = any(word.partition("=")[0] == "--engine" for word in record.command)
    words += (
        ["--engine", record.engine]
        if is_given or record.engine != engine_kinds.chosen(run.program.engine)
        else []
    )
    words += [] if record.first_stage is None else ["--stage", record.first_stage]
    words += [] if record.stop_when_solved else ["--full"]
    return [*words, *(["--allow-code"] if "--allow-code" in record.command else [])]


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
        returns, successes = (
            [episode.total_return for episode in final_episodes],
            [episode.is_success for episode in final_episodes],
        )
        evaluations.append({"stage": "", "returns": returns, "successes": successes})
    rivals = [name for name in members if run.program.has_rivals and name != agent]
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
            name: np.array(
                [
                    members[name].has_succeeded((ending,) if ending else ())
                    for ending in of_all.all_episodes.endings
                ],
                float,
            )
            for name in rivals
        },
    )


def _scalars_of_agent(of_all: Mapping[str, Any], member: Member) -> dict[str, Any]:
    """Return the scalars of one of several agents under its own tags, and those of all agents; an agent that
    plays the policy of another one has the updates of this policy."""
    scalars = {tag: curve for tag, curve in of_all.items() if tag.startswith("self_play/")}
    for name in (member.names.mirrors, member.name):
        prefix = f"{name}/"
        updates = ("train/", "critic/") if name != member.name else ("",)
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
    file = latest_failure(run.path)
    failure = read_failure(file)[0] if file is not None else None
    episodes, evaluations = logs_of(run.path)
    running = is_training(run.path)
    final_episodes: Sequence[Episode] = ()
    if not running and (last := quoted_episodes(run)) is not None:
        final_episodes = last[1].outcomes
        returns, successes = (
            [episode.total_return for episode in final_episodes],
            [episode.is_success for episode in final_episodes],
        )
        evaluations.append({"stage": "", "returns": returns, "successes": successes})
    verdict = run_verdict(run.path, run.record)
    return TrainingEvidence(
        run, episodes, evaluations, scalars_of(run.tensorboard), failure, final_episodes, verdict, running
    )


def run_probes(
    training: TrainingEvidence,
    *,
    permissions: Permissions = Permissions(),
    on_episode: Callable[[int, int], object] | None = None,
    seconds: float = math.inf,
) -> None:
    """Run the short episodes of a training, all from the same starts. No episode continues after
    `seconds`."""
    from deepbots_cli.learning.sb3.algorithms import torch_settings

    probes = _Probes(training, time.monotonic() + seconds, permissions, on_episode)
    with torch_settings(), closing(probes.world):
        probes.play()
    training.failed = _repeat_failed(training, probes.deadline, permissions)


class _Probes:
    """The short episodes of a training.

    Args:
        training: Takes their traces.
        deadline: The end by the monotonic clock, in s; no episode continues after it.
        permissions: The permissions of the scenario.
        on_episode: Called after each episode with the number so far and in total.
    """

    def __init__(
        self,
        training: TrainingEvidence,
        deadline: float,
        permissions: Permissions,
        on_episode: Callable[[int, int], object] | None,
    ) -> None:
        self._training, self.deadline, self._on_episode = training, deadline, on_episode
        run, watch = training.run, instrument_program(training.program, include_observation=True)
        program = api.build(watch.program, engine=run.record.engine, permissions=permissions)
        self.world = TraceRecorder(program, watch, run.compiled.units)
        self._done, self._total = 0, 0

    def play(self) -> None:
        training, world = self._training, self.world
        constant, idle = _constant(world.world), self._idle_action()
        policy, scripts = self._policy_driver(), _teachers(training)
        kinds = 1 + (idle is not None) + (policy is not None)
        self._total = PROBE_EPISODES * kinds + sum(map(len, constant.values()))
        self._total += SCRIPT_EPISODES * len(scripts)
        seeds = self._seeds(PROBE_EPISODES)
        random, played, still = list[Trace](), list[Trace](), list[Trace]()
        for seed in seeds:  # of each kind one after the other, so that a few seconds show something of all
            random += self._episode(seed, random_driver(world))
            if policy is not None:
                played += self._episode(seed, policy())
            if idle is not None:
                still += self._episode(seed, constant_driver(world.world.make_action(*idle)))
        training.random, training.policy, training.idle = random, played, still
        for part, actions in constant.items():
            traces = {
                name: self._episode(seeds[0], constant_driver(action), CONSTANT_ACTION_STEPS)
                for name, action in actions.items()
            }
            training.constant_actions[part] = {
                name: action_traces[0] for name, action_traces in traces.items() if action_traces
            }
        longest = training.program.truncation.max_episode_steps(training.program.period)
        for name in scripts:
            episodes = [
                trace
                for seed in self._seeds(SCRIPT_EPISODES)
                for trace in self._episode(seed, named_driver(world, name), longest)
            ]
            # The deadline cut the others.
            training.scripts[name] = [trace for trace in episodes if trace.outcome != "not ended"]

    def _seeds(self, count: int) -> list[int]:
        seed = self._training.run.record.seed
        return [derive_seed(seed, "diagnosis", number) for number in range(count)]

    def _idle_action(self) -> Any:
        """Return the action that commands zeros; None where a range has no zero."""
        agent = self._training.program.agent
        has_zeros = all(interval.low <= 0.0 <= interval.high for interval in agent.ranges)
        return idle_action(agent.action) if has_zeros else None

    def _policy_driver(self) -> Callable[[], Driver] | None:
        """Make a driver of the last policy; None before there is one."""
        from deepbots_cli.learning.evaluation import load_model
        from deepbots_cli.rollout.policies import PolicyDriver

        run = self._training.run
        name: Any = next((name for name in ("last", "best") if run.model(name).is_file()), None)
        return None if name is None else partial(PolicyDriver, load_model(run, name, self.world), self.world)

    def _episode(self, seed: int, driver: Driver, count: int = PROBE_STEPS) -> list[Trace]:
        """Return the trace of an episode of at most `count` steps, in a list; empty after the deadline."""
        if time.monotonic() > self.deadline:
            return []
        error = ""
        try:
            for _ in islice(steps(self.world, driver, Start(seed)), count + 1):
                if time.monotonic() > self.deadline:
                    break
        except DeepbotsError as failed:
            error = str(failed)
        self._done += 1
        if self._on_episode is not None:
            self._on_episode(self._done, self._total)
        return [self.world.trace("a short episode", error=error)]


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
    numbers = numbers[:FAILED_EPISODES]
    traces = []
    try:
        for trace in trace_episodes(
            evidence.run, numbers, **quoted[1].replay_options, permissions=permissions
        ):
            traces.append(trace)
            if time.monotonic() > deadline:
                break
    except DeepbotsError:  # its model is missing, for example
        pass
    return traces


def _teachers(evidence: TrainingEvidence) -> list[str]:
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


def _constant(env: Supervisor) -> dict[str, dict[str, Any]]:
    """Return, for each part of the action, constant actions in which it alone differs: the first options of a
    choice, both ends of a range."""
    agent = env.scenario.agent
    picks = {
        choice.name: {option.name: n for n, option in enumerate(choice.options[:4])}
        for choice in agent.choices
    }
    values: dict[str, Mapping[str, float]] = {
        **picks,
        **{name: {"-1": -1.0, "1": 1.0} for name in agent.range_names[:8]},
    }
    return {
        name: {word: action_from_values(env, {name: value}) for word, value in by_name.items()}
        for name, by_name in values.items()
    }
