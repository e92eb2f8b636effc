"""A video of a run, from the viewpoint of the world: where its picture is taken from."""

from __future__ import annotations

import threading
from math import ceil
from queue import Queue
from typing import TYPE_CHECKING, Any

from deepbots_cli import frames
from deepbots_cli.files import atomic_write
from deepbots_cli.view.pictures import check_target, write_gif, write_mp4
from deepbots_cli.webots.nodes import number, parameters, real, rotation, text, vector, walk
from deepbots_cli.webots.rendering import require_opengl

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path
    from types import TracebackType

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


SUFFIXES = (".mp4", ".gif")
WIDTH, HEIGHT = 640, 480
FRAME_RATES = {".mp4": 32.0, ".gif": 10.0}
"""The largest number of pictures per simulated second."""
_WAITING = 8  # pictures that are drawn and not written yet


class VideoRecorder:
    """Writes a video while a world runs: a context manager, and a function to call after each step.

    The video plays in simulated time. The picture follows the solid that the viewpoint follows.
    """

    def __init__(self, simulation: Simulation, path: Path, *, force: bool = False) -> None:
        """Check what can be checked before the run. A file is overwritten only by `force`.

        Raises:
            UsageError: The file exists, has another suffix, or cannot be written.
            MissingExtraError: imageio is missing for an MP4.
            EngineError: There is no OpenGL.
        """
        check_target(path, SUFFIXES, force=force)
        require_opengl()
        self._simulation, self._path = simulation, path
        step = simulation.basic_step / 1000
        # A rate of pictures that divides the rate of steps must not become a lower one by rounding.
        self._every = max(1, ceil(1 / step / FRAME_RATES[path.suffix.lower()] - 1e-9))
        self._rate = 1 / step / self._every
        self._viewpoint = Viewpoint(simulation)
        self._pictures: Queue[Any] = Queue(_WAITING)
        self._writer = threading.Thread(target=self._write, daemon=True)
        self._error: BaseException | None = None
        self._steps = 0

    def __enter__(self) -> VideoRecorder:
        self._draw()
        self._writer.start()
        return self

    def __call__(self) -> None:
        """Draw a picture, if it is time for one."""
        self._steps += 1
        if self._steps % self._every == 0:
            self._draw()

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._pictures.put(None)
        self._writer.join()
        if self._error is not None:
            raise self._error

    def _draw(self) -> None:
        if self._error is None:
            view = self._viewpoint
            self._pictures.put(self._simulation.pictures.colors(view.now(), (WIDTH, HEIGHT), view.fov))

    def _write(self) -> None:
        write = write_gif if self._path.suffix.lower() == ".gif" else write_mp4
        try:
            with atomic_write(self._path) as draft:
                write(draft, self._taken(), self._rate)
        except Exception as error:  # noqa: BLE001  # raised in the thread of the run
            self._error = error
            # Taken on, so that the thread of the run does not wait for room in the queue.
            for _ in self._taken():
                continue

    def _taken(self) -> Iterator[Any]:
        while (picture := self._pictures.get()) is not None:
            yield picture
