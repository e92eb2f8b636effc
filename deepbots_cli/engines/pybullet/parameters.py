"""Parameters of the world that an episode varies; each change notes its way back, for the next reset."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import TYPE_CHECKING

from deepbots_cli.engines.objects import find
from deepbots_cli.engines.pybullet import BASE, GAINS
from deepbots_cli.engines.pybullet import pybullet as p
from deepbots_cli.errors import EngineError
from deepbots_cli.program.world import GROUND

if TYPE_CHECKING:
    from deepbots_cli.engines.objects import Pool
    from deepbots_cli.engines.pybullet.body import Body
    from deepbots_cli.engines.pybullet.cameras import Floor
    from deepbots_cli.frames import Triple
    from deepbots_cli.program.world import Colour, EngineParameter, WorldModel
    from deepbots_cli.robots.model import Friction

_CONTACT = {
    "lateral_friction": "lateralFriction",
    "spinning_friction": "spinningFriction",
    "rolling_friction": "rollingFriction",
    "restitution": "restitution",
}
"""PyBullet's names of the parameters of contacts."""


class Parameters:
    """Sets a parameter by the method of its name, with whose it is and the values.

    `light`, the brightness of pictures, and `gravity` (m/s^2) are as they are now; at first those of the world model.
    """

    def __init__(self, client: int, world: WorldModel, pools: dict[str, Pool[Body]], floor: Floor | None) -> None:
        self.light, self.gravity = world.light, world.gravity
        self._client, self._pools, self._floor = client, pools, floor
        self._ways_back: dict[object, Callable[[], object]] = {}

    def restore(self) -> None:
        """Bring back every parameter of the world model."""
        for back in self._ways_back.values():
            back()
        self._ways_back.clear()

    def set(self, what: EngineParameter, of: tuple[str, ...], values: Sequence[float]) -> None:
        """See `Engine.set_parameter`."""
        if what in _CONTACT:
            self._set_contact(_CONTACT[what], *of, *values)  # type: ignore[arg-type]
        else:
            getattr(self, f"_set_{what}")(*of, *values)

    def _body(self, name: str) -> Body:
        return find(self._pools, name, "the world has no body").chosen

    def _link(self, body: str, link: str) -> tuple[Body, int]:
        owner = self._body(body)
        return owner, find(owner.links, link, f"'{body}' has no link") if link else BASE

    def _joint(self, robot: str, joint: str) -> tuple[Body, int]:
        owner = self._body(robot)
        return owner, find(owner.joints, joint, f"'{robot}' has no joint")

    def _set_mass(self, body: str, link: str, mass: float) -> None:
        """That of the base of a fixed body means nothing, and would set it loose."""
        owner, index = self._link(body, link)
        if index == BASE and owner.fixed:
            return
        usual = owner.dynamics(index).mass
        if not (usual > 0.0 and mass > 0.0):
            raise EngineError(f"the mass of a link of '{owner.name}' cannot go from {usual:g} kg to {mass:g} kg")
        owner.weigh(index, mass / usual)
        self._ways_back["mass", owner.number, index] = partial(owner.weigh, index, 1.0)

    def _set_contact(self, name: str, body: str, link: str, value: float) -> None:
        """One call per property: two in one went to the root link."""
        owner, index = self._link(body, link)
        change = partial(p.changeDynamics, owner.number, index, physicsClientId=self._client)
        usual = contact_parameters(owner.model.link(link or owner.model.root).friction)
        change(**{name: value})
        self._ways_back[name, owner.number, index] = partial(change, **{name: usual[name]})

    def _set_joint_damping(self, robot: str, joint: str, damping: float) -> None:
        owner, index = self._joint(robot, joint)
        change = partial(p.changeDynamics, owner.number, index, physicsClientId=self._client)
        change(jointDamping=damping)
        self._ways_back["damping", owner.number, index] = partial(change, jointDamping=owner.model.joint(joint).damping)

    def _set_joint_friction(self, robot: str, joint: str, friction: float) -> None:
        """A reset brakes every joint anew, so there is no way back to note."""
        owner, index = self._joint(robot, joint)
        p.setJointMotorControl2(owner.number, index, p.VELOCITY_CONTROL, 0.0, 0.0, friction, *GAINS, self._client)

    def _set_gravity(self, x: float, y: float, z: float) -> None:
        self._ways_back.setdefault("gravity", partial(self._pull, self.gravity))
        self._pull((x, y, z))

    def _pull(self, gravity: Triple) -> None:
        self.gravity = gravity
        p.setGravity(*gravity, self._client)

    def _set_colour(self, body: str, link: str, *colour: float) -> None:
        if body == GROUND and self._floor is not None:
            self._floor.colour(colour)  # type: ignore[arg-type]
            self._ways_back["floor"] = partial(self._floor.colour, self._floor.usual)
            return
        owner, index = self._link(body, link)
        key = ("colour", owner.number, index)
        if key not in self._ways_back:
            shapes = p.getVisualShapeData(owner.number, physicsClientId=self._client)
            usual = [shape[7] for shape in shapes if shape[1] == index]
            self._ways_back[key] = partial(self._paint, owner.number, index, usual)
        p.changeVisualShape(owner.number, index, rgbaColor=colour, physicsClientId=self._client)

    def _paint(self, number: int, index: int, colours: list[Colour]) -> None:
        for place, colour in enumerate(colours):
            p.changeVisualShape(number, index, shapeIndex=place, rgbaColor=colour, physicsClientId=self._client)

    def _set_light(self, brightness: float) -> None:
        self._ways_back.setdefault("light", partial(setattr, self, "light", self.light))
        self.light = brightness


def contact_parameters(friction: Friction) -> dict[str, float]:
    """By PyBullet's names. The friction of a pair is a product, so silence means 1 for `lateral`, and 0 for the others."""
    return {
        "lateralFriction": 1.0 if friction.lateral is None else friction.lateral,
        "spinningFriction": friction.spinning or 0.0,
        "rollingFriction": friction.rolling or 0.0,
        "restitution": friction.restitution or 0.0,
    }
