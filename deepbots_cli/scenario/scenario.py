"""The scenario: the sections of one file, in the order in which a reader wants them."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Annotated, Self

from deepbots_cli.document.nodes import Path
from deepbots_cli.scenario.fields import Expression, Scalar
from deepbots_cli.scenario.objects import AnyObject
from deepbots_cli.scenario.part import Many, Part, Size, field
from deepbots_cli.scenario.plain import Count, Text, Title
from deepbots_cli.scenario.quantity import LocalName, SharedName, Signal
from deepbots_cli.scenario.reset import Disturbance, Reset
from deepbots_cli.scenario.robot import Messages, Robot
from deepbots_cli.scenario.task import (
    Action,
    Agent,
    Augmentation,
    Evaluation,
    Goal,
    Observation,
    Reward,
    Script,
    Solved,
    Stage,
    Termination,
    Truncation,
)
from deepbots_cli.scenario.training import AnyTraining
from deepbots_cli.scenario.world import World

VERSION = 1
"""The version of the language that is read."""


class Scenario(Part):
    """One task: world, robots, messages, observation, reward, endings, resets, training."""

    deepbots: Annotated[int, Count()] = field(description="Version of the scenario language: `1`.")
    name: Annotated[str, Title()] = field(description="Name of the scenario; runs are named after it.")
    summary: Annotated[str, Text()] = field(default="", description="One sentence that says what it is about.")
    parameters: dict[SharedName, Annotated[Scalar, Expression("parameter")]] = field(
        default={},
        description="Figures by names of your choice: constants, or draws such as `uniform(0 .. 1 m)` that are new in every episode.",
    )
    world: World = field(description="Time and place: timestep, gravity, ground, arena.")
    objects: dict[SharedName, AnyObject] = field(default={}, description="Bodies that are no robots, by names of your choice.")
    robots: Annotated[dict[SharedName, Robot], Size(1, "robot")] = field(description="The robots, by names of your choice.")
    messages: Messages = field(default=Messages(), description="How supervisor and robots talk.")
    action: Annotated[dict[SharedName, Action], Size(1, "action")] = field(
        description="What the agent decides, by names of your choice: a range, or choices."
    )
    agent: Agent = field(default=Agent(), description="How the policy is joined to the scenario.")
    augment: Augmentation = field(default={}, description="What the supervisor adds to what the robots send, and the policy may see.")
    signals: dict[SharedName, Signal] = field(default={}, description="Helpers for reward and endings; the policy never sees them.")
    goal: Goal | None = field(default=None, description="Where to get, for a task with goals.")
    observation: Annotated[Observation, Size(1, "entry")] = field(
        description="What the policy sees, in this order: the name of a value, and the range that is mapped to [-1, 1]."
    )
    reward: Annotated[Reward, Size(1, "term")] = field(description="The summands of the reward, by names of your choice; plain numbers.")
    termination: Termination = field(default=Termination(), description="What ends the task: success and failure.")
    truncation: Truncation | None = field(default=None, description="Limits that cut an episode short.")
    reset: Reset = field(default=Reset(), description="How an episode begins.")
    disturbances: dict[SharedName, Disturbance] = field(default={}, description="Pushes and gusts, by names of your choice.")
    scripts: dict[LocalName, Script] = field(
        default={}, description="Hand-written policies by names of your choice: what each makes of every part of the action."
    )
    curriculum: Annotated[Many[Stage], Size(1, "stage")] = field(default=(), description="Stages of rising difficulty.")
    evaluation: Evaluation = field(default=Evaluation(), description="How a trained policy is examined.")
    solved: Solved | None = field(default=None, description="What counts as solved.")
    train: AnyTraining | None = field(default=None, description="How the policy is trained.")

    pruned: frozenset[Path] = frozenset()
    """The paths that `validate` took out because they had findings; names there are known, what they mean is not."""

    def lacking(self, pruned: Iterable[Path]) -> Self:
        """The same scenario, which is said to lack what stood at these paths."""
        scenario = type(self)(**{name: getattr(self, name) for name in self.given})
        scenario.__dict__["pruned"] = frozenset(pruned)
        return scenario
