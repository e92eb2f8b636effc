"""Worlds as literals, small enough to reason about, and a factory of engines that closes what it opened."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from math import cos, pi, sin

import pytest

from deepbots_cli.engines import ENGINES, create
from deepbots_cli.port import Engine
from deepbots_cli.program.world import Arena, Ground, ObjectBody, RobotBody, WorldModel
from deepbots_cli.robots.model import (
    Box,
    Cylinder,
    Friction,
    Geometry,
    Inertial,
    Joint,
    Limit,
    Link,
    Pose,
    RobotModel,
    Sphere,
)


def rod(name: str, mass: float = 0.1, length: float = 1.0) -> Link:
    """A thin rod upright on its frame."""
    across = mass * length * length / 12
    return Link(name, Inertial(mass, Pose((0, 0, length / 2)), ixx=across, iyy=across, izz=1e-5))


def block(name: str, mass: float = 1.0) -> Link:
    return Link(name, Inertial(mass, ixx=0.01, iyy=0.01, izz=0.01))


def cart() -> RobotModel:
    """A hull of two boxes on four wheels, with a pole on a hinge."""
    wheels = [
        (f"wheel_{i}", x, y)
        for i, (x, y) in enumerate(((0.06, 0.05), (0.06, -0.05), (-0.06, 0.05), (-0.06, -0.05)))
    ]
    tire = (Geometry(Cylinder(0.04, 0.02), Pose(rpy=(pi / 2, 0, 0))),)
    hull = tuple(Geometry(Box((0.08, 0.05, 0.04)), Pose((x, 0, 0.02))) for x in (0.06, -0.06))
    links = (
        Link("body", Inertial(2.0, ixx=0.0015, iyy=0.0077, izz=0.0071), hull, hull),
        *(
            Link(name, Inertial(0.1, ixx=4e-5, iyy=8e-5, izz=4e-5), tire, tire, Friction(1.0))
            for name, _, _ in wheels
        ),
        rod("pole", 0.2),
    )
    joints = (
        *(Joint(name, "continuous", "body", name, Pose((x, y, 0)), (0, 1, 0)) for name, x, y in wheels),
        Joint("hinge", "revolute", "body", "pole", Pose((0, 0, 0.03)), (0, 1, 0), Limit(-1.3, 1.3)),
    )
    return RobotModel("cart", links, joints, root="body")


@dataclass(frozen=True)
class Worlds:
    """Builders of worlds; one control tick is `timestep` (s) of `substeps` engine steps."""

    @staticmethod
    def rail(
        timestep: float = 0.02,
        substeps: int = 4,
        damping: float = 0.0,
        friction: float = 0.0,
        limit: Limit | None = None,
    ) -> WorldModel:
        """A cart of 1 kg on a rail, with a rod of 0.1 kg and 1 m on a free hinge and a massless tip at its
        end."""
        model = RobotModel(
            "rail",
            (block("rail"), block("cart"), rod("pole"), Link("tip")),
            (
                Joint(
                    "slide",
                    "prismatic",
                    "rail",
                    "cart",
                    axis=(1, 0, 0),
                    limit=limit or Limit(),
                    damping=damping,
                    friction=friction,
                ),
                Joint("hinge", "continuous", "cart", "pole", axis=(0, 1, 0)),
                Joint("end", "fixed", "pole", "tip", origin=Pose((0, 0, 1))),
            ),
            root="rail",
        )
        return WorldModel(
            timestep,
            substeps,
            ground=None,
            robots=(RobotBody("robot", model, fixed_base=True, pose=Pose((0, 0, 1))),),
        )

    @staticmethod
    def rotor(timestep: float = 0.02, substeps: int = 4) -> WorldModel:
        """A link on a vertical hinge, whose center of mass lies off the axis, weightless."""
        arm = Link("arm", Inertial(2.0, Pose((0.3, 0.1, 0)), ixx=0.02, iyy=0.02, izz=0.02))
        hinge = Joint("hinge", "continuous", "base", "arm", origin=Pose((0.2, 0, 0)), axis=(0, 0, 1))
        model = RobotModel("rotor", (block("base"), arm), (hinge,), root="base")
        return WorldModel(
            timestep, substeps, (0, 0, 0), None, robots=(RobotBody("robot", model, fixed_base=True),)
        )

    @staticmethod
    def crooked(timestep: float = 0.02, substeps: int = 4) -> WorldModel:
        """A free body whose center of mass and principal axes are not those of its frame."""
        inertial = Inertial(
            0.7, Pose((0.1, -0.2, 0.05), (0.3, 0.2, -0.4)), 0.01, 0.002, 0.001, 0.02, -0.001, 0.025
        )
        model = RobotModel("stone", (Link("stone", inertial),), (), root="stone")
        return WorldModel(timestep, substeps, ground=None, robots=(RobotBody("robot", model),))

    @staticmethod
    def ball(height: float = 5.0) -> WorldModel:
        return WorldModel(
            0.02, 4, ground=None, objects=(ObjectBody("ball", Sphere(0.1), Pose((0, 0, height)), 0.5),)
        )

    @staticmethod
    def arena(timestep: float = 0.032, substeps: int = 4, carts: int = 1) -> WorldModel:
        """Carts of four driven wheels and a pole, a ball that rolls, a box and a drum, between walls."""
        places = ((0.0, 0.0), (0.0, 0.25), (0.0, -0.25))[:carts]
        names = ("robot", "second", "third")
        things = (
            ObjectBody("ball", Sphere(0.05), Pose((0.3, 0.02, 0.05)), 0.1),
            ObjectBody("crate", Box((0.1, 0.1, 0.1)), Pose((-0.3, 0.03, 0.05)), 0.1),
            ObjectBody("drum", Cylinder(0.04, 0.1), Pose((0.2, -0.3, 0.05)), 0.1),
            ObjectBody("mark", Sphere(0.03), Pose((0.0, 0.3, 0.05)), solid=False),
        )
        robots = tuple(
            RobotBody(name, cart(), pose=Pose((x, y, 0.04)))
            for name, (x, y) in zip(names, places, strict=False)
        )
        return WorldModel(timestep, substeps, arena=Arena((1, 1), 0.1), robots=robots, objects=things)

    @staticmethod
    def slope(angle: float, friction: float) -> WorldModel:
        """A crate on the floor, with gravity tilted instead of the floor."""
        down = (9.81 * sin(angle), 0.0, -9.81 * cos(angle))
        crate = ObjectBody("crate", Box((0.2, 0.2, 0.1)), Pose((0, 0, 0.05)), 1.0, friction=friction)
        return WorldModel(0.02, 4, down, Ground(1.0), objects=(crate,))

    @staticmethod
    def stand(drop: float) -> WorldModel:
        """A trunk of 5 kg on a leg of 1 kg, above the ground."""
        foot = (Geometry(Box((0.2, 0.2, 0.1))),)
        leg = Link("leg", Inertial(1.0, ixx=0.01, iyy=0.01, izz=0.01), foot, foot)
        trunk = Link("trunk", Inertial(5.0, ixx=0.1, iyy=0.1, izz=0.1))
        knee = Joint("knee", "revolute", "trunk", "leg", Pose((0, 0, -0.1)), (0, 1, 0))
        model = RobotModel("stand", (trunk, leg), (knee,), root="trunk")
        return WorldModel(0.02, 4, robots=(RobotBody("robot", model, pose=Pose((0, 0, 0.15 + drop))),))


@pytest.fixture(params=sorted(ENGINES))
def engine_name(request: pytest.FixtureRequest) -> str:
    """Every engine of the table; each has to keep the promises of the port."""
    return request.param


@pytest.fixture(scope="session")
def worlds() -> Worlds:
    return Worlds()


@pytest.fixture
def build() -> Iterator[Callable[[str, WorldModel], Engine]]:
    """Builds engines, and closes them after the test: each may hold 29 MB."""
    opened: list[Engine] = []

    def build_one(name: str, world: WorldModel) -> Engine:
        opened.append(create(name, world))
        return opened[-1]

    yield build_one
    for engine in opened:
        engine.close()
