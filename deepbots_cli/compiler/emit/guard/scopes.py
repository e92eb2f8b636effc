"""Each name in an expression is defined, in the scope of the expression."""

from __future__ import annotations

from collections.abc import Iterable
from graphlib import CycleError, TopologicalSorter

from deepbots_cli.canonical import CanonicalError
from deepbots_cli.compiler.emit.guard.expressions import nodes
from deepbots_cli.compiler.emit.reads import ARRIVALS
from deepbots_cli.compiler.emit.sensing import devices
from deepbots_cli.compiler.emit.text import action_variables, flat
from deepbots_cli.expressions.scalar import Name, World
from deepbots_cli.ir import CompiledScenario, Ending, Measured, MeasuredGoal, own_action

_FLAGS = tuple((name, None) for name in ("terminated", "truncated", "ended"))
_BUILT_IN = tuple((name, None) for name in ("time", "step", "previous_reward", "episode_return"))


def require_known_names(scenario: CompiledScenario) -> None:
    """Each name in an expression is one that the scenario defines, in the scope of the expression."""
    sent = [(f"{robot.name}.{name}", component) for robot in scenario.robots for name, component in flat(robot.emit)]
    acted = [pair for part in scenario.action for pair in action_variables(part)]
    endings = [(ending.name, None) for ending in scenario.endings]
    given = [("previous_action", component) for component in own_action(scenario.action)]
    known = {*flat(scenario.parameters), *flat(scenario.signals), *sent, *acted, *_BUILT_IN}
    _require_in([scenario.scripts], {*known, *given} - {*endings, *_FLAGS})
    known |= {*endings, *_FLAGS}
    if scenario.goal is not None:
        reached = {(name.name, name.component) for name in (*scenario.goal.names("achieved"), *scenario.goal.names("desired"))}
        reached.add(("goal_reached", None))
        _require_in([(scenario.goal.achieved, scenario.goal.desired)], known - {*endings})
        _require_in([scenario.reward], reached)
        known |= reached
    known |= {*given}
    _require_parameters(scenario)
    _require_senders(scenario)
    supervisor = [scenario.action, scenario.signals, scenario.seen, scenario.reward, scenario.endings, scenario.reset]
    _require_in([*supervisor, *(robot.receive for robot in scenario.robots)], known)
    for robot in scenario.robots:
        sensed = [(sensor.name, component) for sensor in robot.sensors for component in (sensor.components or (None,))]
        _require_in([robot.emit], set(sensed))
        _require_in([robot.apply], {*sensed, *flat(robot.receive)})


def _require_parameters(scenario: CompiledScenario) -> None:
    """A parameter is made of those before it, a figure of a route or of noise of any."""
    known: set[tuple[str, str | None]] = set()
    for entry in scenario.parameters:
        _require_in([entry.values, entry.redraw], known)
        known.update(flat([entry]))
    _require_in([scenario.disturbances], known)
    reset = scenario.reset
    noise = [entry.noise for entry in scenario.signals if isinstance(entry, Measured)]
    noise += [scenario.goal.noise] if isinstance(scenario.goal, MeasuredGoal) else []
    _require_in([*noise, *(entry.noise for entry in scenario.observation)], known)
    _require_in([reset.places, reset.layouts, reset.joints, reset.variations, reset.groups], known)
    _require_in([(robot.to_route, robot.from_route) for robot in scenario.robots], known)


def _require_senders(scenario: CompiledScenario) -> None:
    """The supervisor knows how old the messages of robots are, and a robot how old the readings of its devices."""
    told = [scenario.signals, scenario.observation, scenario.reward, scenario.endings, scenario.action, scenario.scripts]
    known = {robot.name for robot in scenario.robots}
    asked = _senders((*told, *(robot.receive for robot in scenario.robots)))
    on_board = [
        (_senders((robot.emit, robot.apply)), {f"{robot.name}.{name}" for name in devices(scenario, robot)}) for robot in scenario.robots
    ]
    if not asked <= known or _senders(scenario.reset) or any(not ages <= sensors for ages, sensors in on_board):
        raise CanonicalError("the age of something that is not known here")


def _senders(expressions: object) -> set[str]:
    return {node.subjects[0] for node in nodes(expressions) if isinstance(node, World) and node.function in ARRIVALS}


def require_order(endings: tuple[Ending, ...]) -> None:
    """Endings may name each other, but not in a circle."""
    names = {ending.name for ending in endings}
    used = {ending.name: {node.name for node in nodes(ending.condition) if isinstance(node, Name)} & names for ending in endings}
    try:
        TopologicalSorter(used).prepare()
    except CycleError:
        raise CanonicalError("endings that wait for each other") from None


def _require_in(expressions: Iterable[object], known: set[tuple[str, str | None]]) -> None:
    for node in (node for value in expressions for node in nodes(value)):
        if isinstance(node, Name) and (node.name, node.component) not in known:
            raise CanonicalError(f"{node.name[:40]!r} is not defined")
