"""Kinds of bodies other than robots."""

from typing import Annotated, Literal

from deepbots_cli.scenario.base import Kinds, Section, Size
from deepbots_cli.scenario.fields import Bool, Color, LocalName, MeshFile, PlainText, Scalar
from deepbots_cli.scenario.quantities import Quantity, RandomizableFactor, RandomizableShare, Scale, Thickness
from deepbots_cli.scenario.world import PlacedBody


class Material(Section):
    """Material of a body; a variant of `one_of` overrides it."""

    mass: Annotated[Scalar, Quantity("mass", known="episode", minimum=0, exclusive=True)] | None = None
    """Mass, kg. By default, the mass of a body of this shape with the density of water. A mesh that can move
    requires a mass."""
    color: Color | None = None
    """Color: a word, `'#rrggbb'`, or `choice(red | green)`."""
    friction: RandomizableFactor | None = None
    """Coulomb's coefficient of friction."""
    spinning_friction: RandomizableFactor | None = None
    """Friction against spinning on the spot, in m, written as a plain number. Times the normal force, and the
    `friction` of the other body, it is the largest torque."""
    rolling_friction: RandomizableFactor | None = None
    """Friction against rolling, in m, written as a plain number. Times the normal force, and the `friction`
    of the other body, it is the largest torque."""
    restitution: RandomizableShare | None = None
    """Fraction of the speed that remains after a bounce, 0 to 1."""
    fixed: Bool | None = None
    """Whether the body is fixed to the world; by default `false`."""
    solid: Bool | None = None
    """Whether the body collides; by default `true`. `false` makes a marker without collisions."""


class ShapedBody(Material):
    """A body of one shape."""

    shape: PlainText
    """The shape of the body."""


class Box(ShapedBody):
    """A box."""

    shape: Literal["box"]
    size: Annotated[Scalar, Quantity("length", components=3, minimum=1e-4)]
    """Lengths along x, y and z, such as `10 10 10 cm`."""


class Sphere(ShapedBody):
    """A ball."""

    shape: Literal["sphere"]
    radius: Thickness
    """Radius, m."""


class Cylinder(ShapedBody):
    """A cylinder along z."""

    shape: Literal["cylinder"]
    radius: Thickness
    """Radius, m."""
    height: Thickness
    """Height, m."""


class Capsule(ShapedBody):
    """A cylinder along z with a hemisphere on each end."""

    shape: Literal["capsule"]
    radius: Thickness
    """Radius, m."""
    height: Thickness
    """Height of the cylinder between the hemispheres, m."""


class Mesh(ShapedBody):
    """A body from a mesh file."""

    shape: Literal["mesh"]
    file: MeshFile
    """The mesh file."""
    scale: Scale | None = None
    """Scale factors along x, y and z."""


SHAPES: dict[str, type[ShapedBody]] = {
    "box": Box,
    "sphere": Sphere,
    "cylinder": Cylinder,
    "capsule": Capsule,
    "mesh": Mesh,
}


class BoxObject(PlacedBody, Box):
    """A box in the world."""


class SphereObject(PlacedBody, Sphere):
    """A ball in the world."""


class CylinderObject(PlacedBody, Cylinder):
    """A cylinder in the world."""


class CapsuleObject(PlacedBody, Capsule):
    """A capsule in the world."""


class MeshObject(PlacedBody, Mesh):
    """A mesh in the world."""


class VariedObject(PlacedBody, Material):
    """Copies of different shapes, which are drawn from variants."""

    one_of: Annotated[dict[LocalName, Annotated[ShapedBody, Kinds("shape", SHAPES)]], Size(1, "variant")]
    """Variants, each under a name that you choose; deepbots draws one of them for each copy."""


OBJECTS: dict[str, type[PlacedBody]] = {
    "box": BoxObject,
    "sphere": SphereObject,
    "cylinder": CylinderObject,
    "capsule": CapsuleObject,
    "mesh": MeshObject,
}
OBJECTS_BY_KEY: dict[str, type[PlacedBody]] = {"one_of": VariedObject}
"""Objects without a `shape`, by the key that they have."""
