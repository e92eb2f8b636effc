"""Pictures of the world, drawn with OpenGL from a model of their own, which has the visible shapes instead of
the collision shapes."""

from __future__ import annotations

import atexit
import sys
import warnings
from contextlib import suppress
from functools import cache
from importlib import import_module
from importlib.util import find_spec
from math import tan
from typing import TYPE_CHECKING, Any
from weakref import WeakSet

import numpy as np

from deepbots_cli import frames
from deepbots_cli.engines.mujoco import mujoco as mj
from deepbots_cli.engines.mujoco.model import (
    FACE_DISTANCE_M,
    FAR_CLIP_M,
    NEAR_CLIP_M,
    TERRAIN_TILES,
    ModelBuilder,
)
from deepbots_cli.errors import EngineError
from deepbots_cli.port import CAMERA_RANGE_M, CameraImage
from deepbots_cli.program.world import GROUND

if TYPE_CHECKING:
    from deepbots_cli.engines.mujoco.state import MujocoWorld
    from deepbots_cli.frames import Frame, Triple
    from deepbots_cli.port import Image, PoseReader, View
    from deepbots_cli.program.world import WorldModel

UNAVAILABLE_MESSAGE = (
    "MuJoCo cannot render on this machine, because OpenGL needs a display; install EGL or OSMesa and set"
    " MUJOCO_GL=egl or "
    "MUJOCO_GL=osmesa, or use the engine 'pybullet' for pictures"
)


_RANGE = NEAR_CLIP_M, FAR_CLIP_M
OPEN_RENDERERS: WeakSet[Any] = WeakSet()  # closed at the end of the process


def _close_all() -> None:
    for pictures in tuple(OPEN_RENDERERS):  # a weak set may shrink during iteration
        pictures.close()


def is_available() -> bool:
    """Return whether MuJoCo has found a library for OpenGL. No context is made before the first picture,
    which may still fail."""
    return hasattr(mj, "GLContext")


@cache
def opens_context() -> bool:
    """Return whether a context of OpenGL can be made; found out once, in 10 ms.

    Software OpenGL brings the LLVM of the system. Triton, which torch loads with some optimizers, has its
    own, and the process ends with a segmentation fault if Triton is loaded second (triton 3.7, Mesa 22). It
    is therefore loaded here, in 0.15 s.
    """
    if find_spec("triton") is not None:
        with suppress(ImportError):
            import_module("triton")
    try:
        with warnings.catch_warnings(action="ignore"):
            if (
                glfw := sys.modules.get("glfw")
            ) is not None:  # without a display it warns, and returns no window
                warnings.simplefilter("error", glfw.GLFWError)
            context = mj.GLContext(8, 8)
            context.make_current()
            context.free()
    except Exception:  # noqa: BLE001 - each of the libraries fails in its own way
        return False
    atexit.register(_close_all)  # before MuJoCo ends the library, which it registered with the first context
    return True


class Renderers:
    """The renderers of a model, by the width and height of their pictures."""

    def __init__(self) -> None:
        self._model: Any = None
        self._renderers: dict[tuple[int, int], Any] = {}
        OPEN_RENDERERS.add(self)

    def close(self) -> None:
        for renderer in self._renderers.values():
            renderer.close()
        self._renderers.clear()

    def renderer(self, width: int, height: int) -> Any:
        """Return the renderer of a size. MuJoCo refuses one that is larger than the framebuffer of the
        model."""
        if (width, height) not in self._renderers:
            self._model.vis.global_.offwidth, self._model.vis.global_.offheight = width, height
            self._renderers[width, height] = mj.Renderer(self._model, height, width)
        return self._renderers[width, height]


def aim(renderer: Any, eye: Triple, ahead: Any, up: Any, range: tuple[float, float], slope: float) -> None:
    """Let a renderer look ahead within a range (m); `slope` is the tangent of half the vertical field of
    view."""
    for camera in renderer.scene.camera:  # one for each eye; a picture is from between them
        camera.pos = eye
        camera.forward = ahead
        camera.up = up
        camera.frustum_center = 0.0
        camera.frustum_top = range[0] * slope
        camera.frustum_bottom = -camera.frustum_top
        camera.frustum_width = 0.0  # MuJoCo then takes the aspect of the picture
        camera.frustum_near, camera.frustum_far = range


class WorldRenderer(Renderers):
    """Draws one world; nothing is built before the first picture."""

    def __init__(self, world: WorldModel, state: MujocoWorld) -> None:
        super().__init__()
        self._world = world
        self._state = state

    def render_view(self, view: View) -> Image:
        ahead = np.subtract(view.target, view.eye)
        ahead = ahead / np.linalg.norm(ahead)
        left = np.cross((0.0, 0.0, 1.0), ahead)
        length = np.linalg.norm(left)
        left = left / length if length > 1e-9 else np.array((0.0, 1.0, 0.0))
        samples = view.samples
        renderer = self._renderer_of_size(view.width * samples, view.height * samples)
        aim(renderer, view.eye, ahead, np.cross(ahead, left), _RANGE, tan(view.fov / 2))
        self._cast_shadows(renderer, view)
        self._lay_tiles(renderer)
        fine = renderer.render()
        # 16 bits have room for the sum of 16 x 16 samples of 255. At 640 x 480 pixels of 2 x 2 samples,
        # slices take 5 ms, and a sum over reshaped axes 110 ms.
        total = np.zeros((view.height, view.width, 3), np.uint16)
        for row in range(samples):
            for column in range(samples):
                total += fine[row::samples, column::samples]
        return self._brightened((total // samples**2).astype(np.uint8))

    def _cast_shadows(self, renderer: Any, view: View) -> None:
        """Let the sun cast shadows around the target of a view. Images of cameras have none."""
        distance = float(np.linalg.norm(np.subtract(view.target, view.eye)))
        sun, sky = renderer.scene.lights[:2]
        # In its shadow, a light of MuJoCo lacks its ambient part too.
        sky.ambient, sun.ambient = np.add(sky.ambient, sun.ambient), (0.0,) * 3
        sun.castshadow = True
        sun.pos = np.subtract(view.target, np.multiply(sun.dir, distance))
        renderer._mjr_context.shadowClip = distance  # it has no public name

    def _lay_tiles(self, renderer: Any) -> None:
        """Show the tiles of a terrain."""
        material = mj.mj_name2id(self._model, mj.mjtObj.mjOBJ_MATERIAL, TERRAIN_TILES)
        if material >= 0:
            for geom in renderer.scene.geoms[: renderer.scene.ngeom]:
                if geom.type == mj.mjtGeom.mjGEOM_HFIELD:
                    geom.matid = material
                    geom.rgba = (1.0, 1.0, 1.0, 1.0)

    def render_camera(
        self, pose: PoseReader, mount: Frame, width: int, height: int, fov: float
    ) -> CameraImage:
        eye, rotation = frames.compose(pose(), mount)
        renderer = self._renderer_of_size(width, height)
        aim(
            renderer,
            eye,
            frames.rotate(rotation, (1.0, 0.0, 0.0)),
            frames.rotate(rotation, (0.0, 0.0, 1.0)),
            _RANGE,
            tan(fov / 2),
        )
        colors = self._brightened(renderer.render())
        renderer.enable_segmentation_rendering()
        geoms = renderer.render()[..., 0]
        renderer.disable_segmentation_rendering()
        self._lower_ground(renderer, -FACE_DISTANCE_M)  # depths are those of the ground itself
        renderer.enable_depth_rendering()
        depth = np.minimum(renderer.render(), np.float32(CAMERA_RANGE_M))
        renderer.disable_depth_rendering()
        names = tuple(self._state.pools)
        bodies = np.where(geoms >= 0, self._owners[geoms], np.int32(-1)).astype(np.int32)
        return CameraImage(colors, depth, bodies, names)

    def _brightened(self, picture: Image) -> Image:
        light = self._state.light
        return (
            picture
            if light == 1.0
            else np.asarray(np.clip(picture * np.float32(light), 0.0, 255.0), dtype=np.uint8)
        )

    def _renderer_of_size(self, width: int, height: int) -> Any:
        """Return a renderer of this size, with the bodies where they are now."""
        if not (is_available() and opens_context()):
            raise EngineError(UNAVAILABLE_MESSAGE)
        if self._model is None:
            self._build()
        model = self._model
        data = self._data
        for name in ("qpos", "mocap_pos", "mocap_quat"):
            getattr(data, name)[:] = getattr(self._state.data, name)
        model.geom_rgba[:] = self._nominal
        for (body, link), color in self._state.colors.items():
            model.geom_rgba[self._geoms.get((body, link), [])] = color
        mj.mj_kinematics(model, data)
        mj.mj_camlight(model, data)
        renderer = self.renderer(width, height)
        renderer.update_scene(data)
        self._lower_ground(renderer, FACE_DISTANCE_M)
        return renderer

    def _lower_ground(self, renderer: Any, distance: float) -> None:
        """Move the flat ground of the scene down (m), below the tops of things that are level with it."""
        for geom in renderer.scene.geoms[: renderer.scene.ngeom]:
            if geom.type == mj.mjtGeom.mjGEOM_PLANE:
                geom.pos[2] -= distance

    def _build(self) -> None:
        builder = ModelBuilder(self._world, for_rendering=True)
        self._model = builder.compile()
        self._data = mj.MjData(self._model)
        self._nominal = self._model.geom_rgba.copy()
        self._geoms: dict[tuple[str, str], list[int]] = {}
        self._owners = np.full(self._model.ngeom + 1, -1, np.int32)
        for index, pool in enumerate(builder.pools):
            for body in pool:
                for link, geoms in body.geoms.items():
                    self._geoms.setdefault((pool.name, link), []).extend(geoms)
                    self._owners[geoms] = index
        ground = self._geoms.get((GROUND, GROUND))
        if ground:  # painted lines
            lines = (self._model.geom_bodyid[: self._model.ngeom] == 0).nonzero()[0]
            self._owners[lines] = self._owners[ground[0]]
