"""What everything stands on: the plane, or terrain."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from deepbots_cli.engines.pybullet.body import Body
from deepbots_cli.engines.pybullet.library import pybullet as p
from deepbots_cli.errors import EngineError
from deepbots_cli.frames import UPRIGHT
from deepbots_cli.geometry import triangles
from deepbots_cli.program.world import GROUND
from deepbots_cli.robots.model import Friction, Link, Mesh, RobotModel
from deepbots_cli.terrain import Grid, grid

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from deepbots_cli.program.world import Ground, Terrain, WorldModel

EARTH = (0.72, 0.63, 0.48, 1.0)
_SEEN = 100  # cells of what is drawn along either side; a finer picture would take longer than it shows


def body(client: int, world: WorldModel) -> Body | None:
    """The terrain, or else the plane, or nothing."""
    if world.terrain is not None:
        return _terrain(client, world.terrain)
    return _plane(client, world.ground) if world.ground is not None else None


def _plane(client: int, ground: Ground) -> Body:
    shape = p.createCollisionShape(p.GEOM_PLANE, physicsClientId=client)
    unseen = p.createVisualShape(p.GEOM_SPHERE, radius=1e-3, visualFramePosition=(0.0, 0.0, -1000.0), physicsClientId=client)
    number = p.createMultiBody(0, shape, unseen, physicsClientId=client)
    return _body(client, number, Friction(lateral=ground.friction, restitution=ground.restitution))


def _terrain(client: int, ground: Terrain) -> Body:
    """Heights as a heightfield, meshes as they are, neither of them convex.

    Raises:
        EngineError: Its file has gone or changed, or it has no height somewhere.
    """
    heights = grid(ground.shape)
    if heights is None:
        assert isinstance(ground.shape, Mesh)  # all else is a grid
        corners = triangles(ground.shape)
        shape = _mesh(client, corners.reshape(-1, 3), np.arange(corners.size // 3), p.GEOM_FORCE_CONCAVE_TRIMESH)
        drawn, middle = _drawn(client, corners.reshape(-1, 3), np.arange(corners.size // 3).reshape(-1, 3), ground), 0.0
    else:
        middle = float(heights.heights.max() + heights.heights.min()) / 2  # the library moves it there
        shape = _heightfield(client, heights)
        drawn = _drawn(client, *heights.coarser(_SEEN).triangles(), ground, middle)
    if shape < 0:
        raise EngineError("PyBullet cannot build the terrain")
    number = p.createMultiBody(0, shape, drawn, basePosition=(0.0, 0.0, middle), physicsClientId=client)
    made = _body(client, number, Friction(lateral=ground.friction))
    made.home = ((0.0, 0.0, middle), UPRIGHT)
    return made


def _heightfield(client: int, heights: Grid) -> int:
    rows, columns = heights.heights.shape
    shape: int = p.createCollisionShape(
        p.GEOM_HEIGHTFIELD,
        meshScale=(*heights.cell, 1.0),
        heightfieldData=heights.heights.ravel().tolist(),
        numHeightfieldRows=columns,
        numHeightfieldColumns=rows,
        physicsClientId=client,
    )
    return shape


def _mesh(client: int, vertices: NDArray[np.float64], indices: NDArray[np.int64], flags: int) -> int:
    shape: int = p.createCollisionShape(
        p.GEOM_MESH, vertices=vertices.tolist(), indices=indices.tolist(), flags=flags, physicsClientId=client
    )
    return shape


def _drawn(client: int, vertices: NDArray[np.float64], faces: NDArray[np.int64], ground: Terrain, middle: float = 0.0) -> int:
    """What is seen of it, shaded smoothly."""
    normals = np.zeros_like(vertices)
    a, b, c = (vertices[faces[:, corner]] for corner in range(3))
    for corner in range(3):
        np.add.at(normals, faces[:, corner], np.cross(b - a, c - a))
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
    shape: int = p.createVisualShape(
        p.GEOM_MESH,
        vertices=(vertices - (0.0, 0.0, middle)).tolist(),
        indices=faces.ravel().tolist(),
        normals=normals.tolist(),
        rgbaColor=ground.colour or EARTH,
        physicsClientId=client,
    )
    return shape


def _body(client: int, number: int, friction: Friction) -> Body:
    return Body(GROUND, number, RobotModel(GROUND, (Link(GROUND, friction=friction),), (), GROUND), True, client)
