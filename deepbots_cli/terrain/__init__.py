"""Terrain: ground that is not flat.

png.py     checks of a height picture before it is decoded; needs no numpy
relief.py  every kind of terrain as a grid of heights or as triangles, and the height at any x, y

Engines and the placement of bodies use the same surface.
"""
