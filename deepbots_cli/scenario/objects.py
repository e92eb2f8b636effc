"""Bodies that are no robots: boxes, balls, cylinders, meshes, and groups of them."""

from __future__ import annotations

from typing import Annotated

from deepbots_cli.scenario.fields import Quantity, Scalar
from deepbots_cli.scenario.part import Kinds, Part, Size, field
from deepbots_cli.scenario.pose import Pose
from deepbots_cli.scenario.quantity import (
    DrawnCount,
    DrawnFactor,
    DrawnMass,
    DrawnShare,
    Extent,
    LocalName,
    MeshFile,
    OnOff,
    Paint,
    Prose,
    Thickness,
)


class Material(Part):
    """What a body is made of; in `one_of`, a variant overrides it."""

    mass: DrawnMass | None = field(
        default=None, description="Mass, kg; by default as much as water has in this shape. A mesh that can move needs one."
    )
    colour: Paint | None = field(default=None, description="Colour: a word, `'#rrggbb'`, or `choice(red | green)`.")
    friction: DrawnFactor | None = field(default=None, description="Coulomb's coefficient of friction.")
    spinning_friction: DrawnFactor | None = field(default=None, description="Friction against spinning on the spot.")
    rolling_friction: DrawnFactor | None = field(default=None, description="Friction against rolling.")
    restitution: DrawnShare | None = field(default=None, description="Share of the speed that a bounce keeps, 0 to 1.")
    fixed: OnOff | None = field(default=None, description="Whether it never moves; by default false.")
    solid: OnOff | None = field(default=None, description="Whether things bump into it; `false` makes a mark that is only seen.")


class Shaped(Material):
    """A body of one shape."""

    shape: Prose = field(description="The shape of the body.")


class Box(Shaped):
    """A box."""

    size: Extent = field(description="Lengths along x, y and z, such as `10 10 10 cm`.")


class Sphere(Shaped):
    """A ball."""

    radius: Thickness = field(description="Radius, m.")


class Cylinder(Shaped):
    """A cylinder along z."""

    radius: Thickness = field(description="Radius, m.")
    height: Thickness = field(description="Height, m.")


class Capsule(Shaped):
    """A cylinder along z with half a ball on either end."""

    radius: Thickness = field(description="Radius, m.")
    height: Thickness = field(description="Height of the cylinder between the half balls, m.")


class Mesh(Shaped):
    """A body from a mesh file."""

    file: MeshFile = field(description="The mesh.")
    scale: Annotated[Scalar, Quantity("number", components=3)] | None = field(default=None, description="Factors along x, y and z.")


SHAPES: dict[str, type[Shaped]] = {"box": Box, "sphere": Sphere, "cylinder": Cylinder, "capsule": Capsule, "mesh": Mesh}


class Placed(Part):
    """What an object has besides its shape."""

    pose: Pose = field(default=Pose(), description="Where it stands unless `reset` places it.")
    count: DrawnCount = field(default=1, description="How many copies there are; the name then names a group.")


class BoxObject(Placed, Box):
    """A box in the world."""


class SphereObject(Placed, Sphere):
    """A ball in the world."""


class CylinderObject(Placed, Cylinder):
    """A cylinder in the world."""


class CapsuleObject(Placed, Capsule):
    """A capsule in the world."""


class MeshObject(Placed, Mesh):
    """A mesh in the world."""


class VariedObject(Placed, Material):
    """Copies of different shapes: each is drawn from the variants."""

    one_of: Annotated[dict[LocalName, Annotated[Shaped, Kinds("shape", tuple(SHAPES), SHAPES.__getitem__)]], Size(1, "variant")] = field(
        description="The variants that each copy is drawn from, by names of your choice."
    )


OBJECTS: dict[str, type[Placed]] = {
    "box": BoxObject,
    "sphere": SphereObject,
    "cylinder": CylinderObject,
    "capsule": CapsuleObject,
    "mesh": MeshObject,
}
AnyObject = Annotated[Placed, Kinds("shape", tuple(OBJECTS), OBJECTS.__getitem__, marked=(("one_of", VariedObject),))]
