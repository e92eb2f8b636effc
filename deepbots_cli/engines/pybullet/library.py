"""The library, imported without what it prints, and its numbers that stand for something."""

from __future__ import annotations

from deepbots_cli.engines.common import hushed

with hushed():  # it prints the time of its build
    import pybullet

__all__ = ["pybullet"]

BASE = -1  # the number of a root link
FAINT = 1e-200  # N m or N; stands for no force, at which a motor would go on reporting what it last exerted
STRONGEST = 1e12  # N m or N; stands for an unlimited motor
UNREACHABLE = 1e9  # rad/s or m/s; a velocity motor that aims there exerts exactly its limit
GAINS = (0.1, 1.0, -1.0)  # the library's own position and velocity gain, and no cap; positional arguments cost half of named ones
