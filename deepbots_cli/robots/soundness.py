"""Whether a robot that came as data, not as a file, is one that the reader could have made.

The compiled scenario of a run may be from anyone. A name of 100 000 characters in it, or a joint between links that
do not exist, ends PyBullet's process; the reader refuses both, so a robot is written out and must come back as it was.
"""

from __future__ import annotations

from dataclasses import replace

from deepbots_cli.diagnostics import Findings
from deepbots_cli.robots.meshes import Refusal
from deepbots_cli.robots.model import Geometry, Inertial, Link, Mesh, RobotModel, Shape, Sphere
from deepbots_cli.robots.reader import read_bytes
from deepbots_cli.robots.writer import write


def is_sound(model: RobotModel) -> bool:
    """Whether the reader makes the same robot of it; an engine looks at its meshes."""
    plain = replace(model, links=tuple(_without_meshes(link) for link in model.links))
    try:
        text = write(plain).encode()
    except (ValueError, OverflowError):  # surrogates, which no file holds; numbers that cannot be written
        return False
    read = read_bytes(text, "robot", Findings(), resolve_mesh=lambda name: Refusal("there are no meshes here"))
    return read is not None and read.model == plain


def is_sound_shape(shape: Shape, mass: float) -> bool:
    """The same for a body of one shape."""
    return is_sound(RobotModel("body", (Link("body", Inertial(mass), collisions=(Geometry(shape),)),), (), "body"))


def _without_meshes(link: Link) -> Link:
    visuals, collisions = (
        tuple(replace(seen, shape=Sphere(1.0)) if isinstance(seen.shape, Mesh) else seen for seen in geometries)
        for geometries in (link.visuals, link.collisions)
    )
    return replace(link, visuals=visuals, collisions=collisions)
