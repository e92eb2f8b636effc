"""The scenario: the sections of one file, in the order in which a reader wants them."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field, PrivateAttr

from deepbots_cli.schema.fields import Expression, Scalar
from deepbots_cli.schema.objects import AnyObject
from deepbots_cli.schema.part import Many, Part, Size
from deepbots_cli.schema.plain import Count, Text, Title
from deepbots_cli.schema.quantity import LocalName, SharedName, Signal
from deepbots_cli.schema.reset import Disturbance, Reset
from deepbots_cli.schema.robot import Messages, Robot
from deepbots_cli.schema.task import (
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
from deepbots_cli.schema.training import AnyTraining
from deepbots_cli.schema.world import World

VERSION = 1
"""The version of the language that is read."""


class Scenario(Part):
    """One task: world, robots, messages, observation, reward, endings, resets, training."""

    deepbots: Annotated[int, Count()] = Field(description="Version of the scenario language: `1`.")
    name: Annotated[str, Title()] = Field(description="Name of the scenario; runs are named after it.")
    summary: Annotated[str, Text()] = Field(default="", description="One sentence that says what it is about.")
    parameters: dict[SharedName, Annotated[Scalar, Expression("parameter")]] = Field(
        default={},
        description="Figures by names of your choice: constants, or draws such as `uniform(0 .. 1 m)` that are new in every episode.",
    )
    world: World = Field(description="Time and place: timestep, gravity, ground, arena.")
    objects: dict[SharedName, AnyObject] = Field(default={}, description="Bodies that are no robots, by names of your choice.")
    robots: Annotated[dict[SharedName, Robot], Size(1, "robot")] = Field(description="The robots, by names of your choice.")
    messages: Messages = Field(default_factory=Messages, description="How supervisor and robots talk.")
    action: Annotated[dict[SharedName, Action], Size(1, "action")] = Field(
        description="What the agent decides, by names of your choice: a range, or choices."
    )
    agent: Agent = Field(default_factory=Agent, description="How the policy is joined to the scenario.")
    augment: Augmentation = Field(default={}, description="What the supervisor adds to what the robots send, and the policy may see.")
    signals: dict[SharedName, Signal] = Field(default={}, description="Helpers for reward and endings; the policy never sees them.")
    goal: Goal | None = Field(default=None, description="Where to get, for a task with goals.")
    observation: Annotated[Observation, Size(1, "entry")] = Field(
        description="What the policy sees, in this order: the name of a value, and the range that is mapped to [-1, 1]."
    )
    reward: Annotated[Reward, Size(1, "term")] = Field(description="The summands of the reward, by names of your choice; plain numbers.")
    termination: Termination = Field(default_factory=Termination, description="What ends the task: success and failure.")
    truncation: Truncation | None = Field(default=None, description="Limits that cut an episode short.")
    reset: Reset = Field(default_factory=Reset, description="How an episode begins.")
    disturbances: dict[SharedName, Disturbance] = Field(default={}, description="Pushes and gusts, by names of your choice.")
    scripts: dict[LocalName, Script] = Field(
        default={}, description="Hand-written policies by names of your choice: what each makes of every part of the action."
    )
    curriculum: Annotated[Many[Stage], Size(1, "stage")] = Field(default=(), description="Stages of rising difficulty.")
    evaluation: Evaluation = Field(default_factory=Evaluation, description="How a trained policy is examined.")
    solved: Solved | None = Field(default=None, description="What counts as solved.")
    train: AnyTraining | None = Field(default=None, description="How the policy is trained.")

    _pruned: frozenset[tuple[str | int, ...]] = PrivateAttr(frozenset())

    @property
    def pruned(self) -> frozenset[tuple[str | int, ...]]:
        """The paths that `validate` took out because they had findings; names there are known, what they mean is not."""
        return self._pruned
