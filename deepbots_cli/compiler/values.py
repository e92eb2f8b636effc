"""Texts to typed trees, with findings at their places, and the values of fields that are read by their
annotations.

Names whose definitions had findings are kept apart: later uses of them are not reported.

Values may use names: `namespace.fields.fixed(arena, "wall_height")` takes the path from the section, and
dimension, components and `known` from the annotation.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from collections.abc import Mapping as Table
from dataclasses import replace
from typing import Any, NamedTuple, TypedDict, TypeVar, Unpack

from deepbots_cli.compiler.texts import SourceText, TextFindings
from deepbots_cli.diagnostics import Findings, Fix, Label, Span
from deepbots_cli.diagnostics.nearest import suggest_replacement, with_owner
from deepbots_cli.document.nodes import (
    MappingNode,
    Node,
    NodePath,
    ScalarNode,
    SequenceNode,
    descend,
    to_data,
    without_paths,
)
from deepbots_cli.expressions import check, parser, syntax
from deepbots_cli.expressions.dimensions import ACCELERATION, NUMBER, Dimension
from deepbots_cli.expressions.lower import constant_values
from deepbots_cli.expressions.types import (
    Components,
    Constant,
    Context,
    FindingReporter,
    Invocation,
    Known,
    Redraw,
    Scope,
    TypedNode,
    TypedRange,
    ValueType,
    Vector,
    is_bare_zero,
)
from deepbots_cli.expressions.unification import ANY_SHAPE, expect_kind, expect_range, expect_value
from deepbots_cli.program.resets import OfLink, Owner, Randomizable, RandomizedParameter
from deepbots_cli.program.robots import Parameter
from deepbots_cli.program.values import Expression, Noise
from deepbots_cli.program.world import Color
from deepbots_cli.scenario.base import Section, section_fields
from deepbots_cli.scenario.fields import COLORS, FieldType, choices_help, color_options
from deepbots_cli.scenario.keys import replacement_for
from deepbots_cli.scenario.quantities import Column, Quantity, Range, dimension_of, measure_dimension

Default = TypeVar("Default")


class FieldContext(TypedDict, total=False):
    """The properties of a field that its annotation leaves open and the caller gives: a joint turns or
    slides, a sensor has components.

    With `per_component`, a value is drawn anew for each of these components.
    """

    dimension: Dimension | None
    components: Components | None
    scope: Scope
    known: Known
    per_component: Components | None


class FieldReader:
    """Reads fields of a scenario, each by its annotation.

    Attributes:
        variations: Values that are drawn anew in every episode, in the order in which they were found.
        colors: The same for colors.
    """

    def __init__(self, values: ValueReader, scope: Callable[[Context], Scope]) -> None:
        """Create a reader. `scope` is the default for the names that a field may use; a caller can pass
        another one."""
        self._values = values
        self._scope = scope
        self.variations: list[RandomizedParameter] = []
        self.colors: list[RandomizedParameter] = []

    def typed(
        self, text: SourceText, description: str | None = None, **context: Unpack[FieldContext]
    ) -> TypedNode | None:
        """Return the tree of a quantity; None after a finding, in which the field is called `description`."""
        return self._values.quantity(
            text, description or f"`{text.path[-1]}`", *self._expected_type(text, context)
        )

    def expression(
        self, section: Section, *steps: str | int, **context: Unpack[FieldContext]
    ) -> Expression | None:
        """Return a field that is computed anew in an episode or in a step; None where none is given, and
        after a finding."""
        text = self._text_of(section, steps)
        typed = self.typed(text, **context) if text else None
        return text.expression(typed) if text and typed else None

    def numbers(
        self, section: Section, *steps: str | int, **context: Unpack[FieldContext]
    ) -> tuple[float, ...] | None:
        """Return the SI values of a fixed field; None if none is given, and after a finding.

        With a later `known` the language lets the field vary, and a finding reports that this does not run
        yet.
        """
        text = self._text_of(section, steps)
        if text is None:
            return None
        scope, dimension, components, known = self._expected_type(text, {"known": Known.FIXED, **context})
        called = f"`{text.path[-1]}`"
        typed = self._values.quantity(text, called, scope, dimension, components, known)
        if typed is not None and typed.type.known is not Known.FIXED:
            self._values.add(
                "DB108",
                text.span,
                f"{called} must be fixed: random and changing values are not supported here yet",
                "write a fixed number",
            )
            return None
        return self._si_values(typed, text, len(components or ("",))) if typed else None

    def _si_values(self, typed: TypedNode, text: SourceText, count: int) -> tuple[float, ...] | None:
        """Return the SI values of a fixed tree; a single one is used for all of `count`."""
        fixed = self._values.fixed(typed, text, f"`{text.path[-1]}`")
        return None if fixed is None else tuple(map(float, fixed * count if len(fixed) == 1 else fixed))

    def fixed(self, section: Section, *steps: str | int, **context: Unpack[FieldContext]) -> float | None:
        """Return the SI value of a fixed field that is a single number; None as in `numbers`."""
        numbers = self.numbers(section, *steps, **context)
        return numbers[0] if numbers else None

    def pair(self, section: Section, *steps: str | int) -> tuple[float, float] | None:
        """Return the two SI values of a fixed field in the plane; None as in `numbers`."""
        numbers = self.numbers(section, *steps)
        return (numbers[0], numbers[1]) if numbers else None

    def triple(
        self, section: Section, *steps: str | int, **context: Unpack[FieldContext]
    ) -> tuple[float, float, float] | None:
        """Return the three SI values of a fixed field in space; None as in `numbers`."""
        numbers = self.numbers(section, *steps, **context)
        return (numbers[0], numbers[1], numbers[2]) if numbers else None

    def scalar_or_randomized(
        self,
        section: Section,
        key: str,
        what: Randomizable,
        of: Owner,
        default: Default,
        **context: Unpack[FieldContext],
    ) -> float | Default:
        """Return the SI value of a field that an episode may draw; `default` where none is given, and after a
        finding.

        A drawn value becomes a randomized parameter, and the middle of its interval is returned. With
        `per_component` it is drawn anew for each component.
        """
        values = self.vector_or_randomized(section, key, what, of, **context)
        return values[0] if values else default

    def vector_or_randomized(
        self, section: Section, key: str, what: Randomizable, of: Owner, **context: Unpack[FieldContext]
    ) -> tuple[float, ...] | None:
        """Return the SI values of a vector that an episode may draw; None where none is given, and after a
        finding."""
        text = self._text_of(section, (key,))
        if text is None:
            return None
        called = f"`{key}`"
        per_component = context.get("per_component")
        scope, dimension, components, _ = self._expected_type(text, {"known": Known.EPISODE, **context})
        components = components or per_component
        typed = self._values.quantity(text, called, scope, dimension, components, Known.EPISODE)
        if typed is None or not self._is_bounded(typed, text):
            return None
        count = len(components or ("",))
        # A value that is given again, as for a link that two patterns match, replaces the earlier draw.
        self.variations[:] = [
            variation for variation in self.variations if (variation.what, variation.of) != (what, of)
        ]
        if typed.type.known is Known.FIXED:
            return self._si_values(typed, text, count)
        value = replace(text.expression(typed, per_component=per_component), owner=_owner(text, of))
        self.variations.append(RandomizedParameter(what, of, value, count))
        intervals = typed.type.intervals or (typed.type.interval,) * count
        ends_of_each = ([end for end in interval if math.isfinite(end)] for interval in intervals)
        return tuple(sum(ends) / len(ends) if ends else 0.0 for ends in ends_of_each)

    def _is_bounded(self, typed: TypedNode, text: SourceText) -> bool:
        """Return whether a drawn value keeps the bounds of its field: a normal distribution has none."""
        reach = typed.type.interval
        kind = text.kind
        if not isinstance(kind, Quantity) or typed.type.known is Known.FIXED:
            return True
        end = "minimum" if kind.minimum is not None and reach.low == -math.inf else "maximum"
        if end == "maximum" and (kind.maximum is None or reach.high < math.inf):
            return True
        unit = "" if typed.type.dimension == NUMBER else f" {typed.type.dimension}"
        self._values.add(
            "DB105",
            text.span,
            f"`{text.path[-1]}` is drawn without a {end}",
            f"keep it within bounds, as in `clamp(normal(2 +- 1{unit}), 1 .. 3{unit})`",
        )
        return False

    def ends(
        self,
        section: Section,
        *steps: str | int,
        description: str | None = None,
        falling: bool = False,
        **context: Unpack[FieldContext],
    ) -> RangeEnds | None:
        """Return the ends of a fixed range, in any order where it may be `falling`; None after a finding."""
        text = self._values.field(section, *steps)
        dimension = context.get("dimension") or (
            measure_dimension(text.kind.measure) if isinstance(text.kind, Range) else None
        )
        scope = context.get("scope") or self._scope(Context.FIXED)
        components = context.get("components")
        return self._values.ends(
            text,
            description or f"`{text.path[-1]}`",
            scope,
            dimension=dimension,
            components=components,
            falling=falling,
        )

    def parameters(
        self,
        spec: Section,
        fields: Iterable[tuple[str, FieldType]],
        base_dimension: Dimension,
        *,
        slides: bool = False,
    ) -> tuple[tuple[str, Parameter], ...] | None:
        """Return the `fields` of a sensor or actuator in SI units; None after a finding.

        `base_dimension` is the dimension of its readings or commands. Of a measure such as `torque or force`,
        joints that slide have the second.
        """
        parameters: dict[str, Parameter] = {}
        for key, kind in fields:
            findings_before = len(self._values.findings)
            parameters[key] = (
                None
                if getattr(spec, key) is None
                else self._parameter(spec, key, kind, base_dimension, slides=slides)
            )
            if parameters[key] is None and len(self._values.findings) > findings_before:
                return None
        return tuple(parameters.items())

    def _parameter(
        self, spec: Section, key: str, kind: FieldType, base_dimension: Dimension, *, slides: bool
    ) -> Parameter:
        value = getattr(spec, key)
        if not isinstance(kind, (Quantity, Range, Column)) or (
            isinstance(kind, Quantity) and value in kind.words
        ):
            return value if isinstance(value, (bool, int, float)) else str(value)
        dimension = dimension_of(kind.measure, base_dimension, second=slides)
        if isinstance(kind, Range):
            ends = self.ends(spec, key, dimension=dimension)
            return (*ends.low, *ends.high) if ends else None
        text = self._values.field(spec, key)
        typed = self.typed(text, dimension=dimension, known=Known.FIXED)
        numbers = self._values.fixed(typed, text, f"`{key}`") if typed else None
        is_vector = isinstance(kind, Column) or kind.components
        if numbers is None:
            return None
        if is_vector:
            return tuple(map(float, numbers))
        return float(numbers[0])

    def noise(self, section: Section, of: TypedNode) -> Noise | None:
        """Return the `noise` of a section on the value `of`: its standard deviation in the unit of the value,
        or relative to it with `%`.

        None where none is given, for a standard deviation of 0, and after a finding.
        """
        if "noise" not in section.model_fields_set:
            return None
        text = self._values.field(section, "noise")
        if of.type.boolean or of.type.picture:
            self._values.add(
                "DB403",
                text.span,
                f"noise on {of.type.description}",
                "remove it, or put the noise on the number from which the value is computed",
            )
            return None
        components = of.type.components
        std = self.typed(text, "the noise", components=components)
        if std is None or is_bare_zero(std):
            return None
        relative = std.type.dimension == NUMBER and (of.type.dimension != NUMBER or "%" in text.text)
        if not relative:
            std = expect_value(
                std,
                self._values.reporter(text),
                "the noise",
                dimension=of.type.dimension,
                components=components,
            )
        return Noise(text.expression(std, per_component=components), relative) if std else None

    def color(self, section: Section, of: OfLink | None = None) -> Color | None:
        """Return the `color` of a section; None without one.

        A choice of colors returns the first, and adds a randomized parameter of the link `of`. Without `of`,
        a draw is a finding.
        """
        color = getattr(section, "color", None)
        if color is None:
            return None
        text = self._values.field(section, "color")
        options = [_rgba(word) for word in color_options(color)]
        if of is not None:
            # A link that two patterns match has the color of the later one.
            self.colors[:] = [parameter for parameter in self.colors if parameter.of != of]
        if len(options) > 1 and of is None:
            self._values.add(
                "DB407",
                text.span,
                "this color must be fixed, but the value is random",
                "write one color for all episodes",
            )
        elif len(options) > 1 and of is not None:
            single = ValueType(known=Known.EPISODE)
            ends = tuple(Constant(single, 0, 0, (end,)) for end in (0.0, len(options) - 1.0))
            option_index = Invocation(single, 0, 0, "integer", (), ends, 0)
            shades = tuple(Constant(single, 0, 0, (share,)) for option in options for share in option[:3])
            choice = text.expression(Vector(single, 0, len(text.text), (option_index, *shades)))
            self.colors.append(RandomizedParameter("color", of, replace(choice, owner=_owner(text, of))))
        return options[0]

    def _text_of(self, section: Section, steps: tuple[str | int, ...]) -> SourceText | None:
        return None if getattr(section, str(steps[0])) is None else self._values.field(section, *steps)

    def _expected_type(
        self, text: SourceText, context: FieldContext
    ) -> tuple[Scope, Dimension | None, Components | None, Known]:
        kind = text.kind
        assert isinstance(kind, (Quantity, Column))  # other fields have no numbers
        axes, default = (kind.axes, kind.known) if isinstance(kind, Quantity) else (ANY_SHAPE, "fixed")
        known = context.get("known", Known[default.upper()])
        scope = context.get("scope") or self._scope(Context.FIELD if known else Context.FIXED)
        return (
            scope,
            context.get("dimension") or measure_dimension(kind.measure),
            context.get("components") or axes,
            known,
        )

    def is_randomized(self, what: Randomizable, of: Owner) -> bool:
        """Return whether an episode draws this value."""
        return any((variation.what, variation.of) == (what, of) for variation in self.variations)


def _owner(text: SourceText, subject: tuple[str, ...]) -> str:
    return ":".join((text.owner, *filter(None, subject)))


def _rgba(word: str) -> Color:
    if word.startswith("#"):
        return (int(word[1:3], 16) / 255, int(word[3:5], 16) / 255, int(word[5:7], 16) / 255, 1.0)
    return (*COLORS[word], 1.0)


_KEY_BEFORE = r"(?<![\w.])([\w.]+)['\"]?\s*:\s*$"
_DEFINED_UNDER = {
    "case": "evaluation.cases",
    "stage": "curriculum",
    "line": "world.lines",
    "object": "objects",
    "layout": "reset.layouts",
}
"""The place of definitions, by their name in findings."""
ANY_NAME = "*"
"""The placeholder for all names: the names of a section that is not a mapping are unknown."""

_NAME_SECTIONS = frozenset({"parameters", "augment", "signals", "success", "failure"})
_MAX_KEY_DISTANCE = 200
"""The largest distance of a key before its finding, in characters."""


def invalid_names(root: MappingNode, pruned: Iterable[NodePath], spans: Iterable[Span]) -> set[str]:
    """Return the names in the entries that the schema took out of `root`, and the keys at and right before
    the findings at `spans`."""
    names: set[str] = set()
    data = to_data(root)
    for path in pruned:
        node, key, steps = descend(root, path)
        if steps == len(path):
            replacement = replacement_for(data, path)
            names.update([key.text] if key else [], [replacement.text] if replacement else [], _names(node))
            if path[-1:] and path[-1] in _NAME_SECTIONS and not isinstance(node, MappingNode):
                names.add(ANY_NAME)
    for span in spans:
        before = re.compile(_KEY_BEFORE).search(
            span.source.text, max(0, span.start - _MAX_KEY_DISTANCE), span.start
        )
        names.update([before[1]] if before else [])
        names.update([span.text] if span.end - span.start < _MAX_KEY_DISTANCE else [])
    return names


def _names(node: Node) -> Iterator[str]:
    """Yield all keys below `node`, and the items of its lists."""
    match node:
        case MappingNode():
            for name, entry in node.entries.items():
                yield name
                yield from _names(entry.value)
        case SequenceNode():
            for item in node.items:
                yield from [item.text] if isinstance(item, ScalarNode) else _names(item)


class RangeEnds(NamedTuple):
    """The ends of a range per component, in SI units."""

    dimension: Dimension
    low: tuple[float, ...]
    high: tuple[float, ...]


class ScopedExpression(NamedTuple):
    """A text that was read as an expression: the names visible at its place, and the resulting trees.

    A range gives two trees, a value that is drawn at intervals also their length; after a finding there may
    be none.
    """

    text: SourceText
    scope: Scope
    trees: tuple[TypedNode, ...]


class ValueReader:
    """Reads the values of one scenario.

    `kinds` has the field type at each path; `invalid` has the names whose definitions had findings, and
    `pruned` the paths that the schema took out, whose fields have their defaults. The expressions that were
    read are kept in `readings`, for editors.
    """

    def __init__(
        self,
        root: MappingNode,
        findings: Findings,
        kinds: Table[NodePath, FieldType],
        invalid: Iterable[str] = (),
        pruned: Iterable[NodePath] = (),
    ) -> None:
        self.root = root
        self._valid = without_paths(root, pruned)
        self.findings = findings
        self.readings: list[ScopedExpression] = []
        self._kinds = kinds
        self._invalid = set(invalid)
        self._text_findings = TextFindings(root, findings)

    def span(self, path: NodePath) -> Span:
        """Return the span of the value at `path`, or of the nearest node around it."""
        return descend(self.root, path)[0].span

    def key_span(self, path: NodePath) -> Span:
        """Return the span of the last key of `path`; of the value if there is no key, and of the first line
        for the whole file."""
        node, key, _ = descend(self.root, path)
        if key is None and node is self.root:
            end = node.span.source.text.find("\n", node.span.start, node.span.end)
            return node.span if end < 0 else Span(node.span.source, node.span.start, end)
        return key.span if key else node.span

    def span_of_first(self, path: NodePath, *keys: str) -> Span:
        """Return the span of the value of the first of these keys that the mapping at `path` has; otherwise
        that of the last key of `path`."""
        key = next((key for key in keys if self.is_present((*path, key))), None)
        return self.span((*path, key)) if key else self.key_span(path)

    def text(self, path: NodePath, default: object = None) -> SourceText:
        """Return the text at `path`; a text that the file leaves out has the place of the nearest node around
        it."""
        node, _, steps = descend(self._valid, path)
        if steps == len(path) and isinstance(node, ScalarNode):
            return SourceText(node.text, node.part, self._kinds.get(path), path)
        span = node.span
        return SourceText(str(default), lambda _start, _end: span, None, path)

    def field(self, section: Section, *steps: str | int) -> SourceText:
        """Return the text of a field, or of an item below it; the text of the default if the file leaves it
        out."""
        value: Any = getattr(section, str(steps[0]))
        for step in steps[1:]:
            value = value[step]
        text = self.text((*section.path, *steps), value)
        kind = section_fields(type(section))[str(steps[0])]
        return text if text.kind or not isinstance(kind, FieldType) else text._replace(kind=kind)

    def key_text(self, path: NodePath) -> SourceText:
        """Return the text of the key at the end of `path`."""
        key = descend(self.root, path)[1]
        return SourceText(key.text, key.part, None, path) if key else self.text(path, path[-1])

    def add(
        self,
        code: str,
        span_or_path: Span | NodePath,
        headline: str,
        help: str | None = None,
        *,
        labels: tuple[Label, ...] = (),
        notes: tuple[str, ...] = (),
        fix: Fix | None = None,
    ) -> None:
        """Add a finding at a span, or at the value at a path."""
        span = span_or_path if isinstance(span_or_path, Span) else self.span(span_or_path)
        self.findings.add(code, span, headline, help=help, labels=labels, notes=notes, fix=fix)

    def add_at_key(
        self,
        code: str,
        path: NodePath,
        headline: str,
        help: str | None = None,
        *,
        notes: tuple[str, ...] = (),
    ) -> None:
        """Add a finding at the last key of a path."""
        self.add(code, self.key_span(path), headline, help, notes=notes)

    def check_whole_timesteps(self, seconds: float, timestep: float, span: Span, description: str) -> bool:
        """Return whether a time is a multiple of the timestep; DB308 if it is not."""
        # 3 * 0.1 is 0.30000000000000004.
        is_multiple = abs(seconds - round(seconds / timestep) * timestep) <= 1e-9 * seconds
        if not is_multiple:
            self.add(
                "DB308",
                span,
                f"{description} of {seconds:g} s is not a multiple of the timestep of {timestep:g} s",
                "write a multiple of the timestep",
            )
        return is_multiple

    # Names

    def report_duplicate(self, path: NodePath, name: str, definition: str, first: NodePath) -> None:
        """Report that the key at `path` defines a `name` that is already `definition`, defined at
        `first`."""
        also = (Label(self.key_span(first), "first defined here"),)
        self.add(
            "DB202",
            self.key_span(path),
            f"`{name}` is already {definition}",
            "choose another name",
            labels=also,
        )

    def mark_invalid(self, name: str) -> None:
        """Note that the definition of `name` had a finding."""
        self._invalid.add(name)

    def is_present(self, path: NodePath) -> bool:
        """Return whether the scenario contains this key, be its value right or not."""
        return descend(self.root, path)[2] == len(path)

    def is_invalid(self, name: str) -> bool:
        """Return whether the definition of the dotted `name`, or of a part of it, had a finding."""
        return name in self._invalid or not self._invalid.isdisjoint(name.split("."))

    def report_unknown(
        self, span: Span, noun: str, name: str, names: Sequence[str], code: str = "DB201"
    ) -> None:
        """Report that `name` is none of the `names`, unless its definition had a finding."""
        if not self.is_invalid(name):
            owned = with_owner(name, names)
            suggestion = owned or suggest_replacement(name, names)
            fix = Fix.replacing(span, name, suggestion.text, safe=suggestion.safe) if suggestion else None
            section = _DEFINED_UNDER.get(noun)
            help = choices_help(name, names) if names else f"no {noun} is defined"
            if owned:
                help = f"write `{owned.text}`"
            elif not names and section is not None:
                help = f"define `{name}` under `{section}`"
            self.add(code, span, f"there is no {noun} `{name}`", help, fix=fix)

    def reporter(self, text: SourceText) -> FindingReporter:
        """Return a function that takes findings at offsets of `text`."""
        return self._text_findings.reporter(text)

    def parsed(self, text: SourceText) -> syntax.Node | None:
        if self._text_findings.mentions_reserved_name(text):
            return None
        return parser.parse(text.text, self.reporter(text))

    def expression(self, text: SourceText, scope: Scope, *, boolean: bool | None = None) -> TypedNode | None:
        """Return the typed tree of an expression; `boolean` demands a truth value (True) or a number
        (False)."""
        tree = self.parsed(text)
        typed = check.check(tree, scope, self.reporter(text)) if tree else None
        self.readings.append(ScopedExpression(text, scope, (typed,) if typed else ()))
        if typed is None or boolean is None:
            return typed
        return expect_kind(typed, self.reporter(text), boolean=boolean)

    def condition(self, text: SourceText, scope: Scope) -> TypedNode | None:
        """Return the typed tree of a single truth value."""
        typed = self.expression(text, scope, boolean=True)
        return typed and expect_value(typed, self.reporter(text), "a condition", boolean=True)

    def drawn(self, text: SourceText, scope: Scope) -> check.TypedExpression | None:
        """Return the typed tree of an expression where draws may be repeated (`every 5 s`)."""
        tree = self.parsed(text)
        checked = check.check_drawn(tree, scope, self.reporter(text)) if tree else None
        period = checked.redraw.period if checked and checked.redraw else None
        self.readings.append(
            ScopedExpression(text, scope, tuple(filter(None, (checked and checked.value, period))))
        )
        return checked

    def redrawn(
        self, text: SourceText, description: str, scope: Scope, dimension: Dimension
    ) -> tuple[TypedNode | None, Redraw | None]:
        """Return a single value that may be new in every step, like `quantity`; with it, how often its draws
        are repeated."""
        checked = self.drawn(text, scope)
        value = checked and expect_value(
            checked.value, self.reporter(text), description, dimension=dimension, unit=text.unit
        )
        if checked is None or value is None or not self._is_within(value, text, description):
            return None, None
        return value, checked.redraw

    def range(self, text: SourceText, scope: Scope, *, falling: bool = False) -> TypedRange | None:
        tree = self.parsed(text)
        ends = check.check_range(tree, scope, self.reporter(text), falling=falling) if tree else None
        self.readings.append(ScopedExpression(text, scope, (ends.low, ends.high) if ends else ()))
        return ends

    def quantity(
        self,
        text: SourceText,
        description: str,
        scope: Scope,
        dimension: Dimension | None,
        components: Components | None = None,
        known: Known = Known.FIXED,
        shape_help: str | None = None,
    ) -> TypedNode | None:
        """Return a value of the dimension (None: any) and components that a field declares, known by then.

        `description` is the name of the field in findings, such as "the timestep"; `shape_help` as in
        `expect_value`.
        """
        typed = self.expression(text, scope, boolean=False)
        if typed is None:
            return None
        value = expect_value(
            typed,
            self.reporter(text),
            description,
            dimension=dimension,
            components=components,
            known=known,
            unit=text.unit,
            noun=text.noun(dimension),
            shape_help=shape_help,
        )
        return (
            value
            if value
            and self._is_vector(value, text, description)
            and self._is_within(value, text, description)
            else None
        )

    def _is_vector(self, value: TypedNode, text: SourceText, description: str) -> bool:
        """Return whether a value with a direction has all its components; a size or a factor, which is fixed,
        may be one for all axes."""
        kind = text.kind
        if (
            not isinstance(kind, Quantity)
            or not kind.components
            or kind.known == "fixed"
            or value.type.components is not None
        ):
            return True
        unit = value.type.dimension
        example = f"0 0 -10 .. 0 0 -9 {unit}" if unit == ACCELERATION else f"-1 -1 0 .. 1 1 0 {unit}"
        self.add(
            "DB404",
            text.span,
            f"{description} must be a vector; this is a single value",
            f"write `vector(x, y, z)`, or draw all three components: `uniform({example})`",
        )
        return False

    def _is_within(self, value: TypedNode, text: SourceText, description: str) -> bool:
        """Return whether the value keeps the bounds of its field; the schema has looked at bare numbers
        only."""
        kind = text.kind
        if not isinstance(kind, Quantity) or (
            kind.minimum is None and kind.maximum is None and not kind.whole
        ):
            return True
        constants = constant_values(value)
        low, high = (
            (min(constants), max(constants))
            if constants
            else (value.type.interval.low, value.type.interval.high)
        )
        minimum, maximum = kind.minimum, kind.maximum
        unit = str(value.type.dimension)
        if (
            minimum is not None
            and math.isfinite(low)
            and (low < minimum or (kind.exclusive and low == minimum))
        ):
            odd = low
            help = f"write {'more than' if kind.exclusive else 'at least'} {_with_unit(minimum, unit)}"
            if text.path[-1:] == ("noise",) and low == -high:
                help = (
                    "noise is Gaussian, and `noise` is its standard deviation: write"
                    f" `noise: {_with_unit(float(f'{high / math.sqrt(3.0):.2g}'), unit)}`, which spreads as"
                    f" much as this uniform noise; `bias: {text.text}` is drawn once per episode"
                )
        elif maximum is not None and math.isfinite(high) and high > maximum:
            odd = high
            help = f"write at most {_with_unit(maximum, unit)}"
        elif (
            kind.whole
            and constants
            and (broken := [number for number in constants if not float(number).is_integer()])
        ):
            odd = broken[0]
            help = "write a whole number"
        else:
            return True
        if constants is None:
            verb = "can be"
        elif len(constants) == 1:
            verb = "is"
        else:
            verb = "contains"
        self.add("DB105", text.span, f"{description} {verb} {_with_unit(odd, unit)}", help)
        return False

    def fixed(self, value: TypedNode, text: SourceText, description: str) -> tuple[float | bool, ...] | None:
        """Return the SI values of a value that is settled in the file; a finding where they cannot be
        computed."""
        values = constant_values(value)
        if values is None:
            self.add(
                "DB105",
                text.span,
                f"{description} cannot be computed",
                "correct it: the expression divides by zero, leaves the domain of a function, or gives"
                " too large a number",
            )
        return values

    def ends(
        self,
        text: SourceText,
        description: str,
        scope: Scope,
        *,
        dimension: Dimension | None = None,
        components: Components | None = None,
        falling: bool = False,
    ) -> RangeEnds | None:
        """Return the fixed ends of a range, one per component; with `falling`, in any order. None after a
        finding."""
        interval = self.range(text, scope, falling=falling)
        bounds = interval and expect_range(
            interval, self.reporter(text), description, dimension=dimension, components=components
        )
        low, high = (
            (self.fixed(bounds.low, text, description), self.fixed(bounds.high, text, description))
            if bounds
            else (None, None)
        )
        if bounds is None or low is None or high is None:
            return None
        count = len(components) if components else 1
        lows, highs = (tuple(map(float, ends * count if len(ends) == 1 else ends)) for ends in (low, high))
        if not falling and any(high <= low for low, high in zip(lows, highs, strict=True)):
            self.add("DB105", text.span, "both ends of the range are equal", "write two different ends")
            return None
        return RangeEnds(
            (bounds.high if is_bare_zero(bounds.low) else bounds.low).type.dimension, lows, highs
        )


def _with_unit(number: float, unit: str) -> str:
    return f"{number:g}" if unit == "1" else f"{number:g} {unit}"
