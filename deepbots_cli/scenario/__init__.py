"""What a user may write in a scenario.

scenario.py         the sections of a file
world.py objects.py robot.py sensors.py actuators.py task.py reset.py training.py
                    their parts: models, one module per part
hyperparameters.py  the algorithms and what each may be given
pose.py quantity.py names that the models use: poses, lengths, durations
fields.py plain.py names.py
                    field kinds: what a single value may be; the metadata that the compiler reads
part.py             the base of the models, and how parts, lists and mappings nest
check.py            data to parts, or what is refused (refusal.py) and where
walk.py             walking a scenario: every value with its path and kind
validate.py         nodes to a Scenario; refusals become findings
explain.py          their wording; habits.py what values of a wrong form tell of what was meant,
                    displaced.py sections inside of others
examples.py         an example of every key, from examples.yaml
hover.py            what is said of a key: unit, default, example
export.py           the JSON Schema for editors: `python -m deepbots_cli.scenario.export`; lowering.py how specs become schemas,
                    known.py names that it lists
"""

from deepbots_cli.scenario.scenario import VERSION, Scenario
from deepbots_cli.scenario.validate import validate
from deepbots_cli.scenario.walk import visit

__all__ = ["VERSION", "Scenario", "validate", "visit"]
