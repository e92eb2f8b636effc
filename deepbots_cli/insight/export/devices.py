"""The inputs and outputs of an exported policy, each with all facts that a robot needs, and their values in
a simulation.

Inputs are sensors of robots, readings of the world and goals; outputs are the commands of actuators, with
their limits and their safe posture.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Generator, Mapping, Sequence
from contextlib import closing
from dataclasses import replace
from functools import partial
from itertools import product
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from deepbots_cli import api
from deepbots_cli.arrays import evaluate
from deepbots_cli.errors import DeepbotsError
from deepbots_cli.expressions.dimensions import ANGLE, LENGTH, NUMBER
from deepbots_cli.expressions.functions import FUNCTIONS
from deepbots_cli.expressions.intervals import Interval
from deepbots_cli.expressions.scalar import EngineRead, Name, Scalar
from deepbots_cli.expressions.types import SPACE, Constant, ValueType
from deepbots_cli.program import Program, generated
from deepbots_cli.program.identity import Deployment, reading_key
from deepbots_cli.program.robots import (
    Cartesian,
    Command,
    CustomActuator,
    Link,
    MessageField,
    Motor,
    NoiseModel,
    Robot,
    Sensor,
    Thrust,
)
from deepbots_cli.program.topics import components_of
from deepbots_cli.program.values import Expression
from deepbots_cli.records import dataclass
from deepbots_cli.robots.model import Pose
from deepbots_cli.rollout import Start, steps
from deepbots_cli.rollout.episode import Driver
from deepbots_cli.runtime import Supervisor
from deepbots_cli.scenario.sensors import SENSORS, JointSensor
from deepbots_robot.model import Input, Mount, Output

if TYPE_CHECKING:
    from deepbots_cli.insight.export.control import ControlStep


_AGES_WITHIN = 3
"""The number of its periods after which a value without a new one is too old."""


@dataclass(frozen=True)
class Reading:
    """An input, and where a simulation has its value.

    `trees` are the expressions of the supervisor, one per component. For a sampled sensor, `device` names
    robot and sensor.
    """

    info: Input
    trees: tuple[Scalar, ...] = ()
    device: tuple[str, str] | None = None


class Readings:
    """Describes the inputs of a program."""

    def __init__(self, program: Program, timestep: float | None = None) -> None:
        """Create the inputs. `timestep` is the time between two calls of the policy in s, by default that
        between two actions."""
        self._program = program
        self._timestep = timestep or program.period
        self.deployment = Deployment(program)
        self._supplied_by = {reading_key(key): " ".join(text.split()) for key, text in program.supplied_by}
        self.direct = self.deployment.sensed
        """The readings of the world that are components of a sensor."""

    def sensor(self, robot: Robot, sensor: Sensor) -> Reading:
        """Describe a sensor of a robot with the values that the supervisor gets."""
        kind, faults = SENSORS[sensor.kind], sensor.faults or NoiseModel()
        of_joints = issubclass(kind, JointSensor)
        name = f"{robot.name}.{sensor.name}"
        world = kind.world_function is not None and bool(components_of(kind.world_function))
        number_type = "bool" if sensor.boolean else "float64"
        own_frame = sensor.subjects[0] if sensor.components == SPACE and not of_joints else None
        info = self._input(
            name,
            robot=robot.name,
            source="sensor",
            sensor=sensor.kind,
            joints=sensor.subjects if of_joints else (),
            link=None if of_joints else sensor.subjects[0],
            mount=Mount(xyz=sensor.mount.xyz, rpy=sensor.mount.rpy) if sensor.mount != Pose() else None,
            shape=sensor.optics.shape if sensor.optics else (len(sensor.components) or 1,),
            dtype="uint8" if sensor.optics else number_type,
            components=sensor.components,
            unit=unit_text(sensor.unit),
            frame="world" if world else own_frame,
            range=_sensor_range(sensor, faults, kind.interval),
            period=faults.period * self._program.world.timestep,
            latency=faults.latency,
        )
        if not self._program.is_direct(robot, "from_robot"):
            return Reading(
                info,
                tuple(
                    Name(f"{robot.name}.{_field(robot, sensor)}", component)
                    for component in sensor.components or (None,)
                ),
            )
        if sensor.is_direct:
            return Reading(
                info,
                tuple(
                    sensor.world_value(robot.name, component) for component in sensor.components or (None,)
                ),
            )
        return Reading(info, device=(robot.name, sensor.name))

    def of_world(self, read: EngineRead) -> tuple[Reading, int]:
        """Describe a reading of the world by the supervisor, with the index of the number in it."""
        components = components_of(read.function)
        function = FUNCTIONS.get(read.function)
        joint = self.deployment.joints.get(read.subjects[0])
        if joint is None:
            shared = NUMBER
        elif joint.type == "prismatic":
            shared = LENGTH
        else:
            shared = ANGLE
        truth = function is None or function.boolean
        name = self.deployment.name(read)
        interval = function.interval() if function is not None and read.function == "orientation" else None
        robot = read.subjects[0].partition(".")[0]
        robots = {entry.name for entry in self._program.robots}
        info = self._input(
            name,
            robot=robot if robot in robots else None,
            source="sensor" if self.deployment.is_measured(read) else "supervisor",
            supplied_by=self._supplied_by.get(name),
            sensor=read.function,
            joints=(joint.name,) if joint is not None else (),
            shape=(len(components) or 1,),
            dtype="bool" if truth else "float64",
            components=components,
            unit="" if truth or function is None else unit_text(function.result(shared)),
            frame="world" if components else None,
            range=None
            if truth
            else _ends([interval or Interval(-math.inf, math.inf)] * (len(components) or 1)),
        )
        whole = [EngineRead(read.function, read.subjects, component) for component in components] or [read]
        return Reading(info, tuple(whole)), components.index(read.component) if read.component else 0

    def parameter(self, value: Expression) -> Reading:
        """Describe a parameter that an episode draws. On a robot, a person or program sets it."""
        value_type = value.typed.type
        parts = value.components or (None,)
        info = self._input(
            value.name,
            source="goal",
            supplied_by=self._supplied_by.get(value.name),
            shape=(len(parts),),
            dtype="bool" if value_type.boolean else "float64",
            components=value.components,
            unit="" if value_type.boolean else unit_text(value_type.dimension),
            range=None
            if value_type.boolean
            else _ends([value_type.interval_of(component) for component in parts]),
            max_age_s=None,
        )
        return Reading(info, tuple(Name(value.name, component) for component in parts))

    def heard(self, link: Link, value: Expression) -> Reading:
        """Describe what a robot hears from another one. It arrives a timestep after it was sent, and after
        the latency of the link."""
        entry, route = MessageField.from_expression(value), link.route
        slowest = 0.0 if route.latency is None else route.latency.typed.type.interval.high
        name, parts = f"{link.receiver}.{value.name}", value.components or (None,)
        info = self._input(
            name,
            robot=link.receiver,
            source="supervisor",
            supplied_by=self._supplied_by.get(name, f"messages of {link.sender}"),
            shape=(len(parts),),
            dtype=entry.dtype,
            components=value.components,
            unit=unit_text(entry.unit),
            range=None,
            latency=self._program.world.timestep + (slowest if math.isfinite(slowest) else 0.0),
        )
        return Reading(info, tuple(Name(name, component) for component in parts))

    def _input(
        self,
        name: str,
        *,
        period: float | None = None,
        latency: float = 0.0,
        components: Sequence[str] = (),
        **fields: object,
    ) -> Input:
        step = self._timestep
        values: dict[str, Any] = {
            "robot": None,
            "supplied_by": None,
            "sensor": None,
            "joints": (),
            "link": None,
            "mount": None,
            "frame": None,
            "rate_hz": round(1.0 / (period or step), 9),
            "latency_s": latency,
            "max_age_s": round(latency + _AGES_WITHIN * max(period or step, step), 9),
        }
        return Input(name=name, components=tuple(components), **{**values, **fields})


def _field(robot: Robot, sensor: Sensor) -> str:
    """Return the field of a message that carries a sensor as it is."""
    parts = tuple(Name(sensor.name, component) for component in sensor.components or (None,))
    return next((entry.name for entry in robot.emit if entry.scalars == parts), sensor.name)


def _sensor_range(
    sensor: Sensor, faults: NoiseModel, interval: Interval
) -> tuple[tuple[float | None, ...], ...] | None:
    """Return the range of the readings: the one that the sensor clips to, or that of its kind where nothing
    is added to the value."""
    count = len(sensor.components) or 1
    if sensor.optics is not None or sensor.boolean:
        return None
    if faults.low:
        return _ends([Interval(low, high) for low, high in zip(faults.low, faults.high, strict=True)])
    exact = sensor.faults is None and sensor.beams is None
    return _ends([interval if exact else Interval(-math.inf, math.inf)] * count)


def _ends(intervals: Sequence[Interval]) -> tuple[tuple[float | None, ...], tuple[float | None, ...]]:
    """Return the lower and the upper ends, None where there is none."""
    return tuple(finite(interval.low) for interval in intervals), tuple(
        finite(interval.high) for interval in intervals
    )


def finite(number: float | None) -> float | None:
    """Return the number; None for one that is infinite."""
    return number if number is not None and math.isfinite(number) else None


def unit_text(unit: object) -> str:
    """Return the unit of a dimension; empty for a plain number."""
    return "" if str(unit) == "1" else str(unit)


_KINDS = {"velocity_motor": "velocity", "position_motor": "position", "torque_motor": "effort"}
_UNITS = {"velocity": ("rad/s", "m/s"), "position": ("rad", "m"), "effort": ("N*m", "N")}
"""The units for revolute and for prismatic joints."""
_ROUNDING = 1e-9

Array = NDArray[Any]


def output(program: Program, robot: Robot, command: Command) -> Output:
    """Return the command of an actuator."""
    actuator, count = command.actuator, len(command.components)
    model = next(body.model for body in program.world.robots if body.name == robot.name)
    joints = [model.joint(name) for name in getattr(actuator, "joints", ())]
    kind, unit, links = "", unit_text(command.target.typed.type.dimension), tuple[str, ...]()
    limits: list[tuple[float, float]] = [(-math.inf, math.inf)] * count
    rates: Sequence[float | None] = (None,) * count
    match actuator:
        case Motor():
            kind = _KINDS[actuator.kind]
            unit = _UNITS[kind][joints[0].type == "prismatic"]
            ends = actuator.max_velocity if kind == "velocity" else actuator.max_torque
            limits = [(-_or(end, math.inf), _or(end, math.inf)) for end in ends]
            if kind == "position":
                ranges = [joint.limit for joint in joints]
                limits = [(_or(joint.lower, -math.inf), _or(joint.upper, math.inf)) for joint in ranges]
                rates = actuator.max_velocity
            elif kind == "velocity":
                rates = (actuator.max_acceleration,) * count
        case Thrust():
            kind, unit, links, limits = "thrust", "N", actuator.links, [(actuator.low, actuator.high)] * count
        case Cartesian():
            kind, unit, links = "cartesian", "m", (actuator.link,)
        case CustomActuator():
            kind = actuator.kind
            limits = [(_or(actuator.low, -math.inf), _or(actuator.high, math.inf))] * count
    low, high = (tuple(finite(end) for end in ends) for ends in zip(*_within(command, limits), strict=True))
    return Output(
        name=f"{robot.name}.{command.name}",
        robot=robot.name,
        actuator=command.name,
        kind=kind,
        joints=tuple(joint.name for joint in joints),
        links=links,
        shape=(count,),
        dtype="float64",
        components=tuple(command.components),
        unit=unit,
        frame="world" if kind == "cartesian" else None,
        range=(low, high),
        max_rate=tuple(map(finite, rates)),
        max_effort=() if isinstance(actuator, Thrust) else tuple(map(finite, actuator.max_torque)),
        stiffness=actuator.stiffness if isinstance(actuator, Motor) else None,
        damping=actuator.damping if isinstance(actuator, Motor) else None,
        attitude=actuator.rpy if isinstance(actuator, Cartesian) else None,
        safe=tuple(_safe(kind, *ends) for ends in zip(low, high, strict=True)),
    )


def _or(number: float | None, default: float) -> float:
    return default if number is None else number


def _within(command: Command, limits: Sequence[tuple[float, float]]) -> list[tuple[float, float]]:
    """Return the limits of each component. For a component without a limit, this is the largest command of
    the scenario."""
    target_type = command.target.typed.type
    components = target_type.components or (None,) * len(limits)
    intervals = []
    for (low, high), component in zip(limits, components, strict=False):
        reach = target_type.interval_of(component)
        ends = sorted(command.opening) if command.opening else (reach.low, reach.high)
        intervals.append(
            (
                low if math.isfinite(low) else min(ends[0], high),
                high if math.isfinite(high) else max(ends[1], low),
            )
        )
    return intervals


def _safe(kind: str, low: float | None, high: float | None) -> float | None:
    """Return the command that stands still: no speed, torque or thrust; joints and links stay where they were
    commanded."""
    if kind not in ("velocity", "effort", "thrust"):
        return None
    return min(max(0.0, 0.0 if low is None else low), math.inf if high is None else high)


def linear(program: Program, targets: Sequence[Scalar]) -> tuple[Array, Array] | None:
    """Return a matrix (targets, numbers of the action) and an offset if each target is matrix @ action +
    offset, with the action in [-1, 1]; else None."""
    parts = [
        (interval, component)
        for interval in program.agent.ranges
        for component in interval.components or (None,)
    ]
    count = len(parts)
    # Zeros and unit vectors give offset and matrix; random actions then show a clamp or a product.
    dice = np.random.default_rng(0).uniform(-1.0, 1.0, (20, count))
    actions = np.concatenate([np.zeros((1, count)), np.eye(count), dice])
    values = _evaluated(
        targets,
        {
            Name(interval.name, component): (interval.high + interval.low) / 2
            + (interval.high - interval.low) / 2 * column
            for (interval, component), column in zip(parts, actions.T, strict=True)
        },
    )
    if values is None:
        return None
    offset, matrix = values[0], (values[1 : count + 1] - values[0]).T
    fits = np.allclose(values, actions @ matrix.T + offset, rtol=0.0, atol=_ROUNDING)
    return (matrix, offset) if fits else None


def tabulated(program: Program, targets: Sequence[Scalar]) -> Array | None:
    """Return the targets of each combination of options, the last choice changing first: (combinations,
    targets); None if they need more."""
    combinations = [*product(*(choice.options for choice in program.agent.choices))]
    variables = [name for choice in program.agent.choices for name in choice.variables]
    rows = np.array(
        [[value for option in options for value in option.values] for options in combinations], float
    )
    return _evaluated(targets, {Name(name): column for name, column in zip(variables, rows.T, strict=True)})


def _evaluated(targets: Sequence[Scalar], names: Mapping[Name, Array]) -> Array | None:
    """Return the targets for rows of values; None for a target that reads sensors, or has a memory."""
    count = len(next(iter(names.values())))
    try:
        return np.stack([np.broadcast_to(evaluate(tree, names), count) for tree in targets], axis=1)
    except DeepbotsError:
        return None


_PREFIX = "export_"
_SEED = 20_000
_NUMPY_TYPES = {"float64": np.float64, "bool": np.bool_, "uint8": np.uint8}


class RecordedStep(NamedTuple):
    """A call of a policy: the value of each input before it, the commands during it, and the action. `first`
    begins an episode."""

    first: bool
    inputs: Mapping[str, Array]
    commands: Mapping[str, Array]
    action: Any


def recorded_steps(
    step: ControlStep, make_driver: Callable[[Supervisor], Driver], *, engine: str | None = None
) -> Generator[RecordedStep, None, None]:
    """Yield the steps of episodes without end, one after the other. For copies of a robot, these are the
    steps of the first copy.

    Args:
        make_driver: Returns the driver for the environment.
    """
    readings = [*step.readings.values()]
    with closing(api.build(with_probes(_as_exported(step.program), readings), engine=engine)) as world:
        agent = next(iter(world.agents.values()))
        watch = Watch(agent, readings, step.outputs)
        noted = _noted_observations(agent, watch)
        driver = make_driver(world)
        number = 0
        while True:
            inputs: Mapping[str, Array] = {}
            for recorded in steps(world, driver, Start(_SEED + number)):
                observed = [*noted]
                noted.clear()
                if recorded.number:
                    action = recorded.action if agent is world else recorded.action[0]
                    between = observed[:-1] if step.repeat > 1 else []
                    for index, step_inputs in enumerate([inputs, *between]):
                        yield RecordedStep(
                            recorded.number == 1 and index == 0, step_inputs, watch.commands(), action
                        )
                inputs = observed[-1]
            number += 1


def with_probes(program: Program, readings: Sequence[Reading]) -> Program:
    """Return the program whose supervisor stores the readings of the world."""
    probes = []
    for number, reading in enumerate(readings):
        if reading.device is None:
            first_value = program.agent.observation[0].value
            count = len(reading.trees)
            components = tuple(f"c{index}" for index in range(count)) if count > 1 else None
            typed = Constant(
                ValueType(components=components, boolean=reading.info.dtype == "bool"), 0, 0, (0.0,) * count
            )
            name = f"{_PREFIX}{number}"
            probe = Expression(
                name,
                first_value.span,
                reading.info.name,
                typed,
                f"signals.{name}",
                lowered=tuple(reading.trees),
            )
            probes.append(probe)
    stored = program.stored_signals | {probe.name for probe in probes}
    return replace(program, signals=(*program.signals, *probes), stored_signals=stored)


def _as_exported(program: Program) -> Program:
    """Return the program without the noise that the supervisor adds, which a bundle leaves out. Rewards and
    endings in Python are removed too, because they are not needed."""
    agent, others = program.agent, program.others
    if others is not None:
        program = replace(program, others=replace(others, world=_as_exported(others.world)))
    program = program.with_agent(
        observation=tuple(replace(entry, noise=None) for entry in agent.observation),
        goal=agent.goal and replace(agent.goal, achieved=replace(agent.goal.achieved, noise=None)),
        reward=tuple(term for term in agent.reward if term.foreign is None),
    )
    signals = tuple(replace(signal, noise=None) for signal in program.signals)
    return replace(
        program,
        endings=tuple(ending for ending in program.endings if ending.foreign is None),
        signals=signals,
    )


def _noted_observations(agent: Supervisor, watch: Watch) -> list[dict[str, Array]]:
    """Return a list that gets the inputs of each further timestep, after which the supervisor observes."""
    noted: list[dict[str, Array]] = []
    world: Any = getattr(agent, "supervisor", agent)  # that of several agents observes for all of them
    observe = world._observe

    def observing(*action: Any) -> None:
        observe(*action)
        noted.append(watch.inputs())

    world._observe = observing
    return noted


class Watch:
    """Reads inputs from a supervisor, and records the commands that its robots apply."""

    def __init__(self, agent: Supervisor, readings: Sequence[Reading], outputs: Sequence[Output]) -> None:
        self._readers = {
            reading.info.name: self._reader(agent, number, reading) for number, reading in enumerate(readings)
        }
        self._infos = {reading.info.name: reading.info for reading in readings}
        self._commands: dict[str, Array] = {}
        self.drives: list[_Drive] = []
        """The actuators that record their commands."""
        for output in outputs:
            controller, attribute = agent.controllers[output.robot], generated.drive(output.actuator)
            drive = _Drive(getattr(controller, attribute), partial(self._note, output.name))
            setattr(controller, attribute, drive)
            self.drives.append(drive)
        for robot in {output.robot for output in outputs}:
            if not agent.scenario.is_direct(
                next(entry for entry in agent.scenario.robots if entry.name == robot), "to_robot"
            ):
                self._apply_when_sent(agent, robot)

    def _apply_when_sent(self, agent: Supervisor, robot: str) -> None:
        """Record the commands of a message when it is sent, because it may be late or be lost on the way."""
        channel, controller = agent.channels[robot, "to_robot"], agent.controllers[robot]
        drives = [drive for drive in vars(controller).values() if isinstance(drive, _Drive)]
        send = channel.send
        for drive in drives:
            drive.switch(notes=False, acts=True)

        def sending(values: Sequence[Any]) -> Any:
            for drive in drives:
                drive.switch(notes=True, acts=False)
            controller.use_message_data(values)  # type: ignore[attr-defined]
            for drive in drives:
                drive.switch(notes=False, acts=True)
            return send(values)

        channel.send = sending  # type: ignore[method-assign, assignment]

    def _note(self, name: str, targets: Sequence[float]) -> None:
        self._commands[name] = np.array([*targets], np.float64)

    @staticmethod
    def _reader(agent: Supervisor, number: int, reading: Reading) -> Callable[[], Any]:
        if reading.device is None:
            return lambda: getattr(agent, generated.last(f"{_PREFIX}{number}"))
        robot, sensor = reading.device
        device = agent.controllers[robot].device(sensor)
        return lambda: device.reading

    def inputs(self) -> dict[str, Array]:
        """Return the value of each input now."""
        inputs: dict[str, Array] = {}
        for name, read in self._readers.items():
            info, value = self._infos[name], read()
            if info.dtype == "uint8":
                value = value[0] if isinstance(value, tuple | list) else value
            inputs[name] = np.array(value, _NUMPY_TYPES[info.dtype]).reshape(info.shape)
        return inputs

    def commands(self) -> dict[str, Array]:
        """Return the commands of this step."""
        return dict(self._commands)


class _Drive:
    """An actuator that records its commands; for everything else the actuator itself."""

    def __init__(
        self, drive: Callable[[Sequence[float]], object], note: Callable[[Sequence[float]], None]
    ) -> None:
        # `__setattr__` passes each attribute on to the actuator, so the attributes of this object bypass it.
        vars(self).update(drive=drive, note=note, notes=True, acts=True)

    def __call__(self, targets: Sequence[float]) -> None:
        targets = [*targets]
        if self.notes:
            self.note(targets)
        if self.acts:
            self.drive(targets)

    def __getattr__(self, name: str) -> Any:
        return getattr(vars(self)["drive"], name)

    def __setattr__(self, name: str, value: Any) -> None:
        setattr(vars(self)["drive"], name, value)

    def switch(self, *, notes: bool, acts: bool) -> None:
        """Set whether the actuator records commands, and whether it passes them on."""
        vars(self).update(notes=notes, acts=acts)
