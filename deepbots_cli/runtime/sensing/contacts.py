"""Sensors that feel what touches their links."""

from __future__ import annotations

from deepbots_cli.port import Engine, Part
from deepbots_cli.program.robots import Sensor
from deepbots_cli.runtime.sensing.device import Instrument


def touch(engine: Engine, robot: str, sensor: Sensor) -> Instrument:
    """Whether each link touched something in any engine step since the tick before."""
    others = None if sensor.against is None else [_part(name) for name in sensor.against]
    readers = [engine.contact((robot, link), others) for link in sensor.subjects]
    if len(readers) == 1:
        (only,) = readers
        return Instrument(lambda: (only(),))
    return Instrument(lambda: [read() for read in readers])


def force(engine: Engine, robot: str, sensor: Sensor) -> Instrument:
    """The sum of normal forces on each link, in N."""
    readers = [engine.contact_force((robot, link)) for link in sensor.subjects]
    return Instrument(lambda: [read() for read in readers])


def _part(name: str) -> Part:
    body, _, link = name.partition(".")
    return body, link or None
