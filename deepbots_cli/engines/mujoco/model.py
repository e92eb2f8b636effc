"""Ground, walls, objects and robots as a model of MuJoCo, built from the world model."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import field
from itertools import combinations, product
from math import dist, hypot, inf
from operator import mul
from typing import TYPE_CHECKING, Any

import numpy as np

from deepbots_cli import frames
from deepbots_cli.engine_kinds import ENGINES
from deepbots_cli.engines.mechanics import (
    LINK_COLORS,
    ROOT_MASS_FRACTION,
    Pool,
    arena_walls,
    as_robot,
    forms_of,
    is_movable,
    rigid_group,
    with_explicit_masses,
)
from deepbots_cli.engines.mujoco import mujoco as mj
from deepbots_cli.engines.mujoco import sliding
from deepbots_cli.errors import EngineError
from deepbots_cli.geometry import HeightGrid, height_grid, mesh_triangles
from deepbots_cli.program.world import GROUND, Color, Line, ObjectBody, Terrain, WorldModel
from deepbots_cli.records import dataclass
from deepbots_cli.robots.kinematics import self_collision_pairs
from deepbots_cli.robots.model import (
    Box,
    Capsule,
    Cylinder,
    Friction,
    Geometry,
    Joint,
    Link,
    Mesh,
    Mimic,
    RobotModel,
    Sphere,
)

if TYPE_CHECKING:
    from deepbots_cli.frames import Frame, Matrix, Triple

MjObject = Any
"""An element of a specification, or a compiled model; MuJoCo has no types that a checker could read."""

PARKING_SPACING_M = 1000.0  # m between bodies that are absent
GROUND_DEPTH_M = 1.0  # m of ground below the lowest place of a terrain
# Groups of geoms: those that rays meet, those that rays do not meet, and those that are only drawn.
SOLID_GROUP = 0
HIDDEN_GROUP = 5
CONTACT_TIME_CONSTANT_S, MIN_CONTACT_STEPS = 0.01, 3.0
"""The time constant (s) of contacts and joint limits, and its least value in engine steps.

MuJoCo's contacts are springs. With these a crate rests 27 um deep at steps of 1 ms and 0.15 mm at 8 ms.
Stiffer ones (2 steps, impedance 0.95 to 0.99) are ten times less deep, and a crate that lands at 1 m/s hops
1.6 mm.
"""
CONTACT_IMPEDANCE = (0.9, 0.95, 0.001, 0.5, 2.0)
GEAR_STEPS, GEAR_IMPEDANCE = 2.0, (0.9999, 0.9999, *CONTACT_IMPEDANCE[2:])
"""The time constant (engine steps) and impedance of a joint that follows another one: as stiff as MuJoCo
allows.

A driven pair is off by 2 um, and one that is pushed into a limit by 6 um (steps of 5 ms, 0.1 kg, 20 N).
"""
TIRE_IMPEDANCE = (2 * 0.9 / (1 + 0.9), 2 * 0.95 / (1 + 0.95), *CONTACT_IMPEDANCE[2:])
"""A tire touches in one point where a cylinder touches in two: it gives way half as much as one of them, and
sinks as deep as both.

A contact gives way by (1 - impedance) / impedance.
"""
AXLE_TOLERANCE = 1e-3
"""The tolerance of the axis of a wheel against that of its joint: as a part of the radius, and in rad. Files
round a right angle to 1.571."""
MAX_HULL_VERTICES = 10_000
"""The maximum number of vertices of the hull of a mesh. On a ball with a radius of 20 cm, 10,000 are within
0.03 mm. A hull of 1,900,000 vertices took 33 s."""
NEAR_CLIP_M, FAR_CLIP_M = 0.01, 2000.0  # m; the range of distances that are drawn
MIN_INERTIA = 1e-12
"""The least inertia (kg m^2) of a link with a mass; MuJoCo refuses less than 1e-14, which files give to
frames of 1 ug."""
FACE_DISTANCE_M = 2e-5
"""The distance by which faces in one plane are separated in a picture, in m. 5 um are enough for a table in
the floor that is 50 m away."""
_SAME_PLANE_M = 1e-5
_MAX_LEVEL = 10
TERRAIN_COLOR = (0.72, 0.63, 0.48, 1.0)
_TERRAIN_SHADE = (0.66, 0.57, 0.43)
TERRAIN_TILES = "terrain tiles"
"""The material of a terrain in pictures for people, which shows its steps; cameras see one color."""
_TILE_COLORS = (0.87, 0.89, 0.91), (0.78, 0.81, 0.84)


@dataclass(eq=False)
class Body:
    """A robot or an object in one of its forms: ids of links and of their geoms, and of joints, by name.

    The state has the 7 position numbers of a root link that moves from `position_index` on, and its 6
    velocity numbers from `velocity_index` on; any other root link has a `mocap_index`. `static_links` are the
    links that never move.
    """

    name: str
    model: RobotModel
    fixed: bool
    initial_pose: Frame
    self_collision: bool = False
    links: dict[str, int] = field(default_factory=dict)
    joints: dict[str, int] = field(default_factory=dict)
    geoms: dict[str, list[int]] = field(default_factory=dict)
    static_links: frozenset[str] = frozenset()
    root_id: int = 0
    position_index: int = -1
    velocity_index: int = -1
    mocap_index: int = -1

    def deactivate(self) -> None:
        """Do nothing: a reset has put it away."""

    def activate(self) -> None:
        """Do nothing: the engine shows it."""

    def geoms_of(self, link: str | None) -> list[int]:
        """Return the geoms of a link, or of all."""
        return (
            self.geoms[link]
            if link is not None
            else [geom for geoms in self.geoms.values() for geom in geoms]
        )


class ModelBuilder:
    """Builds a model of the world, and its bodies. The model for pictures has the same bodies and joints,
    with their visible shapes as geoms."""

    def __init__(self, world: WorldModel, for_rendering: bool = False) -> None:
        self._world = world
        self._for_rendering = for_rendering
        self.spec = spec = mj.MjSpec()
        step = world.timestep / world.substeps
        spec.option.timestep = step
        spec.option.gravity = world.gravity
        spec.option.integrator = mj.mjtIntegrator.mjINT_EULER
        sliding.prepare(spec)
        spec.option.disableflags = mj.mjtDisableBit.mjDSBL_AUTORESET
        spec.compiler.degree = False  # rad; MuJoCo's own default is degrees
        spec.compiler.autolimits = False
        # Aligned, the pose of a free body would be that of its center of mass, not that of its link.
        spec.compiler.alignfree = False
        spec.stat.extent = 1.0  # m; MuJoCo multiplies the clipping distances by it
        spec.visual.map.znear, spec.visual.map.zfar = NEAR_CLIP_M, FAR_CLIP_M
        self._response = (max(CONTACT_TIME_CONSTANT_S, MIN_CONTACT_STEPS * step), 1.0)
        self._made: list[
            tuple[Body, dict[str, MjObject], dict[str, MjObject], dict[str, list[MjObject]]]
        ] = []
        self._flat = world.terrain is None and world.ground is not None and not for_rendering
        self._wheels: set[str] = set()
        self._tires: set[str] = set()
        # Elements are named by number: names in MuJoCo are unique, and two robots may come from one file.
        self._elements = self._absent = 0
        self._links: list[tuple[int, str, str]] = []
        """The number of the first element of each link, its body and its name, for errors."""
        self.pools: list[Pool[Body]] = []
        if for_rendering:
            self._add_light()
        self._add_ground()
        for object_body in (*(arena_walls(world.arena) if world.arena else ()), *world.objects):
            variants = [
                (name, self._object(form, object_body.pooled)) for name, form in forms_of(object_body).items()
            ]
            self.pools.append(Pool(object_body.name, variants, object_body.pooled))
        for robot in world.robots:
            model = with_explicit_masses(robot.name, robot.model, robot.fixed_base)
            body = self._add(
                Body(robot.name, model, robot.fixed_base, frames.frame(robot.pose), robot.self_collision)
            )
            self.pools.append(Pool(robot.name, [(robot.name, body)], pooled=False))

    def compile(self) -> MjObject:
        """Return the compiled model; the bodies then have their ids.

        Raises:
            EngineError: MuJoCo refuses the world; names the link.
        """
        if self._for_rendering:
            self._part_faces()
        else:
            self._add_pairs()
        try:
            model = self.spec.compile()
        except ValueError as error:
            raise self._refusal(str(error)) from error
        # The search for islands of contacts takes 5 % of a step, and finds the only body that moves.
        if model.ntree == 1:
            model.opt.disableflags |= mj.mjtDisableBit.mjDSBL_ISLAND
            if _branches(model):  # the rows of a contact are then half zeros: 12 % of a step of the quadruped
                model.opt.jacobian = mj.mjtJacobian.mjJAC_SPARSE
        for body, links, joints, geoms in self._made:
            body.links = {name: element.id for name, element in links.items()}
            body.joints = {name: element.id for name, element in joints.items()}
            body.geoms = {name: [geom.id for geom in element] for name, element in geoms.items()}
            body.root_id = body.links[body.model.root]
            body.mocap_index = int(model.body_mocapid[body.root_id])
            for link in body.model.links:
                if link.center_varies:
                    # MuJoCo reads no place of a center at the origin, or of a geom at the center.
                    model.body_sameframe[body.links[link.name]] = mj.mjtSameFrame.mjSAMEFRAME_NONE
                    model.geom_sameframe[body.geoms[link.name]] = mj.mjtSameFrame.mjSAMEFRAME_NONE
            if not body.fixed:
                first = model.body_jntadr[body.root_id]
                body.position_index, body.velocity_index = (
                    int(model.jnt_qposadr[first]),
                    int(model.jnt_dofadr[first]),
                )
        return model

    def _refusal(self, text: str) -> EngineError:
        """Return the error for a world that MuJoCo refuses. Its text is `Error: REASON`, and in the next line
        `Element name 'NAME', id ID`."""
        first, _, second_line = text.partition("\n")
        reason = re.split(r"[.;]\s", re.sub(r":? '?m\d+'?", "", first.removeprefix("Error: ")))[0]
        element = re.search(r"'[bgjm](\d+)'", second_line)
        number = int(element[1]) if element else 0
        owner = next(((body, link) for start, body, link in reversed(self._links) if start <= number), None)
        if owner is None:
            return EngineError(f"MuJoCo cannot build this world: {reason}")
        return EngineError(
            f"MuJoCo cannot build link '{owner[1]}' of '{owner[0]}': {reason}; correct its inertia, shapes"
            " or joint"
        )

    # Ground

    def _add_ground(self) -> None:
        world = self._world
        shape: dict[str, Any]
        color: Color | None
        if world.terrain is not None:
            relief = self._relief(world.terrain)
            shape = {
                "type": mj.mjtGeom.mjGEOM_HFIELD,
                "hfieldname": GROUND,
                "pos": (0.0, 0.0, float(relief.heights.min())),
            }
            friction = Friction(lateral=world.terrain.friction)
            color = world.terrain.color or TERRAIN_COLOR
        elif world.ground is not None:
            shape = {"type": mj.mjtGeom.mjGEOM_PLANE, "size": (0.0, 0.0, 1.0)}  # a size of 0 is endless
            friction = Friction(lateral=world.ground.friction, restitution=world.ground.restitution)
            color = world.ground.color
        else:
            return
        body = Body(
            GROUND,
            RobotModel(GROUND, (Link(GROUND, friction=friction),), (), GROUND),
            True,
            frames.IDENTITY_FRAME,
            static_links=frozenset({GROUND}),
        )
        if self._for_rendering:
            shape |= {"rgba": color} if color else {"material": self._tiles("tiles", *_TILE_COLORS)}
            if world.terrain is not None and world.terrain.color is None:
                self._tiles(TERRAIN_TILES, TERRAIN_COLOR[:3], _TERRAIN_SHADE)
        geom = self._geom(self.spec.worldbody, **shape)
        self._made.append((body, {GROUND: self.spec.worldbody}, {}, {GROUND: [geom]}))
        self.pools.append(Pool(GROUND, [(GROUND, body)], pooled=False))
        if self._for_rendering:
            for number, line in enumerate(world.lines):
                self._paint(line, 1e-3 + number * FACE_DISTANCE_M)

    def _relief(self, terrain: Terrain) -> HeightGrid:
        relief = height_grid(terrain.shape)
        if relief is None:
            lack = ENGINES.built_in["mujoco"].mesh_terrain
            assert lack is not None
            raise EngineError(f"{lack.reason}; {lack.help}")
        rows, columns = relief.heights.shape
        low, high = float(relief.heights.min()), float(relief.heights.max())
        span = max(high - low, 1e-6)  # MuJoCo refuses a height field without height
        self.spec.add_hfield(
            name=GROUND,
            nrow=rows,
            ncol=columns,
            size=(relief.size[0] / 2, relief.size[1] / 2, span, GROUND_DEPTH_M),
            # MuJoCo takes heights as shares, which it multiplies by the third size.
            userdata=((relief.heights - low) / span).ravel().tolist(),
        )
        return relief

    def _add_light(self) -> None:
        """Add daylight, a sky that is brighter at the horizon, and colors that do not depend on the direction
        of view."""
        spec = self.spec
        spec.visual.quality.offsamples = 0  # each pixel is sampled at its center
        gradient = mj.mjtBuiltin.mjBUILTIN_GRADIENT
        sky = mj.mjtTexture.mjTEXTURE_SKYBOX
        spec.add_texture(
            name="sky",
            type=sky,
            builtin=gradient,
            rgb1=(0.59, 0.73, 0.87),
            rgb2=(0.93, 0.95, 0.96),
            width=128,
            height=768,
        )
        spec.visual.headlight.active = False  # it shines from where the camera was in the picture before
        sun = mj.mjtLightType.mjLIGHT_DIRECTIONAL
        for direction, ambient, diffuse in (((-0.3, 0.4, -0.87), 0.45, 0.5), ((0.5, -0.6, -0.3), 0.0, 0.1)):
            dull = {
                "ambient": (ambient,) * 3,
                "diffuse": (diffuse,) * 3,
                "specular": (0.0,) * 3,
                "castshadow": False,
            }
            spec.worldbody.add_light(type=sun, pos=(0, 0, 10), dir=direction, **dull)

    def _tiles(self, name: str, light: Triple, dark: Triple) -> str:
        """Add a material of tiles in two colors, and return its name."""
        kinds = {"type": mj.mjtTexture.mjTEXTURE_2D, "builtin": mj.mjtBuiltin.mjBUILTIN_CHECKER}
        self.spec.add_texture(name=name, rgb1=light, rgb2=dark, width=256, height=256, **kinds)
        material = self.spec.add_material(name=name, texuniform=True, texrepeat=(4.0, 4.0))
        material.textures[mj.mjtTextureRole.mjTEXROLE_RGB] = name
        return name

    def _paint(self, line: Line, thin: float) -> None:
        """Add a box for each piece, and a disc at each of its ends; a line that rises higher (m) covers those
        below."""
        half = line.width / 2
        for (x0, y0), (x1, y1) in line.pieces:
            long = float(np.hypot(x1 - x0, y1 - y0)) / 2
            yaw = float(np.arctan2(y1 - y0, x1 - x0))
            rotation = frames.wxyz(frames.quaternion(0.0, 0.0, yaw))
            if long > 0.0:
                middle, size = ((x0 + x1) / 2, (y0 + y1) / 2, 0.0), (long, half, thin)
                self._geom(
                    self.spec.worldbody,
                    type=mj.mjtGeom.mjGEOM_BOX,
                    size=size,
                    pos=middle,
                    quat=rotation,
                    rgba=line.color,
                )
            for x, y in ((x0, y0), (x1, y1)):
                disc = (half, thin, 0.0)
                self._geom(
                    self.spec.worldbody,
                    type=mj.mjtGeom.mjGEOM_CYLINDER,
                    size=disc,
                    pos=(x, y, 0.0),
                    rgba=line.color,
                )

    # Bodies

    def _object(self, body: ObjectBody, pooled: bool) -> Body:
        home = frames.frame(body.pose)
        if pooled:
            self._absent += 1
            home = (
                # Above the ground: a plane is a half-space in MuJoCo, and a body below it is in contact.
                (-self._absent * PARKING_SPACING_M, 0.0, self._absent * PARKING_SPACING_M),
                frames.IDENTITY_ROTATION,
            )
        return self._add(Body(body.name, as_robot(body), not is_movable(body), home), pooled)

    def _add(self, body: Body, pooled: bool = False) -> Body:
        """Add the links and joints of a body to the specification."""
        model = body.model
        subtree_mass = model.subtree_mass()
        joint_of = {joint.child: joint for joint in model.joints}
        body.static_links = frozenset(rigid_group(model, model.root)) if body.fixed else frozenset()
        links: dict[str, MjObject] = {}
        joints: dict[str, MjObject] = {}
        geoms: dict[str, list[MjObject]] = {}
        order = [model.root]
        for index, name in enumerate(order):
            link = model.link(name)
            above = joint_of.get(name)
            position, rotation = body.initial_pose if above is None else frames.frame(above.origin)
            parent = self.spec.worldbody if above is None else links[above.parent]
            self._elements += 1
            self._links.append((self._elements, body.name, name))
            weightless = float(pooled and not body.fixed)
            links[name] = body_element = parent.add_body(
                name=f"b{self._elements}", pos=position, quat=frames.wxyz(rotation), gravcomp=weightless
            )
            if above is None:
                # A mocap body can be placed anew in an episode, without another compilation.
                body_element.mocap = body.fixed
                if not body.fixed:
                    body_element.add_freejoint()
            elif above.moves:
                joints[above.name] = self._joint(body_element, above)
            self._set_inertia(
                body_element,
                body.name,
                link,
                ROOT_MASS_FRACTION * subtree_mass[name] if above is None or above.moves else 0.0,
            )
            pieces = (link.visuals or link.collisions) if self._for_rendering else link.collisions
            geoms[name] = [self._surface(body_element, piece, index, pooled) for piece in pieces]
            if self._flat and above is not None:
                geoms[name] += self._add_tires(body_element, link, above, geoms[name])
            order += [joint.child for joint in model.joints_below[name]]
        if not self._for_rendering:
            for follower, mimic in model.followers.items():
                self._follow(joints[follower], joints[mimic.joint], mimic)
        self._made.append((body, links, joints, geoms))
        return body

    def _set_inertia(self, element: MjObject, body: str, link: Link, trace: float) -> None:
        """Set mass and inertia; a moving link without them gets a trace of the mass that it carries, since
        MuJoCo accepts no such link.

        Raises:
            EngineError: No rigid body can have the inertia.
        """
        inertial = link.inertial
        mass = inertial.mass if inertial else 0.0
        if inertial is None or mass <= 0.0:
            mass = trace
            tensor = frames.diagonal((trace, trace, trace))
            at = (0.0, 0.0, 0.0)
        else:
            tensor = frames.rotate_tensor(inertial.matrix, frames.rotation_matrix(inertial.origin.rpy))
            at = inertial.origin.xyz
            if not inertial.is_stated:
                tensor = self._made_up(link, mass)
            elif not inertial.is_plausible:
                lack = ENGINES.built_in["mujoco"].implausible_inertia
                assert lack is not None
                raise EngineError(f"link '{link.name}' of '{body}' {lack.reason}; {lack.help}")
            else:
                tensor = _without_excess(tensor)
            if max(tensor[axis][axis] for axis in range(3)) < MIN_INERTIA:
                tensor = frames.diagonal((MIN_INERTIA,) * 3)
        element.explicitinertial = True
        element.simple = not link.center_varies
        element.mass = mass
        element.ipos = at
        if mass > 0.0:
            element.fullinertia = (
                tensor[0][0],
                tensor[1][1],
                tensor[2][2],
                tensor[0][1],
                tensor[0][2],
                tensor[1][2],
            )

    def _made_up(self, link: Link, mass: float) -> Matrix:
        """Return the inertia of a link that has a mass only: that of the box around its mesh, or else a
        trace."""
        for piece in link.collisions:
            if isinstance(piece.shape, Mesh):
                corners = mesh_triangles(piece.shape).reshape(-1, 3)
                x, y, z = ((corners.max(axis=0) - corners.min(axis=0)) ** 2).tolist()
                box = frames.diagonal((mass / 12 * (y + z), mass / 12 * (x + z), mass / 12 * (x + y)))
                return frames.rotate_tensor(box, frames.rotation_matrix(piece.origin.rpy))
        return frames.diagonal((ROOT_MASS_FRACTION * mass,) * 3)

    def _joint(self, element: MjObject, joint: Joint) -> MjObject:
        kinds = mj.mjtJoint
        lower, upper = joint.limit.lower, joint.limit.upper
        open_ended = joint.type == "continuous" or (lower is None and upper is None)
        low, high = -1e9 if lower is None else lower, 1e9 if upper is None else upper
        self._elements += 1
        name = f"j{self._elements}"
        added = element.add_joint(
            name=name,
            type=kinds.mjJNT_SLIDE if joint.type == "prismatic" else kinds.mjJNT_HINGE,
            axis=joint.axis,
            limited=not open_ended and low <= high,
            # MuJoCo refuses a range whose ends are equal or crossed.
            range=(low, max(high, low + 1e-9)),
            damping=joint.damping,
            frictionloss=joint.friction,
            armature=joint.armature,
            solref_limit=self._response,
            solimp_limit=CONTACT_IMPEDANCE,
            solref_friction=self._response,
            solimp_friction=CONTACT_IMPEDANCE,
        )
        actuator = self.spec.add_actuator(
            name=name,
            target=name,
            trntype=mj.mjtTrn.mjTRN_JOINT,
            biastype=mj.mjtBias.mjBIAS_AFFINE,
            gaintype=mj.mjtGain.mjGAIN_FIXED,
        )
        actuator.gainprm[0] = 1.0
        return added

    def _follow(self, follower: MjObject, leader: MjObject, mimic: Mimic) -> None:
        """Make a joint follow its leader."""
        self.spec.add_equality(
            type=mj.mjtEq.mjEQ_JOINT,
            objtype=mj.mjtObj.mjOBJ_JOINT,
            name1=follower.name,
            name2=leader.name,
            # The coefficients of a polynomial of the leader's position, from degree 0 on.
            data=(mimic.offset, mimic.multiplier, *(0.0,) * (mj.mjNEQDATA - 2)),
            solref=(GEAR_STEPS * self.spec.option.timestep, 1.0),
            solimp=GEAR_IMPEDANCE,
        )

    def _surface(self, element: MjObject, piece: Geometry, index: int, pooled: bool) -> MjObject:
        position, rotation = frames.frame(piece.origin)
        color = piece.color or LINK_COLORS[index % len(LINK_COLORS)]
        about: dict[str, Any] = {
            "pos": position,
            "quat": frames.wxyz(rotation),
            "rgba": color if self._for_rendering else (1, 1, 1, 1),
        }
        group = HIDDEN_GROUP if pooled and not self._for_rendering else SOLID_GROUP
        kinds = mj.mjtGeom
        match piece.shape:
            case Box(size):
                return self._geom(
                    element, group, type=kinds.mjGEOM_BOX, size=[side / 2 for side in size], **about
                )
            case Sphere(radius):
                return self._geom(element, group, type=kinds.mjGEOM_SPHERE, size=(radius, 0, 0), **about)
            case Cylinder(radius, length):
                return self._geom(
                    element, group, type=kinds.mjGEOM_CYLINDER, size=(radius, length / 2, 0), **about
                )
            case Capsule(radius, length):
                return self._geom(
                    element, group, type=kinds.mjGEOM_CAPSULE, size=(radius, length / 2, 0), **about
                )
            case Mesh():
                return self._geom(
                    element, group, type=kinds.mjGEOM_MESH, meshname=self._mesh(piece.shape), **about
                )

    def _add_tires(
        self, element: MjObject, link: Link, axle: Joint, cylinders: list[MjObject]
    ) -> list[MjObject]:
        """Add for each wheel of a link the surface that meets flat ground: an ellipsoid within the wheel,
        which touches in its middle.

        A cylinder touches flat ground at both ends of its width, which doubles the constraints and makes a
        wheel slip in an arc.
        """
        tires = []
        for piece, cylinder in zip(link.collisions, cylinders, strict=True):
            if isinstance(piece.shape, Cylinder) and _is_wheel(piece.shape, frames.frame(piece.origin), axle):
                radius = piece.shape.radius
                half = piece.shape.length / 2
                kind = mj.mjtGeom.mjGEOM_ELLIPSOID
                size = (radius, radius, half)
                tire = self._geom(
                    element, HIDDEN_GROUP, type=kind, size=size, pos=cylinder.pos, quat=cylinder.quat
                )
                self._wheels.add(cylinder.name)
                self._tires.add(tire.name)
                tires.append(tire)
        return tires

    def _mesh(self, mesh: Mesh) -> str:
        """Add a mesh and return its name; MuJoCo uses its convex hull for collisions, as PyBullet does with
        meshes that move.

        Shapes that are only drawn need no hull: flat meshes have none.
        """
        corners = mesh_triangles(mesh).reshape(-1, 3)
        # Files of triangles repeat a vertex for each face that meets there; MuJoCo gets it once.
        vertices, faces = np.unique(corners, axis=0, return_inverse=True)
        self._elements += 1
        name = f"m{self._elements}"
        inertia = mj.mjtMeshInertia
        self.spec.add_mesh(
            name=name,
            uservert=vertices.ravel().tolist(),
            userface=faces.ravel().tolist(),
            inertia=inertia.mjMESH_INERTIA_SHELL if self._for_rendering else inertia.mjMESH_INERTIA_CONVEX,
            maxhullvert=MAX_HULL_VERTICES if len(vertices) > MAX_HULL_VERTICES else -1,
        )
        return name

    def _geom(self, element: MjObject, group: int = SOLID_GROUP, **about: Any) -> MjObject:
        """Add a geom that touches nothing except by an entry of its own, and has no mass."""
        self._elements += 1
        return element.add_geom(
            name=f"g{self._elements}", contype=0, conaffinity=0, group=group, mass=0.0, **about
        )

    # Faces in one plane

    def _part_faces(self) -> None:
        """Enlarge a surface a little that has a face in the plane of a face of an earlier one: drawn faces in
        one plane flicker.

        This is done for the surfaces of a link, and for those of all bodies that never move.
        """
        staying: list[tuple[MjObject, Frame]] = []
        for body, _, _, geoms in self._made:
            if body.name != GROUND:
                for link, elements in geoms.items():
                    if body.fixed and link == body.model.root:
                        staying += [
                            (geom, frames.compose(body.initial_pose, _frame_of(geom))) for geom in elements
                        ]
                    else:
                        _part([(geom, _frame_of(geom)) for geom in elements])
        _part(staying)

    # Pairs

    def _add_pairs(self) -> None:
        """Add an entry for each two surfaces that may touch: of two bodies, at least one of which moves, or
        of two links of a robot with `self_collision`."""
        surfaces = [list(self._surfaces(pool)) for pool in self.pools]
        for first_surfaces, second_surfaces in combinations(surfaces, 2):
            for first, stays in first_surfaces:
                for second, stays_too in second_surfaces:
                    if not (stays and stays_too):
                        self._add_pair(first, second)
        for body, _, _, geoms in self._made:
            if body.self_collision:
                for link, other_link in self_collision_pairs(body.model):
                    for first, second in product(geoms[link], geoms[other_link]):
                        self._add_pair(first, second)

    def _add_pair(self, first: MjObject, second: MjObject) -> None:
        if self._meet(first, second) and self._meet(second, first):
            self.spec.add_pair(
                geomname1=first.name,
                geomname2=second.name,
                condim=3,  # until `MujocoWorld._update_contact_pairs` sets it with the friction
                margin=0.0,
                gap=0.0,
                solref=self._response,
                solreffriction=(0.0, -1.0 / self.spec.option.timestep),
                solimp=TIRE_IMPEDANCE if self._tires & {first.name, second.name} else CONTACT_IMPEDANCE,
            )

    def _meet(self, surface: MjObject, other_surface: MjObject) -> bool:
        """Return whether a surface may touch another: a wheel touches flat ground with its tire, and anything
        else with its cylinder."""
        ground = self._flat and other_surface.type == mj.mjtGeom.mjGEOM_PLANE
        return surface.name not in (self._wheels if ground else self._tires)

    def _surfaces(self, pool: Pool[Body]) -> Iterator[tuple[MjObject, bool]]:
        """Yield the geoms of a body in all its forms, and whether they never move."""
        owned = set(map(id, pool))
        for body, _, _, geoms in self._made:
            if id(body) in owned:
                for link, element in geoms.items():
                    yield from ((geom, link in body.static_links) for geom in element)


def _part(surfaces: Sequence[tuple[MjObject, Frame]]) -> None:
    """Make surfaces larger by a step for each earlier surface in front of which they have to be."""
    planes: dict[tuple[int, ...], list[tuple[Triple, float, int]]] = {}
    for geom, frame in surfaces:
        faces = list(_faces(geom, frame))
        levels = [
            level + 1
            for plane, middle, reach in faces
            for other_middle, far, level in planes.get(plane, ())
            if dist(middle, other_middle) < reach + far
        ]
        level = min(max(levels, default=0), _MAX_LEVEL)
        for plane, middle, reach in faces:
            planes.setdefault(plane, []).append((middle, reach, level))
        if level:
            geom.size = [size + level * FACE_DISTANCE_M if size > 0.0 else 0.0 for size in geom.size]


def _faces(geom: MjObject, frame: Frame) -> Iterator[tuple[tuple[int, ...], Triple, float]]:
    """Yield the flat faces of a box or a cylinder: the plane, rounded, the middle, and how far the face
    reaches from there, m."""
    half = [float(size) for size in geom.size]
    normals: Sequence[Triple] = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
    if geom.type == mj.mjtGeom.mjGEOM_CYLINDER:
        half = [half[0], half[0], half[1]]
        normals = normals[2:]
    elif geom.type != mj.mjtGeom.mjGEOM_BOX:
        return
    for along, sign in product(normals, (1.0, -1.0)):
        axis = along.index(1.0)
        normal = frames.scaled(frames.rotate(frame[1], along), sign)
        middle = frames.add(frame[0], frames.scaled(normal, half[axis]))
        across = [half[index] for index in range(3) if index != axis]
        rounded = (
            *(round(part * 1e4) for part in normal),
            round(sum(map(mul, normal, middle)) / _SAME_PLANE_M),
        )
        yield rounded, middle, hypot(*across)


def _frame_of(geom: MjObject) -> Frame:
    """Return the frame of a shape in the frame of its link."""
    (x, y, z), (w, i, j, k) = geom.pos, geom.quat
    return (x, y, z), (i, j, k, w)


def _branches(model: MjObject) -> bool:
    """Return whether each link moves by no more than half of the degrees of freedom."""
    moved = [0] * model.nbody
    for body in range(1, model.nbody):  # a parent comes before its children
        moved[body] = moved[model.body_parentid[body]] + int(model.body_dofnum[body])
    return bool(2 * max(moved) <= model.nv)


def _without_excess(tensor: Matrix) -> Matrix:
    """Return the inertia, raised in all directions where the largest moment exceeds the sum of the others by
    rounding; MuJoCo allows none."""
    smallest, middle, largest = np.linalg.eigvalsh(tensor).tolist()
    excess = largest - middle - smallest
    if excess <= 0.0:
        return tensor
    # Raising each moment by `more` lowers the excess by `more`; the margin exceeds rounding.
    more = excess + 1e-9 * largest
    (xx, xy, xz), (_, yy, yz), (_, _, zz) = tensor
    return ((xx + more, xy, xz), (xy, yy + more, yz), (xz, yz, zz + more))


def _is_wheel(shape: Cylinder, at: Frame, axle: Joint) -> bool:
    """Return whether a cylinder turns about its own axis on a joint, and is no wider than its radius."""
    if axle.type not in ("continuous", "revolute") or shape.length > shape.radius:
        return False
    position, rotation = at
    axis = frames.rotate(rotation, (0.0, 0.0, 1.0))
    off = np.linalg.norm(np.cross(axis, axle.axis)) / np.linalg.norm(axle.axis)
    return bool(
        off < AXLE_TOLERANCE and np.linalg.norm(np.cross(axis, position)) < AXLE_TOLERANCE * shape.radius
    )


def finite_limit(bound: float) -> float:
    """Return a bound that MuJoCo accepts."""
    return min(bound, 1e12) if bound < inf else 1e12
