"""An engine that follows a world of Webots.

The world moves in Webots. After each timestep, deepbots sets the engine to the poses and velocities of
Webots. So the engine computes every reading that these determine: poses, rays, clearances. Contacts come from
Webots, and the controllers of the robots drive the motors.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from deepbots_cli.port import ZERO_VECTOR, EngineProxy
from deepbots_cli.program.world import ARENA_WALLS

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from deepbots_cli.frames import Quaternion, Triple
    from deepbots_cli.port import ContactReader, Engine, MotorWriter, Part
    from deepbots_cli.program.world import EngineParameter, WorldModel
    from deepbots_cli.webots.bridge.plant import Plant

TOUCHING_M = 1e-3
"""The distance of two surfaces that touch, at a contact point of Webots."""


class MirrorEngine(EngineProxy):
    """The engine of a scenario in a world of Webots."""

    def __init__(self, engine: Engine, plant: Plant, world: WorldModel) -> None:
        super().__init__(engine)
        self.plant = plant
        self.timestep_ms = round(world.timestep * 1000)
        self._substeps = world.substeps
        self._others = [robot.name for robot in world.robots] + [body.name for body in world.objects]
        if world.arena is not None:
            self._others += ARENA_WALLS
        self.let_timestep_pass: Callable[[], None] = lambda: plant.wait(self.timestep_ms)
        """The function that lets a timestep pass."""
        self.is_starting = False
        """Whether the world is being placed for a new episode."""

    def reset(self) -> None:
        self.is_starting = True
        self.engine.reset()
        self.plant.reset(self.timestep_ms)
        self._bring_back()

    def _bring_back(self) -> None:
        """Set the world to the state after a reset: its physics steps within the timestep of the reset."""
        for body in self.plant.moving_bodies:
            self.plant.place(body, *self.engine.pose(body)(), ZERO_VECTOR, ZERO_VECTOR)
        for robot, joint in self.plant.joints:
            ((position, _),) = self.engine.joint_states(robot, (joint.name,))()
            self.plant.set_joint(robot, joint.name, position)

    def step(self, substeps: int) -> None:
        """Let the world run, in whole timesteps, and follow it."""
        for _ in range(max(1, round(substeps / self._substeps))):
            if self.is_starting:
                self.plant.wait(self.timestep_ms)
            else:
                self.let_timestep_pass()
        self.follow()

    def follow(self) -> None:
        """Take over the state of the world."""
        place_body, set_joint = self.engine.place, self.engine.set_joint
        for body in self.plant.moving_bodies:
            place_body(body, *self.plant.motion(body))
        for robot, joint in self.plant.joints:
            set_joint(robot, joint.name, *joint())

    def place(
        self,
        body: str,
        position: Triple,
        orientation: Quaternion,
        velocity: Triple = ZERO_VECTOR,
        angular_velocity: Triple = ZERO_VECTOR,
    ) -> None:
        self.engine.place(body, position, orientation, velocity, angular_velocity)
        self.plant.place(body, position, orientation, velocity, angular_velocity)

    def set_joint(self, robot: str, joint: str, position: float, velocity: float) -> None:
        self.engine.set_joint(robot, joint, position, velocity)
        self.plant.set_joint(robot, joint, position)

    def set_parameter(self, parameter: EngineParameter, owner: tuple[str, ...], *values: float) -> None:
        """Set a parameter of the engine; gravity also in the world. Webots changes no other in an episode."""
        self.engine.set_parameter(parameter, owner, *values)
        if parameter == "gravity":
            self.plant.set_gravity(values)

    def contact(
        self, one: Part, others: Sequence[Part] | None = None, *, ground: bool = True
    ) -> ContactReader:
        """Return whether `one` touches one of `others` at the end of a timestep."""
        touches = self.plant.touch(one)
        if others is None and ground:
            return touches
        if others is None:
            others = [(name, None) for name in self._others if name != one[0]]
        # Webots shows that a body touches anything, and the engine shows which other bodies are that near.
        gaps = [self.engine.clearance(one, part) for part in others]
        return lambda: touches() and any(gap() < TOUCHING_M for gap in gaps)

    def _no_motor(self, *_of: Any, **_limits: Any) -> MotorWriter:
        return lambda targets: None

    velocity_motor = _no_motor
    position_motor = _no_motor
    torque_motor = _no_motor
