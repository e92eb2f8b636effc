"""One control step of a scenario as a graph: from what sensors measure to the commands of actuators, in SI
units.

    sensors ─▶ emit ─▶ augment, signals ─▶ observation ─▶ networks ─▶ action ─▶ receive ─▶ apply ─▶ commands

The parts are those of the generated code, in its order: what `_observe` computes for the policy, then
`_advance` up to the actuators. Noise is left out, since a robot has its own. A memory is a tensor in and one
out; `memory.started` is false in the first step of an episode, in which each memory begins as after a reset.

With `action_repeat`, a function with a memory advances between two actions too. The graph is then called in
every timestep: it observes in all of them, and acts in every n-th; in the others it returns the commands of
the last action.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import Any

import numpy as np
from gymnasium import spaces

from deepbots_cli.errors import UsageError
from deepbots_cli.expressions.scalar import EngineRead, Name, Scalar, State, names_in, walk
from deepbots_cli.insight.export import actuators, network
from deepbots_cli.insight.export.graph import Graph
from deepbots_cli.insight.export.readings import Reading, Readings
from deepbots_cli.insight.export.trees import Arithmetic, Item, MemoryFormulas, TreePrinter, Value
from deepbots_cli.learning.learner import Learner
from deepbots_cli.program import Program
from deepbots_cli.program.robots import Robot, Sensor
from deepbots_cli.program.task import ImageObservation, Observation, action_names
from deepbots_cli.runtime.spaces import observation_space
from deepbots_robot.model import Memory, Output

_LATER = {
    **dict.fromkeys(("previous_reward", "episode_return"), "the reward"),
    **dict.fromkeys(("terminated", "truncated", "ended", "goal_reached"), "the end of an episode"),
}
"""Names that mean something only in a training."""


class _AdvancesBetweenActionsError(Exception):
    """A memory of the observation, in a scenario with several timesteps per action."""


def control_step(program: Program, learner: Learner) -> ControlStep:
    """The graph of a control step.

    Raises:
        UsageError: The scenario or the policy holds something that cannot be exported; names it.
    """
    try:
        return ControlStep(program, learner)
    except _AdvancesBetweenActionsError:
        return ControlStep(program, learner, in_timesteps=True)


class ControlStep:
    """The graph of a control step; see `control_step`.

    Attributes:
        timestep: The time between two calls, in s.
        readings: The inputs, in order of first use.
        memories: What the graph passes to itself.
        outputs: The commands.
        repeat: In how many calls it acts once.
    """

    def __init__(self, program: Program, learner: Learner, *, in_timesteps: bool = False) -> None:
        """`in_timesteps` makes a graph that is called in every timestep, also between two actions."""
        self.program, self.agent = program, program.agent
        self.repeat = program.action_repeat if in_timesteps else 1
        self.timestep = program.world.timestep if in_timesteps else program.period
        self.graph = Graph()
        self.math = Arithmetic(self.graph)
        self.readings: dict[str, Reading] = {}
        self.memories: list[Memory] = []
        self._kept: dict[str, str] = {}
        self.outputs: list[Output] = []
        self._describe = Readings(program, self.timestep)
        self._formulas = MemoryFormulas(self.math, program.world.timestep)
        self._whole: dict[str, Value] = {}
        self._definitions = self._describe.deployment.definitions
        self._on_board = {
            robot.name: TreePrinter(self.math, _OnBoard(self, robot), self._observed_states)
            for robot in program.robots
        }
        self._refuse_what_robots_compute_late()
        self._observed = TreePrinter(self.math, self._observed_leaf, self._observed_states)
        action = self._decide(learner)
        self._command(action)
        for name in [name for name in action if name in self._whole]:
            self.keep(name, self._if_acting(action[name], self._whole[name]))
        self._finish()

    def model(self, metadata: dict[str, str]) -> bytes:
        return self.graph.model(self.program.name, metadata)

    # Inputs, memories, outputs

    @cached_property
    def started(self) -> Value:
        """Whether there was a step before in this episode."""
        started = self.memory("started", 1, truth=True)
        self.keep("started", self.math.constant([True]))
        return started

    @cached_property
    def _acts(self) -> Value:
        """Whether the policy acts in this call."""
        calls = self._calls
        return self.math.binary(
            "Equal",
            self.math.remainder(calls, self.math.constant([float(self.repeat)])),
            self.math.constant([0.0]),
        )

    @cached_property
    def _calls(self) -> Value:
        """How many calls there were before in this episode."""
        calls = self.memory("calls", 1)
        self.keep("calls", self.math.binary("Add", calls, self.math.constant([1.0])))
        return calls

    def _if_acting(self, value: Value, otherwise: Value) -> Value:
        """The value, in a call in which the policy does not act the other one."""
        return value if self.repeat == 1 else self.math.where(self._acts, value, otherwise)

    def _tensor_if_acting(self, tensor: str, otherwise: str) -> str:
        return (
            tensor if self.repeat == 1 else str(self.graph.add("Where", self._acts.name, tensor, otherwise))
        )

    def input(self, reading: Reading) -> Value:
        """The tensor of an input, which is made when it is first read."""
        info = reading.info
        if info.name not in self.readings:
            self.readings[info.name] = reading
            self.graph.input(info.name, info.dtype, *info.shape)
        return Value(info.name, info.shape[0], info.dtype == "bool")

    def memory(self, name: str, size: int, *, truth: bool = False) -> Value:
        """The tensor that holds a value from the step before; zeros at the start of an episode."""
        tensor = self._memory_tensor(name, np.bool_ if truth else np.float64, size)
        return Value(tensor, size, truth)

    def keep(self, name: str, value: Value) -> None:
        """Pass a value to the next step."""
        memory = next(entry for entry in self.memories if entry.name == f"memory.{name}")
        (size,) = memory.shape
        self._kept[memory.name] = self.math.spread(
            value if memory.dtype == "bool" else self.math.number(value), size
        ).name

    def _memory_tensor(self, name: str, dtype: Any, *shape: int) -> str:
        tensor = f"memory.{name}"
        dtype_name: Any = np.dtype(dtype).name
        self.memories.append(Memory(name=tensor, shape=shape, dtype=dtype_name, initial=(0.0,)))
        return self.graph.input(tensor, dtype, *shape)

    def _finish(self) -> None:
        """Declare inputs in their order, and the memories as outputs after the commands."""
        declared = {entry.name: entry for entry in self.graph.inputs}
        self.graph.inputs = [
            declared[name] for name in (*self.readings, *(memory.name for memory in self.memories))
        ]
        for memory in self.memories:
            self.graph.output(f"{memory.name}_next", self._kept[memory.name], memory.dtype, *memory.shape)
        shape = [len(self.agent.choices)] if len(self.agent.choices) > 1 else []
        if self._decision.scores is None:
            self.graph.output("action", self._action, np.float32, len(self.agent.range_names))
            return
        self.graph.output("action", self.graph.reshape(self._action, *shape), np.int64, *shape)
        size = sum(len(part.options) for part in self.agent.choices)
        self.graph.output("scores", self.graph.reshape(self._decision.scores, -1), np.float32, size)

    # What names mean while the policy observes

    def sensor(self, robot: Robot, sensor: Sensor) -> Value:
        return self.input(self._describe.sensor(robot, sensor))

    def of_world(self, leaf: EngineRead) -> Item:
        """A reading of the world, or the component of the sensor that measures it."""
        if leaf in self._describe.direct:
            robot, sensor, index = self._describe.direct[leaf]
            return Item(self.sensor(robot, sensor), index)
        reading, index = self._describe.of_world(leaf)
        return Item(self.input(reading), index)

    def _observed_leaf(self, leaf: Name | EngineRead) -> Item:
        if isinstance(leaf, EngineRead):
            return (
                self._channel_value(leaf)
                if leaf.function in ("age", "message_received")
                else self.of_world(leaf)
            )
        return self._named(leaf, self._clock(leaf.name, 0))

    def _named(self, leaf: Name, clock: Value | None) -> Item:
        """A named value, of which `clock` is the time or the number of the step."""
        name, part = leaf
        if clock is not None:
            return Item(clock)
        if name in _LATER or any(ending.name == name for ending in self.program.endings):
            raise UsageError(
                f"the policy sees '{name}', and {_LATER.get(name, 'an ending')} is known in a training alone"
            )
        if name in self._definitions.parameters:
            value = self._definitions.parameters[name]
            return _item(self.input(self._describe.parameter(value)), value.components, part)
        if name in self._definitions.signals:
            signal = self._definitions.signals[name]
            return _item(
                self._once(f"signal {name}", self._observed, signal.scalars), signal.components, part
            )
        if name in self._definitions.fields:
            robot, entry = self._definitions.fields[name]
            if not self.program.is_direct(robot, "from_robot") and not _sends_a_sensor(robot, entry.scalars):
                late = f"messages from {robot.name} arrive late or not at all"
                raise UsageError(
                    f"{robot.name} computes '{name}' itself, and {late}; this cannot be exported"
                )
            return _item(
                self._once(f"field {name}", self._on_board[robot.name], entry.scalars), entry.components, part
            )
        return _item(self._last_action(name), self._acted[name], part)

    def _once(self, key: str, printer: TreePrinter, trees: Sequence[Scalar]) -> Value:
        if key not in self._whole:
            self._whole[key] = printer.vector(trees)
        return self._whole[key]

    @property
    def _acted(self) -> dict[str, Sequence[str]]:
        """The components of the action variables, and of the action as the agent gave it."""
        parts = {name: part.components for part in self.agent.ranges for name in part.variables}
        variables = {name: parts.get(name, ()) for part in self.agent.action for name in part.variables}
        return {**variables, "previous_action": action_names(self.agent.action)}

    def _last_action(self, name: str) -> Value:
        """An action variable, or the whole action, of the step before; zeros at a reset."""
        if name not in self._acted:
            raise UsageError(f"the policy sees '{name}', which cannot be exported")
        if name not in self._whole:
            truth = name == "previous_action" and not self.agent.ranges
            self._whole[name] = self.memory(name, len(self._acted[name]) or 1, truth=truth)
        return self._whole[name]

    def _clock(self, name: str, ahead: int) -> Value | None:
        """The number of the step, or the time, `ahead` steps after the observation; None for other names."""
        if name not in ("time", "step"):
            return None
        calls, math, repeat = self._calls, self.math, self.program.action_repeat
        if name == "step":  # one that has begun counts
            begun = math.call("ceil", [math.binary("Div", calls, math.constant([float(self.repeat)]))])
            return math.binary("Add", begun, math.constant([float(ahead)]))
        ticks = math.binary("Mul", calls, math.constant([float(repeat // self.repeat)]))
        ticks = math.binary("Add", ticks, math.constant([1.0])) if ahead and repeat == 1 else ticks
        return math.binary("Mul", ticks, math.constant([self.program.world.timestep]))

    def _channel_value(self, leaf: EngineRead) -> Item:
        """The age of what arrived from a robot, and whether something arrived in this timestep."""
        name, _, sensor = leaf.subjects[0].partition(".")
        robot = next(robot for robot in self.program.robots if robot.name == name)
        if sensor in dict(robot.ages) or not self.program.is_direct(robot, "from_robot"):
            return self.of_world(leaf)
        return Item(self.math.constant([True if leaf.function == "message_received" else 0.0]))

    # Memories

    def _observed_states(self, states: Sequence[State], printer: TreePrinter) -> Value:
        """What advances once per timestep, from its value at the reset on."""
        function = states[0].function
        if self.program.action_repeat != self.repeat:
            raise _AdvancesBetweenActionsError
        args = _columns(printer, states)
        begun, first = self._formulas.begin(function, args)
        name = self._slot(states[0])
        kept, value = self._formulas.proceed(
            function, self.memory(name, len(states), truth=begun.truth), args
        )
        self.keep(name, self.math.where(self.started, kept, begun))
        return self.math.where(self.started, value, first)

    def _states_at_reset(self, states: Sequence[State], printer: TreePrinter) -> Value:
        return self._formulas.begin(states[0].function, _columns(printer, states))[1]

    def _slot(self, state: State) -> str:
        """A name for the memory of a stateful call, which no other memory has."""
        item, occurrence = state.call
        names = {memory.name for memory in self.memories}
        wanted = [
            item if occurrence == "0" else f"{item}.{occurrence}",
            *(f"{item}.{occurrence}.{number}" for number in range(1, 10_000)),
        ]
        return next(name for name in wanted if f"memory.{name}" not in names)

    # The observation and the networks

    def _decide(self, learner: Learner) -> dict[str, Value]:
        """The action variables, and the action as the agent gave it."""
        agent, graph = self.agent, self.graph
        seen: dict[str, str] = {}
        if agent.numbers or not agent.images:
            seen["observation"] = self._seen()
        seen |= {image.key: self._seen_image(image) for image in agent.images}
        if agent.goal is not None:
            for key, trees in (
                ("achieved_goal", agent.goal.achieved.scalars),
                ("desired_goal", agent.goal.targets),
            ):
                middle, half = _mapping(agent.goal.low, agent.goal.high)
                value = self.math.binary("Sub", self._observed.vector(trees), self.math.constant(middle))
                value = self._clipped(self.math.binary("Div", value, self.math.constant(half)))
                seen[key] = graph.cast(self.math.spread(value, len(middle)).name, np.float32)
        space = observation_space(agent)
        order = space.spaces if isinstance(space, spaces.Dict) else seen
        seen = {key: graph.reshape(seen[key], 1, *self._shapes.get(key, (-1,))) for key in order}
        policy = learner.network()
        states = []
        if policy.memory is not None:
            sides = (policy.memory.num_layers, policy.memory.hidden_size)
            tensors = [self._memory_tensor(name, np.float32, *sides) for name in network.LSTM_STATES]
            states = [graph.add("Unsqueeze", tensor, graph.constant([1], np.int64)) for tensor in tensors]
        self._decision = network.decide(graph, policy, self.program, seen, states, self._mask(learner))
        for name, after in zip(network.LSTM_STATES, self._decision.after, strict=False):
            memory = f"memory.{name}"
            self._kept[memory] = self._tensor_if_acting(
                graph.add("Squeeze", after, graph.constant([1], np.int64)), memory
            )
        self._action = graph.reshape(self._decision.action, -1)
        if self.repeat > 1:
            dtype, size = (
                (np.int64, len(agent.choices)) if agent.choices else (np.float32, len(agent.range_names))
            )
            self._action = self._tensor_if_acting(self._action, self._memory_tensor("action", dtype, size))
            self._kept["memory.action"] = self._action
        return self._decoded()

    def _mask(self, learner: Learner) -> str | None:
        if not network.takes_masks(learner, self.program):
            return None
        allowed = [
            self.math.constant([True])
            if option.forbidden is None
            else self.math.negated(self._observed.value(option.forbidden.scalar))
            for part in self.agent.choices
            for option in part.options
        ]
        return self.graph.reshape(self.math.joined(allowed).name, 1, -1)

    def _decoded(self) -> dict[str, Value]:
        """What the action of the policy sets."""
        agent, graph, decision = self.agent, self.graph, self._decision
        decoded: dict[str, Value] = {}
        if decision.scores is None:
            whole = Value(graph.cast(graph.reshape(decision.action, -1), np.float64), len(agent.range_names))
            place = 0
            for part in agent.ranges:
                size = len(part.names)
                value = self.math.picked([Item(whole, place + index) for index in range(size)])
                half, middle = (part.high - part.low) / 2, (part.high + part.low) / 2
                value = self.math.binary("Mul", value, self.math.constant([half])) if half != 1.0 else value
                decoded[part.name] = (
                    self.math.binary("Add", value, self.math.constant([middle])) if middle else value
                )
                place += size
            return decoded | {"previous_action": whole}
        taken = []
        for choice, option in zip(agent.choices, decision.options, strict=True):
            table = graph.constant([each.values for each in choice.options], np.float64)
            row = Value(graph.reshape(graph.add("Gather", table, option, axis=0), -1), len(choice.variables))
            decoded |= {
                name: self.math.picked([Item(row, place)]) for place, name in enumerate(choice.variables)
            }
            size = len(choice.options)
            hot = graph.reshape(
                graph.add("Gather", graph.constant(np.eye(size), np.float64), option, axis=0), -1
            )
            taken.append(self.math.binary("Greater", Value(hot, size), self.math.constant([0.5])))
        return decoded | {"previous_action": self.math.joined(taken)}

    def _seen(self) -> str:
        """The vector of numbers, in [-1, 1]: the newest frame and older ones."""
        agent, graph = self.agent, self.graph
        parts = [self._seen_numbers(entry) for entry in agent.observation if entry.numbers]
        frame = parts[0] if len(parts) == 1 else graph.add("Concat", *parts, axis=0)
        depth, width = 1 + max((ago for _, ago in agent.seen), default=0), len(agent.numbers)
        if depth == 1:
            return str(frame)
        row = graph.reshape(frame, 1, width)
        before = self._memory_tensor("frames", np.float32, depth - 1, width)
        first = graph.add("Concat", *[row] * (depth - 1), axis=0)
        older = graph.add("Where", self.started.name, before, first)
        frames = graph.add("Concat", older, row, axis=0)
        self._kept["memory.frames"] = self._tensor_if_acting(self._without_oldest(frames, depth), older)
        places = [(depth - 1 - ago) * width + index for index, ago in agent.seen]
        return str(graph.add("Gather", graph.reshape(frames, -1), graph.constant(places, np.int64), axis=0))

    def _without_oldest(self, frames: str, depth: int) -> str:
        ends = (self.graph.constant([place], np.int64) for place in (1, depth, 0))
        return str(self.graph.add("Slice", frames, *ends))

    def _seen_numbers(self, entry: Observation) -> str:
        """The numbers of one entry as the policy sees them, float32."""
        first, size = entry.numbers[0], len(entry.numbers)
        if entry.value.foreign is not None:
            raise UsageError(
                f"the observation '{entry.name}' is computed by Python, which cannot be exported"
            )
        value = self._observed.vector(entry.value.scalars)
        as_given = (
            entry.name == "previous_action"
            and entry.noise is None
            and {*entry.low, *entry.high} == {-1.0, 1.0}
        )
        if not (first.is_truth or as_given):
            middle, half = _mapping(entry.low, entry.high)
            value = self.math.binary("Sub", value, self.math.constant(middle))
            value = self.math.binary("Mul", value, self.math.constant([1 / each for each in half]))
            value = self._clipped(value) if entry.clip else value
        return self.graph.cast(self.math.spread(value, size).name, np.float32)

    def _clipped(self, value: Value) -> Value:
        return self.math.call(
            "min", [self.math.call("max", [value, self.math.constant([-1.0])]), self.math.constant([1.0])]
        )

    @property
    def _shapes(self) -> dict[str, tuple[int, ...]]:
        """Rows, columns and channels of the images that the policy sees."""
        stack = self.agent.frame_stack
        return {
            image.key: (*image.shape[:2], image.shape[2] * len(image.ages(stack)))
            for image in self.agent.images
        }

    def _seen_image(self, image: ImageObservation) -> str:
        """An image, uint8 [rows, columns, channels], with its history side by side, oldest first."""
        robot, entry = self._definitions.fields.get(image.name, (None, None))
        sensor = None
        if robot is not None and entry is not None:
            sensor = next((each for each in robot.sensors if entry.scalars == (Name(each.name),)), None)
        if robot is None or sensor is None:
            raise UsageError(
                f"the image '{image.name}' is not that of a camera as it is, which cannot be exported"
            )
        reading = self._describe.sensor(robot, sensor)
        self.input(reading)
        graph, ages = self.graph, image.ages(self.agent.frame_stack)
        depth = 1 + max(ages)
        if depth == 1:
            return reading.info.name
        newest = graph.add("Unsqueeze", reading.info.name, graph.constant([0], np.int64))
        before = self._memory_tensor(image.key, np.uint8, depth - 1, *image.shape)
        older = graph.add(
            "Where", self.started.name, before, graph.add("Concat", *[newest] * (depth - 1), axis=0)
        )
        frames = graph.add("Concat", older, newest, axis=0)
        self._kept[f"memory.{image.key}"] = self._tensor_if_acting(self._without_oldest(frames, depth), older)
        taken = graph.add(
            "Gather", frames, graph.constant([depth - 1 - ago for ago in ages], np.int64), axis=0
        )
        return graph.reshape(graph.add("Transpose", taken, perm=[1, 2, 0, 3]), *self._shapes[image.key])

    # Messages and commands

    def _refuse_what_robots_compute_late(self) -> None:
        """Robots compute on board when a message arrives; a bundle computes when it is sent."""
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
        zeros = {name: self.math.constant([0.0]) for name in action}
        at_reset = TreePrinter(self.math, _Sent(self, zeros, 0), self._states_at_reset)
        sent = TreePrinter(self.math, _Sent(self, action, 1), _Acting(self, at_reset, frozenset()))
        for robot in self.program.robots:
            if robot.name not in self.agent.robots:
                continue
            first = TreePrinter(self.math, _Applied(self, robot, None), self._states_at_reset)
            applied = TreePrinter(
                self.math, _Applied(self, robot, sent), _Acting(self, first, robot.begun_by_message)
            )
            for command in robot.commands:
                info = actuators.output(self.program, robot, command)
                value = self.math.spread(self.math.number(applied.vector(command.scalars)), info.shape[0])
                low, high = (self._bounds(ends, sign) for ends, sign in zip(info.range, (-1, 1), strict=True))
                value = self.math.call("min", [self.math.call("max", [value, low]), high])
                if self.repeat > 1:
                    value = self._if_acting(value, self.memory(f"command.{info.name}", info.shape[0]))
                    self.keep(f"command.{info.name}", value)
                self.outputs.append(info)
                self.graph.output(info.name, value.name, np.float64, *info.shape)

    def _bounds(self, ends: Sequence[float | None], sign: int) -> Value:
        return self.math.constant([sign * np.inf if end is None else float(end) for end in ends])

    def states_of_acting(
        self,
        states: Sequence[State],
        printer: TreePrinter,
        at_reset: TreePrinter,
        begun: frozenset[tuple[str, str]],
    ) -> Value:
        """What advances with each message, from its value at the reset on; `begun` are the calls that begin
        with the first message."""
        function = states[0].function
        args = _columns(printer, states)
        start, _ = self._formulas.begin(
            function, args if states[0].call in begun else _columns(at_reset, states)
        )
        name = self._slot(states[0])
        before = self.math.where(self.started, self.memory(name, len(states), truth=start.truth), start)
        kept, value = self._formulas.proceed(function, before, args)
        self.keep(name, self._if_acting(kept, before))
        return value

    def clock_when_acting(self, name: str, ahead: int) -> Value | None:
        return self._clock(name, ahead)

    def named(self, leaf: Name, clock: Value | None) -> Item:
        return self._named(leaf, clock)


class _OnBoard:
    """What names mean in the values that a robot sends."""

    def __init__(self, step: ControlStep, robot: Robot) -> None:
        self._step, self._robot = step, robot
        self._sensors = {sensor.name: sensor for sensor in robot.sensors}

    def __call__(self, leaf: Name | EngineRead) -> Item:
        if isinstance(leaf, EngineRead):
            return self._step.of_world(leaf)
        sensor = self._sensors[leaf.name]
        return _item(self._step.sensor(self._robot, sensor), sensor.components, leaf.component)


class _Sent:
    """What names mean in the values that the supervisor sends: those of the observation, and the action."""

    def __init__(self, step: ControlStep, action: dict[str, Value], ahead: int) -> None:
        self._step, self._action, self._ahead = step, action, ahead

    def __call__(self, leaf: Name | EngineRead) -> Item:
        step = self._step
        if isinstance(leaf, EngineRead):
            return step._observed_leaf(leaf)
        if leaf.name in self._action:
            return _item(self._action[leaf.name], step._acted[leaf.name], leaf.component)
        return step.named(leaf, step.clock_when_acting(leaf.name, self._ahead))


class _Applied:
    """What names mean in the commands of a robot: its sensors, and what it received; zeros at a reset (`sent`
    None)."""

    def __init__(self, step: ControlStep, robot: Robot, sent: TreePrinter | None) -> None:
        self._step, self._sent = step, sent
        self._received = {entry.name: entry for entry in robot.received}
        self._sense = _OnBoard(step, robot)

    def __call__(self, leaf: Name | EngineRead) -> Item:
        if isinstance(leaf, EngineRead) or leaf.name not in self._received:
            return self._sense(leaf)
        if self._sent is None:
            return Item(self._step.math.constant([0.0]))
        entry = self._received[leaf.name]
        return _item(self._sent.vector(entry.scalars), entry.components, leaf.component)


class _Acting:
    """The values of stateful functions in messages and commands."""

    def __init__(self, step: ControlStep, at_reset: TreePrinter, begun: frozenset[tuple[str, str]]) -> None:
        self._step, self._at_reset, self._begun = step, at_reset, begun

    def __call__(self, states: Sequence[State], printer: TreePrinter) -> Value:
        return self._step.states_of_acting(states, printer, self._at_reset, self._begun)


def _sends_a_sensor(robot: Robot, trees: Sequence[Scalar]) -> bool:
    """Whether a value that a robot sends is a sensor as it is."""
    return any(
        trees == tuple(Name(sensor.name, part) for part in sensor.components or (None,))
        for sensor in robot.sensors
    )


def _item(whole: Value, components: Sequence[str], part: str | None) -> Item:
    """A component of a vector; any of them where all are equal."""
    return Item(whole, 0 if part is None or whole.size == 1 else [*components].index(part))


def _columns(printer: TreePrinter, states: Sequence[State]) -> list[Value]:
    """Each argument of a stateful function, one value per component."""
    return [printer.vector([state.args[place] for state in states]) for place in range(len(states[0].args))]


def _mapping(low: Sequence[float], high: Sequence[float]) -> tuple[list[float], list[float]]:
    """The middle of each range, and half of its width."""
    ends = [*zip(low, high, strict=True)]
    return [(b + a) / 2 for a, b in ends], [(b - a) / 2 for a, b in ends]
