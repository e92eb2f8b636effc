"""The language of scenarios: pydantic models, from which validation, JSON Schema, hover and reference pages
come.

fields            field types: the values that a field may have, for validation and for the compiler
base.py           Section, the base of the models; unions, sizes; the shape of an annotation
documentation.py  the documentation of a section and of its keys: sentences, defaults, examples
walk.py           walking a scenario by the shapes of its keys
search.py         the search spaces of `tune`
world.py          the sections of the world
sensors.py        the sections of sensors
actuators.py      the sections of actuators
training.py       the sections of training and of its curriculum: stages, levels
agent.py          what an agent does, sees and is rewarded for; several agents
robots.py         robots and their messages
episode.py        how an episode begins, is disturbed and ends
evaluation.py     the evaluation, `tune`, and the tests of a scenario
scenario.py       Scenario, the whole file; deployment
synonyms.py       words that people write instead of a word of the language: the table synonyms.yaml
isaac_lab.py      terms of Isaac Lab with their lines, the table isaac_lab.json; advice for sections that
                  are written as there
keys.py           the texts of findings about a key, and about an unknown one
validate.py       nodes to a Scenario; validation errors become findings with exact places
json_schema.py    the JSON Schema for editors: `python -m deepbots_cli.scenario.json_schema` writes it
"""

from deepbots_cli.scenario.scenario import VERSION, Scenario
from deepbots_cli.scenario.validate import validate
from deepbots_cli.scenario.walk import visit_values

__all__ = ["VERSION", "Scenario", "validate", "visit_values"]
