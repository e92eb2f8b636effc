"""The sensors of a batch: the same device in all worlds, with its faults and delays, over columns; see
`sensing`.

A device copies the state of that of the single world, which gave the first reading of the episode, and draws
its noise from the same stream in the same blocks. A kind whose reader computes with columns as with numbers
is read at once, any other world by world.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, cast

import numpy as np
from numpy.typing import NDArray

from deepbots_cli.arrays import larger, smaller
from deepbots_cli.plugins import import_attribute
from deepbots_cli.program.robots import NoiseModel, Sensor
from deepbots_cli.runtime.readers import ON_COLUMNS, projected_gravity
from deepbots_cli.runtime.sensing import ROWS_PER_BLOCK, Device, Lookup, Normals, Site

if TYPE_CHECKING:
    from deepbots_cli.port import Engine
    from deepbots_cli.runtime.batch import BatchSupervisor

Column = NDArray[Any]


def stack_worlds(values: Sequence[Any]) -> Any:
    """Return one value per world as a column; vectors, and pairs of them, as a column per number."""
    first = values[0]
    if isinstance(first, (tuple, list)) and first and isinstance(first[0], (tuple, list)):
        return tuple(stack_worlds(part) for part in zip(*values, strict=True))
    return np.array(values).T


class BatchNormals:
    """The normal numbers of one sensor in all worlds, in the order in which the single worlds would take
    them."""

    def __init__(self, singles: Sequence[Normals], width: int) -> None:
        self._singles = singles
        self._blocks = np.zeros((len(singles), ROWS_PER_BLOCK, width))
        self._left = np.zeros(len(singles), np.intp)
        self._every = np.arange(len(singles))

    def load(self, world: int) -> None:
        normals = self._singles[world]
        self._left[world] = normals.rows_left
        if normals.rows_left:
            self._blocks[world] = normals.drawn

    def row(self, mask: Column | None) -> Column:
        """Return a row per component; worlds outside `mask` keep theirs."""
        left = self._left
        empty = left == 0 if mask is None else (left == 0) & mask
        for world in np.flatnonzero(empty).tolist():
            self._blocks[world] = self._singles[world].block()
            left[world] = ROWS_PER_BLOCK
        block = self._blocks[self._every, left - 1]
        self._left = left - 1 if mask is None else left - mask
        return block.T


class BatchSensorErrors:
    """The faults of one sensor; see `sensing.SensorErrors`."""

    def __init__(self, devices: Sequence[Device], width: int) -> None:
        self._chains = [device.chain for device in devices if device.chain is not None]
        self._parameters = {
            name: np.zeros((width, len(devices))) for name in ("noise", "share", "gain", "bias", "drift")
        }
        self._has: dict[str, bool] = {}
        spec = self._chains[0].spec
        self._noise = BatchNormals([chain.normals for chain in self._chains], width)
        self._ends = tuple(np.array(ends)[:, None] for ends in (spec.low, spec.high)) if spec.low else None
        self._steps = np.array(spec.resolution)[:, None] if spec.resolution else None

    def load(self, world: int) -> None:
        parameters = self._chains[world].parameters
        self._has = {name: bool(values) for name, values in parameters.items()}
        for name, values in parameters.items():
            if values:
                self._parameters[name][:, world] = values
        self._noise.load(world)

    def __call__(self, values: Column, time: Column, sampled: Column | None) -> Column:
        has, parameters = self._has, self._parameters
        if has["share"]:
            values = values * (parameters["gain"] + parameters["share"] * self._noise.row(sampled))
        elif has["gain"]:
            values = values * parameters["gain"]
        bias = parameters["bias"] + parameters["drift"] * time if has["drift"] else parameters["bias"]
        if has["noise"]:
            values = values + bias if has["bias"] else values
            values = values + parameters["noise"] * self._noise.row(sampled)
        elif has["bias"]:
            values = values + bias
        if self._ends is not None:
            values = smaller(larger(values, self._ends[0]), self._ends[1])
        if self._steps is not None:
            values = self._steps * (np.rint(values / self._steps) + 0.0)  # `round` has no -0.0
        return values


class BatchLookupTable:
    """The lookup table of one sensor, with the noise of each world; see `readers.LookupTable`."""

    def __init__(self, tables: Sequence[Lookup], width: int) -> None:
        self._rows = np.array(tables[0].rows)
        normals = [table.normals for table in tables if table.normals is not None]
        self._noise = BatchNormals(normals, width) if normals else None

    def load(self, world: int) -> None:
        if self._noise is not None:
            self._noise.load(world)

    def __call__(self, values: Column, sampled: Column | None) -> Column:
        distances = self._rows[1:, 0]
        start, value, noise, slope, growth = np.moveaxis(
            self._rows[np.searchsorted(distances, values, side="right")], -1, 0
        )
        along = values - start
        readings: Column = value + slope * along
        return (
            readings
            if self._noise is None
            else readings * (1.0 + (noise + growth * along) * self._noise.row(sampled))
        )


class BatchDevice:
    """The same device in all worlds, called once per tick; `reading` is the newest that was delivered, a row
    per component."""

    def __init__(self, devices: Sequence[Device], sensor: Sensor, robot: str, batch: BatchSupervisor) -> None:
        self._devices = devices
        self._batch = batch
        count = len(devices)
        self._width = max(1, len(sensor.components))
        faults = sensor.faults or NoiseModel()
        self._period = faults.period
        self._timestep = batch.scenario.world.timestep
        self._faults = BatchSensorErrors(devices, self._width) if devices[0].chain is not None else None
        tables = [device.instrument.lookup for device in devices if device.instrument.lookup is not None]
        self._lookups = BatchLookupTable(tables, self._width) if tables else None
        self.reading: Any = np.zeros((self._width, count))
        self._tick, self._delay, self.measured_tick = (np.zeros(count, np.intp) for _ in range(3))
        self._ring: list[Any] = []
        reader = import_attribute(sensor.reader)
        self._read: Callable[[], Any] | None = None
        # Where gravity varies, each world has its own, and the engine of the batch a single one.
        varies = reader is projected_gravity and any(
            variation.what == "gravity" for variation in batch.scenario.reset.variations
        )
        joins = sensor.beams is not None and sensor.beams.combined not in (None, "each")
        if reader in ON_COLUMNS and not (varies or joins):
            instrument = reader(Site(cast("Engine", batch.engine), robot, sensor, batch.scenario.world))
            if instrument.lookup is None:
                instrument.restart(None)
            self._read = instrument.read

    def load(self, world: int) -> None:
        device = self._devices[world]
        reading = np.asarray(device.reading)
        if reading.dtype == bool and self.reading.dtype != bool:
            self.reading = self.reading.astype(bool)
        if not self.reading.flags.writeable:
            self.reading = self.reading.copy()
        self.reading[:, world] = reading
        self._tick[world] = 0
        self.measured_tick[world] = 0
        self._delay[world] = device.delay
        for part in (self._faults, self._lookups):
            if part is not None:
                part.load(world)

    @property
    def age(self) -> Column:
        return (self._tick - self.measured_tick) * self._timestep

    def __call__(self) -> None:
        running = self._batch.running
        self._tick = self._tick + 1 if running is None else self._tick + running
        sampled = None if self._period == 1 else self._tick % self._period == 0
        if running is not None:
            sampled = running if sampled is None else sampled & running
        delayed = bool(self._delay.any())
        if sampled is None and not delayed:
            self.reading = self._sampled(None)
            self.measured_tick = self._tick.copy()
            return
        values = self._sampled(sampled)
        if not delayed:
            mask = np.ones(self._tick.shape, bool) if sampled is None else sampled
            self.reading, self.measured_tick = (
                np.where(mask, values, self.reading),
                np.where(mask, self._tick, self.measured_tick),
            )
            return
        self._deliver(values, running)

    def _deliver(self, values: Any, running: Column | None) -> None:
        """Give each world the reading that is as old as its delay; before the first one, that of the
        reset."""
        if running is not None and self._ring:
            values = np.where(running, values, self._ring[0])
        self._ring = [values, *self._ring[: int(self._delay.max())]]
        taken_at = self._tick - self._delay
        due = (taken_at >= 1) & (taken_at % self._period == 0) & (True if running is None else running)
        for delay in np.unique(self._delay[due]).tolist():
            now = due & (self._delay == delay)
            self.reading = np.where(now, self._ring[delay], self.reading)
            self.measured_tick = np.where(now, taken_at, self.measured_tick)

    def _sampled(self, sampled: Column | None) -> Column:
        if self._read is not None:
            columns = self._read()
            values = np.empty((len(columns), len(self._devices)), np.asarray(columns[0]).dtype)
            for row, column in zip(values, columns, strict=True):
                row[:] = column
        else:
            values = np.stack([self._single(world, sampled) for world in range(len(self._devices))], axis=1)
        if self._lookups is not None:
            values = self._lookups(values, sampled)
        return values if self._faults is None else self._faults(values, self._tick * self._timestep, sampled)

    def _single(self, world: int, sampled: Column | None) -> Column:
        """Return the reading of the instrument of one world; without a reading, the instrument is only
        updated."""
        device = self._devices[world]
        if sampled is None or sampled[world]:
            return np.asarray(device.instrument.read())
        if self._batch.running is None or self._batch.running[world]:
            device.instrument.update()
        return np.zeros(self._width, self.reading.dtype)
