"""Ground that is not flat: from what a scenario says of it to heights.

png.py        grey pictures as heights, checked before anything is unpacked
triangles.py  mesh files as triangles
relief.py     every kind of relief as a grid of heights or as triangles, and the height of any place

Engines build a terrain from these, and placing stands bodies on it, so that both mean the same surface.
The compiler looks into pictures only, which needs no numpy.
"""
