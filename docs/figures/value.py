"""The way of the angle of the pole of CartPole, from the robot file to the policy."""

from __future__ import annotations

from math import degrees, radians

from deepbots_cli import api
from figures.drawing import Drawing

ANGLE = 5.0  # deg
LEFT, WIDTH, HEIGHT, STEP = 150.0, 240.0, 40.0, 62.0


def draw() -> str:
    program = api.compile("cartpole").program
    (body,) = program.world.robots
    joint = body.model.joint("pole_hinge")
    (entry,) = [one for one in program.agent.numbers if one.name == "cart.pole_angle"]
    seen = radians(ANGLE) / entry.high
    limits = f"{degrees(joint.limit.lower or 0):.0f} .. {degrees(joint.limit.upper or 0):.0f} deg"
    stages = [
        ("robot file (URDF)", f"joint {joint.name}, {joint.type}", limits, "soft"),
        ("physics engine", "turns the joint", f"{radians(ANGLE):.4f} rad", "soft"),
        ("sensor", "type: joint_position", "+ noise, bias, drift, period, latency", "blue"),
        ("robot controller", "emit: pole_angle", "from the sensors of this robot alone", "blue"),
        ("message", f"format: {program.format}", "latency and loss of the channel", "orange"),
        ("supervisor", "cart.pole_angle", "the last message that arrived", "green"),
        ("observation", "cart.pole_angle: -20 .. 20 deg", f"mapped to -1 .. 1: {seen:.2f}", "green"),
        ("policy", "sees a number without unit", "", "ink"),
    ]
    assert round(degrees(entry.high)) == 20
    drawing = Drawing(660, 520, f"The way of a pole angle of {ANGLE:g} deg from the robot file to the policy")
    for number, (name, what, change, color) in enumerate(stages):
        top = 12.0 + STEP * number
        drawing.text((LEFT - 14, top + 25), name, anchor="end")
        drawing.box(LEFT, top, WIDTH, HEIGHT, color)
        drawing.text((LEFT + WIDTH / 2, top + 25), what, anchor="middle", code=True)
        drawing.text((LEFT + WIDTH + 14, top + 25), change, color)
        if number + 1 < len(stages):
            drawing.line([(LEFT + WIDTH / 2, top + HEIGHT), (LEFT + WIDTH / 2, top + STEP - 2)], arrow=True)
    return drawing.svg()
