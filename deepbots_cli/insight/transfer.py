"""The transfer of a policy to another world: its evaluations in both, the comparison of the worlds, and the
requirements that it meets.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import inf
from pathlib import Path
from typing import Any, NamedTuple

from deepbots_cli import api
from deepbots_cli.api import Compiled
from deepbots_cli.document import Permissions
from deepbots_cli.insight.recorded_worlds import EPISODES, EngineWorld
from deepbots_cli.insight.world_comparison import WorldComparison, compare_worlds
from deepbots_cli.learning.evaluation import evaluate
from deepbots_cli.learning.executor import SERIAL, Executor
from deepbots_cli.learning.robustness import (
    SHARE_OF_NOMINAL,
    Robustness,
    base_document,
    evaluate_robustness,
)
from deepbots_cli.learning.runs.episodes import check_defines_success
from deepbots_cli.learning.runs.evaluations import EvaluationResult
from deepbots_cli.learning.runs.run import ModelName, Run
from deepbots_cli.program.task import Solved
from deepbots_cli.rollout.episode import Episode
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
        return (first, second), "the given requirements"
    if solved is None:
        return (None, None), ""
    first, second = (solved.is_met(result.mean_return, result.success_rate) for result in results)
    return (first, second), f"`solved` of the scenario ({solved.description})"
