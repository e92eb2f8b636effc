"""The devices of robots, as the module `controller` has them: the class of each, and those that do little.

Names and meanings are those of Webots' reference. An attribute of Webots that is missing here raises
`NotImplementedCallError` with its name.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from deepbots_cli.webots.cameras import Camera, RangeFinder
from deepbots_cli.webots.device import Device
from deepbots_cli.webots.joints import Brake, Motor, PositionSensor
from deepbots_cli.webots.lidar import Lidar
from deepbots_cli.webots.light import LightSensor
from deepbots_cli.webots.nodes import integer
from deepbots_cli.webots.radar import Radar
from deepbots_cli.webots.radio import Emitter, Receiver
from deepbots_cli.webots.sensors import (
    GPS,
    Accelerometer,
    Altimeter,
    Compass,
    DistanceSensor,
    Gyro,
    InertialUnit,
    TouchSensor,
)

if TYPE_CHECKING:
    from deepbots_cli.webots.scene import Device as Spec
    from deepbots_cli.webots.simulation import Simulation


class LED(Device):
    """A lamp: 0 is off, n its n-th color; a gradual one takes an RGB number."""

    def __init__(self, simulation: Simulation, spec: Spec) -> None:
        super().__init__(simulation, spec)
        self._value = 0

    def set(self, value: int) -> None:
        self._value = int(value)

    def get(self) -> int:
        return self._value


class Display(Device):
    """A display that nobody sees: what is drawn has no effect."""

    def _draw(self, *_: Any) -> None:
        """Do nothing."""

    setColor = setAlpha = setOpacity = setFont = _draw
    drawPixel = drawLine = drawRectangle = drawOval = drawPolygon = drawText = _draw
    fillRectangle = fillOval = fillPolygon = _draw

    def getWidth(self) -> int:
        return integer(self._spec.node, "width")

    def getHeight(self) -> int:
        return integer(self._spec.node, "height")


class Speaker(Device):
    """A speaker that nobody hears: sounds have no effect, and end at once."""

    def _sound(self, *_: Any, **__: Any) -> None:
        """Do nothing."""

    speak = stop = setEngine = setLanguage = _sound

    @staticmethod
    def playSound(left: Any, right: Any, *_: Any, **__: Any) -> None:
        """Do nothing."""

    def isSoundPlaying(self, sound: str = "") -> bool:
        return False

    def isSpeaking(self) -> bool:
        return False


class Connector(Device):
    """A connector: no function of it is implemented."""


class Pen(Device):
    """A pen: no function of it is implemented."""


class Microphone(Device):
    """A microphone: no function of it is implemented."""


class VacuumGripper(Device):
    """A vacuum gripper: no function of it is implemented."""


class Skin(Device):
    """A skin: no function of it is implemented."""


class Radio(Device):
    """A radio: no function of it is implemented."""


_CLASSES: dict[str, type[Device]] = {
    "RotationalMotor": Motor,
    "LinearMotor": Motor,
    **{
        kind.__name__: kind
        for kind in (
            *(PositionSensor, Brake, Gyro, Accelerometer, Compass, InertialUnit, GPS, Altimeter),
            *(DistanceSensor, TouchSensor, Emitter, Receiver, LED),
            *(Camera, RangeFinder, Lidar, Radar, LightSensor, Display, Speaker, Connector, Pen),
            *(Microphone, VacuumGripper, Skin, Radio),
        )
    },
}


def device_object(simulation: Simulation, spec: Spec) -> Device:
    """Return the object of a device; the same one each time."""
    if spec not in simulation.objects:
        simulation.objects[spec] = _CLASSES[spec.type](simulation, spec)
    device = simulation.objects[spec]
    assert isinstance(device, Device)
    return device
