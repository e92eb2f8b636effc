"""PyBullet behind the port; the only package that imports it.

library.py     the library itself, and its numbers that stand for something
engine.py      the engine: one world in a client of its own
loading.py     ground, walls, objects and robots, built from the world model
body.py        a robot or an object: links and joints by name, frames of links and of inertia; pooled bodies
readers.py     joints, poses and velocities, kept while the world stands still
motors.py      motors and springs on joints, and forces on links
contacts.py    what touches what, how hard, and distances between surfaces
rays.py        how far rays from a link are free
parameters.py  masses, friction, colours that an episode varies, and their way back
cameras.py     pictures: bodies, floor and sky

What PyBullet leaves to its callers, and is settled here:

- a joint starts with a braking motor: ours start free, but for the friction that their file states
- a fresh world and a reset one differ by what contacts and motors left behind, unless every body was far
  from every other for one step, and by how bodies are grouped for the solver, unless all are one group;
  both worlds are made by the same `reset`
- links without an inertial would weigh 1 kg: ours weigh nothing, which a link that moves may not
- a new mass brings an inertia made up from the shape: ours scales that of the file
- the friction of a pair is the product of the two; a link that states none has 1, so that the other decides
- links of one robot do not touch each other
- poses of bodies are those of their centre of mass, velocities too: converted where the two points differ
- poses of links lag one engine step behind unless their kinematics are asked for
- cylinders are hulls, 1 mm too large and bumpy, unless implicit: a cart driven at 0.2 m/s did 0.2049 and lost
  half of it in 1.3 s of coasting; implicit, 0.2000 and nothing
"""

from deepbots_cli.engines.pybullet.engine import PyBulletEngine

__all__ = ["PyBulletEngine"]
