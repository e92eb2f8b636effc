"""Webots' module `controller`, for worlds that deepbots runs."""

from deepbots_webots.devices import (
    LED,
    Brake,
    Connector,
    Display,
    Emitter,
    Microphone,
    Motor,
    Pen,
    PositionSensor,
    Receiver,
    Skin,
    Speaker,
    VacuumGripper,
)
from deepbots_webots.imaging import Camera, Lidar, LidarPoint, Radar, RadarTarget, RangeFinder
from deepbots_webots.sensors import (
    GPS,
    Accelerometer,
    Altimeter,
    Compass,
    Device,
    DistanceSensor,
    Gyro,
    InertialUnit,
    LightSensor,
    TouchSensor,
    missing_name,
)
from deepbots_webots.supervisor import Keyboard, Robot, Supervisor
from deepbots_webots.tree import ContactPoint, Field, Node

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

__getattr__ = missing_name
