"""A first scenario for a robot file: the task that suits its build, and the values of the template of this
task.

for_robots/   one Jinja template per task; parts.yaml holds the parts that they share
first_scenario.py  chooses a task for the kind of a robot (`robots/kinds.py`) and adds the entries of this
              task; text.py numbers, names and comments
legs.py       the task of a robot on legs
webots.py     the scenario of a project of Webots, from its draft (`webots/imports`)
templates.py  the templates of `deepbots new --template`, from *.yaml; arm.urdf is the robot of arm.yaml
"""

from __future__ import annotations

from deepbots_cli.cli.starters.first_scenario import scenario

__all__ = ["scenario"]
