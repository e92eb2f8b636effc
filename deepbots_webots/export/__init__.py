"""A scenario as a project of Webots: `deepbots export SCENARIO --to webots`.

world.py    the world: ground, walls, objects, a Robot node for each robot; nodes as text
files.py    the files of the project, whose texts are in `project/`; what Webots does not support
command.py  the command

`deepbots_webots.bridge` is what the written controllers use.
"""
