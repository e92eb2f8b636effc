"""What an expression is known to be before anything runs, and what it is told about the names in it."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from enum import Enum, IntEnum, StrEnum, auto
from typing import NamedTuple, Protocol

from deepbots_cli.diagnostics.nearest import Meant
from deepbots_cli.expressions.dimensions import NUMBER, Dimension
from deepbots_cli.expressions.intervals import EVERYTHING, Interval

Components = tuple[str, ...]
PLANE: Components = ("x", "y")
SPACE: Components = ("x", "y", "z")
Shape = tuple[int, int, int]
QUATERNION: Components = ("x", "y", "z", "w")


class Copies(tuple[str, ...]):
    """The components of a value for each copy of a group, told by what they are: a joint may be called `hip#1` as well."""


class Stage(IntEnum):
    """When a number is settled: in the file, at a reset, or in every step."""

    FIXED = 0
    EPISODE = 1
    STEP = 2

    @property
    def words(self) -> str:
        return ("fixed", "drawn once per episode", "different in every step")[self]


class Type(NamedTuple):
    """Dimension, components (None for a single value), truth or number, interval in SI, stage.

    The interval of a vector covers all of its components; that of a truth value means nothing. A picture,
    which is neither truth nor number, says its rows, columns and channels.
    """

    dimension: Dimension = NUMBER
    components: Components | None = None
    boolean: bool = False
    interval: Interval = EVERYTHING
    stage: Stage = Stage.FIXED
    picture: Shape | None = None

    @property
    def words(self) -> str:
        """For a sentence: `a speed (m/s)`, `a truth value`."""
        return "a picture" if self.picture else "a truth value" if self.boolean else self.dimension.words

    @property
    def copies(self) -> bool:
        """Whether there is a component for each copy of a group, of which some may be absent."""
        return isinstance(self.components, Copies)

    @property
    def shape_words(self) -> str:
        return "a single value" if self.components is None else f"a vector of {shown(self.components)}"


def shown(names: Iterable[str], most: int = 12) -> str:
    """`a, b, c`, cut short after `most`."""
    listed = list(names)
    return ", ".join(listed[:most]) + (f" and {len(listed) - most} more" if len(listed) > most else "")


class Symbol(NamedTuple):
    """A named value. `type` None marks one whose own definition is broken: using it is no further fault.

    `value` holds SI numbers, one per component, where the value is fixed and known; it is folded.
    `refused` says why the name, which exists, has no value in this place.
    """

    name: str
    type: Type | None
    value: tuple[float | bool, ...] | None = None
    refused: str | None = None


class Kind(StrEnum):
    """What a name stands for as the argument of a world function."""

    ROBOT = "robot"
    LINK = "link"
    JOINT = "joint"
    LINKS = "group of links"
    JOINTS = "group of joints"
    OBJECT = "object"
    OBJECTS = "group of objects"
    WALL = "wall of one piece"
    WALLS = "wall of several pieces"
    LINE = "line"
    SENSOR = "sensor"
    CAMERA = "camera"
    GROUND = "ground"
    BROKEN = "broken"

    @property
    def words(self) -> str:
        return {"object": "an object", "ground": "the ground"}.get(self.value, f"a {self.value}")


class Subject(NamedTuple):
    """A part of the world that functions may ask about.

    `members` are the full names in a group (`dog.fl_toe`), in order. `link` is the full name of the
    link whose pose stands for it: a robot's base link. `pieces` are the bodies that a wall consists of;
    what is asked of the wall is asked of each piece. For joints, `dimension` is that of their
    position (angle or length) and `interval` its limits. The kind `BROKEN` marks one whose own
    definition had findings: using it is no further fault.
    """

    name: str
    kind: Kind
    members: tuple[str, ...] = ()
    link: str | None = None
    dimension: Dimension = NUMBER
    interval: Interval = EVERYTHING
    pieces: tuple[str, ...] = ()

    @property
    def components(self) -> Components | None:
        """The short names of a group's members; None where the subject is a single thing."""
        if self.kind is Kind.OBJECTS:
            return Copies(self.members) if self.members else None
        # The first dot is behind the robot's name; a joint may have dots in its own.
        return tuple(member.partition(".")[2] for member in self.members) if self.members else None


class Context(Enum):
    """The place of an expression in the scenario, which decides what may be called in it."""

    FIXED = auto()
    PARAMETER = auto()
    FIELD = auto()
    EMIT = auto()
    APPLY = auto()
    RECEIVE = auto()
    SIGNAL = auto()
    OBSERVATION = auto()
    FORBID = auto()
    SCRIPT = auto()
    GOAL = auto()
    REWARD = auto()
    ENDING = auto()
    RESET = auto()
    REQUIRE = auto()


class Scope(Protocol):
    """What an expression may see from its place."""

    @property
    def context(self) -> Context: ...

    def lookup(self, name: str) -> Symbol | None:
        """The value of the dotted `name`."""

    def subject(self, name: str, kinds: frozenset[Kind] | None = None) -> Subject | None:
        """The part of the world that the dotted `name` means as an argument of a function.

        Where several parts share the name, as a joint and its link may, it means one of `kinds`.
        """

    def names(self) -> Iterable[str]:
        """Every name that `lookup` knows, for suggestions."""

    def subjects(self) -> Iterable[str]:
        """Every name that `subject` knows, for suggestions."""


class NoNames(NamedTuple):
    """The scope of a literal: nothing is in it."""

    context: Context = Context.FIXED

    def lookup(self, name: str) -> Symbol | None:
        return None

    def subject(self, name: str, kinds: frozenset[Kind] | None = None) -> Subject | None:
        return None

    def names(self) -> Iterable[str]:
        return ()

    def subjects(self) -> Iterable[str]:
        return ()


Rewriting = Callable[[str], str]
"""What to write instead of a piece of text, made of that piece: a good guess."""


class Report(Protocol):
    """Takes a finding; `start` and `end` are offsets in the text of the expression, `meant` is what to write between them."""

    def __call__(
        self,
        code: str,
        start: int,
        end: int,
        headline: str,
        help: str | None = None,
        notes: tuple[str, ...] = (),
        meant: Meant | Rewriting | None = None,
    ) -> None: ...
