"""What messages meet on their way."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from deepbots_cli.expressions.scalar import Const, Scalar
from deepbots_cli.ir.values import Redraw

Order = Literal["sent", "arrival", "newest"]
OnLoss = Literal["hold", "zero", "skip"]


@dataclass(frozen=True)
class Setting:
    """A figure of a route, made of draws and parameters; with a redraw it holds between one and the next."""

    value: Scalar
    redraw: Redraw | None = None


@dataclass(frozen=True)
class Route:
    """What happens to the messages of one robot in one direction.

    Latency in s, from sending to arrival; loss is a share of the messages; `burst` the mean number that are
    lost in a row, None where each is lost or not by itself; range in m, from the origin of the world to the
    robot's root link.
    """

    latency: Setting = Setting(Const(0.0))
    loss: Setting = Setting(Const(0.0))
    burst: float | None = None
    range: Setting | None = None
    order: Order = "sent"
    on_loss: OnLoss = "hold"

    @property
    def perfect(self) -> bool:
        """Whether every message arrives at once."""
        ideal = Setting(Const(0.0))
        return self.latency == self.loss == ideal and self.range is None

    @property
    def settings(self) -> tuple[tuple[str, Setting], ...]:
        """Its figures by name."""
        found = (("latency", self.latency), ("loss", self.loss), ("range", self.range))
        return tuple((name, setting) for name, setting in found if setting is not None)
