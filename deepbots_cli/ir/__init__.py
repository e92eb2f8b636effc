"""The compiled scenario: frozen, in SI units, free of YAML, of the schema and of any engine.

    CompiledScenario
    ├── world         what an engine builds: timestep, ground, arena, robots as data, objects
    ├── robots        controllers: sensors, what they emit, what they apply, message layouts
    ├── parameters    values drawn per episode or more often (fixed ones are folded into the expressions)
    ├── action, agent what the agent chooses, which variables that sets, for how many ticks
    ├── signals       augmentation and helpers, in order of evaluation
    ├── goal          where it has got and shall get
    ├── observation   one entry per number of a frame of what the policy sees, pictures apart
    ├── reward, endings, truncation, reset, disturbances
    ├── training, evaluation, solved
    ├── scripts       hand-written policies
    └── cases, curriculum   the whole once more for each case of the evaluation and each stage of the curriculum

world.py     what an engine builds               robots.py    controllers and their messages
channels.py  what messages meet on their way    sensing.py   what robots sense
values.py    named values, and how often they are drawn   actuation.py what they drive   disturbances.py what pushes bodies about
task.py      action to endings                   resets.py    how an episode begins, what it varies
scripts.py   hand-written policies
training.py  how the policy is trained and judged
records.py   all of these seen from outside: members by name

Expressions are scalar trees (`lang.scalar`). `deepbots_cli.canonical` writes all of it as canonical JSON, whose
digest identifies the scenario.
"""

from __future__ import annotations

from dataclasses import dataclass

from deepbots_cli.diagnostics.nearest import nearest
from deepbots_cli.errors import UsageError
from deepbots_cli.expressions.scalar import is_drawn
from deepbots_cli.ir.actuation import Actuator, Cartesian, Motor, MotorKind, Response, Thrust
from deepbots_cli.ir.channels import OnLoss, Order, Route, Setting
from deepbots_cli.ir.disturbances import NOTHING, Disturbance
from deepbots_cli.ir.resets import MOST_SPOTS, Cells, Group, Layout, Place, Region, Reset, SetJoint, Top, Variation
from deepbots_cli.ir.robots import (
    Direction,
    Field,
    MessageFormat,
    MessageLayout,
    Robot,
    Timing,
)
from deepbots_cli.ir.scripts import MOST_CONDITIONS, Aim, Pick, Script
from deepbots_cli.ir.sensing import (
    FINEST,
    MOST_PIXELS,
    MOST_RAYS,
    MOST_SENSED_RAYS,
    Beams,
    Channels,
    Combined,
    Faults,
    Lookup,
    Optics,
    Sensor,
)
from deepbots_cli.ir.task import (
    MOST_SEEN,
    MOST_SEEN_BYTES,
    Agent,
    Choices,
    Copies,
    Ending,
    Foreign,
    Goal,
    Interval,
    MeasuredGoal,
    Observed,
    Option,
    Outcome,
    Pictured,
    Term,
    Truncation,
    own_action,
    viewed,
)
from deepbots_cli.ir.training import ActionNoise, Criterion, Evaluation, Hindsight, Hyperparameter, Policy, Schedule, Solved, Training
from deepbots_cli.ir.values import Measured, NamedValues, Noise, Parameter, Redraw
from deepbots_cli.ir.world import (
    ARENA_WALLS,
    GROUND,
    MOST_BODIES,
    MOST_POINTS,
    MOST_SETTLING_STEPS,
    MOST_SUBSTEPS,
    WALL_COLOUR,
    Arena,
    Colour,
    Formula,
    Ground,
    Line,
    ObjectBody,
    Picture,
    Pit,
    Point,
    Relief,
    RobotBody,
    Terrain,
    Variant,
    WorldModel,
)

__all__ = [
    "ARENA_WALLS",
    "FINEST",
    "GROUND",
    "IR_VERSION",
    "MOST_BODIES",
    "MOST_CONDITIONS",
    "MOST_PIXELS",
    "MOST_POINTS",
    "MOST_RAYS",
    "MOST_SEEN",
    "MOST_SEEN_BYTES",
    "MOST_SENSED_RAYS",
    "MOST_SETTLING_STEPS",
    "MOST_SPOTS",
    "MOST_SUBSTEPS",
    "NOTHING",
    "WALL_COLOUR",
    "ActionNoise",
    "Actuator",
    "Agent",
    "Aim",
    "Arena",
    "Beams",
    "Cartesian",
    "Case",
    "Cells",
    "Channels",
    "Choices",
    "Colour",
    "Combined",
    "CompiledScenario",
    "Copies",
    "Criterion",
    "Direction",
    "Disturbance",
    "Ending",
    "Evaluation",
    "Faults",
    "Field",
    "Foreign",
    "Formula",
    "Goal",
    "Ground",
    "Group",
    "Hindsight",
    "Hyperparameter",
    "Interval",
    "Layout",
    "Line",
    "Lookup",
    "Measured",
    "MeasuredGoal",
    "MessageFormat",
    "MessageLayout",
    "Motor",
    "MotorKind",
    "NamedValues",
    "Noise",
    "ObjectBody",
    "Observed",
    "OnLoss",
    "Optics",
    "Option",
    "Order",
    "Outcome",
    "Parameter",
    "Pick",
    "Picture",
    "Pictured",
    "Pit",
    "Place",
    "Point",
    "Policy",
    "Redraw",
    "Region",
    "Relief",
    "Reset",
    "Response",
    "Robot",
    "RobotBody",
    "Route",
    "Schedule",
    "Script",
    "Sensor",
    "SetJoint",
    "Setting",
    "Solved",
    "Stage",
    "Term",
    "Terrain",
    "Thrust",
    "Timing",
    "Top",
    "Training",
    "Truncation",
    "Variant",
    "Variation",
    "WorldModel",
    "own_action",
    "viewed",
]

IR_VERSION = 2


@dataclass(frozen=True)
class CompiledScenario:
    """One scenario, ready to be printed as Python and run."""

    name: str
    summary: str
    language: int
    world: WorldModel
    robots: tuple[Robot, ...]
    format: MessageFormat
    timing: Timing
    parameters: tuple[Parameter, ...]
    action: tuple[Choices | Interval, ...]
    signals: tuple[NamedValues | Measured, ...]
    observation: tuple[Observed, ...]
    reward: tuple[Term, ...]
    endings: tuple[Ending, ...]
    truncation: Truncation
    reset: Reset
    solved: Solved | None
    training: Training | None
    evaluation: Evaluation = Evaluation()
    agent: Agent = Agent()
    cases: tuple[Case, ...] = ()
    curriculum: tuple[Stage, ...] = ()
    disturbances: tuple[Disturbance, ...] = ()
    goal: Goal | MeasuredGoal | None = None
    pictures: tuple[Pictured, ...] = ()
    scripts: tuple[Script, ...] = ()
    version: int = IR_VERSION

    @property
    def foreign(self) -> tuple[Foreign, ...]:
        """The functions of installed packages that its reward and its endings call."""
        named = [term.foreign for term in self.reward] + [ending.foreign for ending in self.endings]
        return tuple(function for function in named if function is not None)

    @property
    def settable(self) -> tuple[NamedValues, ...]:
        """What an episode draws under a name, and `options` of `reset` may set: parameters, places and joints."""
        drawn = (entry for entry in self.parameters if any(map(is_drawn, entry.values)))
        return (*drawn, *self.reset.drawn)

    @property
    def seen(self) -> tuple[Observed | Pictured, ...]:
        """All entries of the observation, the numbers first."""
        return (*self.observation, *self.pictures)

    @property
    def period(self) -> float:
        """Simulated time of a whole step of the agent, in s."""
        return self.world.timestep * self.agent.repeat

    @property
    def defines_success(self) -> bool:
        """Whether an episode can be a success at all."""
        return self.goal is not None or any(ending.outcome == "success" for ending in self.endings)

    def case(self, name: str) -> Case:
        """The case of the evaluation of that name.

        Raises:
            UsageError: There is none; lists those there are.
        """
        found = next((case for case in self.cases if case.name == name), None)
        if found is None:
            known = ", ".join(case.name for case in self.cases)
            raise UsageError(f"{self.name} has no case '{name}'" + (f"; there are: {known}" if known else ", nor any other"))
        return found

    def stage(self, name: str) -> Stage:
        """The stage of the curriculum of that name.

        Raises:
            UsageError: There is none; lists those there are.
        """
        found = next((stage for stage in self.curriculum if stage.name == name), None)
        if found is None:
            known = ", ".join(stage.name for stage in self.curriculum)
            raise UsageError(f"{self.name} has no stage '{name}'" + (f"; there are: {known}" if known else ", nor any other"))
        return found

    def script(self, name: str) -> Script:
        """The script of that name.

        Raises:
            UsageError: There is none; lists those there are.
        """
        found = next((script for script in self.scripts if script.name == name), None)
        if found is None:
            names = [script.name for script in self.scripts]
            near = nearest(name, names)
            hint = f" (did you mean {near}?)" if near else ""
            raise UsageError(
                f"{self.name} has no script '{name}'{hint}" + (f"; there are: {', '.join(names)}" if names else ", nor any other")
            )
        return found


@dataclass(frozen=True)
class Case:
    """The scenario under other conditions, to evaluate a policy in; `scenario` has neither cases nor stages."""

    name: str
    episodes: int
    scenario: CompiledScenario


@dataclass(frozen=True)
class Stage:
    """The scenario as it is while a stage of the curriculum lasts: until its criterion is met, or to the end of the training."""

    name: str
    until: Criterion | None
    scenario: CompiledScenario
