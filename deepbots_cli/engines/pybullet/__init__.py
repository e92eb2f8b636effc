"""PyBullet behind the port; the only package that imports it.

library.py   the library itself, and its numbers that stand for something
engine.py    the engine: one world in a client of its own
loading.py   walls, objects and robots, built from the world model; ground.py what they stand on
loadable.py  robots without what PyBullet's loader would misread, invent or crash on
body.py      a robot or an object: links and joints by name, frames of links and of inertia
pool.py      bodies by name: pooled ones, in one of several forms
readers.py   joints, poses and velocities
moments.py   readings that are kept while the world stands still
motors.py    motors, and springs with dampers on joints
pushes.py    forces on links
contacts.py  what touches what, how hard, and distances between surfaces
rays.py      how far rays from a link are free
figures.py   masses, friction, colours that an episode varies, and their way back
substeps.py  what acts and looks around every engine step
cameras.py   pictures
backdrop.py  what is seen behind all bodies
floor.py     tiles, and lines painted on them

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
