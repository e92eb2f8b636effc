"""A scenario that runs in Webots: what the controllers of an exported project use.

names.py    the names of nodes, devices and channels in an exported world
project.py  the scenario of a project, compiled; its supervisor, whose robots are controllers of their own
mirror.py   an engine that follows the world in Webots: poses, joints and contacts
robot.py    a generated robot controller on the devices of a robot in Webots

The world of Webots moves, and an engine of deepbots is set to its state after each timestep. So the generated
code of a scenario runs unchanged: distances, bearings, paths and clearances are those of the engine.
"""
