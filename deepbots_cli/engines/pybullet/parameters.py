"""Parameters of the world that an episode varies; each change notes its way back, for the next reset."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING

from deepbots_cli.engines.pybullet import BASE, GAINS
from deepbots_cli.engines.pybullet import pybullet as p
from deepbots_cli.errors import EngineError

if TYPE_CHECKING:
    from deepbots_cli.engines.pybullet.body import Body
    from deepbots_cli.engines.pybullet.cameras import Floor
    from deepbots_cli.frames import Triple
    from deepbots_cli.robots.model import Friction

Colour = tuple[float, float, float, float]


class Parameters:
    """`light`, the brightness of pictures, and `gravity` (m/s^2), as they are now; at first those of the world model."""

    def __init__(self, client: int, gravity: Triple, light: float) -> None:
        self.light = light
        self._client = client
        self.gravity = gravity
        self._ways_back: dict[object, Callable[[], object]] = {}

    def restore(self) -> None:
        """Bring back every parameter of the world model."""
        for back in self._ways_back.values():
            back()
        self._ways_back.clear()

    def set_mass(self, body: Body, index: int, mass: float) -> None:
        """That of the base of a fixed body means nothing, and would set it loose."""
        if index == BASE and body.fixed:
            return
        usual = body.dynamics(index).mass
        if not (usual > 0.0 and mass > 0.0):
            raise EngineError(f"the mass of a link of '{body.name}' cannot go from {usual:g} kg to {mass:g} kg")
        body.weigh(index, mass / usual)
        self._ways_back["mass", body.number, index] = partial(body.weigh, index, 1.0)

    def set_friction(self, body: Body, index: int, given: dict[str, float | None], nominal: Friction) -> None:
        """One call per property: two in one went to the root link."""
        change = partial(p.changeDynamics, body.number, index, physicsClientId=self._client)
        usual = contact_parameters(nominal)
        for what, value in given.items():
            if value is not None:
                change(**{what: value})
                self._ways_back[what, body.number, index] = partial(change, **{what: usual[what]})

    def set_joint_damping(self, body: Body, index: int, damping: float, nominal: float) -> None:
        change = partial(p.changeDynamics, body.number, index, physicsClientId=self._client)
        change(jointDamping=damping)
        self._ways_back["damping", body.number, index] = partial(change, jointDamping=nominal)

    def set_joint_friction(self, body: Body, index: int, friction: float) -> None:
        """A reset brakes every joint anew, so there is no way back to note."""
        p.setJointMotorControl2(body.number, index, p.VELOCITY_CONTROL, 0.0, 0.0, friction, *GAINS, self._client)

    def set_gravity(self, gravity: Triple) -> None:
        self._ways_back.setdefault("gravity", partial(self._pull, self.gravity))
        self._pull(gravity)

    def _pull(self, gravity: Triple) -> None:
        self.gravity = gravity
        p.setGravity(*gravity, self._client)

    def set_colour(self, body: Body, index: int, colour: Colour) -> None:
        key = ("colour", body.number, index)
        if key not in self._ways_back:
            shapes = p.getVisualShapeData(body.number, physicsClientId=self._client)
            usual = [shape[7] for shape in shapes if shape[1] == index]
            self._ways_back[key] = partial(self._paint, body.number, index, usual)
        p.changeVisualShape(body.number, index, rgbaColor=colour, physicsClientId=self._client)

    def _paint(self, number: int, index: int, colours: list[Colour]) -> None:
        for place, colour in enumerate(colours):
            p.changeVisualShape(number, index, shapeIndex=place, rgbaColor=colour, physicsClientId=self._client)

    def set_light(self, brightness: float) -> None:
        self._ways_back.setdefault("light", partial(setattr, self, "light", self.light))
        self.light = brightness

    def set_floor(self, floor: Floor, colour: Colour) -> None:
        floor.colour(colour)
        self._ways_back["floor"] = partial(floor.colour, floor.usual)


def contact_parameters(friction: Friction) -> dict[str, float]:
    """By PyBullet's names. The friction of a pair is a product, so silence means 1 for `lateral`, and 0 for the others."""
    return {
        "lateralFriction": 1.0 if friction.lateral is None else friction.lateral,
        "spinningFriction": friction.spinning or 0.0,
        "rollingFriction": friction.rolling or 0.0,
        "restitution": friction.restitution or 0.0,
    }
