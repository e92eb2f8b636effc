"""What a camera takes pictures of, and how large they are."""

from __future__ import annotations

import math

from deepbots_cli.compiler.values import Values
from deepbots_cli.document.nodes import Path
from deepbots_cli.expressions.dimensions import ANGLE, LENGTH, NUMBER
from deepbots_cli.expressions.types import PLANE, NoNames
from deepbots_cli.program.robots import CameraIntrinsics
from deepbots_cli.scenario.sensors import Camera


def optics(values: Values, path: Path, spec: Camera) -> CameraIntrinsics | None:
    """The optics of the camera that stands at `path`; None after a finding."""
    size = values.numbers((*path, "resolution"), spec.resolution, NUMBER, PLANE)
    fov = values.number((*path, "fov"), spec.fov, ANGLE)
    near, far = 0.0, 10.0
    if spec.range is not None:
        if spec.channels != "depth":
            help = "only pictures of depths have one: `channels: depth`"
            values.findings.add("DB203", values.key_span((*path, "range")), "the range of a camera that measures no distances", help=help)
        ends = values.ends(values.text((*path, "range"), spec.range), "the range of a camera", NoNames(), dimension=LENGTH)
        if ends is None:
            return None
        (near,), (far,) = ends.low, ends.high
    if fov is not None and fov >= math.pi:
        values.findings.add(
            "DB105", values.span((*path, "fov")), f"an angle of view of {math.degrees(fov):g} deg", help="give less than 180 deg"
        )
        return None
    return CameraIntrinsics(int(size[0]), int(size[1]), fov, spec.channels, near, far) if size and fov else None
