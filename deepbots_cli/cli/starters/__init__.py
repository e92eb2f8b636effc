"""A first scenario for a robot file: the task that suits its build, and the values of the template of this
task.

for_robots/   one Jinja template per task; parts.yaml holds the parts that they share
first_scenario.py  the task that suits the kind of a robot, and its template; wheels, propellers, and plain
                   joints
legs.py, arms.py   the groups, poses and motors of robots on legs, of arms and of hands
draft.py      the groups, poses and motors of a robot; templates, numbers, names and comments; *.yaml and
              arm.urdf are those of `deepbots new --template`
"""

from __future__ import annotations

from deepbots_cli.cli.starters.first_scenario import scenario

__all__ = ["scenario"]
