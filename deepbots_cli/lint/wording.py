"""Figures in findings, in the units that people write."""

from __future__ import annotations

import math

from deepbots_cli.expressions.dimensions import ANGLE, NUMBER, Dimension
from deepbots_cli.expressions.intervals import Interval


def figure(value: float, dimension: Dimension) -> str:
    """`15 deg`, `0.4 m`, `195`."""
    return f"{_number(value, dimension)}{_unit(dimension)}"


def span_of(interval: Interval, dimension: Dimension) -> str:
    """A range as the language writes it: `-18 .. 18 deg`."""
    return f"{_number(interval.low, dimension)} .. {_number(interval.high, dimension)}{_unit(dimension)}"


def between(interval: Interval, dimension: Dimension) -> str:
    """Where values lie, for a sentence."""
    if interval.single:
        return f"always {figure(interval.low, dimension)}"
    if interval.finite:
        return f"between {_number(interval.low, dimension)} and {figure(interval.high, dimension)}"
    known = interval.low if interval.low > -math.inf else interval.high
    return f"{'at least' if interval.low > -math.inf else 'at most'} {figure(known, dimension)}"


def _number(value: float, dimension: Dimension) -> str:
    return f"{math.degrees(value) if dimension == ANGLE else value:.4g}"


def _unit(dimension: Dimension) -> str:
    return "" if dimension == NUMBER else " deg" if dimension == ANGLE else f" {dimension}"
