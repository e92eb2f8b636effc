"""The scenario: deployment, and the whole file."""

import pathlib
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Annotated, Any, Self

from pydantic import Field, PrivateAttr, ValidationError, model_validator

from deepbots_cli.document.nodes import MappingNode, NodePath, node_at
from deepbots_cli.scenario.base import FORMS, Many, Section, Size, visit_values
from deepbots_cli.scenario.fields import (
    FilePath,
    LocalName,
    PlainText,
    Reference,
    Scalar,
    SharedName,
    Text,
    Word,
)
from deepbots_cli.scenario.quantities import Expression, PositiveInt, Signal, Solved
from deepbots_cli.scenario.robots import Messages, Robot
from deepbots_cli.scenario.task import (
    Action,
    Agent,
    AgentOfSeveral,
    Augmentation,
    Disturbance,
    Ending,
    Evaluation,
    Goal,
    Observation,
    Reset,
    Reward,
    Role,
    ScenarioTest,
    Script,
    Termination,
    Truncation,
    Tune,
)
from deepbots_cli.scenario.training import AnyTraining, Levels, Stage
from deepbots_cli.scenario.world import AnyObject, World

# Deployment

ROS_TYPES = (
    "sensor_msgs/JointState",
    "sensor_msgs/LaserScan",
    "sensor_msgs/Range",
    "sensor_msgs/Imu",
    "sensor_msgs/Image",
    "sensor_msgs/CompressedImage",
    "geometry_msgs/Twist",
    "geometry_msgs/PoseStamped",
    "geometry_msgs/WrenchStamped",
    "nav_msgs/Odometry",
    "std_msgs/Float64MultiArray",
)
"""The types that `PARTS` of `deepbots_robot.topics` describes: the language has them also where
deepbots-robot is not installed."""
ROS_TOPIC = Text("a topic of ROS 2", r"/[A-Za-z][A-Za-z0-9_]*(/[A-Za-z][A-Za-z0-9_]*)*", "/joint_states")


class Deploy(Section):
    """What a real robot needs that has no supervisor; `deepbots export` writes it into the bundle."""

    supplied_by: dict[Annotated[str, Reference("reading")], PlainText] = {}
    """What supplies each reading of the world that the policy needs and no robot measures, such as
    `position(ball): motion capture`."""


class RosTopic(Section):
    """The ROS 2 topic of a sensor, a reading of the world or an actuator."""

    topic: Annotated[str, ROS_TOPIC]
    """Name of the topic, such as `/joint_states`."""
    type: Annotated[str, Word(ROS_TYPES)]
    """Type of its messages. The message must have a part with the unit and the number of values of the
    sensor, reading or actuator."""
    part: PlainText | None = None
    """Part of the message, such as `velocity` or `linear.x`. Default: the part whose unit and number of
    values fit."""


# The whole file

VERSION = 1
"""The version of the language that is read."""
TITLE = Text(
    "a name",
    r"[A-Za-z][A-Za-z0-9_-]{0,63}",
    "CartPole",
    role="the name of a scenario",
    help="use letters, digits, `_` and `-`, at most 64, and begin with a letter",
)
_OF_ONE_AGENT: Mapping[str, Any] = {
    "action": {"none": "-1 .. 1"},
    "observation": {"none": "-1 .. 1"},
    "reward": {"none": 0},
}
"""Stand-ins for the sections that a scenario with one agent requires."""


class Scenario(Section):
    """One task: world, robots, messages, observation, reward, endings, resets, training.

    You can build a scenario in Python from nested models, mappings and plain values. An unknown key, or a
    value of the wrong type or form, raises `pydantic.ValidationError`. `deepbots_cli.api.lint` and
    `deepbots_cli.compile` check the scenario as a whole.
    """

    deepbots: PositiveInt
    """Version of the scenario language: `1`."""
    name: Annotated[str, TITLE]
    """Name of the scenario; runs are named after it."""
    summary: PlainText = ""
    """One sentence about the task."""
    parameters: dict[SharedName, Annotated[Scalar, Expression("parameter")]] = {}
    """Values, each under a name that you choose: constants, or draws such as `uniform(0 .. 1 m)` that are new
    in every episode."""
    world: World
    """The simulated world: timestep, physics engine, gravity, ground, arena."""
    objects: dict[SharedName, AnyObject] = {}
    """Bodies other than robots, each under a name that you choose."""
    robots: Annotated[dict[SharedName, Robot], Size(1, "robot")]
    """The robots, each under a name that you choose."""
    messages: Messages = Field(default_factory=Messages)
    """Messages between supervisor and robots."""
    action: Annotated[dict[SharedName, Action], Size(1, "action")]
    """Actions of the agent, each under a name that you choose: a range, or choices."""
    agent: Agent = Field(default_factory=Agent)
    """How the policy acts: action repeat, frame stack, one policy for all copies."""
    augment: Augmentation = {}
    """Values from the supervisor that the policy may observe, in addition to values that robots send."""
    signals: dict[SharedName, Signal] = {}
    """Helper values for reward, endings and scripts. The policy cannot observe them; list values for the
    policy under `augment`."""
    goal: Goal | None = None
    """The goal of an episode: a value to reach."""
    observation: Annotated[Observation, Size(1, "entry")]
    """Entries of the observation: for each, the name of a value and the range that deepbots maps to [-1, 1].
    The policy gets them in the order of the file."""
    critic: Observation = {}
    """Values that only the critic gets, in training: the value function of the algorithm sees them in
    addition to the observation, the policy does not. They may be signals and parameters, such as a friction
    that was drawn."""
    reward: Annotated[Reward, Size(1, "term")]
    """Terms of the reward, each under a name that you choose. Each term is a plain number; the reward is
    their sum."""
    termination: Termination = Field(default_factory=Termination)
    """Endings of the task: success and failure."""
    truncation: Truncation | None = None
    """Limits that cut an episode short."""
    reset: Reset = Field(default_factory=Reset)
    """How an episode begins."""
    disturbances: dict[SharedName, Disturbance] = {}
    """Pushes and gusts, each under a name that you choose."""
    scripts: dict[LocalName, Script] = {}
    """Hand-written policies, each under a name that you choose: an expression for every part of the
    action."""
    curriculum: Annotated[Annotated[Many[Stage], Size(1, "stage")] | Levels, FORMS] = ()
    """Stages of increasing difficulty, one after the other, or a level for each world."""
    evaluation: Evaluation = Field(default_factory=Evaluation)
    """Evaluation of a trained policy."""
    solved: Annotated[str, Solved()] | None = None
    """When the task is solved: a minimum of `mean_return` or `success_rate` over the last episodes."""
    train: AnyTraining | None = None
    """How the policy is trained. Without it, `deepbots train` chooses the learner."""
    tune: Tune | None = None
    """A search for better values of the scenario."""
    deploy: Deploy | None = None
    """What a real robot needs; with this section, `lint` reports readings of the world that nothing supplies
    (DB617)."""
    ros: dict[Annotated[str, Reference("sensor, reading or actuator")], RosTopic] = {}
    """ROS 2 topics, for `deepbots serve --ros`: of sensors and actuators (`cart.pole_angle`), and of readings
    of the world that no robot measures (`position(ball)`). `deepbots inspect --ros` prints this section with
    a topic for each of them; it is used where there is no entry."""
    tests: dict[LocalName, ScenarioTest] = {}
    """Tests for `deepbots test`, each under a name that you choose: who acts, and the expected result."""
    agents: Annotated[dict[SharedName, AgentOfSeveral], Size(2, "agent")] | None = None
    """Several agents, each with a policy of its own, in place of `action`, `observation`, `reward` and the
    like at the top level."""
    endings: dict[SharedName, Ending] = {}
    """Endings of the task of several agents, each under a name that you choose, in place of `termination`."""
    role: Role | None = None
    """Which of several agents a policy plays, and who acts for the others. Without it, the scenario is that
    of all agents."""

    _pruned: frozenset[NodePath] = PrivateAttr(frozenset())

    @model_validator(mode="wrap")
    @classmethod
    def _leave_sections_to_agents(cls, data: Any, handler: Callable[[Any], Self]) -> Self:
        """With several agents, the sections that a scenario with one requires are in those of the agents."""
        if not isinstance(data, Mapping) or data.get("agents") is None:
            return handler(data)
        missing = {key: value for key, value in _OF_ONE_AGENT.items() if key not in data}
        scenario = handler({**data, **missing})
        for key in missing:
            # The model is frozen, and a stand-in is not a value that the user has set.
            scenario.__dict__[key] = {}
            scenario.model_fields_set.discard(key)
        return scenario

    @property
    def stages(self) -> tuple[Stage, ...]:
        """The stages of the curriculum; none if it has levels."""
        return () if isinstance(self.curriculum, Levels) else self.curriculum

    @property
    def defines_success(self) -> bool:
        """Whether an ending, a goal or a limit is a success."""
        is_limit = self.truncation is not None and bool(self.truncation.success)
        return bool(self.termination.success) or self.goal is not None or is_limit

    @property
    def levels(self) -> Levels | None:
        """The levels of the curriculum; None if it has stages."""
        return self.curriculum if isinstance(self.curriculum, Levels) else None

    @property
    def pruned(self) -> frozenset[NodePath]:
        """The paths that `validate` removed because they had findings; their names are known, their values
        are not."""
        return self._pruned

    @classmethod
    def from_yaml(cls, path: str | pathlib.Path) -> Self:
        """Load a scenario from a file, including the files that it extends and includes. Paths of other files
        become absolute. Where an agent has some keys of `train`, those at the top level are added.

        Raises:
            ScenarioError: The file has findings at error level.
            UsageError: The file does not exist.
        """
        from deepbots_cli.diagnostics import Findings, Span
        from deepbots_cli.document import descend, load, shipped, to_data, walk
        from deepbots_cli.document.load import with_settings_at
        from deepbots_cli.errors import ScenarioError
        from deepbots_cli.scenario.validate import findings_of, validate

        document = load(path)
        root = None if document.root is None else with_whole_training(document.root)
        scenario = validate(root, document.findings) if root is not None else None
        if root is None or scenario is None or document.findings.errors:
            raise ScenarioError(list(document.findings))
        data: Any = to_data(root)
        variants: list[NodePath] = [("evaluation", "cases", name) for name in scenario.evaluation.cases]
        variants += [("curriculum", number) for number in range(len(scenario.stages))]
        files: dict[Span, str] = {}
        for version in (root, *(with_settings_at(root, variant) for variant in variants)):
            model = validate(version, Findings())
            for place, kind, value in visit_values(model) if model is not None else ():
                span = descend(version, place)[0].span
                file = document.directory_of(span) / str(value)
                if isinstance(kind, FilePath) and value not in shipped.robot_names() and file.exists():
                    files[span] = str(file.resolve())
        for place, node in walk(root):
            if node.span in files:
                holder = data
                for step in place[:-1]:
                    holder = holder[step]
                holder[place[-1]] = files[node.span]
        try:
            return cls.model_validate(data)
        except ValidationError as invalid:  # `validate` leaves the syntax of expressions to the compiler
            raise ScenarioError(findings_of(root, data, invalid)) from None

    def to_yaml(self) -> str:
        """Return the scenario as YAML text, without the values that were not set."""
        import yaml

        # By default, PyYAML sorts the keys and writes other characters than ASCII as escapes.
        return yaml.safe_dump(
            self.model_dump(mode="json", exclude_unset=True), sort_keys=False, allow_unicode=True, width=120
        )

    @classmethod
    def model_json_schema(cls, *args: Any, **kwargs: Any) -> dict[str, Any]:
        """Return the JSON Schema for editors, whatever the arguments."""
        from deepbots_cli.scenario.json_schema import json_schema

        return json_schema()


def with_whole_training(root: MappingNode) -> MappingNode:
    """Return the scenario in which the `train` of each agent has the keys at the top level too."""
    agents, shared = node_at(root, "agents"), node_at(root, "train")
    if not isinstance(agents, MappingNode) or not isinstance(shared, MappingNode):
        return root
    sections = {}
    for name, entry in agents.entries.items():
        section = entry.value
        train = node_at(entry.value, "train")
        if isinstance(section, MappingNode) and isinstance(train, MappingNode):
            whole = replace(train, entries={**shared.entries, **train.entries})
            training = section.entries["train"]._replace(value=whole)
            section = replace(section, entries={**section.entries, "train": training})
        sections[name] = entry._replace(value=section)
    divided = root.entries["agents"]._replace(value=replace(agents, entries=sections))
    return replace(root, entries={**root.entries, "agents": divided})
