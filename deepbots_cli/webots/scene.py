"""Bodies, joints, geometries and devices of a world: what an engine builds. `scene_builder.py` reads them.

A body is what moves as one: a solid that stands alone, or is the end point of a joint, with all solids fixed
to it. A solid without physics that no joint carries does not move. `Scene.attachments` has the body and the
frame of every node with a pose, so that a supervisor can ask for it.

`port.Engine` is not used here, because its world model has no joints outside of robots, no ball joints, no
two joints between the same two bodies, no friction per pair of materials, and its motors reach a velocity as
fast as their torque allows; a motor of Webots takes one basic time step. So `physics.py` builds the model.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Literal

from deepbots_cli.frames import IDENTITY_ROTATION
from deepbots_cli.webots.nodes import boolean, text

if TYPE_CHECKING:
    from deepbots_cli.frames import Frame, Triple
    from deepbots_cli.webots.project import Files
    from deepbots_cli.webots.shapes import Shape
    from deepbots_cli.webots.syntax import Node

ORIGIN: Frame = ((0.0, 0.0, 0.0), IDENTITY_ROTATION)
AXES: tuple[Triple, ...] = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))

DEVICES = frozenset(
    [
        "Accelerometer",
        "Altimeter",
        "Brake",
        "Camera",
        "Compass",
        "Connector",
        "Display",
        "DistanceSensor",
        "Emitter",
        "GPS",
        "Gyro",
        "InertialUnit",
        "LED",
        "Lidar",
        "LightSensor",
        "LinearMotor",
        "Microphone",
        "Pen",
        "PositionSensor",
        "Radar",
        "Radio",
        "RangeFinder",
        "Receiver",
        "RotationalMotor",
        "Skin",
        "Speaker",
        "TouchSensor",
        "VacuumGripper",
    ]
)


@dataclass(eq=False)
class Geometry:
    """A shape of a bounding object: its frame in the body, the material, and the mass it adds (kg)."""

    shape: Shape
    frame: Frame
    material: str
    owner: Node
    mass: float = 0.0
    reflection: float = 0.6
    """The share of infra-red light that it reflects."""


@dataclass(eq=False)
class Visual:
    """A Shape node that is seen: its frame in the body, or in the world without one, and the scale there."""

    node: Node
    body: Body | None
    frame: Frame
    scale: Triple


@dataclass(eq=False)
class Light:
    """A light: its node, and the frame of that node in the body, or in the world without one."""

    node: Node
    body: Body | None
    frame: Frame


@dataclass(eq=False)
class Inertia:
    """The mass (kg) and inertia (kg m^2: xx, yy, zz, xy, xz, yz about the center) that a solid states."""

    mass: float
    frame: Frame
    matrix: tuple[float, ...]


@dataclass(eq=False)
class Joint:
    """A joint of a body with its parent: axis and anchor (m) in the frame of the body at the first position.

    Positions are in rad or m, and 0 for both limits means none. `parameters` is the node with its position,
    `index` the number of its axis among those of the node.
    """

    kind: Literal["hinge", "slide", "ball"]
    axis: Triple
    anchor: Triple
    position: float = 0.0
    limits: tuple[float, float] = (0.0, 0.0)
    stiffness: float = 0.0
    damping: float = 0.0
    friction: float = 0.0
    node: Node | None = None
    parameters: Node | None = None
    motor: Node | None = None
    index: int = 0


@dataclass(eq=False)
class Body:
    """A body: its frame in its parent, or in the world; its joints, geometries and stated inertias.

    `is_free` says that it moves without a joint. Velocities are those at the start: m/s and rad/s. `damping`
    has the shares of its linear and its angular velocity that it loses per s.
    """

    index: int
    node: Node
    parent: Body | None
    frame: Frame
    robot: Robot | None
    is_free: bool = False
    is_dynamic: bool = False
    joints: list[Joint] = field(default_factory=list)
    geometries: list[Geometry] = field(default_factory=list)
    inertias: list[Inertia] = field(default_factory=list)
    damping: tuple[float, float] = (0.0, 0.0)
    velocity: tuple[Triple, Triple] = ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0))


@dataclass(eq=False)
class Device:
    """A device of a robot: its node, its body and frame there, and the joint of a motor or sensor."""

    node: Node
    type: str
    name: str
    body: Body
    frame: Frame = ORIGIN
    joint: Joint | None = None


@dataclass(eq=False)
class Robot:
    """A robot: its node as it is written, the node it stands for, and its devices by name."""

    written: Node
    node: Node
    index: int
    devices: dict[str, Device] = field(default_factory=dict)

    @property
    def name(self) -> str:
        return text(self.node, "name")

    @property
    def is_supervisor(self) -> bool:
        return boolean(self.node, "supervisor")

    @property
    def controller(self) -> str:
        return text(self.node, "controller")


@dataclass(frozen=True)
class Contact:
    """How two materials touch: friction, bounce, and the lowest speed (m/s) at which they bounce."""

    friction: float = 1.0
    rolling: Triple = (0.0, 0.0, 0.0)
    bounce: float = 0.5
    bounce_velocity: float = 0.01


@dataclass(eq=False)
class Scene:
    """The bodies, robots and settings of a world.

    `nodes` are the top nodes of the file, `seed` is that of all random numbers; `basic_step` is in ms,
    `gravity` in m/s^2. `attachments` maps each node with a pose to its body and its
    frame in the body. `outer_frames` maps nodes with a pose outside of bodies to their frame in the world.
    `parents` maps each node to the node above it.
    """

    nodes: list[Node]
    files: Files
    basic_step: int = 32
    gravity: Triple = (0.0, 0.0, -9.81)
    seed: int = 0
    bodies: list[Body] = field(default_factory=list)
    robots: list[Robot] = field(default_factory=list)
    contacts: dict[tuple[str, str], Contact] = field(default_factory=lambda: {("", ""): Contact()})
    """By two materials; ("", "") has the contact of all others."""
    attachments: dict[Node, tuple[Body, Frame]] = field(default_factory=dict)
    outer_frames: dict[Node, Frame] = field(default_factory=dict)
    parents: dict[Node, Node] = field(default_factory=dict)
    visuals: list[Visual] = field(default_factory=list)
    lights: list[Light] = field(default_factory=list)
    radar_targets: list[Node] = field(default_factory=list)
    """The solids that radars see."""

    def contact(self, first: str, second: str) -> Contact:
        """Return how two materials touch."""
        return (
            self.contacts.get((first, second)) or self.contacts.get((second, first)) or self.contacts["", ""]
        )
