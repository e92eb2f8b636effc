"""Sensors that measure along rays: distances, and how bright the ground is."""

from __future__ import annotations

from bisect import bisect_right
from typing import Any

from deepbots_cli import frames
from deepbots_cli.frames import Triple
from deepbots_cli.port import RayReader
from deepbots_cli.program.robots import CalibrationTable, RayConfig
from deepbots_cli.runtime.lines import Paint
from deepbots_cli.runtime.sensing.device import Figures, Instrument, Normals, Site


def ranging(site: Site) -> Instrument:
    """How far each ray is free, or one figure of all, in m; or what the lookup table makes of that."""
    beams, mount = site.sensor.beams or RayConfig((), 0.0), site.mount
    rays = [frames.inside(mount, frames.frame(ray)) for ray in beams.rays]
    read = _combined(site.engine.rays((site.robot, site.link), rays, beams.reach), beams)
    if beams.lookup is None:
        return Instrument(read)
    table = Table(beams.lookup, max(1, len(site.sensor.components)))
    return Instrument(lambda: table(read()), table.restart)


def _combined(read: RayReader, beams: RayConfig) -> RayReader:
    count = len(beams.rays)
    match beams.combined:
        case "nearest":
            return lambda: (min(read()),)
        case "mean":
            return lambda: (sum(read()) / count,)
        case _:
            return read


class Table:
    """Readings of `width` rays by their distances, with the noise of each row."""

    def __init__(self, spec: CalibrationTable, width: int) -> None:
        distance, value = spec.distance, spec.value
        noise = spec.noise or (0.0,) * len(distance)
        self._distances = distance
        self._normals = Normals(width) if spec.noise else None
        starts = zip(distance, value, noise, _slopes(distance, value), _slopes(distance, noise), strict=True)
        first = (distance[0], value[0], noise[0], 0.0, 0.0)
        self._rows = [first, *starts]
        """Distance, value and noise at the start of a stretch, and how value and noise change along it; the first is before the table."""

    def restart(self, generator: Any) -> None:
        if self._normals is not None:
            self._normals.restart(generator)

    def __call__(self, distances: Figures) -> Figures:
        known, rows = self._distances, self._rows
        if self._normals is None:
            return [(row := rows[bisect_right(known, x)])[1] + row[3] * (x - row[0]) for x in distances]
        readings = []
        for x, normal in zip(distances, self._normals.row(), strict=True):
            start, value, noise, slope, growth = rows[bisect_right(known, x)]
            along = x - start
            readings.append((value + slope * along) * (1.0 + (noise + growth * along) * normal))
        return readings


def _slopes(distance: Figures, column: Figures) -> list[float]:
    """By how much a column changes per m after each row; not at all after the last."""
    pairs = zip(distance, distance[1:], column, column[1:], strict=False)
    return [*((d - c) / (b - a) for a, b, c, d in pairs), 0.0]


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
