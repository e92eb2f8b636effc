"""The eight infrared rays of the e-puck in find_ball, seen from above, and their lookup table."""

from __future__ import annotations

from math import cos, degrees, sin

from deepbots_cli import api
from deepbots_cli.robots.kinematics import box_sides, robot_bounds
from figures.drawing import Drawing, Point

SCALE = 1150.0  # pixels per meter
CENTER = (160.0, 165.0)


def _seen(x: float, y: float) -> Point:
    """From above: the x axis of the robot goes up, y to the left."""
    return CENTER[0] - SCALE * y, CENTER[1] - SCALE * x


def draw() -> str:
    program = api.compile("find_ball").program
    (sensor,) = program.robots[0].sensors
    assert sensor.beams is not None
    assert sensor.beams.lookup is not None
    drawing = Drawing(640, 330, "The rays of a distance sensor from above, and its lookup table")
    radius = box_sides(robot_bounds(program.world.robots[0].model))[1] / 2
    drawing.circle(_seen(0.0, 0.0), SCALE * radius, "soft", fill="solid")
    drawing.line([_seen(0.0, 0.0), _seen(0.03, 0.0)], "orange", arrow=True)
    drawing.line([_seen(0.0, 0.0), _seen(0.0, 0.03)], "green", arrow=True)
    drawing.text((CENTER[0] + 5, CENTER[1] - 22), "x", "orange")
    drawing.text((CENTER[0] - 26, CENTER[1] + 16), "y", "green")
    wall = 0.067
    for name, ray in zip(sensor.components, sensor.beams.rays, strict=True):
        (x, y, _), yaw = ray.xyz, ray.rpy[2]
        reach = min(sensor.beams.reach, (wall - x) / cos(yaw)) if cos(yaw) > 0 else sensor.beams.reach
        hit = reach < sensor.beams.reach
        end = x + reach * cos(yaw), y + reach * sin(yaw)
        drawing.line([_seen(x, y), _seen(*end)], "orange" if hit else "blue", dashed=not hit, arrow=not hit)
        if hit:
            drawing.circle(_seen(*end), 4, "orange", fill="solid-orange")
        label = (
            _seen(x + (reach + 0.013) * cos(yaw), y + (reach + 0.013) * sin(yaw))
            if not hit
            else _seen(end[0] + 0.012, end[1])
        )
        drawing.text((label[0], label[1] + 4), name, anchor="middle", code=True)
    drawing.line([_seen(wall, 0.1), _seen(wall, -0.1)], "ink")
    drawing.text((_seen(wall, 0.132)[0], _seen(wall, 0)[1] + 4), "wall")
    first = sensor.beams.rays[0].rpy[2]
    drawing.text(
        (20, 318), f"ps0 points {degrees(first):.1f} deg from x: negative angles go to the right", "soft"
    )
    _table(drawing, sensor.beams.lookup.distance, sensor.beams.lookup.value)
    return drawing.svg()


def _table(drawing: Drawing, distances: tuple[float, ...], values: tuple[float, ...]) -> None:
    left, top, width, height = 390.0, 50.0, 220.0, 190.0

    def at(distance: float, value: float) -> Point:
        return left + width * distance / distances[-1], top + height * (1 - value / values[0])

    drawing.line([(left, top), (left, top + height), (left + width, top + height)], "soft")
    drawing.line([at(*pair) for pair in zip(distances, values, strict=True)], "blue")
    for pair in zip(distances, values, strict=True):
        drawing.circle(at(*pair), 3, "blue", fill="solid-blue")
    drawing.text((left - 6, top + 5), f"{values[0]:g}", anchor="end")
    drawing.text((left - 6, top + height + 4), "0", anchor="end")
    drawing.text((left, top + height + 20), "0", anchor="middle")
    drawing.text((left + width, top + height + 20), f"{100 * distances[-1]:g} cm", anchor="middle")
    drawing.text((left + width / 2, top + height + 20), "distance", "soft", anchor="middle")
    drawing.text((left, top - 16), "reading, from `lookup`", "soft")
