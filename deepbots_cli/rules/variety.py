"""Rules about what differs between episodes, in the family DB8."""

from __future__ import annotations

from collections.abc import Iterator

from deepbots_cli.compiler import Checked
from deepbots_cli.compiler.joints import joint_dimension
from deepbots_cli.diagnostics import Finding
from deepbots_cli.expressions.dimensions import ANGLE
from deepbots_cli.expressions.functions import FUNCTIONS, Family
from deepbots_cli.expressions.types import Invocation, Typed, children
from deepbots_cli.ir import Sensor
from deepbots_cli.task import JointStart, Placement, Task, TaskRoute


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
    task = checked.task
    if task is None or checked.namespace is None or task.training is None or task.evaluation.episodes < 2:
        return
    if task.cases or task.curriculum or _differs(task):
        return
    values = checked.namespace.values
    if any(_draws(tree) for reading in values.readings for tree in reading.trees):
        return
    headline = f"nothing is drawn, so that the {task.evaluation.episodes} episodes of an evaluation are one and the same"
    section = next((key for key in ("reset", "evaluation", "train") if values.stands((key,))), "train")
    if task.joint_starts:
        start = task.joint_starts[0]
        yield Finding("DB809", start.position.span, headline, help=f"draw it, as in `uniform({_spread(task, start)})`")
    else:
        help = f"draw where it begins, as in `{task.world.robots[0].name}: {{x: uniform(-5 .. 5 cm)}}` under `reset.place`"
        yield Finding("DB809", values.key_span((section,)), headline, help=help)


def _differs(task: Task) -> bool:
    """Whether anything is random that no function of the language draws."""
    begins = task.beginnings
    places = [*begins.placements, *(place for layout in begins.layouts for place in layout.placements)]
    valued = [*task.order, *task.reward, *(ending.value for ending in task.endings)]
    return bool(
        task.variations
        or task.colours
        or task.disturbances
        or any(thing.variants for thing in task.world.objects)
        or len(begins.layouts) > 1
        or any(map(_is_found, places))
        or any(_loses(route) for route in (task.to_robot, task.from_robot))
        or any(entry.noise for entry in task.observation)
        or any(value.noise for value in (*task.order, *([task.goal.achieved] if task.goal else [])))
        or any(_errs(sensor) for robot in task.robots for sensor in robot.sensors)
        or any(value.foreign for value in valued)
    )


def _is_found(place: Placement) -> bool:
    """Whether a spot or a turn is looked for anew."""
    return place.spot is not None or any(coordinate.anywhere for coordinate in place.coordinates.values())


def _loses(route: TaskRoute) -> bool:
    return route.loss is not None or route.burst is not None or route.latency is not None


def _errs(sensor: Sensor) -> bool:
    faults, beams = sensor.faults, sensor.beams
    lookup = beams.lookup if beams is not None else None
    return (faults is not None and any((faults.noise, faults.relative_noise, faults.drift))) or (lookup is not None and bool(lookup.noise))


def _draws(tree: Typed) -> bool:
    if isinstance(tree, Invocation) and FUNCTIONS[tree.function].family is Family.DRAW:
        return True
    return any(map(_draws, children(tree)))


def _spread(task: Task, start: JointStart) -> str:
    """An example of a draw for a joint."""
    model = next(body.model for body in task.world.robots if body.name == start.robot)
    return "-1 .. 1 deg" if joint_dimension(model.joint(start.joints[0])) == ANGLE else "-1 .. 1 cm"


RULES = (identical_episodes,)
