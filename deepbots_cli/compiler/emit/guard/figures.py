"""Counts and figures that code is made with."""

from __future__ import annotations

from deepbots_cli.canonical import CanonicalError
from deepbots_cli.compiler.emit.reset import is_arranged
from deepbots_cli.compiler.emit.text import flat
from deepbots_cli.compiler.emit.variations import SETTERS
from deepbots_cli.ir import MOST_BODIES, MOST_SETTLING_STEPS, MOST_SUBSTEPS, Choices, CompiledScenario, Measured, MeasuredGoal

_MOST_TICKS = 1e12  # centuries


def require_counts(scenario: CompiledScenario) -> None:
    """A value for each component, variable, joint and field of a message; at least one option and one reward; stamps of 32 bits."""
    robots = scenario.robots
    named = [*scenario.parameters, *scenario.signals, *(entry for robot in robots for entry in (*robot.emit, *robot.receive))]
    pairs = [(entry.name, len(entry.values), len(entry.components or (None,))) for entry in named]
    pairs += [(entry.name, len(entry.noise), len(entry.values)) for entry in scenario.signals if isinstance(entry, Measured)]
    if isinstance(scenario.goal, MeasuredGoal):
        pairs.append(("goal", len(scenario.goal.noise), len(scenario.goal.achieved)))
    pairs.append(("reward", len(scenario.reward), max(1, len(scenario.reward))))
    for part in scenario.action:
        if isinstance(part, Choices):
            pairs += [(option.name, len(option.values), len(part.variables)) for option in part.options]
            pairs.append((part.name, len(part.options), max(1, len(part.options))))
    for robot in robots:
        driven = {actuator.name: len(actuator.components) for actuator in robot.actuators}
        pairs += [(entry.name, len(entry.values), driven.get(entry.name, 0)) for entry in robot.apply]
        if not all(0 <= layout.stamp < 2**32 for layout in (robot.to_robot, robot.from_robot)):
            raise CanonicalError(f"a stamp in messages of '{robot.name}' that is not of 32 bits")
        told = ((robot.to_robot, robot.receive), (robot.from_robot, robot.emit))
        pairs += [(robot.name, len(flat(values)), sum(len(f.components) or 1 for f in layout.fields)) for layout, values in told]
    for name, given, wanted in pairs:
        if given != wanted:
            raise CanonicalError(f"'{name[:40]}' has {given} values where {wanted} are wanted")


def require_variations(scenario: CompiledScenario) -> None:
    """Each figure that an episode varies is in the table, with its names and values."""
    for variation in scenario.reset.variations:
        setter = SETTERS.get(variation.what)
        if setter is None or setter.names not in (None, len(variation.of)) or setter.values not in (None, len(variation.values)):
            raise CanonicalError(f"{variation.what[:40]!r} is nothing that an episode varies")
        if variation.what == "colour" and (len(variation.values) < 4 or len(variation.values) % 3 != 1):
            raise CanonicalError(f"{variation.what[:40]!r} is nothing that an episode varies")


def require_figures(scenario: CompiledScenario) -> None:
    """What is divided by, or counted in, while the code is printed."""
    timestep = scenario.world.timestep
    spans = [(scenario.reset.settle, "settle"), (scenario.truncation.max_time or 0.0, "max_time")]
    if not 1e-9 < timestep < 1e6:
        raise CanonicalError(f"a timestep of {timestep} s")
    for seconds, what in spans:
        if not 0.0 <= seconds / timestep < _MOST_TICKS:
            raise CanonicalError(f"{what} of {seconds} s")
    if not 1 <= scenario.world.substeps <= MOST_SUBSTEPS:
        raise CanonicalError(f"{scenario.world.substeps} substeps")
    if scenario.reset.settle / timestep * scenario.world.substeps > MOST_SETTLING_STEPS * (1 + 1e-9):
        raise CanonicalError(f"settle of {scenario.reset.settle} s")
    if len(scenario.world.robots) + sum(thing.bodies for thing in scenario.world.objects) > MOST_BODIES:
        raise CanonicalError(f"more than {MOST_BODIES} bodies")
    if [robot.name for robot in scenario.robots] != [body.name for body in scenario.world.robots]:
        raise CanonicalError("robots other than those of the world")
    if scenario.truncation.max_steps is None and scenario.truncation.max_time is None:
        raise CanonicalError("episodes without a limit")


def require_copies(scenario: CompiledScenario) -> None:
    """Copies are of the one robot that there is, each in its place in the row, and no more than a world may hold."""
    copies, world = scenario.agent.each, scenario.world
    if copies is None:
        return
    if [robot.name for robot in scenario.robots] != [copies.robot] or [robot.name for robot in world.robots] != [copies.robot]:
        raise CanonicalError(f"copies of {copies.robot[:40]!r}, which is not the one robot")
    if not 1 <= copies.count <= MOST_BODIES - len(world.objects) or not all(abs(step) < 1e6 for step in copies.spacing):
        raise CanonicalError(f"{copies.count} copies")
    if is_arranged(scenario):
        raise CanonicalError("copies that look for their places")


def require_routes(scenario: CompiledScenario) -> None:
    """What messages meet on their way: runs of losses that begin and end."""
    for burst in (route.burst for robot in scenario.robots for route in (robot.to_route, robot.from_route)):
        if burst is not None and not 1.0 <= burst < 1e300:
            raise CanonicalError(f"bursts of {burst} lost messages")
