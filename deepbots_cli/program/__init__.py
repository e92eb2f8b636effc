"""The checked scenario: one structure from the linter to the engine.

    Program
    ├── world                 what an engine builds: timestep, ground, arena, robots as data, objects
    ├── robots                controllers: sensors, what they emit, what they apply, message layouts, routes
    ├── parameters            values drawn per episode or more often (fixed ones are folded into the expressions)
    ├── action, agent         what the agent chooses, and for how many ticks
    ├── signals               augmentation and signals, in order of evaluation
    ├── goal                  what is achieved and what is desired
    ├── observation, reward, endings, truncation
    ├── reset, disturbances   how an episode begins, what it varies, what disturbs it
    ├── training, evaluation, solved, scripts
    └── cases, curriculum     the whole once more for each case of the evaluation and each stage of the curriculum

values.py   Expression, the leaf of all of these      world.py    what an engine builds
robots.py   sensors, actuators, messages, controllers task.py     action to endings, scripts, training, evaluation
resets.py   placements, randomized parameters

Everything is frozen, in SI units, and free of YAML and of any engine. Rules read the typed tree and the place of an expression
(`.typed`, `.span`), generated code its scalar trees (`.scalars`), which are made when first asked for. `deepbots_cli.canonical`
writes a program as canonical JSON, whose digest identifies the scenario.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TypeVar

from deepbots_cli.diagnostics.nearest import nearest
from deepbots_cli.errors import UsageError
from deepbots_cli.expressions.scalar import is_drawn
from deepbots_cli.program.resets import Disturbance, Reset
from deepbots_cli.program.robots import Robot, Timing
from deepbots_cli.program.task import (
    ActionPart,
    Agent,
    Criterion,
    Ending,
    Evaluation,
    Goal,
    ImageObservation,
    Observation,
    ObservedNumber,
    Script,
    Solved,
    Training,
    Truncation,
)
from deepbots_cli.program.values import Expression, Foreign, NamedScalars
from deepbots_cli.program.world import WorldModel


@dataclass(frozen=True, eq=False)
class Program:
    """One checked scenario, ready to be printed as Python and run.

    It has one policy: `action`, `agent`, `observation`, `goal`, `reward`, `scripts` and `training` belong to it.
    `augmented` are the signals that the policy may see.
    """

    name: str
    summary: str
    language: int
    world: WorldModel
    robots: tuple[Robot, ...]
    format: str
    timing: Timing
    parameters: tuple[Expression, ...]
    action: tuple[ActionPart, ...]
    signals: tuple[Expression, ...]
    observation: tuple[Observation, ...]
    reward: tuple[Expression, ...]
    endings: tuple[Ending, ...]
    truncation: Truncation
    reset: Reset
    solved: Solved | None
    training: Training | None
    evaluation: Evaluation = Evaluation()
    agent: Agent = Agent()
    cases: tuple[EvaluationCase, ...] = ()
    curriculum: tuple[CurriculumStage, ...] = ()
    disturbances: tuple[Disturbance, ...] = ()
    goal: Goal | None = None
    scripts: tuple[Script, ...] = ()
    augmented: frozenset[str] = frozenset()

    def projection(self) -> dict[str, object]:
        return {name: value for name, value in vars(self).items() if name in self.__dataclass_fields__ and name != "augmented"}

    @property
    def foreign(self) -> tuple[Foreign, ...]:
        """The functions of installed packages that its reward and its endings call."""
        named = (*self.reward, *(ending.value for ending in self.endings))
        return tuple(value.foreign for value in named if value.foreign is not None)

    @property
    def settable(self) -> tuple[NamedScalars, ...]:
        """Draws with a name, which `options` of `reset` may set: parameters, places and joints."""
        drawn = (
            NamedScalars(value.name, value.components, value.scalars) for value in self.parameters if any(map(is_drawn, value.scalars))
        )
        return (*drawn, *self.reset.drawn)

    @cached_property
    def numbers(self) -> tuple[ObservedNumber, ...]:
        """The numbers of one frame of the observation, apart from images."""
        return tuple(number for entry in self.observation for number in entry.numbers)

    @property
    def images(self) -> tuple[ImageObservation, ...]:
        return tuple(entry for entry in self.observation if isinstance(entry, ImageObservation))

    @property
    def period(self) -> float:
        """Simulated time of a whole step of the agent, in s."""
        return self.world.timestep * self.agent.action_repeat

    @property
    def defines_success(self) -> bool:
        """Whether an episode can be a success at all."""
        return self.goal is not None or any(ending.outcome == "success" for ending in self.endings)

    def case(self, name: str) -> EvaluationCase:
        """The case of the evaluation of that name.

        Raises:
            UsageError: There is none; lists those there are.
        """
        return self._named("case", name, self.cases)

    def stage(self, name: str) -> CurriculumStage:
        """The same for a stage of the curriculum."""
        return self._named("stage", name, self.curriculum)

    def script(self, name: str) -> Script:
        """The same for a script."""
        return self._named("script", name, self.scripts)

    def _named(self, what: str, name: str, known: Sequence[Entry]) -> Entry:
        found = next((entry for entry in known if entry.name == name), None)
        if found is None:
            names = [entry.name for entry in known]
            near = nearest(name, names)
            hint = f" (did you mean {near}?)" if near else ""
            raise UsageError(
                f"{self.name} has no {what} '{name}'{hint}" + (f"; there are: {', '.join(names)}" if names else ", nor any other")
            )
        return found


@dataclass(frozen=True, eq=False)
class EvaluationCase:
    """The scenario under other conditions, to evaluate a policy in; `program` has neither cases nor stages."""

    name: str
    episodes: int
    program: Program


@dataclass(frozen=True, eq=False)
class CurriculumStage:
    """The scenario as it is while a stage of the curriculum lasts: until its criterion is met, or to the end of the training."""

    name: str
    until: Criterion | None
    program: Program


Entry = TypeVar("Entry", EvaluationCase, CurriculumStage, Script)
