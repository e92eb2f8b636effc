"""The controllers of robots, which read their sensors and act on messages, with the paths of messages;
actuators that are more than a motor of the engine, because they act in every substep or change from episode
to episode; and pushes.

Response               the response of an actuator to its commands: delay, lag, limited rates
Motor, Cartesian       joints that are driven together, and arms that bring a link to a position
CustomMotor            joints that the control law of a plug-in drives
Thrust, Push           forces on links: rotors, and disturbances of an episode
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from functools import partial
from math import ceil, exp, inf
from typing import Any, NamedTuple, TypeVar

from deepbots_cli import frames
from deepbots_cli.errors import MessageError
from deepbots_cli.frames import Triple, quaternion
from deepbots_cli.plugins import import_attribute
from deepbots_cli.port import ZERO_VECTOR, Engine, MotorWriter, Part, Pusher
from deepbots_cli.program import Program, generated
from deepbots_cli.program.robots import Actuator, CustomActuator, Direction, MessageLayout, MotorKind, Robot
from deepbots_cli.program.robots import Motor as MotorSpec
from deepbots_cli.runtime.formulas import Memories, Memory, memory_of_vector
from deepbots_cli.runtime.messages import Channel, FieldCodec, LossyChannel, layout_error
from deepbots_cli.runtime.readers import sees
from deepbots_cli.runtime.sensing import Device, instrument
from deepbots_cli.runtime.streams import Streams

_TIME_TOLERANCE = 1e-9  # the error of a sum of durations, as a share of a substep
PerJoint = float | Sequence[float]
"""A value for all joints, or one for each."""


class Response:
    """The response of an actuator to its commands, from substep to substep.

    A command takes effect in the first substep that begins `delay` after it was sent, or later. From there on
    the followed value approaches it: in a substep of h seconds by the share 1 - exp(-h / time_constant) of
    the difference, a lag of first order exactly, and by at most `rate` * h. It starts from `initial_value`
    when the first command takes effect.

    `delay` and `time_constant` are in s. A new value takes effect at the next `reset`; a negative one, which
    a normal distribution may draw, counts as 0. `rates` are positive, in units of the command per s, one per
    component, and fixed when the response is created.
    """

    def __init__(
        self,
        substep: float,
        initial_value: Callable[[], Sequence[float]],
        delay: float = 0.0,
        time_constant: float = 0.0,
        rates: Sequence[float] = (),
    ) -> None:
        """Create a response; `substep` is the length of a substep, s; without `rates` a command may jump."""
        self.delay = delay
        self.time_constant = time_constant
        self._substep = substep
        self._initial_value = initial_value
        self._max_changes = [rate * substep for rate in rates]
        self._sent: deque[tuple[int, Sequence[float]]] = deque()
        self.reset()

    def reset(self) -> None:
        """Forget all commands."""
        self._sent.clear()
        self._now = 0
        self._wait = max(0, ceil(self.delay / self._substep - _TIME_TOLERANCE))
        self._share = 1.0 - exp(-self._substep / self.time_constant) if self.time_constant > 0.0 else 1.0
        self._jumps = self._share == 1.0 and not self._max_changes
        self._goal: Sequence[float] = ()
        self._value: Sequence[float] | None = None
        self._still = True

    def start(self, value: Sequence[float]) -> None:
        """Set the value that is followed before any command."""
        self._value = value

    def send(self, command: Sequence[float]) -> None:
        self._sent.append((self._now + self._wait, command))

    def advance(self) -> Sequence[float] | None:
        """Return the value that is followed in this substep; None if it has not changed, or if there is
        none."""
        sent = self._sent
        while sent and sent[0][0] <= self._now:
            self._goal = sent.popleft()[1]
            self._still = False
        self._now += 1
        if self._still:
            return None
        if self._jumps:
            self._still = True
            return self._goal
        before = self._initial_value() if self._value is None else self._value
        share = self._share
        after = [old + share * (goal - old) for old, goal in zip(before, self._goal, strict=True)]
        if self._max_changes:
            after = list(map(_within_rate, before, after, self._max_changes))
        self._still = self._value is not None and after == before
        self._value = after
        return after


def _within_rate(old: float, new: float, max_change: float) -> float:
    """Return `new`, at most `max_change` away from `old`."""
    if new - old > max_change:
        return old + max_change
    return old - max_change if new - old < -max_change else new


class Motor:
    """Joints that are driven together; called with one target per joint.

    `strength` multiplies the torque or force that the motor would exert without it: its limit, the gains of
    its spring, the target of a torque motor, its stall torque. Strength, limits and gains may be set between
    two episodes and are in force from the next `reset`.
    """

    def __init__(
        self,
        engine: Engine,
        kind: MotorKind,
        robot: str,
        joints: Sequence[str],
        max_torque: PerJoint,
        *,
        stiffness: PerJoint | None = None,
        damping: PerJoint | None = None,
        stall_torque: float | None = None,
        no_load_speed: float | None = None,
        strength: PerJoint = 1.0,
        substep: float | None = None,
        delay: float = 0.0,
        time_constant: float = 0.0,
        rates: Sequence[float] = (),
    ) -> None:
        """Create a motor; `rates` bounds how fast targets change, in their unit per s. With `stall_torque`
        (N m or N) and `no_load_speed` (rad/s or m/s), its torque falls with its speed.

        With `substep`, the length of one in s, the motor follows its commands in every substep; without, at
        once.
        """
        self.max_torque = max_torque
        self.stiffness = stiffness
        self.damping = damping
        self.strength = strength
        self._stall_torque = stall_torque
        self._no_load_speed = no_load_speed
        self._engine = engine
        self._kind = kind
        self._robot = robot
        self._joints = joints
        self._states = engine.joint_states(robot, joints)
        self._bound: object = None
        self.response = (
            None if substep is None else Response(substep, self._rest, delay, time_constant, rates)
        )
        self.reset()
        if self.response is not None:
            engine.before_substep(self._act)

    def __call__(self, targets: Sequence[float]) -> None:
        if self.response is None:
            self._exert(targets)
        else:
            self.response.send(targets)

    def reset(self) -> None:
        """Apply the present strength, limits and gains, and discard all commands."""
        bound = (self.max_torque, self.stiffness, self.damping, self.strength)
        if bound != self._bound:
            self._bound = bound
            self._bind()
        if self.response is not None:
            self.response.reset()

    def hold(self) -> None:
        """Keep the joints where they are, as far as a motor of this kind can."""
        if self._kind != "torque_motor":
            targets = self._rest()
            self._exert(targets)
            if self.response is not None:
                self.response.start(targets)

    def _rest(self) -> Sequence[float]:
        """Return the targets at which the joints stay where they are."""
        if self._kind == "position_motor":
            return [state[0] for state in self._states()]
        return [0.0] * len(self._joints)

    def _act(self) -> None:
        targets = self.response.advance() if self.response is not None else None
        if targets is not None:
            self._exert(targets)

    def _exert(self, targets: Sequence[float]) -> None:
        if self._kind == "torque_motor":
            targets = [share * target for share, target in zip(self._shares, targets, strict=True)]
        self._write(targets)

    def _bind(self) -> None:
        # A normal distribution may draw a negative strength.
        self._shares = [max(0.0, strength) for strength in self._each(self.strength)]
        limits = [
            share * limit if limit < inf else inf
            for share, limit in zip(self._shares, self._each(self.max_torque), strict=True)
        ]
        gains = (
            (self._scaled(self.stiffness), self._scaled(self.damping))
            if self._kind == "position_motor"
            else ()
        )
        self._write: MotorWriter = getattr(self._engine, self._kind)(
            self._robot, self._joints, limits, *gains, **self._torque_curve()
        )

    def _torque_curve(self) -> dict[str, list[float]]:
        """Return stall torque and no-load speed of each joint as arguments of the engine, if there are
        any."""
        if self._stall_torque is None or self._no_load_speed is None:
            return {}
        return {
            "stall_torque": [share * self._stall_torque for share in self._shares],
            "no_load_speed": [self._no_load_speed] * len(self._shares),
        }

    def _scaled(self, gain: PerJoint | None) -> list[float] | None:
        """Return a gain of the spring in each joint, as strong as that motor is."""
        return (
            None
            if gain is None
            else [
                share * max(0.0, value) for share, value in zip(self._shares, self._each(gain), strict=True)
            ]
        )

    def _each(self, values: PerJoint) -> Sequence[float]:
        return (values,) * len(self._joints) if isinstance(values, (int, float)) else values


class Cartesian(Motor):
    """Brings the origin of a link to a position (m, world frame); called with x, y and z.

    Joint positions are computed once per command, from the present positions and within their ranges; a
    target out of reach is approached. The engine's servo then drives the joints there, with the delay, time
    constant and rates of a `Motor`.
    """

    def __init__(
        self,
        engine: Engine,
        robot: str,
        link: str,
        joints: Sequence[str],
        max_torque: PerJoint,
        *,
        rpy: tuple[float, float, float] | None = None,
        **response: Any,
    ) -> None:
        """Create the actuator. `rpy` (rad) is the attitude that the link keeps; without, it may have any.
        `response` are further arguments of a `Motor`."""
        self._solve = engine.inverse_kinematics((robot, link), joints)
        self.attitude = None if rpy is None else quaternion(*rpy)
        self.watch: Callable[[Triple, Sequence[float]], object] | None = None
        """The function called with the position of each command (m, world frame) and the joint positions
        computed for it (rad or m)."""
        super().__init__(engine, "position_motor", robot, joints, max_torque, **response)

    def __call__(self, targets: Sequence[float]) -> None:
        x, y, z = targets
        solution = self._solve((x, y, z), self.attitude)
        if self.watch is not None:
            self.watch((x, y, z), solution)
        super().__call__(solution)


# Actuators of plug-ins


def _nothing() -> None:
    """Do nothing, as a control law without a memory at a reset."""


class ControlLaw(NamedTuple):
    """The response of an actuator to its commands.

    `act` is called before every engine step, from the first command on. It gets the command in SI units, one
    value per joint, after delay and time constant, and returns the torque (N m) or force (N) on each joint;
    strength and `max_torque` are applied to it. `restart` begins an episode. `rest` gives the command that
    keeps the joints where they are until the first one; without it the actuator exerts nothing until then.
    """

    act: Callable[[Sequence[float]], Sequence[float]]
    restart: Callable[[], None] = _nothing
    rest: Callable[[], Sequence[float]] | None = None


class Site(NamedTuple):
    """The context from which `drive` of an actuator kind creates a control law. `substep` is the length of an
    engine step, s."""

    engine: Engine
    robot: str
    actuator: CustomActuator
    substep: float

    @property
    def joints(self) -> tuple[str, ...]:
        return self.actuator.joints

    @property
    def parameters(self) -> dict[str, Any]:
        """The parameters that only this kind has, in SI units."""
        return dict(self.actuator.parameters)


class CustomMotor(Motor):
    """Joints that a control law drives; called with one command per joint.

    Raises:
        EngineError: The robot has no such joint.
    """

    def __init__(self, site: Site) -> None:
        actuator = site.actuator
        response = site.actuator.response
        self._law: ControlLaw = import_attribute(actuator.drive)(site)
        limits = [inf if limit is None else limit for limit in actuator.max_torque]
        super().__init__(
            site.engine,
            "torque_motor",
            site.robot,
            actuator.joints,
            limits,
            strength=response.strength,
            substep=site.substep,
            delay=response.delay,
            time_constant=response.time_constant,
        )

    def reset(self) -> None:
        super().reset()
        self._command: Sequence[float] | None = None
        self._law.restart()

    def hold(self) -> None:
        if self._law.rest is not None and self.response is not None:
            self._command = self._law.rest()
            self.response.start(self._command)

    def _rest(self) -> Sequence[float]:
        return super()._rest() if self._law.rest is None else self._law.rest()

    def _act(self) -> None:
        command = self.response.advance() if self.response is not None else None
        if command is not None:
            self._command = command
        if self._command is not None:
            self._exert(self._law.act(self._command))


# Forces on links

Rotor = tuple[str, Triple, Triple, float]
"""The link that carries it, its place and axis in the frame of that link, and its moment constant (m),
negative for the other sense."""


class Thrust:
    """Pushes links in every substep; called with one thrust (N) per rotor.

    A thrust t along the axis comes with a torque moment_constant * t (N m) about it, which the air exerts on
    the link: positive for a rotor that turns clockwise seen from the tip of the axis. `strength` multiplies
    both, and is in force from the next `reset`. Until the first command takes effect rotors are still.

    All rotors on one link make one force and one torque; with four of them, pushing each by itself took seven
    times as long.
    """

    def __init__(
        self,
        engine: Engine,
        robot: str,
        rotors: Sequence[Rotor],
        substep: float,
        *,
        strength: float | Sequence[float] = 1.0,
        delay: float = 0.0,
        time_constant: float = 0.0,
    ) -> None:
        """Create the actuator; `substep` is the length of a substep, s."""
        self.strength = strength
        self._rotors = rotors
        self._push = {carrier: engine.pusher((robot, carrier), "link") for carrier, _, _, _ in rotors}
        self.response = Response(substep, lambda: [0.0] * len(rotors), delay, time_constant)
        self.reset()
        engine.before_substep(self._act)

    def __call__(self, thrusts: Sequence[float]) -> None:
        self.response.send(thrusts)

    def reset(self) -> None:
        """Take the strength as it is now, and forget all commands."""
        strength = self.strength
        strengths = [strength] * len(self._rotors) if isinstance(strength, (int, float)) else strength
        self._effects: list[tuple[str, Triple, Triple]] = []
        """The link of each rotor, and force and torque on it per thrust that is commanded."""
        for (carrier, position, axis, moment_constant), rotor_strength in zip(
            self._rotors, strengths, strict=True
        ):
            force = frames.scaled(axis, max(0.0, rotor_strength))
            self._effects.append(
                (
                    carrier,
                    force,
                    frames.add(frames.cross(position, force), frames.scaled(force, moment_constant)),
                )
            )
        self._loads: list[tuple[Pusher, Triple, Triple]] = []
        self.response.reset()

    def hold(self) -> None:
        """Do nothing: rotors exert nothing by themselves until the first command."""

    def _act(self) -> None:
        thrusts = self.response.advance()
        if thrusts is not None:
            self._loads = [(push, *self._load(carrier, thrusts)) for carrier, push in self._push.items()]
        for push, force, torque in self._loads:
            push(force, torque)

    def _load(self, carrier: str, thrusts: Sequence[float]) -> tuple[Triple, Triple]:
        """Return force and torque on one link."""
        fx = fy = fz = tx = ty = tz = 0.0
        for thrust, (link, (ax, ay, az), (bx, by, bz)) in zip(thrusts, self._effects, strict=True):
            if link == carrier:
                fx += thrust * ax
                fy += thrust * ay
                fz += thrust * az
                tx += thrust * bx
                ty += thrust * by
                tz += thrust * bz
        return (fx, fy, fz), (tx, ty, tz)


Draw = Callable[[], tuple[Triple, Triple, float, float]]
"""The draw of a push: force (N), torque (N m), how long they act (s), and how long after the beginning of
this push the next begins (s)."""


class Push:
    """Pushes a link now and then, in the axes of the world, in every substep while a push lasts.

    A push begins in the first substep at or after its time. A push that ends within a substep acts with the
    remaining share of its force, also where the next one begins in that substep, so that momentum is force
    times duration for any substep.
    """

    def __init__(self, engine: Engine, part: Part, draw: Draw, substep: float) -> None:
        """Create the push; `draw` is called once at the beginning of each push; `substep` is the length of a
        substep, s."""
        self._push = engine.pusher(part)
        self._draw = draw
        self._substep = substep
        # No push begins before the first reset.
        self.reset(inf, 0)
        engine.before_substep(self._act)

    def reset(self, first: float, settling: int) -> None:
        """Let the first push begin `first` s into the episode, before which there are `settling` substeps."""
        self._now = -settling - 1
        """The number of the last substep."""
        self._due = first / self._substep - _TIME_TOLERANCE
        self._left = 0.0
        self._last = -inf
        self._force: Triple = ZERO_VECTOR
        self._torque: Triple = ZERO_VECTOR

    def force_within(self, substeps: int) -> Triple:
        """Return the force (N) that pushed in one of the last `substeps` substeps; zero between two
        pushes."""
        return self._force if self._now - self._last < substeps else ZERO_VECTOR

    def _act(self) -> None:
        self._now += 1
        force, torque = self._share()
        while self._now >= self._due:
            self._force, self._torque, duration, until_next = self._draw()
            self._left = duration / self._substep
            # From the time of this push and not from its substep, so that rounding does not add up.
            self._due += until_next / self._substep
            further_force, further_torque = self._share()
            force, torque = frames.add(force, further_force), frames.add(torque, further_torque)
        if self._last == self._now:
            self._push(force, torque)

    def _share(self) -> tuple[Triple, Triple]:
        """Return force and torque of the last push in this substep."""
        share = min(self._left, 1.0)
        if share <= _TIME_TOLERANCE:
            return ZERO_VECTOR, ZERO_VECTOR
        self._last = self._now
        self._left -= share
        return frames.scaled(self._force, share), frames.scaled(self._torque, share)


# Controllers


C = TypeVar("C", bound="RobotController")
M = TypeVar("M", bound=Memory)


class WithMemories:
    """Memories of stateful functions, which a new episode clears; `timestep` is in s."""

    def __init__(self, timestep: float) -> None:
        self._timestep = timestep
        self._memories: list[Memory | Memories] = []

    def memory(self, kind: type[M], *, on_message: bool = False) -> M:
        """Return a memory that begins at the reset, or else with the first message (`on_message`)."""
        memory = kind(self._timestep, on_message=on_message)
        self._memories.append(memory)
        return memory

    def memories(self, kind: type[Memory], count: int, *, on_message: bool = False) -> Memory | Memories:
        """Return one memory for each component of a vector."""
        memory = memory_of_vector(kind, count, self._timestep, on_message=on_message)
        self._memories.append(memory)
        return memory

    def clear_memories(self) -> None:
        for memory in self._memories:
            memory.reset()


class RobotController(WithMemories):
    """Base of the generated robot classes.

    A generated class adds `bind`, which takes its readers and writers from the engine, and the paper's
    pair: `use_message_data(message)` drives the actuators by the fields of a message, and `create_message()`
    reads the sensors into the fields of one. Channels encode and decode.
    """

    def __init__(self, spec: Robot, scenario: Program, engine: Engine) -> None:
        super().__init__(scenario.world.timestep)
        self.spec = spec
        self.devices: dict[str, Device] = {}
        self._world = scenario.world
        self._engine = engine
        self.bind(engine)
        drives = [
            (actuator, getattr(self, generated.drive(actuator.name), None)) for actuator in spec.actuators
        ]
        driven = [(actuator, drive) for actuator, drive in drives if drive is not None]
        self._holds: list[Callable[[], object]] = [
            drive.hold if hasattr(drive, "hold") else _hold(engine, spec.name, actuator, drive)
            for actuator, drive in driven
        ]
        # Actuators with `hold` have a state of their own.
        self._releases = [drive.reset for _, drive in driven if hasattr(drive, "hold")]

    def bind(self, engine: Engine) -> None:
        """Take readers and writers from the engine; called once."""

    def device(self, name: str) -> Device:
        """Return the device behind a sensor, made on first use."""
        if name not in self.devices:
            sensor = next(sensor for sensor in self.spec.sensors if sensor.name == name)
            device = instrument(sensor, self.spec.name, self._world, self._engine)
            self.devices[name] = Device(sensor, self.spec.name, device, self._world.timestep)
        return self.devices[name]

    def actuator(self, name: str) -> CustomMotor:
        """Return an actuator of a plug-in's kind."""
        actuator = next(actuator for actuator in self.spec.actuators if actuator.name == name)
        assert isinstance(actuator, CustomActuator)  # generated code uses no other
        return CustomMotor(
            Site(self._engine, self.spec.name, actuator, self._world.timestep / self._world.substeps)
        )

    def sees(self, sensor: str, body: str) -> Callable[[], bool]:
        """Return whether the newest picture of a camera shows the body."""
        return sees(self.device(sensor), body)

    def begin(self, streams: Streams) -> None:
        """Begin an episode: discard earlier readings and take the first ones."""
        for device in self.devices.values():
            device.reset(streams)
        self.clear_memories()
        self.reset()

    def reset(self) -> None:
        """Begin the values computed on board with the first readings, and with actions of zeros."""

    def observe(self) -> None:
        """Sample the sensors that are sampled once per timestep."""

    def release(self) -> None:
        """Set the values of the actuators for this episode and discard their commands: they exert nothing
        until `hold`."""
        for release in self._releases:
            release()

    def hold(self) -> None:
        """Hold all driven joints in their reset state until the first command takes effect."""
        for hold in self._holds:
            hold()


def _hold(engine: Engine, robot: str, actuator: Actuator, drive: MotorWriter) -> Callable[[], object]:
    """Return a function that keeps the joints of a plain motor where they are; a motor that commands torques
    lets its joints go."""
    if isinstance(actuator, MotorSpec) and actuator.kind == "velocity_motor":
        return partial(drive, (0.0,) * len(actuator.joints))
    if isinstance(actuator, MotorSpec) and actuator.kind == "position_motor":
        read = engine.joint_states(robot, actuator.joints)
        return lambda: drive([state[0] for state in read()])
    return _nothing


class SupervisedRobots(WithMemories):
    """The robots of a supervisor, which `bind` makes: their controllers, and the paths of messages."""

    step_count: int

    def __init__(self, scenario: Program, engine: Engine) -> None:
        super().__init__(scenario.world.timestep)
        self.scenario = scenario
        self.engine = engine
        self.controllers: dict[str, RobotController] = {}
        self.channels: dict[tuple[str, Direction], Channel | LossyChannel] = {}
        """The paths of messages, by robot and direction."""
        self.links: dict[tuple[str, str], LossyChannel] = {}
        """The paths of messages between robots, by sender and receiver."""

    def bind(self, engine: Engine) -> None:
        """Take readers from the engine."""

    def robot(self, name: str, controller: type[C]) -> C:
        """Return the controller of a robot."""
        robot_controller = controller(self._spec(name), self.scenario, self.engine)
        self.controllers[name] = robot_controller
        return robot_controller

    def channel(self, name: str, direction: Direction) -> Channel:
        """Return the path of messages to or from a robot, if it is direct."""
        spec = self._spec(name)
        channel = Channel(
            FieldCodec(
                spec.to_robot if direction == "to_robot" else spec.from_robot,
                self.scenario.format,
                self._rejected,
            )
        )
        self.channels[name, direction] = channel
        return channel

    def lossy_channel(self, name: str, direction: Direction) -> LossyChannel:
        """Return the path of messages to or from a robot, where messages come late or may be lost."""
        robot = self._spec(name)
        to_robot = direction == "to_robot"
        route, layout = (robot.to_route, robot.to_robot) if to_robot else (robot.from_route, robot.from_robot)
        channel = LossyChannel(
            f"{name}.{direction}",
            route,
            self.scenario.world.timestep,
            1 if self.scenario.timing == "delayed" else 0,
            self.engine.pose(name),
            FieldCodec(layout, self.scenario.format, self._rejected),
            first_at_once=not to_robot,
        )
        self.channels[name, direction] = channel
        return channel

    def link(self, sender: str, receiver: str) -> LossyChannel:
        """Return the path of messages from one robot to another, which take at least a timestep."""
        spec = next(
            link for link in self.scenario.links if (link.sender, link.receiver) == (sender, receiver)
        )
        sender_pose, receiver_pose = self.engine.pose(sender), self.engine.pose(receiver)

        def apart() -> tuple[tuple[float, float, float], Any]:
            (a, _), (b, _) = sender_pose(), receiver_pose()
            return (b[0] - a[0], b[1] - a[1], b[2] - a[2]), None

        channel = LossyChannel(
            f"{sender}.to_{receiver}",
            spec.route,
            self.scenario.world.timestep,
            1,
            apart,
            FieldCodec(spec.layout, self.scenario.format, self._rejected),
            first_at_once=True,
        )
        self.links[sender, receiver] = channel
        return channel

    def _spec(self, name: str) -> Robot:
        return next(robot for robot in self.scenario.robots if robot.name == name)

    def begin_robots(self, streams: Streams) -> None:
        """Make controllers, channels and memories forget the last episode."""
        for part in (*self.controllers.values(), *self.channels.values(), *self.links.values()):
            part.begin(streams)
        self.clear_memories()

    def vary_sensor(self, robot: str, sensor: str, fault: str, values: Sequence[float]) -> None:
        """Set the values of a sensor fault for this episode. A sensor that nothing reads has no device."""
        controller = self.controllers[robot]
        if sensor in controller.devices:
            controller.devices[sensor].vary(fault, values)

    def set_joints(
        self, robot: str, joints: Sequence[str], positions: Sequence[float], velocities: Sequence[float] = ()
    ) -> None:
        """Set the start positions (rad or m) and velocities (rad/s or m/s) of joints, at rest without
        them."""
        for joint, position, velocity in zip(
            joints, positions, velocities or (0.0,) * len(joints), strict=True
        ):
            self.engine.set_joint(robot, joint, position, velocity)

    def set_walls(self, bodies: Sequence[str], friction: float) -> None:
        """Let several bodies, such as the walls around an arena, have the same coefficient of friction."""
        for body in bodies:
            self.engine.set_parameter("lateral_friction", (body, ""), friction)

    def _rejected(self, layout: MessageLayout, message: Any) -> MessageError:
        self.engine.require_finite()  # not every format can carry values that are not finite
        return layout_error(layout, self.scenario.format, message, self.step_count)
