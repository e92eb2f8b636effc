"""Rules about what differs between episodes, in the family DB8."""

from __future__ import annotations

from collections.abc import Iterator

from deepbots_cli.compiler import Checked
from deepbots_cli.compiler.robots import joint_dimension
from deepbots_cli.diagnostics import Finding
from deepbots_cli.expressions.dimensions import ANGLE
from deepbots_cli.expressions.functions import FUNCTIONS, Family
from deepbots_cli.expressions.types import Invocation, Typed, children
from deepbots_cli.program import Program
from deepbots_cli.program.resets import JointStart, Placement
from deepbots_cli.program.robots import Route, Sensor


def identical_episodes(checked: Checked) -> Iterator[Finding]:
    """DB809: nothing is drawn, at the start or later, so that one episode is like the other.

    Physics repeats itself to the last digit. A policy without noise then does the same in all hundred episodes of an evaluation: their
    deviation is 0, and what they tell is how it fares from that one start. What it learns is often that one way, too. Draws, noise,
    lost messages, free spots, layouts in shares and whatever is in Python count as different; so do several cases of the evaluation
    and stages of a curriculum. Where one start is meant, one episode is enough: `evaluation: {episodes: 1}`.

    Example::

        reset: {set: {cart.pole_hinge: 1 deg}}

    Instead::

        reset: {set: {cart.pole_hinge: uniform(-1 .. 1 deg)}}
    """
    program = checked.program
    if program is None or checked.namespace is None or program.training is None or program.evaluation.episodes < 2:
        return
    if program.cases or program.curriculum or _differs(program):
        return
    values = checked.namespace.values
    if any(_draws(tree) for reading in values.readings for tree in reading.trees):
        return
    headline = f"nothing is drawn, so that the {program.evaluation.episodes} episodes of an evaluation are one and the same"
    section = next((key for key in ("reset", "evaluation", "train") if values.stands((key,))), "train")
    if program.reset.joint_starts:
        start = program.reset.joint_starts[0]
        yield Finding("DB809", start.position.span, headline, help=f"draw it, as in `uniform({_spread(program, start)})`")
    else:
        help = f"draw where it begins, as in `{program.world.robots[0].name}: {{x: uniform(-5 .. 5 cm)}}` under `reset.place`"
        yield Finding("DB809", values.key_span((section,)), headline, help=help)


def _differs(program: Program) -> bool:
    """Whether anything is random that no function of the language draws."""
    reset = program.reset
    places = [*reset.placements, *(place for layout in reset.layouts for place in layout.placements)]
    valued = [*program.signals, *program.reward, *(ending.value for ending in program.endings)]
    return bool(
        program.reset.variations
        or program.disturbances
        or any(thing.variants for thing in program.world.objects)
        or len(reset.layouts) > 1
        or any(map(_is_found, places))
        or any(_loses(route) for robot in program.robots for route in (robot.to_route, robot.from_route))
        or any(entry.noise for entry in program.observation)
        or any(value.noise for value in (*program.signals, *([program.goal.achieved] if program.goal else [])))
        or any(_errs(sensor) for robot in program.robots for sensor in robot.sensors)
        or any(value.foreign for value in valued)
    )


def _is_found(place: Placement) -> bool:
    """Whether a spot or a turn is looked for anew."""
    return place.spot is not None or any(_draws(coordinate.typed) for coordinate in place.coordinates.values())


def _loses(route: Route) -> bool:
    return route.loss is not None or route.burst is not None or route.latency is not None


def _errs(sensor: Sensor) -> bool:
    faults, beams = sensor.faults, sensor.beams
    lookup = beams.lookup if beams is not None else None
    return (faults is not None and any((faults.noise, faults.relative_noise, faults.drift))) or (lookup is not None and bool(lookup.noise))


def _draws(tree: Typed) -> bool:
    if isinstance(tree, Invocation) and FUNCTIONS[tree.function].family is Family.DRAW:
        return True
    return any(map(_draws, children(tree)))


def _spread(program: Program, start: JointStart) -> str:
    """An example of a draw for a joint."""
    model = next(body.model for body in program.world.robots if body.name == start.robot)
    return "-1 .. 1 deg" if joint_dimension(model.joint(start.joints[0])) == ANGLE else "-1 .. 1 cm"


RULES = (identical_episodes,)
