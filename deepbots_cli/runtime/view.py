"""Where to look from: a view that holds the whole scene."""

from __future__ import annotations

import math

from deepbots_cli.ir import CompiledScenario
from deepbots_cli.port import View
from deepbots_cli.urdf.model import Box, Capsule, Cylinder, RobotModel, Shape, Sphere


def overview(scenario: CompiledScenario, width: int = 480, height: int = 320) -> View:
    """A view from the front right, above, on the robots and the arena around them."""
    world = scenario.world
    reach = max([_reach(robot.model) for robot in world.robots], default=0.5)
    radius = max(reach, 0.5 * math.hypot(*world.arena.size)) if world.arena else 1.3 * reach
    target = (0.0, 0.0, 0.35 * reach)
    eye = (0.55 * radius, -2.1 * radius, target[2] + 0.75 * radius)
    return View(eye, target, width, height)


def _reach(model: RobotModel) -> float:
    """A radius in m around the root that holds the robot in any pose."""
    steps = sum(math.dist((0, 0, 0), joint.origin.xyz) for joint in model.joints if joint.parent != model.root)
    first = max((math.dist((0, 0, 0), joint.origin.xyz) for joint in model.joints if joint.parent == model.root), default=0.0)
    extents = [_extent(g.shape) + math.dist((0, 0, 0), g.origin.xyz) for link in model.links for g in link.visuals]
    return max(0.05, first + steps, *extents) if extents else max(0.3, first + steps)


def _extent(shape: Shape) -> float:
    match shape:
        case Box(size):
            return 0.5 * math.hypot(*size)
        case Sphere(radius):
            return radius
        case Cylinder(radius, length) | Capsule(radius, length):
            return math.hypot(radius, 0.5 * length)
        case _:
            return 0.2
