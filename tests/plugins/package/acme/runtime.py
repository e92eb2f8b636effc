"""What runs in a world."""

from __future__ import annotations

from deepbots_cli.runtime import actuation
from deepbots_cli.runtime.actuation import ControlLaw
from deepbots_cli.runtime.messages import Codec
from deepbots_cli.runtime.sensing import Instrument, Site


def tachometer(site: Site) -> Instrument:
    read = site.engine.joint_states(site.robot, site.sensor.subjects)
    spacing = site.parameters["spacing"]
    if site.parameters["direction"] == "forward":
        return Instrument(lambda: [max(0.0, state[1]) / spacing for state in read()])
    return Instrument(lambda: [state[1] / spacing for state in read()])


def throttle(site: actuation.Site) -> ControlLaw:
    read = site.engine.joint_states(site.robot, site.joints)
    stall, idle = site.parameters["stall_torque"], site.parameters["idle_speed"]
    return ControlLaw(
        lambda shares: [
            stall * (share - state[1] / idle) for share, state in zip(shares, read(), strict=True)
        ]
    )


def piped(stamp: int, codes: list[str]) -> Codec:
    """Numbers as text, between bars; no pictures."""

    def encode(*values: float) -> str:
        return "|".join(map(repr, (stamp, *map(float, values))))

    def decode(message: str) -> list[float]:
        return [float(cell) for cell in message.split("|")]

    return Codec(encode, decode, decode)
