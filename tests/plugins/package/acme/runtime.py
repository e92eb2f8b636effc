"""What runs in a world."""

from __future__ import annotations

from deepbots_cli.runtime.messages import Codec
from deepbots_cli.runtime.sensing import Instrument, Site


def tachometer(site: Site) -> Instrument:
    read, spacing = site.engine.joint_states(site.robot, site.sensor.subjects), site.parameters["spacing"]
    if site.parameters["direction"] == "forward":
        return Instrument(lambda: [max(0.0, state[1]) / spacing for state in read()])
    return Instrument(lambda: [state[1] / spacing for state in read()])


def piped(stamp: int, codes: list[str]) -> Codec:
    """Numbers as text, between bars; no pictures."""

    def encode(*values: float) -> str:
        return "|".join(map(repr, (stamp, *map(float, values))))

    def decode(message: str) -> list[float]:
        return [float(cell) for cell in message.split("|")]

    return Codec(encode, decode, decode)
