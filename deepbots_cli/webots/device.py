"""What all devices of the module `controller` share: their node, sampling, and lookup tables.

A sensor returns NaN until its first sampling period has passed.
"""

from __future__ import annotations

import sys
from abc import ABC, abstractmethod
from collections.abc import Sequence
from itertools import pairwise
from math import nan
from typing import TYPE_CHECKING, Any

from deepbots_cli.webots.nodes import boolean, number, parameters, text, vectors
from deepbots_cli.webots.unimplemented import missing_attribute

if TYPE_CHECKING:
    from deepbots_cli.frames import Frame, Triple
    from deepbots_cli.webots.scene import Device as Spec
    from deepbots_cli.webots.simulation import Simulation


class Device:
    """A device of a robot."""

    def __init__(self, simulation: Simulation, spec: Spec) -> None:
        self._simulation, self._spec = simulation, spec

    def __getattr__(self, name: str) -> Any:
        raise missing_attribute(type(self), name)

    def renew(self) -> None:
        """Read the fields of the node again, after a supervisor set one."""

    def getName(self) -> str:
        return self._spec.name

    def getModel(self) -> str:
        return text(self._spec.node, "model") if "model" in parameters(self._spec.node) else ""

    def _frame(self) -> Frame:
        return self._simulation.physics.frame(self._spec.body, self._spec.frame)

    def _warn(self, message: str) -> None:
        print(f"Warning: {self._spec.name}: {message}", file=sys.stderr)

    def _noise(self, deviation: float) -> float:
        # A device without noise draws nothing, so that it does not shift the draws of others.
        return self._simulation.random.gauss(0.0, deviation) if deviation else 0.0

    def _rounded(self, value: float) -> float:
        resolution = number(self._spec.node, "resolution")
        return round(value / resolution) * resolution if resolution > 0 else value


class Sensor(Device, ABC):
    """A device that measures once in each sampling period (ms)."""

    def __init__(self, simulation: Simulation, spec: Spec) -> None:
        super().__init__(simulation, spec)
        self.period = self.due = self._asked = 0

    def enable(self, samplingPeriod: int) -> None:
        if samplingPeriod <= 0:
            raise ValueError(f"enable() of '{self._spec.name}': the sampling period must be positive")
        self._asked = int(samplingPeriod)
        self._begin()
        self._simulation.enable(self, self._asked)

    def disable(self) -> None:
        self._asked = 0
        self._simulation.disable(self)

    def getSamplingPeriod(self) -> int:
        return self._asked

    def _begin(self) -> None:
        """Prepare the first measurement."""

    @abstractmethod
    def sample(self) -> None:
        """Measure."""

    def forget(self) -> None:
        """Discard the state from before a reset of the world."""


class ScalarSensor(Sensor):
    """A sensor of one number."""

    def __init__(self, simulation: Simulation, spec: Spec) -> None:
        super().__init__(simulation, spec)
        self._value = nan

    def getValue(self) -> float:
        return self._value


class HasLookupTable(Sensor):
    """A sensor with a lookup table: rows of a measurement, the response, and the share of noise in it."""

    def __init__(self, simulation: Simulation, spec: Spec) -> None:
        super().__init__(simulation, spec)
        self._table = vectors(spec.node, "lookupTable")

    def getLookupTable(self) -> list[float]:
        return [value for row in self._table for value in row]


class VectorSensor(HasLookupTable):
    """A sensor of three numbers, in its own frame; an axis that is switched off reads NaN."""

    def __init__(self, simulation: Simulation, spec: Spec) -> None:
        super().__init__(simulation, spec)
        self._values: Triple = (nan, nan, nan)
        self._axes = tuple(boolean(spec.node, f"{axis}Axis") for axis in "xyz")

    def getValues(self) -> list[float]:
        return list(self._values)

    @abstractmethod
    def _measure(self) -> Triple:
        """Return the three numbers of now."""

    def sample(self) -> None:
        x, y, z = (
            self._rounded(self._response(value)) if is_on else nan
            for value, is_on in zip(self._measure(), self._axes, strict=True)
        )
        self._values = x, y, z

    def _response(self, value: float) -> float:
        if not self._table:
            return value
        answer, share = look_up(self._table, value)
        return answer * (1.0 + self._noise(share))


def look_up(table: Sequence[Triple], value: float) -> tuple[float, float]:
    """Interpolate the response and its share of noise between the rows of a lookup table. Beyond the ends of
    the table, the nearest row applies."""
    if not table:
        return value, 0.0
    if value <= table[0][0]:
        return table[0][1], table[0][2]
    for (low, first, quiet), (high, last, loud) in pairwise(table):
        if value <= high:
            share = (value - low) / (high - low) if high > low else 1.0
            return first + share * (last - first), quiet + share * (loud - quiet)
    return table[-1][1], table[-1][2]
