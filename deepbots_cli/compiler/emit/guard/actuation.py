"""Actuators: figures that their code is made with, and what an episode may vary of them; disturbances."""

from __future__ import annotations

from deepbots_cli.canonical import CanonicalError
from deepbots_cli.compiler.emit.guard.expressions import nodes
from deepbots_cli.expressions.scalar import State, World
from deepbots_cli.ir import Actuator, Cartesian, CompiledScenario, Motor, Thrust, Variation

_LONGEST = 1e9  # s or substeps; a delay or lag beyond is nothing that was compiled
_MOST = 1e30
_PREFIX = "actuator_"


def require_actuators(scenario: CompiledScenario) -> None:
    """As many limits as joints, figures that are no nonsense, and variations of actuators that have such a figure."""
    substep = scenario.world.timestep / scenario.world.substeps
    for robot in scenario.robots:
        for actuator in robot.actuators:
            _require_sound(actuator, substep)
    commanded = {
        (robot.name, actuator.name): actuator
        for robot in scenario.robots
        for actuator in robot.actuators
        if actuator.name in {entry.name for entry in robot.apply}
    }
    for variation in scenario.reset.variations:
        if variation.what.startswith(_PREFIX):
            _require_varied(variation, commanded.get((variation.of[0], variation.of[1])))


def _require_sound(actuator: Actuator, substep: float) -> None:
    response = actuator.response
    if not all(0.0 <= span <= _LONGEST and span / substep <= _LONGEST for span in (response.delay, response.lag)):
        raise CanonicalError(f"'{actuator.name[:40]}' answers after {response.delay} s, with a lag of {response.lag} s")
    match actuator:
        case Motor():
            counts = {len(actuator.joints), len(actuator.max_torque), len(actuator.max_velocity)}
            limits: tuple[float | None, ...] = (*actuator.max_torque, *actuator.max_velocity)
            gains: tuple[float | None, ...] = (actuator.stiffness, actuator.damping, actuator.max_acceleration)
        case Cartesian():
            counts = {len(actuator.joints), len(actuator.max_torque), len(actuator.max_velocity)}
            limits, gains = (*actuator.max_torque, *actuator.max_velocity), ()
            if not all(abs(angle) < _MOST for angle in actuator.rpy or ()):
                raise CanonicalError(f"'{actuator.name[:40]}' keeps no attitude")
        case Thrust():
            counts, limits, gains = {len(actuator.links), len(actuator.spin)}, (), (actuator.drag, *map(abs, actuator.spin))
            if not -_MOST < actuator.low < actuator.high < _MOST:
                raise CanonicalError(f"'{actuator.name[:40]}' pushes with {actuator.low} to {actuator.high} N")
    if len(counts) != 1 or 0 in counts:
        raise CanonicalError(f"'{actuator.name[:40]}' has not one figure for each part")
    figures = (response.strength, *gains)
    if any(gain is not None and not 0.0 <= gain < _MOST for gain in figures) or not all(limit is None or limit >= 0.0 for limit in limits):
        raise CanonicalError(f"'{actuator.name[:40]}' has a figure below 0 or beyond all bounds")


def _require_varied(variation: Variation, actuator: Actuator | None) -> None:
    figure = variation.what.removeprefix(_PREFIX)
    count = 1 if figure in ("delay", "lag") else len(actuator.parts) if actuator else 0
    if actuator is None or not _has(actuator, figure) or len(variation.values) != count:
        raise CanonicalError(f"{'.'.join(variation.of)[:40]!r} has no {figure} to vary")


def _has(actuator: Actuator, figure: str) -> bool:
    if figure in ("strength", "delay", "lag"):
        return True
    if figure == "max_torque":
        return not isinstance(actuator, Thrust)
    return isinstance(actuator, Motor) and getattr(actuator, figure) is not None


def require_disturbances(scenario: CompiledScenario) -> None:
    """A push is made of drawn figures alone; nothing of the world and no memory goes into it."""
    if any(isinstance(node, (World, State)) for node in nodes(scenario.disturbances)):
        raise CanonicalError("a disturbance that depends on what happens")
    names = [push.name for push in scenario.disturbances]
    if len(set(names)) < len(names):
        raise CanonicalError("two disturbances share a name")
