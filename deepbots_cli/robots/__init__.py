"""Robots as data: from a URDF file to a checked model, changed by pure functions, and back to text.

model.py       what a robot is: links, joints, shapes, inertia
reader.py      read: strict, every finding with its place
xml.py         text to elements that know their place
report.py      findings about elements; numbers and vectors in them
vocabulary.py  the words that are known, and those that look misspelt
parts.py       elements to links and joints
mesh.py        where mesh files are and whether they may be read
mesh_format.py what a mesh must hold so that an engine survives it
checks.py      one tree of links, plausible inertia
writer.py      write: the normalised URDF that an engine loads
inertia.py     closed forms; second moments
rotation.py    3 by 3 matrices as tuples
override.py    stretch, with_mass, with_friction, with_joint
"""
