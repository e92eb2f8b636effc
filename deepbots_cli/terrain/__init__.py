"""Ground that is not flat: from what a scenario says of it to heights.

png.py     what is checked of a picture of heights before it is decoded; needs no numpy
relief.py  every kind of relief as a grid of heights or as triangles, and the height of any place

Engines build a terrain from these, and placing stands bodies on it, so both use the same surface.
"""
