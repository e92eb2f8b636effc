"""A video of a run, from the viewpoint of the world."""

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

SUFFIXES = (".mp4", ".gif")
WIDTH, HEIGHT = 640, 480
FRAME_RATES = {".mp4": 32.0, ".gif": 10.0}
"""The largest number of pictures per simulated second."""
_WAITING = 8  # pictures that are drawn and not written yet


class Recorder:
    """Writes a video while a world runs: a context manager, and a function to call after each step.

    The video plays in simulated time. The picture follows the solid that the viewpoint follows.
    """

    def __init__(self, simulation: Simulation, path: Path) -> None:
        """Check what can be checked before the run.

        Raises:
            UsageError: The file exists, has another suffix, or cannot be written.
            MissingExtraError: imageio is missing for an MP4.
            EngineError: There is no OpenGL.
        """
        check_target(path, SUFFIXES, force=False)
        require_opengl()
        self._simulation, self._path = simulation, path
        step = simulation.basic_step / 1000
        self._every = max(1, ceil(1 / step / FRAME_RATES[path.suffix.lower()] - 1e-9))
        self._rate = 1 / step / self._every
        self._viewpoint = _Viewpoint(simulation)
        self._pictures: Queue[Any] = Queue(_WAITING)
        self._writer = threading.Thread(target=self._write, daemon=True)
        self._error: BaseException | None = None
        self._steps = 0

    def __enter__(self) -> Recorder:
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
            frame, fov = self._viewpoint.now()
            self._pictures.put(self._simulation.pictures.colors(frame, (WIDTH, HEIGHT), fov))

    def _write(self) -> None:
        write = write_gif if self._path.suffix.lower() == ".gif" else write_mp4
        try:
            with atomic_write(self._path) as draft:
                write(draft, self._taken(), self._rate)
        except Exception as error:  # noqa: BLE001  # raised in the thread of the run
            self._error = error
            for _ in self._taken():
                continue

    def _taken(self) -> Iterator[Any]:
        while (picture := self._pictures.get()) is not None:
            yield picture


class _Viewpoint:
    """The Viewpoint node of a world: where it is, and what it follows."""

    def __init__(self, simulation: Simulation) -> None:
        self._simulation = simulation
        nodes = simulation.scene.nodes
        node = next((real(candidate) for candidate in nodes if real(candidate).type == "Viewpoint"), None)
        self._fov, self._frame, self._followed = 0.785, _overview(), None
        if node is not None:
            self._fov = min(max(number(node, "fieldOfView"), 0.05), 2.5)
            self._frame = vector(node, "position"), rotation(node, "orientation")
            self._followed = _solid(simulation, text(node, "follow"))
        self._begin = self._place()

    def now(self) -> tuple[Frame, float]:
        """Return the frame of the picture and its field of view, rad."""
        moved = frames.subtract(self._place(), self._begin)
        return (frames.add(self._frame[0], moved), self._frame[1]), self._fov

    def _place(self) -> frames.Triple:
        if self._followed is None:
            return 0.0, 0.0, 0.0
        return self._simulation.physics.position(*self._simulation.scene.places[self._followed])


def _solid(simulation: Simulation, name: str) -> Node | None:
    """Return the solid of a name such as `robot` or `robot:arm`, whose last part is its field `name`."""
    last_part = name.rpartition(":")[2]
    for node in walk(simulation.scene.nodes):
        if last_part and node in simulation.scene.places and _name(node) == last_part:
            return node
    return None


def _name(node: Node) -> str:
    return text(node, "name") if "name" in parameters(node) else ""


def _overview() -> Frame:
    """Return a frame that looks at the origin from 3 m, for a world without a viewpoint."""
    return (-2.4, 0.0, 1.8), frames.quaternion(0.0, 0.6435, 0.0)
