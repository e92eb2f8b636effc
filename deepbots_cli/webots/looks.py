"""How Shape nodes look: their geometry, color and texture; the color of the sky."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import cos, pi, sin
from typing import TYPE_CHECKING

from deepbots_cli.webots.findings import WorldFindings
from deepbots_cli.webots.nodes import child, is_a, number, real, vector
from deepbots_cli.webots.shapes import Shape, shape_of
from deepbots_cli.webots.textures import Texture, texture_of

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
    """Return a cone around z, with its base at the bottom."""
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


@dataclass(frozen=True)
class Look:
    """The color (red, green, blue, opacity, from 0 to 1) of a Shape node below its texture."""

    base: tuple[float, float, float, float] = (0.8, 0.8, 0.8, 1.0)
    texture: Texture | None = None

    @property
    def color(self) -> tuple[float, float, float, float]:
        """The color with the mean of the texture."""
        if self.texture is None:
            return self.base
        red, green, blue = (
            channel * share for channel, share in zip(self.base, self.texture.mean, strict=False)
        )
        return red, green, blue, self.base[3]


def look_of(node: Node, files: Files) -> Look:
    """Return the color and texture of a Shape node."""
    appearance = child(node, "appearance")
    if appearance is None:
        return Look()
    if is_a(appearance, "PBRAppearance"):
        return _look(appearance, "baseColor", texture_of(appearance, "baseColorMap", files))
    if not is_a(appearance, "Appearance"):
        return Look()
    texture = texture_of(appearance, "texture", files)
    material = child(appearance, "material")
    return _look(material, "diffuseColor", texture) if material is not None else Look(texture=texture)


def _look(node: Node, field: str, texture: Texture | None) -> Look:
    return Look((*vector(node, field), 1.0 - number(node, "transparency")), texture)


def color_of(node: Node, files: Files) -> Sequence[float]:
    """Return the color and opacity of a Shape node, with the mean color of its texture."""
    return look_of(node, files).color


def sky_color(nodes: Sequence[Node]) -> Triple | None:
    """Return the color of the sky; None in a world without a Background."""
    sky = next((real(node) for node in nodes if real(node).type == "Background"), None)
    return None if sky is None else vector(sky, "skyColor")
