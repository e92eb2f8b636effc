"""Frames on a link: where a sensor or one of its rays sits, and how it is turned."""

from __future__ import annotations

from deepbots_cli.compiler.values import Values
from deepbots_cli.document.nodes import Path
from deepbots_cli.expressions.dimensions import ANGLE, LENGTH
from deepbots_cli.expressions.types import SPACE, Components
from deepbots_cli.robots.model import Pose, Vector
from deepbots_cli.scenario.world import SensorFrame

_TURNS: Components = ("roll", "pitch", "yaw")


def mount(values: Values, path: Path, spec: SensorFrame) -> Pose:
    """The frame that stands at `path`; what has a finding is 0."""
    return Pose(_triple(values, path, spec, "xyz", SPACE), _triple(values, path, spec, "rpy", _TURNS))


def _triple(values: Values, path: Path, spec: SensorFrame, whole: str, parts: Components) -> Vector:
    """Three figures, given at once or by their names."""
    dimension = LENGTH if whole == "xyz" else ANGLE
    if getattr(spec, whole) is not None:
        found = values.numbers((*path, whole), getattr(spec, whole), dimension, SPACE) or (0.0, 0.0, 0.0)
    else:
        found = tuple(_one(values, path, spec, part, whole == "xyz") for part in parts)
    x, y, z = found
    return (x, y, z)


def _one(values: Values, path: Path, spec: SensorFrame, part: str, length: bool) -> float:
    if part not in spec.model_fields_set:
        return 0.0
    return values.number((*path, part), getattr(spec, part), LENGTH if length else ANGLE) or 0.0
