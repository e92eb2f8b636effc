"""Motors with a strength, and with a delay, a lag or a limited rate of change; arms that bring a link to a position."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from math import ceil, exp, inf

from deepbots_cli.frames import Triple, quaternion
from deepbots_cli.port import Engine, MotorWriter
from deepbots_cli.program.robots import MotorKind

Origin = Callable[[], Sequence[float]]
_EARLY = 1e-9  # of a substep; what a sum of durations may be off
PerJoint = float | Sequence[float]
"""One for all joints, or one for each."""


class Response:
    """What of its commands an actuator follows, from substep to substep.

    A command takes effect in the first substep that begins `delay` after it was sent, or later. From there on what is
    followed approaches it: in a substep of h seconds by the share 1 - exp(-h / time_constant) of what is left, a lag of
    first order exactly, and by at most `rate` * h. It starts from what `origin` says when the first command takes effect.

    `delay` and `time_constant` are in s, `rates` in units of the command per s, one per component; they are in force from the
    next `reset`. A negative one, such as a normal distribution may draw, counts as 0.
    """

    def __init__(self, substep: float, origin: Origin, delay: float = 0.0, time_constant: float = 0.0, rates: Sequence[float] = ()) -> None:
        """`substep` is the length of one, s; without `rates` a command may jump."""
        self.delay = delay
        self.time_constant = time_constant
        self._substep = substep
        self._origin = origin
        self._most = [rate * substep for rate in rates]
        self._sent: deque[tuple[int, Sequence[float]]] = deque()
        self.reset()

    def reset(self) -> None:
        """No command was ever sent."""
        self._sent.clear()
        self._now = 0
        self._wait = max(0, ceil(self.delay / self._substep - _EARLY))
        self._share = 1.0 - exp(-self._substep / self.time_constant) if self.time_constant > 0.0 else 1.0
        self._jumps = self._share == 1.0 and not self._most
        self._goal: Sequence[float] = ()
        self._value: Sequence[float] | None = None
        self._still = True

    def start(self, value: Sequence[float]) -> None:
        """What is followed now, before any command."""
        self._value = value

    def send(self, command: Sequence[float]) -> None:
        self._sent.append((self._now + self._wait, command))

    def advance(self) -> Sequence[float] | None:
        """What is followed in the substep that begins now; None where that is what it was in the last one, or nothing."""
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
        before, share = self._origin() if self._value is None else self._value, self._share
        after = [old + share * (goal - old) for old, goal in zip(before, self._goal, strict=True)]
        if self._most:
            after = [
                old + most if new - old > most else old - most if new - old < -most else new
                for old, new, most in zip(before, after, self._most, strict=True)
            ]
        self._still = self._value is not None and after == before
        self._value = after
        return after


class Motor:
    """Joints that are driven together; called with one target per joint.

    What `strength` multiplies is the torque or force that the motor would exert without it: its limit, the gains of
    its spring, the target of a torque motor. Strength, limits and gains may be set between two episodes and are in
    force from the next `reset`.
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
        strength: PerJoint = 1.0,
        substep: float | None = None,
        delay: float = 0.0,
        time_constant: float = 0.0,
        rates: Sequence[float] = (),
    ) -> None:
        """`rates` bounds how fast targets change, in their unit per s.

        With `substep`, the length of one in s, the motor follows its commands in every substep; without, at once.
        """
        self.max_torque = max_torque
        self.stiffness = stiffness
        self.damping = damping
        self.strength = strength
        self._engine, self._kind, self._robot, self._joints = engine, kind, robot, joints
        self._states = engine.joint_states(robot, joints)
        self._bound: object = None
        self.response = None if substep is None else Response(substep, self._rest, delay, time_constant, rates)
        self.reset()
        if self.response is not None:
            engine.before_substep(self._act)

    def __call__(self, targets: Sequence[float]) -> None:
        if self.response is None:
            self._exert(targets)
        else:
            self.response.send(targets)

    def reset(self) -> None:
        """Take strength, limits and gains as they are now, and forget all commands."""
        bound = (self.max_torque, self.stiffness, self.damping, self.strength)
        if bound != self._bound:
            self._bound = bound
            self._bind()
        if self.response is not None:
            self.response.reset()

    def hold(self) -> None:
        """Keep the joints where they are, as far as a motor of this kind can."""
        if self._kind != "torque_motor":
            rest = self._rest()
            self._exert(rest)
            if self.response is not None:
                self.response.start(rest)

    def _rest(self) -> Sequence[float]:
        """The targets at which the joints stay where they are."""
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
        self._shares = [max(0.0, strength) for strength in self._each(self.strength)]
        limits = [share * limit if limit < inf else inf for share, limit in zip(self._shares, self._each(self.max_torque), strict=True)]
        engine, robot, joints = self._engine, self._robot, self._joints
        if self._kind == "velocity_motor":
            self._write: MotorWriter = engine.velocity_motor(robot, joints, limits)
        elif self._kind == "torque_motor":
            self._write = engine.torque_motor(robot, joints, limits)
        else:
            self._write = engine.position_motor(robot, joints, limits, self._scaled(self.stiffness), self._scaled(self.damping))

    def _scaled(self, gain: PerJoint | None) -> list[float] | None:
        """A gain of the spring in each joint, as strong as that motor is."""
        return None if gain is None else [share * max(0.0, each) for share, each in zip(self._shares, self._each(gain), strict=True)]

    def _each(self, values: PerJoint) -> Sequence[float]:
        return (values,) * len(self._joints) if isinstance(values, (int, float)) else values


class Cartesian(Motor):
    """Brings the origin of a link to a position (m, world frame); called with x, y and z.

    Joint positions are computed once per command, from where the joints are and within their ranges; what is out of
    reach is approached. The engine's servo then drives the joints there, with the delay, time constant and rates of a `Motor`.
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
        strength: PerJoint = 1.0,
        substep: float | None = None,
        delay: float = 0.0,
        time_constant: float = 0.0,
        rates: Sequence[float] = (),
    ) -> None:
        """`rpy` (rad) is the attitude that the link keeps; without, it may have any."""
        self._solve = engine.inverse_kinematics((robot, link), joints)
        self.attitude = None if rpy is None else quaternion(*rpy)
        self.watch: Callable[[Triple, Sequence[float]], object] | None = None
        """Called with the position of each command (m, world frame) and the joint positions computed for it (rad or m)."""
        super().__init__(
            engine,
            "position_motor",
            robot,
            joints,
            max_torque,
            strength=strength,
            substep=substep,
            delay=delay,
            time_constant=time_constant,
            rates=rates,
        )

    def __call__(self, targets: Sequence[float]) -> None:
        x, y, z = targets
        solution = self._solve((x, y, z), self.attitude)
        if self.watch is not None:
            self.watch((x, y, z), solution)
        super().__call__(solution)
