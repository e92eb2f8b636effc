"""DB811: what would come only after every episode has ended."""

from __future__ import annotations

from collections.abc import Iterator

from deepbots_cli.compiler import Checked
from deepbots_cli.diagnostics import Finding
from deepbots_cli.document.nodes import Path
from deepbots_cli.expressions.dimensions import TIME
from deepbots_cli.lint.meaning import book_of
from deepbots_cli.lint.payments import versions
from deepbots_cli.lint.reach import reach_of
from deepbots_cli.lint.wording import figure
from deepbots_cli.program import Program
from deepbots_cli.program.values import Expression


def after_the_end(checked: Checked) -> Iterator[Finding]:
    """DB811: a push, a reading or a message that would come only after every episode has been cut short.

    The first push of a disturbance, the second reading of a sensor, the first message after that of the reset: later than `max_steps` or
    `max_time`, in the scenario and in each of its cases and stages, so that there is none. Most often a time is in another unit.

    Example::

        disturbances:
          knock: {body: cart, force: 5 0 0 N, at: 20 s, lasts: 50 ms}

    Instead::

        disturbances:
          knock: {body: cart, force: 5 0 0 N, at: 2 s, lasts: 50 ms}
    """
    if checked.program is None or checked.namespace is None:
        return
    times = [{path: time for _, time, path in _awaited(program)} for program in versions(checked)]
    end = max(book_of(program).last * book_of(program).period for program in versions(checked))  # s
    for what, time, path in _awaited(checked.program):
        if time >= end and all(known.get(path, time) >= end for known in times):
            headline = f"{what} {figure(time, TIME)} or more, and no episode lasts longer than {figure(end, TIME)}"
            yield Finding("DB811", checked.namespace.values.span(path), headline, help="let it come earlier, or episodes last longer")


def _awaited(program: Program) -> Iterator[tuple[str, float, Path]]:
    """What has to be waited for, the least time of that (s), and where it is written."""
    book = book_of(program)
    reach = reach_of(book)

    def least(time: Expression) -> float:
        return reach.of(book.scalars(time)[0]).low

    for push in program.disturbances:
        key, first = ("at", push.first) if push.first is not None else ("every", push.every)
        if first is not None:
            yield f"`{push.name}` begins after", least(first), ("disturbances", push.name, key)
    for robot in program.robots:
        for sensor in robot.sensors:
            if sensor.faults is not None and sensor.faults.period > 1:
                period = sensor.faults.period * program.world.timestep
                yield f"`{sensor.name}` is read again after", period, ("robots", robot.name, "sensors", sensor.name, "period")
    routes = (
        (key, route) for robot in program.robots[:1] for key, route in (("to_robot", robot.to_route), ("from_robot", robot.from_route))
    )
    for key, route in routes:
        if route.latency is not None:
            yield "a message takes", least(route.latency), ("messages", key, "latency")


RULES = (after_the_end,)
