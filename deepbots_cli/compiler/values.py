"""Texts to typed trees, with findings at their places; values that every episode draws anew.

Names whose definitions had findings are kept apart: later uses of them are not reported.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from collections.abc import Mapping as Table
from dataclasses import replace
from typing import TYPE_CHECKING, Any, NamedTuple

from deepbots_cli.diagnostics import Findings, Fix, Label, Span
from deepbots_cli.diagnostics.nearest import Meant, meant, nearest
from deepbots_cli.document.nodes import Mapping, Node, Path, Scalar, descend, to_data
from deepbots_cli.document.nodes import Sequence as SequenceNode
from deepbots_cli.expressions import check, parser, syntax
from deepbots_cli.expressions.dimensions import NUMBER, Dimension
from deepbots_cli.expressions.intervals import Interval
from deepbots_cli.expressions.lower import constant
from deepbots_cli.expressions.types import (
    PLANE,
    SPACE,
    Components,
    Constant,
    Invocation,
    NoNames,
    Redraw,
    Report,
    Scope,
    Stage,
    Type,
    Typed,
    TypedRange,
    Vector,
    zero,
)
from deepbots_cli.expressions.unification import ANY_SHAPE, expect, expect_kind, expect_range
from deepbots_cli.program.resets import RandomizedParameter
from deepbots_cli.program.robots import Parameter
from deepbots_cli.program.values import Expression, Noise
from deepbots_cli.program.world import Colour
from deepbots_cli.scenario.base import Section, fields
from deepbots_cli.scenario.fields import COLOURS, Column, FieldType, Quantity, Range, choose_from, colour_options, dimension_of, other_name
from deepbots_cli.scenario.validate import meant_by

if TYPE_CHECKING:
    from deepbots_cli.compiler.namespace import Namespace


_KEY_BEFORE = re.compile(r"(?<![\w.])([\w.]+)['\"]?\s*:\s*$")
ANY = "*"
"""Stands for all names: those of a section that is no mapping cannot be told."""

_OF_NAMES = frozenset({"parameters", "augment", "signals", "success", "failure"})
_REACH = 200  # how far before a finding its key may stand, in characters


def lost_names(root: Mapping, pruned: Iterable[Path], found: Iterable[Span]) -> set[str]:
    """The names in what the schema took out of `root`, and the keys at and right before the findings `found`."""
    names: set[str] = set()
    data = to_data(root)
    for path in pruned:
        node, key, steps = descend(root, path)
        if steps == len(path):
            near = meant_by(data, path)
            names.update([key.text] if key else [], [near.text] if near else [], _names(node))
            if path[-1:] and path[-1] in _OF_NAMES and not isinstance(node, Mapping):
                names.add(ANY)
    for span in found:
        before = _KEY_BEFORE.search(span.source.text, max(0, span.start - _REACH), span.start)
        names.update([before[1]] if before else [])
        names.update([span.text] if span.end - span.start < _REACH else [])
    return names


def _names(node: Node) -> Iterator[str]:
    """All keys below `node`, and the items of its lists."""
    match node:
        case Mapping():
            for name, entry in node.entries.items():
                yield name
                yield from _names(entry.value)
        case SequenceNode():
            for item in node.items:
                yield from [item.text] if isinstance(item, Scalar) else _names(item)


class Text(NamedTuple):
    """A text of the scenario: what it says, where each part of it stands, and what its field takes."""

    text: str
    part: Callable[[int, int], Span]
    kind: FieldType | None = None
    path: Path = ()

    @property
    def owner(self) -> str:
        """The path in one text; streams of draws are named after it."""
        return ".".join(map(str, self.path))

    def expression(
        self,
        typed: Typed,
        name: str | None = None,
        *,
        spread: Components | None = None,
        redraw: Redraw | None = None,
        noise: Noise | None = None,
    ) -> Expression:
        """The expression of which `typed` is the tree, called like the key unless it has a `name`."""
        return Expression(name or str(self.path[-1]), self.span, self.text, typed, self.owner, spread, redraw, noise=noise)

    @property
    def span(self) -> Span:
        return self.part(0, len(self.text))

    @property
    def unit(self) -> str | None:
        """What a number without a unit is probably in."""
        return self.kind.usual if isinstance(self.kind, Quantity) else None


class Ends(NamedTuple):
    """What a range goes from and to, per component, in SI units."""

    dimension: Dimension
    low: tuple[float, ...]
    high: tuple[float, ...]


class Reading(NamedTuple):
    """A text that was read as an expression: what it sees from its place, and the trees that it came to.

    A range comes to two, what is drawn at intervals also to their length; after a finding there may be none.
    """

    text: Text
    scope: Scope
    trees: tuple[Typed, ...]


class Values:
    """Reads the values of one scenario.

    `kinds` says what the schema wants at each path; `lost` holds the names whose definitions had findings. What was read
    is kept in `readings`, for editors.
    """

    def __init__(self, root: Mapping, findings: Findings, kinds: Table[Path, FieldType], lost: Iterable[str] = ()) -> None:
        self.root = root
        self.findings = findings
        self.readings: list[Reading] = []
        self._kinds = kinds
        self._lost = set(lost)

    def span(self, path: Path) -> Span:
        """Where the value at `path` stands, or the nearest thing around it."""
        return descend(self.root, path)[0].span

    def key_span(self, path: Path) -> Span:
        """Where the key at the end of `path` stands; the value where there is none, and of the whole file its first line."""
        node, key, _ = descend(self.root, path)
        if key is None and node is self.root:
            end = node.span.source.text.find("\n", node.span.start, node.span.end)
            return node.span if end < 0 else Span(node.span.source, node.span.start, end)
        return key.span if key else node.span

    def text(self, path: Path, default: object = None) -> Text:
        """The text at `path`; one that the file leaves out is placed at what surrounds it."""
        node, _, steps = descend(self.root, path)
        if steps == len(path) and isinstance(node, Scalar):
            return Text(node.text, node.part, self._kinds.get(path), path)
        span = node.span
        return Text(str(default), lambda _start, _end: span, None, path)

    def field(self, section: Section, *steps: str | int) -> Text:
        """The text of a field, or of an item below it; that of the default where the file leaves it out."""
        value: Any = getattr(section, str(steps[0]))
        for step in steps[1:]:
            value = value[step]
        text, kind = self.text((*section.path, *steps), value), fields(type(section))[str(steps[0])]
        return text if text.kind or not isinstance(kind, FieldType) else text._replace(kind=kind)

    def key_text(self, path: Path) -> Text:
        """The text of the key at the end of `path`."""
        key = descend(self.root, path)[1]
        return Text(key.text, key.part, None, path) if key else self.text(path, path[-1])

    # Names

    def taken(self, path: Path, name: str, what: str, first: Path) -> None:
        """A finding that the key at `path` defines a `name` that is already `what`, since `first`."""
        also = (Label(self.key_span(first), "first defined here"),)
        self.findings.add("DB202", self.key_span(path), f"`{name}` is already {what}", help="choose another name", also=also)

    def lose(self, name: str) -> None:
        """Note that the definition of `name` had a finding."""
        self._lost.add(name)

    def stands(self, path: Path) -> bool:
        """Whether the scenario holds this key, be its value right or not."""
        return descend(self.root, path)[2] == len(path)

    def is_lost(self, name: str) -> bool:
        """Whether the definition of the dotted `name`, or of a part of it, had a finding."""
        return name in self._lost or not self._lost.isdisjoint(name.split("."))

    def unknown(self, span: Span, what: str, name: str, known: Sequence[str], code: str = "DB201") -> None:
        """A finding that `name` is none of the `known`, unless its definition had one."""
        if not self.is_lost(name):
            help = choose_from(name, known) if known else "there is none to choose from"
            near = meant(name, known)
            fix = Fix.replacing(span, name, near.text, safe=near.safe) if near else None
            self.findings.add(code, span, f"there is no {what} `{name}`", help=help, fix=fix)

    def report(self, text: Text) -> Report:
        """Takes findings at offsets of `text`."""

        def report(code: str, start: int, end: int, headline: str, help: str | None = None, meant: Meant | None = None) -> None:
            span, piece = text.part(start, end), text.text[start:end]
            if code == "DB502" and any(found.code == "DB106" and found.span == span for found in self.findings):
                return  # what to write instead of too few numbers shows the unit
            word = self._word_meant(text, piece) if code == "DB402" else None
            if word and not (help or "").startswith("did you mean"):
                help, meant = f"did you mean `{word}`? {help}", Meant(word, safe=False)
            fix = Fix.replacing(span, piece, meant.text, safe=meant.safe) if meant else None
            self.findings.add(code, span, headline, help=help, fix=fix)

        return report

    @staticmethod
    def _word_meant(text: Text, piece: str) -> str | None:
        """Of a field that takes words beside figures, the one that an unknown name stands for."""
        words = text.kind.words if isinstance(text.kind, Quantity) and piece == text.text.strip() else ()
        return other_name(piece, words) or nearest(piece, words) if words else None

    def parsed(self, text: Text) -> syntax.Node | None:
        return parser.parse(text.text, self.report(text))

    def expression(self, text: Text, scope: Scope, *, boolean: bool | None = None) -> Typed | None:
        """The typed tree of an expression; `boolean` demands a truth value (True) or a number (False)."""
        tree = self.parsed(text)
        typed = check.check(tree, scope, self.report(text)) if tree else None
        self.readings.append(Reading(text, scope, (typed,) if typed else ()))
        if typed is None or boolean is None:
            return typed
        return expect_kind(typed, self.report(text), boolean=boolean)

    def condition(self, text: Text, scope: Scope) -> Typed | None:
        """The same for a single truth value."""
        typed = self.expression(text, scope, boolean=True)
        return typed and expect(typed, self.report(text), "a condition", boolean=True)

    def drawn(self, text: Text, scope: Scope) -> check.Checked | None:
        """The typed tree of an expression where draws may be repeated (`every 5 s`)."""
        tree = self.parsed(text)
        checked = check.check_drawn(tree, scope, self.report(text)) if tree else None
        period = checked.redraw.period if checked and checked.redraw else None
        self.readings.append(Reading(text, scope, tuple(filter(None, (checked and checked.value, period)))))
        return checked

    def redrawn(self, text: Text, what: str, scope: Scope, dimension: Dimension) -> tuple[Typed | None, Redraw | None]:
        """As `quantity`, for a single figure that may be new in every step; with it, how often its draws are repeated."""
        checked = self.drawn(text, scope)
        value = checked and expect(checked.value, self.report(text), what, dimension=dimension, unit=text.unit)
        if checked is None or value is None or not self._is_within(value, text, what):
            return None, None
        return value, checked.redraw

    def range(self, text: Text, scope: Scope, *, falling: bool = False) -> TypedRange | None:
        tree = self.parsed(text)
        ends = check.check_range(tree, scope, self.report(text), falling=falling) if tree else None
        self.readings.append(Reading(text, scope, (ends.low, ends.high) if ends else ()))
        return ends

    def quantity(
        self,
        text: Text,
        what: str,
        scope: Scope,
        dimension: Dimension | None,
        components: Components | None = None,
        stage: Stage = Stage.FIXED,
    ) -> Typed | None:
        """A value of the dimension (None: any) and components that a field declares, settled by `stage`.

        `what` is how findings call the field, such as "the timestep".
        """
        typed = self.expression(text, scope, boolean=False)
        if typed is None:
            return None
        value = expect(typed, self.report(text), what, dimension=dimension, components=components, stage=stage, unit=text.unit)
        return value if value and self._is_vector(value, text, what) and self._is_within(value, text, what) else None

    def _is_vector(self, value: Typed, text: Text, what: str) -> bool:
        """Whether what has a direction has all its components; a size or a factor, which is fixed, may be one for all axes."""
        kind = text.kind
        if not isinstance(kind, Quantity) or not kind.components or kind.stage == "fixed" or value.type.components is not None:
            return True
        help = f"write `vector(x, y, z)`, or draw three: `uniform(-1 -1 0 .. 1 1 0 {value.type.dimension})`"
        self.findings.add("DB404", text.span, f"{what} is a single value, not a vector", help=help)
        return False

    def _is_within(self, value: Typed, text: Text, what: str) -> bool:
        """Whether the value keeps the bounds of its field; the schema has looked at bare numbers only."""
        kind = text.kind
        if not isinstance(kind, Quantity) or (kind.minimum is None and kind.maximum is None and not kind.whole):
            return True
        known = constant(value)
        low, high = (min(known), max(known)) if known else (value.type.interval.low, value.type.interval.high)
        least, most, unit = kind.minimum, kind.maximum, str(value.type.dimension)
        if least is not None and math.isfinite(low) and (low < least or (kind.exclusive and low == least)):
            odd, help = low, f"give {'more than' if kind.exclusive else 'at least'} {_figure(least, unit)}"
        elif most is not None and math.isfinite(high) and high > most:
            odd, help = high, f"give at most {_figure(most, unit)}"
        elif kind.whole and known and (broken := [figure for figure in known if not float(figure).is_integer()]):
            odd, help = broken[0], "give a whole number"
        else:
            return True
        verb = "can be" if known is None else "is" if len(known) == 1 else "holds"
        self.findings.add("DB105", text.span, f"{what} {verb} {_figure(odd, unit)}", help=help)
        return False

    def fixed(self, value: Typed, text: Text, what: str) -> tuple[float | bool, ...] | None:
        """The SI values of a value that is settled in the file; a finding where they cannot be computed."""
        values = constant(value)
        if values is None:
            help = "it divides by zero, leaves the domain of a function, or is too large"
            self.findings.add("DB105", text.span, f"{what} cannot be computed", help=help)
        return values

    def ends(
        self,
        text: Text,
        what: str,
        scope: Scope,
        *,
        dimension: Dimension | None = None,
        components: Components | None = None,
        falling: bool = False,
    ) -> Ends | None:
        """The fixed ends of a range, one per component; with `falling`, in any order. None after a finding."""
        found = self.range(text, scope, falling=falling)
        bounds = found and expect_range(found, self.report(text), what, dimension=dimension, components=components)
        low, high = (self.fixed(bounds.low, text, what), self.fixed(bounds.high, text, what)) if bounds else (None, None)
        if bounds is None or low is None or high is None:
            return None
        count = len(components) if components else 1
        lows, highs = (tuple(map(float, ends * count if len(ends) == 1 else ends)) for ends in (low, high))
        if not falling and any(high <= low for low, high in zip(lows, highs, strict=True)):
            self.findings.add("DB105", text.span, "an empty range", help="let its ends differ")
            return None
        return Ends((bounds.high if zero(bounds.low) else bounds.low).type.dimension, lows, highs)

    def number(self, path: Path, default: object, dimension: Dimension, scope: Scope | None = None) -> float | None:
        """A fixed single value in SI units; None after a finding."""
        values = self.numbers(path, default, dimension, None, scope)
        return values[0] if values else None

    def numbers(
        self, path: Path, default: object, dimension: Dimension, components: Components | None, scope: Scope | None = None
    ) -> tuple[float, ...] | None:
        """The fixed SI values of a vector with `components`; None after a finding."""
        return self.settled(self.text(path, default), scope or NoNames(), dimension, components)

    def settled(
        self, text: Text, scope: Scope, dimension: Dimension | None, components: Components | None, stage: Stage = Stage.FIXED
    ) -> tuple[float, ...] | None:
        """The SI values of a field that is fixed; None after a finding. One that the language lets vary up to `stage` may not do so yet."""
        what = f"`{text.path[-1]}`"
        typed = self.quantity(text, what, scope, dimension, components, stage)
        if typed is not None and typed.type.stage is not Stage.FIXED:
            self.findings.add("DB108", text.span, f"{what} that is drawn anew is not supported yet", help="give a fixed figure")
            return None
        values = self.fixed(typed, text, what) if typed else None
        if not values:
            return None
        count = len(components) if components else 1
        return tuple(float(value) for value in (values * count if len(values) == 1 else values))


def _figure(number: float, unit: str) -> str:
    return f"{number:g}" if unit == "1" else f"{number:g} {unit}"


def figure(
    namespace: Namespace, path: Path, given: object, dimension: Dimension, scope: Scope, what: str, of: tuple[str, ...]
) -> float | None:
    """The SI value of a figure that an episode may vary; None where none is given, and after a finding.

    `what` is its entry in the table of variations (`emit.variations`), `of` whose it is. A drawn figure
    is noted there, and the middle of its interval returned.
    """
    found = figures(namespace, path, given, dimension, scope, what, of)
    return found[0] if found else None


def forget(namespace: Namespace, what: str, of: tuple[str, ...]) -> None:
    """A figure that is given again, as for a link that two patterns mean, replaces what was to be drawn."""
    namespace.variations[:] = [known for known in namespace.variations if (known.what, known.of) != (what, of)]


def figures(
    namespace: Namespace,
    path: Path,
    given: object,
    dimension: Dimension,
    scope: Scope,
    what: str,
    of: tuple[str, ...],
    components: Components | None = None,
    spread: Components | None = None,
) -> tuple[float, ...] | None:
    """The same for a vector of `components`, or for one figure that is drawn anew for each of `spread`."""
    return None if given is None else varied(namespace, namespace.values.text(path, given), dimension, scope, what, of, components, spread)


def varied(
    namespace: Namespace,
    text: Text,
    dimension: Dimension | None,
    scope: Scope,
    what: str,
    of: tuple[str, ...],
    components: Components | None = None,
    spread: Components | None = None,
) -> tuple[float, ...] | None:
    """The SI values of a figure that an episode may vary; a drawn one is noted in the table of variations."""
    values, called = namespace.values, f"`{text.path[-1]}`"
    typed = values.quantity(text, called, scope, dimension, components or spread, Stage.EPISODE)
    if typed is None or not _is_bounded(typed, text, called, values):
        return None
    count = len(components or spread or ("",))
    forget(namespace, what, of)
    if typed.type.stage is Stage.FIXED:
        fixed = values.fixed(typed, text, called)
        return None if fixed is None else tuple(float(value) for value in (fixed * count if len(fixed) == 1 else fixed))
    value = replace(text.expression(typed, spread=spread), owner=_owner(text, of))
    namespace.variations.append(RandomizedParameter(what, of, value, count))
    return (_middle(typed.type.interval),) * count


def _owner(text: Text, of: tuple[str, ...]) -> str:
    return ":".join((text.owner, *filter(None, of)))


def noise(namespace: Namespace, section: Section, of: Typed) -> Noise | None:
    """The `noise` of a section on the value `of`: its standard deviation in the unit of the value, or, written with `%`, as a share of it.

    None where none is given, for a deviation of 0, and after a finding.
    """
    if "noise" not in section.model_fields_set:
        return None
    values, text = namespace.values, namespace.values.field(section, "noise")
    if of.type.boolean or of.type.picture:
        help = "take it out, or give it to the number behind it"
        values.findings.add("DB403", text.span, f"noise on {of.type.words}", help=help)
        return None
    components = of.type.components
    deviation = namespace.typed(text, "the noise", components=components)
    if deviation is None or zero(deviation):
        return None
    relative = deviation.type.dimension == NUMBER and (of.type.dimension != NUMBER or "%" in text.text)
    if not relative:
        deviation = expect(deviation, values.report(text), "the noise", dimension=of.type.dimension, components=components)
    return Noise(text.expression(deviation, spread=components), relative) if deviation else None


def _is_bounded(typed: Typed, text: Text, called: str, values: Values) -> bool:
    """Whether what is drawn keeps the bounds that its field has: a normal draw has none, and would break them now and then."""
    reach, kind = typed.type.interval, text.kind
    if not isinstance(kind, Quantity) or typed.type.stage is Stage.FIXED:
        return True
    end = "least" if kind.minimum is not None and reach.low == -math.inf else "greatest"
    if end == "greatest" and (kind.maximum is None or reach.high < math.inf):
        return True
    help = "keep it within bounds, as in `clamp(normal(2 +- 1), 1 .. 3)`"
    values.findings.add("DB105", text.span, f"{called} is drawn without a {end} value", help=help)
    return False


def _middle(reach: Interval) -> float:
    """Of an interval without one, the end that it has."""
    ends = [end for end in (reach.low, reach.high) if math.isfinite(end)]
    return sum(ends) / len(ends) if ends else 0.0


def colour(namespace: Namespace, section: Section, of: tuple[str, str] | None = None) -> Colour | None:
    """The `colour` of a section, None where none is given.

    Of several to draw from it is the first, and the draw is noted as a variation of a body and link, `of`; without
    one, a draw is a finding.
    """
    given = getattr(section, "colour", None)
    if given is None:
        return None
    text = namespace.values.field(section, "colour")
    if of is not None:
        namespace.colours[:] = [known for known in namespace.colours if known.of != of]  # as for a link that two patterns mean
    options = [_paint(word) for word in colour_options(given)]
    if len(options) > 1 and of is None:
        help = "it is the same in every episode; give one colour"
        namespace.values.findings.add("DB407", text.span, "a draw of a colour that is fixed", help=help)
    elif len(options) > 1 and of is not None:
        single = Type(stage=Stage.EPISODE)
        ends = tuple(Constant(single, 0, 0, (end,)) for end in (0.0, len(options) - 1.0))
        which = Invocation(single, 0, 0, "integer", (), ends, 0)
        shades = tuple(Constant(single, 0, 0, (share,)) for option in options for share in option[:3])
        drawn = text.expression(Vector(single, 0, len(text.text), (which, *shades)))
        namespace.colours.append(RandomizedParameter("colour", of, replace(drawn, owner=_owner(text, of))))
    return options[0]


def _paint(word: str) -> Colour:
    if word.startswith("#"):
        return (int(word[1:3], 16) / 255, int(word[3:5], 16) / 255, int(word[5:7], 16) / 255, 1.0)
    return (*COLOURS[word], 1.0)


# Parameters that a kind of sensor or actuator has of its own


def read_parameters(
    values: Values,
    place: Path,
    spec: Section,
    wanted: Iterable[tuple[str, FieldType]],
    own: Dimension,
    scope: Scope,
    *,
    slides: bool = False,
) -> tuple[tuple[str, Parameter], ...] | None:
    """The `wanted` parameters of the sensor or actuator at `place`, in SI units; None after a finding.

    `own` is the dimension of its readings or commands. Of a measure such as `torque or force`, joints that slide have the second.
    """
    read: dict[str, Parameter] = {}
    for key, kind in wanted:
        given, found = getattr(spec, key), len(values.findings)
        read[key] = None if given is None else _parameter(values, (*place, key), given, kind, own, scope, slides)
        if read[key] is None and len(values.findings) > found:
            return None
    return tuple(read.items())


def _parameter(values: Values, path: Path, given: Any, kind: FieldType, own: Dimension, scope: Scope, slides: bool) -> Parameter:
    if not isinstance(kind, (Quantity, Range, Column)) or (isinstance(kind, Quantity) and given in kind.words):
        return given if isinstance(given, (bool, int, float)) else str(given)
    text, what, dimension = values.text(path, given), f"`{path[-1]}`", dimension_of(kind.dimension, own, second=slides)
    if isinstance(kind, Range):
        ends = values.ends(text, what, scope, dimension=dimension)
        return (*ends.low, *ends.high) if ends else None
    components = ANY_SHAPE if isinstance(kind, Column) else {2: PLANE, 3: SPACE}.get(kind.components or 0)
    typed = values.quantity(text, what, scope, dimension, components)
    numbers = values.fixed(typed, text, what) if typed else None
    return None if numbers is None else tuple(map(float, numbers)) if components else float(numbers[0])
