"""The world: implausible scale (DB507), engines (DB309, DB316), robots that fall (DB323), starts of episodes
(DB310, DB809, DB812)."""

from __future__ import annotations

import re
from collections.abc import Iterator

from deepbots_cli.analysis import Analysis
from deepbots_cli.analysis.ranges import with_unit
from deepbots_cli.compiler.robots import joint_dimension
from deepbots_cli.compiler.values import ValueReader
from deepbots_cli.diagnostics import Finding, Label, Span
from deepbots_cli.document.nodes import NodePath
from deepbots_cli.engine_kinds import ENGINES, OTHER_ENGINES, Feature
from deepbots_cli.expressions.dimensions import ANGLE, MASS
from deepbots_cli.expressions.functions import contains_draw
from deepbots_cli.expressions.intervals import ALWAYS
from deepbots_cli.expressions.scalar import EngineRead
from deepbots_cli.expressions.types import Known, referenced_names
from deepbots_cli.lint.context import Match, RuleContext, Simulation, rule
from deepbots_cli.lint.observations import may_be_noisy
from deepbots_cli.lint.simulation import MeasuredOverlap, Stop
from deepbots_cli.program import Program
from deepbots_cli.program.resets import Placement
from deepbots_cli.program.robots import CustomActuator, Motor, Sensor, Thrust
from deepbots_cli.program.world import ARENA_WALLS, GROUND, ObjectBody, Variant
from deepbots_cli.robots.model import Mesh, volume

_MIN_DENSITY, _MAX_DENSITY = 0.1, 25_000.0
"""The plausible densities in kg/m^3; air has 1.2, osmium 22 600, and a toy balloon weighs 0.2 for each
m^3."""
_MAX_MASS_RATIO = 1e5
"""The mass from which an object is implausible, as a multiple of the mass of all robots together."""
_WATER_DENSITY = 1000.0
"""The density of water, in kg/m^3."""
_LENGTHS_IN_METERS = r"([\d.]+(?: [\d.]+)*) *m"
_MAX_DEPTH = 0.005
"""The depth (m) up to which bodies may overlap; engines let resting bodies sink in by less than a millimeter,
and a pose set by hand is often a little off.

A cart or a crate was pushed out of the ground at 0.01 to 0.04 m/s from 4 mm, at up to 0.22 m/s from 5 mm and
up to 0.5 m/s from 10 mm (physics steps of 8 and of 1 ms); a fall of 1 mm gives 0.14 m/s.
"""


# Objects, robots and engines


@rule(
    "DB323",
    "`{robot}` falls without end: its base is free, and no link of its robot file has a <collision>",
    "write `base: fixed` to bolt it to the world, or give the links that touch the ground a <collision> in"
    " the robot file",
)
def falls_without_end(context: RuleContext) -> Iterator[Match]:
    """Report a robot that falls without end, because its base is free and nothing of it collides with the
    ground."""
    program, values = context.program, context.values
    lifted = {
        robot.name
        for robot in program.robots
        if any(isinstance(actuator, (Thrust, CustomActuator)) for actuator in robot.actuators)
    }
    for body in program.world.robots:
        is_held = body.fixed_base or body.name in lifted or not any(program.world.gravity)
        if not is_held and not any(link.collisions for link in body.model.links):
            yield Match(values.span_of_first(("robots", body.name), "base", "urdf"), robot=body.name)


@rule("DB316")
def beyond_engine(context: RuleContext) -> Iterator[Finding]:
    """Report a physics engine that is not installed, or does not support a part of the world."""
    world = context.program.world
    kind = ENGINES.get(context.program.engine or "")
    terrain = world.terrain
    if kind is None:
        return
    if not kind.is_installed and any(engine.is_installed for engine in ENGINES.built_in.values()):
        headline = f"the engine `{context.program.engine}` cannot be used here: {kind.missing}"
        yield Finding("DB316", context.values.span(("world", "engine")), headline, kind.help)
    if kind.mesh_terrain is not None and terrain is not None and isinstance(terrain.shape, Mesh):
        yield Finding(
            "DB316",
            context.values.span(("world", "terrain", "file")),
            kind.mesh_terrain.reason,
            kind.mesh_terrain.help,
        )
    followers = [(robot.name, joint) for robot in world.robots for joint in robot.model.followers]
    if followers and not kind.supports("mimic"):
        headline = (
            f"the engine `{context.program.engine}` does not simulate <mimic>, but the joint"
            f" `{followers[0][1]}` follows another joint"
        )
        yield Finding("DB316", context.values.span(("world", "engine")), headline, OTHER_ENGINES)
    for feature, span in _needed_features(context):
        if not kind.supports(feature):
            yield Finding("DB316", span, *kind.limitation(feature))
    if kind.implausible_inertia is not None:
        reason, help = kind.implausible_inertia
        for robot in world.robots:
            wrong = [
                link.name
                for link in robot.model.links
                if link.inertial is not None and link.inertial.is_stated and not link.inertial.is_plausible
            ]
            if wrong:
                changes = ", ".join(f"{name}: {{inertia: auto}}" for name in wrong)
                yield Finding(
                    "DB316",
                    context.values.key_span(("robots", robot.name)),
                    f"link `{wrong[0]}` {reason}",
                    f"{help}, or compute it from shape and mass: `links: {{{changes}}}`",
                    notes=(f"the same is true of {', '.join(wrong[1:])}",) if len(wrong) > 1 else (),
                )


def _needed_features(context: RuleContext) -> Iterator[tuple[Feature, Span]]:
    """Yield each feature of an engine that the scenario needs, with the place of the value."""
    for variation in context.program.reset.variations:
        if variation.what == "center_of_mass":
            yield "center_of_mass", variation.value.span
    for robot in context.program.robots:
        for actuator in robot.actuators:
            if isinstance(actuator, Motor) and actuator.no_load_speed is not None:
                path = ("robots", robot.name, "actuators", actuator.name, "no_load_speed")
                yield "torque_curve", context.values.span(path)
        for sensor in robot.sensors:
            if sensor.kind in ("reaction_force", "reaction_torque"):
                yield (
                    "joint_wrench",
                    context.values.span(("robots", robot.name, "sensors", sensor.name, "type")),
                )
    geared = {
        robot.name
        for robot in context.program.world.robots
        if any(joint.armature > 0.0 for joint in robot.model.joints)
    }
    robots = context.checked.spec.robots if context.checked.spec is not None else {}
    for name, robot_spec in robots.items():
        if robot_spec.self_collision:
            yield "self_collision", context.values.span((*robot_spec.path, "self_collision"))
        for change in robot_spec.joints.values():
            if name in geared and change.armature is not None:
                yield "armature", context.values.span((*change.path, "armature"))


@rule("DB507")
def odd_scale(context: RuleContext) -> Iterator[Finding]:
    """Report an implausible mass of an object; the robot files were judged when they were read."""
    world = context.program.world
    values = context.values
    weight = sum(robot.model.mass for robot in world.robots)
    met: set[NodePath] = set()
    for body in world.objects:
        for path, kind in _forms(body):
            if path in met or not values.is_present(path):
                continue  # another copy of a group, or a wall
            met.add(path)
            finding = _odd_mass(body, kind, weight, path, values)
            if finding is not None:
                yield finding


def _forms(body: ObjectBody) -> Iterator[tuple[NodePath, Variant]]:
    """Yield each variant of a body, and its place in the scenario."""
    path: NodePath = ("objects", body.name.partition("#")[0])
    if body.variants:
        yield from (((*path, "one_of", kind.name), kind) for kind in body.variants)
    else:
        yield path, Variant(body.name, body.shape, body.mass, fixed=body.fixed)


def _odd_mass(
    body: ObjectBody, kind: Variant, carried: float, path: NodePath, values: ValueReader
) -> Finding | None:
    """Return a finding about a movable object with the density of no material, or one that outweighs all
    robots, of a mass of `carried` kg, by far."""
    size = volume(kind.shape)
    if not body.solid or kind.fixed or not size or kind.mass <= 0.0:
        return None
    weight = with_unit(kind.mass, MASS)
    density = kind.mass / size
    water = f"the same volume of water weighs {with_unit(_WATER_DENSITY * size, MASS)}"
    if not _MIN_DENSITY <= density <= _MAX_DENSITY:
        beyond = "more than any metal" if density > _MAX_DENSITY else "less than a tenth of air"
        density_text = f"{density:.0f}" if density > 1000.0 else f"{density:.2g}"
        headline = (
            f"`{path[-1]}` has a density of {density_text} kg/m^3, {beyond}: {weight} in {size:.3g} m^3"
        )
        help = f"check the units of its mass and size ({water})" + (
            ", or write `fixed: true`" if density > _MAX_DENSITY else ""
        )
        return Finding("DB507", values.span_of_first(path, "mass"), headline, help)
    if carried <= 0.0 or kind.mass < _MAX_MASS_RATIO * carried:
        return None
    headline = f"`{path[-1]}` weighs {weight}, but all robots together weigh only {with_unit(carried, MASS)}"
    return Finding(
        "DB507", values.span_of_first(path, "mass", "radius", "size"), headline, _in_centimeters(path, values)
    )


def _in_centimeters(path: NodePath, values: ValueReader) -> str:
    """Return a help with the same size in centimeters, where it is written in meters."""
    size_text = values.span_of_first(path, "radius", "size").text
    match = re.fullmatch(_LENGTHS_IN_METERS, size_text)
    if match is None:
        return "check the unit of its size"
    return f"write `{match[1]} cm` if you mean centimeters"


# Measured in a simulation

_STABILITY_HELP = (
    "shorten the physics step (`world.substeps`), weaken motors and springs, and check masses and inertias"
)
_KINDS = {
    "crash": ("the physics engine crashes ({})", _STABILITY_HELP),
    "hang": (
        "a step does not return within {}",
        "look for overlapping bodies and fine meshes, and use fewer substeps",
    ),
    "memory": (
        "the simulation needs more memory than {}",
        "use fewer bodies, smaller meshes or smaller pictures",
    ),
    "killed": (
        "another process ended the simulation ({})",
        "the system probably ran out of memory; make the world smaller",
    ),
}


@rule("DB309", simulated=True)
def unstable_simulation(simulation: Simulation) -> Iterator[Finding]:
    """Report that the engine crashes, hangs, or computes impossible motion."""
    halt, stop = simulation.report.halt, simulation.report.stop
    if halt is not None and halt.kind in _KINDS:
        headline, help = _KINDS[halt.kind]
        body = None
        notes = [simulation.when()]
        if simulation.report.fastest:
            body, speed = simulation.report.fastest.body, simulation.report.fastest.speed
            notes.append(f"the fastest body before was `{body}`, at {speed:.3g} m/s")
        yield Finding(
            "DB309", simulation.body_span(body), headline.format(halt.description), help, notes=tuple(notes)
        )
    elif stop is not None:
        yield from _stopped(simulation, stop)


def _stopped(simulation: Simulation, stop: Stop) -> Iterator[Finding]:
    body, text = stop.body, stop.text
    match stop.kind:
        case "speed":
            headline = _implausible_motion(stop)
        case "lost":
            headline = f"the motion of `{body}` became infinite or NaN"
        case "engine":
            headline = f"the engine stops with an error: {text}"
            body = _body_in(simulation, text)
        case "build":
            yield Finding(
                "DB309",
                simulation.body_span(_body_in(simulation, text)),
                f"the engine cannot build this world: {text}",
            )
            return
        case _:
            return
    yield Finding("DB309", simulation.body_span(body), headline, _STABILITY_HELP, notes=(simulation.when(),))


def _implausible_motion(stop: Stop) -> str:
    joint = f"joint `{stop.joint}` of `{stop.body}`" if stop.joint is not None else f"`{stop.body}`"
    match stop.motion:
        case "velocity":
            return f"`{stop.body}` moves at {stop.value:.3g} m/s"
        case "spin":
            return (
                f"`{stop.body}` spins at {stop.value:.3g} rad/s, by more than half a turn in each physics"
                " step"
            )
        case "joint":
            return f"{joint} moves at {stop.value:.3g} rad/s or m/s"
        case _:
            return f"the motion of {joint} became infinite or NaN"


def _body_in(simulation: Simulation, text: str) -> str:
    """Return the first body that a message of the engine names; empty if it names none."""
    world = simulation.program.world
    bodies = {robot.name for robot in world.robots} | {body.name for body in world.objects}
    return next((word for word in re.findall(r"'([^']+)'", text) if word in bodies), "")


# Resets


@rule("DB809", versions="base")
def identical_episodes(context: RuleContext) -> Iterator[Finding]:
    """Report that nothing is random, so that all episodes are the same."""
    program = context.program
    if (
        program.agent.training is None
        or program.evaluation.episodes < 2
        or program.cases
        or program.curriculum
        or _varies(context.analysis)
        or any(contains_draw(tree) for reading in context.values.readings for tree in reading.trees)
    ):
        return
    headline = (
        f"nothing is random, so the {program.evaluation.episodes} episodes of an evaluation are identical"
    )
    if program.reset.joint_starts:
        start = program.reset.joint_starts[0]
        joint = context.analysis.body(start.robot).model.joint(start.joints[0])
        spread = "-1 .. 1 deg" if joint_dimension(joint) == ANGLE else "-1 .. 1 cm"
        yield Finding(
            "DB809", start.position.span, headline, f"draw the initial state, as in `uniform({spread})`"
        )
    else:
        section = next(
            (key for key in ("reset", "evaluation", "train") if context.values.is_present((key,))), "train"
        )
        help = (
            f"draw the initial position, as in `{program.world.robots[0].name}: {{x: uniform(-5 .. 5"
            f" cm)}}` under `reset.place`"
        )
        yield Finding("DB809", context.values.key_span((section,)), headline, help)


def _varies(analysis: Analysis) -> bool:
    """Return whether anything is random that no function of the language draws."""
    program = analysis.program
    values = [*program.signals, *program.agent.reward, *program.endings]
    routes = [route for robot in program.robots for route in (robot.to_route, robot.from_route)]
    return bool(
        program.reset.variations
        or program.disturbances
        or any(body.variants for body in program.world.objects)
        or len(program.reset.layouts) > 1
        or any(place.spot is not None or _draws_coordinates(place) for place in analysis.placements)
        or any(
            setting is not None for route in routes for setting in (route.loss, route.burst, route.latency)
        )
        or any(entry.noise for entry in program.agent.observation)
        or any(value.noise for value in may_be_noisy(program))
        or any(_has_noise(sensor) for robot in program.robots for sensor in robot.sensors)
        or any(value.foreign for value in values)
    )


def _has_noise(sensor: Sensor) -> bool:
    faults = sensor.faults
    lookup = sensor.beams.lookup if sensor.beams is not None else None
    return (faults is not None and any((faults.noise, faults.relative_noise, faults.drift))) or (
        lookup is not None and bool(lookup.noise)
    )


def _draws_coordinates(place: Placement) -> bool:
    return any(contains_draw(coordinate.typed) for coordinate in place.coordinates.values())


@rule(
    "DB812",
    "`require` depends on `{drawn}`, which deepbots does not draw again if a start does not meet `require`",
    "draw `{drawn}` only from values that meet `require`, as in `choice(-1 | 1) * uniform(6 .. 20 cm)` (two"
    " intervals), or replace `{drawn}` with a position that is drawn under `reset.place`",
)
def requirement_not_redrawn(context: RuleContext) -> Iterator[Match]:
    """Report `reset.require` that depends only on parameters, which are not drawn again if it does not
    hold."""
    program = context.program
    analysis = context.analysis
    require = context.program.reset.require
    if require is None:
        return
    (node,) = analysis.scalars(require)
    drawn_names = {value.name for value in program.parameters if value.typed.type.known is not Known.FIXED}
    facts = [fact for fact in analysis.walk_definitions(node) if isinstance(fact, EngineRead)]
    bodies = {subject.partition(".")[0].partition("#")[0] for fact in facts for subject in fact.subjects}
    places = [place for place in analysis.placements if place.body in bodies]
    names = {
        name
        for place in places
        for coordinate in place.coordinates.values()
        for name in referenced_names(coordinate.typed)
    }
    sources = sorted((analysis.drawn_dependencies(node) | names) & drawn_names)
    bent = {
        subject.partition(".")[0]
        for fact in facts
        if not _is_of_root(program, fact)
        for subject in fact.subjects
    }
    if sources and not _is_drawn_again(program, places, bent) and analysis.start.of(node) != ALWAYS:
        yield Match(require.span, drawn=sources[0])


def _is_of_root(program: Program, fact: EngineRead) -> bool:
    """Return whether a fact concerns the pose of an object or of a root link, which no joint moves."""
    roots = {f"{robot.name}.{robot.model.root}" for robot in program.world.robots} | {
        body.name for body in program.world.objects
    }
    return fact.function in ("position", "orientation") and roots.issuperset(fact.subjects)


def _is_drawn_again(program: Program, places: list[Placement], bent: set[str]) -> bool:
    """Return whether the next attempt differs: in the place of a body, in the layout, or in a joint of a
    robot in `bent`."""
    joints = any(
        start.robot in bent and contains_draw(start.position.typed) for start in program.reset.joint_starts
    )
    moved = any(
        _draws_coordinates(place) or place.spot is not None or place.at_most is not None for place in places
    )
    return joints or moved or (bool(places) and len(program.reset.layouts) > 1)


@rule("DB310", simulated=True)
def spawn_overlap(simulation: Simulation) -> Iterator[Finding]:
    """Report bodies that overlap at the start; one pair is reported for all copies of a group."""
    deepest: dict[frozenset[str], MeasuredOverlap] = {}
    for overlap in simulation.report.overlaps:
        pair = frozenset(name.partition("#")[0] for name, _ in (overlap.one, overlap.other))
        if overlap.depth > _MAX_DEPTH and (pair not in deepest or deepest[pair].depth < overlap.depth):
            deepest[pair] = overlap
    yield from (_overlapping(simulation, overlap) for overlap in deepest.values())


def _overlapping(simulation: Simulation, overlap: MeasuredOverlap) -> Finding:
    """Return a finding at the body that the scenario places, a robot first."""
    body_part, other_part = sorted((overlap.one, overlap.other), key=lambda part: _order(simulation, part[0]))
    first, second = simulation.called(body_part[0]), simulation.called(other_part[0])
    depth = f"{overlap.depth * 1000:.3g} mm"
    span = simulation.placement(body_part[0]) or simulation.body_span(body_part[0])
    met = f"link `{body_part[1]}` meets `{simulation.called(other_part[1])}`"
    notes = (f"{met}, in the reset with seed {overlap.seed}; {simulation.plan.resets} seeds were simulated",)
    if other_part[0] == GROUND:
        headline = f"`{first}` begins {depth} below the surface of the ground"
        has_height = any("z" in place.coordinates for place in simulation.placements(body_part[0]))
        help = f"place it {depth} higher" + (
            ", or remove `z` to place it on the ground" if has_height else ", with `z`"
        )
        also = (
            (Label(simulation.body_span(other_part[0]), "the ground"),)
            if simulation.program.world.terrain
            else ()
        )
    elif body_part[0] == other_part[0]:
        headline = (
            f"links `{body_part[1]}` and `{other_part[1]}` of `{first}` overlap by {depth} at the start"
        )
        help = "make their <collision> shapes in the robot file smaller, or remove `self_collision`"
        also = ()
    else:
        headline = f"`{first}` and `{second}` overlap by {depth} at the start"
        help = "place them farther apart, or use a `region`, where deepbots finds free positions"
        second_span = simulation.placement(other_part[0]) or simulation.body_span(other_part[0])
        also = (Label(second_span, f"`{second}` begins here"),)
    return Finding("DB310", span, headline, help, notes=notes, labels=also)


def _order(simulation: Simulation, name: str) -> int:
    if name == GROUND or name in ARENA_WALLS:
        return 3
    if name.partition("#")[0] in simulation.robot_names:
        return 0
    return 1 if simulation.placement(name) else 2
