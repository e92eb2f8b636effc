"""The values that a value is made of, through the names of signals and endings, and of the fields that robots
send."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from deepbots_cli.expressions.scalar import Name, Scalar, walk
from deepbots_cli.program import Program
from deepbots_cli.program.robots import Robot
from deepbots_cli.program.values import Expression, NamedScalars

Node = tuple[Robot | None, Scalar]
"""A part of a tree, and the robot that computes it; None for the supervisor."""


class Definitions:
    """The values that a program names.

    `fields` are the fields that robots send, by full name, each with the robot that computes it.
    """

    def __init__(self, program: Program) -> None:
        self.parameters = {value.name: value for value in program.parameters}
        self.signals = {signal.name: signal for signal in program.signals}
        self.fields = {
            f"{robot.name}.{entry.name}": (robot, entry)
            for robot in program.robots
            for entry in robot.emitted
        }
        self._followed: dict[str, tuple[Robot | None, Expression | NamedScalars]] = {
            **{value.name: (None, value) for value in (*program.signals, *program.endings)},
            **self.fields,
            **{
                f"{link.receiver}.{value.name}": (None, value)
                for link in program.links
                for value in link.values
            },
        }

    def nodes(self, trees: Iterable[Scalar]) -> Iterator[Node]:
        """Return the nodes of trees of the supervisor, and after each name those of its definition, once.

        A parameter has no definition here, and a sensor has none.
        """
        return self._nodes(trees, None, set())

    def _nodes(self, trees: Iterable[Scalar], robot: Robot | None, met: set[str]) -> Iterator[Node]:
        for node in (node for tree in trees for node in walk(tree)):
            yield robot, node
            # A name on board of a robot is one of its sensors, and not a value of the supervisor.
            if (
                robot is None
                and isinstance(node, Name)
                and node.name in self._followed
                and node.name not in met
            ):
                met.add(node.name)
                owner, value = self._followed[node.name]
                yield from self._nodes(value.scalars, owner, met)
