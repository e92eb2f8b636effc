"""A project of Webots as a scenario: `deepbots new NAME --webots WORLD.wbt`.

world.py       robots as robot models; arena, terrain and objects as entries of a scenario
code.py        the Python files of a controller as syntax trees, with limits
values.py      what an expression of a controller stands for: numbers, conditions, nodes, devices, operators
reader.py      follows the statements of a controller without running them
calls.py       functions that controllers call: of Webots, deepbots, numpy and Python
task.py        actions and messages of a project
judging.py     observations, rewards and endings of a project
hints.py       overridden methods of deepbots; words of the language for Python that is left to a person
draft.py       devices as sensors; all of it as one record, which the starters of `new` write as YAML

No code of the project runs. Python without a counterpart in the language becomes a `Todo` with its location
in the file.
"""
