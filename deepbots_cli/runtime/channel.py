"""The path of messages between one emitter and one receiver: one that delivers, or a radio where the scenario says so."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from typing import Any

from deepbots_cli.port import Engine
from deepbots_cli.program import Program
from deepbots_cli.program.robots import Direction, Robot
from deepbots_cli.runtime.messages import codec, zeros
from deepbots_cli.runtime.radio import Radio
from deepbots_cli.runtime.streams import Streams


class Channel:
    """Delivers messages in order, each `delay` ticks after it was sent.

    One message is sent per tick. Without delay, sending and receiving are the two ends of a queue and
    nothing else; with it, `receive` gives None while nothing has arrived.
    """

    send: Callable[[Any], None]
    receive: Callable[[], Any]

    def __init__(self, delay: int = 0) -> None:
        self._queue: deque[Any] = deque()
        self._delay = delay
        self.send = self._queue.append
        self.receive = self._queue.popleft if delay == 0 else self._receive_late

    def _receive_late(self) -> Any:
        return self._queue.popleft() if len(self._queue) > self._delay else None

    def begin(self, streams: Streams) -> None:
        """Forget what is under way; a reset leaves no message behind."""
        self._queue.clear()

    def __len__(self) -> int:
        return len(self._queue)


def channel(scenario: Program, robot: Robot, direction: Direction, engine: Engine) -> Channel | Radio:
    """The path between the supervisor and one robot; `paper` timing makes either direction a tick longer."""
    late = scenario.timing == "paper"
    route, layout = (robot.to_route, robot.to_robot) if direction == "to_robot" else (robot.from_route, robot.from_robot)
    ticks_matter = late and direction == "to_robot" and scenario.agent.repeat > 1
    if scenario.format == "none" or (route.perfect and not ticks_matter):
        return Channel(1 if late else 0)
    silence = codec(layout, scenario.format).encode(*zeros(layout))
    return Radio(f"{robot.name}.{direction}", route, scenario.world.timestep, 1 if late else 0, engine.pose(robot.name), silence)
