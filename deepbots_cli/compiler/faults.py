"""How sensors err: the faults that a scenario gives them, checked against what they measure."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from deepbots_cli.compiler.namespace import Namespace
from deepbots_cli.compiler.scopes import ParameterScope
from deepbots_cli.compiler.values import Values
from deepbots_cli.compiler.variations import figure, figures
from deepbots_cli.document.nodes import Path
from deepbots_cli.expressions.dimensions import NUMBER, TIME, Dimension
from deepbots_cli.expressions.intervals import EVERYTHING, Interval
from deepbots_cli.expressions.types import Context, Type
from deepbots_cli.program.robots import MIN_RESOLUTION, NoiseModel
from deepbots_cli.scenario.sensors import Sensor

MOST_TICKS = 100_000
"""The longest period and latency; a reading that old tells nothing, and each is kept."""
_OF_NUMBERS = ("noise", "bias", "drift", "quantise", "range")


@dataclass(frozen=True)
class FaultReader:
    """Reads the faults of one sensor, which stands at `path`."""

    namespace: Namespace
    robot: str
    sensor: str
    path: Path

    def read(self, spec: Sensor, known: Type) -> tuple[NoiseModel | None, Interval]:
        """Its faults, period apart, and the interval of its readings; None where there are none."""
        drawn = len(self.namespace.variations)
        if known.boolean or known.picture:
            faults = self._of_no_numbers(spec, known)
            return self._unless_none(faults, drawn), known.interval
        noise, relative_noise = self._figures(spec, "noise", known)
        bias, relative_bias = self._figures(spec, "bias", known)
        drift, _ = self._figures(spec, "drift", known, known.dimension / TIME)
        quantise = self._steps(spec, known)
        low, high = self._range(spec, known)
        faults = NoiseModel(1, self._latency(spec), noise, relative_noise, bias, relative_bias, drift, low, high, quantise)
        wanders = noise or relative_noise or bias or relative_bias or drift
        reach = EVERYTHING if wanders else known.interval
        if low:
            reach = Interval(min(low), max(high))
        if quantise and math.isfinite(reach.low) and math.isfinite(reach.high):
            half = max(quantise) / 2
            reach = Interval(reach.low - half, reach.high + half)
        return self._unless_none(faults, drawn), reach

    def _unless_none(self, faults: NoiseModel, drawn: int) -> NoiseModel | None:
        """None for a perfect sensor, of which no figure has been drawn since there were `drawn` of them."""
        return None if faults == NoiseModel() and len(self.namespace.variations) == drawn else faults

    def _of_no_numbers(self, spec: Sensor, known: Type) -> NoiseModel:
        tells, keys = ("takes pictures", _OF_NUMBERS[:-1]) if known.picture else ("tells true or false", _OF_NUMBERS)
        for key in keys:
            if key in spec.model_fields_set:
                headline = f"`{key}` of a sensor that {tells}"
                self.namespace.values.findings.add("DB403", self.namespace.values.key_span((*self.path, key)), headline, help="take it out")
        return NoiseModel(latency=self._latency(spec))

    def _latency(self, spec: Sensor) -> float:
        if "latency" not in spec.model_fields_set:
            return 0.0
        return figure(self.namespace, (*self.path, "latency"), spec.latency, TIME, self._scope, "sensor", self._of("latency")) or 0.0

    def _figures(
        self, spec: Sensor, key: str, known: Type, dimension: Dimension | None = None
    ) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """A figure for each component, absolute or relative: written with `%` it is a share of the value."""
        if key not in spec.model_fields_set:
            return (), ()
        place, given = (*self.path, key), getattr(spec, key)
        relative = dimension is None and "%" in self.namespace.values.text(place, given).text
        wanted = NUMBER if relative else dimension or known.dimension
        what = self._of(f"relative_{key}" if relative else key)
        drawn = len(self.namespace.variations)
        found = figures(self.namespace, place, given, wanted, self._scope, "sensor", what, spread=known.components or ("",)) or ()
        if not any(found) and drawn == len(self.namespace.variations):
            found = ()
        return ((), found) if relative else (found, ())

    def _steps(self, spec: Sensor, known: Type) -> tuple[float, ...]:
        if "quantise" not in spec.model_fields_set:
            return ()
        given = self.namespace.values.numbers((*self.path, "quantise"), spec.quantise, known.dimension, known.components, self._fixed)
        if given and any(0.0 < step < MIN_RESOLUTION for step in given):
            values, headline = self.namespace.values, f"a step of {min(given):g} between two readings"
            values.findings.add(
                "DB105", values.span((*self.path, "quantise")), headline, help=f"give at least {MIN_RESOLUTION:g}, or take it out"
            )
        return given if given and all(given) else ()

    def _range(self, spec: Sensor, known: Type) -> tuple[tuple[float, ...], tuple[float, ...]]:
        if spec.range is None:
            return (), ()
        values = self.namespace.values
        text = values.text((*self.path, "range"), spec.range)
        ends = values.ends(text, "the range of a sensor", self._fixed, dimension=known.dimension, components=known.components)
        return (ends.low, ends.high) if ends else ((), ())

    def _of(self, figure: str) -> tuple[str, str, str]:
        return self.robot, self.sensor, figure

    @property
    def _scope(self) -> ParameterScope:
        return ParameterScope(self.namespace, Context.FIELD)

    @property
    def _fixed(self) -> ParameterScope:
        return ParameterScope(self.namespace, Context.FIXED)


def period(faults: NoiseModel | None, values: Values, path: Path, given: object, tick: float) -> NoiseModel | None:
    """The faults with the period that stands at `path`, in ticks; DB308 for one that is no whole number of them."""
    seconds = None if given is None else values.number((*path, "period"), given, TIME)
    if seconds is None or values.is_lost("world.timestep"):
        return faults
    ticks = round(seconds / tick)
    if ticks < 1 or abs(seconds - ticks * tick) > 1e-9 * seconds:
        headline = f"a period of {seconds:g} s, which is no multiple of the timestep of {tick:g} s"
        values.findings.add("DB308", values.span((*path, "period")), headline, help="a sensor is read in whole timesteps")
    elif ticks > MOST_TICKS:
        values.findings.add("DB105", values.span((*path, "period")), f"a period of {ticks:_} timesteps", help="give a shorter one")
    return replace(faults or NoiseModel(), period=ticks) if ticks > 1 else faults
