"""What is known of a training: its logs, and a few short episodes of its policy and of random actions.

Logs are `monitor.csv`, the TensorBoard files and the evaluations during the training. Nothing is written.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from deepbots_cli import api
from deepbots_cli.compiler.inputs import RESOLVED_NAME
from deepbots_cli.diagnostics import Finding
from deepbots_cli.errors import DeepbotsError, RunError
from deepbots_cli.insight.conditions import measured
from deepbots_cli.insight.trace import Trace, Traced
from deepbots_cli.learning import failures
from deepbots_cli.learning.defaults import effective
from deepbots_cli.learning.episodes import read_log
from deepbots_cli.learning.run import Run
from deepbots_cli.lint import all_findings
from deepbots_cli.program import Program
from deepbots_cli.program.task import ActionRange, Choices, Schedule, Solved
from deepbots_cli.runtime.streams import derive_seed
from deepbots_cli.view.plots import evaluations_of, scalars_of

Array = NDArray[np.float64]
EPISODES, STEPS, FEW_STEPS = 4, 300, 40
"""Short episodes of the policy, of random actions and without commands, and their steps at most; and the steps of a constant action."""


@dataclass(frozen=True)
class Episodes:
    """What the training episodes came to, in order: arrays of one entry per episode."""

    steps: Array
    returns: Array
    lengths: Array
    successes: Array
    endings: Sequence[str]

    def part(self, first: float, last: float) -> Episodes:
        """Those from one share of the episodes to another: `part(0.75, 1)` is the last quarter."""
        a, b = round(first * len(self.returns)), round(last * len(self.returns))
        return Episodes(self.steps[a:b], self.returns[a:b], self.lengths[a:b], self.successes[a:b], self.endings[a:b])


@dataclass(eq=False)
class Training:
    """A training as its files tell it, and short episodes.

    `scalars` are curves of TensorBoard by tag: steps and values. The short episodes have the same starts: `policy` those of the last
    policy, `random` those of random actions, `still` those of an action that commands zeros, and `constant` one for each constant action,
    by the part of the action that alone differs.
    """

    run: Run
    episodes: Episodes
    scalars: Mapping[str, tuple[Array, Array]]
    evaluations: Sequence[Mapping[str, Any]]
    failure: str = ""
    policy: Sequence[Trace] = ()
    random: Sequence[Trace] = ()
    still: Sequence[Trace] = ()
    constant: Mapping[str, Mapping[str, Trace]] = field(default_factory=dict)

    @property
    def program(self) -> Program:
        return self.run.program

    @cached_property
    def settings(self) -> Mapping[str, Any]:
        """The hyperparameters that the training takes, by name."""
        return {entry.name: entry.value for entry in effective(self.program, self.run.record.total_timesteps)}

    def setting(self, name: str) -> float | None:
        """A hyperparameter as a number, the first one of a schedule; None where it is none."""
        value = self.settings.get(name)
        value = value.start if isinstance(value, Schedule) else value
        return float(value) if isinstance(value, int | float) and not isinstance(value, bool) else None

    @property
    def steps(self) -> int:
        result = self.run.record.result
        return result.steps if result is not None else int(self.episodes.steps[-1]) if len(self.episodes.steps) else 0

    @cached_property
    def findings(self) -> list[Finding]:
        return findings(self.run)

    @property
    def solved_while_exploring(self) -> bool:
        """Whether the episodes of the training met what `solved` asks for."""
        result = self.run.record.result
        return result is not None and result.solved_at is not None

    @property
    def solved(self) -> bool:
        """Whether the episodes of the training or one of its evaluations met what `solved` asks for."""
        solved = self.program.solved
        return self.solved_while_exploring or (solved is not None and any(_meets(solved, each) for each in self.evaluations))

    def curve(self, tag: str) -> Array:
        """The values of a curve; none where TensorBoard has no such tag."""
        return self.scalars[tag][1] if tag in self.scalars else np.zeros(0)

    def curves(self, prefix: str) -> dict[str, Array]:
        return {tag.removeprefix(prefix): values for tag, (_, values) in self.scalars.items() if tag.startswith(prefix)}


def _meets(solved: Solved, evaluation: Mapping[str, Any]) -> bool:
    returns, successes = evaluation["returns"], evaluation["successes"]
    return (solved.mean_return is None or float(np.mean(returns)) >= solved.mean_return) and (
        solved.success_rate is None or float(np.mean(successes)) >= solved.success_rate
    )


def findings(run: Run) -> list[Finding]:
    """What lint says of the scenario of a run."""
    return all_findings(api.load(run.path / RESOLVED_NAME, allow_code=True, project=run.path))


def read(run: Run) -> Training:
    """The logs of a run, without short episodes.

    Raises:
        RunError: A log is damaged.
    """
    rows = read_log(run.path / "monitor.csv")
    try:
        steps, returns, lengths, successes = (np.array([float(row[name]) for row in rows]) for name in ("steps", "r", "l", "is_success"))
        evaluations = [{name: [float(x) for x in line[name]] for name in ("returns", "successes")} for line in evaluations_of(run.path)]
        numbers: list[Any] = [steps, returns, lengths, successes, *(values for line in evaluations for values in line.values())]
        if not all(np.isfinite(values).all() for values in numbers) or not all(all(line.values()) for line in evaluations):
            raise ValueError("a number is not finite, or an evaluation has no episode")
        episodes = Episodes(steps, returns, lengths, successes, [row["ended_by"] for row in rows])
    except (KeyError, TypeError, ValueError, OverflowError, RecursionError) as error:
        raise RunError(f"{run.path} is damaged: one of its logs cannot be read") from error
    return Training(run, episodes, scalars_of(run.tensorboard), evaluations, _failure(run))


def _failure(run: Run) -> str:
    """What the training failed of, in a sentence; empty where it did not."""
    files = sorted((run.path / failures.FOLDER).glob("[0-9][0-9][0-9][0-9].json"))
    if not files:
        return ""
    failure, _, _ = failures.read(files[-1])
    return f"episode {failure.episode:,}, {failure.error}"


def probe(training: Training, *, allow_code: bool = False, on_episode: Callable[[int, int], object] | None = None) -> None:
    """Run the short episodes of a training, all from the same starts."""
    from deepbots_cli.learning import algorithms, evaluation

    run = training.run
    seeds = [derive_seed(run.record.seed, "diagnosis", number) for number in range(EPISODES)]
    watch = measured(training.program)
    world = Traced(api.build(watch.program, engine=run.record.engine, allow_code=allow_code), watch)
    with algorithms.torch_settings(), closing(world):
        constant, still = _constant(world), _still(world)
        name: Any = next((name for name in ("last", "best") if run.model(name).is_file()), None)
        model = None if name is None else evaluation.load(run, name, world)
        total = EPISODES * (1 + (still is not None) + (model is not None)) + sum(map(len, constant.values()))
        done = 0

        def episode(seed: int, begin: Callable[[], Callable[[Any], Any]], steps: int = STEPS) -> Trace:
            nonlocal done
            error = ""
            try:
                observation, _ = world.reset(seed=seed)
                act = begin()
                for _ in range(steps):
                    observation, _, terminated, truncated, _ = world.step(act(observation))
                    if terminated or truncated:
                        break
            except DeepbotsError as failed:
                error = str(failed)
            done += 1
            if on_episode is not None:
                on_episode(done, total)
            return world.trace("a short episode", error=error)

        def fixed(action: Any) -> Callable[[], Callable[[Any], Any]]:
            return lambda: lambda observation: action

        training.random = [episode(seed, lambda: lambda observation: world.action_space.sample()) for seed in seeds]
        training.constant = {
            part: {name: episode(seeds[0], fixed(action), FEW_STEPS) for name, action in actions.items()}
            for part, actions in constant.items()
        }
        if still is not None:
            training.still = [episode(seed, fixed(still)) for seed in seeds]
        if model is not None:
            training.policy = [episode(seed, lambda: evaluation.acting(model, world)) for seed in seeds]


def _constant(world: Traced) -> dict[str, dict[str, Any]]:
    """For each part of the action, constant actions in which it alone differs: the first options of a choice, both ends of a range."""
    env, policy = world.world, world.watch.program.policy
    choices = [part for part in policy.action if isinstance(part, Choices)]
    ranges = [part for part in policy.action if isinstance(part, ActionRange)]
    names = [name for part in ranges for name in part.names]
    found: dict[str, dict[str, Any]] = {}
    for place, choice in enumerate(choices):
        picks = [[number if other == place else 0 for other in range(len(choices))] for number in range(min(4, len(choice.options)))]
        found[choice.name] = {choice.options[pick[place]].name: env.acting(pick, [0.0] * len(names)) for pick in picks}
    for place, name in enumerate(names[:8]):
        ends = [[end if other == place else 0.0 for other in range(len(names))] for end in (-1.0, 1.0)]
        found[name] = {f"{end[place]:g}": env.acting([0] * len(choices), end) for end in ends}
    return found


def _still(world: Traced) -> Any:
    """The action that commands zeros; None where a choice has no such option, or a range does not hold zero."""
    policy = world.watch.program.policy
    picks: list[int] = []
    values: list[float] = []
    for part in policy.action:
        if isinstance(part, Choices):
            picks += [number for number, option in enumerate(part.options) if not any(option.values)][:1] or [-1]
        else:
            values += [-(part.high + part.low) / (part.high - part.low)] * max(1, len(part.components))
    if -1 in picks or any(abs(value) > 1 for value in values):
        return None
    return world.world.acting(picks, values)
