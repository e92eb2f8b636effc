"""What engines share: objects and walls as robots, things by name, and a quiet terminal."""

from __future__ import annotations

import ctypes
import os
import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
from typing import TypeVar

from deepbots_cli.errors import EngineError
from deepbots_cli.program.world import ARENA_WALLS, WALL_COLOUR, Arena, ObjectBody
from deepbots_cli.robots import inertia
from deepbots_cli.robots.model import Box, Friction, Geometry, Inertial, Link, Pose, RobotModel


def moves(body: ObjectBody) -> bool:
    """Whether physics moves the object. One without mass, or that is only seen, stays where it is put."""
    return body.solid and not body.fixed and body.mass > 0.0


def forms(body: ObjectBody) -> dict[str, ObjectBody]:
    """The object in each of its variants, by their names; by its own if it has none."""
    figures = ("shape", "mass", "colour", "friction", "fixed")
    shown = {v.name: replace(body, variants=(), **{what: getattr(v, what) for what in figures}) for v in body.variants}
    return shown or {body.name: body}


def as_robot(body: ObjectBody) -> RobotModel:
    """The object as a robot of one link with the object's name; the inertia of a mesh is 0, for the engine to find."""
    seen = Geometry(body.shape, colour=body.colour)
    link = Link(
        name=body.name,
        inertial=inertia.homogeneous(body.shape, body.mass) or Inertial(body.mass),
        visuals=(seen,),
        collisions=(seen,) if body.solid else (),
        friction=Friction(body.friction, body.spinning_friction, body.rolling_friction, body.restitution),
    )
    return RobotModel(name=body.name, links=(link,), joints=(), root=body.name)


def walls(arena: Arena) -> tuple[ObjectBody, ...]:
    """Four fixed boxes around the inner size of the arena. Four, not one of four parts: an engine sorts out far boxes cheaply."""
    (x, y), height, thick = arena.size, arena.wall_height, arena.wall_thickness
    sides = (
        ((x + thick) / 2, 0.0, thick, y + 2 * thick),
        (-(x + thick) / 2, 0.0, thick, y + 2 * thick),
        (0.0, (y + thick) / 2, x, thick),
        (0.0, -(y + thick) / 2, x, thick),
    )
    return tuple(
        ObjectBody(
            name=name,
            shape=Box((along_x, along_y, height)),
            pose=Pose((at_x, at_y, height / 2)),
            colour=arena.colour or WALL_COLOUR,
            friction=arena.friction,
            fixed=True,
        )
        for name, (at_x, at_y, along_x, along_y) in zip(ARENA_WALLS, sides, strict=True)
    )


Found = TypeVar("Found")


def find(table: dict[str, Found], name: str, lacking: str) -> Found:
    """The entry called `name`; `lacking` opens the sentence of the error that lists what there is."""
    try:
        return table[name]
    except KeyError:
        raise EngineError(f"{lacking} '{name}'; there are {', '.join(table)}") from None


@contextmanager
def hushed() -> Iterator[Callable[[], str]]:
    """Catch what is written to the process's own stdout and stderr, below Python's; yields a way to read it."""
    _flush()
    with tempfile.TemporaryFile() as caught:
        kept: list[tuple[int, int]] = []
        for fd in (1, 2):
            with suppress(OSError):  # a program may have closed its own
                kept.append((fd, os.dup(fd)))
        try:
            for fd, _ in kept:
                os.dup2(caught.fileno(), fd)

            def said() -> str:
                _flush()
                caught.seek(0)
                return caught.read().decode(errors="replace").strip()

            yield said
        finally:
            _flush()
            for fd, copy in kept:
                os.dup2(copy, fd)
                os.close(copy)


def _flush() -> None:
    """Empty Python's buffers and the C library's, which would otherwise print after the terminal is back."""
    for stream in (sys.stdout, sys.stderr):
        if stream is not None:
            stream.flush()
    if os.name == "posix":
        ctypes.CDLL(None).fflush(None)
