"""Wrong units of a robot file: millimeters, grams, g mm^2, and inertias that were never filled in.

Two numbers of a link hardly depend on its material: its mass over the volume of the box around its shapes,
from 1 to 30,000 kg/m^3, and the trace of its inertia over that of a box of its mass and extent, from 0.01 to
3 (all mass at the corners). Of 173 published robot files, two others than those with placeholders have a
finding: their parts are denser than any metal.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from itertools import product
from pathlib import Path

from deepbots_cli import frames
from deepbots_cli.records import dataclass
from deepbots_cli.robots.kinematics import (
    bounds_of_shape,
    box_around,
    box_sides,
    robot_bounds,
    without_meshes,
)
from deepbots_cli.robots.meshes import Bounds, scaled_box
from deepbots_cli.robots.model import Geometry, Inertial, Link, Mesh, RobotModel

MeshBoxes = Mapping[tuple[str, str], Bounds]
"""The box around each mesh of a robot in its own units, by the suffix of the file and its digest."""

_MIN_SHARE = 0.02
"""The share of the mass of its robot from which a link is judged: published files give markers and frames any
inertia."""
_MAX_DENSITY = 3e4
"""The density (kg/m^3) of the box around a link from which its mass is in grams; osmium has 22,600."""
_MAX_DENSITY_OF_GRAMS = 3e7
"""The density from which the lengths are too small: that of metal in grams is less."""
_MIN_DENSITY, _MIN_LARGE_LINK_M = 3e-3, 3.0
"""The density of the box, and its diagonal (m), of a link in millimeters; a toy balloon has 0.2."""
_USUAL_DENSITY = 500.0
"""The density of the box around a link, kg/m^3."""
_MIN_CONSISTENT_INERTIA = 0.01
"""The inertia over that of a box from which lengths and inertia are of one system."""
_MIN_MILLIMETERS = 316.0
"""The factor of lengths from which they are in millimeters, not in centimeters."""
_MIN_ROBOT_DENSITY, _MIN_LARGE_ROBOT_M = 1e-5, 10.0
"""The mass (kg) of a robot for each cube of its length, and its length (m), if joints are in millimeters; a
drone of 0.5 m and 1 kg has 8, an arm of 0.75 m and 3.5 kg too."""
_MIN_PLACEHOLDER = 5.0
_MIN_WRONG_INERTIA, _MAX_ROUND_INERTIA = 300.0, 1e5
"""The inertia over that of a box: the least of an identity that is a placeholder, the least of a wrong unit,
and what round numbers of published robots do not reach."""
_MIN_SIZE_RATIO, _MAX_SIZE_RATIO = 200.0, 5000.0
"""The size of a visual over that of the collision shapes of its link, if one of them is in millimeters."""
_INERTIA_UNITS = {1e3: "g*m^2", 1e4: "kg*cm^2", 1e6: "kg*mm^2", 1e7: "g*cm^2", 1e9: "g*mm^2"}
_USUAL_INERTIA = 0.5
"""The inertia of a link over that of the box around it; the middle of published robots."""
_MAX_NAMES = 5


@dataclass(frozen=True)
class UnitFault:
    """A quantity of some links in a wrong unit: `factor` is by how much the numbers are too large, None for a
    placeholder. `element` is the path of the XML element in the first of the links."""

    code: str
    element: tuple[str, ...]
    links: tuple[str, ...]
    factor: float | None
    headline: str
    help: str


def unit_faults(model: RobotModel, boxes: MeshBoxes) -> Iterator[UnitFault]:
    """Yield the faults of a robot, one of each kind."""
    parts = [_Part(model, link, boxes) for link in model.links]
    judged = [part for part in parts if part.box is not None and part.mass > _MIN_SHARE * model.mass]
    long = [
        part
        for part in judged
        if part.mass < _MIN_DENSITY * part.volume and part.diagonal > _MIN_LARGE_LINK_M
    ]
    mismatched = [part for part in parts if _MIN_SIZE_RATIO < part.size_ratio < _MAX_SIZE_RATIO]
    size = max(box_sides(robot_bounds(without_meshes(model))))
    if mismatched:
        for element in ("visual", "collision"):
            if faulty := [part for part in mismatched if part.faulty_element == element]:
                yield _mismatch(element, faulty)
    elif long:
        yield _lengths(long)
    elif size >= _MIN_LARGE_ROBOT_M and 0.0 < model.mass < _MIN_ROBOT_DENSITY * size**3:
        yield _spread(model, size)
    else:
        heavy = [part for part in judged if part.mass > _MAX_DENSITY * part.volume > 0.0]
        tiny = [part for part in heavy if part.mass > _MAX_DENSITY_OF_GRAMS * part.volume]
        if tiny:
            yield _tiny(tiny)
            return
        if heavy:
            yield _masses(heavy)
        ratios = [(part, part.inertia_ratio * (1e3 if part in heavy else 1.0)) for part in judged]
        unfilled = [part for part, ratio in ratios if part.is_identity and ratio > _MIN_PLACEHOLDER]
        if unfilled:
            yield _placeholder(unfilled)
        wrong = [(part, ratio) for part, ratio in ratios if ratio > part.max_inertia_ratio]
        if wrong:
            yield _inertias(wrong)


# Measures


class _Part:
    """The measures of a link, in m and kg: the boxes around its visuals and its collision shapes, the
    diagonal of the box around them, its origin, its center of mass and its child joints."""

    def __init__(self, model: RobotModel, link: Link, boxes: MeshBoxes) -> None:
        self.name = link.name
        self.mass = link.mass
        self.inertial = link.inertial or Inertial(0.0)
        self.visual, self.collision = (_box(pieces, boxes) for pieces in (link.visuals, link.collisions))
        shapes = [box for box in (self.visual, self.collision) if box is not None]
        self.box = box_around(shapes) if shapes else None
        ends = [joint.origin.xyz for joint in model.joints if joint.parent == link.name]
        points = [(point, point) for point in ((0.0, 0.0, 0.0), self.inertial.origin.xyz, *ends)]
        self.extent = math.dist(*box_around([*shapes, *points]))

    @property
    def diagonal(self) -> float:
        return math.dist(*self.box) if self.box else 0.0

    @property
    def volume(self) -> float:
        """The volume of the box around all shapes, m^3."""
        return math.prod(box_sides(self.box)) if self.box else 0.0

    @property
    def inertia_ratio(self) -> float:
        """The trace of the inertia over that of a box of this mass and diagonal, m extent^2 / 6."""
        inertial = self.inertial
        usual = self.mass * self.extent**2 / 6
        return (inertial.ixx + inertial.iyy + inertial.izz) / usual if usual > 0.0 else 0.0

    @property
    def size_ratio(self) -> float:
        """The size of the larger of the visuals and the collision shapes over the other; 1 without one."""
        sizes = [math.dist(*box) for box in (self.visual, self.collision) if box is not None]
        return max(sizes) / min(sizes) if len(sizes) == 2 and min(sizes) > 0.0 else 1.0

    @property
    def faulty_element(self) -> str:
        """The element with the wrong size, `visual` or `collision`: without it, the density of the link is
        nearer to the usual one. The larger one where the link has no mass."""
        elements = {"visual": self.visual, "collision": self.collision}
        volumes = {name: math.prod(box_sides(box)) for name, box in elements.items() if box is not None}
        if self.mass <= 0.0 or min(volumes.values()) <= 0.0:
            return max(volumes, key=lambda name: volumes[name])
        return max(volumes, key=lambda name: abs(math.log(self.mass / volumes[name] / _USUAL_DENSITY)))

    @property
    def is_identity(self) -> bool:
        return self.inertial.matrix == frames.diagonal((1.0, 1.0, 1.0))

    @property
    def max_inertia_ratio(self) -> float:
        """The inertia ratio that need not be a wrong unit. A round number about each axis, such as 0.1, may
        be far off: nobody has measured it."""
        moment = self.inertial.ixx
        is_same = self.inertial.matrix == frames.diagonal((moment,) * 3)
        if self.is_identity:
            return math.inf
        return _MAX_ROUND_INERTIA if is_same and float(f"{moment:.0e}") == moment else _MIN_WRONG_INERTIA


def _box(shapes: Sequence[Geometry], boxes: MeshBoxes) -> Bounds | None:
    """Return the box around shapes in the frame of their link; None without any."""
    bounds = []
    for part in shapes:
        frame = frames.frame(part.origin)
        if isinstance(part.shape, Mesh):
            own = boxes.get((Path(part.shape.path).suffix.lower(), part.shape.digest))
            if own is not None:
                axes = zip(*scaled_box(own, part.shape.scale), strict=True)
                corners = [
                    frames.add(frame[0], frames.rotate(frame[1], (x, y, z))) for x, y, z in product(*axes)
                ]
                bounds += [(corner, corner) for corner in corners]
        else:
            bounds.append(bounds_of_shape(part.shape, frame))
    return box_around(bounds) if bounds else None


# Findings


def _named(parts: Sequence[_Part]) -> str:
    names = ", ".join(f"'{part.name}'" for part in parts[:_MAX_NAMES])
    more = f" and {len(parts) - _MAX_NAMES} more" if len(parts) > _MAX_NAMES else ""
    return f"{'link' if len(parts) == 1 else 'links'} {names}{more}"


def _lengths(parts: Sequence[_Part]) -> UnitFault:
    """Return a fault of lengths. An inertia that fits to them is in a system of millimeters; else the density
    says the unit."""
    largest = max(parts, key=lambda part: part.diagonal)
    ratio = (_USUAL_DENSITY * largest.volume / largest.mass) ** (1 / 3)
    is_centimeters = largest.inertia_ratio < _MIN_CONSISTENT_INERTIA and ratio < _MIN_MILLIMETERS
    unit, factor = ("centimeters", 100.0) if is_centimeters else ("millimeters", 1000.0)
    return _fault(
        "DB507",
        (),
        parts,
        factor,
        f"the shapes of {_named(parts)} are up to {largest.diagonal:.3g} m long, and the masses are"
        f" those of small parts: the lengths are probably in {unit}, {factor:g} times too large",
        _in_meters(factor),
    )


def _mismatch(element: str, parts: Sequence[_Part]) -> UnitFault:
    first = parts[0]
    visual, collision = (math.dist(*box) if box else 0.0 for box in (first.visual, first.collision))
    is_larger = (visual > collision) == (element == "visual")
    other = "collision" if element == "visual" else "visual"
    compared = f"{first.size_ratio:,.0f} times as {'large' if is_larger else 'small'} as the <{other}>"
    return _fault(
        "DB507",
        (element,),
        parts,
        1e3 if is_larger else 1e-3,
        f"the <{element}> of {_named(parts)} is {compared}: it is probably "
        + ("in millimeters, 1000 times too large" if is_larger else "1000 times too small"),
        f'write scale="0.001 0.001 0.001" at the mesh of the <{element}>, or its lengths in meters'
        if is_larger
        else f'remove scale="0.001 0.001 0.001" at the mesh of the <{element}>, or write lengths in meters',
    )


def _spread(model: RobotModel, size: float) -> UnitFault:
    headline = (
        f"the robot is {size:.4g} m long and has a mass of {model.mass:.4g} kg: its lengths are probably in"
        " millimeters, 1000 times too large"
    )
    return UnitFault("DB507", (), (model.root,), 1e3, headline, _in_meters(1e3))


def _in_meters(factor: float) -> str:
    scale = " ".join([f"{1 / factor:g}"] * 3)
    return f'divide the lengths of the robot file by {factor:g}, and write scale="{scale}" at its meshes'


def _tiny(parts: Sequence[_Part]) -> UnitFault:
    return _fault(
        "DB507",
        (),
        parts,
        1e-3,
        f"the shapes of {_named(parts)} are only {parts[0].diagonal:.2g} m long for"
        f" {parts[0].mass:.3g} kg: their lengths are"
        " probably 1000 times too small",
        'remove scale="0.001 0.001 0.001" at a mesh that is in meters already',
    )


def _masses(parts: Sequence[_Part]) -> UnitFault:
    density = parts[0].mass / parts[0].volume
    return _fault(
        "DB507",
        ("inertial", "mass"),
        parts,
        1e3,
        f"the mass of {_named(parts)} gives a density of {density:.2g} kg/m^3, more than any metal:"
        " it is probably in grams, 1000 times too large",
        "write masses in kilograms: divide them by 1000",
    )


def _placeholder(parts: Sequence[_Part]) -> UnitFault:
    return _fault(
        "DB306",
        ("inertial", "inertia"),
        parts,
        None,
        f"the inertia of {_named(parts)} is 1 kg*m^2 about each axis, a placeholder: no body of this"
        " mass and size has it",
        "compute it from the shape: for a box, ixx = m (y^2 + z^2) / 12",
    )


def _inertias(wrong: Sequence[tuple[_Part, float]]) -> UnitFault:
    parts = [part for part, _ in wrong]
    ratio = math.exp(sum(math.log(ratio) for _, ratio in wrong) / len(wrong))
    factor = min(_INERTIA_UNITS, key=lambda unit: abs(math.log(ratio / _USUAL_INERTIA / unit)))
    rounded = float(f"{ratio:.0e}")
    return _fault(
        "DB306",
        ("inertial", "inertia"),
        parts,
        factor,
        f"the inertia of {_named(parts)} is about {rounded:,.0f} times that of a box of this"
        f" mass and size: it is probably in {_INERTIA_UNITS[factor]}, {factor:,.0f} times too large",
        f"write inertias in kg*m^2: divide them by {factor:,.0f}",
    )


def _fault(
    code: str,
    element: tuple[str, ...],
    parts: Sequence[_Part],
    factor: float | None,
    headline: str,
    help: str,
) -> UnitFault:
    return UnitFault(code, element, tuple(part.name for part in parts), factor, headline, help)
