"""Types, symbols and scopes of expressions, and the typed tree."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from enum import Enum, IntEnum, StrEnum
from types import MappingProxyType
from typing import NamedTuple, Protocol

from deepbots_cli.diagnostics.nearest import Replacement
from deepbots_cli.expressions.dimensions import NUMBER, Dimension, Unit
from deepbots_cli.expressions.intervals import EVERYTHING, Interval, hull

Components = tuple[str, ...]
PLANE: Components = ("x", "y")
SPACE: Components = ("x", "y", "z")
QUATERNION: Components = ("x", "y", "z", "w")
Shape = tuple[int, int, int]
"""Rows, columns and channels of a picture."""

CORRECTED_LINE = "{corrected line}"
"""The placeholder in a help for the line to write, which the reader of the text fills in."""

NO_NAMES: Mapping[str, str | None] = MappingProxyType({})


class GroupComponents(tuple[str, ...]):
    """The components of a value that has one per copy of a group. They cannot be recognized by their names: a
    joint may be called `hip#1`, too."""


class RowComponents(tuple[str, ...]):
    """The components of a value that has a vector for each member of a group, or for each row of a table:
    `fl_toe.x`, `fl_toe.y`, `fl_toe.z`, `fr_toe.x` and so on.

    `rows` are the names of the members, `columns` the components of each vector.
    """

    rows: Components
    columns: Components

    def __new__(cls, rows: Components, columns: Components) -> RowComponents:
        components = super().__new__(cls, (f"{row}.{column}" for row in rows for column in columns))
        components.rows, components.columns = rows, columns
        return components

    def __getnewargs__(self) -> tuple[Components, Components]:
        """Return the arguments that make a copy."""
        return self.rows, self.columns

    def column(self, name: str) -> tuple[int, ...]:
        """Return the positions of a component of all rows."""
        return tuple(range(self.columns.index(name), len(self), len(self.columns)))

    def row(self, name: str) -> tuple[int, ...]:
        """Return the positions of the components of a row."""
        first = self.rows.index(name) * len(self.columns)
        return tuple(range(first, first + len(self.columns)))

    @property
    def of_rows(self) -> tuple[int, ...]:
        """The position of the row of each component."""
        return tuple(row for row in range(len(self.rows)) for _ in self.columns)

    @property
    def of_columns(self) -> tuple[int, ...]:
        """The position of each component in its row."""
        return tuple(range(len(self.columns))) * len(self.rows)


class Known(IntEnum):
    """The time from which a value is known: in the file, at a reset, or in every step."""

    FIXED = 0
    EPISODE = 1
    STEP = 2

    @property
    def description(self) -> str:
        return ("fixed", "drawn once per episode", "different in every step")[self]


class ValueType(NamedTuple):
    """Dimension, components (None for a single value) and interval in SI units of a number, truth value or
    picture, and when it is known.

    The interval of a vector covers all its components; `intervals` are those of each, where they differ. The
    interval of a truth value has no meaning.
    """

    dimension: Dimension = NUMBER
    components: Components | None = None
    boolean: bool = False
    interval: Interval = EVERYTHING
    known: Known = Known.FIXED
    picture: Shape | None = None
    intervals: tuple[Interval, ...] = ()

    def with_intervals(self, intervals: Iterable[Interval]) -> ValueType:
        """Return the type with an interval per component, or with one for all of them. Equal ones are kept
        once: a scan has 1000 components."""
        by_component = tuple(intervals)
        return self._replace(
            interval=hull(by_component), intervals=by_component if len(set(by_component)) > 1 else ()
        )

    def selected(self, indices: Sequence[int]) -> ValueType:
        """Return the type of some components of a vector, by position."""
        names = (
            tuple(self.components[index] for index in indices)
            if self.components and len(indices) > 1
            else None
        )
        selection = self._replace(components=names)
        return (
            selection.with_intervals(self.intervals[index] for index in indices)
            if self.intervals
            else selection
        )

    def interval_of(self, component: str | None) -> Interval:
        """Return the interval of one component; that of the whole, if no other is known."""
        if self.components and self.intervals and component in self.components:
            return self.intervals[self.components.index(component)]
        return self.interval

    @property
    def description(self) -> str:
        """The type for a sentence: `a speed (m/s)`, `a truth value`."""
        if self.picture:
            return "a picture"
        if self.boolean:
            return "a truth value"
        return self.dimension.description

    @property
    def has_group_components(self) -> bool:
        """Whether there is a component per copy of a group, of which some may be absent."""
        return isinstance(self.components, GroupComponents)

    @property
    def shape_description(self) -> str:
        if self.components is None:
            return "a single value"
        if isinstance(self.components, RowComponents):
            rows, columns = self.components.rows, self.components.columns
            return f"a vector of {shortened_list(columns)} for each of {shortened_list(rows)}"
        return f"a vector of {shortened_list(self.components)}"


def shortened_list(names: Iterable[str], limit: int = 12) -> str:
    """Return `a, b, c`, cut short after `limit`."""
    listed = list(names)
    return ", ".join(listed[:limit]) + (f" and {len(listed) - limit} more" if len(listed) > limit else "")


class Symbol(NamedTuple):
    """A named value.

    `type` is None if the definition is invalid; uses are then not reported. `value` holds the SI numbers of a
    fixed value, one per component; lowering folds them. `text` is the source text of the definition.
    `refusal` is the reason why the name has no value in this place.
    """

    name: str
    type: ValueType | None
    value: tuple[float | bool, ...] | None = None
    refusal: str | None = None
    text: str = ""


class Kind(StrEnum):
    """The kind of a part of the world, as an argument of a world function."""

    ROBOT = "robot"
    LINK = "link"
    JOINT = "joint"
    LINKS = "group of links"
    JOINTS = "group of joints"
    OBJECT = "object"
    OBJECTS = "group of objects"
    WALL = "wall with one segment"
    WALLS = "wall with several segments"
    LINE = "line"
    SENSOR = "sensor"
    CAMERA = "camera"
    GROUND = "ground"
    BROKEN = "broken"

    @property
    def description(self) -> str:
        return {"object": "an object", "ground": "the ground"}.get(self.value, f"a {self.value}")


class Subject(NamedTuple):
    """A part of the world, as an argument of a world function.

    `members` are the full names in a group (`dog.fl_toe`), in order. `link` is the full name of the link
    whose pose is read: a robot's base link. `pieces` are the bodies of a wall; a function reads each piece.
    For joints, `dimension` is that of their position (angle or length), `interval` has their limits and
    `intervals` those of each member. Uses of the kind `BROKEN`, an invalid definition, are not reported.
    """

    name: str
    kind: Kind
    members: tuple[str, ...] = ()
    link: str | None = None
    dimension: Dimension = NUMBER
    interval: Interval = EVERYTHING
    pieces: tuple[str, ...] = ()
    intervals: tuple[Interval, ...] = ()

    @property
    def components(self) -> Components | None:
        """The short names of a group's members; None where the subject is a single thing."""
        if self.kind is Kind.OBJECTS:
            return GroupComponents(self.members) if self.members else None
        # The first dot follows the robot's name; a joint may have dots in its own.
        return tuple(member.partition(".")[2] for member in self.members) if self.members else None


class Context(Enum):
    """The place of an expression in the scenario, on which the functions that may be called depend."""

    FIXED = "a fixed value"
    PARAMETER = "a parameter"
    FIELD = "a field of the world"
    EMIT = "a value that a robot sends"
    APPLY = "a command under `apply`"
    RECEIVE = "a value that a robot receives"
    SIGNAL = "a signal"
    OBSERVATION = "the range of an observation"
    FORBID = "a `forbid` condition"
    SCRIPT = "a script"
    TEST = "a test"
    GOAL = "a goal"
    REWARD = "a reward"
    ENDING = "an ending"
    RESET = "a reset"
    REQUIRE = "a requirement on the start"


class Scope(Protocol):
    """The names that an expression may use in its place."""

    @property
    def context(self) -> Context: ...

    def lookup(self, name: str) -> Symbol | None:
        """Return the value of the dotted `name`."""

    def subject(self, name: str, kinds: frozenset[Kind] | None = None) -> Subject | None:
        """Return the part of the world with the dotted `name`; one of `kinds` where several parts share it,
        as a joint and its link may."""

    def names(self) -> Iterable[str]:
        """Return every name that `lookup` finds, for suggestions."""

    def subjects(self) -> Iterable[str]:
        """Return every name that `subject` finds, for suggestions."""


class FindingReporter(Protocol):
    """Takes a finding at the offsets `[start, end)` of the text.

    `replacement` is the text to write there instead. `names` are the named values that probably cause the
    finding, each with the value it probably should have (None if that is open). `corrected` makes the whole
    right text from the text; the line with it replaces `CORRECTED_LINE` in `help`, and the text itself if
    this is the `replacement`.
    """

    def __call__(
        self,
        code: str,
        start: int,
        end: int,
        headline: str,
        help: str | None = None,
        replacement: Replacement | None = None,
        names: Mapping[str, str | None] = NO_NAMES,
        corrected: Callable[[str], str] | None = None,
    ) -> None: ...


# The typed tree. Every node holds its type and its place in the text, [start, end).

INEQUALITIES = frozenset({"less", "less_equal", "greater", "greater_equal"})

MAX_SIZE = 10_000
"""The maximum number of operations of a checked expression: nested vector functions repeat their arguments
and could grow to millions."""
_WORLD_SIZE = 40  # operations of the largest world function, per component of its result
_READS_PER_ROTATED_COMPONENT = 3  # every component of a turned vector reads all three of the argument


class Constant(NamedTuple):
    """SI values, one per component; `unit` as written, None for bare numbers and truth values."""

    type: ValueType
    start: int
    end: int
    values: tuple[float | bool, ...]
    unit: Unit | None = None


class Reference(NamedTuple):
    """The value of a symbol."""

    type: ValueType
    start: int
    end: int
    symbol: Symbol


class ComponentSelection(NamedTuple):
    """Some components of a vector, by position."""

    type: ValueType
    start: int
    end: int
    value: TypedNode
    indices: tuple[int, ...]


class Operation(NamedTuple):
    """An operator applied elementwise: `add`, `less`, `and` ... (the names of `scalar.Op`)."""

    type: ValueType
    start: int
    end: int
    operator: str
    args: tuple[TypedNode, ...]


class Vector(NamedTuple):
    """Single values put together."""

    type: ValueType
    start: int
    end: int
    items: tuple[TypedNode, ...]


class Invocation(NamedTuple):
    """A function of the table; ranges and the like are flattened into `args`.

    `occurrence` counts the stateful calls and draws of one text, in its order; None for others.
    """

    type: ValueType
    start: int
    end: int
    function: str
    subjects: tuple[Subject, ...]
    args: tuple[TypedNode, ...]
    occurrence: int | None = None


TypedNode = Constant | Reference | ComponentSelection | Operation | Vector | Invocation
"""A node of the tree of an expression, with its type; its start and end are offsets in the text."""


class TypedRange(NamedTuple):
    """A range with both ends; they agree in dimension, and in components where both are vectors."""

    low: TypedNode
    high: TypedNode
    start: int
    end: int


class Redraw(NamedTuple):
    """The interval at which the draws of an expression are repeated; `period` None means in each step."""

    period: TypedNode | None


def children(node: TypedNode) -> tuple[TypedNode, ...]:
    match node:
        case Constant() | Reference():  # first: most nodes are one of these
            return ()
        case ComponentSelection(value=value):
            return (value,)
        case Operation(args=args) | Invocation(args=args):
            return args
        case Vector(items=items):
            return items


def walk(node: TypedNode) -> Iterator[TypedNode]:
    """Yield every node, each before its children."""
    waiting = [node]
    while waiting:
        node = waiting.pop()
        yield node
        if not isinstance(node, (Constant, Reference)):
            # The last item of the stack is next, so the first child is added last.
            waiting += reversed(children(node))


def referenced_names(tree: TypedNode) -> Iterator[str]:
    """Return the names that an expression refers to."""
    return (node.symbol.name for node in walk(tree) if isinstance(node, Reference))


def unit_of_text(value: TypedNode) -> Unit | None:
    """Return the unit in which the text writes the value: the first one of its dimension; None where the text
    has none."""
    dimension = value.type.dimension
    units = (node.unit for node in walk(value) if isinstance(node, Constant) and node.unit is not None)
    return next((unit for unit in units if unit.dimension == dimension), None)


def is_bare_number(value: TypedNode) -> bool:
    """Return whether this is made of numbers without units alone."""
    match value:
        case Constant(unit=unit):
            return unit is None and not value.type.boolean
        case Operation(operator="where", args=(_, *parts)):
            return all(is_bare_number(part) for part in parts)
        case Operation(args=parts) | Vector(items=parts):
            return not value.type.boolean and all(is_bare_number(part) for part in parts)
        case Invocation(function="uniform" | "integer" | "normal" | "choice", args=parts):
            return all(is_bare_number(part) for part in parts)
        case _:
            return False


def is_bare_zero(value: TypedNode) -> bool:
    """Return whether this is a bare zero, which fits every dimension."""
    return isinstance(value, Constant) and is_bare_number(value) and not any(value.values)


def size(node: TypedNode) -> int:
    """Return an upper bound of the number of operations over all components, cut off at twice `MAX_SIZE`."""
    count = len(node.type.components) if node.type.components else 1
    if isinstance(node, (Constant, Reference)):
        return min(count, 2 * MAX_SIZE)
    of_world = isinstance(node, Invocation) and bool(node.subjects)
    repeated = _READS_PER_ROTATED_COMPONENT if of_world else 1
    total = count * (_WORLD_SIZE if of_world else 1)
    for child in children(node):
        single = child.type.components is None and not isinstance(node, Vector)
        total += size(child) * (count if single else 1) * repeated
    return min(total, 2 * MAX_SIZE)
