"""Sensors that feel what touches their links."""

from __future__ import annotations

from deepbots_cli.port import Part
from deepbots_cli.runtime.sensing.device import Instrument, Site


def touch(site: Site) -> Instrument:
    """Whether each link touched something in any engine step since the tick before."""
    others = None if site.sensor.against is None else [_part(name) for name in site.sensor.against]
    readers = [site.engine.contact((site.robot, link), others) for link in site.sensor.subjects]
    if len(readers) == 1:
        (only,) = readers
        return Instrument(lambda: (only(),))
    return Instrument(lambda: [read() for read in readers])


def force(site: Site) -> Instrument:
    """The sum of normal forces on each link, in N."""
    readers = [site.engine.contact_force((site.robot, link)) for link in site.sensor.subjects]
    return Instrument(lambda: [read() for read in readers])


def _part(name: str) -> Part:
    body, _, link = name.partition(".")
    return body, link or None
