"""Sensors that look at how bright the ground is."""

from __future__ import annotations

from deepbots_cli import frames
from deepbots_cli.frames import Triple
from deepbots_cli.program.robots import RayConfig
from deepbots_cli.runtime.lines import Paint
from deepbots_cli.runtime.sensing.device import Instrument, Site

_DOWN: Triple = (0.0, 0.0, -1.0)


def reflectance(site: Site) -> Instrument:
    """The light that the plane z = 0 throws back where -z of each ray's frame meets it; none where it looks level or up.

    Unpainted ground is 1. A reading is the mean over a spot, so that it goes gradually from ground to line.
    """
    beams, mount, spot = site.sensor.beams or RayConfig((), 0.0), site.mount, site.parameters["spot"]
    rays = [frames.inside(mount, frames.frame(ray)) for ray in beams.rays]
    eyes = [(origin, frames.rotate(turned, _DOWN)) for origin, turned in rays]
    read, paint, rotate = site.engine.pose(site.robot, site.link), Paint(site.world.lines, spot / 2), frames.rotate

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
