"""Robots as data: from a URDF file to a checked model, changed by pure functions, and back to text.

model.py     links, joints, shapes, inertia
elements.py  XML to elements that know their place; their numbers and vectors
reader.py    elements to a checked model, every finding with its place
meshes.py    where mesh files are, whether they may be read, what they hold
inertia.py   closed forms; second moments
edits.py     stretch, with_mass, with_friction, with_joint
writer.py    the normalised URDF that an engine loads
"""
