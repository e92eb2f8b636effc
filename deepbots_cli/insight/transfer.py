"""The transfer of a policy to another world: its evaluations in both, the requirements that it meets, and
the differences between the worlds with their causes.

The worlds are two engines, or a simulation and one with another mass. The policy plays some episodes in the
world of its training, and the other world repeats their starts and actions. The difference of each number
of the observation and of each reward term then comes from the world, not from other actions. `causes` are
changes of the first world that make it more like the second one: another order, sign, unit or age of a
number, or another latency, mass, friction, strength, gain, lag or order of motors. Changes of the physics
are simulated, each with the same starts and actions.

Most kinds of changes explain nothing. Therefore the first round simulates a small, a medium and a large
amount of each kind, in two episodes, until the differences have grown. The second round searches the best
amount of each likely kind, and simulates it in all episodes.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import closing, suppress
from dataclasses import replace
from functools import cache, partial
from math import ceil, exp, floor, inf, log
from pathlib import Path
from statistics import fmean
from typing import Any, NamedTuple, TypeVar

import numpy as np
from scipy.optimize import minimize_scalar

from deepbots_cli import api
from deepbots_cli.api import Compiled
from deepbots_cli.document import Document, MappingNode, Permissions
from deepbots_cli.errors import DeepbotsError, UsageError
from deepbots_cli.insight.recorded_worlds import (
    EPISODES,
    MAX_STEPS,
    REWARD,
    Act,
    Array,
    ChangeEffect,
    Difference,
    EngineWorld,
    RecordedEpisode,
    ValueColumn,
    ValueComparison,
    action_gains,
    changed_actions,
    columns_of,
    command_plans,
    doubled_times,
    friction_plans,
    latency_plans,
    record_episodes,
    repeat_episodes,
    torque_limits,
    without_amount,
)
from deepbots_cli.insight.trace import instrument_program
from deepbots_cli.learning.evaluation import evaluate
from deepbots_cli.learning.executor import SERIAL, Executor
from deepbots_cli.learning.robustness import (
    DELAY,
    FACTOR,
    MASS,
    SHARE_OF_NOMINAL,
    Plan,
    Robustness,
    base_document,
    changed_program,
    evaluate_robustness,
    masses,
    plans,
)
from deepbots_cli.learning.runs.episodes import check_defines_success
from deepbots_cli.learning.runs.evaluations import EvaluationResult
from deepbots_cli.learning.runs.run import ModelName, Run
from deepbots_cli.program.task import Solved
from deepbots_cli.records import dataclass
from deepbots_cli.rollout import Episode, Start
from deepbots_cli.rollout.source import Source
from deepbots_cli.runtime.spaces import FORWARD_BATCH_SIZE
from deepbots_cli.words import beside

MIN_EPISODES = FORWARD_BATCH_SIZE
"""The number of episodes of an evaluation that a number of steps does not leave out: deepbots plays as many
at a time."""
QUICK_EPISODES = 4
"""The number of episodes of a quick comparison."""


class Gate(NamedTuple):
    """A requirement of an evaluation, and whether it is met; `subject` names the world or the condition."""

    subject: str
    requirement: str
    met: bool

    @property
    def text(self) -> str:
        return f"{self.subject}: {self.requirement}"

    def as_json(self) -> dict[str, Any]:
        return {"text": self.text, "met": self.met}


@dataclass(frozen=True)
class Transfer:
    """A policy in two worlds.

    Attributes:
        run: The run directory.
        names: The names of the two worlds, which differ.
        between: The worlds with their scenarios and engines, in words.
        here: The evaluation in the world of the training.
        there: The evaluation in the other one, with the same starts.
        comparison: The differences between the worlds.
        robustness: The policy under changed conditions; None if they were left out.
        gates: The requirements; empty if no success rate is required.
        works: Whether the policy works in each of the two worlds: it meets the requirements, or else `solved`
            of the scenario; None without either.
        required: The requirement in words; empty without one.
    """

    run: Path
    names: tuple[str, str]
    between: str
    here: EvaluationResult
    there: EvaluationResult
    comparison: WorldComparison
    robustness: Robustness | None
    gates: tuple[Gate, ...]
    works: tuple[bool | None, bool | None]
    required: str

    @property
    def passed(self) -> bool:
        return all(gate.met for gate in self.gates)

    @property
    def is_much_lower(self) -> bool:
        """Whether the return in the other world is lower by more than a fifth, and the intervals of both do
        not overlap."""
        first, second = self.here, self.there
        if (
            first.return_interval is None
            or second.return_interval is None
            or second.return_interval[1] >= first.return_interval[0]
        ):
            return False
        return second.mean_return < first.mean_return - (1 - SHARE_OF_NOMINAL) * abs(first.mean_return)


def world_names(
    scenarios: tuple[str, str], engines: tuple[str, str], is_other_scenario: bool
) -> tuple[tuple[str, str], str]:
    """Different names of two worlds, and the worlds with their scenarios and engines, in words."""
    if not is_other_scenario:
        return engines, f"{scenarios[0]} in {engines[0]} and in {engines[1]}"
    is_same = scenarios[0] == scenarios[1]
    names = ("training", "other") if is_same else scenarios
    both = "both " + (f"{scenarios[0]} " if is_same else "")
    if engines[0] == engines[1]:
        return names, f"{names[0]} and {names[1]}, {both}in {engines[0]}"
    return names, f"{names[0]} in {engines[0]} and {names[1]} in {engines[1]}" + (
        f", {both.rstrip()}" if is_same else ""
    )


def transfer(
    run: Run,
    *,
    engine: str,
    model: ModelName = "best",
    scenario: Compiled | None = None,
    min_success: float | None = None,
    min_return: float | None = None,
    episodes: int = 50,
    max_steps: float = inf,
    with_conditions: bool = True,
    seed: int | None = None,
    permissions: Permissions = Permissions(),
    executor: Executor = SERIAL,
    on_world: Callable[[int, int], object] | None = None,
) -> Transfer:
    """Evaluate a policy in the world of its training and in another one, and compare the worlds.

    Args:
        run: The run.
        engine: The engine of the other world.
        model: The name of the model.
        scenario: The scenario of the other world; by default that of the run.
        min_success: The success rate that the policy must reach in both worlds, and at the first level of
            each side of each condition.
        min_return: The same for the mean return.
        episodes: Episodes of each evaluation.
        max_steps: The evaluation in the world of the training ends after this number of steps, but not before
            8 episodes, and the other one has as many episodes. Fewer episodes are compared, too.
        with_conditions: Whether the policy is also evaluated under changed conditions.
        seed: Root seed of the starts; by default that of the training.
        executor: Where the evaluations under changed conditions run.
        on_world: Called with the number of evaluations or kinds of changes done, and of all; it begins again
            in each round.

    Raises:
        RunError: The run has no model, or does not fit the scenario.
        UsageError: The scenario has copies of a robot, or defines no success for `min_success`.
    """
    base = Source.kept(run.path, permissions)
    trained_in = api.compile(base.checked())
    for compiled in (trained_in, scenario) if min_success is not None else ():
        if compiled is not None:
            check_defines_success(compiled.program)
    root = run.record.seed if seed is None else seed
    settings: dict[str, Any] = {"seed": root, "model": model, "permissions": permissions}

    def is_enough(evaluated: Sequence[Episode]) -> bool:
        return len(evaluated) >= MIN_EPISODES and sum(episode.length for episode in evaluated) >= max_steps

    first = evaluate(run, episodes=episodes, until=is_enough, **settings)
    settings["episodes"] = first.episodes
    second = evaluate(run, scenario=scenario, engine=engine, **settings)
    program = trained_in.program if scenario is None else scenario.program
    here = EngineWorld(trained_in.program, run.record.engine, permissions)
    comparison = compare_worlds(
        run,
        here,
        EngineWorld(program, engine, permissions),
        base_document(base),
        seed=root,
        model=model,
        episodes=EPISODES if max_steps == inf else QUICK_EPISODES,
        outcomes=[*zip(first.outcomes, second.outcomes, strict=True)],
        on_world=on_world or (lambda count, planned: None),
    )
    robustness = None
    if with_conditions:
        robustness = evaluate_robustness(
            run,
            min_success=min_success,
            min_return=min_return,
            on_level=on_world,
            executor=executor,
            **settings,
        )
    names, between = world_names(
        (run.program.name, program.name), (run.record.engine, engine), scenario is not None
    )
    conditions = robustness.conditions if robustness is not None else ()
    judged = [*zip(names, (first, second), strict=True)]
    easiest = (
        (condition.name, side.levels[0])
        for condition in conditions
        for side in condition.sides
        if side.levels
    )
    judged += [(f"{name} {level.level}", level.evaluation) for name, level in easiest]
    gates = []
    for name, result in judged:
        if min_success is not None:
            met = result.success_rate >= min_success
            measured, bar = beside(100 * result.success_rate, 100 * min_success, 3)
            gates.append(Gate(name, f"success rate {measured}% of at least {bar}%", met))
        if min_return is not None:
            met = result.mean_return >= min_return
            measured, bar = beside(result.mean_return, min_return)
            gates.append(Gate(name, f"mean return {measured} of at least {bar}", met))
    works, required = worlds_that_work(names, (first, second), gates, trained_in.program.agent.solved)
    return Transfer(
        run.path, names, between, first, second, comparison, robustness, tuple(gates), works, required
    )


def worlds_that_work(
    names: tuple[str, str],
    results: tuple[EvaluationResult, EvaluationResult],
    gates: Sequence[Gate],
    solved: Solved | None,
) -> tuple[tuple[bool | None, bool | None], str]:
    """Return whether the policy works in each of two worlds, and the meaning of working."""
    if gates:
        first, second = (all(gate.met for gate in gates if gate.subject == name) for name in names)
        return (first, second), "what `--min-success` and `--min-return` ask for"
    if solved is None:
        return (None, None), ""
    first, second = (solved.is_met(result.mean_return, result.success_rate) for result in results)
    return (first, second), f"the thresholds of `solved` ({solved.thresholds})"


T = TypeVar("T")

_LEAST_EXPLAINED = 0.3
"""The smallest share of the squared differences that a cause must explain."""
_REFINED = 8
"""The number of kinds of changes whose best amount is searched in these episodes, and simulated in all."""
_SEARCH_STEPS = 7
"""The number of simulations of such a search."""
_EXPLAINS_ALL = 0.9995
"""The share from which no better amount is searched."""
_MAX_LINKS = 12
"""The largest number of links whose mass is changed."""
_MAX_JOINED = 3
"""The number of changes with the same effect that are named; more are counted."""
_PHASE, _LATEST, _CLEARLY_APART, _MOST_APART = 50, 1_000, 0.1, 6
"""The steps before outcomes part that are compared, the latest step at which they may part, and, of the means
in this phase, the least difference as a share of the width, and the number that is kept."""
_CHECKED, _CHECKED_EPISODES, _LEAST_SUCCESS = 3, 20, 0.2
"""The causes whose effect on the success is evaluated, the episodes of each evaluation, and the difference of
the success rates from which they are."""


@dataclass(frozen=True)
class Cause:
    """A change of the first world that makes it more like the other one.

    `explained` is the share of the squared differences that it removes. `success` is the success rate of the
    policy in the first world with this change, and `explained_success` the share of the difference between
    the success rates in the two worlds that it makes; None where this was not evaluated.
    """

    text: str
    explained: float
    success: float | None = None
    explained_success: float | None = None


@dataclass(frozen=True)
class Parting:
    """The steps before the outcomes of the policy part: `episodes` of `of` end in another way in the other
    world. `steps` is the range of these steps, and `differences` the largest ones of their means."""

    episodes: int
    of: int
    steps: tuple[int, int]
    differences: tuple[Difference, ...]


@dataclass(frozen=True)
class WorldComparison:
    """The result of a comparison: `differences` in the order in which they begin, `causes` from the one that
    explains most.

    A cause explains numbers of the observation, so there is none if only reward terms differ. `success` holds
    the success rates in both worlds, in the episodes in which causes are evaluated by it.
    """

    episodes: int
    steps: int
    differences: tuple[Difference, ...]
    causes: tuple[Cause, ...]
    parting: Parting | None = None
    success: tuple[float, float] | None = None

    @property
    def observation_differs(self) -> bool:
        return any(not difference.name.startswith(REWARD) for difference in self.differences)


def compare_worlds(
    run: Run,
    first: EngineWorld,
    second: EngineWorld,
    document: Document,
    *,
    seed: int,
    model: ModelName = "best",
    episodes: int = EPISODES,
    outcomes: Sequence[tuple[Episode, Episode]] = (),
    on_world: Callable[[int, int], object] = lambda count, planned: None,
) -> WorldComparison:
    """Compare two worlds by the actions of a policy, up to the step in which its outcomes part.

    Args:
        run: The run of the policy.
        first: The world in which the policy acts. deepbots changes it to find causes.
        second: The world that repeats its actions.
        document: The scenario of `first`, from `robustness.base_document`.
        seed: Root seed of the starts.
        outcomes: The episodes of the evaluations with this seed, in both worlds.
        on_world: Called in each of two rounds, with the number of kinds of changes done, and of all.

    Raises:
        UsageError: The scenario has copies of a robot.
    """
    if first.program.agent.copies is not None:
        raise UsageError(
            f"{first.program.name} has copies of a robot, whose worlds cannot be compared step by step"
        )
    columns, others = (
        columns_of(instrument_program(world.program, include_observation=True)) for world in (first, second)
    )
    columns = [column for column in columns if column in others]
    first, second = (world._replace(columns=columns) for world in (first, second))
    ends = [[(one.is_success, one.ended_by) for one in pair] for pair in outcomes]
    parting_steps = [min(one.length for one in pair) for pair in outcomes]
    parted = [number for number, (here, there) in enumerate(ends) if here != there]
    late = [number for number in parted if parting_steps[number] <= _LATEST][:episodes]
    numbers = [*late, *(number for number in range(episodes) if number not in late)][:episodes]
    longest = max([MAX_STEPS, *(parting_steps[number] for number in late)])

    def record(
        numbers: Iterable[int], max_steps: int | None, world: EngineWorld, act: Act | None = None
    ) -> list[RecordedEpisode]:
        starts = (Start.of_evaluation(seed, number) for number in numbers)
        return record_episodes(run, world, model, starts, act=act, max_steps=max_steps)

    recorded = record(numbers, longest, first)
    comparison = ValueComparison(columns, recorded, repeat_episodes(second, recorded))
    parting = None
    if late:
        pairs = [*zip(recorded, record(late, longest, second), strict=False)]
        parting = Parting(len(parted), len(outcomes), *_phase(columns, pairs))
    size = len(recorded), max(len(episode.actions) for episode in recorded)
    result = WorldComparison(*size, tuple(comparison.differences()), (), parting=parting)
    if not result.observation_differs:
        return result
    rows = [*comparison.measured_causes()]
    with closing(first.build()) as recorder:
        kinds = [*_kinds(first, first._replace(recorder=recorder), document)]
        for row in _simulated_causes(comparison, kinds, on_world):
            duplicate = next(
                (other for other in rows if comparison.all_same([other.values], [row.values])), None
            )
            if duplicate is None:
                rows.append(row)
            else:
                duplicate.texts.extend(row.texts)
                duplicate.world = duplicate.world or row.world
        explained = [(comparison.explained(row.values), row) for row in rows]
        likely = [(share, row) for share, row in explained if share >= _LEAST_EXPLAINED]
        likely.sort(key=lambda pair: -pair[0])  # stable
        causes = [Cause(_either(row.texts), share) for share, row in likely]
        checked = outcomes[:_CHECKED_EPISODES] if first.program.defines_success else ()
        rates = [fmean(one.is_success for one in world) for world in zip(*checked, strict=True)]
        if not rates or abs(rates[0] - rates[1]) < _LEAST_SUCCESS:
            return replace(result, causes=tuple(causes))
        for index, (_, row) in enumerate(likely[:_CHECKED]):
            if row.world is not None:
                with suppress(DeepbotsError):  # of another start, such as an ending that holds at its reset
                    rate = fmean(one.is_success for one in record(range(len(checked)), None, *row.world()))
                    share = (rates[0] - rate) / (rates[0] - rates[1])
                    causes[index] = replace(causes[index], success=rate, explained_success=share)
    return replace(result, causes=tuple(causes), success=(rates[0], rates[1]))


def _phase(
    columns: Sequence[ValueColumn], pairs: Sequence[tuple[RecordedEpisode, RecordedEpisode]]
) -> tuple[tuple[int, int], tuple[Difference, ...]]:
    """Return the first and the last step of the phase in which the outcomes of pairs of episodes part, and
    the columns whose means in it differ most."""
    lasts = [min(len(episode.actions) for episode in pair) for pair in pairs]
    here, there = (
        np.vstack([episode.values[max(0, last - _PHASE + 1) : last + 1] for episode, last in parts])
        for parts in (zip(world, lasts, strict=True) for world in zip(*pairs, strict=True))
    )
    width = np.ptp(np.vstack([one.values for pair in pairs for one in pair]), axis=0) + 1e-9
    means = here.mean(axis=0), there.mean(axis=0)
    shares = np.abs(means[1] - means[0]) / width
    order = [index for index in np.argsort(-shares, kind="stable") if shares[index] >= _CLEARLY_APART]
    return (max(0, min(lasts) - _PHASE + 1), max(lasts)), tuple(
        Difference(
            columns[index].name,
            columns[index].unit,
            0,
            0,
            float(means[0][index]),
            float(means[1][index]),
            float(shares[index]),
        )
        for index in order[:_MOST_APART]
    )


def _either(texts: Sequence[str]) -> str:
    more = len(texts) - _MAX_JOINED
    return " or ".join([*texts[:_MAX_JOINED], *([f"{more} more"] if more > 0 else [])])


def _simulated(comparison: ValueComparison, kind: Kind, amount: float) -> list[Array] | None:
    """Return the values with a change; None if the change does not fit this scenario."""
    try:
        world, act = kind.changed(amount)
        values = repeat_episodes(world, comparison.recorded, act)
    except DeepbotsError:
        return None
    return values if all(np.isfinite(array).all() for array in values) else None


def _simulated_causes(
    comparison: ValueComparison, kinds: Sequence[Kind], on_world: Callable[[int, int], object]
) -> list[ChangeEffect]:
    """Return the likely changes, each with the amount that explains most of a few short episodes, and their
    effects on all."""
    probe = comparison.probed()
    likeness = {kind: _likeness(probe, kind) for kind in _announced(kinds, on_world)}
    likely = [kind for kind in sorted(kinds, key=lambda kind: -likeness[kind]) if likeness[kind] > 0.0]
    effects = []
    for kind in _announced(likely[:_REFINED], on_world):
        amount = _best_amount(probe, kind)
        values = _simulated(comparison, kind, amount)
        if values is not None:
            effects.append(ChangeEffect([kind.text(amount)], values, partial(kind.changed, amount)))
    return effects


def _announced(items: Sequence[T], on_world: Callable[[int, int], object]) -> Iterator[T]:
    """Yield the items of a round; after each, `on_world` gets the number of those done, and of all."""
    for number, item in enumerate(items, 1):
        yield item
        on_world(number, len(items))


def _likeness(probe: ValueComparison, kind: Kind) -> float:
    """Return how much an effect of a kind of change is like the difference, regardless of its amount."""
    effects = filter(None, (_simulated(probe, kind, amount) for amount in kind.probes))
    return max(map(probe.likeness if kind.form else probe.explained, effects), default=0.0)


def _best_amount(probe: ValueComparison, kind: Kind) -> float:
    """Return the amount of a kind that explains most of a few short episodes: the best one of its amounts, or
    one of two digits between the neighbors of that, searched on a logarithmic scale."""

    @cache
    def score(amount: float) -> float:
        values = _simulated(probe, kind, amount)
        # Rounded, so that the last bits do not choose among amounts with the same effect.
        return -1.0 if values is None else round(max(probe.explained(values), -1.0), 9)

    amounts = kind.amounts
    best = max(amounts, key=lambda amount: (score(amount), amount))
    if len(amounts) < 2 or score(best) >= _EXPLAINS_ALL:
        return best
    # One more amount at either end, at the ratio of the two that are next to it.
    scale = [amounts[0] ** 2 / amounts[1], *amounts, amounts[-1] ** 2 / amounts[-2]]
    index = scale.index(best)
    least = minimize_scalar(
        lambda x: -score(float(f"{exp(x):.2g}")),
        bounds=(log(scale[index - 1]), log(scale[index + 1])),
        method="bounded",
        options={"maxiter": _SEARCH_STEPS, "xatol": 0.01},
    )
    middle, digit = exp(least.x), 10.0 ** (floor(least.x / log(10.0)) - 1)
    near = [best, *(float(f"{middle + step * digit:.2g}") for step in range(-2, 3))]
    if kind.form == DELAY:  # a latency of a part of a timestep has the effect of a whole one
        near.append(amounts[0] * ceil(middle / amounts[0]))
    return max((amount for amount in near if amount > 0.0), key=lambda amount: (score(amount), amount))


# Changes of the first world

_FACTORS = (0.001, 0.003, 0.01, 0.03, 0.1, 0.25, 0.5, 0.8, 1.25, 2.0, 4.0, 8.0)
"""Factors on a value. Motors are often much stronger than needed, so only a small share of their strength has
an effect."""
_PROBED_FACTORS = (0.003, 0.5, 2.0)
_MASS_FACTORS = tuple(factor for factor in _FACTORS if factor >= 0.1)
_PROBED_MASSES = (0.5, 2.0)


@dataclass(frozen=True, eq=False)
class Kind:
    """A kind of change of the first world.

    Attributes:
        name: Its name, which an amount follows.
        changed: Returns the world with an amount of it.
        amounts: The amounts that are tried, sorted.
        probes: The amounts that are simulated first.
        form: The format of an amount; empty if the change has none.
    """

    name: str
    changed: Callable[[float], tuple[EngineWorld, Act | None]]
    amounts: tuple[float, ...] = (1.0,)
    probes: tuple[float, ...] = (1.0,)
    form: str = ""

    def text(self, amount: float) -> str:
        return f"{self.name} {self.form.format(amount)}".rstrip()


def _kinds(world: EngineWorld, unchanged: EngineWorld, document: Document) -> Iterator[Kind]:
    """Yield the kinds of changes that are possible in a world. `unchanged` is `world`, built for other
    actions."""

    def with_actions(act: Callable[[float], Act]) -> Callable[[float], tuple[EngineWorld, Act | None]]:
        return lambda amount: (unchanged, act(amount))

    def with_plan(plan: Plan) -> Callable[[float], tuple[EngineWorld, Act | None]]:
        return lambda amount: (world._replace(program=changed_program(document, plan.change(amount))), None)

    for name, act in changed_actions(world.program):
        yield Kind(name, with_actions(partial(without_amount, act)))
    for name, scaled in action_gains(world.program):
        yield Kind(name, with_actions(scaled), _MASS_FACTORS, _PROBED_MASSES, FACTOR)
    root, program = document.root, world.program
    assert isinstance(root, MappingNode)
    times = doubled_times(program.world.timestep)
    for plan in (
        *(plan for plan in plans(root, program) if plan.family != MASS),
        *masses(root, program, _MAX_LINKS),
        *friction_plans(root, program),
        *latency_plans(root, program),
        *command_plans(root, program),
    ):
        if plan.form == DELAY:
            yield Kind(plan.name, with_plan(plan), times, (times[len(times) // 3], times[-1]), DELAY)
        elif plan.form == FACTOR:
            amounts, probes = (
                (_MASS_FACTORS, _PROBED_MASSES) if plan.family == MASS else (_FACTORS, _PROBED_FACTORS)
            )
            yield Kind(plan.name, with_plan(plan), amounts, probes, FACTOR)
    for plan, largest in torque_limits(program):
        limits, first = (
            tuple(factor * largest for factor in factors if factor < 1.0)
            for factors in (_FACTORS, _PROBED_FACTORS)
        )
        yield Kind(plan.name, with_plan(plan), limits, first, plan.form)
