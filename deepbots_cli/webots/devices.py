"""The devices of robots, as the module `controller` has them: emitters, receivers, those that do little, and
the class of each.

Names and meanings are those of Webots' reference. An attribute of Webots that is missing here raises
`NotImplementedCallError` with its name.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from deepbots_cli.webots.cameras import Camera, RangeFinder
from deepbots_cli.webots.device import Device, Sensor
from deepbots_cli.webots.joints import Brake, Motor, PositionSensor
from deepbots_cli.webots.nodes import integer, number, numbers
from deepbots_cli.webots.ranging import Lidar, Radar
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

if TYPE_CHECKING:
    from deepbots_cli.webots.scene import Device as Spec
    from deepbots_cli.webots.simulation import Packet, Simulation


class Emitter(Device):
    """Sends messages to the receivers of other robots."""

    CHANNEL_BROADCAST = -1

    def __init__(self, simulation: Simulation, spec: Spec) -> None:
        super().__init__(simulation, spec)
        self._channel = integer(spec.node, "channel")
        self._range = number(spec.node, "range")
        self._size = integer(spec.node, "bufferSize")

    def send(self, message: str | bytes | Sequence[float]) -> int:
        """Send a text, bytes or numbers; returns 1, or 0 if the message is larger than the buffer."""
        if isinstance(message, str):
            # A C string, as in Webots; it counts for the size of the buffer.
            data = message.encode("utf-8") + b"\0"
        elif isinstance(message, bytes | bytearray | memoryview):
            data = bytes(message)
        else:
            data = struct.pack(f"{len(message)}d", *message)
        if 0 <= self._size < len(data):
            return 0
        self._simulation.send(self._spec, data, self._channel, self._range)
        return 1

    def getChannel(self) -> int:
        return self._channel

    def setChannel(self, channel: int) -> None:
        allowed = numbers(self._spec.node, "allowedChannels")
        if allowed and channel not in allowed:
            self._warn(f"channel {channel} is not allowed")
            return
        self._channel = int(channel)

    def getRange(self) -> float:
        return self._range

    def setRange(self, range: float) -> None:
        most = number(self._spec.node, "maxRange")
        if most >= 0 and not 0 <= range <= most:
            self._warn(f"range {range:g} exceeds maxRange {most:g}, and is limited")
            range = most
        self._range = float(range)

    def getBufferSize(self) -> int:
        return self._size


class Receiver(Sensor):
    """Messages of other robots, in the order in which they were sent."""

    CHANNEL_BROADCAST = -1

    def __init__(self, simulation: Simulation, spec: Spec) -> None:
        super().__init__(simulation, spec)
        self._inbox = simulation.inboxes[spec]
        self._size = integer(spec.node, "bufferSize")

    def _begin(self) -> None:
        self._inbox.is_enabled = True

    def disable(self) -> None:
        super().disable()
        self._inbox.is_enabled = False

    def sample(self) -> None:
        inbox = self._inbox
        if not inbox.arrived:
            return
        size = self._size
        for packet in inbox.arrived:
            if size < 0 or sum(len(entry.data) for entry in inbox.queue) + len(packet.data) <= size:
                inbox.queue.append(packet)
        inbox.arrived.clear()

    def getQueueLength(self) -> int:
        return len(self._inbox.queue)

    def nextPacket(self) -> None:
        self._head("nextPacket")
        self._inbox.queue.popleft()

    def _head(self, function: str) -> Packet:
        if not self._inbox.queue:
            raise RuntimeError(f"Receiver.{function}: the queue of '{self._spec.name}' is empty")
        return self._inbox.queue[0]

    def getBytes(self) -> bytes:
        return self._head("getBytes").data

    def getData(self) -> bytes:
        return self._head("getData").data

    def getString(self) -> str:
        return self._head("getString").data.partition(b"\0")[0].decode("utf-8")

    def getFloats(self) -> list[float]:
        data = self._head("getFloats").data
        return list(struct.unpack(f"{len(data) // 8}d", data[: len(data) // 8 * 8]))

    def getDataSize(self) -> int:
        return len(self._head("getDataSize").data)

    def getSignalStrength(self) -> float:
        return self._head("getSignalStrength").strength()

    def getEmitterDirection(self) -> list[float]:
        return list(self._head("getEmitterDirection").direction())

    def getChannel(self) -> int:
        return self._inbox.channel

    def setChannel(self, channel: int) -> None:
        self._inbox.channel = int(channel)


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
