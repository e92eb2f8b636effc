"""Actuators that are more than a motor of the engine, because they act in every substep or change from
episode to episode; and pushes.

Response               the response of an actuator to its commands: delay, lag, limited rates
Motor, Cartesian       joints that are driven together, and arms that bring a link to a position
CustomMotor            joints that the control law of a plug-in drives
Thrust, Push           forces on links: rotors, and disturbances of an episode
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from math import ceil, exp, inf
from typing import Any, NamedTuple

from deepbots_cli import frames
from deepbots_cli.frames import Triple, quaternion
from deepbots_cli.plugins import import_attribute
from deepbots_cli.port import ZERO_VECTOR, Engine, MotorWriter, Part, Pusher
from deepbots_cli.program.robots import CustomActuator, MotorKind

InitialValue = Callable[[], Sequence[float]]
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
        initial_value: InitialValue,
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
    remaining share of its force, so that momentum is force times duration for any substep.
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
        self._now = -settling
        self._due = first / self._substep - _TIME_TOLERANCE
        self._left = 0.0
        self._force: Triple = ZERO_VECTOR
        self._torque: Triple = ZERO_VECTOR

    @property
    def current_force(self) -> Triple:
        """The force (N) that pushes now; zero between two pushes."""
        return self._force if self._left > 0.0 else ZERO_VECTOR

    def _act(self) -> None:
        if self._now >= self._due:
            self._force, self._torque, duration, until_next = self._draw()
            self._left = duration / self._substep
            # From the time of this push and not from its substep, so that rounding does not add up.
            self._due += until_next / self._substep
        self._now += 1
        left = self._left
        if left >= 1.0:
            self._push(self._force, self._torque)
            self._left = left - 1.0
        elif left > 0.0:
            (x, y, z), (a, b, c) = self._force, self._torque
            self._push((left * x, left * y, left * z), (left * a, left * b, left * c))
            self._left = 0.0
