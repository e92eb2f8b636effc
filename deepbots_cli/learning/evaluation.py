"""Evaluation: a trained policy on held-out episodes, with intervals and a verdict; and match-ups of policies
and scripts of two agents, all on the same held-out starts.

Every player of the first agent meets every player of the second one. Where one agent mirrors the other,
a player takes both sides: each pair plays every start twice, with the sides swapped.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing
from itertools import chain, combinations, pairwise, product
from pathlib import Path
from statistics import fmean
from typing import Any, NamedTuple

from pydantic import BaseModel

from deepbots_cli import api
from deepbots_cli.analysis import possible_returns
from deepbots_cli.api import Compiled
from deepbots_cli.compiler.inputs import RESOLVED_NAME
from deepbots_cli.document import Permissions
from deepbots_cli.errors import RunError, UsageError
from deepbots_cli.learning.environments import EvaluationWorlds, WorldFactory, supervisor_factory
from deepbots_cli.learning.executor import SERIAL, Attempt, Executor, Watcher, results
from deepbots_cli.learning.policy import load_model, loaded
from deepbots_cli.learning.runs.episodes import Scores, agent_scores
from deepbots_cli.learning.runs.evaluations import (
    EvaluationResult,
    draw_labels,
    in_parentheses,
    remark_on_episodes,
)
from deepbots_cli.learning.runs.run import ModelName, ModelRef, Run, steps_of
from deepbots_cli.learning.runs.statistics import ALPHA, UNBOUNDED, Interval, error_level, wilson
from deepbots_cli.learning.runs.verdict import quoted_episodes, solved_verdict
from deepbots_cli.learning.sb3.algorithms import torch_settings
from deepbots_cli.program import RANDOM, ZERO, Program, identity
from deepbots_cli.records import dataclass
from deepbots_cli.rollout import Episode, Start, play
from deepbots_cli.rollout.drivers import AgentsDriver, named_driver
from deepbots_cli.rollout.episode import OnEpisode, own_episode
from deepbots_cli.rollout.policies import StopCondition, ordered_episodes
from deepbots_cli.rollout.source import RECORD_NAME
from deepbots_cli.runtime.spaces import FORWARD_BATCH_SIZE, Predictor
from deepbots_cli.runtime.streams import derive_seed
from deepbots_cli.scenario import Scenario
from deepbots_cli.words import rate_text, shell_word

MAX_BATCH_WORLDS = 32
"""The number of worlds of a batch. The array operations of a batch take as long per step as 5 single worlds,
and worlds that end early are idle at the end."""


def evaluate(
    run: ModelRef | Run | str | Path,
    *,
    episodes: int | None = None,
    seed: int | None = None,
    deterministic: bool = True,
    model: ModelName = "best",
    scenario: Compiled | Scenario | str | Path | None = None,
    case: str | None = None,
    stage: str | None = None,
    permissions: Permissions = Permissions(),
    engine: str | None = None,
    build: WorldFactory | None = None,
    on_episode: OnEpisode | None = None,
    until: StopCondition | None = None,
    executor: Executor = SERIAL,
) -> EvaluationResult:
    """Evaluate the policy of a run on episodes that it was not trained on.

    Each episode has its own seed, derived from `seed` and the episode number. The result therefore does not
    depend on how many run at once, and the first ten of a hundred episodes are the same as in an evaluation
    of ten episodes. Training episodes use other seeds. All cases use the same seeds, so they differ only in
    their settings.

    Args:
        run: The run, its directory, or the file of a model in it.
        episodes: Number of episodes; by default that of the scenario, or as many as its `solved` asks for if
            these are more.
        seed: Root seed of the episodes, from 0; by default that of the training. Without `episodes`, it is
            that of the confirmation which ended the training: an evaluation of the best model then repeats
            it.
        deterministic: Whether the policy takes its most likely action; otherwise it samples actions, also
            from seeded streams.
        model: The name of the model where `run` names none: `best`, `last`, `step-000020000`.
        scenario: Another scenario to evaluate in, as for `train`; its observation, action and messages must
            be those of the run.
        case: Name of the case of `evaluation` to evaluate in.
        stage: Name of the stage of the curriculum to evaluate in.
        permissions: With `code`, the scenario may run functions of installed Python packages.
        engine: The physics engine; by default that of the training, or of `scenario` if it names another.
        build: Function that makes a world of the scenario, in place of the generated supervisor.
        on_episode: Called after each episode with the number of finished episodes and the number of all
            episodes.
        until: Called with the first k episodes for k = 1, 2, ...; return True to stop. The result then
            contains only these k episodes.
        executor: Where the episodes run; the result does not depend on it.

    Raises:
        RunError: The folder is not a run, is damaged, or does not match `scenario`; the message lists the
            differences by field.
        UsageError: A number is out of range.
    """
    ref = ModelRef.open(run, model=model)
    model = ref.name
    setting = _Setting(ref.run, episodes, seed, scenario, case, stage, permissions, engine, build)
    policy = _Policy(model, deterministic)
    rounds = math.ceil(setting.episodes / FORWARD_BATCH_SIZE)
    if executor.is_here or rounds == 1:
        outcomes = setting.play(range(setting.episodes), policy, on_episode, until)
        return setting.result(model, outcomes, deterministic=deterministic)
    if build is not None:
        raise UsageError("`build` makes worlds in this process only; leave out the workers")
    parts = min(executor.workers, rounds)
    # Each begins with row 0 of a forward pass, as in this process.
    bounds = [
        min(setting.episodes, FORWARD_BATCH_SIZE * (rounds * part // parts)) for part in range(parts + 1)
    ]
    part_options: dict[str, Any] = {
        "episodes": episodes,
        "seed": seed,
        "scenario": setting.judged,
        "case": case,
        "stage": stage,
    }
    part_options |= {"permissions": permissions, "engine": engine}
    calls = [_Part(setting.run, part_options, range(*part), policy) for part in pairwise(bounds)]
    watcher = FinishedEpisodes(on_episode, setting.episodes)
    with closing(
        results(executor.map(_play_part, calls, watcher=watcher, files=[setting.run.path / RECORD_NAME]))
    ) as played:
        outcomes = ordered_episodes(
            enumerate(chain.from_iterable(played)), range(setting.episodes), until=until
        )
    return setting.result(model, outcomes, deterministic=deterministic)


@dataclass(frozen=True)
class _Policy:
    """The options of `evaluate` for choosing actions, under the names of its arguments."""

    model: ModelName
    deterministic: bool


class _Part(NamedTuple):
    """Some of the episodes of an evaluation. `options` are the arguments of a `_Setting`."""

    run: Run
    options: dict[str, Any]
    numbers: range
    policy: _Policy


def _play_part(part: _Part, attempt: Attempt) -> list[Episode]:
    return _Setting(part.run, **part.options).play(
        part.numbers, part.policy, lambda count, total: attempt.report(count)
    )


def planned_episodes(run: Run, *options: Any, **further_options: Any) -> int:
    """Return the number of episodes of `evaluate` without `until`, for its options."""
    return _Setting(run, *options, **further_options).episodes


class FinishedEpisodes(Watcher):
    """Calls a function with the number of finished episodes of all calls, which report theirs, and the number
    of all."""

    def __init__(self, show: OnEpisode | None, total: int) -> None:
        self._show = show
        self._done = {0: 0}
        self._total = total

    def on_report(self, item: int, value: object) -> None:
        # A part that is repeated reports from 0 again.
        if isinstance(value, int) and value > self._done.get(item, 0):
            self._done[item] = value
            if self._show is not None:
                self._show(sum(self._done.values()), self._total)

    def on_done(self, item: int, outcome: object) -> None:
        self.on_report(item, len(outcome) if isinstance(outcome, list) else None)


def confirmation_result(run: Run, number: int, seed: int, episodes: Sequence[Episode]) -> EvaluationResult:
    """Return the confirmation that ended a training as an evaluation of its best model.

    Args:
        run: The run.
        number: The number of the confirmation, from 1.
        seed: The root seed of its starts.
        done: Its episodes.
    """
    return _Setting(run, len(episodes), seed).result("best", episodes, confirmation=number)


def evaluate_trained(
    run: Run, *, permissions: Permissions = Permissions(), on_episode: OnEpisode | None = None
) -> EvaluationResult:
    """Return the evaluation after a training: the confirmation that ended it, or else new episodes.

    The confirmation is in the run already. The number of new episodes is that of `solved`. If they meet it
    and so few may do so by luck, more are played.
    """
    quoted = quoted_episodes(run)
    if quoted is None or quoted.confirmation is None:
        result = evaluate(run, permissions=permissions, on_episode=on_episode)
        required = result.required_episodes or 0
        if result.solved is None and required > result.episodes:
            return evaluate(run, episodes=required, permissions=permissions, on_episode=on_episode)
        return result
    return confirmation_result(run, quoted.confirmation or 1, quoted.seed, quoted.outcomes)


def until_enough(
    result: EvaluationResult, until: StopCondition, run: Run, **options: Any
) -> EvaluationResult:
    """Return the result that `evaluate` has with the same `options` and `until`, from a result with all
    episodes.
    """
    for count in range(1, result.episodes):
        if until(result.outcomes[:count]):
            other_options = ("model", "deterministic", "on_episode")
            setting = _Setting(
                run, **{name: value for name, value in options.items() if name not in other_options}
            )
            return setting.result(result.model, result.outcomes[:count], deterministic=result.deterministic)
    return result


def evaluate_baselines(
    run: Run | str | Path,
    *,
    episodes: int | None = None,
    seed: int | None = None,
    scenario: Compiled | Scenario | str | Path | None = None,
    case: str | None = None,
    stage: str | None = None,
    permissions: Permissions = Permissions(),
    engine: str | None = None,
    build: WorldFactory | None = None,
    on_episode: OnEpisode | None = None,
) -> tuple[EvaluationResult, ...]:
    """Evaluate policies without learning on the starts of `evaluate`: random actions, zero actions, and each
    script of the scenario.

    Arguments and errors are as for `evaluate`. The `model` of a result is `random`, `zero` or `script NAME`.
    Random actions are sampled by the action space, which the seed of each episode seeds.
    """
    setting = _Setting(run, episodes, seed, scenario, case, stage, permissions, engine, build)
    scripts = {f"script {script.name}": script.name for script in setting.program.agent.scripts}
    starts = [Start.of_evaluation(setting.seed, number) for number in range(setting.episodes)]
    results = []
    with closing(setting.build(setting.program)) as world:
        for name, driver in {RANDOM: RANDOM, ZERO: ZERO, **scripts}.items():
            finished = enumerate(play(world, named_driver(world, driver), start) for start in starts)
            results.append(setting.result(name, ordered_episodes(finished, range(len(starts)), on_episode)))
    return tuple(results)


def evaluate_cases(
    run: Run | str | Path,
    *,
    scenario: Compiled | Scenario | str | Path | None = None,
    stages: bool = False,
    **options: Any,
) -> tuple[EvaluationResult, ...]:
    """Evaluate in every case of the scenario, in file order, and with `stages` in every stage of its
    curriculum too.

    `options` are those of `evaluate`, except for `case`, `stage` and `until`.
    """
    opened = run if isinstance(run, Run) else Run.open(run)
    judged = None if scenario is None else api.compile(scenario)
    program = opened.program if judged is None else judged.program
    cases = [evaluate(opened, scenario=judged, case=case.name, **options) for case in program.cases]
    return (
        *cases,
        *(
            evaluate(opened, scenario=judged, stage=stage.name, **options)
            for stage in program.curriculum
            if stages
        ),
    )


class _Setting:
    """The scenario and the starts on which a policy is evaluated.

    Attributes:
        judged: A scenario that replaces that of the run.
        program: The case or stage in which the policy is evaluated.
        engine: The engine; None for worlds of the caller.
    """

    def __init__(
        self,
        run: Run | str | Path,
        episodes: int | None = None,
        seed: int | None = None,
        scenario: Compiled | Scenario | str | Path | None = None,
        case: str | None = None,
        stage: str | None = None,
        permissions: Permissions = Permissions(),
        engine: str | None = None,
        build: WorldFactory | None = None,
    ) -> None:
        self.run = run = run if isinstance(run, Run) else Run.open(run)
        self.judged = None if scenario is None else api.compile(scenario)
        program = (self.judged or run).program
        self._is_part = program.others is not None and bool(run.program.members)
        """Whether one of several agents that the run trained is evaluated."""
        if program.others is not None and self._is_part:
            self.run = run = run.of_agent(program.others.agent)
        if self.judged is not None and (differences := identity.differences(run.program, program)):
            lines = "\n  ".join(differences)
            raise RunError(
                f"{run.path} was trained with other observations, actions or messages than {program.name}"
                f" defines:\n  {lines}"
            )
        self.program = program.variant(case, stage)
        self.case = case
        self.stage = stage
        self.seed = run.evaluation_seed if seed is None else seed
        engine = engine or run.engine_for(self.program)
        self.engine = None if build else engine
        result = run.record.result
        best = result.best if result is not None and result.confirmed_seed == self.seed else None
        confirmed = None if best is None else best.episodes
        usual = (self.judged or run).program.evaluation_episodes(case)
        if self._is_of_training and confirmed is not None:
            usual = confirmed
        self.episodes = usual if episodes is None else episodes
        if seed is None and confirmed is not None and episodes not in (None, confirmed):
            # The episodes of the confirmation are a selected sample: all of them were needed to pass.
            self.seed = run.record.seed
        if self.episodes < 1 or self.seed < 0:
            raise UsageError(
                f"episodes must be at least 1 and the seed at least 0, not {self.episodes} and {self.seed}"
            )
        self.build = build or supervisor_factory(engine, permissions=permissions)

    def play(
        self,
        numbers: range,
        policy: _Policy,
        on_episode: OnEpisode | None = None,
        until: StopCondition | None = None,
    ) -> list[Episode]:
        """Play the episodes of these numbers, the first of which is a multiple of `FORWARD_BATCH_SIZE`."""
        seeds = [derive_seed(self.seed, "evaluation", k) for k in range(numbers.stop)]
        count = len(numbers)
        engine = self.engine if self.engine and policy.deterministic else ""
        run = self.run if self.judged is None else None
        evaluation_worlds = EvaluationWorlds(
            self.build, run, engine=engine, batch=min(count, MAX_BATCH_WORLDS)
        )
        with torch_settings(), closing(evaluation_worlds) as worlds:
            worlds.enter(self.program, case=self.case, stage=self.stage)
            model = load_model(self.run, policy.model, worlds.first)
            return worlds.play(
                model,
                seeds,
                numbers,
                deterministic=policy.deterministic,
                on_episode=on_episode,
                until=until,
            )

    @property
    def _is_of_training(self) -> bool:
        """Whether the scenario and the engine are those of the training."""
        return (self.judged, self.case, self.stage, self.engine) == (None, None, None, self.run.record.engine)

    @property
    def _has_confirmed_starts(self) -> bool:
        """Whether these are the starts, scenario and engine of the confirmation that ended the training."""
        result = self.run.record.result
        is_same_seed = result is not None and result.confirmed_seed == self.seed
        return is_same_seed and self._is_of_training

    def result(
        self,
        model: str,
        episodes: Sequence[Episode],
        *,
        deterministic: bool = True,
        confirmation: int | None = None,
    ) -> EvaluationResult:
        """Return the result of these episodes. `confirmation` is the number of the confirmation that they
        repeat."""
        run = self.run
        program = self.program
        engine = self.engine
        if confirmation is None and model == "best" and deterministic and self._has_confirmed_starts:
            assert run.record.result is not None
            confirmation = run.record.result.confirmations
        # A world of the caller may pay anything.
        low, high = possible_returns(program) if engine else UNBOUNDED
        file = run.model(model)
        result = run.record.result
        needs_no_confirmation = confirmation is not None or (
            result is not None
            and result.confirmed_seed is not None
            and model == "best"
            and self._is_of_training
        )
        number = 1 if result is None else result.confirmations + 1
        verdict = solved_verdict(
            program.agent.solved, episodes, (low, high), None if needs_no_confirmation else number
        )
        elsewhere, overrides = self._elsewhere()
        circumstances = self._circumstances(model, elsewhere, overrides, deterministic=deterministic)
        remarks = (*circumstances, *remark_on_episodes(len(episodes), self.episodes, None))
        return EvaluationResult.of_episodes(
            episodes,
            (low, high),
            ALPHA if confirmation is None else error_level(confirmation),
            run=run.path,
            scenario=program.name,
            model=model,
            model_steps=steps_of(file) if file.is_file() else None,
            confirmation=confirmation,
            success_defined=program.defines_success,
            solved=verdict.solved,
            answer=verdict.text,
            verdict=verdict.text + in_parentheses(remarks),
            circumstances=circumstances,
            engine=engine,
            case=self.case,
            stage=self.stage,
            elsewhere=elsewhere,
            set=overrides,
            digest=(self.judged or run).digest,
            agent=program.agent.name if program.others is None else program.others.agent,
            against=None if program.others is None else program.others.text,
            agents=agent_scores(program.members, episodes),
            seed=self.seed,
            planned=self.episodes,
            required_episodes=verdict.required_episodes,
            deterministic=deterministic,
            notes=tuple(self._notes(len(episodes), confirmation)),
            outcomes=tuple(episodes),
            draws=draw_labels(program, (self.judged or run.compiled).units),
            return_bounds=(low if low > -math.inf else None, high if high < math.inf else None),
        )

    def _notes(self, episodes: int, confirmation: int | None) -> Iterator[str]:
        yield from self.run.notes()
        yield from identity.timing_differences(self.run.program, self.program)
        if confirmation is not None:
            yield (
                f"these starts confirmed that the task is solved (confirmation {confirmation}), and ended"
                " the training; `deepbots eval RUN --seed 1` plays other starts"
            )
        if self.engine and episodes > 1 and not self.program.draws.vary_start:
            yield (
                f"a reset draws nothing, so all {episodes} episodes begin in the same state, and intervals"
                " say nothing about other starts"
            )

    def _circumstances(
        self, model: str, elsewhere: str | None, overrides: Sequence[str], *, deterministic: bool
    ) -> tuple[str, ...]:
        """Return notes on how this evaluation differs from the training, or from an ordinary evaluation."""
        run = self.run
        trained_in = self.run.record.engine
        lines = [f"scenario {elsewhere}"] if elsewhere else []
        if not elsewhere and run.record.digest not in ((self.judged or run).digest, run.digest):
            lines.append("scenario changed since the training")
        lines += [f"--set {shell_word(text)}" for text in overrides]
        if self.case:
            lines.append(f"case {self.case}")
        if self.stage:
            lines.append(f"stage {self.stage}")
        if self.engine not in (None, trained_in):
            lines.append(f"engine {self.engine}, trained in {trained_in}")
        if model != "best":
            lines.append(f"{model} model" if run.model(model).is_file() else f"actions of {model}")
        if not deterministic:
            lines.append("actions sampled")
        return tuple(lines)

    def _elsewhere(self) -> tuple[str | None, tuple[str, ...]]:
        """Return the name of a scenario that replaces that of the run, and the assignments of `--set`,
        without that of another engine."""
        judged = self.judged
        if judged is None or (judged.digest == self.run.record.digest and not self._is_part):
            return None, ()
        path = self.run.path.resolve()
        # The scenario of a group is that of its runs, which are in its folder.
        is_own = judged.source.resolve() in (path / RESOLVED_NAME, path.parent / RESOLVED_NAME)
        name = (
            judged.source.name
            if judged.source.name != RESOLVED_NAME
            else f"{judged.source.parent.name}/{RESOLVED_NAME}"
        )
        other_overrides = tuple(text for text in judged.overrides if text != f"world.engine={self.engine}")
        return None if is_own else name, other_overrides or (
            judged.overrides if self.engine == self.run.record.engine else ()
        )


POLICY = "policy"
"""The name of the policy of the first run among the players."""


class Match(BaseModel, frozen=True):
    """The episodes of two players.

    Attributes:
        row: The player of the first agent.
        column: The player of the second agent.
        episodes: The number of episodes; twice that of the starts where players take both sides.
        endings: The number of episodes that each ending ended, by its name.
        mean_seconds: The mean duration of an episode in s of simulated time.
        agents: The scores of each agent by name; empty where players take both sides.
        wins: The number of episodes that are a success for the row alone; None unless players take both
            sides. `losses` are successes of the column alone.
        win_rate: The share of the wins among wins and losses, with `win_interval` at 95 %; None without any.
    """

    row: str
    column: str
    episodes: int
    endings: Mapping[str, int]
    mean_seconds: float
    agents: Mapping[str, Scores] = {}
    wins: int | None = None
    losses: int | None = None
    win_rate: float | None = None
    win_interval: Interval | None = None


class MatchTable(BaseModel, frozen=True):
    """The matches of all players.

    Attributes:
        scenario: The name of the scenario.
        agents: The first and the second agent.
        rows: The players of the first agent; `columns` those of the second one.
        is_symmetric: Whether every player takes both sides.
        success_defined: Whether an ending is a success for the first agent.
        starts: The number of held-out starts of each match, from `seed`.
        notes: A sentence for each policy that is not clearly better than random actions.
    """

    scenario: str
    agents: tuple[str, str]
    rows: tuple[str, ...]
    columns: tuple[str, ...]
    is_symmetric: bool
    success_defined: bool
    starts: int
    seed: int
    matches: tuple[Match, ...]
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class Player:
    """A policy, or the name of a driver, for each agent that it can play."""

    name: str
    drivers: Mapping[str, str | Predictor]


def play_matches(
    runs: Sequence[str | Path | ModelRef],
    *,
    scenario: str | Path | Compiled | None = None,
    episodes: int | None = None,
    seed: int | None = None,
    engine: str | None = None,
    on_episode: OnEpisode | None = None,
    permissions: Permissions = Permissions(),
) -> MatchTable:
    """Play the policies of runs, the scripts of the scenario and random actions against each other.

    Args:
        runs: Runs of all agents or of one of them, or models of such runs.
        scenario: The scenario, which scripts alone play without `runs`; by default that of the first run.
        episodes: The number of starts of each match; by default that of the scenario.
        seed: Root seed of the starts; by default that of the evaluation of the first run, or 0.
        engine: The physics engine; by default that of the first training, or of the scenario.
        on_episode: Called after each episode with the number of finished episodes, and of all.
        permissions: From which folders a `scenario` may read, and whether its Python functions, or those of
            the first run, may be run.

    Raises:
        RunError: One of these is not a run, or is damaged.
        ScenarioError: The scenario has findings at error level.
        UsageError: The scenario does not have two agents, or the agents of a run are others.
    """
    refs = [run if isinstance(run, ModelRef) else ModelRef.open(run) for run in runs]
    first = refs[0].run if refs else None
    program = _played_program(first, scenario, permissions)
    if seed is None:
        seed = 0 if first is None else first.evaluation_seed
    starts = [
        Start.of_evaluation(seed, number) for number in range(episodes or program.evaluation_episodes())
    ]
    first_agent, second_agent = program.members
    is_symmetric = program.is_symmetric
    policies = _policies(program, refs, is_symmetric=is_symmetric)
    players = [*policies, *_scripted(program)]
    if is_symmetric:
        players = [player for player in players if len(player.drivers) == len(program.members)]
    rows = [player for player in players if first_agent in player.drivers]
    columns = [player for player in players if second_agent in player.drivers]
    pairs = [*combinations(rows, 2)] if is_symmetric else [*product(rows, columns)]
    count = 0
    total = len(pairs) * len(starts) * (2 if is_symmetric else 1)

    def counted(outcomes: Iterator[Episode]) -> Iterator[Episode]:
        nonlocal count
        for episode in outcomes:
            count += 1
            if on_episode is not None:
                on_episode(count, total)
            yield episode

    matches: list[Match] = []
    engine = engine or (None if first is None else first.record.engine)
    with torch_settings(), closing(api.build(program, engine=engine, permissions=permissions)) as world:

        def played(as_one: Player, as_two: Player) -> list[Episode]:
            driver = AgentsDriver(
                world, {first_agent: as_one.drivers[first_agent], second_agent: as_two.drivers[second_agent]}
            )
            return [*counted(play(world, driver, start) for start in starts)]

        for a, b in pairs:
            outcomes = played(a, b)
            if is_symmetric:
                matches.append(_both_sides(program, a, b, outcomes, played(b, a)))
            else:
                matches.append(
                    _match(program, a, b, outcomes, agents=agent_scores(program.members, outcomes))
                )
    return MatchTable(
        scenario=program.name,
        agents=(first_agent, second_agent),
        rows=tuple(player.name for player in rows),
        columns=tuple(player.name for player in columns),
        is_symmetric=is_symmetric,
        success_defined=program.members[first_agent].defines_success,
        starts=len(starts),
        seed=seed,
        matches=tuple(matches),
        notes=tuple(_like_random(program, [player.name for player in policies], matches)),
    )


def _share(rate: float | None, low: float, high: float) -> str:
    return f"{rate_text(rate or 0.0)} ({rate_text(low)} .. {rate_text(high)})"


def _like_random(program: Program, policies: Sequence[str], matches: Sequence[Match]) -> Iterator[str]:
    """Yield a sentence for each policy whose success is not clearly above that of random actions."""
    for name in policies:
        for match in matches:
            if match.win_interval is not None and (match.row, match.column) == (name, RANDOM):
                low, high = match.win_interval
                if low <= 0.5:
                    yield (
                        f"{name} is not clearly better than random actions: against them, it wins"
                        f" {_share(match.win_rate, low, high)} of the decided episodes"
                    )
        for agent, side in zip(program.members, ("row", "column"), strict=True):
            acting, random = (
                [match.agents[agent] for match in matches if match.agents and getattr(match, side) == player]
                for player in (name, RANDOM)
            )
            if not acting or not random or acting[0].success_rate is None:
                continue
            episodes = sum(scores.episodes for scores in acting)
            rate, chance = (
                fmean(scores.success_rate or 0.0 for scores in group) for group in (acting, random)
            )
            low, high = wilson(round(rate * episodes), episodes)
            if low <= chance:
                yield (
                    f"as {agent}, {name} is not clearly better than random actions: against all opponents, it"
                    f" succeeds in {_share(rate, low, high)}, random actions in {rate_text(chance)}"
                )


def _played_program(
    run: Run | None, scenario: str | Path | Compiled | None, permissions: Permissions
) -> Program:
    """Return the program of both agents: of the scenario, or of the run."""
    if scenario is not None:
        program = _world_of(api.compile(scenario, permissions=permissions).program)
    elif run is not None:
        program = _world_of(run.program)
    else:
        raise UsageError("a match needs a run or a scenario")
    if len(program.members) != 2:
        raise UsageError(
            f"a match needs a scenario with two agents; {program.name} has {max(1, len(program.members))}"
        )
    return program


def _world_of(program: Program) -> Program:
    """Return the program of all agents."""
    return program if program.others is None else program.others.world


def _policies(program: Program, refs: Sequence[ModelRef], *, is_symmetric: bool) -> list[Player]:
    """Return the player of each model; of several with one label, the path is the name."""
    labels = [POLICY if ref is refs[0] else ref.label for ref in refs]
    return [
        Player(
            label if labels.count(label) == 1 else str(ref.shown_path),
            _drivers(program, ref, is_symmetric=is_symmetric),
        )
        for label, ref in zip(labels, refs, strict=True)
    ]


def _scripted(program: Program) -> list[Player]:
    """Return the scripts of both agents as players, and random actions."""
    scripts: dict[str, dict[str, str | Predictor]] = {}
    for agent, member in program.members.items():
        for name in (*(script.name for script in member.program.agent.scripts), RANDOM):
            scripts.setdefault(name, {})[agent] = name
    return [Player(name, drivers) for name, drivers in scripts.items()]


def _drivers(program: Program, ref: ModelRef, *, is_symmetric: bool) -> dict[str, str | Predictor]:
    """Return the policies in a model: of all agents, or of the one that its run trained."""
    run = ref.run
    world = _world_of(ref.run.program)
    if differing := identity.differences(world, program):
        lines = "\n  ".join(differing)
        raise UsageError(f"the agents of {run.path} are others than those of {program.name}:\n  {lines}")
    if run.program.others is None:
        model: Any = loaded(run, ref.name)
        return dict(model.learners)
    agent = run.program.others.agent
    policies: dict[str, str | Predictor] = {agent: loaded(run, ref.name)}
    if is_symmetric:
        policies |= dict.fromkeys(program.members, policies[agent])
    return policies


def _both_sides(
    program: Program, a: Player, b: Player, as_first: Sequence[Episode], as_second: Sequence[Episode]
) -> Match:
    """Return the match of two players: the episodes with `a` as the first agent, and as the second one."""
    first, second = program.members.values()
    wins = losses = 0
    for episodes, side, opponent in ((as_first, first, second), (as_second, second, first)):
        for episode in episodes:
            won, lost = (own_episode(member, episode).is_success for member in (side, opponent))
            wins += won and not lost
            losses += lost and not won
    decided = wins + losses
    return _match(
        program,
        a,
        b,
        [*as_first, *as_second],
        wins=wins,
        losses=losses,
        win_rate=wins / decided if decided else None,
        win_interval=wilson(wins, decided) if decided else None,
    )


def _match(program: Program, a: Player, b: Player, episodes: Sequence[Episode], **results: Any) -> Match:
    """Return the match of two players with these episodes and `results`."""
    return Match(
        row=a.name,
        column=b.name,
        episodes=len(episodes),
        endings=dict(Counter(str(episode.ended_by) for episode in episodes).most_common()),
        mean_seconds=fmean(episode.length for episode in episodes) * program.period,
        **results,
    )
