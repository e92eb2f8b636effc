"""A sensor: when it samples, which faults its readings have, and when a reading is delivered.

The faults are a chain from the true value to the reading:

    value -> x (1 + relative bias + relative noise) + bias + drift t + noise -> range -> steps

Noise is normal. It is drawn in blocks, since a call of the generator costs more than 50 numbers of it.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from operator import add
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from deepbots_cli import frames
from deepbots_cli.frames import Frame
from deepbots_cli.plugins import import_attribute
from deepbots_cli.port import Engine
from deepbots_cli.program.robots import NoiseModel, Sensor
from deepbots_cli.program.world import WorldModel, whole_timesteps
from deepbots_cli.runtime.formulas import clamp
from deepbots_cli.runtime.streams import Streams

Values = Sequence[float]
ROWS_PER_BLOCK = 128
"""The number of rows of normal numbers that are drawn at once."""
Reading = Sequence[Any]
"""One number, truth value or picture per component; a single one for a sensor without components."""


class Normals:
    """Rows of `width` samples of the standard normal distribution, all from one generator."""

    def __init__(self, width: int) -> None:
        self._width = width
        self._scale: Values | float = 1.0
        self.drawn: Any = None
        """The newest block, before it is scaled."""
        self._rows: list[list[float]] = []
        self.rows_left = 0
        """The number of rows of the newest block that were not taken yet; they are taken from its end."""
        self._generator: Any = None

    def restart(self, generator: Any) -> None:
        """Draw from `generator` from now on, and discard samples that were drawn before."""
        self._generator = generator
        self._rows = []
        self.rows_left = 0

    def scale(self, deviations: Values | float) -> None:
        """Multiply all further rows by one factor, or by one factor per sample. A block at once costs a tenth
        of row by row."""
        self._scale = deviations
        self._rows = []

    def next_row(self) -> list[float]:
        if not self._rows:
            if not self.rows_left:
                self.drawn = self.block()
                self.rows_left = ROWS_PER_BLOCK
                # A batch takes only the first row of an episode here.
                self._rows = (self.drawn[-1:] * self._scale).tolist()
            else:
                self._rows = (self.drawn[: self.rows_left] * self._scale).tolist()
        self.rows_left -= 1
        return self._rows.pop()

    def block(self) -> NDArray[np.float64]:
        """Draw the next block."""
        block: NDArray[np.float64] = self._generator.standard_normal((ROWS_PER_BLOCK, self._width))
        return block


class SensorErrors:
    """The faults of one sensor with `width` values."""

    def __init__(self, spec: NoiseModel, width: int) -> None:
        self.spec = spec
        self.normals = Normals(width)
        self._zeros = (0.0,) * width
        faults = ("noise", "relative_noise", "bias", "relative_bias", "drift")
        self._parameters: dict[str, Values] = {name: getattr(spec, name) for name in faults}
        self._settle()

    def vary(self, fault: str, values: Values) -> None:
        """Set the values of a fault for this episode, one per component."""
        if fault not in self._parameters or len(values) != len(self._zeros):
            raise KeyError(fault)
        self._parameters[fault] = values
        self._settle()

    def _settle(self) -> None:
        parameters = self._parameters
        self._noise = parameters["noise"]
        self._share = parameters["relative_noise"]
        self._drift = parameters["drift"]
        self._bias = parameters["bias"] or (self._zeros if self._drift else ())
        self._gain = [1.0 + error for error in parameters["relative_bias"]] or (
            [1.0] * len(self._zeros) if self._share else []
        )
        self._only_noise = bool(self._noise) and not (self._share or self._gain or self._bias)
        self.normals.scale(self._noise if self._only_noise else 1.0)

    @property
    def parameters(self) -> dict[str, Values]:
        """The values of the faults in this episode, one number per component; empty for a fault that the
        sensor does not have."""
        return {
            "noise": self._noise,
            "share": self._share,
            "gain": self._gain,
            "bias": self._bias,
            "drift": self._drift,
        }

    def restart(self, generator: Any) -> None:
        """Begin an episode. Its noise is drawn from `generator`."""
        self.normals.restart(generator)

    def __call__(self, values: Values, time: float) -> Values:
        """Return the readings for the true `values`, `time` s after the reset."""
        values = self._with_noise(values) if self._only_noise else self._with_all(values, time)
        spec = self.spec
        if spec.low:
            values = list(map(clamp, values, spec.low, spec.high))
        if spec.resolution:
            values = [step * round(x / step) for x, step in zip(values, spec.resolution, strict=True)]
        return values

    def _with_noise(self, values: Values) -> Values:
        """Return the readings in the usual case, in a third of the time."""
        return list(map(add, values, self.normals.next_row()))

    def _with_all(self, values: Values, time: float) -> Values:
        if self._share:
            rows = zip(values, self._gain, self._share, self.normals.next_row(), strict=True)
            values = [x * (gain + share * normal) for x, gain, share, normal in rows]
        elif self._gain:
            values = [x * gain for x, gain in zip(values, self._gain, strict=True)]
        bias = self._bias
        if self._drift:
            bias = [b + drift * time for b, drift in zip(bias, self._drift, strict=True)]
        if self._noise:
            rows = zip(values, bias or self._zeros, self._noise, self.normals.next_row(), strict=True)
            values = [x + b + noise * normal for x, b, noise, normal in rows]
        elif bias:
            values = [x + b for x, b in zip(values, bias, strict=True)]
        return values


def _nothing(_generator: Any = None) -> None:
    """Do nothing. This is the default at a reset and between two readings."""


class Lookup(Protocol):
    """A table between the values that an instrument reads and its readings; see `readers.LookupTable`."""

    @property
    def rows(self) -> Sequence[tuple[float, float, float, float, float]]:
        """The start of each interval: distance, value, noise, and by how much value and noise grow; the first
        lies before the table."""

    @property
    def normals(self) -> Normals | None:
        """The noise, if the table has any."""

    def __call__(self, values: Values, /) -> Values:
        """Return the readings."""


class Instrument(NamedTuple):
    """The measuring part of a sensor: `read` gives the true values at this moment, `restart` begins an
    episode with a random generator.

    `update` is called in the ticks without a reading. `lookup` turns the value read into a reading, with
    noise of its own.
    """

    read: Callable[[], Reading]
    restart: Callable[[Any], None] = _nothing
    update: Callable[[], None] = _nothing
    lookup: Lookup | None = None


class Site(NamedTuple):
    """A sensor in a world, from which its kind's `reader` makes an instrument. `mount` is its frame in its
    link."""

    engine: Engine
    robot: str
    sensor: Sensor
    world: WorldModel

    @property
    def link(self) -> str:
        """The link or joint on which the sensor is mounted, or the first of them."""
        return self.sensor.subjects[0]

    @property
    def mount(self) -> Frame:
        return frames.frame(self.sensor.mount)

    @property
    def parameters(self) -> dict[str, Any]:
        """The parameters that only this kind has, in SI units."""
        return dict(self.sensor.parameters)


def instrument(sensor: Sensor, robot: str, world: WorldModel, engine: Engine) -> Instrument:
    """Return the instrument of a sensor, whose readers are taken from `engine`.

    Raises:
        EngineError: The robot has no such joint or link, or the engine cannot sense so.
    """
    reader: Instrument = import_attribute(sensor.reader)(Site(engine, robot, sensor, world))
    return reader


class Device:
    """Called once per timestep. `reading` is the newest that was delivered, `sampled_at` the timestep at
    which it was taken."""

    reading: Reading
    sampled_at: int

    def __init__(self, sensor: Sensor, robot: str, instrument: Instrument, timestep: float) -> None:
        faults = sensor.faults or NoiseModel()
        self._sensor = sensor
        self.instrument = instrument
        self._lookup = instrument.lookup
        self._timestep = timestep
        self._stream = f"robots.{robot}.sensors.{sensor.name}"
        self._period = faults.period
        self._latency = faults.latency
        parameters = (
            faults.noise,
            faults.relative_noise,
            faults.bias,
            faults.relative_bias,
            faults.drift,
            faults.low,
            faults.resolution,
        )
        self.chain: SensorErrors | None = None
        if any(parameters):
            self.chain = SensorErrors(faults, max(1, len(sensor.components)))
        self._under_way: deque[tuple[int, int, Reading]] = deque()
        self._followed: Callable[[], Reading] | None = None

    def vary(self, fault: str, values: Sequence[float]) -> None:
        """Set the values of a fault (a field of `NoiseModel`) for this episode, one per component, or the
        latency in s."""
        if fault == "latency":
            (self._latency,) = values
        elif self.chain is not None:
            self.chain.vary(fault, values)

    def follow(self, read: Callable[[], Reading]) -> None:
        """Take each reading from `read`, as it is and in every timestep, instead of from the world."""
        self._followed = read

    def reset(self, streams: Streams) -> None:
        """Begin an episode: a first reading is taken and delivered at once."""
        self._tick = self.sampled_at = 0
        self.delay = whole_timesteps(max(0.0, self._latency), self._timestep)
        self._under_way.clear()
        # A stream of its own, so that the noise of a lookup table does not change that of the faults.
        self.instrument.restart(streams[f"{self._stream}.lookup"])
        if self.chain is not None:
            self.chain.restart(streams[self._stream])
        self.reading = self._sampled()

    @property
    def age(self) -> float:
        """The age of the reading, in s."""
        return (self._tick - self.sampled_at) * self._timestep

    def __call__(self) -> None:
        self._tick = tick = self._tick + 1
        if self._followed is not None:
            self.reading = self._followed()
            self.sampled_at = tick
        elif self._period == 1 or tick % self._period == 0:
            reading = self._sampled()
            if not self.delay:
                self.reading = reading
                self.sampled_at = tick
                return
            self._under_way.append((tick + self.delay, tick, reading))
        else:
            self.instrument.update()
        while self._under_way and self._under_way[0][0] <= tick:
            _, self.sampled_at, self.reading = self._under_way.popleft()

    def _sampled(self) -> Reading:
        if self._followed is not None:
            return self._followed()
        values = self.instrument.read()
        if self._lookup is not None:
            values = self._lookup(values)
        return values if self.chain is None else self.chain(values, self._tick * self._timestep)
