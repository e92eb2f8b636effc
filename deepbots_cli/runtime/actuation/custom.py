"""Actuators of plug-ins: a control law says what torques they exert."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from math import inf
from typing import Any, NamedTuple

from deepbots_cli.plugins import attribute
from deepbots_cli.port import Engine
from deepbots_cli.program.robots import CustomActuator
from deepbots_cli.runtime.actuation.motors import Motor


def _nothing() -> None:
    """What a control law without a memory does at a reset."""


class ControlLaw(NamedTuple):
    """How an actuator answers its commands.

    `act` is called before every engine step, from the first command on. It gets the command in SI units, one value per joint, after
    delay and time constant, and returns the torque (N m) or force (N) on each joint; strength and `max_torque` are applied to it.
    `restart` begins an episode. `rest` gives the command that keeps the joints where they are until the first one; without it the
    actuator exerts nothing until then.
    """

    act: Callable[[Sequence[float]], Sequence[float]]
    restart: Callable[[], None] = _nothing
    rest: Callable[[], Sequence[float]] | None = None


class Site(NamedTuple):
    """An actuator in a world: what its kind's `drive` makes a control law from. `substep` is the length of an engine step, s."""

    engine: Engine
    robot: str
    actuator: CustomActuator
    substep: float

    @property
    def joints(self) -> tuple[str, ...]:
        return self.actuator.joints

    @property
    def parameters(self) -> dict[str, Any]:
        """The parameters that the kind has of its own, in SI units."""
        return dict(self.actuator.parameters)


class CustomMotor(Motor):
    """Joints that a control law drives; called with one command per joint.

    Raises:
        EngineError: The robot has no such joint.
    """

    def __init__(self, site: Site) -> None:
        actuator, response = site.actuator, site.actuator.response
        self._law: ControlLaw = attribute(actuator.drive)(site)
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
