"""Limits of speed: how fast wheels, joints and the distances between bodies can change, where motors limit it."""

from __future__ import annotations

from deepbots_cli.analysis import Analysis
from deepbots_cli.expressions.intervals import INF
from deepbots_cli.expressions.scalar import Scalar


def rate_of(analysis: Analysis, node: Scalar) -> float:
    """The largest change of a value per second; infinite where nothing limits it."""
    return INF
