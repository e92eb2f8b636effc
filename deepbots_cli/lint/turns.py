"""DB506: angles that jump by a full turn."""

from __future__ import annotations

from collections.abc import Iterator
from math import pi

from deepbots_cli.compiler import Checked
from deepbots_cli.diagnostics import Finding
from deepbots_cli.expressions.dimensions import ANGLE
from deepbots_cli.expressions.types import Invocation, Operation, Reference, Stage, Typed, children
from deepbots_cli.lint.equality import judged
from deepbots_cli.lint.meaning import Book, book_of
from deepbots_cli.program.robots import Robot
from deepbots_cli.program.values import Expression

_ROUND = frozenset({"yaw", "bearing", "atan2", "wrap"})
"""They go from 180 deg to -180 deg in one tick."""
_EVEN = frozenset({"wrap", "sin", "cos", "tan"})
"""They do not mind a full turn more or less."""


def angle_jumps(checked: Checked) -> Iterator[Finding]:
    """DB506: the change of a heading, or the difference of two, which jumps by a full turn where the heading passes 180 deg.

    `yaw`, `bearing`, `atan2` and a compass lie between -180 and 180 deg. Who turns on from 179 to -179 deg has turned by 2 deg, and
    `delta` gives -358; a goal at 170 deg is 11 deg from there, and the difference 349. A reward or a policy that is made of that is
    right for most of the circle. `wrap` gives the short way round; `sin` and `cos` do not mind.

    Example::

        signals: {turned: delta(yaw(cart))}
        reward: {still: -abs(turned) / rad}

    Instead::

        signals: {turned: wrap(delta(yaw(cart)))}
        reward: {still: -abs(turned) / rad}
    """
    if checked.program is None or checked.namespace is None:
        return
    book = book_of(checked.program)
    texts: list[tuple[Expression, Robot | None]] = [(value, None) for value in judged(checked.program)]
    for body in checked.program.robots:
        texts += [(value, body) for value in (*body.emit, *(command.target for command in body.commands))]
    for value, robot in texts:
        for node in Turns(book, robot).jumping(value.typed):
            path = (*(("robots",) if robot is not None else ()), *value.owner.split("."))
            text = checked.namespace.values.text(path)
            written, place = text.text[node.start : node.end], text.part(node.start, node.end)
            yield Finding("DB506", place, f"`{written}` jumps by a full turn at 180 deg", help=f"go the short way round: `wrap({written})`")


class Turns:
    """Which angles of the supervisor's expressions, or of those on board of a robot, go round."""

    def __init__(self, book: Book, robot: Robot | None, known: dict[str, bool] | None = None) -> None:
        self._book = book
        self._robot = robot
        self._known: dict[str, bool] = {} if known is None else known

    def jumping(self, node: Typed) -> Iterator[Typed]:
        match node:
            case Invocation(function=function) if function in _EVEN:
                return
            case Invocation(function="delta", args=(inner, *_)) if self._is_round(inner):
                yield node
                return
            case Operation(operator="sub", args=(a, b)) if self._differ(a, b) or self._differ(b, a):
                yield node
                return
        for part in children(node):
            yield from self.jumping(part)

    def _differ(self, heading: Typed, other: Typed) -> bool:
        """Whether the two can lie on both sides of 180 deg: a figure near 0 is no such thing."""
        known = other.type.interval
        return self._is_round(heading) and (self._is_round(other) or (known.finite and max(-known.low, known.high) > pi / 2 + 1e-9))

    def _is_round(self, node: Typed) -> bool:
        if node.type.dimension != ANGLE or node.type.stage is not Stage.STEP:
            return False
        match node:
            case Invocation(function=function):
                return function in _ROUND
            case Operation(operator="add" | "sub" | "neg", args=args):
                return any(self._is_round(arg) for arg in args)
            case Reference(symbol=symbol) if self._robot is not None:
                return any(sensor.name == symbol.name and sensor.kind == "compass" for sensor in self._robot.sensors)
            case Reference(symbol=symbol):
                return self._is_named_round(symbol.name)
            case _:
                return False

    def _is_named_round(self, name: str) -> bool:
        if name not in self._known:
            robot = next((robot for robot in self._book.program.robots if name.startswith(f"{robot.name}.")), None)
            meant = self._book.named(name)
            asked = Turns(self._book, robot, self._known)
            self._known[name] = meant is not None and meant.foreign is None and asked._is_round(meant.typed)
        return self._known[name]


RULES = (angle_jumps,)
