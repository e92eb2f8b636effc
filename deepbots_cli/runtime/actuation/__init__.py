"""Actuators that are more than a motor of the engine: they act in every substep, or change from episode to episode; and pushes.

motors.py  motors with a strength and a response, and arms that bring a link to a position
forces.py  rotors, and pushes that disturb an episode
custom.py  actuators of plug-ins, by their control laws
"""

from deepbots_cli.runtime.actuation.custom import ControlLaw, CustomMotor, Site
from deepbots_cli.runtime.actuation.forces import Push, Thrust
from deepbots_cli.runtime.actuation.motors import Cartesian, Motor

__all__ = ["Cartesian", "ControlLaw", "CustomMotor", "Motor", "Push", "Site", "Thrust"]
