"""Shortest ways around what is solid.

ways.py    who asks for which way, and when a map is out of date
chart.py   a map of an area: where a disc can be, and how far it has to go
sweep.py   lengths of ways on a grid
"""

from deepbots_cli.runtime.ways.ways import Ways

__all__ = ["Ways"]
