"""Sensors in joints."""

from __future__ import annotations

from deepbots_cli.runtime.sensing.device import Instrument, Site


def positions(site: Site) -> Instrument:
    """In rad or m."""
    read = site.engine.joint_states(site.robot, site.sensor.subjects)
    return Instrument(lambda: [state[0] for state in read()])


def velocities(site: Site) -> Instrument:
    """In rad/s or m/s."""
    read = site.engine.joint_states(site.robot, site.sensor.subjects)
    return Instrument(lambda: [state[1] for state in read()])


def torques(site: Site) -> Instrument:
    """What the motors exerted in the last physics step, in N m or N."""
    return Instrument(site.engine.joint_torques(site.robot, site.sensor.subjects))
