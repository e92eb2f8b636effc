"""The compiled scenario: frozen, in SI units, free of YAML, of pydantic and of any engine.

    CompiledScenario
    ├── world         what an engine builds: timestep, ground, arena, robots as data, objects
    ├── robots        controllers: sensors, what they emit, what they apply, message layouts
    ├── parameters    values drawn per episode (fixed ones are folded into the expressions)
    ├── action        what the agent chooses and which variables that sets
    ├── signals       augmentation and helpers, in order of evaluation
    ├── observation   one entry per number that the policy sees
    ├── reward, endings, truncation, reset
    └── training, evaluation, solved

Expressions are scalar trees (`lang.scalar`). `canonical.py` writes all of it as canonical JSON, whose
digest identifies the scenario.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from deepbots_cli.lang.scalar import Scalar
from deepbots_cli.urdf.model import Pose, RobotModel, Shape, Vector

IR_VERSION = 1

# What one world and one reset may ask of an engine; beyond, building or resetting would take minutes.
MOST_BODIES = 500
MOST_SUBSTEPS = 10_000
MOST_SETTLING_STEPS = 100_000

MessageFormat = Literal["csv", "json", "struct", "msgpack", "none"]
Timing = Literal["immediate", "paper"]
Outcome = Literal["success", "failure"]
Direction = Literal["to_robot", "from_robot"]
ActuatorKind = Literal["velocity_motor", "position_motor", "torque_motor"]


# The world, as an engine builds it


@dataclass(frozen=True)
class Ground:
    """The plane z = 0; friction is Coulomb's coefficient."""

    friction: float = 1.0
    restitution: float = 0.0


@dataclass(frozen=True)
class Arena:
    """A rectangle of walls around the origin: inner size along x and y in m."""

    size: tuple[float, float]
    wall_height: float
    wall_thickness: float = 0.01
    friction: float = 1.0


@dataclass(frozen=True)
class ObjectBody:
    """A body that is no robot. Mass in kg; a fixed one never moves, one that is not solid is only seen."""

    name: str
    shape: Shape
    pose: Pose = Pose()
    mass: float = 0.0
    colour: tuple[float, float, float, float] = (0.7, 0.7, 0.7, 1.0)
    friction: float = 1.0
    fixed: bool = False
    solid: bool = True


@dataclass(frozen=True)
class RobotBody:
    """A robot in the world; `pose` places the origin of its root link when nothing else does."""

    name: str
    model: RobotModel
    fixed_base: bool = False
    pose: Pose = Pose()


@dataclass(frozen=True)
class WorldModel:
    """All that an engine needs. `timestep` (s) is one control tick, made of `substeps` engine steps."""

    timestep: float
    substeps: int
    gravity: Vector = (0.0, 0.0, -9.81)
    ground: Ground | None = Ground()
    arena: Arena | None = None
    robots: tuple[RobotBody, ...] = ()
    objects: tuple[ObjectBody, ...] = ()


# Robots as controllers


@dataclass(frozen=True)
class Field:
    """One named entry of a message; a vector lists its components."""

    name: str
    unit: str
    components: tuple[str, ...] = ()
    dtype: Literal["float64", "bool"] = "float64"


@dataclass(frozen=True)
class MessageLayout:
    """Fields in order, and a stamp (32 bits) that changes whenever they do."""

    robot: str
    direction: Direction
    fields: tuple[Field, ...]
    stamp: int


@dataclass(frozen=True)
class Sensor:
    """What a robot can read. `subjects` are joint names (joint kinds) or one link name (link kinds)."""

    name: str
    kind: str
    subjects: tuple[str, ...]
    components: tuple[str, ...]
    unit: str


@dataclass(frozen=True)
class Actuator:
    """What a robot can drive. Limits in N m or N, rad/s or m/s, one per joint; None is unlimited."""

    name: str
    kind: ActuatorKind
    joints: tuple[str, ...]
    max_torque: tuple[float | None, ...]
    max_velocity: tuple[float | None, ...]
    stiffness: float | None = None
    damping: float | None = None


@dataclass(frozen=True)
class NamedValues:
    """A named scalar (no components) or vector, with one expression per component."""

    name: str
    components: tuple[str, ...]
    values: tuple[Scalar, ...]


@dataclass(frozen=True)
class Robot:
    """A controller. `receive` holds supervisor expressions; `emit` and `apply` see sensors and received fields.

    Each entry of `apply` names an actuator and has one target per joint.
    """

    name: str
    sensors: tuple[Sensor, ...]
    actuators: tuple[Actuator, ...]
    receive: tuple[NamedValues, ...]
    emit: tuple[NamedValues, ...]
    apply: tuple[NamedValues, ...]
    to_robot: MessageLayout
    from_robot: MessageLayout


# The task


@dataclass(frozen=True)
class Option:
    """One choice of a discrete action: its name and the value of each variable that it sets."""

    name: str
    values: tuple[float, ...]


@dataclass(frozen=True)
class Choices:
    """A discrete part of the action."""

    name: str
    variables: tuple[str, ...]
    options: tuple[Option, ...]


@dataclass(frozen=True)
class Interval:
    """A continuous part of the action: the agent's [-1, 1] maps to [low, high], per component."""

    name: str
    components: tuple[str, ...]
    low: float
    high: float
    unit: str


@dataclass(frozen=True)
class Observed:
    """One number of the observation, mapped from [low, high] to [-1, 1] and clipped; a truth value is 0 or 1."""

    name: str
    component: str | None
    value: Scalar
    low: float
    high: float
    unit: str
    truth: bool = False

    @property
    def full_name(self) -> str:
        return self.name if self.component is None else f"{self.name}.{self.component}"


@dataclass(frozen=True)
class Term:
    """A named summand of the reward."""

    name: str
    value: Scalar


@dataclass(frozen=True)
class Ending:
    """A condition that terminates the episode."""

    name: str
    outcome: Outcome
    condition: Scalar


@dataclass(frozen=True)
class Truncation:
    """Limits that are no part of the task: agent steps, simulated seconds."""

    max_steps: int | None = None
    max_time: float | None = None


@dataclass(frozen=True)
class Place:
    """The pose of a body's root link origin at reset: x, y, z in m; roll, pitch, yaw in rad."""

    body: str
    xyz: tuple[Scalar, Scalar, Scalar]
    rpy: tuple[Scalar, Scalar, Scalar]


@dataclass(frozen=True)
class SetJoint:
    """The position of a joint at reset, in rad or m; its velocity in rad/s or m/s is 0 unless given."""

    robot: str
    joint: str
    position: Scalar
    velocity: Scalar


@dataclass(frozen=True)
class Reset:
    """In order: places, then joints, then `settle` seconds of physics with the actuators holding."""

    places: tuple[Place, ...] = ()
    joints: tuple[SetJoint, ...] = ()
    settle: float = 0.0


@dataclass(frozen=True)
class Solved:
    """What counts as solved, over `episodes` consecutive episodes."""

    episodes: int
    mean_return: float | None = None
    success_rate: float | None = None


@dataclass(frozen=True)
class Policy:
    """Hidden layers of actor and critic, and their activation."""

    hidden: tuple[int, ...] = (64, 64)
    activation: str = "tanh"


@dataclass(frozen=True)
class Schedule:
    """A figure that goes linearly from `start` to `end` over the training."""

    start: float
    end: float


@dataclass(frozen=True)
class Hyperparameter:
    """A figure of the algorithm, under the algorithm's own name for it."""

    name: str
    value: bool | int | float | str | Schedule | None


@dataclass(frozen=True)
class Training:
    algorithm: str
    total_timesteps: int
    environments: int = 1
    hyperparameters: tuple[Hyperparameter, ...] = ()
    policy: Policy = Policy()


@dataclass(frozen=True)
class Evaluation:
    episodes: int = 100


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
    parameters: tuple[NamedValues, ...]
    action: tuple[Choices | Interval, ...]
    signals: tuple[NamedValues, ...]
    observation: tuple[Observed, ...]
    reward: tuple[Term, ...]
    endings: tuple[Ending, ...]
    truncation: Truncation
    reset: Reset
    solved: Solved | None
    training: Training | None
    evaluation: Evaluation = Evaluation()
    version: int = IR_VERSION
