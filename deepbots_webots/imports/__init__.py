"""A project of Webots as a scenario: `deepbots new NAME --webots WORLD.wbt`.

world.py    robots as robot models; arena, terrain and objects as entries of a scenario
draft.py    devices as sensors and motors; classes of deepbots in Python files: their methods as text, and plain
            constants; all of it as one record
starter.py  the YAML text of the scenario

No code of the project runs, and none is followed: a person writes actions, observations, rewards and endings,
beside the Python that the scenario quotes.
"""
