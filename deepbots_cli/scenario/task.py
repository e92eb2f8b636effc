"""The task: what the agent does and sees, what it is paid for, when an episode ends."""

from __future__ import annotations

from typing import Annotated, ClassVar

from deepbots_cli.scenario.fields import Expression, Quantity, Range, Reference, Scalar
from deepbots_cli.scenario.part import FORMS, Keys, Many, Part, Size, field
from deepbots_cli.scenario.plain import Count, PythonPath, Real, Setting, Until
from deepbots_cli.scenario.quantity import LocalName, OnOff, Period, Share, SharedName, Signal, Whole

Small = Annotated[int, Count(maximum=1000)]
Number = Annotated[Scalar, Quantity("any")]
Noise = Annotated[Scalar, Quantity("any", stage="episode", relative=True, minimum=0)]


class PythonTerm(Part):
    """A term computed by a function of an installed package; refused unless foreign code is allowed."""

    python: Annotated[str, PythonPath()] = field(description="The function, `package.module:function`.")


class ContinuousAction(Part):
    """Numbers that the agent chooses; it acts in [-1, 1], and the range says what that means."""

    range: Annotated[str, Range("any")] = field(description="What -1 and 1 of the agent stand for, such as `0.25 .. 1`.")
    each: Annotated[str, Reference("group")] | None = field(
        default=None, description="One number for each member of this group or actuator."
    )


class DiscreteAction(Part):
    """One of several options."""

    marks: ClassVar[frozenset[str]] = frozenset({"choices", "forbid"})

    choices: Annotated[dict[LocalName, Annotated[dict[SharedName, Number] | Number, FORMS]], Size(2, "choice")] = field(
        description="The options by name, each with a number, or with the variables that it sets: `{forward: {left: 1, right: 1}}`."
    )
    forbid: dict[Annotated[str, Reference("choice")], Annotated[str, Expression("forbid", boolean=True)]] = field(
        default={}, description="When an option may not be chosen."
    )


Action = Annotated[DiscreteAction | ContinuousAction | Annotated[str, Range("any")], FORMS]


class Agent(Part):
    """How the policy is joined to the scenario."""

    repeat: Small = field(default=1, description="Control ticks for which one action of the agent is held.")
    stack: Small = field(default=1, description="How many observations in a row the policy sees.")
    each: Annotated[str, Reference("robot")] | None = field(default=None, description="One shared policy over the copies of this robot.")


class Observed(Part):
    """One entry of the observation, with more than its range."""

    range: Annotated[str, Range("any", auto=True)] = field(
        description="What is mapped to [-1, 1], such as `-0.4 .. 0.4 m`; `auto` takes what is known."
    )
    history: Small = field(default=1, description="How many values in a row the policy sees, newest last.")
    noise: Noise = field(default=0, description="Standard deviation of what is added to it, such as `0.01 rad`, or `2 %` of the value.")
    clip: OnOff = field(default=True, description="Whether values outside the range are clipped to it.")


class Goal(Part):
    """A task that is told by where to get: for hindsight replay."""

    achieved: Annotated[Scalar, Expression("goal", boolean=False)] = field(description="What the agent has reached.")
    desired: Annotated[Scalar, Expression("goal", boolean=False)] = field(description="What it shall reach.")
    within: Annotated[Scalar, Quantity("any", minimum=0)] = field(
        description="Distance between the two at which the goal counts as reached."
    )
    range: Annotated[str, Range("any")] = field(description="Bounds of both, for the observation.")
    noise: Noise = field(
        default=0, description="Standard deviation of the noise on `achieved`: in its unit, such as `5 mm`, or as `2 %` of the value."
    )


Condition = Annotated[PythonTerm | Annotated[str, Expression("ending", boolean=True)], FORMS]


class Termination(Part):
    """Conditions that end the task; they are part of what the agent has to learn."""

    success: dict[SharedName, Condition] = field(
        default={}, description="Conditions under which the agent has succeeded, by names of your choice."
    )
    failure: dict[SharedName, Condition] = field(default={}, description="Conditions under which it has failed; failure beats success.")


class Truncation(Part):
    """Limits that only cut the episode short; they are no part of the task."""

    needs: ClassVar[tuple[Keys, ...]] = (Keys(("max_steps", "max_time"), least=1, most=2),)

    max_steps: Annotated[Scalar, Quantity("number", minimum=1, whole=True)] | None = field(default=None, description="Steps of the agent.")
    max_time: Period | None = field(default=None, description="Simulated time, such as `60 s`.")


Decision = Annotated[
    Annotated[dict[Annotated[str, Reference("choice")], Annotated[Scalar | bool, Expression("script")]], Size(1, "option")]
    | Annotated[Scalar, Expression("script", boolean=False)],
    FORMS,
]
Script = Annotated[dict[Annotated[str, Reference("action")], Decision], Size(1, "action")]


Settings = dict[Annotated[str, Reference("setting")], Annotated[str | int | float | bool | dict[str, object] | list[object], Setting()]]


class Stage(Part):
    """A stage of the curriculum."""

    name: LocalName = field(description="Name of the stage.")
    set: Settings = field(
        default={}, description="What is different: parameters by name, or other values by path, such as `reset.layout: paper`."
    )
    until: Annotated[str, Until()] | None = field(
        default=None, description="When the next stage begins: `success_rate >= 0.7 over 40 episodes`, or after `50_000 steps`."
    )


class Case(Part):
    """One case of the evaluation."""

    set: Settings = field(default={}, description="What is different: parameters by name, or other values by path.")
    episodes: Whole | None = field(default=None, description="Episodes of this case.")


class Evaluation(Part):
    """How a trained policy is examined."""

    episodes: Whole = field(default=100, description="Episodes, or episodes per case.")
    cases: dict[LocalName, Case] = field(default={}, description="Further conditions to examine it under, by names of your choice.")


class Solved(Part):
    """What counts as solved."""

    needs: ClassVar[tuple[Keys, ...]] = (Keys(("mean_return", "success_rate"), least=1, most=2),)

    mean_return: Annotated[float, Real()] | None = field(default=None, description="Least mean return over the episodes.")
    success_rate: Share | None = field(default=None, description="Least share of successful episodes, 0 to 1.")
    episodes: Whole = field(default=100, description="Over how many episodes in a row.")


class Measured(Part):
    """A value that the supervisor measures with noise. Every expression that uses the name reads the same noisy value."""

    value: Signal = field(description="The exact value.")
    noise: Noise = field(
        default=0, description="Standard deviation of the noise on it: in its unit, such as `2 mm`, or as `2 %` of the value."
    )


Augmentation = Annotated[
    Many[Annotated[str, Reference("parameter or signal")]] | dict[SharedName, Annotated[Measured | Signal, FORMS]], FORMS
]
Reward = dict[LocalName, Annotated[PythonTerm | Annotated[Scalar, Expression("reward")], FORMS]]
Observation = dict[Annotated[str, Reference("value")], Annotated[Observed | Annotated[str, Range("any", auto=True)], FORMS]]
