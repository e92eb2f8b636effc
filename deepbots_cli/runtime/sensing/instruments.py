"""What each kind of sensor measures."""

from __future__ import annotations

from collections.abc import Callable

from deepbots_cli import frames
from deepbots_cli.frames import Frame
from deepbots_cli.port import Engine
from deepbots_cli.program.robots import Sensor
from deepbots_cli.program.world import WorldModel
from deepbots_cli.runtime.sensing import brightness, camera, contacts, inertial, ranging
from deepbots_cli.runtime.sensing import frames as placed
from deepbots_cli.runtime.sensing.device import Instrument

OnLink = Callable[[Engine, str, str, Frame], Instrument]

_ON_LINKS: dict[str, OnLink] = {
    "position": placed.position,
    "orientation": placed.orientation,
    "velocity": placed.velocity,
    "angular_velocity": placed.angular_velocity,
    "compass": placed.compass,
    "gyro": inertial.gyro,
    "inclinometer": inertial.inclinometer,
}
_RANGING = frozenset({"infrared", "sonar", "laser", "lidar"})


def instrument(sensor: Sensor, robot: str, world: WorldModel, engine: Engine) -> Instrument:
    """The instrument of a sensor, whose readers are taken from `engine`.

    Raises:
        KeyError: The kind is in no table.
        EngineError: The robot has no such joint or link, or the engine cannot sense so.
    """
    kind, mount = sensor.kind, frames.frame(sensor.mount)
    if kind in _ON_LINKS:
        return _ON_LINKS[kind](engine, robot, sensor.subjects[0], mount)
    if kind in _RANGING:
        return ranging.ranging(engine, robot, sensor, mount)
    match kind:
        case "joint_position" | "joint_velocity":
            read, index = engine.joint_states(robot, sensor.subjects), int(kind == "joint_velocity")
            return Instrument(lambda: [state[index] for state in read()])
        case "joint_torque":
            return Instrument(engine.joint_torques(robot, sensor.subjects))
        case "accelerometer":
            imu = inertial.Accelerometer(engine, robot, sensor.subjects[0], mount, world.timestep)
            return Instrument(imu.read, imu.restart, imu.follow)
        case "touch":
            return contacts.touch(engine, robot, sensor)
        case "force":
            return contacts.force(engine, robot, sensor)
        case "reflectance":
            return brightness.reflectance(engine, robot, sensor, mount, world)
        case "camera":
            return camera.camera(engine, robot, sensor, mount)
    raise KeyError(kind)
