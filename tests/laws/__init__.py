"""Laws: what must hold for every scenario, tried on scenarios that chance draws.

expressions.py  strategies for texts of the expression language
fields.py       strategies for single values, one for each class of `scenario/fields.py` and `scenario/quantities.py`
scenarios.py    strategies for whole scenarios, from the models of the language
tasks.py        strategies for what a scenario says about its task
pairs.py        the pairs of keys, functions and options that scenarios combine
law.py          what a law is, and how it is tried
reduce.py       makes the scenario of a failure smaller
found.yaml      scenarios that once broke a law
episodes.py     laws of episodes
writing.py      laws of writing
parameters.py   laws of drawn values, overrides and devices
variants.py     laws of changed conditions and of tests of a case
claims.py       laws of what the analysis and lint state
parts.py        laws of values against a second implementation of their expressions
records.py      laws of what trainings and evaluations record, and of what is exported
readings.py     a world that shows all that sensors and functions read
frames.py       laws of turned and mirrored worlds
two_engines.py  laws of one world in two engines
shapes.py       rays and points against shapes, in closed form
sensors.py      laws of sensors and functions against a second implementation
"""

from tests.laws import (
    claims,
    episodes,
    frames,
    parameters,
    parts,
    records,
    sensors,
    two_engines,
    variants,
    writing,
)
from tests.laws.law import LAWS

__all__ = [
    "LAWS",
    "claims",
    "episodes",
    "frames",
    "parameters",
    "parts",
    "records",
    "sensors",
    "two_engines",
    "variants",
    "writing",
]
