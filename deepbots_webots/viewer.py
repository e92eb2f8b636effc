"""The page of a world that runs: its bodies in the browser, time and keys.

The world does not wait for the page: the thread of the world leaves the poses of the bodies up to 30 times a
second, and a thread of the page sends them while a browser shows it.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from math import atan, tan
from types import TracebackType
from typing import Any

import numpy as np

from deepbots_cli import frames
from deepbots_cli.frames import Frame
from deepbots_cli.geometry import HeightGrid
from deepbots_cli.port import View
from deepbots_cli.view import server
from deepbots_cli.view.panel import hint, notice, set_theme
from deepbots_cli.view.playback import RELEASE_TIMEOUT_S, Axes, Keys
from deepbots_cli.view.scene import (
    MAX_CELLS,
    add_shape,
    add_triangles,
    aim_camera,
    shaded_mesh,
    with_edges,
)
from deepbots_webots.nodes import number, real, rotation, text, turn_of, vector
from deepbots_webots.scene import solid_of_name
from deepbots_webots.shapes import Grid, Mesh, Plane, Shape, look_of, sky_color, visible_shape
from deepbots_webots.simulation import Pace, Simulation

FRAME_RATE = 30
"""Pictures per second of real time."""
_FAREWELL_S = 0.3  # s; the time in which a browser gets the last picture
_DEFAULT_PLANE_M = 100.0
# From 3 m, to the origin, for a world without a viewpoint.
_OVERVIEW: Frame = ((-2.4, 0.0, 1.8), frames.quaternion(0.0, 0.6435, 0.0))
_ASPECT = 4 / 3

# The code that Webots has for a key: the character in upper case, or a number from 312 on, with the
# modifiers. A character that is not of ASCII is that of the key on an English keyboard.
_SENT_KEY = """e => {
  const pad = {Home: 375, ArrowLeft: 376, ArrowUp: 377, ArrowRight: 378, ArrowDown: 379, End: 382};
  const keys = {End: 312, Home: 313, ArrowLeft: 314, ArrowUp: 315, ArrowRight: 316, ArrowDown: 317,
    PageUp: 366, PageDown: 367};
  const text = /^[ -~]$/.test(e.key) ? e.key : (/^(?:Key|Digit)(.)$/.exec(e.code) ?? [])[1];
  const code = (e.location == 3 && pad[e.key]) || keys[e.key] || text?.toUpperCase().charCodeAt(0);
  const modifiers = 0x10000 * e.shiftKey + 0x20000 * e.ctrlKey + 0x40000 * e.altKey;
  return !code || e.metaKey ? null : code + modifiers; }"""


class Viewpoint:
    """The Viewpoint node of a world: where it is, and what it follows."""

    def __init__(self, simulation: Simulation) -> None:
        self._simulation = simulation
        nodes = simulation.scene.nodes
        node = next((real(candidate) for candidate in nodes if real(candidate).type == "Viewpoint"), None)
        self.fov, self.frame, self._followed = 0.785, _OVERVIEW, None
        """The horizontal field of view (rad), and the frame at the start."""
        if node is not None:
            self.fov = min(max(number(node, "fieldOfView"), 0.05), 2.5)
            orientation = frames.multiply(rotation(node, "orientation"), turn_of(node))
            self.frame = vector(node, "position"), orientation
            self._followed = solid_of_name(simulation.scene, text(node, "follow"))
        self._start_position = self._followed_position()

    def moved(self) -> frames.Triple:
        """Return how far the solid that the viewpoint follows has moved since the start, m."""
        return frames.subtract(self._followed_position(), self._start_position)

    def _followed_position(self) -> frames.Triple:
        if self._followed is None:
            return 0.0, 0.0, 0.0
        return self._simulation.physics.position(*self._simulation.scene.attachments[self._followed])


class Viewer:
    """Serves a world: a context manager, and a function to call after each step. `address` is its URL."""

    def __init__(self, simulation: Simulation, pace: Pace, title: str, host: str, port: int | None) -> None:
        """Start the server, and show the world as it is now.

        Raises:
            UsageError: The host is unknown, or the port is in use.
            MissingExtraError: viser is not installed.
        """
        self._simulation, self._pace = simulation, pace
        self._viewpoint = Viewpoint(simulation)
        self._held: tuple[list[int], float] = ([], 0.0)
        self._server, self.address = server.serve(
            host, port, f"deepbots {title}", self.hold, needs_token=True, sent_key=_SENT_KEY
        )
        try:
            self._add_panel(title)
            self._build("/world")
        except BaseException:
            server.stop(self._server)
            raise
        simulation.held_keys = self.codes
        self._is_stale = threading.Event()
        simulation.on_change.append(self._is_stale.set)
        pace.on_pause = self._read
        self._drawing, self._ended = threading.Lock(), threading.Event()
        self._thread = threading.Thread(target=self._serve, daemon=True)

    def __enter__(self) -> Viewer:
        self._thread.start()
        return self

    def __call__(self) -> None:
        """Leave the poses for the page, if it is time for a picture."""
        if self._is_stale.is_set():
            with self._drawing:
                self._server.scene.reset()
                # A browser keeps the poses of nodes whose names return.
                self._build(self._root.name + "'")
            self._is_stale.clear()
        if time.monotonic() >= self._due or self._pace.is_paused:
            self._read()

    def hold(self, keys: Keys, axes: Axes) -> None:
        """Take the keys that are held on the page, as codes of Webots, the newest first. They are released if
        no message arrives for `RELEASE_TIMEOUT_S`.

        Raises:
            ValueError: A key is not a number.
        """
        self._held = [int(key) for key in keys][: server.MAX_KEYS], time.monotonic()

    def codes(self) -> list[int]:
        codes, at = self._held
        return codes if time.monotonic() - at < RELEASE_TIMEOUT_S else []

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._ended.set()
        self._thread.join()
        if kind is None:  # else the world may still advance in the thread of a controller
            self._read()
        self._draw()
        self._write("the run has ended")
        if self._server.get_clients():
            self._server.flush()
            time.sleep(_FAREWELL_S)
        server.stop(self._server)

    # The scene

    def _build(self, top: str) -> None:
        """Show the shapes of the world, in nodes below a node of this name."""
        scene, world = self._server.scene, self._simulation.scene
        self._root = scene.add_frame(top, show_axes=False)
        self._nodes = [scene.add_frame(f"{top}/{body.index}", show_axes=False) for body in world.bodies]
        for index, visual in enumerate(world.visuals):
            shape = visible_shape(visual, world.files)
            if shape is not None:
                above = top if visual.body is None else f"{top}/{visual.body.index}"
                self._add(
                    f"{above}/shape{index}", shape, look_of(visual.node, world.files).color, visual.frame
                )
        sky = sky_color(world.nodes)
        if sky is not None:
            scene.set_background_image(np.full((1, 1, 3), np.multiply(sky, 255), np.uint8))
        self._sent = np.full((len(self._nodes), 7), np.nan)
        self._read()
        self._draw()
        self._aim()

    def _add(self, name: str, shape: Shape, color: Any, frame: Frame) -> None:
        import trimesh

        scene = self._server.scene
        match shape:
            case Mesh(vertices, faces):
                solid = trimesh.Trimesh(vertices, faces, process=False)
                add_triangles(scene, name, with_edges(solid), color, frame)
            case Plane(size):
                x, y = (*size, _DEFAULT_PLANE_M, _DEFAULT_PLANE_M)[:2]
                flat = HeightGrid(np.zeros((2, 2)), (x, y)).triangles()
                add_triangles(scene, name, trimesh.Trimesh(*flat, process=False), color, frame)
            case Grid(size=(x, y)):
                points, triangles = shape.coarsened(MAX_CELLS).triangles()
                solid = shaded_mesh(points + np.array([x / 2, y / 2, 0.0]), triangles, color)
                scene.add_mesh_trimesh(name, solid, position=frame[0], wxyz=frames.wxyz(frame[1]))
            case _:
                add_shape(scene, name, shape, color, frame)

    def _aim(self) -> None:
        """Look from the viewpoint; a person turns the camera around the middle of the bodies."""
        eye, turned = self._viewpoint.frame
        ahead = frames.rotate(turned, (1.0, 0.0, 0.0))
        middle = self._poses[:, :3].mean(axis=0) if len(self._poses) else np.zeros(3)
        distance = max(0.1, float((middle - eye) @ ahead))
        vertical = 2 * atan(tan(self._viewpoint.fov / 2) / _ASPECT)
        aim_camera(self._server, View(eye, frames.add(eye, frames.scaled(ahead, distance)), fov=vertical))
        self._server.initial_camera.up = frames.rotate(turned, (0.0, 0.0, 1.0))

    # The panel

    def _add_panel(self, title: str) -> None:
        gui, pace = self._server.gui, self._pace
        set_theme(gui, dark=False)
        gui.set_panel_label(title)
        gui.main_panel.dock_right()
        self._state = gui.add_html("")
        acts: dict[str, Callable[[], None]] = {
            "pause": pace.pause,
            "step": pace.step_once,
            "real time": lambda: pace.run(is_fast=False),
            "fast": lambda: pace.run(is_fast=True),
        }
        buttons = gui.add_button_group(
            "time", tuple(acts), hint="pause; one basic time step; at the pace of a clock; as fast as it can"
        )
        buttons.on_click(lambda event: acts[event.target.value]())
        gui.add_html(hint("Keys that you press on this page are those of each Keyboard."))

    def _write(self, state: str) -> None:
        """Write the state of the run."""
        seconds = self._simulation.time / 1000
        self._state.content = notice(state, f"{seconds:.3f} s of simulated time", "#0072B2")

    # While the world runs

    def _read(self) -> None:
        """Leave the poses for the page, in the thread of the world."""
        self._due = time.monotonic() + 1 / FRAME_RATE
        self._poses, self._moved = self._simulation.physics.poses(), self._viewpoint.moved()

    def _serve(self) -> None:
        while not self._ended.wait(1 / FRAME_RATE):
            if self._server.get_clients():
                with self._drawing:
                    self._draw()
                self._write("paused" if self._pace.is_paused else "running")

    def _draw(self) -> None:
        """Send the poses that have changed. The world moves, and not the camera, which belongs to a
        person."""
        poses, (x, y, z) = self._poses, self._moved
        with self._server.atomic():
            for row in np.flatnonzero((poses != self._sent).any(axis=1)):
                self._nodes[row].position, self._nodes[row].wxyz = poses[row, :3], poses[row, 3:]
            self._root.position = (-x, -y, -z)
        self._sent = poses
