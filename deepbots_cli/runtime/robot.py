"""The robot controller: reads its sensors, acts on messages, knows nothing else of the world."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from deepbots_cli.errors import MessageError
from deepbots_cli.ir import MessageFormat, Robot
from deepbots_cli.port import Engine
from deepbots_cli.runtime.messages import codec, explain


class RobotController:
    """Base of the generated robot classes.

    A generated class adds `bind`, which takes its readers and writers from the engine, and the paper's
    pair: `use_message_data(message)` decodes and drives the actuators, `create_message()` reads the
    sensors and encodes. Without messages (`format: none`) the pair is `apply(...)` and `sense()`.
    """

    def __init__(self, spec: Robot, format: MessageFormat, engine: Engine, clock: Callable[[], int]) -> None:
        """`clock` tells the number of the present step."""
        self.spec = spec
        self.format = format
        self.clock = clock
        if format != "none":
            self.encode = codec(spec.from_robot, format).encode
            self.decode = codec(spec.to_robot, format).decode
        self.bind(engine)

    def bind(self, engine: Engine) -> None:
        """Take readers and writers from the engine; called once."""

    def reset(self) -> None:
        """Forget everything that was computed from earlier messages and readings."""

    def rejected(self, message: Any) -> MessageError:
        """The error for a message that does not fit."""
        return explain(self.spec.to_robot, self.format, message, self.clock())
