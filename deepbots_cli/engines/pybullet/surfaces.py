"""What is touched and seen: contacts and their forces, distances between surfaces, free distances of rays
from a link, lines of sight, and pictures.

PyBullet's software renderer draws bodies, and this module draws floor and sky. A software renderer shades a
floor pixel by pixel (22 ms of a 30 ms picture of 480 x 320, measured), although it looks the same in every
picture of one view.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from functools import partial
from math import ceil, hypot, inf, sqrt, tan
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from deepbots_cli import frames
from deepbots_cli.engines.pybullet import BASE_LINK, state
from deepbots_cli.engines.pybullet import pybullet as p
from deepbots_cli.errors import EngineError
from deepbots_cli.frames import add, cross, rotate, scaled, subtract
from deepbots_cli.port import CAMERA_RANGE_M, CameraImage
from deepbots_cli.program.world import ARENA_WALLS
from deepbots_cli.robots.model import Box, Capsule, Cylinder, Sphere

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from deepbots_cli.engines.pybullet.state import Body, ReadCache
    from deepbots_cli.frames import Frame, Triple
    from deepbots_cli.port import (
        ClearanceReader,
        ContactReader,
        ForceReader,
        Image,
        PoseReader,
        RayReader,
        VectorReader,
        View,
    )
    from deepbots_cli.program.world import Line

    FloatArray = NDArray[np.float32]
    Color = tuple[float, float, float, float]


# Contacts and gaps

ANY_LINK = -2  # PyBullet's number for all links of a body
MAX_CLEARANCE_M = 1e6  # m; larger distances between surfaces are not computed
MAX_LINK_QUERIES = 2  # links; from three on one query for all links costs less than one for each
ContactQuery = Callable[[], Any]
LinkKey = tuple[int, int]
"""The number of a body and that of a link, or `ANY_LINK`."""


@dataclass(eq=False, slots=True)
class ContactFlag:
    """Whether a link (or `ANY_LINK`) touched something that `is_other` names by body and link, since the last
    `forget`."""

    link: int
    is_other: Callable[[int, int], bool]
    touched: bool = False

    def read(self) -> bool:
        return self.touched


class ContactMonitor:
    """Checks the contacts of the links of one body after every engine step, until every reader has its answer
    before the next `reset`.

    It makes one query for the whole body, or one for each link without an answer if these are few: a robot
    that stands on four feet, and must not touch the ground otherwise, costs 2.2 us in the first engine step
    and 0.7 in each further one.
    """

    def __init__(self, client: int, body: Body) -> None:
        self._body = body
        self._client = client
        self._flags: list[ContactFlag] = []
        self._open_flags: list[ContactFlag] = []
        self._first_queries: list[ContactQuery] = []
        """The queries with which a step begins."""
        self._queries: list[ContactQuery] = []

    def reset(self) -> None:
        for mark in self._flags:
            mark.touched = False
        self._open_flags = self._flags
        self._queries = self._first_queries

    def update(self) -> None:
        """Query contacts. A pair is listed while it is near; it touches if its surfaces overlap, or if a
        force kept them from it."""
        learned = False
        for query in self._queries:
            for point in query():
                if point[9] > 0.0 or point[8] <= 0.0:  # 9 is the normal force, 8 the distance
                    other_body, link, other_link = point[2:5]
                    for mark in self._open_flags:
                        if (mark.link == link or mark.link == ANY_LINK) and mark.is_other(
                            other_body, other_link
                        ):
                            mark.touched = learned = True
        if learned:
            self._open_flags = [mark for mark in self._open_flags if not mark.touched]
            self._queries = self._queries_for(self._open_flags)

    def _queries_for(self, marks: Sequence[ContactFlag]) -> list[ContactQuery]:
        links = {mark.link for mark in marks}
        if ANY_LINK in links or len(links) > MAX_LINK_QUERIES:
            links = {ANY_LINK}
        return [_contact_points(self._client, self._body, link) for link in sorted(links)]

    def _flag(self, link: int, accepts: Callable[[int, int], bool]) -> ContactReader:
        mark = ContactFlag(link, accepts)
        self._flags.append(mark)
        self._first_queries = self._queries_for(self._flags)
        self.reset()
        return mark.read

    def touches_any_of(self, link: int, link_keys: Collection[LinkKey]) -> ContactReader:
        """Return whether the link touched one of `link_keys`."""
        keys = frozenset(link_keys)
        return self._flag(
            link,
            lambda other_body, other_link: (other_body, other_link) in keys or (other_body, ANY_LINK) in keys,
        )

    def touches_any_but(self, link: int, without: Collection[int]) -> ContactReader:
        """Return whether the link touched anything but the bodies `without`."""
        left_out = frozenset(without)
        return self._flag(link, lambda other_body, other_link: other_body not in left_out)


def penetrations(client: int) -> dict[tuple[LinkKey, LinkKey], float]:
    """Return the depths (m) of links of two bodies within each other in the present state; only pairs that
    overlap."""
    p.performCollisionDetection(client)
    depths: dict[tuple[LinkKey, LinkKey], float] = {}
    for point in p.getContactPoints(physicsClientId=client):
        _, body, other_body, link, other_link = point[:5]
        pair = ((body, link), (other_body, other_link))
        if point[8] < 0.0:
            depths[pair] = max(depths.get(pair, 0.0), -point[8])
    return depths


def _contact_points(client: int, body: Body, link: int) -> ContactQuery:
    """Return a reader of the contact points of a link, with the body itself as the first body of each; a
    point between two of its links is listed from either side."""
    read = partial(p.getContactPoints, body.number, -1, link, ANY_LINK, client)
    if not body.own_pairs:
        return read
    read_own = partial(p.getContactPoints, body.number, body.number, ANY_LINK, link, client)
    return lambda: [*read(), *map(_from_other_side, read_own())]


def _from_other_side(point: Any) -> tuple[Any, ...]:
    flag, body, other_body, link, other_link, position, other_position, normal, distance, force = point[:10]
    first, along, second, across = point[10:14]
    normal, along, across = (frames.scaled(axis, -1.0) for axis in (normal, along, across))
    ends = (other_body, body, other_link, link, other_position, position)
    return (flag, *ends, normal, distance, force, first, along, second, across)


class ForceMonitor:
    """Adds up the contact forces on a link (or `ANY_LINK`) over the engine steps since the last `reset`."""

    def __init__(self, client: int, body: Body, link: int) -> None:
        self._client, self._key = client, (body.number, link)
        # A contact of two of its links counts once in the sum of normal forces.
        self._of_normals: ContactQuery = (
            partial(p.getContactPoints, body.number, -1, link, ANY_LINK, client)
            if link == ANY_LINK
            else _contact_points(client, body, link)
        )
        self._normals: list[float] = []
        self._vectors: list[Triple] = []
        self._reads_normals = self._reads_vectors = False

    def reset(self) -> None:
        self._normals.clear()
        self._vectors.clear()

    def update(self) -> None:
        if self._reads_normals:
            self._normals.append(sum(point[9] for point in self._of_normals()))
        if self._reads_vectors:
            self._vectors.append(self._force())

    def _force(self) -> Triple:
        """Return the force of other links in the last engine step.

        A query for one body turns the normals of contacts whose second body it is, and not the directions of
        friction. Contacts of all bodies have the force on the first one.
        """
        x = y = z = 0.0
        for point in p.getContactPoints(physicsClientId=self._client):
            is_first = self._has(point[1], point[3])
            if is_first != self._has(point[2], point[4]):
                sign = 1.0 if is_first else -1.0
                for along, size in ((point[7], point[9]), (point[11], point[10]), (point[13], point[12])):
                    force = sign * size
                    x, y, z = x + force * along[0], y + force * along[1], z + force * along[2]
        return x, y, z

    def _has(self, body: int, link: int) -> bool:
        number, own_link = self._key
        return body == number and own_link in (link, ANY_LINK)

    def normal_force(self) -> ForceReader:
        """Return a reader of the mean sum of the normal forces (N)."""
        self._reads_normals = True
        return lambda: sum(self._normals) / len(self._normals) if self._normals else 0.0

    def force_vector(self) -> VectorReader:
        """Return a reader of the mean sum of the contact forces (N, world frame): along the normal, which
        points to the link, and along two directions of friction."""
        self._reads_vectors = True
        return lambda: frames.mean(self._vectors)


def clearance(client: int, first: LinkKey, second: LinkKey) -> ClearanceReader:
    read = partial(
        p.getClosestPoints, first[0], second[0], MAX_CLEARANCE_M, first[1], second[1], physicsClientId=client
    )

    def distance() -> float:
        return max(0.0, min((point[8] for point in read()), default=inf))

    return distance


# Rays

FIRST_GROUP, LAST_GROUP = 6, 30  # bits of a collision group that the library leaves free
MAX_CORRECTION_M = 0.05  # m; farther from PyBullet's answer a closed form has met another surface
SolidShape = Sphere | Cylinder | Capsule | Box


class Rays:
    """Casts rays in one client. The body that casts is in a collision group of its own, which its rays pass
    through."""

    def __init__(self, client: int, bodies: Sequence[Body], read_cache: ReadCache) -> None:
        self._client = client
        self._cache = read_cache
        self._fixed = [body for body in bodies if body.fixed]
        self._free_groups = iter(range(FIRST_GROUP, LAST_GROUP + 1))
        self._surfaces = {
            (body.number, index): surface
            for body in bodies
            for index in body.links.values()
            if (surface := _surface(client, body, index, read_cache)) is not None
        }

    def reader(
        self, body: Body, index: int, rays: Sequence[Frame], reach: float, *, upright: bool = False
    ) -> RayReader:
        if upright:
            return self._level_reader(body, index, rays, reach)
        center, principal = body.dynamics(index).inertia_frame
        back = frames.inverse(principal)
        ends = [frames.add(origin, frames.rotate(rotation, (reach, 0.0, 0.0))) for origin, rotation in rays]
        points = ([origin for origin, _ in rays], ends)
        starts, ends = (
            [frames.rotate(back, frames.subtract(point, center)) for point in group] for group in points
        )
        cast = partial(
            p.rayTestBatch,
            starts,
            ends,
            numThreads=1,
            parentObjectUniqueId=body.number,
            parentLinkIndex=index,
            collisionFilterMask=~self._collision_group_bit(body),
            physicsClientId=self._client,
        )
        refresh = (
            None if index == BASE_LINK else partial(p.getLinkState, body.number, index, 0, 1, self._client)
        )
        pose = state.pose_reader(self._client, body, index, self._cache)
        surfaces = self._surfaces

        def read() -> list[float]:
            # PyBullet mounts rays on the cached pose of a link, which is one engine step old without this.
            if refresh is not None:
                refresh()
            hits = cast()
            free = [hit[2] * reach for hit in hits]
            if surfaces:
                for number, hit in enumerate(hits):
                    if (surface := surfaces.get(hit[:2])) is not None:
                        ray = frames.compose(pose(), rays[number])
                        free[number] = surface.hit_distance(
                            ray[0], frames.rotate(ray[1], (1.0, 0.0, 0.0)), free[number]
                        )
            return free

        return read

    def _level_reader(self, body: Body, index: int, rays: Sequence[Frame], reach: float) -> RayReader:
        """Return a reader of rays that follow the yaw of a link alone, which PyBullet cannot mount on it."""
        ends = [frames.add(origin, frames.rotate(rotation, (reach, 0.0, 0.0))) for origin, rotation in rays]
        points = [origin for origin, _ in rays], ends
        pose = state.pose_reader(self._client, body, index, self._cache)
        mask = ~self._collision_group_bit(body)

        def read() -> list[float]:
            position, rotation = pose()
            level = (position, frames.yaw_only(rotation))
            starts, stops = (
                [frames.compose(level, (point, frames.IDENTITY_ROTATION))[0] for point in group]
                for group in points
            )
            hits = p.rayTestBatch(
                starts, stops, numThreads=1, collisionFilterMask=mask, physicsClientId=self._client
            )
            return [
                self._free(hit, start, stop, reach)
                for hit, start, stop in zip(hits, starts, stops, strict=True)
            ]

        return read

    def _free(self, hit: Any, start: Triple, stop: Triple, reach: float) -> float:
        """Return the free distance along a ray from its hit; of most shapes in
        closed form."""
        surface = self._surfaces.get(hit[:2])
        if surface is None:
            return float(hit[2] * reach)
        direction = frames.scaled(frames.subtract(stop, start), 1.0 / reach)
        return surface.hit_distance(start, direction, hit[2] * reach)

    def _collision_group_bit(self, body: Body) -> int:
        """Return the bit of a body's own group; its collisions stay the same."""
        if body.group is None:
            group = next(self._free_groups, None)
            if group is None:
                raise EngineError(
                    f"PyBullet supports {LAST_GROUP - FIRST_GROUP + 1} robots with rays, and '{body.name}'"
                    " is one more"
                )
            body.group = 1 << group
            for other in self._fixed if body.fixed else ():
                # Two fixed roots never touch, which PyBullet decides by their common group.
                p.setCollisionFilterPair(
                    body.number, other.number, BASE_LINK, BASE_LINK, 0, physicsClientId=self._client
                )
            body.forget_pairs()
        return body.group


@dataclass(frozen=True)
class Surface:
    """The surface of a link with one simple shape, met in closed form. At a round one, PyBullet's answer is
    off by 1 mm, and by 7 mm where a ray grazes it; at a turned box, by 1.5 mm or more for 1 % of rays."""

    shape: SolidShape
    pose: PoseReader
    origin: Frame

    def hit_distance(self, start: Triple, direction: Triple, expected: float) -> float:
        """Return the distance (m) along a unit direction at which the surface is met from outside, if that is
        close to the answer `expected`."""
        center, rotation = frames.compose(self.pose(), self.origin)
        back = frames.inverse(rotation)
        s, d = frames.rotate(back, frames.subtract(start, center)), frames.rotate(back, direction)
        if isinstance(self.shape, Box):
            met = _box(s, d, self.shape.size)
        elif isinstance(self.shape, Sphere):
            met = _ball(s, d, 0.0, self.shape.radius)
        else:
            r = self.shape.radius
            half = self.shape.length / 2
            met = _first(
                d[0] * d[0] + d[1] * d[1], s[0] * d[0] + s[1] * d[1], s[0] * s[0] + s[1] * s[1] - r * r
            )
            if abs(s[2] + met * d[2]) > half:
                is_flat = isinstance(self.shape, Cylinder)
                met = _disc(s, d, half, r) if is_flat else min(_ball(s, d, half, r), _ball(s, d, -half, r))
        return met if met >= 0.0 and abs(met - expected) < MAX_CORRECTION_M else expected


def _box(s: Triple, d: Triple, size: Triple) -> float:
    """Return the distance to a box about the origin, and infinity beside it."""
    near, far = -inf, inf
    for start, along, side in zip(s, d, size, strict=True):
        if along:
            ends = sorted(((-side / 2 - start) / along, (side / 2 - start) / along))
            near, far = max(near, ends[0]), min(far, ends[1])
        elif abs(start) > side / 2:
            return inf
    return near if near <= far else inf


def _disc(s: Triple, d: Triple, half: float, radius: float) -> float:
    """Return the distance to the end of a cylinder that a ray comes to, and infinity beside it."""
    if d[2] == 0.0:
        return inf
    met = (-half if d[2] > 0.0 else half) / d[2] - s[2] / d[2]
    return met if hypot(s[0] + met * d[0], s[1] + met * d[1]) <= radius else inf


def _ball(s: Triple, d: Triple, height: float, radius: float) -> float:
    z = s[2] - height
    return _first(
        1.0, s[0] * d[0] + s[1] * d[1] + z * d[2], s[0] * s[0] + s[1] * s[1] + z * z - radius * radius
    )


def _first(a: float, b: float, c: float) -> float:
    """Return the lesser root of a t^2 + 2 b t + c, and infinity if there is none."""
    discriminant = b * b - a * c
    return (-b - sqrt(discriminant)) / a if a > 0.0 and discriminant >= 0.0 else inf


def _surface(client: int, body: Body, index: int, read_cache: ReadCache) -> Surface | None:
    """Return the surface of a link that collides with one simple shape and nothing else. PyBullet's answer is
    exact at the walls of an arena, which are never turned."""
    link = body.link(index)
    if len(link.collisions) != 1 or body.name in ARENA_WALLS:
        return None
    geometry = link.collisions[0]
    if not isinstance(geometry.shape, SolidShape):
        return None
    return Surface(
        geometry.shape, state.pose_reader(client, body, index, read_cache), frames.frame(geometry.origin)
    )


# Pictures


TILE_SIZE_M = 0.25
_LIGHT_TILE = np.array([222, 227, 232], np.float32)
_DARK_TILE = np.array([198, 206, 214], np.float32)
_DARK_TILE_SHARE = 0.9  # the brightness of the darker tiles of a floor with a color of its own
# The side of a cell of paint in m, and the number of cells along a side from which on they grow.
_PAINT_CELL_M = 0.002
_MAX_PAINT_CELLS = 2000
_HORIZON_COLOR = np.array([236, 241, 246], np.float32)
_ZENITH_COLOR = np.array([150, 186, 222], np.float32)
_HAZE_DISTANCE_M = 12.0  # m; the distance over which the floor fades into the horizon
NEAR_CLIP_M = 0.01
# m by which the eye is moved ahead. The renderer counts pixels of corners that lie in the plane of the eye,
# as those of a flat side do on whose link the camera sits, beyond the range of its integers, and then goes
# through all of them: minutes a picture.
EYE_OFFSET_M = 1.7e-5


class Floor:
    """Colors of points of the plane z = 0."""

    def __init__(self, color: Color | None, lines: Sequence[Line]) -> None:
        self.default_color = color
        self.color(color)
        self._paint = PaintMap(lines) if lines else None

    def color(self, color: Color | None) -> None:
        """Use tiles of this color, or of two grays for None."""
        self.tiles = color
        self._light = _LIGHT_TILE if color is None else np.array(color[:3], np.float32) * np.float32(255.0)
        self._dark = _DARK_TILE if color is None else self._light * np.float32(_DARK_TILE_SHARE)

    def __call__(self, x: FloatArray, y: FloatArray, across: FloatArray) -> FloatArray:
        """Return colors, shape (n, 3), 0 to 255, seen in pixels `across` m long; tiles too small for a pixel
        melt into their mean."""
        sharp = np.clip(1.5 - across * np.float32(1 / TILE_SIZE_M), 0.0, 1.0)
        numbers = np.floor(x * np.float32(1 / TILE_SIZE_M)) + np.floor(y * np.float32(1 / TILE_SIZE_M))
        # Tiles beyond 500,000 km have no number of 32 bits.
        shade = 0.5 + ((numbers % 2).astype(np.int32) - np.float32(0.5)) * sharp
        colors = self._light + (self._dark - self._light) * shade[:, None]
        return colors if self._paint is None else self._paint.paint(colors, x, y)


class PaintMap:
    """Painted lines as a picture from above: cells of 2 mm, or larger for paint that covers more than 4 m."""

    def __init__(self, lines: Sequence[Line]) -> None:
        edges = [
            (x + s * line.width, y + s * line.width)
            for line in lines
            for x, y in line.points
            for s in (-0.5, 0.5)
        ]
        xs, ys = zip(*edges, strict=True)
        self._corner = min(xs), min(ys)
        size = max(max(xs) - min(xs), max(ys) - min(ys))
        self._cell = max(_PAINT_CELL_M, size / _MAX_PAINT_CELLS)
        shape = tuple(ceil((max(values) - min(values)) / self._cell) + 1 for values in (xs, ys))
        self._cells = np.zeros(shape, np.min_scalar_type(len(lines)))
        self._colors = np.zeros((len(lines) + 1, 3), np.float32)
        for number, line in enumerate(lines, start=1):
            self._colors[number] = np.array(line.color[:3], np.float32) * 255.0
            for start, end in line.pieces:
                self._stroke(start, end, line.width / 2, number)

    def _stroke(self, start: tuple[float, float], end: tuple[float, float], half: float, paint: int) -> None:
        """Paint all cells whose center is within `half` m of a straight piece."""
        spans = []
        for axis in (0, 1):
            ends = sorted((start[axis], end[axis]))
            first = max(int((ends[0] - half - self._corner[axis]) / self._cell), 0)
            last = min(int((ends[1] + half - self._corner[axis]) / self._cell) + 1, self._cells.shape[axis])
            spans.append(slice(first, last))
        x, y = (
            self._corner[axis] + self._cell * (np.arange(span.start, span.stop) + 0.5)
            for axis, span in enumerate(spans)
        )
        dx, dy = end[0] - start[0], end[1] - start[1]
        length = hypot(dx, dy) or 1.0
        ahead = ((x[:, None] - start[0]) * dx + (y[None, :] - start[1]) * dy) / length
        foot = np.clip(ahead, 0.0, length)
        apart = np.hypot(
            x[:, None] - start[0] - foot * dx / length, y[None, :] - start[1] - foot * dy / length
        )
        self._cells[spans[0], spans[1]][apart <= half] = paint

    def paint(self, colors: FloatArray, x: FloatArray, y: FloatArray) -> FloatArray:
        """Return the colors with the paint at points over them."""
        column, row = (
            (values - np.float32(low)) * np.float32(1 / self._cell)
            for values, low in zip((x, y), self._corner, strict=True)
        )
        inside = np.flatnonzero(
            (column >= 0) & (row >= 0) & (column < self._cells.shape[0]) & (row < self._cells.shape[1])
        )
        paints = self._cells[column[inside].astype(np.int32), row[inside].astype(np.int32)]
        painted = inside[paints > 0]
        colors[painted] = self._colors[paints[paints > 0]]
        return colors


def fill_background(
    picture: Image,
    where: NDArray[np.bool_],
    eye: Triple,
    rays: NDArray[np.float32],
    pixel: float,
    floor: Floor | None,
) -> None:
    """Draw the background into the pixels `where` of a picture, in which there is no body.

    `rays` have a length of 1 along the line of sight (world frame), `pixel` is the width of a pixel at a
    distance of 1 m.
    """
    # Rays closer to the horizon would meet the floor so far away that the division loses its meaning.
    down = rays[..., 2] < -1e-6 if floor is not None and eye[2] > 0.0 else np.zeros_like(where)
    sky = where & ~down
    if sky.any():
        x, y, z = rays[sky].T
        picture[sky] = (
            _HORIZON_COLOR
            + (_ZENITH_COLOR - _HORIZON_COLOR)
            * np.clip(2.0 * z / np.sqrt(x * x + y * y + z * z), 0.0, 1.0)[:, None]
        )
    ground = where & down
    if floor is not None and ground.any():
        x, y, z = rays[ground].T
        times = np.float32(-eye[2]) / z
        reach = times * np.sqrt(x * x + y * y + z * z)
        colors = floor(
            np.float32(eye[0]) + x * times,
            np.float32(eye[1]) + y * times,
            np.float32(pixel / eye[2]) * reach * reach,
        )
        picture[ground] = (
            _HORIZON_COLOR
            + (colors - _HORIZON_COLOR) * np.exp(reach * np.float32(-1 / _HAZE_DISTANCE_M))[:, None]
        )


def downsampled(picture: Image, samples: int) -> Image:
    """Return the picture with each block of `samples` x `samples` pixels as one of their mean."""
    if samples == 1:
        return picture
    height, width, _ = picture.shape
    # A sum of slices takes 1 ms for 640 x 480 pixels; a sum over reshaped axes takes 11 ms.
    total = np.zeros((height // samples, width // samples, 3), np.uint16)
    for row in range(samples):
        for column in range(samples):
            total += picture[row::samples, column::samples]
    return np.asarray(total // samples**2, dtype=np.uint8)


def brightened(picture: Image, brightness: float) -> Image:
    """Return the picture in another light; 1 leaves it as it is."""
    return (
        picture
        if brightness == 1.0
        else np.asarray(np.clip(picture * np.float32(brightness), 0.0, 255.0), dtype=np.uint8)
    )


class CameraPose(NamedTuple):
    """The position (m) of a camera, and unit vectors ahead, left and up."""

    eye: Triple
    ahead: Triple
    left: Triple
    up: Triple


def pose_along(frame: Frame) -> CameraPose:
    """Return the pose that looks along the x axis of a frame, z up."""
    ahead, left, up = (rotate(frame[1], axis) for axis in ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)))
    return CameraPose(frame[0], ahead, left, up)


def pose_of_view(view: View) -> CameraPose:
    """Return the pose that looks from the eye of a view at its target; straight down, up is the x axis."""
    ahead = _unit(subtract(view.target, view.eye))
    left = cross((0.0, 0.0, 1.0), ahead)
    left = (0.0, 1.0, 0.0) if _length(left) < 1e-9 else _unit(left)
    return CameraPose(view.eye, ahead, left, cross(ahead, left))


class Camera:
    """A camera with `height` x `width` pixels; `fov` is the vertical angle (rad). Each pixel is sampled at
    its center."""

    def __init__(self, client: int, width: int, height: int, fov: float, floor: Floor | None) -> None:
        self._pixel = 2 * tan(fov / 2) / height
        self._client = client
        self._size = (width, height)
        self._floor = floor
        across, upward = width * self._pixel / 2, height * self._pixel / 2
        self._rays = np.ones((height, width, 3), np.float32)
        self._rays[..., 1] = across - self._pixel * (np.arange(width) + 0.5)[None, :]
        self._rays[..., 2] = upward - self._pixel * (np.arange(height) + 0.5)[:, None]
        # The renderer samples a pixel at its upper left corner, turned upside down.
        shift = self._pixel / 2
        near = NEAR_CLIP_M
        frustum = (near * edge for edge in (shift - across, shift + across, shift - upward, shift + upward))
        self._projection = p.computeProjectionMatrix(*frustum, near, CAMERA_RANGE_M)

    def _rendered(self, aim: CameraPose) -> tuple[Image, NDArray[np.float32], NDArray[np.int32]]:
        """Return colors, the buffer of depths, and the numbers of bodies (-1 for none), of bodies alone."""
        width, height = self._size
        eye = add(aim.eye, scaled(aim.ahead, EYE_OFFSET_M))
        _, _, pixels, buffer, numbers = p.getCameraImage(
            width,
            height,
            p.computeViewMatrix(eye, add(eye, aim.ahead), aim.up),
            self._projection,
            lightDirection=(1.0, -1.5, 3.0),
            lightColor=(1.0, 1.0, 1.0),
            lightAmbientCoeff=0.55,
            lightDiffuseCoeff=0.5,
            lightSpecularCoeff=0.05,
            shadow=0,
            renderer=p.ER_TINY_RENDERER,  # on the CPU, without OpenGL or a display
            physicsClientId=self._client,
        )
        shape = (height, width)
        colors = np.asarray(pixels, np.uint8).reshape(*shape, 4)[..., :3]
        return (
            colors,
            np.asarray(buffer, np.float32).reshape(shape),
            np.asarray(numbers, np.int32).reshape(shape),
        )

    def _world_rays(self, aim: CameraPose) -> NDArray[np.float32]:
        """Return the line of sight of each pixel in the world frame, with a length of 1 ahead."""
        return (self._rays.reshape(-1, 3) @ np.array(aim[1:], np.float32)).reshape(self._rays.shape)

    def render(self, aim: CameraPose, background: Image) -> Image:
        """Return the colors of bodies, before a background."""
        colors, _, numbers = self._rendered(aim)
        return np.where((numbers < 0)[..., None], background, colors)

    def background(self, aim: CameraPose) -> Image:
        """Return the colors of floor and sky."""
        width, height = self._size
        picture = np.zeros((height, width, 3), np.uint8)
        fill_background(
            picture,
            np.ones((height, width), np.bool_),
            aim.eye,
            self._world_rays(aim),
            self._pixel,
            self._floor,
        )
        return picture

    def camera_image(
        self, aim: CameraPose, name_indices: NDArray[np.int32], ground: int, names: tuple[str, ...]
    ) -> CameraImage:
        """Return the whole picture; `name_indices` are the indices of PyBullet's numbers among `names`,
        `ground` is that of the floor."""
        picture, buffer, numbers = self._rendered(aim)
        colors = picture.copy()
        bare = numbers < 0
        rays = self._world_rays(aim)
        # The inverse of OpenGL's perspective, in which the buffer is nonlinear in the distance.
        depth = CAMERA_RANGE_M * NEAR_CLIP_M / (
            CAMERA_RANGE_M - (CAMERA_RANGE_M - NEAR_CLIP_M) * buffer
        ) + np.float32(EYE_OFFSET_M)
        bodies = np.where(bare, np.int32(-1), name_indices[numbers])
        depth[bare] = CAMERA_RANGE_M
        if self._floor is not None and aim.eye[2] > 0.0:
            floor = bare & (rays[..., 2] < -1e-6)
            bodies[floor] = ground
            depth[floor] = np.minimum(np.float32(-aim.eye[2]) / rays[floor][:, 2], CAMERA_RANGE_M)
        fill_background(colors, bare, aim.eye, rays, self._pixel, self._floor)
        return CameraImage(colors, depth, bodies, names)


def _length(v: Triple) -> float:
    return float(np.linalg.norm(v))


def _unit(v: Triple) -> Triple:
    return scaled(v, 1.0 / _length(v))
