"""The robot `rover` from above, drawn from its file."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from math import cos, sin

from deepbots_cli.cli.arguments import open_robot
from deepbots_cli.robots.model import Box, Cylinder
from figures.drawing import Drawing, Point

Seen = Callable[[float, float], Point]
"""Where a point of the ground, in m, is on the drawing."""


def from_above(center: Point, scale: float, heading: float = 0.0) -> Seen:
    """Return where points of the robot are: its x axis goes to the right, turned left by `heading` in rad, and
    its y axis goes up. `scale` is in pixels per meter."""

    def seen(x: float, y: float) -> Point:
        along, beside = x * cos(heading) - y * sin(heading), x * sin(heading) + y * cos(heading)
        return center[0] + scale * along, center[1] - scale * beside

    return seen


def draw_rover(drawing: Drawing, seen: Seen) -> None:
    """Draw body, bumpers and wheels."""
    for (x, y), (length, width) in _rectangles():
        sides = ((-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5))
        drawing.polygon([seen(x + a * length, y + b * width) for a, b in sides], "soft", fill="solid")


def wheel_places() -> tuple[Point, Point]:
    """Return the places of the left and the right wheel, in m."""
    model = open_robot("rover")[0].model
    joints = (model.joint(f"{side}_wheel") for side in ("left", "right"))
    left, right = ((joint.origin.xyz[0], joint.origin.xyz[1]) for joint in joints)
    return left, right


def _rectangles() -> Iterator[tuple[Point, Point]]:
    """Yield the middles and sizes of the shapes that are seen from above, in m."""
    model = open_robot("rover")[0].model
    places = {model.root: (0.0, 0.0), **{joint.child: joint.origin.xyz[:2] for joint in model.joints}}
    for link, (x, y) in places.items():
        for visual in model.link(link).visuals[:1]:
            middle = x + visual.origin.xyz[0], y + visual.origin.xyz[1]
            match visual.shape:
                case Box(size=(length, width, _)):
                    yield middle, (length, width)
                case Cylinder(radius=radius, length=width):
                    yield middle, (2 * radius, width)
