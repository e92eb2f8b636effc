"""The scenario: the sections of one file, in the order in which a reader wants them."""

from pathlib import Path as FilePath
from typing import Annotated, Any, Self

from pydantic import Field, PrivateAttr

from deepbots_cli.document.nodes import Path
from deepbots_cli.scenario import fields
from deepbots_cli.scenario.base import Many, Section, Size, visit
from deepbots_cli.scenario.fields import Expression, LocalName, PlainText, PositiveInt, Scalar, SharedName, Signal, Text
from deepbots_cli.scenario.robot import Messages, Robot
from deepbots_cli.scenario.task import (
    Action,
    Agent,
    Augmentation,
    Disturbance,
    Evaluation,
    Goal,
    Observation,
    Reset,
    Reward,
    ScenarioTest,
    Script,
    Solved,
    Stage,
    Termination,
    Truncation,
)
from deepbots_cli.scenario.training import AnyTraining
from deepbots_cli.scenario.world import AnyObject, World

VERSION = 1
"""The version of the language that is read."""

TITLE = Text(
    "a name",
    r"[A-Za-z][A-Za-z0-9_-]{0,63}",
    "CartPole",
    refused="a name that cannot name a folder",
    help="use letters, digits, `_` and `-`, at most 64, and begin with a letter",
)


class Scenario(Section):
    """One task: world, robots, messages, observation, reward, endings, resets, training.

    It may be built in Python of nested models, mappings and plain values. A value of a wrong type or form and an unknown key raise
    `pydantic.ValidationError`. Checks of the whole scenario follow in `deepbots_cli.lint` and `compile`.
    """

    deepbots: PositiveInt
    """Version of the scenario language: `1`."""
    name: Annotated[str, TITLE]
    """Name of the scenario; runs are named after it."""
    summary: PlainText = ""
    """One sentence about the task."""
    parameters: dict[SharedName, Annotated[Scalar, Expression("parameter")]] = {}
    """Values by names of your choice: constants, or draws such as `uniform(0 .. 1 m)` that are new in every episode."""
    world: World
    """Time and place: timestep, gravity, ground, arena."""
    objects: dict[SharedName, AnyObject] = {}
    """Bodies that are no robots, by names of your choice."""
    robots: Annotated[dict[SharedName, Robot], Size(1, "robot")]
    """The robots, by names of your choice."""
    messages: Messages = Field(default_factory=Messages)
    """Messages between supervisor and robots."""
    action: Annotated[dict[SharedName, Action], Size(1, "action")]
    """Actions of the agent, by names of your choice: a range, or choices."""
    agent: Agent = Field(default_factory=Agent)
    """How the policy is joined to the scenario."""
    augment: Augmentation = {}
    """Values that the supervisor adds to those of the robots; the policy may see them."""
    signals: dict[SharedName, Signal] = {}
    """Helpers for reward and endings; the policy never sees them."""
    goal: Goal | None = None
    """Goal specification."""
    observation: Annotated[Observation, Size(1, "entry")]
    """Observation of the policy, in this order: the name of a value, and the range that is mapped to [-1, 1]."""
    reward: Annotated[Reward, Size(1, "term")]
    """Terms of the reward, by names of your choice. Each term is a plain number; the reward is their sum."""
    termination: Termination = Field(default_factory=Termination)
    """Endings of the task: success and failure."""
    truncation: Truncation | None = None
    """Limits that cut an episode short."""
    reset: Reset = Field(default_factory=Reset)
    """How an episode begins."""
    disturbances: dict[SharedName, Disturbance] = {}
    """Pushes and gusts, by names of your choice."""
    scripts: dict[LocalName, Script] = {}
    """Hand-written policies by names of your choice: an expression for every part of the action."""
    curriculum: Annotated[Many[Stage], Size(1, "stage")] = ()
    """Stages of increasing difficulty."""
    evaluation: Evaluation = Field(default_factory=Evaluation)
    """Evaluation of a trained policy."""
    solved: Solved | None = None
    """Criterion for a solved task."""
    train: AnyTraining | None = None
    """How the policy is trained."""
    tests: dict[LocalName, ScenarioTest] = {}
    """Tests by names of your choice, which `deepbots test` runs: who acts, and the expected result."""

    _pruned: frozenset[Path] = PrivateAttr(frozenset())

    @property
    def pruned(self) -> frozenset[Path]:
        """The paths that `validate` removed because they had findings; their names are known, their values are not."""
        return self._pruned

    @classmethod
    def from_yaml(cls, path: str | FilePath) -> Self:
        """The scenario in a file, with all that the file extends and includes; files that it names get absolute paths.

        Raises:
            ScenarioError: The file has findings at error level.
            UsageError: There is no such file.
        """
        from deepbots_cli.document import descend, load, shipped, to_data
        from deepbots_cli.errors import ScenarioError
        from deepbots_cli.scenario.validate import validate, with_new_names

        document = load(path)
        root = with_new_names(document.root, document.findings) if document.root is not None else None
        found = validate(root, document.findings) if root is not None else None
        if root is None or found is None or document.findings.errors:
            raise ScenarioError(list(document.findings))
        data: Any = to_data(root)
        for place, kind, value in visit(found):
            node = descend(root, place)[0]
            file = document.directory_of(node.span) / str(value)
            if isinstance(kind, fields.FilePath) and value not in shipped.robot_names() and file.exists():
                holder = data
                for step in place[:-1]:
                    holder = holder[step]
                holder[place[-1]] = str(file.resolve())
        return cls.model_validate(data)

    def to_yaml(self) -> str:
        """The scenario as the text of a file; values left to their defaults are left out."""
        import yaml

        return yaml.safe_dump(self.model_dump(mode="json", exclude_unset=True), sort_keys=False, allow_unicode=True, width=120)

    @classmethod
    def model_json_schema(cls, *args: Any, **kwargs: Any) -> dict[str, Any]:
        """The JSON Schema for editors, whatever the arguments."""
        from deepbots_cli.scenario.json_schema import json_schema

        return json_schema()
