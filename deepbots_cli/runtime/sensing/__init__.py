"""Sensors that are more than one fact of the engine: sampled once per tick, and as faulty as the scenario says.

device.py  one sensor: samples, noise and other faults, when a reading is delivered

What each kind measures; the classes of `scenario.sensors` name these functions as their readers:

body.py    joints, poses and velocities, inertial measurements, contacts
rays.py    distances along rays, and how bright the ground is
camera.py  pictures
"""

from deepbots_cli.runtime.sensing.camera import sees
from deepbots_cli.runtime.sensing.device import Device, Instrument, Site, instrument

__all__ = ["Device", "Instrument", "Site", "instrument", "sees"]
