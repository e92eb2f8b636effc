"""The engine port: all that the runtime asks of a physics engine.

SI units, world frame (x forward, y left, z up), quaternions (x, y, z, w). Bodies, links and joints go
by name. Whatever happens in every step is bound once, when the environment is built: the engine hands
out readers and writers, so that a step looks nothing up. A reader only reads; two calls between two
steps return equal values.

A further engine is one module in `engines/` with a class that fits `Engine`, and its line in
`engines/__init__.py`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal, Protocol

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from deepbots_cli.ir import WorldModel

    Image = NDArray[np.uint8]

Capability = Literal["contacts", "rendering"]
Triple = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]
JointStates = Sequence[Sequence[float]]
JointReader = Callable[[], JointStates]
"""One item per joint: position (rad or m) at index 0, velocity (rad/s or m/s) at index 1; what follows is the engine's."""
TorqueReader = Callable[[], Sequence[float]]
"""The torque (N m) or force (N) of the motor of each joint in the last engine step."""
PoseReader = Callable[[], tuple[Triple, Quaternion]]
"""Position of the link's origin (m), not of its centre of mass, and its orientation."""
VelocityReader = Callable[[], tuple[Triple, Triple]]
"""Velocity of the link's origin (m/s) and its angular velocity (rad/s), both in the world frame."""
MotorWriter = Callable[[Sequence[float]], object]
"""Sets one target per joint, in force until the next call; after a reset motors exert nothing until written.

The limits that a motor is bound with are infinite where a joint has none.
"""


@dataclass(frozen=True)
class View:
    """A camera that looks from `eye` at `target` (m), z up; `fov` is the vertical angle in rad.

    Each pixel is the mean of `samples` x `samples` points, which smooths edges.
    """

    eye: Triple
    target: Triple
    width: int = 480
    height: int = 320
    fov: float = 0.7
    samples: int = 2


class Engine(Protocol):
    """A physics engine that holds one world, for one environment."""

    name: str
    capabilities: frozenset[Capability]

    def reset(self) -> None:
        """Put every body where the world model has it, at rest, joints at 0, motors off, no memory of contacts.

        What follows is bit for bit what follows in a world that was just built.
        """

    def place(self, body: str, position: Triple, orientation: Quaternion) -> None:
        """Put the origin of a body's root link there, at rest. Meant between `reset` and the first step."""

    def set_joint(self, robot: str, joint: str, position: float, velocity: float) -> None:
        """Put a joint there (rad or m; rad/s or m/s). Meant between `reset` and the first step."""

    def step(self, substeps: int) -> None:
        """Advance by `substeps` engine steps of `timestep / substeps` of the world model each."""

    def require_finite(self) -> None:
        """Check every pose and joint.

        Raises:
            EngineError: A figure is not finite; names the body.
        """

    def joint_states(self, robot: str, joints: Sequence[str]) -> JointReader: ...

    def joint_torques(self, robot: str, joints: Sequence[str]) -> TorqueReader: ...

    def pose(self, body: str, link: str | None = None) -> PoseReader:
        """Of a link, or of the root link of a robot or object."""

    def velocity(self, body: str, link: str | None = None) -> VelocityReader: ...

    def velocity_motor(self, robot: str, joints: Sequence[str], max_torque: Sequence[float]) -> MotorWriter:
        """Drive joints towards target velocities (rad/s or m/s) with at most `max_torque` (N m or N)."""

    def position_motor(
        self, robot: str, joints: Sequence[str], max_torque: Sequence[float], stiffness: float | None, damping: float | None
    ) -> MotorWriter:
        """Drive joints towards target positions (rad or m).

        With stiffness (N m/rad or N/m) and damping (N m s/rad or N s/m) the torque is
        `stiffness * (target - position) - damping * velocity`, limited, renewed in every engine step, and
        None for `damping` is 0; without stiffness the engine's own servo closes all but 1/e of its error in
        `engines.servo.SERVO_TIME`, as far as the limit allows, and `damping` means nothing.
        """

    def torque_motor(self, robot: str, joints: Sequence[str], max_torque: Sequence[float]) -> MotorWriter:
        """Exert target torques (N m or N), limited, in every engine step until the next call."""

    def render(self, view: View) -> Image:
        """A picture of the world: uint8, shape (height, width, 3).

        Raises:
            EngineError: The engine cannot draw (no "rendering" among its capabilities).
        """

    def close(self) -> None:
        """Release the world; may be called twice."""


class EngineFactory(Protocol):
    """What `engines/` registers under a name."""

    def __call__(self, world: WorldModel) -> Engine: ...
