"""Small worlds in the engine, and sensors in them, each with its device."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from math import pi

import pytest

from deepbots_cli.engines import create
from deepbots_cli.port import Engine
from deepbots_cli.program.robots import NoiseModel, Sensor
from deepbots_cli.program.world import Ground, ObjectBody, RobotBody, WorldModel
from deepbots_cli.robots.model import Box, Friction, Geometry, Inertial, Joint, Link, Pose, RobotModel
from deepbots_cli.runtime.sensing import Device, instrument
from deepbots_cli.runtime.streams import Streams
from deepbots_cli.scenario.sensors import SENSORS

TIMESTEP, SUBSTEPS = 0.02, 4
ORIGIN, ABOVE = Pose(), Pose((0, 0, 1))


def brick(side: float = 0.2, friction: float = 1.0) -> RobotModel:
    """A cube of 1 kg about its frame."""
    shape = (Geometry(Box((side, side, side))),)
    moment = side * side / 6
    link = Link("brick", Inertial(1.0, ixx=moment, iyy=moment, izz=moment), shape, shape, Friction(friction))
    return RobotModel("brick", (link,), (), root="brick")


def arm() -> RobotModel:
    """A link on a hinge about z, fixed to the world at (0, 0, 1)."""
    base = Link("base", Inertial(1.0, ixx=0.1, iyy=0.1, izz=0.1))
    arm = Link("arm", Inertial(1.0, Pose((0.25, 0, 0)), ixx=0.1, iyy=0.1, izz=0.1))
    return RobotModel(
        "arm", (base, arm), (Joint("hinge", "continuous", "base", "arm", axis=(0, 0, 1)),), root="base"
    )


@dataclass
class Scene:
    """A world that is running; `tick` lets it go on and samples the sensors."""

    engine: Engine
    world: WorldModel
    devices: list[Device]

    def sensor(self, sensor: Sensor) -> Device:
        sensor = replace(sensor, reader=SENSORS[sensor.kind].reader)
        device = Device(
            sensor, "robot", instrument(sensor, "robot", self.world, self.engine), self.world.timestep
        )
        self.devices.append(device)
        return device

    def begin(self) -> None:
        for device in self.devices:
            device.reset(Streams(1))

    def tick(self, number: int = 1) -> None:
        for _ in range(number):
            self.engine.step(self.world.substeps)
            for device in self.devices:
                device()


@pytest.fixture
def scene() -> Iterator[Callable[..., Scene]]:
    """`scene(model)` builds a world around one robot; keywords are those of the world model."""
    opened: list[Engine] = []

    def build(
        model: RobotModel,
        *,
        fixed: bool = False,
        pose: Pose = ABOVE,
        ground: bool = False,
        objects: tuple[ObjectBody, ...] = (),
        gravity: tuple[float, float, float] = (0.0, 0.0, -9.81),
        substeps: int = SUBSTEPS,
    ) -> Scene:
        world = WorldModel(
            TIMESTEP,
            substeps,
            gravity,
            Ground() if ground else None,
            None,
            (RobotBody("robot", model, fixed, pose),),
            objects,
        )
        engine = create("pybullet", world)
        opened.append(engine)
        return Scene(engine, world, [])

    yield build
    for engine in opened:
        engine.close()


def on(
    kind: str,
    link: str,
    components: tuple[str, ...] = ("x", "y", "z"),
    mount: Pose = ORIGIN,
    faults: NoiseModel | None = None,
) -> Sensor:
    return Sensor(kind, kind, (link,), components, "", mount=mount, faults=faults)


DEGREE = pi / 180
