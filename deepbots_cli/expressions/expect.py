"""What a field of the scenario demands of an expression: dimension, components, truth or number, stage."""

from __future__ import annotations

from deepbots_cli.expressions import agree
from deepbots_cli.expressions.dimensions import (
    ACCELERATION,
    ANGLE,
    ANGULAR_VELOCITY,
    FORCE,
    LENGTH,
    MASS,
    NUMBER,
    SPEED,
    TIME,
    TORQUE,
    Dimension,
)
from deepbots_cli.expressions.typed import Typed, TypedRange, bare, zero
from deepbots_cli.expressions.types import Components, Report, Stage

ANY_SHAPE: Components = ("*",)
_BARE_MEANS_SI = frozenset({LENGTH, MASS})
_NEEDS_NO_UNIT = _BARE_MEANS_SI | {NUMBER}
# Far beyond any robot; only a wrong unit or a slipped exponent gets there.
_PLAUSIBLE = {
    LENGTH: 1e5,
    MASS: 1e6,
    TIME: 1e7,
    ANGLE: 1e4,
    SPEED: 1e4,
    ACCELERATION: 1e6,
    ANGULAR_VELOCITY: 1e5,
    FORCE: 1e8,
    TORQUE: 1e8,
}
_BEYOND = 10  # times what is plausible: an engine's sums lose their digits
_LARGEST = 1e30  # of what is none of these


def expect(
    value: Typed,
    report: Report,
    what: str,
    *,
    dimension: Dimension | None = None,
    components: Components | None = None,
    boolean: bool = False,
    stage: Stage = Stage.STEP,
    unit: str | None = None,
) -> Typed | None:
    """The value as a field takes it, or None after a finding.

    `what` names the field (`the timestep`). `dimension` None takes any. `components` None takes a
    single value only, a tuple takes those components or a single value for all of them, `ANY_SHAPE`
    takes everything. A bare number counts as SI where a length or a mass is due, a bare zero everywhere;
    another is probably meant in `unit`.
    """
    if boolean != value.type.boolean or value.type.picture:
        (agree.truths if boolean else agree.numbers)([value], report)
        return None
    if not boolean and dimension is not None:
        fitted = _in_dimension(value, dimension, what, report, unit)
        if fitted is None:
            return None
        value = fitted
    if not (_has_shape(value, components, what, report) and _has_stage(value, stage, what, report)):
        return None
    return value if _has_size(value, stage, what, report) else None


def expect_range(
    found: TypedRange,
    report: Report,
    what: str,
    *,
    dimension: Dimension | None = None,
    components: Components | None = None,
    stage: Stage = Stage.FIXED,
    unit: str | None = None,
) -> TypedRange | None:
    """As `expect`, for both ends of a range."""
    if dimension and dimension not in _NEEDS_NO_UNIT and bare(found.low) and bare(found.high) and not zero(found.high):
        agree.missing_unit(found, dimension, report, unit)  # one unit is missing, behind both ends
        return None
    # The right end first: the unit of both stands there.
    high = expect(found.high, report, what, dimension=dimension, components=components, stage=stage)
    low = expect(found.low, report, what, dimension=dimension, components=components, stage=stage) if high else None
    return None if low is None or high is None else found._replace(low=low, high=high)


def _in_dimension(value: Typed, dimension: Dimension, what: str, report: Report, unit: str | None) -> Typed | None:
    if value.type.dimension == dimension:
        return value
    if (bare(value) and dimension in _BARE_MEANS_SI) or agree.has_dimension(value, dimension, what, report, unit=unit):
        return value._replace(type=value.type._replace(dimension=dimension))
    return None


def _has_shape(value: Typed, components: Components | None, what: str, report: Report) -> bool:
    found = value.type.components
    if components == ANY_SHAPE or found is None or found == components:
        return True
    if components is None:
        report(
            "DB404",
            value.start,
            value.end,
            f"{what} is {value.type.shape_words}, not a single value",
            f"pick a component, or reduce it with {'`any` or `all`' if value.type.boolean else '`norm`, `sum`, `max` ...'}",
        )
    elif len(found) != len(components) and found[0] in ("x", "1"):
        report(
            "DB106", value.start, value.end, f"{what} has {len(found)} values, not {len(components)}", f"give {' and '.join(components)}"
        )
    else:
        agree.differing(components, found, value.start, value.end, report)
    return False


def _has_stage(value: Typed, stage: Stage, what: str, report: Report) -> bool:
    if value.type.stage <= stage:
        return True
    allowed = "may be drawn once per episode, but not change within it" if stage is Stage.EPISODE else "must be fixed"
    report("DB407", value.start, value.end, f"{what} is {value.type.stage.words}", f"it {allowed}")
    return False


def _has_size(value: Typed, stage: Stage, what: str, report: Report) -> bool:
    """Warn of what is implausible; a figure that is settled before the episode must also be one to compute with."""
    interval, dimension = value.type.interval, value.type.dimension
    largest = max(abs(interval.low), abs(interval.high))
    most = _PLAUSIBLE.get(dimension)
    limit = _LARGEST if most is None else _BEYOND * most
    if interval.finite and largest > limit and stage is not Stage.STEP and not value.type.boolean:
        unit = "" if dimension == NUMBER else f" {dimension}"
        report("DB105", value.start, value.end, f"{what} of {largest:g}{unit}", f"give at most {limit:g}{unit}")
        return False
    if dimension == ANGLE:
        agree.warn_of_degrees(value, report)
    if most is not None and interval.finite and largest > most and not value.type.boolean:
        report("DB505", value.start, value.end, f"{what} of {largest:g} {dimension}", "check the unit")
    return True
