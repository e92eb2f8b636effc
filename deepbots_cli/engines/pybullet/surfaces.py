"""Contacts and their forces, distances between surfaces, free distances of rays from a link, and lines of
sight."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from functools import partial
from math import hypot, inf, sqrt
from typing import TYPE_CHECKING, Any

from deepbots_cli import frames
from deepbots_cli.engines.pybullet import BASE_LINK, state
from deepbots_cli.engines.pybullet import pybullet as p
from deepbots_cli.errors import EngineError
from deepbots_cli.robots.model import Capsule, Cylinder, Sphere

if TYPE_CHECKING:
    from deepbots_cli.engines.pybullet.state import Body, ReadCache
    from deepbots_cli.frames import Frame, Triple
    from deepbots_cli.port import (
        ClearanceReader,
        ContactReader,
        ForceReader,
        PoseReader,
        RayReader,
        VectorReader,
    )

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
ALL_GROUPS = -1
"""The mask of moving bodies."""
ALL_BUT_STATIC = ~2
"""The mask of static bodies."""
MAX_CORRECTION_M = 0.05  # m; farther from PyBullet's answer a closed form has met another surface
RoundShape = Sphere | Cylinder | Capsule


class Rays:
    """Casts rays in one client. The body that casts is in a collision group of its own, which its rays pass
    through."""

    def __init__(self, client: int, bodies: Sequence[Body], read_cache: ReadCache) -> None:
        self._client = client
        self._cache = read_cache
        self._groups: dict[int, int] = {}
        self._round_surfaces = {
            (body.number, index): rounded
            for body in bodies
            for index in body.links.values()
            if (rounded := _rounded(client, body, index, read_cache)) is not None
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
        rounded = self._round_surfaces

        def read() -> list[float]:
            # PyBullet mounts rays on the cached pose of a link, which is one engine step old without this.
            if refresh is not None:
                refresh()
            hits = cast()
            free = [hit[2] * reach for hit in hits]
            if rounded:
                for number, hit in enumerate(hits):
                    if (surface := rounded.get(hit[:2])) is not None:
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
        """Return the free distance along a ray from its hit; surfaces that PyBullet builds of triangles are
        round."""
        surface = self._round_surfaces.get(hit[:2])
        if surface is None:
            return float(hit[2] * reach)
        direction = frames.scaled(frames.subtract(stop, start), 1.0 / reach)
        return surface.hit_distance(start, direction, hit[2] * reach)

    def _collision_group_bit(self, body: Body) -> int:
        """Return the bit of a body's own group; its collisions stay the same."""
        if body.number not in self._groups:
            group = FIRST_GROUP + len(self._groups)
            if group > LAST_GROUP:
                raise EngineError(
                    f"PyBullet supports {LAST_GROUP - FIRST_GROUP + 1} robots with rays, and '{body.name}'"
                    " is one more"
                )
            self._groups[body.number] = 1 << group
            for name, index in body.links.items():
                mask = ALL_BUT_STATIC if name in body.static_links else ALL_GROUPS
                p.setCollisionFilterGroupMask(body.number, index, 1 << group, mask, self._client)
        return self._groups[body.number]


@dataclass(frozen=True)
class RoundSurface:
    """A round surface, where PyBullet's answer is off by 1 mm, and by 7 mm where a ray grazes it: met in
    closed form."""

    shape: RoundShape
    pose: PoseReader
    origin: Frame

    def hit_distance(self, start: Triple, direction: Triple, expected: float) -> float:
        """Return the distance (m) along a unit direction at which the surface is met from outside, if that is
        close to the answer `expected`."""
        center, rotation = frames.compose(self.pose(), self.origin)
        back = frames.inverse(rotation)
        s, d = frames.rotate(back, frames.subtract(start, center)), frames.rotate(back, direction)
        r = self.shape.radius
        if isinstance(self.shape, Sphere):
            met = _ball(s, d, 0.0, r)
        else:
            half = self.shape.length / 2
            met = _first(
                d[0] * d[0] + d[1] * d[1], s[0] * d[0] + s[1] * d[1], s[0] * s[0] + s[1] * s[1] - r * r
            )
            if abs(s[2] + met * d[2]) > half:
                is_flat = isinstance(self.shape, Cylinder)
                met = _disc(s, d, half, r) if is_flat else min(_ball(s, d, half, r), _ball(s, d, -half, r))
        return met if met >= 0.0 and abs(met - expected) < MAX_CORRECTION_M else expected


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


def _rounded(client: int, body: Body, index: int, read_cache: ReadCache) -> RoundSurface | None:
    """Return the surface of a link that collides with one round shape and nothing else."""
    link = body.link(index)
    if len(link.collisions) != 1:
        return None
    geometry = link.collisions[0]
    if not isinstance(geometry.shape, RoundShape):
        return None
    return RoundSurface(
        geometry.shape, state.pose_reader(client, body, index, read_cache), frames.frame(geometry.origin)
    )
