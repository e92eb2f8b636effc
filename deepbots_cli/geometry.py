"""Meshes at simulation time, read by trimesh and yourdfpy: triangles of the ground, masses of links with a density.

Importing the two libraries takes 0.57 s of CPU. Each function imports them when it is called, so a world without
such a mesh starts as fast as before, and lint never needs them.

COLLADA files stay with the engine. Of 13 files in pybullet_data, trimesh and PyBullet build 3 differently: trimesh
leaves the unit to the caller (duck.dae comes out 100 times as large), and PyBullet ignores `<rotate>` (hokuyo.dae lies).
"""

from __future__ import annotations

from dataclasses import replace
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from deepbots_cli.errors import EngineError
from deepbots_cli.robots.edits import with_link
from deepbots_cli.robots.meshes import checked_bytes
from deepbots_cli.robots.model import Inertial, Link, Mesh, Pose, RobotModel
from deepbots_cli.robots.writer import write

if TYPE_CHECKING:
    import trimesh
    from numpy.typing import NDArray


def triangles(mesh: Mesh) -> NDArray[np.float64]:
    """The corners of an STL or OBJ mesh, scaled: shape (count, 3 corners, 3 coordinates), in m.

    Raises:
        EngineError: The file has gone or changed, or holds no triangles.
    """
    import trimesh

    data = checked_bytes(mesh)
    try:
        loaded = trimesh.load_mesh(BytesIO(data), file_type=Path(mesh.path).suffix[1:].lower(), process=False, skip_materials=True)
    except (ValueError, IndexError) as error:
        raise EngineError(f"mesh {mesh.path} cannot be read") from error
    return np.asarray(loaded.triangles * np.asarray(mesh.scale), np.float64)


def with_masses(model: RobotModel) -> RobotModel:
    """The model with mass, centre and inertia of each link that has a density, from the volume of its mesh.

    Raises:
        EngineError: A mesh has gone or changed, or encloses no volume.
    """
    for link in model.links:
        if link.density is not None:
            model = with_link(model, replace(link, inertial=_inertial(link, link.density), density=None))
    return model


def _inertial(link: Link, density: float) -> Inertial:
    """The inertial of a homogeneous link, in axes parallel to those of the link; `density` in kg/m^3."""
    solid = _solid(link)
    if not solid.is_watertight or not solid.is_winding_consistent:
        raise EngineError(f"the mesh of link '{link.name}' is not watertight, so its density gives no mass; give its `mass` instead")
    if solid.volume < 0.0:  # every face is inside out
        solid.invert()
    solid.density = density
    (ixx, ixy, ixz), (_, iyy, iyz), (_, _, izz) = solid.moment_inertia.tolist()
    x, y, z = solid.center_mass.tolist()
    return Inertial(float(solid.mass), Pose((x, y, z)), ixx=ixx, ixy=ixy, ixz=ixz, iyy=iyy, iyz=iyz, izz=izz)


def _solid(link: Link) -> trimesh.Trimesh:
    """What a link collides with, or shows where nothing collides, as one mesh in the frame of the link."""
    import yourdfpy

    shapes = link.collisions or link.visuals
    for geometry in shapes:
        if isinstance(geometry.shape, Mesh):
            checked_bytes(geometry.shape)
    text = write(RobotModel("robot", (Link(link.name, collisions=shapes),), (), link.name))
    robot = yourdfpy.URDF.load(
        BytesIO(text.encode()),
        build_scene_graph=False,
        load_meshes=False,
        build_collision_scene_graph=True,
        load_collision_meshes=True,
        force_collision_mesh=False,
        filename_handler=lambda fname: fname,
    )
    solid: trimesh.Trimesh = robot.collision_scene.to_mesh()
    return solid
