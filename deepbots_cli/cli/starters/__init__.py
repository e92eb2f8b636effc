"""A first scenario for a robot file: the task that suits its build, and the values of the template of this
task.

for_robots/   one Jinja template per task; parts.yaml holds the parts that they share
first_scenario.py  the task that suits the kind of a robot, and its template
draft.py      the groups, poses and motors of a robot; wheels.py, legs.py and arms.py add those of their tasks
text.py       numbers, names and comments
webots.py     the scenario of a project of Webots, from its draft (`webots/imports`)
templates.py  the templates of `deepbots new --template`, from *.yaml; arm.urdf is the robot of arm.yaml
"""

from __future__ import annotations

from deepbots_cli.cli.starters.first_scenario import scenario

__all__ = ["scenario"]
