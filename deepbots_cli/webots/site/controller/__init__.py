"""Webots' module `controller`, for worlds that deepbots runs."""

from deepbots_cli.webots.api import MISSING_CLASSES
from deepbots_cli.webots.devices import (
    GPS,
    LED,
    Accelerometer,
    Altimeter,
    Brake,
    Camera,
    Compass,
    Connector,
    Device,
    Display,
    DistanceSensor,
    Emitter,
    Gyro,
    InertialUnit,
    Lidar,
    LidarPoint,
    LightSensor,
    Microphone,
    Motor,
    Pen,
    PositionSensor,
    Radar,
    RangeFinder,
    Receiver,
    Skin,
    Speaker,
    TouchSensor,
    VacuumGripper,
)
from deepbots_cli.webots.supervisor import ContactPoint, Field, Keyboard, Node, Robot, Supervisor

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
