"""A scene as a model of MuJoCo."""

from __future__ import annotations

from itertools import combinations
from typing import Any

import numpy as np
from numpy.typing import NDArray

from deepbots_cli import frames
from deepbots_cli.engines.mujoco import mujoco as mj
from deepbots_cli.engines.mujoco import sliding
from deepbots_cli.frames import Frame, rotate_tensor, rotation_matrix
from deepbots_cli.robots.model import Box, Capsule, Cylinder, Inertial, Sphere, combined
from deepbots_webots.nodes import boolean
from deepbots_webots.scene import Body, Contact, Geometry, Joint, Scene
from deepbots_webots.shapes import Grid, Mesh, Plane, Shape, compose

Floats = NDArray[np.float64]

CONTACT_STEPS = 2.85
"""The time constant of contacts and stops, in substeps; stiffer ones let a resting box hop."""
CONTACT_IMPEDANCE = (0.98, 0.9999, 0.004, 0.5, 2.0)
"""The impedance of contacts. With a minimum of 0.9, a robot of 0.16 kg stands 0.5 mm deep in the floor (steps
of 8 ms), and one with a clearance of 0.1 mm drags its base. With a maximum of 0.95, an e-puck that pushes a
wall with its 10 N m sinks 2 cm into it."""
MOTOR_IMPEDANCE = (0.9999, 0.9999, 0.001, 0.5, 2.0)
"""The impedance of motors, with which a motor exerts all of its force. MuJoCo's default leaves 10 % of an
error."""
KINEMATIC = Inertial(1e-3, ixx=1e-6, iyy=1e-6, izz=1e-6)
"""The inertia of a solid without physics at the end of a joint."""
GRID_DEPTH_M = 1.0


class ModelBuilder:
    """Builds the specification of a model."""

    def __init__(self, scene: Scene, substep: float) -> None:
        self.scene = scene
        self.spec = spec = mj.MjSpec()
        spec.option.timestep = substep
        spec.option.gravity = scene.gravity
        spec.option.integrator = mj.mjtIntegrator.mjINT_EULER
        # Motors and bounces set rows of constraints, before contacts are corrected.
        sliding.prepare(spec, by_callback=False)
        # `Physics.step` reports a state that is not finite, which MuJoCo would reset by itself.
        spec.option.disableflags = mj.mjtDisableBit.mjDSBL_AUTORESET | mj.mjtDisableBit.mjDSBL_ISLAND
        spec.compiler.degree = False
        spec.compiler.autolimits = False
        # A free body keeps the frame of its node, to which all poses in the world refer.
        spec.compiler.alignfree = False
        # `_is_inertia` accepts moments that are rounded by 0.1 %, which MuJoCo would refuse without this.
        spec.compiler.balanceinertia = True
        spec.compiler.boundmass = 1e-9
        spec.compiler.boundinertia = 1e-14
        self.contact_time = CONTACT_STEPS * substep
        self.bodies: list[Any] = []
        self.joints: dict[Joint, Any] = {}
        self.free_joints: dict[Body, Any] = {}
        self.geometries: list[tuple[Body, Geometry]] = []
        self._geoms: list[Any] = []
        for body in scene.bodies:
            self._add_body(body)
        self._add_exclusions()
        self._add_pairs()
        self._add_loops()

    def _add_body(self, body: Body) -> None:
        parent = self.spec.worldbody if body.parent is None else self.bodies[body.parent.index]
        position, rotation = body.frame
        element = parent.add_body(name=f"b{body.index}", pos=position, quat=frames.wxyz(rotation))
        self.bodies.append(element)
        if body.is_free:
            self.free_joints[body] = element.add_freejoint()
        for at, joint in enumerate(body.joints):
            self.joints[joint] = self._add_joint(element, joint, f"b{body.index}.{at}")
        for geometry in body.geometries:
            self._add_geometry(element, body, geometry)
        if body.inertias:
            # One inertia for all: fixed bodies for those that are stated would make contacts softer, the
            # farther from the origin of the world a body is.
            _set_inertia(element, combined([inertial for _, inertial in body.inertias]))
        elif body.joints or body.is_free:
            _set_inertia(element, KINEMATIC)
            element.gravcomp = 1.0  # a solid without physics has no weight in Webots

    def _add_joint(self, element: Any, joint: Joint, name: str) -> Any:
        kinds = {
            "hinge": mj.mjtJoint.mjJNT_HINGE,
            "slide": mj.mjtJoint.mjJNT_SLIDE,
            "ball": mj.mjtJoint.mjJNT_BALL,
        }
        added = element.add_joint(name=name, type=kinds[joint.kind], pos=joint.anchor)
        if joint.kind != "ball":
            added.axis = joint.axis
            added.ref = joint.position  # the position of the joint in the pose that the file has
        low, high = joint.limits
        if low < high:
            added.limited = 1
            added.range = [low, high]
            added.solref_limit = [self.contact_time, 1.0]
        added.stiffness, added.damping = [joint.stiffness, 0.0, 0.0], [joint.damping, 0.0, 0.0]
        added.frictionloss = joint.friction
        if joint.motor is not None:
            added.solimp_friction = MOTOR_IMPEDANCE
        return added

    def _add_geometry(self, element: Any, body: Body, geometry: Geometry) -> None:
        friction = self.scene.contact(geometry.material, geometry.material)
        added = element.add_geom(
            **geom_fields(self.spec, geometry.shape, geometry.frame, f"shape{len(self._geoms)}"),
            mass=0.0,
            friction=_friction(friction),
            condim=_condim(friction),
            solref=[self.contact_time, 1.0],
            solimp=CONTACT_IMPEDANCE,
        )
        self._geoms.append(added)
        self.geometries.append((body, geometry))

    def geometries_by_id(self) -> list[tuple[Body, Geometry]]:
        """Return the geometries in the order of their numbers in the compiled model."""
        owners = {int(added.id): owner for added, owner in zip(self._geoms, self.geometries, strict=True)}
        return [owners[number] for number in sorted(owners)]

    def _add_exclusions(self) -> None:
        """Let the parts of a robot pass through each other, unless it says `selfCollision TRUE`."""
        for robot in self.scene.robots:
            if boolean(robot.node, "selfCollision"):
                continue
            bodies = [body for body in self.scene.bodies if body.robot is robot and body.geometries]
            for at, body in enumerate(bodies):
                for other_body in bodies[at + 1 :]:
                    self.spec.add_exclude(bodyname1=f"b{body.index}", bodyname2=f"b{other_body.index}")

    def _add_loops(self) -> None:
        for loop in self.scene.loops:
            self.spec.add_equality(
                type=mj.mjtEq.mjEQ_WELD,
                objtype=mj.mjtObj.mjOBJ_BODY,
                name1=f"b{loop.end.index}",
                name2="world" if loop.other is None else f"b{loop.other.index}",
                data=[*[0.0] * 10, 1.0, 0.0],  # in their pose at the start; torques count as forces at 1 m
                solref=[self.contact_time, 1.0],
                solimp=MOTOR_IMPEDANCE,  # that of contacts lets a rod of 1 m sag by 2 mm
            )

    def _add_pairs(self) -> None:
        """Give pairs of materials their friction, where it is not the larger one of the two."""
        contact = self.scene.contact
        for (at, (body, first)), (other_at, (other_body, second)) in combinations(
            enumerate(self.geometries), 2
        ):
            if first.material == second.material or not _may_touch(body, other_body):
                continue
            own = [contact(name, name) for name in (first.material, second.material)]
            pair_contact = contact(first.material, second.material)
            usual = [max(pair) for pair in zip(*map(_friction, own), strict=True)]
            if (usual, max(map(_condim, own))) != (_friction(pair_contact), _condim(pair_contact)):
                self._add_pair(at, other_at, pair_contact)

    def _add_pair(self, first: int, second: int, contact: Contact) -> None:
        for index in (first, second):
            self._geoms[index].name = f"g{index}"
        slide, spin, roll = _friction(contact)
        self.spec.add_pair(
            geomname1=f"g{first}",
            geomname2=f"g{second}",
            condim=_condim(contact),
            friction=[slide, slide, spin, roll, roll],
            solref=[self.contact_time, 1.0],
            solimp=CONTACT_IMPEDANCE,
        )


def geom_fields(spec: Any, shape: Shape, frame: Frame, name: str, *, is_seen: bool = False) -> dict[str, Any]:
    """Return the keywords of `add_geom` for a shape, and add the asset of a grid or a mesh to the model.

    Args:
        spec: The specification of the model.
        frame: The frame of the shape in its body.
        name: The name of an asset.
        is_seen: Whether the shape is seen, and does not collide: a plane has an end, and a mesh no volume.
    """
    types = mj.mjtGeom
    fields: dict[str, Any] = {"type": types.mjGEOM_MESH, "meshname": name}
    match shape:
        case Box(size):
            fields = {"type": types.mjGEOM_BOX, "size": [side / 2 for side in size]}
        case Sphere(radius):
            fields = {"type": types.mjGEOM_SPHERE, "size": [radius, 0.0, 0.0]}
        case Cylinder(radius, height) | Capsule(radius, height):
            kind = types.mjGEOM_CYLINDER if isinstance(shape, Cylinder) else types.mjGEOM_CAPSULE
            fields = {"type": kind, "size": [radius, height / 2, 0.0]}
        case Plane(extent):
            # A plane collides without end in Webots, whatever its size, as one of size 0 does in MuJoCo.
            x, y = (*extent, 1.0, 1.0)[:2] if is_seen else (0.0, 0.0)
            fields = {"type": types.mjGEOM_PLANE, "size": [x / 2, y / 2, 1.0]}
        case Grid():
            rise = max(float(np.ptp(shape.heights)), 1e-6)
            spec.add_hfield(
                name=name,
                size=[shape.size[0] / 2, shape.size[1] / 2, rise, GRID_DEPTH_M],
                nrow=shape.heights.shape[0],
                ncol=shape.heights.shape[1],
                userdata=((shape.heights - shape.heights.min()) / rise).ravel().tolist(),
            )
            fields = {"type": types.mjGEOM_HFIELD, "hfieldname": name}
            # A grid begins at its origin in Webots, and has its middle there in MuJoCo.
            middle = (shape.size[0] / 2, shape.size[1] / 2, float(shape.heights.min()))
            frame = compose(frame, (middle, frames.IDENTITY_ROTATION))
        case Mesh(vertices, faces):
            mesh = spec.add_mesh(name=name)
            mesh.uservert, mesh.userface = vertices.ravel(), faces.ravel()
            kinds = mj.mjtMeshInertia
            mesh.inertia = kinds.mjMESH_INERTIA_SHELL if is_seen else kinds.mjMESH_INERTIA_CONVEX
    return fields | {"pos": frame[0], "quat": frames.wxyz(frame[1])}


def _set_inertia(element: Any, inertial: Inertial) -> None:
    """Give a body a mass and an inertia."""
    tensor = np.array(rotate_tensor(inertial.matrix, rotation_matrix(inertial.origin.rpy)))
    element.explicitinertial = 1
    element.mass, element.ipos = inertial.mass, inertial.origin.xyz
    element.fullinertia = tensor[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]


def _may_touch(first: Body, second: Body) -> bool:
    shares_robot = first.robot is not None and first.robot is second.robot
    moves = first.is_free or first.joints or second.is_free or second.joints
    return first is not second and not shares_robot and bool(moves)


def _friction(contact: Contact) -> list[float]:
    rolling, _, spinning = contact.rolling
    # 1e-5 is mjMINMU, MuJoCo's least coefficient.
    return [max(contact.friction, 1e-5), max(spinning, 1e-5), max(rolling, 1e-5)]


def _condim(contact: Contact) -> int:
    return 6 if any(contact.rolling) else 3
