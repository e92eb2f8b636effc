"""Resets: episodes that are all alike (DB809), requirements that are never drawn again (DB812), bodies that overlap (DB310)."""

from __future__ import annotations

from collections.abc import Iterator

from deepbots_cli.compiler.robots import joint_dimension
from deepbots_cli.diagnostics import Finding, Label
from deepbots_cli.expressions.dimensions import ANGLE
from deepbots_cli.expressions.functions import FUNCTIONS, Family
from deepbots_cli.expressions.intervals import ALWAYS
from deepbots_cli.expressions.scalar import World
from deepbots_cli.expressions.types import Invocation, Stage, Typed, walk
from deepbots_cli.lint.analysis import Analysis
from deepbots_cli.lint.context import Context, names_in
from deepbots_cli.lint.observations import may_be_noisy
from deepbots_cli.lint.simulation import Overlap, Simulation
from deepbots_cli.program import Program
from deepbots_cli.program.resets import Placement
from deepbots_cli.program.robots import Route, Sensor
from deepbots_cli.program.world import ARENA_WALLS, GROUND

_MAX_DEPTH = 0.005
"""m; engines let what rests sink in by less than a millimetre, and what is placed by hand is often a little off.

A cart or a crate was pushed out of the ground at 0.01 to 0.04 m/s from 4 mm, at up to 0.22 m/s from 5 mm and up to 0.5 m/s from
10 mm (physics steps of 8 and of 1 ms); a fall of 1 mm gives 0.14 m/s.
"""


def identical_episodes(context: Context) -> Iterator[Finding]:
    """DB809: nothing is random, so that all episodes are the same.

    Physics is deterministic. A policy without noise behaves the same in all episodes of an evaluation: their standard deviation is 0,
    and they show one start only. Draws, noise, lost messages, free spots, several layouts and Python code count as random; scenarios
    with several cases of the evaluation or stages of a curriculum are not reported. If one start is intended, one episode is enough:
    `evaluation: {episodes: 1}`.

    Example::

        reset: {set: {cart.pole_hinge: 1 deg}}

    Instead::

        reset: {set: {cart.pole_hinge: uniform(-1 .. 1 deg)}}
    """
    program = context.program
    if (
        program.policy.training is None
        or program.evaluation.episodes < 2
        or program.cases
        or program.curriculum
        or _varies(context.analysis)
    ):
        return
    if any(_is_drawn(tree) for reading in context.values.readings for tree in reading.trees):
        return
    headline = f"nothing is drawn, so that the {program.evaluation.episodes} episodes of an evaluation are one and the same"
    if program.reset.joint_starts:
        start = program.reset.joint_starts[0]
        joint = context.analysis.body(start.robot).model.joint(start.joints[0])
        spread = "-1 .. 1 deg" if joint_dimension(joint) == ANGLE else "-1 .. 1 cm"
        yield Finding("DB809", start.position.span, headline, help=f"draw it, as in `uniform({spread})`")
    else:
        section = next((key for key in ("reset", "evaluation", "train") if context.values.stands((key,))), "train")
        help = f"draw where it begins, as in `{program.world.robots[0].name}: {{x: uniform(-5 .. 5 cm)}}` under `reset.place`"
        yield Finding("DB809", context.values.key_span((section,)), headline, help=help)


def _varies(analysis: Analysis) -> bool:
    """Whether anything is random that no function of the language draws."""
    program = analysis.program
    values = [*program.signals, *program.policy.reward, *(ending.value for ending in program.endings)]
    return bool(
        program.reset.variations
        or program.disturbances
        or any(thing.variants for thing in program.world.objects)
        or len(program.reset.layouts) > 1
        or any(place.spot is not None or _draws_coordinates(place) for place in analysis.placements)
        or any(_is_random(route) for robot in program.robots for route in (robot.to_route, robot.from_route))
        or any(entry.noise for entry in program.policy.observation)
        or any(value.noise for value in may_be_noisy(program))
        or any(_has_noise(sensor) for robot in program.robots for sensor in robot.sensors)
        or any(value.foreign for value in values)
    )


def _is_random(route: Route) -> bool:
    return route.loss is not None or route.burst is not None or route.latency is not None


def _has_noise(sensor: Sensor) -> bool:
    faults = sensor.faults
    lookup = sensor.beams.lookup if sensor.beams is not None else None
    return (faults is not None and any((faults.noise, faults.relative_noise, faults.drift))) or (lookup is not None and bool(lookup.noise))


def _is_drawn(tree: Typed) -> bool:
    return any(isinstance(node, Invocation) and FUNCTIONS[node.function].family is Family.DRAW for node in walk(tree))


def _draws_coordinates(place: Placement) -> bool:
    return any(_is_drawn(coordinate.typed) for coordinate in place.coordinates.values())


def requirement_not_redrawn(context: Context) -> Iterator[Finding]:
    """DB812: `reset.require` depends on drawn parameters, and on nothing that is drawn again when it does not hold.

    When a requirement does not hold, the layout, all places and the joints are drawn again. Parameters keep their values for the
    episode, so that all attempts are the same, and the reset fails. Draw the parameter so that it fits, or draw under `place`.

    Example::

        parameters: {mark: uniform(-0.3 .. 0.3 m)}
        augment: {left: mark - x}
        observation: {left: -0.8 .. 0.8 m}
        reset: {require: abs(mark) > 10 cm}

    Instead::

        parameters: {side: choice(-1 | 1), mark: side * uniform(0.1 .. 0.3 m)}
        augment: {left: mark - x}
        observation: {left: -0.8 .. 0.8 m}
    """
    program, analysis, require = context.program, context.analysis, context.program.reset.require
    if require is None:
        return
    (node,) = analysis.scalars(require)
    drawn = {value.name for value in program.parameters if value.typed.type.stage is not Stage.FIXED}
    facts = [fact for fact in analysis.unfold(node) if isinstance(fact, World)]
    bodies = {subject.partition(".")[0].partition("#")[0] for fact in facts for subject in fact.subjects}
    places = [place for place in analysis.placements if place.body in bodies]
    names = {name for place in places for coordinate in place.coordinates.values() for name in names_in(coordinate.typed)}
    sources = sorted((analysis.sources(node) | names) & drawn)
    bent = {subject.partition(".")[0] for fact in facts if not _is_of_root(program, fact) for subject in fact.subjects}
    if sources and not _is_drawn_again(program, places, bent) and analysis.start.of(node) != ALWAYS:
        headline = f"drawing again does not change what is required: `{sources[0]}` is drawn once per episode"
        yield Finding("DB812", require.span, headline, help=f"draw `{sources[0]}` so that it fits, or draw places under `reset.place`")


def _is_of_root(program: Program, fact: World) -> bool:
    """Whether a fact concerns the pose of an object or of a root link, which no joint moves."""
    roots = {f"{robot.name}.{robot.model.root}" for robot in program.world.robots} | {thing.name for thing in program.world.objects}
    return fact.function in ("position", "orientation") and roots.issuperset(fact.subjects)


def _is_drawn_again(program: Program, places: list[Placement], bent: set[str]) -> bool:
    """Whether the next attempt differs: in the place of a body, in the layout, or in a joint of a robot in `bent`."""
    joints = any(start.robot in bent and _is_drawn(start.position.typed) for start in program.reset.joint_starts)
    moved = any(_draws_coordinates(place) or place.spot is not None or place.at_most is not None for place in places)
    return joints or moved or (bool(places) and len(program.reset.layouts) > 1)


def spawn_overlap(simulation: Simulation) -> Iterator[Finding]:
    """DB310: bodies begin within each other; one pair is reported for all copies of a group."""
    deepest: dict[frozenset[str], Overlap] = {}
    for found in simulation.report.overlaps:
        pair = frozenset(name.partition("#")[0] for name, _ in (found.one, found.other))
        if found.depth > _MAX_DEPTH and (pair not in deepest or deepest[pair].depth < found.depth):
            deepest[pair] = found
    for found in deepest.values():
        yield _overlapping(simulation, found)


def _overlapping(simulation: Simulation, found: Overlap) -> Finding:
    """Reported at the body that the scenario places, a robot first."""
    one, other = sorted((found.one, found.other), key=lambda part: _order(simulation, part[0]))
    depth = f"{found.depth * 1000:.3g} mm"
    span = simulation.placement(one[0]) or simulation.body_span(one[0])
    notes = (f"link `{one[1]}` meets `{other[1]}`, in the reset with seed {found.seed}; {simulation.plan.resets} seeds were tried",)
    if other[0] == GROUND:
        headline = f"`{one[0]}` begins {depth} deep in the ground"
        help = f"place it {depth} higher, or leave `z` out for what shall rest on the ground"
        also = (Label(simulation.body_span(other[0]), "the ground"),) if simulation.program.world.terrain else ()
    else:
        headline = f"`{one[0]}` and `{other[0]}` begin {depth} within each other"
        help = "place them apart, or in a `region`, which looks for free spots"
        there = simulation.placement(other[0]) or simulation.body_span(other[0])
        also = (Label(there, f"`{other[0]}` begins here"),)
    return Finding("DB310", span, headline, help=help, notes=notes, also=also)


def _order(simulation: Simulation, name: str) -> int:
    if name == GROUND or name in ARENA_WALLS:
        return 3
    if name.partition("#")[0] in simulation.robot_names:
        return 0
    return 1 if simulation.placement(name) else 2


RULES = (identical_episodes, requirement_not_redrawn)
MEASURED = (spawn_overlap,)
