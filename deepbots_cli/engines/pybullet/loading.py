"""Ground, walls, objects and robots, built in a client from the world model."""

from __future__ import annotations

import tempfile
from collections.abc import Iterable, Iterator
from dataclasses import replace
from itertools import combinations
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from deepbots_cli import frames
from deepbots_cli.engine_kinds import MAX_PYBULLET_JOINTS
from deepbots_cli.engines.mechanics import (
    LINK_COLORS,
    Pool,
    arena_walls,
    as_robot,
    forms_of,
    is_movable,
    with_explicit_masses,
)
from deepbots_cli.engines.pybullet import BASE_LINK, UNREACHABLE_SPEED, capture_native_output
from deepbots_cli.engines.pybullet import pybullet as p
from deepbots_cli.engines.pybullet.state import Body, contact_parameters
from deepbots_cli.errors import EngineError
from deepbots_cli.geometry import height_grid, mesh_triangles
from deepbots_cli.port import ZERO_VECTOR
from deepbots_cli.program.world import GROUND
from deepbots_cli.robots.kinematics import box_sides, self_collision_pairs
from deepbots_cli.robots.mesh_formats import is_plain_obj, is_text_stl
from deepbots_cli.robots.meshes import mesh_bounds, read_verified
from deepbots_cli.robots.model import (
    Cylinder,
    Friction,
    Geometry,
    Joint,
    Limit,
    Link,
    Mesh,
    Mimic,
    RobotModel,
    Shape,
    to_urdf,
)

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from deepbots_cli.program.world import Ground, ObjectBody, Terrain, WorldModel

PARKING_SPACING_M = 1000.0  # m between bodies that are parked
DEFAULT_CONTACT_ERP = 0.08  # the share of a penetration that PyBullet removes in a physics step by default
CONTACT_DISTANCE_M = 1e-4
"""The distance (m) beyond which surfaces do not touch for the solver.

PyBullet keeps a point of contact until its surfaces are 2 % of the size of a link apart, so a rolling wheel
keeps points that carry nothing, and the solver iterates over all of them. With this limit a step of CartPole
costs 0.68 of what it did, and its heights differ by 1e-6 m. At 2e-5 m and below, wheels lose the ground
between two steps and sink by 0.3 mm. On terrain there is no such limit: with it, two trainings of PitEscape
took 1.25 and 1.65 times as many steps. The cause was not measured; a ball that rolls over an edge of a
triangle may be further away than this for a step.
"""
HULL_MARGIN_M = 1e-3
"""The distance (m) by which PyBullet enlarges the convex hull of a mesh, but no other shape.

A mesh that is not made smaller by as much stands 1 mm high, and starts with 0.02 m/s upward.
`changeDynamics(collisionMargin=...)` has no effect on links other than the root.
"""
TERRAIN_COLOR = (0.72, 0.63, 0.48, 1.0)
_MAX_VISUAL_CELLS = 100  # drawn cells along either side; more of them take longer and are hardly seen
_CYLINDER = "cylinder.obj"
GEAR_ERP = 0.2
"""The share of the error of a follower that is removed in a physics step."""
GEAR_FORCE = 1e5
"""The largest force (N) or torque (N m) for it."""
NO_RATIO = 1e-12  # PyBullet takes 0 for a ratio that is not given
GEAR_ITERATIONS = 100
"""The iterations of the solver in a world with a follower; PyBullet's own number is 50, and it stops earlier
where the forces converge.

A follower that is ten times heavier than its driven leader is off by 2 mm in motion with 50 iterations and by
0.2 mm with 100; one that is a hundred times heavier by 65 and 31 mm (steps of 5 ms, strokes of 0.6 m). If
both weigh the same, the number makes no difference. A step in which a gripper presses on something takes 1.5
times as long.
"""
OPEN_JOINT_LIMIT = 1e9  # rad or m; the open end of a range with one end
UNLIMITED_RANGE = (1.0, -1.0)  # the loader reads a missing limit as 0, and lower > upper as unlimited


def create_client(world: WorldModel) -> int:
    """Return a client with the world's gravity and timestep, and nothing in it."""
    client: int = p.connect(p.DIRECT)
    if client < 0:
        raise EngineError("PyBullet cannot create another world in this process; close some environments")
    p.setGravity(*world.gravity, client)
    step = world.timestep / world.substeps
    p.setPhysicsEngineParameter(
        fixedTimeStep=step,
        deterministicOverlappingPairs=1,
        enableFileCaching=0,
        physicsClientId=client,
    )
    if any(robot.model.followers for robot in world.robots):
        p.setPhysicsEngineParameter(numSolverIterations=GEAR_ITERATIONS, physicsClientId=client)
    links = (link for robot in world.robots for link in robot.model.links)
    stated = [
        world.ground.restitution if world.ground else 0.0,
        *(body.restitution for body in world.objects),
    ]
    if any(value > 0.0 for value in (*stated, *(link.friction.restitution or 0.0 for link in links))):
        # Contact error reduction turns penetration into velocity, more with every step of an impact: a
        # restitution of 0.8 measured 0.82 to 0.88 at 1 ms steps. With a reduction within 0.2 s it measures
        # 0.80 to 0.81. Worlds without restitution keep the default.
        p.setPhysicsEngineParameter(contactERP=min(DEFAULT_CONTACT_ERP, step / 0.2), physicsClientId=client)
    return client


def bodies(client: int, world: WorldModel) -> Iterator[Pool[Body]]:
    """Yield all bodies, in the order of the world model."""
    for pool in _loaded(client, world):
        for body, link in [
            (form, link) for form in pool for link in form.model.links if world.terrain is None
        ]:
            if not link.friction.restitution:
                # Links with restitution keep the distance 0 that `_make_contact` has set.
                p.changeDynamics(
                    body.number,
                    body.links[link.name],
                    contactProcessingThreshold=CONTACT_DISTANCE_M,
                    physicsClientId=client,
                )
        yield pool


def _loaded(client: int, world: WorldModel) -> Iterator[Pool[Body]]:
    if world.terrain is not None:
        floor = _terrain(client, world.terrain)
    elif world.ground:
        floor = _plane(client, world.ground)
    else:
        floor = None
    if floor is not None:
        _make_contact(client, floor)
        yield Pool(GROUND, [(GROUND, floor)], pooled=False)
    parked = 0
    with tempfile.TemporaryDirectory(prefix="deepbots-") as folder:
        # PyBullet loads a URDF, and the meshes that it names, from files alone.
        file, cylinder = Path(folder, "body.urdf"), Path(folder, _CYLINDER)
        cylinder.write_text(_cylinder_mesh(), encoding="ascii")
        for object_body in (*(arena_walls(world.arena) if world.arena else ()), *world.objects):
            variants = [(name, _object(client, form, file)) for name, form in forms_of(object_body).items()]
            if object_body.pooled:
                for _, body in variants:
                    parked += 1
                    body.initial_pose = (
                        (-parked * PARKING_SPACING_M, 0.0, -PARKING_SPACING_M),
                        frames.IDENTITY_ROTATION,
                    )
            yield Pool(object_body.name, variants, object_body.pooled)
        for robot in world.robots:
            if len(robot.model.joints) > MAX_PYBULLET_JOINTS:
                count = len(robot.model.joints)
                raise EngineError(
                    f"'{robot.name}' has {count} joints, but PyBullet supports at most {MAX_PYBULLET_JOINTS},"
                    " including fixed joints"
                )
            model = with_explicit_masses(robot.name, robot.model, robot.fixed_base)
            body = _load(
                client, robot.name, model, robot.fixed_base, file, self_collision=robot.self_collision
            )
            body.initial_pose = body.center_pose(*frames.frame(robot.pose))
            yield Pool(robot.name, [(robot.name, body)], pooled=False)


def join_islands(client: int, pools: Iterable[Pool[Body]]) -> None:
    """Join all moving bodies to one another with gears that exert nothing, so that the solver sees one group.

    It solves bodies whose boxes overlap together, iterates until such a group is done, and forgets overlaps
    at a moment that depends on the whole past. Of 150 episodes of three carts after a reset 34 differed from
    a fresh world's; tied together, none. 20 idle balls then cost 50 us a step; a robot by itself nothing.
    All are tied to the first body, which is a permanent one if possible; an absent body ties nothing.
    """
    tied = sorted((pool for pool in pools), key=lambda pool: pool.pooled)
    anchors = [(body.number, body.anchor) for pool in tied for body in pool if body.anchor is not None]
    for number, link in anchors[1:]:
        gear = p.createConstraint(
            *anchors[0],
            number,
            link,
            p.JOINT_GEAR,
            (0, 1, 0),
            ZERO_VECTOR,
            ZERO_VECTOR,
            physicsClientId=client,
        )
        p.changeConstraint(gear, maxForce=0.0, physicsClientId=client)


def _object(client: int, object_body: ObjectBody, file: Path) -> Body:
    model = as_robot(object_body)
    fixed = not is_movable(object_body)
    is_mesh = isinstance(object_body.shape, Mesh)
    body = _load(client, object_body.name, model, fixed, file, inertia_known=not is_mesh)
    body.initial_pose = body.center_pose(*frames.frame(object_body.pose))
    return body


def _load(
    client: int,
    name: str,
    model: RobotModel,
    fixed: bool,
    file: Path,
    inertia_known: bool = True,
    self_collision: bool = False,
) -> Body:
    file.write_text(to_urdf(for_loader(model, file.parent)), encoding="utf-8")
    # Without the second flag, PyBullet makes up the inertia from the collision shapes.
    flags = p.URDF_USE_IMPLICIT_CYLINDER | (p.URDF_USE_INERTIA_FROM_FILE if inertia_known else 0)
    flags |= p.URDF_USE_SELF_COLLISION if self_collision else 0
    with capture_native_output() as output:
        try:
            number = p.loadURDF(str(file), useFixedBase=int(fixed), flags=flags, physicsClientId=client)
        except p.error as error:
            raise EngineError(f"PyBullet cannot load '{name}': {output() or error}") from error
    body = Body(name, number, model, fixed, client)
    _make_contact(client, body)
    if self_collision:
        _collide_with_itself(client, body)
    for follower, mimic in model.followers.items():
        _follow(client, number, body.joints[follower], body.joints[mimic.joint], mimic)
    for setting in (
        {"linearDamping": 0.0},  # by default a free body at 1 m/s loses 7.5 % of its speed in 1 s
        {"angularDamping": 0.0},
        {"maxJointVelocity": UNREACHABLE_SPEED},  # PyBullet caps joints at 100 rad/s or m/s by default
        {"activationState": p.ACTIVATION_STATE_DISABLE_SLEEPING},
    ):
        p.changeDynamics(number, BASE_LINK, **setting, physicsClientId=client)
    return body


def _collide_with_itself(client: int, body: Body) -> None:
    """Let links touch each other that no joint joins."""
    body.own_pairs = tuple(
        (body.links[first], body.links[second]) for first, second in self_collision_pairs(body.model)
    )
    for pair in combinations(body.links.values(), 2):
        p.setCollisionFilterPair(body.number, body.number, *pair, 0, client)
    set_self_contact(client, body, is_on=True)


def set_self_contact(client: int, body: Body, *, is_on: bool) -> None:
    """Let the links of a body touch each other, or not."""
    for pair in body.own_pairs:
        p.setCollisionFilterPair(body.number, body.number, *pair, int(is_on), client)


def _follow(client: int, number: int, follower: int, leader: int, mimic: Mimic) -> None:
    """Make a joint follow its leader, by a gear: PyBullet keeps `follower + ratio * leader` at the target."""
    joints = (number, follower, number, leader)
    gear = p.createConstraint(
        *joints, p.JOINT_GEAR, (0, 0, 1), ZERO_VECTOR, ZERO_VECTOR, physicsClientId=client
    )
    ratio = -mimic.multiplier or NO_RATIO
    settings = {
        "gearRatio": ratio,
        "relativePositionTarget": mimic.offset,
        "erp": GEAR_ERP,
        "maxForce": GEAR_FORCE,
    }
    p.changeConstraint(gear, **settings, physicsClientId=client)


def _make_contact(client: int, body: Body) -> None:
    """Set friction and restitution, one property per call: two in one went to the root link.

    A link that bounces makes contact at distance 0. The solver otherwise brakes it before it touches: of a
    bounce of 0.8 between 0.06 and 0.82 was left, at 1 ms a step.
    """
    for link in body.model.links:
        parameters = contact_parameters(link.friction)
        if parameters["restitution"] > 0.0:
            parameters["contactProcessingThreshold"] = 0.0
        for key, value in parameters.items():
            p.changeDynamics(body.number, body.links[link.name], **{key: value}, physicsClientId=client)


def _plane(client: int, ground: Ground) -> Body:
    shape = p.createCollisionShape(p.GEOM_PLANE, physicsClientId=client)
    # Without a visual shape, PyBullet would draw the collision shape; `surfaces.Floor` draws the ground.
    unseen = p.createVisualShape(
        p.GEOM_SPHERE, radius=1e-3, visualFramePosition=(0.0, 0.0, -1000.0), physicsClientId=client
    )
    number = p.createMultiBody(0, shape, unseen, physicsClientId=client)
    return _ground_body(client, number, Friction(lateral=ground.friction, restitution=ground.restitution))


def _terrain(client: int, ground: Terrain) -> Body:
    """Return the ground with heights as a heightfield, meshes as they are, neither of them convex.

    Raises:
        EngineError: Its file has gone or changed, or it has no height somewhere.
    """
    heights = height_grid(ground.shape)
    if heights is None:
        assert isinstance(ground.shape, Mesh)  # all else is a grid
        corners = mesh_triangles(ground.shape).reshape(-1, 3)
        mesh = {
            "vertices": corners.tolist(),
            "indices": list(range(len(corners))),
            "flags": p.GEOM_FORCE_CONCAVE_TRIMESH,
        }
        shape = p.createCollisionShape(p.GEOM_MESH, **mesh, physicsClientId=client)
        visual = _drawn_terrain(client, corners, np.arange(len(corners)).reshape(-1, 3), ground)
        middle = 0.0
    else:
        middle = float(heights.heights.max() + heights.heights.min()) / 2  # the library moves it there
        rows, columns = heights.heights.shape
        shape = p.createCollisionShape(
            p.GEOM_HEIGHTFIELD,
            meshScale=(*heights.cell, 1.0),
            heightfieldData=heights.heights.ravel().tolist(),
            numHeightfieldRows=columns,  # PyBullet's rows run along x
            numHeightfieldColumns=rows,
            physicsClientId=client,
        )
        visual = _drawn_terrain(client, *heights.coarsened(_MAX_VISUAL_CELLS).triangles(), ground, middle)
    if shape < 0:
        raise EngineError("PyBullet cannot build the terrain")
    number = p.createMultiBody(0, shape, visual, basePosition=(0.0, 0.0, middle), physicsClientId=client)
    body = _ground_body(client, number, Friction(lateral=ground.friction))
    body.initial_pose = ((0.0, 0.0, middle), frames.IDENTITY_ROTATION)
    return body


def _drawn_terrain(
    client: int, vertices: NDArray[np.float64], faces: NDArray[np.int64], ground: Terrain, middle: float = 0.0
) -> int:
    """Return the visual shape of the terrain, shaded smoothly."""
    normals = np.zeros_like(vertices)
    a, b, c = (vertices[faces[:, corner]] for corner in range(3))
    for corner in range(3):
        # `+=` with an array of indices would count a vertex of several faces once.
        np.add.at(normals, faces[:, corner], np.cross(b - a, c - a))
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
    shape: int = p.createVisualShape(
        p.GEOM_MESH,
        vertices=(vertices - (0.0, 0.0, middle)).tolist(),
        indices=faces.ravel().tolist(),
        normals=normals.tolist(),
        rgbaColor=ground.color or TERRAIN_COLOR,
        physicsClientId=client,
    )
    return shape


def _ground_body(client: int, number: int, friction: Friction) -> Body:
    return Body(
        GROUND, number, RobotModel(GROUND, (Link(GROUND, friction=friction),), (), GROUND), True, client
    )


def for_loader(model: RobotModel, folder: Path) -> RobotModel:
    """Return the model with both ends on each range of a joint, a color on all visible shapes, and the
    checked meshes.

    A link without visuals shows its collision shapes. Cylinders are drawn as the mesh in `folder`: those of
    the library share normals between side and caps, so that a flat disc looked like a cone. Meshes
    that collide are smaller by the margin of the library.

    Raises:
        EngineError: A mesh cannot be read or has changed.
    """
    links = []
    for index, link in enumerate(model.links):
        for geometry in (*link.visuals, *link.collisions):
            if isinstance(geometry.shape, Mesh):
                read_verified(geometry.shape)
        color = LINK_COLORS[index % len(LINK_COLORS)]
        visuals = tuple(
            replace(visual, color=visual.color or color, shape=_seen_shape(visual.shape, folder))
            for visual in link.visuals or link.collisions
        )
        collisions = tuple(_within_margin(piece, folder) for piece in link.collisions)
        links.append(replace(link, visuals=visuals, collisions=collisions))
    return replace(
        model,
        links=tuple(links),
        joints=tuple(replace(joint, limit=_explicit_limits(joint)) for joint in model.joints),
    )


def _seen_shape(shape: Shape, folder: Path) -> Shape:
    match shape:
        case Cylinder(radius, length):
            return Mesh(str(folder / _CYLINDER), "", (radius, radius, length))
        case Mesh():
            return _readable(shape, folder)
        case _:
            return shape


def _within_margin(piece: Geometry, folder: Path) -> Geometry:
    """Return a collision shape for the loader: a mesh is made smaller about the middle of its box, by the
    margin on each side, but at most to half of its size."""
    if not isinstance(piece.shape, Mesh) or (bounds := mesh_bounds(piece.shape)) is None:
        return piece
    shape = _readable(piece.shape, folder)
    shares = [1.0 - 2.0 * min(HULL_MARGIN_M, side / 4) / side if side else 1.0 for side in box_sides(bounds)]
    middle = frames.scaled(frames.add(*bounds), 0.5)
    x, y, z = ((1.0 - share) * along for share, along in zip(shares, middle, strict=True))
    position, rotation = frames.frame(piece.origin)
    xyz = frames.add(position, frames.rotate(rotation, (x, y, z)))
    a, b, c = (factor * share for factor, share in zip(shape.scale, shares, strict=True))
    return replace(piece, shape=replace(shape, scale=(a, b, c)), origin=replace(piece.origin, xyz=xyz))


def _readable(mesh: Mesh, folder: Path) -> Mesh:
    """Return a mesh as a file that the library reads as deepbots does: an OBJ file for COLLADA, whose nodes
    it composes otherwise, and for an STL file of text or an OBJ file that is not plain, which it does not
    read."""
    suffix, data = Path(mesh.path).suffix.lower(), read_verified(mesh)
    if (suffix == ".obj" and is_plain_obj(data)) or (suffix == ".stl" and not is_text_stl(data)):
        return mesh
    file = folder / f"{mesh.digest}.obj"
    corners = mesh_triangles(replace(mesh, scale=(1.0, 1.0, 1.0))).reshape(-1, 3)
    vertices, faces = np.unique(corners, axis=0, return_inverse=True)
    lines = [f"v {x!r} {y!r} {z!r}" for x, y, z in vertices.tolist()]
    lines += [f"f {a} {b} {c}" for a, b, c in (faces.reshape(-1, 3) + 1).tolist()]
    file.write_text("\n".join(lines), encoding="ascii")
    return Mesh(str(file), "", mesh.scale)


def _cylinder_mesh(sides: int = 48) -> str:
    """Return a cylinder of radius 1 and length 1 as OBJ: two corners and a normal for each side, the normals
    of the caps, and their middles."""
    angles = 2 * np.pi * np.arange(sides) / sides
    rim = [f"{x:.6f} {y:.6f}" for x, y in zip(np.cos(angles), np.sin(angles), strict=True)]
    lines = [f"v {x_y} {z}" for x_y in rim for z in (-0.5, 0.5)] + ["v 0 0 -0.5", "v 0 0 0.5"]
    lines += [f"vn {x_y} 0" for x_y in rim] + ["vn 0 0 -1", "vn 0 0 1"]
    below, above = 2 * sides + 1, 2 * sides + 2
    for index in range(1, sides + 1):
        next_index = index % sides + 1
        a, b, c, d = 2 * index - 1, 2 * next_index - 1, 2 * next_index, 2 * index
        lines += [
            f"f {a}//{index} {b}//{next_index} {c}//{next_index}",
            f"f {a}//{index} {c}//{next_index} {d}//{index}",
        ]
        lines += [
            f"f {below}//{sides + 1} {b}//{sides + 1} {a}//{sides + 1}",
            f"f {above}//{sides + 2} {d}//{sides + 2} {c}//{sides + 2}",
        ]
    return "\n".join([*lines, ""])


def _explicit_limits(joint: Joint) -> Limit:
    limit = joint.limit
    lower, upper = limit.lower, limit.upper
    if joint.type == "continuous" or (lower is None and upper is None):
        lower, upper = UNLIMITED_RANGE
    return Limit(
        lower=-OPEN_JOINT_LIMIT if lower is None else lower,
        upper=OPEN_JOINT_LIMIT if upper is None else upper,
        velocity=limit.velocity or 0.0,
        effort=limit.effort or 0.0,
    )
