"""Bodies in PyBullet: links and joints by name, frames of links and of their inertia."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from deepbots_cli import frames
from deepbots_cli.engines.objects import held_by
from deepbots_cli.engines.pybullet import BASE
from deepbots_cli.engines.pybullet import pybullet as p
from deepbots_cli.frames import IDENTITY_FRAME, Frame
from deepbots_cli.port import STILL

if TYPE_CHECKING:
    from deepbots_cli.frames import Quaternion, Triple
    from deepbots_cli.robots.model import Link, RobotModel


@dataclass(frozen=True)
class Dynamics:
    """What the world model says of a link: mass (kg), principal moments (kg m^2), and its frame of inertia in its own frame."""

    mass: float
    moments: Triple
    inertia_frame: Frame


class Body:
    """One PyBullet body.

    `brakes` is the friction (N m or N) of each joint by index, `anchor` a link that moves and touches, `still` the links
    that never move.
    """

    def __init__(self, name: str, number: int, model: RobotModel, fixed: bool, client: int) -> None:
        self.name = name
        self.suspended = False
        self.number = number
        self.model = model
        self.fixed = fixed
        self.links = {model.root: BASE}
        self.joints: dict[str, int] = {}
        for index in range(p.getNumJoints(number, client)):
            info = p.getJointInfo(number, index, client)
            self.joints[info[1].decode()] = index
            self.links[info[12].decode()] = index
        self.brakes = {self.joints[joint.name]: joint.friction for joint in model.moving_joints}
        self.still = frozenset(held_by(model, model.root) if fixed else ())
        touching = [self.links[link.name] for link in model.links if link.collisions and link.name not in self.still]
        self.anchor = touching[0] if touching else None
        self._client = client
        self._dynamics: dict[int, Dynamics] = {}
        self.centre, self.principal = self.dynamics(BASE).inertia_frame
        self._back = frames.inverse(self.principal)
        self._parallel = self.principal == frames.IDENTITY_ROTATION
        self.home: Frame = IDENTITY_FRAME
        self._weights: dict[int, tuple[float, Triple]] = {}

    def dynamics(self, index: int) -> Dynamics:
        """Of a link as it was loaded: first asked for, and so kept, before anything may vary."""
        if index not in self._dynamics:
            info = p.getDynamicsInfo(self.number, index, self._client)
            self._dynamics[index] = Dynamics(info[0], info[2], (info[3], info[4]))
        return self._dynamics[index]

    def link(self, index: int) -> Link:
        return self.model.link(next(name for name, its in self.links.items() if its == index))

    def weigh(self, index: int, factor: float) -> None:
        """So many times the mass that a link was loaded with, and the inertia."""
        loaded = self.dynamics(index)
        self._weights[index] = loaded.mass * factor, frames.scaled(loaded.moments, factor)
        if not self.suspended:
            self._apply_weight(index)

    def _apply_weight(self, index: int) -> None:
        """One call for both: a mass alone would get the inertia of the link's shape."""
        mass, moments = self._weights[index]
        p.changeDynamics(self.number, index, mass=mass, localInertiaDiagonal=moments, physicsClientId=self._client)

    def suspend(self) -> None:
        """Stay where it is put, at no cost: PyBullet takes a body without mass for a fixed one. Nothing for a fixed body."""
        if not self.fixed and not self.suspended:
            self.suspended = True
            p.changeDynamics(self.number, BASE, mass=0.0, physicsClientId=self._client)

    def wake(self) -> None:
        """Move again, as heavy as it was told to be."""
        if self.suspended:
            self.suspended = False
            if BASE not in self._weights:
                self.weigh(BASE, 1.0)
            self._apply_weight(BASE)

    @property
    def centred(self) -> bool:
        """Whether the root link's frame is that of its inertia, so that PyBullet's figures are ours."""
        return self.centre == STILL and self._parallel

    def of_centre(self, position: Triple, orientation: Quaternion) -> Frame:
        """The pose of the inertia, from that of the root link."""
        if self.centred:
            return position, orientation
        return frames.add(position, frames.rotate(orientation, self.centre)), frames.multiply(orientation, self.principal)

    def of_origin(self, position: Triple, orientation: Quaternion) -> Frame:
        """The pose of the root link, from that of the inertia."""
        turned = orientation if self._parallel else frames.multiply(orientation, self._back)
        return frames.subtract(position, frames.rotate(turned, self.centre)), turned
