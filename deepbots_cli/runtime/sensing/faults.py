"""How figures err: a chain from what is to what a sensor says of it.

    value -> x (1 + relative bias + relative noise) + bias + drift t + noise -> range -> steps

Noise is normal. It is drawn in blocks, since a call of the generator costs more than 50 figures of it.
"""

from __future__ import annotations

from collections.abc import Sequence
from operator import add
from typing import Any

from deepbots_cli.program.robots import NoiseModel

Figures = Sequence[float]
_ROWS = 128


class Normals:
    """Rows of `width` figures of the standard normal distribution, all out of one generator."""

    def __init__(self, width: int) -> None:
        self._width = width
        self._scale: Figures | float = 1.0
        self._drawn: Any = None
        self._rows: list[list[float]] = []
        self._generator: Any = None

    def restart(self, generator: Any) -> None:
        """Draw from `generator` from here on; what was drawn before is forgotten."""
        self._generator = generator
        self._rows = []

    def scale(self, deviations: Figures | float) -> None:
        """Multiply the figures of all further rows, one by one or all alike; a block at once costs a tenth of row by row."""
        self._scale = deviations
        if self._rows:
            self._rows = (self._drawn[: len(self._rows)] * deviations).tolist()

    def row(self) -> list[float]:
        if not self._rows:
            self._drawn = self._generator.standard_normal((_ROWS, self._width))
            self._rows = (self._drawn * self._scale).tolist()
        return self._rows.pop()


class Chain:
    """The faults of one sensor of `width` figures."""

    def __init__(self, spec: NoiseModel, width: int) -> None:
        self._spec = spec
        self._normals = Normals(width)
        self._zeros = (0.0,) * width
        self._figures: dict[str, Figures] = {
            "noise": spec.noise,
            "relative_noise": spec.relative_noise,
            "bias": spec.bias,
            "relative_bias": spec.relative_bias,
            "drift": spec.drift,
        }
        self._settle()

    def vary(self, figure: str, values: Figures) -> None:
        """Give this episode's figures of a fault, one per component."""
        if figure not in self._figures or len(values) != len(self._zeros):
            raise KeyError(figure)
        self._figures[figure] = values
        self._settle()

    def _settle(self) -> None:
        figures = self._figures
        self._noise, self._share, self._drift = figures["noise"], figures["relative_noise"], figures["drift"]
        self._bias = figures["bias"] or (self._zeros if self._drift else ())
        self._gain = [1.0 + error for error in figures["relative_bias"]] or ([1.0] * len(self._zeros) if self._share else [])
        self._only_noise = bool(self._noise) and not (self._share or self._gain or self._bias)
        self._normals.scale(self._noise if self._only_noise else 1.0)

    def restart(self, generator: Any) -> None:
        """Begin an episode, whose noise comes from `generator`."""
        self._normals.restart(generator)

    def __call__(self, values: Figures, time: float) -> Figures:
        """What the sensor says of `values`, `time` s after the reset."""
        values = self._with_noise(values) if self._only_noise else self._with_all(values, time)
        spec = self._spec
        if spec.low:
            ends = zip(values, spec.low, spec.high, strict=True)
            values = [low if x < low else high if x > high else x for x, low, high in ends]
        if spec.quantise:
            values = [step * round(x / step) for x, step in zip(values, spec.quantise, strict=True)]
        return values

    def _with_noise(self, values: Figures) -> Figures:
        """The usual case, in a third of the time."""
        return list(map(add, values, self._normals.row()))

    def _with_all(self, values: Figures, time: float) -> Figures:
        if self._share:
            rows = zip(values, self._gain, self._share, self._normals.row(), strict=True)
            values = [x * (gain + share * normal) for x, gain, share, normal in rows]
        elif self._gain:
            values = [x * gain for x, gain in zip(values, self._gain, strict=True)]
        bias = self._bias
        if self._drift:
            bias = [b + drift * time for b, drift in zip(bias, self._drift, strict=True)]
        if self._noise:
            rows = zip(values, bias or self._zeros, self._noise, self._normals.row(), strict=True)
            values = [x + b + noise * normal for x, b, noise, normal in rows]
        elif bias:
            values = [x + b for x, b in zip(values, bias, strict=True)]
        return values
