"""Robots as data: from a URDF file to a checked model, changed by pure functions, and back to text.

model.py       links, joints, shapes; mass, volume and inertia in closed form; normalized URDF for an engine;
               a robot with one thing changed (with_scale, with_mass, with_friction, with_joint)
kinematics.py  frames of links, bounding boxes, the height at which a robot or a shape rests
build.py       the parts of a robot by their function: wheels, legs, arms, hands, propellers
kinds.py       the kind of a robot, with its evidence
elements.py    XML to elements with their position in the file; their numbers and vectors
reader.py      elements to a checked model, every finding with its place
xacro.py       xacro to plain elements, with includes and limits; xacro_expressions.py computes its
               expressions
packages.py    the places of mesh files and robot files, and what may be read
meshes.py      the contents of mesh files; how many times their triangles cover each other
mesh_formats.py the triangles of STL, OBJ, COLLADA and glTF files, and their faults
units.py       millimeters, grams and g mm^2 in a robot file
"""
