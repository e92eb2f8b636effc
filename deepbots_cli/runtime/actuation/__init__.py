"""Actuators that are more than a motor of the engine: they act in every substep, or change from episode to episode; and pushes.

response.py  commands on their way: delayed, lagging, changing only so fast
motors.py    motors with a strength and a response
cartesian.py arms that are told where to bring their hand
thrust.py    rotors
custom.py    actuators of plug-ins, by their control laws
pushes.py    disturbances
hold.py      what keeps a robot where it is from a reset to its first command
"""

from deepbots_cli.runtime.actuation.cartesian import Cartesian
from deepbots_cli.runtime.actuation.custom import ControlLaw, CustomMotor, Site
from deepbots_cli.runtime.actuation.hold import Drive, hold
from deepbots_cli.runtime.actuation.motors import Motor
from deepbots_cli.runtime.actuation.pushes import Push
from deepbots_cli.runtime.actuation.thrust import Thrust

__all__ = ["Cartesian", "ControlLaw", "CustomMotor", "Drive", "Motor", "Push", "Site", "Thrust", "hold"]
