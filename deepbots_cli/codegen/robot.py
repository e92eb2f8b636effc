"""Prints one controller class per robot: `use_message_data` and `create_message`, as in the paper; its
sensors and actuators."""

from __future__ import annotations

from collections.abc import Sequence

from deepbots_cli import frames
from deepbots_cli.codegen.names import (
    Constants,
    block,
    class_name,
    constants_tuple_code,
    docstring,
    fill_template,
    quoted,
    quoted_tuple,
    targets_code,
    tuple_code,
    unused_name,
)
from deepbots_cli.codegen.printer import Printer, outer_states
from deepbots_cli.codegen.workspace import ClassPrinter, ReaderKeys, whole_vector
from deepbots_cli.compiler.robots import rigid_root
from deepbots_cli.expressions.functions import FUNCTIONS
from deepbots_cli.expressions.scalar import Draw, EngineRead, Name, Op, Scalar, State, names_in, walk
from deepbots_cli.expressions.text import SCALAR, Target
from deepbots_cli.expressions.types import Kind
from deepbots_cli.program import Program, generated
from deepbots_cli.program.robots import Actuator, Cartesian, CustomActuator, Motor, Robot, Sensor, Thrust
from deepbots_cli.words import sentence_list

_CLASS = """
class {name}({base}):
    {doc}

    {state}
    def bind(self, engine: Any) -> None:
        {binding}

    {methods}
"""


class ControllerPrinter(ClassPrinter):
    """Prints the controller of one robot."""

    def __init__(
        self, scenario: Program, robot: Robot, constants: Constants, target: Target = SCALAR
    ) -> None:
        super().__init__(scenario, constants, target)
        self._robot = robot
        self._received = {entry.name: entry.components for entry in robot.received}
        self._sensors = {sensor.name: sensor for sensor in robot.sensors}
        self._devices = sampled_sensors(scenario, robot)
        self._emitted = [[self._resolved(value) for value in entry.scalars] for entry in robot.emitted]
        self._applied = [[self._resolved(value) for value in entry.scalars] for entry in robot.commands]
        self.begun_by_message = robot.begun_by_message
        for actuator in robot.actuators:
            if isinstance(actuator, Motor):
                constants.name_strings(f"{robot.name}_{actuator.name}", actuator.joints)

    def lines(self) -> list[str]:
        robot = self._robot
        emitted = sentence_list([entry.name for entry in robot.emitted]) or "nothing"
        driven = sentence_list([entry.name for entry in robot.commands]) or "nothing"
        # A batch begins like its single worlds: the same names are given, and nothing is printed.
        on_floats = self.target is SCALAR
        resetting = self._reset()
        methods = [
            *(resetting if on_floats else []),
            *self._observe(),
            *self._use_message_data(),
            *self._create_message(),
        ]
        writers = ActuatorBindings(self.scenario, robot, self.constants).bind_lines(on_columns=not on_floats)
        state_names = (
            [generated.emitted(self.names(entry.name)) for entry in robot.emitted]
            if self._keeps_state and not on_floats
            else []
        )
        devices = [f"self.{generated.sense(name)} = self.device({quoted(name)})" for name in self._devices]
        return fill_template(
            _CLASS,
            name=controller_names(self.scenario)[robot.name],
            base="RobotController" if on_floats else "BatchController",
            state=[f"STATE = {quoted_tuple(state_names)}", ""] if state_names else [],
            doc=docstring(f"Robot `{robot.name}`: emits {emitted}; drives {driven}."),
            binding=[*self.bind_lines(*devices), *writers] or ["pass"],
            methods=methods,
        )

    @property
    def _keeps_state(self) -> bool:
        """Whether the robot emits a value with a memory, which advances once per timestep."""
        return any(outer_states(value) for values in self._emitted for value in values)

    def _reset(self) -> list[str]:
        """Return the reset method: actions are zeros, and a memory that begins with another received value
        waits for the first message."""
        applied = [value for values in self._applied for value in values]
        if not (
            self._keeps_state or any(outer_states(value, without=self.begun_by_message) for value in applied)
        ):
            return []
        acting = self._printer()
        for values in self._applied:
            acting.vector(values)
        printer = self._printer(dict.fromkeys(self._received, "0.0"))
        printer.update_memories(applied, acting)
        lines = self._finished(printer, [])
        return block("def reset(self) -> None:", [*lines, "self.compute()"] if self._keeps_state else lines)

    def _observe(self) -> list[str]:
        """Return the method that samples, and advances memories once per timestep."""
        sampling = [f"self.{generated.sense(name)}()" for name in self._devices]
        if not self._keeps_state:
            return (
                block("def observe(self) -> None:", ['"""Read the sensors, once per timestep."""', *sampling])
                if sampling
                else []
            )
        printer = self._printer()
        for entry, values in zip(self._robot.emitted, self._emitted, strict=True):
            printer.assign(self._stored(entry.name), printer.vector_or_number(entry.components, values))
        doc = '"""Compute the emitted values, and update memories."""'
        return [
            *block(
                "def observe(self) -> None:",
                ['"""Read the sensors and compute, once per timestep."""', *sampling, "self.compute()"],
            ),
            *block("def compute(self) -> None:", self._finished(printer, [doc])),
        ]

    def _use_message_data(self) -> list[str]:
        printer = self._printer()
        received = [self.names(name) for name in self._received]
        if received:
            printer.line(f"{targets_code(received)} = message")
        printer.insert_readers_here()
        for entry, values in zip(self._robot.commands, self._applied, strict=True):
            printer.line(f"self.{generated.drive(entry.name)}({printer.vector(values)})")
        doc = docstring(
            f"Drive the actuators by {sentence_list(list(self._received)) or 'an empty message'}."
        )
        return block("def use_message_data(self, message: Any) -> None:", self._finished(printer, doc))

    def _create_message(self) -> list[str]:
        entries = self._robot.emitted
        if self._keeps_state:
            values = [self._stored(entry.name) for entry in entries]
            printer = None
        else:
            printer = self._printer()
            values = [
                printer.vector_or_number(entry.components, trees)
                for entry, trees in zip(entries, self._emitted, strict=True)
            ]
        listed = sentence_list([entry.name for entry in entries]) or "nothing"
        lines = self._finished(printer, []) if printer and values else []
        answer = f"return {tuple_code(values) if values else '()'}"
        doc = docstring(f"The values of a message: {listed}.")
        return block("def create_message(self) -> tuple[Any, ...]:", [*doc, *lines, answer])

    def _stored(self, name: str) -> str:
        return f"self.{generated.emitted(self.names(name))}"

    # Meanings of names

    def _printer(self, renamed: dict[str, str] | None = None) -> Printer:
        self._read: dict[str, str] = {}
        return Printer(self, renamed=renamed or {})

    def _finished(self, printer: Printer, doc: Sequence[str]) -> list[str]:
        """Return the lines of a method; the last results of devices are taken where engines are read."""
        lines = [f"{local} = self.{generated.sense(name)}.reading" for name, local in self._read.items()]
        printer.lines[printer.reads_at : printer.reads_at] = lines
        return printer.method_lines(doc) if printer.lines or printer.needs or not doc else [*doc]

    def scalar(self, leaf: Name | EngineRead, needs: ReaderKeys) -> str:
        if isinstance(leaf, EngineRead):
            if leaf.function != "age":
                return self.readers.code(leaf, needs)
            return f"self.{generated.sense(leaf.subjects[0].partition('.')[2])}.age"
        if leaf.name in self._received:
            components = self._received[leaf.name]
            return (
                f"{self.names(leaf.name)}[{components.index(leaf.component)}]"
                if leaf.component
                else self.names(leaf.name)
            )
        components = self._devices[leaf.name].components
        return f"{self._reading(leaf.name)}[{components.index(leaf.component) if leaf.component else 0}]"

    def vector(self, leaves: Sequence[Name]) -> str | None:
        if leaves[0].name in self._received:
            return whole_vector(leaves, self._received, self.names)
        components = {name: sensor.components for name, sensor in self._devices.items()}
        return whole_vector(leaves, components, self._reading)

    def _reading(self, sensor: str) -> str:
        self._read[sensor] = (
            self.names.identifier(f"reading {sensor}", sensor)
            if sensor not in self._received
            else self.names(sensor, "reading")
        )
        return self._read[sensor]

    def _resolved(self, tree: Scalar) -> Scalar:
        """Return the tree with the name of each direct sensor replaced by its world function."""
        match tree:
            case Name(name, component) if name not in self._received and name not in self._devices:
                return self._sensors[name].world_value(self._robot.name, component)
            case Op(op, args):
                return Op(op, tuple(map(self._resolved, args)))
            case State(function, args, slot):
                return State(function, tuple(map(self._resolved, args)), slot)
            case Draw(distribution, args, stream):
                return Draw(distribution, tuple(map(self._resolved, args)), stream)
            case _:
                return tree


def sampled_sensors(scenario: Program, robot: Robot) -> dict[str, Sensor]:
    """Return the sensors that are sampled once per timestep, by name: those that are read and are no
    facts."""
    on_board = [value for entry in (*robot.emitted, *robot.commands) for value in entry.scalars]
    computed = [value for entry in scenario.computed_expressions for value in entry.scalars]
    used_names = {leaf.name for value in on_board for leaf in names_in(value)}
    named_sensors = {
        node.subjects[0]
        for value in (*on_board, *computed)
        for node in walk(value)
        if isinstance(node, EngineRead) and _names_sensor(node.function)
    }
    used = [
        sensor
        for sensor in robot.sensors
        if sensor.name in used_names or f"{robot.name}.{sensor.name}" in named_sensors
    ]
    return {sensor.name: sensor for sensor in used if not sensor.is_direct}


def _names_sensor(function: str) -> bool:
    """Return whether a function takes a sensor or a camera, as `age` and `visible` do."""
    entry = FUNCTIONS.get(function)  # None for `present`, which only generated code reads
    return entry is not None and any(param.kinds & {Kind.SENSOR, Kind.CAMERA} for param in entry.params)


def observes_each_timestep(scenario: Program, robot: Robot) -> bool:
    """Return whether anything on board happens once per timestep: a device is sampled, or a memory
    advances."""
    return bool(sampled_sensors(scenario, robot)) or any(
        outer_states(value) for entry in robot.emitted for value in entry.scalars
    )


def controller_names(scenario: Program) -> dict[str, str]:
    """Return the class name of each robot: neither that of a base class, as for `robot`, nor that of another
    robot, as for `arm_1` and `arm1`."""
    names: dict[str, str] = {}
    for robot in scenario.robots:
        taken = {"RobotController", "BatchController", *names.values()}
        names[robot.name] = unused_name(f"{class_name(robot.name)}Controller", taken)
    return names


class ActuatorBindings:
    """The actuators of one robot that have a command: plain motors of the engine, and devices of the
    runtime."""

    def __init__(self, scenario: Program, robot: Robot, constants: Constants) -> None:
        self._robot = robot
        self._constants = constants
        self._model = next(body.model for body in scenario.world.robots if body.name == robot.name)
        self._substep = scenario.world.timestep / scenario.world.substeps
        self._varied = {
            (*variation.of[1:], variation.what)
            for variation in scenario.reset.variations
            if variation.of[:1] == (robot.name,)
        }
        commanded = {entry.name for entry in robot.commands}
        self.actuators = [actuator for actuator in robot.actuators if actuator.name in commanded]

    def bind_lines(self, *, on_columns: bool = False) -> list[str]:
        """Return statements that take each motor from `engine`; for a batch (`on_columns`), devices from the
        single worlds."""
        names = [generated.drive(actuator.name) for actuator in self.actuators]
        apart = [on_columns and self._is_device(actuator) for actuator in self.actuators]
        parts = zip(names, self.actuators, apart, strict=True)
        return [
            f"self.{name} = {f'self.each({quoted(name)})' if single else self._code(actuator)}"
            for name, actuator, single in parts
        ]

    @property
    def has_devices(self) -> bool:
        return any(self._is_device(actuator) for actuator in self.actuators)

    def _code(self, actuator: Actuator) -> str:
        robot = quoted(self._robot.name)
        match actuator:
            case Thrust():
                rotors = [
                    self._rotor(link, actuator.axis, actuator.moment_constant * sense)
                    for link, sense in zip(actuator.links, actuator.spin, strict=True)
                ]
                arguments = [
                    "engine",
                    robot,
                    tuple_code(rotors),
                    repr(self._substep),
                    *_strength(actuator),
                    *_late(actuator),
                ]
                return f"Thrust({', '.join(arguments)})"
            case Cartesian():
                arguments = [
                    "engine",
                    robot,
                    quoted(actuator.link),
                    self._constants.strings(actuator.joints),
                    _limits(actuator),
                ]
                arguments += [f"rpy={actuator.rpy!r}"] if actuator.rpy is not None else []
                return f"Cartesian({', '.join([*arguments, *self._response_arguments(actuator)])})"
            case CustomActuator():
                return f"self.actuator({quoted(actuator.name)})"
            case Motor() if self._is_device(actuator):
                arguments = [
                    "engine",
                    quoted(actuator.kind),
                    robot,
                    self._constants.strings(actuator.joints),
                    _limits(actuator),
                ]
                numbers = (
                    ("stiffness", actuator.stiffness),
                    ("damping", actuator.damping),
                    ("stall_torque", actuator.stall_torque),
                    ("no_load_speed", actuator.no_load_speed),
                )
                arguments += [f"{name}={number!r}" for name, number in numbers if number is not None]
                return f"Motor({', '.join([*arguments, *self._response_arguments(actuator)])})"
            case Motor():
                return self._engine_motor(robot, actuator)

    def _engine_motor(self, robot: str, motor: Motor) -> str:
        """Return the code of a motor of the engine, whose values do not change within an episode."""
        strength = motor.response.strength
        arguments = [robot, self._constants.strings(motor.joints), _limits(motor, strength)]

        def for_each_joint(value: float) -> str:
            return constants_tuple_code([repr(value)] * len(motor.joints))

        if motor.kind == "position_motor":
            gains = (motor.stiffness, motor.damping)
            arguments += ["None" if gain is None else for_each_joint(strength * gain) for gain in gains]
        if motor.stall_torque is not None and motor.no_load_speed is not None:
            arguments += [
                f"stall_torque={for_each_joint(strength * motor.stall_torque)}",
                f"no_load_speed={for_each_joint(motor.no_load_speed)}",
            ]
        return f"engine.{motor.kind}({', '.join(arguments)})"

    def _is_device(self, actuator: Actuator) -> bool:
        if not isinstance(actuator, Motor):
            return True
        varies = any(
            self._varies(actuator, value) for value in ("strength", "max_torque", "stiffness", "damping")
        )
        return (
            varies
            or self._acts_each_substep(actuator)
            # The engine gets scaled limits, but only `Motor` also scales the targets of a torque motor.
            or (actuator.kind == "torque_motor" and actuator.response.strength != 1.0)
        )

    def _acts_each_substep(self, actuator: Motor | Cartesian) -> bool:
        """Return whether it follows its commands in every substep, rather than at once."""
        response = actuator.response
        late = (
            response.delay > 0.0
            or response.time_constant > 0.0
            or self._varies(actuator, "delay")
            or self._varies(actuator, "time_constant")
        )
        return late or bool(_rates(actuator))

    def _response_arguments(self, actuator: Motor | Cartesian) -> list[str]:
        """Return the arguments for the strength and the response of the actuator."""
        if not self._acts_each_substep(actuator):
            return _strength(actuator)
        rates = _rates(actuator)
        limited = [f"rates={constants_tuple_code([_number(rate) for rate in rates])}"] if rates else []
        return [*_strength(actuator), f"substep={self._substep!r}", *_late(actuator), *limited]

    def _varies(self, actuator: Actuator, key: str) -> bool:
        return (actuator.name, f"actuator_{key}") in self._varied

    def _rotor(self, link: str, axis_name: str, moment_constant: float) -> str:
        """Return the link that carries a rotor, where on it the rotor sits, its axis and its moment
        constant. A rotor without mass sits at the origin of its <inertial>, as in the files of
        gym-pybullet-drones."""
        carrier, frame = rigid_root(self._model, link)
        inertial = self._model.link(link).inertial
        if inertial is not None and inertial.mass == 0.0:
            frame = frames.compose(frame, (inertial.origin.xyz, frames.IDENTITY_ROTATION))
        position, rotation = frame
        x, y, z = (float(name == axis_name) for name in "xyz")
        axis = frames.rotate(rotation, (x, y, z))
        return f"({quoted(carrier)}, {position!r}, {axis!r}, {moment_constant!r})"


def _strength(actuator: Actuator) -> list[str]:
    return [f"strength={actuator.response.strength!r}"] if actuator.response.strength != 1.0 else []


def _late(actuator: Actuator) -> list[str]:
    values = (("delay", actuator.response.delay), ("time_constant", actuator.response.time_constant))
    return [f"{name}={value!r}" for name, value in values if value]


def _rates(motor: Motor | Cartesian) -> Sequence[float | None]:
    """Return the rates at which the targets of each joint may change; empty if at once."""
    if isinstance(motor, Motor) and motor.kind == "velocity_motor" and motor.max_acceleration is not None:
        return (motor.max_acceleration,) * len(motor.joints)
    if (isinstance(motor, Cartesian) or motor.kind == "position_motor") and any(
        limit is not None for limit in motor.max_velocity
    ):
        return motor.max_velocity
    return ()


def _limits(motor: Motor | Cartesian, strength: float = 1.0) -> str:
    return constants_tuple_code([_number(limit, strength) for limit in motor.max_torque])


def _number(limit: float | None, strength: float = 1.0) -> str:
    return "inf" if limit is None else repr(strength * limit)
