"""The language of scenarios: pydantic models, from which validation, JSON Schema, hover and reference pages
come.

fields.py         field types: the values that a field may have, for validation and for the compiler
quantities.py     field types of numbers, quantities and expressions
base.py           Section, the base of the models; unions, sizes; the shapes of annotations, and walks by them
documentation.py  sentences, defaults and examples of keys; other words for them; terms of Isaac Lab
search.py         the search spaces of `tune`
world.py          the sections of the world
terrains.py       kinds of terrain and of tiles, imported for a file that has one
objects.py        kinds of objects, imported for a file that has one
sensors.py        the sections of sensors
actuators.py      the sections of actuators
robots.py         robots and their messages
training.py       the sections of training and of its curriculum: stages, levels
task.py           agents, episodes, the evaluation, `tune`, and the tests of a scenario
scenario.py       Scenario, the whole file; deployment
keys.py           the texts of findings about a key, and about an unknown one
validate.py       nodes to a Scenario; validation errors become findings with exact places
json_schema.py    the JSON Schema for editors: `python -m deepbots_cli.scenario.json_schema` writes it
"""

from deepbots_cli.scenario.base import visit_values
from deepbots_cli.scenario.scenario import VERSION, Scenario
from deepbots_cli.scenario.validate import validate

__all__ = ["VERSION", "Scenario", "validate", "visit_values"]
