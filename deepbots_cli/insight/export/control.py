"""One control step of a scenario as a graph: from the measurements of sensors to the commands of actuators,
with the tensors that names in expressions stand for.

sensors ─▶ emit ─▶ augment, signals ─▶ observation ─▶ networks ─▶ action ─▶ receive ─▶ apply ─▶ commands

The parts are those of the generated code, in its order: the observation that `_observe` computes, then
`_advance` up to the actuators. Noise is left out, since a robot has its own.

With `action_repeat`, a function with a memory advances between two actions too. The graph is then called in
every timestep: it observes in all of them, and acts in every n-th; in the others it returns the commands of
the last action.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial

import numpy as np
from gymnasium import spaces

from deepbots_cli.errors import UsageError
from deepbots_cli.expressions.scalar import EngineRead, Name, Scalar, State, names_in, walk
from deepbots_cli.insight.export import devices, network
from deepbots_cli.insight.export.devices import Reading, Readings
from deepbots_cli.insight.export.network import Graph
from deepbots_cli.insight.export.trees import (
    AdvancesBetweenActionsError,
    Arithmetic,
    Item,
    StepMemories,
    TreePrinter,
    Value,
)
from deepbots_cli.learning.learner import Learner
from deepbots_cli.program import Program
from deepbots_cli.program.robots import Robot, Sensor
from deepbots_cli.program.task import ImageObservation, Observation, action_names
from deepbots_cli.runtime.spaces import observation_space
from deepbots_robot.model import Output

Leaf = Callable[[Name | EngineRead], Item]
"""The meaning of names and of readings of the world in a tree."""
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
            robot.name: TreePrinter(math, on_board(self, robot), memories.per_timestep)
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


def on_board(names: ObservedNames, robot: Robot) -> Leaf:
    """Return the meaning of names in the values that a robot sends."""
    sensors = {sensor.name: sensor for sensor in robot.sensors}

    def meaning(leaf: Name | EngineRead) -> Item:
        if isinstance(leaf, EngineRead):
            return names.of_world(leaf)
        sensor = sensors[leaf.name]
        return item(names.sensor(robot, sensor), sensor.components, leaf.component)

    return meaning


def sent(names: ObservedNames, action: Mapping[str, Value], ahead: int) -> Leaf:
    """Return the meaning of names in the values that the supervisor sends: those of the observation, and the
    action."""

    def meaning(leaf: Name | EngineRead) -> Item:
        if isinstance(leaf, EngineRead):
            return names(leaf)
        if leaf.name in action:
            return item(action[leaf.name], names.acted[leaf.name], leaf.component)
        return names.named(leaf, ahead=ahead)

    return meaning


def applied(names: ObservedNames, robot: Robot, message: TreePrinter | None) -> Leaf:
    """Return the meaning of names in the commands of a robot: its sensors, and the values that it received in
    a message; zeros at a reset (`message` None)."""
    received, sense = {entry.name: entry for entry in robot.received}, on_board(names, robot)

    def meaning(leaf: Name | EngineRead) -> Item:
        if isinstance(leaf, EngineRead) or leaf.name not in received:
            return sense(leaf)
        if message is None:
            return Item(names.math.constant([0.0]))
        entry = received[leaf.name]
        return item(message.vector(entry.scalars), entry.components, leaf.component)

    return meaning


def _sends_a_sensor(robot: Robot, trees: Sequence[Scalar]) -> bool:
    """Return whether a value that a robot sends is a sensor without changes."""
    return any(
        trees == tuple(Name(sensor.name, component) for component in sensor.components or (None,))
        for sensor in robot.sensors
    )


def item(whole: Value, components: Sequence[str], component: str | None) -> Item:
    """Return a component of a vector; any of them if all are equal."""
    return Item(whole, 0 if component is None or whole.size == 1 else [*components].index(component))


def control_step(program: Program, learner: Learner) -> ControlStep:
    """Return the graph of a control step.

    Raises:
        UsageError: The scenario or the policy has a part that cannot be exported; the message names it.
    """
    try:
        return ControlStep(program, learner)
    except AdvancesBetweenActionsError:
        return ControlStep(program, learner, in_timesteps=True)


class ControlStep:
    """The graph of a control step; see `control_step`.

    Attributes:
        timestep: The time between two calls, in s.
        readings: The inputs, in order of first use.
        memories: The values that the graph passes to its next call.
        outputs: The commands.
        repeat: The number of calls in which it acts once.
    """

    def __init__(self, program: Program, learner: Learner, *, in_timesteps: bool = False) -> None:
        """Create the graph. With `in_timesteps`, it is called in every timestep, also between two actions."""
        self.program, self.agent = program, program.agent
        self.repeat = program.action_repeat if in_timesteps else 1
        self.timestep = program.world.timestep if in_timesteps else program.period
        self.graph = Graph()
        self.outputs: list[Output] = []
        self._math = Arithmetic(self.graph)
        self._memories = StepMemories(self._math, program, self.repeat)
        self._names = ObservedNames(program, self._math, self._memories, self.timestep)
        self.readings, self.memories = self._names.readings, self._memories.entries
        self._refuse_what_robots_compute_late()
        action = self._decide(learner)
        self._command(action)
        self._names.keep_action(action)
        self._finish()

    def model(self, metadata: dict[str, str]) -> bytes:
        return self.graph.model(self.program.name, metadata)

    def _finish(self) -> None:
        """Declare inputs in their order, and the memories as outputs after the commands."""
        declared = {entry.name: entry for entry in self.graph.inputs}
        self.graph.inputs = [
            declared[name] for name in (*self.readings, *(memory.name for memory in self.memories))
        ]
        self._memories.declare()
        shape = [len(self.agent.choices)] if len(self.agent.choices) > 1 else []
        if self._decision.scores is None:
            self.graph.output("action", self._action, np.float32, len(self.agent.range_names))
            return
        self.graph.output("action", self.graph.reshape(self._action, *shape), np.int64, *shape)
        size = sum(len(choice.options) for choice in self.agent.choices)
        self.graph.output("scores", self.graph.reshape(self._decision.scores, -1), np.float32, size)

    # The observation and the networks

    def _decide(self, learner: Learner) -> dict[str, Value]:
        """Return the action variables, and the action as the agent gave it."""
        agent, graph = self.agent, self.graph
        inputs: dict[str, str] = {}
        if agent.numbers or not agent.images:
            inputs["observation"] = self._observation_vector()
        inputs |= {image.key: self._seen_image(image) for image in agent.images}
        if agent.goal is not None:
            for key, trees in (
                ("achieved_goal", agent.goal.achieved.scalars),
                ("desired_goal", agent.goal.targets),
            ):
                middle, half = _mapping(agent.goal.low, agent.goal.high)
                value = self._math.binary(
                    "Sub", self._names.printer.vector(trees), self._math.constant(middle)
                )
                # A division as in `spaces.scaled_goal`, so that the last bits agree.
                value = self._clipped(self._math.binary("Div", value, self._math.constant(half)))
                inputs[key] = graph.cast(self._math.spread(value, len(middle)).name, np.float32)
        space = observation_space(agent)
        order = space.spaces if isinstance(space, spaces.Dict) else inputs
        inputs = {key: graph.reshape(inputs[key], 1, *self._shapes.get(key, (-1,))) for key in order}
        policy = learner.network()
        states = []
        if policy.memory is not None:
            sides = (policy.memory.num_layers, policy.memory.hidden_size)
            tensors = [self._memories.tensor(name, np.float32, *sides) for name in network.LSTM_STATES]
            states = [graph.add("Unsqueeze", tensor, graph.constant([1], np.int64)) for tensor in tensors]
        self._decision = network.decide(graph, policy, self.program, inputs, states, self._mask(learner))
        # Without an LSTM, `after` is empty.
        for name, after in zip(network.LSTM_STATES, self._decision.after, strict=False):
            squeezed = graph.add("Squeeze", after, graph.constant([1], np.int64))
            self._memories.keep_tensor(name, self._memories.tensor_if_acting(squeezed, f"memory.{name}"))
        self._action = graph.reshape(self._decision.action, -1)
        if self.repeat > 1:
            dtype, size = (
                (np.int64, len(agent.choices)) if agent.choices else (np.float32, len(agent.range_names))
            )
            self._action = self._memories.tensor_if_acting(
                self._action, self._memories.tensor("action", dtype, size)
            )
            self._memories.keep_tensor("action", self._action)
        return self._decoded()

    def _mask(self, learner: Learner) -> str | None:
        if not network.takes_masks(learner, self.program):
            return None
        allowed = [
            self._math.constant([True])
            if option.forbidden is None
            else self._math.negated(self._names.printer.value(option.forbidden.scalar))
            for choice in self.agent.choices
            for option in choice.options
        ]
        return self.graph.reshape(self._math.joined(allowed).name, 1, -1)

    def _decoded(self) -> dict[str, Value]:
        """Return the values that the action of the policy sets."""
        agent, graph, decision = self.agent, self.graph, self._decision
        decoded: dict[str, Value] = {}
        if decision.scores is None:
            whole = Value(graph.cast(graph.reshape(decision.action, -1), np.float64), len(agent.range_names))
            offset = 0
            for interval in agent.ranges:
                size = len(interval.names)
                value = self._math.picked([Item(whole, offset + index) for index in range(size)])
                half, middle = (interval.high - interval.low) / 2, (interval.high + interval.low) / 2
                value = self._math.binary("Mul", value, self._math.constant([half])) if half != 1.0 else value
                decoded[interval.name] = (
                    self._math.binary("Add", value, self._math.constant([middle])) if middle else value
                )
                offset += size
            return decoded | {"previous_action": whole}
        parts = []
        for choice, option in zip(agent.choices, decision.options, strict=True):
            table = graph.constant([entry.values for entry in choice.options], np.float64)
            row = Value(graph.reshape(graph.add("Gather", table, option, axis=0), -1), len(choice.variables))
            decoded |= {
                name: self._math.picked([Item(row, index)]) for index, name in enumerate(choice.variables)
            }
            size = len(choice.options)
            hot = graph.reshape(
                graph.add("Gather", graph.constant(np.eye(size), np.float64), option, axis=0), -1
            )
            parts.append(self._math.binary("Greater", Value(hot, size), self._math.constant([0.5])))
        return decoded | {"previous_action": self._math.joined(parts)}

    def _observation_vector(self) -> str:
        """Return the vector of numbers, in [-1, 1]: the newest frame and older ones."""
        agent, graph = self.agent, self.graph
        parts = [self._seen_numbers(entry) for entry in agent.observation if entry.numbers]
        frame = parts[0] if len(parts) == 1 else graph.add("Concat", *parts, axis=0)
        depth, width = 1 + max((ago for _, ago in agent.seen), default=0), len(agent.numbers)
        if depth == 1:
            return str(frame)
        row = graph.reshape(frame, 1, width)
        frames = self._memories.frames("frames", row, depth, np.float32, width)
        indices = [(depth - 1 - ago) * width + index for index, ago in agent.seen]
        return str(graph.add("Gather", graph.reshape(frames, -1), graph.constant(indices, np.int64), axis=0))

    def _seen_numbers(self, entry: Observation) -> str:
        """Return the numbers of one entry as observed, float32."""
        first, size = entry.numbers[0], len(entry.numbers)
        if entry.value.foreign is not None:
            raise UsageError(
                f"the observation '{entry.name}' is computed by Python, which cannot be exported"
            )
        value = self._names.printer.vector(entry.value.scalars)
        as_given = (
            entry.name == "previous_action"
            and entry.noise is None
            and {*entry.low, *entry.high} == {-1.0, 1.0}
        )
        if not (first.is_truth or as_given):
            middle, half = _mapping(entry.low, entry.high)
            value = self._math.binary("Sub", value, self._math.constant(middle))
            # By the reciprocal as in `formulas.scale`, so that the last bits agree.
            value = self._math.binary("Mul", value, self._math.constant([1 / number for number in half]))
            value = self._clipped(value) if entry.clip else value
        return self.graph.cast(self._math.spread(value, size).name, np.float32)

    def _clipped(self, value: Value) -> Value:
        return self._math.call(
            "min", [self._math.call("max", [value, self._math.constant([-1.0])]), self._math.constant([1.0])]
        )

    @property
    def _shapes(self) -> dict[str, tuple[int, ...]]:
        """The rows, columns and channels of the observed images."""
        stack = self.agent.frame_stack
        return {
            image.key: (*image.shape[:2], image.shape[2] * len(image.ages(stack)))
            for image in self.agent.images
        }

    def _seen_image(self, image: ImageObservation) -> str:
        """Return an image, uint8 [rows, columns, channels], with its history side by side, oldest first."""
        robot, entry = self._names.definitions.fields.get(image.name, (None, None))
        sensor = None
        if robot is not None and entry is not None:
            sensor = next(
                (candidate for candidate in robot.sensors if entry.scalars == (Name(candidate.name),)), None
            )
        if robot is None or sensor is None:
            raise UsageError(
                f"the image '{image.name}' is not that of a camera as it is, which cannot be exported"
            )
        picture = self._names.sensor(robot, sensor).name
        graph, ages = self.graph, image.ages(self.agent.frame_stack)
        depth = 1 + max(ages)
        if depth == 1:
            return picture
        newest = graph.add("Unsqueeze", picture, graph.constant([0], np.int64))
        frames = self._memories.frames(image.key, newest, depth, np.uint8, *image.shape)
        stack = graph.add(
            "Gather", frames, graph.constant([depth - 1 - ago for ago in ages], np.int64), axis=0
        )
        return graph.reshape(graph.add("Transpose", stack, perm=[1, 2, 0, 3]), *self._shapes[image.key])

    # Messages and commands

    def _refuse_what_robots_compute_late(self) -> None:
        """Refuse values whose time would differ: robots compute on board when a message arrives, and a bundle
        when it is sent."""
        for robot in self.program.robots:
            trees = [tree for command in robot.commands for tree in command.scalars]
            received = {entry.name for entry in robot.received}
            reads = any(leaf.name not in received for tree in trees for leaf in names_in(tree))
            keeps = any(isinstance(node, State) for tree in trees for node in walk(tree))
            if (
                robot.name in self.agent.robots
                and (reads or keeps)
                and not self.program.is_direct(robot, "to_robot")
            ):
                late = "and messages to it arrive late or not at all"
                raise UsageError(
                    f"`apply` of {robot.name} reads sensors or keeps values, {late}; this cannot be exported"
                )

    def _command(self, action: dict[str, Value]) -> None:
        """The commands of the robots that the action commands."""
        zeros = {name: self._math.constant([0.0]) for name in action}
        names, memories = self._names, self._memories
        at_reset = TreePrinter(self._math, sent(names, zeros, 0), memories.at_reset)
        per_message = partial(memories.per_message, reset=at_reset)
        message = TreePrinter(self._math, sent(names, action, 1), per_message)
        for robot in self.program.robots:
            if robot.name not in self.agent.robots:
                continue
            first = TreePrinter(self._math, applied(names, robot, None), memories.at_reset)
            per_message = partial(memories.per_message, reset=first, begun=robot.begun_by_message)
            printer = TreePrinter(self._math, applied(names, robot, message), per_message)
            for command in robot.commands:
                info = devices.output(self.program, robot, command)
                value = self._math.spread(self._math.number(printer.vector(command.scalars)), info.shape[0])
                low, high = (self._bounds(ends, sign) for ends, sign in zip(info.range, (-1, 1), strict=True))
                value = self._math.call("min", [self._math.call("max", [value, low]), high])
                if self.repeat > 1:
                    value = memories.if_acting(value, memories.memory(f"command.{info.name}", info.shape[0]))
                    memories.keep(f"command.{info.name}", value)
                self.outputs.append(info)
                self.graph.output(info.name, value.name, np.float64, *info.shape)

    def _bounds(self, ends: Sequence[float | None], sign: int) -> Value:
        return self._math.constant([sign * np.inf if end is None else float(end) for end in ends])


def _mapping(low: Sequence[float], high: Sequence[float]) -> tuple[list[float], list[float]]:
    """Return the middle of each range, and half of its width."""
    ends = [*zip(low, high, strict=True)]
    return [(b + a) / 2 for a, b in ends], [(b - a) / 2 for a, b in ends]
