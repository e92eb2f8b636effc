"""The world in viser's scene. Bodies are created once, and move with each frame.

Geometry is put below the frames of links, and only those frames move: a busy browser shows new poses at once
and new geometry late. Links that are connected by fixed joints are one node.
"""

from __future__ import annotations

import math
import re
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import lru_cache
from io import BytesIO
from itertools import pairwise, product
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from deepbots_cli import frames, geometry
from deepbots_cli.engines.mechanics import LINK_COLORS, arena_walls, forms_of, rigid_group
from deepbots_cli.errors import EngineError
from deepbots_cli.frames import Triple
from deepbots_cli.port import ZERO_VECTOR, View
from deepbots_cli.program.world import Color, Line, WorldModel
from deepbots_cli.robots.kinematics import robot_bounds
from deepbots_cli.robots.mesh_formats import GLTF_SUFFIXES, is_plain_obj
from deepbots_cli.robots.meshes import read_verified
from deepbots_cli.robots.model import (
    Box,
    Capsule,
    Cylinder,
    Geometry,
    Mesh,
    Pose,
    RobotModel,
    Shape,
    Sphere,
)
from deepbots_cli.runtime.overview import view_around
from deepbots_cli.view.frames import FrameLayout, LinkName, WorldFrame

if TYPE_CHECKING:
    import trimesh
    import viser

GROUND_COLOR: Color = (0.95, 0.955, 0.965, 1.0)
_DEFAULT_COLOR: Color = (0.72, 0.74, 0.78, 1.0)
MAX_CELLS = 120  # the largest number of cells of a terrain along a side
_MIN_BRIGHTNESS = 0.55  # the brightness of the lowest place of a terrain
_SETTLING_S = 2.0  # the time for which a changed world is seen from the place before

Points = NDArray[np.float32]


# Geometry


@lru_cache(maxsize=128)
def triangles(mesh: Mesh) -> Any:
    """Return the triangles of a mesh file, scaled, in m. They are cached, because a world that begins again
    has the same meshes, and each takes 0.5 s.

    Raises:
        EngineError: The file was removed or changed, or cannot be read.
    """
    import trimesh

    data = read_verified(mesh)
    kind = Path(mesh.path).suffix[1:].lower()
    if f".{kind}" in GLTF_SUFFIXES or (kind == "obj" and not is_plain_obj(data)):
        corners = geometry.mesh_triangles(mesh).reshape(-1, 3)
        return with_edges(trimesh.Trimesh(corners, np.arange(len(corners)).reshape(-1, 3)))
    try:
        loaded = trimesh.load_scene(BytesIO(data), file_type=kind, skip_materials=True).to_mesh()
    except Exception as error:  # the readers of trimesh raise many kinds of exceptions
        raise EngineError(f"mesh {mesh.path} cannot be read") from error
    unit = re.search(rb'<unit[^>]*meter="([0-9.eE+-]+)"', data[:20_000]) if kind == "dae" else None
    # trimesh returns the coordinates of a COLLADA file in the unit of the file.
    loaded.apply_scale(np.asarray(mesh.scale) * (float(unit[1]) if unit else 1.0))
    return with_edges(loaded)


def with_edges(solid: trimesh.Trimesh) -> Any:
    """Return triangles with normals that show sharp edges."""
    import trimesh

    # Files repeat a vertex for each face or normal; faces must share it to be shaded as one surface.
    solid.merge_vertices(merge_tex=True, merge_norm=True)
    return trimesh.graph.smooth_shade(solid, angle=math.radians(35))  # sharper edges are drawn


def rigid_groups(model: RobotModel) -> dict[str, tuple[str, frames.Frame]]:
    """Return, for each link, the first link of its group that fixed joints connect, and the pose of the link
    in the frame of this first link."""
    held = {joint.child for joint in model.joints if joint.type == "fixed"}
    heads = [link.name for link in model.links if link.name not in held]
    return {link: (head, pose) for head in heads for link, pose in rigid_group(model, head).items()}


def stroke_triangles(line: Line, height: float) -> tuple[Points, NDArray[np.int32]]:
    """Return a painted line as triangles just above the ground: a rectangle for each piece, longer by half a
    width at both ends."""
    corners = []
    half = line.width / 2
    for (x, y), (x_end, y_end) in line.pieces:
        length = math.hypot(x_end - x, y_end - y) or 1.0
        ax, ay = (x_end - x) / length * half, (y_end - y) / length * half
        corners += [
            (x - ax - ay, y - ay + ax),
            (x - ax + ay, y - ay - ax),
            (x_end + ax + ay, y_end + ay - ax),
            (x_end + ax - ay, y_end + ay + ax),
        ]
    flat = np.array([(*corner, height) for corner in corners], np.float32)
    faces = np.array(
        [(4 * n, 4 * n + a, 4 * n + a + 1) for n in range(len(line.pieces)) for a in (1, 2)], np.int32
    )
    return flat, faces


def _contour(relief: geometry.HeightGrid, above: float) -> Points:
    """Return line segments (n, 2, 3) along every fifth row and column of a relief, a little above it."""
    rows, columns = relief.heights.shape
    points = relief.triangles()[0].reshape(rows, columns, 3) + np.array([0.0, 0.0, above])
    parts = [
        np.stack([lines[:, :-1], lines[:, 1:]], 2) for lines in (points[::5], points.transpose(1, 0, 2)[::5])
    ]
    return np.concatenate([part.reshape(-1, 2, 3) for part in parts]).astype(np.float32)


def shaded_mesh(vertices: Any, faces: Any, color: Color) -> Any:
    """Return a surface that is darker where it is lower, because light alone hardly shows a hollow from
    above."""
    import trimesh

    heights = np.asarray(vertices)[:, 2]
    share = _MIN_BRIGHTNESS + (1.0 - _MIN_BRIGHTNESS) * (heights - heights.min()) / (np.ptp(heights) or 1.0)
    return trimesh.Trimesh(
        vertices, faces, vertex_colors=(share[:, None] * _rgb(color)).astype(np.uint8), process=False
    )


def _rgb(color: Color) -> tuple[int, int, int]:
    return int(255 * color[0]), int(255 * color[1]), int(255 * color[2])


def aim_camera(server: viser.ViserServer, view: View) -> float:
    """Light the scene, and look at it from a view until a person moves the camera. Returns the distance in
    m."""
    camera = server.initial_camera
    size = math.dist(view.eye, view.target)
    camera.position = view.eye
    camera.look_at = view.target
    camera.fov = view.fov
    # The resolution of depth falls with the ratio of far to near.
    camera.near, camera.far = max(0.002, size / 200), 60 * size
    _light(server)
    return size


def _light(server: viser.ViserServer) -> None:
    scene = server.scene
    scene.set_up_direction("+z")
    scene.configure_default_lights(cast_shadow=False)
    # All is black until a browser has read viser's environment map, which takes up to 20 s without a GPU.
    scene.configure_environment_map(None)
    scene.add_light_hemisphere(
        "/sky", sky_color=(255, 255, 255), ground_color=(120, 125, 135), intensity=1.5, position=(0, 0, 1)
    )


def add_shape(scene: viser.SceneApi, name: str, shape: Shape, color: Color, frame: frames.Frame) -> Any:
    """Add a shape, and return its node. `frame` is that of the shape in the node above."""
    options = _options(color, frame)
    match shape:
        case Box(size):
            return scene.add_box(name, _rgb(color), size, **options)
        case Sphere(radius):
            return scene.add_icosphere(name, radius, _rgb(color), **options)
        case Cylinder(radius, length):
            return scene.add_cylinder(name, radius, length, _rgb(color), **options)
        case Capsule(radius, length):
            import trimesh

            solid = trimesh.creation.capsule(height=length, radius=radius)
        case Mesh():
            solid = triangles(shape)
    return add_triangles(scene, name, solid, color, frame)


def add_triangles(
    scene: viser.SceneApi, name: str, solid: trimesh.Trimesh, color: Color, frame: frames.Frame
) -> Any:
    """Add triangles that are seen from both sides, and return their node."""
    return scene.add_mesh_simple(
        name,
        np.asarray(solid.vertices, np.float32),
        np.asarray(solid.faces, np.int32),
        color=_rgb(color),
        side="double",
        **_options(color, frame),
    )


def _options(color: Color, frame: frames.Frame) -> dict[str, Any]:
    opacity = None if color[3] >= 0.99 else color[3]
    return {"position": frame[0], "wxyz": frames.wxyz(frame[1]), "opacity": opacity}


class SceneCameras:
    """Fits the camera of each browser to the scene when it is opened or resized."""

    def __init__(self, server: viser.ViserServer, queue: Callable[[Callable[[], None]], None]) -> None:
        """Follow the clients of a server. `queue` runs a function in the thread of the page."""
        self._server = server
        self._boxes: Sequence[tuple[Triple, Triple]] = ()
        self._fitted: dict[int, dict[tuple[int, int], Triple]] = {}
        self._due = math.inf
        server.on_client_connect(
            lambda client: client.camera.on_update(lambda _: queue(lambda: self._fit(client)))
        )
        server.on_client_disconnect(lambda client: self._fitted.pop(client.client_id, None))

    def aim(self, boxes: Sequence[tuple[Triple, Triple]], *, waits: bool = False) -> float:
        """Look at the scene within these boxes (lowest and highest corner, m). Returns the distance in m.

        With `waits`, `settle` moves the cameras a moment later: at once, a robot that has grown would be
        drawn as large as before.
        """
        self._boxes = boxes
        view = view_around(boxes, 480, 400)  # a usual window beside the panel
        if not waits:
            return aim_camera(self._server, view)
        _light(self._server)
        self._due = time.monotonic() + _SETTLING_S
        return math.dist(view.eye, view.target)

    def settle(self) -> None:
        """Show the whole scene in all browsers, once it is time after `aim`, unless a person has moved the
        camera."""
        if time.monotonic() >= self._due:
            self._due = math.inf
            for client in self._server.get_clients().values():
                self._fit(client, again=True)

    def refit(self) -> None:
        """Show the whole scene in all browsers, wherever a person has moved the camera."""
        self._fitted.clear()
        for client in self._server.get_clients().values():
            self._fit(client)

    def _fit(self, client: Any, *, again: bool = False) -> None:
        """Show the whole scene in a browser that has been opened or resized, or else `again`, unless a person
        has moved its camera."""
        camera = client.camera
        size = (camera.image_width, camera.image_height)
        framed = self._fitted.setdefault(client.client_id, {})
        # A slow browser may report an earlier position: the initial one, or one that was set here.
        initial = self._server.initial_camera.position
        moved = framed and all(
            math.dist(camera.position, eye) > 0.01 * math.hypot(*eye) for eye in (initial, *framed.values())
        )
        is_fitted = bool(framed) and next(reversed(framed)) == size and not again
        if not self._boxes or min(size) < 1 or moved or is_fitted:
            return
        view = view_around(self._boxes, *size)
        camera.position = view.eye
        camera.look_at = view.target
        framed.pop(size, None)  # so that the newest size is the last
        framed[size] = view.eye


class WorldScene:
    """A world below the node `root`. `set_frame` sets the newest frame, and `draw` shows the world between
    the last two frames."""

    def __init__(
        self,
        scene: viser.SceneApi,
        world: WorldModel,
        layout: FrameLayout,
        *,
        size: float,
        root: str = "/world",
        origin: Triple = ZERO_VECTOR,
    ) -> None:
        """Create the nodes of a world. `size` is the distance (m) from which the world is seen, which
        determines the size of marks. `origin` is the position (m) of its origin."""
        self._scene = scene
        self._layout = layout
        self._root = root
        self._size = size
        self._origin = origin
        self._anchor = scene.add_frame(root, show_axes=False, position=origin)
        # viser sends no position of 0, and a browser keeps that of the node of this name before.
        self._anchor.position = frames.add(origin, (1.0, 0.0, 0.0))
        self._anchor.position = origin
        self.follows = False
        """Whether the robot stays in view, as the world moves below it."""
        self._nodes: dict[LinkName, Any] = {}
        self._variants: dict[tuple[str, str], Any] = {}
        self._labels: list[Any] = []
        self._dots: dict[LinkName, Any] = {}
        self._goals: dict[tuple[str, str], Any] = {}
        visible_names, hidden_names = ("rays", "contacts", "goal", "shortest path"), ("names", "axes")
        self.visible_parts = dict.fromkeys(visible_names, True) | dict.fromkeys(hidden_names, False)
        """The parts that a person can show and hide. `shortest path` is that of `path_distance`."""
        self._build_surroundings(world)
        for robot in world.robots:
            self._build_robot(robot.name, robot.model)
        for body in world.objects:
            self._build_object(body.name, forms_of(body))
        line = np.zeros((1, 2, 3), np.float32)
        self._arrows = scene.add_arrows(
            f"{root}/pushes",
            line,
            np.array([[230, 120, 0]], np.uint8),
            shaft_radius=0.006 * size,
            head_radius=0.016 * size,
            head_length=0.03 * size,
            visible=False,
        )
        self._ways = self._add_lines(f"{root}/ways", line, visible=False)
        self._rays = self._add_lines(f"{root}/rays", line, visible=len(layout.sensor_rays) > 0)
        first = next((r for r in world.robots if not r.fixed_base), next(iter(world.robots), None))
        self._followed = (first.name, first.model.root) if first else None
        self._start = ZERO_VECTOR
        self._parts = list(self._nodes)
        self._now = self._before = self._sent = np.full((len(self._parts), 7), np.nan)
        self._rays_now = self._rays_before = self._rays_sent = np.zeros((0, 2, 6), np.float32)
        self._frame: WorldFrame | None = None

    # Made once

    def _build_surroundings(self, world: WorldModel) -> None:
        scene = self._scene
        root = self._root
        light = min(1.0, world.light)
        if world.terrain is not None:
            relief = geometry.height_grid(world.terrain.shape)
            if relief is not None:
                surface = relief.coarsened(MAX_CELLS).triangles()
                contour = _contour(relief.coarsened(MAX_CELLS), 0.001 * self._size)
                # A smooth relief of one color is hard to see.
                self._add_lines(f"{root}/contour", contour, 110, thickness=1.0)
            else:
                assert isinstance(world.terrain.shape, Mesh)  # all others are grids
                solid = triangles(world.terrain.shape)
                surface = solid.vertices, solid.faces
            color = world.terrain.color or (0.62, 0.58, 0.50, 1.0)
            scene.add_mesh_trimesh(f"{root}/terrain", shaded_mesh(*surface, color))
        elif world.ground is not None:
            color = world.ground.color or GROUND_COLOR
            cell = 10.0 ** math.floor(math.log10(max(self._size, 0.01) / 4))
            width = (
                10 * cell * max(1, round(self._size / cell))
                if world.arena is None
                else max(world.arena.size) + 4 * cell
            )
            lines = tuple(int(0.88 * part) for part in _rgb(color))
            scene.add_grid(
                f"{root}/ground",
                width,
                width,
                cell_size=cell,
                section_size=10 * cell,
                cell_color=lines,
                section_color=lines,
                plane_color=_rgb(color),
                plane_opacity=light,
                position=(0.0, 0.0, -0.0002 * self._size),
            )
        for number, line in enumerate(world.lines):
            # Each line lies a little above the one before: surfaces in one plane flicker.
            points, faces = stroke_triangles(line, 0.0004 * self._size * (1 + 0.1 * number))
            scene.add_mesh_simple(
                f"{root}/lines/{number}",
                points,
                faces,
                color=_rgb(line.color),
                side="double",
                cast_shadow=False,
            )
        if world.arena:
            for wall in arena_walls(world.arena):
                self._add(
                    f"{root}/arena/{wall.name.replace(' ', '_')}",
                    Geometry(wall.shape, wall.pose, wall.color),
                    frames.IDENTITY_FRAME,
                )

    def _build_robot(self, name: str, model: RobotModel) -> None:
        groups = rigid_groups(model)
        for number, link in enumerate(model.links):
            head, pose = groups[link.name]
            if (name, head) not in self._nodes:
                self._node((name, head))
            for index, visual in enumerate(link.visuals or link.collisions):
                colored = replace(visual, color=visual.color or LINK_COLORS[number % len(LINK_COLORS)])
                self._add(f"{self._path_of((name, head))}/{number}_{index}", colored, pose)
        self._label((name, groups[model.root][0]), name)

    def _build_object(self, name: str, forms: Mapping[str, Any]) -> None:
        part = (name, name)
        node = self._node(part)
        for form, body in forms.items():
            self._variants[name, form] = self._add(
                f"{node.name}/{form}", Geometry(body.shape, Pose(), body.color), frames.IDENTITY_FRAME
            )
        self._label(part, name)

    def _add_lines(
        self, name: str, points: Points, color: int = 0, *, thickness: float = 2.0, **options: Any
    ) -> Any:
        """Add line segments (n, 2, 3), `thickness` in pixels."""
        # A single color for all lines, later replaced by an array, would hide them.
        colors = np.full(points.shape, color, np.uint8)
        return self._scene.add_line_segments(
            name, points, colors, thickness=thickness, thickness_units="screen", **options
        )

    def _path_of(self, part: LinkName) -> str:
        kind = "robots" if part[0] in self._layout.robots else "objects"
        return f"{self._root}/{kind}/{part[0].replace('#', '_')}/{part[1]}"

    def _node(self, part: LinkName) -> Any:
        node = self._scene.add_frame(
            self._path_of(part),
            show_axes=False,
            axes_length=0.06 * self._size,
            axes_radius=0.002 * self._size,
        )
        self._nodes[part] = node
        return node

    def _label(self, part: LinkName, text: str) -> None:
        self._labels.append(
            self._scene.add_label(f"{self._path_of(part)}/label", text, visible=False, anchor="bottom-center")
        )

    def _add(self, name: str, geometry: Geometry, within: frames.Frame) -> Any:
        """Add a shape at its place below a node."""
        frame = frames.compose(within, frames.frame(geometry.origin))
        return add_shape(self._scene, name, geometry.shape, geometry.color or _DEFAULT_COLOR, frame)

    # What a person chooses to see

    def set_visible(self, part: str, visible: bool) -> None:
        """Show or hide one of `visible_parts`."""
        self.visible_parts[part] = visible
        for label in self._labels:
            label.visible = self.visible_parts["names"]
        for (body, _), node in self._nodes.items():
            node.show_axes = self.visible_parts["axes"] and body in self._layout.robots
        self._rays.visible = self.visible_parts["rays"] and len(self._rays_now) > 0
        if self._frame is not None:
            self._mark(self._frame)

    # Moved with every frame

    def set_frame(self, frame: WorldFrame, *, after_reset: bool = False) -> None:
        """Show `frame` from now on. With `after_reset`, nothing is interpolated from the frame before."""
        rows = np.full((len(self._parts), 7), np.nan)
        for row, part in enumerate(self._parts):
            pose = frame.links.get(part)
            if pose is not None:
                rows[row, :3] = pose[0]
                rows[row, 3:] = frames.wxyz(pose[1])
        self._rays_before = self._rays_now
        if self._layout.sensor_rays:
            self._rays_now = np.concatenate(
                [beams.lines(frame, key) for key, beams in self._layout.sensor_rays.items()]
            )
        if after_reset or self._frame is None:
            self._before = rows
            self._rays_before = self._rays_now
            if self._followed is not None:
                self._start = frame.links[self._followed][0]
        else:
            # A body that appears does not fly in from its last place.
            self._before = np.where(np.isnan(self._now) | np.isnan(rows), rows, self._now)
            # q and -q are the same rotation; between opposite signs, the link would turn the long way.
            opposite = (self._before[:, 3:] * rows[:, 3:]).sum(axis=1) < 0.0
            self._before[opposite, 3:] *= -1.0
        self._now = rows
        self._frame = frame
        for (body, form), node in self._variants.items():
            node.visible = (body, body) in frame.links and frame.variants.get(body, form) == form
        self._mark(frame)

    def draw(self, share: float) -> None:
        """Move the world to `share` (0 to 1) of the way from the frame before to the newest."""
        rows = self._before + share * (self._now - self._before)
        rows[:, 3:] /= np.linalg.norm(rows[:, 3:], axis=1, keepdims=True)
        # Absent bodies have NaN, which is unequal to itself: without the check, each frame would send them.
        changed = np.flatnonzero((rows != self._sent).any(axis=1) & ~np.isnan(rows[:, 0]))
        for row in changed:
            node = self._nodes[self._parts[row]]
            node.position = rows[row, :3]
            node.wxyz = rows[row, 3:]
        self._sent = rows
        # In the world frame, and not in that of the link: a busy browser shows new lines late, and then rays
        # would reach through walls.
        rays = self._rays_before + share * (self._rays_now - self._rays_before)
        if self._rays.visible and not np.array_equal(rays, self._rays_sent):
            self._rays.points = rays[..., :3]
            self._rays.colors = rays[..., 3:].astype(np.uint8)
            self._rays_sent = rays
        if self._followed is not None:
            x, y, _ = rows[self._parts.index(self._followed), :3] - self._start
            shift = frames.add(self._origin, (-x, -y, 0.0)) if self.follows else self._origin
            self._anchor.position = shift

    def draw_paths(self, paths: Sequence[Sequence[tuple[float, float]]]) -> None:
        """Show shortest paths (points in m) on the ground."""
        height = 0.004 * self._size
        pieces = [((*start, height), (*end, height)) for way in paths for start, end in pairwise(way)]
        self._ways.visible = bool(pieces) and self.visible_parts["shortest path"]
        if pieces:
            self._ways.points = np.array(pieces, np.float32)
            self._ways.colors = np.full((len(pieces), 2, 3), (0, 158, 115), np.uint8)

    def _mark(self, frame: WorldFrame) -> None:
        """Mark contacts, goals and pushes."""
        self._mark_contacts(frame)
        self._mark_goal(frame)
        force = next(iter(frame.pushes), None)
        if force is not None:
            part, push = force
            strength = max(1e-9, float(np.linalg.norm(force[1])))
            at = np.array(frame.links.get(part, (ZERO_VECTOR,))[0])
            self._arrows.points = np.array(
                [[at - np.array(push) / strength * 0.3 * self._size, at]], np.float32
            )
        self._arrows.visible = force is not None

    def _mark_goal(self, frame: WorldFrame) -> None:
        """Mark a point to be reached, and the achieved one."""
        words = {"desired": ((0, 158, 115), 0.02), "achieved": ((0, 114, 178), 0.01)}
        for (word, (color, radius)), (name, agent) in product(words.items(), frame.agents.items()):
            point = self._layout.goal_point(agent, word)
            if point is None:
                continue
            dot = self._goals.get((name, word))
            if dot is None:
                path = f"{self._root}/{word}_{name.replace('#', '_')}"
                dot = self._goals[name, word] = self._scene.add_icosphere(
                    path, radius * self._size, color, opacity=0.6
                )
            dot.position = point
            dot.visible = self.visible_parts["goal"]

    def _mark_contacts(self, frame: WorldFrame) -> None:
        touching = set(frame.forces) if self.visible_parts["contacts"] else set()
        for part in touching - self._dots.keys():
            model = self._layout.robots[part[0]]
            head, pose = rigid_groups(model)[part[1]]
            name = f"{self._path_of((part[0], head))}/touch_{part[1]}"
            radius = 0.02 * math.dist(*robot_bounds(model))
            self._dots[part] = self._scene.add_icosphere(
                name, radius, (225, 60, 40), opacity=0.5, position=pose[0], visible=False
            )
        for part, dot in self._dots.items():
            dot.visible = part in touching
