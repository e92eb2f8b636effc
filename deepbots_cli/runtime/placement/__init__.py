"""Where bodies stand when an episode begins.

arrangement.py  looks for a place for each body, again and again until the start is as required
"""

from deepbots_cli.runtime.placement.arrangement import Arrangement

__all__ = ["Arrangement"]
