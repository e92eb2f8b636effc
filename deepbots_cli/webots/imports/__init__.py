"""A project of Webots as a scenario: `deepbots new NAME --webots WORLD.wbt`.

names.py       names of robots, links, sensors and objects in a scenario
robots.py      the bodies of a robot as a robot model, from which a URDF file is written
world.py       arena, terrain and objects as entries of a scenario
sensors.py     devices as sensors of a scenario
code.py        the Python files of a controller as syntax trees, with limits
values.py      what an expression of a controller stands for: numbers, quantities, conditions, nodes, devices
reader.py      follows the statements of a controller without running them
conditions.py  values under conditions, and conditions
arithmetic.py  operators on numbers and quantities
calls.py       functions that controllers call: of Webots, deepbots, numpy and Python
task.py        actions and messages of a project
judging.py     observations, rewards and endings of a project
overrides.py   methods of deepbots that a project writes anew
hints.py       words of the language for Python that is left to a person
draft.py       all of it as one record, which the starters of `new` write as YAML

No code of the project runs. Python without a counterpart in the language becomes a `Todo` with its location
in the file.
"""
