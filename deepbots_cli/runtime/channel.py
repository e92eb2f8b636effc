"""The path of messages between one emitter and one receiver: a channel that delivers, or a radio where the scenario says so."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from typing import Any

from deepbots_cli.port import Engine
from deepbots_cli.program import Program
from deepbots_cli.program.robots import Direction, MessageLayout, Robot
from deepbots_cli.runtime.messages import Wire
from deepbots_cli.runtime.radio import Radio
from deepbots_cli.runtime.streams import Streams


class Channel:
    """Delivers each message in the timestep in which it was sent.

    What is sent is one value per field of the layout, and so is what is received: messages are encoded on the way, decoded and checked.
    """

    def __init__(self, wire: Wire) -> None:
        self.wire = wire
        self._queue: deque[Any] = deque()
        self.transmit: Callable[[Any], None] = self._queue.append
        """Sends a message that is encoded already."""

    def send(self, message: Sequence[Any]) -> None:
        """Send one value per field."""
        self._queue.append(self.wire.encode(message))

    def receive(self) -> Sequence[Any]:
        """One value per field of the next message.

        Raises:
            MessageError: The message is not of the layout.
        """
        return self.wire.decode(self._queue.popleft())

    def begin(self, streams: Streams) -> None:
        """Forget what is under way; a reset leaves no message behind."""
        self._queue.clear()

    def __len__(self) -> int:
        return len(self._queue)


def radio(
    scenario: Program, robot: Robot, direction: Direction, engine: Engine, refuse: Callable[[MessageLayout, Any], Exception]
) -> Radio:
    """The path between the supervisor and one robot, where it is not direct."""
    to_robot = direction == "to_robot"
    route, layout = (robot.to_route, robot.to_robot) if to_robot else (robot.from_route, robot.from_robot)
    wire = Wire(layout, scenario.format, refuse)
    late = 1 if scenario.timing == "paper" else 0
    return Radio(
        f"{robot.name}.{direction}", route, scenario.world.timestep, late, engine.pose(robot.name), wire, first_at_once=not to_robot
    )
