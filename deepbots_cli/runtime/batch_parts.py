"""The parts of a batch over those of its single worlds: calls, channels, controllers."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import gymnasium as gym
import numpy as np

from deepbots_cli.port import BatchEngine
from deepbots_cli.program import generated
from deepbots_cli.program.robots import Direction, Sensor
from deepbots_cli.program.task import Agent
from deepbots_cli.runtime.columns import BatchMemory, stacked, where_running
from deepbots_cli.runtime.controllers import RobotController
from deepbots_cli.runtime.devices import BatchDevice, stack_worlds
from deepbots_cli.runtime.messages import LossyChannel
from deepbots_cli.runtime.spaces import Column, mask_of_space

if TYPE_CHECKING:
    from deepbots_cli.runtime.batch import BatchSupervisor


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
