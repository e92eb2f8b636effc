"""The viewpoint of a world: where its picture is taken from."""

from __future__ import annotations

from typing import TYPE_CHECKING

from deepbots_cli import frames
from deepbots_cli.webots.nodes import number, parameters, real, rotation, text, vector, walk

if TYPE_CHECKING:
    from deepbots_cli.frames import Frame
    from deepbots_cli.webots.simulation import Simulation
    from deepbots_cli.webots.syntax import Node


class Viewpoint:
    """The Viewpoint node of a world: where it is, and what it follows."""

    def __init__(self, simulation: Simulation) -> None:
        self._simulation = simulation
        nodes = simulation.scene.nodes
        node = next((real(candidate) for candidate in nodes if real(candidate).type == "Viewpoint"), None)
        self.fov, self.frame, self._followed = 0.785, _overview(), None
        """The horizontal field of view (rad), and the frame at the start."""
        if node is not None:
            self.fov = min(max(number(node, "fieldOfView"), 0.05), 2.5)
            self.frame = vector(node, "position"), rotation(node, "orientation")
            self._followed = _solid(simulation, text(node, "follow"))
        self._start_position = self._followed_position()

    def now(self) -> Frame:
        """Return the frame of the picture, which looks along x."""
        return frames.add(self.frame[0], self.moved()), self.frame[1]

    def moved(self) -> frames.Triple:
        """Return how far the solid that the viewpoint follows has moved since the start, m."""
        return frames.subtract(self._followed_position(), self._start_position)

    def _followed_position(self) -> frames.Triple:
        if self._followed is None:
            return 0.0, 0.0, 0.0
        return self._simulation.physics.position(*self._simulation.scene.attachments[self._followed])


def _solid(simulation: Simulation, name: str) -> Node | None:
    """Return the solid of a name such as `robot` or `robot:arm`, whose last part is its field `name`."""
    solid_name = name.rpartition(":")[2]
    for node in walk(simulation.scene.nodes):
        if solid_name and node in simulation.scene.attachments and _name(node) == solid_name:
            return node
    return None


def _name(node: Node) -> str:
    return text(node, "name") if "name" in parameters(node) else ""


def _overview() -> Frame:
    """Return a frame that looks at the origin from 3 m, for a world without a viewpoint."""
    return (-2.4, 0.0, 1.8), frames.quaternion(0.0, 0.6435, 0.0)
