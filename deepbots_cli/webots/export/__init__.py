"""A scenario as a project of Webots: `deepbots export SCENARIO --to webots`.

gaps.py   what Webots does not support, a sentence each
world.py  the world: ground, walls, objects, a Robot node for each robot; nodes as text
files.py  the files of the project; its texts are in `project/`

`deepbots_cli.webots.bridge` is what the written controllers use.
"""
