"""A scenario as a project of Webots: `deepbots export SCENARIO --to webots`.

world.py    the world: ground, walls, objects, a Robot node for each robot; nodes as text
command.py  the command: the files of the project, with texts in `project/`, and what Webots does not support

`deepbots_webots.bridge` is what the written controllers use.
"""
