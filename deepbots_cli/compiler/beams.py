"""The rays of a sensor: by name or as a fan, what they report at which distance, and how far they reach."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise

from deepbots_cli.compiler.mounts import mount
from deepbots_cli.compiler.sensors import SensorKind
from deepbots_cli.compiler.values import Values
from deepbots_cli.document.nodes import Path
from deepbots_cli.expressions.dimensions import ANGLE, LENGTH, NUMBER, Dimension
from deepbots_cli.expressions.intervals import Interval
from deepbots_cli.expressions.types import Components, NoNames
from deepbots_cli.expressions.unification import ANY_SHAPE
from deepbots_cli.program.robots import CalibrationTable, RayConfig
from deepbots_cli.robots.model import Pose
from deepbots_cli.scenario.sensors import RayScan, RaySensor, Reflectance


@dataclass(frozen=True)
class ReadBeams:
    """What was read: the rays, their names (none for a single figure), and the readings that they give."""

    beams: RayConfig
    components: Components
    dimension: Dimension
    interval: Interval


@dataclass(frozen=True)
class BeamReader:
    """Reads what is about rays in the sensor that stands at `path`; without a lookup, its range says how far they reach."""

    values: Values
    path: Path

    def read(self, spec: RayScan, kind: SensorKind) -> ReadBeams | None:
        """None after a finding."""
        rays = self._rays(spec)
        if isinstance(spec, Reflectance):
            spot = self.values.number((*self.path, "spot"), spec.spot, LENGTH)
            if rays is None or spot is None:
                return None
            return ReadBeams(RayConfig(tuple(rays.values()), 0.0, spot=spot), _named(rays), kind.dimension, kind.interval)
        if not isinstance(spec, RaySensor):
            return None
        table = self._lookup(spec) if spec.lookup is not None else None
        if rays is None or (spec.lookup is not None and table is None):
            return None
        components = _named(rays) if spec.measure == "each" else ()
        beams = RayConfig(tuple(rays.values()), 0.0, spec.measure)
        if table is not None:
            lookup, dimension = table
            reach = Interval(min(lookup.value), max(lookup.value))
            return ReadBeams(replace(beams, reach=lookup.distance[-1], lookup=lookup), components, dimension, reach)
        return ReadBeams(beams, components, kind.dimension, kind.interval)

    # Rays

    def _rays(self, spec: RayScan) -> dict[str, Pose] | None:
        place = (*self.path, "rays")
        if isinstance(spec.rays, dict):
            if spec.fan is not None:
                headline = "a fan, where the rays are given by name"
                self.values.findings.add(
                    "DB101", self.values.key_span((*self.path, "fan")), headline, help="give their number under `rays`"
                )
            return {name: mount(self.values, (*place, name), ray) for name, ray in spec.rays.items()}
        count = spec.rays or 1
        if spec.fan is None:
            if count > 1:
                headline = f"{count} rays without their directions"
                self.values.findings.add("DB102", self.values.span(place), headline, help="add `fan: 90 .. -90 deg`, or give them by name")
                return None
            return {"": Pose()} if spec.rays is None else {"r0": Pose()}
        return self._fan(spec.fan, count)

    def _fan(self, given: str, count: int) -> dict[str, Pose] | None:
        """Rays at equal angles from the first to the last; a single one looks along the middle."""
        text = self.values.text((*self.path, "fan"), given)
        ends = self.values.ends(text, "the fan", NoNames(), dimension=ANGLE, falling=True)
        if ends is None:
            return None
        (first,), (last,) = ends.low, ends.high
        turns = [first + (last - first) * (index / (count - 1) if count > 1 else 0.5) for index in range(count)]
        return {f"r{index}": Pose(rpy=(0.0, 0.0, turn)) for index, turn in enumerate(turns)}

    # Lookup tables

    def _lookup(self, spec: RaySensor) -> tuple[CalibrationTable, Dimension] | None:
        assert spec.lookup is not None
        distance = self._column("distance", spec.lookup.distance, LENGTH)
        value = self._column("value", spec.lookup.value, None)
        noise = self._column("noise", spec.lookup.noise, NUMBER) if spec.lookup.noise is not None else ((), NUMBER)
        if distance is None or value is None or noise is None:
            return None
        columns = {"value": value[0], **({"noise": noise[0]} if spec.lookup.noise is not None else {})}
        sound = self._is_table(distance[0], columns)
        return (CalibrationTable(distance[0], value[0], noise[0]), value[1]) if sound else None

    def _column(self, key: str, given: object, dimension: Dimension | None) -> tuple[tuple[float, ...], Dimension] | None:
        path = (*self.path, "lookup", key)
        text = self.values.text(path, given)
        typed = self.values.quantity(text, f"`{key}`", NoNames(), dimension, ANY_SHAPE)
        figures = self.values.fixed(typed, text, f"`{key}`") if typed else None
        return (tuple(map(float, figures)), typed.type.dimension) if typed and figures else None

    def _is_table(self, distance: tuple[float, ...], columns: dict[str, tuple[float, ...]]) -> bool:
        place = (*self.path, "lookup")
        sound = True
        for key, column in columns.items():
            if len(column) != len(distance):
                headline = f"`{key}` has {len(column)} figures, `distance` {len(distance)}"
                self.values.findings.add("DB106", self.values.span((*place, key)), headline, help="give one for each distance")
                sound = False
        fault = _fault(distance, columns.get("noise", ()))
        if fault is not None:
            key, headline, help = fault
            self.values.findings.add("DB105", self.values.span((*place, key)), headline, help=help)
        return sound and fault is None


def _fault(distance: tuple[float, ...], noise: tuple[float, ...]) -> tuple[str, str, str] | None:
    """Where a table cannot be meant: the column, and what is wrong with it."""
    falling = [b for a, b in pairwise(distance) if b <= a]
    if falling:
        return "distance", f"the distances do not rise at {falling[0]:g} m", "give the nearest first"
    if distance[0] < 0.0 or distance[-1] <= 0.0:
        return "distance", f"a distance of {min(distance[0], distance[-1]):g} m", "distances are 0 or more, the last more than 0"
    if noise and min(noise) < 0.0:
        return "noise", f"a noise of {min(noise):g}", "give 0 or more"
    return None


def _named(rays: dict[str, Pose]) -> Components:
    """The names of the rays; none for a single one without a name."""
    return () if "" in rays else tuple(rays)
