"""PyBullet behind the port; the only package that imports it, and suppresses its output.

engine.py      the engine: one world in a client of its own
loading.py     ground, walls, objects and robots, built from the world model
state.py       bodies with links and joints by name; joints, poses and velocities; masses, friction, colors
               that an episode varies
motors.py      motors, springs and damping of joints, and forces on links
surfaces.py    contacts and their forces, distances between surfaces and along rays, lines of sight; pictures:
               bodies, floor and sky

Differences between PyBullet and the port, which this package resolves:

- a joint starts with a braking motor: ours start free, but for the friction that their file states
- a fresh world and a reset one differ by what contacts and motors left behind, unless every body was far
  from every other for one step, and by how bodies are grouped for the solver, unless all are one group;
  both worlds are made by the same `reset`
- links without an inertial would weigh 1 kg: ours weigh nothing, which a link that moves may not
- a new mass brings an inertia made up from the shape: ours scales that of the file
- the friction of a pair is the product of the two; a link that states none has 1, so that the other decides
- links of one robot do not touch each other
- poses of bodies are those of their center of mass, velocities too: converted where the two points differ
- poses of links lag one engine step behind unless their kinematics are asked for
- damping by the velocity at the start of a step makes joints swing ever wider: ours is by that at its end
- a joint over 0.04 rad beyond its limit stays there: ours returns
- cylinders are hulls, 1 mm too large and bumpy, unless implicit: a cart driven at 0.2 m/s did 0.2049 and lost
  half of it in 1.3 s of coasting; implicit, 0.2000 and nothing
"""

from __future__ import annotations

import ctypes
import os
import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress

BASE_LINK = -1  # the number of a root link
NEGLIGIBLE_FORCE = 1e-200  # N m or N; stands for no force, at which a motor would still report its last force
UNLIMITED_FORCE = 1e12  # N m or N; stands for an unlimited motor
UNREACHABLE_SPEED = 1e9  # rad/s or m/s; a velocity motor that aims there exerts exactly its limit
# The library's own position and velocity gain, and no cap. Positional arguments cost half of named ones.
DEFAULT_GAINS = (0.1, 1.0, -1.0)


@contextmanager
def capture_native_output() -> Iterator[Callable[[], str]]:
    """Catch the output to the process's own stdout and stderr, below Python's; yields a function that reads
    it."""
    _flush()
    with tempfile.TemporaryFile() as caught:
        copies: list[tuple[int, int]] = []
        for fd in (1, 2):
            with suppress(OSError):  # a program may have closed its own
                copies.append((fd, os.dup(fd)))
        try:
            for fd, _ in copies:
                os.dup2(caught.fileno(), fd)

            def said() -> str:
                _flush()
                caught.seek(0)
                return caught.read().decode(errors="replace").strip()

            yield said
        finally:
            _flush()
            for fd, copy in copies:
                os.dup2(copy, fd)
                os.close(copy)


def _flush() -> None:
    """Flush Python's buffers and the C library's, which would otherwise print after the terminal is back."""
    for stream in (sys.stdout, sys.stderr):
        if stream is not None:
            stream.flush()
    if os.name == "posix":
        ctypes.CDLL(None).fflush(None)


with capture_native_output():  # it prints the time of its build
    import pybullet

__all__ = [
    "BASE_LINK",
    "DEFAULT_GAINS",
    "NEGLIGIBLE_FORCE",
    "UNLIMITED_FORCE",
    "UNREACHABLE_SPEED",
    "capture_native_output",
    "pybullet",
]
