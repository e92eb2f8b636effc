"""Where bodies stand when an episode begins.

arrangement.py  looks for a place for each body, again and again until the start is as required
floor.py        the ground plane: what is taken, and which spots are free
forms.py        what each body covers of the ground
"""

from deepbots_cli.runtime.placement.arrangement import Arrangement

__all__ = ["Arrangement"]
