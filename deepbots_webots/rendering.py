"""Pictures of a world, drawn with OpenGL from a model of its own: the Shape nodes in place of bounding
objects.

Shapes have the base color of their appearance, with textures on boxes, planes and grids, and are lit from the
camera.
"""

from __future__ import annotations

from functools import cache
from itertools import count
from math import inf, tan
from typing import Any

import numpy as np
from numpy.typing import NDArray

from deepbots_cli import frames
from deepbots_cli.engines.mujoco import mujoco as mj
from deepbots_cli.engines.mujoco.cameras import Renderers, aim, is_available, opens_context
from deepbots_cli.errors import EngineError
from deepbots_cli.frames import Frame
from deepbots_cli.robots.model import Box
from deepbots_webots.model import geom_fields
from deepbots_webots.physics import Physics
from deepbots_webots.scene import Visual
from deepbots_webots.shapes import Grid, Plane, Shape, look_of, sky_color, visible_shape
from deepbots_webots.syntax import Node

Image = NDArray[np.uint8]


NEAR_M, FAR_M = 0.01, 1000.0
"""The range of distances that are drawn."""
_FARTHEST_DEPTH_M = 998.0
"""The largest depth of a body: where nothing is, MuJoCo computes 998.65 m from `FAR_M`, in float32."""
MAX_PIXELS = 4096
"""The largest width and height of a picture."""
UNAVAILABLE = "MuJoCo finds no OpenGL on this machine; install EGL or OSMesa (Debian: libegl1 or libosmesa6)"


_context = cache(lambda: mj.GLContext(8, 8))
"""Returns a context of OpenGL around which all pictures are drawn, so that none stays with a thread: each
controller has a thread of its own."""


def require_opengl() -> None:
    """Check that pictures can be drawn.

    Raises:
        EngineError: There is no OpenGL.
    """
    if not (is_available() and opens_context()):
        raise EngineError(UNAVAILABLE)


class Pictures(Renderers):
    """Draws one world; the model is built for the first picture."""

    def __init__(self, physics: Physics) -> None:
        super().__init__()
        self._physics = physics

    def colors(self, frame: Frame, size: tuple[int, int], fov: float, near: float = NEAR_M) -> Image:
        """Return the picture of a camera that looks along x of a frame, shape (height, width, 3).

        `size` is width and height; `fov` is the horizontal field of view, rad.

        Raises:
            EngineError: There is no OpenGL.
        """
        return self._draw(frame, size, fov, near, has_depth=False)  # type: ignore[no-any-return]

    def depths(self, frame: Frame, size: tuple[int, int], fov: float) -> NDArray[np.float32]:
        """Return the distances along x, m, shape (height, width); infinite where nothing is.

        Raises:
            EngineError: There is no OpenGL.
        """
        depths: NDArray[np.float32] = self._draw(frame, size, fov, NEAR_M, has_depth=True)
        return np.where(depths > _FARTHEST_DEPTH_M, np.float32(inf), depths)

    def _draw(self, frame: Frame, size: tuple[int, int], fov: float, near: float, *, has_depth: bool) -> Any:
        require_opengl()
        if self._model is None:
            self._build()
        self._follow()
        with _context().as_current():
            renderer = self.renderer(*size)
            self._model.vis.map.znear = near
            renderer.update_scene(self._data)
            position, rotation = frame
            ahead, up = (frames.rotate(rotation, axis) for axis in ((1.0, 0.0, 0.0), (0.0, 0.0, 1.0)))
            for light in renderer.scene.lights[: renderer.scene.nlight]:
                light.pos, light.dir = position, ahead  # by default, a light of MuJoCo is at its own camera
            aim(renderer, position, ahead, up, (near, FAR_M), tan(fov / 2) * size[1] / size[0])
            if has_depth:
                renderer.enable_depth_rendering()
            picture = renderer.render()
            renderer.disable_depth_rendering()
        return picture

    def _follow(self) -> None:
        """Place the bodies as they are now."""
        for body, index in self._bodies.items():
            position, rotation = self._physics.frame(self._physics.scene.bodies[body])
            self._data.mocap_pos[index], self._data.mocap_quat[index] = position, frames.wxyz(rotation)
        mj.mj_kinematics(self._model, self._data)
        mj.mj_camlight(self._model, self._data)

    def _build(self) -> None:
        builder = _VisualModel(self._physics)
        self._model = builder.spec.compile()
        self._data = mj.MjData(self._model)
        self._bodies = {
            index: int(self._model.body_mocapid[element.id]) for index, element in builder.bodies.items()
        }


class _VisualModel:
    """The visible shapes of a world, on bodies that are placed from outside."""

    def __init__(self, physics: Physics) -> None:
        self._scene = physics.scene
        self.spec = spec = mj.MjSpec()
        # MuJoCo multiplies the distances of the clipping planes by the extent, so that they are in m here.
        spec.stat.extent = 1.0
        spec.stat.center = (0.0, 0.0, 0.0)
        spec.visual.map.znear, spec.visual.map.zfar = NEAR_M, FAR_M
        spec.visual.quality.offsamples = 0
        spec.visual.headlight.ambient = (0.45,) * 3
        spec.visual.headlight.diffuse = (0.55,) * 3
        spec.visual.headlight.specular = (0.0,) * 3
        spec.compiler.alignfree = False
        self._names = map("s{}".format, count(1))
        sky = sky_color(self._scene.nodes) or (0.0, 0.0, 0.0)
        spec.add_texture(
            name="sky",
            type=mj.mjtTexture.mjTEXTURE_SKYBOX,
            builtin=mj.mjtBuiltin.mjBUILTIN_GRADIENT,
            rgb1=sky,
            rgb2=sky,
            width=16,
            height=96,  # six faces of a cube, one below another
        )
        self.bodies = {
            body.index: spec.worldbody.add_body(name=f"b{body.index}", mocap=True)
            for body in self._scene.bodies
        }
        for visual in self._scene.visuals:
            self._add(visual)

    def _add(self, visual: Visual) -> None:
        shape = visible_shape(visual, self._scene.files)
        if shape is None:
            return
        parent = self.spec.worldbody if visual.body is None else self.bodies[visual.body.index]
        parent.add_geom(
            **geom_fields(self.spec, shape, visual.frame, next(self._names), is_seen=True),
            **self._surface(visual.node, shape),
            contype=0,
            conaffinity=0,
            mass=0.0,
        )

    def _surface(self, node: Node, shape: Shape) -> dict[str, Any]:
        """Return the color of a shape, or its texture."""
        look = look_of(node, self._scene.files)
        if look.texture is None or not isinstance(shape, Box | Plane | Grid):
            return {"rgba": look.color}
        rows, columns, _ = look.texture.pixels.shape
        name = next(self._names)
        picture = self.spec.add_texture(
            name=name, type=mj.mjtTexture.mjTEXTURE_2D, width=columns, height=rows, nchannel=3
        )
        picture.data = look.texture.pixels.tobytes()
        repeats = look.texture.repeats_on(shape.size or (1.0, 1.0))
        material = self.spec.add_material(name=name, texuniform=False, texrepeat=repeats)
        material.textures[mj.mjtTextureRole.mjTEXROLE_RGB] = name
        return {"rgba": look.base, "material": name}
