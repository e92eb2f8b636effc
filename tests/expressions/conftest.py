"""A small world for expressions, and a bench that takes a text through the whole language."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import pytest

from deepbots_cli.expressions.check import check
from deepbots_cli.expressions.dimensions import (
    ACCELERATION,
    ANGLE,
    ANGULAR_VELOCITY,
    LENGTH,
    NUMBER,
    SPEED,
    TIME,
)
from deepbots_cli.expressions.intervals import EVERYTHING, Interval
from deepbots_cli.expressions.lower import lower
from deepbots_cli.expressions.parser import parse
from deepbots_cli.expressions.scalar import Draw, EngineRead, Name, State
from deepbots_cli.expressions.text import to_python
from deepbots_cli.expressions.types import SPACE, Context, Kind, Known, Subject, Symbol, TypedNode, ValueType
from deepbots_cli.runtime import formulas


def symbol(
    name,
    dimension=NUMBER,
    components=None,
    boolean=False,
    interval=EVERYTHING,
    known=Known.STEP,
    value=None,
    refused=None,
):
    return Symbol(name, ValueType(dimension, components, boolean, interval, known), value, refused)


SYMBOLS = (
    symbol("x", LENGTH),
    symbol("y", LENGTH, interval=Interval(-2.0, 3.0)),
    symbol("speed", SPEED),
    symbol("angle", ANGLE),
    symbol("gas", interval=Interval(-1.0, 1.0)),
    symbol("turn", interval=Interval(-1.0, 1.0)),
    symbol("flag", boolean=True),
    symbol("time", TIME),
    symbol("home", LENGTH, SPACE, known=Known.FIXED, value=(0.0, 0.0, 1.0)),
    symbol("track", LENGTH, known=Known.FIXED, value=(0.39,), interval=Interval(0.39, 0.39)),
    symbol("wind", SPEED, known=Known.EPISODE),
    symbol("cart.pole_angle", ANGLE),
    symbol("cart.gyro", ANGULAR_VELOCITY, SPACE),
    symbol("cart.accel", ACCELERATION, SPACE),
    symbol("cart.rays", LENGTH, ("ps0", "ps1")),
    symbol("stride", NUMBER, ("hip", "knee"), interval=Interval(-1.0, 1.0)),
    symbol("bumps", NUMBER, ("hip", "knee"), boolean=True),
    symbol("radio", TIME, refused="a drawn parameter is not known on board; send it under `receive`"),
    Symbol("broken", None),
)
SUBJECTS = (
    Subject("cart", Kind.ROBOT, link="cart.body"),
    Subject("cart.tip", Kind.LINK),
    Subject("cart.pole_hinge", Kind.JOINT, dimension=ANGLE, interval=Interval(-1.3, 1.3)),
    Subject("cart.slider", Kind.JOINT, dimension=LENGTH),
    Subject("cart.legs", Kind.JOINTS, ("cart.hip", "cart.knee"), dimension=ANGLE),
    Subject("cart.feet", Kind.LINKS, ("cart.left_toe", "cart.right_toe")),
    Subject("ball", Kind.OBJECT),
    Subject("obstacle", Kind.OBJECTS, ("obstacle.0", "obstacle.1")),
    Subject("ground", Kind.GROUND),
)


@dataclass(frozen=True)
class TableScope:
    """A scope over the tables above."""

    context: Context = Context.SIGNAL
    symbols: dict[str, Symbol] = field(default_factory=lambda: {entry.name: entry for entry in SYMBOLS})
    things: dict[str, Subject] = field(default_factory=lambda: {entry.name: entry for entry in SUBJECTS})

    def lookup(self, name: str) -> Symbol | None:
        return self.symbols.get(name)

    def subject(self, name: str, kinds: frozenset[Kind] | None = None) -> Subject | None:
        return self.things.get(name)

    def names(self) -> Iterable[str]:
        return self.symbols

    def subjects(self) -> Iterable[str]:
        return self.things


class BenchFinding(NamedTuple):
    """One finding, with the piece of the text that it points to."""

    code: str
    piece: str
    headline: str
    help: str | None


class Bench:
    """Takes texts through the language and remembers what was found."""

    def __init__(self) -> None:
        self.findings: list[BenchFinding] = []
        self.text = ""
        self.scope = TableScope()

    def report(self, code, start, end, headline, help=None, replacement=None, names=(), corrected=None):
        assert 0 <= start <= end <= len(self.text)
        assert headline[0] == headline[0].lower() or headline[0] == "`"
        assert not headline.endswith(".")
        self.findings.append(BenchFinding(code, self.text[start:end], headline, help))

    def read(self, text: str):
        self.text = text
        self.findings = []
        return parse(text, self.report)

    def typed(self, text: str, context: Context = Context.SIGNAL) -> TypedNode | None:
        tree = self.read(text)
        return check(tree, replace(self.scope, context=context), self.report) if tree is not None else None

    def clean(self, text: str, context: Context = Context.SIGNAL) -> TypedNode:
        """The typed tree of a text without fault."""
        value = self.typed(text, context)
        assert self.findings == [], text
        assert value is not None
        return value

    def codes(self, text: str, context: Context = Context.SIGNAL) -> list[str]:
        self.typed(text, context)
        return [finding.code for finding in self.findings]

    def only(self, text: str, context: Context = Context.SIGNAL) -> BenchFinding:
        """The one finding of a text."""
        self.typed(text, context)
        assert len(self.findings) == 1, self.findings
        return self.findings[0]

    def code_of(self, text: str, context: Context = Context.SIGNAL) -> list[str]:
        """The Python of every component."""
        return [to_python(scalar, leaf) for scalar in lower(self.clean(text, context), "item")]

    def values(self, text: str, **read: float) -> list[float]:
        """The values of the printed Python for the values that it reads."""
        return evaluate(self.clean(text), read)

    def values_of(self, value: TypedNode, read: dict[str, object]) -> list[float]:
        return evaluate(value, read)


def evaluate(value: TypedNode, read: dict[str, object]) -> list[float]:
    scalars = lower(value, "item")
    return [eval(to_python(scalar, leaf), {**vars(math), **vars(formulas), **read}) for scalar in scalars]


def leaf(read: Name | EngineRead | State | Draw) -> str:
    match read:
        case Name(name=name, component=component):
            parts = [name, *([component] if component else [])]
        case EngineRead(function=function, subjects=subjects, component=component):
            parts = [function, *subjects, *([component] if component else [])]
        case State(slot=place) | Draw(stream=place):
            parts = [place.replace("#", "_")]
    return "_".join(parts).replace(".", "_")


@pytest.fixture
def bench() -> Bench:
    return Bench()


@pytest.fixture(scope="session")
def bench_of():
    """A new bench for each example of a property test."""
    return Bench
