"""The names of nodes, devices and channels in an exported world."""

from __future__ import annotations

import re

EMITTER, RECEIVER = "emitter", "receiver"
OWN_NODES = ("SUPERVISOR", "GROUND", "WORLD_INFO")
"""The DEF names that each project has."""


def def_name(*parts: str) -> str:
    """Return the DEF name of a body, or of its link or joint: `cart#1`, `pole` give `CART_1__POLE`."""
    name = "__".join(re.sub(r"\W", "_", part) for part in parts).upper()
    return f"N{name}" if name[0].isdigit() else name


def joint_def(robot: str, joint: str) -> str:
    """Return the DEF name of a joint node."""
    return def_name(robot, "joint", joint)


def controller_name(robot: str) -> str:
    """Return the name of the controller of a robot, which copies of a robot share."""
    return re.sub(r"\W", "_", robot.partition("#")[0])


def to_robot_channel(index: int) -> int:
    """Return the channel of the messages to the robot of a number, from 0."""
    return 2 * index + 1


def from_robot_channel(index: int) -> int:
    return 2 * index + 2


receiver_of = "receiver {}".format
"""Returns the name of the supervisor's receiver of messages from a robot."""
position_sensor = "{} sensor".format
gps, inertial_unit, gyro = "{} gps".format, "{} inertial unit".format, "{} gyro".format
"""Return the names of the sensors at a link."""
distance_sensor = "ray {}".format
"""Returns the name of the sensor of one ray, numbered over the robot."""
