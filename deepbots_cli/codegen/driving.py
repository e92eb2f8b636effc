"""How a printed controller drives its actuators: plain motors of the engine, and devices of the runtime."""

from __future__ import annotations

from collections.abc import Sequence

from deepbots_cli import frames
from deepbots_cli.codegen.text import quoted, quoted_tuple, tuple_code
from deepbots_cli.compiler.robots import held
from deepbots_cli.program import Program
from deepbots_cli.program.robots import Actuator, Cartesian, Motor, Robot, Thrust


class Driving:
    """The actuators of one robot that have a command."""

    def __init__(self, scenario: Program, robot: Robot) -> None:
        self._robot = robot
        self._model = next(body.model for body in scenario.world.robots if body.name == robot.name)
        self._substep = scenario.world.timestep / scenario.world.substeps
        self._varied = {(*variation.of[1:], variation.what) for variation in scenario.reset.variations if variation.of[:1] == (robot.name,)}
        commanded = {entry.name for entry in robot.commands}
        self._actuators = [actuator for actuator in robot.actuators if actuator.name in commanded]

    def bind_lines(self) -> list[str]:
        """Statements that take each motor from `engine`."""
        return [f"self.drive_{actuator.name} = {self._code(actuator)}" for actuator in self._actuators]

    @property
    def has_devices(self) -> bool:
        return any(self._is_device(actuator) for actuator in self._actuators)

    @property
    def has_any(self) -> bool:
        return bool(self._actuators)

    def _code(self, actuator: Actuator) -> str:
        match actuator:
            case Thrust():
                return self._thrust(actuator)
            case Cartesian():
                return self._cartesian(actuator)
            case Motor():
                return self._device(actuator) if self._is_device(actuator) else self._plain(actuator)

    def _is_device(self, actuator: Actuator) -> bool:
        return not isinstance(actuator, Motor) or self._is_device_motor(actuator)

    def _is_device_motor(self, motor: Motor) -> bool:
        varies = any(self._varies(motor, figure) for figure in ("strength", "max_torque", "stiffness", "damping"))
        return varies or self._responds(motor) or (motor.kind == "torque_motor" and motor.response.strength != 1.0)

    def _responds(self, actuator: Motor | Cartesian) -> bool:
        """Whether it follows its commands in every substep, rather than at once."""
        response = actuator.response
        late = response.delay > 0.0 or response.lag > 0.0 or self._varies(actuator, "delay") or self._varies(actuator, "lag")
        return late or bool(_rates(actuator))

    def _answers(self, actuator: Motor | Cartesian) -> list[str]:
        """The arguments that say how strongly and promptly it answers."""
        if not self._responds(actuator):
            return _strength(actuator)
        rates = _rates(actuator)
        limited = [f"rates={tuple_code([_figure(rate) for rate in rates])}"] if rates else []
        return [*_strength(actuator), f"substep={self._substep!r}", *_late(actuator), *limited]

    def _varies(self, actuator: Actuator, figure: str) -> bool:
        return (actuator.name, f"actuator_{figure}") in self._varied

    def _plain(self, motor: Motor) -> str:
        strength = motor.response.strength
        arguments = [self._joints(motor), _limits(motor, strength)]
        if motor.kind == "position_motor":
            gains = (motor.stiffness, motor.damping)
            arguments += ["None" if gain is None else _each(strength * gain, motor) for gain in gains]
        return f"engine.{motor.kind}({', '.join(arguments)})"

    def _device(self, motor: Motor) -> str:
        arguments = ["engine", quoted(motor.kind), self._joints(motor), _limits(motor)]
        gains = (("stiffness", motor.stiffness), ("damping", motor.damping))
        arguments += [f"{name}={gain!r}" for name, gain in gains if gain is not None]
        return f"Motor({', '.join([*arguments, *self._answers(motor)])})"

    def _cartesian(self, hand: Cartesian) -> str:
        arguments = ["engine", quoted(self._robot.name), quoted(hand.link), quoted_tuple(hand.joints), _limits(hand)]
        arguments += [f"rpy={tuple_code([repr(angle) for angle in hand.rpy])}"] if hand.rpy is not None else []
        return f"Cartesian({', '.join([*arguments, *self._answers(hand)])})"

    def _thrust(self, thrust: Thrust) -> str:
        rotors = [self._rotor(link, thrust.drag * sense) for link, sense in zip(thrust.links, thrust.spin, strict=True)]
        arguments = ["engine", quoted(self._robot.name), tuple_code(rotors), repr(self._substep)]
        return f"Thrust({', '.join([*arguments, *_strength(thrust), *_late(thrust)])})"

    def _rotor(self, link: str, drag: float) -> str:
        """The link that carries a rotor, where on it the rotor sits, its axis and its drag."""
        carrier, (position, turned) = held(self._model, link)
        axis = frames.rotate(turned, (0.0, 0.0, 1.0))
        return f"({quoted(carrier)}, {position!r}, {axis!r}, {drag!r})"

    def _joints(self, motor: Motor) -> str:
        return f"{quoted(self._robot.name)}, {quoted_tuple(motor.joints)}"


def _strength(actuator: Actuator) -> list[str]:
    return [f"strength={actuator.response.strength!r}"] if actuator.response.strength != 1.0 else []


def _late(actuator: Actuator) -> list[str]:
    figures = (("delay", actuator.response.delay), ("lag", actuator.response.lag))
    return [f"{name}={figure!r}" for name, figure in figures if figure]


def _rates(motor: Motor | Cartesian) -> Sequence[float | None]:
    """How fast the targets of each joint may change; empty where at once."""
    if isinstance(motor, Motor) and motor.kind == "velocity_motor" and motor.max_acceleration is not None:
        return (motor.max_acceleration,) * len(motor.joints)
    if (isinstance(motor, Cartesian) or motor.kind == "position_motor") and any(limit is not None for limit in motor.max_velocity):
        return motor.max_velocity
    return ()


def _limits(motor: Motor | Cartesian, strength: float = 1.0) -> str:
    return tuple_code([_figure(limit, strength) for limit in motor.max_torque])


def _figure(limit: float | None, strength: float = 1.0) -> str:
    return "inf" if limit is None else repr(strength * limit)


def _each(figure: float, motor: Motor) -> str:
    return tuple_code([repr(figure)] * len(motor.joints))
