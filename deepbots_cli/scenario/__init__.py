"""What a user may write in a scenario: pydantic models, from which validation, JSON Schema, hover and
reference pages come.

fields.py       field types: what a single value may be, and what the compiler reads of it
base.py         Section, the base of the models; unions, sizes; the shape of an annotation, and walking a
                scenario by shapes;
                what is said of a key: descriptions, units, defaults, examples
search.py       the search spaces of `tune`
world.py sensors.py actuators.py training.py
                sections
scenario.py     Scenario, the whole file: robots, messages, the task
synonyms.py     what people write instead of a word of the language: the table synonyms.yaml
keys.py         what findings say about a key, and about an unknown one
validate.py     nodes to a Scenario; validation errors become findings with exact places
json_schema.py  the JSON Schema for editors: `python -m deepbots_cli.scenario.json_schema` writes it
"""

from deepbots_cli.scenario.base import visit_values
from deepbots_cli.scenario.scenario import VERSION, Scenario
from deepbots_cli.scenario.validate import validate

__all__ = ["VERSION", "Scenario", "validate", "visit_values"]
