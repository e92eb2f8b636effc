"""Rays that pass over everything in every step of a simulation, the code DB615."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from math import hypot, inf

from deepbots_cli import footprint, frames
from deepbots_cli.diagnostics import Finding
from deepbots_cli.lint.probed import Probed
from deepbots_cli.lint.rays import ARENA, CLEAR, Aim, Heights, casts_rays, over_all
from deepbots_cli.port import Engine
from deepbots_cli.program import Program
from deepbots_cli.program.robots import Sensor
from deepbots_cli.program.world import ObjectBody


class Overlooking:
    """The sensors whose rays were above everything solid in all steps so far, and met nothing: `aims`, by robot and sensor.

    Of teams and above terrain there is none.
    """

    def __init__(self, scenario: Program) -> None:
        self._world = scenario.world
        is_asked = scenario.world.terrain is None and scenario.agent.each is None
        found = [(robot.name, sensor) for robot in scenario.robots for sensor in robot.sensors if is_asked and casts_rays(sensor)]
        self._sensors = {(robot, sensor.name): sensor for robot, sensor in found}
        self.aims: dict[tuple[str, str], Aim] = dict.fromkeys(self._sensors, Aim(inf, -inf, ""))

    def watch(self, engine: Engine) -> Callable[[], None]:
        """What looks at the world of an engine, once in each step."""
        if not self.aims:
            return lambda: None
        tops = {thing.name: _top_of(engine, thing) for thing in self._world.objects if thing.solid}
        tops |= {body.name: _top_of_robot(engine, body.name, footprint.bounds(body.model)) for body in self._world.robots}
        if self._world.arena is not None:
            wall = self._world.arena.wall_height
            tops[ARENA] = lambda: wall
        lowest = {both: _lowest(engine, both[0], self._sensors[both]) for both in self.aims}

        def look() -> None:
            known = [(top(), name) for name, top in tops.items()] if self.aims else []
            for both, before in list(self.aims.items()):
                highest = max((top for top in known if top[1] != both[0]), default=(inf, ""))
                low = lowest[both]()
                if low > highest[0] + CLEAR:
                    self.aims[both] = Aim(min(low, before.lowest), *max(highest, (before.top, before.tallest)))
                else:
                    del self.aims[both]

        return look


def _top_of(engine: Engine, thing: ObjectBody) -> Callable[[], float]:
    shapes = [variant.shape for variant in thing.variants] or [thing.shape]
    pose = engine.pose(thing.name)
    return lambda: max(footprint.bounds_of_shape(shape, pose())[1][2] for shape in shapes)


def _top_of_robot(engine: Engine, name: str, box: footprint.Bounds) -> Callable[[], float]:
    """At most so high, in whatever attitude the root is."""
    pose, reach = engine.pose(name), hypot(*(max(-low, high) for low, high in zip(*box, strict=True)))
    return lambda: pose()[0][2] + reach


def _lowest(engine: Engine, robot: str, sensor: Sensor) -> Callable[[], float]:
    """The lowest point of any ray within its range, m above the ground; minus infinity while one meets something."""
    assert sensor.beams is not None  # it casts rays
    mount, reach, part = frames.frame(sensor.mount), sensor.beams.reach, (robot, sensor.subjects[0])
    rays = [frames.inside(mount, frames.frame(ray)) for ray in sensor.beams.rays]
    ends = [end for ray in rays for end in (ray[0], frames.inside(ray, ((reach, 0.0, 0.0), frames.UPRIGHT))[0])]
    pose, cast = engine.pose(*part), engine.rays(part, rays, reach)

    def lowest() -> float:
        (_, _, height), turn = pose()
        return height + min(frames.rotate(turn, end)[2] for end in ends) if min(cast()) >= reach else -inf

    return lowest


def rays_meet_nothing(probed: Probed) -> Iterator[Finding]:
    """DB615: as the rule of that name, for robots whose height the text does not tell."""
    heights = Heights(probed.program)
    for (robot, sensor), aim in probed.report.over.items() if probed.report.whole else ():
        if heights.is_left_to_simulation(robot, sensor):
            yield over_all(probed.names.values, robot, sensor, aim, notes=(probed.looked,))


RULES = {"DB615": rays_meet_nothing}
