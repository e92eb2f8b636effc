"""How two wheels move the robot of lesson 2: the action, the speeds of the wheels, the way of the robot."""

from __future__ import annotations

from math import cos, pi, sin

from figures.drawing import Drawing, Point
from figures.rover import Seen, draw_rover, from_above, wheel_places

SCALE = 620.0  # pixels per meter
FULL = 0.085
"""The length in m of the arrow of a wheel at full speed."""


def draw() -> str:
    drawing = Drawing(640, 330, "Actions, the speeds of two wheels, and how the robot moves")
    for center, gas, turn, about in (
        (95.0, 1.0, 0.0, "straight ahead"),
        (310.0, 0.0, 1.0, "turns left on the spot"),
        (515.0, 0.6, 0.3, "a curve to the left"),
    ):
        _robot(drawing, (center, 105.0), gas, turn)
        drawing.text((center, 30), f"gas: {gas:g}, turn: {turn:g}", anchor="middle", code=True)
        drawing.text((center, 185), f"left {gas - turn:g}, right {gas + turn:g}", anchor="middle", code=True)
        drawing.text((center, 204), about, "soft", anchor="middle")
    _rolling(drawing)
    return drawing.svg()


def _robot(drawing: Drawing, center: Point, gas: float, turn: float) -> None:
    seen = from_above(center, SCALE)
    draw_rover(drawing, seen)
    for (x, y), speed in zip(wheel_places(), (gas - turn, gas + turn), strict=True):
        if speed:
            drawing.line([seen(x, y), seen(x + FULL * speed, y)], "blue", arrow=True)
    drawing.line(_way(seen, gas, turn), "orange", arrow=True)


def _way(seen: Seen, gas: float, turn: float) -> list[Point]:
    """The way of the middle of the robot; on the spot, an arc that shows its turn."""
    if gas == 0.0:
        return [
            seen(0.04 * cos(angle), 0.04 * sin(angle)) for angle in (step * pi / 24 for step in range(25))
        ]
    if turn == 0.0:
        return [seen(0.0, 0.0), seen(0.13, 0.0)]
    left, _ = wheel_places()
    radius = left[1] * gas / turn
    return [
        seen(radius * sin(angle), radius * (1 - cos(angle))) for angle in (step * 0.02 for step in range(45))
    ]


def _rolling(drawing: Drawing) -> None:
    """A wheel from the side: what it rolls in a second."""
    middle, radius, way = (95.0, 270.0), 32.0, 160.0
    ground = middle[1] + radius
    drawing.line([(30, ground), (330, ground)], "soft")
    drawing.circle((middle[0] + way, middle[1]), radius, "soft", dashed=True)
    drawing.circle(middle, radius, "soft", fill="solid")
    drawing.line([middle, (middle[0], ground)], "ink")
    drawing.text((middle[0] - radius - 6, middle[1] + 20), "3 cm", anchor="end", code=True)
    turned = ((1 - step / 20) * pi * 0.85 + 0.2 for step in range(21))
    arc = [(middle[0] + 22 * cos(angle), middle[1] - 22 * sin(angle)) for angle in turned]
    drawing.line(arc, "blue", arrow=True)
    drawing.line([(middle[0], ground + 14), (middle[0] + way, ground + 14)], "orange", arrow=True)
    drawing.text((middle[0] + way + 8, ground + 18), "in a second", "orange")
    drawing.text((360, 262), "a wheel rolls radius · speed", "")
    drawing.text((360, 284), "3 cm · 10 rad/s = 30 cm/s", code=True)
    drawing.text((360, 306), "a full turn is 6.28 rad", "soft")
