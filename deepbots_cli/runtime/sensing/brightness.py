"""Sensors that look at how bright the ground is."""

from __future__ import annotations

from deepbots_cli import frames
from deepbots_cli.frames import Frame, Triple
from deepbots_cli.port import Engine
from deepbots_cli.program.robots import RayConfig, Sensor
from deepbots_cli.program.world import WorldModel
from deepbots_cli.runtime.lines import Paint
from deepbots_cli.runtime.sensing.device import Instrument

_DOWN: Triple = (0.0, 0.0, -1.0)


def reflectance(engine: Engine, robot: str, sensor: Sensor, mount: Frame, world: WorldModel) -> Instrument:
    """The light that the plane z = 0 throws back where -z of each ray's frame meets it; none where it looks level or up.

    Unpainted ground is 1. A reading is the mean over a spot, so that it goes gradually from ground to line.
    """
    beams = sensor.beams or RayConfig((), 0.0)
    rays = [frames.inside(mount, frames.frame(ray)) for ray in beams.rays]
    eyes = [(origin, frames.rotate(turned, _DOWN)) for origin, turned in rays]
    read, paint, rotate = engine.pose(robot, sensor.subjects[0]), Paint(world.lines, beams.spot / 2), frames.rotate

    def brightness() -> list[float]:
        (x, y, z), turned = read()
        readings = []
        for origin, direction in eyes:
            right, left, up = rotate(turned, origin)
            ahead, aside, down = rotate(turned, direction)
            if down > -1e-6:
                readings.append(0.0)
                continue
            way = (z + up) / -down
            readings.append(paint(x + right + way * ahead, y + left + way * aside))
        return readings

    return Instrument(brightness)
