"""The names of a scenario: one flat namespace, each name typed when it is first asked for.

Parameters, action variables, augmentation, signals and endings live here, with the fields that robots
send (`cart.pole_angle`). Typing on demand makes the order of the file irrelevant; what is asked for
while it is itself being typed closes a circle, which is a finding.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from enum import Enum

from deepbots_cli.compile.robots import RobotScene
from deepbots_cli.compile.values import Values
from deepbots_cli.diagnostics import Label
from deepbots_cli.lang.types import Kind, Subject, Symbol
from deepbots_cli.source.nodes import Path


class Origin(Enum):
    """What kind of definition a name has; the value is how a finding calls it."""

    PARAMETER = "a parameter"
    ACTION = "an action variable"
    FIELD = "a message field"
    AUGMENT = "an augmentation"
    SIGNAL = "a signal"
    ENDING = "an ending"
    ROBOT = "a robot"
    OBJECT = "an object"
    LINE = "a line"
    BUILT_IN = "built in"


@dataclass(eq=False)
class Definition:
    """One name: where it is defined, and how to type it."""

    name: str
    origin: Origin
    path: Path
    make: Callable[[], Symbol] | None = None
    symbol: Symbol | None = None
    open: bool = False
    uses: int = field(default=0)


class Namespace:
    """All definitions of one scenario."""

    def __init__(self, values: Values) -> None:
        self.values = values
        self.definitions: dict[str, Definition] = {}
        self.robots: dict[str, RobotScene | None] = {}
        self.order: list[str] = []
        """Names in the order in which their values can be computed: each after those it is made of."""

    def define(self, name: str, origin: Origin, path: Path, make: Callable[[], Symbol] | None = None) -> None:
        """Add a name; a second definition is a finding, and the first one stays."""
        first = self.definitions.get(name)
        if first is None:
            self.definitions[name] = Definition(name, origin, path, make)
            return
        also = (Label(self.values.key_span(first.path), "first defined here"),) if first.path else ()
        headline = f"`{name}` is already {first.origin.value}"
        self.values.findings.add("DB202", self.values.key_span(path), headline, help="choose another name", also=also)

    def symbol(self, name: str) -> Symbol | None:
        """The typed symbol of a name that an expression uses; None where there is no such value."""
        self.touch(name)
        return self.settle(name)

    def touch(self, name: str) -> None:
        """Note that an expression uses `name`."""
        if name in self.definitions:
            self.definitions[name].uses += 1

    def settle(self, name: str) -> Symbol | None:
        """The same, where the name is only asked for so that it is typed."""
        definition = self.definitions.get(name)
        if definition is None or definition.make is None:
            return None
        if definition.symbol is None:
            if definition.open:
                headline = f"`{name}` is defined by way of itself"
                self.values.findings.add(
                    "DB207",
                    self.values.key_span(definition.path),
                    headline,
                    help="break the circle: `previous(...)` gives the value of the step before",
                )
                definition.symbol = Symbol(name, None)
                return definition.symbol
            definition.open = True
            made = definition.make()
            definition.open = False
            definition.symbol = definition.symbol or made
            self.order.append(name)
        return definition.symbol

    def origin(self, name: str) -> Origin | None:
        definition = self.definitions.get(name)
        return definition.origin if definition else None

    def named(self, *origins: Origin) -> list[str]:
        return [name for name, definition in self.definitions.items() if definition.origin in origins]

    def subject(self, name: str) -> Subject | None:
        """The part of the world called `name`: a robot, one of its parts, an object, the ground."""
        head, _, rest = name.partition(".")
        definition = self.definitions.get(head)
        if definition is None:
            return Subject("ground", Kind.GROUND) if name == "ground" else None
        definition.uses += 1
        if definition.origin is Origin.ROBOT:
            robot = self.robots.get(head)
            if robot is None:
                return None
            return robot.subject(rest) if rest else Subject(head, Kind.ROBOT, link=f"{head}.{robot.model.root}")
        if definition.origin is Origin.OBJECT and not rest:
            return Subject(head, Kind.OBJECT, link=head)
        return None

    def subjects(self) -> Iterable[str]:
        for name, definition in self.definitions.items():
            robot = self.robots.get(name)
            if definition.origin in (Origin.ROBOT, Origin.OBJECT):
                yield name
            if robot is not None:
                yield from (f"{name}.{part}" for part in robot.parts)

    def broken(self, name: str) -> bool:
        """Whether `name` begins with a robot whose file could not be read, so that nothing is known of its parts."""
        head = name.partition(".")[0]
        return head in self.robots and self.robots[head] is None
