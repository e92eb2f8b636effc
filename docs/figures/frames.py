"""The root frame of the robot `balancer` and the axes of its joints, read from its file."""

from __future__ import annotations

from math import cos, pi, sin

from deepbots_cli.cli.arguments import open_robot
from deepbots_cli.robots.model import Box, Cylinder, Joint, RobotModel
from figures.drawing import Drawing, Point

SCALE = 1250.0  # pixels per meter
ORIGIN = (230.0, 275.0)
ARC = 0.066  # m
Triple = tuple[float, float, float]


def _seen(point: Triple) -> Point:
    """Isometric projection from the front, the left and above: x to the lower left, y to the lower right, z
    up."""
    x, y, z = point
    return ORIGIN[0] + SCALE * 0.87 * (y - x), ORIGIN[1] + SCALE * (0.5 * (x + y) - z)


def draw() -> str:
    robot, _ = open_robot("balancer")
    model = robot.model
    right, left = sorted(model.joints, key=lambda joint: joint.origin.xyz[1])
    drawing = Drawing(640, 440, "The root frame of a robot and the axes of its joints")
    _wheel(drawing, model, right)
    for visual in model.link(model.root).visuals:
        assert isinstance(visual.shape, Box)
        _box(drawing, visual.origin.xyz, visual.shape.size)
    _wheel(drawing, model, left)
    for axis, label, color, shift in (
        ((0.14, 0.0, 0.0), "x: forward", "orange", (-20, 20)),
        ((0.0, 0.22, 0.0), "y: left", "green", (8, 8)),
        ((0.0, 0.0, 0.21), "z: up", "blue", (10, 4)),
    ):
        drawing.line([_seen((0.0, 0.0, 0.0)), _seen(axis)], color, arrow=True)
        drawing.text((_seen(axis)[0] + shift[0], _seen(axis)[1] + shift[1]), label, color)
    drawing.circle(_seen((0.0, 0.0, 0.0)), 4, "ink", fill="solid")
    x, y, z = left.origin.xyz
    turned = [
        (x + ARC * sin(angle), y + 0.01, z + ARC * cos(angle))
        for angle in (0.1 * step - 0.9 for step in range(19))
    ]
    drawing.line([_seen(point) for point in turned], "ink", arrow=True)
    drawing.text((395, 200), f"joint {left.name}", code=True)
    drawing.text((395, 218), f"axis {' '.join(f'{part:g}' for part in left.axis)}", code=True)
    drawing.text((395, 240), "a positive angle turns", "soft")
    drawing.text((395, 257), "counter-clockwise about the axis", "soft")
    drawing.text((330, 60), f"root link {model.root}", code=True)
    drawing.text((330, 80), "its origin is the middle of the axle", "soft")
    return drawing.svg()


def _wheel(drawing: Drawing, model: RobotModel, joint: Joint) -> None:
    (tire, *_) = model.link(joint.child).visuals
    assert isinstance(tire.shape, Cylinder)
    x, y, z = joint.origin.xyz
    for side in (-0.5, 0.5):
        turns = [2 * pi * step / 48 for step in range(48)]
        rim = [
            (
                x + tire.shape.radius * cos(turn),
                y + side * tire.shape.length,
                z + tire.shape.radius * sin(turn),
            )
            for turn in turns
        ]
        drawing.polygon([_seen(point) for point in rim], "soft", fill="solid")


def _box(drawing: Drawing, center: Triple, size: Triple) -> None:
    """The three faces of a box that are seen: in front, on the left and above."""
    (x, y, z), (dx, dy, dz) = center, (size[0] / 2, size[1] / 2, size[2] / 2)
    front = ((1, -1, -1), (1, 1, -1), (1, 1, 1), (1, -1, 1))
    left = ((1, 1, -1), (-1, 1, -1), (-1, 1, 1), (1, 1, 1))
    above = ((1, -1, 1), (1, 1, 1), (-1, 1, 1), (-1, -1, 1))
    for face in (front, left, above):
        drawing.polygon(
            [_seen((x + a * dx, y + b * dy, z + c * dz)) for a, b, c in face], "soft", fill="solid"
        )
