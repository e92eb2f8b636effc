"""Light sensors, as the module `controller` has them: the irradiance of the lights of the world."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

from deepbots_cli import frames
from deepbots_cli.frames import IDENTITY_ROTATION
from deepbots_cli.webots.device import HasLookupTable, ScalarSensor, look_up
from deepbots_cli.webots.nodes import boolean, number, vector
from deepbots_cli.webots.shapes import compose

if TYPE_CHECKING:
    from deepbots_cli.frames import Frame, Triple
    from deepbots_cli.webots.scene import Light
    from deepbots_cli.webots.syntax import Node

SUN_DISTANCE_M = 1000.0
"""The distance of a DirectionalLight in the search for obstacles, m."""
_WITHOUT_ATTENUATION = (1.0, 0.0, 0.0)


class _Beam(NamedTuple):
    """The light of one source at a position: the direction to the source, its distance (m), and the shares of
    its intensity that remain after the attenuation by distance and in the cone of a SpotLight."""

    direction: Triple
    distance: float
    attenuation: float
    spot: float


class LightSensor(ScalarSensor, HasLookupTable):
    """The response of a lookup table to the irradiance, W/m^2."""

    def sample(self) -> None:
        answer, share = look_up(self._table, self._irradiance())
        self._value = self._rounded(answer * (1.0 + self._noise(share)))

    def _irradiance(self) -> float:
        """Return the mean over the colors of the light that arrives, through the color filter."""
        node = self._spec.node
        position, rotation = self._frame()
        normal = frames.rotate(rotation, (1.0, 0.0, 0.0))
        total = 0.0
        for light in self._simulation.scene.lights:
            if not boolean(light.node, "on"):
                continue
            beam = _beam(light, self._frame_of(light), position)
            direct = (
                number(light.node, "intensity") * max(0.0, frames.dot(normal, beam.direction)) * beam.spot
            )
            if direct and boolean(node, "occlusion") and self._is_hidden(position, beam):
                direct = 0.0
            color = frames.dot(vector(light.node, "color"), vector(node, "colorFilter")) / 3
            total += beam.attenuation * (_ambient(light.node) + direct) * color
        return total

    def _frame_of(self, light: Light) -> Frame:
        return light.frame if light.body is None else self._simulation.physics.frame(light.body, light.frame)

    def _is_hidden(self, position: Triple, beam: _Beam) -> bool:
        robot = self._spec.body.robot
        skipped = None if robot is None else robot.index
        return (
            self._simulation.physics.rays.cast(position, [beam.direction], beam.distance, skipped)[0][1] >= 0
        )


def _ambient(light: Node) -> float:
    """Return the ambient intensity of a source. As in Webots, one with an attenuation has none."""
    has_attenuation = (
        light.type != "DirectionalLight" and vector(light, "attenuation") != _WITHOUT_ATTENUATION
    )
    return 0.0 if has_attenuation else number(light, "ambientIntensity")


def _beam(light: Light, frame: Frame, position: Triple) -> _Beam:
    """Return the light of a source that arrives at a position; its attenuation is 1 / (a + b d + c d^2)."""
    node = light.node
    if node.type == "DirectionalLight":
        back = frames.scaled(_unit(vector(node, "direction")), -1.0)
        return _Beam(frames.rotate(frame[1], back), SUN_DISTANCE_M, 1.0, 1.0)
    source = compose(frame, (vector(node, "location"), IDENTITY_ROTATION))[0]
    offset = frames.subtract(source, position)
    distance = math.hypot(*offset)
    constant, linear, square = vector(node, "attenuation")
    weakened = constant + linear * distance + square * distance**2
    direction = _unit(offset)
    spot = 1.0
    if node.type == "SpotLight":
        axis = frames.rotate(frame[1], _unit(vector(node, "direction")))
        # The product of unit vectors may round beyond 1.
        spot = _spot_share(node, math.acos(max(-1.0, min(1.0, -frames.dot(axis, direction)))))
    return _Beam(direction, distance, 1 / weakened if weakened > 0 else 0.0, spot)


def _spot_share(node: Node, angle: float) -> float:
    """Return the share of a SpotLight at an angle (rad) to its axis: 1 within `beamWidth`, 0 beyond
    `cutOffAngle`, and a straight line between them."""
    width, edge = number(node, "beamWidth"), number(node, "cutOffAngle")
    if angle > edge:
        return 0.0
    return 1.0 if angle <= width else (edge - angle) / (edge - width)


def _unit(values: Triple) -> Triple:
    length = math.hypot(*values)
    return frames.scaled(values, 1 / length) if length else values
