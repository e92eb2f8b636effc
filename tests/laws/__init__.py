"""Laws: what must hold for every scenario, tried on scenarios that chance draws.

expressions.py  strategies for literals and expressions, from the table of functions
fields.py       strategies for single values, one for each class of `scenario/fields`
scenarios.py    strategies for whole scenarios, from the models of the language
law.py          what a law is, and how it is tried
episodes.py     laws of episodes
readings.py     a world that shows all that sensors and functions read
frames.py       laws of turned and mirrored worlds
two_engines.py  laws of one world in two engines
shapes.py       rays and points against shapes, in closed form
sensors.py      laws of sensors and functions against a second implementation
"""

from tests.laws import episodes, frames, sensors, two_engines
from tests.laws.law import LAWS

__all__ = ["LAWS", "episodes", "frames", "sensors", "two_engines"]
