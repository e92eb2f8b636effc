"""Webots' module `controller`, for worlds that deepbots runs."""

from deepbots_cli.webots.cameras import Camera, RangeFinder
from deepbots_cli.webots.device import Device
from deepbots_cli.webots.devices import (
    LED,
    Connector,
    Display,
    Emitter,
    Microphone,
    Pen,
    Receiver,
    Skin,
    Speaker,
    VacuumGripper,
)
from deepbots_cli.webots.joints import Brake, Motor, PositionSensor
from deepbots_cli.webots.ranging import Lidar, LidarPoint, Radar, RadarTarget
from deepbots_cli.webots.sensors import (
    GPS,
    Accelerometer,
    Altimeter,
    Compass,
    DistanceSensor,
    Gyro,
    InertialUnit,
    LightSensor,
    TouchSensor,
)
from deepbots_cli.webots.supervisor import Keyboard, Robot, Supervisor
from deepbots_cli.webots.tree import ContactPoint, Field, Node
from deepbots_cli.webots.unimplemented import MISSING_CLASSES

__all__ = [
    "GPS",
    "LED",
    "Accelerometer",
    "Altimeter",
    "Brake",
    "Camera",
    "Compass",
    "Connector",
    "ContactPoint",
    "Device",
    "Display",
    "DistanceSensor",
    "Emitter",
    "Field",
    "Gyro",
    "InertialUnit",
    "Keyboard",
    "Lidar",
    "LidarPoint",
    "LightSensor",
    "Microphone",
    "Motor",
    "Node",
    "Pen",
    "PositionSensor",
    "Radar",
    "RadarTarget",
    "RangeFinder",
    "Receiver",
    "Robot",
    "Skin",
    "Speaker",
    "Supervisor",
    "TouchSensor",
    "VacuumGripper",
]


def __getattr__(name: str) -> object:
    if name in MISSING_CLASSES:
        raise ImportError(f"controller.{name} is not implemented")
    raise AttributeError(f"module 'controller' has no attribute '{name}'")
