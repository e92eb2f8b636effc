"""A first scenario for a robot file: the task that suits its build, and the values of the template of this
task.

for_robots/  one Jinja template per task; parts.yaml holds the parts that they share
build.py     the build of a robot: wheels, limbs, rotors; tasks.py the tasks for these, draft.py what they add
             to a robot; text.py numbers, names and comments in the text
*.yaml       the scenarios of `deepbots new --template`; arm.urdf is the robot of arm.yaml
"""

from __future__ import annotations

from deepbots_cli.cli.starters.first_scenario import scenario

__all__ = ["scenario"]
