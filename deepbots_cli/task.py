"""The checked task: typed expressions with their places. What lint rules read, and what is lowered.

Figures that are fixed (the world, robot bodies, training) are already in the form of the compiled
scenario; whatever has a value only in an episode or a step is a typed tree here.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from deepbots_cli import ir
from deepbots_cli.diagnostics import Span
from deepbots_cli.expressions.types import Components, Redraw, Typed


@dataclass(frozen=True, eq=False)
class Valued:
    """A named expression; `text` is what the user wrote, `owner` its place in the scenario, such as `reward.alive`.

    `redraw` says how often its draws are repeated within an episode, None for not at all. Of a `foreign` one, which is a
    function of Python, the tree tells the type only. With `noise`, the name has a noisy value, which is drawn once per tick.
    """

    name: str
    span: Span
    text: str
    typed: Typed
    owner: str
    redraw: Redraw | None = None
    foreign: ir.Foreign | None = None
    noise: TaskNoise | None = None

    @property
    def components(self) -> Components:
        return self.typed.type.components or ()


@dataclass(frozen=True, eq=False)
class Command:
    """What drives one actuator: one target per component, or one for all.

    That of a gripper is how far it is open, from 0 to 1: its joints are then between the two positions of `opening`.
    """

    actuator: ir.Actuator
    target: Valued
    opening: tuple[float, float] | None = None


@dataclass(frozen=True, eq=False)
class TaskRobot:
    """A robot controller with typed expressions; besides `receive`, it is sent the action variables that `commands` use."""

    name: str
    sensors: tuple[ir.Sensor, ...]
    actuators: tuple[ir.Actuator, ...]
    receive: tuple[Valued, ...]
    emit: tuple[Valued, ...]
    commands: tuple[Command, ...]


@dataclass(frozen=True, eq=False)
class TaskNoise:
    """The standard deviation of the noise on a value, per component or for all; `relative` to the value or in its unit."""

    deviation: Valued
    relative: bool


@dataclass(frozen=True, eq=False)
class TaskRoute:
    """What messages of one direction meet on their way; each robot draws its own figures. None is the default."""

    latency: Valued | None = None
    loss: Valued | None = None
    range: Valued | None = None
    burst: float | None = None
    order: ir.Order = "sent"
    on_loss: ir.OnLoss = "hold"


@dataclass(frozen=True, eq=False)
class ObservedValue:
    """An entry of the observation: its value, and the fixed bounds of each component in SI units."""

    value: Valued
    low: tuple[float, ...]
    high: tuple[float, ...]
    history: int = 1
    clip: bool = True
    noise: TaskNoise | None = None


@dataclass(frozen=True, eq=False)
class TaskGoal:
    """Where the agent has got and shall get, with the bounds of both per component, and how close counts as reached."""

    achieved: Valued
    desired: Valued
    low: tuple[float, ...]
    high: tuple[float, ...]
    within: float


@dataclass(frozen=True, eq=False)
class Forbidden:
    """A condition under which an option of a choice may not be chosen."""

    action: str
    option: str
    condition: Valued


@dataclass(frozen=True, eq=False)
class Pick:
    """How a script chooses: the first option whose condition holds, and `otherwise` if none does."""

    rules: tuple[tuple[str, Valued], ...]
    otherwise: str


@dataclass(frozen=True, eq=False)
class TaskScript:
    """A hand-written policy: for each part of the action, in its order, an option, or values in what the part's range is in.

    Of several components there is one value, a vector or for all of them, or one for each.
    """

    name: str
    parts: tuple[Pick | tuple[Valued, ...], ...]


@dataclass(frozen=True, eq=False)
class TaskEnding:
    value: Valued
    outcome: ir.Outcome


@dataclass(frozen=True, eq=False)
class Coordinate:
    """One number of a placement: a typed tree, or a turn drawn from the whole circle (`any`)."""

    owner: str
    typed: Typed | None

    @property
    def anywhere(self) -> bool:
        return self.typed is None


@dataclass(frozen=True, eq=False)
class Placement:
    """Where a body, or each present copy of a group, begins: x, y, z in m, roll, pitch, yaw in rad; what is not listed is 0.

    `rests` is an object without a height, which lies on the ground; `heading` (rad) is added to the yaw.
    """

    body: str
    coordinates: Mapping[str, Coordinate]
    velocity: Valued | None = None
    angular_velocity: Valued | None = None
    rests: bool = False
    heading: float = 0.0
    spot: ir.Region | ir.Cells | ir.Top | None = None
    clearance: float = 0.0
    at_most: int | None = None
    spacing: tuple[float, float] = (0.0, 0.0)
    owner: str = ""


@dataclass(frozen=True, eq=False)
class TaskLayout:
    """A way to arrange bodies, and its share of the episodes."""

    name: str
    share: float
    placements: tuple[Placement, ...]


@dataclass(frozen=True, eq=False)
class Beginnings:
    """Where bodies stand in every layout, the layouts in use, what must hold at the start, and how often to try."""

    placements: tuple[Placement, ...]
    layouts: tuple[TaskLayout, ...] = ()
    require: Valued | None = None
    attempts: int = 100


@dataclass(frozen=True, eq=False)
class TaskGroup:
    """Copies of a body: as many as there can be, and as there are in an episode."""

    name: str
    capacity: int
    count: Valued

    @property
    def copies(self) -> tuple[str, ...]:
        return tuple(f"{self.name}#{index + 1}" for index in range(self.capacity))


@dataclass(frozen=True, eq=False)
class JointStart:
    """Joints that start at a position (one value per joint, or one for all), at a velocity."""

    robot: str
    joints: tuple[str, ...]
    position: Valued
    velocity: Valued | None


@dataclass(frozen=True, eq=False)
class Varied:
    """A figure that every episode draws anew: an `ir.Variation` in the making.

    A vector has `components`; a single figure with `spread` is drawn anew for each of these, and then cut off at
    the limit in `most`, where there is one.
    """

    what: str
    of: tuple[str, ...]
    value: Valued
    components: Components | None = None
    spread: Components | None = None
    most: tuple[float | None, ...] = ()


@dataclass(frozen=True, eq=False)
class Push:
    """A disturbance: the first push at `first` (or after one `every`), further ones `every` later."""

    name: str
    body: str
    link: str | None
    force: Valued | None
    torque: Valued | None
    first: Valued | None
    every: Valued | None
    lasts: Valued


@dataclass(frozen=True, eq=False)
class Task:
    """One checked scenario. `order` lists augmentation and signals so that each comes after what it is made of."""

    name: str
    summary: str
    language: int
    world: ir.WorldModel
    robots: tuple[TaskRobot, ...]
    format: ir.MessageFormat
    timing: ir.Timing
    parameters: tuple[Valued, ...]
    action: tuple[ir.Choices | ir.Interval, ...]
    order: tuple[Valued, ...]
    observation: tuple[ObservedValue, ...]
    reward: tuple[Valued, ...]
    endings: tuple[TaskEnding, ...]
    truncation: ir.Truncation
    beginnings: Beginnings
    joint_starts: tuple[JointStart, ...]
    settle: float
    solved: ir.Solved | None
    training: ir.Training | None
    evaluation: ir.Evaluation
    augmented: frozenset[str]
    variations: tuple[Varied, ...] = ()
    colours: tuple[ir.Variation, ...] = ()
    agent: ir.Agent = ir.Agent()
    to_robot: TaskRoute = TaskRoute()
    from_robot: TaskRoute = TaskRoute()
    forbidden: tuple[Forbidden, ...] = ()
    disturbances: tuple[Push, ...] = ()
    goal: TaskGoal | None = None
    scripts: tuple[TaskScript, ...] = ()
    cases: tuple[TaskCase, ...] = ()
    curriculum: tuple[TaskStage, ...] = ()
    groups: tuple[TaskGroup, ...] = ()


@dataclass(frozen=True, eq=False)
class TaskCase:
    """The task under the settings of a case of the evaluation."""

    name: str
    episodes: int
    task: Task


@dataclass(frozen=True, eq=False)
class TaskStage:
    """The task in a stage of the curriculum."""

    name: str
    until: ir.Criterion | None
    task: Task
