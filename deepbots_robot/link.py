"""A link between robot and policy: the interface of all transports, and the messages that arrive on them.

One end sends sensor fields and resets and receives commands, the other end the reverse. A link carries arrays
by the names of fields; `intake` checks them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal, Protocol

from numpy.typing import NDArray

from deepbots_robot.about import About, Remark

Array = NDArray[Any]
Kind = Literal["fields", "reset"]

EPISODE_TOPIC = "/deepbots/episode"
"""The topic of resets in ROS 2: std_msgs/Header with the time of the reset, and the number of the episode as
`frame_id`."""
ACTION_TOPIC = "/deepbots/action"
"""The topic of the action of a policy, std_msgs/Float64MultiArray."""
MAX_BYTES = 16 * 2**20
"""The largest size of a message in bytes. A picture of 1024 x 1024 pixels in color has three million."""


@dataclass(frozen=True)
class Arrival:
    """An arrived message, decoded but not checked.

    Attributes:
        source: The topic, or the robot that sent it.
        fields: Arrays by the names of fields.
        stamp: The sender's time in s; None if the message has none.
        problem: The reason why it cannot be read; empty if it can.
        kind: The kind; with `reset`, an episode begins.
        number: The number of the episode of a reset.
        about: The description of the sender, in the first message of an episode.
    """

    source: str
    fields: Mapping[str, Array] = field(default_factory=dict)
    stamp: float | None = None
    problem: str = ""
    kind: Kind = "fields"
    number: int = 0
    about: About | None = None


class Link(Protocol):
    """An end of a link."""

    name: str
    """The transport and its address, for people."""

    def wait(self, timeout: float) -> None:
        """Wait until a message has arrived, at most `timeout` s."""

    def take(self) -> Sequence[Arrival]:
        """Return the messages that arrived since the last call, in their order; resets first."""

    def send(self, values: Mapping[str, Array], stamp: float) -> None:
        """Send fields, which were measured or computed at `stamp` (s)."""

    def reset(self, number: int, stamp: float) -> None:
        """Announce that episode `number` begins. Messages that are sent afterwards arrive afterwards."""

    def connected(self) -> bool:
        """Return whether the other end listens."""

    def remarks(self) -> Sequence[Remark]:
        """Return remarks on other programs on the link that do not fit, or that interfere."""

    def others(self) -> Sequence[About]:
        """Return the descriptions of other ends, as far as they have arrived."""

    def close(self) -> None:
        """End the link."""
