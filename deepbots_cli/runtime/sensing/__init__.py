"""Sensors that are more than one fact of the engine: sampled once per tick, and as faulty as the scenario says.

device.py      one sensor: samples, faults, when a reading is delivered
faults.py      how figures err: noise, bias, drift, range, steps

What each kind measures; the classes of `scenario.sensors` name these functions as their readers:

joints.py      positions, velocities, torques of joints
frames.py      where a sensor sits, and what is read there
inertial.py    gyro, accelerometer, inclinometer
ranging.py     rays and their lookup tables
contacts.py    touch and force
brightness.py  how light the ground is
camera.py      pictures
"""

from deepbots_cli.runtime.sensing.camera import sees
from deepbots_cli.runtime.sensing.device import Device, Instrument, Site, instrument

__all__ = ["Device", "Instrument", "Site", "instrument", "sees"]
