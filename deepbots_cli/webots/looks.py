"""How Shape nodes look: their geometry, and their color."""

from __future__ import annotations

from collections.abc import Sequence
from math import cos, pi, sin
from typing import TYPE_CHECKING

from deepbots_cli.webots.findings import WorldFindings
from deepbots_cli.webots.nodes import child, is_a, number, vector
from deepbots_cli.webots.shapes import Shape, shape_of

if TYPE_CHECKING:
    from deepbots_cli.frames import Triple
    from deepbots_cli.webots.project import Files
    from deepbots_cli.webots.scene import Visual
    from deepbots_cli.webots.syntax import Node

CONE_SIDES = 32
"""The sides of a cone, which is drawn as a mesh."""


def visible_shape(visual: Visual, files: Files) -> Shape | None:
    """Return the geometry of a Shape node; None for one that is not drawn."""
    geometry = child(visual.node, "geometry")
    if geometry is None:
        return None
    if geometry.type == "Cone":
        return _cone(number(geometry, "bottomRadius"), number(geometry, "height"), visual.scale)
    return shape_of(geometry, visual.scale, files, WorldFindings())


def _cone(radius: float, height: float, scale: Triple) -> Shape:
    """Return a cone around z, of which the base is below."""
    rim: list[Triple] = [
        (radius * cos(2 * pi * k / CONE_SIDES), radius * sin(2 * pi * k / CONE_SIDES), -height / 2)
        for k in range(CONE_SIDES)
    ]
    points = [*rim, (0.0, 0.0, height / 2), (0.0, 0.0, -height / 2)]
    faces = []
    for k in range(CONE_SIDES):
        after = (k + 1) % CONE_SIDES
        faces += [(k, after, CONE_SIDES), (after, k, CONE_SIDES + 1)]
    scaled = [(x * scale[0], y * scale[1], z * scale[2]) for x, y, z in points]
    return Shape("mesh", vertices=scaled, faces=faces)


def color_of(node: Node) -> Sequence[float]:
    """Return the color and opacity of a Shape node."""
    appearance = child(node, "appearance")
    if appearance is None:
        return (0.8, 0.8, 0.8, 1.0)
    if is_a(appearance, "PBRAppearance"):
        return (*vector(appearance, "baseColor"), 1.0 - number(appearance, "transparency"))
    material = child(appearance, "material") if is_a(appearance, "Appearance") else None
    if material is None:
        return (0.8, 0.8, 0.8, 1.0)
    return (*vector(material, "diffuseColor"), 1.0 - number(material, "transparency"))
