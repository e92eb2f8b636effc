"""DB304: figures beyond the limits of the robot file, told in the unit that they are written in."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator

from deepbots_cli.compiler.values import Text, Values
from deepbots_cli.diagnostics import Edit, Fix
from deepbots_cli.expressions import syntax
from deepbots_cli.expressions.dimensions import ANGLE, UNITS, Dimension, Unit
from deepbots_cli.expressions.intervals import Interval

_NUMBER = re.compile(r"[-+]?[0-9.][0-9_.]*(?:[eE][-+]?[0-9]+)?")
_DIGITS = 4


class Confines:
    """What the robot file allows a figure that is written in `text`."""

    def __init__(self, values: Values, text: Text, dimension: Dimension, allowed: Interval) -> None:
        self._values = values
        self._text = text
        self._allowed = allowed
        tree = values.parsed(text)
        self._figures = list(_figures(tree)) if tree else []
        units = [figure.unit for figure in self._figures if figure.unit is not None and figure.unit.dimension == dimension]
        self._unit = units[0] if units else UNITS["deg"] if dimension == ANGLE else Unit(str(dimension), dimension)

    def report(self, what: str, found: Interval, help: str) -> None:
        """A warning that `what` is `found`, which is not all within what is allowed."""
        limits = self._allowed if self._allowed.low > -math.inf else Interval(self._allowed.high, self._allowed.high)
        headline = f"{what} {self._shown(found)} {self._unit.text}, where the robot file allows {self._shown(limits)}"
        self._values.findings.add("DB304", self._text.span, headline, help=help, fix=self._within())

    def _shown(self, known: Interval) -> str:
        low, high = (f"{end / self._unit.to_si(1.0):.{_DIGITS}g}" for end in known)
        return low if low == high else f"{low} .. {high}"

    def _within(self) -> Fix | None:
        """Each figure at the limit that it is beyond; None where they stand for something else, or none would be left to draw from."""
        kept = [self._held(figure) for figure in self._figures]
        if not kept or (len(kept) > 1 and kept[0] >= kept[1]):
            return None
        edits = []
        for figure, value in zip(self._figures, kept, strict=True):
            written = _NUMBER.match(self._text.text, figure.start)
            if written is None:
                return None
            span = self._text.part(*written.span())
            if span.text != written.group():
                return None
            if value != figure.value:
                edits.append(Edit(span, f"{value:.{_DIGITS}g}"))
        return Fix(tuple(edits), safe=False) if edits else None

    def _held(self, figure: syntax.Number) -> float:
        one = figure.unit.to_si(1.0) if figure.unit else 1.0
        low, high = (end / one for end in self._allowed)
        return _rounded(low, math.ceil) if figure.value < low else _rounded(high, math.floor) if figure.value > high else figure.value


def _figures(tree: syntax.Node) -> Iterator[syntax.Number]:
    """The numbers of a text that holds a single figure, or the two ends that one is drawn from; otherwise none."""
    match tree:
        case syntax.Number():
            yield tree
        case syntax.Call(function="uniform", args=(syntax.Range(low=syntax.Number() as low, high=syntax.Number() as high),)):
            yield from (low, high)


def _rounded(limit: float, inwards: Callable[[float], int]) -> float:
    """A limit to a few digits, and not beyond itself."""
    near = float(f"{limit:.{_DIGITS}g}")
    if math.isclose(near, limit, rel_tol=1e-9) or limit == 0.0:
        return near
    digits = _DIGITS - 1 - math.floor(math.log10(abs(limit)))
    scale = 10.0**digits
    return inwards(limit * scale) / scale
