"""MuJoCo behind the port; the only package that imports it.

engine.py      the engine: one world
model.py       ground, walls, objects and robots, as a model of MuJoCo
state.py       the state of a world and what is derived from it; the values that an episode varies; what
               motors and readers of a batch share
motors.py      motors and springs on joints, and forces on links; of one world and of a batch
sliding.py     Coulomb's friction for contacts that slide; sliding_callback.py compiles it for batches
surfaces.py    contacts and their forces, distances between surfaces and along rays, lines of sight
cameras.py     pictures, where OpenGL is
batch.py       many worlds of one model, stepped by `mujoco.batch`, read and written as columns: its
               readers, sensors, links, rays and distances in batch_readers.py

Differences between MuJoCo and the port, which this package resolves:

- the friction of a pair is the larger of the two: ours is their product, as in PyBullet, so each pair of
  surfaces that may touch is an entry of its own
- positions of links and velocities belong to the state before the last step: they are computed again when
  they are read
- bodies cannot come and go: an absent one floats without weight far away
- a state that is not finite is silently replaced by the first one, with a line in a log file: ours stays as
  it is, for `require_finite`
- rays leave out one link: ours leave out the robot
- a motor that is stiff for a light wheel is unstable, or breaks the grip of the wheel if it is integrated
  implicitly after contacts are solved: ours adds what it does within a step to the inertia of the joint
"""

from __future__ import annotations

import ctypes
import os
import sys
from contextlib import suppress

from deepbots_cli.errors import EngineError


def _opengl_without_display() -> str:
    """Return the value of MUJOCO_GL for the first library of OpenGL that this machine has."""
    for name, library in (("egl", "libEGL.so.1"), ("osmesa", "libOSMesa.so.8")):
        with suppress(OSError):
            ctypes.CDLL(library)
            return name
    return "disable"


if sys.platform == "linux" and not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
    # MuJoCo chooses its library for pictures on import: by default one that needs a display. If the library
    # that it is asked for is missing, as in slim containers, the import fails.
    os.environ.setdefault("MUJOCO_GL", _opengl_without_display())

try:
    import mujoco
except (AttributeError, RuntimeError) as error:
    raise EngineError(
        f"MuJoCo cannot be imported with MUJOCO_GL={os.environ.get('MUJOCO_GL', '')}, which is not a library"
        " of OpenGL on this machine; unset MUJOCO_GL, and deepbots chooses one"
    ) from error

__all__ = ["mujoco"]

# `require_finite` reports a state that is not finite, with the name of the body. By default MuJoCo writes
# MUJOCO_LOG.TXT into the working directory.
mujoco.set_mju_user_warning(lambda _: None)
