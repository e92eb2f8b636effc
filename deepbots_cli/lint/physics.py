"""Whether the world is one that an engine can simulate, and arms reach what they are told: the codes DB309, DB310 and DB315."""

from __future__ import annotations

import re
from collections.abc import Iterator
from math import degrees, radians
from typing import Any

from deepbots_cli.compiler.robots import joint_dimension
from deepbots_cli.diagnostics import Finding, Label
from deepbots_cli.lint.probed import Probed
from deepbots_cli.lint.report import Missed, Overlap, Where
from deepbots_cli.lint.wording import figure
from deepbots_cli.program.world import ARENA_WALLS, GROUND
from deepbots_cli.robots.model import Joint

_DEEP = 0.005
"""m; engines let what rests sink in by less than a millimetre, and what is placed by hand is often a little off.

A cart or a crate was pushed out of the ground at 0.01 to 0.04 m/s from 4 mm, at up to 0.22 m/s from 5 mm and up to 0.5 m/s from
10 mm (physics steps of 8 and of 1 ms); who falls for 1 mm has 0.14 m/s.
"""

_OFTEN = 0.1
"""Of the commands of an episode: a script may pass over what is out of reach on its way."""
_SLIGHT_DISTANCE, _SLIGHT_ANGLE = 0.001, radians(0.5)
"""m, rad; what a finding leaves out beside the other."""

_CALMER = "shorten the physics step (`world.substeps`), weaken motors and springs, and look at masses and inertias"
_KINDS = {
    "crash": ("the physics engine crashes ({})", _CALMER),
    "hang": (
        "a step does not come back within {}",
        "look for what makes the engine busy: bodies within each other, fine meshes, many substeps",
    ),
    "memory": ("the simulation needs more memory than {}", "let there be fewer bodies, smaller meshes or smaller pictures"),
    "killed": ("the simulation is ended from outside ({})", "most often the system had no memory left: let there be less in the world"),
}


def unstable_simulation(probed: Probed) -> Iterator[Finding]:
    """DB309: the engine comes to an end, or to figures that no world has."""
    halt, stop = probed.report.halt, probed.report.stop
    if halt is not None and halt.kind in _KINDS:
        headline, help = _KINDS[halt.kind]
        fastest = probed.report.fastest
        body = fastest[0] if fastest else None
        notes = [probed.when()]
        if fastest:
            notes.append(f"the fastest body until then was `{fastest[0]}`, at {fastest[1]:.3g} m/s")
        yield Finding("DB309", probed.body(body), headline.format(halt.what), help=help, notes=tuple(notes))
    elif stop is not None:
        yield from _stopped(probed, stop)


def _stopped(probed: Probed, stop: Any) -> Iterator[Finding]:
    body = str(stop.get("body", ""))
    match stop.get("kind"):
        case "speed":
            yield Finding("DB309", probed.body(body), _violent(stop, body), help=_CALMER, notes=(probed.when(),))
        case "lost":
            yield Finding("DB309", probed.body(body), f"the motion of `{body}` is no longer a number", help=_CALMER, notes=(probed.when(),))
        case "build":
            text = str(stop.get("text"))
            yield Finding("DB309", probed.body(_named(probed, text)), f"the engine cannot build this world: {text}")
        case "engine":
            text = str(stop.get("text"))
            yield Finding("DB309", probed.body(_named(probed, text)), f"the engine gives up: {text}", help=_CALMER, notes=(probed.when(),))


def _violent(stop: Any, body: str) -> str:
    joint = f"joint `{stop['joint']}` of `{body}`" if "joint" in stop else f"`{body}`"
    figure = float(stop.get("figure", 0.0))
    match stop.get("what"):
        case "velocity":
            return f"`{body}` moves at {figure:.3g} m/s"
        case "spin":
            return f"`{body}` spins at {figure:.3g} rad/s, by more than half a turn in each physics step"
        case "joint":
            return f"{joint} moves at {figure:.3g} rad/s or m/s"
        case _:
            return f"the motion of {joint} is no longer a number"


def _named(probed: Probed, text: str) -> str | None:
    """The first body that a message of the engine names."""
    world = probed.program.world
    known = {robot.name for robot in world.robots} | {thing.name for thing in world.objects}
    return next((word for word in re.findall(r"'([^']+)'", text) if word in known), None)


def spawn_overlap(probed: Probed) -> Iterator[Finding]:
    """DB310: bodies begin within each other; of the copies of a group one pair is told."""
    deepest: dict[frozenset[str], Overlap] = {}
    for found in probed.report.overlaps:
        pair = frozenset(name.partition("#")[0] for name, _ in (found.one, found.other))
        if found.depth > _DEEP and (pair not in deepest or deepest[pair].depth < found.depth):
            deepest[pair] = found
    for found in deepest.values():
        yield _overlapping(probed, found)


def _overlapping(probed: Probed, found: Overlap) -> Finding:
    """Told where the one begins that the scenario places, a robot first."""
    one, other = sorted((found.one, found.other), key=lambda part: _order(probed, part[0]))
    depth = f"{found.depth * 1000:.3g} mm"
    span = probed.placed(one[0]) or probed.body(one[0])
    notes = (f"link `{one[1]}` meets `{other[1]}`, in the reset with seed {found.seed}; {probed.plan.resets} seeds were tried",)
    if other[0] == GROUND:
        headline = f"`{one[0]}` begins {depth} deep in the ground"
        help = f"place it {depth} higher, or leave `z` out for what shall rest on the ground"
        also = (Label(probed.body(other[0]), "the ground"),) if probed.program.world.terrain else ()
    else:
        headline = f"`{one[0]}` and `{other[0]}` begin {depth} within each other"
        help = "place them apart, or in a `region`, which looks for free spots"
        there = probed.placed(other[0]) or probed.body(other[0])
        also = (Label(there, f"`{other[0]}` begins here"),)
    return Finding("DB310", span, headline, help=help, notes=notes, also=also)


def _order(probed: Probed, name: str) -> int:
    if name == GROUND or name in ARENA_WALLS:
        return 3
    if name.partition("#")[0] in probed.scenario_robots:
        return 0
    return 1 if probed.placed(name) else 2


def pose_out_of_reach(probed: Probed) -> Iterator[Finding]:
    """DB315: a `cartesian` actuator is commanded to a pose that the inverse kinematics does not reach."""
    told: set[tuple[str, str]] = set()
    for missed in probed.report.missed:
        if (missed.turn or missed.out >= _OFTEN * missed.commands) and (missed.robot, missed.actuator) not in told:
            told.add((missed.robot, missed.actuator))
            yield _turned(probed, missed) if missed.turn else _missed(probed, missed)


def _missed(probed: Probed, missed: Missed) -> Finding:
    model = next(robot.model for robot in probed.program.world.robots if robot.name == missed.robot)
    turned = missed.angle > _SLIGHT_ANGLE
    span = probed.names.values.span(("robots", missed.robot, "actuators", missed.actuator, "rpy" if turned else "link"))
    distance = f"{missed.distance:.3g} m" if missed.distance > _SLIGHT_DISTANCE else ""
    by = " and ".join(filter(None, [distance, f"{degrees(missed.angle):.3g} deg" if turned else ""]))
    notes = [probed.when(Where(missed.by, missed.seed, missed.step))]
    notes += [_stop(model.joint(name), stop) for name, stop in missed.stops.items()]
    notes += [f"{missed.out} of {missed.commands} commands in that episode are out of reach"] if missed.commands > 1 else []
    remedy = "choose another `rpy`, or leave it out if any attitude will do" if turned else "command positions that the arm reaches"
    headline = f"`{missed.actuator}` is commanded to a pose that the inverse kinematics misses by {by}"
    help = f"{remedy}; `deepbots inspect` prints the pose of the link at the start of an episode"
    return Finding("DB315", span, headline, help=help, notes=tuple(notes))


def _turned(probed: Probed, missed: Missed) -> Finding:
    """Of a command that an arm reaches by contorting itself: its link is told another attitude than it starts in."""
    span = probed.names.values.span(("robots", missed.robot, "actuators", missed.actuator, "rpy"))
    angles = [round(degrees(angle)) for angle in missed.start]
    start = " ".join(str(180 if angle == -180 else angle) for angle in angles)
    headline = f"the first command turns `{missed.actuator}` by {degrees(missed.turn):.3g} deg in place"
    help = f"write `rpy: {start} deg`, which is about the attitude at the start, or let the arm start in another pose"
    notes = (probed.when(Where(missed.by, missed.seed, missed.step)), "the arm contorts itself, and may swing far on its way")
    return Finding("DB315", span, headline, help=help, notes=notes)


def _stop(joint: Joint, stop: float) -> str:
    return f"joint `{joint.name}` is at its limit of {figure(stop, joint_dimension(joint))}"


RULES = {"DB309": unstable_simulation, "DB310": spawn_overlap, "DB315": pose_out_of_reach}
