"""Resolves the names in expression trees to tensors of the exported graph."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from deepbots_cli.errors import UsageError
from deepbots_cli.expressions.scalar import EngineRead, Name, Scalar
from deepbots_cli.insight.export.memories import StepMemories
from deepbots_cli.insight.export.readings import Reading, Readings
from deepbots_cli.insight.export.trees import Arithmetic, Item, TreePrinter, Value
from deepbots_cli.program import Program
from deepbots_cli.program.robots import Robot, Sensor
from deepbots_cli.program.task import action_names

_LATER = {
    **dict.fromkeys(("previous_reward", "episode_return"), "the reward"),
    **dict.fromkeys(("terminated", "truncated", "ended", "goal_reached"), "the end of an episode"),
}
"""The names that have a meaning in a training only."""


class ObservedNames:
    """The meaning of names while the policy observes.

    Attributes:
        readings: The inputs of the graph, in order of first use.
        printer: Prints trees of the supervisor.
        acted: The components of the action variables, and of the action as the agent gave it.
        definitions: The values that the program names.
    """

    def __init__(self, program: Program, math: Arithmetic, memories: StepMemories, timestep: float) -> None:
        """Create the names. `timestep` is the time between two calls of the graph, in s."""
        self.math, self.memories = math, memories
        self.readings: dict[str, Reading] = {}
        self.printer = TreePrinter(math, self, memories.per_timestep)
        components = {
            name: interval.components for interval in program.agent.ranges for name in interval.variables
        }
        variables = {
            name: components.get(name, ()) for part in program.agent.action for name in part.variables
        }
        self.acted: dict[str, Sequence[str]] = {
            **variables,
            "previous_action": action_names(program.agent.action),
        }
        self._program = program
        self._describe = Readings(program, timestep)
        self.definitions = self._describe.deployment.definitions
        self._heard = {
            f"{link.receiver}.{value.name}": (link, value) for link in program.links for value in link.values
        }
        self._whole: dict[str, Value] = {}
        self._on_board = {
            robot.name: TreePrinter(math, OnBoard(self, robot), memories.per_timestep)
            for robot in program.robots
        }

    def input(self, reading: Reading) -> Value:
        """Return the tensor of an input, which is created when it is first read."""
        info = reading.info
        if info.name not in self.readings:
            self.readings[info.name] = reading
            self.math.graph.input(info.name, info.dtype, *info.shape)
        return Value(info.name, info.shape[0], info.dtype == "bool")

    def sensor(self, robot: Robot, sensor: Sensor) -> Value:
        return self.input(self._describe.sensor(robot, sensor))

    def of_world(self, leaf: EngineRead) -> Item:
        """Return a reading of the world, or the component of the sensor that measures it."""
        if leaf in self._describe.direct:
            robot, sensor, index = self._describe.direct[leaf]
            return Item(self.sensor(robot, sensor), index)
        reading, index = self._describe.of_world(leaf)
        return Item(self.input(reading), index)

    def __call__(self, leaf: Name | EngineRead) -> Item:
        if isinstance(leaf, EngineRead):
            return (
                self._channel_value(leaf)
                if leaf.function in ("age", "message_received")
                else self.of_world(leaf)
            )
        return self.named(leaf, ahead=0)

    def named(self, leaf: Name, *, ahead: int) -> Item:
        """Return a named value. The time and the number of the step are those `ahead` steps after the
        observation."""
        name, component = leaf
        clock = self.memories.clock(name, ahead)
        if clock is not None:
            return Item(clock)
        if name in _LATER or any(ending.name == name for ending in self._program.endings):
            raise UsageError(
                f"the policy sees '{name}', but {_LATER.get(name, 'an ending')} is known only during"
                " training; remove it from the observation"
            )
        if name in self.definitions.parameters:
            value = self.definitions.parameters[name]
            return item(self.input(self._describe.parameter(value)), value.components, component)
        if name in self.definitions.signals:
            signal = self.definitions.signals[name]
            return item(
                self._once(f"signal {name}", self.printer, signal.scalars), signal.components, component
            )
        if name in self.definitions.fields:
            robot, entry = self.definitions.fields[name]
            if not self._program.is_direct(robot, "from_robot") and not _sends_a_sensor(robot, entry.scalars):
                late = f"messages from {robot.name} arrive late or not at all"
                raise UsageError(
                    f"{robot.name} computes '{name}' itself, and {late}; this cannot be exported"
                )
            return item(
                self._once(f"field {name}", self._on_board[robot.name], entry.scalars),
                entry.components,
                component,
            )
        if name in self._heard:
            link, value = self._heard[name]
            return item(self.input(self._describe.heard(link, value)), value.components, component)
        return item(self._last_action(name), self.acted[name], component)

    def _once(self, key: str, printer: TreePrinter, trees: Sequence[Scalar]) -> Value:
        if key not in self._whole:
            self._whole[key] = printer.vector(trees)
        return self._whole[key]

    def _last_action(self, name: str) -> Value:
        """Return an action variable, or the whole action, of the step before; zeros at a reset."""
        if name not in self.acted:
            raise UsageError(f"the policy sees '{name}', which cannot be exported")
        if name not in self._whole:
            truth = name == "previous_action" and not self._program.agent.ranges
            self._whole[name] = self.memories.memory(name, len(self.acted[name]) or 1, truth=truth)
        return self._whole[name]

    def keep_action(self, action: Mapping[str, Value]) -> None:
        """Pass the values that were read of the last action to the next step."""
        for name in action:
            if name in self._whole:
                self.memories.keep(name, self.memories.if_acting(action[name], self._whole[name]))

    def _channel_value(self, leaf: EngineRead) -> Item:
        """Return the age of the last message from a robot, or whether a message arrived in this timestep."""
        name, _, sensor = leaf.subjects[0].partition(".")
        robot = next(robot for robot in self._program.robots if robot.name == name)
        if sensor in dict(robot.ages) or not self._program.is_direct(robot, "from_robot"):
            return self.of_world(leaf)
        return Item(self.math.constant([True if leaf.function == "message_received" else 0.0]))


class OnBoard:
    """The meaning of names in the values that a robot sends."""

    def __init__(self, names: ObservedNames, robot: Robot) -> None:
        self._names, self._robot = names, robot
        self._sensors = {sensor.name: sensor for sensor in robot.sensors}

    def __call__(self, leaf: Name | EngineRead) -> Item:
        if isinstance(leaf, EngineRead):
            return self._names.of_world(leaf)
        sensor = self._sensors[leaf.name]
        return item(self._names.sensor(self._robot, sensor), sensor.components, leaf.component)


class Sent:
    """The meaning of names in the values that the supervisor sends: those of the observation, and the
    action."""

    def __init__(self, names: ObservedNames, action: Mapping[str, Value], ahead: int) -> None:
        self._names, self._action, self._ahead = names, action, ahead

    def __call__(self, leaf: Name | EngineRead) -> Item:
        if isinstance(leaf, EngineRead):
            return self._names(leaf)
        if leaf.name in self._action:
            return item(self._action[leaf.name], self._names.acted[leaf.name], leaf.component)
        return self._names.named(leaf, ahead=self._ahead)


class Applied:
    """The meaning of names in the commands of a robot: its sensors, and the values that it received; zeros at
    a reset (`sent` None)."""

    def __init__(self, names: ObservedNames, robot: Robot, sent: TreePrinter | None) -> None:
        self._math, self._sent = names.math, sent
        self._received = {entry.name: entry for entry in robot.received}
        self._sense = OnBoard(names, robot)

    def __call__(self, leaf: Name | EngineRead) -> Item:
        if isinstance(leaf, EngineRead) or leaf.name not in self._received:
            return self._sense(leaf)
        if self._sent is None:
            return Item(self._math.constant([0.0]))
        entry = self._received[leaf.name]
        return item(self._sent.vector(entry.scalars), entry.components, leaf.component)


def _sends_a_sensor(robot: Robot, trees: Sequence[Scalar]) -> bool:
    """Return whether a value that a robot sends is a sensor without changes."""
    return any(
        trees == tuple(Name(sensor.name, component) for component in sensor.components or (None,))
        for sensor in robot.sensors
    )


def item(whole: Value, components: Sequence[str], component: str | None) -> Item:
    """Return a component of a vector; any of them if all are equal."""
    return Item(whole, 0 if component is None or whole.size == 1 else [*components].index(component))
