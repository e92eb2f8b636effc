"""Emitters and receivers, as the module `controller` has them."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from typing import TYPE_CHECKING

from deepbots_cli.webots.device import Device, Sensor
from deepbots_cli.webots.nodes import integer, number, numbers

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
