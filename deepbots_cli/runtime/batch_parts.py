"""The parts of a batch over those of its single worlds: calls, channels, controllers, and sensors.

A device copies the state of that of the single world, which gave the first reading of the episode, and draws
its noise from the same stream in the same blocks. A kind whose reader computes with columns as with numbers
is read at once, any other world by world.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple, cast

import gymnasium as gym
import numpy as np

from deepbots_cli.arrays import larger, smaller
from deepbots_cli.plugins import import_attribute
from deepbots_cli.port import BatchEngine, Engine
from deepbots_cli.program import generated
from deepbots_cli.program.robots import Direction, NoiseModel, Sensor
from deepbots_cli.program.task import Agent
from deepbots_cli.runtime.actuation import RobotController
from deepbots_cli.runtime.columns import BatchMemory, stacked, where_running
from deepbots_cli.runtime.messages import LossyChannel
from deepbots_cli.runtime.readers import ON_COLUMNS, projected_gravity
from deepbots_cli.runtime.sensing import ROWS_PER_BLOCK, Device, Lookup, Normals, Site
from deepbots_cli.runtime.spaces import Column, mask_of_space

if TYPE_CHECKING:
    from deepbots_cli.runtime.batch import BatchSupervisor


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


class PerWorldCall:
    """Calls the single worlds in turn: functions that take and give single numbers, over columns."""

    def __init__(self, functions: Sequence[Callable[..., Any]], engine: BatchEngine) -> None:
        self._functions = functions
        self._engine = engine

    def __call__(self, *arguments: Any) -> Any:
        if not arguments:
            return stack_worlds([function() for function in self._functions])
        rows = zip(*(_rows(argument, len(self._functions)) for argument in arguments), strict=True)
        mask = self._engine.write_mask
        by_world = [
            function(*row) if mask is None or mask[world] else None
            for world, (function, row) in enumerate(zip(self._functions, rows, strict=True))
        ]
        return None if by_world[0] is None else stack_worlds(by_world)


def _rows(argument: Any, count: int) -> list[Any]:
    """Return a column, or a vector of columns, as one number or list per world."""
    if isinstance(argument, np.ndarray):
        return list(argument.T.tolist())
    if isinstance(argument, (tuple, list)):
        return list(stacked(argument, count).T.tolist())
    return [argument] * count


class BatchChannel:
    """A channel that delivers each message in the timestep in which it was sent; all formats carry numbers
    exactly."""

    def __init__(self) -> None:
        self._message: Any = ()

    def send(self, message: Any) -> None:
        self._message = message

    def receive(self) -> Any:
        return self._message


class BatchLossyChannel:
    """A channel on which messages come late or are lost: the channels of the single worlds, in turn."""

    def __init__(self, channels: Sequence[LossyChannel], batch: BatchSupervisor) -> None:
        self._channels = channels
        self._batch = batch

    @property
    def age(self) -> Column:
        return np.array([channel.age for channel in self._channels])

    @property
    def message_received(self) -> Column:
        return np.array([channel.message_received for channel in self._channels])

    def send(self, message: Any) -> None:
        count = len(self._channels)
        messages = (
            zip(*(_rows(field, count) for field in message), strict=True) if message else iter([()] * count)
        )
        running = self._batch.running
        for world, (channel, world_message) in enumerate(zip(self._channels, messages, strict=True)):
            if running is None or running[world]:
                channel.send(world_message)

    def newest(self) -> Any:
        return [
            stack_worlds(values)
            for values in zip(*(channel.newest() for channel in self._channels), strict=True)
        ]

    def receive(self) -> Iterator[Any]:
        """Yield the first message of each world that got one, then the second; meanwhile motors of the others
        are left alone."""
        arrived = [channel.receive() for channel in self._channels]
        for number in range(max(map(len, arrived))):
            having = np.array([len(messages) > number for messages in arrived])
            # Worlds without a message get that of another world; the mask leaves their motors out.
            usual = arrived[int(having.argmax())][number]
            messages = [messages[number] if len(messages) > number else usual for messages in arrived]
            self._batch.engine.write_mask = having
            yield [stack_worlds(values) for values in zip(*messages, strict=True)]
        self._batch.engine.write_mask = None


class BatchPart:
    """Base of supervisor and controllers, which copy the state of the single worlds when an episode
    begins."""

    STATE: tuple[str, ...] = ()
    """The attributes whose columns begin with the values of the single worlds: drawn values, and values that
    the next step reads."""

    def __init__(self, singles: Sequence[Any], batch: BatchSupervisor) -> None:
        self._singles = singles
        self._batch = batch
        self._loaded: list[BatchMemory | BatchDevice] = []

    def each(self, attribute: str) -> PerWorldCall:
        """Return a call of the attribute of this name of each single world."""
        return PerWorldCall([getattr(single, attribute) for single in self._singles], self._batch.engine)

    def memory(self, attribute: str) -> BatchMemory:
        """Return the memory of a stateful function."""
        memory = BatchMemory(
            [getattr(single, attribute) for single in self._singles], lambda: self._batch.engine.write_mask
        )
        self._loaded.append(memory)
        return memory

    def take_over(self, worlds: Sequence[int]) -> None:
        """Copy the state with which the single worlds began."""
        for part in self._loaded:
            for world in worlds:
                part.load(world)
        self.take_columns(worlds, self.STATE)

    def take_columns(self, worlds: Sequence[int], names: Sequence[str]) -> None:
        count = len(self._singles)
        for name in names:
            values = np.array([getattr(self._singles[world], name) for world in worlds]).T
            is_new = len(worlds) == count or not hasattr(self, name)
            column = (
                np.zeros((*values.shape[:-1], count), values.dtype)
                if is_new
                else columns_array(getattr(self, name), count)
            )
            column[..., worlds] = values
            setattr(self, name, column)


def columns_array(value: Any, count: int) -> Column:
    """Return a column or a vector of columns as an array that can be written."""
    if isinstance(value, (tuple, list)):
        return stacked(value, count)
    return np.array(np.broadcast_to(value, (*np.shape(value)[:-1], count)))


class BatchController(BatchPart):
    """Base of the generated controllers of robots."""

    def __init__(self, singles: Sequence[RobotController], batch: BatchSupervisor) -> None:
        super().__init__(singles, batch)
        self.devices: dict[str, BatchDevice] = {}
        self.bind(batch.engine)

    def bind(self, engine: BatchEngine) -> None:
        """Take readers and writers from the engine."""

    def device(self, name: str) -> BatchDevice:
        """Return the devices behind a sensor."""
        sensor: Sensor = next(sensor for sensor in self._singles[0].spec.sensors if sensor.name == name)
        device = BatchDevice(
            [single.devices[name] for single in self._singles],
            sensor,
            self._singles[0].spec.name,
            self._batch,
        )
        self._loaded.append(device)
        self.devices[name] = device
        return device

    def observe(self) -> None:
        """Sample the sensors that are sampled once per tick."""


class StuckRow(NamedTuple):
    """A row in which every option of a choice is forbidden."""

    row: int
    choice: str


class OptionMasks:
    """The options of each choice that may be chosen next: truth values (option, row)."""

    def __init__(self, agent: Agent, count: int) -> None:
        self._masks = {part.name: np.ones((len(part.options), count), bool) for part in agent.choices}

    def allow(self, choice: str, allowed: Sequence[Any], running: Column | None) -> None:
        """Let some options of a choice be allowed next in the `running` rows: a column for each option."""
        for row, may in zip(self._masks[choice], allowed, strict=True):
            row[:] = where_running(running, may, row)

    def load(self, row: int, allowed: Sequence[Sequence[bool]]) -> None:
        """Allow the options that a single supervisor allows."""
        for mask, may in zip(self._masks.values(), allowed, strict=True):
            mask[:, row] = may

    def without_option(self, going_on: Column) -> StuckRow | None:
        """Return the first row that goes on although every option of a choice is forbidden."""
        for choice, mask in self._masks.items():
            stuck = going_on & ~mask.any(axis=0)
            if stuck.any():
                return StuckRow(int(stuck.argmax()), choice)
        return None

    def of_agent(self, agent: Agent, names: Mapping[str, str]) -> OptionMasks:
        """Return the masks of one of several agents, whose choices have other `names` here; a view."""
        masks = OptionMasks(agent, 0)
        masks._masks = {part.name: self._masks[names[part.name]] for part in agent.choices}
        return masks

    def by_row(self) -> Column:
        """Return the options of all choices in a row per agent; a copy."""
        return np.concatenate(list(self._masks.values())).T.copy()

    def of_space(self, space: gym.Space[Any], rows: Any = slice(None)) -> Any:
        """Return the masks of some rows in the form that `sample` of an action space takes."""
        return mask_of_space(space, [mask.T[rows].astype(np.int8) for mask in self._masks.values()])


class BatchRobots(BatchPart, ABC):
    """The robots of a batch, which `bind` makes: their controllers, and the paths of messages."""

    def __init__(self, singles: Sequence[Any], batch: BatchSupervisor) -> None:
        super().__init__(singles, batch)
        self.controllers: dict[str, BatchController] = {}
        self.channels: dict[tuple[str, str], BatchChannel | BatchLossyChannel] = {}

    @abstractmethod
    def bind(self, engine: BatchEngine) -> None:
        """Take readers from the engine."""

    def robot(self, name: str, controller: type[BatchController]) -> Any:
        """Return the controllers of a robot."""
        robot = self.controllers[name] = controller(
            [single.controllers[name] for single in self._singles], self._batch
        )
        return robot

    def channel(self, name: str, direction: Direction) -> BatchChannel:
        """Return the paths of messages to or from a robot, if they are direct."""
        channel = self.channels[name, direction] = BatchChannel()
        return channel

    def lossy_channel(self, name: str, direction: Direction) -> BatchLossyChannel:
        """Return the paths of messages to or from a robot, where messages come late or may be lost."""
        attribute = generated.channel(name, direction)
        channel = self.channels[name, direction] = BatchLossyChannel(
            [getattr(single, attribute) for single in self._singles], self._batch
        )
        return channel

    def link(self, sender: str, receiver: str) -> BatchLossyChannel:
        """Return the paths of messages from one robot to another."""
        attribute = generated.link(sender, receiver)
        return BatchLossyChannel([getattr(single, attribute) for single in self._singles], self._batch)
