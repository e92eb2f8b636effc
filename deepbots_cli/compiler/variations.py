"""Figures that a scenario may draw anew in every episode: the nominal value now, an expression for each reset; and noise."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from deepbots_cli.compiler.values import Text, Values
from deepbots_cli.document.nodes import Path
from deepbots_cli.expressions.dimensions import NUMBER, Dimension
from deepbots_cli.expressions.intervals import Interval
from deepbots_cli.expressions.types import Components, Scope, Stage, Typed, zero
from deepbots_cli.expressions.unification import expect
from deepbots_cli.program.resets import RandomizedParameter
from deepbots_cli.program.values import Expression, Noise
from deepbots_cli.scenario.fields import Quantity

if TYPE_CHECKING:
    from deepbots_cli.compiler.namespace import Namespace


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
    if given is None:
        return None
    values = namespace.values
    text, called = values.text(path, given), f"`{path[-1]}`"
    typed = values.quantity(text, called, scope, dimension, components or spread, Stage.EPISODE)
    if typed is None or not _is_bounded(typed, text, called, values):
        return None
    count = len(components or spread or ("",))
    forget(namespace, what, of)
    if typed.type.stage is Stage.FIXED:
        fixed = values.fixed(typed, text, called)
        return None if fixed is None else tuple(float(value) for value in (fixed * count if len(fixed) == 1 else fixed))
    owner = ".".join(map(str, path)) + "".join(f":{name}" for name in of if name)
    value = Expression(str(path[-1]), text.span, text.text, typed, owner, spread)
    namespace.variations.append(RandomizedParameter(what, of, value, count))
    return (_middle(typed.type.interval),) * count


def noise(values: Values, path: Path, given: object, of: Typed, scope: Scope) -> Noise | None:
    """The noise on the value `of`: its standard deviation in the unit of the value, or, written with `%`, as a share of the value.

    None for a deviation of 0, and after a finding.
    """
    text = values.text(path, given)
    if of.type.boolean or of.type.picture:
        help = "take it out, or give it to the number behind it"
        values.findings.add("DB403", text.span, f"noise on {of.type.words}", help=help)
        return None
    components = of.type.components
    deviation = values.quantity(text, "the noise", scope, None, components, Stage.EPISODE)
    if deviation is None or zero(deviation):
        return None
    relative = deviation.type.dimension == NUMBER and (of.type.dimension != NUMBER or "%" in text.text)
    if not relative:
        deviation = expect(deviation, values.report(text), "the noise", dimension=of.type.dimension, components=components)
    std = deviation and Expression("noise", text.span, text.text, deviation, ".".join(map(str, path)), components)
    return Noise(std, relative) if std else None


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
