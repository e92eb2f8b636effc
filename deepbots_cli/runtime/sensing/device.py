"""One sensor of a robot: when it samples, how it errs, and when a reading is delivered."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

from deepbots_cli import frames
from deepbots_cli.frames import Frame
from deepbots_cli.plugins import attribute
from deepbots_cli.port import Engine
from deepbots_cli.program.robots import NoiseModel, Sensor
from deepbots_cli.program.world import WorldModel
from deepbots_cli.runtime.sensing.faults import Chain
from deepbots_cli.runtime.streams import Streams

Reading = Sequence[Any]
"""One figure, truth value or picture per component; a single one for a sensor without components."""


def _nothing(_generator: Any = None) -> None:
    """What most instruments do at a reset, and between two readings."""


class Instrument(NamedTuple):
    """What a sensor measures: `read` gives the true values at this moment, `restart` begins an episode with a random generator.

    `follow` is called in the ticks without a reading.
    """

    read: Callable[[], Reading]
    restart: Callable[[Any], None] = _nothing
    follow: Callable[[], None] = _nothing


class Site(NamedTuple):
    """A sensor in a world: what its kind's `reader` makes an instrument from. `mount` is its frame in its link."""

    engine: Engine
    robot: str
    sensor: Sensor
    world: WorldModel

    @property
    def link(self) -> str:
        """The link or joint that it sits on, or the first of them."""
        return self.sensor.subjects[0]

    @property
    def mount(self) -> Frame:
        return frames.frame(self.sensor.mount)

    @property
    def parameters(self) -> dict[str, Any]:
        """The parameters that the kind has of its own, in SI units."""
        return dict(self.sensor.parameters)


def instrument(sensor: Sensor, robot: str, world: WorldModel, engine: Engine) -> Instrument:
    """The instrument of a sensor, whose readers are taken from `engine`.

    Raises:
        EngineError: The robot has no such joint or link, or the engine cannot sense so.
    """
    made: Instrument = attribute(sensor.reader)(Site(engine, robot, sensor, world))
    return made


class Device:
    """Called once per tick. `reading` is the newest that was delivered, `measured` the tick at which it was taken."""

    reading: Reading
    measured: int

    def __init__(self, sensor: Sensor, robot: str, instrument: Instrument, timestep: float) -> None:
        faults = sensor.faults or NoiseModel()
        self._sensor = sensor
        self._instrument = instrument
        self._timestep = timestep
        self._stream = f"robots.{robot}.sensors.{sensor.name}"
        self._period = faults.period
        self._latency = faults.latency
        figures = (faults.noise, faults.relative_noise, faults.bias, faults.relative_bias, faults.drift, faults.low, faults.quantise)
        self._chain = Chain(faults, max(1, len(sensor.components))) if any(figures) else None
        self._under_way: deque[tuple[int, int, Reading]] = deque()

    def vary(self, figure: str, values: Sequence[float]) -> None:
        """Give this episode's figures of a fault (a field of `NoiseModel`), one per component, or the latency in s."""
        if figure == "latency":
            (self._latency,) = values
        elif self._chain is not None:
            self._chain.vary(figure, values)

    def reset(self, streams: Streams) -> None:
        """Begin an episode: a first reading is taken and delivered at once."""
        self._tick = self.measured = 0
        self._delay = math.ceil(max(0.0, self._latency) / self._timestep - 1e-9)
        self._under_way.clear()
        self._instrument.restart(streams[f"{self._stream}.lookup"])
        if self._chain is not None:
            self._chain.restart(streams[self._stream])
        self.reading = self._sampled()

    @property
    def age(self) -> float:
        """How old the reading is, in s."""
        return (self._tick - self.measured) * self._timestep

    def __call__(self) -> None:
        self._tick = tick = self._tick + 1
        if self._period == 1 or tick % self._period == 0:
            reading = self._sampled()
            if not self._delay:
                self.reading, self.measured = reading, tick
                return
            self._under_way.append((tick + self._delay, tick, reading))
        else:
            self._instrument.follow()
        while self._under_way and self._under_way[0][0] <= tick:
            _, self.measured, self.reading = self._under_way.popleft()

    def _sampled(self) -> Reading:
        values = self._instrument.read()
        return values if self._chain is None else self._chain(values, self._tick * self._timestep)
