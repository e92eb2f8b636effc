"""Where sensors are on the robot of lesson 1: axes, `pose`, `yaw`, and what a sonar reads."""

from __future__ import annotations

from math import cos, pi, sin

from figures.drawing import Drawing
from figures.rover import draw_rover, from_above

ROBOT, STRIP = from_above((190.0, 165.0), 1250.0), from_above((80.0, 345.0), 620.0)
SONAR, WALL = 0.07, 0.79  # m


def draw() -> str:
    drawing = Drawing(640, 405, "The axes of a robot, and the places of its sensors")
    draw_rover(drawing, ROBOT)
    for end, label, color, shift in (
        ((0.16, 0.0), "x: forward", "orange", (8, 4)),
        ((0.0, 0.115), "y: left", "green", (8, 0)),
    ):
        drawing.line([ROBOT(0.0, 0.0), ROBOT(*end)], color, arrow=True)
        drawing.text((ROBOT(*end)[0] + shift[0], ROBOT(*end)[1] + shift[1]), label, color)
    drawing.circle(ROBOT(0.0, 0.0), 4, "ink", fill="solid")
    drawing.text(
        (ROBOT(0.0, 0.0)[0] - 8, ROBOT(0.0, 0.0)[1] + 18), "origin of base_link", anchor="middle", code=True
    )
    turn = [
        ROBOT(0.105 * cos(angle), 0.105 * sin(angle)) for angle in (step * pi / 60 for step in range(3, 28))
    ]
    drawing.line(turn, "ink", arrow=True)
    drawing.text(
        (ROBOT(0.078, 0.083)[0], ROBOT(0.078, 0.083)[1]), "yaw turns to the left: 0 deg is x, 90 deg is y"
    )
    _sensor(drawing, (SONAR, 0.0), (390, 212), "pose: {x: 7 cm}, a sonar", "blue")
    _sensor(drawing, (0.07, -0.02), (390, 238), "pose: {x: 7 cm, y: -2 cm}", "ink")
    _sensor(drawing, (-0.05, 0.03), (390, 120), "pose: {x: -5 cm, y: 3 cm}", "ink")
    _reading(drawing)
    return drawing.svg()


def _sensor(
    drawing: Drawing, place: tuple[float, float], label: tuple[float, float], text: str, color: str
) -> None:
    x, y = ROBOT(*place)
    drawing.line([(x, y), (label[0] - 8, label[1] - 4)], "soft", dashed=True)
    drawing.circle((x, y), 4, color, fill="solid-blue" if color == "blue" else "solid")
    drawing.text(label, text, code=True)


def _reading(drawing: Drawing) -> None:
    """The way from the origin to the wall: what the sonar reads is the rest behind its place."""
    wall = STRIP(WALL, 0.0)
    draw_rover(drawing, STRIP)
    drawing.line([STRIP(SONAR, 0.0), wall], "blue", arrow=True)
    drawing.text((STRIP(0.43, 0.0)[0], wall[1] - 8), "it reads 79 cm - 7 cm = 72 cm", "blue", anchor="middle")
    drawing.line([(wall[0], wall[1] - 45), (wall[0], wall[1] + 45)], "ink")
    drawing.text((wall[0] + 8, wall[1] + 4), "wall")
    for end, label, down in ((SONAR, "7 cm", 24), (WALL, "79 cm", 44)):
        below = wall[1] + down
        drawing.line([(STRIP(0.0, 0.0)[0], below), (STRIP(end, 0.0)[0], below)], "soft", arrow=True)
        drawing.text(
            (STRIP(end, 0.0)[0] + (6 if end < WALL else -48), below + (4 if end < WALL else -5)),
            label,
            "soft",
        )
