"""Fields of the scenario as values in SI units, and as expressions; values that every episode draws anew.

Values may use names: `namespace.fields.fixed(arena, "wall_height")` takes the path from the section, and
dimension, components and `known` from the annotation.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import replace
from typing import TypedDict, TypeVar, Unpack

from deepbots_cli.compiler.texts import SourceText
from deepbots_cli.compiler.values import RangeEnds, ValueReader
from deepbots_cli.expressions.dimensions import NUMBER, Dimension
from deepbots_cli.expressions.types import (
    Components,
    Constant,
    Context,
    Invocation,
    Known,
    Scope,
    TypedNode,
    ValueType,
    Vector,
    is_bare_zero,
)
from deepbots_cli.expressions.unification import ANY_SHAPE, expect_value
from deepbots_cli.program.resets import OfLink, Owner, Randomizable, RandomizedParameter
from deepbots_cli.program.robots import Parameter
from deepbots_cli.program.values import Expression, Noise
from deepbots_cli.program.world import Color
from deepbots_cli.scenario.base import Section
from deepbots_cli.scenario.fields.base import FieldType
from deepbots_cli.scenario.fields.quantities import Column, Quantity, Range, dimension_of, measure_dimension
from deepbots_cli.scenario.fields.words import COLORS, color_options

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
        ends = [end for end in typed.type.interval if math.isfinite(end)]
        return (sum(ends) / len(ends) if ends else 0.0,) * count

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
        help = f"keep it within bounds, as in `clamp(normal(2 +- 1{unit}), 1 .. 3{unit})`"
        self._values.add("DB105", text.span, f"`{text.path[-1]}` is drawn without a {end}", help)
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
            help = "remove it, or put the noise on the number from which the value is computed"
            self._values.add("DB403", text.span, f"noise on {of.type.description}", help)
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
            help = "write one color for all episodes"
            self._values.add("DB407", text.span, "this color must be fixed, but the value is random", help)
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
