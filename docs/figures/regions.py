"""Three starts of the first scenario of docs/resets.md, seen from above."""

from __future__ import annotations

import re
from contextlib import closing
from math import cos, hypot, sin
from pathlib import Path

from deepbots_cli import api
from deepbots_cli.compiler import check
from deepbots_cli.document import loads
from deepbots_cli.frames import roll_pitch_yaw
from deepbots_cli.program.resets import Placement, Region
from deepbots_cli.robots.kinematics import robot_bounds
from deepbots_cli.robots.model import Box, Sphere
from deepbots_cli.runtime import Supervisor
from figures.drawing import Drawing, Point

ROOT = Path(__file__).resolve().parents[2]
SCALE = 185.0  # pixels per meter
SIDE = 0.5  # m, from the center of the arena
SEEDS = (0, 4, 3)
TOP = 135.0


def draw() -> str:
    text = re.findall(
        r"```yaml fragment\n(.*?)```", (ROOT / "docs" / "resets.md").read_text(encoding="utf-8"), re.DOTALL
    )[0]
    compiled = api.compile(check(loads(f"deepbots: 1\nextends: cartpole\n{text}", base=ROOT / "scenarios")))
    drawing = Drawing(
        640, 300, "Three starts from above: a cart, a ball in its region, and a group of crates"
    )
    with closing(api.make(compiled, engine="mujoco")) as environment:
        for column, seed in enumerate(SEEDS):
            _, info = environment.reset(seed=seed)
            _start(drawing, (115.0 + 205.0 * column, TOP), environment, str(info["drawn"]["reset.layout"]))
            drawing.text(
                (115.0 + 205.0 * column, 24.0),
                f"seed {seed}: {info['drawn']['reset.layout']}",
                anchor="middle",
                code=True,
            )
    drawing.line([(30, 262), (55, 262)], "green", dashed=True)
    drawing.text((62, 266), "region of the ball", "green")
    drawing.line([(230, 262), (255, 262)], "orange", dashed=True)
    drawing.text((262, 266), "clearance of the cart and the crates", "orange")
    drawing.text((30, 290), "x to the right, y up; an episode has 0 to 2 crates", "soft")
    return drawing.svg()


def _start(drawing: Drawing, center: Point, environment: Supervisor, layout: str) -> None:
    world = environment.scenario.world
    engine = next(iter(environment.agents.values())).engine
    placed = {
        one.body: one
        for each in environment.scenario.reset.layouts
        if each.name == layout
        for one in each.placements
    }

    def seen(x: float, y: float) -> Point:
        return center[0] + SCALE * x, center[1] - SCALE * y

    def corners(x: float, y: float, dx: float, dy: float, yaw: float = 0.0) -> list[Point]:
        turned = [
            (a * dx * cos(yaw) - b * dy * sin(yaw), a * dx * sin(yaw) + b * dy * cos(yaw))
            for a, b in ((1, 1), (-1, 1), (-1, -1), (1, -1))
        ]
        return [seen(x + u, y + v) for u, v in turned]

    def clearance(name: str) -> float:
        found: Placement | None = placed.get(name)
        return found.clearance if found else 0.0

    drawing.polygon(corners(0.0, 0.0, SIDE, SIDE), "ink")
    if "ball" in placed and isinstance(spot := placed["ball"].spot, Region):
        (low_x, low_y), (high_x, high_y) = spot.low, spot.high
        drawing.polygon(
            corners((low_x + high_x) / 2, (low_y + high_y) / 2, (high_x - low_x) / 2, (high_y - low_y) / 2),
            "green",
            dashed=True,
        )
    for body in world.objects:
        (x, y, _), turn = engine.pose(body.name, body.name)()
        if abs(x) > SIDE:
            continue  # absent
        yaw = roll_pitch_yaw(turn)[2]
        if isinstance(body.shape, Sphere):
            drawing.circle(seen(x, y), SCALE * body.shape.radius, "green", fill="solid-green")
        elif isinstance(body.shape, Box):
            dx, dy = body.shape.size[0] / 2, body.shape.size[1] / 2
            drawing.polygon(corners(x, y, dx, dy, yaw), "ink", fill="solid")
            around = clearance("crate")
            drawing.polygon(corners(x, y, dx + around, dy + around, yaw), "orange", dashed=True)
    (robot,) = world.robots
    low, high = robot_bounds(robot.model)
    (x, y, _), turn = engine.pose(robot.name, robot.model.root)()
    dx, dy = (high[0] - low[0]) / 2, (high[1] - low[1]) / 2
    drawing.polygon(corners(x, y, dx, dy, roll_pitch_yaw(turn)[2]), "blue", fill="solid")
    if "cart" in placed and placed["cart"].spot:
        drawing.circle(seen(x, y), SCALE * (hypot(dx, dy) + clearance("cart")), "orange", dashed=True)
    drawing.text((seen(x, y)[0], seen(x, y)[1] + 4), "cart", "blue", anchor="middle")
