"""An episode that runs again, with the observation, action, reward and measurements of each step.

Runs keep the seeds of their evaluations, recordings their actions, failures both: each of them gives the
same episode once more. Its endings are comparisons: `instrument_program` gives a program whose supervisor
keeps both sides of each. Everything else of an episode stays the same to the bit: the added signals read
what the endings read, and share their memories.
"""

from __future__ import annotations

import math
import operator
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing, suppress
from dataclasses import field, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Literal

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from deepbots_cli import api
from deepbots_cli.analysis.shown_units import ShownUnits
from deepbots_cli.document import Permissions
from deepbots_cli.errors import DeepbotsError, EvaluationError, RunError, UsageError
from deepbots_cli.expressions.check import COMPARISONS
from deepbots_cli.expressions.scalar import is_drawn, names_in
from deepbots_cli.expressions.types import Invocation, Operation, Reference, TypedNode, walk
from deepbots_cli.learning import environments
from deepbots_cli.learning.runs.run import ModelName, Run
from deepbots_cli.program import Program, generated
from deepbots_cli.program.task import Goal
from deepbots_cli.program.values import Expression
from deepbots_cli.records import dataclass
from deepbots_cli.rollout import Start, play, steps
from deepbots_cli.rollout.drivers import sequence_driver
from deepbots_cli.rollout.recordings import RecordedEpisode, Recording, actions
from deepbots_cli.runtime import Supervisor
from deepbots_cli.view.episodes import ShowingState
from deepbots_cli.view.frames import successful_agents, value_of_row
from deepbots_cli.view.recordings import observation_hash
from deepbots_cli.view.replay import observation_hash_at, version_changes
from deepbots_cli.words import shell_word

StepValues = Mapping[str, Sequence[float]]
"""The kept values of a step in the supervisor: the components of each value, by its name."""

_SIGNAL_PREFIX = "insight_"
_GOAL_SIGNAL = f"{_SIGNAL_PREFIX}goal"
_GOAL_BOUND = f"{_GOAL_SIGNAL}_bound"
SIGN_OF_OPERATOR = {name: sign for sign, name in COMPARISONS.items()}
_NEGATED = {"less": "greater_equal", "less_equal": "greater", "equal": "not_equal"}
_NEGATED |= {negated: name for name, negated in _NEGATED.items()}
_MIRRORED = {"less": "greater", "less_equal": "greater_equal"}
_MIRRORED |= {mirrored: name for name, mirrored in _MIRRORED.items()}
_FUNCTIONS = dict(
    zip(
        COMPARISONS,
        (operator.lt, operator.le, operator.gt, operator.ge, operator.eq, operator.ne),
        strict=True,
    )
)


@dataclass(frozen=True)
class Comparison:
    """A comparison `value operator bound`. Both sides are names of kept values, and `sides` their texts in
    the scenario. The bound is the side that is known for longer: `x` is the value of `5 cm < x`.

    `text` is true where the comparison is: `x <= 1 m` for `not x > 1 m`. `reduction` says whether any or all
    components of a vector must be true. `unit` is the SI unit of both sides. A truth value without a bound,
    such as a contact, has no `bound`, is compared with 1, and has the measured value 1 where `text` is true.
    `lasting` is the condition whose `duration` is the value. `is_bound_named` says whether the text of the
    bound has names, so that it does not show the number.
    """

    text: str
    operator: str
    value: str
    bound: str | None = None
    unit: str = ""
    sides: tuple[str, str] = ("", "")
    reduction: Literal["any", "all"] = "any"
    lasting: Condition | None = None
    is_bound_named: bool = False


@dataclass(frozen=True)
class CompoundCondition:
    """Conditions, all (`and`) or one (`or`) of which must be true."""

    operator: Literal["and", "or"]
    parts: tuple[Condition, ...]


Condition = Comparison | CompoundCondition


@dataclass(frozen=True)
class MeasuredComparison:
    """A comparison at one moment, in SI units.

    `margin` is the distance of the value beyond the bound: the comparison is true from 0 on, and below 0 this
    much is missing. A truth value has neither bound nor margin.
    """

    condition: Comparison
    holds: bool
    value: float
    bound: float | None = None
    margin: float | None = None

    def as_json(self) -> dict[str, Any]:
        """Return the comparison in SI units."""
        condition = self.condition
        data: dict[str, Any] = {"condition": condition.text, "holds": self.holds, "value": self.value}
        if condition.bound is not None:
            data |= {
                "operator": SIGN_OF_OPERATOR[condition.operator],
                "bound": self.bound,
                "margin": self.margin,
                "unit": condition.unit,
            }
        return data


@dataclass(frozen=True, eq=False)
class InstrumentedProgram:
    """A program that measures its endings, and the condition of each; None for one that has no tree, or draws
    random numbers.

    `observed_signals` holds the kept value of each entry of the observation, before noise and clipping, by
    its name.
    """

    program: Program
    conditions: Mapping[str, Condition | None]
    observed_signals: Mapping[str, str]

    def read(self, agent: Supervisor) -> StepValues:
        """Read the values that this step left in a supervisor of the program."""
        signals = {name: getattr(agent, generated.last(name)) for name in self.program.stored_signals}
        values = {
            name: tuple(value) if isinstance(value, list | tuple) else (float(value),)
            for name, value in signals.items()
        }
        goal = self.program.agent.goal
        if goal is not None:
            values[_GOAL_SIGNAL] = (_distance(goal, agent),)
            values[_GOAL_BOUND] = (goal.tolerance,)
        return values


def instrument_program(program: Program, *, include_observation: bool = False) -> InstrumentedProgram:
    """Return the program with kept values for each comparison of its endings, and for the observation too
    with `include_observation`."""
    builder = _ConditionBuilder(program)
    conditions = {ending.name: builder.ending_condition(ending) for ending in program.endings}
    if program.agent.goal is not None:
        conditions.setdefault("goal_reached", builder.goal(program.agent.goal, negated=False))
    values = [
        entry.value
        for entry in program.agent.observation
        if include_observation
        and entry.numbers
        and entry.value.foreign is None
        # The observations of several agents have the names of each agent, not those of the joint program.
        and not program.members
    ]
    observed_signals = {
        value.name: builder.probe(value.typed, value) for value in values if builder.is_measurable(value)
    }
    signals = (*program.signals, *builder.probes.values())
    return InstrumentedProgram(
        replace(program, signals=signals, stored_signals=frozenset(builder.probes)),
        conditions,
        observed_signals,
    )


class _UnmeasuredError(Exception):
    """A condition whose value an episode cannot keep: a random draw, or the goal as observed."""


class _ConditionBuilder:
    def __init__(self, program: Program) -> None:
        self.probes: dict[str, Expression] = {}
        self._program = program
        self._named: dict[str, Expression] = {signal.name: signal for signal in program.signals}
        self._named |= {ending.name: ending for ending in program.endings if ending.foreign is None}

    def ending_condition(self, ending: Expression) -> Condition | None:
        if ending.foreign is not None:
            return None
        try:
            return self._condition(ending.typed, ending, negated=False)
        except _UnmeasuredError:
            return None

    def goal(self, goal: Goal, *, negated: bool) -> Comparison:
        sides = ("the distance from achieved to desired", "goal.tolerance")
        return Comparison(
            "not goal_reached" if negated else "goal_reached",
            "greater" if negated else "less_equal",
            _GOAL_SIGNAL,
            _GOAL_BOUND,
            goal.unit,
            sides,
            is_bound_named=True,
        )

    def _condition(
        self, node: TypedNode, expression: Expression, *, negated: bool, joined: Literal["any", "all"] = "any"
    ) -> Condition:
        """Return the condition of a truth value in the text of `expression`, with `not` pushed down to the
        comparisons."""
        match node:
            case Operation(operator="not", args=(inner,)):
                return self._condition(inner, expression, negated=not negated, joined=joined)
            case Operation(operator="and" | "or" as joining, args=args) if node.type.components is None:
                connective: Literal["and", "or"] = "or" if (joining == "or") != negated else "and"
                return CompoundCondition(
                    connective, tuple(self._condition(arg, expression, negated=negated) for arg in args)
                )
            case Operation(operator=written, args=(left, right)) if (
                written in SIGN_OF_OPERATOR and not left.type.boolean
            ):
                used = _NEGATED[written] if negated else written
                first, second = (expression.text[side.start : side.end] for side in (left, right))
                text = expression.text[node.start : node.end]
                if negated:
                    text = f"{first} {SIGN_OF_OPERATOR[used]} {second}"
                if left.type.known < right.type.known:
                    left, right, first, second, used = right, left, second, first, _MIRRORED.get(used, used)
                return Comparison(
                    text,
                    used,
                    self.probe(left, expression),
                    self.probe(right, expression),
                    str(left.type.dimension),
                    (first, second),
                    joined,
                    self._lasting(left, expression),
                    is_bound_named=any(isinstance(part, Reference | Invocation) for part in walk(right)),
                )
            case Invocation(function="any" | "all" as function, args=(inner,)) if (
                not inner.type.has_group_components
            ):
                reduction: Literal["any", "all"] = "any" if (function == "any") != negated else "all"
                if isinstance(inner, Operation) and inner.operator in SIGN_OF_OPERATOR:
                    return self._condition(inner, expression, negated=negated, joined=reduction)
            case Reference(symbol=symbol) if (
                symbol.name == "goal_reached" and self._program.agent.goal is not None
            ):
                return self.goal(self._program.agent.goal, negated=negated)
            case Reference(symbol=symbol) if symbol.name in self._named and node.type.components is None:
                definition = self._named[symbol.name]
                if not any(map(is_drawn, definition.scalars)):
                    return self._condition(definition.typed, definition, negated=negated)
        text = expression.text[node.start : node.end]
        if negated:
            is_bare = isinstance(node, Operation) and node.start == min(arg.start for arg in node.args)
            text = f"not ({text})" if is_bare else f"not {text}"
        return Comparison(text, "not_equal" if negated else "equal", self.probe(node, expression))

    def _lasting(self, node: TypedNode, expression: Expression) -> Condition | None:
        """Return the condition in `duration(...)`, also behind the name of a signal."""
        match node:
            case Reference(symbol=symbol) if symbol.name in self._named and node.type.components is None:
                return self._lasting(self._named[symbol.name].typed, self._named[symbol.name])
            case Invocation(function="duration", args=(inner,)) if inner.type.components is None:
                with suppress(_UnmeasuredError):
                    return self._condition(inner, expression, negated=False)
        return None

    def probe(self, node: TypedNode, expression: Expression) -> str:
        """Return the name of a signal that has the value of a part of an expression."""
        probe = Expression(
            "",
            expression.span,
            expression.text[node.start : node.end],
            node,
            expression.owner,
            expression.per_component,
        )
        if not self.is_measurable(probe):
            raise _UnmeasuredError
        name = f"{_SIGNAL_PREFIX}{len(self.probes)}"
        self.probes[name] = replace(probe, name=name)
        return name

    def is_measurable(self, value: Expression) -> bool:
        refused = {"achieved", "desired", "goal_reached", *(ending.name for ending in self._program.endings)}
        return not any(
            is_drawn(tree) or refused & {leaf.name for leaf in names_in(tree)} for tree in value.scalars
        )


def _distance(goal: Goal, agent: Supervisor) -> float:
    """Return the distance of the achieved goal from the desired one, both as observed."""
    size = len(goal.low)
    numbers = agent.goal.tolist()
    return math.hypot(
        *(
            (achieved - desired) * half
            for achieved, desired, half in zip(numbers[:size], numbers[size:], goal.halves, strict=True)
        )
    )


def _margin(comparison: str, value: float, bound: float) -> float:
    if comparison in ("equal", "not_equal"):
        return abs(value - bound) * (-1 if comparison == "equal" else 1)
    return bound - value if comparison in ("less", "less_equal") else value - bound


def comparisons_in(condition: Condition) -> list[Comparison]:
    if isinstance(condition, CompoundCondition):
        return [leaf for part in condition.parts for leaf in comparisons_in(part)]
    return [condition]


def measure(condition: Comparison, values: StepValues) -> MeasuredComparison:
    """Measure a comparison in one step. For a vector, this is the component that makes the comparison true or
    false."""
    sides, bounds = values[condition.value], (1.0,) if condition.bound is None else values[condition.bound]
    pairs = [
        # A single number is compared with every component of the other side.
        (sides[index % len(sides)], bounds[index % len(bounds)])
        for index in range(max(len(sides), len(bounds)))
    ]
    extreme = max if condition.reduction == "any" else min
    value, bound = extreme(pairs, key=lambda pair: _margin(condition.operator, *pair))
    holds = _FUNCTIONS[SIGN_OF_OPERATOR[condition.operator]](value, bound)
    if condition.bound is None:
        return MeasuredComparison(condition, holds, float(holds))
    return MeasuredComparison(
        condition, holds, float(value), float(bound), _margin(condition.operator, value, bound)
    )


def holds(condition: Condition, values: StepValues) -> bool:
    if isinstance(condition, CompoundCondition):
        return (all if condition.operator == "and" else any)(holds(part, values) for part in condition.parts)
    return measure(condition, values).holds


def missing_comparisons(condition: Condition, values: StepValues) -> list[Comparison]:
    """Return the comparisons that keep a condition from being true. For parts joined by `or`, these are those
    of the part that lacks the fewest."""
    if not isinstance(condition, CompoundCondition):
        return [] if measure(condition, values).holds else [condition]
    parts = [missing_comparisons(part, values) for part in condition.parts]
    return [leaf for part in parts for leaf in part] if condition.operator == "and" else min(parts, key=len)


def deciding_comparison(
    condition: Condition, before: StepValues | None, now: StepValues
) -> MeasuredComparison:
    """Return the comparison that made a condition true. It is true now and was false in the step before; one
    with a bound comes first."""
    if not isinstance(condition, CompoundCondition):
        return measure(condition, now)
    parts = [part for part in condition.parts if holds(part, now)] or list(condition.parts)
    new = [part for part in parts if before is not None and not holds(part, before)] or parts
    deciding = [deciding_comparison(part, before, now) for part in new]
    return next((comparison for comparison in deciding if comparison.margin is not None), deciding[0])


Array = NDArray[np.float64]


@dataclass(eq=False)
class Trace:
    """An episode of an agent. For a team, it is that of the agent that ended the episode, or of the first
    one.

    Step k lies between moment k - 1 and moment k; moment 0 is the reset. `observations` (moments, numbers)
    has the newest value of each number as observed, and `values` the values that the conditions of the
    endings compare in each moment. `terms` (steps) are the reward terms, and `actions` the actions in the
    action space. `critic` holds the critic's value of each moment but the last; None for a policy without a
    critic or with a memory, and for recordings and failures.
    """

    title: str
    instrumented: InstrumentedProgram
    observations: Array
    actions: Sequence[Any]
    terms: Mapping[str, Array]
    values: Sequence[StepValues]
    ended_by: str | None
    outcome: Literal["success", "failure", "time limit", "error", "not ended"]
    time: float
    error: str = ""
    agent: str = ""
    succeeded: Sequence[str] = ()
    """Of several agents, those for which the episode is a success."""
    critic: Array | None = None
    notes: Sequence[str] = ()
    units: ShownUnits = field(default_factory=ShownUnits)
    """The units that the scenario file uses."""

    @property
    def program(self) -> Program:
        return self.instrumented.program

    @property
    def steps(self) -> int:
        return len(self.actions)

    @property
    def returns(self) -> float:
        return float(sum(term.sum() for term in self.terms.values()))

    @property
    def is_success(self) -> bool:
        return self.outcome == "success"

    @cached_property
    def sums(self) -> dict[str, float]:
        """The sum of each reward term over the episode; steps without a number are left out."""
        return {name: float(np.nansum(values)) for name, values in self.terms.items()}

    def time_at(self, step: int) -> float:
        """Return the time of a moment, in s."""
        return self.time if step == self.steps else step * self.program.period

    @cached_property
    def end(self) -> MeasuredComparison | None:
        """The comparison that ended the episode; None if an episode limit ended it, or the ending has
        no tree."""
        # At a limit, only a scenario with a goal has a success.
        at_limit = self.outcome == "success" and self.ended_by in (
            "max_steps",
            "max_time",
        )
        condition = self.instrumented.conditions.get("goal_reached" if at_limit else self.ended_by or "")
        if condition is None or self.outcome in ("time limit", "error", "not ended"):
            return None
        return deciding_comparison(
            condition, self.values[-2] if len(self.values) > 1 else None, self.values[-1]
        )

    def action_array(self, key: Literal["choices", "ranges"]) -> Array:
        """Return the numbers of the options, or the numbers of ranges in [-1, 1], of the actions: (steps,
        numbers)."""
        rows = [action[key] if isinstance(action, dict) else action for action in self.actions]
        return np.array([np.asarray(row, float).reshape(-1) for row in rows]).reshape(
            len(rows), -1 if rows else 0
        )


# Conditions of a success


def missed_success(trace: Trace) -> tuple[str, Condition | None]:
    """Return the first success with a bound that an episode without a success missed, and its condition."""
    if trace.outcome not in ("success", "error"):
        for name in (*trace.program.agent.success, "goal_reached"):
            condition = trace.instrumented.conditions.get(name)
            if condition is not None and any(leaf.bound is not None for leaf in comparisons_in(condition)):
                return name, condition
    return "", None


def inner_comparisons(condition: Condition) -> list[Comparison]:
    """Return the comparisons of a condition, including those that must be true for a time."""
    outer = comparisons_in(condition)
    return [
        comparison
        for leaf in outer
        for comparison in (comparisons_in(leaf.lasting) if leaf.lasting else [leaf])
    ]


def nearest_moment(
    trace: Trace, leaf: Comparison, moments: Sequence[int] = ()
) -> tuple[int, MeasuredComparison]:
    """Return the first of the moments in which a comparison came nearest to its bound, or went farthest
    beyond it."""
    past = {step: measure(leaf, trace.values[step]) for step in moments or range(len(trace.values))}
    step = max(
        past, key=lambda step: float(past[step].holds if (margin := past[step].margin) is None else margin)
    )
    return step, past[step]


# Recording


class TraceRecorder(gym.Wrapper[Any, Any, Any, Any]):
    """A world that records each step of an episode; a reset starts a new record. `act` changes the actions,
    but not the recorded ones. The wrapper closes the world."""

    def __init__(
        self, world: Supervisor, instrumented: InstrumentedProgram, units: ShownUnits | None = None
    ) -> None:
        super().__init__(world)
        self.world, self.instrumented, self.units = world, instrumented, units or ShownUnits()
        self.act: Callable[[Any], Any] = lambda action: action
        self.observations: list[Any] = []
        self.actions: list[Any] = []
        self._terms: list[list[Mapping[str, float]]] = []
        self._values: list[list[StepValues]] = []

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        self.observations, self.actions, self._terms, self._values = [], [], [], []
        try:
            observation, info = self.env.reset(seed=seed, options=options)
        except EvaluationError:  # an ending is true already
            self._note()
            raise
        self.observations.append(observation)
        self._note()
        return observation, info

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        outcome = self.env.step(self.act(action))
        self.observations.append(outcome[0])
        self.actions.append(action)
        self._terms.append([agent.get_info()["reward_terms"] for agent in self.world.agents.values()])
        self._note()
        return outcome

    def _note(self) -> None:
        self._values.append([self.instrumented.read(agent) for agent in self.world.agents.values()])

    def moments(self) -> Iterator[tuple[StepValues, Mapping[str, float]]]:
        """Yield the kept values and the reward terms of the first agent in each moment so far; the terms are
        0 at the reset."""
        yield self._values[0][0], {term.name: 0.0 for term in self.instrumented.program.agent.reward}
        for values, terms in zip(self._values[1:], self._terms, strict=True):
            yield values[0], terms[0]

    def trace(self, title: str, *, error: str = "", notes: Sequence[str] = ()) -> Trace:
        """Return the episode so far."""
        world, program = self.world, self.instrumented.program
        names, team = list(world.agents), len(world.agents) > 1
        row = next(
            (
                n
                for n, agent in enumerate(world.agents.values())
                if agent.ended_by and agent.ended_by == world.ended_by
            ),
            0,
        )
        agent_observations = [
            value_of_row(observation, row) if team else observation for observation in self.observations
        ]
        newest = [index for index, value in enumerate(program.agent.inputs) if value.steps_ago == 0]
        vectors = [
            observation.get("observation", np.zeros(0)) if isinstance(observation, dict) else observation
            for observation in agent_observations
        ]
        observations = np.array([np.asarray(vector, float)[newest] for vector in vectors]).reshape(
            len(vectors), len(newest)
        )
        outcome: Any = "error" if error else "not ended"
        if world.ended_by is not None and not error:
            if world.is_success:
                outcome = "success"
            elif world.truncated:
                outcome = "time limit"
            else:
                outcome = "failure"
        return Trace(
            title=title,
            instrumented=self.instrumented,
            observations=observations,
            actions=[value_of_row(action, row) if team else action for action in self.actions],
            terms={
                term.name: np.array([terms[row][term.name] for terms in self._terms], float)
                for term in program.agent.reward
            },
            values=[values[row] for values in self._values],
            ended_by=world.ended_by,
            outcome=outcome,
            time=(world.timestep_count or world.step_count * program.action_repeat) * program.world.timestep,
            error=error,
            agent=names[row] if team else "",
            succeeded=successful_agents(program, world.endings, world.agent_endings),
            notes=notes,
            units=self.units,
        )


# Runs


def trace_episodes(
    run: Run,
    numbers: Sequence[int],
    *,
    seed: int,
    model: ModelName = "best",
    deterministic: bool = True,
    permissions: Permissions = Permissions(),
) -> Iterator[Trace]:
    """Run the episodes of the evaluation of a run with this root seed again.

    Raises:
        RunError: The run has no model, or one that does not fit.
    """
    from deepbots_cli.learning.policy import load_model
    from deepbots_cli.learning.sb3.algorithms import torch_settings
    from deepbots_cli.rollout.policies import PolicyDriver

    if not run.model(model).is_file():
        path = shell_word(run.path)
        if run.record.status == "failed":
            raise RunError(
                f"the training of {run.path} failed before it saved a model; find the cause with: deepbots"
                f" diagnose {path}"
            )
        raise RunError(
            f"{run.path} contains no model '{model}'; train it first, with: deepbots resume {path}"
        )
    watch = instrument_program(run.program)
    with (
        torch_settings(),
        closing(_world(watch, run.engine_for(run.program), permissions, run.compiled.units)) as world,
    ):
        policy = load_model(run, model, world)
        for number in numbers:
            play(
                world,
                PolicyDriver(policy, world, deterministic=deterministic),
                Start.of_evaluation(seed, number),
            )
            trace = world.trace(f"episode {number} of {run.path}", notes=run.notes())
            row = list(world.world.agents).index(trace.agent) if trace.agent else None
            observations = [
                observation if row is None else value_of_row(observation, row)
                for observation in world.observations[:-1]
            ]
            trace.critic = policy.values(observations)
            yield trace


def _world(
    watch: InstrumentedProgram, engine: str | None, permissions: Permissions, units: ShownUnits
) -> TraceRecorder:
    return TraceRecorder(api.build(watch.program, engine=engine, permissions=permissions), watch, units)


# Recordings and failures


def trace_recorded(opened: ShowingState, episodes: Sequence[RecordedEpisode]) -> Iterator[Trace]:
    """Run episodes of an open recording again, each with its actions.

    Raises:
        RecordingError: A step is damaged.
        UsageError: An episode differs when its actions run here.
    """
    recording: Recording = opened.recording
    # A recording that does not compile is refused when it is opened.
    assert opened.program is not None
    showing, units = opened.shown, opened.checked().units
    with closing(
        _world(instrument_program(opened.program), showing.engine, showing.permissions, units)
    ) as world:
        for recorded in episodes:
            again = steps(
                world, sequence_driver(actions(recording, recorded, world.action_space)), Start(recorded.seed)
            )
            for index in range(len(recorded.steps)):
                try:
                    step = next(again, None)
                except UsageError:  # the action does not fit this scenario
                    step = None
                if step is None or observation_hash_at(recording, recorded, index) != observation_hash(
                    step.observation
                ):
                    reason = (
                        "; ".join(version_changes(recording))
                        or "it was made on another machine, or changed since then"
                    )
                    problem = f"{recording.path}: the episode differs from its recording at step {index}"
                    raise UsageError(f"{problem}, so it cannot be explained here: {reason}")
            yield world.trace(f"episode {recorded.number} of {recording.path}")


def trace_failure(path: Path, *, permissions: Permissions = Permissions()) -> Trace:
    """Run the episode of a file in the folder `failures` of a run again.

    Raises:
        RunError: The file is damaged, or does not lie in the folder of a run.
    """
    failure, run, program = environments.read_failure(path)
    error = ""
    with closing(
        _world(instrument_program(program), run.record.engine, permissions, run.compiled.units)
    ) as world:
        try:
            for _ in environments.repeat_steps(failure, program, world, path):
                pass
        except RunError:
            raise
        except DeepbotsError as raised:
            error = str(raised)
        return world.trace(f"episode {failure.episode} of {path}", error=error)
