"""Scenarios to begin with: what `deepbots new` writes.

templates.py   from one of the templates beside it (*.yaml, arm.urdf)
robots.py      from a robot file: what kind of robot it is, and which task suits it
survey.py      what the shapes and joints of a robot file show: wheels, limbs, rotors
limbs.py       chains of joints: where their ends are, and positions that bring them somewhere
rolling.py     tasks on wheels
jointed.py     tasks for arms, legs and mechanisms
flying.py      a task for rotors
parts.py       what these tasks have in common: groups, motors, postures
draft.py       the text: sections in order, with their comments
"""
